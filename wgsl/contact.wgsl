// Which tiles of a frame are in contact, a bit each: cells [3, H, W] in levels to words of 32 tiles.
//
// A workgroup computes a word, an invocation a tile of 2 x 2 cells.

// include: index

struct Params {
    height: u32,
    width: u32,
    // Tiles in a row, and all of them.
    columns: u32,
    tiles: u32,
    threshold: f32,
    clipped: f32,
    // 1 where there is a reference frame.
    referenced: u32,
    // Always 0: in a loop's bound it keeps compilers from unrolling.
    zero: u32,
}

const REACH: i32 = 4;
const TILE: u32 = 2u;
const LEVEL: f32 = 128.0;
const DARK: f32 = 16.0;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cells: array<f32>;
// The cells themselves where there is none.
@group(0) @binding(2) var<storage, read> reference: array<f32>;
@group(0) @binding(3) var<storage, read_write> output: array<u32>;

var<workgroup> word: atomic<u32>;

// The level of a cell, or of the nearest one where it is past the edge.
fn level(channel: u32, x: i32, y: i32) -> f32 {
    let column = u32(clamp(x, 0, i32(params.width) - 1));
    let row = u32(clamp(y, 0, i32(params.height) - 1));
    let at = (channel * params.height + row) * params.width + column;
    let value = cells[at];
    if params.referenced == 0u {
        return value;
    }
    return value * LEVEL / max(reference[at], DARK);
}

fn difference(channel: u32, x: i32, y: i32, dx: i32, dy: i32) -> f32 {
    let middle = (level(channel, x + dx, y + dy) + level(channel, x - dx, y - dy)) / 2.0;
    return abs(level(channel, x, y) - middle);
}

// Whether a cell differs from the middle of two others, or shows nothing.
fn touched(x: u32, y: u32) -> bool {
    let at = vec2(i32(x), i32(y));
    let area = params.height * params.width;
    var lowest = cells[y * params.width + x];
    var largest = 0.0;
    for (var c = 0u; c < 3u + params.zero; c++) {
        lowest = min(lowest, cells[c * area + y * params.width + x]);
        largest = max(largest, difference(c, at.x, at.y, REACH, 0));
        largest = max(largest, difference(c, at.x, at.y, 0, REACH));
        largest = max(largest, difference(c, at.x, at.y, REACH, REACH));
        largest = max(largest, difference(c, at.x, at.y, REACH, -REACH));
    }
    return lowest >= params.clipped || largest > params.threshold;
}

@compute @workgroup_size(32)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    if local == 0u {
        atomicStore(&word, 0u);
    }
    workgroupBarrier();
    let index = linear_index(workgroup, workgroups, 0u, 1u);
    let tile = index * 32u + local;
    if tile < params.tiles {
        let row = tile / params.columns;
        let first = vec2(tile - row * params.columns, row) * TILE;
        let end = min(first + TILE, vec2(params.width, params.height));
        for (var y = first.y; y < end.y; y++) {
            for (var x = first.x; x < end.x; x++) {
                if touched(x, y) {
                    atomicOr(&word, 1u << local);
                }
            }
        }
    }
    workgroupBarrier();
    if local == 0u && index * 32u < params.tiles {
        output[index] = atomicLoad(&word);
    }
}
