// The sum of up to five maps, each times its weight, on maps with four channels a texel. All lie
// alike, so that nobody need know where a pixel is.

// include: texels

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<storage, read_write> output: array<OutputTexel>;
@group(0) @binding(3) var<storage, read> map0: array<Texel>;
#if MAP1
@group(0) @binding(4) var<storage, read> map1: array<Texel>;
#endif
#if MAP2
@group(0) @binding(5) var<storage, read> map2: array<Texel>;
#endif
#if MAP3
@group(0) @binding(6) var<storage, read> map3: array<Texel>;
#endif
#if MAP4
@group(0) @binding(7) var<storage, read> map4: array<Texel>;
#endif

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let first = workgroup.z * params.texels;
    let weight = workgroup.z * params.weight_stride;
    for (var i = workgroup.x * 64u + lane; i < params.texels; i += params.invocations) {
        let at = first + i;
        var sum = weights[weight] * loaded(map0[at]);
#if MAP1
        sum += weights[weight + 1u] * loaded(map1[at]);
#endif
#if MAP2
        sum += weights[weight + 2u] * loaded(map2[at]);
#endif
#if MAP3
        sum += weights[weight + 3u] * loaded(map3[at]);
#endif
#if MAP4
        sum += weights[weight + 4u] * loaded(map4[at]);
#endif
        output[at] = stored(sum);
    }
}
