//! Files that are cut or damaged are read as far as they go, and that is told.

use crate::order::{all, write};
use percept_bags::Recording;
use proptest::prelude::*;
use std::sync::Arc;

/// A ROS 1 bag with one connection and `times` in one chunk, as the format's page has it.
fn ros1_bag(compression: &str, pack: impl Fn(&[u8]) -> Vec<u8>, times: &[u32]) -> Vec<u8> {
    let part = |bytes: &[u8]| [&(bytes.len() as u32).to_le_bytes()[..], bytes].concat();
    let field = |name: &str, value: &[u8]| part(&[name.as_bytes(), b"=", value].concat());
    let record = |fields: &[Vec<u8>], data: &[u8]| [part(&fields.concat()), part(data)].concat();
    let conn = field("conn", &7u32.to_le_bytes());
    let about = [field("topic", b"/scan"), field("type", b"sensor_msgs/LaserScan"), field("md5sum", b"x")].concat();
    let mut chunk = record(&[field("op", &[7]), conn.clone(), field("topic", b"/scan")], &about);
    for (i, time) in times.iter().enumerate() {
        let stamp = [time.to_le_bytes(), 5u32.to_le_bytes()].concat();
        chunk.extend(record(&[field("op", &[2]), conn.clone(), field("time", &stamp)], &[i as u8; 3]));
    }
    let size = field("size", &(chunk.len() as u32).to_le_bytes());
    let mut bag = b"#ROSBAG V2.0\n".to_vec();
    bag.extend(record(&[field("op", &[3]), field("index_pos", &u64::MAX.to_le_bytes())], &[b' '; 40]));
    bag.extend(record(&[field("op", &[5]), field("compression", compression.as_bytes()), size], &pack(&chunk)));
    // An index that says nothing true.
    bag.extend(record(&[field("op", &[4]), conn, field("ver", &[9, 9, 9, 9])], &[0xff; 7]));
    bag
}

fn lz4(bytes: &[u8]) -> Vec<u8> {
    use std::io::Write;
    let mut encoder = lz4_flex::frame::FrameEncoder::new(vec![]);
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// The same messages, in front of what tells their channel: as a recorder that was killed, or damage, may leave them.
#[test]
fn messages_in_front_of_their_channel_are_counted_as_they_are_read() {
    let bag = ros1_bag("none", <[u8]>::to_vec, &[3, 1, 2]);
    // The connection's record becomes one of a kind that nobody knows, and comes again behind the messages.
    let (known, at) = (b"op=\x07", bag.windows(4).position(|w| w == b"op=\x07").unwrap());
    let from = at - 8;
    let to = bag.windows(4).position(|w| w == b"op=\x02").unwrap() - 8;
    let mut damaged = bag.clone();
    damaged[at + known.len() - 1] = 0x77;
    damaged.extend_from_slice(&bag[from..to]);
    let recording = opened(&damaged);
    assert_eq!(recording.topics()[0].num_messages, 3);
}

/// Times that no stamp holds are the last that it does.
#[test]
fn messages_of_impossible_times_are_read() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let mut writer = percept_bags::Writer::create(file.path()).unwrap();
    let topic = writer.add_channel("/scan", "sensor_msgs/msg/LaserScan", "").unwrap();
    let never = percept_geometry::Timestamp(i64::MAX);
    writer.write(topic, never, never, b"late").unwrap();
    writer.finish().unwrap();
    assert_eq!(opened(&std::fs::read(file.path()).unwrap()).topics()[0].num_messages, 1);
}

fn opened(bytes: &[u8]) -> Arc<Recording> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    let recording = Recording::open(file.path()).unwrap();
    // Whatever it is, what was counted is what is read.
    let counted: u64 = recording.topics().iter().map(|t| t.num_messages).sum();
    assert_eq!(all(&recording).len() as u64, counted);
    recording
}

#[test]
fn ros1_bags_read_whatever_their_index_says() {
    for bytes in [ros1_bag("none", <[u8]>::to_vec, &[3, 1, 2]), ros1_bag("lz4", lz4, &[3, 1, 2])] {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), &bytes).unwrap();
        let recording = Recording::open(file.path()).unwrap();
        assert_eq!(recording.warnings(), []);
        let topic = &recording.topics()[0];
        assert_eq!((topic.name.as_str(), topic.type_name.as_str()), ("/scan", "sensor_msgs/LaserScan"));
        assert_eq!((topic.encoding.as_str(), topic.num_messages), ("ros1", 3));
        let read: Vec<_> = all(&recording).iter().map(|m| (m.log_time.0, m.bytes.clone())).collect();
        let expected = [(1, 1), (2, 2), (3, 0)].map(|(sec, byte)| (sec * 1_000_000_000 + 5, vec![byte; 3]));
        assert_eq!(read, expected);
    }
}

#[test]
fn an_unknown_compression_is_passed_over_and_told() {
    let recording = opened(&ros1_bag("secret", <[u8]>::to_vec, &[1]));
    assert_eq!(recording.topics(), []);
    assert!(recording.warnings()[0].to_string().contains("packed by 'secret'"), "{:?}", recording.warnings());
}

#[test]
fn a_file_that_is_cut_is_read_so_far() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    write(&path, 400, 1000);
    let whole = std::fs::read(&path).unwrap();
    let mut last = 0;
    for share in 1..20 {
        let recording = opened(&whole[..whole.len() * share / 20]);
        let read = recording.topics().iter().map(|t| t.num_messages).sum();
        // Cut in the summary, it lacks nothing.
        assert!(read == 800 || !recording.warnings().is_empty(), "{share}");
        assert!(read >= last, "{share}: {read} after {last}");
        last = read;
    }
    assert!(last > 300, "{last}");
}

#[test]
fn a_database_without_the_tables_says_so() {
    let file = tempfile::NamedTempFile::new().unwrap();
    for sql in ["CREATE TABLE topics(id)", "CREATE TABLE topics(id); CREATE VIEW messages AS SELECT 1"] {
        std::fs::write(file.path(), "").unwrap();
        rusqlite::Connection::open(file.path()).unwrap().execute_batch(sql).unwrap();
        let error = Recording::open(file.path()).unwrap_err().to_string();
        assert!(error.contains("has no tables `topics` and `messages`"), "{error}");
    }
}

/// As [`opened`], but for files that are refused, and those whose middle is.
fn tried(bytes: &[u8]) {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    if let Ok(recording) = Recording::open(file.path()) {
        let _ = recording.messages().count();
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]
    #[test]
    fn damaged_bytes_never_panic(
        kind in 0usize..6, cut in any::<prop::sample::Index>(), hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
    ) {
        let mut bytes = match kind {
            0 => ros1_bag("none", <[u8]>::to_vec, &[3, 1, 2]),
            1 => ros1_bag("lz4", lz4, &[3, 1, 2]),
            2 => include_bytes!("../golden/bz2.bag").to_vec(),
            3 => include_bytes!("../golden/lz4.mcap").to_vec(),
            4 => include_bytes!("../golden/zstd.mcap").to_vec(),
            _ => {
                let file = tempfile::NamedTempFile::new().unwrap();
                write(file.path(), 5, 20);
                std::fs::read(file.path()).unwrap()
            }
        };
        for (at, value) in hits {
            // Behind the magic.
            let at = 13 + at.index(bytes.len() - 13);
            bytes[at] ^= value;
        }
        let cut = 13 + cut.index(bytes.len() - 12);
        opened(&bytes[..cut]);
        opened(&bytes);
    }

    #[test]
    fn damaged_databases_never_panic(
        cut in any::<prop::sample::Index>(), hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..20),
    ) {
        let mut bytes = include_bytes!("../golden/zstd_messages.db3").to_vec();
        for (at, value) in hits {
            let at = at.index(bytes.len());
            bytes[at] ^= value;
        }
        tried(&bytes);
        tried(&bytes[..cut.index(bytes.len())]);
    }
}
