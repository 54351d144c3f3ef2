//! `smr-gpu weights`: which weights there are, and storing more.

use std::fmt;
use std::fs;
use std::io::ErrorKind;
use std::path::PathBuf;

use serde::Serialize;
use sha2::{Digest, Sha256};
use smr_gpu::smr::catalog::{self, PUBLISHED};
use smr_gpu::smr::{Bytes, Catalog, MAX_FILE, Network, Wanted, Weights};
use smr_gpu::{Error, WeightSource, files};

use super::exit::{Exit, Failure, as_typed, exit_of};
use super::message::tell;
use super::names::shown;
use super::output::{json_line, line};

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu weights
  smr-gpu weights add mine.safetensors
  smr-gpu detect picture.png --weights mine";

/// List the networks that there are, or store more
///
/// Each line is a name that --weights takes, with the weights that it finds. They are looked for in
/// $SMR_GPU_WEIGHTS, if that is a folder, in the user's data folder, in `weights` beside the program and up to two
/// folders above it, in `share/smr-gpu/weights` beside the program's folder, and in `weights` in the current folder.
/// `small` is also in the program.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Print one line of JSON for each.
    #[arg(long)]
    json: bool,

    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    Add(AddArgs),
}

/// Store a weight file in the user's data folder, where every command finds it by its name
///
/// The file is stored only if the network can be built from it and its SHA-256 is right: the one of --sha256, or,
/// for `large` and `small` without that option, the one that this program knows.
#[derive(Debug, clap::Args)]
struct AddArgs {
    /// The weight file.
    file: PathBuf,

    /// What --weights will take for it: letters, digits, `-` and `_` [default: `large` or `small` for a file that
    /// is the one, else the file's own name without its extension].
    #[arg(long, value_parser = name)]
    name: Option<String>,

    /// The file's SHA-256.
    #[arg(long, value_name = "HEX", value_parser = digest)]
    sha256: Option<String>,
}

/// Weights, as `--json` prints them.
#[derive(Serialize)]
struct Record {
    name: String,
    /// None for what is in the program.
    file: Option<String>,
    bytes: usize,
    sha256: String,
    classes: Vec<String>,
}

impl fmt::Display for Record {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, file, bytes, sha256, classes } = self;
        let (megabytes, classes) = (*bytes as f64 / 1e6, classes.join(", "));
        let file = file.as_deref().unwrap_or("(in the program)");
        write!(f, "{name:<10} {megabytes:>6.1} MB  {sha256}  {classes}  {file}")
    }
}

/// Parses a name.
///
/// # Errors
/// In words.
fn name(text: &str) -> Result<String, String> {
    let expected = "expected a plain word of letters, digits, `-` and `_`";
    catalog::is_name(text).then(|| text.to_owned()).ok_or_else(|| expected.to_owned())
}

/// Parses a SHA-256.
///
/// # Errors
/// In words.
fn digest(text: &str) -> Result<String, String> {
    let is_digest = text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
    is_digest
        .then(|| text.to_lowercase())
        .ok_or_else(|| "expected 64 hexadecimal digits".to_owned())
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    match args.command {
        Some(Command::Add(add)) => self::add(add),
        None => list(args.json),
    }
}

fn list(json: bool) -> Result<Exit, Failure> {
    let catalog = Catalog::from_env();
    let all = catalog.all();
    if all.is_empty() {
        // Its error says where weights are looked for.
        catalog.usual()?;
    }
    let mut exit = Exit::Done;
    for (name, found) in all {
        match read(name, &found) {
            Ok((record, _)) if json => json_line(&record)?,
            Ok((record, _)) => line(record)?,
            Err(e) => {
                tell(as_typed(&e));
                exit = exit.max(exit_of(&e));
            }
        }
    }
    Ok(exit)
}

/// What there is to say of weights, with their bytes.
fn read(name: String, from: &WeightSource) -> Result<(Record, Bytes), Error> {
    let bytes = from.bytes()?;
    let weights = Weights::from_shared(from.name(), bytes.clone())?;
    let classes = weights.config().classes.clone();
    // What no network can be built from is none.
    Network::new(weights, [32; 2], Wanted::ALL)?;
    let all = (*bytes).as_ref();
    let sha256 = Sha256::digest(all).iter().map(|byte| format!("{byte:02x}")).collect();
    let file = from.file().map(|file| shown(file.as_os_str()));
    Ok((Record { name, file, bytes: all.len(), sha256, classes }, bytes))
}

fn add(args: AddArgs) -> Result<Exit, Failure> {
    let AddArgs { file, name, sha256 } = args;
    let (record, bytes) = read(String::new(), &WeightSource::File(file.clone()))?;
    let known = PUBLISHED.iter().find(|network| network.sha256 == record.sha256);
    let stem =
        file.file_stem().and_then(|stem| stem.to_str()).filter(|stem| catalog::is_name(stem));
    let given = name.or_else(|| known.map(|n| n.name).or(stem).map(str::to_owned));
    let name = given.ok_or_else(|| {
        Failure::usage(format!("--name: expected one, as `{}` is no plain word", file.display()))
    })?;
    let stored = catalog::file_name(&name);
    let network = PUBLISHED.iter().find(|network| network.file == stored);
    let name = network.map_or(name, |network| network.name.into());
    let expected = sha256.or_else(|| Some(network?.sha256.to_owned()));
    if let Some(expected) = expected
        && expected != record.sha256
    {
        let (file, got) = (file.display(), record.sha256);
        let message =
            format!("weights {file}: `{name}`: expected the SHA-256 {expected}, got {got}");
        return Err(Failure::new(Exit::Weights, message));
    }
    let folder = catalog::data_folder().ok_or_else(|| {
        Failure::new(
            Exit::Output,
            "no folder for the user's data: expected a home folder, got none",
        )
    })?;
    let (path, bytes) = (folder.join(stored), (*bytes).as_ref());
    match files::read(&path, MAX_FILE) {
        Ok(there) if there == bytes => {}
        Err(e) if e.kind() == ErrorKind::NotFound => {
            let failed = |e| Failure::new(Exit::Output, format!("{}: {e}", folder.display()));
            fs::create_dir_all(&folder).map_err(failed)?;
            files::write(&path, bytes)?;
        }
        _ => {
            let message = format!(
                "{}: expected no other weights of this name, got some: remove them, or give another --name",
                path.display()
            );
            return Err(Failure::new(Exit::Output, message));
        }
    }
    line(Record { name, file: Some(shown(path.as_os_str())), ..record })?;
    Ok(Exit::Done)
}
