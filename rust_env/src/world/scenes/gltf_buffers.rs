//! The bytes behind a glTF file: the GLB's chunk, data URIs, and files beside the asset, never outside its folder.
use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};
use std::rc::Rc;

use gltf::json;

use super::{disk, MAX_FILE_BYTES};

type Reading<T> = std::result::Result<T, String>;

pub(super) struct Buffers<'a> {
    path: &'a Path,
    root: &'a json::Root,
    /// The binary chunk of a GLB.
    chunk: Option<&'a [u8]>,
    read: HashMap<usize, Rc<[u8]>>,
    bytes: u64,
}

/// Equally wide elements in a buffer.
pub(super) struct Slice {
    buffer: Rc<[u8]>,
    start: usize,
    stride: usize,
    width: usize,
    count: usize,
}

impl Slice {
    pub fn iter(&self) -> impl Iterator<Item = &[u8]> {
        (0..self.count).map(|i| {
            let at = self.start + i * self.stride;
            &self.buffer[at..at + self.width]
        })
    }
}

impl<'a> Buffers<'a> {
    pub fn new(path: &'a Path, root: &'a json::Root, chunk: Option<&'a [u8]>) -> Self {
        Self {
            path,
            root,
            chunk,
            read: HashMap::new(),
            bytes: 0,
        }
    }

    /// `count` elements of `width` bytes from `offset` in a buffer view; all of them lie inside the view, and the
    /// view inside its buffer.
    pub fn slice(
        &mut self,
        view: usize,
        offset: u64,
        width: usize,
        count: usize,
    ) -> Reading<Slice> {
        let index = view;
        let view = self
            .root
            .buffer_views
            .get(index)
            .ok_or_else(|| format!("no bufferView {index}"))?;
        let stride = view.byte_stride.as_ref().map_or(width, |stride| stride.0);
        if stride < width {
            return Err(format!(
                "bufferView {index}: stride {stride} for elements of {width} bytes"
            ));
        }
        let wide = |n: usize| n as u128;
        let end = match count {
            0 => u128::from(offset),
            _ => u128::from(offset) + wide(count - 1) * wide(stride) + wide(width),
        };
        let length = u128::from(view.byte_length.0);
        if end > length {
            return Err(format!(
                "needs {end} bytes of bufferView {index}, which has {length}"
            ));
        }
        let buffer = self.buffer(view.buffer.value())?;
        let start = view.byte_offset.map_or(0, |o| o.0);
        if u128::from(start) + length > wide(buffer.len()) {
            let held = buffer.len();
            return Err(format!(
                "bufferView {index} reaches beyond its buffer of {held} bytes"
            ));
        }
        Ok(Slice {
            buffer,
            // Fits: no larger than the buffer.
            start: (start + offset) as usize,
            stride,
            width,
            count,
        })
    }

    fn buffer(&mut self, index: usize) -> Reading<Rc<[u8]>> {
        if let Some(buffer) = self.read.get(&index) {
            return Ok(buffer.clone());
        }
        let buffer = self
            .root
            .buffers
            .get(index)
            .ok_or_else(|| format!("no buffer {index}"))?;
        let length = buffer.byte_length.0;
        let mut bytes: Rc<[u8]> = match (&buffer.uri, self.chunk) {
            (Some(uri), _) => self
                .uri(uri)
                .map_err(|m| format!("buffer {index}: {m}"))?
                .into(),
            (None, Some(chunk)) if index == 0 => chunk.into(),
            (None, _) => return Err(format!("buffer {index}: no URI (is the mesh compressed?)")),
        };
        self.bytes += bytes.len() as u64;
        if self.bytes > 2 * MAX_FILE_BYTES {
            return Err(format!(
                "buffer {index}: more than {} bytes in all",
                2 * MAX_FILE_BYTES
            ));
        }
        if (bytes.len() as u64) < length {
            let held = bytes.len();
            return Err(format!(
                "buffer {index}: {length} bytes are declared, {held} are there"
            ));
        }
        if bytes.len() as u64 > length {
            bytes = bytes[..length as usize].into();
        }
        self.read.insert(index, bytes.clone());
        Ok(bytes)
    }

    fn uri(&self, uri: &str) -> Reading<Vec<u8>> {
        if let Some(data) = uri.strip_prefix("data:") {
            let (kind, data) = data.split_once(',').ok_or("a data URI without data")?;
            if !kind.ends_with(";base64") {
                return Err("a data URI that is not base64".to_owned());
            }
            return base64(data.as_bytes()).ok_or_else(|| "not valid base64".to_owned());
        }
        let path = self.beside(uri)?;
        disk::bytes(&path).map_err(|e| e.to_string())
    }

    /// A file in the folder of the asset or below, links followed.
    fn beside(&self, uri: &str) -> Reading<PathBuf> {
        let refused =
            || format!("'{uri}' is refused: only files in the folder of the asset are read");
        let name = percent_decoded(uri).ok_or_else(|| format!("'{uri}' is no valid URI"))?;
        let relative = Path::new(&name);
        let plain = |c: Component| matches!(c, Component::Normal(_) | Component::CurDir);
        if name.contains([':', '\\', '\0']) || !relative.components().all(plain) {
            return Err(refused());
        }
        let folder = match self.path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        let not_there = |path: &Path, e: std::io::Error| format!("{}: {e}", path.display());
        let path = folder.join(relative);
        let real = disk::target(&path).map_err(|e| not_there(&path, e))?;
        let folder = disk::target(folder).map_err(|e| not_there(folder, e))?;
        if real.starts_with(folder) {
            Ok(real)
        } else {
            Err(refused())
        }
    }
}

fn percent_decoded(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        if byte == b'%' {
            let mut digit = || (rest.next()? as char).to_digit(16);
            bytes.push((digit()? * 16 + digit()?) as u8);
        } else {
            bytes.push(byte);
        }
    }
    String::from_utf8(bytes).ok()
}

fn base64(text: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3);
    let (mut held, mut bits) = (0u32, 0);
    for byte in text.iter().take_while(|b| **b != b'=') {
        let value = match byte {
            b'A'..=b'Z' => byte - b'A',
            b'a'..=b'z' => byte - b'a' + 26,
            b'0'..=b'9' => byte - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            b'\r' | b'\n' | b' ' => continue,
            _ => return None,
        };
        held = (held << 6 | u32::from(value)) & 0xFFFF;
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            bytes.push((held >> bits) as u8);
        }
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_and_percent_codes() {
        assert_eq!(base64(b"bmJ2LWd5bQ==").unwrap(), b"nbv-gym");
        assert_eq!(base64(b"bmJ2LWd5\nbSE").unwrap(), b"nbv-gym!");
        assert_eq!(base64(b"").unwrap(), b"");
        assert!(base64(b"bm*2").is_none());
        assert_eq!(percent_decoded("a%20b%2Ec").unwrap(), "a b.c");
        // The crate panics on this one.
        assert!(percent_decoded("%FF").is_none());
        assert!(percent_decoded("%2").is_none());
    }
}
