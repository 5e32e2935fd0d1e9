//! What is left of the triangles as read, and where the floor is.
use std::collections::{HashMap, HashSet};

use glam::{DVec3, IVec3, Vec2};

use crate::geometry::{Aabb, Mesh};

/// What is smaller than this, metres, stands on a floor instead of holding one.
const ROOM: f32 = 3.0;
/// Cells along the longer side of the extent in the search for a floor.
const GRID: u32 = 256;
/// The floor lies within this height above the lowest point, metres, and within this share of the total height.
const LOW: f32 = 2.0;
const LOW_SHARE: f32 = 0.3;
/// Least |z| of the unit normal of a floor.
const FLAT: f32 = 0.9;
/// Heights that count as one floor, metres.
const BIN: f32 = 0.01;
/// Least share of the extent that a floor covers.
const FLOOR_SHARE: f32 = 0.1;
const MAX_CELL_VISITS: u64 = 200_000_000;

/// A point to the micrometre, half-way cases to the even side. Two points with the same cell are the same point.
pub(super) fn cell(point: DVec3) -> IVec3 {
    // Coordinates are at most 1 km, which fits.
    (point * 1e6).map(f64::round_ties_even).as_ivec3()
}

/// A mesh whose vertices carry their cells.
#[derive(Default)]
pub(super) struct Soup {
    pub mesh: Mesh,
    /// A number for each triangle, kept with it.
    pub objects: Vec<u32>,
    pub cells: Vec<IVec3>,
}

impl Soup {
    /// Welds vertices of one cell, then drops triangles whose corners lie on a line and all but the first of
    /// those with the same corners in any order: rays are cast double-sided. Unused vertices go, too.
    pub fn clean(self) -> (Mesh, Vec<u32>) {
        let mut out = Mesh::default();
        let mut objects = Vec::with_capacity(self.objects.len());
        let mut index_of = HashMap::with_capacity(self.cells.len());
        let mut seen = HashSet::with_capacity(self.mesh.triangles.len());
        for (triangle, object) in self.mesh.triangles.into_iter().zip(self.objects) {
            let corners = triangle.map(|i| self.cells[i as usize]);
            if on_a_line(corners) {
                continue;
            }
            let welded = [0, 1, 2].map(|k| {
                *index_of.entry(corners[k]).or_insert_with(|| {
                    out.vertices.push(self.mesh.vertices[triangle[k] as usize]);
                    out.vertices.len() as u32 - 1
                })
            });
            let mut key = welded;
            key.sort_unstable();
            if seen.insert(key) {
                out.triangles.push(welded);
                objects.push(object);
            }
        }
        (out, objects)
    }
}

/// The connected part of each triangle, counted from 1: triangles that share a vertex are one part.
pub(super) fn connected_parts(mesh: &Mesh) -> Vec<u32> {
    // Union-find over the vertices; paths are halved on the way up.
    let mut parent: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    let find = |parent: &mut [u32], mut i: u32| {
        while parent[i as usize] != i {
            parent[i as usize] = parent[parent[i as usize] as usize];
            i = parent[i as usize];
        }
        i
    };
    for [a, b, c] in &mesh.triangles {
        let root = find(&mut parent, *a);
        for other in [*b, *c] {
            let joined = find(&mut parent, other);
            parent[joined as usize] = root;
        }
    }
    let mut number_of = HashMap::new();
    mesh.triangles
        .iter()
        .map(|t| {
            let next = number_of.len() as u32 + 1;
            *number_of.entry(find(&mut parent, t[0])).or_insert(next)
        })
        .collect()
}

/// Exact: the differences have 32 bits, their products 63.
fn on_a_line([a, b, c]: [IVec3; 3]) -> bool {
    let (u, v) = (
        b.as_i64vec3() - a.as_i64vec3(),
        c.as_i64vec3() - a.as_i64vec3(),
    );
    u.y * v.z == u.z * v.y && u.z * v.x == u.x * v.z && u.x * v.y == u.y * v.x
}

/// Height of the floor: the most frequent height of what one sees from above when all that reaches higher than
/// `LOW` is taken away. Without such a height (an object, not a room) the ground plane, or the lowest point.
pub(super) fn floor(visual: &Mesh, extent: Aabb, ground_plane: Option<f32>) -> f32 {
    let lowest = ground_plane.unwrap_or(extent.min.z);
    let size = extent.size();
    if size.x.max(size.y) < ROOM {
        return lowest;
    }
    let cell = (size.x.max(size.y) / GRID as f32).max(1e-3);
    let low = extent.min.z + LOW.min(size.z * LOW_SHARE);
    let columns = (size.x / cell) as i32 + 1;
    let rows = (size.y / cell) as i32 + 1;
    let mut top = vec![f32::NEG_INFINITY; (columns * rows) as usize];
    let mut visits = 0u64;
    for index in 0..visual.triangles.len() {
        let corners = visual.corners(index);
        let area = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let heights = corners.map(|c| c.z);
        let above = heights.iter().any(|z| *z > low);
        if above || area.z.abs() < FLAT * area.length() || visits > MAX_CELL_VISITS {
            continue;
        }
        let cells = corners.map(|c| (c - extent.min) / cell);
        let range = |values: [f32; 3], end: i32| {
            let least = values.iter().copied().fold(f32::INFINITY, f32::min);
            let most = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            // The centre of a cell is at + 0.5.
            let first = (least - 0.5).ceil().max(0.0) as i32;
            first..=((most - 0.5).floor() as i32).min(end - 1)
        };
        let [a, b, c] = cells.map(|c| c.truncate());
        let across = range([a.x, b.x, c.x], columns);
        for row in range([a.y, b.y, c.y], rows) {
            for column in across.clone() {
                visits += 1;
                let p = Vec2::new(column as f32 + 0.5, row as f32 + 0.5);
                let sides = [
                    (b - a).perp_dot(p - a),
                    (c - b).perp_dot(p - b),
                    (a - c).perp_dot(p - c),
                ];
                if sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0) {
                    let total: f32 = sides.iter().sum();
                    // Barycentric weights are the opposite sides; a triangle seen edge-on has none.
                    if total != 0.0 {
                        let [ab, bc, ca] = sides.map(|s| s / total);
                        let z = bc * heights[0] + ca * heights[1] + ab * heights[2];
                        let top = &mut top[(row * columns + column) as usize];
                        *top = top.max(z);
                    }
                }
            }
        }
    }
    most_frequent(&top).unwrap_or(lowest)
}

/// The median of the fullest `BIN` among finite heights, if it holds at least `FLOOR_SHARE` of all cells.
fn most_frequent(heights: &[f32]) -> Option<f32> {
    let mut sorted: Vec<f32> = heights.iter().copied().filter(|z| z.is_finite()).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let mut best = 0..0;
    let mut start = 0;
    for end in 0..sorted.len() {
        while sorted[end] - sorted[start] > BIN {
            start += 1;
        }
        if end + 1 - start > best.len() {
            best = start..end + 1;
        }
    }
    let enough = best.len() as f32 >= FLOOR_SHARE * heights.len() as f32;
    (enough && !best.is_empty()).then(|| sorted[best.start + best.len() / 2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec3;

    fn soup(corners: &[[f64; 3]], triangles: &[[u32; 3]]) -> Soup {
        let points = corners.iter().map(|c| DVec3::from(*c));
        Soup {
            cells: points.clone().map(cell).collect(),
            objects: (0..triangles.len() as u32).collect(),
            mesh: Mesh {
                vertices: points.map(|p| p.as_vec3()).collect(),
                triangles: triangles.to_vec(),
            },
        }
    }

    #[test]
    fn copies_and_slivers_are_dropped() {
        let corners = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            // The same points but for less than half a micrometre.
            [4e-7, 0.0, 0.0],
            [1.0, -4e-7, 0.0],
            // On the line between the first two, and a micrometre off it.
            [0.25, 4e-7, 0.0],
            [0.25, 1e-6, 0.0],
            // Half-way cases go to the even side.
            [5.9232525, 0.0, 0.0],
        ];
        let kept = |triangles: &[[u32; 3]]| soup(&corners, triangles).clean().0.triangles.len();
        assert_eq!(kept(&[[0, 1, 2], [2, 1, 0], [1, 2, 0], [3, 4, 2]]), 1);
        assert_eq!(kept(&[[0, 0, 1], [0, 1, 3], [0, 1, 5]]), 0);
        assert_eq!(kept(&[[0, 1, 6]]), 1);
        assert_eq!(cell(DVec3::from(corners[7])).x, 5_923_252);
        // Vertices of one cell are welded, those of no triangle go.
        let (mesh, objects) = soup(&corners, &[[0, 1, 2], [0, 0, 1], [3, 2, 6]]).clean();
        assert_eq!(mesh.vertices.len(), 4);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(objects, [0, 2]);
    }

    #[test]
    fn triangles_with_a_common_vertex_are_one_part() {
        let triangles = vec![[0, 1, 2], [3, 4, 5], [6, 7, 8], [8, 9, 10], [10, 1, 11]];
        let mesh = Mesh {
            vertices: vec![Vec3::ZERO; 12],
            triangles,
        };
        assert_eq!(connected_parts(&mesh), [1, 2, 1, 1, 1]);
    }

    #[test]
    fn lines_are_told_at_the_ends_of_the_range() {
        let far = |x, y, z| cell(DVec3::new(x, y, z));
        let (a, b) = (far(-1000.0, -1000.0, -1000.0), far(1000.0, 1000.0, 1000.0));
        assert!(on_a_line([a, b, far(0.0, 0.0, 0.0)]));
        assert!(!on_a_line([a, b, far(0.0, 0.0, 1e-6)]));
    }

    /// A floor, a table, and a shelf that reaches above the search.
    #[test]
    fn the_floor_is_the_most_frequent_height() {
        let mut mesh = Mesh::default();
        let mut slab = |low: [f32; 2], high: [f32; 2], z: f32| {
            let base = mesh.vertices.len() as u32;
            let corners = [[low[0], low[1]], [high[0], low[1]], high, [low[0], high[1]]];
            mesh.vertices
                .extend(corners.map(|[x, y]| Vec3::new(x, y, z)));
            mesh.triangles.push([base, base + 1, base + 2]);
            mesh.triangles.push([base, base + 2, base + 3]);
        };
        slab([0.0, 0.0], [8.0, 6.0], -0.2); // a slab under the floor
        slab([0.1, 0.1], [7.9, 5.9], 0.15);
        slab([1.0, 1.0], [4.0, 5.0], 0.8);
        slab([0.0, 0.0], [8.0, 6.0], 3.0);
        assert_eq!(floor(&mesh, mesh.bounds(), None), 0.15);
        // What is small has no floor, what is empty lies on the plane.
        for vertex in &mut mesh.vertices {
            *vertex *= 0.1;
        }
        assert_eq!(floor(&mesh, mesh.bounds(), None), mesh.bounds().min.z);
        let extent = Aabb::new(Vec3::splat(-5.0), Vec3::splat(5.0));
        assert_eq!(floor(&Mesh::default(), extent, Some(-1.0)), -1.0);
    }
}
