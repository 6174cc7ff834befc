//! A recording: its files walked once for topics and blocks, then read block by block, merged by log time.

use crate::block::{self, Block};
use crate::mcap_file::Mcap;
use crate::ros1_bag::Ros1Bag;
use crate::rosbag2_sqlite as sqlite;
use crate::walk::{Container, HEAD_BYTES, Record, records};
use crate::{BagError, Warning};
use percept_geometry::Timestamp;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The name under which percept's own recordings say of what session they are ([`Recording::metadata`]).
pub const ABOUT: &str = "percept";
/// Records that say something of a recording as a whole, at most: what there is more is passed over.
const MOST_METADATA: usize = 1000;

/// A topic of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Its name, `/scan`.
    pub name: String,
    /// Type of its messages as recorded: `sensor_msgs/msg/LaserScan`; of ROS 1, `sensor_msgs/LaserScan`.
    pub type_name: String,
    /// Encoding of its messages: `cdr`, `ros1`, `protobuf`, `json`, …
    pub encoding: String,
    /// Number of its messages that can be read.
    pub num_messages: u64,
    /// Log time of the earliest; none if there is no message.
    pub first: Option<Timestamp>,
    /// Log time of the latest.
    pub last: Option<Timestamp>,
}

/// A message as it was recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordedMessage {
    /// Index of its topic in [`Recording::topics`].
    pub topic: usize,
    /// When it was recorded.
    pub log_time: Timestamp,
    /// When it was sent; in ROS 1 bags, when it was recorded.
    pub publish_time: Timestamp,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Mcap,
    Ros1,
    Sqlite,
}

/// Where messages lie that are read at once.
#[derive(Debug, Clone, Copy)]
enum Place {
    Block(Block),
    Rows(sqlite::Range),
}

impl Place {
    /// Log time of the earliest, ns; where it begins.
    fn order(&self) -> (i64, u64) {
        match self {
            Self::Block(block) => (block.first, block.offset),
            Self::Rows(range) => (range.from, 0),
        }
    }
}

#[derive(Debug)]
struct Part {
    path: PathBuf,
    kind: Kind,
    /// The topic of each channel number.
    channels: BTreeMap<u32, usize>,
    /// Types by number.
    schemas: BTreeMap<u32, String>,
    /// Messages of each channel number: a damaged file may tell what a channel is behind its first messages.
    tallies: BTreeMap<u32, Tally>,
}

/// How many messages a channel has, and their times, ns.
#[derive(Debug, Clone, Copy)]
struct Tally {
    num_messages: u64,
    first: i64,
    last: i64,
}

/// A recording that was opened: what is in it is known, its messages are read when they are asked for.
#[derive(Debug)]
pub struct Recording {
    topics: Vec<Topic>,
    warnings: Vec<Warning>,
    parts: Vec<Part>,
    metadata: Vec<(String, BTreeMap<String, String>)>,
    /// With the index of their file, by the time of their first message.
    places: Vec<(usize, Place)>,
}

impl Recording {
    /// Opens a `.mcap`, `.bag` or `.db3` file, or a folder of such. Reads all of it once, block by block; of `.db3`, the index.
    ///
    /// # Errors
    /// `Io`, `Unrecognised` or `Packed` (by the first bytes, whatever the name), `Empty` (a folder without any), `Sqlite`.
    pub fn open(path: &Path) -> Result<Arc<Self>, BagError> {
        let mut recording = Self { topics: vec![], warnings: vec![], parts: vec![], metadata: vec![], places: vec![] };
        for file in files(path)? {
            recording.add(file)?;
        }
        recording.places.sort_by_key(|(part, place)| (place.order().0, *part, place.order().1));
        Ok(Arc::new(recording))
    }

    /// The topics, in the order in which they were found.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// What is said of the recording as a whole under a name ([`Writer::add_metadata`]), in the order in which it was written.
    ///
    /// [`Writer::add_metadata`]: crate::Writer::add_metadata
    pub fn metadata<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a BTreeMap<String, String>> {
        self.metadata.iter().filter(move |(of, _)| of == name).map(|(_, entries)| entries)
    }

    /// What was passed over: damage, cut ends, compressions that are not known.
    pub fn warnings(&self) -> &[Warning] {
        &self.warnings
    }

    /// The messages in the order of their log times; those of one time in the order of the file. In memory are the blocks whose
    /// times overlap: as a rule one or two.
    pub fn messages(self: &Arc<Self>) -> Messages {
        let recording = Arc::clone(self);
        Messages { recording, next_place: 0, ahead: BinaryHeap::new(), num_read: 0, has_failed: false }
    }

    fn add(&mut self, path: PathBuf) -> Result<(), BagError> {
        let mut file = File::open(&path).map_err(BagError::io(&path))?;
        let mut magic = vec![];
        (&mut file).take(16).read_to_end(&mut magic).map_err(BagError::io(&path))?;
        let kind = match &magic[..] {
            m if m.starts_with(Mcap::MAGIC) => Kind::Mcap,
            m if m.starts_with(Ros1Bag::MAGIC) => Kind::Ros1,
            m if m.starts_with(sqlite::MAGIC) => Kind::Sqlite,
            m if m.starts_with(&ZSTD_MAGIC) => return Err(BagError::Packed { path }),
            _ => return Err(BagError::Unrecognised { path }),
        };
        let (channels, schemas, tallies) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        self.parts.push(Part { path: path.clone(), kind, channels, schemas, tallies });
        match kind {
            Kind::Mcap => self.walk::<Mcap>(&mut file, &path),
            Kind::Ros1 => self.walk::<Ros1Bag>(&mut file, &path),
            Kind::Sqlite => self.look(&path),
        }?;
        self.count();
        Ok(())
    }

    /// Counts the messages of the last file for their topics.
    fn count(&mut self) {
        let Some(part) = self.parts.last() else { return };
        for (channel, tally) in &part.tallies {
            let topic = part.channels.get(channel).and_then(|index| self.topics.get_mut(*index));
            let Some(topic) = topic else { continue };
            topic.num_messages += tally.num_messages;
            topic.first = topic.first.into_iter().chain([Timestamp(tally.first)]).min();
            topic.last = topic.last.max(Some(Timestamp(tally.last)));
        }
    }

    /// Takes in the tables of a file.
    fn look(&mut self, path: &Path) -> Result<(), BagError> {
        let sqlite::Tables { topics, ranges, error } = sqlite::look(path).map_err(BagError::sqlite(path))?;
        if let Some(error) = error {
            self.warn(path, 0, format!("the table of messages is damaged: {error}; read so far"));
        }
        for row in topics {
            let sqlite::TopicRow { id, name, type_name, encoding, num_messages, span } = row;
            // Numbers of rows begin at 1; what is beyond 32 bits no recorder has written.
            let Ok(id) = u32::try_from(id) else { continue };
            self.learn(Record::Channel { id, schema: 0, topic: name, type_name: Some(type_name), encoding }, &mut None);
            let tally = span.map(|(first, last)| Tally { num_messages, first, last });
            if let (Some(part), Some(tally)) = (self.parts.last_mut(), tally) {
                part.tallies.insert(id, tally);
            }
        }
        let part = self.parts.len() - 1;
        self.places.extend(ranges.into_iter().map(|range| (part, Place::Rows(range))));
        Ok(())
    }

    fn warn(&mut self, path: &Path, byte: u64, what: impl Into<String>) {
        self.warnings.push(Warning { path: path.to_owned(), byte, what: what.into() });
    }

    /// Goes along the records of a file.
    fn walk<C: Container>(&mut self, file: &mut File, path: &Path) -> Result<(), BagError> {
        let length = file.seek(SeekFrom::End(0)).map_err(BagError::io(path))?;
        let mut at = C::MAGIC.len() as u64;
        loop {
            let head = read_at(file, at, HEAD_BYTES as u64).map_err(BagError::io(path))?;
            if head.is_empty() {
                if C::HAS_END {
                    self.warn(
                        path,
                        at,
                        "the file has no end: it was cut off, or its recorder did not close it; read so far",
                    );
                }
                return Ok(());
            }
            let Some(frame) = C::frame(&head) else {
                self.warn(path, at, "a record is cut off; read so far");
                return Ok(());
            };
            let available = length - at.min(length);
            if frame.is_chunk {
                let known = usize::try_from(frame.num_bytes).unwrap_or(usize::MAX).min(head.len());
                match C::parse(head.get(..known).unwrap_or_default()) {
                    Ok(Record::Chunk { offset, num_bytes, compression: Ok(compression) }) => {
                        let offset = at + offset as u64;
                        let num_bytes = num_bytes.min(length - offset.min(length));
                        self.add_block::<C>(file, path, Block::new(offset, num_bytes, compression))?;
                    }
                    Ok(Record::Chunk { compression: Err(name), .. }) => {
                        self.warn(
                            path,
                            at,
                            format!("a chunk is packed by '{name}', which is not read; it was passed over"),
                        );
                    }
                    Ok(_) => {}
                    Err(what) => self.warn(path, at, what),
                }
            } else if frame.num_bytes <= available {
                // Messages that lie in no chunk are blocks of their own.
                let record = read_at(file, at, frame.num_bytes).map_err(BagError::io(path))?;
                match C::parse(&record) {
                    Ok(Record::End) => return Ok(()),
                    Ok(Record::Message { .. }) => {
                        let block = Block::new(at, frame.num_bytes, block::Compression::None);
                        self.add_block::<C>(file, path, block)?;
                    }
                    Ok(record) => self.learn(record, &mut None),
                    Err(what) => self.warn(path, at, what),
                }
            }
            if frame.num_bytes > available {
                self.warn(
                    path,
                    at,
                    format!("a record of {} bytes is cut off after {available}; read so far", frame.num_bytes),
                );
                return Ok(());
            }
            at += frame.num_bytes;
        }
    }

    fn add_block<C: Container>(&mut self, file: &mut File, path: &Path, mut block: Block) -> Result<(), BagError> {
        let (bytes, error) = unpacked(file, &block).map_err(BagError::io(path))?;
        if let Some(error) = error {
            self.warn(path, block.offset, format!("a chunk is damaged: {error}; read as far as it goes"));
        }
        let mut first = None;
        let ended = records::<C>(&bytes, |record| self.learn(record, &mut first));
        if let Err((_, what)) = ended {
            self.warn(path, block.offset, format!("{what} inside a chunk; read so far"));
        }
        if let Some(first) = first {
            block.first = first;
            self.places.push((self.parts.len() - 1, Place::Block(block)));
        }
        Ok(())
    }

    /// Takes in what a record of the last file says; `first` becomes the earliest time.
    fn learn(&mut self, record: Record<'_>, first: &mut Option<i64>) {
        let Some(part) = self.parts.last_mut() else { return };
        match record {
            Record::Schema { id, type_name } => {
                part.schemas.insert(id, type_name);
            }
            Record::Channel { id, schema, topic: name, type_name, encoding } => {
                let type_name = type_name.or_else(|| part.schemas.get(&schema).cloned()).unwrap_or_default();
                let is_it = |t: &Topic| t.name == name && t.type_name == type_name && t.encoding == encoding;
                let index = self.topics.iter().position(is_it).unwrap_or(self.topics.len());
                if index == self.topics.len() {
                    self.topics.push(Topic { name, type_name, encoding, num_messages: 0, first: None, last: None });
                }
                part.channels.entry(id).or_insert(index);
            }
            Record::Message { channel, log_time, .. } => {
                let none = Tally { num_messages: 0, first: i64::MAX, last: i64::MIN };
                let tally = part.tallies.entry(channel).or_insert(none);
                tally.num_messages += 1;
                tally.first = tally.first.min(log_time);
                tally.last = tally.last.max(log_time);
                *first = Some(first.map_or(log_time, |first| first.min(log_time)));
            }
            Record::Metadata { name, entries } if self.metadata.len() < MOST_METADATA => {
                self.metadata.push((name, entries));
            }
            Record::Metadata { .. } | Record::Chunk { .. } | Record::End | Record::Other => {}
        }
    }
}

/// The file itself, or those of a folder, by name.
fn files(path: &Path) -> Result<Vec<PathBuf>, BagError> {
    let of = BagError::io(path);
    if !std::fs::metadata(path).map_err(&of)?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let entries = std::fs::read_dir(path).map_err(&of)?.map(|e| e.map(|e| e.path()));
    let mut files = entries.collect::<Result<Vec<_>, _>>().map_err(&of)?;
    files.retain(|f| f.extension().is_some_and(|e| ["mcap", "bag", "db3", "zstd"].iter().any(|known| e == *known)));
    files.sort();
    if files.is_empty() { Err(BagError::Empty { path: path.to_owned() }) } else { Ok(files) }
}

/// Up to `count` bytes from a place.
fn read_at(file: &mut File, at: u64, count: u64) -> std::io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(at))?;
    let mut bytes = vec![];
    file.take(count).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn unpacked(file: &mut File, block: &Block) -> std::io::Result<(Vec<u8>, Option<std::io::Error>)> {
    file.seek(SeekFrom::Start(block.offset))?;
    Ok(block::unpack(std::io::BufReader::new(file.take(block.num_bytes)), block.compression))
}

/// What every frame of zstd begins with (RFC 8878). No message does: CDR begins with 0, messages of ROS 1 with a length or a
/// number, and one that is this is hardly the first of megabytes that unpack without an error.
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// A message's bytes: rosbag2 packs them one by one if it is told to (compression mode `message`), whatever it stores them in.
fn of_message(bytes: Vec<u8>) -> Vec<u8> {
    if !bytes.starts_with(&ZSTD_MAGIC) {
        return bytes;
    }
    match block::unpack(&bytes[..], block::Compression::Zstd) {
        (unpacked, None) => unpacked,
        (_, Some(_)) => bytes,
    }
}

/// Messages in the order of their log times.
#[derive(Debug)]
pub struct Messages {
    recording: Arc<Recording>,
    next_place: usize,
    /// By time, then by order of reading.
    ahead: BinaryHeap<Reverse<Ahead>>,
    num_read: u64,
    has_failed: bool,
}

#[derive(Debug)]
struct Ahead {
    order: (i64, u64),
    message: RecordedMessage,
}

impl PartialEq for Ahead {
    fn eq(&self, other: &Self) -> bool {
        self.order == other.order
    }
}

impl Eq for Ahead {}

impl PartialOrd for Ahead {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Ahead {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.order.cmp(&other.order)
    }
}

impl Messages {
    fn load(&mut self, part: &Part, place: Place) -> Result<(), BagError> {
        let mut found = |channel: u32, log_time: i64, publish_time: i64, bytes: Vec<u8>| {
            let Some(&topic) = part.channels.get(&channel) else { return };
            let bytes = of_message(bytes);
            let (log_time, publish_time) = (Timestamp(log_time), Timestamp(publish_time));
            let message = RecordedMessage { topic, log_time, publish_time, bytes };
            self.ahead.push(Reverse(Ahead { order: (log_time.0, self.num_read), message }));
            self.num_read += 1;
        };
        match place {
            Place::Rows(range) => {
                let of_row =
                    |topic: i64, time, bytes| found(u32::try_from(topic).unwrap_or(u32::MAX), time, time, bytes);
                sqlite::read(&part.path, range, of_row).map_err(BagError::sqlite(&part.path))
            }
            Place::Block(block) => {
                let mut file = File::open(&part.path).map_err(BagError::io(&part.path))?;
                let (bytes, _) = unpacked(&mut file, &block).map_err(BagError::io(&part.path))?;
                let of_record = |record: Record<'_>| {
                    if let Record::Message { channel, log_time, publish_time, bytes } = record {
                        found(channel, log_time, publish_time, bytes.to_vec());
                    }
                };
                // Where it breaks off was told when the recording was opened.
                let _ = match part.kind {
                    Kind::Ros1 => records::<Ros1Bag>(&bytes, of_record),
                    Kind::Mcap | Kind::Sqlite => records::<Mcap>(&bytes, of_record),
                };
                Ok(())
            }
        }
    }
}

impl Iterator for Messages {
    type Item = Result<RecordedMessage, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.has_failed {
            return None;
        }
        let recording = Arc::clone(&self.recording);
        while let Some(&(part, place)) = recording.places.get(self.next_place) {
            if self.ahead.peek().is_some_and(|Reverse(ahead)| ahead.order.0 < place.order().0) {
                break;
            }
            self.next_place += 1;
            let part = recording.parts.get(part)?;
            if let Err(error) = self.load(part, place) {
                self.has_failed = true;
                return Some(Err(error));
            }
        }
        self.ahead.pop().map(|Reverse(ahead)| Ok(ahead.message))
    }
}
