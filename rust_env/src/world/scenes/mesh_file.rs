//! A single mesh file: the dispatch by extension.
use std::path::Path;

use super::assembly::{Assembly, Layer};
use super::part::{z_up_from, Part};
use super::{collada, disk, gltf_file, obj, ply, stl, text, LoadOptions, UpAxis};
use crate::error::{Error, Result};
use crate::fault;

pub(super) const EXTENSIONS: &[&str] = &["dae", "glb", "gltf", "obj", "ply", "stl"];

/// The triangles of a mesh file in the file's own frame, in metres. Warnings are appended to `notes`.
pub(super) fn read(path: &Path, options: &LoadOptions, notes: &mut Vec<String>) -> Result<Part> {
    let extension = text::extension(path);
    if !EXTENSIONS.contains(&extension.as_str()) {
        let message = format!("'{extension}' is no mesh format that is read here");
        return Err(Error::malformed(path, message));
    }
    parse(path, disk::bytes(path)?, options, notes)
}

/// The same from the file's content; `path` decides how by its extension.
fn parse(
    path: &Path,
    bytes: Vec<u8>,
    options: &LoadOptions,
    notes: &mut Vec<String>,
) -> Result<Part> {
    let extension = text::extension(path);
    // The last line of defence against faults of the parsing crates; ours return errors.
    let part = fault::caught(|| match extension.as_str() {
        "dae" => collada::read(path, bytes, options, notes),
        "glb" | "gltf" => gltf_file::read(path, &bytes, options, notes),
        "obj" => obj::read(path, &bytes, options),
        "ply" => ply::read(path, &bytes, options),
        _ => stl::read(path, &bytes, options),
    })
    .unwrap_or_else(|what| {
        let message = format!("the parser failed on this file: {what}");
        Err(Error::malformed(path, message))
    })?;
    if part.triangles.is_empty() {
        return Err(Error::malformed(path, "holds no triangles"));
    }
    Ok(part)
}

/// The file, whose content this is, is the scene.
pub(super) fn read_alone(path: &Path, bytes: Vec<u8>, assembly: &mut Assembly) -> Result<()> {
    let options = assembly.options;
    let mut notes = Vec::new();
    // An axis that the caller names goes before the one in the file.
    let reading = LoadOptions {
        honour_up_axis: options.honour_up_axis && options.up_axis.is_none(),
        ..options.clone()
    };
    let part = parse(path, bytes, &reading, &mut notes)?;
    for note in notes {
        assembly.note(note);
    }
    let gltf = matches!(text::extension(path).as_str(), "glb" | "gltf");
    let up = options
        .up_axis
        .unwrap_or(if gltf { UpAxis::Y } else { UpAxis::Z });
    let placed = assembly.place(Layer::Visual, &part, z_up_from(up), path, &|| {
        "mesh".to_owned()
    });
    (assembly.instances, assembly.lone) = (1, true);
    placed
}
