//! What may be left out of a picture.

use crate::error::{Error, Result};
use crate::smr::Wanted;

/// Height and width of the paper's input.
const PAPER: [usize; 2] = [320; 2];
/// Proposals that the RoI head's kernels take together.
const TOGETHER: usize = 16;
/// All proposals that there are.
const MOST_PROPOSALS: usize = Wanted::ALL.most_proposals;

/// What is left out where a picture does not need it, each saving for itself. Where that leaves a box in doubt,
/// a second run leaves nothing out. A picture gets the same answer however busy the machine is: only what it
/// shows decides.
///
/// ```
/// use smr_gpu::{Config, Savings};
///
/// let everything = Config { savings: Savings::NONE, ..Config::new("weights/smrnet.safetensors") };
/// let savings = Config { savings: Savings::ALL, ..Config::new("weights/smrnet.safetensors") };
/// assert!(savings.savings.regions && !everything.savings.regions);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Savings {
    /// Where nothing touches the gel the network does not run: no snap.
    pub contact: bool,
    /// The network runs only where something touches the gel, and `margin_mm` round it, in parts that
    /// make up at most `most_of_input` of its input, and of each only at the best `most_proposals`; else at
    /// the whole.
    pub regions: bool,
    /// Of the whole picture, too, only the best `most_proposals` reach the network's last part.
    pub proposals: bool,
    /// The deepest of the three scales, conv5_x, is neither computed nor added. Weights without RW-Net cannot do
    /// without it.
    pub scales: bool,
    /// Gel round a contact that the network sees, in millimetres; from 0 to 60. What counts as contact reaches
    /// up to 2 mm past what touches.
    pub margin_mm: f32,
    /// Share of the network's input above which all of it is computed; from 0 to 1. Larger parts save little, and
    /// where they leave doubt the whole comes on top.
    pub most_of_input: f32,
    /// How far on the way from the asked-for [`Config::score`](crate::Config::score), or
    /// [`Config::counts_above`](crate::Config::counts_above), to 0 a box is doubtful that parts show, two scales
    /// or the best proposals: with nothing left out it may pass, and so the network runs again, on all of the
    /// picture. With 0 no box is; from 0 to 1.
    pub doubt: f32,
    /// Proposals of 320 × 320 pixels of the network's input that reach its last part, those of the highest
    /// objectness; of more or less the area's share, in whole sixteens. From 1 to 100.
    pub most_proposals: usize,
}

/// What a detection may leave out, each a switch of [`Savings`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Saving {
    /// [`Savings::contact`].
    Contact,
    /// [`Savings::regions`].
    Regions,
    /// [`proposals`](field@Savings::proposals).
    Proposals,
    /// [`Savings::scales`].
    Scales,
}

impl Saving {
    /// All there are.
    pub const ALL: [Self; 4] = [Self::Contact, Self::Regions, Self::Proposals, Self::Scales];

    /// As `--leave-out` takes it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Contact => "contact",
            Self::Regions => "regions",
            Self::Proposals => "proposals",
            Self::Scales => "scales",
        }
    }
}

impl Savings {
    /// These alone are left out.
    pub fn of(savings: &[Saving]) -> Self {
        let has = |saving| savings.contains(&saving);
        Self {
            contact: has(Saving::Contact),
            regions: has(Saving::Regions),
            proposals: has(Saving::Proposals),
            scales: has(Saving::Scales),
            ..Self::NONE
        }
    }

    /// Nothing is left out.
    pub const NONE: Self = Self {
        contact: false,
        regions: false,
        proposals: false,
        scales: false,
        margin_mm: 1.0,
        most_of_input: 0.55,
        doubt: 0.6,
        most_proposals: 32,
    };
    /// All that can be left out is.
    pub const ALL: Self =
        Self { contact: true, regions: true, proposals: true, scales: true, ..Self::NONE };

    /// Whether they need to know where something touches.
    pub fn need_contact(&self) -> bool {
        self.contact || self.regions
    }

    /// What a box's score must be above where detections must be above `score`: where less than all is
    /// computed, all that may leave doubt.
    pub(super) fn least_score(&self, score: f32) -> f32 {
        let less = self.regions || self.proposals || self.scales;
        if less { score * (1.0 - self.doubt) } else { score }
    }

    /// Whether a box of this score leaves doubt, where less than all was computed and detections must be above
    /// `asked`.
    pub(super) fn is_doubtful(&self, score: f32, asked: f32) -> bool {
        score > self.least_score(asked) && score <= asked
    }

    /// How many proposals reach the last part, of a whole input or a part with this height and width.
    pub(super) fn proposals(&self, [height, width]: [usize; 2], is_part: bool) -> usize {
        if !self.proposals && !is_part {
            return MOST_PROPOSALS;
        }
        let share = (self.most_proposals * height * width).div_ceil(PAPER[0] * PAPER[1]);
        share.next_multiple_of(TOGETHER).min(MOST_PROPOSALS)
    }

    /// # Errors
    /// [`Error::Param`] for a number out of its range.
    pub(super) fn check(&self) -> Result<()> {
        let ranges = [
            ("margin_mm", self.margin_mm, 60.0),
            ("most_of_input", self.most_of_input, 1.0),
            ("doubt", self.doubt, 1.0),
        ];
        for (name, value, most) in ranges {
            // A NaN is in no range.
            if !(0.0..=most).contains(&value) {
                let expected = format!("a number from 0 to {most}");
                return Err(Error::param("detect", name, expected, value));
            }
        }
        if !(1..=MOST_PROPOSALS).contains(&self.most_proposals) {
            let expected = format!("1 to {MOST_PROPOSALS}");
            return Err(Error::param("detect", "most_proposals", expected, self.most_proposals));
        }
        Ok(())
    }
}

impl Default for Savings {
    /// What lost none of 2003 labelled snaps with earlier weights, and none of 133 with these: `contact` and
    /// `regions`. `scales` beside them lost one, `proposals` five, with earlier weights, and are for those who ask.
    fn default() -> Self {
        Self { contact: true, regions: true, ..Self::NONE }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_little_below_the_asked_score_are_doubtful() {
        let savings = Savings::ALL;
        // From 0.2, from 0.04.
        for (asked, sure, doubtful) in [
            (0.5, [0.19, 0.51, 0.9], [0.21, 0.35, 0.5]),
            (0.1, [0.03, 0.11, 1.0], [0.05, 0.08, 0.1]),
        ] {
            assert!(sure.iter().all(|score| !savings.is_doubtful(*score, asked)), "{asked}");
            assert!(doubtful.iter().all(|score| savings.is_doubtful(*score, asked)), "{asked}");
        }
        let certain = Savings { doubt: 0.0, ..savings };
        assert!([0.0, 0.5, 1.0].iter().all(|score| !certain.is_doubtful(*score, 0.5)));
        // Where nothing is left out the asked-for score decides, and whatever is left out makes doubt.
        let half = Savings { doubt: 0.5, ..Savings::NONE };
        assert_eq!(half.least_score(0.5), 0.5);
        for less in [
            Savings { regions: true, ..half },
            Savings { proposals: true, ..half },
            Savings { scales: true, ..half },
        ] {
            assert_eq!(less.least_score(0.5), 0.25, "{less:?}");
        }
    }

    #[test]
    fn an_input_has_its_share_of_the_proposals_in_whole_sixteens() {
        let (all, saving) = (Savings::NONE, Savings::ALL);
        // 32 · 96² / 320² is 3, 32 · 256² / 320² is 20, 32 · 640 · 480 / 320² is 96.
        let sizes = [[96, 96], [160, 160], [256, 256], [320, 320], [480, 640], [640, 640]];
        assert_eq!(sizes.map(|size| saving.proposals(size, false)), [16, 16, 32, 32, 96, 100]);
        assert_eq!(sizes.map(|size| all.proposals(size, false)), [100; 6]);
        assert_eq!(sizes.map(|size| all.proposals(size, true)), [16, 16, 32, 32, 96, 100]);
    }
}
