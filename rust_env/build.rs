//! A digest of the code that makes scenes and ground truths: what a cache holds is good for this very code only.
use std::collections::hash_map::DefaultHasher;
use std::fs;
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};

/// What decides what a scene looks like once it is read, and what a map of it looks like after images of all views.
const SOURCES: [&str; 9] = [
    "rust_env/src/world",
    "rust_env/src/belief",
    "rust_env/src/episode",
    "rust_env/src/robot.rs",
    "rust_env/src/arm.rs",
    "rust_env/src/capsule.rs",
    "rust_env/src/geometry.rs",
    "rust_env/src/camera.rs",
    "Cargo.lock",
];

fn files(path: &Path, found: &mut Vec<PathBuf>) {
    match fs::read_dir(path) {
        Ok(entries) => entries.flatten().for_each(|e| files(&e.path(), found)),
        Err(_) => found.push(path.to_owned()),
    }
}

fn main() {
    let mut found = Vec::new();
    for source in SOURCES {
        println!("cargo::rerun-if-changed={source}");
        files(Path::new(source), &mut found);
    }
    found.sort();
    let mut hasher = DefaultHasher::new();
    for file in found {
        file.to_string_lossy().hash(&mut hasher);
        fs::read(&file).unwrap_or_default().hash(&mut hasher);
    }
    std::env::var("TARGET")
        .unwrap_or_default()
        .hash(&mut hasher);
    let version = std::env::var("CARGO_PKG_VERSION").unwrap_or_default();
    println!(
        "cargo::rustc-env=NBV_GYM_WORLD_DIGEST={version}-{:016x}",
        hasher.finish()
    );
}
