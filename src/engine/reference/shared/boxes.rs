//! What the box operations share; a box is `(x1, y1, x2, y2)`.

/// ln(1000 / 16): torchvision lets no box grow by more (`BoxCoder.bbox_xform_clip`).
pub const MAX_LOG_SCALE: f32 = 4.135_166_6;

/// The box that `deltas` (dx, dy, dw, dh) make of `anchor`, clipped to `[0, extent]`; torchvision's
/// `BoxCoder.decode_single` and `clip_boxes_to_image`. On an axis where anything is not finite both sides
/// are NaN, also where torchvision's clamps make numbers of an infinity: who looks at boxes alone must
/// see that they mean nothing.
pub fn decode_box(anchor: [f32; 4], deltas: [f64; 4], extent: [f32; 2]) -> [f32; 4] {
    let mut decoded = [0.0; 4];
    for axis in 0..2 {
        let [low, high] = [anchor[axis], anchor[axis + 2]].map(f64::from);
        if [low, high, deltas[axis], deltas[axis + 2]].iter().any(|x| !x.is_finite()) {
            [decoded[axis], decoded[axis + 2]] = [f32::NAN; 2];
            continue;
        }
        let size = high - low;
        let centre = low + 0.5 * size + deltas[axis] * size;
        let half = 0.5 * deltas[axis + 2].min(f64::from(MAX_LOG_SCALE)).exp() * size;
        let limit = f64::from(extent[axis]);
        decoded[axis] = (centre - half).clamp(0.0, limit) as f32;
        decoded[axis + 2] = (centre + half).clamp(0.0, limit) as f32;
    }
    decoded
}

/// Whether the intersection over union of `a` and `b` is above `threshold`.
///
/// In f32 by definition, each step rounded, so that every device decides alike: common >
/// threshold · ((area a + area b) − common).
pub fn iou_above(a: [f32; 4], b: [f32; 4], threshold: f32) -> bool {
    let area = |b: [f32; 4]| (b[2] - b[0]) * (b[3] - b[1]);
    let side = |axis: usize| (a[axis + 2].min(b[axis + 2]) - a[axis].max(b[axis])).max(0.0);
    let common = side(0) * side(1);
    common > threshold * ((area(a) + area(b)) - common)
}
