// The sum of up to five maps, each times its weight.

// include: index

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weights: array<f32>;
// Those from `maps` on are not read.
@group(0) @binding(2) var<storage, read> map0: array<f32>;
@group(0) @binding(3) var<storage, read> map1: array<f32>;
@group(0) @binding(4) var<storage, read> map2: array<f32>;
@group(0) @binding(5) var<storage, read> map3: array<f32>;
@group(0) @binding(6) var<storage, read> map4: array<f32>;
@group(0) @binding(7) var<storage, read_write> output: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = linear_index(workgroup, local, 64u);
    if index >= params.elements {
        return;
    }
    var sum = weights[0] * map0[index];
    if params.maps > 1u {
        sum = fma(weights[1], map1[index], sum);
    }
    if params.maps > 2u {
        sum = fma(weights[2], map2[index], sum);
    }
    if params.maps > 3u {
        sum = fma(weights[3], map3[index], sum);
    }
    if params.maps > 4u {
        sum = fma(weights[4], map4[index], sum);
    }
    output[index] = sum;
}
