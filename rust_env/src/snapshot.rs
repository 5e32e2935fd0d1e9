//! Snapshots: a simulator as bytes, so that it goes on bit for bit elsewhere.
//!
//! The magic, the version (u32), a checksum of what follows (XXH3, u64), and a [`Snapshot`] as postcard writes it. The
//! checksum finds damage; against forgery every value is checked where it is used, and nothing is executed.
use crate::belief::nbvmap;
use crate::episode::EpisodeState;
use crate::error::{Error, Result};
use crate::setup::Setup;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use xxhash_rust::xxh3::xxh3_64;

const MAGIC: &[u8; 8] = b"NBVSNAP\n";
/// To be raised with every change of a saved state.
pub const VERSION: u32 = 3;
const HEADER: usize = 8 + 4 + 8;

/// One environment.
#[derive(Serialize, Deserialize)]
pub struct SlotState<'a> {
    pub seeds: Pcg64Mcg,
    #[serde(borrow)]
    pub episode: Option<EpisodeState<'a>>,
}

#[derive(Serialize, Deserialize)]
pub struct Snapshot<'a> {
    /// As Rust prints it: two setups that read alike are alike, and what differs can be shown.
    setup: Cow<'a, str>,
    /// What the caller wrote into it.
    #[serde(borrow)]
    pub notes: Cow<'a, [u8]>,
    #[serde(borrow)]
    pub slots: Vec<SlotState<'a>>,
}

fn broken(what: &str) -> Error {
    Error::invalid(format!("snapshot: {what}"))
}

pub fn write(setup: &Setup, notes: &[u8], slots: Vec<SlotState>) -> Result<Vec<u8>> {
    let snapshot = Snapshot {
        setup: format!("{setup:#?}").into(),
        notes: notes.into(),
        slots,
    };
    let body =
        postcard::to_allocvec(&snapshot).map_err(|e| Error::Internal(format!("snapshot: {e}")))?;
    Ok(with_header(&body))
}

fn with_header(body: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(HEADER + body.len());
    out.extend(MAGIC);
    out.extend(VERSION.to_le_bytes());
    out.extend(xxh3_64(body).to_le_bytes());
    out.extend(body);
    out
}

/// A snapshot of this setup whose notes and environments are these bytes, with all checksums made right, so that a fuzzer
/// gets to what lies behind them.
#[doc(hidden)]
pub fn sealed(setup: &Setup, rest: &[u8]) -> Result<Vec<u8>> {
    let mut rest = rest.to_vec();
    let mut at = 0;
    while let Some(map) = nbvmap::find(&rest[at..]) {
        at += map;
        nbvmap::reseal(&mut rest[at..]);
        at += 1;
    }
    let setup = postcard::to_allocvec(&format!("{setup:#?}"));
    let mut body = setup.map_err(|e| Error::Internal(format!("snapshot: {e}")))?;
    body.extend(rest);
    Ok(with_header(&body))
}

/// What [`sealed`] makes a snapshot of.
#[doc(hidden)]
pub fn unsealed(bytes: &[u8]) -> Result<&[u8]> {
    let body = bytes.get(HEADER..).unwrap_or_default();
    let setup = postcard::take_from_bytes::<Cow<str>>(body);
    setup
        .map(|(_, rest)| rest)
        .map_err(|e| broken(&format!("its setup cannot be read ({e})")))
}

/// Reads without copying maps and images; allocates a small multiple of the bytes.
pub fn read(bytes: &[u8]) -> Result<Snapshot<'_>> {
    let Some((header, body)) = bytes.split_first_chunk::<HEADER>() else {
        return Err(broken("it ends too early"));
    };
    let (magic, rest) = header.split_at(8);
    if magic != MAGIC {
        return Err(broken(
            "these bytes are none (they do not begin with NBVSNAP)",
        ));
    }
    let (version, checksum) = rest.split_at(4);
    let version = version.try_into().map_or(0, u32::from_le_bytes);
    if version != VERSION {
        let age = if version > VERSION { "newer" } else { "older" };
        return Err(broken(&format!(
            "its version {version} is {age} than what is read here, version {VERSION}"
        )));
    }
    if checksum != xxh3_64(body).to_le_bytes() {
        return Err(broken("its checksum is wrong: it is damaged"));
    }
    let (snapshot, rest) = postcard::take_from_bytes(body)
        .map_err(|e| broken(&format!("its content cannot be read ({e})")))?;
    if rest.is_empty() {
        Ok(snapshot)
    } else {
        Err(broken(&format!("it has {} bytes too many", rest.len())))
    }
}

impl Snapshot<'_> {
    /// An error that shows the first difference if the snapshot was taken under another setup.
    pub fn check_setup(&self, setup: &Setup) -> Result<()> {
        let here = format!("{setup:#?}");
        if here == self.setup {
            return Ok(());
        }
        let mut lines = self.setup.lines().zip(here.lines());
        let (there, here) = lines.find(|(a, b)| a != b).unwrap_or(("more", "less"));
        Err(broken(&format!(
            "it was taken under another setup: {} instead of {}",
            there.trim(),
            here.trim()
        )))
    }
}

#[cfg(test)]
mod tests;
