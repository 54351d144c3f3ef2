//! The drawn frames as a video, which ffmpeg writes.

use std::ffi::OsString;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use image::RgbImage;
use smr_gpu::files::{Outputs, Unfinished};

use super::super::detector::number;
use super::super::exit::{Exit, Failure};
use super::super::ffmpeg::{self, Ffmpeg};
use super::super::message::remark;
use super::super::names::shown;
use super::super::source::frame::FrameId;

/// What ffmpeg calls the kinds of files, by ending.
const KINDS: [(&str, &str); 6] = [
    ("mp4", "mp4"),
    ("m4v", "mp4"),
    ("mkv", "matroska"),
    ("mov", "mov"),
    ("webm", "webm"),
    ("avi", "avi"),
];
/// Frames a second of frames without times.
const USUAL: f64 = 25.0;
const RATES: [f64; 2] = [0.01, 1000.0];

fn kind(path: &Path) -> Option<&'static str> {
    let ending = path.extension()?.to_str()?.to_lowercase();
    KINDS.iter().find(|(known, _)| *known == ending).map(|(_, kind)| *kind)
}

/// Parses the name of a video to write.
///
/// # Errors
/// In words.
pub(super) fn film_name(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    kind(&path)
        .map(|_| path)
        .ok_or("expected a name that ends in .mp4, .mkv, .mov, .webm or .avi".into())
}

/// Parses frames a second.
///
/// # Errors
/// In words.
pub(super) fn rate(text: &str) -> Result<f64, String> {
    number(text, RATES)
}

/// A video that is written.
pub(super) struct Film {
    file: Unfinished,
    rate: Option<f64>,
    /// The first frame and its time, while the second is not there to tell the rate.
    first: Option<(RgbImage, Option<f64>)>,
    running: Option<Running>,
}

struct Running {
    ffmpeg: Ffmpeg,
    size: (u32, u32),
}

impl Film {
    pub fn new(outputs: &Outputs, path: &Path, rate: Option<f64>) -> Result<Self, Failure> {
        Ok(Self { file: outputs.create(path)?, rate, first: None, running: None })
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// [`Exit::Output`] if ffmpeg failed, [`Exit::Inputs`] for a frame of another size than the first.
    pub fn add(&mut self, id: &FrameId, drawn: RgbImage) -> Result<(), Failure> {
        if self.running.is_none() {
            let Some((first, time_s)) = self.first.take() else {
                self.first = Some((drawn, id.time_s));
                return Ok(());
            };
            self.begin(first, time_s.zip(id.time_s).map(|(from, to)| 1.0 / (to - from)))?;
        }
        let name = shown(self.file.path().as_os_str());
        let Some(running) = &mut self.running else { return Ok(()) };
        if running.size != drawn.dimensions() {
            let ((width, height), (wide, high)) = (running.size, drawn.dimensions());
            let message = format!(
                "{id}: left out of {name}: expected {width} × {height} pixels, got {wide} × {high}"
            );
            return Err(Failure::new(Exit::Inputs, message));
        }
        self.write(&drawn)
    }

    /// Starts ffmpeg with the first frame.
    fn begin(&mut self, first: RgbImage, rate: Option<f64>) -> Result<(), Failure> {
        let rate =
            self.rate.or(rate.filter(|rate| (RATES[0]..=RATES[1]).contains(rate))).unwrap_or(USUAL);
        let (width, height) = first.dimensions();
        let kind = kind(self.file.path()).unwrap_or("mp4");
        let arguments = |path: &Path| -> Vec<OsString> {
            let size = format!("{width}x{height}");
            // The usual form of colours has one value for two columns and rows.
            let even = "pad=ceil(iw/2)*2:ceil(ih/2)*2";
            let words = format!(
                "-y -f rawvideo -pix_fmt rgb24 -video_size {size} -framerate {rate} -i - -vf {even} -pix_fmt \
                 yuv420p -f {kind}"
            );
            words.split(' ').map(OsString::from).chain([ffmpeg::file_argument(path)]).collect()
        };
        let path = self.file.path();
        let name = shown(path.as_os_str());
        remark(format!("{name}: {}", ffmpeg::command_line(&arguments(path))));
        let ffmpeg = Ffmpeg::start(&arguments(self.file.own_path()), Stdio::piped(), Stdio::null());
        let ffmpeg = ffmpeg.map_err(|why| Failure::new(Exit::Output, format!("{name}: {why}")))?;
        self.running = Some(Running { ffmpeg, size: (width, height) });
        self.write(&first)
    }

    fn write(&mut self, drawn: &RgbImage) -> Result<(), Failure> {
        let Some(running) = &mut self.running else { return Ok(()) };
        let written =
            running.ffmpeg.child().stdin.as_mut().map(|stdin| stdin.write_all(drawn.as_raw()));
        match written {
            Some(Err(e)) => Err(self.failed(e)),
            _ => Ok(()),
        }
    }

    fn failed(&mut self, error: std::io::Error) -> Failure {
        let said = self.running.take().map(|running| running.ffmpeg.finish());
        let why = said
            .and_then(Result::err)
            .unwrap_or_else(|| format!("ffmpeg took no more frames: {error}"));
        Failure::new(Exit::Output, format!("{}: {why}", shown(self.file.path().as_os_str())))
    }

    /// Ends the video; without a frame there is none.
    pub fn finish(mut self, outputs: &mut Outputs) -> Result<(), Failure> {
        if let Some((first, _)) = self.first.take() {
            self.begin(first, None)?;
        }
        let Some(running) = self.running.take() else { return Ok(()) };
        let name = shown(self.file.path().as_os_str());
        running
            .ffmpeg
            .finish()
            .map_err(|why| Failure::new(Exit::Output, format!("{name}: {why}")))?;
        Ok(outputs.finish(self.file)?)
    }
}
