// Boxes are (x1, y1, x2, y2) in pixels of the network's input.

// ln(1000 / 16): torchvision lets no box grow by more.
const MAX_LOG_SCALE: f32 = 4.135166556742356;

// `x` rounded to f32: passed through an integer, so that no compiler fuses the operation that made
// it with the next. `zero` is 0, but only at run time.
fn rounded(x: f32, zero: u32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) | zero);
}

fn box_area(b: vec4<f32>, zero: u32) -> f32 {
    return rounded(rounded(b.z - b.x, zero) * rounded(b.w - b.y, zero), zero);
}

// Whether the intersection over union is above `threshold`; equality is not, as in torchvision.
// Without a division, which WGSL lets be 2.5 ULP off, and with each step rounded to f32, so that
// every device and the reference decide alike.
fn iou_above(a: vec4<f32>, b: vec4<f32>, threshold: f32, zero: u32) -> bool {
    let size = max(min(a.zw, b.zw) - max(a.xy, b.xy), vec2<f32>(0.0));
    let overlap = rounded(rounded(size.x, zero) * rounded(size.y, zero), zero);
    let both = rounded(box_area(a, zero) + box_area(b, zero), zero);
    return overlap > rounded(threshold * rounded(both - overlap, zero), zero);
}

// The intersection over union; 0 for boxes of no area.
fn iou(a: vec4<f32>, b: vec4<f32>) -> f32 {
    let size = max(min(a.zw, b.zw) - max(a.xy, b.xy), vec2<f32>(0.0));
    let shared_area = size.x * size.y;
    let both = (a.z - a.x) * (a.w - a.y) + (b.z - b.x) * (b.w - b.y) - shared_area;
    return select(0.0, shared_area / both, shared_area > 0.0 && both > 0.0);
}

const QUIET_NAN: u32 = 0x7fc00000u;

// By their bits, as WGSL may take all numbers for finite.
fn not_finite(x: vec2<f32>) -> vec2<bool> {
    return (bitcast<vec2<u32>>(x) & vec2<u32>(0x7f800000u)) == vec2<u32>(0x7f800000u);
}

// The box that `deltas` (dx, dy, dw, dh) make of `anchor`, clipped to [0, extent]. On an axis where
// anything is not finite both sides are NaN: a clip or a least would make numbers of them.
fn decode_box(anchor: vec4<f32>, deltas: vec4<f32>, extent: vec2<f32>) -> vec4<f32> {
    let size = anchor.zw - anchor.xy;
    let centre = anchor.xy + 0.5 * size + deltas.xy * size;
    let half = 0.5 * exp(min(deltas.zw, vec2<f32>(MAX_LOG_SCALE))) * size;
    let low = clamp(centre - half, vec2<f32>(0.0), extent);
    let high = clamp(centre + half, vec2<f32>(0.0), extent);
    let lost = not_finite(anchor.xy) | not_finite(anchor.zw) | not_finite(deltas.xy)
        | not_finite(deltas.zw);
    let low_bits = select(bitcast<vec2<u32>>(low), vec2<u32>(QUIET_NAN), lost);
    let high_bits = select(bitcast<vec2<u32>>(high), vec2<u32>(QUIET_NAN), lost);
    return bitcast<vec4<f32>>(vec4<u32>(low_bits, high_bits));
}
