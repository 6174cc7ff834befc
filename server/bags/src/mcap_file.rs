//! MCAP's records. Source: the MCAP format specification, version 0 (mcap.dev/spec).

use crate::block::Compression;
use crate::walk::{Container, Fields, Frame, Record, nanos};
use std::collections::BTreeMap;

pub(crate) struct Mcap;

const SCHEMA: u8 = 3;
const CHANNEL: u8 = 4;
const MESSAGE: u8 = 5;
const CHUNK: u8 = 6;
const METADATA: u8 = 12;
const DATA_END: u8 = 15;
const FOOTER: u8 = 2;
/// Opcode and length.
const FRAMING: usize = 9;

impl Container for Mcap {
    const MAGIC: &'static [u8] = b"\x89MCAP0\r\n";
    const HAS_END: bool = true;

    fn frame(head: &[u8]) -> Option<Frame> {
        let mut fields = Fields(head);
        let [opcode] = *fields.take(1)? else { return None };
        let num_bytes = fields.u64()?.saturating_add(FRAMING as u64);
        Some(Frame { num_bytes, is_chunk: opcode == CHUNK })
    }

    fn parse(record: &[u8]) -> Result<Record<'_>, &'static str> {
        let [opcode, ..] = *record else { return Err("an empty record") };
        let mut fields = Fields(record.get(FRAMING..).unwrap_or_default());
        let parsed = match opcode {
            SCHEMA => schema(&mut fields),
            CHANNEL => channel(&mut fields),
            MESSAGE => message(&mut fields),
            CHUNK => chunk(record.len(), &mut fields),
            METADATA => metadata(&mut fields),
            DATA_END | FOOTER => Some(Record::End),
            _ => Some(Record::Other),
        };
        parsed.ok_or("a record is shorter than its fields")
    }
}

fn schema<'a>(fields: &mut Fields<'a>) -> Option<Record<'a>> {
    Some(Record::Schema { id: fields.u16()?.into(), type_name: fields.text()? })
}

fn channel<'a>(fields: &mut Fields<'a>) -> Option<Record<'a>> {
    let (id, schema) = (fields.u16()?.into(), fields.u16()?.into());
    Some(Record::Channel { id, schema, topic: fields.text()?, type_name: None, encoding: fields.text()? })
}

fn metadata<'a>(fields: &mut Fields<'a>) -> Option<Record<'a>> {
    let name = fields.text()?;
    let (mut map, mut entries) = (Fields(fields.bytes()?), BTreeMap::new());
    while !map.0.is_empty() {
        entries.insert(map.text()?, map.text()?);
    }
    Some(Record::Metadata { name, entries })
}

fn message<'a>(fields: &mut Fields<'a>) -> Option<Record<'a>> {
    let channel = fields.u16()?.into();
    let _sequence = fields.u32()?;
    let (log_time, publish_time) = (nanos(fields.u64()?), nanos(fields.u64()?));
    Some(Record::Message { channel, log_time, publish_time, bytes: fields.0 })
}

fn chunk<'a>(record_bytes: usize, fields: &mut Fields<'a>) -> Option<Record<'a>> {
    // First and last log time, unpacked size, check sum.
    fields.take(8 + 8 + 8 + 4)?;
    let name = fields.bytes()?;
    let compression = Compression::named(name).ok_or_else(|| String::from_utf8_lossy(name).into_owned());
    let num_bytes = fields.u64()?;
    Some(Record::Chunk { offset: record_bytes - fields.0.len(), num_bytes, compression })
}
