//! Asking the map: voxels of a state, boxes, bounds.
use super::{certainty_units, entropy_units, Brick, Counts, KeyBox, Octree, State};
use super::{SIDE, UNIT, VOXELS};
use crate::error::{Error, Result};
use crate::geometry::{Aabb, IVec3};

/// Most unknown voxels that are listed at once.
const MAX_UNKNOWN: u64 = 1 << 26;

impl Brick {
    /// The voxels of a state as bits.
    pub fn mask(&self, state: State) -> [u64; 8] {
        std::array::from_fn(|word| match state {
            State::Occupied => self.occupied[word],
            State::Free => self.known[word] & !self.occupied[word],
            State::Unknown => !self.known[word],
        })
    }
}

fn push_keys(keys: &mut Vec<IVec3>, corner: IVec3, mask: &[u64; 8]) {
    for (word, mask) in mask.iter().enumerate() {
        let mut bits = *mask;
        while bits != 0 {
            let bit = bits.trailing_zeros() as i32;
            bits &= bits - 1;
            keys.push((corner << 3) + IVec3::new(bit & 7, bit >> 3, word as i32));
        }
    }
}

impl Octree {
    /// Keys of all voxels of a state, bricks in the order in which they were first seen; of unknown ones those that share
    /// a brick with a voxel that was seen.
    pub fn keys(&self, state: State) -> Vec<IVec3> {
        let mut keys = Vec::new();
        for (brick, corner) in self.bricks.iter().zip(&self.coordinates) {
            push_keys(&mut keys, *corner, &brick.mask(state));
        }
        keys
    }

    /// Keys of the voxels of a state in a box; bricks in the order in which they were first seen, for unknown voxels by
    /// z, y, x.
    pub fn keys_in(&self, state: State, voxels: &KeyBox) -> Result<Vec<IVec3>> {
        let mut keys = Vec::new();
        if state != State::Unknown {
            for (brick, corner) in self.bricks.iter().zip(&self.coordinates) {
                let inside = voxels.mask(*corner);
                let mask = brick.mask(state);
                push_keys(
                    &mut keys,
                    *corner,
                    &std::array::from_fn(|w| mask[w] & inside[w]),
                );
            }
            return Ok(keys);
        }
        let [unknown, ..] = self.counts_in(voxels);
        if unknown > MAX_UNKNOWN {
            return Err(Error::invalid(format!(
                "the box holds {unknown} unknown voxels, more than the {MAX_UNKNOWN} that are listed"
            )));
        }
        keys.reserve(unknown as usize);
        let (low, high) = voxels.bricks();
        for z in low.z..high.z {
            for y in low.y..high.y {
                for x in low.x..high.x {
                    let corner = IVec3::new(x, y, z);
                    let brick = self.brick_of(corner << 3).unwrap_or(&Brick::EMPTY);
                    let (mask, inside) = (brick.mask(state), voxels.mask(corner));
                    push_keys(
                        &mut keys,
                        corner,
                        &std::array::from_fn(|w| mask[w] & inside[w]),
                    );
                }
            }
        }
        Ok(keys)
    }

    /// How many voxels of a box are unknown, free and occupied.
    pub fn counts_in(&self, voxels: &KeyBox) -> [u64; 3] {
        let (mut known, mut occupied) = (0u64, 0u64);
        for (brick, corner) in self.bricks.iter().zip(&self.coordinates) {
            for (word, mask) in voxels.mask(*corner).iter().enumerate() {
                known += u64::from((brick.known[word] & mask).count_ones());
                occupied += u64::from((brick.occupied[word] & mask).count_ones());
            }
        }
        [voxels.volume() - known, known - occupied, occupied]
    }

    /// The box of all bricks with a known voxel, metres; empty for an empty map.
    pub fn bounds(&self) -> Aabb {
        let side = (self.resolution * f64::from(SIDE)) as f32;
        let seen = self.bricks.iter().zip(&self.coordinates);
        seen.filter(|(b, _)| b.known != [0; 8])
            .fold(Aabb::EMPTY, |bounds, (_, corner)| {
                let low = corner.as_vec3() * side;
                bounds.union(&Aabb::new(low, low + side))
            })
    }

    /// The counts, counted again from the voxels: (known, occupied, entropy in bits, information). For tests.
    pub fn recount(&self) -> (u64, u64, f64, f64) {
        let mut c = Counts::default();
        for brick in &self.bricks {
            for voxel in 0..VOXELS {
                let state = brick.state(voxel);
                if state != State::Unknown {
                    c.known += 1;
                    c.entropy += entropy_units(brick.log_odds[voxel]);
                }
                if state == State::Occupied {
                    c.occupied += 1;
                    c.information += certainty_units(self.brick_uncertainty(brick, voxel));
                }
            }
        }
        (
            c.known,
            c.occupied,
            c.entropy as f64 / UNIT,
            c.information as f64 / UNIT,
        )
    }
}
