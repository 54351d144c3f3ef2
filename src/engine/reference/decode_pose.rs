//! A pose from what the RoI head says of a region.

use crate::engine::reference::shared;

/// Logarithms of variances lie in these ranges: e⁻⁶ of a unit is below all noise; a direction knows
/// nothing at the deviation of all angles alike, π/√3, and a centre at 10 mm.
const LEAST: f64 = -12.0;
const MOST_YAW: f64 = 1.190_847_5; // ln(π²/3)
const MOST_CENTRE: f64 = 4.605_170_2; // ln 100

/// Of a row (c, s, v, vx, vy, w): the direction atan2(s, c) in degrees and its standard deviation
/// e^(v/2) in degrees, the centre's e^(vx/2) and e^(vy/2) in millimetres, and the probability
/// 1 / (1 + e⁻ʷ) that the part is whole. Logarithms are clamped first; a vector (c, s) of subnormal
/// numbers, which a device may take for zero, points along 0°.
pub fn decode_pose(row: [f32; 6]) -> [f64; 5] {
    let normal = |x: f32| if x.abs() < f32::MIN_POSITIVE { 0.0 } else { f64::from(x) };
    let deviation = |v: f32, most: f64| (f64::from(v).clamp(LEAST, most) / 2.0).exp();
    let [c, s, v, vx, vy, w] = row;
    [
        normal(s).atan2(normal(c)).to_degrees(),
        deviation(v, MOST_YAW).to_degrees(),
        deviation(vx, MOST_CENTRE),
        deviation(vy, MOST_CENTRE),
        shared::sigmoid(w.into()),
    ]
}
