//! The voxel of a state that is nearest to a point.
use super::{Brick, Octree, State, Summary, KEY_LIMIT, SIDE};
use crate::error::Result;
use crate::geometry::{IVec3, Vec3};
use crate::interrupt;

/// The best voxel so far; distances in voxels.
struct Best {
    squared: f64,
    key: Option<IVec3>,
}

impl Octree {
    /// The voxel of a state whose centre is nearest to `point`, and its distance in metres, if it is not farther than
    /// `max_range`; of equally near ones the first by z, y, x. `None` if there is none, or if the point is not finite or
    /// outside the key space. With limits, voxels outside them do not count as unknown. Fails only if it is interrupted.
    ///
    /// Exact: shells of bricks around the point, until no farther one can hold a nearer voxel.
    pub fn nearest(
        &self,
        point: Vec3,
        state: State,
        max_range: f64,
    ) -> Result<Option<(IVec3, f64)>> {
        let (Some(key), Some((low, high))) = (self.key(point), self.extent(state)) else {
            return Ok(None);
        };
        let home: IVec3 = key >> 3;
        let at = point.as_dvec3() * self.inverse;
        let reach = (max_range * self.inverse).max(0.0);
        let mut best = Best {
            squared: reach * reach,
            key: None,
        };
        let side = f64::from(SIDE);
        let outside: IVec3 = (low - home).max(home - (high - 1));
        let first = outside.max_element().max(0);
        let last = (home - low).max(high - 1 - home).max_element();
        for shell in first..=last {
            interrupt::check()?;
            // No voxel centre of this shell or a farther one is nearer.
            let below = at - (home - shell + 1).as_dvec3() * side;
            let above = (home + shell).as_dvec3() * side - at;
            let bound = below.min(above).min_element() + 0.5;
            if shell > 0 && bound > 0.0 && bound * bound > best.squared {
                break;
            }
            let (from, to) = ((home - shell).max(low), (home + shell).min(high - 1));
            for z in from.z..=to.z {
                for y in from.y..=to.y {
                    let whole_row = (z - home.z).abs() == shell || (y - home.y).abs() == shell;
                    let step = if whole_row { 1 } else { (2 * shell).max(1) };
                    let start = if whole_row { from.x } else { home.x - shell };
                    for x in (start..=to.x).step_by(step as usize) {
                        if x >= from.x {
                            self.nearest_in(IVec3::new(x, y, z), at, state, &mut best);
                        }
                    }
                }
            }
        }
        Ok(best
            .key
            .map(|key| (key, best.squared.sqrt() * self.resolution)))
    }

    /// Bricks that may hold voxels of a state: the first, and the one after the last.
    fn extent(&self, state: State) -> Option<(IVec3, IVec3)> {
        let (known, occupied) = (self.counts.known, self.counts.occupied);
        match (state, self.limits) {
            (State::Occupied, _) if occupied == 0 => None,
            (State::Free, _) if known == occupied => None,
            (State::Unknown, Some(limits)) => (limits.volume() > known).then(|| limits.bricks()),
            (State::Unknown, None) => {
                let limit = IVec3::splat(KEY_LIMIT / SIDE);
                Some((-limit, limit))
            }
            _ => Some((self.root.origin, self.root.origin + self.root.dims)),
        }
    }

    fn nearest_in(&self, corner: IVec3, at: glam::DVec3, state: State, best: &mut Best) {
        let cell = self.root.index(corner);
        let summary = cell.map_or(Summary::Unknown, |c| self.root.summary(c));
        if matches!(
            (state, summary),
            (State::Occupied, Summary::Free | Summary::Unknown)
                | (State::Free, Summary::Unknown)
                | (State::Unknown, Summary::Free)
        ) {
            return;
        }
        // From the point to the nearest and the farthest corner of the box of the brick's voxel centres.
        let first: IVec3 = corner << 3;
        let low = first.as_dvec3() + 0.5;
        let gap = (low - at).max(at - (low + f64::from(SIDE - 1)));
        if gap.max(glam::DVec3::ZERO).length_squared() > best.squared {
            return;
        }
        let brick = cell
            .and_then(|c| self.root.brick(c))
            .map(|b| &self.bricks[b]);
        let mut mask = brick.unwrap_or(&Brick::EMPTY).mask(state);
        if let (State::Unknown, Some(limits)) = (state, self.limits) {
            let inside = limits.mask(corner);
            mask.iter_mut().zip(inside).for_each(|(m, i)| *m &= i);
        }
        for (word, mask) in mask.into_iter().enumerate() {
            let dz = low.z + word as f64 - at.z;
            let mut bits = if dz * dz > best.squared { 0 } else { mask };
            while bits != 0 {
                let bit = bits.trailing_zeros() as i32;
                bits &= bits - 1;
                let key = first + IVec3::new(bit & 7, bit >> 3, word as i32);
                let squared = (key.as_dvec3() + 0.5 - at).length_squared();
                let order = |k: IVec3| (k.z, k.y, k.x);
                let nearer = squared < best.squared
                    || squared == best.squared && best.key.is_none_or(|b| order(key) < order(b));
                if nearer {
                    *best = Best {
                        squared,
                        key: Some(key),
                    };
                }
            }
        }
    }
}
