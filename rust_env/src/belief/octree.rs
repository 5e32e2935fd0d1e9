//! The map: an octree whose leaves are bricks of 8 x 8 x 8 voxels.
//!
//! Every voxel has a state (unknown, free, occupied), a log-odds value (OctoMap's model, f32, bit for bit) and,
//! where something was hit, an uncertainty in [0, 1] (Lluvia 2023, Eq. 8-9). Bricks keep the states as bit masks,
//! so that counting and ray walking touch 64 voxels at a time; the root is a dense grid of brick numbers that
//! grows with the map and carries a summary per brick, so that rays skip known free space.
//!
//! Counts (known, occupied, entropy, information) are kept in integers: the same in whatever order voxels change.
mod changes;
mod edit;
mod key_box;
mod nearest;
mod query;
mod root;
#[cfg(test)]
mod tests;

pub use changes::{Change, States};
pub use edit::NewBrick;
pub use key_box::KeyBox;
pub use root::Root;

use super::lockstep::Lanes;
use super::misses::Misses;
use super::view_history::ViewHistory;
use crate::error::{positive, Error, Result};
use crate::geometry::{Aabb, IVec3, Vec3};
use changes::Changes;
use std::sync::OnceLock;

/// Voxels along a brick's side.
pub const SIDE: i32 = 8;
/// Voxels in a brick. Voxel (x, y, z) of a brick is bit `y * 8 + x` of word `z`.
pub const VOXELS: usize = 512;
/// OctoMap's key space: 16 bits a side, the origin in the middle.
pub const KEY_LIMIT: i32 = 32768;
/// Largest root grid (cells); at 5 cm voxels this is a volume of 4 million cubic metres.
const MAX_ROOT_CELLS: u64 = 1 << 26;
const NONE: u32 = u32::MAX;
/// Fixed-point unit of the entropy and information sums.
const UNIT: f64 = (1u64 << 32) as f64;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i8)]
pub enum State {
    Unknown = -1,
    Free = 0,
    Occupied = 1,
}

/// What a root cell says about its brick without looking into it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Summary {
    /// No voxel of the brick is known.
    Unknown = 0,
    Mixed = 1,
    /// Every voxel of the brick is known and free.
    Free = 2,
}

/// Log-odds of a hit and a miss and the clamps, as OctoMap stores them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorModel {
    pub hit: f32,
    pub miss: f32,
    pub clamp_min: f32,
    pub clamp_max: f32,
}

fn log_odds_of(probability: f64) -> f32 {
    (probability / (1.0 - probability)).ln() as f32
}

impl SensorModel {
    /// From probabilities; OctoMap's defaults are 0.7, 0.4, 0.1192, 0.971.
    pub fn from_probabilities(hit: f64, miss: f64, clamp_min: f64, clamp_max: f64) -> Result<Self> {
        for (name, p, low, high) in [
            ("hit", hit, 0.5, 1.0),
            ("miss", miss, 0.0, 0.5),
            ("clamp_min", clamp_min, 0.0, 0.5),
            ("clamp_max", clamp_max, 0.5, 1.0),
        ] {
            if !(p > low && p < high) {
                return Err(Error::invalid(format!(
                    "{name} must be a probability in ({low}, {high}), got {p}"
                )));
            }
        }
        Ok(Self {
            hit: log_odds_of(hit),
            miss: log_odds_of(miss),
            clamp_min: log_odds_of(clamp_min),
            clamp_max: log_odds_of(clamp_max),
        })
    }
}

impl Default for SensorModel {
    fn default() -> Self {
        Self {
            hit: log_odds_of(0.7),
            miss: log_odds_of(0.4),
            clamp_min: log_odds_of(0.1192),
            clamp_max: log_odds_of(0.971),
        }
    }
}

/// Occupancy probability of a log-odds value.
pub fn probability(log_odds: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(log_odds)).exp())
}

/// Shannon entropy in bits of a cell with this log-odds, in units of 2^-32 bit. Interpolated in a table of |log-odds|:
/// the error is below 1e-6 bit, and equal values always give equal integers.
pub fn entropy_units(log_odds: f32) -> u64 {
    const CELLS: usize = 4096;
    const REACH: f32 = 16.0;
    static TABLE: OnceLock<Vec<f32>> = OnceLock::new();
    let table = TABLE.get_or_init(|| {
        (0..=CELLS + 1)
            .map(|i| {
                let p = 1.0 / (1.0 + (i as f64 * f64::from(REACH) / CELLS as f64).exp());
                (-p * p.log2() - (1.0 - p) * (1.0 - p).log2()) as f32
            })
            .collect()
    });
    let x = log_odds.abs().min(REACH) * (CELLS as f32 / REACH);
    let i = x as usize;
    let h = table[i] + (table[i + 1] - table[i]) * (x - i as f32);
    (f64::from(h) * UNIT) as u64
}

fn certainty_units(uncertainty: f32) -> u64 {
    ((1.0 - f64::from(uncertainty)) * UNIT) as u64
}

#[derive(Clone)]
#[repr(C, align(64))]
pub struct Brick {
    pub known: [u64; 8],
    /// A subset of `known`.
    pub occupied: [u64; 8],
    pub log_odds: [f32; VOXELS],
    /// Number of this brick's block in the uncertainty pool; only bricks with a surface have one.
    uncertainty: u32,
}

impl Brick {
    const EMPTY: Brick = Brick {
        known: [0; 8],
        occupied: [0; 8],
        log_odds: [0.0; VOXELS],
        uncertainty: NONE,
    };

    #[inline]
    pub fn state(&self, voxel: usize) -> State {
        changes::state_of(&self.known, &self.occupied, voxel)
    }

    fn summary(&self) -> Summary {
        if self.known.iter().all(|w| *w == u64::MAX) && self.occupied.iter().all(|w| *w == 0) {
            Summary::Free
        } else if self.known.iter().all(|w| *w == 0) {
            Summary::Unknown
        } else {
            Summary::Mixed
        }
    }
}

/// Which voxels of one brick an image saw as free and as hit, and how certain the hits are.
#[derive(Clone)]
pub struct BrickUpdate<'a> {
    pub brick: IVec3,
    pub free: [u64; 8],
    /// Wins over `free`.
    pub hit: [u64; 8],
    /// Uncertainty of each hit voxel in this image (only set bits of `hit` are read).
    pub uncertainty: Option<&'a [f32; VOXELS]>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Counts {
    known: u64,
    occupied: u64,
    /// Sum of the entropies of the known voxels, in `UNIT`s.
    entropy: u64,
    /// Sum of (1 - uncertainty) over the occupied voxels, in `UNIT`s.
    information: u64,
}

/// Most bricks (of 2.2 kB) that a map with limits has room for from the start.
const RESERVED_BRICKS: usize = 512;

#[derive(Clone)]
pub struct Octree {
    resolution: f64,
    inverse: f64,
    sensor: SensorModel,
    misses: Misses,
    root: Root,
    bricks: Vec<Brick>,
    /// Brick coordinates of each brick.
    coordinates: Vec<IVec3>,
    uncertainty: Vec<[f32; VOXELS]>,
    counts: Counts,
    limits: Option<KeyBox>,
    /// From where the voxels were seen, if the map keeps that.
    history: Option<Box<ViewHistory>>,
    /// Kept once somebody asks what changed.
    changes: Option<Box<Changes>>,
}

/// Voxel number within its brick.
#[inline]
pub fn voxel_in_brick(key: IVec3) -> usize {
    (((key.z & 7) << 6) | ((key.y & 7) << 3) | (key.x & 7)) as usize
}

/// A side of voxels, metres, if keys can count them.
pub fn checked_resolution(resolution: f64) -> Result<f64> {
    positive("resolution", resolution)?;
    if (1e-4..=1e3).contains(&resolution) {
        return Ok(resolution);
    }
    Err(Error::invalid(format!(
        "resolution must lie in [1e-4, 1e3] m, got {resolution:?}"
    )))
}

impl Octree {
    pub fn new(resolution: f64, sensor: SensorModel) -> Result<Self> {
        Ok(Self {
            resolution: checked_resolution(resolution)?,
            inverse: 1.0 / resolution,
            misses: Misses::new(Lanes::best(), &sensor),
            sensor,
            root: Root::default(),
            bricks: Vec::new(),
            coordinates: Vec::new(),
            uncertainty: Vec::new(),
            counts: Counts::default(),
            limits: None,
            history: None,
            changes: None,
        })
    }

    /// A map that knows nothing and has no limits, with the memory of this one.
    pub fn emptied(mut self) -> Self {
        self.changes = None;
        self.root = Root::default();
        self.clear();
        self.limits = None;
        self
    }

    /// Keep for every voxel from where it was seen ([`Self::record_view`]).
    pub fn with_view_history(mut self) -> Self {
        self.history = Some(Box::default());
        self
    }

    /// The same with what was seen before, of this map's bricks.
    pub fn with_history(mut self, history: ViewHistory) -> Self {
        self.history = Some(Box::new(history));
        self
    }

    pub fn view_history(&self) -> Option<&ViewHistory> {
        self.history.as_deref()
    }

    pub(super) fn view_history_mut(&mut self) -> &mut Option<Box<ViewHistory>> {
        &mut self.history
    }

    /// Ignore everything outside a box (metres; voxels that it touches belong to it). Only for an empty map.
    pub fn limited_to(self, bounds: &Aabb) -> Result<Self> {
        match (self.key(bounds.min), self.key(bounds.max)) {
            (Some(min), Some(max)) if self.bricks.is_empty() && min.cmple(max).all() => {
                let max = max + 1;
                self.with_limits(Some(KeyBox { min, max }))
            }
            _ => Err(Error::invalid(format!(
                "map bounds {} .. {} are empty or beyond the key space",
                bounds.min, bounds.max
            ))),
        }
    }

    /// Update voxels in a given way (by default the quickest of this machine); all ways give the same map.
    pub fn with_lanes(mut self, lanes: Lanes) -> Self {
        self.misses = Misses::new(lanes, &self.sensor);
        self
    }

    /// The same by keys; `None` leaves the map without limits.
    pub fn with_limits(mut self, limits: Option<KeyBox>) -> Result<Self> {
        if let Some(l) = limits {
            let (low, high) = (l.min >> 3, (l.max - 1) >> 3);
            self.reserve(low, high)?;
            // Growing copies. Memory that is never written costs address space only.
            let bricks = (high - low + 1).as_usizevec3().element_product();
            self.bricks.reserve(bricks.min(RESERVED_BRICKS));
        }
        self.limits = limits;
        Ok(self)
    }

    /// The voxels that the map is limited to.
    pub fn limits(&self) -> Option<KeyBox> {
        self.limits
    }

    pub fn resolution(&self) -> f64 {
        self.resolution
    }
    /// Voxels a metre, as OctoMap computes it.
    pub fn inverse(&self) -> f64 {
        self.inverse
    }
    pub fn sensor(&self) -> &SensorModel {
        &self.sensor
    }
    pub fn root(&self) -> &Root {
        &self.root
    }
    pub fn bricks(&self) -> &[Brick] {
        &self.bricks
    }
    /// Brick coordinates (voxel key >> 3) of brick number `i`.
    pub fn brick_coordinates(&self, i: usize) -> IVec3 {
        self.coordinates[i]
    }

    /// The voxel that holds a coordinate, as OctoMap computes it (without OctoMap's offset of 32768).
    #[inline]
    pub fn key_of(&self, coordinate: f32) -> i32 {
        let x = self.inverse * f64::from(coordinate);
        // Rounds down without a call of `floor`, which baseline x86-64 does not have as an instruction.
        let t = x as i32;
        t.saturating_sub(i32::from(x < f64::from(t)))
    }

    /// The voxel that holds a point; `None` outside OctoMap's key space or if not finite.
    #[inline]
    pub fn key(&self, p: Vec3) -> Option<IVec3> {
        if !p.is_finite() {
            return None;
        }
        let k = IVec3::new(self.key_of(p.x), self.key_of(p.y), self.key_of(p.z));
        let inside = |v: i32| (-KEY_LIMIT..KEY_LIMIT).contains(&v);
        (inside(k.x) && inside(k.y) && inside(k.z)).then_some(k)
    }

    pub fn center(&self, key: IVec3) -> Vec3 {
        let c = |k: i32| ((f64::from(k) + 0.5) * self.resolution) as f32;
        Vec3::new(c(key.x), c(key.y), c(key.z))
    }

    #[inline]
    fn brick_of(&self, key: IVec3) -> Option<&Brick> {
        let cell = self.root.index(key >> 3)?;
        self.root.brick(cell).map(|b| &self.bricks[b])
    }

    #[inline]
    pub fn state(&self, key: IVec3) -> State {
        self.brick_of(key)
            .map_or(State::Unknown, |b| b.state(voxel_in_brick(key)))
    }

    /// `None` where unknown.
    pub fn log_odds(&self, key: IVec3) -> Option<f32> {
        let brick = self.brick_of(key)?;
        let voxel = voxel_in_brick(key);
        (brick.state(voxel) != State::Unknown).then(|| brick.log_odds[voxel])
    }

    /// Lluvia 2023, Eq. 9; 1 where nothing was hit.
    pub fn uncertainty(&self, key: IVec3) -> f32 {
        self.brick_of(key)
            .map_or(1.0, |b| self.brick_uncertainty(b, voxel_in_brick(key)))
    }

    #[inline]
    pub fn brick_uncertainty(&self, brick: &Brick, voxel: usize) -> f32 {
        match brick.uncertainty {
            NONE => 1.0,
            block => self.uncertainty[block as usize][voxel],
        }
    }

    /// Whether a surface was ever seen in a brick, so that it has uncertainties.
    pub fn has_uncertainty(&self, brick: &Brick) -> bool {
        brick.uncertainty != NONE
    }

    pub fn num_known(&self) -> u64 {
        self.counts.known
    }
    pub fn num_occupied(&self) -> u64 {
        self.counts.occupied
    }
    /// Sum over the known voxels of H(p), bits.
    pub fn entropy(&self) -> f64 {
        self.counts.entropy as f64 / UNIT
    }
    /// Lluvia 2023, Eq. 11: sum over the occupied voxels of 1 - u.
    pub fn information(&self) -> f64 {
        self.counts.information as f64 / UNIT
    }
    /// Bits gained against knowing nothing: sum over the known voxels of 1 - H(p).
    pub fn information_bits(&self) -> f64 {
        self.counts.known as f64 - self.entropy()
    }

    pub fn memory_bytes(&self) -> usize {
        self.root.cells.capacity() * 5
            + self.bricks.capacity() * std::mem::size_of::<Brick>()
            + self.coordinates.capacity() * std::mem::size_of::<IVec3>()
            + self.uncertainty.capacity() * std::mem::size_of::<[f32; VOXELS]>()
            + self.history.as_ref().map_or(0, |h| h.memory_bytes())
    }

    /// Make room for the bricks `low..=high` (brick coordinates), before anything is changed.
    pub fn reserve(&mut self, low: IVec3, high: IVec3) -> Result<()> {
        if self.root.index(low).is_some() && self.root.index(high).is_some() {
            return Ok(());
        }
        match self.root.grown(low, high) {
            Some(root) => {
                self.root = root;
                Ok(())
            }
            None => Err(Error::invalid(format!(
                "the map would span bricks {low}..{high} of {} m: more than {MAX_ROOT_CELLS} root cells; use a coarser resolution or a max_range",
                self.resolution * f64::from(SIDE)
            ))),
        }
    }

    /// One image's update of one brick: a hit or a miss once per voxel, clamped; hits win.
    /// The brick must lie in the reserved box.
    pub fn apply(&mut self, update: &BrickUpdate) {
        let Some(cell) = self.root.index(update.brick) else {
            debug_assert!(false, "apply outside the reserved box");
            return;
        };
        let mask = self.limits.map_or([u64::MAX; 8], |l| l.mask(update.brick));
        if (0..8).all(|w| mask[w] & (update.hit[w] | update.free[w]) == 0) {
            return;
        }
        if *self.misses.sensor() != self.sensor {
            self.misses = Misses::new(self.misses.lanes(), &self.sensor);
        }
        let number = match self.root.cells[cell] {
            NONE => {
                self.bricks.push(Brick::EMPTY);
                self.coordinates.push(update.brick);
                self.root.cells[cell] = self.bricks.len() as u32 - 1;
                self.bricks.len() - 1
            }
            b => b as usize,
        };
        if let Some(changes) = &mut self.changes {
            changes.note(number, update.brick, &self.bricks[number]);
        }
        let brick = &mut self.bricks[number];
        let any_hit = update.hit.iter().zip(&mask).any(|(h, m)| h & m != 0);
        if any_hit && brick.uncertainty == NONE {
            brick.uncertainty = self.uncertainty.len() as u32;
            self.uncertainty.push([1.0; VOXELS]);
        }
        let mut block = match brick.uncertainty {
            NONE => None,
            b => Some(&mut self.uncertainty[b as usize]),
        };
        let sensor = self.sensor;
        let (mut entropy, mut information) = (0i64, 0i64);
        for word in 0..8 {
            let hits = update.hit[word];
            let mut bits = (hits | update.free[word]) & mask[word];
            if bits == 0 {
                continue;
            }
            let (known, occupied) = (brick.known[word], brick.occupied[word]);
            let mut now_occupied = occupied;
            let all = bits;
            // Most voxels were only ever missed: they stay free, and only their entropy changes.
            let values = brick.log_odds[word * 64..].first_chunk_mut::<64>();
            if let Some(values) = values {
                let (done, change) = self.misses.apply(bits & !hits & !occupied, values);
                bits &= !done;
                entropy += change;
            }
            while bits != 0 {
                let bit = bits.trailing_zeros();
                bits &= bits - 1;
                let mask = 1u64 << bit;
                let voxel = word * 64 + bit as usize;
                let hit = hits & mask != 0;
                let old = brick.log_odds[voxel];
                let delta = if hit { sensor.hit } else { sensor.miss };
                let new = (old + delta).clamp(sensor.clamp_min, sensor.clamp_max);
                if known & mask == 0 {
                    entropy += entropy_units(new) as i64;
                } else if new != old {
                    entropy += entropy_units(new) as i64 - entropy_units(old) as i64;
                }
                brick.log_odds[voxel] = new;
                let is_occupied = new >= 0.0;
                now_occupied = if is_occupied {
                    now_occupied | mask
                } else {
                    now_occupied & !mask
                };
                if let Some(block) = block.as_deref_mut() {
                    let before = block[voxel];
                    let was = if occupied & mask != 0 {
                        certainty_units(before)
                    } else {
                        0
                    };
                    if hit {
                        if let Some(seen) = update.uncertainty {
                            block[voxel] = before.min(seen[voxel]);
                        }
                    }
                    let is = if is_occupied {
                        certainty_units(block[voxel])
                    } else {
                        0
                    };
                    information += is as i64 - was as i64;
                }
            }
            self.counts.known += u64::from((all & !known).count_ones());
            self.counts.occupied += u64::from(now_occupied.count_ones());
            self.counts.occupied -= u64::from(occupied.count_ones());
            brick.known[word] = known | all;
            brick.occupied[word] = now_occupied;
        }
        self.counts.entropy = self.counts.entropy.wrapping_add_signed(entropy);
        self.counts.information = self.counts.information.wrapping_add_signed(information);
        self.root.summaries[cell] = brick.summary() as u8;
    }
}
