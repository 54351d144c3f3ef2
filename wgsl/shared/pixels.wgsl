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

// Red, green and blue, from 0 to 255, of the bits from a pixel's first byte on.
fn of_bits(map: Pixels, bits: u32) -> vec3<u32> {
    return (vec3<u32>(bits) >> map.shifts) & vec3<u32>(255u);
}

// Red, green and blue of a pixel. Nothing is read outside the picture's buffer, whatever the
// corner says.
fn colour(map: Pixels, at: vec2<u32>) -> vec3<u32> {
    let byte = (at.y * map.width + at.x) * map.bytes;
    let low = picture[min(byte / 4u, map.last_word)];
    let high = picture[min(byte / 4u + 1u, map.last_word)];
    let shift = byte % 4u * 8u;
    // In two steps: no shift is by all bits.
    return of_bits(map, (low >> shift) | ((high << (24u - shift)) << 8u));
}

// The colours of four pixels side by side.
struct FourColours {
    a: vec3<u32>,
    b: vec3<u32>,
    c: vec3<u32>,
    d: vec3<u32>,
}

// The colours of a pixel and the three behind it, with half the loads of four `colour`: their words are read
// once. Of what lies outside the picture's buffer they are some colour.
fn four_colours(map: Pixels, at: vec2<u32>) -> FourColours {
    let byte = (at.y * map.width + at.x) * map.bytes;
    let first = byte / 4u;
    let last = map.last_word;
    let words = vec4<u32>(
        picture[min(first, last)],
        picture[min(first + 1u, last)],
        picture[min(first + 2u, last)],
        picture[min(first + 3u, last)],
    );
    // From the first pixel's first byte on. Four words are enough: only pixels of four bytes fill them, and
    // those begin with a word.
    let shift = vec4<u32>(byte % 4u * 8u);
    let bytes = (words >> shift) | ((vec4<u32>(words.yzw, 0u) << (24u - shift)) << vec4<u32>(8u));
    let of_three = vec4<u32>(
        bytes.x,
        (bytes.x >> 24u) | (bytes.y << 8u),
        (bytes.y >> 16u) | (bytes.z << 16u),
        bytes.z >> 8u,
    );
    let of_one = vec4<u32>(bytes.x) >> vec4<u32>(0u, 8u, 16u, 24u);
    let pixels = select(select(bytes, of_three, map.bytes == 3u), of_one, map.bytes == 1u);
    return FourColours(
        of_bits(map, pixels.x),
        of_bits(map, pixels.y),
        of_bits(map, pixels.z),
        of_bits(map, pixels.w),
    );
}
