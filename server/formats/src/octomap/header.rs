//! The lines of text before the nodes.

use super::FORMAT;
use crate::text::Lines;
use crate::{FormatError, Place};

/// What the nodes of a file say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// `.bt`: occupied or free, two bits a child.
    Binary,
    /// `.ot`: log-odds, five bytes a node.
    Full,
}

impl Encoding {
    /// What the first line begins with.
    pub(super) fn magic(self) -> &'static str {
        match self {
            Self::Binary => "# Octomap OcTree binary file",
            Self::Full => "# Octomap OcTree file",
        }
    }
}

/// Which encoding the first line declares; none if it is not OctoMap's.
pub fn encoding(bytes: &[u8]) -> Option<Encoding> {
    [Encoding::Binary, Encoding::Full].into_iter().find(|e| bytes.starts_with(e.magic().as_bytes()))
}

/// What the header says, and where the nodes begin.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    /// Bytes of colour after each node's log-odds.
    pub(super) color_bytes: usize,
    pub(super) num_nodes: u64,
    pub(super) resolution_m: f64,
    pub(super) body_offset: usize,
}

pub(super) fn parse(bytes: &[u8]) -> Result<Header, FormatError> {
    let Some(encoding) = encoding(bytes) else {
        let (found, expected) =
            (&bytes[..bytes.len().min(40)], "'# Octomap OcTree binary file' or '# Octomap OcTree file'");
        return Err(FormatError::malformed(FORMAT, Place::Line(1), "first line", found, expected));
    };
    let (mut id, mut num_nodes, mut resolution_m) = (None, None, None);
    let mut lines = Lines::new(FORMAT, bytes);
    while let Some(line) = lines.next() {
        let mut fields = line.fields();
        // OctoMap reads words, not lines: keys may share one.
        while let Some(key) = fields.token() {
            match key {
                b"id" => id = Some(fields.required("id")?),
                b"size" => num_nodes = Some(fields.number::<u32>("size")?),
                b"res" => {
                    let value = fields.number::<f64>("res")?;
                    if !(value.is_finite() && value > 0.0) {
                        return Err(line.malformed("res", value.to_string().as_bytes(), "metres, positive and finite"));
                    }
                    resolution_m = Some(value);
                }
                b"data" if line.ended => {
                    let missing = |field| FormatError::Missing { format: FORMAT, field };
                    let id = id.ok_or(missing("id"))?;
                    return Ok(Header {
                        encoding,
                        color_bytes: color_bytes(id, encoding)?,
                        num_nodes: u64::from(num_nodes.ok_or(missing("size"))?),
                        resolution_m: resolution_m.ok_or(missing("res"))?,
                        body_offset: lines.offset(),
                    });
                }
                // A comment, or a key of a later version: the rest of the line is its.
                _ => break,
            }
        }
    }
    Err(FormatError::Missing { format: FORMAT, field: "data" })
}

/// Bytes of colour that a kind of tree keeps beside the log-odds. Stamps are not written, whatever the tree.
fn color_bytes(id: &[u8], encoding: Encoding) -> Result<usize, FormatError> {
    match (id, encoding) {
        // '1' is what files before version 1.0 have.
        (b"OcTree" | b"OcTreeStamped" | b"1", _) | (b"ColorOcTree", Encoding::Binary) => Ok(0),
        (b"ColorOcTree", Encoding::Full) => Ok(3),
        _ => {
            let value = String::from_utf8_lossy(&id[..id.len().min(40)]).into_owned();
            let supported = "OcTree, OcTreeStamped and ColorOcTree";
            Err(FormatError::Unsupported { format: FORMAT, field: "id", value, supported })
        }
    }
}
