//! Gains that average utilities along rays (Wang et al. 2019, section III-B).
//!
//! A ray's utility is the mean utility of its visible voxels: those from the sensor's minimum range up to, and with, the
//! first occupied one, or up to the maximum range. A view's gain is the mean over its rays, in [0, 1]. What differs is the
//! utility of a voxel:
//!
//! - `view_history` (InfoGain), Eq. 3: 1 if it was never seen, else `1 / sum C_k` if it was never seen from the candidate's
//!   direction and `c(O_k[i]) / sum C_k` if it was; at most 1 (the sum is small for voxels seen at p = 1/2). A ray that meets
//!   an unexplored voxel has utility 1.
//! - `ray_entropy` (BaseGain-E): H(p), without a memory of directions. Unexplored voxels count nothing: "the standard octomap
//!   structure" has no node for them, and with the rule above BaseGain explores and does not "saturate due to being stuck
//!   at a local area", as the paper reports (docs/wang2019.md).
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
/// Counts nothing, the ray goes on: what lies outside the exploration bounds.
const IGNORED: f32 = 3.0;
/// Counts nothing and ends the ray.
const WALL: f32 = -4.0;
/// Not computed yet.
const UNFILLED: f32 = 5.0;

/// Most voxels of a field, 4 bytes each.
const MAX_VOXELS: u64 = 1 << 27;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Utility {
    ViewHistory,
    Entropy,
    Probability,
}

impl Utility {
    fn of_unexplored(self) -> f32 {
        match self {
            Self::ViewHistory => UNEXPLORED,
            Self::Entropy | Self::Probability => IGNORED,
        }
    }
}

/// Memory kept from view to view.
#[derive(Default)]
pub struct Scratch {
    field: Field,
    rays: Rays,
}

/// The utilities of the voxels around a view's rays, as seen from the view's position. Rays are stopped by what is occupied or
/// unexplored, mostly long before their range: bricks are filled when a ray first meets them.
#[derive(Default)]
pub struct Field {
    origin: IVec3,
    dims: IVec3,
    /// Index = (z * dims.y + y) * dims.x + x.
    values: Vec<f32>,
    /// What was filled of the view at hand.
    filled: Vec<KeyBox>,
}

impl Field {
    fn index(&self, key: IVec3) -> usize {
        let c = key - self.origin;
        (c.z as usize * self.dims.y as usize + c.y as usize) * self.dims.x as usize + c.x as usize
    }

    fn key(&self, index: usize) -> IVec3 {
        let (nx, ny) = (self.dims.x as usize, self.dims.y as usize);
        let (x, y, z) = (index % nx, index / nx % ny, index / (nx * ny));
        self.origin + IVec3::new(x as i32, y as i32, z as i32)
    }

    /// Lay the field over `region` with a border of walls around it; nothing is filled.
    fn lay(&mut self, region: KeyBox) -> Result<()> {
        if region.volume() > MAX_VOXELS {
            return Err(Error::invalid(format!(
                "a view's rays span {} voxels, more than {MAX_VOXELS}: use a shorter max_range or a coarser map",
                region.volume()
            )));
        }
        // The view before: what it filled is much less than all.
        for part in std::mem::take(&mut self.filled) {
            self.rows(&part, |row, _| row.fill(UNFILLED));
        }
        self.border(UNFILLED);
        self.origin = region.min - 1;
        self.dims = region.max - region.min + 2;
        let voxels = self.dims.as_usizevec3().element_product();
        self.values.resize(voxels, UNFILLED);
        self.border(WALL);
        Ok(())
    }

    fn border(&mut self, value: f32) {
        let [nx, ny, nz] = self.dims.to_array().map(|n| n as usize);
        if self.values.is_empty() {
            return;
        }
        let layer = nx * ny;
        self.values[..layer].fill(value);
        self.values[(nz - 1) * layer..].fill(value);
        for z in 1..nz - 1 {
            let slab = &mut self.values[z * layer..(z + 1) * layer];
            slab[..nx].fill(value);
            slab[layer - nx..].fill(value);
            for y in 1..ny - 1 {
                slab[y * nx] = value;
                slab[(y + 1) * nx - 1] = value;
            }
        }
    }

    /// The rows along x of a box, with their first keys.
    fn rows(&mut self, part: &KeyBox, mut each: impl FnMut(&mut [f32], IVec3)) {
        let length = (part.max.x - part.min.x) as usize;
        for z in part.min.z..part.max.z {
            for y in part.min.y..part.max.y {
                let key = IVec3::new(part.min.x, y, z);
                let at = self.index(key);
                each(&mut self.values[at..at + length], key);
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
            return [self.utility.of_unexplored(); LAYER];
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
                    *value = self.utility.of_unexplored();
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
        let inside = self
            .bounds
            .is_none_or(|b| b.intersection(&region) == region);
        let walk = Walk {
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
        let fill = |field: &mut Field, index: usize| {
            self.fill(field, field.key(index) >> 3, &region, &utilities, inside);
        };
        Ok(walk.mean(lanes, rays, field, fill))
    }

    /// Compute the utilities of a brick's voxels within `region`.
    fn fill(
        &self,
        field: &mut Field,
        corner: IVec3,
        region: &KeyBox,
        utilities: &Utilities,
        inside: bool,
    ) {
        let octree = self.octree;
        let key = corner * SIDE;
        let first = octree.center(key);
        let brick = octree
            .root()
            .index(corner)
            .and_then(|c| octree.root().brick(c))
            .map(|n| (n, &octree.bricks()[n]));
        let part = region.intersection(&KeyBox {
            min: key,
            max: key + SIDE,
        });
        field.filled.push(part);
        let unexplored = [utilities.utility.of_unexplored(); LAYER];
        let (mut layer, mut values) = (i32::MIN, unexplored);
        field.rows(&part, |row, at| {
            if layer != at.z {
                layer = at.z;
                values = match brick {
                    Some((n, brick)) => utilities.layer(n, brick, (at.z - key.z) as usize, first),
                    None => unexplored,
                };
                if !inside {
                    self.leave_out(&mut values, IVec3::new(key.x, key.y, at.z));
                }
            }
            let from = ((at.y - key.y) * SIDE + at.x - key.x) as usize;
            row.copy_from_slice(&values[from..from + row.len()]);
        });
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
                    IGNORED
                };
            }
        }
    }
}

#[cfg(test)]
mod tests;
