// Reductions by a tree over a workgroup. The including shader declares `const WORKGROUP`, its number
// of invocations, a power of two, and a `params.zero` that is always 0: a bound that the compiler
// does not know keeps it from unrolling the tree, and with it from compiling for a fifth of a second.
//
// All invocations call together. Each gets the reduction over the invocations whose index is equal
// to its own modulo `keep`, a power of two: 1 reduces the whole workgroup.

var<workgroup> partial: array<vec2<f32>, WORKGROUP>;

// Both components summed.
fn tree_sum(local: u32, value: vec2<f32>, keep: u32) -> vec2<f32> {
    partial[local] = value;
    workgroupBarrier();
    for (var half = WORKGROUP / 2u; half >= bound(keep, params.zero); half /= 2u) {
        if local < half {
            partial[local] += partial[local + half];
        }
        workgroupBarrier();
    }
    let total = partial[local % keep];
    // The next tree must not overwrite what others still read.
    workgroupBarrier();
    return total;
}

// The sum of the first component, the largest of the second.
fn tree_sum_max(local: u32, value: vec2<f32>, keep: u32) -> vec2<f32> {
    partial[local] = value;
    workgroupBarrier();
    for (var half = WORKGROUP / 2u; half >= bound(keep, params.zero); half /= 2u) {
        if local < half {
            let a = partial[local];
            let b = partial[local + half];
            partial[local] = vec2<f32>(a.x + b.x, max(a.y, b.y));
        }
        workgroupBarrier();
    }
    let total = partial[local % keep];
    workgroupBarrier();
    return total;
}
