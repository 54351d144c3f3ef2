// 2-D convolution with bias, optional residual and ReLU, on [C, H, W].
//
// One invocation computes 16 output channels at 2 pixels and keeps its sums in registers; the
// 64 invocations of a workgroup share the weights they read, at 128 neighbouring pixels. The taps
// are the outer loops, so whether a pixel lies in the padding is decided once a tap, not once a
// channel.

// include: relu

struct Params {
    in_channels: u32,
    in_height: u32,
    in_width: u32,
    out_channels: u32,
    out_height: u32,
    out_width: u32,
    kernel_height: u32,
    kernel_width: u32,
    stride: u32,
    padding: u32,
    dilation: u32,
    has_residual: u32,
    relu: u32,
}

const PIXELS: u32 = 64u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<f32>;
// [kernel_height][kernel_width][in_channels][out_channels / 4], padded to 16 output channels.
@group(0) @binding(2) var<storage, read> weight: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> bias: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> residual: array<f32>;
@group(0) @binding(5) var<storage, read_write> output: array<f32>;

// Where the tap (ky, kx) of output pixel `pixel` reads channel 0, or the last word if in padding.
struct Tap {
    address: u32,
    inside: bool,
}

fn tap(pixel: u32, ky: u32, kx: u32) -> Tap {
    let oy = pixel / params.out_width;
    let ox = pixel - oy * params.out_width;
    // Wraps below zero to a large number, so that one comparison finds both sides.
    let iy = oy * params.stride + ky * params.dilation - params.padding;
    let ix = ox * params.stride + kx * params.dilation - params.padding;
    let inside = iy < params.in_height && ix < params.in_width
        && pixel < params.out_height * params.out_width;
    return Tap(select(0u, iy * params.in_width + ix, inside), inside);
}

fn store(pixel: u32, channel: u32, sums: vec4<f32>) {
    let area = params.out_height * params.out_width;
    if pixel >= area {
        return;
    }
    let total = sums + bias[channel / 4u];
    for (var i = 0u; i < 4u; i++) {
        if channel + i < params.out_channels {
            let at = (channel + i) * area + pixel;
            var value = total[i];
            if params.has_residual != 0u {
                value += residual[at];
            }
            if params.relu != 0u {
                value = relu(vec4<f32>(value)).x;
            }
            output[at] = value;
        }
    }
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let first = workgroup.x * 2u * PIXELS + local;
    let second = first + PIXELS;
    let channel = workgroup.y * 16u;
    let in_area = params.in_height * params.in_width;
    let weight_stride = ((params.out_channels + 15u) / 16u) * 4u;

    var total_a = array<vec4<f32>, 4>();
    var total_b = array<vec4<f32>, 4>();
    var weight_at = channel / 4u;
    for (var ky = 0u; ky < params.kernel_height; ky++) {
        for (var kx = 0u; kx < params.kernel_width; kx++) {
            let tap_a = tap(first, ky, kx);
            let tap_b = tap(second, ky, kx);
            var at_a = tap_a.address;
            var at_b = tap_b.address;
            // Each tap sums for itself: shorter sums lose fewer digits.
            var a0 = vec4<f32>(0.0);
            var a1 = vec4<f32>(0.0);
            var a2 = vec4<f32>(0.0);
            var a3 = vec4<f32>(0.0);
            var b0 = vec4<f32>(0.0);
            var b1 = vec4<f32>(0.0);
            var b2 = vec4<f32>(0.0);
            var b3 = vec4<f32>(0.0);
            for (var c = 0u; c < params.in_channels; c++) {
                let a = select(0.0, input[at_a], tap_a.inside);
                let b = select(0.0, input[at_b], tap_b.inside);
                let w0 = weight[weight_at];
                let w1 = weight[weight_at + 1u];
                let w2 = weight[weight_at + 2u];
                let w3 = weight[weight_at + 3u];
                a0 = fma(vec4<f32>(a), w0, a0);
                a1 = fma(vec4<f32>(a), w1, a1);
                a2 = fma(vec4<f32>(a), w2, a2);
                a3 = fma(vec4<f32>(a), w3, a3);
                b0 = fma(vec4<f32>(b), w0, b0);
                b1 = fma(vec4<f32>(b), w1, b1);
                b2 = fma(vec4<f32>(b), w2, b2);
                b3 = fma(vec4<f32>(b), w3, b3);
                at_a += in_area;
                at_b += in_area;
                weight_at += weight_stride;
            }
            total_a[0] += a0;
            total_a[1] += a1;
            total_a[2] += a2;
            total_a[3] += a3;
            total_b[0] += b0;
            total_b[1] += b1;
            total_b[2] += b2;
            total_b[3] += b3;
        }
    }
    for (var i = 0u; i < 4u; i++) {
        store(first, channel + 4u * i, total_a[i]);
        store(second, channel + 4u * i, total_b[i]);
    }
}
