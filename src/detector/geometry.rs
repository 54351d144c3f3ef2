//! How large the network's input is for a view, and regions of it.

use crate::error::{Error, Result};
use crate::sensor::view::View;
use crate::smr::ModelConfig;

/// Pixels of the network's input from a part's edge at which a box is taken to be cut by it.
const CUT: f32 = 2.0;
/// How large the network's input is for a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Geometry {
    /// Width and height that the view's part is resized to.
    pub resized: [usize; 2],
    /// Height and width of the input, which repeats the part's right and lower edges.
    pub size: [usize; 2],
}

impl Geometry {
    /// The part at the network's own scale, or with `longer` pixels along its longer side.
    ///
    /// # Errors
    /// [`Error::Param`] for `longer` past [`ModelConfig::INPUT_SIZES`]; [`Error::Picture`] for a part that is
    /// past them at the network's own scale.
    pub fn new(view: &View, model: &ModelConfig, longer: Option<usize>) -> Result<Self> {
        let part = [view.part.width, view.part.height].map(f64::from);
        let scale = match longer {
            Some(pixels) => pixels as f64 / part[0].max(part[1]),
            None => f64::from(model.pixels_per_mm) * f64::from(view.scale.mm_per_pixel),
        };
        let resized = part.map(|side| ((side * scale).round() as usize).max(1));
        // A side past all numbers stays as it is, and is refused.
        let padded = |side: usize| side.checked_next_multiple_of(32).unwrap_or(side);
        let [width, height] = resized.map(padded);
        for side in [width, height] {
            if ModelConfig::is_input_size(side) {
                continue;
            }
            if longer.is_some() {
                let expected = ModelConfig::INPUT_SIZES;
                return Err(Error::param("detect", "input_size", expected, side));
            }
            let (scale, most) = (model.pixels_per_mm, ModelConfig::MAX_INPUT);
            let field = part[0].max(part[1]) * f64::from(view.scale.mm_per_pixel);
            let message = format!(
                "expected a field of at most {:.3} mm along its longer side, which is {most} pixels at the \
                 weights' {scale} a millimetre, got {field:.3} mm",
                most as f32 / scale
            );
            return Err(Error::Picture { file: "picture".into(), message });
        }
        Ok(Self { resized, size: [height, width] })
    }
}

/// A part of the network's input, in its pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Region {
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
}

impl Region {
    pub fn area(&self) -> usize {
        self.width * self.height
    }

    /// Whether a box, in pixels of the whole input, reaches an edge of this region that is none of the input of
    /// this height and width.
    pub fn cuts(&self, bbox: [f32; 4], [height, width]: [usize; 2]) -> bool {
        let [x, y] = [self.x, self.y].map(|at| at as f32);
        let [right, bottom] = [self.x + self.width, self.y + self.height];
        (self.x > 0 && bbox[0] <= x + CUT)
            || (self.y > 0 && bbox[1] <= y + CUT)
            || (right < width && bbox[2] >= right as f32 - CUT)
            || (bottom < height && bbox[3] >= bottom as f32 - CUT)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::detector::input::tests::view;
    use crate::sensor::rect::Rect;
    use crate::smr::Weights;

    /// 0.4 pixels of the input for one of the frame: 140.4 and 59.6, in whole thirty-twos.
    #[test]
    fn sizes_are_rounded_and_filled_up() {
        let part = Rect { x: 3, y: 5, width: 351, height: 149 };
        let view = View { part, ..view(0.05) };
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("weights/smrnet-s.safetensors");
        let weights = Weights::open(&file).expect("weights");
        let geometry = |longer| Geometry::new(&view, weights.config(), longer).expect("a size");
        assert_eq!(geometry(None), Geometry { resized: [140, 60], size: [64, 160] });
        // 149 · 320 / 351 = 135.8.
        assert_eq!(geometry(Some(320)), Geometry { resized: [320, 136], size: [160, 320] });
    }

    #[test]
    fn only_inner_edges_cut() {
        let window = Region { x: 0, y: 64, width: 96, height: 96 };
        let size = [160, 224];
        assert!(!window.cuts([0.0, 70.0, 50.0, 160.0], size));
        assert!(window.cuts([0.0, 65.0, 50.0, 160.0], size));
        assert!(window.cuts([40.0, 70.0, 95.0, 100.0], size));
        // The input's own right edge, and an inner left one.
        let window = Region { x: 128, y: 0, width: 96, height: 96 };
        assert!(!window.cuts([140.0, 0.0, 224.0, 50.0], size));
        assert!(window.cuts([129.0, 0.0, 150.0, 50.0], size));
        assert!(window.cuts([140.0, 0.0, 150.0, 95.0], size));
    }
}
