// The map that a kernel reads over and over: with TEXTURE a texture, else a buffer. Software adapters load texels
// faster, and are given a copy; a GPU gains too little from them to wait for one.

#if TEXTURE
@group(0) @binding(1) var input: TexelTexture;

/// What lies at a column and a row.
fn input_at(map: Quads, at: vec2<u32>) -> vec4<f32> {
    return textureLoad(input, at);
}
#else
@group(0) @binding(1) var<storage, read> input: array<Texel>;

/// What lies at a column and a row.
fn input_at(map: Quads, at: vec2<u32>) -> vec4<f32> {
    return loaded(input[texel_index(map, at)]);
}
#endif
