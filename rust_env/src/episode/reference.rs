//! What coverage is measured against, by the setup's [`Truth`]: computed once for a scene, its dome or ring and a robot.
use super::start::free_views;
use crate::belief::integrate::Integrator;
use crate::belief::octree::Octree;
use crate::belief::uncertainty::UncertaintyModel;
use crate::error::Result;
use crate::geometry::{Pose, Vec3};
use crate::interrupt;
use crate::setup::{Setup, Truth};
use crate::world::ground_truth::{GroundTruth, Sight};
use crate::world::SceneAssets;
use std::sync::Arc;

/// The surface voxels that count, for an episode whose dome or ring stands at `anchor` (or whose free camera starts
/// there).
pub fn ground_truth(setup: &Setup, assets: &SceneAssets, anchor: Vec3) -> Result<Arc<GroundTruth>> {
    let (map, robot) = (&setup.map, &setup.robot);
    let key = format!(
        "{:?} {:?} {:?} {map:?} {anchor} {robot:?}",
        setup.truth, setup.views, setup.camera
    );
    assets.ground_truth(key, || {
        let scene = &assets.scene;
        let range = (map.max_range as f32).min(setup.camera.far);
        match (setup.truth, setup.views.is_fixed()) {
            (Truth::Images, _) => {
                let octree = reconstruction(setup, assets, &free_views(setup, assets, anchor))?;
                GroundTruth::within(&scene.visual, &scene.bounds, map.resolution, |brick| {
                    let cell = octree.root().index(brick);
                    let number = cell.and_then(|cell| octree.root().brick(cell));
                    number.map_or([0; 8], |n| octree.bricks()[n].occupied)
                })
            }
            (Truth::Sight, fixed) => {
                let (views, positions);
                let sight = if fixed {
                    views = free_views(setup, assets, anchor);
                    Sight::Views(&views)
                } else {
                    positions = assets.reachable_positions(anchor, robot.radius());
                    Sight::Positions(&positions)
                };
                GroundTruth::new(
                    &scene.visual,
                    &assets.renderer,
                    &scene.bounds,
                    map.resolution,
                    range,
                    &setup.camera,
                    &sight,
                )
            }
        }
    })
}

/// The map of a robot that takes a perfect image from each view, in their order.
fn reconstruction(setup: &Setup, assets: &SceneAssets, views: &[Pose]) -> Result<Octree> {
    let (map, camera) = (&setup.map, &setup.camera);
    let mut octree = Octree::new(map.resolution, map.sensor)?.limited_to(&assets.scene.bounds)?;
    let mut integrator = Integrator::default();
    let model = UncertaintyModel::of_camera(camera);
    let mut image = vec![0.0; camera.pixels()];
    for view in views {
        interrupt::check()?;
        assets.renderer.render(camera, view, &mut image);
        integrator.using(map.integration).insert_depth(
            &mut octree,
            &image,
            camera,
            view,
            Some(map.max_range),
            &model,
        )?;
    }
    Ok(octree)
}

#[cfg(test)]
mod tests;
