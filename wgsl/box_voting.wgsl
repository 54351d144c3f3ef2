// Box voting: each kept box's row moves to the mean of the rows of its class whose boxes overlap with
// it. An invocation for each number of a kept row.

@group(0) @binding(0) var<uniform> params: Params;
// [candidates / share][columns]
@group(0) @binding(1) var<storage, read> rows: array<f32>;
@group(0) @binding(2) var<storage, read> boxes: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> scores: array<f32>;
@group(0) @binding(4) var<storage, read> classes: array<u32>;
@group(0) @binding(5) var<storage, read> keep: array<u32>;
// How many are kept, and how many candidates there are.
@group(0) @binding(6) var<storage, read> kept: array<u32>;
@group(0) @binding(7) var<storage, read> count: array<u32>;
@group(0) @binding(8) var<storage, read_write> output: array<f32>;

// include: boxes
// include: index

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_index(workgroup, local, 64u);
    let place = at / params.columns;
    let column = at % params.columns;
    let n = min(count[0], params.candidates);
    if place >= min(kept[0], params.capacity) || n == 0u {
        return;
    }
    let own = min(keep[place], n - 1u);
    let box = boxes[own];
    let mine = rows[own / params.share * params.columns + column];
    let scale = 1.0 / (1.0 - params.iou_threshold);
    var total = max(scores[own], 0.0);
    var shift = 0.0;
    var voted = false;
    for (var j = 0u; j < n; j++) {
        let score = scores[j];
        // It begins at 0, so that a box that is just past the threshold moves nothing.
        let weight = score * (iou(box, boxes[j]) - params.iou_threshold) * scale;
        if j != own && classes[j] == classes[own] && score > 0.0 && weight > 0.0 {
            total += weight;
            shift += weight * (rows[j / params.share * params.columns + column] - mine);
            voted = true;
        }
    }
    output[at] = select(mine, mine + shift / total, voted);
}
