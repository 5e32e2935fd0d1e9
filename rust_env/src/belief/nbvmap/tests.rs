use super::*;
use crate::belief::octree::State;
use crate::belief::testing::{empty, observe, random};
use crate::geometry::{Aabb, Vec3};
use proptest::prelude::*;

fn same(a: &Octree, b: &Octree) {
    assert_eq!(
        (a.resolution(), a.sensor(), a.limits()),
        (b.resolution(), b.sensor(), b.limits())
    );
    assert_eq!(
        a.recount(),
        (
            a.num_known(),
            a.num_occupied(),
            a.entropy(),
            a.information()
        )
    );
    assert_eq!(a.recount(), b.recount());
    for state in [State::Unknown, State::Free, State::Occupied] {
        assert_eq!(a.keys(state), b.keys(state));
        for key in a.keys(state) {
            let bits = |o: &Octree| {
                (
                    o.log_odds(key).map(f32::to_bits),
                    o.uncertainty(key).to_bits(),
                )
            };
            assert_eq!(bits(a), bits(b));
        }
    }
}

#[test]
fn what_is_written_is_read_and_goes_on_alike() {
    let bounds = Aabb::new(Vec3::splat(-0.5), Vec3::splat(0.7));
    for mut map in [
        empty(),
        random(1, 9, [1, 2, 2]),
        empty().limited_to(&bounds).unwrap(),
    ] {
        if map.limits().is_some() {
            observe(
                &mut map,
                random(2, 4, [0, 1, 1]).keys(State::Occupied),
                true,
                0.4,
            );
        }
        let mut back = parse(&serialise(&map), Some(&map.clone())).unwrap();
        same(&back, &map);
        assert_eq!(serialise(&back), serialise(&map));
        let later = random(3, 5, [1, 1, 1]).keys(State::Free);
        for map in [&mut map, &mut back] {
            observe(map, later.clone(), true, 0.2);
            map.decay(0.7, 0.2, None).unwrap();
        }
        same(&back, &map);
    }
}

#[test]
fn unknown_layers_are_skipped_only_if_they_may_be() {
    let map = random(4, 5, [1, 1, 1]);
    let bytes = serialise(&map);
    let end = bytes.len() - 20;
    for (tag, good) in [(b"view", true), (b"VIEW", false), (b"ODDS", false)] {
        let mut more = bytes[..end].to_vec();
        chunk(&mut more, tag, &[1, 2, 3]);
        more.extend(&bytes[end..]);
        match parse(&more, None) {
            Ok(back) => same(&back, &map),
            Err(e) => assert!(!good && e.contains(&*String::from_utf8_lossy(tag)), "{e}"),
        }
        assert_eq!(parse(&more, None).is_ok(), good);
    }
}

#[test]
fn what_is_no_map_is_said_so() {
    let map = random(5, 5, [1, 1, 1]);
    let bytes = serialise(&map);
    let error = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = bytes.clone();
        change(&mut bytes);
        parse(&bytes, None).err().unwrap()
    };
    assert!(error(&|b| b[8] = 9).contains("version 9 of the format is newer"));
    assert!(error(&|b| b[8] = 0).contains("version 0 of the format is older"));
    assert!(error(&|b| b[0] = b'X').contains("not an .nbvmap file"));
    assert!(error(&|b| b[500] ^= 4).contains("chunk BRKS has a wrong checksum"));
    assert!(error(&|b| b.truncate(1000)).contains("chunk BRKS: the file ends too early"));
    assert!(error(&|b| b.push(0)).contains("1 bytes too many"));
    assert!(parse(
        &bytes,
        Some(
            &empty()
                .limited_to(&Aabb::new(Vec3::ZERO, Vec3::ONE))
                .unwrap()
        )
    )
    .is_err());
}

/// A file with right checksums and any content: it returns.
fn forged(payloads: [&[u8]; 4]) -> Vec<u8> {
    let mut out = Vec::new();
    out.extend(MAGIC);
    out.extend(VERSION.to_le_bytes());
    for (tag, payload) in [b"HEAD", b"BRKS", b"ODDS", b"UNCT"]
        .into_iter()
        .zip(payloads)
    {
        chunk(&mut out, tag, payload);
    }
    chunk(&mut out, b"END ", &[]);
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn every_flipped_byte_is_found(at in any::<prop::sample::Index>(), flip in 1u8..=255, cut in any::<prop::sample::Index>()) {
        let mut bytes = serialise(&random(6, 3, [1, 1, 1]));
        let at = at.index(bytes.len());
        bytes[at] ^= flip;
        prop_assert!(parse(&bytes, None).is_err());
        bytes[at] ^= flip;
        bytes.truncate(cut.index(bytes.len()));
        prop_assert!(parse(&bytes, None).is_err());
    }

    #[test]
    fn forged_content_is_an_error_or_a_sound_map(which in 0usize..4, at in any::<prop::sample::Index>(), value in any::<u8>()) {
        let bytes = serialise(&random(7, 3, [1, 1, 1]));
        let (payloads, _) = chunks(&bytes).unwrap();
        let mut changed = payloads[which].to_vec();
        let at = at.index(changed.len());
        changed[at] = value;
        let mut all = payloads;
        all[which] = &changed;
        if let Ok(map) = parse(&forged(all), None) {
            prop_assert_eq!(map.recount(), (map.num_known(), map.num_occupied(), map.entropy(), map.information()));
        }
    }
}

#[test]
fn resealed_bytes_are_those_of_the_writer() {
    let bytes = serialise(&random(8, 3, [1, 1, 1]));
    let mut broken = bytes.clone();
    let end = broken.len();
    broken[end - 8..].fill(0);
    assert!(parse(&broken, None).is_err());
    reseal(&mut broken);
    assert_eq!(broken, bytes);
    for cut in 0..bytes.len() {
        reseal(&mut broken[..cut]);
    }
    assert_eq!(broken, bytes);
}

#[test]
fn the_seeds_of_the_fuzzer_are_maps() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/rust_env/fuzz/seeds/nbvmap");
    let mut files = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let mut bytes = std::fs::read(entry.unwrap().path()).unwrap();
        reseal(&mut bytes);
        let map = parse(&bytes, None).unwrap();
        assert_eq!((map.num_known(), map.num_occupied()), (2, 1));
        files += 1;
    }
    assert_eq!(files, 2);
}
