//! The walk through a recording.

use crate::FormatError;
use percept_geometry::{SensorData, SensorFrame, SensorId, Timestamp};
use std::ops::Range;
use std::sync::Arc;

/// What reads and decodes one frame of the primary sensor.
pub(super) trait Load: std::fmt::Debug + Send + Sync {
    /// Name of the primary sensor.
    fn sensor(&self) -> SensorId;

    /// Frame `index`, which is within the recording.
    fn load(&self, index: usize) -> Result<SensorData, FormatError>;
}

/// Frames of a recording in order of their stamps; see [`super::Dataset::frames`].
#[derive(Debug)]
pub struct Frames {
    source: Arc<dyn Load>,
    stamps: Arc<[Timestamp]>,
    beside: Arc<[SensorFrame]>,
    primary: Range<usize>,
    samples: Range<usize>,
}

impl Frames {
    pub(super) fn new(
        source: Arc<dyn Load>,
        stamps: Arc<[Timestamp]>,
        beside: Arc<[SensorFrame]>,
        range: Option<Range<usize>>,
    ) -> Self {
        let until = |stamp: Timestamp| beside.partition_point(|f| f.stamp <= stamp);
        let (primary, samples) = match range {
            None => (0..stamps.len(), 0..beside.len()),
            Some(range) => {
                let end = range.end.min(stamps.len());
                let start = range.start.min(end);
                let first = if start == 0 { 0 } else { until(stamps[start - 1]) };
                let last = if end == start { first } else { until(stamps[end - 1]) };
                (start..end, first..last)
            }
        };
        Self { source, stamps, beside, primary, samples }
    }
}

impl Iterator for Frames {
    type Item = Result<SensorFrame, FormatError>;

    fn next(&mut self) -> Option<Self::Item> {
        let stamp = self.primary.clone().next().map(|i| self.stamps[i]);
        let sample = self.samples.clone().next().map(|i| &self.beside[i]);
        if let Some(sample) = sample.filter(|f| stamp.is_none_or(|stamp| f.stamp <= stamp)) {
            self.samples.next();
            return Some(Ok(sample.clone()));
        }
        let (index, stamp) = (self.primary.next()?, stamp?);
        Some(self.source.load(index).map(|data| SensorFrame { sensor: self.source.sensor(), stamp, data }))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let n = self.primary.len() + self.samples.len();
        (n, Some(n))
    }
}

impl ExactSizeIterator for Frames {}

impl std::iter::FusedIterator for Frames {}
