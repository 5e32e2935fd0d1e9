//! What every generated scene must keep, checked over many seeds: the laws that hold for all kinds.
use super::bathroom;
use super::crockery;
use super::draft::{Draft, CAMERA_HEIGHT};
use super::draw::{Draw, Random};
use super::fixtures as fix;
use super::footprint::contains;
use super::furniture as make;
use super::layout::{Piece, Use};
use super::objects as small;
use super::seats;
use super::{draft, generate, KINDS};
use crate::geometry::{Aabb, Mesh, Vec3};
use glam::Vec2;
use rand::SeedableRng;

pub(super) fn plan(kind: &str, seed: u64) -> Draft {
    draft(kind, &mut Random::seed_from_u64(seed)).unwrap()
}

fn indoor_kinds() -> impl Iterator<Item = &'static str> {
    KINDS.iter().copied().filter(|k| *k != "tabletop")
}

/// Distance from a point to a triangle (Ericson, Real-Time Collision Detection, 5.1.5).
fn point_triangle(p: Vec3, [a, b, c]: [Vec3; 3]) -> f32 {
    let n = (b - a).cross(c - a);
    let inside = |u: Vec3, v: Vec3| (v - u).cross(p - u).dot(n) >= 0.0;
    if inside(a, b) && inside(b, c) && inside(c, a) {
        return ((p - a).dot(n) / n.length()).abs();
    }
    let edge = |u: Vec3, v: Vec3| {
        let t = (p - u).dot(v - u) / (v - u).length_squared();
        p.distance(u + (v - u) * t.clamp(0.0, 1.0))
    };
    edge(a, b).min(edge(b, c)).min(edge(c, a))
}

fn clearance(mesh: &Mesh, p: Vec3) -> f32 {
    (0..mesh.triangles.len())
        .map(|t| point_triangle(p, mesh.corners(t)))
        .fold(f32::INFINITY, f32::min)
}

#[test]
fn same_seed_same_scene_and_another_seed_another() {
    for kind in KINDS {
        let (a, b) = (generate(kind, 3).unwrap(), generate(kind, 3).unwrap());
        assert_eq!(a.visual, b.visual, "{kind}");
        assert_eq!(a.starts, b.starts, "{kind}");
        assert_eq!(a.bounds, b.bounds, "{kind}");
        assert_ne!(a.visual, generate(kind, 4).unwrap().visual, "{kind}");
    }
}

#[test]
fn unknown_kind_is_named() {
    let error = generate("castle", 0).unwrap_err().to_string();
    assert!(
        error.contains("castle") && error.contains("room"),
        "{error}"
    );
}

#[test]
fn triangles_are_finite_distinct_and_inside_the_bounds() {
    for kind in KINDS {
        for seed in 0..40 {
            let s = generate(kind, seed).unwrap();
            let all = s.visual.bounds();
            assert!(
                s.visual.vertices.iter().all(|v| v.is_finite()),
                "{}",
                s.name
            );
            assert_eq!(s.report.visual_bounds, all, "{}", s.name);
            assert!(s.collision.triangles.is_empty());
            assert!(s.floor > 0.0 && s.floor < 0.06);
            let n = s.visual.triangles.len();
            if *kind == "tabletop" {
                assert!((2_000..14_000).contains(&n), "{}: {n} triangles", s.name);
                // The objects are inside: what is above the table's surface does not stick out.
                let surface = s.bounds.min.z + 0.21;
                assert!(s
                    .visual
                    .vertices
                    .iter()
                    .all(|v| v.z < surface || s.bounds.contains(*v)));
            } else {
                assert!(
                    s.bounds.grown(1e-3).contains(all.min)
                        && s.bounds.grown(1e-3).contains(all.max)
                );
                assert!((1_500..250_000).contains(&n), "{}: {n} triangles", s.name);
                assert!(
                    s.report.instances >= 12,
                    "{}: {}",
                    s.name,
                    s.report.instances
                );
            }
            let mut keys: Vec<_> = (0..n)
                .map(|t| {
                    let mut c = s.visual.corners(t).map(|v| v.to_array().map(f32::to_bits));
                    c.sort_unstable();
                    assert!(c[0] != c[1] && c[1] != c[2], "{}: degenerate {t}", s.name);
                    c
                })
                .collect();
            keys.sort_unstable();
            assert!(
                keys.windows(2).all(|w| w[0] != w[1]),
                "{}: duplicate",
                s.name
            );
        }
    }
}

#[test]
fn starts_are_clear_of_all_geometry() {
    for kind in KINDS {
        for seed in 0..60 {
            let s = generate(kind, seed).unwrap();
            assert_eq!(s.starts.len(), 3, "{}", s.name);
            for (i, (p, yaw)) in s.starts.iter().enumerate() {
                assert!(yaw.is_finite());
                assert!((p.z - s.floor - CAMERA_HEIGHT).abs() < 1e-4);
                let need = if i == 0 { 0.7 } else { 0.4 };
                let free = clearance(&s.visual, *p);
                assert!(free >= need, "{} start {i}: {free} m", s.name);
            }
            if *kind != "tabletop" {
                // The whole cylinder of 1 m radius up to the camera dome is free, but for the floor.
                let p = s.starts[0].0;
                for z in [0.3, 0.8, 1.3, 1.8] {
                    let at = Vec3::new(p.x, p.y, s.floor + z);
                    let side = (0..s.visual.triangles.len())
                        .map(|t| s.visual.corners(t))
                        .filter(|c| c.iter().any(|v| v.z > s.floor + 0.02))
                        .filter(|c| c.iter().any(|v| v.z < s.floor + 2.2))
                        .map(|c| point_triangle(at, c))
                        .fold(f32::INFINITY, f32::min);
                    assert!(side >= 1.0, "{} free disc at {z}: {side} m", s.name);
                }
            }
        }
    }
}

type Maker = fn(&mut Random) -> Piece;

/// Every maker of a piece, by name.
fn makers() -> Vec<(&'static str, Maker)> {
    vec![
        ("table", |r| make::table(r, 1.4, 0.9, 0.75, Use::Dining)),
        ("round table", |r| {
            make::round_table(r, 0.5, 0.75, Use::Dining)
        }),
        ("chair", seats::chair),
        ("stool", |r| seats::stool(r, 0.45)),
        ("office chair", seats::office_chair),
        ("sofa", |r| seats::sofa(r, 3)),
        ("bed", |r| seats::bed(r, 1.6)),
        ("shelf", |r| make::shelf(r, 1.0, 0.3, 1.8, Use::Shelf)),
        ("wardrobe", make::wardrobe),
        ("dresser", make::dresser),
        ("nightstand", make::nightstand),
        ("desk", make::desk),
        ("coffee table", make::coffee_table),
        ("tv stand", make::tv_stand),
        ("counter", |r| {
            fix::counter(r, [0.6, 0.6, 0.9], fix::Unit::Plain)
        }),
        ("sink", |r| {
            fix::counter(r, [0.6, 0.6, 0.9], fix::Unit::Sink)
        }),
        ("stove", |r| {
            fix::counter(r, [0.6, 0.6, 0.9], fix::Unit::Stove)
        }),
        ("fridge", fix::fridge),
        ("washing machine", bathroom::washing_machine),
        ("wall cabinet", |r| fix::wall_cabinet(r, 0.6)),
        ("picture", |r| fix::picture(r, 0.5, 0.4)),
        ("radiator", fix::radiator),
        ("curtain", |r| fix::curtain(r, 2.2)),
        ("floor lamp", fix::floor_lamp),
        ("hanging lamp", |r| fix::hanging_lamp(r, 0.5)),
        ("plant", fix::plant),
        ("bin", fix::bin),
        ("toilet", bathroom::toilet),
        ("washbasin", bathroom::washbasin),
        ("bathtub", bathroom::bathtub),
        ("coat rack", fix::coat_rack),
        ("shoes", fix::shoes),
        ("suitcase", fix::suitcase),
        ("fan", fix::fan),
        ("carton", |r| small::carton(r, 0.1, 0.3)),
        ("open box", small::open_box),
        ("mug", |r| crockery::mug(r, 12)),
        ("glass", |r| crockery::glass(r, 12)),
        ("plate", |r| crockery::plate(r, 12)),
        ("bowl", |r| crockery::bowl(r, 12)),
        ("fruit bowl", |r| crockery::fruit_bowl(r, 12)),
        ("bottle", |r| crockery::bottle(r, 12)),
        ("tin", |r| crockery::tin(r, 12)),
        ("vase", |r| crockery::vase(r, 12)),
        ("pot", |r| crockery::pot(r, 12)),
        ("kettle", |r| crockery::kettle(r, 12)),
        ("toaster", small::toaster),
        ("sphere", |r| small::sphere(r, 12)),
        ("book stack", small::book_stack),
        ("book row", |r| small::book_row(r, Vec2::new(0.8, 0.3), 0.3)),
        ("picture frame", small::picture_frame),
        ("pen pot", |r| small::pen_pot(r, 12)),
        ("table lamp", |r| small::table_lamp(r, 12)),
        ("small plant", |r| small::small_plant(r, 12)),
        ("monitor", small::monitor),
        ("keyboard", small::keyboard),
        ("laptop", small::laptop),
        ("speaker", |r| small::speaker(r, 12)),
        ("basket", |r| small::basket(r, 12)),
        ("towels", |r| small::towels(r, 12)),
        ("cushion", |r| small::cushion(r, 12)),
        ("clothes", |r| small::clothes(r, 12)),
        ("bag", |r| small::bag(r, 12)),
        ("laundry", small::laundry),
        ("carton stack", small::carton_stack),
    ]
}

#[test]
fn every_piece_keeps_to_its_place() {
    let mut wrong = Vec::new();
    for (name, maker) in makers() {
        for seed in 0..60 {
            let piece = maker(&mut Random::seed_from_u64(seed));
            let mesh = piece.mesh.bounds();
            let blocks = piece.blocks.iter().flat_map(|b| {
                let f = b.footprint;
                [
                    (f.center - f.half).extend(b.z[0]),
                    (f.center + f.half).extend(b.z[1]),
                ]
            });
            let blocks = Aabb::of(blocks);
            // A centimetre of play: tilted and bent parts.
            let is_in =
                blocks.grown(0.01).contains(mesh.min) && blocks.grown(0.01).contains(mesh.max);
            let is_named = blocks.max.truncate().max(-blocks.min.truncate()) - piece.half;
            if !is_in || is_named.max_element() > 0.012 || mesh.min.z < -1e-4 {
                wrong.push(format!(
                    "{name}:{seed} mesh {mesh:?} blocks {blocks:?} half {}",
                    piece.half
                ));
                break;
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn nothing_stands_in_anything_else() {
    for kind in KINDS {
        for seed in 0..60 {
            for room in &plan(kind, seed).rooms {
                // Parts of one piece touch or overlap by design (a tap over its sink); pieces are apart.
                for (i, a) in room.solid.iter().enumerate() {
                    for (j, b) in room.solid[..i].iter().enumerate() {
                        let same = room.owner(i) == room.owner(j);
                        assert!(
                            same || !a.overlaps(b),
                            "{kind}:{seed} pieces {} and {}: {a:?} {b:?}",
                            room.owner(i),
                            room.owner(j)
                        );
                    }
                }
            }
        }
    }
}

/// Share of the indoor floor that is not floor seen from 2 m above it, and the median free horizontal ray at 0.6 m.
fn statistics(draft: &Draft, random: &mut Random) -> (f32, f32) {
    let mut mesh = draft.shell.clone();
    draft.rooms.iter().for_each(|r| mesh.append(&r.mesh));
    let bounds: Aabb = mesh.bounds();
    const STEP: f32 = 0.1;
    let size = (bounds.size() / STEP).ceil();
    let (w, h) = (size.x as usize + 1, size.y as usize + 1);
    let at = |i: usize, j: usize| bounds.min.truncate() + Vec2::new(i as f32, j as f32) * STEP;
    let mut top = vec![f32::NEG_INFINITY; w * h];
    let mut slice = Vec::new();
    for t in 0..mesh.triangles.len() {
        let c = mesh.corners(t);
        let [a, b, d] = c.map(|v| v.truncate());
        let twice = (b - a).perp_dot(d - a);
        let low = (a.min(b).min(d) - bounds.min.truncate()) / STEP;
        let high = (a.max(b).max(d) - bounds.min.truncate()) / STEP;
        if twice.abs() > 1e-9 {
            for j in low.y.ceil() as usize..=(high.y as usize).min(h - 1) {
                for i in low.x.ceil() as usize..=(high.x as usize).min(w - 1) {
                    let p = at(i, j);
                    let u = (b - p).perp_dot(d - p) / twice;
                    let v = (d - p).perp_dot(a - p) / twice;
                    let z = u * c[0].z + v * c[1].z + (1.0 - u - v) * c[2].z - draft.floor;
                    if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && z < 2.0 {
                        top[j * w + i] = top[j * w + i].max(z);
                    }
                }
            }
        }
        // Where the triangle crosses the plane 0.6 m above the floor.
        let z = c.map(|v| v.z - draft.floor - 0.6);
        let crossings: Vec<Vec2> = [(0, 1), (1, 2), (2, 0)]
            .into_iter()
            .filter(|(i, j)| (z[*i] > 0.0) != (z[*j] > 0.0))
            .map(|(i, j)| c[i].lerp(c[j], z[i] / (z[i] - z[j])).truncate())
            .collect();
        if let [p, q] = crossings[..] {
            slice.push((p, q));
        }
    }
    let indoor: Vec<(Vec2, f32)> = (0..w * h)
        .map(|k| (at(k % w, k / w), top[k]))
        .filter(|(p, _)| draft.rooms.iter().any(|r| contains(&r.outline, *p)))
        .collect();
    let covered = indoor.iter().filter(|(_, z)| *z > 0.05).count();
    let free: Vec<Vec2> = indoor
        .iter()
        .filter(|(_, z)| *z <= 0.05)
        .map(|x| x.0)
        .collect();
    let mut ranges: Vec<f32> = (0..200)
        .map(|_| {
            let (p, d) = (random.one_of(&free), Vec2::from_angle(random.heading()));
            slice
                .iter()
                .filter_map(|(a, b)| {
                    let (e, f) = (*b - *a, *a - p);
                    let det = d.perp_dot(e);
                    let (t, s) = (f.perp_dot(e) / det, f.perp_dot(d) / det);
                    (t > 0.0 && (0.0..=1.0).contains(&s)).then_some(t)
                })
                .fold(f32::INFINITY, f32::min)
        })
        .collect();
    ranges.sort_by(f32::total_cmp);
    (covered as f32 / indoor.len() as f32, ranges[100])
}

#[test]
fn indoor_scenes_are_as_full_as_measured_ones() {
    for kind in indoor_kinds() {
        let mut random = Random::seed_from_u64(1);
        let all: Vec<(f32, f32)> = (0..200)
            .map(|seed| statistics(&plan(kind, seed), &mut random))
            .collect();
        let mean = |f: fn(&(f32, f32)) -> f32| all.iter().map(f).sum::<f32>() / 200.0;
        let (covered, ray) = (mean(|x| x.0), mean(|x| x.1));
        let mut sorted: Vec<f32> = all.iter().map(|x| x.0).collect();
        sorted.sort_by(f32::total_cmp);
        eprintln!(
            "{kind}: covered {covered:.3} (p10 {:.3}, p90 {:.3}), median ray {ray:.2} m",
            sorted[20], sorted[180]
        );
        assert!(
            (0.10..=0.25).contains(&covered),
            "{kind}: covered {covered}"
        );
        assert!((1.5..=3.5).contains(&ray), "{kind}: median ray {ray} m");
    }
}

#[test]
fn one_plan_of_three_is_turned() {
    let turned = (0..300)
        .filter(|seed| {
            let s = generate("room", *seed).unwrap();
            // Walls of an unturned plan lie square to the axes.
            let d = (s.visual.vertices[1] - s.visual.vertices[0])
                .truncate()
                .normalize_or_zero();
            d.x.abs() > 1e-3 && d.y.abs() > 1e-3
        })
        .count();
    assert!((70..160).contains(&turned), "{turned} of 300");
}

/// Seconds of processor that this thread has used, to a tick of 4 ms, where the system says so: other tests run beside
/// this one.
fn processor_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: f64 = text.split(' ').next()?.parse().ok()?;
    Some(nanoseconds * 1e-9)
}

#[test]
fn generation_is_fast() {
    for kind in KINDS {
        let (mut triangles, mut instances) = (0, 0);
        let mut milliseconds: Vec<f64> = (0..50)
            .map(|seed| {
                let mut run = || {
                    let before = processor_seconds();
                    let scene = generate(kind, seed).unwrap();
                    triangles += scene.visual.triangles.len();
                    instances += scene.report.instances;
                    match (before, processor_seconds()) {
                        (Some(before), Some(after)) => (after - before) * 1e3,
                        _ => scene.report.load_milliseconds,
                    }
                };
                run().min(run())
            })
            .collect();
        let mean = milliseconds.iter().sum::<f64>() / 50.0;
        milliseconds.sort_by(f64::total_cmp);
        eprintln!(
            "{kind}: mean {mean:.2} ms, worst {:.2} ms; mean {} triangles, {} instances",
            milliseconds[49],
            triangles / 100,
            instances / 100
        );
        // Debug builds are slower.
        let limit = if cfg!(debug_assertions) { 500.0 } else { 50.0 };
        assert!(milliseconds[49] < limit, "{kind}: {milliseconds:?}");
    }
}
