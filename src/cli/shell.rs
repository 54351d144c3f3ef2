//! `smr-gpu shell`: what a package installs beside the program: completions for shells, and man pages.

use std::path::PathBuf;

use clap::Command;
use clap_complete::Shell;

use super::exit::{Exit, Failure};
use super::output::to_stdout;

/// Write completions for a shell, or man pages
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
pub(super) struct Args {
    /// Print the completions for this shell.
    #[arg(long, value_name = "SHELL")]
    completions: Option<Shell>,

    /// Write a man page for the program, and one for each command, into this folder.
    #[arg(long, value_name = "DIR")]
    man: Option<PathBuf>,
}

pub(super) fn run(args: Args, mut program: Command) -> Result<Exit, Failure> {
    if let Some(shell) = args.completions {
        let mut text = Vec::new();
        clap_complete::generate(shell, &mut program, "smr-gpu", &mut text);
        to_stdout(|| std::io::Write::write_all(&mut std::io::stdout(), &text))?;
    }
    if let Some(folder) = args.man {
        let made =
            |e: std::io::Error| Failure::new(Exit::Output, format!("{}: {e}", folder.display()));
        std::fs::create_dir_all(&folder).map_err(made)?;
        clap_mangen::generate_to(program, &folder).map_err(made)?;
    }
    Ok(Exit::Done)
}
