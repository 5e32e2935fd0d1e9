//! Which voxels changed their state: bricks note how they were before they are first touched.
use super::{Brick, Octree, State};
use crate::geometry::IVec3;
use std::collections::HashSet;

/// A voxel that is no longer what it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    pub key: IVec3,
    pub before: State,
    pub after: State,
}

/// A brick's states at some time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct States {
    pub brick: IVec3,
    pub known: [u64; 8],
    pub occupied: [u64; 8],
}

/// The bricks that were touched since the last call of [`Octree::changed`], as they were before.
#[derive(Clone, Debug, Default)]
pub struct Changes {
    /// By brick number.
    noted: Vec<bool>,
    before: Vec<States>,
}

impl Changes {
    #[inline]
    pub(super) fn note(&mut self, number: usize, corner: IVec3, brick: &Brick) {
        if self.noted.len() <= number {
            self.noted.resize(number + 1, false);
        }
        if !std::mem::replace(&mut self.noted[number], true) {
            self.before.push(States {
                brick: corner,
                known: brick.known,
                occupied: brick.occupied,
            });
        }
    }

    /// Bricks get new numbers; what they were stays noted.
    pub(super) fn renumber(&mut self) {
        self.noted.clear();
    }
}

impl Octree {
    /// The voxels whose state differs from what it was at the last call, by bricks in the order in which these were first
    /// touched. The first call begins the bookkeeping and gives every known voxel. A voxel that changed back is left out.
    ///
    /// The bookkeeping copies 140 bytes for each brick that is touched between two calls.
    pub fn changed(&mut self) -> Vec<Change> {
        let noted = match &mut self.changes {
            Some(changes) => {
                changes.noted.clear();
                std::mem::take(&mut changes.before)
            }
            none => {
                *none = Some(Box::default());
                let unknown = |brick: &IVec3| States {
                    brick: *brick,
                    known: [0; 8],
                    occupied: [0; 8],
                };
                self.coordinates.iter().map(unknown).collect()
            }
        };
        // A brick that was dropped and made again is noted twice; how it was first is what counts.
        let mut seen = HashSet::with_capacity(noted.len());
        let mut changed = Vec::new();
        for states in noted.iter().filter(|s| seen.insert(s.brick)) {
            let now = self.brick_of(states.brick << 3).unwrap_or(&Brick::EMPTY);
            for word in 0..8 {
                let mut bits = (states.known[word] ^ now.known[word])
                    | (states.occupied[word] ^ now.occupied[word]);
                while bits != 0 {
                    let bit = bits.trailing_zeros();
                    bits &= bits - 1;
                    let voxel = word * 64 + bit as usize;
                    let (x, y) = (bit as i32 & 7, bit as i32 >> 3);
                    changed.push(Change {
                        key: (states.brick << 3) + IVec3::new(x, y, word as i32),
                        before: state_of(&states.known, &states.occupied, voxel),
                        after: now.state(voxel),
                    });
                }
            }
        }
        changed
    }

    /// The notes for the next call of [`Octree::changed`]; `None` if it was never called.
    pub fn noted(&self) -> Option<&[States]> {
        self.changes.as_ref().map(|c| c.before.as_slice())
    }

    /// Go on with notes that a map of the same content took.
    pub fn restore_noted(&mut self, before: Vec<States>) {
        let mut noted = vec![false; self.bricks.len()];
        for states in &before {
            let cell = self.root.index(states.brick);
            if let Some(number) = cell.and_then(|c| self.root.brick(c)) {
                noted[number] = true;
            }
        }
        self.changes = Some(Box::new(Changes { noted, before }));
    }
}

#[inline]
pub(super) fn state_of(known: &[u64; 8], occupied: &[u64; 8], voxel: usize) -> State {
    let (word, bit) = (voxel >> 6, voxel & 63);
    if known[word] >> bit & 1 == 0 {
        State::Unknown
    } else if occupied[word] >> bit & 1 == 1 {
        State::Occupied
    } else {
        State::Free
    }
}
