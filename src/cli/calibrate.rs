//! `smr-gpu calibrate`: the simulated sensor's optics against real presses of a ball.

use std::io::Cursor;
use std::path::PathBuf;

use image::ImageFormat;
use smr_gpu::files::Outputs;
use smr_gpu::simulator::Error;
use smr_gpu::simulator::calibrate::{
    self, CROP_PX, DIFFERENCE_GAIN, Distance, FOLDS, read_sensor, sensor_files,
};

use super::exit::{Exit, Failure};
use super::output::{count, line, tell};

/// Compare the simulated sensor with real presses of a ball
///
/// Fits the optics to some presses and measures the distance to the others, round about, in crops
/// about each contact: mean absolute difference in 8-bit levels, PSNR and SSIM.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder with background.png, the presses and presses.csv.
    #[arg(long, value_name = "DIR")]
    presses: PathBuf,

    /// Save a real press, the simulated press and their difference side by side.
    #[arg(long, value_name = "PNG")]
    save: Option<PathBuf>,

    /// Write the fitted sensor, in the form of the simulator's own src/simulator/calibration.json.
    #[arg(long, value_name = "JSON")]
    write: Option<PathBuf>,

    /// Folder with GelSight's calibration files (*.yaml) of more sensors for --write.
    #[arg(long, value_name = "DIR", requires = "write")]
    flatfields: Option<PathBuf>,
}

pub(super) fn run(args: Args) -> Result<Exit, Failure> {
    let sensors = match &args.flatfields {
        Some(folder) => sensor_files(folder).map_err(unreadable)?,
        None => Vec::new(),
    };
    let report = calibrate::calibrate(&args.presses).map_err(unreadable)?;
    let mut outputs = Outputs::sparing(report.files.iter().chain(&sensors));
    for file in args.save.iter().chain(&args.write) {
        outputs.check(file)?;
    }
    line(format!("{} presses, {CROP_PX}×{CROP_PX} crops, {FOLDS}-fold held out", report.presses))?;
    line("")?;
    line("| renderer | L1 | PSNR, dB | SSIM |")?;
    line("|---|---|---|---|")?;
    let row = |name: &str, d: &Distance| {
        line(format!("| {name} | {:.2} | {:.2} | {:.3} |", d.l1, d.psnr_db, d.ssim))
    };
    row("the untouched background, nothing drawn", &report.background)?;
    row("this simulator, held out", &report.held_out)?;
    if let Some(path) = &args.save {
        let mut png = Cursor::new(Vec::new());
        report
            .comparison
            .write_to(&mut png, ImageFormat::Png)
            .map_err(|e| Failure::new(Exit::Output, format!("{}: {e}", path.display())))?;
        outputs.write(path, png.get_ref())?;
        tell(format!(
            "{}: real, simulated, difference ({DIFFERENCE_GAIN} times, about grey)",
            path.display()
        ));
    }
    if let Some(path) = &args.write {
        let mut fitted = vec![report.sensor().map_err(unreadable)?];
        for file in &sensors {
            fitted.push(read_sensor(file).map_err(unreadable)?);
        }
        let text = serde_json::to_string(&fitted)
            .map_err(|e| Failure::new(Exit::Output, format!("{}: {e}", path.display())))?;
        outputs.write(path, text.as_bytes())?;
        tell(format!("{}: {}", path.display(), count(fitted.len(), "sensor")));
    }
    Ok(Exit::Done)
}

fn unreadable(error: Error) -> Failure {
    Failure::new(Exit::Inputs, error)
}
