//! Which of many fixed viewpoints keep the robot's body clear of what is known to be occupied, kept up to date with the map.
//!
//! Each viewpoint has the voxels that its body would touch, sorted by bricks. After an image only bricks whose occupied voxels
//! changed are looked at, so that a step costs little however many viewpoints there are.
use super::octree::{voxel_in_brick, KeyBox, Octree};
use super::viewpoints::is_touched;
use crate::geometry::{Aabb, IVec3, Pose, Vec3};
use std::sync::Arc;

/// The voxels of one word of a brick that one viewpoint's body touches.
#[derive(Clone, Copy)]
struct Touched {
    viewpoint: u32,
    word: u32,
    voxels: u64,
}

/// A brick that some body touches.
struct Watched {
    brick: IVec3,
    touched: Vec<Touched>,
}

#[derive(Clone)]
pub struct Clearance {
    watched: Arc<Vec<Watched>>,
    /// 1 for a viewpoint that is out of bounds, else 0.
    outside: Arc<Vec<u32>>,
    /// Occupied voxels of the watched bricks when they were last looked at.
    occupied: Vec<[u64; 8]>,
    /// How many occupied voxels each viewpoint's body touches, and `outside`.
    blocked_by: Vec<u32>,
}

/// More voxels of bodies are not listed.
const MOST_VOXELS: u64 = 1 << 21;

impl Clearance {
    /// For a body that is a ball of `radius` metres around each viewpoint, in a map in which nothing is known. `None` where the
    /// bodies hold too many voxels, or are too far apart, for lists.
    pub fn new(octree: &Octree, bounds: &Aabb, viewpoints: &[Pose], radius: f32) -> Option<Self> {
        let mut lists = Lists::new();
        let mut outside = vec![0; viewpoints.len()];
        let around = |p: Vec3| KeyBox::touching(octree, &Aabb::of([p]).grown(radius));
        let inside = |p: Vec3| bounds.contains(p) && octree.key(p).is_some();
        let centers = || viewpoints.iter().map(|v| v.translation);
        let mut voxels = 0u64;
        for center in centers().filter(|c| inside(*c)) {
            let region = around(center);
            voxels = voxels.saturating_add(region.volume());
            lists.cover(&region);
        }
        if voxels > MOST_VOXELS || !lists.lay() {
            return None;
        }
        for (number, center) in centers().enumerate() {
            if !inside(center) {
                outside[number] = 1;
                continue;
            }
            let region = around(center);
            for z in region.min.z..region.max.z {
                for y in region.min.y..region.max.y {
                    for x in region.min.x..region.max.x {
                        let key = IVec3::new(x, y, z);
                        if is_touched(octree, center, radius, key) {
                            lists.add(number as u32, key);
                        }
                    }
                }
            }
        }
        let watched = lists.watched;
        Some(Self {
            occupied: vec![[0; 8]; watched.len()],
            watched: Arc::new(watched),
            blocked_by: outside.clone(),
            outside: Arc::new(outside),
        })
    }

    /// The same in a map in which nothing is known.
    pub fn forget(&mut self) {
        self.occupied.fill([0; 8]);
        self.blocked_by.copy_from_slice(&self.outside);
    }

    /// Learn what changed in the map.
    pub fn update(&mut self, octree: &Octree) {
        for (watched, known) in self.watched.iter().zip(&mut self.occupied) {
            let cell = octree.root().index(watched.brick);
            let brick = cell.and_then(|cell| octree.root().brick(cell));
            let occupied = brick.map_or([0; 8], |number| octree.bricks()[number].occupied);
            if occupied == *known {
                continue;
            }
            for touched in &watched.touched {
                let word = touched.word as usize;
                let (before, after) = (known[word], occupied[word]);
                if (before ^ after) & touched.voxels != 0 {
                    let count = &mut self.blocked_by[touched.viewpoint as usize];
                    *count += (after & touched.voxels).count_ones();
                    *count -= (before & touched.voxels).count_ones();
                }
            }
            *known = occupied;
        }
    }

    /// Whether the body is within bounds and touches nothing occupied at a viewpoint, by its number.
    pub fn is_clear(&self, viewpoint: usize) -> bool {
        self.blocked_by[viewpoint] == 0
    }
}

/// The watched bricks while they are listed, found by a grid over all bodies.
#[derive(Default)]
struct Lists {
    /// The first and the last brick per axis.
    low: IVec3,
    high: IVec3,
    dims: IVec3,
    /// Number of a cell's brick, plus one.
    cells: Vec<u32>,
    watched: Vec<Watched>,
}

impl Lists {
    fn new() -> Self {
        Self {
            low: IVec3::MAX,
            high: IVec3::MIN,
            ..Self::default()
        }
    }

    fn cover(&mut self, region: &KeyBox) {
        self.low = self.low.min(region.min >> 3);
        self.high = self.high.max((region.max - 1) >> 3);
    }

    fn lay(&mut self) -> bool {
        if self.low.cmpgt(self.high).any() {
            return true;
        }
        self.dims = self.high - self.low + 1;
        let cells = self.dims.as_u64vec3().element_product();
        self.cells = vec![0; cells.min(MOST_VOXELS) as usize];
        cells <= MOST_VOXELS
    }

    fn add(&mut self, viewpoint: u32, key: IVec3) {
        let brick = key >> 3;
        let c: IVec3 = brick - self.low;
        let cell = &mut self.cells[((c.z * self.dims.y + c.y) * self.dims.x + c.x) as usize];
        if *cell == 0 {
            let touched = Vec::new();
            self.watched.push(Watched { brick, touched });
            *cell = self.watched.len() as u32;
        }
        let touched = &mut self.watched[*cell as usize - 1].touched;
        let voxel = voxel_in_brick(key);
        let (word, voxels) = ((voxel >> 6) as u32, 1 << (voxel & 63));
        match touched.last_mut() {
            Some(last) if last.viewpoint == viewpoint && last.word == word => last.voxels |= voxels,
            _ => touched.push(Touched {
                viewpoint,
                word,
                voxels,
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::belief::integrate::Integrator;
    use crate::belief::octree::SensorModel;
    use crate::belief::viewpoints::{admissible, dome};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn it_is_what_looking_at_the_map_says(
            clouds in prop::collection::vec(prop::collection::vec((-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0).prop_map(Vec3::from), 0..60), 1..5),
            origin in (-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0).prop_map(Vec3::from),
            resolution in 0.03f64..0.3,
            radius in 0.0f32..0.3,
        ) {
            let mut octree = Octree::new(resolution, SensorModel::default()).unwrap();
            let bounds = Aabb::new(Vec3::splat(-0.9), Vec3::new(2.0, 0.5, 0.8));
            let viewpoints = dome(Vec3::new(0.1, 0.0, 0.2), 5, 12, 0.6, -0.6, 1.0);
            let mut clearance = Clearance::new(&octree, &bounds, &viewpoints, radius).unwrap();
            let fresh = clearance.clone();
            for cloud in clouds {
                // Later rays free what earlier ones hit.
                for _ in 0..2 {
                    Integrator::default().insert_points(&mut octree, cloud.iter().copied(), origin, None).unwrap();
                }
                clearance.update(&octree);
                for (number, viewpoint) in viewpoints.iter().enumerate() {
                    let expected = admissible(&octree, &bounds, viewpoint, radius);
                    prop_assert_eq!(clearance.is_clear(number), expected, "viewpoint {}", number);
                }
            }
            clearance.forget();
            prop_assert!(clearance.occupied == fresh.occupied && clearance.blocked_by == fresh.blocked_by);
        }
    }

    #[test]
    fn giants_are_not_listed() {
        let octree = Octree::new(0.01, SensorModel::default()).unwrap();
        let bounds = Aabb::new(Vec3::splat(-100.0), Vec3::splat(100.0));
        assert!(Clearance::new(&octree, &bounds, &[Pose::IDENTITY], 50.0).is_none());
    }
}
