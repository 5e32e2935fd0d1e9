//! What each voxel is worth, as seen from one position: Eq. 3 and its simpler relatives, a brick at a time.
use super::field::{encoded, IGNORED, UNEXPLORED, WALL};
use crate::belief::octree::{entropy_units, probability, Brick, KeyBox, SIDE};
use crate::belief::view_history::sectors::{Column, Sectors};
use crate::belief::view_history::{self, layer_of, Total, ViewHistory, LAYER, UNIT};
use crate::geometry::{IVec3, Vec3};

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

pub struct Utilities<'a> {
    pub utility: Utility,
    pub history: Option<&'a ViewHistory>,
    pub sectors: Sectors,
    pub resolution: f32,
    /// Of a ball around a brick, metres.
    pub radius: f32,
    /// The voxels that rays may meet, and those that count.
    pub region: KeyBox,
    pub bounds: Option<KeyBox>,
}

impl Utilities<'_> {
    /// Fill `out` with the encoded utilities of a brick's voxels. `key` is the brick's first voxel, `first` its centre, `brick` its
    /// number and content if the map holds it. One source, compiled for each kind of lanes.
    #[inline(always)]
    pub fn brick(&self, key: IVec3, first: Vec3, brick: Option<(usize, &Brick)>, out: &mut [u32]) {
        let whole = KeyBox {
            min: key,
            max: key + SIDE,
        };
        let inside = |part: &KeyBox| part.intersection(&whole) == whole;
        let cut = !(inside(&self.region) && self.bounds.as_ref().is_none_or(inside));
        let unexplored = self.utility.of_unexplored();
        let Some((number, brick)) = brick else {
            out.fill(encoded(unexplored));
            if cut {
                for (z, out) in out.chunks_exact_mut(LAYER).enumerate() {
                    self.cut(key + IVec3::Z * z as i32, &mut [unexplored; LAYER], out);
                }
            }
            return;
        };
        if let Some(history) = self.history {
            history.prefetch(number);
        }
        let mut column = None;
        for (z, out) in out.chunks_exact_mut(LAYER).enumerate() {
            let mut values = self.layer(number, brick, z, first, &mut column);
            if cut {
                self.cut(key + IVec3::Z * z as i32, &mut values, out);
                continue;
            }
            for (out, value) in out.iter_mut().zip(&values) {
                *out = encoded(*value);
            }
        }
    }

    #[inline(always)]
    fn layer(
        &self,
        number: usize,
        brick: &Brick,
        z: usize,
        first: Vec3,
        column: &mut Option<Column>,
    ) -> [f32; LAYER] {
        let unexplored = self.utility.of_unexplored();
        let known = brick.known[z];
        if known == 0 {
            return [unexplored; LAYER];
        }
        let log_odds = layer_of(&brick.log_odds, z);
        let mut values = match self.utility {
            Utility::ViewHistory => {
                let total = self.history.and_then(|h| Some((h, h.total(number, z)?)));
                match total {
                    None => [1.0; LAYER],
                    Some((history, total)) => {
                        let column = column.get_or_insert_with(|| {
                            self.sectors.column(first, self.resolution, self.radius)
                        });
                        let height = first.z + z as f32 * self.resolution;
                        self.seen(history, total, number, z, column, height, known)
                    }
                }
            }
            Utility::Entropy => {
                by_value(log_odds, |l| entropy_units(l) as f32 / (1u64 << 32) as f32)
            }
            Utility::Probability => by_value(log_odds, |l| {
                (1.0 - (2.0 * probability(l) - 1.0).abs()) as f32
            }),
        };
        let occupied = brick.occupied[z];
        if known != u64::MAX || occupied != 0 {
            for (row, values) in values.chunks_exact_mut(16).enumerate() {
                let (known, occupied) = (known >> (16 * row), occupied >> (16 * row));
                for (i, value) in values.iter_mut().enumerate() {
                    let sign = (occupied as u32 >> i & 1) << 31;
                    let signed = f32::from_bits(value.to_bits() ^ sign);
                    *value = if known as u32 >> i & 1 == 1 {
                        signed
                    } else {
                        unexplored
                    };
                }
            }
        }
        values
    }

    /// Eq. 3. `height` is the z of the layer's centres.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)]
    fn seen(
        &self,
        history: &ViewHistory,
        total: &Total,
        number: usize,
        z: usize,
        column: &Column,
        height: f32,
        known: u64,
    ) -> [f32; LAYER] {
        // 1, or c(O_k[i]) where the voxel was seen from here; C_k[i] = 0 counts as not seen.
        let mut confidence = [UNIT; LAYER];
        let voxels = known & total.seen;
        for (direction, part) in self.sectors.split(column, height, voxels).iter() {
            let Some((sight, block)) = history.block(number, z, direction) else {
                continue;
            };
            let part = part & sight.confident;
            if part == 0 {
                continue;
            }
            // Neighbours in free space have the same log-odds, mostly.
            let one = block.log_odds[part.trailing_zeros() as usize];
            if !all_are(one, &block.log_odds, part) {
                confidences_of(&block.log_odds, part, &mut confidence);
                continue;
            }
            let now = view_history::confidence(one);
            for (row, confidence) in confidence.chunks_exact_mut(16).enumerate() {
                let part = (part >> (16 * row)) as u32;
                for (i, confidence) in confidence.iter_mut().enumerate() {
                    if part >> i & 1 == 1 {
                        *confidence = now;
                    }
                }
            }
        }
        let mut values = [1.0; LAYER];
        for (i, value) in values.iter_mut().enumerate() {
            // A sum of 0: never seen, or only at p = 1/2.
            let utility = confidence[i] as f32 / total.confidence[i] as f32;
            *value = if utility < 1.0 { utility } else { 1.0 };
        }
        values
    }

    /// The values of a layer that is not whole within region and bounds: beyond the region stands a wall; voxels outside the
    /// bounds count nothing, and occupied ones there still end a ray.
    #[inline(never)]
    fn cut(&self, first: IVec3, values: &mut [f32; LAYER], out: &mut [u32]) {
        for (i, (value, out)) in values.iter().zip(out).enumerate() {
            let key = first + IVec3::new(i as i32 & 7, i as i32 >> 3, 0);
            let outside = |part: &KeyBox| !part.contains(key);
            *out = encoded(
                if outside(&self.region)
                    || value.is_sign_negative() && self.bounds.as_ref().is_some_and(outside)
                {
                    WALL
                } else if self.bounds.as_ref().is_some_and(outside) {
                    IGNORED
                } else {
                    *value
                },
            );
        }
    }
}

/// Do all voxels of `part` have these log-odds?
#[inline(always)]
fn all_are(one: f32, log_odds: &[f32; LAYER], part: u64) -> bool {
    let mut others = 0;
    for (row, log_odds) in log_odds.chunks_exact(16).enumerate() {
        let part = (part >> (16 * row)) as u32;
        for (i, log_odds) in log_odds.iter().enumerate() {
            others |= (part >> i & 1) * u32::from(log_odds.to_bits() != one.to_bits());
        }
    }
    others == 0
}

/// c(O_k[i]) of the voxels of `part`.
#[inline(never)]
fn confidences_of(log_odds: &[f32; LAYER], part: u64, out: &mut [u32; LAYER]) {
    let mut last = (0, view_history::confidence(0.0));
    let mut left = part;
    while left != 0 {
        let i = left.trailing_zeros() as usize;
        left &= left - 1;
        if log_odds[i].to_bits() != last.0 {
            last = (log_odds[i].to_bits(), view_history::confidence(log_odds[i]));
        }
        out[i] = last.1;
    }
}

/// A function of the log-odds; neighbours often have equal ones.
#[inline(always)]
fn by_value(log_odds: &[f32; LAYER], of: impl Fn(f32) -> f32) -> [f32; LAYER] {
    let mut last = (log_odds[0], of(log_odds[0]));
    log_odds.map(|l| {
        if l.to_bits() != last.0.to_bits() {
            last = (l, of(l));
        }
        last.1
    })
}
