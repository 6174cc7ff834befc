//! Messages as frames, read when they are asked for.

use super::survey::Recorded;
use crate::dataset::frames::Load;
use crate::{FormatError, Limits};
use percept_bags::{Messages, Recording};
use percept_geometry::{SensorData, SensorId};
use percept_ros::readings;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Which messages make a frame.
#[derive(Debug)]
pub(super) enum Pictures {
    /// Each message of the topic.
    Each,
    /// A depth image and one of `color`'s images: numbers of messages of either topic.
    Pairs { color: usize, pairs: Vec<(usize, usize)> },
}

/// Frames of one topic, or of depth images and the colour images that belong to them.
#[derive(Debug)]
pub(super) struct Loader {
    recording: Arc<Recording>,
    recorded: Recorded,
    index: usize,
    pictures: Pictures,
    limits: Limits,
    cursor: Mutex<Option<Cursor>>,
}

/// Where the recording is being read.
#[derive(Debug)]
struct Cursor {
    messages: Messages,
    /// Messages of the topic, and of the colour images, that have come.
    come: [usize; 2],
    /// Read, and not asked for yet.
    held: BTreeMap<(usize, usize), Vec<u8>>,
}

impl Loader {
    pub(super) fn new(
        recording: Arc<Recording>,
        recorded: Recorded,
        index: usize,
        pictures: Pictures,
        limits: Limits,
    ) -> Self {
        let recorded = Recorded { stamps: vec![], samples: vec![], ..recorded };
        Self { recording, recorded, index, pictures, limits, cursor: Mutex::new(None) }
    }

    /// The bytes of the messages that make frame `index`.
    fn bytes(&self, index: usize) -> Result<(Vec<u8>, Option<Vec<u8>>), FormatError> {
        let (color, first, second) = match &self.pictures {
            Pictures::Each => (usize::MAX, index, None),
            Pictures::Pairs { color, pairs } => {
                let pair =
                    pairs.get(index).ok_or_else(|| FormatError::Recording { reason: "no such frame".to_owned() })?;
                (*color, pair.0, Some(pair.1))
            }
        };
        let mut cursor = self.cursor.lock().unwrap_or_else(PoisonError::into_inner);
        let is_past = |c: &Cursor| {
            let gone = |part: usize, wanted: usize| c.come[part] > wanted && !c.held.contains_key(&(part, wanted));
            gone(0, first) || second.is_some_and(|s| gone(1, s))
        };
        if cursor.as_ref().is_none_or(is_past) {
            *cursor = Some(Cursor { messages: self.recording.messages(), come: [0; 2], held: BTreeMap::new() });
        }
        let at = cursor.as_mut().ok_or_else(|| FormatError::Recording { reason: "not open".to_owned() })?;
        while !(at.held.contains_key(&(0, first)) && second.is_none_or(|s| at.held.contains_key(&(1, s)))) {
            let message = match at.messages.next() {
                Some(Ok(message)) => message,
                Some(Err(e)) => return Err(FormatError::recording(e)),
                None => {
                    return Err(FormatError::Recording { reason: "the recording ends before this frame".to_owned() });
                }
            };
            let part = if message.topic == self.index {
                0
            } else if message.topic == color {
                1
            } else {
                continue;
            };
            let number = at.come[part];
            at.come[part] += 1;
            // What is before it will not be asked for, by whoever reads in order.
            if number >= if part == 0 { first } else { second.unwrap_or(0).min(number) } {
                at.held.insert((part, number), message.bytes);
            }
        }
        let taken = at.held.remove(&(0, first)).unwrap_or_default();
        // One colour image may belong to two depth images.
        let beside = second.and_then(|s| at.held.get(&(1, s)).cloned());
        at.held
            .retain(|(part, number), _| if *part == 0 { *number > first } else { second.is_none_or(|s| *number >= s) });
        Ok((taken, beside))
    }

    fn fail(&self, reason: impl Into<String>) -> FormatError {
        FormatError::Recording { reason: format!("{}: {}", self.recorded.topic.name, reason.into()) }
    }
}

impl Load for Loader {
    fn sensor(&self) -> SensorId {
        self.recorded.topic.sensor_id()
    }

    fn load(&self, index: usize) -> Result<SensorData, FormatError> {
        let encoding = self.recorded.encoding.ok_or_else(|| self.fail("its encoding is not known"))?;
        let (data, color) = self.bytes(index)?;
        let (content, max_pixels) = (&self.recorded.topic.content, self.limits.max_pixels);
        let reading = readings::reading(content, encoding, &data, color.as_deref(), max_pixels);
        reading.map(|r| r.data).map_err(|e| self.fail(e.to_string()))
    }
}
