// A texel of four channels as maps are stored: with HALF those that are read, with HALF_OUTPUT the one
// that is written, are four f16.

#if HALF
alias Texel = vec2<u32>;
alias TexelTexture = texture_storage_2d<rgba16float, read>;

fn loaded(texel: Texel) -> vec4<f32> {
    return vec4<f32>(unpack2x16float(texel.x), unpack2x16float(texel.y));
}
#else
alias Texel = vec4<f32>;
alias TexelTexture = texture_storage_2d<rgba32float, read>;

fn loaded(texel: Texel) -> vec4<f32> {
    return texel;
}
#endif

#if HALF_OUTPUT
alias OutputTexel = vec2<u32>;

// Rounds to the nearest, of two to the even one, on every device: WGSL leaves the direction to
// `pack2x16float`, and what it makes of numbers past 65504, which are infinite here.
fn stored(value: vec4<f32>) -> OutputTexel {
    let bits = bitcast<vec4<u32>>(value);
    let size = bits & vec4<u32>(0x7fffffffu);
    // The exponent's offset is 127 there and 15 here.
    let normal = ((size + 0xfffu + ((size >> vec4<u32>(13u)) & vec4<u32>(1u))) >> vec4<u32>(13u))
        - 0x1c000u;
    // The last digit of 0.5 is the smallest f16, so that the sum rounds as it should.
    let small = bitcast<vec4<u32>>(bitcast<vec4<f32>>(size) + 0.5) - 0x3f000000u;
    var half = select(normal, small, size < vec4<u32>(0x38800000u));
    // 65520, and behind infinity what is not a number.
    half = select(half, vec4<u32>(0x7c00u), size >= vec4<u32>(0x477ff000u));
    half = select(half, vec4<u32>(0x7e00u), size > vec4<u32>(0x7f800000u));
    half |= (bits >> vec4<u32>(16u)) & vec4<u32>(0x8000u);
    return half.xz | (half.yw << vec2<u32>(16u));
}
#else
alias OutputTexel = vec4<f32>;

fn stored(value: vec4<f32>) -> OutputTexel {
    return value;
}
#endif
