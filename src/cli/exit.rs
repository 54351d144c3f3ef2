//! Exit codes, and the failure that carries one.

use std::fmt::Display;

use smr_gpu::{Error, files};

use super::message::tell;

/// Shown below `--help`.
pub(super) const HELP: &str = "\
Exit codes: 0 done, 1 some inputs or checks failed, 2 usage, 3 weights, 4 no device, 5 device lost \
or timed out, 6 some output could not be written, 130 stopped by Ctrl-C, 141 stdout's reader went \
away";

/// How the program ends; of two that came up on the way, the greater counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub(super) enum Exit {
    /// All was done.
    Done = 0,
    /// Some inputs, or some checks, failed.
    Inputs = 1,
    /// The command line asks for something that does not exist. clap uses this code too.
    Usage = 2,
    /// The weights are missing or damaged.
    Weights = 3,
    /// No device as asked for.
    Device = 4,
    /// The device was lost, timed out or failed.
    Lost = 5,
    /// An output cannot be written.
    Output = 6,
    /// Ctrl-C: what shells show of a program that SIGINT ends.
    Interrupted = 130,
    /// Stdout's reader went away before the end: what shells show of a program that SIGPIPE ends.
    Pipe = 141,
}

/// Why a command stops before its end.
#[derive(Debug)]
pub(super) struct Failure {
    pub exit: Exit,
    /// What to tell the user; `None` if nothing is left to say.
    pub message: Option<String>,
}

impl Failure {
    pub fn new(exit: Exit, message: impl Display) -> Self {
        Self { exit, message: Some(message.to_string()) }
    }

    /// An error of the library about one input.
    pub fn about(input: impl Display, error: &Error) -> Self {
        Self::new(exit_of(error), format!("{input}: {}", as_typed(error)))
    }

    /// Tells the user at once: to close a device that hangs takes its time.
    pub fn told(self) -> Self {
        self.message.into_iter().for_each(tell);
        Self { message: None, ..self }
    }

    /// Whether it may be one picture's alone. A device that was late for one may not be for the next.
    pub fn is_of_one_picture(&self) -> bool {
        matches!(self.exit, Exit::Inputs | Exit::Lost)
    }

    pub fn usage(message: impl Display) -> Self {
        Self::new(Exit::Usage, message)
    }
}

/// Tells why something was not written, and gives its share of the exit code.
pub(super) fn told(result: Result<(), Failure>) -> Exit {
    result.map_or_else(|failure| failure.told().exit, |()| Exit::Done)
}

impl From<files::Error> for Failure {
    fn from(error: files::Error) -> Self {
        let exit = match error {
            files::Error::Spared { .. } => Exit::Usage,
            _ => Exit::Output,
        };
        Self::new(exit, error)
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self::new(exit_of(&error), as_typed(&error))
    }
}

/// What the library calls what an option sets, by the part that refuses it, and the option.
const OPTIONS: [(&str, &str, &str); 12] = [
    ("detect", "classes", "--class"),
    ("detect", "device", "--device"),
    ("detect", "input_size", "--size"),
    ("detect", "iou", "--iou"),
    ("detect", "max_detections", "--max-det"),
    ("detect", "precision", "--precision"),
    ("detect", "score", "--conf"),
    ("compare", "device", "--device"),
    ("check", "operation", "NAME"),
    ("check", "kernel", "--kernel"),
    ("check", "case", "--case"),
    ("tradeoff", "max_shift_mm", "--max-shift-mm"),
];

/// An error of the library, with the option where it is about one: its own names nobody typed.
pub(super) fn as_typed(error: &Error) -> String {
    let Error::Param { op, param, expected, got } = error else { return error.to_string() };
    let option = OPTIONS.iter().find(|(part, name, _)| part == op && name == param);
    match option {
        Some((.., option)) => format!("{option}: expected {expected}, got {got}"),
        None if op == "tradeoff" => format!("{param}: expected {expected}, got {got}"),
        None => error.to_string(),
    }
}

/// The exit code that belongs to an error of the library.
pub(super) fn exit_of(error: &Error) -> Exit {
    match error {
        Error::Param { .. } => Exit::Usage,
        Error::Weights { .. } | Error::NoWeights { .. } => Exit::Weights,
        Error::NoAdapter { .. } | Error::Device { .. } | Error::Shader { .. } => Exit::Device,
        Error::DeviceLost(_) | Error::Timeout { .. } | Error::Driver { .. } => Exit::Lost,
        // A tensor or a picture that does not fit; the library may add kinds.
        _ => Exit::Inputs,
    }
}
