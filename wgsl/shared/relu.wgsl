// ReLU that keeps a NaN, as PyTorch's does: `max(NaN, 0)` would be 0 and hide an overflow from the
// host, which looks for it in the outputs.
fn relu(x: vec4<f32>) -> vec4<f32> {
    return select(x, vec4<f32>(0.0), x < vec4<f32>(0.0));
}
