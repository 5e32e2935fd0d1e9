//! A robot gets into every room of a generated plan.
use super::draft::Draft;
use super::footprint::contains;
use super::generated_tests::plan;
use crate::geometry::{Aabb, Mesh, Vec3};
use crate::world::motion::SceneShape;
use crate::world::scene::Scene;
use glam::Vec2;

const STEP: f32 = 0.05;

/// Of each room the share of its free places that a ball gets to from the first start, on a fine lattice whose neighbours
/// are safely joined. `heights` of its centre above the floor: free at all of them.
fn shares(draft: &Draft, radius: f32, heights: &[f32]) -> Vec<f32> {
    let mut mesh: Mesh = draft.shell.clone();
    draft.rooms.iter().for_each(|r| mesh.append(&r.mesh));
    let bounds: Aabb = mesh.bounds();
    let shape = SceneShape::new(&Scene {
        visual: mesh,
        ..Scene::default()
    });
    let low = bounds.min.truncate();
    let size = (bounds.size().truncate() / STEP).ceil();
    let (w, h) = (size.x as usize + 1, size.y as usize + 1);
    let at = |k: usize| low + Vec2::new((k % w) as f32, (k / w) as f32) * STEP;
    let room: Vec<Option<usize>> = (0..w * h)
        .map(|k| draft.rooms.iter().position(|r| contains(&r.outline, at(k))))
        .collect();
    let need = radius + STEP / 2.0;
    let mut free = vec![true; w * h];
    for z in heights {
        let mut known = vec![false; w * h];
        for k in 0..w * h {
            if known[k] || room[k].is_none() && !free[k] {
                continue;
            }
            let p: Vec3 = at(k).extend(draft.floor + z);
            let clearance = shape.clearance(p, 1.0);
            // As far around as its neighbours cannot differ.
            let reach = ((clearance - need).abs() / STEP) as usize;
            let (x, y) = (k % w, k / w);
            for j in y.saturating_sub(reach)..(y + reach + 1).min(h) {
                for i in x.saturating_sub(reach)..(x + reach + 1).min(w) {
                    let to = j * w + i;
                    if at(to).distance(at(k)) <= reach as f32 * STEP {
                        known[to] = true;
                        free[to] &= clearance >= need;
                    }
                }
            }
        }
    }
    let start = ((draft.starts[0].0 - low) / STEP).round();
    let start = start.y as usize * w + start.x as usize;
    let mut seen = vec![false; w * h];
    seen[start] = true;
    let mut todo = vec![start];
    while let Some(k) = todo.pop() {
        let (x, y) = (k % w, k / w);
        let mut visit = |to: usize| {
            if free[to] && !seen[to] {
                seen[to] = true;
                todo.push(to);
            }
        };
        if x > 0 {
            visit(k - 1)
        }
        if x + 1 < w {
            visit(k + 1)
        }
        if y > 0 {
            visit(k - w)
        }
        if y + 1 < h {
            visit(k + w)
        }
    }
    (0..draft.rooms.len())
        .map(|i| {
            let here = |k: &usize| room[*k] == Some(i) && free[*k];
            let all = (0..w * h).filter(here).count();
            let got = (0..w * h).filter(here).filter(|k| seen[*k]).count();
            if all == 0 {
                1.0
            } else {
                got as f32 / all as f32
            }
        })
        .collect()
}

/// People's heads, shoulders, hips; what lies lower than 0.3 m is stepped over.
const PERSON: [f32; 4] = [0.55, 0.9, 1.25, 1.55];

#[test]
fn people_get_into_every_room() {
    // More seeds: NBV_GYM_SEEDS=200.
    let seeds = std::env::var("NBV_GYM_SEEDS").map_or(30, |n| n.parse().unwrap());
    for kind in ["home", "office"] {
        for seed in 0..seeds {
            let shares = shares(&plan(kind, seed), 0.2, &PERSON);
            assert!(shares.iter().all(|s| *s > 0.5), "{kind}:{seed} {shares:?}");
        }
    }
}
