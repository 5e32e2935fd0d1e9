//! Scenes, their hierarchies and what sight can reach, kept on disk: the second load of a world takes a fraction of the first.
//!
//! One file an entry, named by a digest of the question (which file, read how). An entry of a scene also holds all that the
//! reader asked the disk, with the digest of every file's bytes: it counts only if all answers are still the same. A header
//! names the build of the code that wrote it and a checksum, and reading trusts none of the bytes behind it ([`entry`]).
//! Entries are written beside their place and renamed, so that readers and other writers see whole ones only.
pub(in crate::world) mod entry;
#[cfg(test)]
mod tests;

pub use entry::{read_scene, read_truth, SceneEntry};

use std::env;
use std::fs::{self, File, FileTimes};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use xxhash_rust::xxh3::xxh3_128;

use super::bytes::{Fault, Reader, Writer};

/// Where entries are kept, or `off`.
pub const VARIABLE: &str = "NBV_GYM_CACHE";
/// All entries together; the one used longest ago goes first.
pub const MAX_BYTES: u64 = 2 << 30;
/// Another build of the code that reads and builds scenes has other entries (see build.rs).
const BUILD: &str = env!("NBV_GYM_WORLD_DIGEST");
const MAGIC: &[u8; 8] = b"NBVCACHE";
const EXTENSION: &str = "nbv";
/// What a writer that died has left behind goes after this time.
const DRAFT_AGE: Duration = Duration::from_secs(3600);

/// A folder of entries.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SceneCache {
    folder: PathBuf,
    max_bytes: u64,
}

/// What became of a look into the cache.
#[derive(Debug)]
pub enum Found<T> {
    Good(T),
    Nothing,
    /// There is an entry, which must be made anew, and why.
    Bad(Fault),
}

impl SceneCache {
    pub fn new(folder: PathBuf, max_bytes: u64) -> Self {
        Self { folder, max_bytes }
    }

    /// The folder named by `NBV_GYM_CACHE`, or else the platform's folder for caches; `None` if that is `off` or unknown.
    pub fn of_environment() -> Option<Self> {
        let folder = match env::var_os(VARIABLE).filter(|v| !v.is_empty()) {
            Some(value) if value.eq_ignore_ascii_case("off") => return None,
            Some(folder) => PathBuf::from(folder),
            // Unit tests must leave the user's folder alone.
            None if cfg!(test) => return None,
            None => platform_folder()?.join("nbv-gym"),
        };
        Some(Self::new(folder, MAX_BYTES))
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The payload behind a question, if it was written by this build and is whole.
    pub fn read(&self, question: u128) -> Found<Vec<u8>> {
        let path = self.path(question);
        let Ok(metadata) = fs::metadata(&path) else {
            return Found::Nothing;
        };
        if !metadata.is_file() || metadata.len() > self.max_bytes {
            return Found::Bad("not an entry");
        }
        let mut bytes = Vec::with_capacity(metadata.len() as usize);
        let read = File::open(&path).and_then(|f| f.take(self.max_bytes).read_to_end(&mut bytes));
        if read.is_err() {
            return Found::Bad("unreadable");
        }
        match header_length(&bytes) {
            Ok(header) => {
                bytes.drain(..header);
                // For the order in which entries go; a folder that is only readable keeps its times.
                let now = FileTimes::new().set_modified(SystemTime::now());
                let _ = File::options()
                    .append(true)
                    .open(&path)
                    .and_then(|f| f.set_times(now));
                Found::Good(bytes)
            }
            Err(fault) => Found::Bad(fault),
        }
    }

    /// Writes an entry whole or not at all, then drops the oldest ones beyond the limit.
    pub fn write(&self, question: u128, payload: &[u8]) -> io::Result<()> {
        static DRAFTS: AtomicU64 = AtomicU64::new(0);
        let header = header(payload);
        let size = (header.len() + payload.len()) as u64;
        if size > self.max_bytes {
            let message = format!("{size} bytes are more than the cache may hold");
            return Err(io::Error::new(io::ErrorKind::QuotaExceeded, message));
        }
        fs::create_dir_all(&self.folder)?;
        let path = self.path(question);
        let draft = path.with_extension(format!(
            "{}-{}.draft",
            std::process::id(),
            DRAFTS.fetch_add(1, Ordering::Relaxed)
        ));
        let written = File::create_new(&draft)
            .and_then(|mut file| {
                file.write_all(&header)?;
                file.write_all(payload)
            })
            .and_then(|()| fs::rename(&draft, &path));
        if written.is_err() {
            let _ = fs::remove_file(&draft);
        }
        written?;
        self.drop_oldest(&path);
        Ok(())
    }

    /// Number of entries and their bytes.
    pub fn size(&self) -> (usize, u64) {
        let entries = self.files(EXTENSION);
        (entries.len(), entries.iter().map(|e| e.bytes).sum())
    }

    /// Removes all entries and returns how many there were; other files in the folder stay.
    pub fn clear(&self) -> io::Result<usize> {
        let entries = self.files(EXTENSION);
        for entry in entries.iter().chain(&self.files("draft")) {
            match fs::remove_file(&entry.path) {
                Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
                _ => {}
            }
        }
        Ok(entries.len())
    }

    fn path(&self, question: u128) -> PathBuf {
        self.folder.join(format!("{question:032x}.{EXTENSION}"))
    }

    fn files(&self, extension: &str) -> Vec<Entry> {
        let Ok(files) = fs::read_dir(&self.folder) else {
            return Vec::new();
        };
        files
            .flatten()
            .filter_map(|file| {
                let path = file.path();
                let metadata = file.metadata().ok()?;
                let ours = path.file_name()?.to_str()?.get(..32)?;
                let ours = ours.bytes().all(|c| c.is_ascii_hexdigit());
                let fits = path.extension()? == extension && ours && metadata.is_file();
                fits.then_some(Entry {
                    used: metadata.modified().ok()?,
                    bytes: metadata.len(),
                    path,
                })
            })
            .collect()
    }

    /// Other processes may drop the same entries at the same time: one that is gone is no error.
    fn drop_oldest(&self, keep: &Path) {
        for draft in self.files("draft") {
            if draft.used.elapsed().is_ok_and(|age| age > DRAFT_AGE) {
                let _ = fs::remove_file(&draft.path);
            }
        }
        let mut entries = self.files(EXTENSION);
        entries.sort_by(|a, b| (a.used, &a.path).cmp(&(b.used, &b.path)));
        let mut total: u64 = entries.iter().map(|e| e.bytes).sum();
        for entry in entries.iter().filter(|e| e.path != keep) {
            if total <= self.max_bytes {
                break;
            }
            let _ = fs::remove_file(&entry.path);
            total -= entry.bytes;
        }
    }
}

struct Entry {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
}

fn header(payload: &[u8]) -> Vec<u8> {
    let mut out = Writer(MAGIC.to_vec());
    out.text(BUILD);
    out.u128(xxh3_128(payload));
    out.0
}

fn header_length(bytes: &[u8]) -> Result<usize, Fault> {
    let mut reader = Reader(bytes);
    if reader.take(MAGIC.len())? != MAGIC {
        return Err("not an entry");
    }
    if reader.text()? != BUILD {
        return Err("written by another version");
    }
    if reader.u128()? != xxh3_128(reader.0) {
        return Err("damaged");
    }
    Ok(bytes.len() - reader.0.len())
}

fn platform_folder() -> Option<PathBuf> {
    let named = |variable: &str| {
        env::var_os(variable)
            .map(PathBuf::from)
            .filter(|p| p.is_absolute())
    };
    if cfg!(windows) {
        return named("LOCALAPPDATA");
    }
    if cfg!(target_os = "macos") {
        return named("HOME").map(|home| home.join("Library/Caches"));
    }
    named("XDG_CACHE_HOME").or_else(|| named("HOME").map(|home| home.join(".cache")))
}
