//! Puts small faults into the shaders and tells which check notices each.
//!
//! ```sh
//! cargo run --release --example mutants -- [--per-file 8] [--seed 1] [--file conv2d/planar] [--sample 1]
//! ```
//!
//! Each mutant runs through the cases of every operation that has its file, hand-computed cases
//! first, and what survives through the whole network on a picture; with `--sample` so do some that
//! the cases notice. Mutants run with bounds checks in
//! a process of their own, which is ended when one does not come to an end.

#[path = "../tests/support/mutate.rs"]
mod mutate;

use std::collections::hash_map::Entry as Slot;
use std::collections::{BTreeMap, HashMap};
use std::error::Error;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, mpsc};
use std::time::Duration;

use clap::Parser;
use mutate::Mutant;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use smr_gpu::engine::gpu::{Gpu, GpuOptions};
use smr_gpu::engine::ops::{Case, Entry, Expected};
use smr_gpu::verify;
use smr_gpu::verify::check::check_expected;
use smr_gpu::{Config, Frame, GpuDetector};

/// Longest run of one shader.
const RUN: Duration = Duration::from_secs(60);
/// Longest wait for one mutant's verdict.
const VERDICT: Duration = Duration::from_secs(600);

#[derive(Parser)]
struct Args {
    /// Mutants of each shader file.
    #[arg(long, default_value_t = 8)]
    per_file: usize,
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// This file alone.
    #[arg(long)]
    file: Option<String>,
    /// Leave the whole network out, but for the sample.
    #[arg(long)]
    no_network: bool,
    /// Mutants of each file, drawn at random, that run through the whole network whether or not a case
    /// notices.
    #[arg(long, default_value_t = 0)]
    sample: usize,
    /// The cases with outputs by hand alone: what they miss, the reference could have wrong too.
    #[arg(long, conflicts_with = "sample")]
    by_hand: bool,
    /// Run the mutants from this one on and write a verdict a line: what a child process does.
    #[arg(long, hide = true)]
    from: Option<usize>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    let wanted = |file: &str| args.file.as_deref().is_none_or(|f| f == file);
    let mutants: Vec<Mutant> = mutate::sources()
        .iter()
        .filter(|(file, _)| wanted(file))
        .flat_map(|(file, text)| mutate::chosen(file, text, args.seed, args.per_file))
        .collect();
    match args.from {
        Some(first) => run(&mutants, first, &args),
        None => report(&mutants),
    }
}

/// What became of a mutant.
#[derive(Clone, Debug, Default)]
struct Verdict {
    /// The case that notices it.
    case: Option<String>,
    /// The case that notices it by its outputs by hand.
    by_hand: Option<String>,
    /// Whether the network does, if it was run.
    network: Option<bool>,
    /// Whether the device is still at it, so that the process must end.
    hangs: bool,
}

impl Verdict {
    fn to_line(&self) -> String {
        let text = |part: &Option<String>| part.clone().unwrap_or_default();
        let network = self.network.map_or("", |n| if n { "noticed" } else { "missed" });
        let hangs = if self.hangs { "hangs" } else { "" };
        [&text(&self.case), &text(&self.by_hand), network, hangs].join("\t")
    }

    fn from_line(line: &str) -> Self {
        let mut parts = line.split('\t').map(|p| (!p.is_empty()).then(|| p.to_owned()));
        let mut next = || parts.next().flatten();
        let (case, by_hand) = (next(), next());
        Self { case, by_hand, network: next().map(|n| n == "noticed"), hangs: next().is_some() }
    }
}

/// How many mutants each kind of check notices.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    mutants: usize,
    by_hand: usize,
    case: usize,
    network_alone: usize,
    missed: usize,
    /// Noticed by a case, and run through the network too.
    sampled: usize,
    /// Of those, noticed by the network.
    both: usize,
}

impl Tally {
    const HEAD: &str = "| file | mutants | a case by hand | another case | the network alone | \
        nothing | of those by cases, run through the network | noticed there |\n\
        |---|--:|--:|--:|--:|--:|--:|--:|";

    fn add(&mut self, verdict: &Verdict) {
        self.mutants += 1;
        match verdict {
            Verdict { by_hand: Some(_), .. } => self.by_hand += 1,
            Verdict { case: Some(_), .. } => self.case += 1,
            Verdict { network: Some(true), .. } => self.network_alone += 1,
            _ => self.missed += 1,
        }
        if let (Some(_), Some(noticed)) = (&verdict.case, verdict.network) {
            self.sampled += 1;
            self.both += usize::from(noticed);
        }
    }

    fn row(&self, file: &str) -> String {
        let Self { mutants, by_hand, case, network_alone, missed, sampled, both } = self;
        let numbers = [mutants, by_hand, case, network_alone, missed, sampled, both];
        format!("| {file} | {} |", numbers.map(|n| n.to_string()).join(" | "))
    }
}

/// Runs all mutants in child processes and prints a table of them, and one of the files.
fn report(mutants: &[Mutant]) -> Result<(), Box<dyn Error>> {
    println!("| mutant | noticed by | a case by hand | the network |\n|---|---|---|---|");
    let mut tally: BTreeMap<&str, Tally> = BTreeMap::new();
    let mut total = Tally::default();
    let mut next = 0;
    while next < mutants.len() {
        let mut child = Command::new(std::env::current_exe()?)
            .args(std::env::args().skip(1))
            .args(["--from", &next.to_string()])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let (sender, receiver) = mpsc::channel();
        let output = child.stdout.take().ok_or("a child without stdout")?;
        std::thread::spawn(move || {
            let lines = BufReader::new(output).lines();
            lines.map_while(Result::ok).take_while(|l| sender.send(l.clone()).is_ok()).count();
        });
        while next < mutants.len() {
            let verdict = match receiver.recv_timeout(VERDICT) {
                Ok(line) => Verdict::from_line(&line),
                Err(_) => {
                    Verdict { case: Some("no end".into()), hangs: true, ..Verdict::default() }
                }
            };
            let mutant = &mutants[next];
            tally.entry(&mutant.file).or_default().add(&verdict);
            total.add(&verdict);
            let text = |part: &Option<String>| part.clone().unwrap_or_default();
            let network = verdict.network.map_or("", |n| if n { "noticed" } else { "missed" });
            let (case, by_hand) = (text(&verdict.case), text(&verdict.by_hand));
            let mutant = mutant.to_string().replace('|', "\\|");
            println!("| {mutant} | {case} | {by_hand} | {network} |");
            std::io::stdout().flush()?;
            next += 1;
            if verdict.hangs {
                break;
            }
        }
        child.kill()?;
        child.wait()?;
    }
    println!("\n{}", Tally::HEAD);
    tally.iter().for_each(|(file, tally)| println!("{}", tally.row(file)));
    println!("{}", total.row("all"));
    Ok(())
}

/// The cases of an operation with what must come of them, small ones first.
struct Cases {
    by_hand: Vec<Expected<'static>>,
    others: Vec<Expected<'static>>,
}

impl Cases {
    fn new(entry: &Entry, by_hand_alone: bool) -> Result<Self, Box<dyn Error>> {
        // Lives as long as the process, which runs them for each mutant.
        let mut cases = (entry.cases)();
        cases.retain(|c| c.by_hand.is_some() || !by_hand_alone);
        cases.sort_by_key(|c| c.inputs.iter().map(|v| v.bytes().len()).sum::<usize>());
        let (by_hand, others): (Vec<&'static Case>, Vec<_>) =
            Vec::leak(cases).iter().partition(|c| c.by_hand.is_some());
        let expect = |cases: Vec<&'static Case>| -> smr_gpu::Result<Vec<_>> {
            cases.into_iter().map(Expected::of).collect()
        };
        Ok(Self { by_hand: expect(by_hand)?, others: expect(others)? })
    }
}

fn run(mutants: &[Mutant], first: usize, args: &Args) -> Result<(), Box<dyn Error>> {
    let options = GpuOptions { bounds_checks: true, timeout: RUN, ..GpuOptions::default() };
    let gpu = pollster::block_on(Gpu::open(options))?;
    let mut cases: HashMap<&str, Cases> = HashMap::new();
    let sample = sample(mutants, args);
    for (i, mutant) in mutants.iter().enumerate().skip(first) {
        let mutated = gpu.with_replacement(mutant.replacement());
        let mut verdict = by_cases(&mutated, mutant, &mut cases, args.by_hand)?;
        let missed = verdict.case.is_none() && !args.no_network && !args.by_hand;
        if (missed || sample.contains(&i)) && !verdict.hangs {
            match differs(&mutated)? {
                Some(noticed) => verdict.network = Some(noticed),
                None => (verdict.network, verdict.hangs) = (Some(true), true),
            }
        }
        println!("{}", verdict.to_line());
        std::io::stdout().flush()?;
        if verdict.hangs {
            // Not `exit`: the driver's threads are still at it.
            std::process::abort()
        }
    }
    Ok(())
}

/// The places of the mutants that run through the network in any case.
fn sample(mutants: &[Mutant], args: &Args) -> Vec<usize> {
    let mut sample = Vec::new();
    let mut first = 0;
    for of_file in mutants.chunk_by(|a, b| a.file == b.file) {
        let mut places: Vec<usize> = (first..first + of_file.len()).collect();
        places.shuffle(&mut rand_pcg::Pcg64Mcg::seed_from_u64(args.seed));
        sample.extend(&places[..args.sample.min(places.len())]);
        first += of_file.len();
    }
    sample
}

/// The first case that notices a mutant, and the first that does by its outputs by hand.
fn by_cases(
    gpu: &Arc<Gpu>,
    mutant: &Mutant,
    cases: &mut HashMap<&'static str, Cases>,
    by_hand_alone: bool,
) -> Result<Verdict, Box<dyn Error>> {
    let mut verdict = Verdict::default();
    for entry in mutate::users(&mutant.file) {
        let Cases { by_hand, others } = match cases.entry(entry.name) {
            Slot::Occupied(slot) => slot.into_mut(),
            Slot::Vacant(slot) => slot.insert(Cases::new(entry, by_hand_alone)?),
        };
        let by_hand = by_hand.iter().map(|case| (case, true));
        for (expected, hand) in by_hand.chain(others.iter().map(|case| (case, false))) {
            if verdict.case.is_some() && !hand {
                break;
            }
            let Some(noticed) = noticed(gpu, expected) else { continue };
            let name = format!("{}: {}{}", entry.name, expected.case().name, noticed.how);
            if noticed.by_hand {
                verdict.by_hand = Some(name.clone());
            }
            verdict.case.get_or_insert(name);
            verdict.hangs = noticed.hangs;
            if verdict.by_hand.is_some() || verdict.hangs {
                return Ok(verdict);
            }
        }
    }
    Ok(verdict)
}

/// How a case notices a mutant.
struct Noticed {
    how: String,
    by_hand: bool,
    hangs: bool,
}

fn noticed(gpu: &Arc<Gpu>, expected: &Expected) -> Option<Noticed> {
    let has_hand = expected.case().by_hand.is_some();
    match check_expected(gpu, expected, &expected.case().inputs) {
        Ok(report) if report.failures.is_empty() => None,
        Ok(report) => {
            let by_hand = report.failures.iter().any(|f| f.contains(": kernel by hand: "));
            Some(Noticed { how: String::new(), by_hand, hangs: false })
        }
        Err(smr_gpu::Error::Timeout { .. }) => {
            Some(Noticed { how: " (no end)".into(), by_hand: has_hand, hangs: true })
        }
        // A write behind a tensor's end, or one that the driver refused.
        Err(error) => {
            let how = format!(" ({})", error.to_string().lines().next().unwrap_or_default());
            Some(Noticed { how, by_hand: has_hand, hangs: false })
        }
    }
}

/// Whether the whole network notices on a sample, as `smr-gpu compare` does; `None` if it does not
/// come to an end.
fn differs(gpu: &Arc<Gpu>) -> Result<Option<bool>, Box<dyn Error>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut config = Config::new(root.join("weights/smrnet.safetensors"));
    config.keep_stages = true;
    config.score = 0.5;
    let picture = image::open(root.join("samples/mixed.png"))?;
    let detector = pollster::block_on(GpuDetector::on_device(gpu.clone(), config))?;
    Ok(match verify::compare(&detector, &Frame::from(&picture)) {
        Ok(found) => Some(found.failures().next().is_some()),
        Err(smr_gpu::Error::Timeout { .. }) => None,
        Err(_) => Some(true),
    })
}
