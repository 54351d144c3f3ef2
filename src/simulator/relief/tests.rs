//! Reliefs of bodies whose heights are known, and what is said of files that are none.

use std::f64::consts::{PI, TAU};

use super::super::mesh::{Format, Triangle};
use super::super::outline::WALL_SLOPE;
use super::*;

/// Deepest press that is asked for.
const DEPTH: f64 = 2.0;

/// A strip of quadrangles: rows of points, each row closed or not.
fn sheet(rows: &[Vec<DVec3>], is_closed: bool) -> Vec<Triangle> {
    let corner = |p: DVec3| p.to_array().map(|v| v as f32);
    let mut triangles = Vec::new();
    for pair in rows.windows(2) {
        let n = pair[0].len();
        for i in 0..if is_closed { n } else { n - 1 } {
            let j = (i + 1) % n;
            let [a, b, c, d] = [pair[0][i], pair[0][j], pair[1][j], pair[1][i]].map(corner);
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    triangles
}

/// A closed body of sections that all have as many points and run counter-clockwise about the way from the first
/// to the last; the first and last are closed by fans.
fn loft(sections: &[Vec<DVec3>]) -> Vec<Triangle> {
    let middle = |section: &[DVec3]| section.iter().sum::<DVec3>() / section.len() as f64;
    let (first, last) = (&sections[0], &sections[sections.len() - 1]);
    let mut rows = vec![vec![middle(first); first.len()]];
    rows.extend_from_slice(sections);
    rows.push(vec![middle(last); last.len()]);
    sheet(&rows, true)
}

/// An upright prism: its outline counter-clockwise.
fn prism(outline: &[[f64; 2]], low: f64, high: f64) -> Vec<Triangle> {
    let at = |z: f64| outline.iter().map(|&[x, y]| DVec3::new(x, y, z)).collect();
    loft(&[at(low), at(high)])
}

fn square(half: f64) -> [[f64; 2]; 4] {
    [[-half, -half], [half, -half], [half, half], [-half, half]]
}

fn polygon(sides: u32, radius: f64, phase: f64) -> Vec<[f64; 2]> {
    let angle = |i| phase + f64::from(i) / f64::from(sides) * TAU;
    (0..sides).map(|i| [radius * angle(i).cos(), radius * angle(i).sin()]).collect()
}

fn mesh(triangles: Vec<Triangle>) -> Mesh {
    Mesh::new(triangles, Unit::Mm).expect("a mesh")
}

fn turned(triangles: Vec<Triangle>, turn: glam::DQuat) -> Vec<Triangle> {
    let turned = |p: DVec3| (turn * p).to_array().map(|v| v as f32);
    triangles.iter().map(|t| corners(t).map(turned)).collect()
}

fn seen(triangles: Vec<Triangle>) -> (Relief, Vec<Remark>) {
    Relief::of_mesh(&mesh(triangles), View::default()).expect("a part")
}

/// The relief of a closed body, of which nothing is odd.
fn relief(triangles: Vec<Triangle>) -> Relief {
    let (relief, remarks) = seen(triangles);
    assert_eq!(remarks, []);
    relief
}

/// Compares a relief with a height over x and y of the file, where that is less steep than `slope`: cells at
/// once, and places between them; each within half a cell's run of that slope.
fn compare(name: &str, relief: &Relief, slope: f64, height: impl Fn(f64, f64) -> Option<f64>) {
    let half = relief.spacing_mm() / 2.0;
    let [columns, rows] = relief.cells();
    let top = (0..rows * columns).filter_map(|at| {
        let place = |i: usize, n: usize| (2.0 * i as f64 + 1.0 - n as f64) * half;
        height(place(at % columns, columns), -place(at / columns, rows))
    });
    let top = top.fold(f64::NEG_INFINITY, f64::max);
    let steep = |x: f64, y: f64| {
        let step = 1e-4;
        let [e, w, n, s] = [[step, 0.0], [-step, 0.0], [0.0, step], [0.0, -step]]
            .map(|[dx, dy]| height(x + dx, y + dy));
        Some((e? - w?).hypot(n? - s?) / (2.0 * step))
    };
    let (mut compared, mut worst) = (0, 0f64);
    for at in (0..4 * rows * columns).step_by(31) {
        // Two places a cell along each axis: a centre and an edge.
        let place = |i: usize, n: usize| (i as f64 - n as f64 + 1.0) * half;
        let (x, y) = (place(at % (2 * columns), columns), place(at / (2 * columns), rows));
        let near = [-3.0, 0.0, 3.0].map(|d| d * half);
        let is_smooth = near
            .iter()
            .all(|dx| near.iter().all(|dy| steep(x + dx, y + dy).is_some_and(|s| s <= slope)));
        if let Some(expected) = height(x, y).filter(|_| is_smooth) {
            let got = relief.height(x, -y);
            worst = worst.max((got - (expected - top)).abs());
            compared += 1;
        }
    }
    assert!(compared > rows * columns / 31, "{name}: {compared} places compared");
    assert!(worst <= half * slope.max(1.0), "{name}: {worst} mm off");
}

/// A cube of 5 mm, turned about all axes. From above its height is the least of its faces' planes.
#[test]
fn a_tilted_cube() {
    for turn in
        [glam::DQuat::IDENTITY, glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -0.2, 0.5)]
    {
        let cube = relief(turned(prism(&square(2.5), -2.5, 2.5), turn));
        let normals = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| turn * axis);
        let height = |x: f64, y: f64| {
            let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
            for n in normals {
                // |n · (x, y, z)| ≤ 2.5
                let across = n.x * x + n.y * y;
                if n.z.abs() < 1e-9 {
                    if across.abs() > 2.5 {
                        return None;
                    }
                    continue;
                }
                let [a, b] = [(-2.5 - across) / n.z, (2.5 - across) / n.z];
                (low, high) = (low.max(a.min(b)), high.min(a.max(b)));
            }
            (low <= high).then_some(high)
        };
        compare("cube", &cube, WALL_SLOPE, height);
    }
}

#[test]
fn a_cylinder_lying() {
    let sections: Vec<_> = [-4.0, 4.0]
        .map(|x| polygon(720, 1.5, 0.0).iter().map(|&[y, z]| DVec3::new(x, y, z)).collect())
        .into();
    let cylinder = relief(loft(&sections));
    assert_eq!(cylinder.half_size().map(|v| (v * 100.0).round()), [400.0, 150.0]);
    let height = |x: f64, y: f64| (x.abs() <= 4.0 && y.abs() <= 1.5).then(|| (2.25 - y * y).sqrt());
    compare("cylinder", &cylinder, 3.0, height);
    assert_eq!(cylinder.symmetry(DEPTH), Symmetry::Half);
    assert!(cylinder.looks_like(&cylinder.mirrored(), DEPTH));
}

#[test]
fn a_sphere() {
    let sections: Vec<_> = (1..360)
        .map(|i| {
            let angle = f64::from(i) / 360.0 * PI;
            let ring = polygon(720, 3.0 * angle.sin(), 0.0);
            ring.iter().map(|&[x, y]| DVec3::new(x, y, -3.0 * angle.cos())).collect()
        })
        .collect();
    let sphere = relief(loft(&sections));
    let height = |x: f64, y: f64| (x.hypot(y) < 3.0).then(|| (9.0 - x * x - y * y).sqrt());
    compare("sphere", &sphere, 3.0, height);
    assert_eq!(sphere.symmetry(DEPTH), Symmetry::Round);
}

/// A thread of 2 mm radius and 1 mm pitch, lying: its radius sways with the angle and along x.
#[test]
fn a_thread_lying() {
    let radius = |x: f64, angle: f64| 2.0 + 0.2 * (angle - TAU * x).sin();
    let sections: Vec<_> = (0..=400)
        .map(|i| {
            let x = f64::from(i) / 400.0 * 6.0 - 3.0;
            let angles = (0..720).map(|i| f64::from(i) / 720.0 * TAU);
            angles.map(|a| DVec3::new(x, radius(x, a) * a.cos(), radius(x, a) * a.sin())).collect()
        })
        .collect();
    let thread = relief(loft(&sections));
    let middle = thread.middle_of(&sections);
    // From above the angle at y, by halving.
    let height = |x: f64, y: f64| {
        let y = y + middle.y;
        let (mut low, mut high) = (0.4, PI - 0.4);
        for _ in 0..40 {
            let angle = (low + high) / 2.0;
            let right = radius(x, angle) * angle.cos();
            (low, high) = if right > y { (angle, high) } else { (low, angle) };
        }
        (x.abs() < 3.0 && y.abs() < 1.5).then(|| radius(x, low) * low.sin())
    };
    compare("thread", &thread, 3.0, height);
    // It is no mirror image of itself, but turned end for end it is itself.
    assert_eq!(thread.symmetry(DEPTH), Symmetry::Half);
    assert!(!thread.looks_like(&thread.mirrored(), DEPTH));
}

/// One turn of a spiral stair without steps, seen from its end: 2 mm of rise.
#[test]
fn a_thread_from_its_end() {
    let rise = 2.0;
    let sections: Vec<_> = (0..=720)
        .map(|i| {
            let angle = f64::from(i) / 720.0 * TAU;
            let z = rise * f64::from(i) / 720.0;
            let at = |r: f64, z: f64| DVec3::new(r * angle.cos(), r * angle.sin(), z);
            vec![at(1.0, -1.0), at(1.0, z), at(3.0, z), at(3.0, -1.0)]
        })
        .collect();
    let thread = relief(loft(&sections));
    let height = |x: f64, y: f64| {
        // Where the stair ends over its beginning a wall falls as far as it is high.
        let is_wall = x > 0.0 && (-0.02..rise / WALL_SLOPE + 0.02).contains(&y);
        let is_there = (1.0..=3.0).contains(&x.hypot(y)) && !is_wall;
        is_there.then(|| rise * y.atan2(x).rem_euclid(TAU) / TAU)
    };
    compare("stair", &thread, 1.0, height);
    assert_eq!(thread.symmetry(DEPTH), Symmetry::None);
    assert!(!thread.looks_like(&thread.mirrored(), DEPTH));
    assert!(thread.looks_like(&thread.mirrored().mirrored(), DEPTH));
}

impl Relief {
    /// The middle of what a body's sections span: the relief's origin.
    fn middle_of(&self, sections: &[Vec<DVec3>]) -> DVec3 {
        let all = || sections.iter().flatten().copied();
        let [low, high] = [all().reduce(DVec3::min), all().reduce(DVec3::max)];
        (low.expect("points") + high.expect("points")) / 2.0
    }
}

/// A block of 4 × 2 mm with a step at its lower right, as the file's x and y have it.
fn stepped() -> Vec<Triangle> {
    let block = prism(&[[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]], 0.0, 1.0);
    [block, prism(&[[3.0, 0.25], [3.75, 0.25], [3.75, 0.75], [3.0, 0.75]], 1.5, 2.0)].concat()
}

#[test]
fn pictures_show_the_part_and_not_its_mirror_image() {
    let (relief, remarks) = seen(stepped());
    assert_eq!(remarks, [Remark::Shells { count: 2, seen: 2 }]);
    // y runs down: what is low in the file is at positive y.
    let [up, down, beside] =
        [[1.4, -0.5], [1.4, 0.5], [-1.4, 0.5]].map(|[x, y]| relief.height(x, y));
    assert_eq!([up, down, beside], [-1.0, 0.0, -1.0]);
    // Another direction to the gel, seen from there: the step from its side, z up.
    let view = View { towards: Direction::X, up: None };
    let (side, _) = Relief::of_mesh(&mesh(stepped()), view).expect("a part");
    assert_eq!(side.half_size().map(|v| (v * 100.0).round()), [100.0, 100.0]);
    // Towards x and z up, y points to the right.
    let [block, step, beside] =
        [[0.0, 0.5], [-0.5, -0.75], [0.5, -0.75]].map(|[x, y]| side.height(x, y));
    assert!(
        block.abs() < 1e-6 && (step + 0.25).abs() < 1e-6 && beside < -1.0,
        "{block} {step} {beside}"
    );
    for towards in Direction::ALL {
        assert_eq!(Direction::named(towards.name()), Some(towards));
        for up in Direction::ALL {
            match (View { towards, up: Some(up) }).axes() {
                Ok([x, y, z]) => assert_eq!(x.cross(y), -z, "{towards} {up}"),
                Err(_) => assert_eq!(towards.name().trim_matches('-'), up.name().trim_matches('-')),
            }
        }
        let [.., z] = View { towards, up: None }.axes().expect("a view");
        assert_eq!(z, towards.vector());
    }
    let view: View = serde_json::from_str(r#"{"towards": "-y"}"#).expect("a view");
    assert_eq!(view, View { towards: Direction::NegY, up: None });
}

#[test]
fn walls_and_what_is_beside_the_part() {
    let block = relief(prism(&square(2.5), 0.0, 1.0));
    assert_eq!(
        (block.cells(), block.spacing_mm(), block.half_size()),
        ([500, 500], 0.01, [2.5, 2.5])
    );
    assert_eq!([block.height(0.0, 0.0), block.height(2.49, -2.49)], [0.0, 0.0]);
    // From the last cell's centre on, half a cell within the outline.
    for beside in [0.1, 0.5, 5.0] {
        let height = block.height(0.0, 2.5 + beside);
        assert!((height + WALL_SLOPE * (beside + 0.005)).abs() < 1e-3, "{height}");
    }
    assert_eq!((block.at(0, 0), block.at(500, 0)), (Some(0.0), None));
    let large = relief(prism(&square(30.0), 0.0, 1.0));
    assert_eq!((large.cells(), large.spacing_mm()), ([1200, 1200], 0.05));
}

#[test]
fn turns_that_change_nothing_are_found() {
    let of = |outline: &[[f64; 2]]| relief(prism(outline, 0.0, 3.0)).symmetry(DEPTH);
    let oblong = [[-4.0, -1.5], [4.0, -1.5], [4.0, 1.5], [-4.0, 1.5]];
    let ell = [[-3.0, -3.0], [3.0, -3.0], [3.0, -1.0], [-3.0, 3.0]];
    assert_eq!(of(&ell), Symmetry::None);
    assert_eq!(of(&oblong), Symmetry::Half);
    assert_eq!(of(&square(3.0)), Symmetry::Quarter);
    assert_eq!(of(&polygon(3, 4.0, 0.2)), Symmetry::Other(3));
    assert_eq!(of(&polygon(6, 4.0, 0.2)), Symmetry::Other(6));
    assert_eq!(of(&polygon(48, 4.0, 0.2)), Symmetry::Round);
    // A bottle lying: a light press sees its belly alone, which is the same at both ends.
    let profile = [(-3.0, 1.9), (-1.0, 1.9), (-0.9, 1.0), (3.0, 0.6)];
    let ring = |(x, r): (f64, f64)| {
        polygon(90, r, 0.0).iter().map(|&[y, z]| DVec3::new(x, y, z)).collect::<Vec<_>>()
    };
    let bottle = relief(loft(&profile.map(ring)));
    let turns = [0.3, 0.6, 1.0, 1.5, 2.0].map(|depth| bottle.symmetry(depth));
    assert_eq!(turns[..2], [Symmetry::Half; 2]);
    assert_eq!(turns[2..], [Symmetry::None; 3]);
    assert!(bottle.looks_like(&bottle.mirrored(), DEPTH));
    // Below the deepest press nothing counts.
    let base = prism(&square(3.0), -3.0, -2.5);
    let disc = prism(&polygon(90, 2.0, 0.0), -2.5, 0.0);
    let (pin, _) = seen([base, disc].concat());
    assert_eq!((pin.symmetry(1.0), pin.symmetry(3.0)), (Symmetry::Round, Symmetry::Quarter));
}

#[test]
fn mirror_images_are_known() {
    // An isosceles triangle that lies askew is its own mirror image, turned and moved; a scalene one is not.
    let isosceles: Vec<_> = [[-2.0, -2.0], [2.0, -2.0], [0.0, 4.0]]
        .map(|[x, y]: [f64; 2]| [0.8 * x - 0.6 * y, 0.6 * x + 0.8 * y])
        .into();
    let isosceles = relief(prism(&isosceles, 0.0, 3.0));
    assert!(isosceles.looks_like(&isosceles.mirrored(), DEPTH));
    let scalene = relief(prism(&[[-3.0, -2.0], [3.0, -2.0], [-1.0, 3.0]], 0.0, 3.0));
    assert!(!scalene.looks_like(&scalene.mirrored(), DEPTH));
    assert!(!scalene.looks_like(&relief(prism(&square(2.0), 0.0, 3.0)), DEPTH));
}

#[test]
fn negatives_are_derived() {
    // A cone on a plate far below it.
    let cone = loft(&[[3.0, -2.0], [0.01, 1.0]].map(|[radius, z]: [f64; 2]| {
        polygon(180, radius, 0.0).iter().map(|&[x, y]| DVec3::new(x, y, z)).collect()
    }));
    let (part, _) = seen([cone, prism(&square(4.0), -9.0, -8.0)].concat());
    assert!((part.height(1.5, 0.0) + 1.5).abs() < 0.02, "{}", part.height(1.5, 0.0));
    let cut = part.without_tip(1.0 / 3.0);
    // Of the plate's 8 mm the first two thirds, about whose middle the cone stands at 4 / 3.
    assert!((cut.half_size()[0] - 8.0 / 3.0).abs() < 0.02, "{:?}", cut.half_size());
    assert!(cut.height(4.0 / 3.0, 0.0).abs() < 0.02);
    assert!((cut.height(4.0 / 3.0 - 1.5, 0.0) + 1.5).abs() < 0.02);
    assert!(!cut.looks_like(&part, 1.5));
    let block = part.block(1.5);
    assert!((block.half_size()[0] - 1.5).abs() < 0.03, "{:?}", block.half_size());
    assert_eq!(block.height(1.4, 0.0), 0.0);
    assert!(block.looks_like(&relief(prism(&polygon(180, 1.5, 0.0), 0.0, 3.0)), 1.5));
    // A flat part keeps its looks.
    let flat = relief(prism(&square(2.0), 0.0, 3.0));
    assert!(flat.block(DEPTH).looks_like(&flat, DEPTH));
    assert!(!flat.without_tip(1.0 / 3.0).looks_like(&flat, DEPTH));
    assert_eq!(flat.without_tip(1.0), flat, "something stays");
}

#[test]
fn height_maps_are_read() {
    let part = relief(turned(prism(&square(1.0), 0.0, 3.0), glam::DQuat::from_rotation_y(0.3)));
    let (map, mm_full_scale) = part.to_map();
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("map.png");
    map.save(&path).expect("saved");
    let read = Relief::read_map(&path, part.spacing_mm(), mm_full_scale).expect("a map");
    assert_eq!(read.cells(), part.cells());
    let step = mm_full_scale / 65535.0;
    for [x, y] in [[0.0, 0.0], [0.7, 0.3], [-1.2, -0.9], [3.0, 0.0]] {
        assert!((read.height(x, y) - part.height(x, y)).abs() <= step, "{x} {y}");
    }

    let message = |map: &GreyPicture16, scale, full| {
        Relief::of_map(map, scale, full).expect_err("no part").to_string()
    };
    let black = GreyPicture16::new(20, 20);
    assert_eq!(
        message(&black, 0.1, 2.0),
        "expected a height map that shows a part, got one that is black"
    );
    assert_eq!(
        message(&black, f64::NAN, 2.0),
        "map_pixel: expected more than 0 and at most 1, got NaN"
    );
    assert_eq!(
        message(&black, 0.1, 0.0),
        "map_height: expected more than 0 and at most 100, got 0"
    );
    let small = message(&map, 0.001, 2.0);
    assert!(small.starts_with("expected a part of 1 to 60 mm across the gel, got 0.2"), "{small}");
    let message = message(&GreyPicture16::new(2049, 1), 0.1, 2.0);
    assert_eq!(message, "expected a height map of at most 2048 × 2048 pixels, got 2049 × 1");

    let image = image::DynamicImage::from(map);
    let others = [
        ("8.png", image.to_luma8().into()),
        ("16.png", image::DynamicImage::from(image.to_rgb16())),
    ];
    for (name, other) in others {
        let path = folder.path().join(name);
        other.save(&path).expect("saved");
        let message = Relief::read_map(&path, 0.1, 1.0).expect_err("not grey").to_string();
        assert!(message.starts_with("expected a grey PNG of 16 bits, got "), "{message}");
    }
    let text = folder.path().join("text.png");
    std::fs::write(&text, "solid\nendsolid\n").expect("written");
    assert!(matches!(Relief::read_map(&text, 0.1, 1.0), Err(Error::Picture(_))));
}

#[test]
fn parts_of_another_unit_are_named() {
    let of = |half: f64, unit| {
        let mesh = Mesh::new(prism(&square(half), 0.0, half), unit).expect("a mesh");
        Relief::of_mesh(&mesh, View::default())
    };
    let message = |half, unit| of(half, unit).expect_err("no part").to_string();
    let expected = "expected a part of 1 to 60 mm across the gel, got ";
    for (half, unit, rest) in [
        (0.0045, Unit::Mm, "0.009 × 0.009 mm, lengths taken to be in mm; m would fit"),
        (0.18, Unit::Mm, "0.360 × 0.360 mm, lengths taken to be in mm; inch would fit"),
        (0.025, Unit::Mm, "0.050 × 0.050 mm, lengths taken to be in mm; inch or m would fit"),
        (4.5, Unit::M, "9000.000 × 9000.000 mm, lengths taken to be in m; mm would fit"),
        (4.5, Unit::Inch, "228.600 × 228.600 mm, lengths taken to be in inch; mm would fit"),
        (1e6, Unit::Mm, "2000000.000 × 2000000.000 mm, lengths taken to be in mm"),
    ] {
        assert_eq!(message(half, unit), format!("{expected}{rest}"));
    }
    let (_, remarks) = of(0.6, Unit::Mm).expect("a small part");
    assert_eq!(
        remarks,
        [Remark::Unit { across_mm: 1.2f32.into(), unit: Unit::Mm, fits: vec![Unit::Inch] }]
    );
    assert_eq!(
        remarks[0].to_string(),
        "1.20 mm across, lengths taken to be in mm; inch would fit too"
    );
}

#[test]
fn odd_surfaces_get_a_remark() {
    let block = || prism(&square(2.0), 0.0, 2.0);
    let is_top = |t: &Triangle| t.iter().all(|corner| corner[2] == 2.0);
    let without = |which: &dyn Fn(&Triangle) -> bool| {
        let mut triangles = mesh(block()).triangles().to_vec();
        let first = triangles.iter().position(which).expect("one");
        triangles.remove(first);
        seen(triangles).1
    };
    assert_eq!(without(&is_top), [Remark::OpenEdges { count: 3, seen: 3 }]);
    let is_bottom = |t: &Triangle| t.iter().all(|corner| corner[2] == 0.0);
    assert_eq!(without(&is_bottom), [Remark::OpenEdges { count: 3, seen: 0 }]);

    let mut triangles = block();
    triangles.iter_mut().for_each(|t| t.swap(0, 1));
    let (relief, remarks) = seen(triangles);
    assert_eq!(remarks, [Remark::Turned { count: 16, triangles: 16 }]);
    assert_eq!(relief.height(0.0, 0.0), 0.0);

    // One body in another: only one is seen. The inner one's inside may be out, as a hollow's is.
    let hollow = prism(&square(1.0), 0.5, 1.5).into_iter().map(|[a, b, c]| [a, c, b]);
    let (_, remarks) = seen(block().into_iter().chain(hollow).collect());
    assert_eq!(remarks, [Remark::Shells { count: 2, seen: 1 }]);

    let upright = vec![[[0.0f32, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 2.0]]];
    let error = Relief::of_mesh(&mesh(upright), View::default()).expect_err("on edge");
    assert!(matches!(error, Error::OnEdge), "{error}");
    let view = View { towards: Direction::Z, up: Some(Direction::NegZ) };
    let error = Relief::of_mesh(&mesh(block()), view).expect_err("no view").to_string();
    assert_eq!(error, "expected an upward direction across z, got -z");
}

/// Numbers that no part has end in an error.
#[test]
fn hostile_coordinates_are_no_panic() {
    let extremes = [0.0, -0.0, 1e-45, 1.0, -60.0, 3e38, -3e38];
    let mut state = 7u64;
    for _ in 0..500 {
        let mut text = String::new();
        for _ in 0..4 {
            let mut number = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                extremes[(state >> 33) as usize % extremes.len()]
            };
            text += &format!("v {} {} {}\n", number(), number(), number());
        }
        let mesh = Mesh::decode((text + "f 1 2 3\nf 2 4 3\n").as_bytes(), Format::Obj, Unit::Mm);
        if let Ok((relief, _)) =
            mesh.map_err(Error::from).and_then(|m| Relief::of_mesh(&m, View::default()))
        {
            assert!(relief.height(0.0, 0.0) <= 0.0);
        }
    }
}
