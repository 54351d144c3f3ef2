// The k highest scores and their indices, by descending score, ties by lower index; one workgroup.
//
// An element is the pair (key of its score, inverted index), so no two are equal. A radix select
// looks at the pairs byte by byte, from the top: a histogram of the byte over the elements that
// still match tells which value the k-th highest pair has there. It stops as soon as all matching
// elements are in, mostly before it comes to the index. The chosen go to workgroup memory, and a
// bitonic sort orders them.

// include: bound

const LANES: u32 = 256u;
// Inverted indices have 24 bits.
const LOWEST: u32 = 0xffffffu;

@group(0) @binding(0) var<uniform> params: Params;
// Bits of the floats [channels, area]; element i is [i % channels, i / channels].
@group(0) @binding(1) var<storage, read> scores: array<u32>;
@group(0) @binding(2) var<storage, read> input_count: array<u32>;
@group(0) @binding(3) var<storage, read_write> values: array<u32>;
@group(0) @binding(4) var<storage, read_write> indices: array<u32>;
@group(0) @binding(5) var<storage, read_write> output_count: array<u32>;

var<workgroup> histogram: array<atomic<u32>, 256>;
var<workgroup> sums: array<u32, 256>;
// What the lane whose bin holds the k-th highest tells the others.
var<workgroup> chosen: u32;
var<workgroup> still_wanted: u32;
var<workgroup> candidates: u32;
var<workgroup> filled: atomic<u32>;
var<workgroup> keys: array<u32, 1024>;
var<workgroup> positions: array<u32, 1024>;

fn score_bits(index: u32) -> u32 {
    return scores[(index % params.channels) * params.area + index / params.channels];
}

// Orders as the floats do; -0 as +0, NaN below all.
fn key_of(bits: u32) -> u32 {
    let magnitude = bits & 0x7fffffffu;
    if magnitude > 0x7f800000u {
        return 0u;
    }
    if magnitude == 0u {
        return 0x80000000u;
    }
    return select(bits | 0x80000000u, ~bits, bits > 0x80000000u);
}

// The keys of elements `i`, LANES apart, of `n`; of those past the last its own. They are read at once: a GPU
// waits as long for one as for four.
fn four_keys(i: u32, n: u32) -> vec4<u32> {
    let at = min(i + LANES * vec4<u32>(0u, 1u, 2u, 3u), vec4<u32>(n - 1u));
    let a = score_bits(at.x);
    let b = score_bits(at.y);
    let c = score_bits(at.z);
    let d = score_bits(at.w);
    return vec4<u32>(key_of(a), key_of(b), key_of(c), key_of(d));
}

// Sum of `value` over this lane and those below it.
fn inclusive_sum(lane: u32, value: u32) -> u32 {
    var total = value;
    sums[lane] = total;
    for (var step = 1u; step < bound(LANES, params.zero); step *= 2u) {
        workgroupBarrier();
        var below = 0u;
        if lane >= step {
            below = sums[lane - step];
        }
        workgroupBarrier();
        total += below;
        sums[lane] = total;
    }
    return total;
}

fn precedes(a: u32, b: u32) -> bool {
    return keys[a] > keys[b] || (keys[a] == keys[b] && positions[a] < positions[b]);
}

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    let n = min(input_count[0], params.channels * params.area);
    let k = min(params.k, n);
    if lane == 0u {
        output_count[0] = k;
    }
    if k == 0u {
        return;
    }

    // The k-th highest pair is at least (threshold, low), and exactly k pairs are.
    var threshold = 0u;
    var low = 0u;
    var mask = 0u;
    var wanted = k;
    for (var digit = 0u; digit < bound(7u, params.zero); digit++) {
        let in_key = digit < 4u;
        let shift = select(48u - 8u * digit, 24u - 8u * digit, in_key);
        if digit == 4u {
            mask = 0u;
        }
        atomicStore(&histogram[lane], 0u);
        workgroupBarrier();
        for (var first = lane; first < n; first += 4u * LANES) {
            let four = four_keys(first, n);
            for (var j = 0u; j < bound(4u, params.zero); j++) {
                let i = first + j * LANES;
                let key = four[j];
                let inverted = LOWEST - i;
                let matches = select(
                    key == threshold && (inverted & mask) == low,
                    (key & mask) == threshold,
                    in_key,
                );
                if i < n && matches {
                    atomicAdd(&histogram[(select(inverted, key, in_key) >> shift) & 255u], 1u);
                }
            }
        }
        workgroupBarrier();
        let bin = 255u - lane;
        let size = atomicLoad(&histogram[bin]);
        let upto = inclusive_sum(lane, size);
        if upto >= wanted && upto - size < wanted {
            chosen = bin;
            still_wanted = wanted - (upto - size);
            candidates = size;
        }
        if in_key {
            threshold |= workgroupUniformLoad(&chosen) << shift;
        } else {
            low |= workgroupUniformLoad(&chosen) << shift;
        }
        mask |= 255u << shift;
        wanted = workgroupUniformLoad(&still_wanted);
        if workgroupUniformLoad(&candidates) == wanted {
            break;
        }
    }

    // Padding sorts last: no index is that high.
    for (var i = lane; i < params.sort_size; i += LANES) {
        keys[i] = 0u;
        positions[i] = 0xffffffffu;
    }
    if lane == 0u {
        atomicStore(&filled, 0u);
    }
    workgroupBarrier();
    for (var first = lane; first < n; first += 4u * LANES) {
        let four = four_keys(first, n);
        for (var j = 0u; j < bound(4u, params.zero); j++) {
            let i = first + j * LANES;
            let key = four[j];
            if i < n && (key > threshold || (key == threshold && LOWEST - i >= low)) {
                let at = atomicAdd(&filled, 1u);
                keys[at] = key;
                positions[at] = i;
            }
        }
    }
    workgroupBarrier();

    for (var size = 2u; size <= params.sort_size; size *= 2u) {
        for (var stride = size / 2u; stride > 0u; stride /= 2u) {
            for (var t = lane; t < params.sort_size / 2u; t += LANES) {
                let a = 2u * t - (t & (stride - 1u));
                let b = a + stride;
                let forward = (a & size) == 0u;
                if select(precedes(a, b), precedes(b, a), forward) {
                    let key = keys[a];
                    let position = positions[a];
                    keys[a] = keys[b];
                    positions[a] = positions[b];
                    keys[b] = key;
                    positions[b] = position;
                }
            }
            workgroupBarrier();
        }
    }
    for (var i = lane; i < k; i += LANES) {
        values[i] = score_bits(positions[i]);
        indices[i] = positions[i];
    }
}
