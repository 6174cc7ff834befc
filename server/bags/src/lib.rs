//! Containers of recorded messages: MCAP, ROS 1 bags and rosbag2's SQLite files in, MCAP out.
//!
//! Comes in: a file, or a folder of files that one recording was split into. Goes out: its topics, and its messages as bytes in
//! the order of their log times. What the bytes mean is not known here: `percept_ros` reads them.
//!
//! A file is walked from its beginning, record by record, whatever its index says: one that is cut, or whose index is
//! damaged, is read as far as it goes, and that is told as a warning. Start with [`Recording::open`].

mod block;
mod error;
mod mcap_file;
mod recording;
mod ros1_bag;
mod rosbag2_sqlite;
mod walk;
mod writer;

pub use error::{BagError, Warning};
pub use recording::{ABOUT, Messages, RecordedMessage, Recording, Topic};
pub use writer::{ChannelId, Writer};
