//! Surface voxels that images did not show, and the points in them that rays look for.
use super::eyes::Eyes;
use crate::geometry::{IVec3, Mesh, Vec3};
use crate::world::ground_truth::voxels::{Surface, VoxelSet};

/// Surface points tried in a voxel.
const POINTS: usize = 12;
/// Of these, pieces of triangles that are tried at their corners too.
pub const PIECES: usize = 2;

/// The 26 voxels around one.
pub fn around(key: IVec3) -> impl Iterator<Item = IVec3> {
    (0..27)
        .filter(|i| *i != 13)
        .map(move |i| key + IVec3::new(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1))
}

/// Surface voxels in range of the eyes that the images did not show, with their triangles.
pub struct Hidden {
    voxels: VoxelSet,
    pub keys: Vec<IVec3>,
    /// Triangles of voxel i: `triangles[first[i]..first[i + 1]]`.
    first: Vec<usize>,
    triangles: Vec<u32>,
}

impl Hidden {
    pub fn new(surface: &Surface, visible: &VoxelSet, eyes: &Eyes) -> Self {
        let reach = eyes.reach(surface.resolution);
        let mut pairs: Vec<([i32; 3], u32)> = surface
            .touches
            .iter()
            .filter(|(key, _)| {
                key.cmpge(reach.0).all() && key.cmple(reach.1).all() && !visible.contains(*key)
            })
            .map(|(key, t)| ([key.z, key.y, key.x], *t))
            .collect();
        pairs.sort_unstable();
        let mut hidden = Self {
            voxels: surface.voxels.cleared(),
            keys: Vec::new(),
            first: Vec::new(),
            triangles: pairs.iter().map(|p| p.1).collect(),
        };
        for (i, ([z, y, x], _)) in pairs.iter().enumerate() {
            let key = IVec3::new(*x, *y, *z);
            if hidden.keys.last() != Some(&key) {
                hidden.voxels.insert(key);
                hidden.keys.push(key);
                hidden.first.push(i);
            }
        }
        hidden.first.push(pairs.len());
        hidden
    }

    /// Calls `visit` with the numbers of the hidden voxels among the 26 around `key`.
    pub fn for_neighbours(&self, key: IVec3, mut visit: impl FnMut(usize)) {
        for near in around(key).filter(|k| self.voxels.contains(*k)) {
            let order = |k: &IVec3| (k.z, k.y, k.x).cmp(&(near.z, near.y, near.x));
            if let Ok(i) = self.keys.binary_search_by(order) {
                visit(i);
            }
        }
    }

    /// Points of the surface within voxel i: middles of its largest pieces of triangles, then points near their corners.
    pub fn points(&self, i: usize, mesh: &Mesh, resolution: f64) -> Points {
        let mut pieces: [Option<Piece>; PIECES] = [None; PIECES];
        let center = (self.keys[i].as_dvec3() + 0.5) * resolution;
        for &t in &self.triangles[self.first[i]..self.first[i + 1]] {
            let corners = mesh
                .corners(t as usize)
                .map(|c| (c.as_dvec3() - center).as_vec3());
            let mut new = Piece::new(corners, resolution as f32 / 2.0 + 1e-5);
            for slot in &mut pieces {
                let larger = match (&new, &slot) {
                    (Some(new), Some(old)) => new.area > old.area,
                    (new, _) => new.is_some(),
                };
                if larger {
                    std::mem::swap(slot, &mut new);
                }
            }
        }
        let center = center.as_vec3();
        let mut points = Points::default();
        for piece in pieces.iter().flatten() {
            points.push(center + piece.middle);
        }
        for piece in pieces.iter().flatten() {
            for corner in &piece.polygon[..piece.count] {
                points.push(center + corner.lerp(piece.middle, 0.1));
            }
        }
        points
    }
}

/// A short list of points.
#[derive(Default)]
pub struct Points {
    list: [Vec3; POINTS],
    count: usize,
}

impl Points {
    /// What does not fit is left out.
    pub fn push(&mut self, point: Vec3) {
        if let Some(slot) = self.list.get_mut(self.count) {
            *slot = point;
            self.count += 1;
        }
    }
}

impl std::ops::Deref for Points {
    type Target = [Vec3];
    fn deref(&self) -> &[Vec3] {
        &self.list[..self.count]
    }
}

/// The part of a triangle within a voxel.
#[derive(Clone, Copy)]
pub struct Piece {
    polygon: [Vec3; 10],
    count: usize,
    area: f32,
    middle: Vec3,
}

impl Piece {
    /// The part of a triangle within the cube of half side `half` around the origin.
    pub fn new(corners: [Vec3; 3], half: f32) -> Option<Self> {
        // A triangle clipped by six planes has at most nine corners.
        let mut polygon = [Vec3::ZERO; 10];
        polygon[..3].copy_from_slice(&corners);
        let mut count = 3;
        for axis in 0..3 {
            for sign in [1.0, -1.0] {
                let inside = |p: Vec3| half - sign * p[axis];
                let mut next = [Vec3::ZERO; 10];
                let mut kept = 0;
                for i in 0..count {
                    let (a, b) = (polygon[i], polygon[(i + 1) % count]);
                    let (da, db) = (inside(a), inside(b));
                    if da >= 0.0 && kept < 10 {
                        next[kept] = a;
                        kept += 1;
                    }
                    if (da >= 0.0) != (db >= 0.0) && kept < 10 {
                        next[kept] = a + (b - a) * (da / (da - db));
                        kept += 1;
                    }
                }
                polygon = next;
                count = kept;
            }
        }
        if count == 0 {
            return None;
        }
        let corners = &polygon[..count];
        let area: Vec3 = (1..count.max(2) - 1)
            .map(|i| (corners[i] - corners[0]).cross(corners[i + 1] - corners[0]))
            .sum();
        let middle = corners.iter().sum::<Vec3>() / count as f32;
        Some(Self {
            polygon,
            count,
            area: area.length(),
            middle,
        })
    }
}
