//! Recordings that other implementations wrote (`tests/golden/bags.py`).

use crate::order::all;
use percept_bags::Recording;
use percept_geometry::Timestamp;
use percept_ros::{Message, messages::Header};
use std::path::PathBuf;

const FILES: [&str; 9] = [
    "zstd_messages.db3",
    "zstd_messages.mcap",
    "zstd.mcap",
    "lz4.mcap",
    "none.mcap",
    "unchunked.mcap",
    "none.bag",
    "bz2.bag",
    "lz4.bag",
];

#[test]
fn recordings_of_each_packing_say_the_same() {
    for name in FILES {
        let path = PathBuf::from(std::env::var_os("CARGO_MANIFEST_DIR").unwrap()).join("tests/golden").join(name);
        let recording = Recording::open(&path).unwrap();
        assert_eq!(recording.warnings(), [], "{name}");
        let mut topics: Vec<_> = recording.topics().iter().map(|t| (t.name.as_str(), t.num_messages)).collect();
        topics.sort_unstable();
        assert_eq!(topics, [("/a", 12), ("/b", 12)], "{name}");
        let messages = all(&recording);
        assert_eq!(messages.len(), 24, "{name}");
        for (i, message) in messages.iter().enumerate() {
            let topic = &recording.topics()[message.topic];
            assert_eq!(topic.name, ["/a", "/b"][i % 2], "{name}");
            assert_eq!(message.log_time, Timestamp(1_763_692_800_000_000_000 + i as i64 * 10), "{name}");
            let header = match topic.encoding.as_str() {
                "ros1" => Header::decode_ros1(&message.bytes),
                _ => Header::decode(&message.bytes),
            };
            assert_eq!(header.unwrap().frame_id, i.to_string(), "{name}");
        }
    }
}
