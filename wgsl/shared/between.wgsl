// The two pixels that one output of an upsampling lies between, along one axis, and its distance from the
// first: centres at half pixels, and integers until the last division.
struct Between {
    low: u32,
    high: u32,
    part: f32,
}

fn between(i: u32, in_length: u32, out_length: u32) -> Between {
    let position = max((2u * i + 1u) * in_length, out_length) - out_length;
    let low = position / (2u * out_length);
    let part = f32(position - low * 2u * out_length) / f32(2u * out_length);
    return Between(low, min(low + 1u, in_length - 1u), part);
}
