//! A part of a picture, resized and normalised.

use crate::engine::ops::case::{Case, random_integers, values};
use crate::engine::ops::op::{EPS, Entry, Op, Tolerance, dims, expect};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::pixel_order::PixelOrder;
use crate::engine::reference::{self, Crop};
use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "crop_resize",
    takes: "picture u32 [N], four bytes a word; crop u32 [11]: width, height, x, y, columns, rows, resized \
            width and height, window x and y, format: 0 RGB, 1 BGR, 2 RGBA, 3 BGRA, 4 grey",
    gives: "output [3, height, width]",
    params: &[
        Param::required("width", "320", Range::Whole(1, MAX_SIZE)),
        Param::required("height", "320", Range::Whole(1, MAX_SIZE)),
        Param::required("mean", "0.5,0.5,0.5", Range::Numbers(MEAN[0], MEAN[1])),
        Param::required("std", "0.2,0.2,0.2", Range::Numbers(STD[0], STD[1])),
    ],
    build,
    cases,
};

/// Largest output and resized side, and side of a crop: the shader's positions, products of the two,
/// stay below 2³².
const MAX_SIZE: u64 = 16_384;
const MAX_SIDE: usize = 65_535;

/// Means of pictures in [0, 1].
pub(crate) const MEAN: [f32; 2] = [0.0, 1.0];
/// Standard deviations: from below one level of 8 bits, 1/255, to far above the largest there is.
pub(crate) const STD: [f32; 2] = [1e-3, 1e3];

/// `(pixel / 255 − mean) / std` of a part of a picture, resized with antialiased bilinear weights, or
/// of a window of it. Past the resized part's right and lower edge the output repeats them.
///
/// Inputs: `picture u32[capacity]`, the bytes of its pixels four a word, the first in the low byte,
/// row-major, rows without padding, perhaps with unused words behind it; `crop u32[11]` from
/// [`Crop::to_tensor`]. As geometry and format are data, one plan serves pictures of every kind and size up
/// to the capacity. Output: `output [3, height, width]`.
#[derive(Clone, Copy, Debug)]
pub struct CropResize {
    /// Columns of the output.
    pub width: usize,
    /// Rows of the output.
    pub height: usize,
    /// Mean of each channel in [0, 1].
    pub mean: [f32; 3],
    /// Standard deviation of each channel, positive.
    pub std: [f32; 3],
}

impl Crop {
    /// Numbers of [`Crop::to_tensor`].
    pub const WORDS: usize = 11;

    /// The crop as [`CropResize`] takes it, for a picture buffer of `capacity` words.
    ///
    /// # Errors
    /// [`Error::Tensor`] if the crop is empty, larger than the shader can address, or not inside the
    /// picture; [`Error::Capacity`] if the picture's bytes are more than the buffer's.
    pub fn to_tensor(&self, capacity: usize) -> Result<Tensor<u32>> {
        let Self { width, height, x, y, columns, rows, resized, window, order } = *self;
        let inside = |at: usize, length: usize, all: usize| {
            (1..=MAX_SIDE).contains(&length) && at <= all && length <= all - at
        };
        if !inside(x, columns, width) || !inside(y, rows, height) {
            let expected =
                format!("a part of 1 to {MAX_SIDE} pixels a side inside {width}×{height}");
            let got = format!("{columns}×{rows} at ({x}, {y})");
            return Err(Error::tensor(ENTRY.name, "crop", expected, got));
        }
        for axis in 0..2 {
            let (size, from) = (resized[axis] as u64, window[axis] as u64);
            if !(1..=MAX_SIZE).contains(&size) || from >= size {
                let expected = format!("a window that begins in 1 to {MAX_SIZE} resized pixels");
                let got = format!("at {window:?} of {resized:?}");
                return Err(Error::tensor(ENTRY.name, "crop", expected, got));
            }
        }
        let words = (width as u64 * height as u64 * order.bytes() as u64).div_ceil(4);
        if words > capacity as u64 {
            let what = format!("words for a {width}×{height} picture");
            return Err(Error::Capacity { what, needed: words, available: capacity as u64 });
        }
        let [w, h] = resized;
        let [left, top] = window;
        let number = PixelOrder::ALL.iter().take_while(|known| **known != order).count();
        let numbers = [width, height, x, y, columns, rows, w, h, left, top, number];
        Ok(Tensor::from_fn([Crop::WORDS], |i| numbers[i] as u32))
    }

    /// Reads [`Crop::to_tensor`]'s words back and checks them again.
    ///
    /// # Errors
    /// As [`Crop::to_tensor`], and [`Error::Tensor`] for a format that there is not.
    pub(crate) fn from_tensor(words: &Tensor<u32>, capacity: usize) -> Result<Self> {
        let [width, height, x, y, columns, rows, w, h, left, top, number] =
            std::array::from_fn(|i| words.data()[i] as usize);
        let order = PixelOrder::ALL.get(number).copied().ok_or_else(|| {
            Error::tensor(ENTRY.name, "crop", "a pixel format from 0 to 4", number)
        })?;
        let (resized, window) = ([w, h], [left, top]);
        let crop = Self { width, height, x, y, columns, rows, resized, window, order };
        crop.to_tensor(capacity).map(|_| crop)
    }
}

impl CropResize {
    /// The mean of each channel as a whole number of 8-bit levels, and what is left of it in [0, 1].
    pub(crate) fn shift(&self) -> [(u8, f64); 3] {
        self.mean.map(|mean| {
            let level = (f64::from(mean) * 255.0).round().clamp(0.0, 255.0) as u8;
            (level, f64::from(mean) - f64::from(level) / 255.0)
        })
    }

    fn parts<'a>(&self, inputs: &[&'a Value]) -> Result<(&'a Tensor<u32>, Crop)> {
        let picture = inputs[0].u32()?;
        Ok((picture, Crop::from_tensor(inputs[1].u32()?, picture.data().len())?))
    }
}

impl Op for CropResize {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![
            ("width", self.width.into()),
            ("height", self.height.into()),
            ("mean", self.mean[..].into()),
            ("std", self.std[..].into()),
        ]
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["picture", "crop"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let [capacity] = dims(name, "picture", &inputs[0], DType::U32)?;
        if capacity == 0 {
            return Err(Error::tensor(name, "picture", "at least one pixel", &inputs[0]));
        }
        expect(name, "crop", &TensorSpec::u32([Crop::WORDS]), &inputs[1])?;
        Ok(vec![TensorSpec::f32([3, self.height, self.width])])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let (picture, crop) = self.parts(inputs)?;
        Ok(vec![
            reference::crop_resize(picture, crop, [self.height, self.width], self.mean, self.std)
                .into(),
        ])
    }

    fn check_values(&self, inputs: &[&Value]) -> Result<()> {
        self.parts(inputs).map(|_| ())
    }

    /// The shader resizes d = pixel − shift, which is exact. That is a sum of at most n = rows +
    /// columns of terms in a row, divided by two such sums of weights, so it is 2n + 16 roundings of
    /// the resized |d| off (three products, a division of 2.5 ULP). The rest's subtraction and the
    /// division by std round relative to that + |rest|, at most 6 times.
    fn tolerance(&self, inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        let (picture, crop) = self.parts(inputs)?;
        let shift = self.shift();
        let bytes: &[u8] = bytemuck::cast_slice(picture.data());
        let mut converted = vec![[0; 3]; crop.columns];
        let distances = (0..crop.rows).flat_map(|y| {
            let row = crop.rgb(bytes, 0..crop.columns, y, &mut converted);
            let word = |rgb: &[u8; 3]| {
                let [r, g, b] = std::array::from_fn(|c| rgb[c].abs_diff(shift[c].0));
                u32::from_le_bytes([r, g, b, 0])
            };
            row.as_chunks().0.iter().map(word).collect::<Vec<_>>()
        });
        let distance = Tensor::new([crop.columns * crop.rows], distances.collect())?;
        let (width, height, order) = (crop.columns, crop.rows, PixelOrder::Rgba8);
        let all = Crop { x: 0, y: 0, width, height, order, ..crop };
        let size = [self.height, self.width];
        let resized = reference::crop_resize(&distance, all, size, [0.0; 3], [1.0; 3]);
        let taps = |side: usize, size: usize| (2 * side.div_ceil(size) + 1).min(side);
        let [w, h] = crop.resized;
        let taps = taps(crop.columns, w) + taps(crop.rows, h);
        let area = self.height * self.width;
        let bound = |(i, size): (usize, &f32)| {
            let (rest, std) = (shift[i / area].1, self.std[i / area]);
            let size = f64::from(*size);
            let roundings = (2 * taps + 16) as f64 * size + 6.0 * (size + rest.abs());
            roundings * EPS / f64::from(std)
        };
        Ok(vec![Tolerance::Each(resized.data().iter().enumerate().map(bound).collect())])
    }
}

fn build(params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    let (width, height) = (params.require("width")?, params.require("height")?);
    let (mean, std) = (params.require_array("mean")?, params.require_array("std")?);
    Ok(Box::new(CropResize { width, height, mean, std }))
}

fn cases() -> Vec<Case> {
    const RAW: CropResize = CropResize { width: 1, height: 1, mean: [0.0; 3], std: [1.0; 3] };
    let sized = |size: usize| CropResize { width: size, height: size, ..RAW };
    let grey = |shades: &[u32]| -> Value {
        Tensor::from_fn([shades.len()], |i| 0xff00_0000 | (shades[i] * 0x01_0101)).into()
    };
    let in_format = |numbers: [u32; Crop::WORDS - 1], format: u32| -> Value {
        Tensor::from_fn([Crop::WORDS], |i| *numbers.get(i).unwrap_or(&format)).into()
    };
    let crop = |numbers: [u32; Crop::WORDS - 1]| in_format(numbers, 2);
    // A square: width, height, x, y, side.
    let square = |size: usize, [w, h, x, y, side]: [u32; 5]| {
        crop([w, h, x, y, side, side, size as u32, size as u32, 0, 0])
    };
    // A pattern that differs between channels, without a random generator.
    let pattern = |count: usize| -> Value {
        Tensor::from_fn([count], |i| {
            let [r, g, b] = [i * 37 + 11, i * 91 + 200, i * 53 + 5].map(|v| v as u32 % 256);
            r | g << 8 | b << 16
        })
        .into()
    };
    let mut cases = vec![
        // 2x2 to one: each pixel is half a pixel from the middle and weighs the same.
        // (0 + 51 + 102 + 255) / 4 / 255 = 0.4.
        Case::new(
            "2x2 to 1 by hand",
            RAW,
            vec![grey(&[0, 51, 102, 255]), square(1, [2, 2, 0, 0, 2])],
        )
        .by_hand(vec![values([3, 1, 1], &[0.4, 0.4, 0.4])]),
        // Rows of 4 to 2: the triangle reaches 2 pixels, centres at 1 and 3; the weights are 3/4,
        // 3/4, 1/4 over 7/4. (3·0 + 3·35 + 70) / 7 = 25, (35 + 3·70 + 3·245) / 7 = 140. All four
        // rows are equal. Then (25/255 − 5/51) / 0.1 = 0 and (140/255 − 5/51) / 0.1 = 230/51.
        Case::new(
            "4x4 to 2, normalised, by hand",
            CropResize { mean: [5.0 / 51.0; 3], std: [0.1; 3], ..sized(2) },
            vec![
                grey(&std::array::from_fn::<u32, 16, _>(|i| [0, 35, 70, 245][i % 4])),
                square(2, [4, 4, 0, 0, 4]),
            ],
        )
        .by_hand(vec![values([3, 2, 2], &[0.0, 230.0 / 51.0].repeat(6))]),
        // Red is the low byte; alpha does not count.
        Case::new(
            "channel order by hand",
            RAW,
            vec![Tensor::from_fn([1], |_| 0x0066_3300).into(), square(1, [1, 1, 0, 0, 1])],
        )
        .by_hand(vec![values([3, 1, 1], &[0.0, 0.2, 0.4])]),
        // Levels 51, 102, 204 are 0.2, 0.4, 0.8: (0.2 − 1/8) · 2, (0.4 − 1/4) · 4, (0.8 − 1/2) · 8.
        Case::new(
            "each channel its mean and deviation, by hand",
            CropResize { mean: [0.125, 0.25, 0.5], std: [0.5, 0.25, 0.125], ..RAW },
            vec![Tensor::from_fn([1], |_| 0x00cc_6633).into(), square(1, [1, 1, 0, 0, 1])],
        )
        .by_hand(vec![values([3, 1, 1], &[0.15, 0.6, 2.4])]),
        // The numbers are PyTorch's, from `interpolate(…, antialias=True)` in f64.
        Case::new(
            "5x5 inside 7x6 to 3, PyTorch's numbers",
            sized(3),
            vec![pattern(42), square(3, [7, 6, 1, 1, 5])],
        )
        .by_hand(vec![values(
            [3, 3, 3],
            &[
                0.2672269, 0.4952381, 0.7232493, 0.2857143, 0.5137255, 0.7417367, 0.3042017,
                0.5322129, 0.7602241, 0.5602241, 0.5792095, 0.35006, 0.5337691, 0.5616074,
                0.3327109, 0.5232493, 0.5422347, 0.3130852, 0.5305322, 0.4109555, 0.610084,
                0.4424525, 0.6451222, 0.5379396, 0.3703081, 0.5694367, 0.4498599,
            ],
        )]),
        Case::new(
            "2x2 inside 7x6 enlarged to 3, PyTorch's numbers",
            sized(3),
            vec![pattern(42), square(3, [7, 6, 2, 0, 2])],
        )
        .by_hand(vec![values(
            [3, 3, 3],
            &[
                0.3333333, 0.4058824, 0.4784314, 0.3392157, 0.4117647, 0.4843137, 0.345098,
                0.4176471, 0.4901961, 0.4941177, 0.672549, 0.8509804, 0.7392157, 0.6666667,
                0.5941177, 0.9843137, 0.6607843, 0.3372549, 0.4352941, 0.5392157, 0.6431372,
                0.6607843, 0.5137255, 0.3666667, 0.8862745, 0.4882353, 0.0901961,
            ],
        )]),
    ];
    // Three columns to three of their own width: 51, 102, 204 are 0.2, 0.4, 0.8. The window begins at
    // the second, and what is past the third repeats it.
    let line = vec![grey(&[51, 102, 204]), crop([3, 1, 0, 0, 3, 1, 3, 1, 1, 0])];
    cases.push(
        Case::new("a window and its edge by hand", CropResize { width: 4, height: 2, ..RAW }, line)
            .by_hand(vec![values([3, 2, 4], &[0.4, 0.8, 0.8, 0.8].repeat(6))]),
    );
    // Near the mean, where a subtraction at the end would lose what is there:
    // (135/255 − 17/32) · 128 = −4/17.
    let near = CropResize { mean: [0.531_25; 3], std: [1.0 / 128.0; 3], ..sized(2) };
    let inputs = vec![grey(&[135; 9]), square(2, [3, 3, 0, 0, 3])];
    cases.push(
        Case::new("one level off the mean, by hand", near, inputs)
            .by_hand(vec![values([3, 2, 2], &[-4.0 / 17.0; 12])]),
    );
    let (mean, std) = ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]);
    // (name, size, capacity, [width, height, x, y, side])
    let shapes = [
        ("one pixel enlarged to 17", 17, 1, [1, 1, 0, 0, 1]),
        ("one pixel out of a line", 3, 8192, [1, 8192, 0, 4095, 1]),
        ("same size", 13, 169, [13, 13, 0, 0, 13]),
        ("63 outputs in a row, a buffer larger than the picture", 63, 5000, [71, 67, 4, 0, 67]),
        ("lower right corner", 65, 31 * 29, [31, 29, 12, 10, 19]),
        ("1/31.25 of the size", 4, 125 * 125, [125, 125, 0, 0, 125]),
        ("31.25 times the size", 125, 16, [4, 4, 0, 0, 4]),
        ("odd to odd, nearly the same", 31, 33 * 35, [35, 33, 1, 0, 33]),
        ("to a fifth, primes", 19, 101 * 97, [101, 97, 4, 0, 97]),
        ("four megapixels to 31", 31, 2048 * 2048, [2048, 2048, 1, 1, 2047]),
    ];
    for (name, size, capacity, numbers) in shapes {
        let op = CropResize { mean, std, ..sized(size) };
        cases.push(Case::new(name, op, vec![pattern(capacity), square(size, numbers)]));
    }
    // (name, width, height, capacity, crop)
    let shapes = [
        ("each axis its scale", 13, 5, 61 * 47, [61, 47, 3, 5, 53, 41, 13, 5, 0, 0]),
        ("enlarged one way, shrunk the other", 34, 7, 17 * 67, [17, 67, 0, 0, 17, 67, 34, 7, 0, 0]),
        ("with repeated edges", 64, 32, 101 * 31, [101, 31, 1, 2, 99, 29, 50, 17, 0, 0]),
        ("a window in the middle", 9, 33, 97 * 103, [97, 103, 0, 0, 97, 103, 60, 64, 21, 8]),
        ("a window past the corner", 31, 17, 97 * 103, [97, 103, 2, 3, 90, 99, 45, 33, 40, 32]),
    ];
    for (name, width, height, capacity, numbers) in shapes {
        let op = CropResize { width, height, mean, std };
        cases.push(Case::new(name, op, vec![pattern(capacity), crop(numbers)]));
    }
    // Two rows of two pixels, each to itself. The bytes are 0, 51, 102, 153, 204, 255 and again, a fifth more
    // each: 0, 1, 2, 3, 4, 5, 0, 1, …
    let words = [0x9966_3300, 0x3300_ffcc, 0xffcc_9966, 0x9966_3300];
    let bytes: Value = Tensor::from_fn([4], |i| words[i]).into();
    let by_hand = [
        [[0, 3, 0, 3], [1, 4, 1, 4], [2, 5, 2, 5]],
        [[2, 5, 2, 5], [1, 4, 1, 4], [0, 3, 0, 3]],
        [[0, 4, 2, 0], [1, 5, 3, 1], [2, 0, 4, 2]],
        [[2, 0, 4, 2], [1, 5, 3, 1], [0, 4, 2, 0]],
        [[0, 1, 2, 3]; 3],
    ];
    for ((number, format), fifths) in (0..).zip(PixelOrder::ALL).zip(by_hand) {
        let want: Vec<f32> = fifths.as_flattened().iter().map(|n| *n as f32 / 5.0).collect();
        let inputs = vec![bytes.clone(), in_format([2, 2, 0, 0, 2, 2, 2, 2, 0, 0], number)];
        let case = Case::new(format!("{format:?} by hand"), sized(2), inputs);
        cases.push(case.by_hand(vec![values([3, 2, 2], &want)]));
        let words = (61 * 47 * format.bytes()).div_ceil(4);
        let noise = random_integers(u64::from(number), [words], u32::MAX);
        let op = CropResize { width: 23, height: 17, mean, std };
        let inputs = vec![noise, in_format([61, 47, 1, 2, 60, 45, 23, 17, 0, 0], number)];
        cases.push(Case::new(format!("{format:?}, resized"), op, inputs));
    }
    // A row of five pixels, of which the last four make one: their centres are 3/2 and 1/2 from the middle and
    // the triangle reaches 4, so they weigh 5, 7, 7 and 5 of 24. Red is 0, 1, 3 and 5 fifths, which makes 53/24
    // of a fifth, green 5, 0, 1 and 3, blue 3, 5, 0 and 1. Which byte is which colour, by format:
    let bytes_of: [&[usize]; 5] = [&[0, 1, 2], &[2, 1, 0], &[0, 1, 2, 0], &[2, 1, 0, 0], &[0]];
    let fifths: [[u8; 3]; 5] = [[2, 4, 4], [0, 5, 3], [1, 0, 5], [3, 1, 0], [5, 3, 1]];
    for ((number, format), order) in (0..).zip(PixelOrder::ALL).zip(bytes_of) {
        let bytes = fifths.iter().flat_map(|of| order.iter().map(|colour| 51 * of[*colour]));
        let bytes: Vec<u8> = bytes.collect();
        let word = |at: usize| {
            (0..4)
                .rev()
                .fold(0, |word, i| word << 8 | u32::from(*bytes.get(4 * at + i).unwrap_or(&0)))
        };
        let words: Value = Tensor::from_fn([bytes.len().div_ceil(4)], word).into();
        let inputs = vec![words, in_format([5, 1, 1, 0, 4, 1, 1, 1, 0, 0], number)];
        let want = if order.len() == 1 { [53.0; 3] } else { [53.0, 47.0, 55.0] };
        let case = Case::new(format!("four pixels to one, {format:?}, by hand"), RAW, inputs);
        cases.push(case.by_hand(vec![values([3, 1, 1], &want.map(|n: f32| n / 120.0))]));
    }
    let op = CropResize { mean, std, ..sized(320) };
    let inputs = vec![pattern(1_000_000), square(320, [1000, 1000, 0, 0, 1000])];
    cases.push(Case::new("the sensor's picture", op, inputs).in_network());
    cases
}
