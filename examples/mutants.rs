//! Puts small faults into the shaders and tells which check notices each.
//!
//! ```sh
//! cargo run --release --example mutants -- [--per-file 8] [--seed 1] [--file conv2d]
//! ```
//!
//! Each mutant runs through the cases of every operation that has its file, hand-computed cases
//! first, and what survives through the whole network on a sample. Mutants run with bounds checks in
//! a process of their own, which is ended when one does not come to an end.

#[path = "../tests/support/mutate.rs"]
mod mutate;

use std::collections::HashMap;
use std::error::Error;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, mpsc};
use std::time::Duration;

use clap::Parser;
use mutate::Mutant;
use smr_gpu::gpu::{Gpu, GpuOptions};
use smr_gpu::ops::{Case, Entry, Expected};
use smr_gpu::{Config, GpuDetector};

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
    /// Leave the whole network out.
    #[arg(long)]
    no_network: bool,
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
        Some(first) => run(&mutants[first..], args.no_network),
        None => report(&mutants),
    }
}

/// Runs all mutants in child processes and prints a table.
fn report(mutants: &[Mutant]) -> Result<(), Box<dyn Error>> {
    println!("| mutant | noticed by | a case by hand |\n|---|---|---|");
    let mut tally: HashMap<&str, usize> = HashMap::new();
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
            let line = receiver.recv_timeout(VERDICT);
            let ended = line.is_err();
            let line = line.unwrap_or_else(|_| "no end\t".into());
            let (verdict, hand) = line.split_once('\t').unwrap_or((&line, ""));
            let kind = match verdict {
                "survived" => "survived",
                "the network" => "the network alone",
                _ if hand.is_empty() => "a case",
                _ => "a case by hand",
            };
            *tally.entry(kind).or_default() += 1;
            let mutant = mutants[next].to_string().replace('|', "\\|");
            println!("| {mutant} | {verdict} | {hand} |");
            std::io::stdout().flush()?;
            next += 1;
            if ended || verdict == "no end" {
                break;
            }
        }
        child.kill()?;
        child.wait()?;
    }
    println!("\n{} mutants: {tally:?}", mutants.len());
    Ok(())
}

/// The cases of an operation with what must come of them, small ones first.
struct Cases {
    by_hand: Vec<Expected<'static>>,
    others: Vec<Expected<'static>>,
}

impl Cases {
    fn new(entry: &Entry) -> Result<Self, Box<dyn Error>> {
        // Lives as long as the process, which runs them for each mutant.
        let mut cases = (entry.cases)();
        cases.sort_by_key(|c| c.inputs.iter().map(|v| v.bytes().len()).sum::<usize>());
        let (by_hand, others): (Vec<&'static Case>, Vec<_>) =
            Vec::leak(cases).iter().partition(|c| c.by_hand.is_some());
        let expect = |cases: Vec<&'static Case>| -> smr_gpu::Result<Vec<_>> {
            cases.into_iter().map(Expected::of).collect()
        };
        Ok(Self { by_hand: expect(by_hand)?, others: expect(others)? })
    }
}

fn run(mutants: &[Mutant], no_network: bool) -> Result<(), Box<dyn Error>> {
    let options = GpuOptions { checked: true, timeout: RUN, ..GpuOptions::default() };
    let gpu = pollster::block_on(Gpu::open(options))?;
    let mut cases: HashMap<&str, Cases> = HashMap::new();
    for mutant in mutants {
        let mutated = gpu.with_replacement(mutant.replacement());
        let mut noticed: Option<String> = None;
        let mut by_hand: Option<String> = None;
        for entry in mutate::users(&mutant.file) {
            if !cases.contains_key(entry.name) {
                cases.insert(entry.name, Cases::new(entry)?);
            }
            let Cases { by_hand: hand, others } = &cases[entry.name];
            for expected in hand {
                let Some((name, hand)) = verdict(&mutated, expected)? else { continue };
                let name = format!("{}: {name}", entry.name);
                if hand {
                    by_hand.get_or_insert(name.clone());
                }
                noticed.get_or_insert(name);
                if by_hand.is_some() {
                    break;
                }
            }
            for expected in others {
                if noticed.is_some() {
                    break;
                }
                noticed = verdict(&mutated, expected)?.map(|v| format!("{}: {}", entry.name, v.0));
            }
            if noticed.is_some() && by_hand.is_some() {
                break;
            }
        }
        if noticed.is_none() && !no_network && differs(&mutated)? {
            noticed = Some("the network".into());
        }
        let noticed = noticed.unwrap_or_else(|| "survived".into());
        println!("{noticed}\t{}", by_hand.unwrap_or_default());
        std::io::stdout().flush()?;
    }
    Ok(())
}

/// The name of the case if it fails, and whether it does by its outputs by hand.
fn verdict(gpu: &Arc<Gpu>, expected: &Expected) -> Result<Option<(String, bool)>, Box<dyn Error>> {
    let name = expected.case().name.clone();
    match expected.check(gpu) {
        Ok(report) if report.failures.is_empty() => Ok(None),
        Ok(report) => {
            Ok(Some((name, report.failures.iter().any(|f| f.contains(": shader by hand: ")))))
        }
        Err(smr_gpu::Error::Timeout { .. }) => {
            println!("no end\t");
            std::io::stdout().flush()?;
            // Not `exit`: the driver's threads are still at it.
            std::process::abort()
        }
        // A write behind a tensor's end, or one that the driver refused.
        Err(error) => {
            let error = error.to_string();
            let error = error.lines().next().unwrap_or_default();
            Ok(Some((format!("{name} ({error})"), expected.case().by_hand.is_some())))
        }
    }
}

/// Whether the whole network notices on a sample, as `smr-gpu compare` does.
fn differs(gpu: &Arc<Gpu>) -> Result<bool, Box<dyn Error>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut config = Config::new(root.join("weights/smrnet.safetensors"));
    config.keep_stages = true;
    config.score = 0.5;
    let picture = image::open(root.join("samples/mixed.png"))?;
    let detector = pollster::block_on(GpuDetector::on_device(gpu.clone(), config))?;
    Ok(match detector.compare(&picture) {
        Ok(found) => found.failures().next().is_some(),
        Err(_) => true,
    })
}
