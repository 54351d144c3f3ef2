// Non-maximum suppression over at most 1024 boxes, the best first.
//
// `mask` compares all pairs at once: bit j of row i says that box i, if kept, suppresses the later
// box j, and bit i that it takes no part itself. `scan`, one workgroup, then goes through the rows, 32 boxes at
// a time. It is a chain of steps, so what a step needs is read at once: a load that waits for another takes a
// GPU longer than all else here.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> boxes: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> scores: array<f32>;
@group(0) @binding(3) var<storage, read> classes: array<u32>;
// Indices of the boxes, the best first.
@group(0) @binding(4) var<storage, read> order: array<u32>;
@group(0) @binding(5) var<storage, read> input_count: array<u32>;
@group(0) @binding(6) var<storage, read_write> suppressed: array<u32>;
@group(0) @binding(7) var<storage, read_write> keep: array<u32>;
@group(0) @binding(8) var<storage, read_write> output_count: array<u32>;

var<workgroup> gone: array<u32, 32>;
// The words of a block's rows that are about the block.
var<workgroup> own: array<u32, 32>;
var<workgroup> kept: u32;

// include: bound
// include: boxes
// include: index

@compute @workgroup_size(64)
fn mask(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let n = min(input_count[0], params.boxes);
    let at = linear_index(workgroup, local, 64u);
    let i = at / params.words;
    let first = (at % params.words) * 32u;
    if i >= n {
        return;
    }
    let index = order[i];
    let box = boxes[index];
    let fit = scores[index] > params.min_score && box.z - box.x >= params.min_size
        && box.w - box.y >= params.min_size;
    // A box that takes no part suppresses none: `scan` reads its row, but does not count it.
    if !fit {
        if i / 32u * 32u == first {
            suppressed[at] = 1u << (i % 32u);
        }
        return;
    }
    var word = 0u;
    for (var j = max(first, i + 1u); j < min(first + 32u, n); j++) {
        let other = order[j];
        var rivals = true;
        if params.has_classes != 0u {
            rivals = classes[index] == classes[other];
        }
        if rivals && iou_above(box, boxes[other], params.iou_threshold, params.zero) {
            word |= 1u << (j - first);
        }
    }
    suppressed[at] = word;
}

// Bit `bit` of `bits`, as all or none.
fn every(bits: u32, bit: u32) -> u32 {
    return 0u - ((bits >> bit) & 1u);
}

@compute @workgroup_size(32)
fn scan(@builtin(local_invocation_index) lane: u32) {
    let n = min(input_count[0], params.boxes);
    gone[lane] = 0u;
    var found = 0u;
    for (var block = 0u; block * 32u < n; block++) {
        // Rows behind the last repeat it: they do not survive.
        let first = block * 32u;
        let last = n - 1u;
        own[lane] = suppressed[min(first + lane, last) * params.words + block];
        workgroupBarrier();
        if lane == 0u {
            var out = gone[block] | ~(0xffffffffu >> (31u - min(last - first, 31u)));
            var survivors = 0u;
            for (var bit = 0u; bit < bound(32u, params.zero); bit++) {
                let word = own[bit];
                if ((out | word) & (1u << bit)) == 0u {
                    survivors |= 1u << bit;
                    out |= word;
                }
            }
            kept = survivors;
        }
        let survivors = workgroupUniformLoad(&kept);
        if lane < params.words {
            var out = gone[lane];
            for (var bit = 0u; bit < bound(32u, params.zero); bit += 4u) {
                let at = vec4(first + bit) + vec4(0u, 1u, 2u, 3u);
                let word = min(at, vec4(last)) * params.words + lane;
                let a = suppressed[word.x];
                let b = suppressed[word.y];
                let c = suppressed[word.z];
                let d = suppressed[word.w];
                out |= a & every(survivors, bit);
                out |= b & every(survivors, bit + 1u);
                out |= c & every(survivors, bit + 2u);
                out |= d & every(survivors, bit + 3u);
            }
            gone[lane] = out;
        }
        if (survivors & (1u << lane)) != 0u {
            let at = found + countOneBits(survivors & ((1u << lane) - 1u));
            if at < params.max_out {
                keep[at] = order[first + lane];
            }
        }
        found += countOneBits(survivors);
    }
    if lane == 0u {
        output_count[0] = min(found, params.max_out);
    }
}
