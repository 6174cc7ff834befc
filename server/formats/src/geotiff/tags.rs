//! A TIFF file of one image: header, strips, tags and their values, little-endian.

use super::size;
use crate::FormatError;

/// Types of tags' values.
const ASCII: u16 = 2;
const SHORT: u16 = 3;
const LONG: u16 = 4;
const DOUBLE: u16 = 12;

/// Bytes before the first strip.
const HEADER_BYTES: usize = 8;

/// Tags, to be added in ascending order.
#[derive(Debug, Default)]
pub(super) struct Tags(Vec<Tag>);

#[derive(Debug)]
struct Tag {
    number: u16,
    kind: u16,
    count: usize,
    /// None: where the strips begin, which is known at the end.
    value: Option<Vec<u8>>,
}

impl Tags {
    pub(super) fn shorts(&mut self, number: u16, values: &[u16]) {
        self.add(number, SHORT, values.len(), values.iter().flat_map(|v| v.to_le_bytes()).collect());
    }

    pub(super) fn longs(&mut self, number: u16, values: &[u32]) {
        self.add(number, LONG, values.len(), values.iter().flat_map(|v| v.to_le_bytes()).collect());
    }

    pub(super) fn doubles(&mut self, number: u16, values: &[f64]) {
        self.add(number, DOUBLE, values.len(), values.iter().flat_map(|v| v.to_le_bytes()).collect());
    }

    /// ASCII, ended by a zero.
    pub(super) fn text(&mut self, number: u16, text: &str) {
        self.add(number, ASCII, text.len() + 1, [text.as_bytes(), &[0]].concat());
    }

    /// The tag of where the strips begin.
    pub(super) fn strips(&mut self, number: u16) {
        self.0.push(Tag { number, kind: LONG, count: 0, value: None });
    }

    fn add(&mut self, number: u16, kind: u16, count: usize, value: Vec<u8>) {
        self.0.push(Tag { number, kind, count, value: Some(value) });
    }

    /// The file with these strips.
    pub(super) fn file(mut self, strips: &[Vec<u8>]) -> Result<Vec<u8>, FormatError> {
        let strip_bytes: usize = strips.iter().map(Vec::len).sum();
        // Places of tags and values are even.
        let directory = (HEADER_BYTES + strip_bytes).next_multiple_of(2);
        let values = directory + 2 + 12 * self.0.len() + 4;
        self.place_strips(strips)?;
        let mut out = Vec::with_capacity(values);
        out.extend(b"II");
        out.extend(42u16.to_le_bytes());
        out.extend(size(directory)?.to_le_bytes());
        strips.iter().for_each(|strip| out.extend(strip));
        out.resize(directory, 0);
        out.extend((self.0.len() as u16).to_le_bytes());
        let mut behind = vec![];
        for tag in &self.0 {
            let value = tag.value.as_deref().unwrap_or_default();
            out.extend(tag.number.to_le_bytes());
            out.extend(tag.kind.to_le_bytes());
            out.extend(size(tag.count)?.to_le_bytes());
            if value.len() <= 4 {
                let mut inline = [0; 4];
                inline[..value.len()].copy_from_slice(value);
                out.extend(inline);
            } else {
                out.extend(size(values + behind.len())?.to_le_bytes());
                behind.extend(value);
                behind.resize(behind.len().next_multiple_of(2), 0);
            }
        }
        // No further image.
        out.extend([0; 4]);
        out.extend(behind);
        size(out.len())?;
        Ok(out)
    }

    /// Puts in where each strip begins.
    fn place_strips(&mut self, strips: &[Vec<u8>]) -> Result<(), FormatError> {
        let mut place = HEADER_BYTES;
        let mut value = Vec::with_capacity(4 * strips.len());
        for strip in strips {
            value.extend(size(place)?.to_le_bytes());
            place += strip.len();
        }
        for tag in self.0.iter_mut().filter(|tag| tag.value.is_none()) {
            tag.count = strips.len();
            tag.value = Some(std::mem::take(&mut value));
        }
        Ok(())
    }
}
