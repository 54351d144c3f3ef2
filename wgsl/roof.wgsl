// What an adapter does at best: multiply-adds in registers, and copies.

// include: index

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> sums: array<f32>;
@group(0) @binding(2) var<storage, read> texels_in: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> texels_out: array<vec4<f32>>;

// Sixteen chains that do not wait for each other.
@compute @workgroup_size(64)
fn multiply_add(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let at = workgroup.x * 64u + local;
    let start = f32(local);
    var a = vec4<f32>(start, start + 1.0, start + 2.0, start + 3.0);
    var b = a + 4.0;
    var c = a + 8.0;
    var d = a + 12.0;
    let factor = params.factor;
    for (var round = 0u; round < params.rounds; round++) {
        a = a * factor + b;
        b = b * factor + c;
        c = c * factor + d;
        d = d * factor + 1.0;
    }
    let sum = a + b + c + d;
    sums[at] = sum.x + sum.y + sum.z + sum.w;
}

@compute @workgroup_size(64)
fn copy(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = linear_index(workgroup, local, 64u);
    if index < params.texels {
        texels_out[index] = texels_in[index];
    }
}
