//! What one image saw: free and hit voxels in a box of bricks around its rays.
use super::ends::{Ends, Sensor};
use super::norm;
use crate::belief::lockstep::{self, Lanes, FREE};
use crate::belief::octree::{SIDE, VOXELS};
use crate::belief::ray_walk::Dda;
use crate::error::{Error, Result};
use crate::geometry::{IVec3, Vec3};

const NONE: u32 = u32::MAX;
const NOWHERE: u64 = u64::MAX;
/// Largest number of bricks that one image's box may span (a u32 each).
const MAX_CELLS: u64 = 1 << 27;

/// What one image saw of one brick.
#[derive(Clone)]
struct FrameBrick {
    free: [u64; 8],
    hit: [u64; 8],
    uncertainty: u32,
}

#[derive(Clone, Default)]
pub struct Frame {
    /// Corner and size, in bricks.
    pub origin: IVec3,
    pub dims: IVec3,
    /// Number of the frame brick of each cell.
    slots: Vec<u32>,
    bricks: Vec<FrameBrick>,
    /// Blocks of `VOXELS`, of which the first `blocks` are in use; only what was hit is written and read.
    uncertainty: Vec<f32>,
    blocks: usize,
    /// For lockstep: a byte per voxel, rows of x, then y, then z, and one more for what must not be marked.
    window: Vec<u8>,
    /// Number of each ray's last voxel in the window.
    ends: Vec<i32>,
    doubtful: lockstep::Doubtful,
    /// Where each ray hit, see [`Places`].
    places: Vec<u64>,
}

/// Numbers the voxels of a frame: the cell of the brick times `VOXELS`, and the voxel in the brick.
struct Places {
    origin: IVec3,
    dims: IVec3,
}

impl Places {
    fn find(&self, lanes: Lanes, ends: &Ends, places: &mut [u64]) {
        match lanes {
            Lanes::Scalar => self.find_all(ends, places),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Lanes` is only made where the features were detected.
            Lanes::Avx2 => unsafe { self.find_avx2(ends, places) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            Lanes::Avx512 => unsafe { self.find_avx512(ends, places) },
        }
    }

    /// The place that each ray hit, or `NOWHERE`. One source, compiled for each kind of lanes.
    #[inline(always)]
    fn find_all(&self, ends: &Ends, places: &mut [u64]) {
        let (o, d) = (self.origin, self.dims);
        let [x, y, z] = &ends.key;
        let keys = x.iter().zip(y).zip(z);
        for ((place, hit), ((x, y), z)) in places.iter_mut().zip(&ends.hit).zip(keys) {
            let (cx, cy, cz) = ((x >> 3) - o.x, (y >> 3) - o.y, (z >> 3) - o.z);
            let inside = ((cx as u32) < d.x as u32)
                & ((cy as u32) < d.y as u32)
                & ((cz as u32) < d.z as u32);
            let cell = cz
                .wrapping_mul(d.y)
                .wrapping_add(cy)
                .wrapping_mul(d.x)
                .wrapping_add(cx);
            let voxel = ((z & 7) << 6) | ((y & 7) << 3) | (x & 7);
            let number = u64::from(cell as u32) * VOXELS as u64 + u64::from(voxel as u32);
            *place = if *hit & inside { number } else { NOWHERE };
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn find_avx2(&self, ends: &Ends, places: &mut [u64]) {
        self.find_all(ends, places);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw")]
    fn find_avx512(&self, ends: &Ends, places: &mut [u64]) {
        self.find_all(ends, places);
    }
}

impl Frame {
    /// Lay the frame over a box of keys, both corners included, and forget what was seen. The walk may leave the box of
    /// the rays' ends by rounding: two voxels to spare. Returns the number of cells.
    pub fn lay(&mut self, low: IVec3, high: IVec3) -> Result<u64> {
        self.origin = (low - 2) >> 3;
        self.dims = ((high + 2) >> 3) - self.origin + 1;
        let volume = self.dims.x as u64 * self.dims.y as u64 * self.dims.z as u64;
        if volume > MAX_CELLS {
            return Err(Error::invalid(format!(
                "the image spans {} x {} x {} voxels; pass a max_range or use a coarser resolution",
                self.dims.x * SIDE,
                self.dims.y * SIDE,
                self.dims.z * SIDE
            )));
        }
        self.slots.clear();
        self.slots.resize(volume as usize, NONE);
        self.bricks.clear();
        self.blocks = 0;
        self.window.clear();
        Ok(volume)
    }

    /// Give back what a much larger image took.
    pub fn give_back(&mut self) {
        const MUCH: usize = 1 << 23;
        if self.window.capacity() > MUCH && self.window.capacity() > 4 * self.window.len() {
            self.window.shrink_to(self.window.len());
        }
        if self.slots.capacity() > MUCH / 4 && self.slots.capacity() > 4 * self.slots.len() {
            self.slots.shrink_to(self.slots.len());
        }
    }

    /// Steps of the window's numbers along x, y, z.
    fn strides(&self) -> [i32; 3] {
        let voxels = self.dims * SIDE;
        [1, voxels.x, voxels.x * voxels.y]
    }

    fn window_cell(&self, key: IVec3) -> i32 {
        let k = key - self.origin * SIDE;
        let [_, row, layer] = self.strides();
        k.z * layer + k.y * row + k.x
    }

    /// `skip`: see [`lockstep::Rays`]; rays that it has no number for are walked whole.
    pub fn trace_in_lockstep(
        &mut self,
        lanes: Lanes,
        resolution: f64,
        sensor: &Sensor,
        ends: &Ends,
        skip: &mut Vec<f32>,
    ) {
        skip.resize(ends.len(), 0.0);
        let voxels = self.dims * SIDE;
        self.window
            .resize((voxels.x * voxels.y * voxels.z) as usize + 1, 0);
        let strides = self.strides();
        self.ends.resize(ends.len(), 0);
        let zero = self.window_cell(IVec3::ZERO);
        let [x, y, z] = &ends.key;
        for (((cell, x), y), z) in self.ends.iter_mut().zip(x).zip(y).zip(z) {
            *cell = zero + z * strides[2] + y * strides[1] + x;
        }
        let frame = lockstep::Frame {
            resolution,
            origin: sensor.origin,
            start: sensor.start,
            start_cell: self.window_cell(sensor.start),
            strides,
            max_steps: voxels.element_sum(),
        };
        let rays = lockstep::Rays {
            end: [0, 1, 2].map(|axis| ends.position[axis].as_slice()),
            cell: &self.ends,
            skip,
        };
        lockstep::trace(lanes, &frame, &rays, &mut self.window, &mut self.doubtful);
    }

    /// Number of a cell of the frame.
    #[inline]
    fn cell(&self, c: IVec3) -> usize {
        (c.z as usize * self.dims.y as usize + c.y as usize) * self.dims.x as usize + c.x as usize
    }

    #[inline]
    fn slot(&mut self, brick: IVec3) -> Option<usize> {
        let c = brick - self.origin;
        let d = self.dims;
        if !((c.x as u32) < d.x as u32 && (c.y as u32) < d.y as u32 && (c.z as u32) < d.z as u32) {
            return None;
        }
        let cell = self.cell(c);
        Some(self.slot_of(cell))
    }

    /// The frame brick of a cell, made if it has none.
    #[inline]
    fn slot_of(&mut self, cell: usize) -> usize {
        if self.slots[cell] == NONE {
            self.slots[cell] = self.bricks.len() as u32;
            self.bricks.push(FrameBrick {
                free: [0; 8],
                hit: [0; 8],
                uncertainty: NONE,
            });
        }
        self.slots[cell] as usize
    }

    /// OctoMap's `computeRayKeys` for every ray: all voxels from the sensor's up to, not including, the last.
    pub fn trace(&mut self, resolution: f64, sensor: &Sensor, ends: &Ends) {
        for i in 0..ends.len() {
            let last = ends.last(i);
            if last == sensor.start {
                continue;
            }
            let end = Vec3::new(
                ends.position[0][i],
                ends.position[1][i],
                ends.position[2][i],
            );
            let difference = end - sensor.origin;
            let length = norm(difference) as f32;
            let direction = Vec3::new(
                difference.x / length,
                difference.y / length,
                difference.z / length,
            );
            let mut dda = Dda::new(resolution, sensor.start, sensor.origin, direction);
            let length = f64::from(length);
            'walk: loop {
                let corner = dda.key >> 3;
                let Some(slot) = self.slot(corner) else {
                    break;
                };
                let free = &mut self.bricks[slot].free;
                while dda.key >> 3 == corner {
                    free[(dda.key.z & 7) as usize] |= 1 << ((dda.key.y & 7) << 3 | (dda.key.x & 7));
                    dda.advance();
                    if dda.key == last || dda.exit() > length {
                        break 'walk;
                    }
                }
            }
        }
    }

    /// Note free voxels of a brick of the frame.
    pub fn note_free(&mut self, brick: IVec3, free: &[u64; 8]) {
        if let Some(slot) = self.slot(brick) {
            let noted = &mut self.bricks[slot].free;
            noted.iter_mut().zip(free).for_each(|(a, b)| *a |= b);
        }
    }

    /// Neighbouring pixels often hit the same voxel: one entry for each run of them.
    pub fn hits(&mut self, lanes: Lanes, ends: &Ends) {
        self.places.clear();
        self.places.resize(ends.len(), NOWHERE);
        let frame = Places {
            origin: self.origin,
            dims: self.dims,
        };
        frame.find(lanes, ends, &mut self.places);
        let places = std::mem::take(&mut self.places);
        let mut run = (NOWHERE, 1.0f32);
        for (place, uncertainty) in places.iter().zip(&ends.uncertainty) {
            if *place == run.0 {
                run.1 = run.1.min(*uncertainty);
            } else if *place != NOWHERE {
                self.add_hit(run);
                run = (*place, *uncertainty);
            }
        }
        self.add_hit(run);
        self.places = places;
    }

    fn add_hit(&mut self, (place, uncertainty): (u64, f32)) {
        if place == NOWHERE {
            return;
        }
        let (cell, voxel) = ((place / VOXELS as u64) as usize, place as usize % VOXELS);
        let slot = self.slot_of(cell);
        let brick = &mut self.bricks[slot];
        if brick.uncertainty == NONE {
            brick.uncertainty = self.blocks as u32;
            self.blocks += 1;
            if self.uncertainty.len() < self.blocks * VOXELS {
                self.uncertainty.resize(self.blocks * VOXELS, 1.0);
            }
        }
        let (hit, bit) = (&mut brick.hit[voxel >> 6], 1 << (voxel & 63));
        let least = &mut self.uncertainty[brick.uncertainty as usize * VOXELS + voxel];
        let first = *hit & bit == 0;
        *least = if first {
            uncertainty
        } else {
            least.min(uncertainty)
        };
        *hit |= bit;
    }

    /// Free voxels of a cell of the frame, and the number of its frame brick if anything was noted there.
    pub fn seen(&self, lanes: Lanes, c: IVec3) -> ([u64; 8], Option<u32>) {
        let mut free = self.marked(lanes, c);
        match self.slots[self.cell(c)] {
            NONE => (free, None),
            slot => {
                let noted = &self.bricks[slot as usize].free;
                free.iter_mut().zip(noted).for_each(|(a, b)| *a |= b);
                (free, Some(slot))
            }
        }
    }

    /// Hit voxels of a frame brick and their uncertainty.
    pub fn hit(&self, slot: u32) -> ([u64; 8], Option<&[f32; VOXELS]>) {
        let brick = &self.bricks[slot as usize];
        let (blocks, _) = self.uncertainty.as_chunks();
        (brick.hit, blocks.get(brick.uncertainty as usize))
    }

    /// The voxels of a cell that are marked in the window, as a brick's words.
    fn marked(&self, lanes: Lanes, c: IVec3) -> [u64; 8] {
        if self.window.is_empty() {
            return [0; 8];
        }
        let [_, row, layer] = self.strides().map(|s| s as usize);
        let corner = (c * SIDE).as_usizevec3();
        let corner = corner.z * layer + corner.y * row + corner.x;
        let Some(bytes) = self.window.get(corner..corner + 7 * layer + 7 * row + 8) else {
            return [0; 8];
        };
        match lanes {
            Lanes::Scalar => marks::words(bytes, row, layer),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Lanes` is only made where the features were detected; `bytes` holds all rows.
            Lanes::Avx2 => unsafe { marks::words_avx2(bytes, row, layer) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            Lanes::Avx512 => unsafe { marks::words_avx512(bytes, row, layer) },
        }
    }
}

/// From bytes, eight rows of eight in each of eight layers, to bits.
mod marks {
    use super::FREE;
    #[cfg(target_arch = "x86_64")]
    use std::arch::x86_64::*;

    pub fn words(bytes: &[u8], row: usize, layer: usize) -> [u64; 8] {
        let mut words = [0; 8];
        for (z, word) in words.iter_mut().enumerate() {
            for y in 0..8 {
                let at = z * layer + y * row;
                let mut eight = [0; 8];
                eight.copy_from_slice(&bytes[at..at + 8]);
                // Gathers the lowest bits of eight bytes into one byte.
                let bits = u64::from_le_bytes(eight)
                    .wrapping_mul(0x0102_0408_1020_4080 * u64::from(FREE))
                    >> 56;
                *word |= bits << (y * 8);
            }
        }
        words
    }

    /// SAFETY: needs AVX2, and all rows within `bytes`.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    pub unsafe fn words_avx2(bytes: &[u8], row: usize, layer: usize) -> [u64; 8] {
        let mut words = [0; 8];
        for (z, word) in words.iter_mut().enumerate() {
            for half in 0..2 {
                let at = z * layer + half * 4 * row;
                // SAFETY: eight bytes of a row.
                let eight = |y: usize| unsafe {
                    bytes
                        .as_ptr()
                        .add(at + y * row)
                        .cast::<i64>()
                        .read_unaligned()
                };
                let marks = _mm256_set_epi64x(eight(3), eight(2), eight(1), eight(0));
                let bits = _mm256_movemask_epi8(_mm256_cmpgt_epi8(marks, _mm256_setzero_si256()));
                *word |= u64::from(bits as u32) << (32 * half);
            }
        }
        words
    }

    /// SAFETY: needs AVX-512 F, DQ and BW, and all rows within `bytes`.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512dq,avx512bw")]
    pub unsafe fn words_avx512(bytes: &[u8], row: usize, layer: usize) -> [u64; 8] {
        let rows = _mm512_mullo_epi64(
            _mm512_setr_epi64(0, 1, 2, 3, 4, 5, 6, 7),
            _mm512_set1_epi64(row as i64),
        );
        std::array::from_fn(|z| {
            // SAFETY: eight bytes of each of the layer's eight rows.
            let marks =
                unsafe { _mm512_i64gather_epi64::<1>(rows, bytes.as_ptr().add(z * layer).cast()) };
            _mm512_test_epi8_mask(marks, marks)
        })
    }
}
