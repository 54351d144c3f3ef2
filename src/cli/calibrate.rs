//! `smr-gpu calibrate`: a sensor file from real presses of a ball.

use std::path::{Component, Path, PathBuf};

use smr_gpu::files::Outputs;
use smr_gpu::simulator::Error;
use smr_gpu::simulator::calibrate::{
    self, BALL_MM, Ball, DIFFERENCE_GAIN, Distance, FOLDS, MM_PER_PIXEL, Report, read_sensor,
    sensor_files,
};

use super::detector::number;
use super::draw;
use super::exit::{Exit, Failure};
use super::message::remark;
use super::output::{count, folder_name, line};

/// Shown below the help.
const EXAMPLES: &str = "\
Examples:
  smr-gpu calibrate --presses presses --write mine.json
  smr-gpu calibrate --presses presses --radius 3 --mm-per-pixel 0.03 --write mine.json
  smr-gpu detect picture.png --sensor mine.json";

/// Fit a sensor to pictures of a ball pressed into it
///
/// DIR holds background.png, the untouched gel, and six or more pictures of presses of a ball of known radius.
/// presses.csv (file,center_x_px,center_y_px,contact_radius_px) may say where the contacts are; without it they are
/// found in the pictures. The scale comes from the ball's outline, which shows where it is pressed in about as deep
/// as its radius, or from --mm-per-pixel. The light is fitted to some presses and compared with the others
/// (cross-validation), in crops around each contact: mean absolute difference in 8-bit levels, PSNR and SSIM. --write
/// makes a file of it for --sensor.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Folder with background.png and the presses.
    #[arg(long, value_name = "DIR")]
    presses: PathBuf,

    /// Radius of the ball.
    #[arg(long, value_name = "MM", default_value_t = 2.0, allow_negative_numbers = true)]
    #[arg(value_parser = |text: &str| number(text, BALL_MM))]
    radius: f64,

    /// Millimetres of gel that a pixel shows [default: by the ball's outline].
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    #[arg(value_parser = |text: &str| number(text, MM_PER_PIXEL))]
    mm_per_pixel: Option<f64>,

    /// Write the fitted sensor: detect, eval and simulate take it as --sensor. It is called as the file
    /// is, and names background.png as its frame without contact.
    #[arg(long, value_name = "JSON")]
    write: Option<PathBuf>,

    /// Save a real press, the simulated press and their difference side by side.
    #[arg(long, value_name = "PNG")]
    save: Option<PathBuf>,

    /// Write the fitted light in the form of the simulator's own src/simulator/calibration.json. It is called
    /// as the folder is.
    #[arg(long, value_name = "JSON")]
    optics: Option<PathBuf>,

    /// Folder with GelSight's calibration files (*.yaml) of more sensors for --optics.
    #[arg(long, value_name = "DIR", requires = "optics")]
    flatfields: Option<PathBuf>,
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let sensors = match &args.flatfields {
        Some(folder) => sensor_files(folder).map_err(unreadable)?,
        None => Vec::new(),
    };
    let ball = Ball { radius_mm: args.radius, mm_per_pixel: args.mm_per_pixel };
    let report = calibrate::calibrate(&args.presses, &ball).map_err(unreadable)?;
    let mut outputs = Outputs::sparing(report.files.iter().chain(&sensors));
    outputs.check_all(args.save.iter().chain(&args.write).chain(&args.optics))?;
    // First of all: stdout's reader may go away. Of a fit that is not written there are figures, too.
    let written = write(&args, &report, &sensors, &mut outputs);
    let printed = print(&report);
    written.and(printed).map(|()| Exit::Done)
}

/// Writes what the options name.
///
/// # Errors
/// [`Exit::Inputs`] for a fit that is none, [`Exit::Output`].
fn write(
    args: &Args,
    report: &Report,
    sensors: &[PathBuf],
    outputs: &mut Outputs,
) -> Result<(), Failure> {
    if let Some(path) = &args.save {
        draw::write(outputs, path, &report.comparison)?;
        remark(format!(
            "{}: real, simulated, difference ({DIFFERENCE_GAIN} times, about grey)",
            path.display()
        ));
    }
    if let Some(path) = &args.write {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let reference = from_beside(path, &args.presses.join("background.png"));
        let sensor = report.sensor(&name, reference).map_err(unreadable)?;
        let text = serde_json::to_string_pretty(&sensor)
            .map_err(|e| Failure::new(Exit::Output, format!("{}: {e}", path.display())))?;
        outputs.write(path, text.as_bytes())?;
        remark(format!("{}: for --sensor", path.display()));
    }
    if let Some(path) = &args.optics {
        let name = folder_name(&args.presses);
        let mut fitted = vec![report.optics(&name).map_err(unreadable)?];
        for file in sensors {
            fitted.push(read_sensor(file).map_err(unreadable)?);
        }
        let text = serde_json::to_string(&fitted)
            .map_err(|e| Failure::new(Exit::Output, format!("{}: {e}", path.display())))?;
        outputs.write(path, text.as_bytes())?;
        remark(format!("{}: {}", path.display(), count(fitted.len(), "sensor")));
    }
    Ok(())
}

/// Prints how near simulated presses are to the real ones.
fn print(report: &Report) -> Result<(), Failure> {
    let side = report.crop_px;
    let contacts = if report.found { "found" } else { "from the table" };
    line(format!(
        "{} presses, contacts {contacts}, {side}×{side} crops, {FOLDS}-fold held out",
        report.presses
    ))?;
    line(scale(report))?;
    line("")?;
    line("| renderer | L1 | PSNR, dB | SSIM |")?;
    line("|---|---|---|---|")?;
    let row = |name: &str, d: &Distance| {
        line(format!("| {name} | {:.2} | {:.2} | {:.3} |", d.l1, d.psnr_db, d.ssim))
    };
    row("the untouched background, nothing drawn", &report.background)?;
    row("this simulator, held out", &report.held_out)
}

fn unreadable(error: Error) -> Failure {
    Failure::new(Exit::Inputs, error)
}

/// How large a pixel is, and whence that is known.
fn scale(report: &Report) -> String {
    let scale = report.mm_per_pixel;
    match report.outline_px {
        None => format!("{scale} mm a pixel, as said"),
        Some([mean, deviation]) => format!(
            "{scale:.5} mm a pixel by the ball's outline, {mean:.1} ± {deviation:.1} pixels; too large if \
             most presses are less deep than the ball's radius"
        ),
    }
}

/// A file's name for a file that may lie elsewhere: relative to the other's folder, so that both can be moved
/// together, unless they have nothing in common.
fn from_beside(other: &Path, file: &Path) -> PathBuf {
    let folder = match other.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    let (Ok(folder), Ok(file)) = (folder.canonicalize(), file.canonicalize()) else {
        return file.to_path_buf();
    };
    relative(&folder, &file)
}

/// The way from a folder to a file, both absolute; the file's own name where only the root is common.
fn relative(folder: &Path, file: &Path) -> PathBuf {
    let common = folder.components().zip(file.components()).take_while(|(a, b)| a == b).count();
    if common <= 1 {
        return file.to_path_buf();
    }
    let up = folder.components().skip(common).map(|_| Component::ParentDir);
    up.chain(file.components().skip(common)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reference_is_named_from_the_sensor_file() {
        let to = |folder, file| relative(Path::new(folder), Path::new(file));
        assert_eq!(to("/a/b", "/a/b/c/x.png"), Path::new("c/x.png"));
        assert_eq!(to("/a/b/c", "/a/d/x.png"), Path::new("../../d/x.png"));
        assert_eq!(to("/a/b", "/a/bc/x.png"), Path::new("../bc/x.png"));
        assert_eq!(to("/a/b", "/d/x.png"), Path::new("/d/x.png"));
    }
}
