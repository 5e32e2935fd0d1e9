//! A horizontal slice of the map as a 2-D grid, for robots that drive.
use super::distance;
use super::octree::{KeyBox, Octree, State};
use crate::error::{Error, Result};
use crate::geometry::{Aabb, IVec3, Vec3};
pub use glam::Vec2;

/// Most cells of a grid.
const MAX_CELLS: u64 = 1 << 26;

#[derive(Clone, Debug, PartialEq)]
pub struct OccupancyGrid {
    /// Key of cell (0, 0).
    key: (i32, i32),
    resolution: f64,
    width: usize,
    height: usize,
    cells: Vec<State>,
}

impl OccupancyGrid {
    /// The columns of voxels that `z_min..=z_max` (metres) touches, within the x and y of `bounds`.
    ///
    /// Column rule: occupied if any voxel of the column is occupied; else unknown if more than half of its voxels are
    /// unknown; else free. (Were one unknown voxel enough, hardly a column over the floor's rim would ever be free.)
    pub fn slice(octree: &Octree, z_min: f32, z_max: f32, bounds: &Aabb) -> Result<Self> {
        if !(z_min.is_finite() && z_max.is_finite() && z_min <= z_max) {
            return Err(Error::invalid(format!(
                "z_min <= z_max must be finite, got {z_min} and {z_max}"
            )));
        }
        let low = Vec3::new(bounds.min.x, bounds.min.y, z_min);
        let high = Vec3::new(bounds.max.x, bounds.max.y, z_max);
        if !low.cmple(high).all() {
            // An empty box, e.g. that of an empty map.
            return Ok(Self {
                key: (0, 0),
                resolution: octree.resolution(),
                width: 0,
                height: 0,
                cells: Vec::new(),
            });
        }
        let region = KeyBox::touching(octree, &Aabb::new(low, high));
        let size = region.max - region.min;
        if size.x as u64 * size.y as u64 > MAX_CELLS || region.volume() > 64 * MAX_CELLS {
            return Err(Error::invalid(format!(
                "a slice of {} x {} cells and {} layers is too large; pass smaller bounds",
                size.x, size.y, size.z
            )));
        }
        let (width, height) = (size.x as usize, size.y as usize);
        let mut unknown = vec![size.z as u32; width * height];
        let mut occupied = vec![false; width * height];
        let (first, last): (IVec3, IVec3) = (region.min >> 3, (region.max - 1) >> 3);
        let root = octree.root();
        let (first, last) = (
            first.max(root.origin),
            last.min(root.origin + root.dims - 1),
        );
        for bz in first.z..=last.z {
            for by in first.y..=last.y {
                for bx in first.x..=last.x {
                    let corner = IVec3::new(bx, by, bz);
                    let Some(number) = root.index(corner).and_then(|c| root.brick(c)) else {
                        continue;
                    };
                    let brick = &octree.bricks()[number];
                    for (word, mask) in region.mask(corner).into_iter().enumerate() {
                        let mut bits = brick.known[word] & mask;
                        while bits != 0 {
                            let bit = bits.trailing_zeros() as i32;
                            bits &= bits - 1;
                            let key: IVec3 =
                                (corner << 3) + IVec3::new(bit & 7, bit >> 3, 0) - region.min;
                            let cell = key.y as usize * width + key.x as usize;
                            unknown[cell] -= 1;
                            occupied[cell] |= brick.occupied[word] >> bit & 1 == 1;
                        }
                    }
                }
            }
        }
        let cells = (unknown.iter().zip(&occupied))
            .map(
                |(unknown, occupied)| match (*occupied, 2 * unknown > size.z as u32) {
                    (true, _) => State::Occupied,
                    (false, true) => State::Unknown,
                    (false, false) => State::Free,
                },
            )
            .collect();
        Ok(Self {
            key: (region.min.x, region.min.y),
            resolution: octree.resolution(),
            width,
            height,
            cells,
        })
    }

    /// Cells row by row: cell (x, y) is number `y * width + x`.
    pub fn cells(&self) -> &[State] {
        &self.cells
    }
    pub fn width(&self) -> usize {
        self.width
    }
    pub fn height(&self) -> usize {
        self.height
    }
    /// Side of a cell, metres.
    pub fn resolution(&self) -> f32 {
        self.resolution as f32
    }

    /// Lower left corner of cell (0, 0), metres.
    pub fn origin(&self) -> Vec2 {
        let edge = |k: i32| (f64::from(k) * self.resolution) as f32;
        Vec2::new(edge(self.key.0), edge(self.key.1))
    }

    /// State of cell (x, y); unknown outside the grid.
    pub fn state(&self, x: usize, y: usize) -> State {
        if x < self.width && y < self.height {
            self.cells[y * self.width + x]
        } else {
            State::Unknown
        }
    }

    /// The cell that holds a point (metres), if it is in the grid.
    pub fn cell(&self, x: f32, y: f32) -> Option<(usize, usize)> {
        let inverse = 1.0 / self.resolution;
        let key = |v: f32, first: i32| (inverse * f64::from(v)).floor() - f64::from(first);
        let (x, y) = (key(x, self.key.0), key(y, self.key.1));
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        inside.then_some((x as usize, y as usize))
    }

    /// Centre of cell (x, y), metres.
    pub fn center(&self, x: usize, y: usize) -> Vec2 {
        let center = |k: i32, i: usize| ((f64::from(k) + i as f64 + 0.5) * self.resolution) as f32;
        Vec2::new(center(self.key.0, x), center(self.key.1, y))
    }

    /// Occupied cells grown by a body's `radius` (metres): every cell becomes occupied whose centre is nearer than that to an
    /// occupied cell.
    pub fn inflate(&self, radius: f32) -> Self {
        let occupied = self.cells.iter().map(|c| *c == State::Occupied);
        let grown = distance::inflated(
            occupied,
            [self.width, self.height, 1],
            radius / self.resolution as f32,
        );
        let cells = (self.cells.iter().zip(grown))
            .map(|(c, grown)| if grown { State::Occupied } else { *c })
            .collect();
        Self {
            cells,
            ..self.clone()
        }
    }
}

#[cfg(test)]
mod tests;
