//! The report: WORK/report.md with its pictures beside it.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use plotters::chart::SeriesLabelPosition;
use smr_gpu::evaluation::{
    Figures, RIGHT_IOU, Seen, confusion, deviations, figures, precision_recall, reliability,
    share_within,
};
use smr_gpu::files::{self, Outputs};

use super::super::draw;
use super::super::eval::print::number;
use super::super::eval::{Labelled, sheet};
use super::super::exit::{Exit, Failure};
use super::super::names::shown;
use super::super::parts::PartArg;
use super::charts::{self, Chart};
use super::judge::{COUNTS_ABOVE, Judged, Looked};
use super::plan::Role;
use super::{Teaching, python};

/// Writes the report; returns its path.
pub(super) fn write(
    teaching: &Teaching,
    weights: &Path,
    judged: &Judged,
) -> Result<PathBuf, Failure> {
    let shown = judged.shown();
    let seen = shown.iter().map(|(_, seen)| (*seen).clone()).collect();
    let pages = Pages { teaching, judged, shown, seen };
    let mut text = pages.head(weights);
    text += &pages.figures();
    text += &pages.negatives();
    text += &pages.confusion();
    text += &pages.scores()?;
    text += &pages.pictures()?;
    text += &pages.learning()?;
    let file = teaching.work.join("report.md");
    files::write(&file, text.as_bytes())?;
    Ok(file)
}

struct Pages<'a> {
    teaching: &'a Teaching<'a>,
    judged: &'a Judged,
    /// The pictures of snaps, and what was seen in them.
    shown: Vec<(&'a Labelled, &'a Seen)>,
    seen: Vec<Seen>,
}

impl Pages<'_> {
    fn head(&self, weights: &Path) -> String {
        let args = self.teaching.args;
        let classes = self.judged.classes.join(", ");
        let parts = args.part.iter().map(PartArg::to_string).collect::<Vec<_>>();
        let data = args.data.iter().map(|folder| shown(folder.as_os_str())).collect::<Vec<_>>();
        let mut text = format!("# {classes}\n\n");
        let _ = writeln!(text, "| | |\n|---|---|");
        let mut row = |name: &str, value: String| {
            if !value.is_empty() {
                let _ = writeln!(text, "| {name} | {} |", cell(&value));
            }
        };
        row("weights", shown(args.out.as_os_str()));
        row("parts", parts.join(", "));
        row("labelled pictures", data.join(", "));
        row("sensor", args.sensor.clone().unwrap_or_default());
        row("began with", shown(args.network.as_os_str()));
        if !parts.is_empty() {
            row("simulated pictures", args.pictures.to_string());
        }
        row("steps", args.steps.to_string());
        row("tested on", self.judged.adapter.clone());
        if !parts.is_empty() {
            text += "\n![What the program makes of the parts](parts.png)\n";
        }
        let weights = shown(weights.as_os_str());
        let _ = writeln!(
            text,
            "\nPictures that nothing was learnt from, with nothing left out (`--exact`). Simulated pictures say how \
             well the parts are told apart under the simulator's light, not how well on a real sensor: for that, label \
             some of its pictures and look at them with `smr-gpu eval --weights {weights} --data DIR`."
        );
        text
    }

    /// Figures by set and class.
    fn figures(&self) -> String {
        let mut text = "\n## How good\n\nIoU: mean overlap of each snap with the best box of its class above a score \
                        of 0.5, where a miss counts 0. False: boxes above 0.5 that are on no snap of their class.\n\n\
                        | pictures | class | snaps | IoU, % | AP50, % | centre, mm | yaw, ° | found | false |\n\
                        |---|---|---:|---:|---:|---:|---:|---:|---:|\n"
            .to_owned();
        for Looked { name, seen, role, .. } in &self.judged.sets {
            if *role != Role::Test {
                continue;
            }
            for (index, class) in self.judged.classes.iter().enumerate() {
                let Figures {
                    snaps,
                    mean_best_iou,
                    ap50,
                    center_error_mm,
                    yaw_error_deg,
                    right,
                    false_alarms,
                    ..
                } = figures(seen, &[index], COUNTS_ABOVE.into());
                let _ = writeln!(
                    text,
                    "| {}, {} | {} | {snaps} | {} | {} | {} | {} | {right} | {false_alarms} |",
                    cell(name),
                    seen.len(),
                    cell(class),
                    percent(mean_best_iou),
                    percent(ap50),
                    number(center_error_mm.median, 3),
                    number(yaw_error_deg.median, 1),
                );
            }
        }
        text
    }

    /// What is taken for a snap where there is none.
    fn negatives(&self) -> String {
        let sets: Vec<_> =
            self.judged.sets.iter().filter(|set| set.role == Role::Negative).collect();
        if sets.is_empty() {
            return String::new();
        }
        let classes = &self.judged.classes;
        let heads = classes.iter().map(|class| format!(" taken for {} |", cell(class)));
        let mut text = format!(
            "\n## What is taken for a snap\n\nBoxes above 0.5 in pictures without a snap. `NAME-block` is the part's \
             outline as a plain block, `NAME-cut` the part without the third that its arrow points to, `NAME-mirror` its mirror image.\n\n\
             | pictures of | pictures | with a false box |{}\n|---|---:|---:|{}\n",
            heads.collect::<String>(),
            "---:|".repeat(classes.len())
        );
        for Looked { name, seen, .. } in sets {
            let above = |seen: &Seen, class: Option<usize>| {
                let of =
                    |f: &&smr_gpu::evaluation::Found| class.is_none_or(|class| f.class == class);
                let found = seen.found.iter().filter(of);
                found.filter(|f| f.scored.score > COUNTS_ABOVE.into()).count()
            };
            let with = seen.iter().filter(|seen| above(seen, None) > 0).count();
            let each = (0..classes.len())
                .map(|class| seen.iter().map(|seen| above(seen, Some(class))).sum::<usize>());
            let each = each.map(|boxes| format!(" {boxes} |")).collect::<String>();
            let _ = writeln!(text, "| {} | {} | {with} |{each}", cell(name), seen.len());
        }
        text
    }

    fn confusion(&self) -> String {
        let classes = &self.judged.classes;
        let heads = classes.iter().map(|class| format!(" found as {} |", cell(class)));
        let mut text = format!(
            "\n## What snaps are found as\n\n| |{} not found |\n|---|{}---:|\n",
            heads.collect::<String>(),
            "---:|".repeat(classes.len())
        );
        for (class, row) in
            classes.iter().zip(confusion(&self.seen, classes.len(), COUNTS_ABOVE.into()))
        {
            let row = row.iter().map(|n| format!(" {n} |")).collect::<String>();
            let _ = writeln!(text, "| {} |{row}", cell(class));
        }
        text
    }

    /// Precision and recall, and how far scores and deviations hold.
    fn scores(&self) -> Result<String, Failure> {
        let (classes, seen) = (&self.judged.classes, &self.seen);
        let curves: Vec<_> = classes
            .iter()
            .enumerate()
            .map(|(index, class)| (class.clone(), precision_recall(seen, index)))
            .collect();
        self.chart(
            "precision.png",
            &Chart {
                title: "Precision by recall",
                x: ("recall: share of the snaps that are found", 0.0..1.0),
                y: ("precision: share of the boxes that are right", 0.0..1.02),
                lines: &curves,
                names: SeriesLabelPosition::LowerLeft,
            },
        )?;
        let reliable = reliability(seen, classes.len());
        let points = reliable.bins.iter().map(|bin| (bin.mean_score, bin.right)).collect();
        self.chart(
            "reliability.png",
            &Chart {
                title: "How often boxes are right, by score",
                x: ("score", 0.0..1.0),
                y: ("share that is right", 0.0..1.02),
                lines: &[
                    ("boxes".to_owned(), points),
                    ("as the score says".to_owned(), vec![(0.0, 0.0), (1.0, 1.0)]),
                ],
                names: SeriesLabelPosition::UpperLeft,
            },
        )?;
        let error = number(reliable.expected_error, 3);
        let deviations = deviations(seen, COUNTS_ABOVE.into());
        let within = |thirds| percent(share_within(thirds));
        Ok(format!(
            "\n## Scores\n\n![Precision by recall](precision.png)\n![How often boxes are right, by \
             score](reliability.png)\n\nThe scores' calibration error is {error}: so far is a score from the share of \
             such boxes that are right (overlap of at least {RIGHT_IOU}). Within one stated deviation, which should \
             hold for 68 %, lie {} % of the centres along x, {} % along y, and {} % of the yaws.\n",
            within(&deviations.x_mm),
            within(&deviations.y_mm),
            within(&deviations.yaw_deg)
        ))
    }

    /// Contact sheets.
    fn pictures(&self) -> Result<String, Failure> {
        let (shown, classes) = (&self.shown, &self.judged.classes);
        let mut text =
            "\n## Pictures\n\nWhite: what is there. Coloured: what was found.\n".to_owned();
        let best = sheet::best(shown, classes, COUNTS_ABOVE);
        let worst = sheet::worst(shown, classes, COUNTS_ABOVE);
        for (name, title, sheet) in [("hits", "The best", best), ("misses", "The worst", worst)] {
            let Some(sheet) = sheet else { continue };
            let file = self.teaching.work.join(format!("{name}.png"));
            draw::write(&mut Outputs::default(), &file, &sheet)?;
            let _ = write!(text, "\n{title}:\n\n![{title}]({name}.png)\n");
        }
        Ok(text)
    }

    /// How it learnt.
    fn learning(&self) -> Result<String, Failure> {
        let lines = python::history(&self.teaching.run_folder());
        let losses: Vec<_> =
            lines.iter().filter_map(|line| Some((f64::from(line.step), line.loss?))).collect();
        let Some(last) = losses.last().map(|(step, _)| *step) else { return Ok(String::new()) };
        let top = losses.iter().map(|(_, loss)| *loss).fold(0.0, f64::max);
        let mut curves = vec![("loss".to_owned(), losses)];
        for line in &lines {
            for (folder, classes) in line.val.iter().flatten() {
                let Some(iou) = classes.get("all").and_then(|all| all["iou"].as_f64()) else {
                    continue;
                };
                let name =
                    format!("IoU, {}", Path::new(folder).file_name().map_or(folder.clone(), shown));
                let at = curves.iter().position(|(other, _)| *other == name).unwrap_or_else(|| {
                    curves.push((name, Vec::new()));
                    curves.len() - 1
                });
                curves[at].1.push((f64::from(line.step), iou));
            }
        }
        self.chart(
            "learning.png",
            &Chart {
                title: "Loss and validation while learning",
                x: ("step", 0.0..last.max(1.0)),
                y: ("loss; IoU, 0 to 1", 0.0..(top * 1.05).max(1.0)),
                lines: &curves,
                names: SeriesLabelPosition::UpperRight,
            },
        )?;
        Ok("\n## Learning\n\n![Loss and validation by step](learning.png)\n".to_owned())
    }

    fn chart(&self, name: &str, chart: &Chart) -> Result<(), Failure> {
        let png =
            charts::png(chart).map_err(|e| Failure::new(Exit::Output, format!("{name}: {e}")))?;
        Ok(files::write(&self.teaching.work.join(name), &png)?)
    }
}

/// Text of a table's cell.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace(char::is_control, " ")
}

fn percent(share: Option<f64>) -> String {
    number(share.map(|share| 100.0 * share), 1)
}
