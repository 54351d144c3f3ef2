// The filter of `crop_resize`, along one axis. Needs its `params.capacity` and `crop`.
//
// A triangle, widened where the picture shrinks. A part of `side` pixels becomes `size`; distances are
// counted in 1 / (2 size) of a picture's pixel: pixel j has its centre at (2j + 1) size, output i at
// (2i + 1) side, and the triangle reaches 2 max(side, size). All are integers, so that each weight is
// exact.

// An axis of the part: its pixels, the pixels it is resized to, and where the window begins.
struct Axis {
    side: u32,
    size: u32,
    window: u32,
}

// The crop is data: no side is longer than the picture's, nor than the buffer, and none is nothing.
fn axis(which: u32) -> Axis {
    let side = min(crop[4u + which], min(crop[which], params.capacity));
    return Axis(side, max(crop[6u + which], 1u), crop[8u + which]);
}

// The pixels first..end of the part, along one axis, that one output sees.
struct Taps {
    size: u32,
    centre: u32,
    reach: u32,
    first: u32,
    end: u32,
}

fn taps(along: Axis, output_at: u32) -> Taps {
    let size = along.size;
    let i = min(output_at + along.window, size - 1u);
    let centre = (2u * i + 1u) * along.side;
    let reach = 2u * max(along.side, size);
    var first = 0u;
    if centre >= reach + size {
        first = (centre - reach - size) / (2u * size) + 1u;
    }
    let end = min((centre + reach + size - 1u) / (2u * size), along.side);
    return Taps(size, centre, reach, first, end);
}

// The weight of pixel `j`, zero past the triangle's reach.
fn weight(t: Taps, j: u32) -> f32 {
    let at = (2u * j + 1u) * t.size;
    let distance = max(at, t.centre) - min(at, t.centre);
    return f32(t.reach - min(distance, t.reach));
}

fn total_weight(t: Taps) -> f32 {
    var total = 0.0;
    for (var j = t.first; j < t.end; j++) {
        total += weight(t, j);
    }
    return total;
}
