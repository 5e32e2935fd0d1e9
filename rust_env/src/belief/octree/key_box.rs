//! Boxes of voxels.
use super::{Octree, KEY_LIMIT, SIDE};
use crate::geometry::{Aabb, IVec3, Vec3};

/// The voxels `min <= key < max`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeyBox {
    pub min: IVec3,
    pub max: IVec3,
}

impl KeyBox {
    /// Neutral for `union`. (Corners are within +-2^16, so that sides and volumes cannot overflow.)
    pub const EMPTY: KeyBox = KeyBox {
        min: IVec3::splat(1 << 16),
        max: IVec3::splat(-(1 << 16)),
    };

    /// All voxels that a box in metres touches.
    pub fn touching(octree: &Octree, bounds: &Aabb) -> Self {
        if bounds.is_empty() {
            return Self::EMPTY;
        }
        let limit = IVec3::splat((1 << 16) - 16);
        let key = |p: Vec3| {
            IVec3::new(octree.key_of(p.x), octree.key_of(p.y), octree.key_of(p.z))
                .clamp(-limit, limit)
        };
        Self {
            min: key(bounds.min),
            max: key(bounds.max) + 1,
        }
    }

    /// The voxels of OctoMap's key space whose centres lie in a box in metres, the upper faces included.
    pub fn centered_in(octree: &Octree, bounds: &Aabb) -> Self {
        if bounds.is_empty() {
            return Self::EMPTY;
        }
        let scale = 1.0 / octree.resolution();
        let limit = f64::from(KEY_LIMIT);
        let key = |low: f64| low.clamp(-limit, limit) as i32;
        let (min, max) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
        let (min, max) = (min * scale - 0.5, max * scale - 0.5);
        Self {
            min: IVec3::new(key(min.x.ceil()), key(min.y.ceil()), key(min.z.ceil())),
            max: IVec3::new(
                key(max.x.floor() + 1.0),
                key(max.y.floor() + 1.0),
                key(max.z.floor() + 1.0),
            ),
        }
    }

    /// The bricks that hold a voxel of the box: the first and the one after the last, per axis.
    pub fn bricks(&self) -> (IVec3, IVec3) {
        if self.volume() == 0 {
            return (IVec3::ZERO, IVec3::ZERO);
        }
        (self.min >> 3, ((self.max - 1) >> 3) + 1)
    }

    pub fn union(&self, other: &KeyBox) -> Self {
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    pub fn intersection(&self, other: &KeyBox) -> Self {
        Self {
            min: self.min.max(other.min),
            max: self.max.min(other.max),
        }
    }

    pub fn grown(&self, voxels: i32) -> Self {
        Self {
            min: self.min - voxels,
            max: self.max + voxels,
        }
    }

    pub fn contains(&self, key: IVec3) -> bool {
        key.cmpge(self.min).all() && key.cmplt(self.max).all()
    }

    pub fn volume(&self) -> u64 {
        let d = self.max - self.min;
        d.x.max(0) as u64 * d.y.max(0) as u64 * d.z.max(0) as u64
    }

    /// The bits of brick `brick` that lie in the box.
    pub fn mask(&self, brick: IVec3) -> [u64; 8] {
        let first = brick * SIDE;
        if self.min.cmple(first).all() && (first + SIDE).cmple(self.max).all() {
            return [u64::MAX; 8];
        }
        let low = (self.min - brick * SIDE).clamp(IVec3::ZERO, IVec3::splat(8));
        let high = (self.max - brick * SIDE).clamp(IVec3::ZERO, IVec3::splat(8));
        let mut row = 0u64;
        for x in low.x..high.x {
            row |= 1 << x;
        }
        let mut layer = 0u64;
        for y in low.y..high.y {
            layer |= row << (y * 8);
        }
        std::array::from_fn(|z| {
            if (low.z..high.z).contains(&(z as i32)) {
                layer
            } else {
                0
            }
        })
    }
}
