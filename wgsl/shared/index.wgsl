// Linear index of an invocation in a grid that `Grid::linear` or `indirect_grid` may have folded: rows of
// as many workgroups as a dimension may have, or one shorter row.
fn linear_index(workgroup: vec3<u32>, local: u32, size: u32) -> u32 {
    return (workgroup.y * 65535u + workgroup.x) * size + local;
}
