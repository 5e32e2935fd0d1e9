use super::*;
use crate::belief::octree::{SensorModel, State};
use crate::camera::DepthKind;
use crate::geometry::Aabb;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

fn points() -> impl Strategy<Value = Vec<Vec3>> {
    // Anywhere, or on a border between voxels, where rounding decides.
    let coordinate = || prop_oneof![-6.0f32..6.0, (-60..60i32).prop_map(|n| n as f32 * 0.1)];
    prop::collection::vec(
        (coordinate(), coordinate(), coordinate()).prop_map(Vec3::from),
        0..200,
    )
}

/// The reference: ray by ray, voxel by voxel.
fn one_by_one() -> Integrator {
    Integrator {
        max_window: 0,
        ..Integrator::with_lanes(Lanes::Scalar)
    }
}

fn map_of(
    mut integrator: Integrator,
    clouds: &[(Vec3, Vec<Vec3>)],
    max_range: Option<f64>,
    bounds: Option<Aabb>,
) -> Octree {
    let mut octree = Octree::new(0.1, SensorModel::default())
        .unwrap()
        .with_lanes(integrator.lanes);
    if let Some(bounds) = bounds {
        octree = octree.limited_to(&bounds).unwrap();
    }
    for (origin, cloud) in clouds {
        integrator
            .insert_points(&mut octree, cloud.iter().copied(), *origin, max_range)
            .unwrap();
    }
    octree
}

fn contents(octree: &Octree) -> Vec<(IVec3, u32, u32)> {
    let mut keys = octree.keys(State::Occupied);
    keys.extend(octree.keys(State::Free));
    keys.iter()
        .map(|k| {
            (
                *k,
                octree.log_odds(*k).unwrap().to_bits(),
                octree.uncertainty(*k).to_bits(),
            )
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn every_kind_of_walk_gives_the_same_map(
        clouds in prop::collection::vec(((-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0).prop_map(Vec3::from), points()), 1..4),
        range in prop::option::of(0.5f64..8.0),
        limited in any::<bool>(),
    ) {
        let bounds = limited.then(|| Aabb::new(Vec3::new(-2.03, -1.0, -3.3), Vec3::new(2.9, 4.0, 1.71)));
        let scalar = map_of(one_by_one(), &clouds, range, bounds);
        let counts = (scalar.num_known(), scalar.num_occupied(), scalar.entropy(), scalar.information());
        prop_assert_eq!(scalar.recount(), counts);
        for lanes in Lanes::available() {
            prop_assert_eq!(contents(&map_of(Integrator::with_lanes(lanes), &clouds, range, bounds)), contents(&scalar), "{:?}", lanes);
        }
    }

    #[test]
    fn bounds_only_leave_voxels_out(cloud in points()) {
        let bounds = Aabb::new(Vec3::new(-1.05, -2.0, -1.5), Vec3::new(1.5, 0.33, 3.0));
        let cloud = vec![(Vec3::splat(0.05), cloud)];
        let all = map_of(Integrator::default(), &cloud, Some(4.0), None);
        let limited = map_of(Integrator::default(), &cloud, Some(4.0), Some(bounds));
        let limits = limited.limits().unwrap();
        let mut expected: Vec<_> = contents(&all).into_iter().filter(|c| limits.contains(c.0)).collect();
        let mut found = contents(&limited);
        expected.sort_by_key(|c| c.0.to_array());
        found.sort_by_key(|c| c.0.to_array());
        prop_assert_eq!(found, expected);
    }
}

#[test]
fn hits_beat_misses_and_each_voxel_counts_once() {
    // The second ray passes through the voxel in which the first ends.
    let cloud = vec![
        Vec3::new(0.55, 0.05, 0.05),
        Vec3::new(1.05, 0.06, 0.05),
        Vec3::new(1.06, 0.05, 0.05),
    ];
    let octree = map_of(
        Integrator::default(),
        &[(Vec3::splat(0.05), cloud)],
        None,
        None,
    );
    let sensor = SensorModel::default();
    assert_eq!(octree.log_odds(IVec3::new(5, 0, 0)), Some(sensor.hit));
    assert_eq!(octree.log_odds(IVec3::new(10, 0, 0)), Some(sensor.hit));
    for x in [0, 1, 2, 3, 4, 6, 7, 8, 9] {
        assert_eq!(
            octree.log_odds(IVec3::new(x, 0, 0)),
            Some(sensor.miss),
            "voxel {x}"
        );
    }
    assert_eq!(octree.num_known(), 11);
}

#[test]
fn a_wide_image_takes_the_scalar_path_and_a_wider_one_is_refused() {
    let far = vec![Vec3::new(60.0, 60.0, 60.0)];
    let octree = map_of(
        Integrator::default(),
        &[(Vec3::splat(0.05), far.clone())],
        None,
        None,
    );
    assert_eq!(octree.num_occupied(), 1);
    let mut octree = Octree::new(0.1, SensorModel::default()).unwrap();
    let far = [Vec3::splat(3000.0)];
    assert!(Integrator::default()
        .insert_points(&mut octree, far, Vec3::splat(-3000.0), None)
        .is_err());
    assert_eq!(octree.num_known(), 0);
}

/// A depth image with all kinds of pixels.
fn image(seed: u64) -> Vec<f32> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    (0..camera().pixels())
        .map(|_| match random.random_range(0..8) {
            0 => f32::INFINITY,
            1 => [f32::NAN, 0.0, -1.0, f32::NEG_INFINITY, 1e30, 1e-30][random.random_range(0..6)],
            _ => random.random_range(0.1..6.0),
        })
        .collect()
}

fn camera() -> Camera {
    Camera::from_fov(37, 19, 1.1, 0.7, 0.0, 6.0).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn depth_images_give_the_map_of_their_points(
        seed in any::<u64>(),
        (x, y, z) in (-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0),
        (yaw, pitch) in (-3.0f32..3.0, -1.5f32..1.5),
        by_z in any::<bool>(),
    ) {
        let mut camera = camera();
        if by_z {
            camera.kind = DepthKind::Z;
        }
        let model = UncertaintyModel::of_camera(&camera);
        let pose = Pose::from_yaw_pitch(Vec3::new(x, y, z), yaw, pitch);
        let depth = image(seed);
        let mut reference = None;
        for mut integrator in [one_by_one()].into_iter().chain(Lanes::available().into_iter().map(Integrator::with_lanes)) {
            let lanes = integrator.lanes;
            let mut octree = Octree::new(0.1, SensorModel::default()).unwrap().with_lanes(lanes);
            integrator.insert_depth(&mut octree, &depth, &camera, &pose, Some(4.0), &model).unwrap();
            let sorted = contents(&octree);
            prop_assert_eq!(&sorted, reference.get_or_insert_with(|| sorted.clone()), "{:?}", lanes);
            // Every point is the camera's, bit for bit where glam's rotation is the one written out in `ends.rs`.
            let sensor = sensor(&octree, pose.translation, 4.0).unwrap();
            let mut ends = Ends::default();
            let optics = Optics::of(&camera, &model);
            ends.of_depth(lanes, &depth, &camera, &optics, &pose, &sensor);
            for (i, pixel) in optics.witnesses.order.iter().map(|pixel| *pixel as usize).enumerate() {
                let d = depth[pixel];
                if d.is_nan() || d <= 0.0 || d.is_infinite() {
                    continue;
                }
                let point = camera.unproject(&pose, pixel % camera.width, pixel / camera.width, d);
                let found = Vec3::new(ends.position[0][i], ends.position[1][i], ends.position[2][i]);
                if cfg!(target_arch = "x86_64") {
                    prop_assert_eq!(found.to_array().map(f32::to_bits), point.to_array().map(f32::to_bits));
                } else {
                    prop_assert!((found - point).length() <= 1e-5 * (1.0 + point.length()));
                }
            }
            // And ends where OctoMap's arithmetic, point by point, says.
            let points: Vec<Vec3> = (0..ends.len()).map(|i| Vec3::new(ends.position[0][i], ends.position[1][i], ends.position[2][i])).collect();
            ends.find(lanes, &sensor);
            for (i, p) in points.iter().enumerate() {
                let difference = *p - pose.translation;
                let length = norm(difference);
                let hit = length <= 4.0;
                let end = if hit { *p } else { pose.translation + difference / (length as f32) * 4.0 };
                let expected = octree.key(end).map_or((sensor.start, false), |k| (k, hit));
                prop_assert_eq!((ends.last(i), ends.hit[i]), expected, "{:?} {}", lanes, p);
            }
        }
    }
}
