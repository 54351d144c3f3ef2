// A sum whose terms SLICES groups of WORKGROUP invocations share. A group is whole subgroups, so what all of it read
// from one place a subgroup reads from one place: which invocation has which lane does not matter.

struct Place {
    slice: u32,
    // Among the invocations of the slice.
    own: u32,
}

#if SUBGROUPS
var<workgroup> next_place: atomic<u32>;
#endif
// A quarter of the sums of each invocation that is not of the first slice.
var<workgroup> others: array<mat4x4<f32>, (SLICES - 1u) * WORKGROUP>;

#if SUBGROUPS
// Gives the lanes of a subgroup places behind each other. They are counted: some drivers tell another size.
fn place_of(local: u32, lane: u32) -> Place {
    if local == 0u {
        atomicStore(&next_place, 0u);
    }
    workgroupBarrier();
    let lanes = subgroupAdd(1u);
    let begin = subgroupBroadcast(atomicAdd(&next_place, select(0u, lanes, lane == 0u)), 0u);
    return Place(begin / WORKGROUP, begin % WORKGROUP + lane);
}
#else
fn place_of(local: u32, lane: u32) -> Place {
    return Place(local / WORKGROUP, local % WORKGROUP);
}
#endif

// The sums of all slices in their order, for the invocations of the first; for others none. All of a workgroup
// call together.
fn over_slices(place: Place, own: Sums, zero: u32) -> Sums {
    let a = quarter_over_slices(place, own.a, zero);
    let b = quarter_over_slices(place, own.b, zero);
    let c = quarter_over_slices(place, own.c, zero);
    return Sums(a, b, c, quarter_over_slices(place, own.d, zero));
}

// A quarter of them, for which there is room.
fn quarter_over_slices(place: Place, own: mat4x4<f32>, zero: u32) -> mat4x4<f32> {
    // What was brought together before must have been read.
    workgroupBarrier();
    if place.slice > 0u {
        others[(place.slice - 1u) * WORKGROUP + place.own] = own;
    }
    workgroupBarrier();
    var sum = own;
    if place.slice == 0u {
        for (var i = 0u; i < bound(SLICES - 1u, zero); i++) {
            sum += others[i * WORKGROUP + place.own];
        }
    }
    return sum;
}
