//! Tables of `tradeoff`: any bytes end with a setup that keeps to its limit, or with an error.

use smr_gpu::evaluation::tradeoff::{Limit, Table};

/// Reads the bytes, and chooses from the table.
pub fn run(data: &[u8]) {
    let table = match Table::parse(data) {
        Ok(table) => table,
        Err(message) => return assert!(!message.is_empty()),
    };
    assert!(table.front().len() <= table.rows.len());
    for limit in [0.0, 0.1, 1e9].map(Limit::ShiftMm).into_iter().chain([Limit::Iou(0.9)]) {
        match (table.choose(limit), limit) {
            (Ok(row), Limit::ShiftMm(most)) => {
                assert!(row.setup.batch <= 1 && row.shift_mm() <= most)
            }
            (Ok(row), Limit::Iou(least)) => {
                assert!(row.quality.is_some_and(|quality| quality.iou >= least));
            }
            (Err(error), _) => assert!(!error.to_string().is_empty()),
        }
    }
    for row in &table.rows {
        assert!(!row.setup.name().is_empty());
        // Whatever was measured there.
        let _ = table.check(&row.setup, table.place.as_ref(), "0");
    }
}
