// A map [C, H, W] to four channels a texel, and back. A workgroup is 64 pixels of a row of a quad.

// include: bound
// include: quads
// include: texels

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> planar: array<f32>;
@group(0) @binding(2) var<storage, read_write> quads: array<OutputTexel>;
@group(0) @binding(3) var<storage, read> quads_in: array<Texel>;
@group(0) @binding(4) var<storage, read_write> planar_out: array<f32>;

@compute @workgroup_size(64)
fn to_quads(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let map = params.map;
    let x = workgroup.x * 64u + local;
    if x >= map.width {
        return;
    }
    let q = workgroup.y / map.height;
    let y = workgroup.y - q * map.height;
    let area = map.height * map.width;
    var value = vec4(0.0);
    var at = workgroup.z * params.stride + q * 4u * area + y * map.width + x;
    for (var c = 0u; c < bound(min(map.channels - q * 4u, 4u), map.zero); c++) {
        value[c] = planar[at];
        at += area;
    }
    quads[texel_index(map, texel(map, workgroup.z, q, y, x))] = stored(value);
}

@compute @workgroup_size(64)
fn to_planar(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let map = params.map;
    let x = workgroup.x * 64u + local;
    if x >= map.width {
        return;
    }
    let q = workgroup.y / map.height;
    let y = workgroup.y - q * map.height;
    let area = map.height * map.width;
    let value = loaded(quads_in[texel_index(map, texel(map, workgroup.z, q, y, x))]);
    var at = workgroup.z * params.stride + q * 4u * area + y * map.width + x;
    for (var c = 0u; c < bound(min(map.channels - q * 4u, 4u), map.zero); c++) {
        planar_out[at] = value[c];
        at += area;
    }
}
