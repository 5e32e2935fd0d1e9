//! Changing the map by hand: setting, forgetting, ageing.
use super::{
    certainty_units, entropy_units, Brick, BrickUpdate, Counts, KeyBox, Octree, SensorModel, State,
    NONE, VOXELS,
};
use crate::error::{Error, Result};
use crate::geometry::IVec3;

/// A brick that comes from elsewhere, e.g. from a file.
pub struct NewBrick {
    /// Brick coordinates (voxel key >> 3).
    pub corner: IVec3,
    pub known: [u64; 8],
    pub occupied: [u64; 8],
    /// Read where known.
    pub log_odds: [f32; VOXELS],
    /// Read where known; `None` if no surface was seen in the brick.
    pub uncertainty: Option<[f32; VOXELS]>,
}

impl Octree {
    /// Put a whole brick into the map. It must not be there yet and must lie in the reserved box; every value must be one
    /// that the map could have come to by itself.
    pub fn insert(&mut self, new: &NewBrick) -> Result<()> {
        let wrong = |what: String| Err(Error::invalid(format!("brick {}: {what}", new.corner)));
        let Some(cell) = self.root.index(new.corner) else {
            return wrong("it lies outside the reserved box".to_owned());
        };
        if self.root.brick(cell).is_some() {
            return wrong("it stands there twice".to_owned());
        }
        let mask = self.limits.map_or([u64::MAX; 8], |l| l.mask(new.corner));
        let mut brick = Brick {
            known: new.known,
            occupied: new.occupied,
            ..Brick::EMPTY
        };
        let mut counts = Counts::default();
        for (word, mask) in mask.iter().enumerate() {
            if new.occupied[word] & !new.known[word] != 0 || new.known[word] & !mask != 0 {
                return wrong(
                    "occupied voxels are unknown, or known ones outside the limits".to_owned(),
                );
            }
            let mut bits = new.known[word];
            while bits != 0 {
                let voxel = word * 64 + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let log_odds = new.log_odds[voxel];
                let occupied = brick.state(voxel) == State::Occupied;
                let range = self.sensor.clamp_min..=self.sensor.clamp_max;
                if !range.contains(&log_odds) || (log_odds >= 0.0) != occupied {
                    return wrong(format!("voxel {voxel} has the log-odds {log_odds}"));
                }
                brick.log_odds[voxel] = log_odds;
                let uncertainty = new.uncertainty.map_or(1.0, |u| u[voxel]);
                if !(0.0..=1.0).contains(&uncertainty) {
                    return wrong(format!("voxel {voxel} has the uncertainty {uncertainty}"));
                }
                counts.known += 1;
                counts.entropy += entropy_units(log_odds);
                if occupied {
                    counts.occupied += 1;
                    counts.information += certainty_units(uncertainty);
                }
            }
        }
        if let Some(seen) = new.uncertainty {
            brick.uncertainty = self.uncertainty.len() as u32;
            let value = |v: usize| {
                if new.known[v >> 6] >> (v & 63) & 1 == 1 {
                    seen[v]
                } else {
                    1.0
                }
            };
            self.uncertainty.push(std::array::from_fn(value));
        }
        let number = self.bricks.len();
        if let Some(changes) = &mut self.changes {
            changes.note(number, new.corner, &Brick::EMPTY);
        }
        self.root.cells[cell] = number as u32;
        self.root.summaries[cell] = brick.summary() as u8;
        self.bricks.push(brick);
        self.coordinates.push(new.corner);
        self.counts.known += counts.known;
        self.counts.occupied += counts.occupied;
        self.counts.entropy += counts.entropy;
        self.counts.information += counts.information;
        Ok(())
    }

    /// Forget everything, keep the memory.
    pub fn clear(&mut self) {
        if let Some(changes) = &mut self.changes {
            for (number, brick) in self.bricks.iter().enumerate() {
                changes.note(number, self.coordinates[number], brick);
            }
            changes.renumber();
        }
        self.root.cells.fill(NONE);
        self.root.summaries.fill(0);
        self.bricks.clear();
        self.coordinates.clear();
        self.uncertainty.clear();
        self.counts = Counts::default();
        if let Some(history) = &mut self.history {
            history.clear();
        }
    }

    /// Make the voxels of a box unknown again.
    pub fn clear_box(&mut self, voxels: &KeyBox) {
        for number in 0..self.bricks.len() {
            let corner = self.coordinates[number];
            self.forget(corner, &voxels.mask(corner));
        }
    }

    /// Let knowledge age: every known voxel's log-odds is multiplied by `factor`, and a voxel whose absolute log-odds
    /// falls below `forget_below` becomes unknown. Only voxels in `voxels`, if given.
    ///
    /// After n calls a voxel that nothing was seen of has factor^n of its log-odds; for a half-life of h seconds take
    /// 0.5^(dt / h). States change to unknown only: the sign stays. The uncertainty of what is not forgotten stays, too.
    pub fn decay(&mut self, factor: f32, forget_below: f32, voxels: Option<&KeyBox>) -> Result<()> {
        if !(0.0..=1.0).contains(&factor) {
            return Err(Error::invalid(format!(
                "factor must lie in [0, 1], got {factor}"
            )));
        }
        if !(forget_below.is_finite() && forget_below > 0.0) {
            return Err(Error::invalid(format!(
                "forget_below must be a finite log-odds > 0, got {forget_below}"
            )));
        }
        for number in 0..self.bricks.len() {
            let corner = self.coordinates[number];
            let inside = voxels.map_or([u64::MAX; 8], |v| v.mask(corner));
            let brick = &mut self.bricks[number];
            let mut forgotten = [0; 8];
            for word in 0..8 {
                let mut bits = brick.known[word] & inside[word];
                while bits != 0 {
                    let bit = bits.trailing_zeros();
                    bits &= bits - 1;
                    let log_odds = &mut brick.log_odds[word * 64 + bit as usize];
                    let aged = *log_odds * factor;
                    if aged.abs() < forget_below {
                        forgotten[word] |= 1 << bit;
                    } else {
                        self.counts.entropy -= entropy_units(*log_odds);
                        self.counts.entropy += entropy_units(aged);
                        *log_odds = aged;
                    }
                }
            }
            self.forget(corner, &forgotten);
        }
        Ok(())
    }

    /// Make a cube of voxels (its lowest corner and side) known with a value; the log-odds are clamped.
    /// The cube must lie in the reserved box; voxels outside the map's limits stay unknown.
    pub fn set_cube(&mut self, corner: IVec3, side: i32, log_odds: f32) {
        let cube = KeyBox {
            min: corner,
            max: corner + side,
        };
        let (low, high): (IVec3, IVec3) = (corner >> 3, (corner + side - 1) >> 3);
        let value = log_odds.clamp(self.sensor.clamp_min, self.sensor.clamp_max);
        // One "hit" of the right size on voxels that were forgotten before.
        let sensor = self.sensor;
        self.sensor = SensorModel {
            miss: value,
            ..sensor
        };
        for z in low.z..=high.z {
            for y in low.y..=high.y {
                for x in low.x..=high.x {
                    let brick = IVec3::new(x, y, z);
                    let free = cube.mask(brick);
                    self.forget(brick, &free);
                    self.apply(&BrickUpdate {
                        brick,
                        free,
                        hit: [0; 8],
                        uncertainty: None,
                    });
                }
            }
        }
        self.sensor = sensor;
    }

    /// Make voxels of a brick unknown again.
    pub fn forget(&mut self, brick: IVec3, voxels: &[u64; 8]) {
        let Some(cell) = self.root.index(brick) else {
            return;
        };
        let Some(number) = self.root.brick(cell) else {
            return;
        };
        if voxels
            .iter()
            .zip(&self.bricks[number].known)
            .all(|(v, k)| v & k == 0)
        {
            return;
        }
        if let Some(history) = &mut self.history {
            history.forget(number, voxels);
        }
        if let Some(changes) = &mut self.changes {
            changes.note(number, brick, &self.bricks[number]);
        }
        for (word, mask) in voxels.iter().enumerate() {
            let mut bits = mask & self.bricks[number].known[word];
            while bits != 0 {
                let bit = bits.trailing_zeros();
                bits &= bits - 1;
                let voxel = word * 64 + bit as usize;
                let brick = &mut self.bricks[number];
                self.counts.known -= 1;
                self.counts.entropy -= entropy_units(brick.log_odds[voxel]);
                brick.log_odds[voxel] = 0.0;
                let block = self.uncertainty.get_mut(brick.uncertainty as usize);
                let occupied = brick.occupied[word] >> bit & 1 == 1;
                self.counts.occupied -= u64::from(occupied);
                if let Some(block) = block {
                    if occupied {
                        self.counts.information -= certainty_units(block[voxel]);
                    }
                    block[voxel] = 1.0;
                }
                brick.known[word] &= !(1 << bit);
                brick.occupied[word] &= !(1 << bit);
            }
        }
        self.root.summaries[cell] = self.bricks[number].summary() as u8;
    }
}
