//! Our own map file (`.nbvmap`): every layer of the map, bit for bit.
//!
//! Little-endian: the magic, the version (u32), then chunks of tag (4 letters), length of the payload (u64), payload and
//! checksum (u64, XXH3 of tag, length and payload); an empty chunk `END ` is the last. A chunk whose tag begins with a
//! small letter may be left out and is skipped by readers that do not know it, as in PNG: room for further layers.
//!
//! | tag | payload |
//! |---|---|
//! | `HEAD` | resolution (f64, metres), log-odds of hit, miss and the two clamps (f32), whether the map has limits (u8) and, if so, their lower and upper key (6 i32), number of bricks (u32) |
//! | `BRKS` | for each brick its coordinates (3 i32), known and occupied voxels (8 u64 each) |
//! | `ODDS` | log-odds (f32) of the known voxels, bricks in their order, voxels by z, y, x |
//! | `UNCT` | for each brick whether it has uncertainties (u8); then, for those, the known voxels' (f32) |
//! | `hist` | only if the map keeps a view history; see [`ViewHistory::serialise`] |
use super::octree::{KeyBox, NewBrick, Octree, SensorModel, KEY_LIMIT, SIDE, VOXELS};
use super::view_history::ViewHistory;
use crate::geometry::IVec3;
use xxhash_rust::xxh3::Xxh3;

const MAGIC: &[u8; 8] = b"NBVMAP\r\n";
/// Of the format that is written, and the newest that is read.
pub const VERSION: u32 = 1;

type Parsed<T> = std::result::Result<T, String>;

fn checksum(tag: &[u8], length: &[u8], payload: &[u8]) -> u64 {
    let mut hash = Xxh3::new();
    hash.update(tag);
    hash.update(length);
    hash.update(payload);
    hash.digest()
}

fn chunk(out: &mut Vec<u8>, tag: &[u8; 4], payload: &[u8]) {
    let length = (payload.len() as u64).to_le_bytes();
    out.extend(tag);
    out.extend(length);
    out.extend(payload);
    out.extend(checksum(tag, &length, payload).to_le_bytes());
}

/// Numbers of the voxels whose bits are set.
fn voxels(mask: &[u64; 8]) -> impl Iterator<Item = usize> + '_ {
    mask.iter().enumerate().flat_map(|(word, mask)| {
        let mut bits = *mask;
        std::iter::from_fn(move || {
            (bits != 0).then(|| {
                let bit = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                word * 64 + bit
            })
        })
    })
}

/// The file's bytes.
pub fn serialise(octree: &Octree) -> Vec<u8> {
    let bricks = octree.bricks();
    let sensor = octree.sensor();
    let mut head = Vec::new();
    head.extend(octree.resolution().to_le_bytes());
    for value in [sensor.hit, sensor.miss, sensor.clamp_min, sensor.clamp_max] {
        head.extend(value.to_le_bytes());
    }
    head.push(u8::from(octree.limits().is_some()));
    if let Some(limits) = octree.limits() {
        for key in [limits.min, limits.max] {
            key.to_array()
                .iter()
                .for_each(|k| head.extend(k.to_le_bytes()));
        }
    }
    head.extend((bricks.len() as u32).to_le_bytes());

    let mut masks = Vec::with_capacity(bricks.len() * BRICK_BYTES);
    let mut odds = Vec::with_capacity(octree.num_known() as usize * 4);
    let (mut flags, mut uncertainty) = (Vec::with_capacity(bricks.len()), Vec::new());
    for (number, brick) in bricks.iter().enumerate() {
        for c in octree.brick_coordinates(number).to_array() {
            masks.extend(c.to_le_bytes());
        }
        for word in brick.known.iter().chain(&brick.occupied) {
            masks.extend(word.to_le_bytes());
        }
        for voxel in voxels(&brick.known) {
            odds.extend(brick.log_odds[voxel].to_le_bytes());
        }
        let has = octree.has_uncertainty(brick);
        flags.push(u8::from(has));
        for voxel in voxels(&brick.known).filter(|_| has) {
            uncertainty.extend(octree.brick_uncertainty(brick, voxel).to_le_bytes());
        }
    }
    flags.extend(uncertainty);

    let mut out = Vec::with_capacity(masks.len() + odds.len() + flags.len() + 256);
    out.extend(MAGIC);
    out.extend(VERSION.to_le_bytes());
    for (tag, payload) in [
        (b"HEAD", head),
        (b"BRKS", masks),
        (b"ODDS", odds),
        (b"UNCT", flags),
    ] {
        chunk(&mut out, tag, &payload);
    }
    if let Some(history) = octree.view_history() {
        chunk(&mut out, b"hist", &history.serialise());
    }
    chunk(&mut out, b"END ", &[]);
    out
}

const BRICK_BYTES: usize = 3 * 4 + 16 * 8;

/// Bytes that are read from the front, never past their end.
struct Reader<'a> {
    bytes: &'a [u8],
    what: &'a str,
}

impl<'a> Reader<'a> {
    fn take(&mut self, n: u64) -> Parsed<&'a [u8]> {
        let n = usize::try_from(n).unwrap_or(usize::MAX);
        if self.bytes.len() < n {
            return Err(format!(
                "{} ends too early: {n} bytes are missing, there are {}",
                self.what,
                self.bytes.len()
            ));
        }
        let (head, tail) = self.bytes.split_at(n);
        self.bytes = tail;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Parsed<[u8; N]> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N as u64)?);
        Ok(out)
    }
    fn u32(&mut self) -> Parsed<u32> {
        self.array().map(u32::from_le_bytes)
    }
    fn u64(&mut self) -> Parsed<u64> {
        self.array().map(u64::from_le_bytes)
    }
    fn f32(&mut self) -> Parsed<f32> {
        self.array().map(f32::from_le_bytes)
    }
    fn f64(&mut self) -> Parsed<f64> {
        self.array().map(f64::from_le_bytes)
    }
    fn flag(&mut self) -> Parsed<bool> {
        let [byte] = self.array()?;
        flag_of(byte, self.what)
    }
    fn key(&mut self) -> Parsed<IVec3> {
        let mut c = || self.array().map(i32::from_le_bytes);
        Ok(IVec3::new(c()?, c()?, c()?))
    }
    fn finish(&self) -> Parsed<()> {
        match self.bytes.len() {
            0 => Ok(()),
            n => Err(format!("{} has {n} bytes too many", self.what)),
        }
    }
}

fn flag_of(byte: u8, what: &str) -> Parsed<bool> {
    match byte {
        0 => Ok(false),
        1 => Ok(true),
        other => Err(format!("{what} has {other} where 0 or 1 must stand")),
    }
}

/// The payloads of the required chunks in the order of `TAGS`, and that of `hist` if there is one; every checksum was right.
#[allow(clippy::type_complexity)]
fn chunks(bytes: &[u8]) -> Parsed<([&[u8]; 4], Option<&[u8]>)> {
    const TAGS: [&[u8; 4]; 4] = [b"HEAD", b"BRKS", b"ODDS", b"UNCT"];
    let mut history = None;
    let mut file = Reader {
        bytes,
        what: "the file",
    };
    if file.take(8).ok() != Some(MAGIC.as_slice()) {
        return Err("not an .nbvmap file (it does not begin with NBVMAP)".to_owned());
    }
    let version = file.u32()?;
    if version != VERSION {
        let age = if version > VERSION { "newer" } else { "older" };
        return Err(format!(
            "version {version} of the format is {age} than what is read here, version {VERSION}"
        ));
    }
    let mut found: [Option<&[u8]>; 4] = [None; 4];
    loop {
        let tag: [u8; 4] = file.array()?;
        let name = tag.escape_ascii();
        let length: [u8; 8] = file.array()?;
        let payload = file
            .take(u64::from_le_bytes(length))
            .map_err(|e| format!("chunk {name}: {e}"))?;
        if file.u64()? != checksum(&tag, &length, payload) {
            return Err(format!(
                "chunk {name} has a wrong checksum: the file is damaged"
            ));
        }
        if &tag == b"END " {
            break;
        }
        match TAGS.iter().position(|t| **t == tag) {
            Some(i) if found[i].is_some() => {
                return Err(format!("chunk {name} stands there twice"))
            }
            Some(i) => found[i] = Some(payload),
            None if &tag == b"hist" && history.is_some() => {
                return Err(format!("chunk {name} stands there twice"))
            }
            None if &tag == b"hist" => history = Some(payload),
            None if tag[0].is_ascii_lowercase() => {}
            None => return Err(format!("chunk {name} is unknown and cannot be left out")),
        }
    }
    file.finish()?;
    let mut payloads: [&[u8]; 4] = [&[]; 4];
    for ((out, payload), tag) in payloads.iter_mut().zip(found).zip(TAGS) {
        *out = payload.ok_or_else(|| format!("chunk {} is missing", tag.escape_ascii()))?;
    }
    Ok((payloads, history))
}

/// An empty map by `HEAD`, and the number of bricks that follow.
fn head(payload: &[u8], expected: Option<&Octree>) -> Parsed<(Octree, usize)> {
    let mut head = Reader {
        bytes: payload,
        what: "chunk HEAD",
    };
    let resolution = head.f64()?;
    let [hit, miss, clamp_min, clamp_max] = [head.f32()?, head.f32()?, head.f32()?, head.f32()?];
    let limits = if head.flag()? {
        let (min, max) = (head.key()?, head.key()?);
        let limit = IVec3::splat(KEY_LIMIT);
        if min.cmplt(-limit).any() || max.cmpgt(limit).any() || min.cmpge(max).any() {
            return Err(format!(
                "limits {min} .. {max} are empty or beyond the key space"
            ));
        }
        Some(KeyBox { min, max })
    } else {
        None
    };
    let count = head.u32()?;
    head.finish()?;
    let sensor = SensorModel {
        hit,
        miss,
        clamp_min,
        clamp_max,
    };
    let right =
        |low: f32, high: f32| low.is_finite() && low < 0.0 && high.is_finite() && high > 0.0;
    if !(right(miss, hit) && right(clamp_min, clamp_max)) {
        return Err(format!("{sensor:?} is no sensor model"));
    }
    // Before anything of the size that the file says is made.
    if let Some(e) = expected {
        if (e.resolution(), e.sensor(), e.limits()) != (resolution, &sensor, limits) {
            return Err("the map has another resolution, sensor model or limits".to_owned());
        }
    }
    let octree = Octree::new(resolution, sensor).and_then(|o| o.with_limits(limits));
    Ok((octree.map_err(|e| e.to_string())?, count as usize))
}

/// Where the next map file begins in these bytes.
#[doc(hidden)]
pub fn find(bytes: &[u8]) -> Option<usize> {
    bytes.windows(MAGIC.len()).position(|w| w == MAGIC)
}

/// Make all chunks' checksums right, so that a fuzzer gets to what lies behind them.
#[doc(hidden)]
pub fn reseal(bytes: &mut [u8]) {
    const TAG: usize = 4;
    const LENGTH: usize = 8;
    let mut at = MAGIC.len() + 4;
    while let Some(rest) = bytes.get_mut(at..) {
        let Some(length) = rest.get(TAG..TAG + LENGTH) else {
            return;
        };
        let payload = u64::from_le_bytes(std::array::from_fn(|i| length[i]));
        let (start, room) = (TAG + LENGTH, rest.len() as u64);
        // Eight bytes of checksum follow.
        if payload.saturating_add(start as u64 + 8) > room {
            return;
        }
        let end = start + payload as usize;
        let sum = checksum(&rest[..TAG], &rest[TAG..start], &rest[start..end]);
        rest[end..end + 8].copy_from_slice(&sum.to_le_bytes());
        at += end + 8;
    }
}

/// The map in a file's bytes. If `expected` is given, resolution, sensor model and limits must be that map's.
///
/// Allocates at most some 40 bytes for each one that is read, and the root grid (5 bytes for each brick of the box that
/// the map spans, at most 2^26).
pub fn parse(bytes: &[u8], expected: Option<&Octree>) -> Parsed<Octree> {
    let ([first, masks, odds, uncertainty], history) = chunks(bytes)?;
    let (mut octree, count) = head(first, expected)?;
    if expected.is_some_and(|e| e.view_history().is_some() != history.is_some()) {
        return Err("only one of the two maps keeps a view history".to_owned());
    }
    if masks.len() != count.saturating_mul(BRICK_BYTES) {
        return Err(format!(
            "chunk BRKS has {} bytes for {count} bricks",
            masks.len()
        ));
    }
    let reader = |bytes, what| Reader { bytes, what };
    let mut scan = reader(masks, "chunk BRKS");
    let (mut low, mut high) = (IVec3::MAX, IVec3::MIN);
    for _ in 0..count {
        let corner = scan.key()?;
        let limit = IVec3::splat(KEY_LIMIT / SIDE);
        if corner.cmplt(-limit).any() || corner.cmpge(limit).any() {
            return Err(format!("brick {corner} lies beyond the key space"));
        }
        (low, high) = (low.min(corner), high.max(corner));
        scan.take(16 * 8)?;
    }
    if count > 0 {
        octree.reserve(low, high).map_err(|e| e.to_string())?;
    }
    let mut masks = reader(masks, "chunk BRKS");
    let mut odds = reader(odds, "chunk ODDS");
    let mut uncertainty = reader(uncertainty, "chunk UNCT");
    let flags = uncertainty.take(count as u64)?;
    for flag in flags {
        let mut brick = NewBrick {
            corner: masks.key()?,
            known: [0; 8],
            occupied: [0; 8],
            log_odds: [0.0; VOXELS],
            uncertainty: flag_of(*flag, "chunk UNCT")?.then_some([1.0; VOXELS]),
        };
        for word in brick.known.iter_mut().chain(&mut brick.occupied) {
            *word = masks.u64()?;
        }
        for voxel in voxels(&brick.known) {
            brick.log_odds[voxel] = odds.f32()?;
        }
        if let Some(block) = &mut brick.uncertainty {
            for voxel in voxels(&brick.known) {
                block[voxel] = uncertainty.f32()?;
            }
        }
        octree.insert(&brick).map_err(|e| e.to_string())?;
    }
    odds.finish()?;
    uncertainty.finish()?;
    if let Some(payload) = history {
        let read = ViewHistory::parse(payload, octree.bricks());
        octree = octree.with_history(read.map_err(|e| format!("chunk hist: {e}"))?);
    }
    Ok(octree)
}

#[cfg(test)]
mod tests;
