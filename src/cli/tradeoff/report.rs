//! The table of a run, as Markdown and as CSV.

use std::fmt::Write;

use smr_gpu::evaluation::tradeoff::{Measured, Spread, Table};

use super::super::output::count;

/// A Markdown table, those on the front first, then the others by time.
pub(super) fn markdown(table: &Table) -> String {
    let number = |value: Option<f64>, digits: usize| match value {
        Some(v) if v.is_finite() => format!("{v:.digits$}"),
        Some(_) => "lost".into(),
        None => "-".into(),
    };
    let spread = |s: Option<Spread>, digits: usize| match s {
        Some(s) => format!(
            "{} / {} / {}",
            number(Some(s.median), digits),
            number(Some(s.percentile_95), digits),
            number(Some(s.worst), digits)
        ),
        None => "-".into(),
    };
    let front = table.front();
    let is_front = |row: &Measured| front.iter().any(|f| f.setup == row.setup);
    let mut others: Vec<&Measured> = table.rows.iter().filter(|row| !is_front(row)).collect();
    others.sort_by(|a, b| a.wall_ms.median.total_cmp(&b.wall_ms.median));
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "{}; bold: nothing else is both faster and nearer. Shifts are from {} in f64: median / \
         95th percentile / worst.\n",
        count(table.pictures, "picture"),
        table.base.what()
    );
    text.push_str(
        "| network | run by | ms a picture: median / 95th / worst | device, ms | memory, MB | \
         stage error | shift, mm | score shift | lost | gained | IoU, % | AP50, % | centre, mm |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for row in front.iter().copied().chain(others) {
        let mark = if is_front(row) { "**" } else { "" };
        let _ = writeln!(
            text,
            "| {mark}{}{mark} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} |",
            row.setup.what(),
            row.setup.how(),
            spread(Some(row.wall_ms), 1),
            number(row.device_ms.map(|s| s.median), 1),
            number(row.peak_bytes.map(|bytes| bytes as f64 / 1e6), 0),
            row.rounding().map_or("-".into(), |e| format!("{e:.1e}")),
            spread(row.shift.mm, 4),
            number(row.shift.score.map(|s| s.worst), 4),
            row.shift.lost,
            row.shift.gained,
            number(row.quality.map(|q| q.iou * 100.0), 2),
            number(row.quality.map(|q| q.ap50 * 100.0), 2),
            number(row.quality.map(|q| q.center_error_mm), 3),
        );
    }
    text
}

/// All figures but those of single stages, a line a setup; empty where there is none.
pub(super) fn csv(table: &Table) -> String {
    let mut text = String::from(
        "weights,size,leave_out,device,kernels,batch,precision,wall_ms_median,wall_ms_95,wall_ms_worst,device_ms_median,\
         peak_bytes,stage_relative_l2,shift_mm_median,shift_mm_95,shift_mm_worst,score_shift_median,\
         score_shift_95,score_shift_worst,boxes,lost,gained,iou,ap50,center_error_mm,front\n",
    );
    let front = table.front();
    for row in &table.rows {
        let (setup, shift) = (&row.setup, &row.shift);
        let number = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
        let spread = |s: Option<Spread>| {
            [s.map(|s| s.median), s.map(|s| s.percentile_95), s.map(|s| s.worst)].map(number)
        };
        let mut cells = vec![
            quoted(&setup.weights),
            setup.size.map_or(String::new(), |size| size.to_string()),
            setup.leave_out.iter().map(|saving| saving.name()).collect::<Vec<_>>().join("+"),
            quoted(&setup.device),
            quoted(&setup.kernels.join("+")),
            setup.batch.to_string(),
            setup.precision.to_string(),
        ];
        cells.extend(spread(Some(row.wall_ms)));
        cells.push(number(row.device_ms.map(|s| s.median)));
        cells.push(row.peak_bytes.map_or(String::new(), |bytes| bytes.to_string()));
        cells.push(number(row.rounding()));
        cells.extend(spread(shift.mm));
        cells.extend(spread(shift.score));
        cells.extend([shift.boxes, shift.lost, shift.gained].map(|n| n.to_string()));
        let quality = row.quality;
        cells.push(number(quality.map(|q| q.iou)));
        cells.push(number(quality.map(|q| q.ap50)));
        cells.push(number(quality.map(|q| q.center_error_mm)));
        cells.push(front.iter().any(|f| f.setup == *setup).to_string());
        text.push_str(&cells.join(","));
        text.push('\n');
    }
    text
}

/// A cell of CSV: in quotes where it must be (RFC 4180).
fn quoted(cell: &str) -> String {
    match cell.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", cell.replace('"', "\"\"")),
        false => cell.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_quoted_where_they_must_be() {
        assert_eq!(quoted("large"), "large");
        assert_eq!(quoted("a,b"), "\"a,b\"");
        assert_eq!(quoted("say \"hi\""), "\"say \"\"hi\"\"\"");
    }
}
