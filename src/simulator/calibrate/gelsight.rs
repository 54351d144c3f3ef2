//! Factory calibrations of real sensors, as GelSight publishes them.

use std::path::{Path, PathBuf};

use super::super::Error;
use super::super::optics::{Channel, MeasuredSensor, NORMAL_TERMS, POSITION_TERMS, position_terms};
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
/// A model there is `nᵀA n + b·n + c` for each light, its ten coefficients (A's upper triangle, b,
/// c) quadratic in position (rows x², xy, y², x, y, 1). As GelSight's own renderer reads it (gssim,
/// `shadeQuadratic.cpp`): A is symmetric, and x and y run along the picture from its middle, one for
/// its shorter side. It is brought into this crate's terms to second order in the slope and divided
/// by the flat gel's brightness.
///
/// # Errors
/// [`Error::Io`] or [`Error::Content`] for a file that is missing or not as expected.
pub fn read_sensor(path: &Path) -> Result<MeasuredSensor, Error> {
    let text = read_text(path)?;
    let bad = |expected: &str, found: String| Error::Content {
        path: path.to_owned(),
        expected: expected.to_owned(),
        found,
    };
    let size = model_size(&text).ok_or_else(|| {
        bad("under flatfield: modelsize: (width, height)", "no such size".to_owned())
    })?;
    let rows = format!("under quadfit: {POSITION_TERMS} rows of {QUADRATIC} numbers a light");
    let values = quadratic_fit(&text).map_err(|found| bad(&rows, found))?;
    let lights = values.len() / (POSITION_TERMS * QUADRATIC);
    let block =
        |row: usize, light: usize| &values[(row * lights + light) * QUADRATIC..][..QUADRATIC];
    // Where this crate's position terms stand in the file, and how large they are there at 1 here,
    // which is half a side: along x, along y.
    const ROWS: [usize; POSITION_TERMS] = [5, 3, 4, 0, 1, 2];
    let [x, y] = size.map(|side| side / (2.0 * f64::min(size[0], size[1])));
    let there = position_terms(x, y);
    let lights = (0..lights)
        .map(|light| {
            let flat = block(ROWS[0], light);
            let flat = flat[5] + flat[8] + flat[9];
            let mut channel: Channel = [[0.0; POSITION_TERMS]; NORMAL_TERMS];
            for (p, (&row, there)) in ROWS.iter().zip(there).enumerate() {
                let terms = in_slope(block(row, light));
                for (row, term) in channel.iter_mut().zip(terms) {
                    row[p] = term * there / flat;
                }
            }
            channel
        })
        .collect();
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    Ok(MeasuredSensor { name: name.into_owned(), lights })
}

/// Numbers of a light and position term in a file.
const QUADRATIC: usize = 10;

/// Size of the picture that the model was fitted on: its proportions count.
fn model_size(text: &str) -> Option<[f64; 2]> {
    let (_, rest) = text.split_once("modelsize: (")?;
    let (width, height) = rest.split_once(')')?.0.split_once(',')?;
    let size: [f64; 2] = [width.trim().parse().ok()?, height.trim().parse().ok()?];
    size.iter().all(|side| side.is_finite() && *side > 0.0).then_some(size)
}

/// The numbers under `quadfit`, or what stands in their place.
fn quadratic_fit(text: &str) -> Result<Vec<f64>, String> {
    let list = text
        .split_once("quadfit:")
        .map(|(_, rest)| rest)
        .filter(|rest| rest.trim_start().starts_with(&format!("rows: {POSITION_TERMS}\n")))
        .and_then(|rest| rest.split_once("values: ["))
        .and_then(|(_, rest)| rest.split_once(']'))
        .ok_or("no such matrix")?;
    let values: Vec<f64> = list
        .0
        .split(',')
        .map(|v| v.trim().parse().map_err(|_| format!("{v:?}")))
        .collect::<Result<_, _>>()?;
    match values.is_empty() || !values.len().is_multiple_of(POSITION_TERMS * QUADRATIC) {
        true => Err(format!("{} numbers", values.len())),
        false => Ok(values),
    }
}

/// The terms in the slope of one block of coefficients: what changes with the normal, whose third
/// component is 1 − (nx² + ny²)/2 to second order. The file's normal points to the camera, against
/// the gradient of depth.
fn in_slope(block: &[f64]) -> [f64; NORMAL_TERMS] {
    let [xx, xy, xz, yy, yz, zz, bx, by, bz, _] = block[..] else {
        unreachable!("a block has ten numbers");
    };
    let flattening = zz + 0.5 * bz;
    [-(2.0 * xz + bx), -(2.0 * yz + by), xx - flattening, 2.0 * xy, yy - flattening]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One light whose block is the same in every row, on a picture of 3 : 2.
    fn sensor(block: [f64; QUADRATIC]) -> Channel {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("one.yaml");
        let values = [block; POSITION_TERMS].as_flattened().to_vec();
        let text = format!(
            "quadfit: \n    rows: 6\n    cols: 10\n    values: {values:?}\nflatfield: \n    modelsize: (600, 400)\n"
        );
        std::fs::write(&path, text).expect("written");
        read_sensor(&path).expect("a sensor").lights[0]
    }

    /// By hand: with n = (u, v, 1 − (u² + v²)/2) and A symmetric, nᵀA n + b·n + c is 25 for flat
    /// gel, and (2·3 + 7) u + (2·5 + 8) v + (1 − 6 − 4.5) u² + 2·2 uv + (4 − 6 − 4.5) v² are added to
    /// it; the gradient of depth is −n.
    #[test]
    fn a_block_is_a_symmetric_matrix() {
        let [nx, ny, nxx, nxy, nyy] = sensor([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0]);
        let flat = 6.0 + 9.0 + 10.0;
        let found = [nx, ny, nxx, nxy, nyy].map(|terms| terms[0] * flat);
        assert_eq!(found.map(|v| (v * 1e9).round() / 1e9), [-13.0, -18.0, -9.5, 4.0, -6.5]);
    }

    /// x reaches 0.75 and y 0.5 at the edges of a picture of 3 : 2, where this crate's reach 1.
    #[test]
    fn positions_are_in_shorter_sides() {
        let [nx, ..] = sensor([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0]);
        assert_eq!(nx, [1.0, 0.75, 0.5, 0.5625, 0.375, 0.25]);
    }
}
