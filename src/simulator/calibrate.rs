//! Fits the optics to real presses of a ball, and measures how far simulated presses are from
//! real ones that the fit has not seen.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use image::RgbImage;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Error;
use super::contact::{NO_BODY, Stop, solve};
use super::gel::{Elasticity, Grid, Layer};
use super::optics::{
    Channel, Fit, MeasuredSensor, NORMAL_TERMS, POSITION_TERMS, Shading, TERMS, normal_terms,
    position_terms,
};
use super::surface::Surface;
use crate::{files, picture};

/// Radius of the ball in millimetres.
const BALL_MM: f64 = 2.0;
/// Side of a pixel of the presses, in millimetres.
const PRESS_MM_PER_PX: f64 = 0.0295;
/// Longest table of presses or calibration file, in bytes.
const MAX_TEXT: u64 = 1 << 24;
/// Side of the crop round a contact in which pictures are compared, in pixels.
pub const CROP_PX: usize = 300;
/// Parts that the presses are dealt into; each is measured by a fit on the others.
pub const FOLDS: usize = 6;
/// Grid of the ball's contact: a cell is two pixels of the presses.
const GRID: Grid = Grid { cells: 640, spacing_mm: 2.0 * PRESS_MM_PER_PX };
const STOP: Stop = Stop { tolerance_mm: 1e-5, max_iterations: 400 };

/// A press of the ball into a real gel.
struct Press {
    file: PathBuf,
    picture: RgbImage,
    center_px: [f64; 2],
    contact_radius_px: u32,
}

/// How far pictures are from real ones: means over the presses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Distance {
    /// Mean absolute difference in 8-bit levels.
    pub l1: f64,
    /// Peak signal to noise ratio in decibels.
    pub psnr_db: f64,
    /// Structural similarity (Wang et al. 2004; 7×7 windows, mean over channels).
    pub ssim: f64,
}

/// What [`calibrate`] finds.
#[derive(Debug, Clone)]
pub struct Report {
    /// Number of presses.
    pub presses: usize,
    /// The files that it was found from.
    pub files: Vec<PathBuf>,
    /// The untouched gel's picture against each press.
    pub background: Distance,
    /// Simulated presses against real ones that their fit has not seen.
    pub held_out: Distance,
    /// The fit on all presses.
    pub shading: Shading,
    /// Real press, simulated press and difference, side by side.
    pub comparison: RgbImage,
}

impl Report {
    /// The fit on all presses as a sensor of three lights.
    ///
    /// # Errors
    /// [`Error::PoorFit`] if the simulated presses are no nearer to the real ones than the untouched
    /// background is.
    pub fn sensor(&self) -> Result<MeasuredSensor, Error> {
        let (background, held_out) = (self.background.l1, self.held_out.l1);
        // Not `held_out >= background`: a NaN must fail.
        if held_out < background {
            let name = "gelsight_ball_presses".to_owned();
            return Ok(MeasuredSensor { name, lights: self.shading.channels.to_vec() });
        }
        Err(Error::PoorFit { background, held_out })
    }
}

/// Factor by which [`Report::comparison`] magnifies differences about mid grey.
pub const DIFFERENCE_GAIN: i32 = 4;

/// Fits and measures on a folder with `background.png`, the presses and `presses.csv`
/// (`file,center_x_px,center_y_px,contact_radius_px`).
///
/// # Errors
/// [`Error::Io`], [`Error::Picture`] or [`Error::Content`] for a file that is missing or not as
/// expected; [`Error::Undetermined`] if the presses show too little of the gel for a fit.
pub fn calibrate(folder: &Path) -> Result<Report, Error> {
    let (background_file, table) = (folder.join("background.png"), folder.join("presses.csv"));
    let background = open(&background_file)?;
    let presses = read_presses(folder, &table, &background)?;
    let files = presses.iter().map(|p| p.file.clone()).chain([background_file, table]).collect();
    let surfaces = ball_surfaces(presses.iter().map(|p| p.contact_radius_px));
    let surface = |press: &Press| &surfaces[&press.contact_radius_px];

    // Observations of each press by itself: a fold's fit is a sum over the other folds.
    let observed: Vec<[Fit; 3]> =
        presses.par_iter().map(|press| observe(press, surface(press), &background)).collect();
    let sum = |keep: &dyn Fn(usize) -> bool| {
        let mut sum = [Fit::new(), Fit::new(), Fit::new()];
        for (_, fits) in observed.iter().enumerate().filter(|(i, _)| keep(*i)) {
            for (sum, fit) in sum.iter_mut().zip(fits) {
                sum.merge(fit);
            }
        }
        sum
    };
    let fits: Vec<[Fit; 3]> = (0..FOLDS).map(|fold| sum(&|i| i % FOLDS != fold)).collect();
    // A fit on all presses determines no less than one that leaves some out.
    let rank = fits.iter().flatten().map(Fit::rank).min().unwrap_or(0);
    if rank < TERMS {
        let pixels = presses.iter().map(|p| crop_pixels(p, &background)).sum();
        let path = folder.to_owned();
        return Err(Error::Undetermined { path, expected: TERMS, found: rank, pixels });
    }
    let solve = |fits: &[Fit; 3]| Shading { channels: fits.each_ref().map(Fit::solve) };
    let folds: Vec<Shading> = fits.iter().map(solve).collect();

    let simulated: Vec<RgbImage> = presses
        .par_iter()
        .enumerate()
        .map(|(i, press)| draw(press, surface(press), &background, &folds[i % FOLDS]))
        .collect();
    let distances: Vec<[Distance; 2]> = presses
        .par_iter()
        .zip(&simulated)
        .map(|(press, simulated)| {
            let real = crop(&press.picture, press);
            [distance(&real, &crop(&background, press)), distance(&real, &crop(simulated, press))]
        })
        .collect();
    let mean = |which: usize| {
        let n = distances.len() as f64;
        let sum = |f: fn(&Distance) -> f64| distances.iter().map(|d| f(&d[which])).sum::<f64>() / n;
        Distance { l1: sum(|d| d.l1), psnr_db: sum(|d| d.psnr_db), ssim: sum(|d| d.ssim) }
    };
    // The press of median distance stands for the others.
    let mut order: Vec<usize> = (0..presses.len()).collect();
    order.sort_by(|&a, &b| distances[a][1].l1.total_cmp(&distances[b][1].l1));
    let shown = order[order.len() / 2];
    let comparison = side_by_side(
        &crop(&presses[shown].picture, &presses[shown]),
        &crop(&simulated[shown], &presses[shown]),
    );
    Ok(Report {
        presses: presses.len(),
        files,
        background: mean(0),
        held_out: mean(1),
        shading: solve(&sum(&|_| true)),
        comparison,
    })
}

fn open(path: &Path) -> Result<RgbImage, Error> {
    let picture = picture::read(path);
    let picture = picture.map_err(|source| Error::Picture { path: path.to_owned(), source })?;
    Ok(picture.into_rgb8())
}

fn read_text(path: &Path) -> Result<String, Error> {
    let bytes = files::read(path, MAX_TEXT).map_err(Error::io(path))?;
    String::from_utf8(bytes).map_err(|e| Error::Content {
        path: path.to_owned(),
        expected: "text".to_owned(),
        found: e.to_string(),
    })
}

fn read_presses(folder: &Path, path: &Path, background: &RgbImage) -> Result<Vec<Press>, Error> {
    let text = read_text(path)?;
    let bad = |path: &Path, expected: &str, found: &str| Error::Content {
        path: path.to_owned(),
        expected: expected.to_owned(),
        found: found.to_owned(),
    };
    let mut presses = Vec::new();
    for line in text.lines().skip(1).filter(|line| !line.is_empty()) {
        let wanted = "file,center_x_px,center_y_px,contact_radius_px";
        let fields: Vec<&str> = line.split(',').collect();
        let [file, x, y, radius] = fields[..] else {
            return Err(bad(path, wanted, line));
        };
        let (Ok(x), Ok(y), Ok(radius)) = (x.parse(), y.parse(), radius.parse::<u32>()) else {
            return Err(bad(path, wanted, line));
        };
        let inside = |at: f64, side: u32| (0.0..f64::from(side)).contains(&at);
        if !inside(x, background.width()) || !inside(y, background.height()) {
            return Err(bad(path, "a centre inside the picture", line));
        }
        if !(1..=67).contains(&radius) {
            return Err(bad(path, "a contact radius of 1 to 67 pixels (the ball's own)", line));
        }
        let file = folder.join(file);
        let picture = open(&file)?;
        if picture.dimensions() != background.dimensions() {
            let size = |p: &RgbImage| format!("{} × {} pixels", p.width(), p.height());
            return Err(bad(&file, &size(background), &size(&picture)));
        }
        presses.push(Press { file, picture, center_px: [x, y], contact_radius_px: radius });
    }
    if presses.len() < FOLDS {
        let found = format!("{} presses", presses.len());
        return Err(bad(path, &format!("{FOLDS} presses or more"), &found));
    }
    Ok(presses)
}

/// The gel's surface under the ball for each contact radius.
fn ball_surfaces(radii: impl Iterator<Item = u32>) -> BTreeMap<u32, Surface> {
    let radii: std::collections::BTreeSet<u32> = radii.collect();
    let radii: Vec<u32> = radii.into_iter().collect();
    radii
        .into_par_iter()
        .map(|radius| (radius, ball_surface(f64::from(radius) * PRESS_MM_PER_PX)))
        .collect()
}

/// Finds the depth at which the contact has this radius, by bisection.
fn ball_surface(contact_mm: f64) -> Surface {
    let mut elasticity = Elasticity::new(&Layer::default(), GRID);
    let n = GRID.cells;
    let mut press = |depth: f64| {
        let mut body = vec![NO_BODY; GRID.len()];
        for y in 0..n {
            for x in 0..n {
                let r2 = GRID.position(x).powi(2) + GRID.position(y).powi(2);
                if r2 < BALL_MM * BALL_MM {
                    body[y * n + x] = (depth - BALL_MM + (BALL_MM * BALL_MM - r2).sqrt()) as f32;
                }
            }
        }
        let contact = solve(&mut elasticity, &body, &[], STOP);
        let cells = contact.pressure.iter().filter(|p| **p > 0.0).count() as f64;
        let radius = (cells / std::f64::consts::PI).sqrt() * GRID.spacing_mm;
        (radius, contact)
    };
    let (mut low, mut high) = (0.0, 2.0 * BALL_MM);
    for _ in 0..12 {
        let middle = 0.5 * (low + high);
        if press(middle).0 < contact_mm {
            low = middle;
        } else {
            high = middle;
        }
    }
    let (_, contact) = press(0.5 * (low + high));
    Surface::new(GRID, contact.displacement)
}

/// Pixels of the crop round a press that lie in the picture: the ranges of x and y.
fn crop_range(press: &Press, picture: &RgbImage) -> [std::ops::Range<u32>; 2] {
    let half = CROP_PX as f64 / 2.0;
    let range = |center: f64, side: u32| {
        let low = (center - half).round().clamp(0.0, f64::from(side)) as u32;
        let high = (center + half).round().clamp(0.0, f64::from(side)) as u32;
        low..high
    };
    [range(press.center_px[0], picture.width()), range(press.center_px[1], picture.height())]
}

fn crop_pixels(press: &Press, picture: &RgbImage) -> usize {
    crop_range(press, picture).iter().map(ExactSizeIterator::len).product()
}

fn crop(picture: &RgbImage, press: &Press) -> RgbImage {
    let [xs, ys] = crop_range(press, picture);
    image::imageops::crop_imm(picture, xs.start, ys.start, xs.end - xs.start, ys.end - ys.start)
        .to_image()
}

/// Position in −1 to 1 over the picture's width, and the surface's gradient, at a pixel.
fn geometry(press: &Press, surface: &Surface, size: (u32, u32), x: u32, y: u32) -> [f64; 4] {
    let half = f64::from(size.0) / 2.0;
    let (x, y) = (f64::from(x), f64::from(y));
    let at = surface
        .at((x - press.center_px[0]) * PRESS_MM_PER_PX, (y - press.center_px[1]) * PRESS_MM_PER_PX);
    [
        (x + 0.5 - half) / half,
        (y + 0.5 - f64::from(size.1) / 2.0) / half,
        f64::from(at.gradient[0]),
        f64::from(at.gradient[1]),
    ]
}

fn observe(press: &Press, surface: &Surface, background: &RgbImage) -> [Fit; 3] {
    let mut fits = [Fit::new(), Fit::new(), Fit::new()];
    let [xs, ys] = crop_range(press, background);
    for y in ys.step_by(2) {
        for x in xs.clone().step_by(2) {
            let [px, py, gx, gy] = geometry(press, surface, background.dimensions(), x, y);
            let (position, normal) = (position_terms(px, py), normal_terms(gx, gy));
            let flat = background.get_pixel(x, y).0;
            let seen = press.picture.get_pixel(x, y).0;
            for (c, fit) in fits.iter_mut().enumerate() {
                fit.add(&position, &normal, f64::from(flat[c]), f64::from(seen[c]));
            }
        }
    }
    fits
}

/// The simulated press: the background's picture, shaded.
fn draw(press: &Press, surface: &Surface, background: &RgbImage, shading: &Shading) -> RgbImage {
    let mut picture = background.clone();
    let [xs, ys] = crop_range(press, background);
    for y in ys {
        for x in xs.clone() {
            let [px, py, gx, gy] = geometry(press, surface, background.dimensions(), x, y);
            let change = shading.relative(px, py, gx, gy);
            let pixel = picture.get_pixel_mut(x, y);
            for (level, change) in pixel.0.iter_mut().zip(change) {
                *level = (f64::from(*level) * (1.0 + change)).round().clamp(0.0, 255.0) as u8;
            }
        }
    }
    picture
}

fn distance(a: &RgbImage, b: &RgbImage) -> Distance {
    let count = a.as_raw().len() as f64;
    let differences =
        || a.as_raw().iter().zip(b.as_raw()).map(|(&a, &b)| f64::from(a) - f64::from(b));
    let mse = differences().map(|d| d * d).sum::<f64>() / count;
    Distance {
        l1: differences().map(f64::abs).sum::<f64>() / count,
        psnr_db: 10.0 * (255.0 * 255.0 / mse.max(1e-12)).log10(),
        ssim: ssim(a, b),
    }
}

/// Structural similarity with uniform 7×7 windows and sample covariances, as scikit-image's
/// default, averaged over channels.
fn ssim(a: &RgbImage, b: &RgbImage) -> f64 {
    const WINDOW: usize = 7;
    let (width, height) = (a.width() as usize, a.height() as usize);
    let (c1, c2) = ((0.01f64 * 255.0).powi(2), (0.03f64 * 255.0).powi(2));
    let count = (WINDOW * WINDOW) as f64;
    let unbiased = count / (count - 1.0);
    let mut sum = 0.0;
    let mut windows = 0usize;
    for channel in 0..3 {
        // Running sums of a, b, a², b² and ab over the window's rows, a column each.
        let value = |picture: &RgbImage, x: usize, y: usize| {
            f64::from(picture.as_raw()[(y * width + x) * 3 + channel])
        };
        let products = |x: usize, y: usize| {
            let (p, q) = (value(a, x, y), value(b, x, y));
            [p, q, p * p, q * q, p * q]
        };
        for y in 0..(height + 1).saturating_sub(WINDOW) {
            let columns: Vec<[f64; 5]> = (0..width)
                .map(|x| {
                    let mut column = [0.0; 5];
                    for dy in 0..WINDOW {
                        for (sum, v) in column.iter_mut().zip(products(x, y + dy)) {
                            *sum += v;
                        }
                    }
                    column
                })
                .collect();
            for window in columns.windows(WINDOW) {
                let mut s = [0.0; 5];
                for column in window {
                    for (s, v) in s.iter_mut().zip(column) {
                        *s += v / count;
                    }
                }
                let [ma, mb, aa, bb, ab] = s;
                let (va, vb) = (unbiased * (aa - ma * ma), unbiased * (bb - mb * mb));
                let cov = unbiased * (ab - ma * mb);
                sum += (2.0 * ma * mb + c1) * (2.0 * cov + c2)
                    / ((ma * ma + mb * mb + c1) * (va + vb + c2));
                windows += 1;
            }
        }
    }
    sum / windows.max(1) as f64
}

/// Real, simulated, and the difference magnified about mid grey, with a gap between.
fn side_by_side(real: &RgbImage, simulated: &RgbImage) -> RgbImage {
    const GAP: u32 = 6;
    let (w, h) = real.dimensions();
    let mut picture = RgbImage::from_pixel(3 * w + 2 * GAP, h, image::Rgb([255; 3]));
    for (x, y, &r) in real.enumerate_pixels() {
        let s = *simulated.get_pixel(x, y);
        let mut d = image::Rgb([0; 3]);
        for c in 0..3 {
            let difference = i32::from(s.0[c]) - i32::from(r.0[c]);
            d.0[c] = (128 + DIFFERENCE_GAIN * difference).clamp(0, 255) as u8;
        }
        picture.put_pixel(x, y, r);
        picture.put_pixel(w + GAP + x, y, s);
        picture.put_pixel(2 * (w + GAP) + x, y, d);
    }
    picture
}

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
