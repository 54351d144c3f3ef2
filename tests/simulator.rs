//! The simulated sensor against closed forms, and against real presses.

#[allow(dead_code)]
#[path = "../tools/parts.rs"]
mod parts;
#[path = "support/program.rs"]
mod program;

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use rand::SeedableRng;
use rand_pcg::Pcg64;
use smr_gpu::Sensor;
use smr_gpu::simulator::Error;
use smr_gpu::simulator::calibrate::{self, Ball};
use smr_gpu::simulator::camera::{Camera, NormalTable};
use smr_gpu::simulator::conditions::{Conditions, UNIT_CONTRAST};
use smr_gpu::simulator::contact::{Contact, NO_BODY, Stop, solve};
use smr_gpu::simulator::dataset::{Progress, Settings, Step, simulate};
use smr_gpu::simulator::distractors::{Distractor, Part};
use smr_gpu::simulator::forced::Forced;
use smr_gpu::simulator::gel::{Elasticity, Grid, Layer};
use smr_gpu::simulator::given::Given;
use smr_gpu::simulator::label::{LEAST_IMPRINT_MM, Label, imprints, visible_share};
use smr_gpu::simulator::lamps::Lamps;
use smr_gpu::simulator::markers::Markers;
use smr_gpu::simulator::mesh::{self, Mesh, Unit};
use smr_gpu::simulator::optics::{
    Fit, NORMAL_TERMS, POSITION_TERMS, Shading, TERMS, measured_sensors, normal_terms,
    position_terms,
};
use smr_gpu::simulator::options::{Drive, Optics};
use smr_gpu::simulator::own_part::OwnPart;
use smr_gpu::simulator::painter::Sideways;
use smr_gpu::simulator::raster::{FIELD_MM, Raster};
use smr_gpu::simulator::relief::{Relief, Symmetry, View};
use smr_gpu::simulator::render::{GRID, Rendered, Renderer, Request, STOP, contact_grid};
use smr_gpu::simulator::scene::{Body, Mix, Negative, Own, Placed, Scene, scene_seed};
use smr_gpu::simulator::shadow::{Ray, cast};
use smr_gpu::simulator::smooth;
use smr_gpu::simulator::snaps::{Kind, Snap};
use smr_gpu::simulator::stud::Stud;
use smr_gpu::simulator::surface::Surface;

const PICTURE_PX: usize = Raster::PAPER.width;
const MM_PER_PX: f64 = Raster::PAPER.mm_per_pixel;
const GEL_MM: f64 = PICTURE_PX as f64 * MM_PER_PX;
/// The whole of a plain picture.
const WINDOW: [f64; 4] = [0.0, 0.0, 1000.0, 1000.0];

const EXACT: Stop = Stop { tolerance_mm: 1e-5, max_iterations: 400 };

fn data(folder: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(folder)
}

/// A body from a function of position in millimetres.
fn body(grid: Grid, penetration: impl Fn(f64, f64) -> Option<f64>) -> Vec<f32> {
    let mut out = Vec::with_capacity(grid.len());
    for y in 0..grid.cells {
        for x in 0..grid.cells {
            let d = penetration(grid.position(x), grid.position(y));
            out.push(d.map_or(NO_BODY, |d| d as f32));
        }
    }
    out
}

/// A box-shaped punch whose walls slope steeply.
fn punch(half: [f64; 2], center: [f64; 2], depth: f64) -> impl Fn(f64, f64) -> Option<f64> {
    move |x, y| {
        let inside = (half[0] - (x - center[0]).abs()).min(half[1] - (y - center[1]).abs());
        (inside > -0.3).then_some(depth + 8.0 * inside.min(0.0))
    }
}

fn assert_close(value: f64, expected: f64, relative: f64, what: &str) {
    let error = (value - expected).abs();
    assert!(error <= relative * expected.abs(), "{what}: {value}, expected {expected}");
}

#[test]
fn compliance_has_its_limits() {
    let layer = Layer { thickness_mm: 4.0, shear_modulus_mpa: 0.145 };
    let (h, mu) = (layer.thickness_mm, layer.shear_modulus_mpa);
    // Half-space: the next term is of the order of 4x² exp(−2x), 4e-6 at x = 10.
    for x in [10.0, 30.0, 1e3] {
        let k = x / h;
        assert_close(layer.compliance(k), 1.0 / (2.0 * mu * k), 1e-5, "half-space");
    }
    // Thin layer: the next term is 9/5 x² of it.
    for x in [1e-4, 1e-2, 0.03] {
        let k = x / h;
        assert_close(layer.compliance(k), k * k * h.powi(3) / (3.0 * mu), 2.0 * x * x, "thin");
    }
    // By hand at x = 1: (sinh 2 − 2)/(cosh 2 + 3) = 1.626860408 / 6.762195691.
    let by_hand = 1.626_860_408 / 6.762_195_691 * h / (2.0 * mu);
    assert_close(layer.compliance(1.0 / h), by_hand, 1e-9, "x = 1");
    assert_eq!(layer.compliance(0.0), 0.0);
    // The series takes over at x = 0.02; what it leaves out is of the order of x⁴.
    let (below, above) = (layer.compliance(0.019_999_999 / h), layer.compliance(0.02 / h));
    assert_close(below, above, 1e-6, "series");
}

#[test]
fn a_wave_of_pressure_makes_a_wave_of_displacement() {
    let grid = Grid { cells: 48, spacing_mm: 0.25 };
    let layer = Layer::default();
    let mut elasticity = Elasticity::new(&layer, grid);
    let all = vec![true; grid.cells];
    for (mx, my) in [(1, 0), (0, 3), (5, 2), (24, 0), (7, 24)] {
        let step = std::f64::consts::TAU / (grid.cells as f64 * grid.spacing_mm);
        let (kx, ky) = (step * f64::from(mx), step * f64::from(my));
        let wave = |i: usize| {
            let (x, y) = (i % grid.cells, i / grid.cells);
            (kx * x as f64 * grid.spacing_mm + ky * y as f64 * grid.spacing_mm).cos()
        };
        let pressure: Vec<f32> = (0..grid.len()).map(|i| wave(i) as f32).collect();
        let mut displacement = vec![f32::NAN; grid.len()];
        elasticity.displacement(&pressure, &all, &all, &mut displacement);
        let amplitude = layer.compliance(kx.hypot(ky));
        for (i, &u) in displacement.iter().enumerate() {
            // Single precision through two transforms of 48.
            let error = (f64::from(u) - amplitude * wave(i)).abs();
            assert!(error < 3e-6 * amplitude.max(1.0), "wave {mx}, {my} at {i}: off by {error}");
        }
    }
}

#[test]
fn unwanted_rows_are_left_alone() {
    let grid = Grid { cells: 16, spacing_mm: 0.5 };
    let mut elasticity = Elasticity::new(&Layer::default(), grid);
    let mut pressure = vec![0.0; grid.len()];
    pressure[5 * 16 + 3] = 1.0;
    let (all, mut row5) = (vec![true; 16], vec![false; 16]);
    row5[5] = true;
    let mut whole = vec![f32::NAN; grid.len()];
    let mut part = vec![f32::NAN; grid.len()];
    elasticity.displacement(&pressure, &all, &all, &mut whole);
    elasticity.displacement(&pressure, &row5, &row5, &mut part);
    for (i, (&whole, &part)) in whole.iter().zip(&part).enumerate() {
        assert!(whole.is_finite());
        if i / 16 == 5 {
            assert_eq!(whole, part);
        } else {
            assert!(part.is_nan());
        }
    }
}

/// A ball of 2 mm on a thick layer, pressed to a contact radius of about 0.4 mm.
fn hertz() -> (Grid, Contact) {
    let grid = Grid { cells: 512, spacing_mm: 0.02 };
    let layer = Layer { thickness_mm: 40.0, ..Layer::default() };
    let mut elasticity = Elasticity::new(&layer, grid);
    // Hertz's parabola; the mean displacement is zero, which raises the surface by little.
    let ball = body(grid, |x, y| {
        let r2 = x * x + y * y;
        (r2 < 1.0).then_some(0.4 * 0.4 / 2.0 - r2 / 4.0)
    });
    (grid, solve(&mut elasticity, &ball, EXACT))
}

#[test]
fn a_ball_takes_hertz_force() {
    let (grid, contact) = hertz();
    let mu = Layer::default().shear_modulus_mpa;
    let cells = contact.pressure.iter().filter(|p| **p > 0.0).count() as f64;
    let radius = (cells / std::f64::consts::PI).sqrt() * grid.spacing_mm;
    assert_close(radius, 0.4, 0.06, "contact radius");
    // E* = 4μ for an incompressible half-space, so F = 4/3 E* a³/R = 16 μ a³ / (3 R).
    let force = 16.0 * mu * radius.powi(3) / (3.0 * 2.0);
    assert_close(contact.force_n(grid.spacing_mm), force, 0.03, "force");
    // The greatest pressure is 3/2 of the mean.
    let peak = contact.pressure.iter().fold(0.0f32, |a, &b| a.max(b));
    let mean = force / (std::f64::consts::PI * radius * radius);
    assert_close(f64::from(peak), 1.5 * mean, 0.03, "peak pressure");
}

#[test]
fn pressure_and_gap_are_complementary_and_volume_is_conserved() {
    let mut elasticity = Elasticity::new(&Layer::default(), GRID);
    let blocks = [punch([3.0, 1.5], [-8.0, 2.0], 0.8), punch([1.0, 4.0], [9.0, -6.0], 0.4)];
    let rigid = body(GRID, |x, y| blocks.iter().filter_map(|b| b(x, y)).reduce(f64::max));
    let contact = solve(&mut elasticity, &rigid, STOP);
    assert!(contact.iterations < STOP.max_iterations, "{} iterations", contact.iterations);
    let mut touching = 0;
    let mut squares = 0.0;
    for (i, &pressure) in contact.pressure.iter().enumerate() {
        let gap = f64::from(contact.displacement[i] - rigid[i]);
        assert!(pressure >= 0.0);
        if pressure > 0.0 {
            touching += 1;
            squares += gap * gap;
        } else {
            assert!(gap > -10.0 * STOP.tolerance_mm, "overlap of {gap} mm without pressure");
        }
    }
    let rms = (squares / f64::from(touching)).sqrt();
    assert!(rms <= 1.01 * STOP.tolerance_mm, "gap of {rms} mm under pressure");
    // Both faces touch all over: 6×3 + 2×8 mm².
    let area = f64::from(touching) * GRID.spacing_mm.powi(2);
    assert_close(area, 34.0, 0.05, "area in contact");

    let volume: f64 = contact.displacement.iter().map(|&u| f64::from(u)).sum();
    let moved: f64 = contact.displacement.iter().map(|&u| f64::from(u.abs())).sum();
    assert!(volume.abs() < 1e-5 * moved, "{volume} of {moved} is lost");
    // What goes down in the middle comes up beside it.
    let lowest = contact.displacement.iter().fold(0.0f32, |a, &b| a.min(b));
    assert!(lowest < -0.01, "no bulge: {lowest}");
}

#[test]
fn the_grid_s_images_are_far() {
    // A deep punch at the gel's edge, on the grid in use and on one of twice the size.
    let wide = Grid { cells: 2 * GRID.cells, ..GRID };
    let shape = punch([2.0, 3.0], [17.5, 0.0], 1.0);
    let surface = |grid: Grid| {
        let mut elasticity = Elasticity::new(&Layer::default(), grid);
        let contact = solve(&mut elasticity, &body(grid, &shape), EXACT);
        Surface::new(grid, contact.displacement)
    };
    let (near, far) = (surface(GRID), surface(wide));
    let mut worst = [0.0f32; 2];
    for i in -49..50 {
        for j in -49..50 {
            let (x, y) = (0.4 * f64::from(i), 0.4 * f64::from(j));
            let (a, b) = (near.at(x, y), far.at(x, y));
            worst[0] = worst[0].max((a.depth - b.depth).abs());
            let [gx, gy] = [a.gradient[0] - b.gradient[0], a.gradient[1] - b.gradient[1]];
            worst[1] = worst[1].max(gx.hypot(gy));
        }
    }
    // The slope is what the camera sees: 0.005 changes the brightness by about 0.5 %, a tenth of
    // what an edge does. This punch is as deep and as near the rim as snaps come.
    assert!(worst[0] < 0.02 && worst[1] < 5e-3, "depth and slope differ by {worst:?}");
}

#[test]
fn a_dent_moves_outwards_by_parallax() {
    let camera = Camera::default();
    // 20 mm × (125/124 − 1) / 0.04 mm = 4.03 px.
    let flat = camera.project(20.0, -20.0, 0.0);
    let dent = camera.project(20.0, -20.0, 1.0);
    assert_eq!(flat, [1000.0, 0.0]);
    assert_close(dent[0] - flat[0], 4.032, 1e-3, "x");
    assert_close(dent[1] - flat[1], -4.032, 1e-3, "y");

    // The renderer looks the other way: a dent 1 mm deep about x = 15 is seen 15/124 mm further
    // out.
    let grid = Grid { cells: 512, spacing_mm: 0.08 };
    let displacement = (0..grid.len())
        .map(|i| {
            let (x, y) = (grid.position(i % 512), grid.position(i / 512));
            (-((x - 15.0).powi(2) + y * y) / 8.0).exp() as f32
        })
        .collect();
    let surface = Surface::new(grid, displacement);
    let deepest = (0..2000)
        .map(|i| 14.0 + f64::from(i) * 1e-3)
        .max_by(|&a, &b| {
            let depth = |x| surface.seen(&camera, x, 0.0).depth;
            depth(a).total_cmp(&depth(b))
        })
        .expect("there are places");
    assert!((deepest - 15.0 * 125.0 / 124.0).abs() < 0.05, "seen at {deepest}");
}

#[test]
fn noise_is_45_db_at_saturation() {
    let camera = Camera::default();
    assert_close(20.0 * (255.0 / camera.noise(255.0)).log10(), 45.0, 1e-9, "at saturation");
    assert_close(camera.noise(0.0), camera.read_noise, 1e-9, "in the dark");

    let table = NormalTable::new();
    let mut rng = Pcg64::seed_from_u64(7);
    let count = 300_000;
    for level in [40.0f32, 128.0, 230.0] {
        let plane = vec![level; count];
        let mut bytes = vec![0u8; 3 * count];
        camera.digitise(&plane, &table, &mut rng, &mut bytes, 1, 3);
        let values: Vec<f64> = bytes.iter().skip(1).step_by(3).map(|&b| f64::from(b)).collect();
        let mean = values.iter().sum::<f64>() / count as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count as f64;
        // Five standard errors of the mean; rounding to 8 bits adds 1/12 to the variance.
        assert!((mean - f64::from(level)).abs() < 0.015, "mean {mean} of {level}");
        let expected = camera.noise(f64::from(level)).powi(2) + 1.0 / 12.0;
        assert_close(variance, expected, 0.03, "variance");
        assert!(bytes.iter().step_by(3).all(|&b| b == 0), "another channel was written");
    }
    // Far past the brightest level the noise does not come back below it.
    let mut bytes = vec![0u8; count];
    camera.digitise(&vec![300.0; count], &table, &mut rng, &mut bytes, 0, 1);
    assert!(bytes.iter().all(|&b| b == 255), "a saturated pixel flickers");
}

#[test]
fn blur_keeps_light_and_has_its_width() {
    const N: usize = PICTURE_PX;
    let camera = Camera { blur_px: 1.7, ..Camera::default() };
    let mut plane = vec![0.0f32; N * N];
    plane[400 * N + 300] = 1.0;
    camera.blur(&mut plane, &mut Vec::new());
    let total: f64 = plane.iter().map(|&v| f64::from(v)).sum();
    assert_close(total, 1.0, 1e-5, "light");
    let second = |along: fn(usize) -> f64| -> f64 {
        plane.iter().enumerate().map(|(i, &v)| f64::from(v) * along(i).powi(2)).sum()
    };
    // Cut at 2.5 standard deviations, the kernel loses less than a tenth of its variance.
    assert_close(second(|i| (i % N) as f64 - 300.0), 1.7 * 1.7, 0.1, "variance along x");
    assert_close(second(|i| (i / N) as f64 - 400.0), 1.7 * 1.7, 0.1, "variance along y");
}

#[test]
fn the_label_of_a_flat_punch_is_its_projected_outline() {
    let (half, center, depth) = ([2.5, 1.5], [10.0, -6.0], 0.5);
    let penetration = body(GRID, punch(half, center, depth));
    let owner = penetration.iter().map(|d| if *d > NO_BODY { 0 } else { u8::MAX }).collect();
    let mut elasticity = Elasticity::new(&Layer::default(), GRID);
    let contact = solve(&mut elasticity, &penetration, STOP);
    let camera = Camera::default();
    let found = imprints(&Body { penetration, owner }, &contact, GRID, &camera, WINDOW, 1);
    let imprint = found[0].expect("it touches");
    let scale = 125.0 / (125.0 - depth) / MM_PER_PX;
    let expected = [
        (center[0] - half[0]) * scale + 500.0,
        (center[1] - half[1]) * scale + 500.0,
        (center[0] + half[0]) * scale + 500.0,
        (center[1] + half[1]) * scale + 500.0,
    ];
    for (found, expected) in imprint.pixel_box.into_iter().zip(expected) {
        // A cell is two pixels wide; at a wall the gel may touch one cell further.
        assert!((found - expected).abs() <= 2.5, "{:?}, expected {expected:?}", imprint.pixel_box);
    }
    let area = (expected[2] - expected[0]) * (expected[3] - expected[1]);
    assert_close(imprint.area_px, area, 0.06, "area");
}

#[test]
fn labels_end_at_the_picture() {
    let penetration = body(GRID, punch([3.0, 1.0], [19.0, 0.0], 0.6));
    let owner = vec![0; GRID.len()];
    let mut elasticity = Elasticity::new(&Layer::default(), GRID);
    let contact = solve(&mut elasticity, &penetration, STOP);
    let found =
        imprints(&Body { penetration, owner }, &contact, GRID, &Camera::default(), WINDOW, 1);
    let [x0, _, x1, _] = found[0].expect("it touches").pixel_box;
    assert_eq!(x1, PICTURE_PX as f64);
    assert!((x0 - (500.0 + 16.0 / MM_PER_PX)).abs() < 4.5, "{x0}");
}

#[test]
fn a_turned_sensor_answers_to_turned_light() {
    let shading = Shading { channels: [0, 1, 2].map(|c| measured_sensors()[0].lights[c]) };
    let angle: f64 = 0.7;
    let (sin, cos) = angle.sin_cos();
    for mirror in [false, true] {
        let turned = shading.turned(angle, mirror);
        // A place and slope in the turned frame, and the same in the original's.
        let back = |[x, y]: [f64; 2]| {
            let along = cos * x + sin * y;
            [if mirror { -along } else { along }, cos * y - sin * x]
        };
        let (place, slope) = ([0.3, -0.8], [0.5, 0.2]);
        let ([x, y], [gx, gy]) = (back(place), back(slope));
        let a = turned.relative(place[0], place[1], slope[0], slope[1]);
        let b = shading.relative(x, y, gx, gy);
        for (a, b) in a.into_iter().zip(b) {
            assert!((a - b).abs() < 1e-12, "{a} against {b}, mirrored: {mirror}");
        }
    }
}

#[test]
fn the_fit_finds_known_coefficients() {
    let truth = measured_sensors()[0].lights[0];
    let shading = Shading { channels: [truth; 3] };
    let mut fit = Fit::new();
    let at = |i: i32| f64::from(i) / 4.0;
    for (x, y) in (-4..5).flat_map(|x| (-4..5).map(move |y| (at(x), at(y)))) {
        for (gx, gy) in (-4..5).flat_map(|x| (-4..5).map(move |y| (at(x), at(y)))) {
            let seen = 130.0 * (1.0 + shading.relative(x, y, gx, gy)[0]);
            fit.add(&position_terms(x, y), &normal_terms(gx, gy), 130.0, seen);
        }
    }
    let found = fit.solve();
    for (found, truth) in found.as_flattened().iter().zip(truth.as_flattened()) {
        // The ridge draws coefficients towards zero by about its share of their own term.
        assert!((found - truth).abs() < 1e-3, "{found}, expected {truth}");
    }
}

#[test]
fn a_fit_knows_what_its_pixels_determine() {
    let grid = || (-4..5).flat_map(|x| (-4..5).map(move |y| [x, y].map(|v| f64::from(v) / 4.0)));
    let all: Vec<[f64; 2]> = grid().collect();
    let one = [[0.5, -0.25]];
    let rank = |positions: &[[f64; 2]], slopes: &[[f64; 2]], flat: f64| {
        let mut fit = Fit::new();
        for [x, y] in positions {
            for [gx, gy] in slopes {
                fit.add(&position_terms(*x, *y), &normal_terms(*gx, *gy), flat, 100.0);
            }
        }
        fit.rank()
    };
    assert_eq!(rank(&all, &all, 130.0), TERMS);
    // At one position the five terms of the normal, at one slope the six of the position.
    assert_eq!(rank(&one, &all, 130.0), NORMAL_TERMS);
    assert_eq!(rank(&all, &one, 130.0), POSITION_TERMS);
    // One pixel many times, nothing but flat gel, a black background, and no pixel.
    assert_eq!(rank(&one.repeat(50), &one, 130.0), 1);
    assert_eq!(rank(&all, &[[0.0, 0.0]], 130.0), 0);
    assert_eq!(rank(&all, &all, 0.0), 0);
    assert_eq!(rank(&[], &[], 130.0), 0);
}

/// What is known of the presses in tests/data.
const KNOWN: Ball = Ball { radius_mm: 2.0, mm_per_pixel: Some(0.0295) };

#[test]
fn held_out_presses_are_near_the_real_ones() {
    let report =
        calibrate::calibrate(&data("gelsight_ball_presses"), &KNOWN).expect("the data is there");
    assert_eq!(report.presses, 48);
    // The table that comes with the data: 9.71, 24.56 dB, 0.947. The harness is the same.
    assert!((report.background.l1 - 9.71).abs() < 0.01, "{:?}", report.background);
    assert!((report.background.psnr_db - 24.56).abs() < 0.01, "{:?}", report.background);
    assert!((report.background.ssim - 0.947).abs() < 0.001, "{:?}", report.background);
    assert!(report.held_out.l1 <= 4.5, "{:?}", report.held_out);
    assert!(report.held_out.psnr_db >= 32.5, "{:?}", report.held_out);
    assert!(report.held_out.ssim > report.background.ssim, "{:?}", report.held_out);

    // What the simulator uses is what the calibration gives.
    let mut sensors =
        vec![report.optics("gelsight_ball_presses").expect("better than the background")];
    for file in calibrate::sensor_files(&data("gelsight_flatfields")).expect("files") {
        sensors.push(calibrate::read_sensor(&file).expect("a sensor"));
    }
    assert_eq!(sensors.len(), measured_sensors().len());
    for (sensor, used) in sensors.iter().zip(measured_sensors()) {
        let name = &sensor.name;
        assert_eq!(*name, used.name);
        assert_eq!(sensor.lights.len(), used.lights.len());
        let pairs = sensor.lights.as_flattened().iter().zip(used.lights.as_flattened());
        for (found, used) in pairs.flat_map(|(a, b)| a.iter().zip(b)) {
            // Transforms differ in rounding from processor to processor.
            assert!((found - used).abs() < 0.01, "{name}: {found} against {used}");
        }
    }
}

/// The same presses without their table, and without their scale: both are found in the pictures.
#[test]
fn contacts_and_scale_are_found_in_pictures() {
    let (source, folder) = (data("gelsight_ball_presses"), tempfile::tempdir().expect("a folder"));
    // A third of them: time goes with their number.
    let mut table = std::collections::BTreeMap::new();
    let text = std::fs::read_to_string(source.join("presses.csv")).expect("the table");
    for line in text.lines().skip(1).step_by(3) {
        let fields: Vec<&str> = line.split(',').collect();
        let numbers: Vec<f64> = fields[1..].iter().map(|v| v.parse().expect("a number")).collect();
        table.insert(fields[0].to_owned(), numbers);
    }
    for file in table.keys().map(String::as_str).chain(["background.png"]) {
        std::fs::copy(source.join(file), folder.path().join(file)).expect("a copy");
    }
    let unknown = Ball { mm_per_pixel: None, ..KNOWN };
    let report = calibrate::calibrate(folder.path(), &unknown).expect("presses");
    assert!(report.found && report.presses == table.len(), "{}", report.presses);
    // The scale is known to be 0.0295; outlines scatter by two pixels of 68.
    let off = report.mm_per_pixel / 0.0295 - 1.0;
    assert!(off.abs() <= 0.03, "{:.5} mm a pixel, {:.1} %", report.mm_per_pixel, 100.0 * off);
    let mut distances: Vec<f64> = report
        .contacts
        .iter()
        .map(|(file, [x, y], _)| {
            let name = file.file_name().expect("a name").to_string_lossy().into_owned();
            (x - table[&name][0]).hypot(y - table[&name][1])
        })
        .collect();
    distances.sort_by(f64::total_cmp);
    // The table's centres are by hand, and some presses are cut by the picture's edge.
    let (median, worst) = (distances[distances.len() / 2], distances[distances.len() - 1]);
    assert!(median <= 3.0 && worst <= 7.0, "median {median:.1}, worst {worst:.1} pixels");
    // Nearly as good as by the table, and far better than nothing.
    let (nothing, ours) = (report.background.l1, report.held_out.l1);
    assert!(ours <= 0.55 * nothing, "{ours} of {nothing}");

    // The file that comes of it says the same, and the simulator draws by it.
    let sensor = report.sensor("bench", folder.path().join("background.png")).expect("a sensor");
    let text = serde_json::to_string(&sensor).expect("JSON");
    assert_eq!(Sensor::parse(&text).expect("a sensor"), sensor);
    assert_eq!((sensor.frame, sensor.light.is_some()), (Some([640, 480]), true));
    let given = Given::new(sensor).expect("a sensor that can be drawn");
    let request = Request {
        sensor: Some(std::sync::Arc::new(given)),
        forced: "mild".parse().expect("a condition"),
        ..Request::wide(Mix::A)
    };
    let Rendered { picture, frame, labels, .. } =
        Renderer::new().render(7, &request).expect("a picture");
    assert_eq!((frame.width, frame.height), (640, 480));
    // A data set of it can be continued: what was written is read as the same sensor.
    let out = folder.path().join("set");
    let settings = |count| Settings {
        out: out.clone(),
        count,
        seed: 1,
        request: request.clone(),
        shard: None,
    };
    let run = |count| simulate(&settings(count), &|_| ()).expect("a data set");
    assert_eq!((run(1).rendered, run(2).rendered), (1, 1));
    assert!((frame.mm_per_pixel - report.mm_per_pixel).abs() < 1e-5);
    // Far from all snaps it is the untouched gel's picture but for noise; at a snap it is not.
    let flat = image::open(source.join("background.png")).expect("a picture").into_rgb8();
    let change = |x: u32, y: u32| {
        let pairs = picture.get_pixel(x, y).0.into_iter().zip(flat.get_pixel(x, y).0);
        pairs.map(|(a, b)| f64::from(a.abs_diff(b))).sum::<f64>() / 3.0
    };
    let [x0, y0, x1, y1] = labels[0].pixel_box;
    let (mut inside, mut outside) = (Vec::new(), Vec::new());
    for (x, y) in (0..480).flat_map(|y| (0..640).map(move |x| (x, y))) {
        let off = |at: u32, low: f64, high: f64| (low - f64::from(at)).max(f64::from(at) - high);
        let away = labels.iter().map(|l| {
            let [a, b, c, d] = l.pixel_box;
            off(x, a, c).max(off(y, b, d))
        });
        let away = away.fold(f64::INFINITY, f64::min);
        if off(x, x0, x1).max(off(y, y0, y1)) < 0.0 {
            inside.push(change(x, y));
        } else if away > 150.0 {
            outside.push(change(x, y));
        }
    }
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    assert!(!outside.is_empty() && mean(&outside) < 4.0, "{}", mean(&outside));
    assert!(mean(&inside) > 2.0 * mean(&outside), "{} and {}", mean(&inside), mean(&outside));
}

#[test]
fn a_ball_that_cannot_be_is_refused_by_name() {
    let folder = data("gelsight_ball_presses");
    let refused = |radius_mm: f64, mm_per_pixel: Option<f64>| {
        let ball = Ball { radius_mm, mm_per_pixel };
        calibrate::calibrate(&folder, &ball).expect_err("no such ball").to_string()
    };
    assert_eq!(refused(0.0, None), "radius_mm: expected 0.2 to 20, got 0");
    assert_eq!(refused(f64::NAN, None), "radius_mm: expected 0.2 to 20, got NaN");
    assert_eq!(refused(2.0, Some(-1.0)), "mm_per_pixel: expected 0.0005 to 1, got -1");
    // A contact of 67 pixels is wider than this ball.
    let message = refused(1.0, Some(0.0295));
    assert!(message.contains("expected contact radii below the ball's, 33.9 pixels"), "{message}");
}

#[test]
fn a_sensor_that_cannot_be_drawn_is_refused_by_name() {
    let refused = |text: &str| {
        let sensor = Sensor::parse(text).expect("a sensor");
        Given::new(sensor).expect_err("nothing to draw").to_string()
    };
    let plain = refused(r#"{ "name": "any" }"#);
    assert_eq!(plain, "sensor `any`: frame: expected one to draw, got none");
    let large = refused(r#"{ "name": "big", "frame": [5000, 4000], "mm_per_pixel": 0.01 }"#);
    assert!(
        large.contains("expected sides of 32 to 4000 pixels to draw, got 5000 × 4000"),
        "{large}"
    );
    let background = data("gelsight_ball_presses/background.png");
    let text = serde_json::json!({ "name": "a", "frame": [640, 640], "mm_per_pixel": 0.03,
        "reference": background });
    let other = refused(&text.to_string());
    assert!(other.contains("expected 640 × 640 pixels as the sensor's frames"), "{other}");
    let text = text.to_string().replace("background", "foreground");
    assert!(refused(&text).contains("foreground.png"), "{text}");
}

/// A gel that is a part of the frame: snaps are labelled there alone, and the rest is dark.
#[test]
fn the_papers_frames_show_gel_in_the_middle() {
    let given = Given::new(Sensor::paper()).expect("a sensor");
    let request = Request {
        sensor: Some(std::sync::Arc::new(given)),
        forced: "mild".parse().expect("a condition"),
        ..Request::wide(Mix::B)
    };
    let Rendered { picture, frame, labels, conditions } =
        Renderer::new().render(3, &request).expect("a picture");
    assert_eq!((frame.width, frame.height, frame.mm_per_pixel), (1920, 1200, 0.04));
    assert_eq!(conditions.window, [460.0, 100.0, 1460.0, 1100.0]);
    for Label { pixel_box: [x0, y0, x1, y1], .. } in labels {
        assert!(x0 >= 460.0 && y0 >= 100.0 && x1 <= 1460.0 && y1 <= 1100.0);
    }
    let brightest = |x: std::ops::Range<u32>| {
        let column = x.flat_map(|x| (0..1200).map(move |y| (x, y)));
        column.map(|(x, y)| picture.get_pixel(x, y).0[1]).max().unwrap_or(0)
    };
    assert!(brightest(0..440) < 40 && brightest(1480..1920) < 40 && brightest(900..1000) > 60);
}

/// A gel in a corner of a large frame is pressed as one in the middle, in as fine cells.
#[test]
fn a_gel_in_a_corner_is_drawn_as_one_in_the_middle() {
    let drawn = |seed: u64, x: u32, y: u32| {
        let text = format!(
            r#"{{ "name": "a", "frame": [1600, 1200], "mm_per_pixel": 0.08,
                "gel": {{ "x": {x}, "y": {y}, "width": 250, "height": 250 }} }}"#
        );
        let given = Given::new(Sensor::parse(&text).expect("a sensor")).expect("one to draw");
        let request = Request {
            sensor: Some(std::sync::Arc::new(given)),
            forced: "mild,depth=0.5".parse().expect("conditions"),
            ..Request::wide(Mix::B)
        };
        Renderer::new().render(seed, &request).expect("a picture").labels
    };
    let mut whole = 0;
    for seed in 0..2 {
        let (middle, corner) = (drawn(seed, 675, 475), drawn(seed, 1350, 950));
        assert!(!middle.is_empty() && middle.len() == corner.len());
        for (a, b) in middle.iter().zip(&corner) {
            // 54 and 38 mm further out a dent of 0.5 mm is seen 0.44 mm further out at most, from 62.5 mm.
            let out = [0, 1].map(|axis| b.center_mm[axis] - a.center_mm[axis]);
            assert!(out.into_iter().all(|out| (0.0..0.45).contains(&out)), "{out:?}");
            if a.whole && b.whole {
                // The same cells touch.
                assert_close(b.area_px, a.area_px, 1e-6, "area");
                whole += 1;
            }
        }
    }
    assert!(whole >= 2, "{whole} snaps are whole");
}

#[test]
fn a_broken_calibration_names_its_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let error = calibrate::calibrate(folder.path(), &KNOWN).expect_err("nothing is there");
    assert!(error.to_string().contains("background.png"), "{error}");

    let source = data("gelsight_ball_presses");
    std::fs::copy(source.join("background.png"), folder.path().join("background.png"))
        .expect("a copy");
    let csv = "file,center_x_px,center_y_px,contact_radius_px\npress_00.png,1,2\n";
    std::fs::write(folder.path().join("presses.csv"), csv).expect("a file");
    let error = calibrate::calibrate(folder.path(), &KNOWN).expect_err("a field is missing");
    assert!(matches!(error, Error::Content { .. }), "{error}");
    assert!(error.to_string().contains("press_00.png,1,2"), "{error}");
    let csv = "press_00.png,299,220,63\npress_01.png,300,169,61\n";
    std::fs::write(folder.path().join("presses.csv"), csv).expect("a file");
    let error = calibrate::calibrate(folder.path(), &KNOWN).expect_err("no header").to_string();
    assert!(error.contains("expected the header file,center_x_px"), "{error}");
    // A hole: it takes no space.
    let table = std::fs::File::create(folder.path().join("presses.csv")).expect("a file");
    table.set_len(1 << 25).expect("long");
    let error = calibrate::calibrate(folder.path(), &KNOWN).expect_err("a long table").to_string();
    assert!(
        error.contains("presses.csv: expected at most 16777216 bytes, got 33554432"),
        "{error}"
    );
    #[cfg(unix)]
    {
        let picture = folder.path().join("background.png");
        std::fs::remove_file(&picture).expect("removed");
        let made = std::process::Command::new("mkfifo").arg(&picture).status().expect("mkfifo");
        assert!(made.success());
        // Opening it would wait for a writer.
        let error = calibrate::calibrate(folder.path(), &KNOWN).expect_err("a pipe").to_string();
        assert!(error.contains("background.png: expected a file, got a named pipe"), "{error}");
    }

    let yaml = folder.path().join("x.yaml");
    let numbers = "quadfit: \n    rows: 6\n    cols: 10\n    values: [1, 2]\n";
    for (size, missing) in [
        ("", "modelsize: (width, height), found no such size"),
        ("    modelsize: (600, 0)\n", "found no such size"),
        ("    modelsize: (600, 400)\n", "found 2 numbers"),
    ] {
        std::fs::write(&yaml, format!("{numbers}flatfield: \n{size}")).expect("a file");
        assert_eq!(calibrate::sensor_files(folder.path()).expect("one"), [yaml.as_path()]);
        let error = calibrate::read_sensor(&yaml).expect_err("not a calibration");
        assert!(error.to_string().contains(missing), "{error}");
    }
}

#[test]
fn both_kinds_have_the_same_footprint() {
    // Area of the part's outline, where it is less than 1.6 mm below its highest point.
    let mean_area = |kind: Kind| {
        let mut rng = Pcg64::seed_from_u64(3);
        let areas = (0..60).map(|_| {
            let snap = Snap::sample(&mut rng, &kind);
            assert_eq!(snap.kind(), kind);
            let mut extent = [f64::INFINITY, f64::INFINITY, -f64::INFINITY, -f64::INFINITY];
            for (x, y) in (-60..60).flat_map(|x| (-60..60).map(move |y| (x, y))) {
                let (x, y) = (0.1 * f64::from(x), 0.1 * f64::from(y));
                let height = snap.height(x, y);
                assert!(height <= 1e-9, "{snap:?} rises to {height}");
                if height > -1.6 {
                    assert!(x.hypot(y) <= snap.reach() + 0.3, "{snap:?} reaches {x}, {y}");
                    extent =
                        [extent[0].min(x), extent[1].min(y), extent[2].max(x), extent[3].max(y)];
                }
            }
            let fill = if kind == Kind::A { 1.0 } else { std::f64::consts::FRAC_PI_4 };
            fill * (extent[2] - extent[0]) * (extent[3] - extent[1])
        });
        areas.sum::<f64>() / 60.0
    };
    // Both are uniform in 20 to 49 mm²: the standard error of a mean of 60 is 3 %, and the
    // outlines' walls add up to a tenth.
    let (a, b) = (mean_area(Kind::A), mean_area(Kind::B));
    assert_close(a, b, 0.15, "mean area");
}

#[test]
fn snaps_have_their_features() {
    let mut rng = Pcg64::seed_from_u64(11);
    for _ in 0..20 {
        let Snap::Hook(hook) = Snap::sample(&mut rng, &Kind::A) else { panic!("kind A is a hook") };
        assert!((6.0..=10.0).contains(&hook.length) && (3.0..=5.0).contains(&hook.width));
        let snap = Snap::Hook(hook.clone());
        let along: Vec<f64> = (0..200)
            .map(|i| snap.height((f64::from(i) / 199.0 - 0.5) * hook.length, 0.0))
            .collect();
        let highest = along.iter().fold(f64::NEG_INFINITY, |a, &b| a.max(b));
        assert!(highest.abs() < 0.02, "the barb's top is at {highest}");
        // The arm lies one undercut lower over a third of the length or more.
        let arm = along.iter().filter(|h| (**h + hook.undercut).abs() < 0.01).count();
        assert!(arm > 60, "the arm takes {arm} of 200");

        let Snap::Stud(stud) = Snap::sample(&mut rng, &Kind::B) else { panic!("kind B is a stud") };
        let snap = Snap::Stud(stud.clone());
        assert!(snap.height(0.0, 0.0) < -1.0, "the ring has no hole");
        // Round the ring's crest, the height drops once for each slot.
        let radius = stud.diameter / 2.0;
        let crest = |angle: f64| {
            let (x, y) = (angle.cos(), angle.sin() / stud.oval);
            let r = radius - stud.bead - 0.45 * stud.wall;
            snap.height(r * x, r * y) > -0.35
        };
        let turns = (0..720).filter(|i| {
            let at = |i: i32| f64::from(i) * std::f64::consts::TAU / 720.0;
            crest(at(*i)) && !crest(at(i + 1))
        });
        assert_eq!(turns.count(), stud.slots as usize, "{stud:?}");
    }
}

#[test]
fn scenes_follow_their_rules() {
    let mut empty = 0;
    let mut untouched = 0;
    let mut kinds = BTreeMap::new();
    for seed in 0..400 {
        let scene = Scene::sample(seed, Mix::Mixed, &Own::default());
        empty += usize::from(scene.snaps.is_empty());
        for (i, a) in scene.snaps.iter().enumerate() {
            *kinds.entry(a.part.kind().name().to_owned()).or_insert(0) += 1;
            assert!(a.center_mm.iter().all(|c| c.abs() <= GEL_MM / 2.0));
            for b in &scene.snaps[..i] {
                let distance =
                    (a.center_mm[0] - b.center_mm[0]).hypot(a.center_mm[1] - b.center_mm[1]);
                assert!(distance > a.part.reach() + b.part.reach());
            }
        }
        let only = Scene::sample(seed, Mix::A, &Own::default());
        assert!(!only.snaps.is_empty() && only.snaps.iter().all(|s| s.part.kind() == Kind::A));
        assert_eq!(scene, Scene::sample(seed, Mix::Mixed, &Own::default()));
        let other = Scene::sample(seed, Mix::None, &Own::default());
        assert!(other.snaps.is_empty());
        untouched += usize::from(other.distractors.is_empty());
    }
    // 1 in 10: 40 of 400, standard deviation 6.
    assert!((10..=70).contains(&untouched), "{untouched} scenes touch nothing");
    // 8 in 100 are empty: 32 of 400, standard deviation 5.4.
    assert!((10..=54).contains(&empty), "{empty} scenes are empty");
    let (a, b) = (kinds["A"], kinds["B"]);
    // About 600 snaps, half of each kind: five standard deviations are 61.
    assert!(i32::abs(a - b) < 125, "{a} of A, {b} of B");
}

#[test]
fn every_snap_that_shows_is_labelled() {
    let mut renderer = Renderer::new();
    for seed in 0..4 {
        let rendered = renderer.render(seed, &Request::plain(Mix::B)).expect("a picture");
        assert_eq!(rendered.picture.dimensions(), (PICTURE_PX as u32, PICTURE_PX as u32));
        assert!(!rendered.labels.is_empty());
        for label in &rendered.labels {
            assert_eq!(label.kind, "B");
            let [x0, y0, x1, y1] = label.pixel_box;
            assert!(0.0 <= x0 && x0 < x1 && x1 <= 1000.0 && 0.0 <= y0 && y0 < y1 && y1 <= 1000.0);
            assert!((x1 - x0).max(y1 - y0) * MM_PER_PX >= LEAST_IMPRINT_MM);
            assert!((label.center_mm[0] - ((x0 + x1) / 2.0 - 500.0) * MM_PER_PX).abs() < 1e-9);
            // A ring touches part of its box.
            let fill = label.area_px / ((x1 - x0) * (y1 - y0));
            assert!((0.02..0.95).contains(&fill), "{fill} of the box touches");
        }
        assert!(
            renderer.render(seed, &Request::plain(Mix::None)).expect("a picture").labels.is_empty()
        );
    }
}

/// All files of a folder with their bytes.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            found.extend(contents(&path));
        } else {
            found.insert(path.clone(), std::fs::read(&path).expect("a file"));
        }
    }
    found
}

fn relative(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let strip = |(path, bytes): (PathBuf, Vec<u8>)| {
        (path.strip_prefix(folder).expect("it is inside").to_owned(), bytes)
    };
    contents(folder).into_iter().map(strip).collect()
}

#[test]
fn data_sets_do_not_depend_on_threads_or_interruptions() {
    let (one, three) = (tempfile::tempdir().expect("one"), tempfile::tempdir().expect("three"));
    let settings = |out: &Path, count| Settings {
        out: out.into(),
        count,
        seed: 42,
        request: Request::plain(Mix::Mixed),
        shard: None,
    };
    let run = |settings: &Settings, threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let seen = Mutex::new(Vec::new());
        let progress = |Progress { step, done, all }: Progress| {
            if step == Step::Render {
                assert_eq!(all, settings.count);
                seen.lock().expect("no panic").push(done);
            }
        };
        let summary = pool.install(|| simulate(settings, &progress)).expect("a data set");
        let mut seen = seen.into_inner().expect("no panic");
        seen.sort_unstable();
        assert_eq!(seen, (summary.kept..=settings.count).collect::<Vec<_>>());
        summary
    };
    let summary = run(&settings(one.path(), 10), 1);
    assert_eq!((summary.rendered, summary.kept), (10, 0));
    let whole = relative(one.path());

    // Three threads, begun with fewer pictures, cut off in the middle of one, then continued.
    run(&settings(three.path(), 9), 3);
    std::fs::remove_file(three.path().join("images/000004.png")).expect("a picture");
    std::fs::remove_file(three.path().join("labels/000007.json")).expect("labels");
    std::fs::write(three.path().join("images/.smr-gpu-Qm3Xc1.unfinished"), "torn").expect("a file");
    let summary = run(&settings(three.path(), 10), 3);
    assert_eq!((summary.rendered, summary.kept), (3, 7));
    let resumed = relative(three.path());
    assert!(whole.keys().eq(resumed.keys()), "{:?} against {:?}", whole.keys(), resumed.keys());
    for (path, bytes) in &whole {
        assert!(*bytes == resumed[path], "{} differs", path.display());
    }

    // The labels are COCO's.
    let coco: serde_json::Value =
        serde_json::from_slice(&whole[Path::new("annotations.json")]).expect("JSON");
    let list = |name: &str| coco[name].as_array().expect("a list").clone();
    assert_eq!(list("images").len(), 10);
    assert_eq!(Some(list("annotations").len()), summary.snaps);
    let pairs: Vec<_> =
        list("categories").iter().map(|c| (c["id"].clone(), c["name"].clone())).collect();
    assert_eq!(pairs, [(1.into(), "A".into()), (2.into(), "B".into())]);
    for image in list("images") {
        let file = Path::new("images").join(image["file_name"].as_str().expect("a name"));
        assert!(whole.contains_key(&file));
        let index = image["id"].as_u64().expect("a number");
        assert_eq!(image["scene_seed"], scene_seed(42, index).to_string());
    }
    for annotation in list("annotations") {
        let kind = annotation["kind"].as_str().expect("a name");
        assert_eq!(annotation["category_id"], if kind == "A" { 1 } else { 2 });
        let b: Vec<f64> = annotation["bbox"]
            .as_array()
            .expect("four")
            .iter()
            .filter_map(|v| v.as_f64())
            .collect();
        assert!((annotation["area"].as_f64().expect("a number") - b[2] * b[3]).abs() < 1.0);
        let x = annotation["center_mm"][0].as_f64().expect("a number");
        assert!((x - (b[0] + b[2] / 2.0 - 500.0) * MM_PER_PX).abs() < 1e-3);
    }

    // Another seed may not continue the folder.
    let other = Settings { seed: 43, ..settings(one.path(), 2) };
    let error = simulate(&other, &|_| ()).expect_err("another seed");
    assert!(matches!(error, Error::OtherDataset { .. }), "{error}");
    assert!(error.to_string().contains("seed 42"), "{error}");
}

#[test]
fn scene_seeds_of_different_data_sets_differ() {
    let mut seen = std::collections::BTreeSet::new();
    for seed in 0..50 {
        for index in 0..1000 {
            assert!(seen.insert(scene_seed(seed, index)), "seed {seed}, picture {index}");
        }
    }
}

/// A picture of the plain distribution: 64 levels, of pixel (61 + 125 (n mod 8), 61 + 125 (n div 8))
/// the channel n mod 3, and the boxes.
#[derive(serde::Deserialize)]
struct PlainPicture {
    mix: Mix,
    seed: String,
    levels: Vec<u8>,
    boxes: Vec<[f64; 4]>,
}

#[test]
fn plain_pictures_stay_what_they_are() {
    let pictures: Vec<PlainPicture> =
        serde_json::from_str(include_str!("data/plain_pictures.json")).expect("JSON");
    let mut renderer = Renderer::new();
    for PlainPicture { mix, seed, levels, boxes } in pictures {
        let seed = seed.parse().expect("a seed");
        let rendered = renderer.render(seed, &Request::plain(mix)).expect("a picture");
        assert!(rendered.conditions.plain && rendered.frame == Raster::PAPER);
        for (n, &level) in levels.iter().enumerate() {
            let (x, y) = (61 + 125 * (n as u32 % 8), 61 + 125 * (n as u32 / 8));
            let found = rendered.picture.get_pixel(x, y).0[n % 3];
            // Transforms differ in rounding from processor to processor; other noise would differ
            // by more than a level in a third of the pixels.
            assert!(found.abs_diff(level) <= 1, "{mix:?}: {found} at {x}, {y}, expected {level}");
        }
        assert_eq!(rendered.labels.len(), boxes.len());
        for (label, [x, y, width, height]) in rendered.labels.iter().zip(boxes) {
            for (a, b) in label.pixel_box.into_iter().zip([x, y, x + width, y + height]) {
                assert!((a - b).abs() < 0.01, "{mix:?}: {:?}", label.pixel_box);
            }
        }
    }
}

#[test]
fn a_lens_bends_places_and_back() {
    let frame = Raster { width: 640, height: 480, mm_per_pixel: 0.05 };
    let camera = Camera { frame, distortion: 0.1, ..Camera::default() };
    // A corner lies half a diagonal from the middle: it shows what lies 1.1 times as far.
    let [x, y] = camera.flat_place(640.0, 480.0);
    assert_close(x, 1.1 * 16.0, 1e-12, "x");
    assert_close(y, 1.1 * 12.0, 1e-12, "y");
    for distortion in [-0.3, -0.12, 0.0, 0.12, 0.5] {
        let camera = Camera { distortion, ..camera };
        for place in [[0.0, 0.0], [630.0, 20.0], [100.0, 333.0]] {
            let [x, y] = camera.flat_place(place[0], place[1]);
            let [px, py] = camera.project(x, y, 0.0);
            assert!((px - place[0]).hypot(py - place[1]) < 1e-9, "{place:?} becomes {px}, {py}");
        }
    }
    // What lies past all that such a lens shows does not come back into the picture.
    let camera = Camera { distortion: -0.3, ..camera };
    for far in [1.0, 2.0, 10.0] {
        let [px, py] = camera.project(16.0 * far, 12.0 * far, 0.0);
        assert!(px > 640.0 && py > 480.0, "{far} half diagonals: {px}, {py}");
    }
}

#[test]
fn a_lens_without_blur_changes_nothing() {
    let camera = Camera { frame: Raster::GELSIGHT_MINI, blur_px: 0.0, ..Camera::default() };
    let mut plane: Vec<f32> = (0..320 * 240).map(|i| (i % 7) as f32).collect();
    let sharp = plane.clone();
    camera.blur(&mut plane, &mut Vec::new());
    assert_eq!(plane, sharp);
}

#[test]
fn what_a_sensor_states_is_not_forced() {
    let text = r#"{ "name": "dots", "frame": [320, 240], "mm_per_pixel": 0.0634,
        "markers": { "pitch_mm": 1.5, "diameter_mm": 0.5 } }"#;
    let given = Given::new(Sensor::parse(text).expect("a sensor")).expect("a drawable sensor");
    let stated = |forced: &str| given.stated(&forced.parse().expect("conditions"));
    assert_eq!(stated("scale=0.8"), Some("scale"));
    assert_eq!(stated("exposure=2,markers=2"), Some("markers"));
    assert_eq!(stated("strength=2,mottle=0.02,blur=1,wall"), None);
}

#[test]
fn a_contact_s_grid_covers_its_field() {
    for (frame, gel) in [
        (Raster::PAPER, [44.0, 44.0]),
        (Raster::GELSIGHT_MINI, [24.3, 19.2]),
        (Raster { width: 800, height: 600, mm_per_pixel: 0.0125 }, [14.0, 11.5]),
        (Raster { width: 640, height: 480, mm_per_pixel: 0.09375 }, [64.0, 49.0]),
    ] {
        let grid = contact_grid(&frame, gel);
        let side = grid.cells as f64 * grid.spacing_mm;
        // As much free gel on every side as plain pictures have.
        assert_close(side, gel[0] + 11.2, 1e-9, "side");
        assert!(
            grid.cells <= 640 && grid.spacing_mm >= 0.04 && grid.spacing_mm <= 0.12,
            "{grid:?}"
        );
    }
}

#[test]
fn shadows_fall_away_from_the_light() {
    let grid = Grid { cells: 128, spacing_mm: 0.1 };
    // A tower 1 mm high and 2 mm wide in the middle: at 45 degrees its shadow is 1 mm long.
    let heights: Vec<f32> = body(grid, |x, y| (x.abs().max(y.abs()) < 1.0).then_some(1.0))
        .into_iter()
        .map(|h| h.max(0.0))
        .collect();
    let at = |shadow: &[f32], x: f64, y: f64| {
        shadow[grid.index(y).round() as usize * 128 + grid.index(x).round() as usize]
    };
    for turns in 0..4 {
        let azimuth = f64::from(turns) * std::f64::consts::FRAC_PI_2;
        let ray = Ray { azimuth, elevation: std::f64::consts::FRAC_PI_4 };
        let shadow = cast(grid, &heights, ray, 0.1, 0.0);
        let (sin, cos) = azimuth.sin_cos();
        // Distances from the tower's middle against the light.
        for (distance, dark) in [(1.5, true), (1.75, true), (2.3, false), (-1.5, false)] {
            let found = at(&shadow, -distance * cos, -distance * sin);
            assert_eq!(found, f32::from(u8::from(dark)), "{distance} mm away from {azimuth}");
        }
        assert_eq!(at(&shadow, 0.0, 0.0), 0.0, "its top is lit");
        assert_eq!(at(&shadow, 1.5 * sin, 1.5 * cos), 0.0, "its side is lit");
    }
    // Low light makes long shadows: 1 / tan 20° = 2.75 mm.
    let low = Ray { azimuth: 0.0, elevation: 20f64.to_radians() };
    let shadow = cast(grid, &heights, low, 0.1, 0.0);
    assert_eq!(at(&shadow, -3.5, 0.0), 1.0);
    assert_eq!(at(&shadow, -4.1, 0.0), 0.0);
    // Askew light reaches both sides that face it.
    let askew = Ray { azimuth: 0.6, elevation: std::f64::consts::FRAC_PI_4 };
    let shadow = cast(grid, &heights, askew, 0.1, 0.0);
    assert_eq!(at(&shadow, 1.3, 0.0), 0.0);
    assert_eq!(at(&shadow, 0.0, 1.3), 0.0);
    assert!(at(&shadow, -1.4, -0.4) > 0.9);
    // A lamp from 35° to 55°: all dark for 1 / tan 55° = 0.70 mm, all lit from 1 / tan 35° = 1.43 mm.
    let large = Ray { azimuth: 0.0, elevation: std::f64::consts::FRAC_PI_4 };
    let shadow = cast(grid, &heights, large, 0.01, 10f64.to_radians());
    assert_eq!(at(&shadow, -1.55, 0.0), 1.0);
    let [near, far] = [-1.95, -2.25].map(|x| at(&shadow, x, 0.0));
    assert!(0.9 > near && near > far + 0.2 && far > 0.01, "{near} {far}");
    assert_eq!(at(&shadow, -2.55, 0.0), 0.0);
}

#[test]
fn gel_moves_sideways_as_the_layer_s_solution_says() {
    let layer = Layer { thickness_mm: 4.0, shear_modulus_mpa: 0.145 };
    // Thin: what the surface gives way by flows off sideways, with a parabola's mean of two thirds of
    // the surface's own motion: w = k H · 2/3 u, and u = k q. The next term is x²/5 of it.
    for x in [1e-3, 0.019_99, 0.02, 0.05] {
        let k = x / layer.thickness_mm;
        let flow = x * 2.0 / 3.0 * k * layer.sideways(k);
        assert_close(flow, 1.0, x * x, "thin");
    }
    // By hand at x = 1: u = 2 / (sinh 2 − 2) = 2 / 1.626860408 of w, and u = k q.
    let k = 0.25;
    assert_close(layer.sideways(k), 2.0 / 1.626_860_408 / k, 1e-9, "x = 1");
    // A half-space does not move.
    assert!(layer.sideways(20.0) * 20.0 < 1e-30);

    // A wave of depth w = cos kx moves the gel by T k sin kx: away from where it is deepest.
    let grid = Grid { cells: 64, spacing_mm: 0.5 };
    let k = std::f64::consts::TAU / 32.0;
    let depth: Vec<f32> =
        (0..grid.len()).map(|i| (k * grid.position(i % 64)).cos() as f32).collect();
    let all = vec![true; 64];
    let mut potential = vec![0.0; grid.len()];
    Elasticity::sideways(&layer, grid).displacement(&depth, &all, &all, &mut potential);
    let moved = Sideways {
        potential: Surface::new(grid, potential),
        share: Surface::new(grid, vec![0.0; grid.len()]),
        shear_mm: [0.0; 2],
    };
    let x = grid.position(40);
    let [rest, y] = moved.rest([x, 0.25]);
    // Central differences shrink a slope by sinc(k h).
    let expected = layer.sideways(k) * k * (k * x).sin() * (k * 0.5).sin() / (k * 0.5);
    assert_close(x - rest, expected, 1e-4, "displacement");
    assert!(expected > 0.1 && (y - 0.25).abs() < 1e-5);
}

#[test]
fn markers_move_with_the_gel() {
    let markers = Markers {
        pitch_mm: 2.0,
        size_mm: 0.6,
        square: false,
        yaw: 0.0,
        origin_mm: [0.0; 2],
        jitter: 0.0,
        missing: 0.0,
        brightness: [0.2; 3],
        edge_mm: 0.05,
        seed: 1,
    };
    // Dots of 0.6 mm about every second millimetre.
    for (x, y, printed) in [(0.0, 0.0, 1.0), (2.25, -4.0, 1.0), (2.35, 0.0, 0.0), (1.0, 1.0, 0.0)] {
        assert_eq!(markers.coverage(x, y), printed, "{x}, {y}");
    }
    // A potential of −x²/20 stretches the gel: what was at x is now at 1.1 x. The parts slide by
    // 0.3 mm along y, and the gel follows by half.
    let grid = Grid { cells: 64, spacing_mm: 0.25 };
    let stretch = (0..grid.len()).map(|i| (-0.05 / 1.1 * grid.position(i % 64).powi(2)) as f32);
    let moved = Sideways {
        potential: Surface::new(grid, stretch.collect()),
        share: Surface::new(grid, vec![0.5; grid.len()]),
        shear_mm: [0.0, 0.3],
    };
    let seen = |x: f64, y: f64| {
        let [x, y] = moved.rest([x, y]);
        markers.coverage(x, y)
    };
    // The dot of (4, 0) is at (4.4, 0.15).
    assert_eq!(seen(4.4, 0.15), 1.0);
    assert_eq!(seen(4.65, 0.15), 1.0);
    assert_eq!(seen(4.02, 0.15), 0.0);
    assert_eq!(seen(4.4, -0.2), 0.0);
}

#[test]
fn a_smoothed_relief_keeps_the_part_and_falls_off_beside_it() {
    let grid = Grid { cells: 128, spacing_mm: 0.1 };
    let rigid = body(grid, |x, y| (x.abs().max(y.abs()) < 1.5).then_some(0.7));
    let contact = smooth::pressed(grid, &rigid, 0.4);
    for (i, &d) in rigid.iter().enumerate() {
        assert_eq!(contact.pressure[i] > 0.0, d > 0.0);
        let depth = contact.displacement[i];
        assert!(if d > 0.0 { depth == d } else { (0.0..0.7).contains(&depth) });
    }
    let row = 64 * 128;
    let outside: Vec<f32> = (80..100).map(|x| contact.displacement[row + x]).collect();
    assert!(outside.windows(2).all(|pair| pair[1] <= pair[0]) && outside[19] < 1e-3);
}

#[test]
fn a_snap_s_visible_share_is_what_the_picture_shows() {
    let mut rng = Pcg64::seed_from_u64(4);
    // From so far that there is no parallax.
    let camera = Camera { distance_mm: 1e6, ..Camera::default() };
    for kind in [Kind::A, Kind::B] {
        let part = Snap::sample_wide(&mut rng, &kind, &Forced::default());
        let place = |x: f64, yaw: f64| Placed {
            part: part.clone(),
            center_mm: [x, 0.0],
            yaw,
            tilt: [0.0; 2],
            depth_mm: 1.4,
        };
        let share = |x, yaw| visible_share(&place(x, yaw), &camera, WINDOW);
        assert_eq!(share(0.0, 0.3), 1.0);
        assert_eq!(share(30.0, 0.3), 0.0);
        // Cut by the edge in the middle along its length. Both halves make the whole, and the one
        // in 64 that lies on the edge counts for both.
        let (half, other) = (share(20.0, 0.0), share(20.0, std::f64::consts::PI));
        assert!((0.2..0.8).contains(&half), "{half}");
        assert!((half + other - 1.0).abs() < 0.04, "{half} and {other}");
    }
}

#[test]
fn a_ring_s_bead_and_edges_can_be_forced_with_and_without_slots() {
    let forced: Forced = "bead=0,fillet=0.6".parse().expect("conditions");
    for seed in 0..50 {
        let rng = || Pcg64::seed_from_u64(seed);
        let stud = |forced: &Forced| match Snap::sample_wide(&mut rng(), &Kind::B, forced) {
            Snap::Stud(stud) => stud,
            other => panic!("{other:?}"),
        };
        let ring = |forced: &Forced| match Distractor::sample_wide(&mut rng(), Part::Ring, forced) {
            Some(Distractor::Ring(ring)) => ring,
            other => panic!("{other:?}"),
        };
        for draw in [&stud as &dyn Fn(&Forced) -> Stud, &ring] {
            let (free, plain) = (draw(&Forced::default()), draw(&forced));
            let fillet = 0.6f64.min(plain.wall / 2.0);
            // The wall, and with it a slot's width, may follow the bead.
            let Stud { wall, slot_width, .. } = plain;
            assert_eq!(plain, Stud { bead: 0.0, fillet, wall, slot_width, ..free });
        }
        // A hole that is forced is so wide whatever the bead, where the stud leaves room for it.
        let hole = stud(&"hole=2,bead=0".parse().expect("conditions"));
        let widest = hole.diameter / hole.oval - 0.6;
        assert_close(hole.hole_mm(), 2f64.min(widest), 1e-9, "hole");
    }
}

#[test]
fn a_wall_is_not_in_its_hook_s_box() {
    let forced: Forced = "mild,wall".parse().expect("conditions");
    let (grid, gel) = (GRID, [40.0, 40.0]);
    let mut elasticity = Elasticity::new(&Layer::default(), grid);
    let camera = Camera::default();
    let mut checked = 0;
    for seed in 0..6 {
        let rng = &mut Pcg64::seed_from_u64(seed);
        let region = [-20.0, -20.0, 20.0, 20.0];
        let scene = Scene::sample_wide(rng, region, Mix::A, None, (&forced, &Own::default()));
        assert!(scene.snaps.iter().all(|s| matches!(&s.part, Snap::Hook(h) if h.wall)));
        assert!(scene.distractors.len() >= scene.snaps.len(), "each has its wall");
        let body = scene.body(grid, gel);
        let contact = solve(&mut elasticity, &body.penetration, STOP);
        let found = imprints(&body, &contact, grid, &camera, WINDOW, scene.snaps.len());
        for (snap, imprint) in scene.snaps.iter().zip(found) {
            let Some(imprint) = imprint else { continue };
            // The turned outline's box, seen at the part's depth; walls of parts slope by a fifth.
            let [a, b] = snap.part.half_size();
            let (sin, cos) = (snap.yaw.sin().abs(), snap.yaw.cos().abs());
            let extent = [a * cos + b * sin + 0.35, a * sin + b * cos + 0.35];
            let [x0, y0, x1, y1] = imprint.pixel_box;
            for (axis, (low, high)) in [(x0, x1), (y0, y1)].into_iter().enumerate() {
                let center = snap.center_mm[axis] / MM_PER_PX + 500.0;
                let reach = extent[axis] / MM_PER_PX + 5.0;
                assert!(low > center - reach && high < center + reach, "seed {seed}: {imprint:?}");
            }
            checked += 1;
        }
    }
    assert!(checked >= 6, "{checked} hooks touch");
}

#[test]
fn lookalikes_have_no_label_and_can_be_drawn_alone() {
    let mut renderer = Renderer::new();
    let forced: Forced = "frame=gelsight-mini".parse().expect("a frame");
    let parts = [
        Part::Arm,
        Part::Block,
        Part::Tab,
        Part::Ring,
        Part::Screw,
        Part::Nut,
        Part::Ball,
        Part::Prism,
        Part::Bracket,
        Part::Letters,
        Part::Rib,
        Part::Edge,
        Part::Pin,
        Part::Dome,
        Part::Button,
        Part::Rivet,
        Part::Torus,
        Part::Clip,
        Part::FirTree,
        Part::Nothing,
    ];
    for part in parts {
        let request =
            Request { part: Some(part), forced: forced.clone(), ..Request::wide(Mix::None) };
        let rendered = renderer.render(3, &request).expect("a picture");
        assert!(rendered.labels.is_empty(), "{part:?}");
        assert_eq!(rendered.frame, Raster::GELSIGHT_MINI);
        assert_eq!(rendered.picture.dimensions(), (320, 240));
        let rng = &mut Pcg64::seed_from_u64(3);
        let scene = Scene::sample_wide(
            rng,
            [-10.0, -8.0, 10.0, 8.0],
            Mix::None,
            Some(part),
            (&forced, &Own::default()),
        );
        assert_eq!(scene.distractors.is_empty(), part == Part::Nothing, "{part:?}");
        if let Some(shape) = Distractor::sample_wide(rng, part, &forced) {
            // The highest point is at 0, and the outline is where the part ends.
            let [a, b] = shape.half_size().unwrap_or([5.0, 5.0]);
            let mut highest = f64::NEG_INFINITY;
            for (i, j) in (-60..=60).flat_map(|i| (-60..=60).map(move |j| (i, j))) {
                let (u, v) = (f64::from(i) / 60.0 * 1.2 * a, f64::from(j) / 60.0 * 1.2 * b);
                let height = shape.height(u, v);
                highest = highest.max(height);
                if shape.half_size().is_some() && (u.abs() > a + 0.01 || v.abs() > b + 0.01) {
                    assert!(height < -0.01, "{shape:?} is {height} high at {u}, {v}");
                }
            }
            assert!(highest <= 1e-9 && highest > -0.3, "{part:?} is {highest} high");
        }
    }
}

#[test]
fn wide_pictures_are_as_their_labels_say() {
    let mut renderer = Renderer::new();
    for seed in 0..10 {
        let rendered = renderer.render(seed, &Request::wide(Mix::Mixed)).expect("a picture");
        let again = Renderer::new().render(seed, &Request::wide(Mix::Mixed)).expect("a picture");
        assert!(rendered.picture == again.picture, "seed {seed} gives two pictures");
        assert_eq!(rendered.labels, again.labels);
        let Raster { width, height, mm_per_pixel } = rendered.frame;
        assert_eq!(rendered.picture.dimensions(), (width as u32, height as u32));
        let [left, top, right, bottom] = rendered.conditions.window;
        for label in &rendered.labels {
            let [x0, y0, x1, y1] = label.pixel_box;
            assert!(left <= x0 && x0 < x1 && x1 <= right && top <= y0 && y0 < y1 && y1 <= bottom);
            assert!((x1 - x0).max(y1 - y0) * mm_per_pixel >= LEAST_IMPRINT_MM);
            assert!(label.visible >= 0.25);
            let is_hook = label.kind == "A";
            assert_eq!(label.yaw_deg.is_some(), is_hook);
            assert_eq!(label.slots.is_none(), is_hook);
            assert_eq!(label.hole_mm.is_none(), is_hook);
        }
        if rendered.conditions.colour < 0.0 && rendered.conditions.jpeg.is_none() {
            assert!(rendered.picture.pixels().all(|p| p.0[0] == p.0[1] && p.0[1] == p.0[2]));
        }
    }
}

#[test]
fn a_screw_s_drive_can_be_set() {
    let text = "drive=slot";
    let forced: Forced = text.parse().expect("a condition");
    assert_eq!(forced.to_string(), text);
    let error = "drive=star".parse::<Forced>().expect_err("no such drive").to_string();
    assert!(error.contains("drive=cross, drive=slot or drive=hex"), "{error}");
    for seed in 0..12 {
        let screw = |forced: &Forced| {
            let mut rng = Pcg64::seed_from_u64(seed);
            match Distractor::sample_wide(&mut rng, Part::Screw, forced) {
                Some(Distractor::Screw { radius, drive, recess, .. }) => (radius, drive, recess),
                other => panic!("{other:?}"),
            }
        };
        let (radius, drive, recess) = screw(&forced);
        let drawn = screw(&Forced::default());
        assert!(drive == Drive::Slot && recess < 0.22 * radius, "seed {seed}");
        // The rest is drawn as ever.
        assert!(radius == drawn.0 && (drawn.1 != drive || recess == drawn.2), "seed {seed}");
    }
}

/// A snap that is cut has a box that reaches the picture's edge, but for what of it does not touch the
/// gel there; one that is whole keeps off.
#[test]
fn a_snap_is_whole_where_its_box_keeps_off_the_edge() {
    let mut renderer = Renderer::new();
    for (cut, seed) in [false, true].into_iter().flat_map(|cut| (0..6).map(move |seed| (cut, seed)))
    {
        let answer = if cut { "yes" } else { "no" };
        let forced = format!("mild,frame=gelsight-mini,cut={answer}").parse().expect("conditions");
        let request = Request { forced, ..Request::wide(Mix::Mixed) };
        let Rendered { labels, frame, .. } = renderer.render(seed, &request).expect("a picture");
        for label in labels {
            let [x0, y0, x1, y1] = label.pixel_box;
            let free = x0.min(y0).min(320.0 - x1).min(240.0 - y1) * frame.mm_per_pixel;
            assert_eq!((label.whole, label.visible < 1.0), (!cut, cut), "seed {seed}: {label:?}");
            assert!(if cut { free < 0.5 } else { free > 0.0 }, "seed {seed}, {free}: {label:?}");
        }
    }
}

/// Most of what a press changes in the picture is at a hook's barb, which is deepest: it lies from the
/// box's middle towards the hook's yaw.
#[test]
fn a_hook_s_yaw_leads_to_where_the_picture_changes_most() {
    let mut renderer = Renderer::new();
    for seed in 0..6 {
        let flat = renderer.press(seed, 0, 1, &Request::plain(Mix::A)).picture;
        let Rendered { picture, labels, .. } =
            renderer.press(seed, 200, 2, &Request::plain(Mix::A));
        let [label] = labels.as_slice() else { panic!("seed {seed}: {labels:?}") };
        let [x0, y0, x1, y1] = label.pixel_box;
        let middle = [(x0 + x1) / 2.0, (y0 + y1) / 2.0];
        // The light has drifted in between.
        let light = |picture: &image::RgbImage| -> f64 {
            picture.pixels().map(|p| f64::from(p.0[1])).sum()
        };
        let drift = light(&picture) / light(&flat);
        let (mut changed, mut way) = (0.0, [0.0; 2]);
        for (x, y, pixel) in picture.enumerate_pixels() {
            let change = f64::from(pixel.0[1]) - drift * f64::from(flat.get_pixel(x, y).0[1]);
            let at = [f64::from(x) + 0.5 - middle[0], f64::from(y) + 0.5 - middle[1]];
            // Above the noise, and no further than the box's corners. Pixels count alike: how much an
            // edge changes says where the light comes from.
            if change.abs() > 8.0 && at[0].hypot(at[1]) < (x1 - x0).hypot(y1 - y0) / 2.0 {
                changed += 1.0;
                way = [0, 1].map(|axis| way[axis] + at[axis]);
            }
        }
        let (sin, cos) = label.yaw_deg.expect("a hook has one").to_radians().sin_cos();
        let along = (way[0] * cos + way[1] * sin) / changed * MM_PER_PX;
        assert!(along > 0.2, "seed {seed}: {along} mm along {:?}", label.yaw_deg);
    }
}

#[test]
fn bare_gel_shows_no_part() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("set");
    let run = std::process::Command::new(env!("CARGO_BIN_EXE_smr-gpu"))
        .args(["simulate", "--count", "1", "--seed", "1", "--conditions", "wide"])
        .args(["--kind", "bare", "--look-alike", "block", "--out"])
        .arg(&out)
        .output()
        .expect("the program");
    let message = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(2), "{message}");
    assert!(message.contains("--look-alike") && message.contains("--kind bare"), "{message}");
    assert!(!out.exists());
}

#[test]
fn conditions_keep_to_their_ranges() {
    let mut strong = BTreeMap::new();
    let count = 2000;
    for seed in 0..count {
        let rng = &mut Pcg64::seed_from_u64(seed);
        let (frame, c) = Conditions::sample(rng, &Forced::default());
        let field = frame.longer_mm();
        assert!((FIELD_MM[0] * 0.999..=FIELD_MM[1] * 1.001).contains(&field), "{frame:?}");
        assert!(frame.mm_per_pixel <= 1.001 / 6.0, "{frame:?}");
        assert!((0.8..=4.0).contains(&c.strength) && (0.0..=1.0).contains(&c.shadows));
        assert!((0.25..=2.5).contains(&c.exposure) && (0.0..=0.05).contains(&c.mottle));
        assert!(c.markers_mm == 0.0 || (1.0..=4.0).contains(&c.markers_mm));
        assert!(c.jpeg.is_none_or(|q| (40..=95).contains(&q)));
        assert!((-1.0..=1.0).contains(&c.colour) && c.distortion.abs() <= 0.12);
        assert!((2.5..=6.0).contains(&c.gel_mm) && (28.0..=48.0).contains(&c.snr_db));
        let mut tell = |name, is: bool| *strong.entry(name).or_insert(0u64) += u64::from(is);
        tell("paper's frame", frame == Raster::PAPER);
        tell("markers", c.markers_mm > 0.0);
        tell("shadows", c.shadows > 0.0);
        tell("strength", c.strength > 2.0);
        tell("grey", c.colour < 0.0);
        tell("overexposed", c.exposure > 1.4);
        tell("housing", c.housing);
    }
    for (name, found) in strong {
        // Each is neither rare nor the rule.
        assert!((count / 15..count * 2 / 3).contains(&found), "{name}: {found} of {count}");
    }
}

#[test]
fn wide_scenes_are_balanced() {
    let region = [-16.0, -12.0, 16.0, 12.0];
    let count = 1500;
    let (mut without, mut walls, mut sides, mut few, mut faint, mut narrow) = (0, 0, 0, 0, 0, 0);
    let mut kinds = BTreeMap::new();
    let mut areas: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for seed in 0..count {
        let scene = Scene::sample_wide(
            &mut Pcg64::seed_from_u64(seed),
            region,
            Mix::Mixed,
            None,
            (&Forced::default(), &Own::default()),
        );
        without += usize::from(scene.snaps.is_empty());
        for snap in &scene.snaps {
            *kinds.entry(snap.part.kind().name().to_owned()).or_insert(0usize) += 1;
            faint += usize::from(snap.depth_mm < 0.8);
            let [a, b] = snap.part.half_size();
            match &snap.part {
                Snap::Hook(hook) => {
                    walls += usize::from(hook.wall);
                    sides += usize::from(hook.on_side.is_some());
                    if hook.on_side.is_none() {
                        areas.entry("A").or_default().push(4.0 * a * b);
                    }
                }
                Snap::Stud(stud) => {
                    assert!([2, 3, 4, 6].contains(&stud.slots));
                    few += usize::from(stud.slots == 2);
                    narrow += usize::from(stud.hole_mm() < 2.5);
                    areas.entry("B").or_default().push(std::f64::consts::PI * a * b);
                }
                Snap::Own(part) => panic!("{part:?}"),
            }
        }
    }
    let (a, b) = (kinds["A"], kinds["B"]);
    let share = |found: usize, all: usize| found as f64 / all as f64;
    // 4 in 10 of these, and a plain fifth with 8 in 100: a third of all.
    let all = 0.8 * share(without, count as usize) + 0.2 * 0.08;
    assert!((0.30..0.37).contains(&all), "{all} of wide pictures show no snap");
    // About 1200 snaps: five standard errors are 0.07.
    assert!((0.43..0.57).contains(&share(a, a + b)), "{a} of A, {b} of B");
    assert!((0.25..0.45).contains(&share(walls, a)), "{walls} walls of {a}");
    assert!((0.05..0.2).contains(&share(sides, a)), "{sides} on their side of {a}");
    assert!((0.2..0.4).contains(&share(few, b)), "{few} with two slots of {b}");
    assert!((0.3..0.7).contains(&share(narrow, b)), "{narrow} with a small hole of {b}");
    assert!((0.2..0.45).contains(&share(faint, a + b)), "{faint} faint of {}", a + b);
    // Size does not give the class away.
    let mean = |kind: &str| areas[kind].iter().sum::<f64>() / areas[kind].len() as f64;
    assert_close(mean("A"), mean("B"), 0.15, "mean area");
}

#[test]
fn contrasts_are_those_of_real_lights() {
    let mut rng = Pcg64::seed_from_u64(8);
    let mut contrasts: Vec<f64> = (0..1001).map(|_| Shading::sample(&mut rng).contrast()).collect();
    contrasts.sort_by(f64::total_cmp);
    // Single lights of the measured sensors have 0.29 to 0.56; a channel mixes some of them.
    assert_close(contrasts[500], 1.2 * UNIT_CONTRAST, 0.1, "median contrast");
    for colour in [0.0, 0.5, 1.0] {
        let shading = Shading::sample_wide(&mut rng, colour, 0.3);
        assert_close(shading.contrast(), 0.3, 1e-9, "measured");
        let mut lamps = Lamps::sample(&mut rng, 20.0, colour);
        lamps.set_contrast(0.15);
        assert_close(lamps.contrast(), 0.15, 1e-6, "lamps");
    }
}

#[test]
fn a_slope_towards_a_lamp_is_brighter() {
    let mut rng = Pcg64::seed_from_u64(2);
    let mut lamps = Lamps::sample(&mut rng, 20.0, 0.0);
    lamps.lamps.truncate(1);
    lamps.lamps[0].ray = Ray { azimuth: 0.0, elevation: 0.5 };
    let beams = lamps.beams();
    // Light comes from +x. Where the dent deepens along x the surface faces −x.
    let brightness = |gx: f32| beams.lit([0.0; 2], [gx, 0.0], |_| 0.0)[1];
    assert!(brightness(-0.3) > brightness(0.0) && brightness(0.0) > brightness(0.3));
    // In full shadow the ambient light is left.
    assert_close(
        beams.lit([0.0; 2], [0.0; 2], |_| 1.0)[1].into(),
        lamps.ambient[1],
        1e-6,
        "shadow",
    );
}

#[test]
fn conditions_are_forced_by_name() {
    let forced: Forced = "mild,markers=2,exposure=1.5..2.5,wall=no,frame=320x240@0.0634,scale=0.75"
        .parse()
        .expect("conditions");
    for seed in 0..50 {
        let (frame, c) = Conditions::sample(&mut Pcg64::seed_from_u64(seed), &forced);
        assert_eq!((frame.width, frame.height), (320, 240));
        assert_close(frame.mm_per_pixel, 0.0634 / 0.75, 1e-3, "scale");
        assert_eq!(c.markers_mm, 2.0);
        assert!((1.5..2.5).contains(&c.exposure));
        // The rest is mild.
        assert!(c.strength < 1.5 && c.shadows == 0.0 && c.jpeg.is_none() && !c.housing);
    }
    // No scale leads out of the fields that there are: four times the paper's is 10 mm, a quarter 160.
    for (scale, mm) in
        [("scale=4", 10.0), ("scale=0.25", 60.0), ("frame=400x300@0.05,scale=3", 10.0)]
    {
        let forced = format!("mild,{scale}").parse().expect("conditions");
        let (frame, _) = Conditions::sample(&mut Pcg64::seed_from_u64(1), &forced);
        assert_close(frame.longer_mm(), mm, 1e-9, scale);
    }
    // The depth fits the thinnest gel that the other conditions leave, in whatever order they are told.
    for (text, fits) in [
        ("depth=1..2", true),
        ("depth=3,gel=3.75..5", true),
        ("depth=3,gel=3.7..5", false),
        ("depth=3,mild", true),
        ("mild,gel=2.5,depth=0.3..2.1", false),
    ] {
        assert_eq!(text.parse::<Forced>().is_ok(), fits, "{text}");
    }
    for (text, plain) in [
        ("mild", true),
        ("mild,wall=no,side=no,depth=1", true),
        ("mild,wall", false),
        ("mild,side", false),
        ("mild,hole=2", false),
        ("mild,barbs", false),
        ("mild,size=4", false),
        ("wall=no", false),
    ] {
        let forced: Forced = text.parse().expect(text);
        assert_eq!(forced.leaves_parts_plain(), plain, "{text}");
    }
    // What is forced is told as it is asked for.
    assert_eq!(forced.to_string().parse::<Forced>(), Ok(forced));
    let flags: Forced = "shadows,optics=lamps,cut=no,side".parse().expect("conditions");
    assert_eq!(flags.to_string(), "cut=no,optics=lamps,shadows=0.6..1.0,side=yes");
    assert_eq!(Forced::default().to_string(), "");
    for (text, wanted) in [
        ("marker=2", "one of scale"),
        ("markers", "markers=X"),
        ("exposure=9", "exposure=X or exposure=X..Y with 0.05"),
        ("exposure=2..1", "X ≤ Y"),
        ("wall=maybe", "wall=no"),
        // No part goes through the gel.
        ("gel=0.5", "gel=X or gel=X..Y with 2.5"),
        ("depth=2.5", "expected at most 2 mm, 0.8 of a gel that may have 2.5 mm"),
        ("depth=3", "expected at most 2 mm"),
        ("frame=100x100@1", "frame=paper"),
        ("frame=mini", "frame=paper"),
        ("optics=sun", "optics=measured"),
    ] {
        let error = text.parse::<Forced>().expect_err(text).to_string();
        assert!(error.contains(text) && error.contains(wanted), "{error}");
    }
}

/// Of a stud and of a hook on its back alone: their outlines are known.
fn drawn(seed: u64, mix: Mix, forced: &str) -> Scene {
    let forced: Forced = forced.parse().expect(forced);
    let region = [-20.0, -20.0, 20.0, 20.0];
    let rng = &mut Pcg64::seed_from_u64(seed);
    Scene::sample_wide(rng, region, mix, None, (&forced, &Own::default()))
}

/// Points about a part's outline at its origin's height or higher, on the gel.
fn outline_of(snap: &Placed<Snap>) -> Vec<[f64; 2]> {
    let [a, b] = snap.part.half_size();
    let round = matches!(snap.part, Snap::Stud(_));
    let at = |i: usize| {
        let (sin, cos) = (i as f64 * std::f64::consts::TAU / 400.0).sin_cos();
        let [u, v] =
            if round { [cos, sin] } else { [cos, sin].map(|c| c / cos.abs().max(sin.abs())) };
        snap.pose().gel([a * u, b * v]).into()
    };
    (0..400).map(at).collect()
}

#[test]
fn snaps_in_company_stand_as_far_apart_as_asked() {
    let (mut pairs, mut near) = (0, 0);
    for seed in 0..30 {
        let scene = drawn(seed, Mix::Mixed, "gap=0.3..0.9,wall=no");
        let outlines: Vec<_> = scene.snaps.iter().map(outline_of).collect();
        let distance = |a: &[[f64; 2]], b: &[[f64; 2]]| {
            let all = a.iter().flat_map(|p| b.iter().map(|q| (p[0] - q[0]).hypot(p[1] - q[1])));
            all.fold(f64::INFINITY, f64::min)
        };
        for (i, one) in outlines.iter().enumerate() {
            for other in &outlines[..i] {
                let gap = distance(one, other);
                assert!(gap > 0.29, "seed {seed}: {gap}");
                pairs += 1;
                // Points on an outline of up to 24 mm lie at most 0.06 mm apart.
                near += usize::from(gap < 0.97);
            }
        }
    }
    // Each but the first of a picture stands beside a part before it, one in five beside no snap.
    assert!(pairs > 40 && near > 25, "{near} of {pairs} pairs");
}

#[test]
fn snaps_have_the_size_that_is_asked_for() {
    for seed in 0..20 {
        for snap in drawn(seed, Mix::Mixed, "size=3.5..5,side=no").snaps {
            let [a, b] = snap.part.half_size();
            assert!((3.5..=5.0).contains(&(2.0 * a.max(b))), "{snap:?}");
        }
    }
}

/// Some arm stays behind each barb, and no barb is narrower than its arm.
#[test]
fn varied_barbs_leave_an_arm() {
    let mut flared = 0;
    for seed in 0..60 {
        for snap in drawn(seed, Mix::A, "barbs,side=no,wall=no").snaps {
            let Snap::Hook(hook) = &snap.part else { panic!("{snap:?}") };
            let half = hook.length / 2.0;
            // On the arm behind the middle it is an undercut lower than the barb.
            let arm = snap.part.height(-0.6 * half, 0.0);
            assert!((arm + hook.undercut).abs() < 0.05, "{hook:?}: {arm}");
            flared += usize::from(hook.flare > 1.05);
        }
    }
    assert!(flared > 10, "{flared}");
}

/// A picture and what is forced of its label.
fn forced_picture(forced: &str) -> Rendered {
    let forced: Forced = forced.parse().expect(forced);
    Renderer::new().render(5, &Request { forced, ..Request::wide(Mix::B) }).expect("a picture")
}

/// Within the labelled box the mean brightness falls by a good part of what deep gel lacks; outside of it the
/// gel is as bright as before.
#[test]
fn gel_over_a_dark_coating_is_dark_where_it_is_deep() {
    let same = "mild,optics=lamps,strength=0.1,colour=0,gap=5..6,depth=1.4";
    let (bright, dark) = (forced_picture(same), forced_picture(&format!("{same},darkness=0.8")));
    assert_eq!((bright.conditions.darkness, dark.conditions.darkness), (0.0, 0.8));
    assert_eq!(bright.labels, dark.labels);
    let mean = |rendered: &Rendered, [x0, y0, x1, y1]: [f64; 4]| {
        let part = rendered.picture.enumerate_pixels().filter(|(x, y, _)| {
            (x0..x1).contains(&f64::from(*x)) && (y0..y1).contains(&f64::from(*y))
        });
        let levels: Vec<f64> = part.map(|(_, _, pixel)| f64::from(pixel[1])).collect();
        levels.iter().sum::<f64>() / levels.len() as f64
    };
    let pressed = bright.labels[0].pixel_box;
    let ratio = mean(&dark, pressed) / mean(&bright, pressed);
    assert!((0.2..0.9).contains(&ratio), "{ratio}");
}

#[test]
fn light_comes_from_the_side_that_is_asked_for() {
    for degrees in [-170.0, -60.0, 10.0, 100.0] {
        let rendered = forced_picture(&format!("light={degrees}"));
        let found = rendered.conditions.light_deg.expect("light from one side");
        let off = (found - degrees + 180.0).rem_euclid(360.0) - 180.0;
        // Each of its lamps stands within 0.3 radians of it.
        assert!(off.abs() <= 17.2, "{degrees}: {found}");
        assert_eq!(rendered.conditions.optics, Optics::Lamps);
    }
}

/// Boxes in an ASCII STL, each from its least to its greatest corner.
fn stl_of_boxes(boxes: &[[[f64; 3]; 2]]) -> String {
    let mut text = String::from("solid part\n");
    for [low, high] in boxes {
        let corner = |at: usize| -> [f64; 3] {
            std::array::from_fn(|axis| if at >> axis & 1 == 1 { high[axis] } else { low[axis] })
        };
        // Two triangles a side, counter-clockwise from outside; corners by bits x, y, z.
        for [a, b, c, d] in
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
        {
            for triangle in [[a, b, c], [a, c, d]] {
                text += "facet normal 0 0 0\nouter loop\n";
                for [x, y, z] in triangle.map(corner) {
                    text += &format!("vertex {x} {y} {z}\n");
                }
                text += "endloop\nendfacet\n";
            }
        }
    }
    text + "endsolid part\n"
}

/// A bar of 8 × 2 mm with two teeth of 2 mm on one side, at its end and in its middle, half as high: nothing
/// turns it into its mirror image.
fn comb() -> String {
    stl_of_boxes(&[
        [[0.0, 0.0, 0.0], [8.0, 2.0, 2.0]],
        [[6.0, 1.0, 0.0], [8.0, 4.0, 1.6]],
        [[2.0, 1.0, 0.0], [4.0, 4.0, 1.6]],
    ])
}

fn simulate_parts(folder: &std::path::Path, more: &[&str]) -> program::Ran {
    let mut command = program::command(folder);
    command.args(["simulate", "--seed", "5", "--out", "set"]).args(more);
    command.output().expect("the program").into()
}

#[test]
fn a_part_of_ones_own_is_a_class() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str| folder.path().join(name);
    std::fs::write(file("comb.stl"), comb()).expect("written");
    let cube = stl_of_boxes(&[[[0.0; 3], [5.0, 5.0, 3.0]]]);
    std::fs::write(file("cube.stl"), &cube).expect("written");
    let asked =
        ["--part", "comb=comb.stl", "--part", "cube=cube.stl", "--part", "A", "--count", "16"];
    let run = simulate_parts(folder.path(), &asked);
    let said = run.expect(0).stderr;
    assert!(said.contains("comb: 8.00 x 4.00 mm; it has a direction"), "{said}");
    assert!(
        said.contains("cube: 5.00 x 5.00 mm; it looks the same after a quarter of a turn"),
        "{said}"
    );
    // A cube is the plain block of its outline, and its own mirror image.
    assert!(said.contains("cube-block looks like the part, and is left out"), "{said}");
    assert!(said.contains("cube-mirror looks like the part"), "{said}");
    assert!(!said.contains("comb-mirror"), "{said}");
    let text = std::fs::read_to_string(file("set/annotations.json")).expect("annotations");
    let coco: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let names: Vec<_> =
        (0..3).map(|i| coco["categories"][i]["name"].as_str().expect("a name")).collect();
    assert_eq!(names, ["comb", "cube", "A"]);
    let mut seen = BTreeMap::new();
    for snap in coco["annotations"].as_array().expect("a list") {
        let (kind, id) = (snap["kind"].as_str().expect("a name"), snap["category_id"].as_u64());
        assert_eq!(id, names.iter().position(|name| *name == kind).map(|at| at as u64 + 1));
        assert_eq!(snap["yaw_deg"].is_null(), kind == "cube", "{snap}");
        // No box is larger than the part's diagonal, with the cells at its edge and parallax.
        let most =
            [("comb", 8.95), ("cube", 7.08), ("A", 11.2)].map(|(n, mm)| (n, mm / 0.04 * 1.06));
        let side = [2, 3].map(|at| snap["bbox"][at].as_f64().expect("a number"));
        let side = side[0].max(side[1]);
        assert!(most.iter().any(|(name, px)| *name == kind && side <= *px), "{snap}");
        *seen.entry(kind).or_insert(0) += 1;
    }
    assert_eq!(seen.len(), 3, "{seen:?}");
    // Another part under the same name is another data set.
    std::fs::write(file("comb.stl"), &cube).expect("written");
    let run = simulate_parts(folder.path(), &asked);
    run.expect(2);
}

#[test]
fn a_part_s_negatives_can_be_had_alone() {
    let comb = Mesh::decode(comb().as_bytes(), mesh::Format::Stl, Unit::Mm).expect("a mesh");
    let (comb, _) = Relief::of_mesh(&comb, View::default()).expect("a part");
    let part = OwnPart::new("comb".to_owned(), comb);
    let negatives = vec![Negative::of("comb-mirror".to_owned(), part.relief.mirrored())];
    let own = Own { classes: vec![Kind::Own(part)], negatives, negatives_alone: true };
    let drawn = |own: &Own, seed: u64| {
        let rng = &mut Pcg64::seed_from_u64(seed);
        let wide = (&Forced::default(), own);
        let wide = Scene::sample_wide(rng, [-20.0, -20.0, 20.0, 20.0], Mix::None, None, wide);
        [Scene::sample(seed, Mix::None, own), wide]
    };
    let is_own = |placed: &Placed<Distractor>| matches!(placed.part, Distractor::Relief(_));
    for seed in 0..40 {
        for scene in drawn(&own, seed) {
            // Walls stand beside some, as beside a hook's arm.
            let is_wall = |placed: &Placed<Distractor>| {
                matches!(placed.part, Distractor::Arm { .. } | Distractor::Edge { .. })
            };
            assert!(scene.snaps.is_empty() && scene.distractors.iter().any(is_own), "{seed}");
            assert!(scene.distractors.iter().all(|p| is_own(p) || is_wall(p)), "{seed}");
        }
    }
    // Else they are half of what is no snap.
    let own = Own { negatives_alone: false, ..own };
    let all: Vec<_> =
        (0..200).flat_map(|seed| drawn(&own, seed)).flat_map(|s| s.distractors).collect();
    let share = all.iter().filter(|placed| is_own(placed)).count() as f64 / all.len() as f64;
    // A standard deviation of 500 draws is 0.02; walls beside arms are no draws.
    assert!((0.35..0.6).contains(&share), "{share} of {}", all.len());
}

#[test]
fn the_papers_sets_stay_as_they_are() {
    use sha2::{Digest, Sha256};

    let folder = program::folder();
    let paper = ["simulate", "--paper", "--out", "paper", "--count", "1"];
    program::run(folder.path(), &paper).expect(0);
    let digest = |set: &str| {
        let file = folder.path().join("paper").join(set).join("images/000000.png");
        let pixels = image::open(file).expect("a picture").into_rgb8().into_raw();
        let digest = Sha256::digest(pixels);
        digest.iter().take(8).map(|byte| format!("{byte:02x}")).collect::<String>()
    };
    assert_eq!(["a", "b"].map(digest), ["3bf7887115e19834", "7a76edcca7576bc7"]);
    // Nothing about them can be chosen but how many.
    let chosen = [&paper[..], &["--seed", "1"]].concat();
    program::run(folder.path(), &chosen).expect(2).tells("cannot be used with '--seed <S>'");
}

/// `simulate --preview` of parts in this folder.
fn preview(folder: &std::path::Path, args: &[&str]) -> program::Ran {
    program::command(folder).args(["simulate"]).args(args).output().expect("the program").into()
}

/// Parts that lie differently in their files are of one data set.
#[test]
fn a_part_s_settings_go_before_the_options() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str| folder.path().join(name);
    let write = |name: &str, text: &str| std::fs::write(file(name), text).expect("written");
    std::fs::create_dir(file("cad")).expect("a folder");
    // 8 × 4 × 2 mm, in inches for one of the two.
    let block = |scale: f64| stl_of_boxes(&[[[0.0; 3], [8.0, 4.0, 2.0].map(|mm| mm / scale)]]);
    write("cad/block.stl", &block(1.0));
    write("inches.stl", &block(25.4));
    write("cad/side.json", r#"{"file": "block.stl", "axis": "x", "up": "y"}"#);
    write("inches.json", r#"{"file": "inches.stl", "unit": "inch"}"#);
    let parts = [
        "--part",
        "side=cad/side.json",
        "--part",
        "inches=inches.json",
        "--part",
        "top=cad/block.stl",
    ];
    let run =
        simulate_parts(folder.path(), &[&parts[..], &["--axis", "y", "--count", "1"]].concat());
    // From y what points up is z, against which x runs to the left or right; from x it is y here.
    let run = run.expect(0).tells("side: 2.00 x 4.00 mm").tells("inches: 8.00 x 2.00 mm");
    run.tells("top: 8.00 x 2.00 mm");

    let told = |text: &str, words: &[&str]| {
        write("part.json", text);
        let run = simulate_parts(folder.path(), &["--part", "part=part.json", "--count", "1"]);
        words.iter().fold(run.expect(1).tells("part.json: "), |run, words| run.tells(words));
    };
    told(r#"{"axis": "x"}"#, &["missing field `file`"]);
    told(r#"{"file": "gone.stl"}"#, &["file: expected a CAD file", "gone.stl"]);
    told(r#"{"file": "part.json"}"#, &["file: expected a CAD file", "got settings"]);
    told(
        r#"{"file": "inches.stl", "axes": "x"}"#,
        &["axes: unknown field `axes`, expected one of `file`"],
    );
    told(
        r#"{"file": "inches.stl", "axis": "w"}"#,
        &["axis: unknown variant `w`, expected one of `x`"],
    );
    told(r#"{"file": "inches.stl", "unit": "cm"}"#, &["unit: unknown variant `cm`", "`inch`"]);
    told(
        r#"{"file": "inches.stl", "map_pixel": "a"}"#,
        &["map_pixel: invalid type: string", "expected f64"],
    );
    told(r#"{"file": "inches.stl", "axis": "z", "up": "-z"}"#, &["inches.stl", "across z, got -z"]);
    told(r#"{"file": "inches.stl"} x"#, &["trailing characters"]);
    told(&format!(r#"{{"file": "inches.stl"{}}}"#, " ".repeat(1 << 16)), &["65536"]);
    let map = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(40, 40, image::Luma([9u16]));
    map.save(file("map.png")).expect("saved");
    let scaled = |pixel| format!(r#"{{"file": "map.png", "map_pixel": {pixel}, "map_height": 2}}"#);
    told(&scaled("0"), &["map.png: map_pixel: expected more than 0 and at most 1, got 0"]);
    write("map.json", &scaled("0.1"));
    std::fs::remove_dir_all(file("set")).expect("the other parts' pictures");
    let run = simulate_parts(folder.path(), &["--part", "map=map.json", "--count", "1"]);
    run.expect(0).tells("map: 4.00 x 4.00 mm");
}

/// A closed body of columns of quadrangles, whose file shows it as the simulator's axes have it: y is turned round.
fn solid(columns: usize, rows: usize, at: impl Fn(usize, usize) -> [f64; 3], floor: f64) -> Mesh {
    let top = |i, j| at(i, j).map(|v| v as f32);
    let bottom = |i, j| [top(i, j)[0], top(i, j)[1], floor as f32];
    let mut triangles = Vec::new();
    let mut quad = |[a, b, c, d]: [[f32; 3]; 4]| triangles.extend([[a, b, c], [a, c, d]]);
    for (i, j) in (0..columns).flat_map(|i| (0..rows).map(move |j| (i, j))) {
        quad([top(i, j), top(i + 1, j), top(i + 1, j + 1), top(i, j + 1)]);
        quad([bottom(i, j), bottom(i, j + 1), bottom(i + 1, j + 1), bottom(i + 1, j)]);
    }
    for i in 0..columns {
        quad([bottom(i, 0), bottom(i + 1, 0), top(i + 1, 0), top(i, 0)]);
        quad([bottom(i + 1, rows), bottom(i, rows), top(i, rows), top(i + 1, rows)]);
    }
    for j in 0..rows {
        quad([bottom(0, j + 1), bottom(0, j), top(0, j), top(0, j + 1)]);
        quad([bottom(columns, j), bottom(columns, j + 1), top(columns, j + 1), top(columns, j)]);
    }
    Mesh::new(triangles, Unit::Mm).expect("a mesh")
}

/// A and B, sampled to triangles and read as a part of one's own, make the pictures that their generators make.
///
/// The ways differ at edges alone: between cells of 0.01 mm a wall of slope 5 is off by up to 0.05 mm of height, and a
/// contact's cell, two pixels, sees the wall at one place. What is pressed there spreads over the cells beside it.
#[test]
fn built_in_snaps_are_the_same_as_meshes() {
    let mut renderer = Renderer::new();
    for (kind, seed) in [(Kind::A, 1), (Kind::A, 2), (Kind::B, 3), (Kind::B, 4)] {
        let snap = Snap::sample(&mut Pcg64::seed_from_u64(seed), &kind);
        // Walls end 3.2 mm below, where no press sees them.
        const LOWEST: f64 = -3.2;
        const STEP: f64 = 0.02;
        let cells = snap.half_size().map(|half| ((half + 0.7) / STEP).ceil() as usize);
        let [columns, rows] = cells.map(|n| 2 * n);
        let place = |i: usize, n: usize| (i as f64 - n as f64) * STEP;
        let at = |i: usize, j: usize| {
            let (x, y) = (place(i, cells[0]), place(j, cells[1]));
            [x, y, snap.height(x, -y).max(LOWEST)]
        };
        let top = (0..=columns).flat_map(|i| (0..=rows).map(move |j| (i, j)));
        let top = top.map(|(i, j)| at(i, j)[2]).fold(LOWEST, f64::max);
        let mesh = solid(columns, rows, at, LOWEST - 1.0);
        let (relief, remarks) = Relief::of_mesh(&mesh, View::default()).expect("a part");
        assert_eq!(remarks, []);
        let own = Snap::Own(OwnPart::new(kind.name().to_owned(), relief));
        let (yaw, tilt, center_mm) = (0.6, [0.02, -0.01], [1.3, -2.1]);
        let pictures = [(snap.clone(), 0.9), (own, 0.9 + top)].map(|(part, depth_mm)| {
            let snaps = vec![Placed { part, center_mm, yaw, tilt, depth_mm }];
            let scene = Scene { snaps, distractors: Vec::new() };
            let Rendered { picture, labels, .. } = renderer.scene(&scene, seed).expect("it shows");
            (picture, labels[0].pixel_box)
        });
        // A cell at a box's side is in it or not.
        let boxes = pictures.each_ref().map(|(_, found)| *found);
        let off = boxes[0].iter().zip(boxes[1]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off <= 2.5, "{boxes:?}");
        let placed = Placed { part: snap, center_mm, yaw, tilt, depth_mm: 0.9 };
        // Whether within some pixels of this one the part is steep where it presses.
        let is_edge = |x: u32, y: u32, radius_px: u32| {
            let [x, y] = [x, y].map(|at| (f64::from(at) + 0.5 - 500.0) * MM_PER_PX);
            (0..32 * (radius_px + 1)).any(|i| {
                let (sin, cos) = (f64::from(i % 32) / 32.0 * TAU).sin_cos();
                let r = f64::from(i / 32) * MM_PER_PX;
                let [u, v] = placed.local(x + r * cos, y + r * sin);
                let height = |du: f64, dv: f64| placed.part.height(u + du, v + dv);
                let right = height(0.02, 0.0) - height(-0.02, 0.0);
                let down = height(0.0, 0.02) - height(0.0, -0.02);
                let depth = placed.depth_mm + height(0.0, 0.0) + tilt[0] * u + tilt[1] * v;
                right.hypot(down) > 0.04 && depth > -0.1
            })
        };
        let [(mine, _), (meshed, _)] = &pictures;
        let (mut over, mut worst, mut near) = (0, 0, [0; 7]);
        for (x, y, pixel) in mine.enumerate_pixels() {
            let other = meshed.get_pixel(x, y).0;
            let most = pixel.0.iter().zip(other).map(|(a, b)| a.abs_diff(b)).max().expect("three");
            if most > 1 {
                over += 1;
                worst = worst.max(most);
                let first = [0, 2, 4, 6, 8, 12].iter().position(|r| is_edge(x, y, *r));
                near[first.unwrap_or(6)] += 1;
            }
        }
        let said = format!(
            "{} {seed}: {over} of a million pixels differ by more than 1 level, at most by {worst}; of them {near:?} \
             first within 0, 2, 4, 6, 8, 12 pixels of an edge, and further",
            kind.name()
        );
        // Of an outline of 500 to 800 pixels less than each fourth, and not three cells from it.
        assert!(over < 125 && near[4..].iter().all(|n| *n == 0), "{said}");
    }
}

/// A body of this outline, counter-clockwise and convex, from 0 to 3 mm.
fn prism(outline: &[[f64; 2]]) -> Vec<mesh::Triangle> {
    let at = |i: usize, z: f32| {
        let [x, y] = outline[i % outline.len()];
        [x as f32, y as f32, z]
    };
    let sides = (0..outline.len()).flat_map(|i| {
        let [a, b, c, d] = [at(i, 0.0), at(i + 1, 0.0), at(i + 1, 3.0), at(i, 3.0)];
        [[a, b, c], [a, c, d]]
    });
    let ends = (1..outline.len() - 1).flat_map(|i| {
        [[at(0, 3.0), at(i, 3.0), at(i + 1, 3.0)], [at(0, 0.0), at(i + 1, 0.0), at(i, 0.0)]]
    });
    sides.chain(ends).collect()
}

/// However a part lies in its file, and on however many threads it is looked at.
#[test]
fn symmetry_does_not_depend_on_how_a_part_lies() {
    let folder = tempfile::tempdir().expect("a folder");
    parts::write_both(folder.path()).expect("written");
    let read = |name: &str| {
        Mesh::read(&folder.path().join(name), Unit::Mm).expect("a mesh").triangles().to_vec()
    };
    let rectangle = |x: f64, y: f64| prism(&[[-x, -y], [x, -y], [x, y], [-x, y]]);
    let round: Vec<_> = (0..180).map(|i| f64::from(i) / 180.0 * TAU).collect();
    let round: Vec<_> = round.iter().map(|angle| [2.5 * angle.cos(), 2.5 * angle.sin()]).collect();
    let bodies = [
        ("clip", read("clip.stl"), Symmetry::None),
        ("pin", read("pin.stl"), Symmetry::None),
        ("cube", rectangle(2.5, 2.5), Symmetry::Quarter),
        ("cylinder", prism(&round), Symmetry::Round),
        ("bar", rectangle(4.0, 1.0), Symmetry::Half),
    ];
    let turned = |triangles: &[mesh::Triangle], degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let turn = |[x, y, z]: [f32; 3]| {
            let (x, y) = (f64::from(x), f64::from(y));
            [(cos * x - sin * y) as f32, (sin * x + cos * y) as f32, z]
        };
        let triangles = triangles.iter().map(|corners| corners.map(turn)).collect();
        let mesh = Mesh::new(triangles, Unit::Mm).expect("a mesh");
        Relief::of_mesh(&mesh, View::default()).expect("a part").0
    };
    let bodies = &bodies;
    std::thread::scope(|scope| {
        for degrees in [0.0, 0.0, 7.3, 33.1, 61.7, 118.9, 200.3] {
            scope.spawn(move || {
                for (name, triangles, expected) in bodies {
                    let part = OwnPart::new((*name).to_owned(), turned(triangles, degrees));
                    assert_eq!(part.symmetry, *expected, "{name} turned by {degrees}°");
                    let yaw = part.direction(30.0);
                    assert_eq!(yaw, (*expected == Symmetry::None).then_some(30.0));
                }
            });
        }
    });
    // A press of 0.3 mm sees the pin's head alone.
    let pin = turned(&bodies[1].1, 0.0);
    assert_eq!([0.3, 0.5].map(|depth| pin.symmetry(depth)), [Symmetry::Half, Symmetry::None]);
}

#[test]
fn a_preview_shows_a_part_its_heights_and_presses() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str| folder.path().join(name);
    std::fs::write(file("comb.stl"), comb()).expect("written");
    let cube = stl_of_boxes(&[[[0.0; 3], [5.0, 5.0, 3.0]]]);
    std::fs::write(file("cube.stl"), &cube).expect("written");
    let parts = ["--part", "comb=comb.stl", "--part", "cube=cube.stl"];
    let sheet = |name: &str, more: &[&str]| {
        preview(folder.path(), &[&parts[..], &["--preview", name], more].concat()).expect(0);
        image::open(file(name)).expect("a picture").to_rgb8()
    };
    let drawn = sheet("sheet.png", &[]);
    assert!(!file("set").exists());
    // A heading, two rows of four pictures of 320 px with a line below each and the heights' scale, per part.
    assert_eq!(drawn.dimensions(), (1420, 10 + 2 * 744));
    let at = |x: u32, y: u32| drawn.get_pixel(x, y).0;
    // The comb's picture begins at 10, 40, and its heights' at 10, 392; the comb is 8 × 4 mm, and 1 mm of gel is
    // left round its diagonal. Its bar is the highest, its teeth 0.4 mm lower: yellow and violet.
    let mm = 320.0 / (80f64.sqrt() + 2.0);
    let place = |top: u32, [x, y]: [f64; 2]| {
        at((170.0 + x * mm) as u32, (f64::from(top) + 160.0 + y * mm) as u32)
    };
    let (bar, tooth, beside) = ([0.0, 1.0], [3.0, -1.0], [1.0, -1.5]);
    assert_eq!(place(392, bar), [254, 232, 37]);
    assert_eq!(place(392, tooth), [68, 1, 84]);
    assert_eq!([40, 392].map(|top| place(top, beside)), [[240; 3]; 2]);
    assert!(place(40, [2.0, 1.0])[0] > 150, "a flat top is lit");
    // The comb's 0° is an arrow along x, through the middle; a cube has none.
    assert_eq!(place(40, [0.0, 0.0]), [230, 159, 0]);
    assert_eq!(place(784, [0.0, 0.0]), [190; 3]);
    // Every press shows a box in its class's colour.
    for (part, colour) in [[230, 159, 0], [86, 180, 233]].into_iter().enumerate() {
        for press in 0..6 {
            let (x, y) = (430 + 330 * (press % 3), 40 + 744 * part as u32 + 352 * (press / 3));
            let pixels = (0..320 * 320).filter(|i| at(x + i % 320, y + i / 320) == colour);
            assert!(pixels.count() > 200, "press {press} of part {part}");
        }
    }
    assert_eq!(sheet("same.png", &["--seed", "0"]), drawn);
    assert_ne!(sheet("other.png", &["--seed", "1"]), drawn);

    let told =
        |args: &[&str], code, words: &str| preview(folder.path(), args).expect(code).tells(words);
    told(&["--preview", "none.png"], 2, "--part");
    told(&[&parts[..], &["--preview", "x.png", "--out", "set"]].concat(), 2, "cannot be used with");
    told(&[&parts[..], &["--seed", "1"]].concat(), 2, "--out");
    told(&[&parts[..], &["--preview", "./comb.stl"]].concat(), 2, "comb.stl");
    assert_eq!(std::fs::read_to_string(file("comb.stl")).expect("kept"), comb());
}

/// A part that is larger than the gel is pressed all the same, and cut by the picture.
#[test]
fn a_part_larger_than_the_gel_is_drawn() {
    let folder = tempfile::tempdir().expect("a folder");
    let slab =
        stl_of_boxes(&[[[0.0; 3], [45.0, 30.0, 3.0]], [[10.0, 5.0, 2.0], [20.0, 10.0, 4.0]]]);
    std::fs::write(folder.path().join("slab.stl"), slab).expect("written");
    simulate_parts(folder.path(), &["--part", "slab=slab.stl", "--count", "3"]).expect(0);
}

#[test]
fn parts_that_cannot_be_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("comb.stl"), comb()).expect("written");
    std::fs::write(folder.path().join("text.stl"), "a letter to somebody").expect("written");
    std::fs::write(folder.path().join("none.stl"), "solid a\nendsolid a\n").expect("written");
    let metres = stl_of_boxes(&[[[0.0; 3], [0.008, 0.004, 0.002]]]);
    std::fs::write(folder.path().join("metres.stl"), metres).expect("written");
    for (args, code, words) in [
        (&["--part", "comb"][..], 2, "expected NAME=FILE, A or B"),
        (&["--part", "=comb.stl"], 2, "expected a name before `=`"),
        (&["--part", "comb=comb.stl", "--part", "Comb=comb.stl"], 2, "got `Comb` twice"),
        (&["--part", "comb=comb.stl", "--kind", "a"], 2, "--kind a and b are for A and B"),
        (&["--part", "comb=comb.stl", "--axis", "w"], 2, "expected x, y, z, -x, -y or -z"),
        (&["--negative", "comb.stl"], 2, "--part"),
        (&["--part", "gone=gone.stl"], 1, "gone.stl"),
        (&["--part", "text=text.stl"], 1, "text.stl: "),
        (&["--part", "none=none.stl"], 1, "expected triangles, got none"),
        (&["--part", "metres=metres.stl"], 1, "m would fit"),
        (&["--part", "comb=comb.txt"], 1, "ends in .stl or .obj"),
        (&["--part", "map=map.png"], 2, "expected --map-pixel and --map-height"),
        (&["--part", "comb=comb.stl", "--look-alike", "comp-cut"], 2, "comb-cut"),
    ] {
        let run = simulate_parts(folder.path(), &[args, &["--count", "1"][..]].concat());
        assert_eq!(run.code, Some(code), "{args:?}: {}", run.stderr);
        assert!(run.stderr.contains(words), "{args:?}: {}", run.stderr);
        assert!(!folder.path().join("set").exists(), "{args:?}");
    }
    // In metres it is a part.
    let run =
        simulate_parts(folder.path(), &["--part", "m=metres.stl", "--unit", "m", "--count", "1"]);
    run.expect(0);
}
