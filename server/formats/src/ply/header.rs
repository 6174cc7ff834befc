//! The header: elements and their properties in the order of the body.

use super::FORMAT;
use crate::FormatError;
use crate::scalar::Scalar;
use crate::text::{Line, Lines};

/// How the body is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Decimal numbers, an element a line.
    Ascii,
    /// Least significant byte first.
    BinaryLittleEndian,
    /// Most significant byte first.
    BinaryBigEndian,
}

fn scalar_named(name: &[u8]) -> Option<Scalar> {
    Some(match name {
        b"char" | b"int8" => Scalar::I8,
        b"uchar" | b"uint8" => Scalar::U8,
        b"short" | b"int16" => Scalar::I16,
        b"ushort" | b"uint16" => Scalar::U16,
        b"int" | b"int32" => Scalar::I32,
        b"uint" | b"uint32" => Scalar::U32,
        b"float" | b"float32" => Scalar::F32,
        b"double" | b"float64" => Scalar::F64,
        _ => return None,
    })
}

/// One property of an element.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Property {
    pub(super) name: String,
    /// The type of the value, or of the items of a list.
    pub(super) scalar: Scalar,
    /// The type of a list's length, if it is a list.
    pub(super) list_length: Option<Scalar>,
}

/// `count` elements in a row.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// Bytes of one element; none if it holds lists.
    pub(super) fn stride(&self) -> Option<usize> {
        self.properties.iter().map(|p| p.list_length.is_none().then(|| p.scalar.size())).sum()
    }
}

/// What the header says, and where the body begins.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    pub(super) body_offset: usize,
    pub(super) num_lines: u64,
}

pub(super) fn parse(bytes: &[u8]) -> Result<Header, FormatError> {
    let mut lines = Lines::new(FORMAT, bytes);
    match lines.next() {
        Some(line) if line.bytes.trim_ascii() == b"ply" => {}
        other => {
            let found = other.map_or(b"".as_slice(), |l| l.bytes);
            return Err(FormatError::malformed(FORMAT, crate::Place::Byte(0), "magic", found, "'ply'"));
        }
    }
    let mut encoding = None;
    let mut elements: Vec<Element> = vec![];
    while let Some(line) = lines.next() {
        let mut fields = line.fields();
        match fields.token() {
            Some(b"format") => encoding = Some(parse_encoding(&line, fields.required("format")?)?),
            Some(b"element") => elements.push(Element {
                name: String::from_utf8_lossy(fields.required("element name")?).into_owned(),
                count: fields.number("element count")?,
                properties: vec![],
            }),
            Some(b"property") => {
                let property = parse_property(&line)?;
                let element = elements.last_mut();
                element.ok_or(FormatError::Missing { format: FORMAT, field: "element" })?.properties.push(property);
            }
            Some(b"end_header") if line.ended => {
                let encoding = encoding.ok_or(FormatError::Missing { format: FORMAT, field: "format" })?;
                return Ok(Header { encoding, elements, body_offset: lines.offset(), num_lines: lines.number() });
            }
            None | Some(b"comment" | b"obj_info") => {}
            Some(other) => return Err(line.malformed("header keyword", other, "a PLY keyword")),
        }
    }
    Err(FormatError::Missing { format: FORMAT, field: "end_header" })
}

fn parse_encoding(line: &Line<'_>, name: &[u8]) -> Result<Encoding, FormatError> {
    match name {
        b"ascii" => Ok(Encoding::Ascii),
        b"binary_little_endian" => Ok(Encoding::BinaryLittleEndian),
        b"binary_big_endian" => Ok(Encoding::BinaryBigEndian),
        other => Err(line.malformed("format", other, "ascii, binary_little_endian or binary_big_endian")),
    }
}

fn parse_property(line: &Line<'_>) -> Result<Property, FormatError> {
    let scalar = |token: &[u8]| {
        scalar_named(token).ok_or_else(|| line.malformed("property type", token, "a type such as float or uchar"))
    };
    let mut fields = line.fields();
    fields.token();
    let first = fields.required("property type")?;
    let (list_length, item) = if first == b"list" {
        (Some(scalar(fields.required("list length type")?)?), scalar(fields.required("list item type")?)?)
    } else {
        (None, scalar(first)?)
    };
    let name = String::from_utf8_lossy(fields.required("property name")?).into_owned();
    Ok(Property { name, scalar: item, list_length })
}
