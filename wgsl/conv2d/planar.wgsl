// 2-D convolution with bias, optional residual and ReLU, on [C, H, W].
//
// One invocation computes 8 output channels at 8 pixels and keeps the 64 sums of a tap in registers:
// 16 loads for 64 multiply-adds. The 64 invocations of a workgroup are 8 groups of pixels by 8 groups
// of channels. The taps are the outer loops, so whether a pixel lies in the padding is decided once
// a tap, not once a channel.

// include: relu

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> input: array<f32>;
// [kernel_height][kernel_width][in_channels][out_channels / 4], padded to 64 output channels.
@group(0) @binding(2) var<storage, read> weight: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> bias: array<f32>;
@group(0) @binding(4) var<storage, read> residual: array<f32>;
@group(0) @binding(5) var<storage, read_write> output: array<f32>;

// Where a tap of four output pixels reads channel 0, and whether it lies inside; outside reads 0.
struct Tap {
    address: vec4<u32>,
    inside: vec4<bool>,
}

fn tap(pixel: vec4<u32>, ky: u32, kx: u32) -> Tap {
    let oy = pixel / params.out_width;
    let ox = pixel - oy * params.out_width;
    // Wraps below zero to a large number, so that one comparison finds both sides.
    let iy = oy * params.stride + ky * params.dilation - params.padding;
    let ix = ox * params.stride + kx * params.dilation - params.padding;
    let inside = (iy < vec4<u32>(params.in_height)) & (ix < vec4<u32>(params.in_width))
        & (pixel < vec4<u32>(params.out_height * params.out_width));
    return Tap(select(vec4<u32>(0u), iy * params.in_width + ix, inside), inside);
}

fn load(t: Tap, offset: u32) -> vec4<f32> {
    let at = t.address + offset;
    let x = vec4<f32>(input[at.x], input[at.y], input[at.z], input[at.w]);
    return select(vec4<f32>(0.0), x, t.inside);
}

fn store(pixel: vec4<u32>, channel: u32, sums: vec4<f32>) {
    if channel >= params.out_channels {
        return;
    }
    let area = params.out_height * params.out_width;
    var total = sums + bias[channel];
    for (var i = 0u; i < 4u; i++) {
        if pixel[i] < area {
            let at = channel * area + pixel[i];
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
    let pixel = workgroup.x * 64u + local % 8u;
    let near = pixel + vec4<u32>(0u, 8u, 16u, 24u);
    let far = near + 32u;
    let channel = workgroup.y * 64u + local / 8u * 8u;
    let in_area = params.in_height * params.in_width;
    let weight_stride = ((params.out_channels + 63u) / 64u) * 16u;

    var near_sums = array<vec4<f32>, 8>();
    var far_sums = array<vec4<f32>, 8>();
    var weight_at = channel / 4u;
    for (var ky = 0u; ky < params.kernel_height; ky++) {
        for (var kx = 0u; kx < params.kernel_width; kx++) {
            let tap_near = tap(near, ky, kx);
            let tap_far = tap(far, ky, kx);
            // Each tap sums for itself: shorter sums lose fewer digits.
            var n0 = vec4<f32>(0.0);
            var f0 = vec4<f32>(0.0);
            var n1 = vec4<f32>(0.0);
            var f1 = vec4<f32>(0.0);
            var n2 = vec4<f32>(0.0);
            var f2 = vec4<f32>(0.0);
            var n3 = vec4<f32>(0.0);
            var f3 = vec4<f32>(0.0);
            var n4 = vec4<f32>(0.0);
            var f4 = vec4<f32>(0.0);
            var n5 = vec4<f32>(0.0);
            var f5 = vec4<f32>(0.0);
            var n6 = vec4<f32>(0.0);
            var f6 = vec4<f32>(0.0);
            var n7 = vec4<f32>(0.0);
            var f7 = vec4<f32>(0.0);
            var offset = 0u;
            for (var c = 0u; c < params.in_channels; c++) {
                let n = load(tap_near, offset);
                let f = load(tap_far, offset);
                let u = weight[weight_at];
                let v = weight[weight_at + 1u];
                n0 = fma(n, vec4<f32>(u.x), n0);
                f0 = fma(f, vec4<f32>(u.x), f0);
                n1 = fma(n, vec4<f32>(u.y), n1);
                f1 = fma(f, vec4<f32>(u.y), f1);
                n2 = fma(n, vec4<f32>(u.z), n2);
                f2 = fma(f, vec4<f32>(u.z), f2);
                n3 = fma(n, vec4<f32>(u.w), n3);
                f3 = fma(f, vec4<f32>(u.w), f3);
                n4 = fma(n, vec4<f32>(v.x), n4);
                f4 = fma(f, vec4<f32>(v.x), f4);
                n5 = fma(n, vec4<f32>(v.y), n5);
                f5 = fma(f, vec4<f32>(v.y), f5);
                n6 = fma(n, vec4<f32>(v.z), n6);
                f6 = fma(f, vec4<f32>(v.z), f6);
                n7 = fma(n, vec4<f32>(v.w), n7);
                f7 = fma(f, vec4<f32>(v.w), f7);
                offset += in_area;
                weight_at += weight_stride;
            }
            near_sums[0] += n0;
            far_sums[0] += f0;
            near_sums[1] += n1;
            far_sums[1] += f1;
            near_sums[2] += n2;
            far_sums[2] += f2;
            near_sums[3] += n3;
            far_sums[3] += f3;
            near_sums[4] += n4;
            far_sums[4] += f4;
            near_sums[5] += n5;
            far_sums[5] += f5;
            near_sums[6] += n6;
            far_sums[6] += f6;
            near_sums[7] += n7;
            far_sums[7] += f7;
        }
    }
    for (var c = 0u; c < 8u; c++) {
        store(near, channel + c, near_sums[c]);
        store(far, channel + c, far_sums[c]);
    }
}
