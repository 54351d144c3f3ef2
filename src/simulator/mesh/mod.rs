//! Surfaces of triangles from CAD files that somebody else made.
//!
//! | file | what it does |
//! |---|---|
//! | `read` | STL, binary and ASCII, and OBJ |
//! | `shells` | which triangles hang together, open edges, triangles turned round |
//!
//! The readers are our own. `stl_io` 0.11 takes binary files whose header begins with `solid ` for text where it
//! can, and text without a name after `solid` for binary; of a file of several solids it reads the first; and what
//! is cut off is "failed to fill whole buffer". `tobj` 4 panics at hostile indices of normals, which nobody needs
//! here, and fills concave faces wrongly.

mod read;
pub(super) mod shells;

use std::fmt;
use std::path::Path;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::files;

/// Longest file that is read, in bytes: an ASCII STL of as many triangles as are allowed has about as many.
pub const MAX_BYTES: u64 = 256 << 20;
/// Most triangles of a part. CAD programs write some thousands for a snap.
pub const MAX_TRIANGLES: usize = 1_000_000;

/// What lengths in a file are in; the file does not say.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unit {
    /// Millimetres.
    #[default]
    Mm,
    /// Inches.
    Inch,
    /// Metres.
    M,
}

impl Unit {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Mm, Self::Inch, Self::M];

    /// Its length in millimetres.
    pub fn mm(self) -> f64 {
        match self {
            Self::Mm => 1.0,
            Self::Inch => 25.4,
            Self::M => 1000.0,
        }
    }

    /// Its name: `mm`, `inch`, `m`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mm => "mm",
            Self::Inch => "inch",
            Self::M => "m",
        }
    }

    /// The unit of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|unit| unit.name() == name)
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A kind of CAD file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// STL, binary or ASCII: its bytes tell which.
    Stl,
    /// Wavefront OBJ: vertices and flat convex faces; all else is passed over.
    Obj,
}

impl Format {
    /// The format that a file's name ends in.
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_string_lossy().to_lowercase().as_str() {
            "stl" => Some(Self::Stl),
            "obj" => Some(Self::Obj),
            _ => None,
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Stl => "STL",
            Self::Obj => "OBJ",
        })
    }
}

/// Why a file is no surface; without its name, which the caller knows.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system's words.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// A name without an ending that tells what the file is.
    #[error("expected a name that ends in .stl or .obj, got another")]
    Ending,
    /// Neither kind of STL.
    #[error("expected an STL file, got {0}")]
    NotStl(String),
    /// A binary STL shorter than its header says.
    #[error(
        "expected a binary STL of {triangles} triangles as its header says, {expected} bytes; got {got} bytes: it \
         was cut off, or is no STL"
    )]
    CutOff {
        /// Triangles by the header.
        triangles: u32,
        /// Bytes that these take.
        expected: u64,
        /// Bytes that there are.
        got: u64,
    },
    /// A line of a text file.
    #[error("line {line}: expected {expected}, got {got}")]
    Line {
        /// Counted from 1.
        line: usize,
        /// What should be there.
        expected: String,
        /// What is.
        got: String,
    },
    /// Nothing to press.
    #[error("expected triangles, got none")]
    NoTriangles,
    /// Past a limit.
    #[error("expected at most {} {what}, got more: export it coarser", .most)]
    TooMany {
        /// Of what.
        what: &'static str,
        /// The limit.
        most: usize,
    },
    /// Coordinates that are no numbers.
    #[error(
        "expected finite coordinates, got {what} in {count} of {triangles} triangles, first in number {first}"
    )]
    NotFinite {
        /// NaN or infinity.
        what: &'static str,
        /// Triangles that have such.
        count: usize,
        /// The first of them, counted from 1.
        first: usize,
        /// All triangles.
        triangles: usize,
    },
    /// All triangles are lines or points.
    #[error("expected triangles with an area, got {triangles} without")]
    NoArea {
        /// Triangles.
        triangles: usize,
    },
}

/// A triangle's corners in millimetres; seen from outside they run counter-clockwise.
pub type Triangle = [[f32; 3]; 3];

/// A surface of triangles with an area, in millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    triangles: Vec<Triangle>,
    unit: Unit,
}

impl Mesh {
    /// Reads an STL or OBJ file whose lengths are in this unit.
    ///
    /// # Errors
    /// [`Error`]. At most [`MAX_BYTES`] are read; what is no regular file is not opened.
    pub fn read(path: &Path, unit: Unit) -> Result<Self, Error> {
        let format = Format::of(path).ok_or(Error::Ending)?;
        Self::decode(&files::read(path, MAX_BYTES)?, format, unit)
    }

    /// The same from a file's bytes.
    ///
    /// # Errors
    /// [`Error`].
    pub fn decode(bytes: &[u8], format: Format, unit: Unit) -> Result<Self, Error> {
        let triangles = match format {
            Format::Stl => read::stl(bytes)?,
            Format::Obj => read::obj(bytes)?,
        };
        Self::new(triangles, unit)
    }

    /// Takes triangles in this unit. Those without an area are left out: many programs write such.
    ///
    /// # Errors
    /// [`Error`] for none, for too many, for coordinates that are not finite, for no area at all.
    pub fn new(mut triangles: Vec<Triangle>, unit: Unit) -> Result<Self, Error> {
        let count = triangles.len();
        match count {
            0 => return Err(Error::NoTriangles),
            1..=MAX_TRIANGLES => {}
            _ => return Err(Error::TooMany { what: "triangles", most: MAX_TRIANGLES }),
        }
        for corner in triangles.as_flattened_mut() {
            *corner = corner.map(|v| (f64::from(v) * unit.mm()) as f32);
        }
        let is_wrong = |t: &Triangle| !t.as_flattened().iter().all(|v| v.is_finite());
        if let Some(first) = triangles.iter().position(is_wrong) {
            let is_nan = triangles[first].as_flattened().iter().any(|v| v.is_nan());
            return Err(Error::NotFinite {
                what: if is_nan { "NaN" } else { "infinity" },
                count: triangles.iter().filter(|t| is_wrong(t)).count(),
                first: first + 1,
                triangles: count,
            });
        }
        triangles.retain(|t| {
            let [a, b, c] = corners(t);
            (b - a).cross(c - a) != DVec3::ZERO
        });
        match triangles.is_empty() {
            true => Err(Error::NoArea { triangles: count }),
            false => Ok(Self { triangles, unit }),
        }
    }

    /// Its triangles.
    pub fn triangles(&self) -> &[Triangle] {
        &self.triangles
    }

    /// What its file's lengths were taken to be in.
    pub fn unit(&self) -> Unit {
        self.unit
    }
}

/// A triangle's corners in double precision.
pub(super) fn corners(triangle: &Triangle) -> [DVec3; 3] {
    triangle.map(|[x, y, z]| DVec3::new(x.into(), y.into(), z.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAN: f32 = f32::NAN;
    const CORNER: Triangle = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

    #[test]
    fn triangles_that_cannot_be_are_named() {
        let message = |triangles| Mesh::new(triangles, Unit::Mm).expect_err("no mesh").to_string();
        assert_eq!(message(vec![]), "expected triangles, got none");
        let mut wrong = CORNER;
        wrong[1][2] = NAN;
        assert_eq!(
            message(vec![CORNER, wrong, wrong]),
            "expected finite coordinates, got NaN in 2 of 3 triangles, first in number 2"
        );
        assert_eq!(
            message(vec![[[0.0; 3], [1.0; 3], [2.0; 3]]; 4]),
            "expected triangles with an area, got 4 without"
        );
        assert_eq!(
            message(vec![CORNER; MAX_TRIANGLES + 1]),
            "expected at most 1000000 triangles, got more: export it coarser"
        );
        // What is finite in metres need not be in millimetres.
        wrong[1][2] = 1e38;
        let error = Mesh::new(vec![wrong], Unit::M).expect_err("infinite");
        assert!(error.to_string().contains("infinity in 1 of 1"), "{error}");
    }

    #[test]
    fn lengths_are_in_millimetres() {
        let mesh = Mesh::new(vec![CORNER, [[0.0; 3]; 3]], Unit::Inch).expect("a mesh");
        assert_eq!(mesh.triangles(), [[[0.0; 3], [25.4, 0.0, 0.0], [0.0, 25.4, 0.0]]]);
        for unit in Unit::ALL {
            assert_eq!(Unit::named(unit.name()), Some(unit));
        }
        assert_eq!(Unit::named("furlong"), None);
    }

    #[test]
    fn files_are_told_apart_by_their_names() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("part.OBJ");
        std::fs::write(&path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").expect("written");
        assert_eq!(Mesh::read(&path, Unit::Mm).expect("a mesh").triangles(), [CORNER]);
        let error = Mesh::read(&folder.path().join("part.step"), Unit::Mm).expect_err("STEP");
        assert!(matches!(error, Error::Ending), "{error}");
        let error = Mesh::read(&folder.path().join("gone.stl"), Unit::Mm).expect_err("gone");
        assert!(matches!(error, Error::Io(_)), "{error}");
    }
}
