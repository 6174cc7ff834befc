//! rosbag2's SQLite files: `topics` and `messages` as tables, read by ranges of time.
//!
//! Source: ros2/rosbag2, `rosbag2_storage_sqlite3`, schemas 1 to 4.

use rusqlite::{Connection, Error, OpenFlags};
use std::collections::BTreeMap;
use std::path::Path;

pub(crate) const MAGIC: &[u8] = b"SQLite format 3\0";
/// What is read at once: as much as a chunk of MCAP, or one message if that is larger.
const RANGE_BYTES: u64 = 1 << 20;
const RANGE_ROWS: u64 = 1000;

/// A topic's row, with how many messages it has and when.
pub(crate) struct TopicRow {
    pub(crate) id: i64,
    pub(crate) name: String,
    pub(crate) type_name: String,
    pub(crate) encoding: String,
    pub(crate) num_messages: u64,
    pub(crate) span: Option<(i64, i64)>,
}

/// Messages of `from <= log time < until`, ns.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Range {
    pub(crate) from: i64,
    pub(crate) until: i64,
}

/// What is in a file.
pub(crate) struct Tables {
    pub(crate) topics: Vec<TopicRow>,
    /// Ranges of time that have about as many bytes.
    pub(crate) ranges: Vec<Range>,
    /// Where the messages break off.
    pub(crate) error: Option<Error>,
}

fn open(path: &Path) -> Result<Connection, Error> {
    let connection =
        Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX)?;
    // A file from outside: its schema may run no functions.
    connection.execute_batch("PRAGMA trusted_schema = OFF; PRAGMA cell_size_check = ON;")?;
    let sql = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name IN ('topics', 'messages')";
    // A view of that name could go on for ever.
    match connection.query_row(sql, [], |row| row.get::<_, i64>(0))? {
        2 => Ok(connection),
        _ => Err(Error::InvalidQuery),
    }
}

/// Looks through the tables, at the messages' index and lengths alone.
pub(crate) fn look(path: &Path) -> Result<Tables, Error> {
    let connection = open(path)?;
    let mut statement = connection.prepare("SELECT id, name, type, serialization_format FROM topics ORDER BY id")?;
    let row = |row: &rusqlite::Row<'_>| {
        let (id, name, type_name, encoding) = (row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?);
        Ok(TopicRow { id, name, type_name, encoding, num_messages: 0, span: None })
    };
    let mut topics = statement.query_map([], row)?.collect::<Result<Vec<_>, _>>()?;
    let index: BTreeMap<i64, usize> = topics.iter().enumerate().map(|(i, t)| (t.id, i)).collect();
    let mut ranges = Vec::new();
    let error = messages(&connection, &mut topics, &index, &mut ranges).err();
    Ok(Tables { topics, ranges, error })
}

fn messages(
    connection: &Connection,
    topics: &mut [TopicRow],
    index: &BTreeMap<i64, usize>,
    ranges: &mut Vec<Range>,
) -> Result<(), Error> {
    let mut statement =
        connection.prepare("SELECT topic_id, timestamp, length(data) FROM messages ORDER BY timestamp")?;
    let mut rows = statement.query([])?;
    let (mut num_rows, mut num_bytes) = (0, 0);
    while let Some(row) = rows.next()? {
        let (topic, time, bytes): (i64, i64, i64) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let Some(topic) = index.get(&topic).and_then(|&i| topics.get_mut(i)) else { continue };
        let (first, last) = topic.span.unwrap_or((time, time));
        topic.span = Some((first.min(time), last.max(time)));
        topic.num_messages += 1;
        match ranges.last_mut() {
            // What has one time stays together.
            Some(range) if range.until > time || (num_rows < RANGE_ROWS && num_bytes < RANGE_BYTES) => {
                range.until = time.saturating_add(1);
            }
            _ => {
                ranges.push(Range { from: time, until: time.saturating_add(1) });
                (num_rows, num_bytes) = (0, 0);
            }
        }
        num_rows += 1;
        num_bytes += u64::try_from(bytes).unwrap_or(0);
    }
    Ok(())
}

/// The messages of a range: topic's row, log time, bytes.
pub(crate) fn read(path: &Path, range: Range, mut found: impl FnMut(i64, i64, Vec<u8>)) -> Result<(), Error> {
    let connection = open(path)?;
    let sql = "SELECT topic_id, timestamp, data FROM messages WHERE timestamp >= ?1 AND timestamp < ?2 ORDER BY timestamp, id";
    let mut statement = connection.prepare(sql)?;
    let mut rows = statement.query([range.from, range.until])?;
    while let Some(row) = rows.next()? {
        found(row.get(0)?, row.get(1)?, row.get(2)?);
    }
    Ok(())
}
