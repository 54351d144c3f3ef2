// Non-maximum suppression over at most 1024 boxes, the best first.
//
// `mask` compares all pairs at once: bit j of row i says that box i, if kept, suppresses the later
// box j. `scan`, one workgroup, then goes through the rows, 32 boxes at a time.

struct Params {
    boxes: u32,
    // Words of 32 boxes in a row of the mask.
    words: u32,
    max_out: u32,
    iou_threshold: f32,
    min_score: f32,
    min_size: f32,
    has_classes: u32,
    // Always 0; see `rounded` in shared/boxes.wgsl. As part of a bound it keeps the compiler from
    // unrolling the loop, which takes seconds.
    zero: u32,
}

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
var<workgroup> kept: u32;

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
    // A box that takes no part suppresses none, and `scan` never reads its row.
    if scores[index] <= params.min_score {
        return;
    }
    let box = boxes[index];
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

// The boxes of a word that take no part: behind the count, too low a score, too small.
fn unfit(word: u32, n: u32) -> u32 {
    var bits = 0u;
    for (var bit = 0u; bit < 32u + params.zero; bit++) {
        let i = word * 32u + bit;
        var fit = i < n;
        if fit {
            let index = order[i];
            let box = boxes[index];
            fit = scores[index] > params.min_score && box.z - box.x >= params.min_size
                && box.w - box.y >= params.min_size;
        }
        bits |= select(1u, 0u, fit) << bit;
    }
    return bits;
}

@compute @workgroup_size(32)
fn scan(@builtin(local_invocation_index) lane: u32) {
    let n = min(input_count[0], params.boxes);
    gone[lane] = unfit(lane, n);
    var found = 0u;
    for (var block = 0u; block * 32u < n; block++) {
        workgroupBarrier();
        if lane == 0u {
            var out = gone[block];
            var survivors = 0u;
            for (var bit = 0u; bit < 32u + params.zero; bit++) {
                if (out & (1u << bit)) == 0u {
                    survivors |= 1u << bit;
                    out |= suppressed[(block * 32u + bit) * params.words + block];
                }
            }
            kept = survivors;
        }
        let survivors = workgroupUniformLoad(&kept);
        if lane < params.words {
            var out = gone[lane];
            for (var bit = 0u; bit < 32u + params.zero; bit++) {
                if (survivors & (1u << bit)) != 0u {
                    out |= suppressed[(block * 32u + bit) * params.words + lane];
                }
            }
            gone[lane] = out;
        }
        if (survivors & (1u << lane)) != 0u {
            let at = found + countOneBits(survivors & ((1u << lane) - 1u));
            if at < params.max_out {
                keep[at] = order[block * 32u + lane];
            }
        }
        found += countOneBits(survivors);
    }
    if lane == 0u {
        output_count[0] = min(found, params.max_out);
    }
}
