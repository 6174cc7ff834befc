//! The files of a recording, one after the other.

use crate::messages::{self, Encoded, Unwritable};
use crate::names::Names;
use percept_bags::{ABOUT, BagError, ChannelId, Writer};
use percept_geometry::{Covariance6, Pose, SensorFrame, SensorSpec, Timestamp};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Why something was not written.
#[derive(Debug, thiserror::Error)]
pub(crate) enum WriteError {
    /// It cannot be said: the next may be.
    #[error(transparent)]
    Unwritable(#[from] Unwritable),
    /// The disk refused: nothing more is written.
    #[error(transparent)]
    File(#[from] BagError),
    /// The disk is to keep what it has left.
    #[error("the disk has {left} bytes left of {min} that recordings leave it; make room")]
    NoRoom {
        /// What it has.
        left: u64,
        /// What it is to have.
        min: u64,
    },
    /// The next file cannot be begun: the one that is being written is sound, and can be ended.
    #[error(transparent)]
    NextFile(BagError),
}

impl WriteError {
    /// Whether there is no room, rather than a fault.
    pub(crate) fn is_disk_full(&self) -> bool {
        match self {
            Self::NoRoom { .. } => true,
            Self::File(error) | Self::NextFile(error) => is_disk_full(error),
            Self::Unwritable(_) => false,
        }
    }
}

/// Whether a file was refused for want of room.
pub(crate) fn is_disk_full(error: &BagError) -> bool {
    use std::io::ErrorKind::{QuotaExceeded, StorageFull};
    matches!(error, BagError::Io { error, .. } if matches!(error.kind(), StorageFull | QuotaExceeded))
}

/// The file that is being written, and what is known of those before it.
pub(crate) struct Files {
    folder: PathBuf,
    name: String,
    max_file_bytes: u64,
    paths: Vec<PathBuf>,
    writer: Writer,
    /// Of the file that is being written, by topic.
    channels: BTreeMap<String, ChannelId>,
    names: Names,
    /// Each sensor's frame on base, as it was declared last.
    t_base_sensors: BTreeMap<String, Pose>,
    /// Whether mounts are known that the file does not have.
    are_mounts_due: bool,
    /// What is said of the recording as a whole.
    about: BTreeMap<String, String>,
    num_messages: u64,
    /// Of the files before.
    num_bytes_before: u64,
}

impl Files {
    /// Begins the first file; none that is there is touched.
    pub(crate) fn begin(folder: &Path, name: &str, max_file_bytes: u64) -> Result<Self, BagError> {
        let path = path(folder, name, 0);
        Ok(Self::with(Writer::create_new(&path)?, path, folder, name, max_file_bytes))
    }

    fn with(writer: Writer, path: PathBuf, folder: &Path, name: &str, max_file_bytes: u64) -> Self {
        Self {
            folder: folder.to_owned(),
            name: name.to_owned(),
            max_file_bytes,
            paths: vec![path],
            writer,
            channels: BTreeMap::new(),
            names: Names::default(),
            t_base_sensors: BTreeMap::new(),
            are_mounts_due: false,
            about: BTreeMap::new(),
            num_messages: 0,
            num_bytes_before: 0,
        }
    }

    /// The files so far, in their order.
    pub(crate) fn paths(&self) -> &[PathBuf] {
        &self.paths
    }

    /// Messages of all files.
    pub(crate) fn num_messages(&self) -> u64 {
        self.num_messages
    }

    /// Bytes of all files; what waits to be packed is counted as it is.
    pub(crate) fn num_bytes(&self) -> u64 {
        self.num_bytes_before + self.writer.num_bytes()
    }

    /// Writes a frame with what its declaration has that is new.
    pub(crate) fn frame(&mut self, spec: &SensorSpec, frame: &SensorFrame) -> Result<(), WriteError> {
        let stamp = frame.stamp.plus_seconds(spec.time_offset_s);
        let name = self.names.of(&spec.id);
        let encoded = messages::of_frame(name, spec, frame, stamp)?;
        if self.t_base_sensors.get(name) != Some(&spec.t_base_sensor) {
            self.t_base_sensors.insert(name.to_owned(), spec.t_base_sensor);
            self.are_mounts_due = true;
        }
        self.write(stamp, encoded)
    }

    /// Writes where base is in the map.
    pub(crate) fn pose(
        &mut self,
        stamp: Timestamp,
        t_map_base: &Pose,
        covariance: Option<&Covariance6>,
    ) -> Result<(), WriteError> {
        self.write(stamp, messages::of_pose(stamp, t_map_base, covariance)?)
    }

    /// Says something of the recording as a whole.
    pub(crate) fn about(&mut self, entries: &BTreeMap<String, String>) -> Result<(), WriteError> {
        self.about.clone_from(entries);
        Ok(self.writer.add_metadata(ABOUT, entries)?)
    }

    /// Hands what was written to the system.
    pub(crate) fn flush(&mut self) -> Result<(), BagError> {
        self.writer.flush()
    }

    /// Ends the last file; the bytes of all.
    pub(crate) fn finish(self) -> Result<u64, BagError> {
        Ok(self.num_bytes_before + self.writer.finish()?)
    }

    /// Writes what belongs together into one file, mounts before it.
    fn write(&mut self, stamp: Timestamp, encoded: Vec<Encoded>) -> Result<(), WriteError> {
        // A file has something in it, however little it may hold.
        if self.writer.num_bytes() >= self.max_file_bytes && !self.channels.is_empty() {
            self.begin_next()?;
        }
        if self.are_mounts_due {
            self.put(stamp, &messages::of_mounts(stamp, &self.t_base_sensors)?)?;
            self.are_mounts_due = false;
        }
        encoded.iter().try_for_each(|message| self.put(stamp, message))
    }

    fn put(&mut self, stamp: Timestamp, message: &Encoded) -> Result<(), WriteError> {
        let channel = match self.channels.get(&message.topic) {
            Some(channel) => *channel,
            None => {
                let (topic, definition) = (message.topic.as_str(), (message.definition)());
                let channel = if message.is_latched() {
                    self.writer.add_latched_channel(topic, message.type_name, &definition)?
                } else {
                    self.writer.add_channel(topic, message.type_name, &definition)?
                };
                self.channels.insert(topic.to_owned(), channel);
                channel
            }
        };
        self.writer.write(channel, stamp, stamp, &message.bytes)?;
        self.num_messages += 1;
        Ok(())
    }

    /// Ends the file and begins another, which can be read alone: mounts are told again.
    fn begin_next(&mut self) -> Result<(), WriteError> {
        let path = path(&self.folder, &self.name, self.paths.len());
        let next = Writer::create_new(&path).map_err(WriteError::NextFile)?;
        let before = std::mem::replace(&mut self.writer, next);
        self.paths.push(path);
        self.channels.clear();
        self.are_mounts_due = !self.t_base_sensors.is_empty();
        self.num_bytes_before += before.finish()?;
        if !self.about.is_empty() {
            self.writer.add_metadata(ABOUT, &self.about)?;
        }
        Ok(())
    }
}

fn path(folder: &Path, name: &str, index: usize) -> PathBuf {
    folder.join(format!("{name}_{index:04}.mcap"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn a_full_disk_is_told() {
        let full = Path::new("/dev/full");
        let mut files = Files::with(Writer::create(full).unwrap(), full.to_owned(), full, "", 1 << 30);
        files.pose(Timestamp(1), &Pose::identity(), None).unwrap();
        let error = files.flush().unwrap_err().to_string();
        assert_eq!(error, "/dev/full: No space left on device (os error 28)");
    }
}
