//! What `detect` writes into files, as far as it is asked for.

use std::path::{Path, PathBuf};

use image::RgbImage;
use image::imageops::crop_imm;
use smr_gpu::files::Outputs;
use smr_gpu::{Detection, Detections};

use super::super::draw::Artist;
use super::super::exit::{Exit, Failure};
use super::super::gallery::Gallery;
use super::super::source::frame::Shot;
use super::lists::{Coco, Csv};
use super::video::Film;

#[derive(Debug, clap::Args)]
pub(super) struct FileArgs {
    /// Write each picture, with boxes, classes and scores drawn, into this folder as PNG.
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    save: Option<PathBuf>,

    /// Write a table with a row for each snap.
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    csv: Option<PathBuf>,

    /// Write the snaps as COCO results: `image_id` counts the frames from 0, `category_id` the classes from 1.
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    coco: Option<PathBuf>,

    /// Write a YOLO text file for each picture into this folder. Each line is a snap: class from 0, centre x and y,
    /// width and height as fractions of the picture, and score.
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    yolo: Option<PathBuf>,

    /// Write the crop of each box into this folder as PNG, best score first.
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    crops: Option<PathBuf>,

    /// Write a video of the drawn pictures (.mp4, .mkv, .mov, .webm or .avi) through ffmpeg.
    #[arg(long, value_name = "FILE", help_heading = "Output", value_parser = super::video::film_name)]
    video: Option<PathBuf>,

    /// Frames a second of --video [default: as the first two frames are apart, or 25].
    #[arg(long, value_name = "N", help_heading = "Output", requires = "video")]
    #[arg(value_parser = super::video::rate, allow_negative_numbers = true)]
    fps: Option<f64>,
}

impl FileArgs {
    /// The files of which there is one a run.
    pub fn single(&self) -> impl Iterator<Item = &Path> {
        [&self.csv, &self.coco, &self.video].into_iter().flatten().map(PathBuf::as_path)
    }
}

/// The files of a run. One that cannot be written is told once, and takes none of the others with it.
pub(super) struct Files<'a> {
    save: Option<Gallery>,
    csv: Option<Csv>,
    coco: Option<Coco>,
    yolo: Option<Gallery>,
    crops: Option<Gallery>,
    film: Option<Film>,
    artist: Artist<'a>,
}

impl<'a> Files<'a> {
    /// # Errors
    /// [`Exit::Output`], [`Exit::Usage`] for a file that is an input.
    pub fn create(
        args: &FileArgs,
        outputs: &mut Outputs,
        classes: &'a [String],
    ) -> Result<Self, Failure> {
        let folder = |path: &Option<PathBuf>| path.as_deref().map(Gallery::create).transpose();
        let mut yolo = folder(&args.yolo)?;
        if let Some(yolo) = &mut yolo {
            yolo.write(
                outputs,
                "classes",
                &classes.iter().map(|c| format!("{c}\n")).collect::<String>(),
            )?;
        }
        Ok(Self {
            save: folder(&args.save)?,
            crops: folder(&args.crops)?,
            yolo,
            csv: args.csv.as_deref().map(|path| Csv::create(outputs, path)).transpose()?,
            coco: args.coco.as_deref().map(|path| Coco::create(outputs, path)).transpose()?,
            film: args
                .video
                .as_deref()
                .map(|path| Film::new(outputs, path, args.fps))
                .transpose()?,
            artist: Artist::new(classes),
        })
    }

    /// Writes what was found in a frame.
    pub fn add(&mut self, outputs: &mut Outputs, shot: &Shot, found: &Detections) -> Exit {
        let (mut exit, id) = (Exit::Done, &shot.id);
        keep(&mut self.csv, &mut exit, |csv| csv.add(id, found));
        keep(&mut self.coco, &mut exit, |coco| coco.add(id, found));
        let mut tell =
            |result: Result<(), Failure>| exit = exit.max(super::super::exit::told(result));
        if let Some(yolo) = &self.yolo {
            tell(yolo.write(outputs, &id.stem(), &yolo_text(found)));
        }
        if self.crops.is_none() && self.save.is_none() && self.film.is_none() {
            return exit;
        }
        let picture = match shot.pixels.to_rgb() {
            Ok(picture) => picture,
            Err(e) => return exit.max(Failure::about(id, &e).told().exit),
        };
        if let Some(crops) = &self.crops {
            for (number, snap) in (1..).zip(&found.detections) {
                let crop = cut(&picture, snap);
                tell(crops.save(outputs, &format!("{}.{number}", id.stem()), &crop));
            }
        }
        if self.save.is_none() && self.film.is_none() {
            return exit;
        }
        let drawn = self.artist.draw_found(picture, found);
        if let Some(save) = &self.save {
            tell(save.save(outputs, &id.stem(), &drawn));
        }
        keep(&mut self.film, &mut exit, |film| film.add(id, drawn));
        exit
    }

    /// Ends the files that hold more than one frame.
    pub fn finish(self, outputs: &mut Outputs) -> Exit {
        let finished = [
            self.csv.map_or(Ok(()), |csv| csv.finish(outputs)),
            self.coco.map_or(Ok(()), |coco| coco.finish(outputs)),
            self.film.map_or(Ok(()), |film| film.finish(outputs)),
        ];
        finished.into_iter().map(super::super::exit::told).fold(Exit::Done, Exit::max)
    }
}

/// Writes to a file; one that fails by more than its exit code's share is given up.
fn keep<T>(
    file: &mut Option<T>,
    exit: &mut Exit,
    write: impl FnOnce(&mut T) -> Result<(), Failure>,
) {
    if let Some(Err(failure)) = file.as_mut().map(write) {
        let failure = failure.told();
        // One frame that does not fit leaves the file whole.
        if failure.exit == Exit::Output {
            *file = None;
        }
        *exit = (*exit).max(failure.exit);
    }
}

/// The snaps of a picture in YOLO's form.
fn yolo_text(found: &Detections) -> String {
    let size = [found.width as f32, found.height as f32];
    let line = |snap: &Detection| {
        let ([x, y], [width, height]) = (snap.center(), snap.size());
        let parts = [x / size[0], y / size[1], width / size[0], height / size[1], snap.score];
        format!("{} {}\n", snap.class_index, parts.map(|v| format!("{v:.6}")).join(" "))
    };
    found.detections.iter().map(line).collect()
}

/// The pixels that a box touches; one at least.
fn cut(picture: &RgbImage, snap: &Detection) -> RgbImage {
    let [x1, y1, x2, y2] = snap.bbox;
    let span = |from: f32, to: f32, size: u32| {
        let from = (from.floor().max(0.0) as u32).min(size - 1);
        (from, (to.ceil() as u32).min(size).max(from + 1) - from)
    };
    let ((x, width), (y, height)) = (span(x1, x2, picture.width()), span(y1, y2, picture.height()));
    crop_imm(picture, x, y, width, height).to_image()
}
