//! LAZ: what the library is given, checked first, so that nothing in a file makes it take memory or panic.

use super::FORMAT;
use super::header::{Header, at};
use crate::{FormatError, Place};
use laz::laszip::CompressorType;
use laz::{LasZipDecompressor, LazItemRecordBuilder, LazItemType, LazVlr};
use std::io::{Read, Seek, SeekFrom};

const VLR_HEADER_BYTES: usize = 54;

/// Bytes that cannot be sought in: then the library reads chunk after chunk, and leaves the table of chunks alone.
struct Forward<'a>(&'a [u8]);

impl Read for Forward<'_> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        self.0.read(out)
    }
}

impl Seek for Forward<'_> {
    fn seek(&mut self, _: SeekFrom) -> std::io::Result<u64> {
        Err(std::io::ErrorKind::Unsupported.into())
    }
}

fn broken(header: &Header, expected: &'static str) -> FormatError {
    FormatError::malformed(FORMAT, Place::Byte(header.points_at as u64), "packed points", b"", expected)
}

fn library(error: impl std::fmt::Display) -> FormatError {
    FormatError::Image { format: "LAZ", reason: error.to_string() }
}

/// Hands each unpacked record to `record`.
pub(super) fn records(bytes: &[u8], header: &Header, record: impl FnMut(&[u8])) -> Result<(), FormatError> {
    if header.num_points == 0 {
        return Ok(());
    }
    let vlr = laszip_record(bytes, header)?;
    check_items(&vlr, header)?;
    let body = &bytes[header.points_at..];
    if vlr_compressor(bytes, header)? == CompressorType::LayeredChunked as u16 {
        check_layers(body, &vlr, header)?;
    }
    // The library asserts what a sound encoder promises: its panics are the file's errors.
    let unpack = std::panic::AssertUnwindSafe(|| unpack(body, vlr, header, record));
    std::panic::catch_unwind(unpack).unwrap_or_else(|_| Err(broken(header, "what LASzip can have written")))
}

fn unpack(body: &[u8], vlr: LazVlr, header: &Header, mut record: impl FnMut(&[u8])) -> Result<(), FormatError> {
    let mut points = LasZipDecompressor::new(Forward(body), vlr).map_err(library)?;
    let mut out = vec![0; header.record_bytes];
    for done in 0..header.num_points {
        points.decompress_one(&mut out).map_err(|e| match e.kind() {
            std::io::ErrorKind::UnexpectedEof => FormatError::Truncated {
                format: FORMAT,
                field: "packed points",
                needed: body.len() as u64 + (header.num_points - done).div_ceil(8),
                available: body.len() as u64,
            },
            _ => library(e),
        })?;
        record(&out);
    }
    Ok(())
}

/// Where the content of LASzip's own record begins and ends.
fn laszip_place(bytes: &[u8], header: &Header) -> Result<(usize, usize), FormatError> {
    let mut place = header.header_bytes;
    for _ in 0..header.num_vlrs {
        let content = place + VLR_HEADER_BYTES;
        if content > header.points_at {
            break;
        }
        let end = content + usize::from(u16::from_le_bytes(at(bytes, place + 20)));
        if end > header.points_at {
            break;
        }
        let id = u16::from_le_bytes(at(bytes, place + 18));
        if id == LazVlr::RECORD_ID && bytes[place + 2..].starts_with(LazVlr::USER_ID.as_bytes()) {
            return Ok((content, end));
        }
        place = end;
    }
    Err(FormatError::Missing { format: FORMAT, field: "record 'laszip encoded'" })
}

fn laszip_record(bytes: &[u8], header: &Header) -> Result<LazVlr, FormatError> {
    let (start, end) = laszip_place(bytes, header)?;
    LazVlr::read_from(&bytes[start..end]).map_err(library)
}

/// The kind of packing: the first number of LASzip's record.
fn vlr_compressor(bytes: &[u8], header: &Header) -> Result<u16, FormatError> {
    let (start, end) = laszip_place(bytes, header)?;
    if end - start < 2 {
        return Err(FormatError::Missing { format: FORMAT, field: "compressor" });
    }
    Ok(u16::from_le_bytes(at(bytes, start)))
}

/// The items must be those of the point format, and of one generation.
fn check_items(vlr: &LazVlr, header: &Header) -> Result<(), FormatError> {
    let extra = header.record_bytes - super::header::RECORD_BYTES[usize::from(header.point_format)];
    let expected = u16::try_from(extra).map_err(library)?;
    let expected = LazItemRecordBuilder::default_for_point_format_id(header.point_format, expected).map_err(library)?;
    let kinds = |items: &[laz::LazItem]| items.iter().map(|i| (i.item_type(), i.size())).collect::<Vec<_>>();
    let items = vlr.items();
    if kinds(items) != kinds(&expected) || items.iter().any(|i| i.version() != items[0].version()) {
        return Err(broken(header, "the items of the point format"));
    }
    Ok(())
}

/// Every layer of every chunk must lie within the file: the library takes memory by what a chunk declares.
fn check_layers(body: &[u8], vlr: &LazVlr, header: &Header) -> Result<(), FormatError> {
    let layers = |kind: LazItemType| match kind {
        LazItemType::Point14 => 9,
        LazItemType::RGB14 | LazItemType::WavePacket14 => 1,
        LazItemType::RGBNIR14 => 2,
        LazItemType::Byte14(n) => usize::from(n),
        _ => 0,
    };
    let num_layers: usize = vlr.items().iter().map(|i| layers(i.item_type())).sum();
    let head_bytes = header.record_bytes + 4 + 4 * num_layers;
    let mut place = 8usize;
    let mut left = header.num_points;
    while left > 0 {
        let cut = |needed: usize| FormatError::Truncated {
            format: FORMAT,
            field: "chunk of packed points",
            needed: needed as u64,
            available: body.len() as u64,
        };
        let head = body.get(place..place + head_bytes).ok_or_else(|| cut(place + head_bytes))?;
        let count = u64::from(u32::from_le_bytes(at(head, header.record_bytes)));
        let sizes = head[header.record_bytes + 4..].as_chunks::<4>().0;
        let sum = sizes.iter().fold(0usize, |sum, &s| sum.saturating_add(u32::from_le_bytes(s) as usize));
        place = place.saturating_add(head_bytes).saturating_add(sum);
        if place > body.len() {
            return Err(cut(place));
        }
        let chunk = if vlr.uses_variable_size_chunks() { count } else { u64::from(vlr.chunk_size()) };
        if chunk == 0 {
            return Err(broken(header, "chunks of one point or more"));
        }
        left = left.saturating_sub(chunk);
    }
    Ok(())
}
