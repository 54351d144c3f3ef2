//! What may be left out of a picture.

use crate::detector::Detections;
use crate::error::{Error, Result};

/// Height and width of an input that has all proposals: the paper's.
const SHARED: [usize; 2] = [320; 2];
/// Proposals that the RoI head's kernels take together.
const TOGETHER: usize = 16;

/// What is left out where a picture does not need it, each saving for itself. A picture gets the same
/// answer however busy the machine is: only what it shows decides.
///
/// ```
/// use smr_gpu::{Config, Scene};
///
/// let everything = Config::new("weights/smrnet.safetensors").scene(Scene::FULL);
/// let savings = Config::new("weights/smrnet.safetensors").scene(Scene::SAVING);
/// assert!(savings.scene.regions && !everything.scene.regions);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scene {
    /// Where nothing touches the gel the network does not run: no snap.
    pub contact: bool,
    /// The network looks only where something touches the gel, and `margin_mm` round it, in parts that
    /// make up at most `most_of_input` of its input; else at the whole.
    pub regions: bool,
    /// Proposals whose objectness is at most `objectness` of the score that is asked for do not reach the
    /// network's last part, nor of an input of less than 320 × 320 pixels more than its share of the 100 that
    /// such a one has, in whole sixteens.
    pub proposals: bool,
    /// Gel round a contact that the network sees, in millimetres; from 0 to 60. What counts as contact reaches
    /// up to 2 mm past what touches.
    pub margin_mm: f32,
    /// Share of the network's input above which all of it is computed; from 0 to 1.
    pub most_of_input: f32,
    /// Share of [`Config::score`](crate::Config::score) that a proposal's probability to be a snap must be
    /// above; from 0 to 1.
    pub objectness: f32,
}

impl Scene {
    /// Nothing is left out.
    pub const FULL: Self = Self {
        contact: false,
        regions: false,
        proposals: false,
        margin_mm: 1.0,
        most_of_input: 0.8,
        objectness: 0.01,
    };
    /// All that can be left out is.
    pub const SAVING: Self = Self { contact: true, regions: true, proposals: true, ..Self::FULL };

    /// What was left out of a picture in which a detector with this scene found `found`, and why, a line each;
    /// nothing where all was looked at.
    pub fn left_out(&self, found: &Detections) -> Vec<String> {
        if found.reused {
            return vec![
                "the frame: it equals an earlier one within the sensor's noise".to_owned(),
            ];
        }
        if self.contact && found.contact == Some(false) {
            return vec!["the network: nothing touches the gel".to_owned()];
        }
        let mut left = Vec::new();
        if let Some(regions) = &found.regions {
            let area = |width, height| f64::from(width) * f64::from(height);
            let seen: f64 = regions.iter().map(|r| area(r.width, r.height)).sum();
            // Parts may overlap.
            let share = (1.0 - seen / area(found.width, found.height)).max(0.0);
            let margin = self.margin_mm;
            left.push(format!("{share:.2} of the frame: no contact within {margin} mm of it"));
        }
        if self.proposals {
            let share = self.objectness;
            left.push(format!(
                "proposals: objectness of at most {share} of the asked-for score, or beyond a part's share"
            ));
        }
        left
    }

    /// Whether somebody must look for contact.
    pub fn looks(&self) -> bool {
        self.contact || self.regions
    }

    /// What the objectness of a proposal must be above where detections must be above `score`.
    pub(super) fn least_objectness(&self, score: f32) -> f32 {
        if self.proposals { self.objectness * score } else { f32::NEG_INFINITY }
    }

    /// How many of `most` proposals reach the last part, of an input of this height and width.
    pub(super) fn most_proposals(&self, most: usize, [height, width]: [usize; 2]) -> usize {
        if !self.proposals {
            return most;
        }
        let share = (most * height * width).div_ceil(SHARED[0] * SHARED[1]);
        share.next_multiple_of(TOGETHER).min(most)
    }

    /// # Errors
    /// [`Error::Param`] for a number out of its range.
    pub(super) fn check(&self) -> Result<()> {
        let ranges = [
            ("margin_mm", self.margin_mm, 60.0),
            ("most_of_input", self.most_of_input, 1.0),
            ("objectness", self.objectness, 1.0),
        ];
        for (name, value, most) in ranges {
            // A NaN is in no range.
            if !(0.0..=most).contains(&value) {
                let expected = format!("a number from 0 to {most}");
                return Err(Error::param("detect", name, expected, value));
            }
        }
        Ok(())
    }
}

impl Default for Scene {
    /// What lost none of 2003 labelled snaps: `contact`. The others may cost one, and are for those who ask.
    fn default() -> Self {
        Self { contact: true, ..Self::FULL }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_has_its_share_of_the_proposals_in_whole_sixteens() {
        let (all, saving) = (Scene::FULL, Scene::SAVING);
        // 100 · 96² / 320² is 9, 100 · 160² / 320² is 25, 100 · 160 · 256 / 320² is 40.
        let sizes = [[96, 96], [160, 160], [256, 160], [320, 320], [640, 320]];
        assert_eq!(sizes.map(|size| saving.most_proposals(100, size)), [16, 32, 48, 100, 100]);
        assert_eq!(sizes.map(|size| all.most_proposals(100, size)), [100; 5]);
    }
}
