//! Projective integration: a voxel is free if its centre, projected into the depth image, lies in front of what the nearest
//! pixel measured. Hits are those of exact integration. Much quicker than walking rays, and approximate: rays between
//! pixels are not drawn, and a voxel that a ray only grazes stays as it was.
//!
//! Coarse to fine: bricks are compared with the least and greatest range of the part of the image that they can project
//! to, and only those at its surface are looked at voxel by voxel.
use super::frame::Frame;
use crate::belief::octree::SIDE;
use crate::camera::{Camera, DepthKind};
use crate::geometry::{IVec3, Pose, Vec3};

/// Least and greatest range of 2 x 2, 4 x 4, ... pixels: (columns, values).
type Level = (usize, Vec<(f32, f32)>);

#[derive(Clone, Default)]
pub struct Projection {
    /// How far each pixel's ray is free, metres; 0 without a measurement.
    free: Vec<f32>,
    levels: Vec<Level>,
    farthest: f32,
}

impl Projection {
    /// Of a depth image (row-major); what lies beyond `max_range` is not measured.
    pub fn prepare(&mut self, depth: &[f32], camera: &Camera, max_range: f64) {
        let limit = max_range as f32;
        let pixels = (0..camera.height).flat_map(|v| (0..camera.width).map(move |u| (u, v)));
        self.free.clear();
        self.free.extend(pixels.zip(depth).map(|((u, v), d)| {
            let range = match camera.kind {
                DepthKind::Range => *d,
                DepthKind::Z => d * camera.ray(u, v).length(),
            };
            // NaN is no measurement either.
            if range > 0.0 {
                range.min(limit)
            } else {
                0.0
            }
        }));
        self.farthest = self.free.iter().copied().fold(0.0, f32::max);
        let (mut width, mut height) = (camera.width, camera.height);
        let mut below: Vec<(f32, f32)> = self.free.iter().map(|r| (*r, *r)).collect();
        self.levels.clear();
        while width > 1 || height > 1 {
            let (w, h) = (width.div_ceil(2), height.div_ceil(2));
            let mut level = vec![(f32::INFINITY, 0.0f32); w * h];
            for (i, (least, greatest)) in below.iter().enumerate() {
                let cell = &mut level[i / width / 2 * w + i % width / 2];
                *cell = (cell.0.min(*least), cell.1.max(*greatest));
            }
            self.levels.push((w, level.clone()));
            (below, width, height) = (level, w, h);
        }
    }

    /// Least and greatest range within a box of pixels, both corners included.
    fn ranges(&self, low: [usize; 2], high: [usize; 2]) -> (f32, f32) {
        let side = (high[0] - low[0]).max(high[1] - low[1]);
        // At most three cells along a side.
        let level = (usize::BITS - (side / 2).leading_zeros()).max(1) as usize;
        let Some((width, cells)) = self
            .levels
            .get(level.min(self.levels.len()).wrapping_sub(1))
        else {
            return (self.free[0], self.free[0]);
        };
        let level = level.min(self.levels.len());
        let mut found = (f32::INFINITY, 0.0f32);
        for v in low[1] >> level..=high[1] >> level {
            for u in low[0] >> level..=high[0] >> level {
                let (least, greatest) = cells[v * width + u];
                found = (found.0.min(least), found.1.max(greatest));
            }
        }
        found
    }

    /// Note the free voxels in the frame's bricks.
    pub fn trace(
        &self,
        frame: &mut Frame,
        camera: &Camera,
        world_from_camera: &Pose,
        resolution: f64,
    ) {
        let camera_from_world = world_from_camera.inverse();
        let side = (resolution * f64::from(SIDE)) as f32;
        let radius = side * 0.75f32.sqrt();
        let step = [Vec3::X, Vec3::Y, Vec3::Z]
            .map(|axis| camera_from_world.rotation * axis * resolution as f32);
        for z in 0..frame.dims.z {
            for y in 0..frame.dims.y {
                for x in 0..frame.dims.x {
                    let brick = frame.origin + IVec3::new(x, y, z);
                    let corner = brick.as_vec3() * side;
                    let center = camera_from_world.point(corner + side * 0.5);
                    let free = match self.whole(camera, center, radius) {
                        Some(false) => continue,
                        Some(true) => [u64::MAX; 8],
                        None => {
                            let first = corner + resolution as f32 * 0.5;
                            self.voxels(camera, camera_from_world.point(first), &step)
                        }
                    };
                    if free != [0; 8] {
                        frame.note_free(brick, &free);
                    }
                }
            }
        }
    }

    /// Whether a ball (camera frame) lies as a whole in free space (`true`), or nothing of it (`false`).
    fn whole(&self, camera: &Camera, center: Vec3, radius: f32) -> Option<bool> {
        let range = center.length();
        if range - radius > self.farthest || center.z < -radius {
            return Some(false);
        }
        let near = center.z - radius;
        if near <= radius * 0.5 {
            return None;
        }
        let far = center.z + radius;
        // The ball's box seen from the camera.
        let extent = |c: f32, focal: f32, middle: f32| {
            let (low, high) = (c - radius, c + radius);
            let low = low / if low > 0.0 { far } else { near };
            let high = high / if high > 0.0 { near } else { far };
            [low * focal + middle, high * focal + middle]
        };
        let [u0, u1] = extent(center.x, camera.fx, camera.cx);
        let [v0, v1] = extent(center.y, camera.fy, camera.cy);
        let (width, height) = (camera.width as f32, camera.height as f32);
        if u1 < 0.0 || v1 < 0.0 || u0 >= width || v0 >= height {
            return Some(false);
        }
        let pixel = |x: f32, size: usize| (x.max(0.0) as usize).min(size - 1);
        let (least, greatest) = self.ranges(
            [pixel(u0, camera.width), pixel(v0, camera.height)],
            [pixel(u1, camera.width), pixel(v1, camera.height)],
        );
        if range - radius > greatest {
            return Some(false);
        }
        let inside = u0 >= 0.0 && v0 >= 0.0 && u1 < width && v1 < height;
        (inside && range + radius < least).then_some(true)
    }

    /// The free voxels of a brick: its first voxel's centre and the steps along the axes in the camera frame.
    fn voxels(&self, camera: &Camera, first: Vec3, step: &[Vec3; 3]) -> [u64; 8] {
        let mut words = [0; 8];
        let (width, height) = (camera.width as f32, camera.height as f32);
        for (z, word) in words.iter_mut().enumerate() {
            for y in 0..8 {
                let row = first + step[1] * y as f32 + step[2] * z as f32;
                let mut pixel = [usize::MAX; 8];
                let mut squared = [0.0; 8];
                for x in 0..8 {
                    let p = row + step[0] * x as f32;
                    let u = p.x / p.z * camera.fx + camera.cx;
                    let v = p.y / p.z * camera.fy + camera.cy;
                    squared[x] = p.x * p.x + p.y * p.y + p.z * p.z;
                    let seen = p.z > 0.0 && u >= 0.0 && v >= 0.0 && u < width && v < height;
                    if seen {
                        pixel[x] = v as usize * camera.width + u as usize;
                    }
                }
                for x in 0..8 {
                    let free = self.free.get(pixel[x]).copied().unwrap_or(0.0);
                    *word |= u64::from(squared[x] < free * free) << (y * 8 + x);
                }
            }
        }
        words
    }
}
