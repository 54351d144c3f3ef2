// CBAM's spatial gate: sigmoid of a 7x7 convolution of the two pooled maps, padding 3, with bias.
//
// An invocation computes 8 neighbouring pixels of a row and slides a window of 8 values along it, so that each
// value and each weight is loaded once for 8 outputs. The values of a row are loaded at once: a GPU waits as
// long for one as for all.

// include: bound
// include: index
// include: sigmoid

struct Params {
    height: u32,
    width: u32,
    // Always 0: bounds that the compiler does not know keep it from unrolling loops.
    zero: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> pooled: array<f32>;
@group(0) @binding(2) var<storage, read> weight: array<f32>;
@group(0) @binding(3) var<storage, read> bias: array<f32>;
@group(0) @binding(4) var<storage, read_write> output: array<f32>;

// Column `x` of the row that starts at `row`, zero outside; `x` below zero wraps to a large number.
fn value(row: u32, x: u32) -> f32 {
    let inside = x < params.width;
    return select(0.0, pooled[row + select(0u, x, inside)], inside);
}

// Four columns from `x` on.
fn values(row: u32, x: u32) -> vec4<f32> {
    return vec4<f32>(value(row, x), value(row, x + 1u), value(row, x + 2u), value(row, x + 3u));
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let spans = (params.width + 7u) / 8u;
    let index = linear_index(workgroup, local, 64u);
    if index >= params.height * spans {
        return;
    }
    let y = index / spans;
    let x = (index - y * spans) * 8u;
    var left = vec4<f32>(bias[0]);
    var right = left;
    for (var plane = 0u; plane < bound(2u, params.zero); plane++) {
        for (var ky = 0u; ky < bound(7u, params.zero); ky++) {
            let iy = y + ky - 3u;
            if iy >= params.height {
                continue;
            }
            let row = (plane * params.height + iy) * params.width;
            let taps = (plane * 7u + ky) * 7u;
            var near = values(row, x - 3u);
            var far = values(row, x + 1u);
            var next = values(row, x + 5u);
            // Of the last four only two are in reach.
            let last = vec2<f32>(value(row, x + 9u), value(row, x + 10u));
            var behind = vec4<f32>(last, 0.0, 0.0);
            for (var kx = 0u; kx < bound(7u, params.zero); kx++) {
                let tap = vec4<f32>(weight[taps + kx]);
                left = fma(tap, near, left);
                right = fma(tap, far, right);
                near = vec4<f32>(near.yzw, far.x);
                far = vec4<f32>(far.yzw, next.x);
                next = vec4<f32>(next.yzw, behind.x);
                behind = vec4<f32>(behind.yzw, 0.0);
            }
        }
    }
    let to = y * params.width + x;
    for (var i = 0u; i < min(bound(8u, params.zero), params.width - x); i++) {
        output[to + i] = sigmoid(select(left[i & 3u], right[i & 3u], i >= 4u));
    }
}
