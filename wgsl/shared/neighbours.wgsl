// The two neighbours of a coordinate on one axis, and the weight of the upper one, as RoIAlign samples.
struct Neighbours {
    low: u32,
    high: u32,
    weight: f32,
    inside: bool,
}

// Outside [-1, length] there is nothing; between there and the first and last centre, the edge.
fn neighbours(at: f32, length: u32) -> Neighbours {
    let inside = at >= -1.0 && at <= f32(length);
    let clamped = clamp(at, 0.0, f32(length - 1u));
    let low = min(u32(clamped), length - 1u);
    return Neighbours(low, min(low + 1u, length - 1u), clamped - f32(low), inside);
}
