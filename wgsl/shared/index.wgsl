// Linear index of an invocation in a grid that `Grid::linear` may have folded to two dimensions.
fn linear_index(workgroup: vec3<u32>, workgroups: vec3<u32>, local: u32, size: u32) -> u32 {
    return (workgroup.y * workgroups.x + workgroup.x) * size + local;
}
