//! The tables of `eval` for people.

use smr_gpu::evaluation::{Figures, LEAST_SCORE, Third, share_within};

use super::super::exit::Failure;
use super::super::message::remark;
use super::super::output::{count, line};
use super::super::printable::printable;
use super::{Labelled, Paper, Report};

/// Prints the table by class of one set.
pub(super) fn classes(report: &Report) -> Result<(), Failure> {
    let names = report.classes.iter().map(|row| printable(&row.class));
    let w = names.map(|name| name.chars().count()).max().unwrap_or(0).max(8);
    line(format!(
        "{:<w$} {:>6} {:>19} {:>19} {:>10} {:>11} {:>9} {:>7} {:>7} {:>7} {:>7}",
        "class",
        "snaps",
        "IoU, %",
        "AP50, %",
        "AP50:95, %",
        "median, mm",
        "95th, mm",
        "yaw, °",
        "95th, °",
        "right",
        "false"
    ))?;
    for row in report.classes.iter().chain([&report.all]) {
        let Figures { center_error_mm, yaw_error_deg, interval_95, .. } = &row.figures;
        line(format!(
            "{:<w$} {:>6} {:>19} {:>19} {:>10} {:>11} {:>9} {:>7} {:>7} {:>7} {:>7}",
            printable(&row.class),
            row.figures.snaps,
            percent(row.figures.mean_best_iou, interval_95.mean_best_iou),
            percent(row.figures.ap50, interval_95.ap50),
            percent(row.figures.ap50_95, None),
            number(center_error_mm.median, 3),
            number(center_error_mm.percentile_95, 3),
            number(yaw_error_deg.median, 1),
            number(yaw_error_deg.percentile_95, 1),
            row.figures.right,
            row.figures.false_alarms
        ))?;
        if let Some(Paper { mean_iou, map }) = &row.paper {
            let (iou, map) = (percent(Some(*mean_iou), None), percent(Some(*map), None));
            line(format!("{:<w$} {:>6} {iou:>19} {map:>19}", "  paper", ""))?;
        }
    }
    Ok(())
}

/// Prints a set's row of the table of several, below its head if it is the first.
pub(super) fn set_row(
    report: &Report,
    is_first: bool,
    sets: &[(String, Vec<Labelled>)],
) -> Result<(), Failure> {
    let widest = sets.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0).max(5);
    if is_first {
        head("set", widest)?;
    }
    row(&report.data, widest, &report.all.figures)
}

/// Prints the table by condition, if there are any.
pub(super) fn conditions(report: &Report) -> Result<(), Failure> {
    if report.conditions.is_empty() {
        remark("--by-condition: the labels state no conditions");
        return Ok(());
    }
    let name = |condition: &str, value: &str| format!("{condition}: {value}");
    let names = report.conditions.iter().map(|s| name(s.condition, s.value.as_str()));
    let widest = names.map(|n| n.chars().count()).max().unwrap_or(0).max(9);
    line("")?;
    head("condition", widest)?;
    for stratum in &report.conditions {
        row(&name(stratum.condition, &stratum.value), widest, &stratum.figures)?;
    }
    Ok(())
}

fn head(first: &str, widest: usize) -> Result<(), Failure> {
    let columns = [
        "pictures",
        "snaps",
        "IoU, %",
        "AP50, %",
        "centre, mm",
        "95th, mm",
        "yaw, °",
        "95th, °",
        "to light, mm",
        "false",
        "where no snap is",
    ];
    let cells = columns.iter().zip(WIDTHS).map(|(name, width)| format!(" {name:>width$} |"));
    line(format!("| {first:<widest$} |{}", cells.collect::<String>()))?;
    let rules = WIDTHS.map(|width| format!("{}:|", "-".repeat(width + 1)));
    line(format!("|{}|{}", "-".repeat(widest + 2), rules.concat()))
}

const WIDTHS: [usize; 11] = [8, 6, 19, 19, 19, 19, 16, 16, 12, 5, 16];

fn row(name: &str, widest: usize, figures: &Figures) -> Result<(), Failure> {
    let Figures { center_error_mm, yaw_error_deg, interval_95, without_snap, .. } = figures;
    let without = match without_snap.pictures {
        0 => "-".to_owned(),
        all => {
            let (boxes, with) = (without_snap.false_alarms, without_snap.with_false);
            format!("{boxes} in {with} of {all}")
        }
    };
    let cells = [
        figures.pictures.to_string(),
        figures.snaps.to_string(),
        percent(figures.mean_best_iou, interval_95.mean_best_iou),
        percent(figures.ap50, interval_95.ap50),
        between(center_error_mm.median, interval_95.center_median_mm, 3),
        between(center_error_mm.percentile_95, interval_95.center_percentile_95_mm, 3),
        between(yaw_error_deg.median, interval_95.yaw_median_deg, 1),
        between(yaw_error_deg.percentile_95, interval_95.yaw_percentile_95_deg, 1),
        number(figures.bias_to_light_mm, 3),
        figures.false_alarms.to_string(),
        without,
    ];
    let cells = cells.iter().zip(WIDTHS).map(|(cell, width)| format!(" {cell:>width$} |"));
    line(format!("| {name:<widest$} |{}", cells.collect::<String>()))
}

/// Prints how far scores and stated deviations hold.
pub(super) fn calibration(report: &Report) -> Result<(), Failure> {
    line("")?;
    line("| scores       |  boxes | mean score | right, % |")?;
    line("|--------------|-------:|-----------:|---------:|")?;
    for bin in &report.reliability.bins {
        let (from, to) = (bin.from.max(LEAST_SCORE), bin.to);
        line(format!(
            "| {from:.2} to {to:.2} | {:>6} | {:>10.3} | {:>8} |",
            bin.boxes,
            bin.mean_score,
            percent(Some(bin.right), None)
        ))?;
    }
    let error = number(report.reliability.expected_error, 4);
    line("")?;
    line(format!("expected calibration error: {error}"))?;
    line("")?;

    let deviations = &report.deviations;
    line("| deviation | stated           |  boxes | within one, % |")?;
    line("|-----------|------------------|-------:|--------------:|")?;
    let kinds =
        [("x, mm", &deviations.x_mm), ("y, mm", &deviations.y_mm), ("yaw, °", &deviations.yaw_deg)];
    for (name, thirds) in kinds {
        for Third { boxes, stated: [low, high], within } in thirds {
            let stated = format!("{low:.3} to {high:.3}");
            let within = percent(Some(*within), None);
            line(format!("| {name:<9} | {stated:<16} | {boxes:>6} | {within:>13} |"))?;
        }
        let boxes: usize = thirds.iter().map(|third| third.boxes).sum();
        let within = percent(share_within(thirds), None);
        line(format!("| {name:<9} | {:<16} | {boxes:>6} | {within:>13} |", "all"))?;
    }
    Ok(())
}

/// Tells on stderr what the figures are of.
pub(super) fn summary(report: &Report) {
    let paper = match report.classes.iter().any(|row| row.paper.is_some()) {
        true => "; the paper's figures are its mean IoU and mAP on its own pictures",
        false => "",
    };
    let without = report.all.figures.without_snap;
    let empty = match without.pictures {
        0 => String::new(),
        all => format!(
            "; {} in {} of {} without a snap",
            match without.false_alarms {
                1 => "1 false box".to_owned(),
                n => format!("{n} false boxes"),
            },
            without.with_false,
            count(all, "picture")
        ),
    };
    let assumed = match report.assumed_scale {
        0 => String::new(),
        some => format!(", {some} at an assumed scale"),
    };
    remark(format!(
        "{}{assumed} on {}, {:.3} s each; IoU, errors of centres and yaws and false boxes of detections above a \
         score of {}, average precision above {LEAST_SCORE}; in brackets 95 % intervals{empty}{paper}",
        count(report.pictures, "picture"),
        report.adapter,
        report.seconds_per_picture,
        report.conf
    ));
}

/// A figure with so many digits, or a dash.
pub(in super::super) fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".into(), |v| format!("{v:.digits$}"))
}

/// A figure with its interval, if it has one.
fn between(value: Option<f64>, interval: Option<[f64; 2]>, digits: usize) -> String {
    let shown = number(value, digits);
    match interval {
        Some([low, high]) => format!("{shown} ({low:.digits$}–{high:.digits$})"),
        None => shown,
    }
}

fn percent(share: Option<f64>, interval: Option<[f64; 2]>) -> String {
    let shown = number(share.map(|v| v * 100.0), 2);
    match interval {
        Some([low, high]) => format!("{shown} ({:.1}–{:.1})", low * 100.0, high * 100.0),
        None => shown,
    }
}
