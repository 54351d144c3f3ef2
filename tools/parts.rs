//! Writes two parts as CAD files: a U-clip and a fir-tree pin on its side. They are neither of the built-in snaps,
//! and stand for a part of one's own where there is none.
//!
//! ```sh
//! cargo run --release --example parts -- out/parts
//! ```
//!
//! Writes `clip.stl` and `pin.stl`, binary STL in millimetres, z to the gel; and beside each a grey PNG of 16 bits,
//! its height map, whose scale is printed. What may be changed about them are the fields of [`Clip`] and [`Pin`].

use std::error::Error;
use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};

use smr_gpu::simulator::mesh::{Mesh, Unit};
use smr_gpu::simulator::relief::{Relief, View};

/// A corner in millimetres.
type Point = [f64; 3];

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args_os().nth(1).map(PathBuf::from).ok_or("expected a folder")?;
    std::fs::create_dir_all(&folder)?;
    write_both(&folder)
}

/// Writes both parts.
pub fn write_both(folder: &Path) -> Result<(), Box<dyn Error>> {
    write(folder, "clip", &Clip::default().sections())?;
    write(folder, "pin", &Pin::default().sections())
}

/// A clip bent to a U from flat strip: round ridges across both arms that hold what it is pushed over, a higher bead
/// across the bend, and ends that slope down.
struct Clip {
    /// From the bend to the ends, along x.
    length: f64,
    /// Across both arms, along y.
    width: f64,
    /// Width of the strip.
    strip: f64,
    /// Thickness of the strip.
    thickness: f64,
    /// Of each ridge its middle from the arm's end, half its width, and its height over the strip.
    ridges: [[f64; 3]; 2],
    /// Half the width of the bead, and its height over the strip.
    bead: [f64; 2],
    /// Length of an end's slope, and how far it goes down.
    lead_in: [f64; 2],
    /// Width of the sloped edges, at 45°.
    chamfer: f64,
}

impl Default for Clip {
    fn default() -> Self {
        Self {
            length: 9.0,
            width: 6.0,
            strip: 1.7,
            thickness: 1.2,
            ridges: [[1.3, 0.45, 0.45], [3.1, 0.45, 0.45]],
            bead: [0.9, 0.7],
            lead_in: [0.7, 0.5],
            chamfer: 0.2,
        }
    }
}

impl Clip {
    /// Height of the strip's upper side at this way from the nearer end, of half the way round.
    fn top(&self, way: f64, half: f64) -> f64 {
        let round = |[middle, half_width, height]: [f64; 3]| {
            height * (1.0 - ((way - middle) / half_width).powi(2)).max(0.0).sqrt()
        };
        let [half_width, height] = self.bead;
        let over =
            self.ridges.map(round).into_iter().fold(round([half, half_width, height]), f64::max);
        let [length, down] = self.lead_in;
        self.thickness + over - down * (1.0 - way / length).max(0.0)
    }

    /// Sections across the strip, from one end round the bend to the other.
    fn sections(&self) -> Vec<Vec<Point>> {
        let radius = (self.width - self.strip) / 2.0;
        let arm = self.length - self.width / 2.0;
        let way = 2.0 * arm + PI * radius;
        let stations = (0..=600).map(|i| f64::from(i) / 600.0 * way);
        // The middle of the bend is the origin. An arm runs against x, the other one along it.
        let place = |s: f64| match s {
            s if s < arm => ([arm - s, -radius], [0.0, 1.0]),
            s if s > way - arm => ([s - (way - arm), radius], [0.0, -1.0]),
            s => {
                let (sin, cos) = ((s - arm) / radius).sin_cos();
                ([-radius * sin, -radius * cos], [sin, cos])
            }
        };
        let sections = stations.map(|s| {
            let ([x, y], [u, v]) = place(s);
            let (half, c) = (self.strip / 2.0, self.chamfer);
            let top = self.top(s.min(way - s), way / 2.0);
            // Counter-clockwise as one looks along the strip towards its beginning.
            let profile = [
                (-half, 0.0),
                (-half, top - c),
                (c - half, top),
                (half - c, top),
                (half, top - c),
                (half, 0.0),
            ];
            profile.map(|(across, z)| [x + across * u, y + across * v, z]).to_vec()
        });
        sections.collect()
    }
}

/// A pin that is pushed into a hole, which its fins hold: a shank with a head, on its side along x.
struct Pin {
    /// From the head's top to the tip.
    length: f64,
    /// Radius and thickness of the head.
    head: [f64; 2],
    /// Radius of the shank.
    shank: f64,
    /// Radius of the first fin and of the last.
    fins: [f64; 2],
    /// How many there are.
    count: u32,
    /// Length of the tip.
    tip: f64,
}

impl Default for Pin {
    fn default() -> Self {
        Self { length: 7.0, head: [1.9, 0.7], shank: 0.8, fins: [1.6, 1.3], count: 4, tip: 0.8 }
    }
}

impl Pin {
    /// Sections across the pin, from its head to its tip.
    fn sections(&self) -> Vec<Vec<Point>> {
        let [head, thick] = self.head;
        // The head's edges are rounded a little.
        let mut profile =
            vec![(0.0, head - 0.15), (0.15, head), (thick - 0.15, head), (thick, head - 0.15)];
        let neck = thick + 0.6;
        profile.push((thick + 0.01, self.shank));
        let pitch = (self.length - self.tip - neck) / f64::from(self.count);
        for fin in 0..self.count {
            let share = f64::from(fin) / f64::from((self.count - 1).max(1));
            let radius = self.fins[0] + share * (self.fins[1] - self.fins[0]);
            let start = neck + f64::from(fin) * pitch;
            // Steep towards the head, with a rim, and gently down towards the tip.
            profile.extend([
                (start, self.shank),
                (start + 0.1, radius),
                (start + 0.25, radius),
                (start + pitch, self.shank),
            ]);
        }
        // A fin begins where the one before ends.
        profile.dedup_by(|a, b| (a.0 - b.0).abs() < 1e-9);
        profile.push((self.length, 0.3));
        let ring = |(x, radius): (f64, f64)| {
            let angles = (0..96).map(|i| f64::from(i) / 96.0 * TAU);
            angles.map(|a| [x, radius * a.cos(), radius * a.sin()]).collect()
        };
        profile.into_iter().map(ring).collect()
    }
}

/// Triangles of a closed body of sections that run counter-clockwise as one looks against the way from the first to
/// the last, and that are convex at both ends.
fn body(sections: &[Vec<Point>]) -> Vec<[Point; 3]> {
    let mut triangles = Vec::new();
    for pair in sections.windows(2) {
        for i in 0..pair[0].len() {
            let j = (i + 1) % pair[0].len();
            let [a, b, c, d] = [pair[0][i], pair[0][j], pair[1][j], pair[1][i]];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let (first, last) = (&sections[0], &sections[sections.len() - 1]);
    for i in 1..first.len() - 1 {
        triangles.push([first[0], first[i + 1], first[i]]);
        triangles.push([last[0], last[i], last[i + 1]]);
    }
    triangles
}

fn write(folder: &Path, name: &str, sections: &[Vec<Point>]) -> Result<(), Box<dyn Error>> {
    let triangles = body(sections);
    let single = |triangle: &[Point; 3]| triangle.map(|corner| corner.map(|v| v as f32));
    let triangles: Vec<_> = triangles.iter().map(single).collect();
    let mut stl = vec![0; 80];
    stl.extend((triangles.len() as u32).to_le_bytes());
    for triangle in &triangles {
        // Normals may be left out: readers compute them.
        let numbers = [0.0; 3].iter().chain(triangle.as_flattened());
        stl.extend(numbers.flat_map(|v: &f32| v.to_le_bytes()));
        stl.extend([0, 0]);
    }
    let path = folder.join(name).with_extension("stl");
    std::fs::write(&path, stl)?;
    let (relief, remarks) = Relief::of_mesh(&Mesh::read(&path, Unit::Mm)?, View::default())?;
    if let [remark, ..] = &remarks[..] {
        return Err(format!("{}: {remark}", path.display()).into());
    }
    let (map, mm_full_scale) = relief.to_map();
    map.save(path.with_extension("png"))?;
    let [width, height] = relief.half_size().map(|half| 2.0 * half);
    println!(
        "{}: {} triangles, {width:.2} × {height:.2} mm; its map {} mm a pixel, {mm_full_scale:.4} mm at white",
        path.display(),
        triangles.len(),
        relief.spacing_mm(),
    );
    Ok(())
}
