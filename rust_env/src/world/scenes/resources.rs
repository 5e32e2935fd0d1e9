//! From a URI in an SDF file to a file on disk, never outside the folders the user gave or the world stands in.
use std::cell::RefCell;
use std::collections::HashMap;
use std::env;
use std::ffi::OsString;
use std::path::{Component, Path, PathBuf};
use std::rc::Rc;

use super::disk;
use super::text::{children, content, Xml};

/// Environment variables with lists of resource folders, as Gazebo classic and Gazebo Sim read them.
pub(super) const PATH_VARIABLES: [&str; 3] = [
    "GAZEBO_MODEL_PATH",
    "GZ_SIM_RESOURCE_PATH",
    "IGN_GAZEBO_RESOURCE_PATH",
];

/// What became of a URI.
#[derive(Debug, PartialEq)]
pub(super) enum Found {
    Exact(PathBuf),
    /// Found only when upper and lower case are not told apart.
    OtherCase(PathBuf),
    Missing,
    /// The URI points outside every search folder.
    Refused,
}

/// Longer URIs are refused.
const MAX_URI_BYTES: usize = 4096;

/// The names in a folder by their lower-case form.
type Listing = Rc<HashMap<String, OsString>>;

pub(super) struct Resources {
    roots: Vec<PathBuf>,
    listings: RefCell<HashMap<PathBuf, Listing>>,
}

impl Resources {
    /// For a world or model file: the user's folders, then those near the file, then those of the environment.
    pub fn new(file: &Path, search_paths: &[PathBuf]) -> Self {
        let mut roots: Vec<PathBuf> = Vec::new();
        let mut add = |path: PathBuf| {
            let path = absolute(&path);
            if disk::is_folder(&path) && !roots.contains(&path) {
                roots.push(path);
            }
        };
        search_paths.iter().cloned().for_each(&mut add);
        let folder = absolute(file);
        let folder = folder.parent().unwrap_or(Path::new("/"));
        if let Some(above) = folder.parent() {
            // worlds/x.world with models/ beside it; models/x/model.sdf with other models beside x.
            add(above.join("models"));
            if disk::is_file(&folder.join("model.config")) {
                add(above.to_owned());
            }
        }
        add(folder.join("models"));
        add(folder.to_owned());
        for variable in PATH_VARIABLES {
            if let Some(list) = env::var_os(variable) {
                env::split_paths(&list)
                    .filter(|p| p.is_absolute())
                    .for_each(&mut add);
            }
        }
        Self {
            roots,
            listings: RefCell::default(),
        }
    }

    /// Looks up `uri` as written in a file in `folder`.
    pub fn find(&self, uri: &str, folder: &Path) -> Found {
        let uri = uri.trim();
        if uri.len() > MAX_URI_BYTES {
            return Found::Refused;
        }
        let (scheme, rest) = uri.split_once("://").unwrap_or(("", uri));
        match scheme.to_ascii_lowercase().as_str() {
            "model" | "package" => self.below_roots(Path::new(rest), &[]),
            // A model folder by hand is called ground_plane, one that Fuel's own client wrote "ground plane".
            "http" | "https" => match self.below_roots(Path::new(&fuel_path(rest, "_")), &[]) {
                Found::Missing => self.below_roots(Path::new(&fuel_path(rest, " ")), &[]),
                found => found,
            },
            "" => self.below_roots(Path::new(rest), &[folder]),
            "file" if rest.starts_with('/') => self.absolute_file(Path::new(rest)),
            // file://models/X is meant below a resource folder, which may itself be called models.
            "file" => match self.below_roots(Path::new(rest), &[folder]) {
                Found::Missing => match rest.strip_prefix("models/") {
                    Some(rest) => self.below_roots(Path::new(rest), &[]),
                    None => Found::Missing,
                },
                found => found,
            },
            _ => Found::Missing,
        }
    }

    fn absolute_file(&self, path: &Path) -> Found {
        let path = absolute(path);
        match self.roots.iter().find(|root| path.starts_with(root)) {
            None => Found::Refused,
            Some(_) if disk::exists(&path) => Found::Exact(path),
            Some(_) => Found::Missing,
        }
    }

    fn below_roots(&self, path: &Path, first: &[&Path]) -> Found {
        if path.is_absolute() {
            return self.absolute_file(path);
        }
        let mut refused = false;
        let candidates: Vec<PathBuf> = first
            .iter()
            .copied()
            .chain(self.roots.iter().map(PathBuf::as_path))
            .map(|folder| absolute(&folder.join(path)))
            .collect();
        let permitted = |p: &PathBuf| {
            self.roots.iter().any(|root| p.starts_with(root))
                || first.iter().any(|folder| p.starts_with(folder))
        };
        for candidate in &candidates {
            if !permitted(candidate) {
                refused = true;
            } else if disk::exists(candidate) {
                return Found::Exact(candidate.clone());
            }
        }
        for candidate in candidates.iter().filter(|c| permitted(c)) {
            if let Some(found) = self.ignoring_case(candidate) {
                return Found::OtherCase(found);
            }
        }
        if refused {
            Found::Refused
        } else {
            Found::Missing
        }
    }

    /// The existing path whose names equal those of `path` but for their case. Of several the first by name.
    fn ignoring_case(&self, path: &Path) -> Option<PathBuf> {
        if disk::exists(path) {
            return Some(path.to_owned());
        }
        let folder = self.ignoring_case(path.parent()?)?;
        let name = path.file_name()?.to_string_lossy().to_lowercase();
        let listing = self.listings.borrow().get(&folder).cloned();
        let listing = listing.unwrap_or_else(|| {
            let lower = |name: OsString| (name.to_string_lossy().to_lowercase(), name);
            // The last insertion wins, and the first by name shall.
            let names = disk::names(&folder).into_iter().rev();
            let listing: Listing = Rc::new(names.map(lower).collect());
            self.listings
                .borrow_mut()
                .insert(folder.clone(), listing.clone());
            listing
        });
        Some(folder.join(listing.get(&name)?))
    }
}

/// The path of a Fuel URI below a folder of models: `.../models/Ground Plane` is kept in `ground_plane`, or whatever
/// stands for the blank.
fn fuel_path(rest: &str, blank: &str) -> String {
    let parts: Vec<&str> = rest.split('/').filter(|p| !p.is_empty()).collect();
    let Some(at) = parts.iter().position(|p| p.eq_ignore_ascii_case("models")) else {
        return parts.last().unwrap_or(&"").to_string();
    };
    let name = parts
        .get(at + 1)
        .map(|n| n.replace("%20", " ").replace(' ', blank).to_lowercase())
        .unwrap_or_default();
    // owner/models/NAME[/VERSION][/files/PATH]
    match parts.iter().position(|p| *p == "files") {
        Some(files) if files > at + 1 => format!("{name}/{}", parts[files + 1..].join("/")),
        _ => name,
    }
}

/// Absolute, with `.` and `..` resolved in the text: links are followed only when the file is opened.
pub(super) fn absolute(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let mut out = PathBuf::new();
    for component in path.components() {
        match component {
            Component::CurDir => {}
            Component::ParentDir => {
                out.pop();
            }
            other => out.push(other),
        }
    }
    out
}

/// The SDF file of a model folder. Fuel's client puts each version of a model into a folder of its own.
pub(super) fn sdf_of_model(folder: &Path) -> Option<PathBuf> {
    listed_sdf(folder).or_else(|| {
        let version = |name: &OsString| name.to_str()?.parse::<u32>().ok();
        let newest = disk::names(folder).iter().filter_map(version).max()?;
        listed_sdf(&folder.join(newest.to_string()))
    })
}

/// The one that `model.config` lists with the highest version, or else `model.sdf`.
fn listed_sdf(folder: &Path) -> Option<PathBuf> {
    let config = folder.join("model.config");
    let mut listed: Vec<(Vec<u32>, PathBuf)> = Vec::new();
    if let Ok(xml) = Xml::read(&config) {
        if let Ok(document) = xml.parse(&config) {
            for sdf in children(document.root_element(), "sdf") {
                let name = Path::new(content(sdf));
                let plain = name.components().all(|c| matches!(c, Component::Normal(_)));
                if !plain || name.as_os_str().is_empty() {
                    continue;
                }
                let version = sdf.attribute("version").unwrap_or("0");
                let version = version.split('.').map(|n| n.trim().parse().unwrap_or(0));
                listed.push((version.collect(), folder.join(name)));
            }
        }
    }
    // Stable: of equal versions the first listed stays first.
    listed.sort_by(|a, b| b.0.cmp(&a.0));
    listed
        .into_iter()
        .map(|(_, file)| file)
        .chain([folder.join("model.sdf")])
        .find(|file| disk::is_file(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fuel_uris_name_a_folder() {
        let owner = "fuel.gazebosim.org/1.0/OpenRobotics/models";
        assert_eq!(
            fuel_path(&format!("{owner}/Ground Plane"), "_"),
            "ground_plane"
        );
        assert_eq!(
            fuel_path(&format!("{owner}/Ground%20Plane/2"), " "),
            "ground plane"
        );
        assert_eq!(
            fuel_path(&format!("{owner}/Desk/1/files/meshes/Desk.dae"), "_"),
            "desk/meshes/Desk.dae"
        );
    }
}
