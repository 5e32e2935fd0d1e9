//! A single mesh file: the dispatch by extension, and OBJ, STL and PLY through their crates.
use std::path::Path;

use super::assembly::{Assembly, Layer};
use super::part::{z_up_from, Part};
use super::{collada, text, LoadOptions, UpAxis};
use crate::error::{Error, Result};

pub(super) const EXTENSIONS: &[&str] = &["dae", "glb", "gltf", "obj", "ply", "stl"];

/// The triangles of a mesh file in the file's own frame, in metres.
pub(super) fn read(path: &Path, options: &LoadOptions, notes: &mut Vec<String>) -> Result<Part> {
    let extension = text::extension(path);
    match extension.as_str() {
        "dae" => collada::read(path, text::read_bytes(path)?, options, notes),
        other => Err(Error::malformed(
            path,
            format!("'{other}' is no mesh format that is read here"),
        )),
    }
}

/// The file is the scene.
pub(super) fn read_alone(path: &Path, assembly: &mut Assembly) -> Result<()> {
    let options = assembly.options;
    let mut notes = Vec::new();
    let part = read(path, options, &mut notes)?;
    for note in notes {
        assembly.note(note);
    }
    let gltf = matches!(text::extension(path).as_str(), "glb" | "gltf");
    let up = options
        .up_axis
        .unwrap_or(if gltf { UpAxis::Y } else { UpAxis::Z });
    assembly.instances = 1;
    assembly.place(Layer::Visual, &part, z_up_from(up), path, "mesh")
}
