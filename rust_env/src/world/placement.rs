//! Where an episode can begin in a scene of which nobody says where: indoors, on a floor, with room around.
use super::motion::SceneShape;
use super::render::DepthRenderer;
use super::scene::Scene;
use crate::geometry::Vec3;

/// Height of the camera above the floor, metres (Wang 2019: 1.25 m).
const HEIGHT: f32 = 1.25;
/// Room around a start, and distance between starts, metres.
const CLEARANCE: f32 = 0.4;
const APART: f32 = 1.0;
const MAX_STARTS: usize = 64;
/// Most lattice points that are looked at.
const MAX_POINTS: f32 = 40_000.0;

/// Camera positions with headings (radians), the roomiest first.
pub fn find_starts(
    scene: &Scene,
    shape: &SceneShape,
    renderer: &DepthRenderer,
) -> Vec<(Vec3, f32)> {
    if !scene.starts.is_empty() {
        return scene.starts.clone();
    }
    let bounds = scene.bounds;
    if bounds.is_empty() {
        return Vec::new();
    }
    let size = bounds.size();
    let pitch = (size.x * size.y / MAX_POINTS).sqrt().max(0.25);
    let z = (scene.floor + HEIGHT)
        .min(bounds.max.z - CLEARANCE)
        .max(bounds.min.z);
    let reach = size.length();
    let mut found: Vec<(Vec3, f32)> = Vec::new();
    for j in 0..=(size.y / pitch) as usize {
        for i in 0..=(size.x / pitch) as usize {
            let p = Vec3::new(
                bounds.min.x + i as f32 * pitch,
                bounds.min.y + j as f32 * pitch,
                z,
            );
            let clearance = shape.clearance(p);
            if clearance >= CLEARANCE && is_indoors(p, scene, renderer, reach) {
                found.push((p, clearance));
            }
        }
    }
    // The roomiest first; equal ones stay in the order of the lattice.
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut starts: Vec<(Vec3, f32)> = Vec::new();
    for (p, _) in found {
        if starts.len() < MAX_STARTS && starts.iter().all(|(q, _)| q.distance(p) >= APART) {
            starts.push((p, widest_view(p, renderer, reach)));
        }
    }
    starts
}

fn heading(k: usize, of: usize) -> f32 {
    k as f32 * std::f32::consts::TAU / of as f32
}

fn horizontal(angle: f32) -> Vec3 {
    Vec3::new(angle.cos(), angle.sin(), 0.0)
}

/// A floor below, and walls in most directions: not the garden, not the roof.
fn is_indoors(p: Vec3, scene: &Scene, renderer: &DepthRenderer, reach: f32) -> bool {
    const RAYS: usize = 16;
    let below = renderer.cast(p, Vec3::NEG_Z, HEIGHT + 0.5);
    let on_ground = scene
        .ground_plane
        .is_some_and(|g| (p.z - g) <= HEIGHT + 0.5);
    if below.is_none() && !on_ground {
        return false;
    }
    let hits = (0..RAYS)
        .filter(|k| {
            renderer
                .cast(p, horizontal(heading(*k, RAYS)), reach)
                .is_some()
        })
        .count();
    hits * 4 >= RAYS * 3
}

/// The heading in which most can be seen.
fn widest_view(p: Vec3, renderer: &DepthRenderer, reach: f32) -> f32 {
    const RAYS: usize = 32;
    let ranges: Vec<f32> = (0..RAYS)
        .map(|k| {
            renderer
                .cast(p, horizontal(heading(k, RAYS)), reach)
                .unwrap_or(0.0)
        })
        .collect();
    let view = |k: usize| -> f32 { (0..5).map(|d| ranges[(k + d + RAYS - 2) % RAYS]).sum() };
    let best = (0..RAYS).fold(0, |best, k| if view(k) > view(best) { k } else { best });
    heading(best, RAYS)
}
