//! Factory calibrations of real sensors, as GelSight publishes them.

use std::path::{Path, PathBuf};

use super::super::Error;
use super::super::optics::{Channel, MeasuredSensor, NORMAL_TERMS, POSITION_TERMS};
use super::read_text;

/// GelSight's calibration files (`*.yaml`) in a folder, sorted by name.
///
/// # Errors
/// [`Error::Io`] for the folder, [`Error::Content`] if there is none.
pub fn sensor_files(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(Error::io(folder))?
        .map(|entry| entry.map(|entry| entry.path()).map_err(Error::io(folder)))
        .collect::<Result<_, _>>()?;
    files.retain(|file| file.extension().is_some_and(|e| e == "yaml"));
    if files.is_empty() {
        return Err(Error::Content {
            path: folder.to_owned(),
            expected: "calibration files (*.yaml)".to_owned(),
            found: "none".to_owned(),
        });
    }
    files.sort();
    Ok(files)
}

/// Reads a sensor's shading model from GelSight's calibration file.
///
/// A model there is `nᵀA n + b·n + c` for each light, with coefficients quadratic in position
/// (rows x², xy, y², x, y, 1; for each light A's upper triangle, b, c). It is brought into this
/// crate's terms to second order in the slope and divided by the flat gel's brightness.
///
/// # Errors
/// [`Error::Io`] or [`Error::Content`] for a file that is missing or not as expected.
pub fn read_sensor(path: &Path) -> Result<MeasuredSensor, Error> {
    const QUADRATIC: usize = 10;
    let text = read_text(path)?;
    let bad = |found: String| Error::Content {
        path: path.to_owned(),
        expected: format!("under quadfit: {POSITION_TERMS} rows of {QUADRATIC} numbers a light"),
        found,
    };
    let list = text
        .split_once("quadfit:")
        .map(|(_, rest)| rest)
        .filter(|rest| rest.trim_start().starts_with(&format!("rows: {POSITION_TERMS}\n")))
        .and_then(|rest| rest.split_once("values: ["))
        .and_then(|(_, rest)| rest.split_once(']'))
        .ok_or_else(|| bad("no such matrix".to_owned()))?;
    let values: Vec<f64> = list
        .0
        .split(',')
        .map(|v| v.trim().parse().map_err(|_| bad(format!("{v:?}"))))
        .collect::<Result<_, _>>()?;
    if values.is_empty() || !values.len().is_multiple_of(POSITION_TERMS * QUADRATIC) {
        return Err(bad(format!("{} numbers", values.len())));
    }
    let lights = values.len() / (POSITION_TERMS * QUADRATIC);
    let block =
        |row: usize, light: usize| &values[(row * lights + light) * QUADRATIC..][..QUADRATIC];
    // Where this crate's position terms stand in the file.
    const ROWS: [usize; POSITION_TERMS] = [5, 3, 4, 0, 1, 2];
    let lights = (0..lights)
        .map(|light| {
            let flat = block(ROWS[0], light);
            let flat = flat[5] + flat[8] + flat[9];
            let mut channel: Channel = [[0.0; POSITION_TERMS]; NORMAL_TERMS];
            for (p, &row) in ROWS.iter().enumerate() {
                // A: xx xy xz yy yz zz; b: x y z; c. With nz = 1 − (nx² + ny²)/2.
                let [xx, xy, xz, yy, yz, zz, bx, by, bz, _] = block(row, light)[..] else {
                    unreachable!("a block has ten numbers");
                };
                // The file's normal points to the camera: against the gradient of depth.
                let terms = [-(xz + bx), -(yz + by), xx - zz - 0.5 * bz, xy, yy - zz - 0.5 * bz];
                for (row, term) in channel.iter_mut().zip(terms) {
                    row[p] = term / flat;
                }
            }
            channel
        })
        .collect();
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    Ok(MeasuredSensor { name: name.into_owned(), lights })
}
