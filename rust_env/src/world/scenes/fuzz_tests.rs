//! No bytes make a reader panic. `catch_unwind` is left out here: what it would catch is to be found.
use std::path::Path;

use proptest::prelude::*;

use super::collada_tests::SQUARE;
use super::gltf_tests::quad_glb;
use super::{collada, gltf_file, obj, ply, stl, text, LoadOptions};

/// Reads bytes as if they were each format in turn; the result does not matter.
fn read_as_all(bytes: &[u8]) {
    let path = Path::new("fuzz");
    let options = LoadOptions {
        max_triangles: 1000,
        ..LoadOptions::default()
    };
    let mut notes = Vec::new();
    let parts = [
        collada::read(path, bytes.to_vec(), &options, &mut notes),
        gltf_file::read(path, bytes, &options, &mut notes),
        obj::read(path, bytes, &options),
        ply::read(path, bytes, &options),
        stl::read(path, bytes, &options),
    ];
    for part in parts.into_iter().flatten() {
        assert!(part.triangles.len() <= 1000);
        assert!(part.vertices.iter().all(|v| !v.is_nan()));
        let count = part.vertices.len() as u32;
        assert!(part.triangles.iter().flatten().all(|i| *i < count));
    }
    if let Ok(xml) = text::Xml::new(path, bytes.to_vec()) {
        let _ = xml.parse(path);
    }
}

fn samples() -> Vec<Vec<u8>> {
    vec![
        SQUARE.as_bytes().to_vec(),
        quad_glb(),
        b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1 2//2 3 -1 \\\n 2\n# x\no y\n".to_vec(),
        ply::tests::ASCII.as_bytes().to_vec(),
        ply::tests::binary_quad(true),
        ply::tests::binary_quad(false),
        stl::tests::ASCII.as_bytes().to_vec(),
        stl::tests::binary_file(&[[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.5]]),
    ]
}

/// What a mutation writes; numbers and marks that change the structure of a file.
const TOKENS: [&[u8]; 14] = [
    b"",
    b"0",
    b"-1",
    b"99999999999",
    b"nan",
    b"1e39",
    b"<",
    b">",
    b"\"",
    b"/",
    b" ",
    b"\n",
    b"\xFF\xFF\xFF\xFF",
    b"\0\0\0\0",
];

#[test]
fn samples_are_read() {
    let folder = super::gltf_tests::folder("sample");
    std::fs::write(folder.join("a.world"), SDF).unwrap();
    let scene = super::load(&folder.join("a.world"), &LoadOptions::default()).unwrap();
    assert_eq!(scene.report.visual_triangles_read, 12 + 2 + 1280);
    std::fs::remove_dir_all(folder).unwrap();
    let path = Path::new("a");
    let options = LoadOptions::default();
    let all = samples();
    assert!(collada::read(path, all[0].clone(), &options, &mut Vec::new()).is_ok());
    assert!(gltf_file::read(path, &all[1], &options, &mut Vec::new()).is_ok());
    assert!(obj::read(path, &all[2], &options).is_ok());
    assert!(all[3..6]
        .iter()
        .all(|bytes| ply::read(path, bytes, &options).is_ok()));
    assert!(all[6..]
        .iter()
        .all(|bytes| stl::read(path, bytes, &options).is_ok()));
}

/// Everything an SDF file may hold, once.
const SDF: &str = "<?xml version='1.0'?><sdf version='1.6'><world name='w'>
<include><uri>model://sun</uri><pose>0 0 1 0 0 0</pose></include><frame name='f'><pose relative_to='m'>1 0 0 0 0 0</pose></frame>
<model name='m'><pose frame='' degrees='true'>0 0 0 0 0 90</pose><link name='l'><visual name='v'><geometry><box><size>1 1 1</size></box></geometry></visual>
<collision name='c'><pose relative_to='f'>0 0 0 0 0 0</pose><geometry><mesh><uri>model://x/y.dae</uri><scale>1 1 1</scale></mesh></geometry></collision>
<visual name='p'><geometry><plane><normal>0 0 1</normal><size>100 100</size></plane></geometry></visual>
<visual name='s'><geometry><sphere><radius>1</radius></sphere></geometry></visual></link></model>
<state><model name='m'><pose>0 0 0 0 0 0</pose><scale>1 1 1</scale><link name='l'><pose>1 1 1 0 0 0</pose></link></model></state>
<include><uri>a.world</uri></include><actor name='a'/></world></sdf>";

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn mutated_worlds_do_not_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0..6usize, 0..TOKENS.len()), 1..6),
    ) {
        let folder = super::gltf_tests::folder("fuzz");
        let mut bytes = SDF.as_bytes().to_vec();
        for (at, length, token) in edits {
            let at = at.index(bytes.len());
            let end = bytes.len().min(at + length);
            bytes.splice(at..end, TOKENS[token].iter().copied());
        }
        let path = folder.join("a.world");
        std::fs::write(&path, &bytes).unwrap();
        if let Ok(scene) = super::load(&path, &LoadOptions::default()) {
            prop_assert!(scene.visual.vertices.iter().all(|v| v.is_finite()));
            prop_assert!(scene.floor.is_finite() && scene.bounds.min.is_finite() && scene.bounds.max.is_finite());
            prop_assert!(scene.bounds.min.cmple(scene.bounds.max).all());
        }
        std::fs::remove_dir_all(folder).unwrap();
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_do_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        read_as_all(&bytes);
    }

    /// A few places of a valid file are overwritten, cut out or filled with something else.
    #[test]
    fn mutated_files_do_not_panic(
        sample in 0..8usize,
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0..6usize, 0..TOKENS.len()), 1..5),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = samples().swap_remove(sample);
        for (at, length, token) in edits {
            let at = at.index(bytes.len());
            let end = bytes.len().min(at + length);
            bytes.splice(at..end, TOKENS[token].iter().copied());
            if bytes.is_empty() {
                break;
            }
        }
        if let (Some(cut), false) = (cut, bytes.is_empty()) {
            bytes.truncate(cut.index(bytes.len()));
        }
        read_as_all(&bytes);
    }

    #[test]
    fn random_lines_of_keywords_do_not_panic(
        words in prop::collection::vec(prop::sample::select(vec![
            "ply\n", "format ascii 1.0\n", "format binary_little_endian 1.0\n", "element vertex 3\n", "element face 1\n",
            "element face 18446744073709551615\n", "property float x\n", "property float y\n", "property float z\n",
            "property list uchar int vertex_indices\n", "property list double double vertex_index\n", "end_header\n",
            "0 0 0\n", "3 0 1 2\n", "solid a\n", "vertex 1 2 3\n", "endloop\n", "endsolid\n", "v 1 2 3\n", "f 1 1 1\n", "f -1 1 2 3\n",
            "<COLLADA>", "</COLLADA>", "<node>", "</node>", "<mesh>", "<p>0 1 2</p>", "<!--", "-->", "<![CDATA[", "]]>", "<?xml ", "?>",
        ]), 0..30),
    ) {
        read_as_all(words.concat().as_bytes());
    }
}
