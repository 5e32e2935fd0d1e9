//! Which object a point of the visual surface belongs to.
use std::collections::HashMap;

use super::ground_truth::{floor, voxels_of};
use super::motion::closest_point;
use super::scene::Scene;
use crate::error::Result;
use crate::geometry::{IVec3, Mesh, Vec3};
use crate::interrupt;
use glam::DVec3;

/// Side of a cell, metres; larger where the scene is larger than `MAX_CELLS` of them along an axis.
const SIDE: f64 = 0.05;
const MAX_CELLS: f64 = 1000.0;
/// A measured point lies this close to its triangle, metres.
const REACH: f32 = 1e-3;
/// Cells of all triangles together, besides `CELLS_EACH` for each; with more the cells are made coarser.
const MAX_TOUCHES: usize = 1 << 24;
const CELLS_EACH: usize = 8;

/// What lies in a cell: triangles `first..end` of the grid's list, and their object if they have only one.
#[derive(Clone, Copy)]
struct Cell {
    first: u32,
    end: u32,
    only: Option<u32>,
}

/// The cells `low` to `high`.
#[derive(Clone, Copy)]
pub struct Around {
    low: IVec3,
    high: IVec3,
    cells: [Option<Cell>; 8],
    /// Their object if they have only one.
    only: Option<u32>,
}

/// The visual triangles in cells.
pub struct ObjectGrid {
    side: f64,
    cells: HashMap<IVec3, Cell>,
    triangles: Vec<u32>,
}

impl ObjectGrid {
    /// # Errors
    /// Only if the user asks to stop.
    pub fn new(scene: &Scene) -> Result<Self> {
        let extent = f64::from(scene.visual.bounds().size().max_element().max(0.0));
        let mut side = SIDE.max(extent / MAX_CELLS);
        let mut touches = loop {
            match touches(&scene.visual, side)? {
                Some(touches) => break touches,
                None => side *= 2.0,
            }
        };
        touches.sort_unstable_by_key(|(cell, triangle)| (cell.to_array(), *triangle));
        let mut cells = HashMap::new();
        for (i, (cell, triangle)) in touches.iter().enumerate() {
            let object = scene.objects.get(*triangle as usize).copied();
            let entry = cells.entry(*cell).or_insert(Cell {
                first: i as u32,
                end: i as u32,
                only: object,
            });
            entry.end += 1;
            if entry.only != object {
                entry.only = None;
            }
        }
        Ok(Self {
            side,
            cells,
            triangles: touches.into_iter().map(|(_, t)| t).collect(),
        })
    }

    /// The object of the triangle nearest to a point of the surface; `None` where there is none.
    ///
    /// `last` is what is known of the cells around the last point: neighbours often share them.
    pub fn object_at(&self, scene: &Scene, point: Vec3, last: &mut Option<Around>) -> Option<u32> {
        if !point.is_finite() {
            return None;
        }
        let (low, high) = (key(point - REACH, self.side), key(point + REACH, self.side));
        let known = last.filter(|around| around.low == low && around.high == high);
        let around = known.unwrap_or_else(|| self.around(low, high));
        *last = Some(around);
        if around.only.is_some() {
            return around.only;
        }
        let mut nearest: Option<(f32, u32)> = None;
        for cell in around.cells.iter().flatten() {
            for triangle in &self.triangles[cell.first as usize..cell.end as usize] {
                let [a, b, c] = scene.visual.corners(*triangle as usize);
                let distance = closest_point(point, a, b, c).distance_squared(point);
                if nearest.is_none_or(|(least, _)| distance < least) {
                    nearest = Some((distance, *triangle));
                }
            }
        }
        scene.objects.get(nearest?.1 as usize).copied()
    }

    fn around(&self, low: IVec3, high: IVec3) -> Around {
        // Cells are far larger than the reach: at most two along an axis.
        let cells = std::array::from_fn(|corner| {
            let corner = corner as i32;
            let upper = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
            let beyond = (low + upper).cmpgt(high).any();
            let cell = (!beyond).then(|| self.cells.get(&(low + upper)));
            cell.flatten().copied()
        });
        let mut there = cells.iter().flatten().map(|cell: &Cell| cell.only);
        let first = there.next().flatten();
        Around {
            low,
            high,
            cells,
            only: first.filter(|_| there.all(|only| only == first)),
        }
    }
}

/// (cell, triangle), in the order of the triangles; `None` if there are too many.
fn touches(mesh: &Mesh, side: f64) -> Result<Option<Vec<(IVec3, u32)>>> {
    let limit = MAX_TOUCHES + CELLS_EACH * mesh.triangles.len();
    let mut touches = Vec::new();
    for t in 0..mesh.triangles.len() {
        let corners = mesh.corners(t);
        if !corners.iter().all(|c| c.is_finite()) {
            continue;
        }
        let (low, high) = (IVec3::MIN, IVec3::MAX);
        voxels_of(corners, side, low, high, |cell| {
            touches.push((cell, t as u32))
        });
        if touches.len() > limit {
            return Ok(None);
        }
        if t % 4096 == 0 {
            interrupt::check()?;
        }
    }
    Ok(Some(touches))
}

fn key(point: Vec3, side: f64) -> IVec3 {
    // Far from the ends of i32, beyond all scenes.
    floor((point.as_dvec3() / side).clamp(DVec3::splat(-1e9), DVec3::splat(1e9)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use crate::geometry::Pose;
    use crate::world::scenes::generate;
    use crate::world::SceneAssets;

    fn camera(far: f64) -> Camera {
        Camera::from_fov(40, 30, 1.2, 1.0, 0.05, far).unwrap()
    }

    /// The nearest triangle of all decides; where two objects are equally near, either answer is right.
    #[test]
    fn objects_are_those_of_the_nearest_triangles() {
        for (kind, seed) in [("room", 3), ("tabletop", 1)] {
            let assets = SceneAssets::new(generate(kind, seed).unwrap()).unwrap();
            let scene = &assets.scene;
            let grid = ObjectGrid::new(scene).unwrap();
            let (eye, yaw) = assets.starts[0];
            let pose = Pose::from_yaw_pitch(eye, yaw, -0.3);
            let camera = camera(6.0);
            let mut depth = vec![0.0; camera.pixels()];
            assets.renderer.render(&camera, &pose, &mut depth);
            let (mut checked, mut furniture, mut last) = (0, 0, None);
            for (i, depth) in depth.iter().enumerate().filter(|(_, d)| d.is_finite()) {
                let end = camera.unproject(&pose, i % camera.width, i / camera.width, *depth);
                let distance = |t: usize| {
                    let [a, b, c] = scene.visual.corners(t);
                    closest_point(end, a, b, c).distance(end)
                };
                let near: Vec<(f32, u32)> = (0..scene.visual.triangles.len())
                    .map(|t| (distance(t), scene.objects[t]))
                    .filter(|(d, _)| *d < 1e-2)
                    .collect();
                let least = near.iter().fold(f32::INFINITY, |l, (d, _)| l.min(*d));
                assert!(least < REACH, "{kind}: a pixel off the surface by {least}");
                let object = grid.object_at(scene, end, &mut last).unwrap();
                assert!(near.iter().any(|(d, o)| *o == object && *d <= least + 1e-5));
                checked += 1;
                furniture += usize::from(object != 0);
            }
            assert!(
                checked > 500 && furniture > 50,
                "{kind}: {furniture} of {checked}"
            );
        }
    }

    /// Every instance has triangles of its own, and the shell has some.
    #[test]
    fn generated_scenes_number_their_instances() {
        for kind in crate::world::scenes::KINDS {
            let scene = generate(kind, 5).unwrap();
            assert_eq!(scene.objects.len(), scene.visual.triangles.len());
            let mut numbers = scene.objects.clone();
            numbers.sort_unstable();
            numbers.dedup();
            let count = numbers.len();
            assert_eq!(count, scene.report.instances + 1, "{kind}");
            assert_eq!(numbers.last(), Some(&(scene.report.instances as u32)));
        }
    }

    /// Points of no surface, and of a scene without any.
    #[test]
    fn nothing_is_nowhere() {
        let empty = Scene::default();
        let grid = ObjectGrid::new(&empty).unwrap();
        assert_eq!(grid.object_at(&empty, Vec3::ONE, &mut None), None);
        let room = generate("room", 0).unwrap();
        let grid = ObjectGrid::new(&room).unwrap();
        for far in [Vec3::splat(1e9), Vec3::splat(-1e9), Vec3::NAN] {
            assert_eq!(grid.object_at(&room, far, &mut None), None);
        }
    }
}
