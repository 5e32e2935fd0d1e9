//! Where scenes come from: files and generators. One file a format or a generator.
mod clutter;
mod draft;
mod draw;
mod fixtures;
mod floorplan;
mod footprint;
mod furnish;
mod furniture;
#[cfg(test)]
mod generated_tests;
mod home;
mod layout;
mod objects;
mod office;
mod room;
mod shop;
mod solid;
mod tabletop;
mod walls;
mod warehouse;

use crate::world::scene::Scene;
use crate::{Error, Result};
use rand::SeedableRng;

/// The kinds of scenes that `generate` knows.
pub const KINDS: &[&str] = &["room", "tabletop", "home", "office", "shop", "warehouse"];

/// A procedural scene: the same kind and seed give the same scene, bit for bit.
///
/// The plan stands on a floor 1-5 cm above z = 0 and off the voxel lattice; one of three is turned by any angle.
/// `Scene::starts` holds three camera positions 1.25 m above the floor, at least 0.7 m (the first) and 0.4 m
/// (the others) from all geometry. An unknown kind is `Error::Invalid`.
pub fn generate(kind: &str, seed: u64) -> Result<Scene> {
    let begin = std::time::Instant::now();
    let mut random = draw::Random::seed_from_u64(seed);
    let draft = draft(kind, &mut random)?;
    let mut scene = draft.finish(format!("{kind}:{seed}"), &mut random);
    scene.report.load_milliseconds = begin.elapsed().as_secs_f64() * 1e3;
    Ok(scene)
}

fn draft(kind: &str, random: &mut draw::Random) -> Result<draft::Draft> {
    match kind {
        "room" => Ok(room::room(random)),
        "home" => Ok(home::home(random)),
        "office" => Ok(office::office(random)),
        "shop" => Ok(shop::shop(random)),
        "warehouse" => Ok(warehouse::warehouse(random)),
        "tabletop" => Ok(tabletop::tabletop(random)),
        _ => Err(Error::invalid(format!(
            "scene kind must be one of {KINDS:?}, got {kind:?}"
        ))),
    }
}
