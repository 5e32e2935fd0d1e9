//! Gains that average utilities along rays (Wang et al. 2019, section III-B).
//!
//! A ray's utility is the mean utility of its visible voxels: those from the sensor's minimum range up to, and with, the
//! first occupied one, or up to the maximum range. A ray that meets an unexplored voxel before that has utility 1. A view's
//! gain is the mean over its rays, in [0, 1]. What differs is the utility of a known voxel:
//!
//! - `view_history` (InfoGain), Eq. 3: 1 if it was never seen, else `1 / sum C_k` if it was never seen from the candidate's
//!   direction and `c(O_k[i]) / sum C_k` if it was; at most 1 (the sum is small for voxels seen at p = 1/2).
//! - `ray_entropy` (BaseGain-E): H(p), without a memory of directions.
//! - `ray_probability` (BaseGain-P): `1 - |2 p - 1|`, how near p is to 1/2. The paper gives no formula and refers to Meng et al.
//!   2017; this is our reading.
use super::Task;
use crate::belief::lockstep::Lanes;
use crate::belief::octree::{entropy_units, probability, Brick, KeyBox, SIDE};
use crate::belief::view_history::sectors::{mask, Sectors};
use crate::belief::view_history::{confidences, layer_of, ViewHistory, LAYER, UNIT};
use crate::error::{Error, Result};
use crate::geometry::{IVec3, Mat3, Pose, Vec3};
use walk::{Rays, Walk};

mod walk;

/// Utilities are in [0, 1]; the sign says that the voxel is occupied. Other values have a meaning of their own.
pub const UNEXPLORED: f32 = 2.0;
/// Outside the exploration bounds: counts nothing, the ray goes on.
const OUTSIDE: f32 = 3.0;
/// Counts nothing and ends the ray.
const WALL: f32 = -4.0;

/// Most voxels of a field, 4 bytes each.
const MAX_VOXELS: u64 = 1 << 27;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Utility {
    ViewHistory,
    Entropy,
    Probability,
}

/// Memory kept from view to view.
#[derive(Default)]
pub struct Scratch {
    field: Field,
    rays: Rays,
}

/// The utilities of the voxels around a view's rays, as seen from the view's position.
#[derive(Default)]
pub struct Field {
    origin: IVec3,
    dims: IVec3,
    /// Index = (z * dims.y + y) * dims.x + x. Only what rays can reach is filled.
    values: Vec<f32>,
}

impl Field {
    fn index(&self, key: IVec3) -> usize {
        let c = key - self.origin;
        (c.z as usize * self.dims.y as usize + c.y as usize) * self.dims.x as usize + c.x as usize
    }

    /// Lay the field over `region` with a border of walls around it.
    fn lay(&mut self, region: KeyBox) -> Result<()> {
        if region.volume() > MAX_VOXELS {
            return Err(Error::invalid(format!(
                "a view's rays span {} voxels, more than {MAX_VOXELS}: use a shorter max_range or a coarser map",
                region.volume()
            )));
        }
        self.origin = region.min - 1;
        self.dims = region.max - region.min + 2;
        let [nx, ny, nz] = self.dims.to_array().map(|n| n as usize);
        self.values.resize(nx * ny * nz, 0.0);
        if cfg!(test) {
            // What is not filled must not be read.
            self.values.fill(f32::NAN);
        }
        let layer = nx * ny;
        self.values[..layer].fill(WALL);
        self.values[(nz - 1) * layer..].fill(WALL);
        for z in 1..nz - 1 {
            let slab = &mut self.values[z * layer..(z + 1) * layer];
            slab[..nx].fill(WALL);
            slab[layer - nx..].fill(WALL);
            for y in 1..ny - 1 {
                slab[y * nx] = WALL;
                slab[(y + 1) * nx - 1] = WALL;
            }
        }
        Ok(())
    }

    /// Copy a layer's values to the voxels of `part`, a box within the layer's brick.
    #[inline]
    fn put(&mut self, part: &KeyBox, first: IVec3, z: i32, values: &[f32; LAYER]) {
        let (from, to) = (
            (part.min.x - first.x) as usize,
            (part.max.x - first.x) as usize,
        );
        for y in part.min.y..part.max.y {
            let row = &values[(y - first.y) as usize * 8..][..8];
            let at = self.index(IVec3::new(part.min.x, y, z));
            if to - from == 8 {
                self.values[at..at + 8].copy_from_slice(row);
            } else {
                self.values[at..at + to - from].copy_from_slice(&row[from..to]);
            }
        }
    }
}

/// The utilities of one layer of a brick, as seen from one position.
struct Utilities<'a> {
    utility: Utility,
    history: Option<&'a ViewHistory>,
    sectors: Sectors,
    resolution: f32,
    radius: f32,
}

impl Utilities<'_> {
    fn layer(&self, number: usize, brick: &Brick, z: usize, first: Vec3) -> [f32; LAYER] {
        let known = brick.known[z];
        if known == 0 {
            return [UNEXPLORED; LAYER];
        }
        let log_odds = layer_of(&brick.log_odds, z);
        let mut values = match self.utility {
            Utility::ViewHistory => self.seen(number, z, first, known),
            Utility::Entropy => {
                by_value(log_odds, |l| entropy_units(l) as f32 / (1u64 << 32) as f32)
            }
            Utility::Probability => by_value(log_odds, |l| {
                (1.0 - (2.0 * probability(l) - 1.0).abs()) as f32
            }),
        };
        let occupied = brick.occupied[z];
        if known != u64::MAX || occupied != 0 {
            for (i, value) in values.iter_mut().enumerate() {
                if known >> i & 1 == 0 {
                    *value = UNEXPLORED;
                } else if occupied >> i & 1 == 1 {
                    *value = -*value;
                }
            }
        }
        values
    }

    /// Eq. 3.
    fn seen(&self, number: usize, z: usize, first: Vec3, known: u64) -> [f32; LAYER] {
        let mut values = [1.0; LAYER];
        let Some((history, total)) = self.history.and_then(|h| Some((h, h.total(number, z)?)))
        else {
            return values;
        };
        // A confidence of 0: never seen, or only at p = 1/2.
        for (value, total) in values.iter_mut().zip(&total.confidence) {
            *value = (UNIT as f32 / *total as f32).min(1.0);
        }
        let span = self
            .sectors
            .span(first + 3.5 * self.resolution, self.radius);
        let corner = first + Vec3::Z * (z as f32 * self.resolution);
        let voxels = known & total.seen;
        self.sectors
            .split(&span, corner, self.resolution, voxels, |direction, part| {
                let Some(block) = history.block(number, z, direction) else {
                    return;
                };
                let part = part & block.seen;
                if part == 0 {
                    return;
                }
                let now = confidences(&block.log_odds);
                for i in 0..LAYER {
                    // C_k[i] = 0 counts as not seen from there.
                    if part >> i & 1 == 1 && block.confidence[i] > 0 {
                        values[i] = (now[i] as f32 / total.confidence[i] as f32).min(1.0);
                    }
                }
            });
        values
    }
}

/// A function of the log-odds; neighbours often have equal ones.
fn by_value(log_odds: &[f32; LAYER], of: impl Fn(f32) -> f32) -> [f32; LAYER] {
    let mut last = (log_odds[0], of(log_odds[0]));
    log_odds.map(|l| {
        if l.to_bits() != last.0.to_bits() {
            last = (l, of(l));
        }
        last.1
    })
}

impl Task<'_> {
    /// The gain of one view. `region` holds all voxels that its rays can meet.
    pub(super) fn ray_average(
        &self,
        lanes: Lanes,
        utility: Utility,
        view: &Pose,
        region: KeyBox,
        pyramid: &Pyramid,
        scratch: &mut Scratch,
    ) -> Result<f64> {
        let octree = self.octree;
        let Some(start) = octree.key(view.translation).filter(|k| region.contains(*k)) else {
            return Ok(0.0);
        };
        let Scratch { field, rays } = scratch;
        field.lay(region)?;
        let resolution = octree.resolution() as f32;
        let utilities = Utilities {
            utility,
            history: octree.view_history(),
            sectors: Sectors::new(view.translation),
            resolution,
            radius: resolution * SIDE as f32 * 0.5 * 3f32.sqrt(),
        };
        // Two voxels to spare: the walk may leave the pyramid by rounding.
        let spare = utilities.radius + 2.0 * resolution;
        let inside = self
            .bounds
            .is_none_or(|b| b.intersection(&region) == region);
        let (low, high): (IVec3, IVec3) = (region.min >> 3, (region.max - 1) >> 3);
        for bz in low.z..=high.z {
            for by in low.y..=high.y {
                for bx in low.x..=high.x {
                    let corner = IVec3::new(bx, by, bz);
                    let key = corner * SIDE;
                    let first = octree.center(key);
                    if !pyramid.touches(view, first + 3.5 * resolution, spare) {
                        continue;
                    }
                    let part = region.intersection(&KeyBox {
                        min: key,
                        max: key + SIDE,
                    });
                    let number = octree
                        .root()
                        .index(corner)
                        .and_then(|c| octree.root().brick(c));
                    let brick = number.map(|n| (n, &octree.bricks()[n]));
                    for z in part.min.z..part.max.z {
                        let mut values = match brick {
                            Some((n, brick)) => {
                                utilities.layer(n, brick, (z - key.z) as usize, first)
                            }
                            None => [UNEXPLORED; LAYER],
                        };
                        if !inside {
                            self.leave_out(&mut values, IVec3::new(key.x, key.y, z));
                        }
                        field.put(&part, key, z, &values);
                    }
                }
            }
        }
        let walk = Walk {
            values: &field.values,
            strides: [1, field.dims.x, field.dims.x * field.dims.y],
            start: field.index(start) as i32,
            steps: (field.dims.x + field.dims.y + field.dims.z) as usize,
            key: start,
            origin: view.translation,
            resolution: octree.resolution(),
            near: f64::from(self.near),
            max_range: f64::from(self.max_range),
        };
        rays.turn(&Mat3::from_quat(view.rotation), &self.directions);
        Ok(walk.mean(lanes, rays))
    }

    /// Voxels outside the bounds count nothing; occupied ones there still end a ray.
    fn leave_out(&self, values: &mut [f32; LAYER], first: IVec3) {
        let Some(bounds) = &self.bounds else { return };
        let inside = mask(|i| bounds.contains(first + IVec3::new(i as i32 & 7, i as i32 >> 3, 0)));
        for (i, value) in values.iter_mut().enumerate() {
            if inside >> i & 1 == 0 {
                *value = if value.is_sign_negative() {
                    WALL
                } else {
                    OUTSIDE
                };
            }
        }
    }
}

/// The cone around a camera's rays, in its own frame.
pub struct Pyramid {
    sides: [Vec3; 4],
    far: f32,
}

impl Pyramid {
    /// From the image's corners, z = 1: upper left, upper right, lower left, lower right.
    pub fn new(corners: &[Vec3; 4], max_range: f32) -> Self {
        let [a, b, c, d] = *corners;
        Self {
            sides: [a.cross(b), b.cross(d), d.cross(c), c.cross(a)].map(|n| {
                let n = n.normalize();
                // Inwards: the optical axis is inside.
                if n.z < 0.0 {
                    -n
                } else {
                    n
                }
            }),
            far: max_range,
        }
    }

    fn touches(&self, view: &Pose, center: Vec3, radius: f32) -> bool {
        let p = view.rotation.inverse() * (center - view.translation);
        p.length() <= self.far + radius && self.sides.iter().all(|n| n.dot(p) >= -radius)
    }
}

#[cfg(test)]
mod tests;
