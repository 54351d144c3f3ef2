//! Which triangles of a surface hang together at their edges, and what is wrong where they do not.

use std::collections::HashMap;

use super::{Mesh, corners};

/// Corners nearer than this are one, in millimetres: programs round what they write.
const WELD_MM: f64 = 1e-4;

/// How a surface's triangles hang together.
pub struct Shells {
    /// Of each triangle the shell, as a number below `count`.
    pub of: Vec<u32>,
    /// Shells.
    pub count: usize,
    /// Of each triangle whether it is turned against the rest of its shell; of a closed shell, whether its inside
    /// is out.
    pub is_turned: Vec<bool>,
    /// Edges of one triangle alone: which, and the edge's number in it.
    pub open: Vec<(u32, u8)>,
}

impl Shells {
    /// Finds them.
    pub fn of(mesh: &Mesh) -> Self {
        let triangles = mesh.triangles();
        let mut numbers = HashMap::new();
        // A triangle whose corners are one is none; but it may be what is seen.
        let mut is_lines = Vec::with_capacity(triangles.len());
        let mut edges = Vec::with_capacity(3 * triangles.len());
        for (triangle, at) in triangles.iter().zip(0u32..) {
            let welded = corners(triangle).map(|corner| {
                let key = (corner / WELD_MM).round().to_array().map(|v| v as i64);
                let next = numbers.len() as u32;
                *numbers.entry(key).or_insert(next)
            });
            let [a, b, c] = welded;
            let is_line = a == b || b == c || c == a;
            is_lines.push(is_line);
            for edge in 0..3u8 {
                let (a, b) = (welded[usize::from(edge)], welded[usize::from(edge + 1) % 3]);
                if a != b {
                    let ends = [a.min(b), a.max(b)];
                    edges.push(Edge { ends, is_line, at, edge, is_forward: a < b });
                }
            }
        }
        drop(numbers);
        edges.sort_unstable_by_key(|edge| (edge.ends, edge.is_line));
        let mut sets = Sets::new(triangles.len());
        let mut open = Vec::new();
        for group in edges.chunk_by(|a, b| a.ends == b.ends) {
            let (real, lines) = group.split_at(group.partition_point(|edge| !edge.is_line));
            for line in lines {
                sets.join(group[0].at, line.at, false);
            }
            match real {
                [] => {}
                [edge] => open.push((edge.at, edge.edge)),
                // Neighbours run along their edge in opposite directions.
                [a, b] => sets.join(a.at, b.at, a.is_forward == b.is_forward),
                // Where two bodies touch along an edge.
                many if many.iter().filter(|e| e.is_forward).count() * 2 == many.len() => {}
                many => open.extend(many.iter().map(|edge| (edge.at, edge.edge))),
            }
        }
        let roots: Vec<_> = (0..triangles.len() as u32).map(|at| sets.root(at)).collect();
        let mut shells = HashMap::new();
        let of: Vec<u32> = roots
            .iter()
            .map(|(root, _)| {
                let next = shells.len() as u32;
                *shells.entry(*root).or_insert(next)
            })
            .collect();
        // Of each shell how many triangles are one way and the other, the volume as the first have it, and
        // whether it is closed.
        let mut sums = vec![([0usize; 2], 0.0, true); shells.len()];
        let [origin, ..] = corners(&triangles[0]);
        let real =
            triangles.iter().zip(&roots).zip(&of).zip(&is_lines).filter(|(_, is_line)| !**is_line);
        for (((triangle, &(_, is_other)), &shell), _) in real {
            let (ways, volume, _) = &mut sums[shell as usize];
            let [a, b, c] = corners(triangle).map(|corner| corner - origin);
            ways[usize::from(is_other)] += 1;
            *volume += a.dot(b.cross(c)) * if is_other { -1.0 } else { 1.0 };
        }
        for &(at, _) in &open {
            sums[of[at as usize] as usize].2 = false;
        }
        let is_turned =
            roots.iter().zip(&of).zip(&is_lines).map(|((&(_, is_other), &shell), is_line)| {
                let ([one, other], volume, is_closed) = sums[shell as usize];
                !is_line && is_other != if is_closed { volume < 0.0 } else { other > one }
            });
        Self { is_turned: is_turned.collect(), count: shells.len(), of, open }
    }
}

/// A triangle's edge between two corners.
struct Edge {
    ends: [u32; 2],
    /// Whether two of the triangle's corners are one.
    is_line: bool,
    at: u32,
    edge: u8,
    is_forward: bool,
}

/// Triangles in sets; each knows whether it is turned against its set's root.
struct Sets {
    parents: Vec<(u32, bool)>,
}

impl Sets {
    fn new(count: usize) -> Self {
        Self { parents: (0..count as u32).map(|at| (at, false)).collect() }
    }

    /// The root, and whether this one is turned against it.
    fn root(&mut self, at: u32) -> (u32, bool) {
        let (mut root, mut is_turned) = (at, false);
        while self.parents[root as usize].0 != root {
            let (parent, turned) = self.parents[root as usize];
            (root, is_turned) = (parent, is_turned ^ turned);
        }
        let found = (root, is_turned);
        // The next one who asks finds it at once.
        let mut at = at;
        while at != root {
            let (parent, turned) =
                std::mem::replace(&mut self.parents[at as usize], (root, is_turned));
            (at, is_turned) = (parent, is_turned ^ turned);
        }
        found
    }

    fn join(&mut self, a: u32, b: u32, is_turned: bool) {
        let ((a, a_turned), (b, b_turned)) = (self.root(a), self.root(b));
        if a != b {
            self.parents[b as usize] = (a, a_turned ^ b_turned ^ is_turned);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Triangle, Unit};
    use super::*;

    /// A tetrahedron of 1 mm, its corner at `x`, seen from outside.
    fn tetrahedron(x: f32) -> Vec<Triangle> {
        let [o, a, b, c] = [[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x, 1.0, 0.0], [x, 0.0, 1.0]];
        vec![[o, b, a], [o, a, c], [o, c, b], [a, b, c]]
    }

    fn shells(triangles: Vec<Triangle>) -> Shells {
        Shells::of(&Mesh::new(triangles, Unit::Mm).expect("a mesh"))
    }

    #[test]
    fn shells_open_edges_and_turned_triangles_are_found() {
        let whole = shells(tetrahedron(0.0));
        assert_eq!((whole.count, whole.open.len()), (1, 0));
        assert_eq!(whole.is_turned, [false; 4]);

        let two = shells([tetrahedron(0.0), tetrahedron(3.0)].concat());
        assert_eq!((two.count, two.of), (2, vec![0, 0, 0, 0, 1, 1, 1, 1]));

        // The first triangle is (o, b, a): without it the others' edges at it are open.
        let open = shells(tetrahedron(0.0).split_off(1));
        assert_eq!((open.count, open.open), (1, vec![(0, 0), (1, 2), (2, 0)]));
        assert_eq!(open.is_turned, [false; 3]);

        let mut turned = tetrahedron(0.0);
        turned[2].swap(0, 1);
        assert_eq!(shells(turned.clone()).is_turned, [false, false, true, false]);
        turned.iter_mut().for_each(|t| t.swap(0, 1));
        assert_eq!(shells(turned).is_turned, [true, true, false, true]);
        let inside_out = tetrahedron(0.0).into_iter().map(|[a, b, c]| [a, c, b]).collect();
        assert_eq!(shells(inside_out).is_turned, [true; 4]);
    }

    /// A face cut off along its edge by less than corners are apart: nothing is odd about it.
    #[test]
    fn slivers_are_no_shells() {
        let mut cut = tetrahedron(0.0);
        let [o, a, c] = cut[1];
        let near = [1e-5, 0.0, 1.0];
        cut[1] = [o, a, near];
        cut.push([o, near, c]);
        let found = shells(cut);
        assert_eq!((found.count, found.open.len()), (1, 0));
        assert_eq!(found.is_turned, [false; 5]);
    }

    #[test]
    fn corners_that_were_rounded_are_one() {
        let mut rounded = tetrahedron(0.0);
        rounded[3][0][1] = 1e-6;
        assert_eq!(shells(rounded).open, []);
    }
}
