//! Fits a sensor to real presses of a ball: its scale and its light; and measures how far simulated
//! presses are from real ones that the fit has not seen.
//!
//! | module | what it does |
//! |---|---|
//! | `find` | where the ball is in a picture, and how large |
//! | `ball` | the gel's surface under it |
//! | `distance` | how far two pictures are apart |
//! | `gelsight` | factory calibrations that others measured |

mod ball;
mod distance;
mod find;
mod gelsight;

use std::path::{Path, PathBuf};

use image::RgbImage;
use rayon::prelude::*;

use super::optics::{Fit, MeasuredSensor, Shading, TERMS, normal_terms, position_terms};
use super::surface::Surface;
use super::{Error, on_threads};
use crate::sensor::{Agreement, Light, Sensor};
use crate::{files, picture};

use ball::Surfaces;
pub use distance::{DIFFERENCE_GAIN, Distance};
use distance::{distance, side_by_side};
pub use gelsight::{read_sensor, sensor_files};

/// Longest table of presses or calibration file, in bytes.
const MAX_TEXT: u64 = 1 << 24;
/// Side of the crop round a contact in which pictures are compared, over the ball's radius.
const CROP: f64 = 4.425;
/// Parts that the presses are dealt into; each is measured by a fit on the others.
pub const FOLDS: usize = 6;
/// Radii of balls in millimetres.
pub const BALL_MM: [f64; 2] = [0.2, 20.0];
/// Least and greatest scale: the longest field on the widest picture, the shortest on 16 pixels.
pub const MM_PER_PIXEL: [f64; 2] = [5e-4, 1.0];
/// The contact's radius over that of the ball's outline where it is found in the picture: what the
/// table beside tests/data/gelsight_ball_presses has over what is found there, 62 of 67.5 pixels.
const CONTACT: f64 = 0.92;
/// Widest contact over the ball's radius.
const WIDEST: f64 = 0.985;
/// Steps of found contacts over the ball's radius: about the error of the finding.
const FOUND_STEP: f64 = 0.03;
/// Names of the files.
const BACKGROUND: &str = "background.png";
const TABLE: &str = "presses.csv";

/// What is known of presses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ball {
    /// Radius in millimetres.
    pub radius_mm: f64,
    /// Side of a pixel in millimetres; `None` to take it from the ball's outline.
    pub mm_per_pixel: Option<f64>,
}

/// A press of the ball into a real gel.
struct Press {
    file: PathBuf,
    picture: RgbImage,
    center_px: [f64; 2],
    contact_radius_px: f64,
    mm_per_pixel: f64,
    crop_px: f64,
}

/// What [`calibrate`] finds.
#[derive(Debug, Clone)]
pub struct Report {
    /// Number of presses.
    pub presses: usize,
    /// Where each press is: file, centre and contact radius in pixels.
    pub contacts: Vec<(PathBuf, [f64; 2], f64)>,
    /// Whether these were found in the pictures, or stood in a table.
    pub found: bool,
    /// Width and height of the pictures.
    pub size: [u32; 2],
    /// Side of a pixel in millimetres: what was said, or what the ball's outline says.
    pub mm_per_pixel: f64,
    /// Radius of the ball's outline in the pictures, mean and standard deviation in pixels, if the
    /// scale is from it.
    pub outline_px: Option<[f64; 2]>,
    /// Side of the crops that are compared, in pixels.
    pub crop_px: usize,
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
    pub fn optics(&self, name: &str) -> Result<MeasuredSensor, Error> {
        let (background, held_out) = (self.background.l1, self.held_out.l1);
        // Not `held_out >= background`: a NaN must fail.
        if held_out < background {
            return Ok(MeasuredSensor {
                name: name.to_owned(),
                lights: self.shading.channels.to_vec(),
            });
        }
        Err(Error::PoorFit { background, held_out })
    }

    /// The fitted sensor, with the background's picture as its frame without contact.
    ///
    /// # Errors
    /// As [`optics`](Self::optics); [`Error::Sensor`] for a field of view that no sensor has.
    pub fn sensor(&self, name: &str, reference: PathBuf) -> Result<Sensor, Error> {
        self.optics(name)?;
        let sensor = Sensor {
            name: name.to_owned(),
            frame: Some(self.size),
            mm_per_pixel: Some(self.mm_per_pixel as f32),
            reference: Some(reference),
            light: Some(Light { channels: self.shading.channels }.rounded()),
            agreement: Some(Agreement {
                presses: self.presses,
                background: (self.background.l1 * 1e3).round() / 1e3,
                held_out: (self.held_out.l1 * 1e3).round() / 1e3,
            }),
            ..Sensor::plain()
        };
        sensor.check()?;
        Ok(sensor)
    }
}

/// Fits and measures on a folder with `background.png`, the untouched gel, and presses: those that
/// `presses.csv` (`file,center_x_px,center_y_px,contact_radius_px`) lists; without it all other
/// pictures, in which the ball is found.
///
/// # Errors
/// [`Error::Io`], [`Error::Picture`] or [`Error::Content`] for a file that is missing or not as
/// expected; [`Error::Ball`] for a ball or a scale that cannot be; [`Error::Undetermined`] if the
/// presses show too little of the gel for a fit.
pub fn calibrate(folder: &Path, ball: &Ball) -> Result<Report, Error> {
    on_threads(|| calibrate_here(folder, ball))
}

fn calibrate_here(folder: &Path, ball: &Ball) -> Result<Report, Error> {
    let range = |what: &'static str, value: f64, [least, most]: [f64; 2]| {
        let fits = (least..=most).contains(&value);
        if fits { Ok(()) } else { Err(Error::Ball { what, least, most, value }) }
    };
    range("radius_mm", ball.radius_mm, BALL_MM)?;
    if let Some(scale) = ball.mm_per_pixel {
        range("mm_per_pixel", scale, MM_PER_PIXEL)?;
    }
    let (background_file, table) = (folder.join(BACKGROUND), folder.join(TABLE));
    let background = open(&background_file)?;
    let found = !table.exists();
    let (presses, outlines) = match found {
        true => find_presses(folder, &background)?,
        false => (read_presses(folder, &table, &background)?, Vec::new()),
    };
    let mut files: Vec<PathBuf> = presses.iter().map(|p| p.file.clone()).collect();
    files.push(background_file);
    if !found {
        files.push(table.clone());
    }
    let (mm_per_pixel, outline_px) = match ball.mm_per_pixel {
        Some(scale) => (scale, None),
        None => {
            let outlines = match found {
                true => outlines,
                false => presses
                    .par_iter()
                    .map(|press| outline(press, &background))
                    .collect::<Result<_, Error>>()?,
            };
            let (scale, spread) = scale(ball.radius_mm, &outlines);
            (scale, Some(spread))
        }
    };
    let crop_px = (CROP * ball.radius_mm / mm_per_pixel).round();
    let widest = WIDEST * ball.radius_mm / mm_per_pixel;
    let contact = |press: Press| {
        let radius = press.contact_radius_px;
        let contact_radius_px = match found {
            true => {
                let step = FOUND_STEP * ball.radius_mm / mm_per_pixel;
                ((CONTACT * radius).min(widest) / step).round().max(1.0) * step
            }
            // A table may round, but what is wider than the ball is no contact.
            false if radius * mm_per_pixel < ball.radius_mm => radius.min(widest),
            false => {
                return Err(Error::Content {
                    path: table.clone(),
                    expected: format!(
                        "contact radii below the ball's, {:.1} pixels of {mm_per_pixel} mm",
                        ball.radius_mm / mm_per_pixel
                    ),
                    found: format!("{radius} for {}", press.file.display()),
                });
            }
        };
        Ok(Press { contact_radius_px, mm_per_pixel, crop_px, ..press })
    };
    let presses = presses.into_iter().map(contact).collect::<Result<Vec<_>, Error>>()?;
    let surfaces =
        Surfaces::new(ball.radius_mm, mm_per_pixel, presses.iter().map(|p| p.contact_radius_px));
    let surface = |press: &Press| surfaces.of(press.contact_radius_px);

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
    let contacts = presses.iter().map(|p| (p.file.clone(), p.center_px, p.contact_radius_px));
    Ok(Report {
        presses: presses.len(),
        contacts: contacts.collect(),
        found,
        size: [background.width(), background.height()],
        mm_per_pixel,
        outline_px,
        crop_px: crop_px as usize,
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
    files::text(&bytes).map(str::to_owned).map_err(Error::io(path))
}

/// The table as spreadsheets write it, too: cells in quotes or among blanks, with semicolons or tabs between them
/// and then perhaps commas in numbers, empty cells and lines at the end.
fn read_presses(folder: &Path, path: &Path, background: &RgbImage) -> Result<Vec<Press>, Error> {
    let text = read_text(path)?;
    let bad = |path: &Path, expected: &str, found: &str| Error::Content {
        path: path.to_owned(),
        expected: expected.to_owned(),
        found: found.to_owned(),
    };
    let mut presses = Vec::new();
    let wanted = "file,center_x_px,center_y_px,contact_radius_px";
    let first = text.lines().next().unwrap_or_default();
    let between = [';', '\t'].into_iter().find(|c| first.contains(*c)).unwrap_or(',');
    let mut reader = csv::ReaderBuilder::new();
    reader.has_headers(false).flexible(true).trim(csv::Trim::All).delimiter(between as u8);
    let mut has_header = false;
    for record in reader.from_reader(text.as_bytes()).records() {
        let record = record.map_err(|e| bad(path, wanted, &e.to_string()))?;
        let mut cells: Vec<&str> = record.iter().collect();
        while cells.pop_if(|cell| cell.is_empty()).is_some() {}
        let line = &cells.join(",");
        // A table without its header would lose its first press.
        if !has_header && line != wanted {
            return Err(bad(path, &format!("the header {wanted}"), line));
        }
        if !has_header || cells.is_empty() {
            has_header = true;
            continue;
        }
        let [file, x, y, radius] = cells[..] else {
            return Err(bad(path, wanted, line));
        };
        let number = |cell: &str| match between {
            ',' => cell.parse::<f64>(),
            _ => cell.replace(',', ".").parse(),
        };
        let (Ok(x), Ok(y), Ok(radius)) = (number(x), number(y), number(radius)) else {
            return Err(bad(path, wanted, line));
        };
        let inside = |at: f64, side: u32| (0.0..f64::from(side)).contains(&at);
        if !inside(x, background.width()) || !inside(y, background.height()) {
            return Err(bad(path, "a centre inside the picture", line));
        }
        if !(1.0..f64::INFINITY).contains(&radius) {
            return Err(bad(path, "a contact radius of 1 pixel or more", line));
        }
        let file = folder.join(file);
        let picture = open_press(&file, background)?;
        presses.push(Press::new(file, picture, [x, y], radius));
    }
    if !has_header {
        return Err(bad(path, &format!("the header {wanted}"), "nothing"));
    }
    enough(path, &presses)?;
    Ok(presses)
}

impl Press {
    /// A press whose scale is not known yet.
    fn new(file: PathBuf, picture: RgbImage, center_px: [f64; 2], contact_radius_px: f64) -> Self {
        Self { file, picture, center_px, contact_radius_px, mm_per_pixel: 0.0, crop_px: 0.0 }
    }
}

fn open_press(file: &Path, background: &RgbImage) -> Result<RgbImage, Error> {
    let picture = open(file)?;
    if picture.dimensions() == background.dimensions() {
        return Ok(picture);
    }
    let size = |p: &RgbImage| format!("{} × {} pixels", p.width(), p.height());
    let (path, expected, found) = (file.to_owned(), size(background), size(&picture));
    Err(Error::Content { path, expected, found })
}

fn enough(path: &Path, presses: &[Press]) -> Result<(), Error> {
    if presses.len() >= FOLDS {
        return Ok(());
    }
    let expected = format!("{FOLDS} presses or more");
    Err(Error::Content {
        path: path.to_owned(),
        expected,
        found: format!("{} presses", presses.len()),
    })
}

/// All pictures of the folder but the background, with the ball where it is found, and the radii of
/// its outlines.
fn find_presses(folder: &Path, background: &RgbImage) -> Result<(Vec<Press>, Vec<f64>), Error> {
    let entries = std::fs::read_dir(folder).map_err(Error::io(folder))?;
    let mut pictures = Vec::new();
    for entry in entries {
        let path = entry.map_err(Error::io(folder))?.path();
        let is_background = path.file_name().is_some_and(|name| name == BACKGROUND);
        if picture::has_ending(&path) && !is_background {
            pictures.push(path);
        }
    }
    pictures.sort();
    let found = pictures.into_par_iter().map(|file| {
        let picture = open_press(&file, background)?;
        let press = Press::new(file, picture, [0.0; 2], 0.0);
        let find::Found { center_px, outline_px } = find_ball(&press, background)?;
        Ok(Press { center_px, contact_radius_px: outline_px, ..press })
    });
    let presses = found.collect::<Result<Vec<Press>, Error>>()?;
    enough(folder, &presses)?;
    let outlines = presses.iter().map(|p| p.contact_radius_px).collect();
    Ok((presses, outlines))
}

fn find_ball(press: &Press, background: &RgbImage) -> Result<find::Found, Error> {
    find::find(&press.picture, background).ok_or_else(|| Error::Content {
        path: press.file.clone(),
        expected: "a ball's round outline against the background".to_owned(),
        found: "none".to_owned(),
    })
}

fn outline(press: &Press, background: &RgbImage) -> Result<f64, Error> {
    Ok(find_ball(press, background)?.outline_px)
}

/// Millimetres a pixel by the outlines of a ball, with their mean and standard deviation.
///
/// The light of a press ends where the gel leaves the ball. Pressed in about as deep as its radius,
/// that is the ball's own outline, and less deep a smaller circle. The middle one of the radii stands
/// for the ball: presses that the picture's edge cuts look larger.
fn scale(ball_mm: f64, outlines: &[f64]) -> (f64, [f64; 2]) {
    let n = outlines.len() as f64;
    let mean = outlines.iter().sum::<f64>() / n;
    let variance = outlines.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / n;
    let mut sorted = outlines.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted[sorted.len() / 2];
    // Four digits are more than it is known by.
    ((ball_mm / middle * 1e5).round() / 1e5, [mean, variance.sqrt()])
}

/// Pixels of the crop round a press that lie in the picture: the ranges of x and y.
fn crop_range(press: &Press, picture: &RgbImage) -> [std::ops::Range<u32>; 2] {
    let half = press.crop_px / 2.0;
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
    let at = surface.at(
        (x - press.center_px[0]) * press.mm_per_pixel,
        (y - press.center_px[1]) * press.mm_per_pixel,
    );
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_read_as_spreadsheets_write_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let grey = RgbImage::from_pixel(90, 80, image::Rgb([130; 3]));
        let names = ["a.png", "b, right.png", "c.png", "d.png", "e.png", "f.png"];
        for name in names {
            grey.save(folder.path().join(name)).expect("saved");
        }
        let path = folder.path().join(TABLE);
        let read = |text: String| {
            std::fs::write(&path, text).expect("written");
            let presses = read_presses(folder.path(), &path, &grey);
            presses.map(|presses| {
                let told = |p: &Press| (p.file.clone(), p.center_px, p.contact_radius_px);
                presses.iter().map(told).collect::<Vec<_>>()
            })
        };
        let rows = |row: &dyn Fn(&str, usize) -> String, end: &str| {
            let rows = names.iter().enumerate().map(|(i, name)| row(name, i) + end);
            rows.collect::<String>()
        };
        let head = ["file", "center_x_px", "center_y_px", "contact_radius_px"];
        let plain = rows(&|name, i| format!("\"{name}\",{i}.5,20,12.25"), "\n");
        let want = read(format!("{}\n{plain}", head.join(","))).expect("presses");
        assert_eq!(want[1], (folder.path().join("b, right.png"), [1.5, 20.0], 12.25));
        let semicolons = rows(&|name, i| format!("{name};{i},5;20;12,25"), "\r\n");
        let tabs = rows(&|name, i| format!("{name}\t{i}.5\t20\t\"12,25\""), "\n");
        let blanks = rows(&|name, i| format!("\"{name}\" , {i}.5 ,20, 12.25"), "\n");
        for (what, text) in [
            ("a mark", format!("\u{feff}{}\r\n{plain}", head.join(","))),
            ("semicolons", format!("{}\r\n{semicolons};;;\r\n", head.join(";"))),
            ("tabs", format!("{}\n{tabs}\n", head.join("\t"))),
            ("blanks", format!(" {} \n\n{blanks}", head.join(" , "))),
            ("quotes", format!("\"{}\"\n{plain}", head.join("\",\""))),
            ("empty cells", format!("{},,\n{plain},,,\n", head.join(","))),
        ] {
            assert_eq!(read(text).expect(what), want, "{what}");
        }
        // A comma in a number between commas is two cells, and a number's digits are not grouped.
        for (text, got) in [
            (format!("{}\na.png,1,5,20,12\n", head.join(",")), "found a.png,1,5,20,12"),
            (format!("{}\na.png;1.000,5;20;12\n", head.join(";")), "found a.png,1.000,5,20,12"),
            (format!("{}\na.png,nan,20,12\n", head.join(",")), "a centre inside the picture"),
            (String::new(), "expected the header file,center_x_px"),
        ] {
            let message = read(text).expect_err(got).to_string();
            assert!(message.contains(got), "{message}");
        }
    }
}
