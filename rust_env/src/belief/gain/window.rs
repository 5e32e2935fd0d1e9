//! The part of the map that the rays of some views can meet, unpacked to one byte a voxel: rays then step by adding
//! to an index, without looking for bricks.
use crate::belief::distance;
use crate::belief::octree::{entropy_units, probability, KeyBox, Octree, Summary, SIDE};
use crate::error::{Error, Result};
use crate::geometry::IVec3;

/// States of a voxel, one bit each, so that a set of states is a mask. 0: outside the bounds, counts nothing.
pub const UNKNOWN: u8 = 1;
pub const OCCUPIED: u8 = 2;
pub const FREE: u8 = 4;
/// Ends every ray and counts nothing: the window's border, and occupied voxels outside the bounds.
pub const WALL: u8 = 8;

/// Sums of gains are kept in integers of this unit (2^-31), so that they do not depend on the order of summation.
pub const UNIT: f64 = (1u64 << 31) as f64;

/// Most voxels of a window (one to nine bytes each).
pub const MAX_VOXELS: u64 = 1 << 27;
/// A distance to the next occupied voxel is searched for up to this many voxels.
pub const REACH: i32 = 5;

/// What a metric reads of a voxel besides its state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Layers {
    pub entropy: bool,
    pub probability: bool,
    pub distance: bool,
}

pub struct Window {
    /// Key of the voxel with index 0. The outermost layer of voxels is `WALL`.
    pub origin: IVec3,
    pub dims: IVec3,
    /// Index = (z * dims.y + y) * dims.x + x; three bytes more than voxels, for reads of four bytes.
    pub state: Vec<u8>,
    /// Entropy in `UNIT`s of a bit; empty unless asked for.
    pub entropy: Vec<u32>,
    /// Occupancy probability, 0.5 where unknown; empty unless asked for.
    pub probability: Vec<f32>,
    /// Squared distance in voxels to the nearest occupied voxel (more than `REACH` squared: far); empty unless asked for.
    pub distance: Vec<u16>,
}

impl Window {
    /// Unpack `region`. Voxels outside `bounds` become 0 (or `WALL` where occupied).
    pub fn new(
        octree: &Octree,
        region: KeyBox,
        bounds: Option<KeyBox>,
        layers: Layers,
    ) -> Result<Self> {
        if region.volume() > MAX_VOXELS {
            return Err(Error::invalid(format!(
                "the views' rays span {} voxels, more than {MAX_VOXELS}: use a shorter max_range or a coarser map",
                region.volume()
            )));
        }
        let (origin, dims) = (
            region.min - 1,
            (region.max - region.min).max(IVec3::ZERO) + 2,
        );
        let voxels = dims.x as usize * dims.y as usize * dims.z as usize;
        let mut window = Self {
            origin,
            dims,
            state: vec![WALL; voxels + 3],
            entropy: Vec::new(),
            probability: Vec::new(),
            distance: Vec::new(),
        };
        window.rows(region, |window, row| window.state[row].fill(UNKNOWN));
        if layers.entropy {
            window.entropy = vec![UNIT as u32; voxels];
        }
        if layers.probability {
            window.probability = vec![0.5; voxels];
        }
        window.unpack(octree, region);
        if let Some(bounds) = bounds {
            window.ignore_outside(region, bounds);
        }
        if layers.distance {
            window.measure();
        }
        Ok(window)
    }

    #[inline]
    pub fn index(&self, key: IVec3) -> usize {
        let c = key - self.origin;
        (c.z as usize * self.dims.y as usize + c.y as usize) * self.dims.x as usize + c.x as usize
    }

    #[inline]
    pub fn key(&self, index: usize) -> IVec3 {
        let (nx, ny) = (self.dims.x as usize, self.dims.y as usize);
        let (x, rest) = (index % nx, index / nx);
        self.origin + IVec3::new(x as i32, (rest % ny) as i32, (rest / ny) as i32)
    }

    /// Index steps along x, y, z.
    pub fn strides(&self) -> [isize; 3] {
        [
            1,
            self.dims.x as isize,
            self.dims.x as isize * self.dims.y as isize,
        ]
    }

    /// The voxels without the border.
    pub fn region(&self) -> KeyBox {
        KeyBox {
            min: self.origin + 1,
            max: self.origin + self.dims - 1,
        }
    }

    fn rows(&mut self, region: KeyBox, mut each: impl FnMut(&mut Self, std::ops::Range<usize>)) {
        let length = (region.max.x - region.min.x).max(0) as usize;
        for z in region.min.z..region.max.z {
            for y in region.min.y..region.max.y {
                let start = self.index(IVec3::new(region.min.x, y, z));
                each(self, start..start + length);
            }
        }
    }

    fn unpack(&mut self, octree: &Octree, region: KeyBox) {
        let root = octree.root();
        let (low, high): (IVec3, IVec3) = (region.min >> 3, (region.max - 1) >> 3);
        let low = low.max(root.origin);
        let high = high.min(root.origin + root.dims - 1);
        let plain = self.entropy.is_empty() && self.probability.is_empty();
        // Neighbours often have equal values.
        let mut last = Known::of(0.0);
        for bz in low.z..=high.z {
            for by in low.y..=high.y {
                for bx in low.x..=high.x {
                    let corner = IVec3::new(bx, by, bz);
                    let Some(cell) = root.index(corner) else {
                        continue;
                    };
                    let summary = root.summary(cell);
                    let number = match root.brick(cell) {
                        Some(number) if summary != Summary::Unknown => number,
                        _ => continue,
                    };
                    let first = corner << 3;
                    let part = region.intersection(&KeyBox {
                        min: first,
                        max: first + SIDE,
                    });
                    if plain && summary == Summary::Free {
                        self.rows(part, |window, row| window.state[row].fill(FREE));
                        continue;
                    }
                    let brick = &octree.bricks()[number];
                    for z in part.min.z..part.max.z {
                        let word = (z & 7) as usize;
                        for y in part.min.y..part.max.y {
                            let shift = (y & 7) * 8;
                            let known = (brick.known[word] >> shift) as u8;
                            let occupied = (brick.occupied[word] >> shift) as u8;
                            let states = states_of_row(known, occupied).to_le_bytes();
                            let from = (part.min.x - first.x) as usize;
                            let to = (part.max.x - first.x) as usize;
                            let start = self.index(IVec3::new(part.min.x, y, z));
                            if to - from == 8 {
                                self.state[start..start + 8].copy_from_slice(&states);
                            } else {
                                self.state[start..start + to - from]
                                    .copy_from_slice(&states[from..to]);
                            }
                            if plain {
                                continue;
                            }
                            for (i, x) in (from..to).enumerate() {
                                if known >> x & 1 == 0 {
                                    continue;
                                }
                                let log_odds = brick.log_odds[word * 64 + shift as usize + x];
                                if log_odds.to_bits() != last.log_odds.to_bits() {
                                    last = Known::of(log_odds);
                                }
                                if !self.entropy.is_empty() {
                                    self.entropy[start + i] = last.entropy;
                                }
                                if !self.probability.is_empty() {
                                    self.probability[start + i] = last.probability;
                                }
                            }
                        }
                    }
                }
            }
        }
    }

    fn ignore_outside(&mut self, region: KeyBox, bounds: KeyBox) {
        if bounds.intersection(&region) == region {
            return;
        }
        self.rows(region, |window, row| {
            for i in row {
                if !bounds.contains(window.key(i)) {
                    window.state[i] = if window.state[i] == OCCUPIED { WALL } else { 0 };
                }
            }
        });
    }

    fn measure(&mut self) {
        let dims = self.dims.to_array().map(|n| n as usize);
        let occupied = self.state[..dims[0] * dims[1] * dims[2]]
            .iter()
            .map(|s| *s == OCCUPIED);
        self.distance = distance::to_marked(occupied, dims, REACH as usize, |k| (k * k) as u16);
    }
}

/// What the layers say of a known voxel.
struct Known {
    log_odds: f32,
    entropy: u32,
    probability: f32,
}

impl Known {
    fn of(log_odds: f32) -> Self {
        Self {
            log_odds,
            entropy: (entropy_units(log_odds) >> 1) as u32,
            probability: probability(log_odds) as f32,
        }
    }
}

/// The states of eight voxels in a row (x ascending) from their bits, one byte each, the first in the lowest byte.
fn states_of_row(known: u8, occupied: u8) -> u64 {
    let spread = |bits: u8| SPREAD[bits as usize];
    let (known, occupied) = (spread(known), spread(occupied));
    let unknown = known ^ SPREAD[255];
    let free = known & !occupied;
    (unknown * u64::from(UNKNOWN)) | (occupied * u64::from(OCCUPIED)) | (free * u64::from(FREE))
}

/// Bit i of the index as byte i of the value.
static SPREAD: [u64; 256] = {
    let mut table = [0; 256];
    let mut i = 0;
    while i < 256 {
        let mut bit = 0;
        while bit < 8 {
            table[i] |= ((i as u64 >> bit) & 1) << (8 * bit);
            bit += 1;
        }
        i += 1;
    }
    table
};
