//! The `smr-gpu` program; its commands are in `cli`.

mod cli;

fn main() -> std::process::ExitCode {
    cli::run()
}
