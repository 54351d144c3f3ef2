// RoIAlign: bilinear samples of the features on a grid in each box, averaged by bin.
//
// One invocation computes one bin of sixteen channels, which share their sampling points.

// include: bound
// include: quads
// include: texels
// include: input
// include: neighbours

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(2) var<storage, read> boxes: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> count: array<u32>;
@group(0) @binding(4) var<storage, read_write> output: array<f32>;

fn load(origin: vec2<u32>, y: u32, x: u32) -> vec4<f32> {
    return input_at(params.map, origin + vec2(x, y));
}

// A sample of the quad that begins at `origin`.
fn bilinear(origin: vec2<u32>, y: Neighbours, x: Neighbours) -> vec4<f32> {
    let top = (1.0 - x.weight) * load(origin, y.low, x.low)
        + x.weight * load(origin, y.low, x.high);
    let bottom = (1.0 - x.weight) * load(origin, y.high, x.low)
        + x.weight * load(origin, y.high, x.high);
    return select(vec4(0.0), (1.0 - y.weight) * top + y.weight * bottom, y.inside && x.inside);
}

fn store(picture: u32, roi: u32, bin: u32, quad: u32, value: vec4<f32>) {
    let map = params.map;
    let bins = params.size * params.size;
    if quad >= map.quads {
        return;
    }
    let first = picture * params.output_stride + (roi * map.channels + 4u * quad) * bins + bin;
    for (var i = 0u; i < min(bound(4u, map.zero), map.channels - 4u * quad); i++) {
        output[first + i * bins] = value[i];
    }
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let map = params.map;
    let picture = workgroup.z;
    let bins = params.size * params.size;
    let at = workgroup.x * 64u + lane;
    let roi = at / bins;
    if roi >= min(count[picture * params.count_stride], params.rois) {
        return;
    }
    let bin = at - roi * bins;
    let bin_y = bin / params.size;
    let bin_x = bin - bin_y * params.size;

    let box = boxes[picture * params.box_stride / 4u + roi];
    // Half a pixel: feature (0, 0) is the centre of its cell.
    let start = box.xy * params.scale - 0.5;
    let bin_size = (box.zw * params.scale - 0.5 - start) / f32(params.size);
    let step = bin_size / f32(params.ratio);
    let corner = start + vec2(f32(bin_x), f32(bin_y)) * bin_size;

    // Quads past the last repeat it; nobody stores them.
    let last = map.quads - 1u;
    let first = workgroup.y * 4u;
    let at0 = texel(map, picture, first, 0u, 0u);
    let at1 = texel(map, picture, min(first + 1u, last), 0u, 0u);
    let at2 = texel(map, picture, min(first + 2u, last), 0u, 0u);
    let at3 = texel(map, picture, min(first + 3u, last), 0u, 0u);
    var sum0 = vec4(0.0);
    var sum1 = vec4(0.0);
    var sum2 = vec4(0.0);
    var sum3 = vec4(0.0);
    for (var iy = 0u; iy < params.ratio; iy++) {
        let y = neighbours(corner.y + (f32(iy) + 0.5) * step.y, map.height);
        for (var ix = 0u; ix < params.ratio; ix++) {
            let x = neighbours(corner.x + (f32(ix) + 0.5) * step.x, map.width);
            sum0 += bilinear(at0, y, x);
            sum1 += bilinear(at1, y, x);
            sum2 += bilinear(at2, y, x);
            sum3 += bilinear(at3, y, x);
        }
    }
    let samples = f32(params.ratio * params.ratio);
    store(picture, roi, bin, first, sum0 / samples);
    store(picture, roi, bin, first + 1u, sum1 / samples);
    store(picture, roi, bin, first + 2u, sum2 / samples);
    store(picture, roi, bin, first + 3u, sum3 / samples);
}
