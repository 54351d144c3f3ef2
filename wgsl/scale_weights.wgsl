// RW-Net's weight of each scale: softmax(fc2(relu(fc1(x) + b1)) + b2). One workgroup.

// include: relu
// include: reduce

struct Params {
    inputs: u32,
    hidden: u32,
    scales: u32,
    // Always 0; see shared/reduce.wgsl.
    zero: u32,
}

const WORKGROUP: u32 = 256u;
// Rows of fc1 at a time; the invocations of a row share its columns.
const ROWS: u32 = 16u;
const LANES: u32 = WORKGROUP / ROWS;
// `CAPACITY` in src/ops/scale_weights.rs.
const CAPACITY: u32 = 1024u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> pooled: array<f32>;
@group(0) @binding(2) var<storage, read> fc1_weight: array<f32>;
@group(0) @binding(3) var<storage, read> fc1_bias: array<f32>;
@group(0) @binding(4) var<storage, read> fc2_weight: array<f32>;
@group(0) @binding(5) var<storage, read> fc2_bias: array<f32>;
@group(0) @binding(6) var<storage, read_write> output: array<f32>;

var<workgroup> hidden: array<f32, CAPACITY>;
var<workgroup> logits: array<f32, WORKGROUP>;

@compute @workgroup_size(WORKGROUP)
fn main(
    @builtin(local_invocation_index) local: u32,
    @builtin(num_workgroups) workgroups: vec3<u32>,
) {
    // 0, in bounds that are no uniform alone: see channel_gate.wgsl.
    let none = select(0u, 1u, workgroups.x == 0u);
    for (var base = 0u; base < params.hidden + none; base += ROWS) {
        let row = base + local % ROWS;
        var dot = 0.0;
        if row < params.hidden {
            for (var i = local / ROWS; i < params.inputs + none; i += LANES) {
                dot = fma(fc1_weight[row * params.inputs + i], pooled[i], dot);
            }
        }
        dot = tree_sum(local, vec2<f32>(dot, 0.0), ROWS).x;
        if local < ROWS && row < params.hidden {
            hidden[row] = relu(vec4<f32>(dot + fc1_bias[row])).x;
        }
    }
    workgroupBarrier();
    // At most as many scales as invocations.
    if local < params.scales {
        var logit = fc2_bias[local];
        for (var r = 0u; r < params.hidden + none; r++) {
            logit = fma(fc2_weight[local * params.hidden + r], hidden[r], logit);
        }
        logits[local] = logit;
    }
    workgroupBarrier();
    if local < params.scales {
        var largest = logits[0];
        for (var k = 1u; k < params.scales + none; k++) {
            largest = max(largest, logits[k]);
        }
        var sum = 0.0;
        for (var k = 0u; k < params.scales + none; k++) {
            sum += exp(logits[k] - largest);
        }
        output[local] = exp(logits[local] - largest) / sum;
    }
}
