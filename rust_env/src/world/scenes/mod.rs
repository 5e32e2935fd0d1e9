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

mod assembly;
mod clean;
mod collada;
mod collada_faces;
mod gltf_buffers;
mod gltf_file;
mod mesh_file;
mod obj;
mod part;
mod ply;
mod primitives;
mod resources;
mod sdf;
mod sdf_frames;
mod sdf_shapes;
mod stl;
mod text;

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
            mesh_file::read_alone(path, &mut assembly)?
        }
        other => {
            return Err(Error::invalid(format!(
                "{}: unknown extension '{other}', expected one of .world .sdf .{}",
                path.display(),
                mesh_file::EXTENSIONS.join(" .")
            )))
        }
    }
    let mut scene = assembly.finish(path)?;
    scene.report.load_milliseconds = start.elapsed().as_secs_f64() * 1e3;
    Ok(scene)
}

// Generators.
