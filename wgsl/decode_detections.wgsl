// A box and a score for each region and class but the background, from the RoI head's outputs.

struct Params {
    rois: u32,
    classes: u32,
    // Bit c: class c is wanted.
    class_mask: u32,
    picture_width: f32,
    picture_height: f32,
    weight_x: f32,
    weight_y: f32,
    weight_width: f32,
    weight_height: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rois: array<vec4<f32>>;
// [rois][classes], the background first
@group(0) @binding(2) var<storage, read> deltas: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> probabilities: array<f32>;
@group(0) @binding(4) var<storage, read> input_count: array<u32>;
@group(0) @binding(5) var<storage, read_write> boxes: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> scores: array<f32>;
@group(0) @binding(7) var<storage, read_write> classes: array<u32>;
@group(0) @binding(8) var<storage, read_write> output_count: array<u32>;

// include: boxes
// include: index

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
    scores[at] = select(-1.0, probabilities[source], wanted);
    classes[at] = class_index;
}

@compute @workgroup_size(1)
fn count() {
    output_count[0] = min(input_count[0], params.rois) * (params.classes - 1u);
}
