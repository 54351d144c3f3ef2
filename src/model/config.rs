//! What a weight file says of its network.

use std::fmt::Debug;

use serde::{Deserialize, Serialize};

use crate::ops::{MEAN, STD};

/// Largest input: conv1's output, 64 channels at half the size, must fit a binding of 128 MiB.
const MAX_INPUT: usize = 1440;
/// Most classes: 100 proposals in each must fit the 1024 boxes of one non-maximum suppression.
const MAX_CLASSES: usize = 10;
/// Characters of the longest class name.
const MAX_NAME: usize = 64;
/// Most anchors of a cell: 16 bytes of deltas for each of 180 × 180 cells are 32 MiB.
const MAX_ANCHORS: usize = 64;
/// Sides of anchors in pixels: up to the diagonal of the largest input, and some.
const ANCHOR_SIZE: [f32; 2] = [1.0, 2048.0];
/// Ratios of anchors.
const ANCHOR_RATIO: [f32; 2] = [0.01, 100.0];
/// Millimetres a pixel: from below the wavelength of light to a centimetre.
const MM_PER_PIXEL: [f32; 2] = [1e-4, 10.0];
/// Longest side of the sensor's picture, as of a crop.
const MAX_PICTURE: u32 = 65_535;
/// Largest reduction: the narrowest map with attention has so many channels.
const MAX_REDUCTION: usize = 64;

/// Configuration of a network, kept as JSON under `config` in the weight file's metadata.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelConfig {
    /// Version of this structure; 1.
    pub format: u32,
    /// Side of the network's square input in pixels, a multiple of 32.
    pub input_size: usize,
    /// Mean of each channel of pictures scaled to [0, 1].
    pub mean: [f32; 3],
    /// Standard deviation of each channel.
    pub std: [f32; 3],
    /// Class names without the background.
    pub classes: Vec<String>,
    /// Anchor sizes (square root of the area) in pixels of the network's input.
    pub anchor_sizes: Vec<f32>,
    /// Anchor ratios, height over width.
    pub anchor_ratios: Vec<f32>,
    /// Millimetres on the gel for one pixel of the sensor's picture, `picture_size` pixels wide.
    pub mm_per_pixel: f32,
    /// Side of the sensor's square picture in pixels.
    pub picture_size: u32,
    /// Pixels of the network's input for one cell of the map that the RPN sees.
    pub stride: usize,
    /// Reduction of the channel attention's hidden layer.
    pub reduction: usize,
    /// Which of the paper's modules the network has.
    pub variant: Variant,
}

/// The paper's ablations (its table of modules): each module on or off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Variant {
    /// SAFE-Net: attention in the backbone.
    pub safe: bool,
    /// MSFF-Net: fusion of three scales; without it conv4_x alone.
    pub msff: bool,
    /// RW-Net: learned weights of the scales; without it concatenation and a 1×1 convolution.
    pub rw: bool,
}

impl ModelConfig {
    /// Parses and checks the JSON text.
    ///
    /// # Errors
    /// In words: what is missing or out of range.
    pub fn parse(text: &str) -> Result<Self, String> {
        let config: Self = serde_json::from_str(text).map_err(|e| format!("config: {e}"))?;
        config.check()?;
        Ok(config)
    }

    /// What [`ModelConfig::is_input_size`] admits, in words.
    pub const INPUT_SIZES: &str = "a multiple of 32 from 32 to 1440";

    /// Whether the network's input may have sides of so many pixels.
    pub fn is_input_size(size: usize) -> bool {
        size.is_multiple_of(32) && (32..=MAX_INPUT).contains(&size)
    }

    /// Checks every value against its range; NaN is in none.
    ///
    /// # Errors
    /// In words: the first that is out of it.
    pub(super) fn check(&self) -> Result<(), String> {
        let expect = |fits: bool, name: &str, expected: String, got: &dyn Debug| match fits {
            true => Ok(()),
            false => Err(format!("config: {name}: expected {expected}, got {got:?}")),
        };
        let number = |name: &str, value: f32, [least, most]: [f32; 2]| {
            let expected = format!("a number from {least} to {most}");
            expect((least..=most).contains(&value), name, expected, &value)
        };
        let numbers = |name: &str, values: &[f32], range| {
            values.iter().try_for_each(|value| number(name, *value, range))
        };
        expect(self.format == 1, "format", "1".into(), &self.format)?;
        let fits = Self::is_input_size(self.input_size);
        expect(fits, "input_size", Self::INPUT_SIZES.into(), &self.input_size)?;
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
        number("mm_per_pixel", self.mm_per_pixel, MM_PER_PIXEL)?;
        let expected = format!("1 to {MAX_PICTURE}");
        let fits = (1..=MAX_PICTURE).contains(&self.picture_size);
        expect(fits, "picture_size", expected, &self.picture_size)?;
        let expected = format!("1 to {MAX_REDUCTION}");
        let fits = (1..=MAX_REDUCTION).contains(&self.reduction);
        expect(fits, "reduction", expected, &self.reduction)
    }

    /// Millimetres on the gel for one pixel of a picture whose largest centred square has `side`
    /// pixels: the square shows the same gel at any resolution.
    pub fn mm_per_pixel_of(&self, side: u32) -> f32 {
        self.mm_per_pixel * self.picture_size as f32 / side as f32
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anchors_follow_torchvision() {
        let config = ModelConfig {
            format: 1,
            input_size: 320,
            mean: [0.5; 3],
            std: [0.2; 3],
            classes: vec!["A".into()],
            anchor_sizes: vec![32.0, 64.0],
            anchor_ratios: vec![0.5, 1.0],
            mm_per_pixel: 0.04,
            picture_size: 1000,
            stride: 8,
            reduction: 16,
            variant: Variant { safe: true, msff: true, rw: true },
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
