//! All that a reader asks the disk, written down, so that a cache can ask again whether the answers still hold.
//!
//! Nothing else in this folder may touch the disk: a file that is read beside this one would not be missed when it changes.
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use xxhash_rust::xxh3::{xxh3_128, Xxh3};

use super::MAX_FILE_BYTES;
use crate::error::{Error, Result};

/// A scene that asked more often is read anew each time.
pub const MAX_QUESTIONS: usize = 100_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Missing,
    File,
    Folder,
    /// A pipe, a device.
    Other,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Question {
    /// What is there?
    Kind,
    /// Which bytes does the file hold?
    Bytes,
    /// Which names does the folder hold?
    Names,
    /// Where do links lead?
    Target,
}

/// Questions and answers: the number of a [`Kind`], or a digest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Answers(pub BTreeMap<(PathBuf, Question), u128>);

struct Record {
    answers: Answers,
    /// False once a file could not be read or there were too many questions.
    complete: bool,
}

thread_local! {
    static RECORD: RefCell<Option<Record>> = const { RefCell::new(None) };
}

/// Runs `read` and returns what it asked the disk as well; `None` if that cannot be asked again.
pub fn recorded<T>(read: impl FnOnce() -> T) -> (T, Option<Answers>) {
    let fresh = Record {
        answers: Answers::default(),
        complete: true,
    };
    RECORD.with_borrow_mut(|record| *record = Some(fresh));
    let out = read();
    let record = RECORD.with_borrow_mut(Option::take);
    (out, record.filter(|r| r.complete).map(|r| r.answers))
}

fn note(path: &Path, question: Question, answer: Option<u128>) {
    RECORD.with_borrow_mut(|record| {
        let Some(record) = record else { return };
        let known = &mut record.answers.0;
        match answer {
            // A file that changes while it is read twice has no one answer.
            Some(answer) if known.len() < MAX_QUESTIONS => {
                let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
                let key = (path, question);
                record.complete &= *known.entry(key).or_insert(answer) == answer;
            }
            _ => record.complete = false,
        }
    });
}

/// A file that is not there may be there later; one that is there but cannot be read has no answer.
fn note_absence(path: &Path) {
    let kind = kind_of(path);
    note(
        path,
        Question::Kind,
        (kind != Kind::File).then_some(kind as u128),
    );
}

impl Answers {
    /// Asks everything again: true if nothing has changed.
    pub fn hold(&self) -> bool {
        self.0.iter().all(|((path, question), answer)| {
            let now = match question {
                Question::Kind => Some(kind_of(path) as u128),
                Question::Bytes => read(path).ok().map(|bytes| xxh3_128(&bytes)),
                Question::Names => Some(digest(&names_in(path))),
                Question::Target => path.canonicalize().ok().map(|real| digest(&[real.into()])),
            };
            now == Some(*answer)
        })
    }
}

pub(super) fn kind(path: &Path) -> Kind {
    let kind = kind_of(path);
    note(path, Question::Kind, Some(kind as u128));
    kind
}

pub(super) fn exists(path: &Path) -> bool {
    kind(path) != Kind::Missing
}

pub(super) fn is_file(path: &Path) -> bool {
    kind(path) == Kind::File
}

pub(super) fn is_folder(path: &Path) -> bool {
    kind(path) == Kind::Folder
}

/// The names in a folder, sorted; none if it cannot be read.
pub(super) fn names(folder: &Path) -> Vec<OsString> {
    let names = names_in(folder);
    note(folder, Question::Names, Some(digest(&names)));
    names
}

/// The whole file, if it is a regular file (a pipe would block, a device never end) of a permitted size.
pub(super) fn bytes(path: &Path) -> Result<Vec<u8>> {
    let bytes = read(path);
    match &bytes {
        Ok(bytes) => note(path, Question::Bytes, Some(xxh3_128(bytes))),
        Err(_) => note_absence(path),
    }
    bytes
}

/// The path with all links followed.
pub(super) fn target(path: &Path) -> std::io::Result<PathBuf> {
    let real = path.canonicalize();
    match &real {
        Ok(real) => note(path, Question::Target, Some(digest(&[real.into()]))),
        Err(_) => note_absence(path),
    }
    real
}

fn kind_of(path: &Path) -> Kind {
    match fs::metadata(path) {
        Err(_) => Kind::Missing,
        Ok(metadata) if metadata.is_file() => Kind::File,
        Ok(metadata) if metadata.is_dir() => Kind::Folder,
        Ok(_) => Kind::Other,
    }
}

fn names_in(folder: &Path) -> Vec<OsString> {
    let mut names: Vec<OsString> = fs::read_dir(folder)
        .map(|entries| entries.flatten().map(|e| e.file_name()).collect())
        .unwrap_or_default();
    names.sort();
    names
}

fn digest(names: &[OsString]) -> u128 {
    let mut hash = Xxh3::new();
    for name in names {
        hash.update(name.as_encoded_bytes());
        hash.update(&[0]);
    }
    hash.digest128()
}

fn read(path: &Path) -> Result<Vec<u8>> {
    // Before it is opened: to open a pipe may block.
    let metadata = fs::metadata(path).map_err(|e| Error::io(path, e))?;
    if !metadata.is_file() {
        return Err(Error::malformed(path, "not a regular file"));
    }
    if metadata.len() > MAX_FILE_BYTES {
        return Err(Error::malformed(
            path,
            format!(
                "{} bytes are more than the limit of {MAX_FILE_BYTES}",
                metadata.len()
            ),
        ));
    }
    let file = File::open(path).map_err(|e| Error::io(path, e))?;
    let mut bytes = Vec::with_capacity(metadata.len() as usize);
    // The file may grow between the two calls.
    file.take(MAX_FILE_BYTES)
        .read_to_end(&mut bytes)
        .map_err(|e| Error::io(path, e))?;
    Ok(bytes)
}
