use super::*;
use proptest::prelude::*;

fn map(voxels: &[([i8; 3], bool)]) -> Octree {
    let mut octree = Octree::new(0.1, SensorModel::default()).unwrap();
    octree.reserve(IVec3::splat(-16), IVec3::splat(15)).unwrap();
    for (k, occupied) in voxels {
        let key = IVec3::from(k.map(i32::from));
        octree.set_cube(
            key,
            1,
            if *occupied {
                octree.sensor().clamp_max
            } else {
                octree.sensor().clamp_min
            },
        );
    }
    octree
}

fn contents(octree: &Octree) -> Vec<([i32; 3], u32)> {
    let mut all = octree.keys(State::Free);
    all.extend(octree.keys(State::Occupied));
    let mut all: Vec<_> = all
        .iter()
        .map(|k| (k.to_array(), octree.log_odds(*k).unwrap().to_bits()))
        .collect();
    all.sort_unstable();
    all
}

/// A file of another kind of tree with the same leaves: each node of a colour tree has three bytes more.
fn as_kind(kind: &str, bytes: &[u8], colour: bool) -> Vec<u8> {
    let (from, to) = (b"id OcTree\n", format!("id {kind}\n").into_bytes());
    let at = bytes.windows(from.len()).position(|w| w == from).unwrap();
    let data = header(Path::new("test"), bytes).unwrap().data;
    let mut out = [&bytes[..at], &to, &bytes[at + from.len()..data]].concat();
    for node in bytes[data..].chunks(5) {
        out.extend(&node[..4]);
        out.extend(&[1, 2, 3][..if colour { 3 } else { 0 }]);
        out.push(node[4]);
    }
    out
}

#[test]
fn colours_are_ignored_and_other_trees_refused_by_name() {
    let octree = map(&[([1, 2, 3], true), ([-9, 0, 4], false), ([5, 5, 5], true)]);
    let bytes = serialise(&octree, false);
    let read = |bytes: &[u8]| parse(Path::new("a.ot"), bytes, SensorModel::default());
    for (kind, colour) in [("ColorOcTree", true), ("OcTreeStamped", false)] {
        let back = read(&as_kind(kind, &bytes, colour)).unwrap();
        assert_eq!(contents(&back), contents(&octree), "{kind}");
    }
    let error = read(&as_kind("CountingOcTree", &bytes, false))
        .err()
        .unwrap()
        .to_string();
    assert!(
        error.contains("a.ot") && error.contains("CountingOcTree"),
        "{error}"
    );
    assert!(read(&as_kind("ColorOcTree", &bytes, false)).is_err());
}

#[test]
fn binary_files_of_before_1_4_are_read() {
    let octree = map(&[([1, 2, 3], true), ([-9, 0, 4], false), ([5, 5, 5], true)]);
    let bytes = serialise(&octree, true);
    let Header { size, data, .. } = header(Path::new("new"), &bytes).unwrap();
    let mut old = LEGACY.to_vec();
    old.extend(0.1f64.to_le_bytes());
    old.extend((size as u32).to_le_bytes());
    old.extend(&bytes[data..]);
    let read = |bytes: &[u8]| parse(Path::new("old.bt"), bytes, SensorModel::default());
    assert_eq!(contents(&read(&old).unwrap()), contents(&octree));
    for cut in 0..old.len() {
        assert!(read(&old[..cut]).is_err(), "{cut}");
    }
    old[4..12].copy_from_slice(&f64::NAN.to_le_bytes());
    assert!(read(&old).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn what_is_written_is_read(voxels in prop::collection::vec((any::<[i8; 3]>(), any::<bool>()), 0..300), cube in any::<bool>()) {
        let mut octree = map(&voxels);
        if cube {
            octree.set_cube(IVec3::new(-16, 0, 8), 8, octree.sensor().clamp_min);
        }
        for binary in [true, false] {
            let bytes = serialise(&octree, binary);
            let back = parse(Path::new("test"), &bytes, SensorModel::default()).unwrap();
            prop_assert_eq!(contents(&back), contents(&octree));
            prop_assert_eq!(back.recount(), (back.num_known(), back.num_occupied(), back.entropy(), back.information()));
        }
    }

    #[test]
    fn broken_files_are_errors(voxels in prop::collection::vec((any::<[i8; 3]>(), any::<bool>()), 1..60), binary in any::<bool>(),
                               at in any::<prop::sample::Index>(), value in any::<u8>(), cut in any::<prop::sample::Index>()) {
        let mut bytes = serialise(&map(&voxels), binary);
        let i = at.index(bytes.len());
        bytes[i] = value;
        // Whatever it says, it returns.
        let _ = parse(Path::new("test"), &bytes, SensorModel::default());
        bytes.truncate(cut.index(bytes.len()));
        prop_assert!(parse(Path::new("test"), &bytes, SensorModel::default()).is_err());
    }
}
