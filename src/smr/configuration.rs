//! What a weight file says of its network.

use std::fmt::Debug;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::engine::ops::{MEAN, STD};
use crate::sensor::scale::PAPER_MM;

/// Most classes: 100 proposals in each must fit the 1024 boxes of one non-maximum suppression.
pub const MAX_CLASSES: usize = 10;
/// Characters of the longest class name.
const MAX_NAME: usize = 64;
/// Most anchors of a cell: 16 bytes of deltas for each of 180 × 180 cells are 32 MiB.
const MAX_ANCHORS: usize = 64;
/// Sides of anchors in pixels: up to the diagonal of the largest input, and some.
const ANCHOR_SIZE: [f32; 2] = [1.0, 2048.0];
/// Ratios of anchors.
const ANCHOR_RATIO: [f32; 2] = [0.01, 100.0];
/// Pixels of the network's input for a millimetre of gel: up to the longest input for the least field, 10 mm.
const PIXELS_PER_MM: [f32; 2] = [1e-3, ModelConfig::MAX_INPUT as f32 / 10.0];
/// Millimetres a pixel in format 1: from below the wavelength of light to a centimetre.
const MM_PER_PIXEL: [f32; 2] = [1e-4, 10.0];
/// Longest side of the sensor's picture in format 1, as of a crop.
const MAX_PICTURE: u32 = 65_535;
/// Most channels of a map, and units of a layer.
const MAX_CHANNELS: usize = 4096;
/// Most basic blocks of a stage: that of the deepest ResNet has 36.
const MAX_BLOCKS: usize = 64;
/// Temperatures.
const TEMPERATURE: [f32; 2] = [1e-2, 1e2];

/// Configuration of a network, kept as JSON under `config` in the weight file's metadata; its format
/// is 2. `weights/README.md` has each key, and those of format 1, which is read too.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelConfig {
    /// Version of this structure; 2.
    pub format: u32,
    /// Scale of the network's input: pixels for a millimetre of gel.
    pub pixels_per_mm: f32,
    /// Mean of each channel of pictures scaled to [0, 1].
    pub mean: [f32; 3],
    /// Standard deviation of each channel.
    pub std: [f32; 3],
    /// Class names without the background.
    pub classes: Vec<String>,
    /// Names of the classes that have a direction.
    pub directed: Vec<String>,
    /// Anchor sizes (square root of the area) in pixels of the network's input.
    pub anchor_sizes: Vec<f32>,
    /// Anchor ratios, height over width.
    pub anchor_ratios: Vec<f32>,
    /// Pixels of the network's input for one cell of the map that the RPN sees.
    pub stride: usize,
    /// Which of the paper's modules the network has.
    pub variant: Variant,
    /// Channels of conv1's output.
    pub stem: usize,
    /// Channels of the outputs of conv2_x to conv5_x.
    pub channels: [usize; 4],
    /// Basic blocks of conv2_x to conv5_x.
    pub blocks: [usize; 4],
    /// Reduction of the channel attention's hidden layer.
    pub reduction: usize,
    /// Channels of each scale in the fusion, and of the fused map.
    pub fused: usize,
    /// Channels of RW-Net's convolutions, and units of its hidden layer.
    pub reweight: usize,
    /// Units of each of the RoI head's two layers.
    pub head: usize,
    /// Whether the RoI head tells the pose.
    pub pose: bool,
    /// What the classes' logits are divided by, so that scores are probabilities.
    pub temperature: f32,
}

/// Format 1: one network, on square pictures of one sensor.
#[derive(Deserialize)]
struct Format1 {
    input_size: usize,
    mean: [f32; 3],
    std: [f32; 3],
    classes: Vec<String>,
    anchor_sizes: Vec<f32>,
    anchor_ratios: Vec<f32>,
    mm_per_pixel: f32,
    picture_size: u32,
    stride: usize,
    reduction: usize,
    variant: Variant,
}

/// What the network is made of: the paper's modules (its table of ablations), each on or off, and what a plain
/// Faster R-CNN has in their place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Variant {
    /// SAFE-Net: attention in the backbone.
    pub safe: bool,
    /// MSFF-Net: fusion of three scales; without it conv4_x alone.
    pub msff: bool,
    /// RW-Net: learned weights of the scales; without it concatenation and a 1×1 convolution.
    pub rw: bool,
    /// The RPN's own 3×3 convolution, which MSFF-Net replaces.
    #[serde(default)]
    pub rpn_conv: bool,
}

impl Variant {
    /// The paper's network.
    pub const SMR_NET: Self = Self { safe: true, msff: true, rw: true, rpn_conv: false };
    /// Faster R-CNN on conv4_x (Ren et al. 2015; He et al. 2016, appendix A), one of the paper's baselines.
    pub const FASTER_RCNN: Self = Self { safe: false, msff: false, rw: false, rpn_conv: true };

    /// Whether the network can do without the deepest scale, since RW-Net weighs the others alone.
    pub fn leaves_deepest(self) -> bool {
        self.msff && self.rw
    }
}

impl ModelConfig {
    /// Parses and checks the JSON text.
    ///
    /// # Errors
    /// In words: what is missing or out of range.
    pub fn parse(text: &str) -> Result<Self, String> {
        let fail = |e: serde_json::Error| format!("config: {e}");
        let value: Value = serde_json::from_str(text).map_err(fail)?;
        let config = match value.get("format").and_then(Value::as_u64) {
            Some(1) => Self::from_format_1(serde_json::from_str(text).map_err(fail)?)?,
            _ => serde_json::from_str(text).map_err(fail)?,
        };
        config.check()?;
        Ok(config)
    }

    fn from_format_1(old: Format1) -> Result<Self, String> {
        let fits = Self::is_input_size(old.input_size);
        expect(fits, "input_size", Self::INPUT_SIZES.into(), &old.input_size)?;
        number("mm_per_pixel", old.mm_per_pixel, MM_PER_PIXEL)?;
        let fits = (1..=MAX_PICTURE).contains(&old.picture_size);
        expect(fits, "picture_size", format!("1 to {MAX_PICTURE}"), &old.picture_size)?;
        let field = f64::from(old.mm_per_pixel) * f64::from(old.picture_size);
        let pixels_per_mm = (old.input_size as f64 / field) as f32;
        number("input_size / (mm_per_pixel * picture_size)", pixels_per_mm, PIXELS_PER_MM)?;
        Ok(Self {
            pixels_per_mm,
            mean: old.mean,
            std: old.std,
            classes: old.classes,
            anchor_sizes: old.anchor_sizes,
            anchor_ratios: old.anchor_ratios,
            stride: old.stride,
            variant: old.variant,
            reduction: old.reduction,
            ..Self::large()
        })
    }

    /// The paper's network, as all of format 1: ResNet-34's widths, without pose. What depends on the
    /// data is that of pictures in the middle of their range, with anchors of 32, 48 and 72 pixels.
    pub fn large() -> Self {
        Self {
            format: 2,
            pixels_per_mm: 8.0,
            mean: [0.5; 3],
            std: [0.2; 3],
            classes: vec!["A".into(), "B".into()],
            directed: Vec::new(),
            anchor_sizes: vec![32.0, 48.0, 72.0],
            anchor_ratios: vec![0.5, 1.0, 2.0],
            stride: 8,
            variant: Variant::SMR_NET,
            stem: 64,
            channels: [64, 128, 256, 512],
            blocks: [3, 4, 6, 3],
            reduction: 16,
            fused: 256,
            reweight: 64,
            head: 512,
            pose: false,
            temperature: 1.0,
        }
    }

    /// Longest side of the network's input: conv1's output, 64 channels at half the size, must fit a binding
    /// of 128 MiB.
    pub const MAX_INPUT: usize = 1440;
    /// What [`ModelConfig::is_input_size`] admits, in words.
    pub const INPUT_SIZES: &str = "a multiple of 32 from 32 to 1440";

    /// Whether the network's input may have a side of so many pixels.
    pub fn is_input_size(size: usize) -> bool {
        size.is_multiple_of(32) && (32..=Self::MAX_INPUT).contains(&size)
    }

    /// Checks every value against its range; NaN is in none.
    ///
    /// # Errors
    /// In words: the first that is out of it.
    pub(super) fn check(&self) -> Result<(), String> {
        let numbers = |name: &str, values: &[f32], range| {
            values.iter().try_for_each(|value| number(name, *value, range))
        };
        expect(self.format == 2, "format", "1 or 2".into(), &self.format)?;
        number("pixels_per_mm", self.pixels_per_mm, PIXELS_PER_MM)?;
        let stride = if self.variant.msff { 8 } else { 16 };
        let expected = format!("{stride} for the variant");
        expect(self.stride == stride, "stride", expected, &self.stride)?;
        numbers("mean", &self.mean, MEAN)?;
        numbers("std", &self.std, STD)?;
        let fits = (1..=MAX_CLASSES).contains(&self.classes.len());
        let expected = format!("1 to {MAX_CLASSES} names");
        expect(fits, "classes", expected, &self.classes.len())?;
        for (i, name) in self.classes.iter().enumerate() {
            let fits = !name.trim().is_empty() && name.chars().count() <= MAX_NAME;
            let expected = format!("names of 1 to {MAX_NAME} characters");
            expect(fits, "classes", expected, name)?;
            let lower = name.to_lowercase();
            let fits = self.classes[..i].iter().all(|other| other.to_lowercase() != lower);
            expect(fits, "classes", "different names".into(), name)?;
        }
        for name in &self.directed {
            let fits = self.classes.contains(name);
            expect(fits, "directed", "names of classes".into(), name)?;
        }
        numbers("anchor_sizes", &self.anchor_sizes, ANCHOR_SIZE)?;
        numbers("anchor_ratios", &self.anchor_ratios, ANCHOR_RATIO)?;
        let (sizes, ratios) = (self.anchor_sizes.len(), self.anchor_ratios.len());
        let fits = (1..=MAX_ANCHORS).contains(&sizes.saturating_mul(ratios));
        let expected = format!("1 to {MAX_ANCHORS} sizes times ratios");
        expect(fits, "anchor_sizes and anchor_ratios", expected, &(sizes, ratios))?;
        // Rounded to whole pixels, a small or slender one may be gone.
        let anchors = self.cell_anchors();
        let flat = anchors.iter().find(|[x1, y1, x2, y2]| x1 >= x2 || y1 >= y2);
        let expected = "anchors that cover a pixel".into();
        expect(flat.is_none(), "anchor_sizes and anchor_ratios", expected, &flat)?;
        let count = |name: &str, value: usize, most: usize| {
            expect((1..=most).contains(&value), name, format!("1 to {most}"), &value)
        };
        count("stem", self.stem, MAX_CHANNELS)?;
        self.channels.iter().try_for_each(|c| count("channels", *c, MAX_CHANNELS))?;
        self.blocks.iter().try_for_each(|b| count("blocks", *b, MAX_BLOCKS))?;
        count("fused", self.fused, MAX_CHANNELS)?;
        count("reweight", self.reweight, MAX_CHANNELS)?;
        count("head", self.head, MAX_CHANNELS)?;
        // Of the maps with attention the narrowest has as many hidden units at least as one.
        let narrowest = self.channels.iter().chain([&self.stem, &self.fused]).min();
        count("reduction", self.reduction, narrowest.map_or(1, |n| *n))?;
        number("temperature", self.temperature, TEMPERATURE)
    }

    /// Channels of the map that the RPN and the RoI head see: without the fusion that of conv4_x.
    pub fn width(&self) -> usize {
        if self.variant.msff { self.fused } else { self.channels[2] }
    }

    /// Side of the network's input for a square of the paper's gel, in pixels: a multiple of 32.
    pub fn paper_size(&self) -> usize {
        ((PAPER_MM * self.pixels_per_mm).round() as usize).max(1).next_multiple_of(32)
    }

    /// Anchors of one cell, `(x1, y1, x2, y2)` round the origin, in torchvision's order (ratios
    /// outside, sizes inside) and with its rounding to whole pixels, half to even.
    pub fn cell_anchors(&self) -> Vec<[f32; 4]> {
        let mut anchors = Vec::new();
        for ratio in &self.anchor_ratios {
            let h_ratio = ratio.sqrt();
            let w_ratio = 1.0 / h_ratio;
            for size in &self.anchor_sizes {
                let (w, h) = (w_ratio * size / 2.0, h_ratio * size / 2.0);
                anchors.push([-w, -h, w, h].map(f32::round_ties_even));
            }
        }
        anchors
    }
}

fn expect(fits: bool, name: &str, expected: String, got: &dyn Debug) -> Result<(), String> {
    match fits {
        true => Ok(()),
        false => Err(format!("config: {name}: expected {expected}, got {got:?}")),
    }
}

/// Whether `value` is in its range; NaN is in none.
fn number(name: &str, value: f32, [least, most]: [f32; 2]) -> Result<(), String> {
    let expected = format!("a number from {least} to {most}");
    expect((least..=most).contains(&value), name, expected, &value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anchors_follow_torchvision() {
        let config = ModelConfig {
            anchor_sizes: vec![32.0, 64.0],
            anchor_ratios: vec![0.5, 1.0],
            ..ModelConfig::large()
        };
        // torchvision 0.2x: AnchorGenerator(((32, 64),), ((0.5, 1.0),)).cell_anchors[0]
        let expected = [
            [-23.0, -11.0, 23.0, 11.0],
            [-45.0, -23.0, 45.0, 23.0],
            [-16.0, -16.0, 16.0, 16.0],
            [-32.0, -32.0, 32.0, 32.0],
        ];
        assert_eq!(config.cell_anchors(), expected);
    }
}
