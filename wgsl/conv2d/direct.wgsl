// 2-D convolution with bias, optional residual and ReLU, on maps of four channels a texel.
//
// One invocation computes CHANNELS outputs at each of PIXELS pixels side by side. Those of a workgroup work on
// different pixels, those of small maps on several pictures, and the same channels. So all need the same
// weights: with SPREAD one lane reads a texel of them and spreads it to its subgroup, without they are
// read from one address, which compilers turn into scalar loads. With THREE_TAPS, the kernel is of 3 × 3, and the
// taps of a row share the inputs that they have in common: the pixels of a strip lie as far apart as the
// taps, or, with STRIDE_TWO, side by side. With POINTWISE, it is of 1 × 1 without padding and its inputs lie in a
// buffer: none is outside, and from quad to quad all places move by as much.
//
// A block of quads of input channels is summed for itself and then added to the total: shorter
// sums lose fewer digits. With SPLIT, slices of a workgroup sum some of the blocks each, and the first adds them up.
//
// Constants: WORKGROUP invocations in each of SLICES, with SUBGROUPS whole ones.

// include: bound
// include: quads
// include: texels
// include: input
// include: products
// include: relu
#if SPLIT
// include: slices
#endif

@group(0) @binding(0) var<uniform> params: Params;
// A texel is one output's weights of four input channels, zero in the padding. Texels lie as they are
// read: by tile, quad of inputs, row of the kernel, tap, output of the tile.
#if SPREAD
#if HALF_WEIGHT
@group(0) @binding(2) var weight: texture_storage_2d<rgba16float, read>;
// What each output's sum is to be multiplied with: a power of two. Of whole tiles.
@group(0) @binding(6) var<storage, read> scale: array<vec4<f32>>;
#else
@group(0) @binding(2) var weight: texture_storage_2d<rgba32float, read>;
#endif
#else
@group(0) @binding(2) var<storage, read> weight: array<vec4<f32>>;
#endif
// Of whole tiles.
@group(0) @binding(3) var<storage, read> bias: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> residual: array<Texel>;
@group(0) @binding(5) var<storage, read_write> output: array<OutputTexel>;

#if SPREAD
alias WeightPlace = vec2<u32>;
#else
alias WeightPlace = u32;

fn four_weights(at: u32) -> Four {
    return Four(weight[at], weight[at + 1u], weight[at + 2u], weight[at + 3u]);
}
#endif

// Inputs that the pixels and taps of a strip have between them, and where those of each tap begin.
#if THREE_TAPS
const TAPS: u32 = 3u;
#if STRIDE_TWO
// Those at even places, then those at odd ones.
const SPAN: u32 = 2u * PIXELS + 1u;
const SECOND: u32 = PIXELS + 1u;
const THIRD: u32 = 1u;
#else
const SPAN: u32 = PIXELS + 2u;
const SECOND: u32 = 1u;
const THIRD: u32 = 2u;
#endif
#else
const TAPS: u32 = 1u;
const SPAN: u32 = PIXELS;
#endif
alias Strip = array<vec4<f32>, SPAN>;

// The inputs of four pixels, by channel.
fn pixels(strip: ptr<function, Strip>, at: u32) -> mat4x4<f32> {
    return transpose(mat4x4<f32>(
        (*strip)[at],
        (*strip)[at + 1u],
        (*strip)[at + 2u],
        (*strip)[at + 3u],
    ));
}

const PIXELS: u32 = 4u;
const CHANNELS: u32 = 16u;

// Sums with a tap whose weights begin at `at` and whose inputs begin at `first_input` of the strip.
fn add_tap(
    sums: Sums,
    at: WeightPlace,
    lane: u32,
    strip: ptr<function, Strip>,
    first_input: u32,
) -> Sums {
    let x = pixels(strip, first_input);
#if SPREAD
#if FOUR_LANES
    let own = at + vec2<u32>(lane % 4u, 0u);
    return Sums(
        add_products(sums.a, first(textureLoad(weight, own)), x),
        add_products(sums.b, first(textureLoad(weight, own + vec2<u32>(4u, 0u))), x),
        add_products(sums.c, first(textureLoad(weight, own + vec2<u32>(8u, 0u))), x),
        add_products(sums.d, first(textureLoad(weight, own + vec2<u32>(12u, 0u))), x),
    );
#else
#if EIGHT_LANES
    let own = at + vec2<u32>(lane % 8u, 0u);
    let near = textureLoad(weight, own);
    let far = textureLoad(weight, own + vec2<u32>(8u, 0u));
    return Sums(
        add_products(sums.a, first(near), x),
        add_products(sums.b, second(near), x),
        add_products(sums.c, first(far), x),
        add_products(sums.d, second(far), x),
    );
#else
    let all = textureLoad(weight, at + vec2<u32>(lane % 16u, 0u));
    return Sums(
        add_products(sums.a, first(all), x),
        add_products(sums.b, second(all), x),
        add_products(sums.c, third(all), x),
        add_products(sums.d, fourth(all), x),
    );
#endif
#endif
#else
    return Sums(
        add_products(sums.a, four_weights(at), x),
        add_products(sums.b, four_weights(at + 4u), x),
        add_products(sums.c, four_weights(at + 8u), x),
        add_products(sums.d, four_weights(at + 12u), x),
    );
#endif
}

// Four outputs a texel: of each pixel, then the next four.
fn texels(sums: Sums) -> array<vec4<f32>, 16> {
    let a = transpose(sums.a);
    let b = transpose(sums.b);
    let c = transpose(sums.c);
    let d = transpose(sums.d);
    return array<vec4<f32>, 16>(
        a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3],
        c[0], c[1], c[2], c[3], d[0], d[1], d[2], d[3],
    );
}

// Where the quad behind another lies. Division is slow.
fn beside(corner: vec2<u32>) -> vec2<u32> {
    let map = params.input;
    let x = corner.x + map.pitch;
    let below = vec2<u32>(0u, corner.y + map.height);
    return select(vec2<u32>(x, corner.y), below, x == map.columns * map.pitch);
}

@compute @workgroup_size(WORKGROUP * SLICES)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
#if SUBGROUPS
    @builtin(subgroup_invocation_id) lane: u32,
#endif
) {
#if !SUBGROUPS
    let lane = 0u;
#endif
#if SPLIT
    let place = place_of(local, lane);
    let own = place.own;
#else
    let own = local;
#endif
    let picture_strips = params.strips * params.output.height;
    // Lanes past the last strip of the last picture repeat it.
    let last = params.pictures * picture_strips - 1u;
    let index = workgroup.x * WORKGROUP + own;
    let picture = min(index, last) / picture_strips;
    let strip_index = min(index, last) % picture_strips;
    let out_y = strip_index / params.strips;
    let spacing = params.spacing;
    let strip_of_row = strip_index % params.strips;
    let out_x = strip_of_row / spacing * spacing * PIXELS + strip_of_row % spacing;
    // Wraps below zero to a large number, so that one comparison finds both sides.
    let left = out_x * params.stride - params.padding;
    let top = out_y * params.stride - params.padding;
    let tile = workgroup.y;
    // 0, in bounds that are no uniform alone: lavapipe 22.3 may otherwise put the uniform's values into
    // the code and compile anew at each dispatch. Loops of a known length would be unrolled.
    let none = select(0u, 1u, workgroups.x == 0u);
    let split_blocks = bound(params.split_blocks, none);
#if SPLIT
    // All slices run in step: one that has fewer blocks goes over some of others, which count as zero.
    let first_block = place.slice * split_blocks;
    let begin = min(first_block, params.blocks - split_blocks);
#else
    let begin = bound(0u, none);
#endif
    let width = params.input.width;
    let height = params.input.height;
    let dilation = params.dilation;
#if THREE_TAPS
    // Mesa unrolls this one loop: sums that are kept once in nine taps, not in three, cost a fifth less.
    let kernel_height = 3u;
    let kernel_width = 3u;
#else
    let kernel_height = bound(params.kernel_height, none);
    let kernel_width = bound(params.kernel_width, none);
#endif
    // From one input of a strip to the next.
    let step = params.stride * spacing;
    let block_quads = bound(params.block_quads, none);

    // The taps of a row that are added together lie side by side.
    let taps = TAPS * CHANNELS;
    let taps_of_block = block_quads * kernel_height * kernel_width / TAPS;
    let first_taps = (tile * params.blocks + begin) * taps_of_block;
#if SPREAD
    let taps_of_row = params.weight_width / taps;
    var at = vec2<u32>(first_taps % taps_of_row * taps, first_taps / taps_of_row);
    let second = vec2<u32>(CHANNELS, 0u);
#else
    var at = first_taps * taps;
    let second = CHANNELS;
#endif
    // A quad of inputs, and where it lies. The last block may have fewer quads than others: what is
    // read again has weights of zero, and counts as zero lest it be infinite.
    let first_quad = tile / params.group_tiles * params.group_quads;
    let quads = first_quad + params.group_quads;
    var quad = first_quad + begin * block_quads;
    var corner = texel(params.input, picture, quad, 0u, 0u);
#if POINTWISE
    var places: array<u32, SPAN>;
    for (var j = 0u; j < SPAN; j++) {
        let pixel = vec2<u32>(min(left + j * step, width - 1u), top);
        places[j] = texel_index(params.input, corner + pixel);
    }
    var moved = 0u;
#endif
    var total = Sums();
    for (var block = 0u; block < split_blocks; block++) {
        var part = Sums();
        for (var i = 0u; i < block_quads; i++) {
#if SPLIT
            let exists = (quad < quads) & (begin + block >= first_block);
#else
            let exists = quad < quads;
#endif
#if POINTWISE
            if exists {
                var strip: Strip;
                for (var j = 0u; j < SPAN; j++) {
                    strip[j] = loaded(input[places[j] + moved]);
                }
                part = add_tap(part, at, lane, &strip, 0u);
            }
            at += taps;
            moved += params.input.pitch * height;
#else
            for (var ky = 0u; ky < kernel_height; ky++) {
                let in_y = top + ky * dilation;
                let row = corner.y + min(in_y, height - 1u);
#if THREE_TAPS
                let first_column = left;
#else
                for (var kx = 0u; kx < kernel_width; kx++) {
                    let first_column = left + kx * dilation;
#endif
                    var strip: Strip;
                    for (var j = 0u; j < SPAN; j++) {
#if STRIDE_TWO
                        let in_x = first_column + 2u * j - select(0u, SPAN, j >= SECOND);
#else
                        let in_x = first_column + j * step;
#endif
                        let column = corner.x + min(in_x, width - 1u);
                        let x = input_at(params.input, vec2<u32>(column, row));
                        strip[j] =
                            select(vec4<f32>(), x, exists & (in_y < height) & (in_x < width));
                    }
                    part = add_tap(part, at, lane, &strip, 0u);
#if THREE_TAPS
                    part = add_tap(part, at + second, lane, &strip, SECOND);
                    part = add_tap(part, at + 2u * second, lane, &strip, THIRD);
#endif
#if SPREAD
                    at.x += taps;
                    at = select(at, vec2<u32>(0u, at.y + 1u), at.x == params.weight_width);
#else
                    at += taps;
#endif
#if !THREE_TAPS
                }
#endif
            }
            corner = select(corner, beside(corner), quad + 1u < quads);
#endif
            quad += 1u;
        }
        total = join(total, part);
    }

#if SPLIT
    total = over_slices(place, total, none);
    let stores = (index <= last) & (place.slice == 0u);
#else
    let stores = index <= last;
#endif
    var sums = texels(total);
    var out_quad = tile * (CHANNELS / 4u);
    for (var i = 0u; i < bound(CHANNELS / 4u, none); i++) {
        let first_at = texel_index(
            params.output,
            texel(params.output, picture, out_quad, out_y, out_x),
        );
        let channel = out_quad * 4u + vec4<u32>(0u, 1u, 2u, 3u);
        let exists = channel < vec4<u32>(params.output.channels);
        for (var j = 0u; j < bound(PIXELS, none); j++) {
            if stores & (out_x + j * spacing < params.output.width) & exists.x {
                let at = first_at + j * spacing;
#if HALF_WEIGHT
                var value = sums[i * PIXELS + j] * scale[out_quad] + bias[out_quad];
#else
                var value = sums[i * PIXELS + j] + bias[out_quad];
#endif
                if params.has_residual != 0u {
                    value += loaded(residual[at]);
                }
                if params.relu != 0u {
                    value = relu(value);
                }
                output[at] = stored(select(vec4<f32>(), value, exists));
            }
        }
        out_quad += 1u;
    }
}
