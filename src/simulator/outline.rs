//! Outlines and edges that the rigid parts are built from.
//!
//! Heights are in millimetres towards the gel. An outline is a signed distance, positive inside.

/// Rise of a side wall over its run: a draft of about 11 degrees, as moulded parts have.
pub const WALL_SLOPE: f64 = 5.0;

/// Height of a flat top at 0 with a rounded edge, at `inside` mm from its outline.
///
/// A quarter circle of this radius leads from the top to the outline; a steep wall goes on from
/// there, so that the outline's place between two cells still shows in the heights.
pub fn rounded_edge(inside: f64, radius: f64) -> f64 {
    if inside >= radius {
        0.0
    } else if inside > 0.0 {
        let x = radius - inside;
        (radius * radius - x * x).max(0.0).sqrt() - radius
    } else {
        WALL_SLOPE * inside - radius
    }
}

/// Lesser of two heights, their crossing rounded over about `radius`.
pub fn smooth_min(a: f64, b: f64, radius: f64) -> f64 {
    let h = (radius - (a - b).abs()).max(0.0) / radius;
    a.min(b) - 0.25 * h * h * radius
}

/// Distance inside a rectangle centred on the origin, with corners of this radius.
pub fn rectangle(x: f64, y: f64, half: [f64; 2], corner: f64) -> f64 {
    let dx = x.abs() - (half[0] - corner);
    let dy = y.abs() - (half[1] - corner);
    let outside = dx.max(0.0).hypot(dy.max(0.0));
    corner - outside - dx.max(dy).min(0.0)
}

/// Distance inside a stroke of this half width from `a` to `b`, with round ends.
pub fn stroke(x: f64, y: f64, a: [f64; 2], b: [f64; 2], half_width: f64) -> f64 {
    let [ux, uy] = [b[0] - a[0], b[1] - a[1]];
    let length2 = ux * ux + uy * uy;
    let t = if length2 > 0.0 {
        (((x - a[0]) * ux + (y - a[1]) * uy) / length2).clamp(0.0, 1.0)
    } else {
        0.0
    };
    half_width - (x - a[0] - t * ux).hypot(y - a[1] - t * uy)
}
