//! `smr-gpu merge`: makes one run's list of what the shards of `detect` wrote.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::value::RawValue;
use smr_gpu::files;

use super::detect::lists::{COCO, CSV, Frame};
use super::exit::{Exit, Failure};
use super::output::text_out;

/// Longest file that is read, in bytes.
const MAX_BYTES: u64 = 1 << 32;

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu merge one.csv two.csv three.csv > all.csv
  smr-gpu merge one.jsonl two.jsonl > all.jsonl
  smr-gpu merge *.coco > all.json";

/// Merge what the shards of `detect` wrote
///
/// Prints what one run without --shard writes to --csv or --coco, or prints with --json.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// One file of each shard, all of the same kind: --csv, --coco, or what --json printed.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
}

/// What a list is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Csv,
    Coco,
    /// An object a line.
    Json,
}

/// A snap's row or result, or a frame's line.
struct Entry {
    /// Its frame's.
    index: u64,
    text: String,
}

#[derive(Deserialize)]
struct Indexed {
    index: u64,
}

impl Format {
    fn of(text: &str) -> Self {
        match text.as_bytes().first() {
            Some(b'[') => Self::Coco,
            // A shard that took no picture prints nothing.
            Some(b'{') | None => Self::Json,
            Some(_) => Self::Csv,
        }
    }

    fn frame(self) -> Frame {
        match self {
            Self::Csv => CSV,
            Self::Coco => COCO,
            Self::Json => [""; 3],
        }
    }

    /// The entries of a file.
    ///
    /// # Errors
    /// What was expected and what came.
    fn entries(self, text: &str) -> Result<Vec<Entry>, String> {
        let entry = |before: &str, text: &str, behind: &str| {
            let Indexed { index } = serde_json::from_str(text)?;
            Ok(Entry { index, text: format!("{before}{text}{behind}") })
        };
        let entries: serde_json::Result<_> = match self {
            Self::Csv => return rows(text),
            Self::Json => text.lines().map(|line| entry("", line, "\n")).collect(),
            Self::Coco => serde_json::from_str::<Vec<&RawValue>>(text)
                .and_then(|results| results.iter().map(|r| entry("\n", r.get(), "")).collect()),
        };
        entries.map_err(|e| format!("expected what `detect` writes, got another: {e}"))
    }
}

/// The rows of a table, with their ends.
fn rows(text: &str) -> Result<Vec<Entry>, String> {
    let [head, ..] = CSV;
    let table = text.strip_prefix(head).ok_or_else(|| {
        let got = text.lines().next().unwrap_or_default();
        format!("expected the columns {}, got {got}", head.trim_end())
    })?;
    let mut entries: Vec<Entry> = Vec::new();
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(table.as_bytes());
    let mut row = csv::StringRecord::new();
    let mut begin = 0;
    while reader.read_record(&mut row).map_err(|e| e.to_string())? {
        let end = reader.position().byte() as usize;
        let index = row.get(1).and_then(|index| index.parse().ok());
        let text = table[begin..end].to_owned();
        let index = index.ok_or_else(|| format!("expected a row with an index, got {text}"))?;
        entries.push(Entry { index, text });
        begin = end;
    }
    Ok(entries)
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let mut kind: Option<(Format, &Path)> = None;
    let mut all: Vec<(Entry, &Path)> = Vec::new();
    for path in &args.files {
        let failed = |e: &dyn std::fmt::Display| {
            Failure::new(Exit::Inputs, format!("{}: {e}", path.display()))
        };
        let bytes = files::read(path, MAX_BYTES).map_err(|e| failed(&e))?;
        let text = files::text(&bytes).map_err(|e| failed(&e))?;
        let format = Format::of(text);
        let entries = format.entries(text).map_err(|e| failed(&e))?;
        all.extend(entries.into_iter().map(|entry| (entry, path.as_path())));
        let (expected, first) = *kind.get_or_insert((format, path));
        if format != expected {
            let message = format!("expected {expected:?} as {}, got {format:?}", first.display());
            return Err(failed(&message));
        }
    }
    // A frame's own order stays.
    all.sort_by_key(|(entry, _)| entry.index);
    let twice =
        all.windows(2).find(|pair| pair[0].0.index == pair[1].0.index && pair[0].1 != pair[1].1);
    if let Some([(entry, one), (_, other)]) = twice {
        let message = format!(
            "{}: expected frames of another shard than {}'s, got frame {} in both",
            other.display(),
            one.display(),
            entry.index
        );
        return Err(Failure::new(Exit::Inputs, message));
    }
    let [before, between, behind] = kind.map_or(Format::Json, |(format, _)| format).frame();
    let texts: Vec<&str> = all.iter().map(|(entry, _)| &entry.text[..]).collect();
    text_out(format!("{before}{}{behind}", texts.join(between)).as_bytes())?;
    Ok(Exit::Done)
}
