//! Which surface voxels there are, and which of them sight can reach: what coverage is measured against.
use super::render::DepthRenderer;
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::geometry::{Aabb, IVec3, Mesh, Pose, Vec3};

/// Most voxels of a truth grid (one bit each, twice).
const MAX_VOXELS: u64 = 1 << 31;
/// Viewpoints that are tried for one voxel before it is called invisible.
const TRIES: usize = 96;

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
    fn new(low: IVec3, high: IVec3) -> Result<Self> {
        let origin: IVec3 = low >> 3;
        let top: IVec3 = high >> 3;
        let dims = top - origin + 1;
        let volume = dims.x.max(0) as u64 * dims.y.max(0) as u64 * dims.z.max(0) as u64;
        if volume * 512 > MAX_VOXELS {
            return Err(Error::invalid(format!(
                "exploration bounds of {dims} bricks are too large: use a coarser resolution or smaller bounds"
            )));
        }
        Ok(Self {
            origin,
            dims,
            words: vec![[0; 8]; volume as usize],
        })
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

    pub fn insert(&mut self, key: IVec3) {
        if let Some(i) = self.index(key >> 3) {
            self.words[i][(key.z & 7) as usize] |= 1 << ((key.y & 7) * 8 + (key.x & 7));
        }
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

    /// In the order of the box.
    pub fn keys(&self) -> Vec<IVec3> {
        let mut keys = Vec::new();
        for (i, words) in self.words.iter().enumerate() {
            let i = i as i32;
            let brick = self.origin
                + IVec3::new(
                    i % self.dims.x,
                    i / self.dims.x % self.dims.y,
                    i / self.dims.x / self.dims.y,
                );
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

    /// Every voxel within `bounds` that a triangle touches (separating axes, exact up to rounding: thin parts stay).
    pub fn surface(mesh: &Mesh, bounds: &Aabb, resolution: f64) -> Result<Self> {
        let key = |p: Vec3| (p.as_dvec3() / resolution).floor().as_ivec3();
        let (low, high) = (key(bounds.min), key(bounds.max));
        let mut set = Self::new(low, high)?;
        let half = resolution / 2.0;
        for t in 0..mesh.triangles.len() {
            let corners = mesh.corners(t);
            let around = Aabb::of(corners);
            let from = key(around.min).max(low);
            let to = key(around.max).min(high);
            for z in from.z..=to.z {
                for y in from.y..=to.y {
                    for x in from.x..=to.x {
                        let k = IVec3::new(x, y, z);
                        let center = (k.as_dvec3() + 0.5) * resolution;
                        if touches(corners.map(|c| c.as_dvec3() - center), half) {
                            set.insert(k);
                        }
                    }
                }
            }
        }
        Ok(set)
    }
}

/// Does a triangle touch the cube of half side `half` around the origin? (Akenine-Möller 2001)
fn touches(v: [glam::DVec3; 3], half: f64) -> bool {
    use glam::DVec3;
    let edges = [v[1] - v[0], v[2] - v[1], v[0] - v[2]];
    let apart = |axis: DVec3| {
        let p = v.map(|c| c.dot(axis));
        let reach = half * (axis.x.abs() + axis.y.abs() + axis.z.abs());
        p[0].min(p[1]).min(p[2]) > reach || p[0].max(p[1]).max(p[2]) < -reach
    };
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    if axes.into_iter().any(apart) || apart(edges[0].cross(edges[1])) {
        return false;
    }
    !edges
        .into_iter()
        .any(|e| axes.into_iter().any(|a| apart(a.cross(e))))
}

/// From where a task may look.
pub enum Sight<'a> {
    /// Only these viewpoints, within the camera's frustum.
    Views(&'a [Pose]),
    /// Any orientation from these positions.
    Positions(&'a [Vec3]),
}

/// The surface voxels that sight can reach.
pub struct GroundTruth {
    visible: VoxelSet,
    count: u64,
}

impl GroundTruth {
    pub fn new(
        mesh: &Mesh,
        renderer: &DepthRenderer,
        bounds: &Aabb,
        resolution: f64,
        range: f32,
        camera: &Camera,
        sight: &Sight,
    ) -> Result<Self> {
        let surface = VoxelSet::surface(mesh, bounds, resolution)?;
        let mut visible = VoxelSet {
            words: vec![[0; 8]; surface.words.len()],
            ..surface.clone()
        };
        let side = resolution as f32;
        let eyes: Vec<Vec3> = match sight {
            Sight::Views(views) => views.iter().map(|v| v.translation).collect(),
            Sight::Positions(positions) => positions.to_vec(),
        };
        // Eyes that saw the last voxels are tried first: neighbours are mostly seen from the same place.
        let mut order: Vec<usize> = (0..eyes.len()).collect();
        for key in surface.keys() {
            let corner = key.as_vec3() * side;
            let mut tries = 0;
            let mut found = None;
            for (rank, eye) in order.iter().enumerate() {
                if tries >= TRIES {
                    break;
                }
                let center = corner + side / 2.0;
                let in_sight = match sight {
                    Sight::Views(views) => in_frustum(camera, &views[*eye], center),
                    Sight::Positions(_) => true,
                };
                if !in_sight || eyes[*eye].distance(center) > range {
                    continue;
                }
                tries += 1;
                // The centre, then eight points towards the corners.
                let sees = (0..9).any(|i| {
                    let offset = match i {
                        0 => Vec3::splat(0.5),
                        i => {
                            Vec3::new(
                                (i - 1 & 1) as f32,
                                (i - 1 >> 1 & 1) as f32,
                                (i - 1 >> 2) as f32,
                            ) * 0.8
                                + 0.1
                        }
                    };
                    let ray = corner + offset * side - eyes[*eye];
                    ray.try_normalize().is_some_and(|unit| {
                        let hit = renderer.cast(eyes[*eye], unit, range);
                        hit.is_some_and(|t| {
                            ((eyes[*eye] + unit * t) / side).floor().as_ivec3() == key
                        })
                    })
                });
                if sees {
                    found = Some(rank);
                    break;
                }
            }
            if let Some(rank) = found {
                visible.insert(key);
                // Move to front, a few places at a time, so that the order stays varied.
                order.swap(rank, rank / 2);
            }
        }
        Ok(Self {
            count: visible.len(),
            visible,
        })
    }

    pub fn words(&self, brick: IVec3) -> Option<&[u64; 8]> {
        self.visible.words(brick)
    }
    pub fn count(&self) -> u64 {
        self.count
    }
    pub fn keys(&self) -> Vec<IVec3> {
        self.visible.keys()
    }
}

fn in_frustum(camera: &Camera, view: &Pose, point: Vec3) -> bool {
    let p = view.inverse().point(point);
    let (u, v) = (
        p.x / p.z * camera.fx + camera.cx,
        p.y / p.z * camera.fy + camera.cy,
    );
    p.z > 0.0
        && (0.0..=camera.width as f32).contains(&u)
        && (0.0..=camera.height as f32).contains(&v)
}
