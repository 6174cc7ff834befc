//! MCAP out, as ROS 2 records it: profile `ros2`, chunks packed by zstd with an index, messages in CDR, a summary at the end.
//!
//! Source: the MCAP format specification, version 0 (mcap.dev/spec). Check sums are left out (0), which it allows.

use crate::BagError;
use percept_geometry::Timestamp;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// A topic that is being written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ChannelId(u16);

const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Unpacked bytes from which on a chunk is written: as rosbag2 has it.
const CHUNK_BYTES: usize = 768 << 10;
const COMPRESSION: &[u8] = b"zstd";
/// Of zstd: who writes does so beside other work. Images with noise (VGA, depth and colour) and clouds are written at 174 MB/s on
/// a core, at zstd's own default of 3 at 65; files are a third larger.
const COMPRESSION_LEVEL: i32 = 1;
/// Under this name rosbag2 keeps what it knows of a file. Where it finds a record of the name with nothing in it, its newer
/// versions read [`LATCHED`] as the older ones (up to Humble) do: as numbers, which they would take for words otherwise.
/// Source: rosbag2's `mcap_storage.cpp` (`read_metadata`) and `qos.cpp`.
const METADATA_NAME: &[u8] = b"rosbag2";
/// Kept for those who listen later: keep last 1, reliable, transient local, liveliness automatic, nothing else demanded.
const LATCHED: &[u8] = b"- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline:
    sec: 0
    nsec: 0
  lifespan:
    sec: 0
    nsec: 0
  liveliness: 1
  liveliness_lease_duration:
    sec: 0
    nsec: 0
  avoid_ros_namespace_conventions: false
";
const HEADER: u8 = 1;
const FOOTER: u8 = 2;
const SCHEMA: u8 = 3;
const CHANNEL: u8 = 4;
const MESSAGE: u8 = 5;
const CHUNK: u8 = 6;
const MESSAGE_INDEX: u8 = 7;
const CHUNK_INDEX: u8 = 8;
const STATISTICS: u8 = 11;
const METADATA: u8 = 12;
const METADATA_INDEX: u8 = 13;
const DATA_END: u8 = 15;

/// A record's content, field by field.
#[derive(Default)]
struct Content(Vec<u8>);

impl Content {
    fn u16(mut self, value: u16) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn u32(mut self, value: u32) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn u64(mut self, value: u64) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    /// Bytes behind their 32-bit length: text, arrays and maps. Nothing here but payloads, which have 64 bits, grows beyond.
    fn bytes(self, bytes: &[u8]) -> Self {
        self.u32(bytes.len() as u32).raw(bytes)
    }

    fn record(&self, opcode: u8) -> Vec<u8> {
        let mut record = vec![opcode];
        record.extend((self.0.len() as u64).to_le_bytes());
        record.extend_from_slice(&self.0);
        record
    }
}

/// First and last log time, ns; none before there is a message.
#[derive(Debug, Clone, Copy, Default)]
struct Span(Option<(u64, u64)>);

impl Span {
    fn add(&mut self, time: u64) {
        let (first, last) = self.0.unwrap_or((time, time));
        self.0 = Some((first.min(time), last.max(time)));
    }

    fn ends(self) -> (u64, u64) {
        self.0.unwrap_or((0, 0))
    }
}

/// The records that wait to be packed.
#[derive(Debug, Default)]
struct Chunk {
    records: Vec<u8>,
    span: Span,
    /// Of each channel, the log times of its messages and where they lie.
    index: BTreeMap<u16, Vec<(u64, u64)>>,
}

/// A recording that is being written.
#[derive(Debug)]
pub struct Writer {
    path: PathBuf,
    file: BufWriter<File>,
    position: u64,
    chunk: Chunk,
    /// Schemas and channels, again in the summary.
    described: Vec<u8>,
    schemas: Vec<(String, String)>,
    /// Messages of each channel.
    counts: Vec<u32>,
    span: Span,
    chunk_indexes: Vec<u8>,
    num_chunks: u32,
    metadata_index: Vec<u8>,
    num_metadata: u32,
}

impl Writer {
    /// Begins a file; one that is there is replaced.
    ///
    /// # Errors
    /// `Io`.
    pub fn create(path: &Path) -> Result<Self, BagError> {
        Self::begin(path, File::create(path))
    }

    /// Begins a file where none is.
    ///
    /// # Errors
    /// `Io`, of the kind `AlreadyExists` if there is one.
    pub fn create_new(path: &Path) -> Result<Self, BagError> {
        Self::begin(path, File::create_new(path))
    }

    fn begin(path: &Path, file: std::io::Result<File>) -> Result<Self, BagError> {
        let mut writer = Self {
            path: path.to_owned(),
            file: BufWriter::new(file.map_err(BagError::io(path))?),
            position: 0,
            chunk: Chunk::default(),
            described: vec![],
            schemas: vec![],
            counts: vec![],
            span: Span::default(),
            chunk_indexes: vec![],
            num_chunks: 0,
            metadata_index: vec![],
            num_metadata: 0,
        };
        writer.put(MAGIC)?;
        writer.put(&Content::default().bytes(b"ros2").bytes(b"percept").record(HEADER))?;
        writer.metadata(METADATA_NAME, &[])?;
        Ok(writer)
    }

    /// Says something of the recording as a whole: names and values, under a name of their own ([`Recording::metadata`]).
    ///
    /// [`Recording::metadata`]: crate::Recording::metadata
    ///
    /// # Errors
    /// `Io`.
    pub fn add_metadata(&mut self, name: &str, entries: &BTreeMap<String, String>) -> Result<(), BagError> {
        let map = entries.iter().fold(Content::default(), |map, (k, v)| map.bytes(k.as_bytes()).bytes(v.as_bytes()));
        self.metadata(name.as_bytes(), &map.0)
    }

    fn metadata(&mut self, name: &[u8], entries: &[u8]) -> Result<(), BagError> {
        let metadata = Content::default().bytes(name).bytes(entries).record(METADATA);
        let entry = Content::default().u64(self.position).u64(metadata.len() as u64).bytes(name);
        self.metadata_index.extend(entry.record(METADATA_INDEX));
        self.num_metadata += 1;
        self.put(&metadata)
    }

    /// Adds a topic whose messages are CDR: its type, `sensor_msgs/msg/LaserScan`, and that type's definition as `.msg` text
    /// with those that it needs (`percept_ros::Message::definition`).
    ///
    /// # Errors
    /// `TooManyChannels` beyond 65535, `Io`.
    pub fn add_channel(&mut self, topic: &str, type_name: &str, definition: &str) -> Result<ChannelId, BagError> {
        self.add(topic, type_name, definition, &[])
    }

    /// Adds a topic as [`Writer::add_channel`] does, whose last message those who listen later get, too: as `/tf_static` is,
    /// whose listeners hear nothing of a player that does not offer this.
    ///
    /// # Errors
    /// As [`Writer::add_channel`].
    pub fn add_latched_channel(
        &mut self,
        topic: &str,
        type_name: &str,
        definition: &str,
    ) -> Result<ChannelId, BagError> {
        let metadata = Content::default().bytes(b"offered_qos_profiles").bytes(LATCHED);
        self.add(topic, type_name, definition, &metadata.0)
    }

    fn add(&mut self, topic: &str, type_name: &str, definition: &str, metadata: &[u8]) -> Result<ChannelId, BagError> {
        let is_it = |(name, text): &(String, String)| name == type_name && text == definition;
        let known = self.schemas.iter().position(is_it);
        let schema_index = known.unwrap_or(self.schemas.len());
        let too_many = || BagError::TooManyChannels { path: self.path.clone() };
        let channel = u16::try_from(self.counts.len()).map_err(|_| too_many())?;
        // Number 0 says that there is no schema.
        let schema = u16::try_from(schema_index + 1).map_err(|_| too_many())?;
        let mut records = vec![];
        if known.is_none() {
            self.schemas.push((type_name.to_owned(), definition.to_owned()));
            let content = Content::default().u16(schema).bytes(type_name.as_bytes()).bytes(b"ros2msg");
            records.extend(content.bytes(definition.as_bytes()).record(SCHEMA));
        }
        let content = Content::default().u16(channel).u16(schema).bytes(topic.as_bytes()).bytes(b"cdr").bytes(metadata);
        records.extend(content.record(CHANNEL));
        self.counts.push(0);
        self.described.extend_from_slice(&records);
        // Before the chunk that has its first message, so that a file that is cut can be read.
        self.put(&records)?;
        Ok(ChannelId(channel))
    }

    /// Adds a message to a channel of this writer; times before 1970 are written as 1970.
    ///
    /// # Errors
    /// `Io`.
    pub fn write(
        &mut self,
        channel: ChannelId,
        log_time: Timestamp,
        publish_time: Timestamp,
        bytes: &[u8],
    ) -> Result<(), BagError> {
        let [log_time, publish_time] = [log_time, publish_time].map(|t| u64::try_from(t.0).unwrap_or(0));
        let sequence = self.counts.get(usize::from(channel.0)).copied().unwrap_or(0);
        let head = Content::default().u16(channel.0).u32(sequence).u64(log_time).u64(publish_time);
        let offset = self.chunk.records.len() as u64;
        self.chunk.records.push(MESSAGE);
        self.chunk.records.extend(((head.0.len() + bytes.len()) as u64).to_le_bytes());
        self.chunk.records.extend(head.0);
        self.chunk.records.extend_from_slice(bytes);
        self.chunk.index.entry(channel.0).or_default().push((log_time, offset));
        self.chunk.span.add(log_time);
        self.span.add(log_time);
        if let Some(count) = self.counts.get_mut(usize::from(channel.0)) {
            *count = count.wrapping_add(1);
        }
        if self.chunk.records.len() >= CHUNK_BYTES { self.end_chunk() } else { Ok(()) }
    }

    /// Hands all that was written to the system, the chunk that is being filled packed as it is: from then on it can be read
    /// from the file, and outlives this process, though not the machine's loss of power. Small chunks pack badly: some
    /// seconds of messages should lie between.
    ///
    /// # Errors
    /// `Io`.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.end_chunk()?;
        self.file.flush().map_err(BagError::io(&self.path))
    }

    /// Bytes of the file so far; what waits to be packed is counted as it is.
    pub fn num_bytes(&self) -> u64 {
        self.position + self.chunk.records.len() as u64
    }

    /// Writes summary and end, and tells the file's length, bytes; without, it reads as one that was cut.
    ///
    /// # Errors
    /// `Io`.
    pub fn finish(mut self) -> Result<u64, BagError> {
        self.end_chunk()?;
        self.put(&Content::default().u32(0).record(DATA_END))?;
        let summary_start = self.position;
        let described = std::mem::take(&mut self.described);
        self.put(&described)?;
        let counts = (0u16..).zip(&self.counts);
        let map = counts.fold(Content::default(), |map, (channel, &count)| map.u16(channel).u64(count.into()));
        let num_messages = self.counts.iter().map(|&c| u64::from(c)).sum();
        let (first, last) = self.span.ends();
        let statistics =
            Content::default().u64(num_messages).u16(self.schemas.len() as u16).u32(self.counts.len() as u32);
        let statistics =
            statistics.u32(0).u32(self.num_metadata).u32(self.num_chunks).u64(first).u64(last).bytes(&map.0);
        self.put(&statistics.record(STATISTICS))?;
        let chunk_indexes = std::mem::take(&mut self.chunk_indexes);
        self.put(&chunk_indexes)?;
        let metadata_index = std::mem::take(&mut self.metadata_index);
        self.put(&metadata_index)?;
        self.put(&Content::default().u64(summary_start).u64(0).u32(0).record(FOOTER))?;
        self.put(MAGIC)?;
        self.file.flush().map_err(BagError::io(&self.path))?;
        Ok(self.position)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), BagError> {
        self.file.write_all(bytes).map_err(BagError::io(&self.path))?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// Packs what waits, if anything does, and writes its index behind it.
    fn end_chunk(&mut self) -> Result<(), BagError> {
        let Chunk { records, span, index } = std::mem::take(&mut self.chunk);
        if records.is_empty() {
            return Ok(());
        }
        let packed = zstd::bulk::compress(&records, COMPRESSION_LEVEL).map_err(BagError::io(&self.path))?;
        let ((first, last), unpacked_bytes) = (span.ends(), records.len() as u64);
        let chunk = Content::default().u64(first).u64(last).u64(unpacked_bytes).u32(0).bytes(COMPRESSION);
        let chunk = chunk.u64(packed.len() as u64).raw(&packed).record(CHUNK);
        let chunk_start = self.position;
        self.put(&chunk)?;
        let index_start = self.position;
        let mut offsets = Content::default();
        for (channel, places) in index {
            offsets = offsets.u16(channel).u64(self.position);
            let places = places.iter().fold(Content::default(), |p, &(time, offset)| p.u64(time).u64(offset));
            self.put(&Content::default().u16(channel).bytes(&places.0).record(MESSAGE_INDEX))?;
        }
        let entry = Content::default().u64(first).u64(last).u64(chunk_start).u64(chunk.len() as u64).bytes(&offsets.0);
        let entry =
            entry.u64(self.position - index_start).bytes(COMPRESSION).u64(packed.len() as u64).u64(unpacked_bytes);
        self.chunk_indexes.extend(entry.record(CHUNK_INDEX));
        self.num_chunks += 1;
        Ok(())
    }
}
