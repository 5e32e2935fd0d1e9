use super::*;
use crate::belief::ray_walk::Dda;
use proptest::prelude::*;

const RESOLUTION: f64 = 0.1;
const SIDE: i32 = 64;

struct Scene {
    frame: Frame,
    end: [Vec<f32>; 3],
    cell: Vec<i32>,
    key: Vec<IVec3>,
    skip: Vec<f32>,
}

fn number(key: IVec3) -> i32 {
    let k = key + SIDE / 2;
    (k.z * SIDE + k.y) * SIDE + k.x
}

fn key_of(p: Vec3) -> IVec3 {
    (p.as_dvec3() / RESOLUTION).floor().as_ivec3()
}

impl Scene {
    fn new(origin: Vec3, mut ends: Vec<Vec3>) -> Self {
        ends.resize(ends.len().next_multiple_of(RAYS), origin);
        let start = key_of(origin);
        Self {
            frame: Frame {
                resolution: RESOLUTION,
                origin,
                start,
                start_cell: number(start),
                strides: [1, SIDE, SIDE * SIDE],
                max_steps: 3 * SIDE,
            },
            end: [0, 1, 2].map(|axis| ends.iter().map(|e| e[axis]).collect()),
            cell: ends.iter().map(|e| number(key_of(*e))).collect(),
            skip: vec![0.0; ends.len()],
            key: ends.iter().map(|e| key_of(*e)).collect(),
        }
    }

    fn rays(&self) -> Rays<'_> {
        Rays {
            end: [0, 1, 2].map(|axis| self.end[axis].as_slice()),
            cell: &self.cell,
            skip: &self.skip,
        }
    }

    /// One ray after the other, as OctoMap writes it; what is skipped is left out, where it is certain.
    fn reference(&self) -> Vec<u8> {
        let mut window = empty();
        for (i, last) in self.key.iter().enumerate() {
            if *last == self.frame.start {
                continue;
            }
            let end = Vec3::new(self.end[0][i], self.end[1][i], self.end[2][i]);
            let difference = end - self.frame.origin;
            let length = f64::from(difference.dot(difference)).sqrt() as f32;
            let mut walk = Dda::new(
                RESOLUTION,
                self.frame.start,
                self.frame.origin,
                difference / length,
            );
            loop {
                if walk.exit() > f64::from(self.skip[i]) {
                    window[number(walk.key) as usize] = FREE;
                }
                walk.advance();
                if walk.key == *last || walk.exit() > f64::from(length) {
                    break;
                }
            }
        }
        window
    }

    /// What is marked, and how many rays were walked twice.
    fn traced(&self, lanes: Lanes) -> (Vec<u8>, usize) {
        let (mut window, mut doubtful) = (empty(), Doubtful::default());
        trace(lanes, &self.frame, &self.rays(), &mut window, &mut doubtful);
        *window.last_mut().unwrap() = 0;
        (window, doubtful.number.len())
    }
}

fn empty() -> Vec<u8> {
    vec![0; (SIDE * SIDE * SIDE) as usize + 1]
}

/// Anywhere, on borders of voxels, or nearly there.
fn coordinate(most: i32) -> impl Strategy<Value = f32> {
    let on_grid = -most..most;
    prop_oneof![
        (-most as f32 * 0.1)..(most as f32 * 0.1),
        on_grid.clone().prop_map(|n| n as f32 * 0.1),
        (on_grid, -3..4i32)
            .prop_map(|(n, ulps)| {
                let x = n as f32 * 0.1;
                f32::from_bits(x.to_bits().wrapping_add_signed(ulps))
            })
            .prop_filter("a number", |x| x.abs() < 3.0),
    ]
}

fn point(most: i32) -> impl Strategy<Value = Vec3> {
    (coordinate(most), coordinate(most), coordinate(most)).prop_map(Vec3::from)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]
    #[test]
    fn marks_are_those_of_the_walk_ray_by_ray(origin in point(5), ends in prop::collection::vec(point(29), 1..100)) {
        let scene = Scene::new(origin, ends);
        let expected = scene.reference();
        for lanes in Lanes::available() {
            prop_assert!(scene.traced(lanes).0 == expected, "{:?}", lanes);
        }
    }

    #[test]
    fn what_is_skipped_is_where_the_walk_would_begin(
        origin in point(5),
        ends in prop::collection::vec((point(29), 0.0f32..5.0), 1..100),
    ) {
        let (ends, skip): (Vec<_>, Vec<_>) = ends.into_iter().unzip();
        let mut scene = Scene::new(origin, ends);
        scene.skip[..skip.len()].copy_from_slice(&skip);
        let least = scene.reference();
        scene.skip.fill(0.0);
        let most = scene.reference();
        scene.skip[..skip.len()].copy_from_slice(&skip);
        for lanes in Lanes::available() {
            let (traced, doubtful) = scene.traced(lanes);
            // Rays in doubt are walked whole.
            let between = traced.iter().zip(&least).zip(&most).all(|((t, least), most)| least <= t && t <= most);
            prop_assert!(between, "{:?}", lanes);
            prop_assert!(doubtful > 0 || traced == least, "{:?}", lanes);
        }
    }

    #[test]
    fn the_exact_walk_alone_gives_the_same(origin in point(5), ends in prop::collection::vec(point(29), 1..50)) {
        let scene = Scene::new(origin, ends);
        let mut window = empty();
        exact::trace(&scene.frame, &scene.rays(), &mut window);
        *window.last_mut().unwrap() = 0;
        prop_assert!(window == scene.reference());
    }
}

#[test]
fn few_rays_are_doubtful_and_ties_are_among_them() {
    let grid = |n: i32| (0..n * n).map(move |i| (i % n, i / n));
    let anywhere: Vec<Vec3> = grid(48)
        .map(|(u, v)| Vec3::new(2.017, u as f32 * 0.0513 - 1.21, v as f32 * 0.0497 - 1.19))
        .collect();
    // From the middle of a voxel along diagonals: all three borders come at once.
    let diagonal: Vec<Vec3> = grid(4)
        .map(|(u, v)| Vec3::splat(0.05) + Vec3::splat(0.5 + 0.1 * (u * 4 + v) as f32))
        .collect();
    for lanes in Lanes::available() {
        let scene = Scene::new(Vec3::new(0.031, 0.012, 0.043), anywhere.clone());
        let (window, doubtful) = scene.traced(lanes);
        assert!(doubtful <= 4, "{lanes:?}: {doubtful} of 2304");
        assert!(window == scene.reference());
        let scene = Scene::new(Vec3::splat(0.05), diagonal.clone());
        let (window, doubtful) = scene.traced(lanes);
        assert_eq!(doubtful, 16);
        assert!(window == scene.reference());
    }
}

#[test]
fn an_order_is_certain_only_where_rounding_cannot_change_it() {
    // The sums that the walk makes, against exact ones: each within half of the margin.
    for (t0, dt, steps) in [(0.3, 1.7, 1000), (0.99, 123.4, 77), (0.5, 0.5, 4000)] {
        let rounded = |x: f64| (x + 0.5).floor();
        let sum = (0..steps).fold(rounded(t0), |t, _| t + rounded(dt));
        let exact = t0 + f64::from(steps) * dt;
        assert!((sum - exact).abs() <= f64::from(fixed_point::margin(steps)));
    }
    assert_eq!(fixed_point::margin(136), 71);
}

#[test]
fn a_walk_that_would_begin_on_a_border_begins_at_the_sensor() {
    // Along x from the middle of a voxel: borders at 0.05, 0.15, ... metres.
    let origin = Vec3::new(0.05, 0.013, 0.017);
    for (skip, doubtful) in [
        (0.45, 16),
        (0.450_000_02, 16),
        (0.47, 0),
        (0.999_999, 16),
        (1.0, 0),
        (1.1, 0),
    ] {
        let mut scene = Scene::new(origin, vec![origin + Vec3::X; 16]);
        let whole = scene.reference();
        scene.skip.fill(skip);
        let skipped = scene.reference();
        for lanes in Lanes::available() {
            let (traced, found) = scene.traced(lanes);
            assert_eq!(found, doubtful, "{lanes:?} {skip}");
            assert!(
                traced == if doubtful > 0 { &whole } else { &skipped }[..],
                "{lanes:?} {skip}"
            );
        }
    }
}
