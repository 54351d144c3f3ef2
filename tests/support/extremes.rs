//! Pictures and weights at the ends of what there may be, for the whole network.

use std::collections::HashMap;

use safetensors::{Dtype, SafeTensors};
use smr_gpu::{Detections, Error, Frame, GpuDetector, PixelFormat};

/// A picture, or weights, that few would think of.
pub struct Extreme {
    pub name: &'static str,
    pub picture: Picture,
    /// What is done to the weights.
    pub weights: Weights,
    /// Side of the network's input, where it is another than all others'.
    pub size: Option<usize>,
    /// Whether it takes seconds.
    pub slow: bool,
}

/// What a picture shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Picture {
    /// Snaps: what the weights know.
    Usual,
    /// The same at this share of their contrast about a middle grey.
    Faint(f32),
    /// The same with each pixel so many times over, along x and y.
    Enlarged(u32),
    Even([u8; 3]),
    Spot,
    Checkerboard,
    Noise {
        width: u32,
        height: u32,
    },
}

/// What is done to weights that are as they should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Weights {
    Usual,
    /// The tensors of these beginnings, all times this.
    Scaled(&'static [&'static str], f32),
    /// The tensors of these beginnings, all this.
    Filled(&'static [&'static str], f32),
}

/// Side of the pictures that have no size of their own.
const SIDE: u32 = 250;

pub fn extremes() -> Vec<Extreme> {
    let usual =
        |name, picture, weights| Extreme { name, picture, weights, size: None, slow: false };
    let picture = |name, picture| usual(name, picture, Weights::Usual);
    let weights = |name, weights| usual(name, Picture::Usual, weights);
    let noise = Picture::Noise { width: SIDE, height: SIDE };
    let sized = |name, width, height| picture(name, Picture::Noise { width, height });
    let bn1: &[&str] = &["backbone.bn1.weight", "backbone.bn1.bias"];
    let norms: &[&str] = &["backbone.", "fusion."];
    vec![
        picture("black", Picture::Even([0; 3])),
        picture("white", Picture::Even([255; 3])),
        picture("saturated red", Picture::Even([255, 0, 0])),
        picture("one bright pixel", Picture::Spot),
        picture("checkerboard of pixels", Picture::Checkerboard),
        picture("noise, each value 0 or 255", noise),
        sized("1 × 1 pixel", 1, 1),
        Extreme { slow: true, ..sized("8192 × 4096 pixels", 8192, 4096) },
        Extreme { size: Some(320), ..picture("an eighth of the contrast", Picture::Faint(0.125)) },
        Extreme {
            size: Some(320),
            slow: true,
            ..picture("each pixel 5 × 5 times", Picture::Enlarged(5))
        },
        Extreme { size: Some(32), ..picture("input of 32 × 32", Picture::Usual) },
        Extreme {
            size: Some(1024), slow: true, ..picture("input of 1024 × 1024", Picture::Usual)
        },
        weights("activations past 65 504", Weights::Scaled(bn1, 1e5)),
        weights("activations of 1e30", Weights::Scaled(bn1, 1e30)),
        weights("conv1 past every number", Weights::Filled(&["backbone.bn1.weight"], 1e37)),
        weights(
            "layer 3 past every number",
            Weights::Scaled(
                &["backbone.layer3.0.bn1.weight", "backbone.layer3.0.bn2.weight"],
                1e25,
            ),
        ),
        weights("objectness of 3e38", Weights::Filled(&["rpn.cls.bias"], 3e38)),
        weights("box deltas of 3e38", Weights::Filled(&["rpn.bbox.bias"], 3e38)),
        weights("the RoI head past every number", Weights::Filled(&["roi_head.fc6.bias"], 3e38)),
        weights("all weights zero", Weights::Filled(&[""], 0.0)),
        weights("activations subnormal", Weights::Scaled(norms, 1e-39)),
    ]
}

/// The picture's pixels, three bytes each, with its width and height.
pub fn pixels(picture: Picture, usual: &image::RgbImage) -> (Vec<u8>, [u32; 2]) {
    let each = |[width, height]: [u32; 2], of: &dyn Fn(u32, u32) -> [u8; 3]| {
        let at = |i: u32| of(i % width, i / width);
        ((0..width * height).flat_map(at).collect(), [width, height])
    };
    let square = [SIDE; 2];
    match picture {
        Picture::Usual => (usual.as_raw().clone(), [usual.width(), usual.height()]),
        Picture::Faint(share) => {
            let fainter = |v: &u8| (128.0 + share * (f32::from(*v) - 128.0)).round() as u8;
            (usual.iter().map(fainter).collect(), [usual.width(), usual.height()])
        }
        Picture::Enlarged(times) => {
            each([times * usual.width(), times * usual.height()], &|x, y| {
                usual.get_pixel(x / times, y / times).0
            })
        }
        Picture::Even(colour) => each(square, &|_, _| colour),
        Picture::Spot => each(square, &|x, y| [if [x, y] == [90, 140] { 255 } else { 0 }; 3]),
        Picture::Checkerboard => each(square, &|x, y| [((x + y) % 2 * 255) as u8; 3]),
        Picture::Noise { width, height } => each([width, height], &|x, y| {
            let mixed = (y * 8192 + x).wrapping_mul(2_654_435_761);
            [13, 17, 21].map(|bit| ((mixed ^ mixed >> 9) >> bit & 1) as u8 * 255)
        }),
    }
}

/// A weight file's bytes after what is done to it.
pub fn changed(bytes: &[u8], weights: Weights) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let (names, change): (&[&str], Box<dyn Fn(f32) -> f32>) = match weights {
        Weights::Usual => return bytes,
        Weights::Scaled(names, factor) => (names, Box::new(move |x| x * factor)),
        Weights::Filled(names, value) => (names, Box::new(move |_| value)),
    };
    let (header, metadata) = SafeTensors::read_metadata(&bytes).expect("a weight file");
    let tensors: HashMap<String, _> = metadata.tensors().into_iter().collect();
    for (name, info) in tensors {
        // Of those that are scaled, the gain and the offset of each norm alone.
        let is_norm = || [".weight", ".bias"].iter().any(|end| name.ends_with(end));
        let f32s = info.dtype == Dtype::F32 && is_norm();
        let zeroed = weights == Weights::Filled(&[""], 0.0);
        if !names.iter().any(|start| name.starts_with(start)) || !(f32s || zeroed) {
            continue;
        }
        let values = &mut bytes[8 + header..][info.data_offsets.0..info.data_offsets.1];
        if zeroed {
            values.fill(0);
            continue;
        }
        for word in values.as_chunks_mut::<4>().0 {
            *word = change(f32::from_le_bytes(*word)).to_le_bytes();
        }
    }
    bytes
}

/// What came of it.
#[derive(Clone, Debug)]
#[allow(dead_code, reason = "the test reads them only to show them")]
pub enum Outcome {
    /// Detections, all of whose numbers are finite.
    Finite(Detections),
    /// The error that names where a value was not finite.
    NotFinite(String),
    /// Anything else, in words: it must not be.
    Other(String),
}

pub fn outcome(detector: &GpuDetector, pixels: &[u8], [width, height]: [u32; 2]) -> Outcome {
    match detector.detect(Frame::new(pixels, width, height, PixelFormat::Rgb8)) {
        Ok(found) if is_finite(&found) => Outcome::Finite(found),
        Ok(found) => Outcome::Other(format!("{:?}", found.detections)),
        Err(Error::NotFinite { stage, .. }) => Outcome::NotFinite(stage),
        Err(e) => Outcome::Other(e.to_string()),
    }
}

fn is_finite(found: &Detections) -> bool {
    found.detections.iter().all(|d| {
        let told = [d.yaw_deg, d.yaw_std_deg, d.whole].into_iter().flatten();
        let placed =
            d.bbox.into_iter().chain(d.center_mm).chain(d.center_std_mm.into_iter().flatten());
        d.score.is_finite() && told.chain(placed).all(f32::is_finite)
    })
}

/// How far corners and scores are apart, in pixels and as such; nothing unless the same classes were found in the
/// same order.
pub fn apart(a: &Detections, b: &Detections) -> Option<[f32; 2]> {
    let (a, b) = (&a.detections, &b.detections);
    if a.len() != b.len() || a.iter().zip(b).any(|(a, b)| a.class != b.class) {
        return None;
    }
    let pairs = || a.iter().zip(b);
    let corners = pairs().flat_map(|(a, b)| a.bbox.iter().zip(b.bbox).map(|(a, b)| (a - b).abs()));
    let scores = pairs().map(|(a, b)| (a.score - b.score).abs());
    Some([corners.fold(0.0, f32::max), scores.fold(0.0, f32::max)])
}
