//! `smr-gpu shell`: what stands beside the program: completions for shells, man pages, the reference.

use std::path::PathBuf;

use clap::Command;
use clap_complete::Shell;
use clap_markdown::MarkdownOptions;

use super::exit::{Exit, Failure};
use super::output::text_out;

/// Write completions for a shell, man pages, or the reference of all options
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
pub(super) struct Args {
    /// Print the completions for this shell.
    #[arg(long, value_name = "SHELL")]
    completions: Option<Shell>,

    /// Write a man page for the program, and one for each command, into this folder.
    #[arg(long, value_name = "DIR")]
    man: Option<PathBuf>,

    /// Print all commands and options as Markdown: docs/reference/cli.md.
    #[arg(long)]
    markdown: bool,
}

pub(super) fn run(args: Args, mut program: Command) -> Result<Exit, Failure> {
    if let Some(shell) = args.completions {
        let mut text = Vec::new();
        clap_complete::generate(shell, &mut program, "smr-gpu", &mut text);
        text_out(&text)?;
    }
    if args.markdown {
        let options =
            MarkdownOptions::new().title("Commands and options".into()).show_footer(false);
        let text = clap_markdown::help_markdown_command_custom(&program, &options);
        // The examples are indented by less than a block of code is.
        let text =
            text.replace("Examples:\n", "Examples:\n\n").replace("\n  smr-gpu ", "\n    smr-gpu ");
        text_out(text.as_bytes())?;
    }
    if let Some(folder) = args.man {
        let made =
            |e: std::io::Error| Failure::new(Exit::Output, format!("{}: {e}", folder.display()));
        std::fs::create_dir_all(&folder).map_err(made)?;
        clap_mangen::generate_to(program, &folder).map_err(made)?;
    }
    Ok(Exit::Done)
}
