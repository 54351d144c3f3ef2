//! Non-maximum suppression.

use crate::engine::reference::iou_above;

/// Which boxes take part in [`nms`], and when one suppresses another.
#[derive(Clone, Copy, Debug)]
pub struct NmsRule {
    /// A box with more intersection over union than this with a better one is dropped.
    pub iou_threshold: f32,
    /// Only boxes with a score above this take part.
    pub min_score: f32,
    /// Only boxes at least this wide and high take part.
    pub min_size: f32,
}

/// Indices of the boxes that no better box of their class suppresses, best first, `most` of them at most:
/// `order` names all boxes in that order.
pub fn nms(
    boxes: &[[f32; 4]],
    scores: &[f32],
    classes: Option<&[u32]>,
    rule: NmsRule,
    order: &[u32],
    most: usize,
) -> Vec<u32> {
    let mut keep: Vec<u32> = Vec::new();
    for index in order {
        if keep.len() == most {
            break;
        }
        let i = *index as usize;
        let fits = scores[i] > rule.min_score
            && boxes[i][2] - boxes[i][0] >= rule.min_size
            && boxes[i][3] - boxes[i][1] >= rule.min_size;
        let suppressed = || {
            keep.iter().map(|k| *k as usize).any(|k| {
                classes.is_none_or(|c| c[k] == c[i])
                    && iou_above(boxes[k], boxes[i], rule.iou_threshold)
            })
        };
        if fits && !suppressed() {
            keep.push(*index);
        }
    }
    keep
}
