//! A surface seen from straight above: at each cell its highest point.

use glam::{DVec2, DVec3};

use super::Error;

/// Most cells that triangles are looked at in, all of them together: a thousand layers of the largest grid.
const MAX_LOOKS: usize = 1 << 30;
/// The triangle of a cell that none is over.
pub const NONE: u32 = u32::MAX;

/// What lies highest in each cell, row after row.
pub struct Scan {
    /// Heights at the cells' centres; −∞ where there is no surface.
    pub heights: Vec<f64>,
    /// Which triangle it is of, or [`NONE`].
    pub triangles: Vec<u32>,
}

/// Looks down, against z, on triangles; cells' centres lie `spacing` apart about x = y = 0.
///
/// Edges belong to the triangles on both sides, and both find the same side of it for a point: there are no gaps
/// between neighbours. What stands upright shows nothing.
pub fn scan(
    triangles: impl Iterator<Item = [DVec3; 3]>,
    cells: [usize; 2],
    spacing: f64,
) -> Result<Scan, Error> {
    scan_within(triangles, cells, spacing, MAX_LOOKS)
}

fn scan_within(
    triangles: impl Iterator<Item = [DVec3; 3]>,
    [width, height]: [usize; 2],
    spacing: f64,
    most: usize,
) -> Result<Scan, Error> {
    let mut heights = vec![f64::NEG_INFINITY; width * height];
    let mut highest = vec![NONE; width * height];
    let first = [width, height].map(|n| (n as f64 - 1.0) / 2.0);
    let cells = |low: f64, high: f64, axis: usize, slack: f64| {
        let n = [width, height][axis];
        let low = (low / spacing + first[axis] - slack).ceil().max(0.0) as usize;
        let high =
            (high / spacing + first[axis] + slack + 1.0).floor().clamp(0.0, n as f64) as usize;
        low..high
    };
    let mut looks = 0;
    for (corners, at) in triangles.zip(0..) {
        let flat = corners.map(DVec3::truncate);
        let [a, b, c] = flat;
        let area = (b - a).perp_dot(c - a);
        if area == 0.0 {
            continue;
        }
        let [low, high] = [f64::min, f64::max].map(|pick: fn(f64, f64) -> f64| {
            [0, 1, 2].map(|axis| corners.map(|p| p[axis]).into_iter().reduce(pick).unwrap_or(0.0))
        });
        for row in cells(low[1], high[1], 1, 1e-9) {
            let y = (row as f64 - first[1]) * spacing;
            let (mut left, mut right) = (high[0], low[0]);
            for (p, q) in [(a, b), (b, c), (c, a)] {
                let (down, up) = (p.y.min(q.y), p.y.max(q.y));
                let share = if up > down { (y.clamp(down, up) - p.y) / (q.y - p.y) } else { 0.0 };
                for x in
                    [p.x + share * (q.x - p.x), q.x].into_iter().take(if up > down { 1 } else { 2 })
                {
                    if (down - 1e-9..=up + 1e-9).contains(&y) {
                        (left, right) = (left.min(x), right.max(x));
                    }
                }
            }
            // A cell more at each end: the edges decide exactly.
            let columns = cells(left, right, 0, 1.0);
            looks += columns.len() + 1;
            if looks > most {
                return Err(Error::Crowded);
            }
            for column in columns {
                let point = DVec2::new((column as f64 - first[0]) * spacing, y);
                let sides = [side(b, c, point), side(c, a, point), side(a, b, point)];
                if sides.iter().any(|side| side * area < 0.0) {
                    continue;
                }
                let whole: f64 = sides.iter().sum();
                let z: f64 = sides.iter().zip(&corners).map(|(side, corner)| side * corner.z).sum();
                let z = (z / whole).clamp(low[2], high[2]);
                let cell = row * width + column;
                if z > heights[cell] {
                    (heights[cell], highest[cell]) = (z, at);
                }
            }
        }
    }
    Ok(Scan { heights, triangles: highest })
}

/// Twice the area of the triangle of an edge and a point: which side of the edge it is on. The same number, but
/// for its sign, for the edge the other way.
fn side(p: DVec2, q: DVec2, point: DVec2) -> f64 {
    if (p.x, p.y) < (q.x, q.y) { (q - p).perp_dot(point - p) } else { -(p - q).perp_dot(point - q) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A fan of thin triangles round an odd point covers a square without gaps, whichever way each is turned.
    #[test]
    fn neighbours_leave_no_gap() {
        let center = DVec3::new(0.1, 0.2, 0.3);
        let rim: Vec<_> = (0..400)
            .map(|i| {
                let along = f64::from(i % 100) / 50.0 - 1.0;
                let [x, y] =
                    [[along, -1.0], [1.0, along], [-along, 1.0], [-1.0, -along]][i as usize / 100];
                DVec3::new(x, y, 0.3)
            })
            .collect();
        let fan = rim.iter().zip(rim.iter().cycle().skip(1)).enumerate();
        let fan = fan.map(|(i, (&a, &b))| if i % 3 == 0 { [center, b, a] } else { [b, center, a] });
        // Cells' centres lie on corners, on edges and on the rim.
        let scan = scan(fan, [201, 201], 0.01).expect("a few triangles");
        assert!(scan.heights.iter().all(|z| (z - 0.3).abs() < 1e-12));
        assert!(scan.triangles.iter().all(|&at| at < 400));
    }

    #[test]
    fn the_highest_is_seen_and_upright_triangles_are_not() {
        let at = |z: f64| [(-1.0, -1.0), (1.0, -1.0), (0.0, 1.0)].map(|(x, y)| DVec3::new(x, y, z));
        let upright = [DVec3::ZERO, DVec3::X, DVec3::Z];
        let Scan { heights, triangles } =
            scan([at(1.0), at(2.0), at(0.5), upright].into_iter(), [4, 4], 0.5).expect("few");
        let none = f64::NEG_INFINITY;
        // The triangle's half width at a height of y is (1 − y) / 2.
        let expected = [[2.0; 4], [none, 2.0, 2.0, none], [none, 2.0, 2.0, none], [none; 4]];
        assert_eq!(heights, expected.as_flattened());
        assert_eq!(triangles[..4], [1; 4]);
        assert_eq!(triangles[15], NONE);
    }

    #[test]
    fn layers_are_counted() {
        let large = [(-9.0, -9.0), (9.0, -9.0), (0.0, 90.0)].map(|(x, y)| DVec3::new(x, y, 0.0));
        let scan = |layers| {
            let layers = std::iter::repeat_n(large, layers);
            scan_within(layers, [100, 100], 0.01, 20 * 100 * 101)
        };
        assert!(scan(20).is_ok());
        assert!(matches!(scan(21), Err(Error::Crowded)));
    }
}
