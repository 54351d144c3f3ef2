//! Rows by index.

/// The rows of `columns` elements that `indices` name, one behind the other; an index past the end
/// names the last row.
pub fn gather_rows<T: Copy>(rows: &[T], columns: usize, indices: &[u32]) -> Vec<T> {
    let last = rows.len() / columns - 1;
    indices
        .iter()
        .flat_map(|i| &rows[last.min(*i as usize) * columns..][..columns])
        .copied()
        .collect()
}
