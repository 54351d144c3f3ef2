//! A rigid part as a height field seen along the direction in which it is pressed.
//!
//! | file | what it does |
//! |---|---|
//! | `scan` | triangles seen from above |
//! | `walls` | what is between the cells and beside the part |
//! | `alike` | what looks the same after a turn, mirrored, or as another part |
//! | `tests` | reliefs of bodies whose heights are known |
//!
//! Lengths are in millimetres: x to the right and y down as pictures have them, heights towards the gel, which is
//! towards the camera. Those axes are left-handed, CAD files' are right-handed: a part's upward direction runs
//! against y, so that pictures show the part and not its mirror image.

mod alike;
mod scan;
mod walls;

use std::fmt;
use std::path::Path;

use glam::DVec3;
use image::{ImageBuffer, Luma};
use serde::{Deserialize, Serialize};

use super::mesh::shells::Shells;
use super::mesh::{self, Mesh, Unit, corners};
use crate::engine::digest::fnv1a;
use crate::files;
use crate::picture::{self, GreyPicture16};
pub use alike::Symmetry;
use scan::{NONE, Scan, scan};
use walls::Walls;

/// Shortest and longest part across the gel, in millimetres along its longer side: the gel is 40 mm wide, and less
/// than a millimetre shows as a dot.
pub const ACROSS_MM: [f64; 2] = [1.0, 60.0];
/// Distance of cells: a quarter of the paper's pixel, so that an outline between cells is off by an eighth of one.
const SPACING_MM: f64 = 0.01;
/// Most cells along the longer side, which makes them 0.05 mm at 60 mm: less than the contact's, which are 0.06 to
/// 0.08 mm.
const MAX_CELLS: usize = 1200;
/// Most pixels along a height map's longer side.
pub const MAX_MAP_PX: u32 = 2048;
/// An edge this much below what is beside it is hidden, in millimetres.
const HIDDEN_MM: f64 = 0.02;

/// Why a surface is no part that can be pressed; without its name, which the caller knows.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The surface's file.
    #[error(transparent)]
    Mesh(#[from] mesh::Error),
    /// The height map's file.
    #[error(transparent)]
    Picture(#[from] picture::Error),
    /// Directions that make no view.
    #[error("expected an upward direction across {towards}, got {up}")]
    View {
        /// What points to the gel.
        towards: Direction,
        /// What should point up.
        up: Direction,
    },
    /// Larger or smaller than any part, most likely for its unit.
    #[error(
        "expected a part of {} to {} mm across the gel, got {across_mm:.3} × {down_mm:.3} mm, lengths taken to be in \
         {unit}{}", ACROSS_MM[0], ACROSS_MM[1], would_fit(.fits)
    )]
    Size {
        /// Along x.
        across_mm: f64,
        /// Along y.
        down_mm: f64,
        /// What lengths were taken to be in.
        unit: Unit,
        /// What would make a part of them.
        fits: Vec<Unit>,
    },
    /// Seen on edge.
    #[error("expected a surface seen from the gel, got one on edge: nothing lies across the gel")]
    OnEdge,
    /// So many layers that looking through them would take minutes.
    #[error("expected a surface of at most some hundreds of layers, got more")]
    Crowded,
    /// More pixels than show anything.
    #[error(
        "expected a height map of at most {MAX_MAP_PX} × {MAX_MAP_PX} pixels, got {width} × {height}"
    )]
    MapSize {
        /// Pixels along x.
        width: u32,
        /// Pixels along y.
        height: u32,
    },
    /// No scale.
    #[error("{what}: expected more than 0 and at most {most}, got {got}")]
    MapScale {
        /// Of what, as the program's options are called.
        what: &'static str,
        /// The most that makes sense.
        most: f64,
        /// What was given.
        got: f64,
    },
    /// Black all over.
    #[error("expected a height map that shows a part, got one that is black")]
    EmptyMap,
}

fn would_fit(units: &[Unit]) -> String {
    match units.iter().map(|unit| unit.name()).collect::<Vec<_>>() {
        names if names.is_empty() => String::new(),
        names => format!("; {} would fit", names.join(" or ")),
    }
}

/// What is odd about a part that can be pressed all the same.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Remark {
    /// Edges of one triangle alone: the surface has holes, or its parts were not joined.
    OpenEdges {
        /// All of them.
        count: usize,
        /// Those that nothing hides from the gel.
        seen: usize,
    },
    /// Triangles of what is seen whose inside is out. Heights do not depend on it.
    Turned {
        /// How many.
        count: usize,
        /// Of how many.
        triangles: usize,
    },
    /// Several bodies. They are pressed as one.
    Shells {
        /// All of them.
        count: usize,
        /// Those that can be seen from the gel.
        seen: usize,
    },
    /// So small that another unit makes a part too.
    Unit {
        /// Its longer side across the gel, in millimetres.
        across_mm: f64,
        /// What lengths were taken to be in.
        unit: Unit,
        /// What they may be in.
        fits: Vec<Unit>,
    },
}

impl fmt::Display for Remark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OpenEdges { count, seen } => write!(
                f,
                "the surface is not closed: {count} open edges, {seen} of them seen from the gel"
            ),
            Self::Turned { count, triangles } => write!(
                f,
                "{count} of {triangles} triangles are turned round; heights do not depend on it"
            ),
            Self::Shells { count, seen } => write!(
                f,
                "{count} separate shells, {seen} of them seen from the gel; they are pressed as one part"
            ),
            Self::Unit { across_mm, unit, fits: units } => write!(
                f,
                "{across_mm:.2} mm across, lengths taken to be in {unit}{} too",
                would_fit(units)
            ),
        }
    }
}

/// A direction of a CAD file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Direction {
    /// Along x.
    #[serde(rename = "x")]
    X,
    /// Along y.
    #[serde(rename = "y")]
    Y,
    /// Along z.
    #[serde(rename = "z")]
    Z,
    /// Against x.
    #[serde(rename = "-x")]
    NegX,
    /// Against y.
    #[serde(rename = "-y")]
    NegY,
    /// Against z.
    #[serde(rename = "-z")]
    NegZ,
}

impl Direction {
    /// All of them.
    pub const ALL: [Self; 6] = [Self::X, Self::Y, Self::Z, Self::NegX, Self::NegY, Self::NegZ];

    /// Its name: `x`, `-x` and so on.
    pub fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
            Self::NegX => "-x",
            Self::NegY => "-y",
            Self::NegZ => "-z",
        }
    }

    /// The direction of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|direction| direction.name() == name)
    }

    fn vector(self) -> DVec3 {
        match self {
            Self::X => DVec3::X,
            Self::Y => DVec3::Y,
            Self::Z => DVec3::Z,
            Self::NegX => DVec3::NEG_X,
            Self::NegY => DVec3::NEG_Y,
            Self::NegZ => DVec3::NEG_Z,
        }
    }
}

impl fmt::Display for Direction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// How a part lies before the gel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(default)]
pub struct View {
    /// Which direction of the file points to the gel.
    pub towards: Direction,
    /// Which direction of the file points up in a picture of the part as it lies before it is turned, against the
    /// relief's y. If it is not given, z, or y where z points to the gel or away from it.
    pub up: Option<Direction>,
}

impl Default for View {
    /// z to the gel, y up: as CAD programs show a part from above.
    fn default() -> Self {
        Self { towards: Direction::Z, up: None }
    }
}

impl View {
    /// The file's directions of the relief's x and y and of its heights.
    fn axes(self) -> Result<[DVec3; 3], Error> {
        let towards = self.towards.vector();
        let up = self.up.unwrap_or(match self.towards {
            Direction::Z | Direction::NegZ => Direction::Y,
            _ => Direction::Z,
        });
        let right = up.vector().cross(towards);
        match right == DVec3::ZERO {
            true => Err(Error::View { towards: self.towards, up }),
            false => Ok([right, -up.vector(), towards]),
        }
    }
}

/// A part's heights on a grid of square cells about the middle of its bounding box.
///
/// Between cells heights are interpolated. No wall rises faster than those of the built-in parts
/// ([`WALL_SLOPE`](super::outline::WALL_SLOPE)): at the foot of a steeper one the surface is higher than the file
/// has it. The contact's cells are coarser than these, and see where a wall stands between them by its slope.
#[derive(Clone, PartialEq)]
pub struct Relief {
    cells: [usize; 2],
    spacing_mm: f64,
    /// Row after row; −∞ where the part is not.
    heights: Vec<f32>,
    walls: Walls,
}

impl fmt::Debug for Relief {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [width, height] = self.cells;
        write!(f, "Relief({width} × {height} cells of {} mm)", self.spacing_mm)
    }
}

impl Relief {
    /// What of a surface is seen from the gel; and what is odd about it.
    ///
    /// A cell has the height of the highest triangle at its centre, exactly; the highest cell is at 0. Cells are
    /// 0.01 mm apart, and for parts beyond 12 mm further, so that there are 1200 along the longer side.
    ///
    /// # Errors
    /// [`Error`] for a view that is none, a part of a size that none has, and a surface that shows no area.
    pub fn of_mesh(mesh: &Mesh, view: View) -> Result<(Self, Vec<Remark>), Error> {
        let axes = view.axes()?;
        let turned = |corner: DVec3| DVec3::from_array(axes.map(|axis| axis.dot(corner)));
        let triangles = || mesh.triangles().iter().map(|t| corners(t).map(turned));
        let all = || triangles().flatten();
        let low = all().reduce(DVec3::min).unwrap_or(DVec3::ZERO);
        let high = all().reduce(DVec3::max).unwrap_or(DVec3::ZERO);
        let size = high - low;
        let longer = size.x.max(size.y);
        let fits = |unit: &Unit| {
            let across = longer * unit.mm() / mesh.unit().mm();
            *unit != mesh.unit() && (ACROSS_MM[0]..=ACROSS_MM[1]).contains(&across)
        };
        let fits: Vec<_> = Unit::ALL.into_iter().filter(fits).collect();
        if !(ACROSS_MM[0]..=ACROSS_MM[1]).contains(&longer) {
            let [across_mm, down_mm] = [size.x, size.y];
            return Err(Error::Size { across_mm, down_mm, unit: mesh.unit(), fits });
        }
        // The longer side is a whole number of cells.
        let spacing = longer / (longer / SPACING_MM).ceil().min(MAX_CELLS as f64);
        let cells = [size.x, size.y].map(|side| ((side / spacing - 1e-6).ceil() as usize).max(1));
        let middle = ((low + high) / 2.0).with_z(high.z);
        let placed = |t: [DVec3; 3]| t.map(|corner| corner - middle);
        let Scan { heights, triangles: highest } = scan(triangles().map(placed), cells, spacing)?;
        if highest.iter().all(|&at| at == NONE) {
            return Err(Error::OnEdge);
        }
        let mut remarks = Vec::new();
        let units = fits.into_iter().filter(|unit| unit.mm() > mesh.unit().mm());
        let fits: Vec<_> = units.collect();
        if !fits.is_empty() {
            remarks.push(Remark::Unit { across_mm: longer, unit: mesh.unit(), fits });
        }
        let shells = Shells::of(mesh);
        let mut is_seen = vec![false; shells.count];
        for &at in highest.iter().filter(|&&at| at != NONE) {
            is_seen[shells.of[at as usize] as usize] = true;
        }
        if shells.count > 1 {
            let seen = is_seen.iter().filter(|&&seen| seen).count();
            remarks.push(Remark::Shells { count: shells.count, seen });
        }
        if !shells.open.is_empty() {
            let seen = shells.open.iter().filter(|&&(at, edge)| {
                let [a, b, c] = placed(corners(&mesh.triangles()[at as usize]).map(turned));
                let [a, b] = [[a, b], [b, c], [c, a]][usize::from(edge)];
                let edge = (a + b) / 2.0;
                let around = |axis: usize| {
                    let at =
                        (edge[axis] / spacing + cells[axis] as f64 / 2.0 - 0.5).max(0.0) as usize;
                    at..(at + 2).min(cells[axis])
                };
                let [columns, rows] = [around(0), around(1)];
                let mut cells =
                    rows.flat_map(|row| columns.clone().map(move |column| row * cells[0] + column));
                cells.all(|cell| heights[cell] <= edge.z + HIDDEN_MM)
            });
            remarks.push(Remark::OpenEdges { seen: seen.count(), count: shells.open.len() });
        }
        let is_turned = shells.is_turned.iter().zip(&shells.of);
        let count =
            is_turned.filter(|&(&turned, &shell)| turned && is_seen[shell as usize]).count();
        if count > 0 {
            remarks.push(Remark::Turned { count, triangles: mesh.triangles().len() });
        }
        let heights = heights.into_iter().map(|z| z as f32).collect();
        Ok((Self::of_cells(cells, spacing, heights), remarks))
    }

    /// Reads a height map: a grey PNG of 16 bits, seen as pictures show the part, white at `mm_full_scale` over
    /// where the part begins at level 1; what is black is not of the part.
    ///
    /// # Errors
    /// [`Error`].
    pub fn read_map(path: &Path, mm_per_pixel: f64, mm_full_scale: f64) -> Result<Self, Error> {
        let bytes = files::read(path, picture::MAX_ENCODED).map_err(picture::Error::from)?;
        Self::of_map(&picture::decode_grey_16(&bytes)?, mm_per_pixel, mm_full_scale)
    }

    /// [`read_map`](Self::read_map) of a map in memory.
    ///
    /// # Errors
    /// [`Error`].
    pub fn of_map(
        map: &GreyPicture16,
        mm_per_pixel: f64,
        mm_full_scale: f64,
    ) -> Result<Self, Error> {
        for (what, got, most) in
            [("map_pixel", mm_per_pixel, 1.0), ("map_height", mm_full_scale, 100.0)]
        {
            if !(got > 0.0 && got <= most) {
                return Err(Error::MapScale { what, most, got });
            }
        }
        let (width, height) = map.dimensions();
        if width.max(height) > MAX_MAP_PX {
            return Err(Error::MapSize { width, height });
        }
        let step = mm_full_scale / f64::from(u16::MAX);
        let heights = map.as_raw().iter().map(|&level| match level {
            0 => f32::NEG_INFINITY,
            level => (f64::from(level) * step) as f32,
        });
        let cells = [width as usize, height as usize];
        let (cells, heights) = cropped(cells, heights.collect()).ok_or(Error::EmptyMap)?;
        let [across_mm, down_mm] = cells.map(|n| n as f64 * mm_per_pixel);
        if !(ACROSS_MM[0]..=ACROSS_MM[1]).contains(&across_mm.max(down_mm)) {
            return Err(Error::Size { across_mm, down_mm, unit: Unit::Mm, fits: Vec::new() });
        }
        Ok(Self::of_cells(cells, mm_per_pixel, heights))
    }

    /// The heights as such a map, white at 0; with the map's `mm_full_scale`, the part's lowest cell at level 1.
    pub fn to_map(&self) -> (GreyPicture16, f64) {
        let lowest =
            self.heights.iter().filter(|h| h.is_finite()).fold(0.0, |low: f32, &h| low.min(h));
        let levels = f64::from(u16::MAX) - 1.0;
        // A flat part has any scale.
        let range = f64::from(-lowest).max(1e-3);
        let [width, height] = self.cells.map(|n| n as u32);
        let map = ImageBuffer::from_fn(width, height, |x, y| {
            let height = self.at(x as usize, y as usize);
            Luma([height.map_or(0, |h| (1.0 + (1.0 + h / range) * levels).round() as u16)])
        });
        (map, range * f64::from(u16::MAX) / levels)
    }

    /// Takes cells, of which one at least is of the part, and sets the highest to 0.
    fn of_cells(cells: [usize; 2], spacing_mm: f64, mut heights: Vec<f32>) -> Self {
        let highest = heights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        heights.iter_mut().for_each(|h| *h -= highest);
        let walls = Walls::new(cells, spacing_mm, &heights);
        Self { cells, spacing_mm, heights, walls }
    }

    /// Cells along x and y.
    pub fn cells(&self) -> [usize; 2] {
        self.cells
    }

    /// Side of a cell in millimetres.
    pub fn spacing_mm(&self) -> f64 {
        self.spacing_mm
    }

    /// Height of a cell's centre as the file has it; none where the part is not, and outside the grid.
    pub fn at(&self, column: usize, row: usize) -> Option<f64> {
        let [width, height] = self.cells;
        let height = (column < width && row < height).then(|| self.heights[row * width + column]);
        height.filter(|h| h.is_finite()).map(f64::from)
    }

    /// Height in millimetres; 0 at the highest point, falling steeply outside the part.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        self.walls.height(x, y)
    }

    /// Half the part's size along its own x and y, to half a cell.
    pub fn half_size(&self) -> [f64; 2] {
        self.cells.map(|n| n as f64 * self.spacing_mm / 2.0)
    }

    /// How far the lowest cell that a press of `most_mm` sees lies below the highest, in millimetres.
    pub fn depth_mm(&self, most_mm: f64) -> f64 {
        let seen = self.heights.iter().map(|h| -f64::from(*h)).filter(|depth| *depth <= most_mm);
        seen.fold(0.0, f64::max)
    }

    /// Least depth in millimetres at which a press touches half of the cells that one of `most_mm` touches.
    pub fn half_contact_mm(&self, most_mm: f64) -> f64 {
        let depths = self.heights.iter().map(|h| -h).filter(|depth| f64::from(*depth) <= most_mm);
        let mut depths: Vec<f32> = depths.collect();
        let middle = depths.len() / 2;
        // The highest cell is seen.
        match depths.get(middle) {
            Some(_) => f64::from(*depths.select_nth_unstable_by(middle, f32::total_cmp).1),
            None => 0.0,
        }
    }

    /// A number that tells shapes apart.
    pub fn digest(&self) -> u64 {
        let size = self.cells.iter().flat_map(|n| (*n as u64).to_le_bytes());
        let heights = self.heights.iter().flat_map(|h| h.to_le_bytes());
        fnv1a(size.chain(self.spacing_mm.to_le_bytes()).chain(heights))
    }

    /// Its mirror image, y against y.
    pub fn mirrored(&self) -> Self {
        let rows = self.heights.chunks_exact(self.cells[0]).rev();
        Self::of_cells(self.cells, self.spacing_mm, rows.flatten().copied().collect())
    }

    /// The part without this share of its length, at the end that x points to.
    pub fn without_tip(&self, share: f64) -> Self {
        let [width, _] = self.cells;
        let kept = (width as f64 * (1.0 - share.clamp(0.0, 1.0))).round() as usize;
        let is_kept = |at: usize| at % width < kept;
        let heights = self.heights.iter().enumerate();
        let heights = heights.map(|(at, &h)| if is_kept(at) { h } else { f32::NEG_INFINITY });
        self.of_some(heights.collect())
    }

    /// A plain block of the outline that a press of `depth_mm` sees.
    pub fn block(&self, depth_mm: f64) -> Self {
        let is_seen = |h: f32| f64::from(h) >= -depth_mm.max(0.0);
        let heights =
            self.heights.iter().map(|&h| if is_seen(h) { 0.0 } else { f32::NEG_INFINITY });
        self.of_some(heights.collect())
    }

    /// Of the same cells with these heights, on the smallest grid that has them; itself where there are none.
    fn of_some(&self, heights: Vec<f32>) -> Self {
        match cropped(self.cells, heights) {
            Some((cells, heights)) => Self::of_cells(cells, self.spacing_mm, heights),
            None => self.clone(),
        }
    }
}

/// The smallest grid that has all cells of the part; none if there are none.
fn cropped([width, height]: [usize; 2], heights: Vec<f32>) -> Option<([usize; 2], Vec<f32>)> {
    let is_part = |&column: &usize, &row: &usize| heights[row * width + column].is_finite();
    let rows = |row: &usize| (0..width).any(|column| is_part(&column, row));
    let columns = |column: &usize| (0..height).any(|row| is_part(column, &row));
    let (top, bottom) = ((0..height).find(rows)?, (0..height).rev().find(rows)?);
    let (left, right) = ((0..width).find(columns)?, (0..width).rev().find(columns)?);
    let kept = heights.chunks_exact(width).take(bottom + 1).skip(top);
    let kept = kept.flat_map(|row| &row[left..=right]).copied().collect();
    Some(([right + 1 - left, bottom + 1 - top], kept))
}

#[cfg(test)]
mod tests;
