// The colours of a picture whose bytes lie four a word in `picture`, row by row without gaps. `crop` says
// how wide it is, and in which format: 0 RGB, 1 BGR, 2 RGBA, 3 BGRA, 4 grey.

struct Pixels {
    width: u32,
    // Bytes of a pixel, and bits from its first one to each colour.
    bytes: u32,
    shifts: vec3<u32>,
    last_word: u32,
}

fn pixels() -> Pixels {
    let format = crop[10];
    let bytes = select(select(3u, 4u, format >= 2u), 1u, format >= 4u);
    let blue_first = (format & 1u) == 1u;
    let shifts = select(vec3<u32>(0u, 8u, 16u), vec3<u32>(16u, 8u, 0u), blue_first);
    let last_word = arrayLength(&picture) - 1u;
    return Pixels(crop[0], bytes, select(shifts, vec3<u32>(), format >= 4u), last_word);
}

// Red, green and blue of a pixel, from 0 to 255. Nothing is read outside the picture's buffer, whatever the
// corner says.
fn colour(map: Pixels, at: vec2<u32>) -> vec3<u32> {
    let byte = (at.y * map.width + at.x) * map.bytes;
    let low = picture[min(byte / 4u, map.last_word)];
    let high = picture[min(byte / 4u + 1u, map.last_word)];
    let shift = byte % 4u * 8u;
    // In two steps: no shift is by all bits.
    let four_bytes = (low >> shift) | ((high << (24u - shift)) << 8u);
    return (vec3<u32>(four_bytes) >> map.shifts) & vec3<u32>(255u);
}
