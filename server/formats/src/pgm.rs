//! PGM: grey images of 8 or 16 bits, binary (P5) or plain (P2).
//!
//! Source: Netpbm's `pgm` manual page. 16-bit samples are most significant byte first.

use crate::{FormatError, Limits, Place};
use std::io::Write;

const FORMAT: &str = "PGM";

/// A grey image as a PGM file holds it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pgm {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The value of white, 1..=65535; above 255 samples take two bytes.
    pub max_value: u16,
    /// `H x W` samples, row-major, first row on top.
    pub data: Vec<u16>,
}

/// An image from the bytes of a PGM file; what follows the declared samples is not looked at.
///
/// # Errors
/// `Malformed`, `Truncated`, `TooLarge`.
pub fn decode(bytes: &[u8], limits: &Limits) -> Result<Pgm, FormatError> {
    let (mut header, plain, width, height) = begin(bytes)?;
    let start = header.at as u64;
    let max_value = header.number("maxval")?;
    let Some(max_value) = u16::try_from(max_value).ok().filter(|&m| m > 0) else {
        let found = max_value.to_string();
        return Err(FormatError::malformed(FORMAT, Place::Byte(start), "maxval", found.as_bytes(), "1..=65535"));
    };
    let n = limits.pixels(width, height)?;
    let (width, height) = (width as usize, height as usize);
    let sample_size: usize = if max_value > 255 { 2 } else { 1 };
    let available = bytes.len().saturating_sub(header.at + 1);
    let needed = n.saturating_mul(if plain { 2 } else { sample_size }).saturating_sub(usize::from(plain));
    if needed > available {
        let (needed, available) = (needed as u64, available as u64);
        return Err(FormatError::Truncated { format: FORMAT, field: "samples", needed, available });
    }
    let mut data = Vec::with_capacity(n);
    if plain {
        for _ in 0..n {
            data.push(header.number("sample")?.min(u64::from(max_value)) as u16);
        }
    } else {
        // One whitespace byte parts the header from the samples.
        let body = bytes.get(header.at + 1..).unwrap_or_default();
        match sample_size {
            1 => data.extend(body[..n].iter().map(|&b| u16::from(b))),
            _ => data.extend(body[..2 * n].as_chunks::<2>().0.iter().map(|&b| u16::from_be_bytes(b))),
        }
    }
    Ok(Pgm { width, height, max_value, data })
}

/// Columns and rows that a PGM file declares.
///
/// # Errors
/// `Malformed` if it does not begin as a PGM does.
pub fn size(bytes: &[u8]) -> Result<(usize, usize), FormatError> {
    let (_, _, width, height) = begin(bytes)?;
    let side = |v: u64| usize::try_from(v).unwrap_or(usize::MAX);
    Ok((side(width), side(height)))
}

/// The header after its size, whether samples are plain text, columns and rows.
fn begin(bytes: &[u8]) -> Result<(Header<'_>, bool, u64, u64), FormatError> {
    let plain = match bytes.get(..2) {
        Some(b"P5") => false,
        Some(b"P2") => true,
        other => {
            return Err(FormatError::malformed(FORMAT, Place::Byte(0), "magic", other.unwrap_or(bytes), "P5 or P2"));
        }
    };
    let mut header = Header { bytes, at: 2 };
    let (width, height) = (header.number("width")?, header.number("height")?);
    Ok((header, plain, width, height))
}

struct Header<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Header<'_> {
    /// The next decimal number, after whitespace and comments.
    fn number(&mut self, field: &str) -> Result<u64, FormatError> {
        while let Some(&b) = self.bytes.get(self.at) {
            match b {
                b'#' => {
                    let rest = &self.bytes[self.at..];
                    self.at += rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
                }
                b if b.is_ascii_whitespace() => self.at += 1,
                _ => break,
            }
        }
        let rest = &self.bytes[self.at..];
        let token = &rest[..rest.iter().position(|b| !b.is_ascii_digit()).unwrap_or(rest.len())];
        let place = Place::Byte(self.at as u64);
        self.at += token.len();
        let found = if token.is_empty() { &rest[..rest.len().min(1)] } else { token };
        crate::text::parse(token).ok_or_else(|| FormatError::malformed(FORMAT, place, field, found, "a decimal number"))
    }
}

/// Writes a binary PGM file (P5).
///
/// # Errors
/// `Geometry` if `data` does not hold `width * height` samples; `Malformed` if `max_value` is 0 or a sample
/// exceeds it; `Write` if the writer refuses.
pub fn write(out: &mut impl Write, image: &Pgm) -> Result<(), FormatError> {
    let expected = image.width.saturating_mul(image.height);
    if image.data.len() != expected {
        let actual = image.data.len();
        return Err(percept_geometry::GeometryError::ShapeMismatch { field: "data", expected, actual }.into());
    }
    let largest = image.data.iter().copied().max().unwrap_or(0);
    if image.max_value == 0 || largest > image.max_value {
        let found = image.max_value.to_string();
        let expected = "at least 1 and at least the largest sample";
        return Err(FormatError::malformed(FORMAT, Place::Byte(0), "max_value", found.as_bytes(), expected));
    }
    write!(out, "P5\n{} {}\n{}\n", image.width, image.height, image.max_value)?;
    let samples: Vec<u8> = if image.max_value > 255 {
        image.data.iter().flat_map(|v| v.to_be_bytes()).collect()
    } else {
        image.data.iter().map(|&v| v as u8).collect()
    };
    out.write_all(&samples)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn image(width: usize, height: usize, max_value: u16) -> Pgm {
        let data = (0..width * height).map(|i| (i * 7919 % (usize::from(max_value) + 1)) as u16).collect();
        Pgm { width, height, max_value, data }
    }

    #[test]
    fn images_of_both_depths_read_back_and_cut_ones_do_not() {
        for max_value in [1, 255, 256, 65535] {
            let image = image(5, 3, max_value);
            let mut bytes = vec![];
            write(&mut bytes, &image).unwrap();
            assert_eq!(decode(&bytes, &Limits::default()).unwrap(), image);
            for end in 0..bytes.len() {
                assert!(decode(&bytes[..end], &Limits::default()).is_err(), "{max_value} cut at {end}");
            }
        }
    }

    #[test]
    fn plain_images_and_comments() {
        let image = decode(b"P2 # grey\n2\n#rows\n2 15\n0 5\n 10 15", &Limits::default()).unwrap();
        assert_eq!(image, Pgm { width: 2, height: 2, max_value: 15, data: vec![0, 5, 10, 15] });
    }

    #[test]
    fn lying_sizes_take_no_memory() {
        let limits = Limits::default();
        let error = decode(b"P5 18446744073709551615 18446744073709551615 255 x", &limits).unwrap_err();
        assert!(matches!(error, FormatError::TooLarge { field: "num_pixels", .. }));
        assert!(matches!(decode(b"P5 7000 7000 255 x", &limits), Err(FormatError::Truncated { .. })));
        assert!(matches!(decode(b"P5 1 1 65536 x", &limits), Err(FormatError::Malformed { .. })));
        assert!(matches!(decode(b"P6 1 1 255 x", &limits), Err(FormatError::Malformed { .. })));
    }

    proptest! {
        #[test]
        fn damaged_bytes_never_panic(hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
            let mut bytes = vec![];
            write(&mut bytes, &image(4, 3, 300)).unwrap();
            for (at, value) in hits {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            let _ = decode(&bytes, &Limits::default());
        }
    }
}
