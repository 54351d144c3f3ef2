// A box, a score and its logit for each region and class but the background, from the RoI head's outputs.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rois: array<vec4<f32>>;
// [rois][classes], the background first
@group(0) @binding(2) var<storage, read> deltas: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> logits: array<f32>;
@group(0) @binding(4) var<storage, read> input_count: array<u32>;
@group(0) @binding(5) var<storage, read_write> boxes: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> scores: array<f32>;
@group(0) @binding(7) var<storage, read_write> margins: array<f32>;
@group(0) @binding(8) var<storage, read_write> classes: array<u32>;
@group(0) @binding(9) var<storage, read_write> output_count: array<u32>;

// include: boxes
// include: index
// include: sigmoid

// By how much the logit of a class of a region, which is no background, is above those of all others together.
fn margin_of(roi: u32, class_index: u32) -> f32 {
    let first = roi * params.classes;
    let last = first + params.classes;
    let own = first + class_index;
    var highest = logits[first];
    for (var i = first + 1u; i < last; i++) {
        highest = select(max(highest, logits[i]), highest, i == own);
    }
    var sum = 0.0;
    for (var i = first; i < last; i++) {
        sum += select(exp((logits[i] - highest) * params.scale), 0.0, i == own);
    }
    return (logits[own] - highest) * params.scale - log(sum);
}

@compute @workgroup_size(64)
fn decode(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_index(workgroup, local, 64u);
    let roi = at / (params.classes - 1u);
    let class_index = at % (params.classes - 1u) + 1u;
    if roi >= min(input_count[0], params.rois) {
        return;
    }
    let source = roi * params.classes + class_index;
    let weights = vec4<f32>(
        params.weight_x,
        params.weight_y,
        params.weight_width,
        params.weight_height,
    );
    let extent = vec2<f32>(params.picture_width, params.picture_height);
    boxes[at] = decode_box(rois[roi], deltas[source] / weights, extent);
    let wanted = (params.class_mask & (1u << class_index)) != 0u;
    let margin = margin_of(roi, class_index);
    scores[at] = select(-1.0, sigmoid(margin), wanted);
    margins[at] = margin;
    classes[at] = class_index;
}

@compute @workgroup_size(1)
fn count() {
    output_count[0] = min(input_count[0], params.rois) * (params.classes - 1u);
}
