//! ffmpeg as a child, which reads videos, cameras and network streams, and writes videos.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use super::names::shown;

/// What to do where there is none.
const INSTALL: &str = "ffmpeg is not installed: `apt install ffmpeg` on Debian and Ubuntu, `brew install ffmpeg` \
                       on a Mac, `winget install ffmpeg` on Windows; 5.1 or newer";
/// Lines of errors that are kept, the last ones, and bytes of each.
const MOST_LINES: usize = 3;
const MOST_BYTES: u64 = 4096;
/// Longest wait for a frame's time stamp once the frame is there: an ffmpeg that is asked tells it before.
const STAMP: Duration = Duration::from_secs(1);

/// An ffmpeg that runs.
pub(super) struct Ffmpeg {
    child: Child,
    /// Its last errors.
    said: Option<JoinHandle<Vec<String>>>,
    stamps: Receiver<(u64, f64)>,
    /// The first stamp that no frame has asked for yet.
    next: Option<(u64, f64)>,
    tells_stamps: bool,
}

/// The command as people see it.
pub(super) fn command_line(arguments: &[OsString]) -> String {
    let quoted = |argument: &OsString| {
        let text = shown(argument);
        match text.chars().all(|c| c.is_alphanumeric() || "-_./:=+,@%".contains(c)) {
            true if !text.is_empty() => text,
            _ => format!("'{}'", text.replace('\'', r"'\''")),
        }
    };
    let arguments: Vec<String> = arguments.iter().map(quoted).collect();
    format!("ffmpeg {}", arguments.join(" "))
}

/// A file's name for ffmpeg, which takes some names for options or protocols.
pub(super) fn file_argument(path: &Path) -> OsString {
    let mut argument = OsString::from("file:");
    argument.push(path);
    argument
}

impl Ffmpeg {
    /// Begins. Ctrl-C in a terminal does not reach it: this program ends it, or lets it finish.
    ///
    /// # Errors
    /// In words; where there is no ffmpeg, how to install it.
    pub fn start(arguments: &[OsString], stdin: Stdio, stdout: Stdio) -> Result<Self, String> {
        let mut command = Command::new("ffmpeg");
        command.args(["-hide_banner", "-nostats", "-loglevel", "level+info"]).args(arguments);
        command.stdin(stdin).stdout(stdout).stderr(Stdio::piped());
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().map_err(|e| match e.kind() {
            ErrorKind::NotFound => INSTALL.to_owned(),
            _ => format!("ffmpeg cannot be run: {e}"),
        })?;
        let (to, stamps) = mpsc::channel();
        let said = child.stderr.take().map(|stderr| thread::spawn(move || listen(stderr, &to)));
        Ok(Self { child, said, stamps, next: None, tells_stamps: true })
    }

    /// The process's ends of the pipes.
    pub fn child(&mut self) -> &mut Child {
        &mut self.child
    }

    /// The time of a frame, in seconds; `None` where the stream has none. Frames are asked for in order.
    pub fn time_s(&mut self, frame: u64) -> Option<f64> {
        while self.tells_stamps {
            let next = match self.next.take() {
                Some(next) => Ok(next),
                None => self.stamps.recv_timeout(STAMP),
            };
            match next {
                Ok((number, time_s)) if number == frame => return Some(time_s),
                Ok(later @ (number, _)) if number > frame => {
                    self.next = Some(later);
                    return None;
                }
                Ok(_) => {}
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                    self.tells_stamps = false;
                }
            }
        }
        None
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// How it ended and its last errors, where it did not succeed; of one that did, `Ok` with the errors that it
    /// told on the way.
    pub fn finish(mut self) -> Result<Vec<String>, String> {
        drop(self.child.stdin.take());
        let status = self.child.wait();
        let said = self.said.take().and_then(|said| said.join().ok()).unwrap_or_default();
        match status {
            Ok(status) if status.success() => Ok(said),
            Ok(status) => {
                let said = if said.is_empty() { "nothing".to_owned() } else { said.join("; ") };
                Err(format!("ffmpeg ended with {status}, and said: {said}"))
            }
            Err(e) => Err(format!("ffmpeg: {e}")),
        }
    }
}

impl Drop for Ffmpeg {
    /// One that nobody waited for is ended.
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads what ffmpeg says to its end: passes on frames' numbers and times, and returns the last errors.
fn listen(stderr: impl Read, stamps: &Sender<(u64, f64)>) -> Vec<String> {
    let (mut reader, mut said) = (BufReader::new(stderr), Vec::new());
    loop {
        let mut line = Vec::new();
        match reader.by_ref().take(MOST_BYTES).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return said,
            Ok(_) => {}
        }
        let line = String::from_utf8_lossy(&line);
        if let Some(stamp) = stamp(&line) {
            // Who does not want them has dropped the other end.
            let _ = stamps.send(stamp);
        } else if let Some(error) = error(&line) {
            said.push(error.to_owned());
            said.drain(..said.len().saturating_sub(MOST_LINES));
        }
    }
}

/// Number and time in seconds of a line of the filter `showinfo`.
fn stamp(line: &str) -> Option<(u64, f64)> {
    let after = |key: &str| line.split_once(key)?.1.split_whitespace().next();
    let (_, line_of_frame) = line.split_once("showinfo")?;
    let number = line_of_frame.split_once(" n:")?.1.split_whitespace().next()?;
    Some((number.parse().ok()?, after(" pts_time:")?.parse().ok()?))
}

/// What a line tells that went wrong, without who says so.
fn error(line: &str) -> Option<&str> {
    let levels = ["[error] ", "[fatal] ", "[panic] "];
    let told = levels.iter().find_map(|level| Some(line.split_once(level)?.1.trim()));
    told.filter(|told| !told.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_ffmpeg_says() {
        let said = b"[info] Input #0, matroska, from 'x.mkv':\n\
            [Parsed_showinfo_0 @ 0x55d] [info] config in time_base: 1/1000\n\
            [Parsed_showinfo_0 @ 0x55d] [info] n:   0 pts:      0 pts_time:0       pos:  579 fmt:bgr0\n\
            [Parsed_showinfo_0 @ 0x55d] [info] n:   1 pts:NOPTS pts_time:NOPTS pos: 1079 fmt:bgr0\n\
            [Parsed_showinfo_0 @ 0x55d] [info] n:   2 pts:   1280 pts_time:1.28 pos: 1579 fmt:bgr0\n\
            [error] one\n[h264 @ 0x1] [error] two\n[fatal] three\n[warning] no error\n[error] four";
        let (to, stamps) = mpsc::channel();
        assert_eq!(listen(&said[..], &to), ["two", "three", "four"]);
        assert_eq!(stamps.try_iter().collect::<Vec<_>>(), [(0, 0.0), (2, 1.28)]);
    }

    #[test]
    fn a_command_can_be_typed_again() {
        let arguments =
            ["-i", "file:a b'c.mp4", "-vf", "showinfo=checksum=0", ""].map(OsString::from);
        assert_eq!(
            command_line(&arguments),
            r"ffmpeg -i 'file:a b'\''c.mp4' -vf showinfo=checksum=0 ''"
        );
    }
}
