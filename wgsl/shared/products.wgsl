// Products of four values each of four things, kept in registers, and what lanes of a subgroup hold.

struct Four {
    a: vec4<f32>,
    b: vec4<f32>,
    c: vec4<f32>,
    d: vec4<f32>,
}

// Sums with the products of `w`: column i of the sums is of its i-th member. Column k of `x` is
// multiplied by its members' k-th values.
fn add_products(sums: mat4x4<f32>, w: Four, x: mat4x4<f32>) -> mat4x4<f32> {
    return mat4x4<f32>(
        sums[0] + w.a.x * x[0] + w.a.y * x[1] + w.a.z * x[2] + w.a.w * x[3],
        sums[1] + w.b.x * x[0] + w.b.y * x[1] + w.b.z * x[2] + w.b.w * x[3],
        sums[2] + w.c.x * x[0] + w.c.y * x[1] + w.c.z * x[2] + w.c.w * x[3],
        sums[3] + w.d.x * x[0] + w.d.y * x[1] + w.d.z * x[2] + w.d.w * x[3],
    );
}

// The sums of an invocation: four things each.
struct Sums {
    a: mat4x4<f32>,
    b: mat4x4<f32>,
    c: mat4x4<f32>,
    d: mat4x4<f32>,
}

fn join(a: Sums, b: Sums) -> Sums {
    return Sums(a.a + b.a, a.b + b.b, a.c + b.c, a.d + b.d);
}

#if SUBGROUPS
// What the first four lanes of a subgroup hold, and so on. It may have more, but no fewer.
fn first(w: vec4<f32>) -> Four {
    return Four(
        subgroupBroadcast(w, 0u),
        subgroupBroadcast(w, 1u),
        subgroupBroadcast(w, 2u),
        subgroupBroadcast(w, 3u),
    );
}
#if !FOUR_LANES
fn second(w: vec4<f32>) -> Four {
    return Four(
        subgroupBroadcast(w, 4u),
        subgroupBroadcast(w, 5u),
        subgroupBroadcast(w, 6u),
        subgroupBroadcast(w, 7u),
    );
}
#if !EIGHT_LANES
fn third(w: vec4<f32>) -> Four {
    return Four(
        subgroupBroadcast(w, 8u),
        subgroupBroadcast(w, 9u),
        subgroupBroadcast(w, 10u),
        subgroupBroadcast(w, 11u),
    );
}
fn fourth(w: vec4<f32>) -> Four {
    return Four(
        subgroupBroadcast(w, 12u),
        subgroupBroadcast(w, 13u),
        subgroupBroadcast(w, 14u),
        subgroupBroadcast(w, 15u),
    );
}
#endif
#endif
#endif
