// Boxes and scores of the chosen anchors, from the region proposal head's maps.

@group(0) @binding(0) var<uniform> params: Params;
// [anchors][dx, dy, dw, dh][height][width]
@group(0) @binding(1) var<storage, read> deltas: array<f32>;
@group(0) @binding(2) var<storage, read> logits: array<f32>;
// (y * width + x) * anchors + anchor
@group(0) @binding(3) var<storage, read> indices: array<u32>;
@group(0) @binding(4) var<storage, read> count: array<u32>;
@group(0) @binding(5) var<storage, read> anchors: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> boxes: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> scores: array<f32>;

// include: boxes
// include: index
// include: sigmoid

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = linear_index(workgroup, local, 64u);
    if i >= min(count[0], params.capacity) {
        return;
    }
    let area = params.height * params.width;
    let index = min(indices[i], params.anchors * area - 1u);
    let anchor = index % params.anchors;
    let position = index / params.anchors;
    let at = anchor * 4u * area + position;
    let delta = vec4<f32>(
        deltas[at],
        deltas[at + area],
        deltas[at + 2u * area],
        deltas[at + 3u * area],
    );
    let cell = vec2<u32>(position % params.width, position / params.width);
    let shift = vec2<f32>(cell) * params.stride;
    let extent = vec2<f32>(params.picture_width, params.picture_height);
    boxes[i] = decode_box(anchors[anchor] + shift.xyxy, delta, extent);
    scores[i] = sigmoid(logits[i]);
}
