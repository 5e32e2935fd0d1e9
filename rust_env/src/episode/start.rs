//! Where an episode begins.
use crate::belief::viewpoints::ViewSpace;
use crate::belief::Prior;
use crate::error::{Error, Result};
use crate::geometry::{Pose, Vec3};
use crate::setup::Setup;
use crate::world::arm_motion::{StandingArm, STEP};
use crate::world::SceneAssets;
use rand::seq::IndexedRandom;
use rand_pcg::Pcg64Mcg;
use std::sync::Arc;

#[derive(Clone, Copy)]
pub struct Start {
    pub pose: Pose,
    /// Centre of the fixed views, if the task has such.
    pub anchor: Vec3,
}

impl Start {
    pub fn prior(&self, assets: &SceneAssets) -> Prior {
        Prior {
            bounds: assets.scene.bounds,
            start: self.pose,
            anchor: self.anchor,
        }
    }

    /// Whether `draw` can have given this anchor.
    pub fn is_of(&self, assets: &SceneAssets) -> bool {
        let is = |p: Vec3| p == self.anchor;
        is(assets.scene.bounds.center()) || assets.starts.iter().any(|(p, _)| is(*p))
    }

    pub fn draw(setup: &Setup, assets: &SceneAssets, rng: &mut Pcg64Mcg) -> Result<Self> {
        let scene = &assets.scene;
        let radius = setup.robot.radius();
        let none = |what: &str| {
            Err(Error::invalid(format!(
                "scene {:?} has no {what} for a body of radius {radius} m",
                scene.name
            )))
        };
        let anchors = match &setup.views {
            ViewSpace::SixDirections { .. } => {
                let free: Vec<_> = assets
                    .starts
                    .iter()
                    .filter(|(p, _)| assets.shape.is_free(*p, radius))
                    .collect();
                let Some((position, yaw)) = free.choose(rng) else {
                    return none("free start");
                };
                return Ok(Self {
                    pose: Pose::from_yaw_pitch(*position, *yaw, 0.0),
                    anchor: *position,
                });
            }
            // The roomiest place where the robot has room.
            ViewSpace::Dome { .. } => assets.starts.iter().map(|(p, _)| *p).collect(),
            ViewSpace::Ring { .. } => vec![scene.bounds.center()],
        };
        for &anchor in &anchors {
            if let Some(pose) = free_views(setup, assets, anchor).choose(rng) {
                return Ok(Self {
                    pose: *pose,
                    anchor,
                });
            }
        }
        none(if anchors.is_empty() {
            "place for a dome"
        } else {
            "free viewpoint"
        })
    }
}

/// The fixed views around `anchor` that the robot can take: where its body has room and, with its shoulder at the anchor,
/// its arm. Of an arm's views those that it can reach from one another; where obstacles part them, the most.
pub fn free_views(setup: &Setup, assets: &SceneAssets, anchor: Vec3) -> Arc<Vec<Pose>> {
    let key = format!("{:?} {:?} {anchor}", setup.views, setup.robot);
    assets.free_views(key, || {
        let views = setup.views.views(&Pose::IDENTITY, anchor);
        let (shape, radius) = (&assets.shape, setup.robot.radius());
        let free: Vec<usize> = match setup.robot.arm() {
            None => (0..views.len())
                .filter(|&i| shape.is_free(views[i].translation, radius))
                .collect(),
            Some(arm) => {
                let hand = |i: usize| views[i].translation;
                let free = |i: usize| shape.has_room(arm, radius, anchor, hand(i));
                let passes = |i: usize, j: usize| {
                    let mut standing = StandingArm::new(arm, radius, anchor, hand(i));
                    let way = standing.follow(shape, hand(i), &[hand(j)], STEP, |_, _, _| true);
                    !way.contact
                };
                let open: Vec<bool> = (0..views.len()).map(free).collect();
                largest_part(&open, |i| setup.views.neighbours(i), passes)
            }
        };
        free.into_iter().map(|i| views[i]).collect()
    })
}

/// The largest set of open nodes that hang together by neighbours between which one can pass, ascending; the first of
/// equal ones.
fn largest_part(
    open: &[bool],
    neighbours: impl Fn(usize) -> Vec<usize>,
    passes: impl Fn(usize, usize) -> bool,
) -> Vec<usize> {
    let mut left = open.to_vec();
    let mut largest = Vec::new();
    for first in 0..left.len() {
        if !std::mem::replace(&mut left[first], false) {
            continue;
        }
        let mut part = vec![first];
        let mut next = 0;
        while next < part.len() {
            let here = part[next];
            next += 1;
            for there in neighbours(here) {
                if left[there] && passes(here, there) {
                    left[there] = false;
                    part.push(there);
                }
            }
        }
        if part.len() > largest.len() {
            largest = part;
        }
    }
    largest.sort_unstable();
    largest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::Arm;
    use crate::belief::octree::SensorModel;
    use crate::camera::Camera;
    use crate::geometry::{Aabb, Mesh};
    use crate::robot::Robot;
    use crate::setup::{MapSpec, SceneChoice, Truth};
    use crate::world::bodies::BodiesSpec;
    use crate::world::scene::Scene;

    fn setup(robot: Robot) -> Setup {
        Setup {
            scene: SceneChoice::parse("room").unwrap(),
            camera: Camera::from_fov(8, 6, 1.05, 0.8, 0.0, 4.0).unwrap(),
            robot,
            map: MapSpec::new(0.1, 4.0, SensorModel::default()).unwrap(),
            views: ViewSpace::dome(8, 24, 0.6, -0.6, 1.0).unwrap(),
            local_map: None,
            noise: None,
            lidar: None,
            bodies: BodiesSpec::default(),
            truth: Truth::default(),
        }
    }

    /// A place at the origin between walls of no thickness, from floor to ceiling: `y` and `x` from here to there.
    fn assets(walls: &[[f32; 4]]) -> SceneAssets {
        let mut mesh = Mesh::default();
        for [x, y, to_x, to_y] in walls {
            let n = mesh.vertices.len() as u32;
            for (x, y) in [(x, y), (to_x, to_y)] {
                mesh.vertices.push(Vec3::new(*x, *y, -1.25));
                mesh.vertices.push(Vec3::new(*x, *y, 1.25));
            }
            mesh.triangles
                .extend([[n, n + 1, n + 2], [n + 1, n + 2, n + 3]]);
        }
        SceneAssets::new(Scene {
            visual: mesh,
            bounds: Aabb::new(Vec3::splat(-2.0), Vec3::splat(2.0)),
            starts: vec![(Vec3::Y * 9.0, 0.0), (Vec3::ZERO, 0.0)],
            ..Scene::default()
        })
        .unwrap()
    }

    #[test]
    fn an_arm_starts_where_all_that_counts_can_be_reached() {
        let flying = Robot::flying(0.05, 0.5, 1.5).unwrap();
        let arm = setup(
            flying
                .clone()
                .held_by(Arm::new(0.425, 0.392, 0.06).unwrap()),
        );
        // Two walls part the dome into unequal halves.
        let parted = assets(&[[0.0, 0.15, -0.3, 2.0], [0.0, -0.15, -0.3, -2.0]]);
        let views = free_views(&arm, &parted, Vec3::ZERO);
        assert!((60..100).contains(&views.len()), "{}", views.len());
        assert!(views.iter().all(|v| v.translation.x > -0.1));
        let floating = free_views(&setup(flying), &parted, Vec3::ZERO);
        assert!(floating.iter().any(|v| v.translation.x < -0.4));
        // One wall alone parts nothing: the arm goes round the other way.
        let joined = free_views(&arm, &assets(&[[0.0, 0.15, -0.3, 2.0]]), Vec3::ZERO);
        assert!(joined.iter().any(|v| v.translation.x < -0.4) && joined.len() > views.len());
        let mut rng = rand::SeedableRng::seed_from_u64(1);
        for _ in 0..20 {
            let start = Start::draw(&arm, &parted, &mut rng).unwrap();
            assert!(start.is_of(&parted));
            let here = free_views(&arm, &parted, start.anchor);
            assert!(here.contains(&start.pose));
        }
    }

    #[test]
    fn where_the_arm_has_no_room_the_dome_moves_on() {
        let arm = Arm::new(0.425, 0.392, 0.06).unwrap();
        let arm = setup(Robot::flying(0.05, 0.5, 1.5).unwrap().held_by(arm));
        // A ball has room around the first place, a shoulder in the wall there has none.
        let crossed = assets(&[[-2.0, 9.0, 2.0, 9.0]]);
        let mut rng = rand::SeedableRng::seed_from_u64(1);
        let start = Start::draw(&arm, &crossed, &mut rng).unwrap();
        assert_eq!(start.anchor, Vec3::ZERO);
        let both = assets(&[[-2.0, 9.0, 2.0, 9.0], [-2.0, 0.0, 2.0, 0.0]]);
        let error = Start::draw(&arm, &both, &mut rng)
            .err()
            .unwrap()
            .to_string();
        assert!(error.contains("free viewpoint"), "{error}");
    }

    #[test]
    fn the_largest_part() {
        let line = |i: usize| {
            [i.wrapping_sub(1), i + 1]
                .into_iter()
                .filter(|j| *j < 7)
                .collect()
        };
        let open = [true, true, false, true, true, true, true];
        assert_eq!(largest_part(&open, line, |_, _| true), [3, 4, 5, 6]);
        assert_eq!(largest_part(&open, line, |i, j| i + j != 9), [0, 1]);
        assert_eq!(largest_part(&[false; 7], line, |_, _| true), [0usize; 0]);
    }
}
