//! ROS 1 bags' records. Source: ROS wiki, "Bags/Format/2.0".

use crate::block::Compression;
use crate::walk::{Container, Fields, Frame, Record};

pub(crate) struct Ros1Bag;

const MESSAGE: u8 = 2;
const CHUNK: u8 = 5;
const CONNECTION: u8 = 7;

/// A record's header and data: each a length and that many bytes. Of a chunk, the data may be missing.
struct Parts<'a> {
    header: &'a [u8],
    data_offset: usize,
    data_bytes: u64,
}

fn parts(record: &[u8]) -> Option<Parts<'_>> {
    let mut fields = Fields(record);
    let header = fields.bytes()?;
    let data_bytes = fields.u32()?.into();
    Some(Parts { header, data_offset: record.len() - fields.0.len(), data_bytes })
}

/// The value of a header's field; fields are a length and `name=value`.
fn value<'a>(header: &'a [u8], name: &str) -> Option<&'a [u8]> {
    let mut fields = Fields(header);
    while let Some(field) = fields.bytes() {
        if let Some(value) = field.strip_prefix(name.as_bytes()).and_then(|rest| rest.strip_prefix(b"=")) {
            return Some(value);
        }
    }
    None
}

fn opcode(header: &[u8]) -> Option<u8> {
    value(header, "op")?.first().copied()
}

fn text(value: &[u8]) -> String {
    String::from_utf8_lossy(value).into_owned()
}

impl Container for Ros1Bag {
    const MAGIC: &'static [u8] = b"#ROSBAG V2.0\n";
    // What follows the last chunk repeats what was in them.
    const HAS_END: bool = false;

    fn frame(head: &[u8]) -> Option<Frame> {
        let Parts { header, data_offset, data_bytes } = parts(head)?;
        let num_bytes = data_bytes.saturating_add(data_offset as u64);
        Some(Frame { num_bytes, is_chunk: opcode(header) == Some(CHUNK) })
    }

    fn parse(record: &[u8]) -> Result<Record<'_>, &'static str> {
        let Parts { header, data_offset, data_bytes } = parts(record).ok_or("a record is shorter than its header")?;
        let data = record.get(data_offset..).unwrap_or_default();
        let parsed = match opcode(header).ok_or("a record without a field `op`")? {
            MESSAGE => message(header, data),
            CONNECTION => connection(header, data),
            CHUNK => value(header, "compression").map(|name| Record::Chunk {
                offset: data_offset,
                num_bytes: data_bytes,
                compression: Compression::named(name).ok_or_else(|| text(name)),
            }),
            _ => Some(Record::Other),
        };
        parsed.ok_or("a record's header lacks a field")
    }
}

fn message<'a>(header: &'a [u8], data: &'a [u8]) -> Option<Record<'a>> {
    let channel = Fields(value(header, "conn")?).u32()?;
    let mut time = Fields(value(header, "time")?);
    let (sec, nsec) = (i64::from(time.u32()?), i64::from(time.u32()?));
    let log_time = sec * 1_000_000_000 + nsec;
    Some(Record::Message { channel, log_time, publish_time: log_time, bytes: data })
}

fn connection<'a>(header: &'a [u8], data: &'a [u8]) -> Option<Record<'a>> {
    let id = Fields(value(header, "conn")?).u32()?;
    let topic = text(value(header, "topic")?);
    let type_name = Some(text(value(data, "type")?));
    Some(Record::Channel { id, schema: 0, topic, type_name, encoding: "ros1".to_owned() })
}
