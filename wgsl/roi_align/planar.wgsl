// RoIAlign: bilinear samples of the features on a grid in each box, averaged by bin.
//
// One invocation computes one bin of four channels, which share their sampling points.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> features: array<f32>;
@group(0) @binding(2) var<storage, read> boxes: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> count: array<u32>;
@group(0) @binding(4) var<storage, read_write> output: array<f32>;

// include: index
// include: neighbours

// Where each of the four channels lies behind the first; one past the last repeats it.
fn channel_offsets(channel: u32) -> vec4<u32> {
    let left = params.channels - channel - 1u;
    return min(vec4<u32>(0u, 1u, 2u, 3u), vec4<u32>(left)) * (params.height * params.width);
}

fn load(at: u32, offsets: vec4<u32>) -> vec4<f32> {
    return vec4<f32>(
        features[at + offsets.x],
        features[at + offsets.y],
        features[at + offsets.z],
        features[at + offsets.w],
    );
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_index(workgroup, local, 64u);
    let bins = params.size * params.size;
    let quads = (params.channels + 3u) / 4u;
    let roi = at / (bins * quads);
    if roi >= min(count[0], params.rois) {
        return;
    }
    let channel = at / bins % quads * 4u;
    let bin = vec2<u32>(at % params.size, at / params.size % params.size);

    let box = boxes[roi];
    // Half a pixel: feature (0, 0) is the centre of its cell.
    let start = box.xy * params.scale - 0.5;
    let bin_size = (box.zw * params.scale - 0.5 - start) / f32(params.size);
    let step = bin_size / f32(params.ratio);
    let corner = start + vec2<f32>(bin) * bin_size;
    let offsets = channel_offsets(channel);
    let plane = channel * params.height * params.width;

    var sum = vec4<f32>(0.0);
    for (var iy = 0u; iy < params.ratio; iy++) {
        let y = neighbours(corner.y + (f32(iy) + 0.5) * step.y, params.height);
        let above = plane + y.low * params.width;
        let below = plane + y.high * params.width;
        for (var ix = 0u; ix < params.ratio; ix++) {
            let x = neighbours(corner.x + (f32(ix) + 0.5) * step.x, params.width);
            if x.inside && y.inside {
                let top = (1.0 - x.weight) * load(above + x.low, offsets)
                    + x.weight * load(above + x.high, offsets);
                let bottom = (1.0 - x.weight) * load(below + x.low, offsets)
                    + x.weight * load(below + x.high, offsets);
                sum += (1.0 - y.weight) * top + y.weight * bottom;
            }
        }
    }
    let mean = sum / f32(params.ratio * params.ratio);
    for (var i = 0u; i < min(4u, params.channels - channel); i++) {
        output[(roi * params.channels + channel + i) * bins + bin.y * params.size + bin.x] = mean[i];
    }
}
