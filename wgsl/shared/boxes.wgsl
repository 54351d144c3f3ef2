// Boxes are (x1, y1, x2, y2) in pixels of the network's input.

fn box_area(b: vec4<f32>) -> f32 {
    return (b.z - b.x) * (b.w - b.y);
}

// Whether the intersection over union is above `threshold`; equality is not, as in torchvision.
// Without a division, which WGSL lets be 2.5 ULP off.
fn iou_above(a: vec4<f32>, b: vec4<f32>, threshold: f32) -> bool {
    let size = max(min(a.zw, b.zw) - max(a.xy, b.xy), vec2<f32>(0.0));
    let common = size.x * size.y;
    return common > threshold * (box_area(a) + box_area(b) - common);
}
