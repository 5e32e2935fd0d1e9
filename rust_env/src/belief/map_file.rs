//! Files of maps, by their ending: OctoMap's `.bt` and `.ot`, and our own `.nbvmap`.
use super::octree::{Octree, SensorModel};
use super::{nbvmap, octomap_file};
use crate::error::{Error, Result};
use std::io::Write;
use std::path::Path;

/// Largest file that is read.
const MAX_BYTES: u64 = 1 << 31;

fn ending(path: &Path) -> &str {
    path.extension().and_then(|e| e.to_str()).unwrap_or("")
}

/// Read a map. A file of OctoMap's knows no sensor model: hits and misses that follow use `sensor`, by default
/// OctoMap's own. An `.nbvmap` file has its own, and none must be given.
pub fn read(path: &Path, sensor: Option<SensorModel>) -> Result<Octree> {
    let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
    // A pipe would block, a device never end.
    if !metadata.is_file() {
        return Err(Error::malformed(path, "not a regular file"));
    }
    let length = metadata.len();
    if length > MAX_BYTES {
        return Err(Error::malformed(
            path,
            format!("{length} bytes are more than the {MAX_BYTES} that are read"),
        ));
    }
    if ending(path) == "nbvmap" && sensor.is_some() {
        return Err(Error::invalid(format!(
            "{}: an .nbvmap file has its own sensor model; none can be given",
            path.display()
        )));
    }
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    match ending(path) {
        "nbvmap" => nbvmap::parse(&bytes, None).map_err(|e| Error::malformed(path, e)),
        _ => octomap_file::parse(path, &bytes, sensor.unwrap_or_default()),
    }
}

/// Write a map. The file is complete or not there at all.
pub fn write(octree: &Octree, path: &Path) -> Result<()> {
    let bytes = match ending(path) {
        "bt" => octomap_file::serialise(octree, true),
        "ot" => octomap_file::serialise(octree, false),
        "nbvmap" => nbvmap::serialise(octree),
        _ => {
            return Err(Error::invalid(format!(
                "{}: a map's file ends in .nbvmap, .bt or .ot",
                path.display()
            )))
        }
    };
    let partial = path.with_extension(format!("{}.partial", std::process::id()));
    let written = std::fs::File::create(&partial).and_then(|mut f| {
        f.write_all(&bytes)?;
        f.sync_all()
    });
    written
        .and_then(|()| std::fs::rename(&partial, path))
        .map_err(|e| {
            let _ = std::fs::remove_file(&partial);
            Error::io(path, e)
        })
}
