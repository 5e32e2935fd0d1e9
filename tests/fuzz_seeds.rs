//! Fuzzing without a fuzzer, on stable Rust: the seeds of every target and each file that once broke a reader, as they are
//! and with a few bytes changed.
use nbv_core::world::scene_cache::{read_scene, read_truth};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::path::Path;

#[path = "../rust_env/fuzz/src/lib.rs"]
mod readers;

/// Files of a target below `rust_env/fuzz/`, in the order of their names.
fn files(folder: &str, target: &str) -> Vec<Vec<u8>> {
    let fuzz = Path::new(env!("CARGO_MANIFEST_DIR")).join("rust_env/fuzz");
    let Ok(entries) = std::fs::read_dir(fuzz.join(folder).join(target)) else {
        return Vec::new();
    };
    let mut paths: Vec<_> = entries.map(|e| e.unwrap().path()).collect();
    paths.sort();
    paths.iter().map(|p| std::fs::read(p).unwrap()).collect()
}

fn read(target: &str, data: &[u8]) {
    match target {
        "bt" | "ot" => readers::map(data),
        "nbvmap" => readers::nbvmap(data),
        "scene_entry" => readers::scene_entry::scene(data),
        "sdf" => readers::world(data),
        "snapshot" => readers::snapshot::snapshot(data),
        "truth_entry" => readers::scene_entry::truth(data),
        mesh => readers::mesh(&format!("fuzz.{mesh}"), data),
    }
}

/// The seeds of a target. Files that nobody but us writes are made anew each time: kept ones would be of older versions.
fn seeds(target: &str) -> Vec<Vec<u8>> {
    match target {
        "scene_entry" => vec![readers::scene_entry::made()[0].clone()],
        "truth_entry" => vec![readers::scene_entry::made()[1].clone()],
        "snapshot" => readers::snapshot::made(),
        _ => files("seeds", target),
    }
}

/// What is written over a place in a file, besides single bytes.
const TOKENS: [&[u8]; 12] = [
    b"",
    b"0",
    b"-1",
    b"4294967295",
    b"18446744073709551615",
    b"nan",
    b"1e39",
    b"\n",
    b" ",
    b"\xFF\xFF\xFF\xFF",
    b"\0\0\0\0",
    b"\0\0\x80\x7F",
];

fn changed(mut bytes: Vec<u8>, random: &mut Pcg64Mcg) -> Vec<u8> {
    for _ in 0..random.random_range(1..6) {
        let at = random.random_range(0..=bytes.len());
        match random.random_range(0..5) {
            0 if at < bytes.len() => bytes[at] = random.random(),
            1 if at < bytes.len() => bytes[at] ^= 1 << random.random_range(0..8),
            2 => bytes.truncate(at),
            3 => {
                let end = (at + random.random_range(0..40)).min(bytes.len());
                let piece = bytes[at..end].to_vec();
                bytes.splice(at..at, piece);
            }
            _ => {
                let end = (at + random.random_range(0..6)).min(bytes.len());
                let token = TOKENS.choose(random).unwrap();
                bytes.splice(at..end, token.iter().copied());
            }
        }
    }
    bytes
}

fn survive(target: &str, cases: usize) {
    let seeds = seeds(target);
    assert!(!seeds.is_empty(), "{target} has no seeds");
    for bytes in seeds.iter().chain(&files("regressions", target)) {
        read(target, bytes);
    }
    let mut random = Pcg64Mcg::seed_from_u64(1);
    for _ in 0..cases {
        let bytes = changed(seeds.choose(&mut random).unwrap().clone(), &mut random);
        read(target, &bytes);
    }
}

macro_rules! targets {
    ($($name:ident: $cases:literal),*) => {$(
        #[test]
        fn $name() {
            survive(stringify!($name), $cases);
        }
    )*};
}

targets!(bt: 4000, ot: 4000, dae: 6000, glb: 6000, gltf: 6000, nbvmap: 1000, obj: 10000, ply: 10000, scene_entry: 1000,
    sdf: 1500, snapshot: 300, stl: 10000, truth_entry: 2000);

/// What is changed must be whole before: else all changes would be refused alike.
#[test]
fn made_seeds_are_read() {
    for seed in seeds("snapshot") {
        assert!(readers::snapshot::is_loaded(&seed));
    }
    assert!(read_scene(&seeds("scene_entry")[0]).is_ok());
    assert!(read_truth(&seeds("truth_entry")[0]).is_ok_and(|t| t.count() > 20));
}

#[test]
#[ignore = "writes into the folder where a fuzzer looks"]
fn write_made_seeds() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("rust_env/fuzz/corpus");
    for target in ["scene_entry", "snapshot", "truth_entry"] {
        let folder = corpus.join(target);
        std::fs::create_dir_all(&folder).unwrap();
        for (i, seed) in seeds(target).iter().enumerate() {
            std::fs::write(folder.join(format!("made_{i}")), seed).unwrap();
        }
    }
}

/// Every committed folder is replayed by one of the tests above.
#[test]
fn no_folder_is_left_out() {
    let known = [
        "bt",
        "ot",
        "dae",
        "glb",
        "gltf",
        "nbvmap",
        "obj",
        "ply",
        "scene_entry",
        "sdf",
        "snapshot",
        "stl",
        "truth_entry",
    ];
    let fuzz = Path::new(env!("CARGO_MANIFEST_DIR")).join("rust_env/fuzz");
    for folder in ["seeds", "regressions", "fuzz_targets"] {
        for entry in std::fs::read_dir(fuzz.join(folder)).into_iter().flatten() {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            assert!(known.contains(&name.as_str()), "{}", path.display());
        }
    }
}
