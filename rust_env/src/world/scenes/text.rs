//! Files as capped bytes, XML as a tidy text: what strict parsers refuse but the field's tools accept is mended here.
use std::path::Path;

use roxmltree::{Document, Node, ParsingOptions};

use super::disk;
use crate::error::{Error, Result};

/// Longest start tag, and its attributes: the parser compares them pairwise.
const MAX_TAG_BYTES: usize = 8192;
const MAX_ATTRIBUTES: usize = 100;
/// Namespace prefixes that are looked at.
const MAX_PREFIXES: usize = 20;
const MAX_XML_NODES: u32 = 4_000_000;

/// The lower-case extension without its dot.
pub(super) fn extension(path: &Path) -> String {
    path.extension()
        .map(|e| e.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default()
}

/// XML text whose lines are those of the file, and what had to be mended.
pub(super) struct Xml {
    text: String,
    pub mended: Vec<&'static str>,
}

impl Xml {
    pub fn read(path: &Path) -> Result<Self> {
        Self::new(path, disk::bytes(path)?)
    }

    pub fn new(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        if bytes.starts_with(&[0xFF, 0xFE]) || bytes.starts_with(&[0xFE, 0xFF]) {
            return Err(Error::malformed(path, "UTF-16 is not supported"));
        }
        let mut text = String::from_utf8(bytes)
            .unwrap_or_else(|e| String::from_utf8_lossy(e.as_bytes()).into_owned())
            .into_bytes();
        // The parser is slow where it has to normalise line ends.
        for byte in &mut text {
            if *byte == b'\r' {
                *byte = b' ';
            }
        }
        let mut mended = Vec::new();
        if blank_comments(&mut text) {
            mended.push("'--' inside a comment was ignored");
        }
        if blank_late_declaration(&mut text) {
            mended.push("text before <?xml ...?> was ignored");
        }
        if let Some(better) = mend_tags(&text).map_err(|m| Error::malformed(path, m))? {
            text = better;
            mended.push("attributes without quotes or prefixes without xmlns were mended");
        }
        let text = String::from_utf8(text)
            .map_err(|e| Error::malformed(path, format!("not UTF-8: {e}")))?;
        Ok(Self { text, mended })
    }

    pub fn bytes(&self) -> usize {
        self.text.len()
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

/// TinyXML takes attributes without quotes and prefixes that nobody declared; quotes the former and replaces the
/// colon of the latter. None if nothing was wrong. An error if a tag is too long.
fn mend_tags(text: &[u8]) -> std::result::Result<Option<Vec<u8>>, String> {
    let mut edits: Vec<(usize, u8)> = Vec::new();
    let mut declared: Vec<(&[u8], bool)> = Vec::new();
    let mut known = |prefix| {
        let prefix: &[u8] = prefix;
        if let Some((_, known)) = declared.iter().find(|(p, _)| *p == prefix) {
            return *known;
        }
        // Each costs a search; nobody has more of them.
        if declared.len() >= MAX_PREFIXES {
            return true;
        }
        let declaration = [b"xmlns:", prefix].concat();
        let found = matches!(prefix, b"xml" | b"xmlns") || find(text, &declaration, 0).is_some();
        declared.push((prefix, found));
        found
    };
    let mut at = 0;
    while let Some(open) = find(text, b"<", at) {
        let end = match text.get(open + 1) {
            Some(b'!') if text[open..].starts_with(b"<![CDATA[") => find(text, b"]]>", open),
            Some(b'!' | b'?') => find(text, b">", open),
            Some(_) => mend_tag(text, open + 1, &mut known, &mut edits)?,
            None => None,
        };
        // A tag without an end is left for the parser to complain about.
        let Some(end) = end else { break };
        at = end;
    }
    if edits.is_empty() {
        return Ok(None);
    }
    let mut mended = Vec::with_capacity(text.len() + edits.len());
    let mut done = 0;
    for (at, byte) in edits {
        mended.extend_from_slice(&text[done..at]);
        mended.push(byte);
        // A quote is put in, an underscore takes the colon's place.
        done = at + usize::from(byte == b'_');
    }
    mended.extend_from_slice(&text[done..]);
    Ok(Some(mended))
}

/// The end of the tag whose name starts at `start`.
fn mend_tag<'t>(
    text: &'t [u8],
    start: usize,
    known: &mut impl FnMut(&'t [u8]) -> bool,
    edits: &mut Vec<(usize, u8)>,
) -> std::result::Result<Option<usize>, String> {
    let mut at = start + usize::from(text[start] == b'/');
    let mut word = at;
    let mut attributes = 0;
    while let Some(byte) = text.get(at) {
        if at - start > MAX_TAG_BYTES {
            let message = format!("a tag at byte {start} is longer than {MAX_TAG_BYTES} bytes");
            return Err(message);
        }
        match byte {
            b'>' => return Ok(Some(at)),
            b':' if !known(&text[word..at]) => edits.push((at, b'_')),
            b' ' | b'\t' | b'\r' | b'\n' => word = at + 1,
            b'=' => {
                attributes += 1;
                if attributes > MAX_ATTRIBUTES {
                    let message =
                        format!("a tag at byte {start} has more than {MAX_ATTRIBUTES} attributes");
                    return Err(message);
                }
                at += 1;
                while text.get(at).is_some_and(u8::is_ascii_whitespace) {
                    at += 1;
                }
                let Some(quote) = text.get(at) else {
                    return Ok(None);
                };
                let ends = |b: &u8| match quote {
                    b'"' | b'\'' => b == quote,
                    _ => b.is_ascii_whitespace() || *b == b'>',
                };
                let quoted = matches!(quote, b'"' | b'\'');
                let value = at + usize::from(quoted);
                let rest = &text[value..text.len().min(value + MAX_TAG_BYTES)];
                let Some(length) = rest.iter().position(ends) else {
                    return Ok(None);
                };
                if !quoted {
                    // The slash of an empty element is no part of the value.
                    let slash = length > 0 && rest[length - 1] == b'/' && rest[length] == b'>';
                    edits.push((value, b'"'));
                    edits.push((value + length - usize::from(slash), b'"'));
                }
                at = value + length + usize::from(quoted);
                word = at;
                continue;
            }
            _ => {}
        }
        at += 1;
    }
    Ok(None)
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

/// The trimmed text of an element, empty if it has none. Comments were blanked, so it is one piece.
pub(super) fn content<'a>(node: Node<'a, '_>) -> &'a str {
    node.text().unwrap_or("").trim()
}

/// The line of an element in its file, for messages. Looks at all text before it.
pub(super) fn line(node: Node) -> usize {
    let text = node.document().input_text().as_bytes();
    let before = &text[..node.range().start.min(text.len())];
    1 + before.iter().filter(|byte| **byte == b'\n').count()
}

/// All numbers of a blank-separated text; the first that is none is returned as the error.
pub(super) fn numbers<T: std::str::FromStr>(text: &str) -> std::result::Result<Vec<T>, &str> {
    text.split_ascii_whitespace()
        .map(|word| word.parse().map_err(|_| word))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn xml(text: &str) -> Result<Xml> {
        Xml::new(Path::new("a.sdf"), text.as_bytes().to_vec())
    }

    /// The name and attributes of the root element after mending.
    fn root(text: &str) -> (String, Vec<(String, String)>) {
        let xml = xml(text).unwrap();
        let document = xml.parse(Path::new("a.sdf")).unwrap();
        let root = document.root_element();
        let attributes = root
            .attributes()
            .map(|a| (a.name().to_owned(), a.value().to_owned()));
        (root.tag_name().name().to_owned(), attributes.collect())
    }

    #[test]
    fn what_others_accept_is_mended() {
        let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
        let name = vec![pair("name", "x")];
        for text in [
            "<a name='x'/>",
            "<a name=x/>",
            "<a name = x></a>",
            "\n <?xml version=\"1.0\"?><a name='x'/>",
            "\u{feff}<?xml version=\"1.0\"?><a name='x'/>",
            "<!-- late --><?xml version=\"1.0\" ?>\n<a name='x'/>",
            "<a name='x'><!-- -- <b> <!-- --></a>",
        ] {
            assert_eq!(root(text), ("a".to_owned(), name.clone()), "{text}");
        }
        let value = root("<a b:c='1>2' d=3 e=\"f:g h=i\"/>").1;
        let expected = [pair("b_c", "1>2"), pair("d", "3"), pair("e", "f:g h=i")];
        assert_eq!(value, expected);
        assert_eq!(root("<g:a><b:c></b:c></g:a>").0, "g_a");
        assert_eq!(root("<g:a xmlns:g='u'/>").0, "a");
        assert!(xml("<a name='x'/>").unwrap().mended.is_empty());
    }

    #[test]
    fn errors_name_the_line_of_the_file() {
        let xml = xml("<!-- one\n two -->\n<?xml version='1.0'?>\n<a>\n</b>").unwrap();
        let error = xml.parse(Path::new("a.sdf")).unwrap_err().to_string();
        assert!(error.contains("5:1"), "{error}");
    }

    #[test]
    fn endless_things_end() {
        for text in [
            "",
            "<",
            "<!",
            "<!--",
            "<![CDATA[<",
            "<a",
            "<a b=",
            "<a b='",
            "<a b=c",
            "</",
            "<?xml ",
        ] {
            let result = xml(text).and_then(|xml| xml.parse(Path::new("a")).map(|_| ()));
            assert!(result.is_err(), "{text}");
        }
        let long = format!("<a {}/>", " ".repeat(MAX_TAG_BYTES));
        assert!(xml(&long).is_err());
        let many: String = (0..=MAX_ATTRIBUTES).map(|i| format!("a{i}=''")).collect();
        assert!(xml(&format!("<a {many}/>")).is_err());
        // Linear in the number of prefixes: minutes otherwise.
        let prefixes: String = (0..300_000).map(|i| format!("<p{i}:a/>")).collect();
        assert!(xml(&prefixes).is_ok());
        let entities = "<!DOCTYPE a [<!ENTITY x 'y'>]><a>&x;</a>";
        assert!(xml(entities).unwrap().parse(Path::new("a")).is_err());
    }
}
