//! Which brick stands where: a dense grid of brick numbers with a summary of each brick.
use super::{Summary, KEY_LIMIT, MAX_ROOT_CELLS, NONE, SIDE};
use crate::geometry::IVec3;

/// The dense grid of brick numbers, in brick coordinates (voxel key >> 3).
#[derive(Clone, Default)]
pub struct Root {
    pub origin: IVec3,
    pub dims: IVec3,
    pub(super) cells: Vec<u32>,
    pub(super) summaries: Vec<u8>,
}

impl Root {
    #[inline]
    pub fn index(&self, brick: IVec3) -> Option<usize> {
        let c = brick - self.origin;
        let d = self.dims;
        if (c.x as u32) < d.x as u32 && (c.y as u32) < d.y as u32 && (c.z as u32) < d.z as u32 {
            Some(((c.z as usize * d.y as usize) + c.y as usize) * d.x as usize + c.x as usize)
        } else {
            None
        }
    }

    #[inline]
    pub fn brick(&self, cell: usize) -> Option<usize> {
        match self.cells[cell] {
            NONE => None,
            b => Some(b as usize),
        }
    }

    #[inline]
    pub fn summary(&self, cell: usize) -> Summary {
        match self.summaries[cell] {
            0 => Summary::Unknown,
            1 => Summary::Mixed,
            _ => Summary::Free,
        }
    }

    /// Grow so that the bricks `low..=high` fit; `None` if the grid would become too large.
    pub(super) fn grown(&self, low: IVec3, high: IVec3) -> Option<Root> {
        let (mut lo, mut hi) = (low, high + 1);
        if self.dims.x > 0 {
            let (old_lo, old_hi) = (self.origin, self.origin + self.dims);
            // Room to spare on the sides that grow, so that a map that creeps outwards is copied rarely.
            let spare = (self.dims / 4).max(IVec3::splat(4));
            lo = IVec3::select(low.cmplt(old_lo), low - spare, old_lo);
            hi = IVec3::select((high + 1).cmpgt(old_hi), high + 1 + spare, old_hi);
        }
        let limit = KEY_LIMIT / SIDE;
        lo = lo.max(IVec3::splat(-limit));
        hi = hi.min(IVec3::splat(limit));
        let dims = hi - lo;
        let volume = dims.x as u64 * dims.y as u64 * dims.z as u64;
        if volume > MAX_ROOT_CELLS {
            return None;
        }
        let mut root = Root {
            origin: lo,
            dims,
            cells: vec![NONE; volume as usize],
            summaries: vec![0; volume as usize],
        };
        for z in 0..self.dims.z {
            for y in 0..self.dims.y {
                let from = ((z * self.dims.y) + y) as usize * self.dims.x as usize;
                if let Some(to) = root.index(self.origin + IVec3::new(0, y, z)) {
                    let n = self.dims.x as usize;
                    root.cells[to..to + n].copy_from_slice(&self.cells[from..from + n]);
                    root.summaries[to..to + n].copy_from_slice(&self.summaries[from..from + n]);
                }
            }
        }
        Some(root)
    }
}
