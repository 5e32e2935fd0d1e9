//! The voxels that a mesh touches: conservative voxelisation by separating axes.
use crate::error::{positive, Error, Result};
use crate::geometry::{Aabb, IVec3, Mesh, Vec3};
use crate::world::bytes::{Fault, Reader, Writer};
use glam::DVec3;

/// Most voxels of a set (one bit each).
const MAX_VOXELS: u64 = 1 << 31;
/// A surface this close to a voxel's face counts for both voxels, metres: a point measured in f32 falls into either.
const NOISE: f64 = 1e-6;

/// Voxels in a box, one bit each, on the map's lattice (key = floor(coordinate / resolution)) and in its brick order:
/// voxel (x, y, z) of a brick is bit `y * 8 + x` of word `z`.
#[derive(Clone, Debug, PartialEq)]
pub struct VoxelSet {
    /// In bricks.
    origin: IVec3,
    dims: IVec3,
    words: Vec<[u64; 8]>,
}

impl VoxelSet {
    /// The empty set over the bricks that hold the voxels `low` to `high`.
    fn new(low: IVec3, high: IVec3) -> Result<Self> {
        let origin: IVec3 = low >> 3;
        let top: IVec3 = high >> 3;
        // In i64: voxels far out may have keys at both ends of i32.
        let dims = (top.as_i64vec3() - origin.as_i64vec3() + 1).max(glam::I64Vec3::ZERO);
        let volume = dims
            .to_array()
            .into_iter()
            .fold(512i64, |v, d| v.saturating_mul(d));
        if dims.max_element() > 1 << 20 || volume as u64 > MAX_VOXELS {
            return Err(Error::invalid(format!(
                "exploration bounds of {} x {} x {} bricks of 8 voxels are too large: use a coarser resolution or smaller bounds",
                dims.x, dims.y, dims.z
            )));
        }
        Ok(Self {
            origin,
            dims: dims.as_ivec3(),
            words: vec![[0; 8]; volume as usize / 512],
        })
    }

    pub fn write(&self, out: &mut Writer) {
        out.ivec3(self.origin);
        out.ivec3(self.dims);
        out.u64(self.words.len() as u64);
        self.words.as_flattened().iter().for_each(|w| out.u64(*w));
    }

    /// What [`VoxelSet::write`] wrote.
    pub fn read(from: &mut Reader) -> std::result::Result<Self, Fault> {
        let (origin, dims) = (from.ivec3()?, from.ivec3()?);
        let count = from.count(64)?;
        let fits = dims.cmpge(IVec3::ZERO).all() && dims.max_element() <= 1 << 20;
        // Keys are eight times as large and must fit.
        let near =
            origin.cmpgt(IVec3::splat(-1 << 27)).all() && origin.cmplt(IVec3::splat(1 << 27)).all();
        if !fits || !near || dims.as_u64vec3().element_product() != count as u64 {
            return Err("a set of voxels of another size");
        }
        let mut words = vec![[0; 8]; count];
        for word in words.as_flattened_mut() {
            *word = from.u64()?;
        }
        Ok(Self {
            origin,
            dims,
            words,
        })
    }

    /// Every voxel within `bounds` that a triangle touches: thin parts stay.
    pub fn surface(mesh: &Mesh, bounds: &Aabb, resolution: f64) -> Result<Self> {
        Ok(Surface::new(mesh, bounds, resolution)?.voxels)
    }

    /// The set of the same shape without members.
    pub(super) fn cleared(&self) -> Self {
        Self {
            words: vec![[0; 8]; self.words.len()],
            ..*self
        }
    }

    fn index(&self, brick: IVec3) -> Option<usize> {
        let c = brick - self.origin;
        let inside = c.cmpge(IVec3::ZERO).all() && c.cmplt(self.dims).all();
        inside.then(|| ((c.z * self.dims.y + c.y) * self.dims.x + c.x) as usize)
    }

    /// The words of a brick; `None` outside the box.
    pub fn words(&self, brick: IVec3) -> Option<&[u64; 8]> {
        self.index(brick).map(|i| &self.words[i])
    }

    /// Voxels outside the box are not taken in. True if the voxel is new.
    pub fn insert(&mut self, key: IVec3) -> bool {
        let Some(i) = self.index(key >> 3) else {
            return false;
        };
        let word = &mut self.words[i][(key.z & 7) as usize];
        let bit = 1 << ((key.y & 7) * 8 + (key.x & 7));
        let new = *word & bit == 0;
        *word |= bit;
        new
    }

    pub fn contains(&self, key: IVec3) -> bool {
        self.words(key >> 3)
            .is_some_and(|w| w[(key.z & 7) as usize] >> ((key.y & 7) * 8 + (key.x & 7)) & 1 == 1)
    }

    pub fn len(&self) -> u64 {
        self.words
            .iter()
            .flatten()
            .map(|w| u64::from(w.count_ones()))
            .sum()
    }

    pub fn is_empty(&self) -> bool {
        self.words.iter().flatten().all(|w| *w == 0)
    }

    fn brick(&self, index: usize) -> IVec3 {
        let i = index as i32;
        let (rows, layers) = (i / self.dims.x, i / self.dims.x / self.dims.y);
        self.origin + IVec3::new(i % self.dims.x, rows % self.dims.y, layers)
    }

    /// Keeps the voxels that `other` has, too; it gives the words of a brick.
    pub(super) fn intersect(&mut self, other: impl Fn(IVec3) -> [u64; 8]) {
        for i in 0..self.words.len() {
            if self.words[i] != [0; 8] {
                let other = other(self.brick(i));
                self.words[i]
                    .iter_mut()
                    .zip(other)
                    .for_each(|(a, b)| *a &= b);
            }
        }
    }

    /// In the order of the box.
    pub fn keys(&self) -> Vec<IVec3> {
        let mut keys = Vec::new();
        for (i, words) in self.words.iter().enumerate() {
            let brick = self.brick(i);
            for (z, word) in words.iter().enumerate() {
                let mut bits = *word;
                while bits != 0 {
                    let bit = bits.trailing_zeros() as i32;
                    bits &= bits - 1;
                    keys.push(brick * 8 + IVec3::new(bit & 7, bit >> 3, z as i32));
                }
            }
        }
        keys
    }
}

/// The surface voxels of a mesh and which triangles lie in them.
pub(super) struct Surface {
    pub voxels: VoxelSet,
    pub resolution: f64,
    /// (voxel, triangle), in the order of the triangles.
    pub touches: Vec<(IVec3, u32)>,
}

impl Surface {
    pub fn new(mesh: &Mesh, bounds: &Aabb, resolution: f64) -> Result<Self> {
        positive("map resolution", resolution)?;
        let nothing = bounds.is_empty();
        let infinite = !bounds.min.is_finite() || !bounds.max.is_finite();
        if infinite && !nothing {
            return Err(Error::invalid("exploration bounds must be finite"));
        }
        let (low, high) = if nothing {
            (IVec3::ZERO, IVec3::splat(-8))
        } else {
            (
                key_of(bounds.min, resolution),
                key_of(bounds.max, resolution),
            )
        };
        let mut surface = Self {
            voxels: VoxelSet::new(low, high)?,
            resolution,
            touches: Vec::new(),
        };
        for t in 0..mesh.triangles.len() {
            let corners = mesh.corners(t);
            if corners.iter().all(|c| c.is_finite()) {
                let touches = &mut surface.touches;
                let voxels = &mut surface.voxels;
                voxels_of(corners, resolution, low, high, |key| {
                    voxels.insert(key);
                    touches.push((key, t as u32));
                });
            }
        }
        Ok(surface)
    }

    /// First and last key of the voxels that a point belongs to: two along an axis if it lies on their common face.
    pub fn keys(&self, point: Vec3) -> (IVec3, IVec3) {
        let at = point.as_dvec3() * (1.0 / self.resolution);
        let noise = NOISE / self.resolution;
        (floor(at - noise), floor(at + noise))
    }
}

/// Rounded down, without a call of the C library's floor.
pub(in crate::world) fn floor(x: DVec3) -> IVec3 {
    let truncated = x.as_ivec3();
    let below = |axis: usize| i32::from(x[axis] < f64::from(truncated[axis]));
    truncated - IVec3::new(below(0), below(1), below(2))
}

fn key_of(point: Vec3, resolution: f64) -> IVec3 {
    (point.as_dvec3() / resolution).floor().as_ivec3()
}

/// Calls `visit` for every voxel from `low` to `high` that a triangle touches.
///
/// The thirteen separating axes of box and triangle (Akenine-Möller 2001), arranged as in Schwarz and Seidel 2010: for
/// each column along the axis that the triangle faces most, its plane leaves a few voxels; three axes decide for the
/// whole column, six for each voxel.
pub(in crate::world) fn voxels_of(
    corners: [Vec3; 3],
    resolution: f64,
    low: IVec3,
    high: IVec3,
    mut visit: impl FnMut(IVec3),
) {
    let p = corners.map(|c| c.as_dvec3());
    let half = resolution / 2.0 + NOISE;
    let around = (
        p[0].min(p[1]).min(p[2]) - NOISE,
        p[0].max(p[1]).max(p[2]) + NOISE,
    );
    let from = (around.0 / resolution).floor().as_ivec3().max(low);
    let to = (around.1 / resolution).floor().as_ivec3().min(high);
    if from.cmpgt(to).any() {
        return;
    }
    let edges = [p[1] - p[0], p[2] - p[1], p[0] - p[2]];
    let normal = edges[0].cross(edges[1]);
    let facing = normal.abs();
    let w = if facing.x >= facing.y && facing.x >= facing.z {
        0
    } else if facing.y >= facing.z {
        1
    } else {
        2
    };
    let (u, v) = ((w + 1) % 3, (w + 2) % 3);
    // A centre c can belong to a touched voxel if low <= axis . c <= high.
    let slab = |axis: DVec3| {
        let at = p.map(|corner| corner.dot(axis));
        let reach = half * (axis.x.abs() + axis.y.abs() + axis.z.abs());
        (
            axis,
            at[0].min(at[1]).min(at[2]) - reach,
            at[0].max(at[1]).max(at[2]) + reach,
        )
    };
    let unit = [DVec3::X, DVec3::Y, DVec3::Z];
    let column = edges.map(|e| slab(unit[w].cross(e)));
    let across = [u, v].map(|a| edges.map(|e| slab(unit[a].cross(e))));
    let (_, plane_low, plane_high) = slab(normal);
    let center = |k: i32| (f64::from(k) + 0.5) * resolution;
    let within = |(axis, low, high): &(DVec3, f64, f64), c: DVec3| {
        let at = axis.dot(c);
        *low <= at && at <= *high
    };
    for kv in from[v]..=to[v] {
        for ku in from[u]..=to[u] {
            let mut c = DVec3::ZERO;
            c[u] = center(ku);
            c[v] = center(kv);
            if !column.iter().all(|s| within(s, c)) {
                continue;
            }
            let (mut first, mut last) = (from[w], to[w]);
            if normal[w] != 0.0 {
                let rest = normal[u] * c[u] + normal[v] * c[v];
                let a = (plane_low - rest) / normal[w] / resolution - 0.5;
                let b = (plane_high - rest) / normal[w] / resolution - 0.5;
                first = first.max((a.min(b) - 1e-9).ceil() as i32);
                last = last.min((a.max(b) + 1e-9).floor() as i32);
            }
            for kw in first..=last {
                c[w] = center(kw);
                if across.iter().flatten().all(|s| within(s, c)) {
                    let mut key = IVec3::ZERO;
                    key[u] = ku;
                    key[v] = kv;
                    key[w] = kw;
                    visit(key);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::test_scenes::*;

    /// Overlap of a box with a triangle by clipping: nothing shared with the code above.
    fn clipped_is_empty(corners: [Vec3; 3], center: DVec3, half: f64) -> bool {
        let mut polygon: Vec<DVec3> = corners.iter().map(|c| c.as_dvec3() - center).collect();
        for axis in 0..3 {
            for sign in [1.0, -1.0] {
                let inside = |p: &DVec3| half - sign * p[axis];
                let mut next = Vec::new();
                for i in 0..polygon.len() {
                    let (a, b) = (polygon[i], polygon[(i + 1) % polygon.len()]);
                    let (da, db) = (inside(&a), inside(&b));
                    if da >= 0.0 {
                        next.push(a);
                    }
                    if (da >= 0.0) != (db >= 0.0) {
                        next.push(a + (b - a) * (da / (da - db)));
                    }
                }
                polygon = next;
            }
        }
        polygon.is_empty()
    }

    #[test]
    fn equals_clipping() {
        let mesh = soup(150, 9);
        let (low, high) = (IVec3::splat(-30), IVec3::splat(30));
        let resolution = 0.13;
        let mut touched = 0;
        for t in 0..mesh.triangles.len() {
            let corners = mesh.corners(t);
            let mut got = Vec::new();
            voxels_of(corners, resolution, low, high, |k| got.push(k));
            let unique: std::collections::BTreeSet<_> = got.iter().map(|k| k.to_array()).collect();
            assert_eq!(unique.len(), got.len());
            touched += got.len();
            let around = Aabb::of(corners).grown(0.3);
            let (from, to) = (
                key_of(around.min, resolution),
                key_of(around.max, resolution),
            );
            for x in from.x..=to.x {
                for y in from.y..=to.y {
                    for z in from.z..=to.z {
                        let key = IVec3::new(x, y, z);
                        let center = (key.as_dvec3() + 0.5) * resolution;
                        let has = unique.contains(&key.to_array());
                        let in_range = key.cmpge(low).all() && key.cmple(high).all();
                        // Between the exact voxel and the one grown by twice the noise either answer is right.
                        if !clipped_is_empty(corners, center, resolution / 2.0) {
                            assert!(has || !in_range, "missed {key}");
                        } else if clipped_is_empty(corners, center, resolution / 2.0 + 2.0 * NOISE)
                        {
                            assert!(!has, "too many: {key} of {corners:?}");
                        }
                    }
                }
            }
        }
        assert!(touched > 2000, "{touched}");
    }

    #[test]
    fn set_operations_and_brick_order() {
        let mut set = VoxelSet::new(IVec3::new(-9, 0, 3), IVec3::new(20, 7, 8)).unwrap();
        let keys = [
            IVec3::new(-9, 0, 3),
            IVec3::new(-1, 7, 8),
            IVec3::new(20, 3, 4),
            IVec3::new(2, 5, 7),
        ];
        for key in keys {
            assert!(set.insert(key) && !set.insert(key) && set.contains(key));
        }
        assert!(!set.insert(IVec3::new(100, 0, 0)) && !set.contains(IVec3::new(100, 0, 0)));
        assert_eq!(set.len(), 4);
        let mut found = set.keys();
        assert_eq!(set.words(IVec3::ZERO).unwrap()[7], 1 << (5 * 8 + 2));
        let order = |k: &IVec3| k.to_array();
        found.sort_by_key(order);
        let mut expected = keys;
        expected.sort_by_key(order);
        assert_eq!(found, expected);
        assert!(set.cleared().is_empty());
    }

    #[test]
    fn a_face_on_the_lattice_belongs_to_both_sides() {
        let mut mesh = Mesh::default();
        sheet(
            &mut mesh,
            Vec3::ZERO,
            Vec3::X,
            Vec3::Y,
            10.0,
            0.0,
            &mut random(1),
        );
        let bounds = Aabb::new(Vec3::splat(-1.0), Vec3::splat(2.0));
        let set = VoxelSet::surface(&mesh, &bounds, 0.25).unwrap();
        assert!(set.contains(IVec3::new(1, 1, 0)) && set.contains(IVec3::new(1, 1, -1)));
        assert!(!set.contains(IVec3::new(1, 1, 1)));
        assert_eq!(set.len(), 6 * 6 * 2);
    }

    #[test]
    fn bad_bounds_and_resolutions() {
        let mesh = soup(10, 1);
        assert!(VoxelSet::surface(&mesh, &Aabb::EMPTY, 0.1)
            .unwrap()
            .is_empty());
        let huge = Aabb::new(Vec3::splat(-1e5), Vec3::splat(1e5));
        for (bounds, resolution) in [
            (huge, 0.1),
            (Aabb::new(Vec3::splat(f32::NEG_INFINITY), Vec3::ONE), 0.1),
            (mesh.bounds(), 0.0),
            (mesh.bounds(), f64::NAN),
            (mesh.bounds(), 1e-9),
        ] {
            assert!(VoxelSet::surface(&mesh, &bounds, resolution).is_err());
        }
    }
}
