//! Triangles that are none, or reach beyond all measure: nothing panics or hangs, and what is seen besides them stays as it was.
use super::tests::{brute_force_image, count_wrong, METHODS};
use super::*;
use crate::camera::DepthKind;
use proptest::prelude::*;

/// A number that arithmetic stumbles over.
fn odd() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => -3f32..3.0,
        1 => prop::sample::select(vec![
            f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, 3e38, 1e-30, -0.0, f32::MIN_POSITIVE, 1e-45,
        ]),
    ]
}

fn corner() -> impl Strategy<Value = Vec3> {
    [odd(), odd(), odd()].prop_map(Vec3::from_array)
}

fn soup(corners: Vec<[Vec3; 3]>) -> Mesh {
    let vertices: Vec<Vec3> = corners.into_iter().flatten().collect();
    let count = vertices.len() as u32 / 3;
    Mesh {
        vertices,
        triangles: (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
    }
}

/// Triangles with area, some 2 to 3 metres in front of the camera.
fn plain() -> impl Strategy<Value = Vec<[Vec3; 3]>> {
    let corner = |z: f32| [-2f32..2.0, -2f32..2.0].prop_map(move |[x, y]| Vec3::new(x, y, z));
    prop::collection::vec((corner(2.0), corner(2.5), corner(3.0)), 0..12).prop_map(|all| {
        let area = |t: &[Vec3; 3]| (t[1] - t[0]).cross(t[2] - t[0]).length();
        let all = all.into_iter().map(|(a, b, c)| [a, b, c]);
        all.filter(|t| area(t) > 1e-2).collect()
    })
}

/// Triangles that nobody can see: without area, or not finite. Lines and points lie off the pixels' rays.
fn invisible() -> impl Strategy<Value = Vec<[Vec3; 3]>> {
    let point = || [-3f32..3.0, -3f32..3.0, -3f32..3.0].prop_map(Vec3::from_array);
    let bad = prop::sample::select(vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY]);
    prop::collection::vec(
        prop_oneof![
            point().prop_map(|a| [a, a, a]),
            (point(), point()).prop_map(|(a, b)| [a, b, a]),
            (point(), point(), bad, 0..3usize).prop_map(|(a, b, bad, k)| {
                let mut c = a;
                c[k] = bad;
                [a, b, c]
            }),
        ],
        0..20,
    )
}

fn camera(kind: DepthKind) -> Camera {
    let mut camera = Camera::from_fov(13, 9, 1.4, 1.1, 0.1, 10.0).unwrap();
    camera.kind = kind;
    camera
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_triangles_give_an_image(corners in prop::collection::vec([corner(), corner(), corner()], 0..40), copies in 1..4usize) {
        let mesh = soup(corners.iter().copied().cycle().take(corners.len() * copies).collect());
        for isa in Isa::available() {
            let renderer = DepthRenderer::with_isa(&mesh, isa);
            for kind in [DepthKind::Range, DepthKind::Z] {
                let camera = camera(kind);
                for method in METHODS {
                    let mut image = vec![f32::NAN; camera.pixels()];
                    renderer.render_by(method, &camera, &Pose::IDENTITY, &mut image);
                    let valid = |d: &f32| *d == 0.0 || *d == f32::INFINITY || (0.1..=10.0).contains(d);
                    prop_assert!(image.iter().all(valid), "{isa:?} {method:?} {image:?}");
                }
            }
            let hit = renderer.cast(Vec3::ZERO, Vec3::Z, 10.0);
            prop_assert!(hit.is_none_or(|t| (0.0..=10.0).contains(&t)), "{hit:?}");
        }
    }

    #[test]
    fn what_cannot_be_seen_changes_nothing(good in plain(), bad in invisible(), twice in any::<bool>()) {
        let alone = soup(good.clone());
        let mut all = bad;
        all.extend(good.iter().copied());
        if twice {
            all.extend(good);
        }
        let mesh = soup(all);
        let camera = camera(DepthKind::Range);
        let truth = brute_force_image(&alone, &camera, &Pose::IDENTITY);
        for isa in Isa::available() {
            let (with, without) = (DepthRenderer::with_isa(&mesh, isa), DepthRenderer::with_isa(&alone, isa));
            for method in METHODS {
                let mut images = [vec![f32::NAN; camera.pixels()], vec![f32::NAN; camera.pixels()]];
                with.render_by(method, &camera, &Pose::IDENTITY, &mut images[0]);
                without.render_by(method, &camera, &Pose::IDENTITY, &mut images[1]);
                prop_assert_eq!(&images[0], &images[1], "{:?} {:?}", isa, method);
                // A ray may meet an edge, of which f32 and f64 may think differently.
                prop_assert!(count_wrong(&images[0], &truth, &camera) <= 1, "{isa:?} {method:?}");
            }
        }
    }
}
