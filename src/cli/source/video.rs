//! Videos, cameras and network streams, whose frames ffmpeg writes into a pipe.

use std::ffi::OsString;
use std::process::{ChildStdout, Stdio};

use smr_gpu::files;

use super::super::ffmpeg::{self, Ffmpeg};
use super::Source;

/// An ffmpeg that reads a source, and its frames: BMP pictures, one after the other, upright.
pub(super) struct Video {
    pub ffmpeg: Ffmpeg,
    pub frames: Option<ChildStdout>,
    /// The command, for people.
    pub command: String,
}

impl Video {
    /// # Errors
    /// In words, without the source's name.
    pub fn open(source: &Source) -> Result<Self, String> {
        let (input, shown): (OsString, OsString) = match source {
            Source::Video(path) => {
                files::open(path).map_err(|e| e.to_string())?;
                let argument = ffmpeg::file_argument(path);
                (argument.clone(), argument)
            }
            Source::Live(name) => (name.clone(), source.to_string().into()),
            Source::File(_) | Source::Stdin => return Err("expected a video".into()),
        };
        // Each frame as often as the source has it, in all of its bits, its time in what ffmpeg says.
        let rest = "-map 0:v:0 -vf showinfo=checksum=0 -fps_mode passthrough -c:v bmp -pix_fmt bgr24 -f image2pipe -";
        let arguments = |input| -> Vec<OsString> {
            let begin = ["-nostdin".into(), "-i".into(), input];
            begin.into_iter().chain(rest.split(' ').map(OsString::from)).collect()
        };
        let mut ffmpeg = Ffmpeg::start(&arguments(input), Stdio::null(), Stdio::piped())?;
        let frames = ffmpeg.child().stdout.take();
        Ok(Self { ffmpeg, frames, command: ffmpeg::command_line(&arguments(shown)) })
    }
}
