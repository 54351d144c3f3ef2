//! From a frame to what the network takes.

use std::time::Duration;

use web_time::Instant;

use crate::detector::geometry::{Geometry, Region};
use crate::engine::graph::{StageTime, TensorId};
use crate::engine::reference::Crop;
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;
use crate::sensor::frame::Frame;
use crate::sensor::rect::Rect;
use crate::sensor::view::View;
use crate::smr::Network;

/// A picture as the network takes it, and where it lies in the frame.
pub(crate) struct Input<'a> {
    pub start: Instant,
    pub view: View,
    pub geometry: Geometry,
    /// What the view's part is made from, a single word where the frame's own bytes are.
    pub pixels: Value,
    /// The frame's own bytes.
    pub borrowed: Option<&'a [u8]>,
    /// Words that the part's bytes fill.
    words: usize,
    /// How long it took to make it.
    took: Duration,
    crop: Crop,
    /// The crop of all of it, at the network's scale.
    whole: Value,
}

impl<'a> Input<'a> {
    /// With the frame's own bytes if `borrow`, and if they are as the network reads them; else with a copy.
    ///
    /// # Errors
    /// [`Error::Capacity`] for a part of the frame that is too large.
    pub fn new(
        start: Instant,
        frame: &'a Frame<'_>,
        view: View,
        geometry: Geometry,
        borrow: bool,
    ) -> Result<Self> {
        let began = Instant::now();
        let own = if borrow { frame.own_bytes(view.part) } else { None };
        let (pixels, borrowed, crop) = match own {
            Some((bytes, crop)) => (Tensor::zeros([1]), Some(bytes), crop),
            None => {
                let (pixels, crop) = frame.bytes(view.part)?;
                (pixels, None, crop)
            }
        };
        let words = borrowed.map_or(pixels.data().len(), |bytes| bytes.len().div_ceil(4));
        let crop = Crop { resized: geometry.resized, ..crop };
        let whole = crop.to_tensor(words)?.into();
        let (pixels, took) = (pixels.into(), began.elapsed());
        Ok(Self { start, view, geometry, pixels, borrowed, words, took, crop, whole })
    }

    /// The time that it took to get at the frame's bytes.
    pub fn taken(&self) -> StageTime {
        StageTime { stage: "frame".to_owned(), time: self.took }
    }

    /// The crop of all of the view's part, resized to this width and height.
    ///
    /// # Errors
    /// As [`Crop::to_tensor`].
    pub fn resized(&self, resized: [usize; 2]) -> Result<Value> {
        Ok(Crop { resized, ..self.crop }.to_tensor(self.words)?.into())
    }

    /// The crop of a part of the network's input.
    ///
    /// # Errors
    /// [`Error::Tensor`] for a region that begins behind the resized part.
    pub fn part(&self, region: &Region) -> Result<Value> {
        let window = [region.x, region.y];
        Ok(Crop { window, ..self.crop }.to_tensor(self.words)?.into())
    }

    /// All of the network's input.
    pub fn whole(&self) -> Region {
        let [height, width] = self.geometry.size;
        Region { x: 0, y: 0, width, height }
    }

    /// What the frame shows where a part of the network's input is.
    pub fn rect(&self, region: &Region) -> Rect {
        let part = self.view.part;
        let side = |at: usize, length: usize, axis: usize, first: u32, full: u32| {
            let scale = self.scale()[axis];
            let from = ((at as f32 * scale) as u32).min(full - 1);
            let to = (((at + length) as f32 * scale).ceil() as u32).min(full);
            (first + from, to.saturating_sub(from).max(1))
        };
        let (x, width) = side(region.x, region.width, 0, part.x, part.width);
        let (y, height) = side(region.y, region.height, 1, part.y, part.height);
        Rect { x, y, width, height }
    }

    pub fn inputs(&self, network: &Network) -> [(TensorId, &Value); 2] {
        [(network.picture, &self.pixels), (network.crop, &self.whole)]
    }

    /// Pixels of the frame for one of the network's input, along x and y.
    pub fn scale(&self) -> [f32; 2] {
        let part = [self.view.part.width, self.view.part.height];
        std::array::from_fn(|axis| part[axis] as f32 / self.geometry.resized[axis] as f32)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use std::path::Path;
    use std::sync::LazyLock;

    use super::*;
    use crate::engine::reference::crop_resize;

    use crate::sensor::Lens;
    use crate::sensor::pixel_format::PixelFormat;
    use crate::sensor::scale::Scale;

    /// A frame of 640 × 400 pixels whose gel's middle is at (300, 190), of which 300 × 200 at (120, 60) are
    /// seen.
    pub(in crate::detector) fn view(mm_per_pixel: f32) -> View {
        View {
            frame: [640, 400],
            gel: Rect { x: 100, y: 40, width: 400, height: 300 },
            gel_assumed: false,
            part: Rect { x: 120, y: 60, width: 300, height: 200 },
            scale: Scale::stated(mm_per_pixel),
            lens: Lens::of([0.0; 2], [640.0, 400.0], 0.0),
        }
    }

    pub(in crate::detector) fn input(
        mm_per_pixel: f32,
        resized: [usize; 2],
        size: [usize; 2],
    ) -> Input<'static> {
        static FRAME: LazyLock<Frame> =
            LazyLock::new(|| Frame::new(vec![0; 640 * 400], 640, 400, PixelFormat::Gray8));
        let (view, geometry) = (view(mm_per_pixel), Geometry { resized, size });
        Input::new(Instant::now(), &FRAME, view, geometry, true).expect("an input")
    }

    /// Two frame pixels for one of the input along x, and 2.5 along y.
    pub(in crate::detector) fn uneven() -> Input<'static> {
        input(0.05, [150, 80], [96, 160])
    }

    #[test]
    fn windows_are_told_in_pixels_of_the_frame() {
        let input = uneven();
        // Columns 32 to 96 are 64 to 192, rows 16 to 49 are 40 to 122.5, all from (120, 60).
        let window = Region { x: 32, y: 16, width: 64, height: 33 };
        let want = Rect { x: 184, y: 100, width: 128, height: 83 };
        assert_eq!(input.rect(&window), want);
        // What repeats the edge shows no more than the part.
        let window = Region { x: 96, y: 64, width: 64, height: 32 };
        let want = Rect { x: 312, y: 220, width: 108, height: 40 };
        assert_eq!(input.rect(&window), want);
        assert_eq!(input.rect(&input.whole()), input.view.part);
    }

    /// `tests/fixtures/resize.py` has numbers of its own for a part that is shrunk across, stretched along
    /// and filled up to 32 × 32.
    #[test]
    fn the_network_sees_what_python_computes() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/resize.json");
        let text = std::fs::read_to_string(file).expect("a fixture");
        let stored: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let numbers = |name: &str| -> Vec<usize> {
            serde_json::from_value(stored[name].clone()).expect("numbers")
        };
        let levels: Vec<f32> = serde_json::from_value(stored["levels"].clone()).expect("levels");
        let [width, height] = numbers("frame")[..] else { panic!("a size") };
        let bytes: Vec<u8> = (0..height * width * 3)
            .map(|i| {
                let (x, y, c) = (i / 3 % width, i / 3 / width, i % 3);
                ((x * x * 3 + y * 29 + c * 71 + x * y * 5) % 251) as u8
            })
            .collect();
        let frame = Frame::new(bytes, width as u32, height as u32, PixelFormat::Rgb8);
        let [x, y, w, h] = numbers("part")[..] else { panic!("a part") };
        let [x, y, w, h] = [x, y, w, h].map(|n| n as u32);
        let part = Rect { x, y, width: w, height: h };
        let frame_size = [frame.width, frame.height];
        let view = View { frame: frame_size, gel: part, part, ..view(0.5) };
        let [across, along] = numbers("resized")[..] else { panic!("a size") };
        let geometry = Geometry { resized: [across, along], size: [32, 32] };
        let input = Input::new(Instant::now(), &frame, view, geometry, false).expect("an input");
        for window in [input.whole(), Region { x: 5, y: 14, width: 27, height: 18 }] {
            let (Value::U32(pixels), Value::U32(crop)) =
                (&input.pixels, &input.part(&window).expect("a crop"))
            else {
                panic!("integers")
            };
            let crop = Crop::from_tensor(crop, pixels.data().len()).expect("a crop");
            let size = [window.height, window.width];
            let seen = crop_resize(pixels, crop, size, [0.0; 3], [1.0 / 255.0; 3]);
            for (i, level) in seen.data().iter().enumerate() {
                let (x, y) = (i % window.width, i / window.width % window.height);
                let c = i / (window.width * window.height);
                let want = levels[(c * 32 + window.y + y) * 32 + window.x + x];
                assert!((level - want).abs() < 0.002, "({x}, {y}, {c}): {level} for {want}");
            }
        }
    }
}
