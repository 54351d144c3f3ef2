//! The commands, one a file, and what they share.
//!
//! Data goes to stdout, messages for people to stderr; exit codes are in [`exit`].

mod calibrate;
mod check;
mod compare;
mod detect;
mod detector;
mod devices;
mod draw;
mod eval;
mod exit;
mod op;
mod output;
mod picture;
mod simulate;
mod source;
mod tensors;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use exit::Failure;

/// Finds snap joints in pictures of a GelSight-like tactile sensor, on any GPU.
#[derive(Debug, Parser)]
#[command(version, after_help = exit::HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Detect(detect::Args),
    Devices(devices::Args),
    Eval(eval::Args),
    Op(op::Args),
    Check(check::Args),
    Compare(compare::Args),
    Simulate(Box<simulate::Args>),
    Calibrate(calibrate::Args),
}

/// Runs the program.
pub(crate) fn run() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Detect(args) => detect::run(args),
        Command::Devices(args) => devices::run(args),
        Command::Eval(args) => eval::run(args),
        Command::Op(args) => op::run(args),
        Command::Check(args) => check::run(args),
        Command::Compare(args) => compare::run(args),
        Command::Simulate(args) => simulate::run(*args),
        Command::Calibrate(args) => calibrate::run(args),
    };
    let exit = result.unwrap_or_else(|Failure { exit, message }| {
        if let Some(message) = message {
            output::tell(message);
        }
        exit
    });
    ExitCode::from(exit as u8)
}
