//! Files as capped bytes, XML as a tidy text: what strict parsers refuse but the field's tools accept is mended here.
use std::fs::File;
use std::io::Read;
use std::path::Path;

use roxmltree::{Document, Node, ParsingOptions};

use super::MAX_FILE_BYTES;
use crate::error::{Error, Result};

/// Longest start tag, bytes: comparing attributes pairwise must not become quadratic in the file.
const MAX_TAG_BYTES: usize = 8192;
const MAX_XML_NODES: u32 = 4_000_000;

/// The lower-case extension without its dot.
pub(super) fn extension(path: &Path) -> String {
    path.extension()
        .map(|e| e.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default()
}

/// The whole file, if it is a regular file (a pipe would block, a device never end) of a permitted size.
pub(super) fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    let file = File::open(path).map_err(|e| Error::io(path, e))?;
    let metadata = file.metadata().map_err(|e| Error::io(path, e))?;
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
    let mut bytes = Vec::with_capacity(metadata.len() as usize);
    // The file may grow between the two calls.
    file.take(MAX_FILE_BYTES)
        .read_to_end(&mut bytes)
        .map_err(|e| Error::io(path, e))?;
    Ok(bytes)
}

/// XML text whose byte positions are those of the file, and what had to be mended.
pub(super) struct Xml {
    text: String,
    pub mended: Option<&'static str>,
}

impl Xml {
    pub fn read(path: &Path) -> Result<Self> {
        Self::new(path, read_bytes(path)?)
    }

    pub fn new(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        if bytes.starts_with(&[0xFF, 0xFE]) || bytes.starts_with(&[0xFE, 0xFF]) {
            return Err(Error::malformed(path, "UTF-16 is not supported"));
        }
        let mut text = String::from_utf8(bytes)
            .unwrap_or_else(|e| String::from_utf8_lossy(e.as_bytes()).into_owned())
            .into_bytes();
        let commented = blank_comments(&mut text);
        let late = blank_late_declaration(&mut text);
        let text = String::from_utf8(text)
            .map_err(|e| Error::malformed(path, format!("not UTF-8: {e}")))?;
        check_tags(path, &text)?;
        let mended = match (late, commented) {
            (true, _) => Some("text before <?xml ...?> was ignored"),
            (false, true) => Some("'--' inside a comment was ignored"),
            _ => None,
        };
        Ok(Self { text, mended })
    }

    pub fn len(&self) -> u64 {
        self.text.len() as u64
    }

    pub fn parse(&self, path: &Path) -> Result<Document<'_>> {
        let options = ParsingOptions {
            allow_dtd: false,
            nodes_limit: MAX_XML_NODES,
            ..ParsingOptions::default()
        };
        Document::parse_with_options(&self.text, options)
            .map_err(|e| Error::malformed(path, format!("not well-formed XML: {e}")))
    }
}

/// Overwrites comments with spaces (line breaks stay); XML forbids '--' within them, TinyXML and authors do not care.
/// True if one held such a '--'.
fn blank_comments(text: &mut [u8]) -> bool {
    let mut mended = false;
    let mut at = 0;
    while let Some(open) = find(text, b"<", at) {
        let rest = &text[open..];
        if rest.starts_with(b"<!--") {
            // An endless comment is left for the parser to complain about.
            let Some(close) = find(text, b"-->", open + 4) else {
                return mended;
            };
            mended |= find(&text[..close], b"--", open + 4).is_some();
            blank(&mut text[open..close + 3]);
            at = close + 3;
        } else if rest.starts_with(b"<![CDATA[") {
            let Some(close) = find(text, b"]]>", open) else {
                return mended;
            };
            at = close + 3;
        } else {
            at = open + 1;
        }
    }
    mended
}

/// An XML declaration must be the first thing in a file; blank it (and a byte order mark) where it is not. Comments are blank already.
fn blank_late_declaration(text: &mut [u8]) -> bool {
    let bom = text.starts_with(&[0xEF, 0xBB, 0xBF]);
    if bom {
        blank(&mut text[..3]);
    }
    let Some(first) = text.iter().position(|b| !b.is_ascii_whitespace()) else {
        return false;
    };
    if (first == 0 && !bom) || !text[first..].starts_with(b"<?xml ") {
        return false;
    }
    let Some(close) = find(text, b"?>", first) else {
        return false;
    };
    blank(&mut text[first..close + 2]);
    !(bom && first == 3)
}

fn blank(text: &mut [u8]) {
    for byte in text {
        if *byte != b'\n' {
            *byte = b' ';
        }
    }
}

fn find(text: &[u8], what: &[u8], from: usize) -> Option<usize> {
    let mut at = from;
    loop {
        let step = text.get(at..)?.iter().position(|b| *b == what[0])?;
        at += step;
        if text[at..].starts_with(what) {
            return Some(at);
        }
        at += 1;
    }
}

fn check_tags(path: &Path, text: &str) -> Result<()> {
    let mut at = 0;
    while let Some(open) = text[at..].find('<').map(|i| at + i) {
        if text[open..].starts_with("<![CDATA[") {
            match text[open..].find("]]>") {
                Some(length) => at = open + length + 3,
                None => return Ok(()),
            }
            continue;
        }
        let Some(length) = text[open..].find('>') else {
            return Ok(());
        };
        if length > MAX_TAG_BYTES {
            return Err(Error::malformed(
                path,
                format!("a tag of {length} bytes at byte {open} is longer than {MAX_TAG_BYTES}"),
            ));
        }
        at = open + length;
    }
    Ok(())
}

/// The child elements with this local name; namespaces do not matter here.
pub(super) fn children<'a, 'i: 'a>(
    node: Node<'a, 'i>,
    name: &'static str,
) -> impl Iterator<Item = Node<'a, 'i>> {
    elements(node).filter(move |n| n.tag_name().name() == name)
}

pub(super) fn elements<'a, 'i: 'a>(node: Node<'a, 'i>) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(|n| n.is_element())
}

pub(super) fn child<'a, 'i: 'a>(node: Node<'a, 'i>, name: &'static str) -> Option<Node<'a, 'i>> {
    children(node, name).next()
}

/// The trimmed text of an element, empty if it has none. Text around a comment that was blanked is one piece.
pub(super) fn content<'a>(node: Node<'a, '_>) -> &'a str {
    node.text().unwrap_or("").trim()
}

/// The line of an element in its file, for messages.
pub(super) fn line(node: Node) -> u32 {
    node.document().text_pos_at(node.range().start).row
}

/// All numbers of a blank-separated text; the first that is none is returned as the error.
pub(super) fn numbers<T: std::str::FromStr>(text: &str) -> std::result::Result<Vec<T>, &str> {
    text.split_ascii_whitespace()
        .map(|word| word.parse().map_err(|_| word))
        .collect()
}
