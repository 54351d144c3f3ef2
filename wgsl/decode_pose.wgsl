// The pose of each detection, from its row of the RoI head; an invocation each.

@group(0) @binding(0) var<uniform> params: Params;
// (c, s, v, vx, vy, w) each
@group(0) @binding(1) var<storage, read> rows: array<f32>;
@group(0) @binding(2) var<storage, read> count: array<u32>;
@group(0) @binding(3) var<storage, read_write> output: array<f32>;

// include: index
// include: sigmoid

const DEGREES: f32 = 57.29577951308232;
const PI: f32 = 3.141592653589793;
const TAN_EIGHTH_TURN: f32 = 0.4142135623730951;
const LEAST_NORMAL: f32 = 1.1754944e-38;

// Zero for what a device may take for zero anyway.
fn normal(x: f32) -> f32 {
    return select(x, 0.0, abs(x) < LEAST_NORMAL);
}

// WGSL's own atan2 may be off by 4096 ULP; this polynomial (of Cephes' atanf) by 2e-7 up to an eighth
// of a turn's tangent, to which all is brought.
fn arc_tangent(y: f32, x: f32) -> f32 {
    let most = max(abs(x), abs(y));
    if most == 0.0 {
        return 0.0;
    }
    // WGSL promises a quotient's 2.5 ULP for divisors up to 2^126 alone; beyond, a GPU may give zero.
    let shrink = select(1.0, 0.0625, most > 1e37);
    let t = (shrink * min(abs(x), abs(y))) / (shrink * most);
    let far = t > TAN_EIGHTH_TURN;
    let u = select(t, (t - 1.0) / (t + 1.0), far);
    let q = u * u;
    var series = 0.0805374449538 * q - 0.138776856032;
    series = series * q + 0.199777106478;
    series = series * q - 0.333329491539;
    var angle = select(0.0, 0.25 * PI, far) + (u + u * q * series);
    angle = select(angle, 0.5 * PI - angle, abs(y) > abs(x));
    angle = select(angle, PI - angle, x < 0.0);
    return select(angle, -angle, y < 0.0);
}

// The standard deviation of a clamped logarithm of a variance.
fn deviation(v: f32, most: f32) -> f32 {
    return exp(0.5 * clamp(v, -12.0, most));
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_index(workgroup, local, 64u);
    if at >= min(count[0], params.capacity) {
        return;
    }
    let row = 6u * at;
    let angle = arc_tangent(normal(rows[row + 1u]), normal(rows[row]));
    output[5u * at] = angle * DEGREES;
    // ln(pi^2 / 3) and ln 100.
    output[5u * at + 1u] = deviation(rows[row + 2u], 1.1908475) * DEGREES;
    output[5u * at + 2u] = deviation(rows[row + 3u], 4.6051702);
    output[5u * at + 3u] = deviation(rows[row + 4u], 4.6051702);
    output[5u * at + 4u] = sigmoid(rows[row + 5u]);
}
