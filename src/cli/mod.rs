//! The commands, one a file, and what they share.
//!
//! Data goes to stdout, messages for people to stderr; exit codes are in [`exit`].

mod adapters;
mod bench;
mod calibrate;
mod check;
mod compare;
mod detect;
mod detector;
mod devices;
mod draw;
mod eval;
mod exit;
mod ffmpeg;
mod folders;
mod gallery;
mod merge;
mod message;
mod names;
mod op;
mod output;
mod parts;
mod preview;
mod printable;
mod probe;
mod shell;
mod simulate;
mod source;
mod stdout;
mod teach;
mod tensors;
mod tradeoff;
mod tune;
mod version;
mod weights;

use std::io::Write;
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use smr_gpu::picture::is_decoding;

use exit::{Exit, Failure};
use message::Level;

/// Finds snap joints in pictures of a GelSight-like tactile sensor, on any GPU.
#[derive(Debug, Parser)]
#[command(version, long_version = version::long(), after_help = exit::HELP)]
struct Cli {
    /// Print errors only.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,

    /// Print more: the time of each frame.
    #[arg(short, long, global = true)]
    verbose: bool,

    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Detect(Box<detect::Args>),
    Devices(devices::Args),
    Merge(merge::Args),
    Eval(eval::Args),
    Op(op::Args),
    Check(check::Args),
    Compare(compare::Args),
    Tune(tune::Args),
    Bench(bench::Args),
    Tradeoff(tradeoff::Args),
    /// What `tradeoff` runs in a process of its own.
    #[command(hide = true)]
    TradeoffPeak(tradeoff::PeakArgs),
    /// What looks for adapters in a process of its own.
    #[command(hide = true, name = probe::COMMAND)]
    LookForAdapters,
    #[command(hide = true)]
    Shell(shell::Args),
    Simulate(Box<simulate::Args>),
    Teach(Box<teach::Args>),
    Calibrate(calibrate::Args),
    Weights(weights::Args),
}

/// Runs the program.
pub(crate) fn run() -> ExitCode {
    hush_decoders();
    let exit = parse_and_run().unwrap_or_else(|Failure { exit, message }| {
        if let Some(message) = message {
            message::tell(message);
        }
        exit
    });
    ExitCode::from(exit as u8)
}

fn parse_and_run() -> Result<Exit, Failure> {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) if e.use_stderr() => {
            // It repeats the arguments, which the shell may have made of file names.
            let text = e.to_string();
            let lines: Vec<_> = text.lines().map(printable::printable).collect();
            let _ = writeln!(std::io::stderr(), "{}", lines.join("\n"));
            return Ok(Exit::Usage);
        }
        // Help or version.
        Err(e) => {
            output::to_stdout(|| e.print().and_then(|()| std::io::stdout().flush()))?;
            return Ok(Exit::Done);
        }
    };
    message::set_level(match (cli.quiet, cli.verbose) {
        (true, _) => Level::Quiet,
        (false, true) => Level::Verbose,
        (false, false) => Level::Usual,
    });
    match cli.command {
        Command::Detect(args) => detect::run(*args),
        Command::Devices(args) => devices::run(args),
        Command::Merge(args) => merge::run(args),
        Command::Eval(args) => eval::run(args),
        Command::Op(args) => op::run(args),
        Command::Check(args) => check::run(args),
        Command::Compare(args) => compare::run(args),
        Command::Tune(args) => tune::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Tradeoff(args) => tradeoff::run(args),
        Command::TradeoffPeak(args) => tradeoff::run_peak(args),
        Command::LookForAdapters => probe::answer(),
        Command::Shell(args) => shell::run(args, Cli::command()),
        Command::Simulate(args) => simulate::run(*args),
        Command::Teach(args) => teach::run(*args),
        Command::Calibrate(args) => calibrate::run(args),
        Command::Weights(args) => weights::run(args),
    }
}

/// A decoder's panic becomes its picture's error, and is no news of its own.
fn hush_decoders() {
    let tell = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !is_decoding() {
            tell(panic);
        }
    }));
}
