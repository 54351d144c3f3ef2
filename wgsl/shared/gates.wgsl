// CBAM's spatial gates of some pixels, for all of a workgroup: the logistic function of a 7x7 convolution of the two
// pooled maps, padding 3, with bias. The including shader declares `pooled`, `weight` and `bias`.
//
// An invocation computes a span, 8 neighbouring pixels of a row, and slides a window of 8 values along it, so that
// each value and each weight is loaded once for 8 outputs. The values of a row are loaded at once: a GPU waits as
// long for one as for all.

// Spans of a workgroup.
const SPANS: u32 = 64u;

// Of each pixel of the workgroup's spans; those behind a row's end are no gates.
var<workgroup> gates: array<f32, 8u * SPANS>;

struct Pooled {
    width: u32,
    height: u32,
    // Where the picture's maps begin.
    first: u32,
    // Always 0: bounds that the compiler does not know keep it from unrolling loops.
    zero: u32,
}

// Spans of a row.
fn spans(width: u32) -> u32 {
    return (width + 7u) / 8u;
}

// Column `x` of the row that starts at `row`, zero outside; `x` below zero wraps to a large number.
fn value(map: Pooled, row: u32, x: u32) -> f32 {
    let inside = x < map.width;
    return select(0.0, pooled[row + select(0u, x, inside)], inside);
}

// Four columns from `x` on.
fn four_values(map: Pooled, row: u32, x: u32) -> vec4<f32> {
    return vec4<f32>(
        value(map, row, x),
        value(map, row, x + 1u),
        value(map, row, x + 2u),
        value(map, row, x + 3u),
    );
}

// Leaves the gates of span `index` of the map, if there is one, behind each other from 8 * local on. All of a
// workgroup call it.
fn find_gates(map: Pooled, index: u32, local: u32) {
    let spans_of_row = spans(map.width);
    if index < map.height * spans_of_row {
        let y = index / spans_of_row;
        let x = (index - y * spans_of_row) * 8u;
        var left = vec4<f32>(bias[0]);
        var right = left;
        for (var plane = 0u; plane < bound(2u, map.zero); plane++) {
            for (var ky = 0u; ky < bound(7u, map.zero); ky++) {
                let iy = y + ky - 3u;
                if iy >= map.height {
                    continue;
                }
                let row = map.first + (plane * map.height + iy) * map.width;
                let taps = (plane * 7u + ky) * 7u;
                var near = four_values(map, row, x - 3u);
                var far = four_values(map, row, x + 1u);
                var next = four_values(map, row, x + 5u);
                // Of the last four only two are in reach.
                let last = vec2<f32>(value(map, row, x + 9u), value(map, row, x + 10u));
                var behind = vec4<f32>(last, 0.0, 0.0);
                for (var kx = 0u; kx < bound(7u, map.zero); kx++) {
                    let tap = vec4<f32>(weight[taps + kx]);
                    left = fma(tap, near, left);
                    right = fma(tap, far, right);
                    near = vec4<f32>(near.yzw, far.x);
                    far = vec4<f32>(far.yzw, next.x);
                    next = vec4<f32>(next.yzw, behind.x);
                    behind = vec4<f32>(behind.yzw, 0.0);
                }
            }
        }
        for (var i = 0u; i < bound(4u, map.zero); i++) {
            gates[8u * local + i] = sigmoid(left[i]);
            gates[8u * local + 4u + i] = sigmoid(right[i]);
        }
    }
    workgroupBarrier();
}

// A pixel of a workgroup's spans.
struct Pixel {
    x: u32,
    y: u32,
    exists: bool,
    gate: f32,
}

// Pixel `at` of the workgroup's spans, of which the first is `first_span`.
fn pixel(map: Pooled, first_span: u32, at: u32) -> Pixel {
    let spans_of_row = spans(map.width);
    let span = first_span + at / 8u;
    let y = span / spans_of_row;
    let x = (span - y * spans_of_row) * 8u + at % 8u;
    return Pixel(x, y, (y < map.height) & (x < map.width), gates[at]);
}
