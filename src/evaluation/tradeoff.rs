//! Error against run time: what was measured of the ways to run a network, and which of them to take.
//!
//! A [`Setup`] says what is computed (the network, the size of its input, what is left out) and how (the device, its
//! kernels, how many pictures at a time). The first sets what can be found, the second only rounds.
//! `smr-gpu tradeoff` measures setups side by side into a [`Table`], from which [`Table::choose`]
//! takes the fastest one that is near enough to the truth or to the best that the network can do.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::detector::Saving;
use crate::engine::kernels;
use crate::engine::precision::Precision;
use crate::engine::tuned::Place;
use crate::error::{Error, Result};
use crate::files;
use crate::smr::ModelConfig;

/// Longest file with a table.
const MAX_FILE: u64 = 16 << 20;

/// One way to run a network.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Setup {
    /// The weights, as `--weights` takes them.
    pub weights: String,
    /// Longer side of the gel in the network's input, in pixels; `None` for the weights' own scale.
    pub size: Option<usize>,
    /// What runs it, as `--device` takes it.
    pub device: String,
    /// Kernels that run wherever they fit, as [`crate::engine::lower::KernelChoice::forced`]; empty for the default.
    pub kernels: Vec<String>,
    /// Pictures that are given at a time.
    pub batch: usize,
    /// How a GPU stores maps and weights.
    #[serde(default)]
    pub precision: Precision,
    /// What is left out where a picture does not need it.
    #[serde(default)]
    pub leave_out: Vec<Saving>,
}

impl Setup {
    /// What is computed: setups that share it differ by rounding alone.
    pub fn what(&self) -> String {
        let size = self.size.map_or(String::new(), |size| format!(" at {size} px"));
        let left_out: Vec<_> = self.leave_out.iter().map(|saving| saving.name()).collect();
        match &left_out[..] {
            [] => format!("{}{size}", self.weights),
            names => format!("{}{size}, leaving out {}", self.weights, names.join(" + ")),
        }
    }

    /// How it is computed.
    pub fn how(&self) -> String {
        let mut words = vec![self.device.clone()];
        if !self.kernels.is_empty() {
            words.push(self.kernels.join(" + "));
        }
        if self.precision != Precision::F32 {
            words.push(self.precision.to_string());
        }
        if self.batch > 1 {
            words.push(format!("{} at a time", self.batch));
        }
        words.join(", ")
    }

    /// All of it, for people.
    pub fn name(&self) -> String {
        format!("{}, {}", self.what(), self.how())
    }
}

/// A figure over pictures or boxes; infinity, which JSON does not have, is null there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// The middle one.
    #[serde(deserialize_with = "or_infinity")]
    pub median: f64,
    /// Of twenty, the nineteenth.
    #[serde(deserialize_with = "or_infinity")]
    pub percentile_95: f64,
    /// The largest.
    #[serde(deserialize_with = "or_infinity")]
    pub worst: f64,
}

/// A number, or null for infinity: so serde_json writes it.
fn or_infinity<'de, D: serde::Deserializer<'de>>(from: D) -> std::result::Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::INFINITY))
}

impl Spread {
    /// Of some values; `None` if there are none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        // The value that the share `q` of them does not exceed: between two, infinity has no middle.
        let at =
            |q: f64| sorted[((q * sorted.len() as f64).ceil() as usize).clamp(1, last + 1) - 1];
        Some(Self { median: at(0.5), percentile_95: at(0.95), worst: sorted[last] })
    }
}

/// A stage's error against f64 on the same network and size: the largest over the pictures looked at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageError {
    /// The stage.
    pub stage: String,
    /// Length of the difference over the length of the reference.
    #[serde(deserialize_with = "or_infinity")]
    pub relative_l2: f64,
    /// Largest difference of an element.
    #[serde(deserialize_with = "or_infinity")]
    pub largest: f64,
}

/// Boxes against those of the base network in f64.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Shift {
    /// How far a box's centre is off, in millimetres, over the boxes of the base; a box that is not found
    /// is infinitely far off.
    pub mm: Option<Spread>,
    /// The same of its score, over the boxes that both found.
    pub score: Option<Spread>,
    /// Boxes of the base.
    pub boxes: usize,
    /// Boxes of the base that are not found.
    pub lost: usize,
    /// Boxes that the base does not have.
    pub gained: usize,
}

/// Against the labels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// Mean overlap of a snap with its best box; a miss counts 0.
    pub iou: f64,
    /// Average precision at an overlap of one half, the mean over the classes.
    pub ap50: f64,
    /// Median distance of centres in millimetres; infinite where no snap was found.
    #[serde(deserialize_with = "or_infinity")]
    pub center_error_mm: f64,
    /// Where 95 % of the overlaps of resampled pictures lie.
    #[serde(default)]
    pub iou_95: Option<[f64; 2]>,
    /// The same of the distance of centres.
    #[serde(default)]
    pub center_error_95_mm: Option<[f64; 2]>,
}

/// What was measured of a setup.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// The setup.
    pub setup: Setup,
    /// From picture to detections, in milliseconds a picture.
    pub wall_ms: Spread,
    /// The device's own time by its timestamps, where it has them.
    pub device_ms: Option<Spread>,
    /// Most memory that a process took for one picture, where the system tells.
    pub peak_bytes: Option<u64>,
    /// Errors by stage.
    pub stages: Vec<StageError>,
    /// Boxes against the base.
    pub shift: Shift,
    /// Against the labels, where there are any.
    pub quality: Option<Quality>,
}

impl Measured {
    /// How far nineteen of twenty boxes are off at most; not finite if more are lost.
    pub fn shift_mm(&self) -> f64 {
        self.shift.mm.map_or(f64::INFINITY, |mm| mm.percentile_95)
    }

    /// The largest relative error of a stage against f64, where stages were compared.
    pub fn rounding(&self) -> Option<f64> {
        self.stages.iter().map(|stage| stage.relative_l2).reduce(f64::max)
    }
}

/// What setups were measured, and where.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// The adapter of the setups that ran on one.
    pub place: Option<Place>,
    /// Digest of each weight file, as [`digest`] makes it.
    pub weights: Vec<(String, String)>,
    /// Pictures that each setup saw.
    pub pictures: usize,
    /// Whether it was stopped before all had seen them.
    pub stopped: bool,
    /// What the shifts are from.
    pub base: Setup,
    /// The setups.
    pub rows: Vec<Measured>,
}

/// What a setup must keep to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limit {
    /// Nineteen of twenty boxes are at most so many millimetres from where the base has them.
    ShiftMm(f64),
    /// The mean overlap with the labels is at least this.
    Iou(f64),
}

impl Table {
    /// Reads a table.
    ///
    /// # Errors
    /// [`Error::File`] for a file that is damaged, or names what this version does not have.
    pub fn open(path: &Path) -> Result<Self> {
        let fail = |message: String| Error::File { file: path.to_owned(), message };
        let bytes = files::read(path, MAX_FILE).map_err(|e| fail(e.to_string()))?;
        Self::parse(&bytes).map_err(fail)
    }

    /// Reads the bytes of a table's file.
    ///
    /// # Errors
    /// In words, as [`Table::open`] has them after the file's name.
    pub fn parse(bytes: &[u8]) -> std::result::Result<Self, String> {
        let text = files::text(bytes).map_err(|e| e.to_string())?;
        let table: Self = serde_json::from_str(text)
            .map_err(|e| format!("expected a table of setups, got an error: {e}"))?;
        for setup in table.rows.iter().map(|row| &row.setup) {
            let refuse = |what: &str, expected: &str, got: &dyn std::fmt::Display| {
                format!("{}: {what}: expected {expected}, got {got}", setup.name())
            };
            if let Some(size) = setup.size.filter(|size| !ModelConfig::is_input_size(*size)) {
                return Err(refuse("size", ModelConfig::INPUT_SIZES, &size));
            }
            if let Some(id) = setup.kernels.iter().find(|id| kernels::find(id).is_none()) {
                return Err(refuse("kernels", "names of kernels", id));
            }
        }
        Ok(table)
    }

    /// The setups that no other beats in time and in shift, the fastest first.
    pub fn front(&self) -> Vec<&Measured> {
        front(self.rows.iter(), Measured::shift_mm)
    }

    /// The fastest setup that keeps to `limit`, of those that look at one picture at a time: what several at
    /// a time take a picture is no help to one that comes alone.
    ///
    /// # Errors
    /// [`Error::Param`] if none does: with what the nearest one reaches.
    pub fn choose(&self, limit: Limit) -> Result<&Measured> {
        let alone = || self.rows.iter().filter(|row| row.setup.batch <= 1);
        let iou = |row: &Measured| row.quality.map(|q| q.iou);
        let fits = |row: &&Measured| match limit {
            Limit::ShiftMm(most) => row.shift_mm() <= most,
            Limit::Iou(least) => iou(row).is_some_and(|iou| iou >= least),
        };
        let fastest =
            alone().filter(fits).min_by(|a, b| a.wall_ms.median.total_cmp(&b.wall_ms.median));
        let refuse =
            |param, expected: String, got: f64| Error::param("tradeoff", param, expected, got);
        fastest.ok_or_else(|| match limit {
            Limit::ShiftMm(most) => {
                let finite = alone().map(Measured::shift_mm).filter(|mm| mm.is_finite());
                let expected = match finite.reduce(f64::min) {
                    Some(least) => format!("at least {least:.4}, the nearest of the table"),
                    None => "a table in which a setup finds the base's boxes".into(),
                };
                refuse("max_shift_mm", expected, most)
            }
            Limit::Iou(wanted) => {
                let expected = match alone().filter_map(iou).reduce(f64::max) {
                    Some(most) => format!("at most {most:.4}, the best of the table"),
                    None => "a table of pictures with labelled snaps".into(),
                };
                refuse("min_iou", expected, wanted)
            }
        })
    }

    /// Refuses a table that was measured elsewhere or with other weights: what `place` and the digests of
    /// `weights`, by name, are here.
    ///
    /// # Errors
    /// [`Error::Param`] that names the first difference.
    pub fn check(&self, setup: &Setup, place: Option<&Place>, digest: &str) -> Result<()> {
        let differs = |what: &str, expected: String, got: String| {
            Err(Error::param("tradeoff", what, format!("{expected}, as it was measured"), got))
        };
        let measured = self.weights.iter().find(|(name, _)| *name == setup.weights);
        match measured {
            Some((_, measured)) if measured == digest => {}
            Some((_, measured)) => {
                let got = format!("a file with {digest}");
                return differs("weights", format!("the file with {measured}"), got);
            }
            None => {
                return differs("weights", "weights of the table".into(), setup.weights.clone());
            }
        }
        match (&self.place, place) {
            (Some(there), Some(here)) if there != here => {
                let line =
                    |p: &Place| format!("{} ({}) in version {}", p.adapter, p.driver, p.version);
                differs("adapter", line(there), line(here))
            }
            _ => Ok(()),
        }
    }
}

/// Of some setups those that no other beats in time and in `error`, the fastest first.
pub fn front<'a>(
    rows: impl IntoIterator<Item = &'a Measured>,
    error: impl Fn(&Measured) -> f64,
) -> Vec<&'a Measured> {
    let mut rows: Vec<&Measured> = rows.into_iter().collect();
    let time = |row: &Measured| row.wall_ms.median;
    rows.sort_by(|a, b| time(a).total_cmp(&time(b)).then(error(a).total_cmp(&error(b))));
    let mut least = f64::INFINITY;
    rows.retain(|row| {
        let better = error(row) < least;
        least = least.min(error(row));
        better
    });
    rows
}

/// A digest of a weight file's bytes: equal bytes have equal ones, and a mistaken file another.
pub fn digest(bytes: &[u8]) -> String {
    // FNV-1a over words.
    let words = bytes.chunks(8).map(|chunk| {
        let mut word = [0; 8];
        word[..chunk.len()].copy_from_slice(chunk);
        u64::from_le_bytes(word)
    });
    let hash = words.fold(0xcbf2_9ce4_8422_2325_u64 ^ bytes.len() as u64, |hash, word| {
        (hash ^ word).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(29)
    });
    format!("{hash:016x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setup(weights: &str, batch: usize) -> Setup {
        Setup {
            weights: weights.into(),
            size: None,
            device: "cpu".into(),
            kernels: vec![],
            batch,
            precision: Precision::F32,
            leave_out: vec![],
        }
    }

    fn row(weights: &str, ms: f64, shift: f64, iou: f64) -> Measured {
        let spread = |v: f64| Spread { median: v, percentile_95: v, worst: v };
        Measured {
            setup: setup(weights, 1),
            wall_ms: spread(ms),
            device_ms: None,
            peak_bytes: None,
            stages: Vec::new(),
            shift: Shift { mm: Some(spread(shift)), ..Shift::default() },
            quality: Some(Quality {
                iou,
                ap50: 0.9,
                center_error_mm: 0.1,
                iou_95: None,
                center_error_95_mm: None,
            }),
        }
    }

    fn table() -> Table {
        let rows = vec![
            row("exact", 100.0, 0.0, 0.93),
            row("slow", 120.0, 0.01, 0.93),
            row("fast", 10.0, 0.2, 0.85),
            row("middle", 40.0, 0.05, 0.91),
            row("as good as middle", 40.0, 0.05, 0.90),
            row("loses", 5.0, f64::INFINITY, 0.5),
        ];
        let base = setup("exact", 1);
        let weights = vec![("fast".into(), digest(b"fast"))];
        Table { place: None, weights, pictures: 1, stopped: false, base, rows }
    }

    fn names<'a>(rows: impl IntoIterator<Item = &'a Measured>) -> Vec<&'a str> {
        rows.into_iter().map(|row| row.setup.weights.as_str()).collect()
    }

    #[test]
    fn the_front_is_what_nothing_beats() {
        assert_eq!(names(table().front()), ["fast", "middle", "exact"]);
    }

    #[test]
    fn the_fastest_that_fits_is_chosen() {
        let table = table();
        let chosen = |limit| table.choose(limit).map(|row| row.setup.weights.as_str());
        assert_eq!(chosen(Limit::ShiftMm(0.2)).expect("a setup"), "fast");
        assert_eq!(chosen(Limit::ShiftMm(0.199)).expect("a setup"), "middle");
        assert_eq!(chosen(Limit::ShiftMm(0.0)).expect("a setup"), "exact");
        assert_eq!(chosen(Limit::Iou(0.905)).expect("a setup"), "middle");
        assert_eq!(chosen(Limit::Iou(0.0)).expect("a setup"), "loses");
        let message = chosen(Limit::Iou(0.94)).expect_err("an error").to_string();
        let want = "tradeoff: parameter `min_iou`: expected at most 0.9300, the best of the table, got \
                    0.94";
        assert_eq!(message, want);
        let none = Table { rows: vec![], ..table.clone() };
        assert!(none.choose(Limit::ShiftMm(1.0)).is_err() && none.front().is_empty());
    }

    /// A picture that comes alone has nothing of those beside it.
    #[test]
    fn several_at_a_time_are_not_chosen() {
        let mut table = table();
        table.rows[2].setup.batch = 4;
        let chosen = table.choose(Limit::ShiftMm(0.2)).expect("a setup");
        assert_eq!(chosen.setup.weights, "middle");
        assert_eq!(names(table.front()), ["fast", "middle", "exact"]);
    }

    #[test]
    fn what_no_setup_can_reach_is_said() {
        let mut table = table();
        for row in &mut table.rows {
            row.quality = None;
            row.shift.mm = None;
        }
        let message = |limit| table.choose(limit).expect_err("an error").to_string();
        let labels = message(Limit::Iou(0.5));
        assert!(
            labels.contains("expected a table of pictures with labelled snaps, got 0.5"),
            "{labels}"
        );
        let boxes = message(Limit::ShiftMm(0.1));
        assert!(
            boxes.contains("expected a table in which a setup finds the base's boxes"),
            "{boxes}"
        );
    }

    /// As an earlier version or a hand may have written it.
    #[test]
    fn a_table_of_what_there_is_not_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("table.json");
        let message = |table: &Table| {
            std::fs::write(&path, serde_json::to_vec(table).expect("JSON")).expect("written");
            Table::open(&path).expect_err("an error").to_string()
        };
        let (mut size, mut kernel) = (table(), table());
        size.rows[1].setup.size = Some(100);
        let got = message(&size);
        assert!(
            got.ends_with(
                "slow at 100 px, cpu: size: expected a multiple of 32 from 32 to 1440, got 100"
            ),
            "{got}"
        );
        kernel.rows[1].setup.kernels = vec!["nope/x".into()];
        let got = message(&kernel);
        assert!(got.ends_with("kernels: expected names of kernels, got nope/x"), "{got}");
        let got = Table::open(folder.path()).expect_err("an error").to_string();
        assert_eq!(got, format!("{}: expected a file, got a folder", folder.path().display()));
    }

    /// Of twenty values the nineteenth is the 95th percentile, and a single infinity is the worst alone.
    #[test]
    fn spreads_by_hand() {
        let mut values: Vec<f64> = (1..=20).rev().map(f64::from).collect();
        let want = Spread { median: 10.0, percentile_95: 19.0, worst: 20.0 };
        assert_eq!(Spread::of(&values), Some(want));
        values[0] = f64::INFINITY;
        let spread = Spread::of(&values).expect("values");
        assert_eq!((spread.percentile_95, spread.worst), (19.0, f64::INFINITY));
        assert_eq!(Spread::of(&[3.0]).expect("a value").percentile_95, 3.0);
        assert_eq!(Spread::of(&[]), None);
    }

    /// Lost boxes are infinitely far off, also after a file, and so are centres where none was found.
    #[test]
    fn tables_are_written_and_read() {
        let mut table = table();
        table.rows[0].quality = Some(Quality {
            iou: 0.0,
            ap50: 0.0,
            center_error_mm: f64::INFINITY,
            iou_95: Some([0.0; 2]),
            center_error_95_mm: None,
        });
        let (stage, infinite) = ("conv1".to_owned(), f64::INFINITY);
        table.rows[0].stages = vec![StageError { stage, relative_l2: infinite, largest: infinite }];
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("table.json");
        std::fs::write(&path, serde_json::to_vec(&table).expect("JSON")).expect("written");
        assert_eq!(Table::open(&path).expect("a table"), table);
        std::fs::write(&path, "{}").expect("written");
        assert!(
            Table::open(&path).expect_err("an error").to_string().contains("a table of setups")
        );
    }

    #[test]
    fn another_file_or_adapter_is_refused() {
        let place = |driver: &str| Place {
            adapter: "a".into(),
            driver: driver.into(),
            version: "1".into(),
        };
        let table = Table { place: Some(place("1.0")), ..table() };
        let (fast, here) = (setup("fast", 1), place("1.0"));
        table.check(&fast, Some(&here), &digest(b"fast")).expect("the same");
        table.check(&fast, None, &digest(b"fast")).expect("no adapter");
        let message = |setup: &Setup, place: &Place, bytes: &[u8]| {
            table.check(setup, Some(place), &digest(bytes)).expect_err("an error").to_string()
        };
        assert!(message(&fast, &here, b"fast!").contains("`weights`: expected the file with"));
        let other = message(&fast, &place("1.1"), b"fast");
        assert!(other.contains("expected a (1.0) in version 1, as it was measured"), "{other}");
        assert!(message(&setup("slow", 1), &here, b"fast").contains("weights of the table"));
    }

    #[test]
    fn digests_tell_files_apart() {
        let all = [&b""[..], b"\0", b"\0\0", b"a", b"b", b"abcdefgh", b"abcdefgh\0", b"bacdefgh"];
        let digests: std::collections::BTreeSet<String> = all.into_iter().map(digest).collect();
        assert_eq!(digests.len(), all.len());
    }

    #[test]
    fn setups_have_names() {
        let all = Setup {
            weights: "small".into(),
            size: Some(192),
            device: "gpu".into(),
            kernels: vec!["conv2d/direct".into()],
            batch: 4,
            precision: Precision::F16,
            leave_out: vec![Saving::Contact, Saving::Scales],
        };
        assert_eq!(
            all.name(),
            "small at 192 px, leaving out contact + scales, gpu, conv2d/direct, f16, 4 at a time"
        );
        assert_eq!(setup("large", 1).name(), "large, cpu");
    }
}
