//! What a weight file says of its network.

use serde::{Deserialize, Serialize};

/// Largest input: conv1's output, 64 channels at half the size, must fit a binding of 128 MiB.
const MAX_INPUT: usize = 1440;
/// Most classes: 100 proposals in each must fit the 1024 boxes of one non-maximum suppression.
const MAX_CLASSES: usize = 10;

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

    pub(super) fn check(&self) -> Result<(), String> {
        let finite = |v: &[f32]| v.iter().all(|x| x.is_finite() && *x > 0.0);
        if self.format != 1 {
            return Err(format!("config: format: expected 1, got {}", self.format));
        }
        if !self.input_size.is_multiple_of(32) || !(32..=MAX_INPUT).contains(&self.input_size) {
            let got = self.input_size;
            return Err(format!(
                "config: input_size: expected a multiple of 32 from 32 to {MAX_INPUT}, got {got}"
            ));
        }
        let stride = if self.variant.msff { 8 } else { 16 };
        if self.stride != stride {
            let got = self.stride;
            return Err(format!("config: stride: expected {stride} for the variant, got {got}"));
        }
        if !finite(&self.std) || !self.mean.iter().all(|m| m.is_finite()) {
            return Err("config: mean and std: expected finite values, std above 0".into());
        }
        if self.classes.is_empty() || self.classes.len() > MAX_CLASSES {
            let got = self.classes.len();
            return Err(format!("config: classes: expected 1 to {MAX_CLASSES} names, got {got}"));
        }
        let names: std::collections::BTreeSet<_> =
            self.classes.iter().map(|c| c.to_lowercase()).collect();
        if names.len() != self.classes.len() || names.contains("") {
            let got = self.classes.join(", ");
            return Err(format!("config: classes: expected different names, got {got}"));
        }
        for (name, list) in
            [("anchor_sizes", &self.anchor_sizes), ("anchor_ratios", &self.anchor_ratios)]
        {
            if list.is_empty() || !finite(list) {
                return Err(format!("config: {name}: expected positive numbers, got {list:?}"));
            }
        }
        if !finite(&[self.mm_per_pixel]) || self.reduction == 0 || self.picture_size == 0 {
            return Err("config: mm_per_pixel, picture_size, reduction: expected above 0".into());
        }
        Ok(())
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
