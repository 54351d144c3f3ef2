// The pixels start..end of an axis of `length` pixels that window `i` of a pooling sees, by `params`.
fn window(i: u32, length: u32) -> vec2<u32> {
    let start = i * params.stride;
    return vec2(
        max(start, params.padding) - params.padding,
        min(start + params.kernel - params.padding, length),
    );
}
