// CBAM's channel gate: sigmoid(f(average) + f(maximum)), f(x) = fc2(relu(fc1(x) + b1)) + b2.
//
// One workgroup. fc2 is linear, so the two hidden vectors are added before it and b2 counts twice.

// include: bound
// include: relu
// include: reduce
// include: sigmoid

const WORKGROUP: u32 = 256u;
// Rows of fc1 at a time; the invocations of a row share its columns.
const ROWS: u32 = 16u;
const LANES: u32 = WORKGROUP / ROWS;
// `CAPACITY` in src/kernels/channel_gate.rs.
const CAPACITY: u32 = 1024u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> pooled: array<f32>;
@group(0) @binding(2) var<storage, read> fc1_weight: array<f32>;
@group(0) @binding(3) var<storage, read> fc1_bias: array<f32>;
@group(0) @binding(4) var<storage, read> fc2_weight: array<f32>;
@group(0) @binding(5) var<storage, read> fc2_bias: array<f32>;
@group(0) @binding(6) var<storage, read_write> output: array<f32>;

var<workgroup> hidden: array<f32, CAPACITY>;

@compute @workgroup_size(WORKGROUP)
fn main(
    @builtin(local_invocation_index) local: u32,
    @builtin(num_workgroups) workgroups: vec3<u32>,
) {
    // 0, in bounds that are no uniform alone: lavapipe 22.3 may otherwise put the uniform's values into
    // the code and compile anew at each dispatch.
    let none = select(0u, 1u, workgroups.x == 0u);
    for (var base = 0u; base < bound(params.hidden, none); base += ROWS) {
        let row = base + local % ROWS;
        var dot = vec2<f32>(0.0);
        if row < params.hidden {
            for (var c = local / ROWS; c < bound(params.channels, none); c += LANES) {
                let x = vec2<f32>(pooled[c], pooled[params.channels + c]);
                dot = fma(vec2<f32>(fc1_weight[row * params.channels + c]), x, dot);
            }
        }
        dot = tree_sum(local, dot, ROWS);
        if local < ROWS && row < params.hidden {
            let both = relu(vec4<f32>(dot + fc1_bias[row], 0.0, 0.0)).xy;
            hidden[row] = both.x + both.y;
        }
    }
    workgroupBarrier();
    for (var c = local; c < bound(params.channels, none); c += WORKGROUP) {
        var logit = 2.0 * fc2_bias[c];
        for (var r = 0u; r < bound(params.hidden, none); r++) {
            logit = fma(fc2_weight[c * params.hidden + r], hidden[r], logit);
        }
        output[c] = sigmoid(logit);
    }
}
