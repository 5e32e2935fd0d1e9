//! Where scenes come from: files and generators. One file a format or a generator.
//!
//! # Files
//! [`load`] reads a Gazebo world or model (`.world .sdf`, with everything it includes) or a single mesh
//! (`.dae .glb .gltf .obj .ply .stl`). A file is data from strangers: nothing in it may panic, hang, overflow the
//! stack or exhaust memory, so every reader works on a size-capped buffer and under the limits of this file.
use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::error::{Error, Result};
use crate::world::scene::Scene;
use rand::SeedableRng;

mod assembly;
mod bathroom;
mod clean;
mod clutter;
mod collada;
mod collada_faces;
#[cfg(test)]
mod collada_tests;
mod crockery;
pub mod disk;
mod draft;
mod draw;
mod fixtures;
mod floorplan;
mod footprint;
mod furnish;
mod furniture;
#[cfg(test)]
mod fuzz_tests;
#[cfg(test)]
mod generated_tests;
mod gltf_buffers;
mod gltf_file;
#[cfg(test)]
mod gltf_tests;
mod groups;
mod home;
mod layout;
mod mesh_file;
mod obj;
mod objects;
mod office;
mod part;
#[cfg(test)]
mod passage_tests;
mod ply;
mod primitives;
#[cfg(test)]
mod reachable_tests;
mod resources;
mod room;
mod sdf;
mod sdf_actors;
mod sdf_frames;
#[cfg(test)]
mod sdf_mesh_tests;
mod sdf_shapes;
#[cfg(test)]
mod sdf_tests;
mod seats;
mod shop;
mod solid;
mod stl;
mod tabletop;
mod text;
mod walkways;
mod walls;
mod warehouse;

/// The largest file that is read, bytes.
pub const MAX_FILE_BYTES: u64 = 1 << 30;
/// The default of [`LoadOptions::max_triangles`].
pub const MAX_TRIANGLES: usize = 50_000_000;
/// Includes within includes, models within models, nodes within nodes.
pub(crate) const MAX_DEPTH: usize = 32;
/// Scene-graph nodes of one mesh file, counted per visit: instancing must not multiply without end.
pub(crate) const MAX_NODES: usize = 1_000_000;
/// Objects farther out than this (metres, per axis) are dropped: one stray book would ruin every voxel grid.
pub(crate) const MAX_COORDINATE: f64 = 1000.0;

/// The axis that points up in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpAxis {
    X,
    Y,
    Z,
}

/// How [`load`] reads a file.
#[derive(Clone, Debug)]
pub struct LoadOptions {
    /// Everything that would lose geometry (a missing or broken part, an unsupported shape, a stray object) is an
    /// error instead of a warning.
    pub strict: bool,
    /// Turn COLLADA files after their `<up_axis>`. Gazebo ignores the tag and many of its models carry a wrong one,
    /// so the default is to ignore it too.
    pub honour_up_axis: bool,
    /// The up axis of a stand-alone mesh file, whatever the file says. Default: y for glTF (the format's rule), z for
    /// all others. Meshes that an SDF file names are never turned.
    pub up_axis: Option<UpAxis>,
    /// Folders in which `model://` URIs are looked up, before the world's own `../models` and the folders in the
    /// environment variables `GAZEBO_MODEL_PATH` and `GZ_SIM_RESOURCE_PATH`.
    pub search_paths: Vec<PathBuf>,
    /// A scene with more triangles is refused.
    pub max_triangles: usize,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            strict: false,
            honour_up_axis: false,
            up_axis: None,
            search_paths: Vec::new(),
            max_triangles: MAX_TRIANGLES,
        }
    }
}

impl LoadOptions {
    /// Of all that decides how a file is read besides the bytes on disk.
    pub(crate) fn digest(&self, path: &Path) -> u128 {
        // Named one by one: a new option must not be forgotten here.
        let Self {
            strict,
            honour_up_axis,
            up_axis,
            search_paths,
            max_triangles,
        } = self;
        // The path as given as well: warnings name it.
        let roots: Vec<PathBuf> = search_paths
            .iter()
            .map(|p| resources::absolute(p))
            .collect();
        let folders = resources::PATH_VARIABLES.map(std::env::var_os);
        let text = format!(
            "{path:?} {:?} {strict} {honour_up_axis} {up_axis:?} {roots:?} {max_triangles} {folders:?}",
            resources::absolute(path)
        );
        xxhash_rust::xxh3::xxh3_128(text.as_bytes())
    }
}

/// Reads a scene from a file; the extension (any case) decides how.
///
/// `.world .sdf`: see [`sdf`]. `.dae .glb .gltf .obj .ply .stl`: one mesh, whose triangles are both visual and
/// what bodies hit. Lengths are metres (COLLADA's `<unit>` is applied).
///
/// # Errors
/// [`Error::Invalid`] for an unknown extension, [`Error::Io`] for a file that cannot be read, [`Error::Malformed`]
/// for a broken one, naming the element. With `strict`, also for every part that could not be read.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Scene> {
    let start = Instant::now();
    let mut assembly = assembly::Assembly::new(options);
    match text::extension(path).as_str() {
        "world" | "sdf" => sdf::read(path, &mut assembly)?,
        extension if mesh_file::EXTENSIONS.contains(&extension) => {
            mesh_file::read_alone(path, disk::bytes(path)?, &mut assembly)?
        }
        other => return Err(unknown(path, other, "one of .world .sdf ")),
    }
    let mut scene = assembly.finish(path)?;
    scene.report.load_milliseconds = start.elapsed().as_secs_f64() * 1e3;
    Ok(scene)
}

/// Reads a mesh that is in memory already as [`load`] would read it from the file `path`, which need not exist.
///
/// # Errors
/// As [`load`]; also [`Error::Invalid`] for `.world .sdf`, which are read from files only.
pub fn load_bytes(path: &Path, bytes: Vec<u8>, options: &LoadOptions) -> Result<Scene> {
    let extension = text::extension(path);
    if !mesh_file::EXTENSIONS.contains(&extension.as_str()) {
        return Err(unknown(path, &extension, ""));
    }
    let mut assembly = assembly::Assembly::new(options);
    mesh_file::read_alone(path, bytes, &mut assembly)?;
    assembly.finish(path)
}

fn unknown(path: &Path, extension: &str, others: &str) -> Error {
    Error::invalid(format!(
        "{}: unknown extension '{extension}', expected {others}.{}",
        path.display(),
        mesh_file::EXTENSIONS.join(" .")
    ))
}

// Generators.

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
