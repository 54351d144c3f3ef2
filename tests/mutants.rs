//! What the operations' cases are for: faults in a shader that one of them must notice.

#[path = "support/mutate.rs"]
mod mutate;

use std::sync::{Arc, OnceLock};

use smr_gpu::Precision;
use smr_gpu::engine::gpu::{Gpu, GpuOptions};
use smr_gpu::engine::kernels::shaders;
use smr_gpu::engine::ops::{Case, Expected, find};
use smr_gpu::engine::shader::{Replacement, reflect, reflect_replaced};
use smr_gpu::verify::check::{Selection, Target, check, check_expected, rows};

/// A device with bounds checks: what a fault reads or writes outside is defined.
fn gpu() -> &'static Arc<Gpu> {
    static DEVICE: OnceLock<Arc<Gpu>> = OnceLock::new();
    DEVICE.get_or_init(|| {
        let options = GpuOptions { bounds_checks: true, ..GpuOptions::default() };
        pollster::block_on(Gpu::open(options)).expect("a Vulkan adapter")
    })
}

/// A fault, and the case that notices it.
struct Fault {
    what: &'static str,
    file: &'static str,
    /// Each text that is replaced, from where the one before was.
    changes: &'static [(&'static str, &'static str)],
    op: &'static str,
    case: &'static str,
    /// Whether the outputs by hand show it, so that the same fault in the reference cannot hide it.
    by_hand: bool,
}

const FAULTS: &[Fault] = &[
    Fault {
        what: "the last row of a whole tile is not stored",
        file: "linear/planar",
        changes: &[("if first + 7u < rows", "if first + 8u < rows")],
        op: "linear",
        case: "a whole tile",
        by_hand: false,
    },
    Fault {
        what: "the last row of a whole tile is not stored, where a count limits the rows",
        file: "linear/planar",
        changes: &[("if first + 7u < rows", "if first + 8u < rows")],
        op: "linear",
        case: "two whole tiles, counted",
        by_hand: false,
    },
    Fault {
        what: "rows behind the count are written, with sums of what was there",
        file: "linear/planar",
        changes: &[
            ("fn finish(", "fn finish("),
            ("if row >= min(count[0], params.rows)", "if row >= max(count[0], params.rows)"),
        ],
        op: "linear",
        case: "a row of feature maps",
        by_hand: false,
    },
    Fault {
        what: "boxes may grow by e⁴ instead of 62.5",
        file: "shared/boxes",
        changes: &[("4.135166556742356", "4.0")],
        op: "decode_proposals",
        case: "the clamp by hand",
        by_hand: true,
    },
    Fault {
        what: "boxes may grow by e⁴ instead of 62.5",
        file: "shared/boxes",
        changes: &[("4.135166556742356", "4.0")],
        op: "decode_detections",
        case: "the clamp by hand",
        by_hand: true,
    },
    Fault {
        what: "half of the tiles must be calm, not a quarter",
        file: "contact_map",
        changes: &[("if 4u * below >= params.tiles", "if 2u * below >= params.tiles")],
        op: "contact_map",
        case: "a quarter is calm by hand",
        by_hand: true,
    },
    Fault {
        what: "one channel is enough for an overexposed cell",
        file: "contact_map",
        changes: &[("lowest = min(lowest, cells[c * area", "lowest = max(lowest, cells[c * area")],
        op: "contact_map",
        case: "one channel overexposed by hand",
        by_hand: true,
    },
    Fault {
        what: "what equals the limit is contact",
        file: "contact_map",
        changes: &[("if of_tile[at * 32u + bit] > most", "if of_tile[at * 32u + bit] >= most")],
        op: "contact_map",
        case: "a spot of 8 by hand",
        by_hand: true,
    },
    Fault {
        what: "no sample exactly at the features' end",
        file: "shared/neighbours",
        changes: &[("at <= f32(length)", "at < f32(length)")],
        op: "roi_align",
        case: "exactly at the edges by hand",
        by_hand: true,
    },
    Fault {
        what: "no sample exactly at −1",
        file: "shared/neighbours",
        changes: &[("at >= -1.0", "at > -1.0")],
        op: "roi_align",
        case: "exactly at the edges by hand",
        by_hand: true,
    },
    Fault {
        what: "the first picture's boxes for all",
        file: "roi_align/quads",
        changes: &[("picture * params.box_stride", "0u * params.box_stride")],
        op: "roi_align",
        case: "the RoI head",
        by_hand: false,
    },
    Fault {
        what: "the pixels of all rows summed one after the other",
        file: "shared/over_space",
        changes: &[
            (
                "first_row = local / COLUMNS % ROWS",
                "first_row = select(map.height, 0u, local % QUAD_LANES == 0u)",
            ),
            ("y += ROWS", "y += 1u"),
            ("x += COLUMNS", "x += 1u"),
            ("row_sum += value", "sum += value"),
            ("row += ROWS * row_texels", "row += row_texels"),
        ],
        op: "global_avg_pool",
        case: "one third everywhere",
        by_hand: false,
    },
    Fault {
        what: "the last rows left out",
        file: "shared/over_space",
        changes: &[("i < bound(ROWS, map.zero)", "i < bound(ROWS - 1u, map.zero)")],
        op: "channel_pool",
        case: "41 rows: some invocations have one less",
        by_hand: false,
    },
    Fault {
        what: "a slice's sums counted to another pixel",
        file: "spatial_pool/quads",
        changes: &[("parts[lane + 8u * i]", "parts[lane + 8u * i - 8u]")],
        op: "spatial_pool",
        case: "33 quads: one slice a quad short of the other",
        by_hand: false,
    },
    Fault {
        what: "the first picture's gates for all",
        file: "spatial_pool/quads",
        changes: &[("workgroup.z * params.gate_stride", "0u * params.gate_stride")],
        op: "spatial_pool",
        case: "two pixels of four channels by hand",
        by_hand: false,
    },
    Fault {
        what: "the first picture's gates for all",
        file: "apply_gates/quads",
        changes: &[("workgroup.z * params.pooled_stride", "0u * params.pooled_stride")],
        op: "apply_gates",
        case: "four channels of two pixels by hand",
        by_hand: false,
    },
    Fault {
        what: "one map's weight for the next",
        file: "weighted_sum/quads",
        changes: &[("weights[weight + 3u]", "weights[weight + 2u]")],
        op: "weighted_sum",
        case: "five maps by hand",
        by_hand: true,
    },
    Fault {
        what: "the rest of a row's columns as the height says",
        file: "max_pool2d/quads",
        changes: &[("window(x, source.width)", "window(x, source.height)")],
        op: "max_pool2d",
        case: "two channels, not square, by hand",
        by_hand: true,
    },
    Fault {
        what: "each block of quads as the first",
        file: "upsample_bilinear/quads",
        changes: &[("texel(source, picture, first, y.low", "texel(source, picture, 0u, y.low")],
        op: "upsample_bilinear",
        case: "20 to 40",
        by_hand: false,
    },
    Fault {
        what: "the means of red and green exchanged",
        file: "crop_resize/quads",
        changes: &[("params.shift_r, params.shift_g", "params.shift_g, params.shift_r")],
        op: "crop_resize",
        case: "each channel its mean and deviation, by hand",
        by_hand: true,
    },
    Fault {
        what: "a pixel past the filter's end counted",
        file: "crop_resize/quads",
        changes: &[("vec4(columns.end)", "vec4(columns.end + 1u)")],
        op: "crop_resize",
        case: "5x5 inside 7x6 to 3, PyTorch's numbers",
        by_hand: true,
    },
    Fault {
        what: "of pixels of three bytes the third taken for the fourth",
        file: "shared/pixels",
        changes: &[("bytes.z >> 8u", "(bytes.y >> 16u) | (bytes.z << 16u)")],
        op: "crop_resize",
        case: "four pixels to one, Bgr8, by hand",
        by_hand: true,
    },
    Fault {
        what: "blue first taken for red first",
        file: "shared/pixels",
        changes: &[("(format & 1u) == 1u", "(format & 1u) == 2u")],
        op: "crop_resize",
        case: "Bgr8 by hand",
        by_hand: true,
    },
    Fault {
        what: "quads side by side taken as one below the other",
        file: "shared/quads",
        changes: &[("let width = map.columns * map.pitch", "let width = map.pitch")],
        op: "spatial_pool",
        case: "quads side by side",
        by_hand: false,
    },
    Fault {
        what: "infinities taken for numbers",
        file: "not_finite",
        changes: &[(
            "(bits(at, start + i) & EXPONENT) == EXPONENT",
            "(bits(at, start + i) & 0x7fffffffu) > EXPONENT",
        )],
        op: "not_finite",
        case: "each kind of number by hand",
        by_hand: true,
    },
    Fault {
        what: "rows behind the count looked at",
        file: "not_finite",
        changes: &[("min(count[", "max(count[")],
        op: "not_finite",
        case: "two rows of three by hand",
        by_hand: true,
    },
    Fault {
        what: "a mean summed by one invocation",
        file: "global_avg_pool/planar",
        changes: &[(
            "for (var i = local; i < params.area; i += WORKGROUP)",
            "for (var i = 0u; i < select(0u, params.area, local == 0u); i++)",
        )],
        op: "global_avg_pool",
        case: "one third everywhere",
        by_hand: false,
    },
    Fault {
        what: "a mean summed by one invocation",
        file: "channel_pool/planar",
        changes: &[(
            "for (var i = local; i < params.area; i += WORKGROUP)",
            "for (var i = 0u; i < select(0u, params.area, local == 0u); i++)",
        )],
        op: "channel_pool",
        case: "one third everywhere",
        by_hand: false,
    },
    Fault {
        what: "the kernel's height and width exchanged",
        file: "conv2d/planar",
        changes: &[
            ("ky < params.kernel_height", "ky < params.kernel_width"),
            ("kx < params.kernel_width", "kx < params.kernel_height"),
        ],
        op: "conv2d",
        case: "1x3 by hand",
        by_hand: true,
    },
    Fault {
        what: "the maximum of the first 64 columns alone",
        file: "softmax",
        changes: &[("i = lane + WORKGROUP; i < columns;", "i = lane + WORKGROUP; i < 64u;")],
        op: "softmax",
        case: "the highest behind 64 columns by hand",
        by_hand: true,
    },
    Fault {
        what: "the index's last byte does not count",
        file: "top_k",
        changes: &[("digit < bound(7u", "digit < bound(6u")],
        op: "top_k",
        case: "ties to the last byte by hand",
        by_hand: true,
    },
    Fault {
        what: "an output has its neighbour's weights, where they are read from one address",
        file: "conv2d/direct",
        changes: &[("weight[at], weight[at + 1u]", "weight[at], weight[at]")],
        op: "conv2d",
        case: "two channels to three by hand",
        by_hand: true,
    },
    Fault {
        what: "a ReLU that makes a NaN zero",
        file: "shared/relu",
        changes: &[("select(x, vec4<f32>(0.0), x < vec4<f32>(0.0))", "max(x, vec4<f32>(0.0))")],
        op: "conv2d",
        case: "a NaN goes through the ReLU",
        by_hand: true,
    },
    Fault {
        what: "room for 1023 hidden units",
        file: "channel_gate",
        changes: &[("CAPACITY: u32 = 1024u", "CAPACITY: u32 = 1023u")],
        op: "channel_gate",
        case: "the last of 1024 hidden units by hand",
        by_hand: true,
    },
    Fault {
        what: "what is read planar has three channels of four",
        file: "convert",
        changes: &[
            ("fn to_planar", "fn to_planar"),
            ("min(map.channels - q * 4u, 4u)", "min(map.channels - q * 4u, 3u)"),
        ],
        op: "max_pool2d",
        case: "nine channels by hand",
        by_hand: false,
    },
    Fault {
        what: "a class is among the others that it is held against",
        file: "decode_detections",
        changes: &[("* params.scale), 0.0, i == own)", "* params.scale), 0.0, false)")],
        op: "decode_detections",
        case: "by hand",
        by_hand: true,
    },
    Fault {
        what: "the deviations of width and height exchanged",
        file: "decode_detections",
        changes: &[
            ("params.weight_width", "params.weight_height"),
            ("params.weight_height,\n    );", "params.weight_width,\n    );"),
        ],
        op: "decode_detections",
        case: "four weights by hand",
        by_hand: true,
    },
    Fault {
        what: "the means of red and green exchanged",
        file: "crop_resize/planar",
        changes: &[("params.shift_r, params.shift_g", "params.shift_g, params.shift_r")],
        op: "crop_resize",
        case: "each channel its mean and deviation, by hand",
        by_hand: true,
    },
    Fault {
        what: "the least height holds for the width",
        file: "nms",
        changes: &[("box.z - box.x >= params.min_size", "box.w - box.y >= params.min_size")],
        op: "nms",
        case: "least width and height by hand",
        by_hand: true,
    },
    Fault {
        what: "boxes of the least width are too small",
        file: "nms",
        changes: &[("box.z - box.x >= params.min_size", "box.z - box.x > params.min_size")],
        op: "nms",
        case: "least width and height by hand",
        by_hand: true,
    },
    Fault {
        what: "a dropped box drops others",
        file: "nms",
        changes: &[
            ("if ((out | word) & (1u << bit)) == 0u {", "if true {"),
            (
                "survivors |= 1u << bit;",
                "survivors |= select(1u << bit, 0u, ((out | word) & (1u << bit)) != 0u);",
            ),
        ],
        op: "nms",
        case: "a chain by hand",
        by_hand: true,
    },
    Fault {
        what: "the first layer's bias subtracted",
        file: "channel_gate",
        changes: &[("dot + fc1_bias[row]", "dot - fc1_bias[row]")],
        op: "channel_gate",
        case: "the first layer's bias by hand",
        by_hand: true,
    },
    Fault {
        what: "every second channel with the weights of the one before",
        file: "conv2d/planar",
        changes: &[("n1 = fma(n, vec4<f32>(u.y), n1)", "n1 = fma(n, vec4<f32>(u.x), n1)")],
        op: "conv2d",
        case: "two channels to three by hand",
        by_hand: true,
    },
    Fault {
        what: "channels as far apart as a square",
        file: "max_pool2d/planar",
        changes: &[(
            "channel * params.in_height * params.in_width",
            "channel * params.in_height * params.in_height",
        )],
        op: "max_pool2d",
        case: "two channels, not square, by hand",
        by_hand: true,
    },
    Fault {
        what: "the first channel for all",
        file: "upsample_bilinear/planar",
        changes: &[("(channel * params.in_height + y.low)", "(y.low)")],
        op: "upsample_bilinear",
        case: "two channels by hand",
        by_hand: true,
    },
    Fault {
        what: "clipped to a square",
        file: "decode_proposals",
        changes: &[(
            "params.picture_width, params.picture_height",
            "params.picture_width, params.picture_width",
        )],
        op: "decode_proposals",
        case: "clipped on all sides by hand",
        by_hand: true,
    },
    Fault {
        what: "a box's upper edge for its left one",
        file: "shared/boxes",
        changes: &[("max(a.xy, b.xy)", "max(a.yy, b.xy)")],
        op: "nms",
        case: "shifted both ways, and apart, by hand",
        by_hand: true,
    },
    Fault {
        what: "boxes that lie apart overlap by a pixel",
        file: "shared/boxes",
        changes: &[("max(a.xy, b.xy), vec2<f32>(0.0)", "max(a.xy, b.xy), vec2<f32>(-1.0)")],
        op: "nms",
        case: "shifted both ways, and apart, by hand",
        by_hand: true,
    },
    Fault {
        what: "a box to the left of the picture keeps a negative corner",
        file: "shared/boxes",
        changes: &[("clamp(centre + half, vec2<f32>(0.0)", "clamp(centre + half, vec2<f32>(-1.0)")],
        op: "decode_proposals",
        case: "outside the picture by hand",
        by_hand: true,
    },
    Fault {
        what: "every fourth product left out",
        file: "shared/products",
        changes: &[(" + w.a.w * x[3]", "")],
        op: "conv2d",
        case: "dot products of condition 1e4, exact",
        by_hand: true,
    },
    Fault {
        what: "stride and dilation exchanged",
        file: "conv2d/planar",
        changes: &[(
            "oy * params.stride + ky * params.dilation",
            "oy * params.dilation + ky * params.stride",
        )],
        op: "conv2d",
        case: "stride, dilation, padding and channels by hand",
        by_hand: true,
    },
    Fault {
        what: "a padding of one row less",
        file: "conv2d/planar",
        changes: &[(
            "ky * params.dilation - params.padding",
            "ky * params.dilation - params.padding + 1u",
        )],
        op: "conv2d",
        case: "stride, dilation, padding and channels by hand",
        by_hand: true,
    },
    Fault {
        what: "of stride 2, the second tap begins a pixel early",
        file: "conv2d/direct",
        changes: &[("SECOND: u32 = PIXELS + 1u", "SECOND: u32 = PIXELS")],
        op: "conv2d",
        case: "3x3 stride 2 of odd sizes",
        by_hand: false,
    },
    Fault {
        what: "of a dilated kernel, pixels are stored side by side",
        file: "conv2d/direct",
        changes: &[("first_at + j * spacing", "first_at + j")],
        op: "conv2d",
        case: "3x3 dilation 2, as the fusion",
        by_hand: false,
    },
    Fault {
        what: "every picture of a batch reads the first",
        file: "conv2d/direct",
        changes: &[("texel(params.input, picture, quad", "texel(params.input, 0u, quad")],
        op: "conv2d",
        case: "3x3 of prime sizes",
        by_hand: false,
    },
    Fault {
        what: "tiles without their padding",
        file: "conv2d/winograd_input",
        changes: &[("/ params.tile_columns * 4u - 1u", "/ params.tile_columns * 4u")],
        op: "conv2d",
        case: "3 × 3 taps of condition 1e4, exact",
        by_hand: true,
    },
    Fault {
        what: "sums kept in f16",
        file: "conv2d/planar",
        changes: &[(
            "near_sums[0] += n0;",
            "let h = near_sums[0] + n0; near_sums[0] = vec4<f32>(\
             unpack2x16float(pack2x16float(h.xy)), unpack2x16float(pack2x16float(h.zw)));",
        )],
        op: "conv2d",
        case: "3x3 of prime sizes",
        by_hand: false,
    },
    Fault {
        what: "no maximum subtracted",
        file: "softmax",
        changes: &[(
            "highest = tree_sum_max(lane, vec2<f32>(0.0, highest), 1u).y;",
            "highest = 0.0;",
        )],
        op: "softmax",
        case: "±1e4 by hand",
        by_hand: true,
    },
    Fault {
        what: "the exponential of a positive number",
        file: "shared/sigmoid",
        changes: &[("exp(-abs(x))", "exp(-x)")],
        op: "decode_proposals",
        case: "logits of ±88, ±104, ±1e3 by hand",
        by_hand: true,
    },
    Fault {
        what: "NaN found by comparing values",
        file: "not_finite",
        changes: &[(
            "(bits(at, start + i) & EXPONENT) == EXPONENT",
            "bitcast<f32>(bits(at, start + i)) != bitcast<f32>(bits(at, start + i))",
        )],
        op: "not_finite",
        case: "each kind of number by hand",
        by_hand: true,
    },
    Fault {
        what: "of equal scores the later first",
        file: "top_k",
        changes: &[("positions[a] < positions[b]", "positions[a] > positions[b]")],
        op: "top_k",
        case: "by hand",
        by_hand: true,
    },
    Fault {
        what: "a delta that is not finite makes a box at the picture's edge",
        file: "shared/boxes",
        changes: &[(
            "select(bitcast<vec2<u32>>(low), vec2<u32>(QUIET_NAN), lost)",
            "bitcast<vec2<u32>>(low)",
        )],
        op: "decode_proposals",
        case: "deltas that are not finite, by hand",
        by_hand: true,
    },
    Fault {
        what: "equality at the threshold drops a box",
        file: "shared/boxes",
        changes: &[("return overlap > rounded(", "return overlap >= rounded(")],
        op: "nms",
        case: "at the threshold of 1/2 by hand",
        by_hand: true,
    },
    Fault {
        what: "an area that grows with the distance from the origin",
        file: "shared/boxes",
        changes: &[("rounded(b.z - b.x, zero)", "rounded(b.z + b.x, zero)")],
        op: "nms",
        case: "a chain by hand",
        by_hand: true,
    },
    Fault {
        what: "boxes of higher classes vote too",
        file: "box_voting",
        changes: &[("classes[j] == classes[own]", "classes[j] >= classes[own]")],
        op: "box_voting",
        case: "another class by hand",
        by_hand: true,
    },
    Fault {
        what: "a vote of any overlap past the threshold weighs as its score",
        file: "box_voting",
        changes: &[(
            "score * (iou(box, boxes[j]) - params.iou_threshold) * scale",
            "select(0.0, score, iou(box, boxes[j]) > params.iou_threshold)",
        )],
        op: "box_voting",
        case: "by hand",
        by_hand: true,
    },
    Fault {
        what: "the kept box has no vote",
        file: "box_voting",
        changes: &[("var total = max(scores[own], 0.0);", "var total = 0.0;")],
        op: "box_voting",
        case: "by hand",
        by_hand: true,
    },
    Fault {
        what: "the kept box votes twice",
        file: "box_voting",
        changes: &[("if j != own && ", "if ")],
        op: "box_voting",
        case: "by hand",
        by_hand: true,
    },
    Fault {
        what: "a row a candidate, where two share one",
        file: "box_voting",
        changes: &[("rows[j / params.share *", "rows[j *")],
        op: "box_voting",
        case: "a row for two by hand",
        by_hand: true,
    },
    Fault {
        what: "scores below 0 vote",
        file: "box_voting",
        changes: &[(" && score > 0.0", "")],
        op: "box_voting",
        case: "no scores by hand",
        by_hand: true,
    },
    Fault {
        what: "an overlap that the union counts twice",
        file: "shared/boxes",
        changes: &[(" - shared_area;", ";")],
        op: "box_voting",
        case: "by hand",
        by_hand: true,
    },
];

/// Faults that a case in f16 notices. All but the last are in how f16 is stored, of which f32 sees nothing.
const HALF_FAULTS: &[Fault] = &[
    Fault {
        what: "what f16 cannot hold cut off instead of rounded",
        file: "shared/texels",
        changes: &[("0xfffu", "0u")],
        op: "upsample_bilinear",
        case: "prime sizes",
        by_hand: false,
    },
    Fault {
        what: "channels of a texel exchanged, two and two",
        file: "shared/texels",
        changes: &[("half.xz | (half.yw", "half.yw | (half.xz")],
        op: "conv2d",
        case: "two channels to three by hand",
        by_hand: false,
    },
    Fault {
        what: "the first two channels of a texel read for the others",
        file: "shared/texels",
        changes: &[("unpack2x16float(texel.y)", "unpack2x16float(texel.x)")],
        op: "max_pool2d",
        case: "as after conv1, primes",
        by_hand: false,
    },
    Fault {
        what: "sums without the power of two of their weights",
        file: "conv2d/direct",
        changes: &[(" * scale[out_quad]", "")],
        op: "conv2d",
        case: "two channels to three by hand",
        by_hand: false,
    },
    Fault {
        what: "sums without the power of two of their weights",
        file: "linear/gemm",
        changes: &[("= scale[column]", "= 1.0")],
        op: "linear",
        case: "primes",
        by_hand: false,
    },
    Fault {
        what: "sums in f16",
        file: "conv2d/direct",
        changes: &[(
            "total = join(total, part);",
            "total = join(total, part);
            for (var i = 0u; i < 4u + none; i++) {
                let sum = total.a[i];
                total.a[i] = vec4<f32>(
                    unpack2x16float(pack2x16float(sum.xy)),
                    unpack2x16float(pack2x16float(sum.zw)),
                );
            }",
        )],
        op: "conv2d",
        case: "512 to 512 at 10 × 10, 3 × 3",
        by_hand: false,
    },
];

impl Fault {
    fn replacement(&self) -> Replacement {
        let sources = mutate::sources();
        let (_, text) = sources.iter().find(|(file, _)| file == self.file).expect("a shader");
        let (mut text, mut at) = (text.clone(), 0);
        for (from, to) in self.changes {
            let found = text[at..].find(from);
            at += found.unwrap_or_else(|| panic!("{}: no `{from}`", self.file));
            text.replace_range(at..at + from.len(), to);
        }
        Replacement { file: self.file.into(), text }
    }
}

#[test]
fn each_fault_is_noticed_by_its_case() {
    let mut missed = Vec::new();
    for fault in FAULTS {
        let cases = (find(fault.op).expect("an operation").cases)();
        let case = cases.iter().find(|c| c.name == fault.case);
        let case = case.unwrap_or_else(|| panic!("{} has no case `{}`", fault.op, fault.case));
        let expected = Expected::of(case).expect("a reference");
        let mutated = gpu().with_replacement(fault.replacement());
        let report = check_expected(&mutated, &expected, &case.inputs);
        let shows = |failure: &String| !fault.by_hand || failure.contains(": kernel by hand: ");
        if !report.expect("a run").failures.iter().any(shows) {
            missed.push(format!("{}: {}", fault.file, fault.what));
        }
    }
    assert!(missed.is_empty(), "not noticed:\n{}", missed.join("\n"));
}

#[test]
fn each_fault_in_f16_is_noticed_by_its_case() {
    let mut missed = Vec::new();
    for (at, fault) in HALF_FAULTS.iter().enumerate() {
        let target = Target::Gpu(gpu().with_replacement(fault.replacement()));
        let failures = |precision| -> Vec<String> {
            let selection = Selection {
                case: Some(fault.case.into()),
                precision: Some(precision),
                ..Selection::default()
            };
            let entry = find(fault.op).expect("an operation");
            let rows = rows(&target, entry, &selection).expect("a case of this name");
            rows.into_iter().flat_map(|row| row.failures).collect()
        };
        let (half, single) = (failures(Precision::F16), failures(Precision::F32));
        // The last shows in f32 too.
        if half.is_empty() || (!single.is_empty() && at + 1 < HALF_FAULTS.len()) {
            missed.push(format!("{}: {}: f32: {single:?}", fault.file, fault.what));
        }
    }
    assert!(missed.is_empty(), "not noticed:\n{}", missed.join("\n"));
}

/// The table for people has them all.
#[test]
fn each_fault_is_in_the_table() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/internals/mutants.md");
    let table = std::fs::read_to_string(path).expect("docs/internals/mutants.md");
    let faults = FAULTS.iter().map(|fault| (fault, ""));
    for (fault, precision) in faults.chain(HALF_FAULTS.iter().map(|fault| (fault, ", in f16"))) {
        let Fault { what, file, op, case, by_hand, .. } = fault;
        let by_hand = if *by_hand { "yes |" } else { "|" };
        let row = format!("| {what} | {file} | {op}: {case}{precision} | {by_hand}");
        assert!(
            table.lines().any(|line| line == row),
            "expected in docs/internals/mutants.md:\n{row}"
        );
    }
}

/// A mutant of each shader file; `cargo run --release --example mutants` runs more of them, and
/// docs/internals/mutants.md lists what became of them.
#[test]
fn a_mutant_of_each_shader_is_noticed() {
    let mut missed = Vec::new();
    // The roof measures speed: its values are of no use to anybody. A hidden bound adds a 0, which may as well be
    // subtracted. An input is one load, of which nothing can be changed.
    let none = ["roof", "shared/bound", "shared/input"];
    let counts = |(file, _): &(String, String)| !none.contains(&file.as_str());
    for (file, text) in mutate::sources().into_iter().filter(counts) {
        let mutant = first_sure(&file, &text);
        let mutated = gpu().with_replacement(mutant.replacement());
        let mut noticed = false;
        for op in mutate::users(&file) {
            let mut cases = (op.cases)();
            cases.sort_by_key(|c| c.inputs.iter().map(|v| v.bytes().len()).sum::<usize>());
            let fails = |case: &Case| match check(&mutated, case) {
                Ok(report) => !report.failures.is_empty(),
                Err(_) => true,
            };
            noticed = noticed || cases.iter().any(fails);
        }
        if !noticed {
            missed.push(mutant.to_string());
        }
    }
    assert!(missed.is_empty(), "not noticed:\n{}", missed.join("\n"));
}

/// Faults that change no output, and why: the line with the fault, or the line that is `removed`.
const EQUIVALENT: &[(&str, &str, &str)] = &[
    (
        "shared/texels",
        "let normal = ((size + 0xfffu + ((size << vec4<u32>(13u)) & vec4<u32>(1u))) >> vec4<u32>(13u))",
        "of two f16 that are as near it takes the one nearer to zero, within every bound",
    ),
    (
        "shared/texels",
        "let normal = ((size + 4094u + ((size >> vec4<u32>(13u)) & vec4<u32>(1u))) >> vec4<u32>(13u))",
        "likewise",
    ),
    (
        "shared/pixels",
        "let last_word = arrayLength(&picture) - 0u;",
        "no colour has bits of the word behind the picture's, and reading it is caught by bounds checks",
    ),
    (
        "shared/pixels",
        "let last_word = arrayLength(&picture) - 2u;",
        "a case's buffer has guard words behind the picture's, which this counts too",
    ),
    (
        "max_pool2d/planar",
        "return (bitcast<u32>(x) & 0x7fffffffu) > 2139095041u;",
        "one signalling NaN counts as a number, which no arithmetic makes",
    ),
    (
        "max_pool2d/quads",
        "let quads = vec2(2u * workgroup.y, min(2u * workgroup.y - 1u, to.quads - 1u));",
        "each pair has the quad before its second; the first pair has the last",
    ),
    (
        "crop_resize/quads",
        "if x > map.width || y >= map.height {",
        "an end that saves work: texels behind the width are padding, and `store` looks at each row",
    ),
    ("crop_resize/quads", "if x >= map.width && y >= map.height {", "likewise"),
    ("crop_resize/quads", "return; removed", "likewise: the only one there"),
    (
        "channel_gate",
        "let none = select(0u, 0u, workgroups.x == 0u);",
        "a 0 that compilers must not know",
    ),
    (
        "shared/reduce",
        "if local <= half {",
        "a word behind those that are summed changes; a race where lanes do not go in step",
    ),
    (
        "top_k",
        "return keys[a] > keys[b] || (keys[a] == keys[b] && positions[a] <= positions[b]);",
        "no two elements are equal but the padding",
    ),
];

/// Whether a variant that this adapter runs has the fault: not all are for its size of subgroups.
fn is_run(mutant: &mutate::Mutant) -> bool {
    let replacement = mutant.replacement();
    let has = |stem: &str| stem == mutant.file || mutant.file.starts_with("shared/");
    let mut variants = shaders(gpu().caps()).into_iter().filter(|(shader, _)| has(shader.stem));
    variants.any(|(shader, variant)| {
        let text = reflect(shader, &variant).expect("a shader").text;
        reflect_replaced(shader, &variant, &replacement).map_or(true, |faulty| faulty.text != text)
    })
}

/// One that surely ends: no fault in a loop's head or in what it counts.
fn first_sure(file: &str, text: &str) -> mutate::Mutant {
    let candidates = mutate::chosen(file, text, 1, 8);
    let ends = |m: &&mutate::Mutant| {
        let heads = ["for ", "const ", "workgroupBarrier"];
        !heads.iter().any(|head| m.before.starts_with(head))
    };
    let changes = |m: &&mutate::Mutant| {
        let removed = format!("{} removed", m.before);
        let now = if m.after.is_empty() { &removed } else { &m.after };
        !EQUIVALENT.iter().any(|(file, after, _)| m.file == *file && now == after)
    };
    let found = candidates.iter().filter(ends).filter(changes).find(|m| is_run(m));
    found.unwrap_or_else(|| panic!("{file} has no such mutant")).clone()
}
