// Which tiles of a frame are in contact, a bit each: cells [3, H, W] in levels to words of 32 tiles.
//
// `differences` computes by how much each tile of 2 x 2 cells differs from its surroundings, an
// invocation a tile. `words`, one workgroup, finds the limit for all of them and compares.

// include: bound
// include: index

const TILE: u32 = 2u;
const LEVEL: f32 = 128.0;
const DARK: f32 = 16.0;
const STEPS: u32 = 32u;
const HIDDEN: f32 = 1e9;
const LANES: u32 = 256u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cells: array<f32>;
// The cells themselves where there is none.
@group(0) @binding(2) var<storage, read> reference: array<f32>;
@group(0) @binding(3) var<storage, read_write> of_tile: array<f32>;
@group(0) @binding(4) var<storage, read_write> output: array<u32>;

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

// By what share a cell differs from the middle of two others.
fn difference(channel: u32, x: i32, y: i32, dx: i32, dy: i32) -> f32 {
    let middle = (level(channel, x + dx, y + dy) + level(channel, x - dx, y - dy)) / 2.0;
    return abs(level(channel, x, y) - middle) / max(middle, DARK);
}

fn of_cell(x: u32, y: u32) -> f32 {
    let at = vec2(i32(x), i32(y));
    let reach = i32(params.reach);
    let area = params.height * params.width;
    var lowest = cells[y * params.width + x];
    var largest = 0.0;
    for (var c = 0u; c < bound(3u, params.zero); c++) {
        lowest = min(lowest, cells[c * area + y * params.width + x]);
        largest = max(largest, difference(c, at.x, at.y, reach, 0));
        largest = max(largest, difference(c, at.x, at.y, 0, reach));
        largest = max(largest, difference(c, at.x, at.y, reach, reach));
        largest = max(largest, difference(c, at.x, at.y, reach, -reach));
    }
    return select(largest, HIDDEN, lowest >= params.clipped);
}

@compute @workgroup_size(64)
fn differences(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let tile = linear_index(workgroup, local, 64u);
    if tile >= params.tiles {
        return;
    }
    let row = tile / params.columns;
    let first = vec2(tile - row * params.columns, row) * TILE;
    let end = min(first + TILE, vec2(params.width, params.height));
    var largest = 0.0;
    for (var y = first.y; y < end.y; y++) {
        for (var x = first.x; x < end.x; x++) {
            largest = max(largest, of_cell(x, y));
        }
    }
    of_tile[tile] = largest;
}

fn limit(step: u32) -> f32 {
    return params.least + (params.most - params.least) * f32(step) / f32(STEPS);
}

// How many tiles are below each limit, but not below the one before.
var<workgroup> calm: array<atomic<u32>, STEPS>;
var<workgroup> chosen: u32;

@compute @workgroup_size(LANES)
fn words(@builtin(local_invocation_index) lane: u32) {
    if lane < STEPS {
        atomicStore(&calm[lane], 0u);
    }
    workgroupBarrier();
    for (var tile = lane; tile < params.tiles; tile += LANES) {
        let needed = of_tile[tile] * params.factor;
        var step = 0u;
        while step < bound(STEPS, params.zero) && needed > limit(step) {
            step++;
        }
        if step < STEPS {
            atomicAdd(&calm[step], 1u);
        }
    }
    workgroupBarrier();
    if lane == 0u {
        var below = 0u;
        var step = 0u;
        for (; step < bound(STEPS, params.zero); step++) {
            below += atomicLoad(&calm[step]);
            if 4u * below >= params.tiles {
                break;
            }
        }
        chosen = step;
    }
    let most = limit(workgroupUniformLoad(&chosen));
    for (var at = lane; at * 32u < params.tiles; at += LANES) {
        var word = 0u;
        for (var bit = 0u; bit < min(bound(32u, params.zero), params.tiles - at * 32u); bit++) {
            if of_tile[at * 32u + bit] > most {
                word |= 1u << bit;
            }
        }
        output[at] = word;
    }
}
