//! Walking a ray through the map, voxel by voxel (Amanatides & Woo 1987), with OctoMap's arithmetic, so that both
//! meet the same voxels in the same order.
use super::octree::{voxel_in_brick, Brick, Octree, State, Summary, KEY_LIMIT};
use crate::geometry::{IVec3, Vec3};

/// One voxel on a ray.
pub struct Cell<'a> {
    pub key: IVec3,
    pub state: State,
    /// Distance from the origin to where the ray enters the voxel, in metres.
    pub entry: f64,
    /// `None` in a brick of which nothing is known.
    pub brick: Option<&'a Brick>,
}

impl Cell<'_> {
    /// 0 (p = 0.5) where unknown.
    #[inline]
    pub fn log_odds(&self) -> f32 {
        match (self.state, self.brick) {
            (State::Unknown, _) | (_, None) => 0.0,
            (_, Some(brick)) => brick.log_odds[voxel_in_brick(self.key)],
        }
    }
}

/// The state of a walk between two voxels, in f64 as OctoMap keeps it.
#[derive(Clone, Copy)]
pub struct Dda {
    pub key: IVec3,
    pub step: IVec3,
    pub t_max: [f64; 3],
    pub t_delta: [f64; 3],
}

impl Dda {
    /// `direction` has unit length. `key` is the voxel that holds `origin`.
    #[inline]
    pub fn new(resolution: f64, key: IVec3, origin: Vec3, direction: Vec3) -> Self {
        let mut dda = Self {
            key,
            step: IVec3::ZERO,
            t_max: [f64::MAX; 3],
            t_delta: [f64::MAX; 3],
        };
        for axis in 0..3 {
            let d = direction[axis];
            let step = if d > 0.0 {
                1
            } else if d < 0.0 {
                -1
            } else {
                continue;
            };
            dda.step[axis] = step;
            let center = (f64::from(key[axis]) + 0.5) * resolution;
            let border = center + f64::from((f64::from(step) * resolution * 0.5) as f32);
            dda.t_max[axis] = (border - f64::from(origin[axis])) / f64::from(d);
            dda.t_delta[axis] = resolution / f64::from(d.abs());
        }
        dda
    }

    /// Go to the next voxel; returns the distance at which it is entered.
    #[inline]
    pub fn advance(&mut self) -> f64 {
        let t = self.t_max;
        let axis = if t[0] < t[1] {
            if t[0] < t[2] {
                0
            } else {
                2
            }
        } else if t[1] < t[2] {
            1
        } else {
            2
        };
        self.key[axis] += self.step[axis];
        self.t_max[axis] += self.t_delta[axis];
        t[axis]
    }

    /// Distance at which the current voxel is left.
    #[inline]
    pub fn exit(&self) -> f64 {
        self.t_max[0].min(self.t_max[1]).min(self.t_max[2])
    }
}

/// Inverse lengths between this and its inverse are exact to a rounding.
pub const MIN_SCALE: f32 = 1e-15;

/// A direction with length 1; `None` of one that is zero or not finite.
#[inline]
pub fn unit(direction: Vec3) -> Option<Vec3> {
    let scale = direction.length_recip();
    if scale > MIN_SCALE && scale < 1.0 / MIN_SCALE {
        return Some(direction * scale);
    }
    // The squares lose digits, or all. By its largest component (twice: the inverse of the least numbers is infinite).
    let large = |d: Vec3| d / d.abs().max_element();
    direction
        .is_finite()
        .then(|| large(direction * if scale > 1.0 { 1e30 } else { 1.0 }))
        .and_then(Vec3::try_normalize)
}

impl Octree {
    /// Visit the voxels along the ray from the one that holds `origin` until `visit` returns `false` or a voxel is
    /// entered beyond `max_range`. `direction` is normalised here; a zero or non-finite one visits nothing.
    /// Returns `true` if `visit` stopped the walk. With `SKIP_FREE` bricks that are all free are passed over unvisited.
    #[inline]
    pub fn walk<const SKIP_FREE: bool>(
        &self,
        origin: Vec3,
        direction: Vec3,
        max_range: f64,
        mut visit: impl FnMut(&Cell) -> bool,
    ) -> bool {
        let (Some(key), Some(unit)) = (self.key(origin), unit(direction)) else {
            return false;
        };
        let mut dda = Dda::new(self.resolution(), key, origin, unit);
        let mut entry = 0.0;
        loop {
            let corner = dda.key >> 3;
            let cell = self.root().index(corner);
            let summary = cell.map_or(Summary::Unknown, |c| self.root().summary(c));
            if SKIP_FREE && summary == Summary::Free {
                while dda.key >> 3 == corner {
                    entry = dda.advance();
                    if entry > max_range {
                        return false;
                    }
                }
                continue;
            }
            let brick = cell
                .and_then(|c| self.root().brick(c))
                .map(|b| &self.bricks()[b]);
            while dda.key >> 3 == corner {
                let state = brick.map_or(State::Unknown, |b| b.state(voxel_in_brick(dda.key)));
                if !visit(&Cell {
                    key: dda.key,
                    state,
                    entry,
                    brick,
                }) {
                    return true;
                }
                entry = dda.advance();
                if entry > max_range || dda.key.abs().max_element() > KEY_LIMIT {
                    return false;
                }
            }
        }
    }

    /// First occupied voxel (or, unless `ignore_unknown`, first unknown one) along the ray: the range in metres at
    /// which it is entered and its state; (`max_range`, `Free`) if there is none within `max_range`, (NaN, `Unknown`) if origin or
    /// direction make no ray.
    pub fn cast_ray(
        &self,
        origin: Vec3,
        direction: Vec3,
        max_range: f64,
        ignore_unknown: bool,
    ) -> (f64, State) {
        if unit(direction).is_none() || !origin.is_finite() {
            return (f64::NAN, State::Unknown);
        }
        let mut found = (max_range, State::Free);
        let mut visit = |cell: &Cell| match cell.state {
            State::Occupied => {
                found = (cell.entry, State::Occupied);
                false
            }
            State::Unknown if !ignore_unknown => {
                found = (cell.entry, State::Unknown);
                false
            }
            _ => true,
        };
        self.walk::<true>(origin, direction, max_range, &mut visit);
        found
    }
}
