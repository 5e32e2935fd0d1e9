//! glTF: what the format permits, and the files that break the crate's own importer.
use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec3;

use super::gltf_file::read;
use super::part::Part;
use super::{load, LoadOptions};
use crate::geometry::Vec3;

/// A quad of four f32 positions at stride 16, u16 indices behind them.
fn quad_bytes() -> Vec<u8> {
    let mut bytes = Vec::new();
    for corner in [
        [0f32, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
    ] {
        bytes.extend(corner.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend([0xAB; 4]);
    }
    bytes.extend([0u16, 1, 2, 0, 2, 3].iter().flat_map(|i| i.to_le_bytes()));
    bytes
}

pub(super) const QUAD: &str = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],
"nodes":[{"children":[1],"translation":[0,0,5]},{"mesh":0,"scale":[2,1,1],"rotation":[0,0,0.7071067811865476,0.7071067811865476]}],
"meshes":[{"name":"quad","primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
"accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3"},
{"bufferView":1,"componentType":5123,"count":6,"type":"SCALAR"}],
"bufferViews":[{"buffer":0,"byteLength":64,"byteStride":16},{"buffer":0,"byteOffset":64,"byteLength":12}],
"buffers":[{"byteLength":76}]}"#;

pub(super) fn glb(json: &str, data: &[u8]) -> Vec<u8> {
    let mut text = json.as_bytes().to_vec();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    let length = 12 + 8 + text.len() + 8 + data.len();
    bytes.extend(2u32.to_le_bytes());
    bytes.extend((length as u32).to_le_bytes());
    bytes.extend((text.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(text);
    bytes.extend((data.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(data);
    bytes
}

pub(super) fn quad_glb() -> Vec<u8> {
    glb(QUAD, &quad_bytes())
}

fn try_read(bytes: &[u8]) -> Result<(Part, Vec<String>), String> {
    let mut notes = Vec::new();
    read(
        Path::new("a.glb"),
        bytes,
        &LoadOptions::default(),
        &mut notes,
    )
    .map(|part| (part, notes))
    .map_err(|e| e.to_string())
}

/// The quad with some text of its JSON replaced.
fn changed(from: &str, to: &str) -> Result<Part, String> {
    assert!(QUAD.contains(from), "{from}");
    try_read(&glb(&QUAD.replace(from, to), &quad_bytes())).map(|(part, _)| part)
}

fn refused(from: &str, to: &str, word: &str) {
    let error = changed(from, to).unwrap_err();
    assert!(error.contains(word), "{to}: {error}");
}

/// An empty folder of our own.
pub(super) fn folder(name: &str) -> PathBuf {
    let unique = format!("nbv_gym_{name}_{}", std::process::id());
    let folder = std::env::temp_dir().join(unique);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

#[test]
fn nodes_strides_and_indices() {
    let (part, notes) = try_read(&quad_glb()).unwrap();
    assert_eq!(part.triangles, [[0, 1, 2], [0, 2, 3]]);
    // Scaled by 2 along x, then turned a quarter about z, then lifted.
    let expected = [
        [0.0, 0.0, 5.0],
        [0.0, 2.0, 5.0],
        [-1.0, 2.0, 5.0],
        [-1.0, 0.0, 5.0],
    ];
    for (found, expected) in part.vertices.iter().zip(expected) {
        assert!((*found - DVec3::from(expected)).length() < 1e-6, "{found}");
    }
    assert!(notes.is_empty());
    let matrix = r#""matrix":[0,2,0,0,-1,0,0,0,0,0,1,0,0,0,0,1]"#;
    let from = r#""scale":[2,1,1],"rotation":[0,0,0.7071067811865476,0.7071067811865476]"#;
    let by_matrix = changed(from, matrix).unwrap();
    assert!((by_matrix.vertices[2] - part.vertices[2]).length() < 1e-6);
    // Bytes and 32-bit words as indices.
    for (component, indices) in [
        (5121, vec![0u8, 1, 2]),
        (
            5125,
            [0u32, 3, 2].iter().flat_map(|i| i.to_le_bytes()).collect(),
        ),
    ] {
        let mut data = quad_bytes();
        data.truncate(64);
        data.extend(&indices);
        data.resize(76, 0);
        let json = QUAD.replace("5123,\"count\":6", &format!("{component},\"count\":3"));
        assert_eq!(try_read(&glb(&json, &data)).unwrap().0.triangles.len(), 1);
    }
}

#[test]
fn modes_and_missing_indices() {
    let with = |to: &str| {
        changed(
            r#"{"POSITION":0},"indices":1"#,
            &format!(r#"{{"POSITION":0}}{to}"#),
        )
    };
    assert_eq!(
        with(r#","mode":5"#).unwrap().triangles,
        [[0, 1, 2], [2, 1, 3]]
    );
    assert_eq!(
        with(r#","mode":6"#).unwrap().triangles,
        [[0, 1, 2], [0, 2, 3]]
    );
    assert!(with("").unwrap_err().contains("4 indices are no triangles"));
    let lines = QUAD.replace("\"indices\":1", "\"indices\":1,\"mode\":1");
    let (part, notes) = try_read(&glb(&lines, &quad_bytes())).unwrap();
    assert!(part.triangles.is_empty() && notes[0].contains("points or lines"));
    // Without any scene the nodes that are nobody's children are placed.
    assert_eq!(
        changed("\"scene\":0,\"scenes\":[{\"nodes\":[0]}],", "")
            .unwrap()
            .triangles
            .len(),
        2
    );
    assert_eq!(
        changed("\"scene\":0,\"scenes\"", "\"scenes\"")
            .unwrap()
            .triangles
            .len(),
        2
    );
}

#[test]
fn quantized_and_sparse_positions() {
    let mut data = quad_bytes();
    data.extend([0u8, 0, 0, 0, 127, 0, 0, 0, 0, 127, 0, 0]);
    let json = QUAD
        .replace("\"bufferView\":0,\"componentType\":5126,\"count\":4", "\"bufferView\":2,\"componentType\":5120,\"normalized\":true,\"count\":3")
        .replace("\"count\":6", "\"count\":3")
        .replace("\"byteLength\":12}]", "\"byteLength\":12},{\"buffer\":0,\"byteOffset\":76,\"byteLength\":12,\"byteStride\":4}]")
        .replace("\"byteLength\":76", "\"byteLength\":88")
        .replace("\"asset\"", "\"extensionsRequired\":[\"KHR_mesh_quantization\",\"KHR_texture_basisu\"],\"asset\"");
    let (part, _) = try_read(&glb(&json, &data)).unwrap();
    // One unit along x, scaled and turned.
    assert!((part.vertices[1] - DVec3::new(0.0, 2.0, 5.0)).length() < 1e-6);

    // Vertex 2 is moved to the position of vertex 1.
    let mut data = quad_bytes();
    data.extend([2, 0, 0, 0]);
    let sparse = r#""sparse":{"count":1,"indices":{"bufferView":2,"componentType":5121},"values":{"bufferView":0,"byteOffset":16}},"type":"VEC3""#;
    let json = QUAD
        .replacen("\"type\":\"VEC3\"", sparse, 1)
        .replace(
            "\"byteLength\":12}]",
            "\"byteLength\":12},{\"buffer\":0,\"byteOffset\":76,\"byteLength\":1}]",
        )
        .replace("\"byteLength\":76", "\"byteLength\":80");
    let (part, _) = try_read(&glb(&json, &data)).unwrap();
    assert_eq!(part.vertices[1], part.vertices[2]);
    data[76] = 4;
    assert!(try_read(&glb(&json, &data))
        .unwrap_err()
        .contains("sparse index 4 of 4"));
}

/// The importer of the crate panics, aborts, reads foreign files or reads nonsense on these.
#[test]
fn what_breaks_the_crate_is_refused() {
    // A bufferView of stride 4 under VEC3: an assertion there.
    refused("\"byteStride\":16", "\"byteStride\":4", "stride 4");
    // A sparse accessor without anything behind it that promises billions of positions.
    let bomb = "\"sparse\":{\"count\":0,\"indices\":{\"bufferView\":0,\"componentType\":5121},\"values\":{\"bufferView\":0}},\"count\":";
    refused(
        "\"bufferView\":0,\"componentType\":5126,\"count\":4",
        &format!("\"componentType\":5126,{bomb}17000000000"),
        "17000000000",
    );
    refused(
        "\"bufferView\":0,\"componentType\":5126,\"count\":4",
        &format!("\"componentType\":5126,{bomb}1000001"),
        "nothing in the file",
    );
    // Positions typed as scalars were read as vectors.
    refused("\"VEC3\"", "\"SCALAR\"", "not of type Vec3");
    // URIs.
    for (uri, word) in [
        ("%FF", "no valid URI"),
        ("../../etc/hostname", "refused"),
        ("a/../../b", "refused"),
        ("%2e%2e/b", "refused"),
        ("/etc/hostname", "refused"),
        ("file:///etc/hostname", "refused"),
        ("http://a.b/c", "refused"),
        ("C:\\\\x", "refused"),
        ("data:;base64,AA", "1 are there"),
        ("data:,AA", "not base64"),
        ("data:;base64,!", "not valid base64"),
        ("nowhere.bin", "nowhere.bin"),
    ] {
        refused(
            "{\"byteLength\":76}",
            &format!("{{\"byteLength\":76,\"uri\":\"{uri}\"}}"),
            word,
        );
    }
    // Headers.
    for length in [0u32, 4, 11, 21, u32::MAX] {
        let mut bytes = quad_glb();
        bytes[8..12].copy_from_slice(&length.to_le_bytes());
        assert!(try_read(&bytes).is_err(), "{length}");
        assert!(try_read(&bytes[..20]).is_err(), "{length}");
    }
    for end in 0..quad_glb().len() {
        assert!(try_read(&quad_glb()[..end]).is_err(), "{end}");
    }
}

#[test]
fn indices_and_lengths_are_checked() {
    refused(
        "\"count\":4",
        "\"count\":5",
        "needs 76 bytes of bufferView 0",
    );
    refused("\"count\":4", "\"count\":2", "index 2");
    refused(
        "\"count\":4",
        "\"count\":18446744073709551615",
        "18446744073709551615",
    );
    refused(
        "\"count\":6",
        "\"count\":7",
        "needs 14 bytes of bufferView 1",
    );
    refused("\"count\":6", "\"count\":5", "5 indices");
    refused(
        "\"byteOffset\":64",
        "\"byteOffset\":65",
        "beyond its buffer",
    );
    refused(
        "\"byteOffset\":64",
        "\"byteOffset\":18446744073709551615",
        "beyond its buffer",
    );
    refused("\"byteLength\":76", "\"byteLength\":77", "77");
    refused(
        "\"byteLength\":76",
        "\"byteLength\":75",
        "beyond its buffer",
    );
    refused("\"bufferView\":1", "\"bufferView\":2", "no bufferView 2");
    refused("\"bufferView\":0,", "", "no bufferView (is");
    refused(
        "\"buffer\":0,\"byteLength\"",
        "\"buffer\":1,\"byteLength\"",
        "no buffer 1",
    );
    refused("\"POSITION\":0", "\"POSITION\":7", "no accessor 7");
    refused("\"POSITION\":0", "\"POSITION\":1", "not of type Vec3");
    refused("5123", "5126", "F32");
    refused("5123", "5000", "component type");
    refused("\"mesh\":0", "\"mesh\":1", "no mesh 1");
    refused("\"nodes\":[0]", "\"nodes\":[9]", "no node 9");
    refused("\"children\":[1]", "\"children\":[0]", "levels");
    refused("\"scene\":0", "\"scene\":3", "no scene 3");
}

#[test]
fn unsupported_extensions_are_named() {
    for extension in ["KHR_draco_mesh_compression", "EXT_meshopt_compression"] {
        let required = format!("\"extensionsRequired\":[\"{extension}\"],\"asset\"");
        refused("\"asset\"", &required, extension);
    }
    refused("\"2.0\"", "\"1.0\"", "version '1.0'");
    assert!(try_read(b"[[[[").unwrap_err().contains("not valid glTF"));
}

#[test]
fn files_beside_the_asset_are_read() {
    let folder = folder("gltf");
    fs::create_dir(folder.join("in side")).unwrap();
    fs::write(folder.join("in side/quad.bin"), quad_bytes()).unwrap();
    let json = QUAD.replace(
        "{\"byteLength\":76}",
        "{\"byteLength\":76,\"uri\":\"./in%20side/quad.bin\"}",
    );
    let path = folder.join("quad.GLTF");
    fs::write(&path, &json).unwrap();
    // Alone, y is up: z = 5 becomes y = -5.
    let scene = load(&path, &LoadOptions::default()).unwrap();
    assert!((scene.visual.bounds().min - Vec3::new(-1.0, -5.0, 0.0)).length() < 1e-5);
    assert!((scene.visual.bounds().max - Vec3::new(0.0, -5.0, 2.0)).length() < 1e-5);
    let z_up = LoadOptions {
        up_axis: Some(super::UpAxis::Z),
        ..LoadOptions::default()
    };
    assert_eq!(load(&path, &z_up).unwrap().visual.bounds().max.z, 5.0);
    // A link that leads out of the folder is not followed.
    #[cfg(unix)]
    {
        let inner = folder.join("in side/quad.gltf");
        fs::write(folder.join("outside.bin"), quad_bytes()).unwrap();
        std::os::unix::fs::symlink("../outside.bin", folder.join("in side/link.bin")).unwrap();
        fs::write(&inner, json.replace("./in%20side/quad.bin", "link.bin")).unwrap();
        let error = load(&inner, &LoadOptions::default())
            .unwrap_err()
            .to_string();
        assert!(error.contains("refused"), "{error}");
    }
    fs::remove_dir_all(folder).unwrap();
}
