//! The walk through a recording.

use crate::FormatError;
use percept_geometry::sensor::OdometrySample;
use percept_geometry::{Pose, SensorData, SensorFrame, SensorId, Stamped, Timestamp};
use std::ops::Range;
use std::sync::Arc;

/// Name of the odometry beside a primary sensor.
pub(super) const ODOMETRY: &str = "odometry";

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
    odometry: Arc<[Stamped<Pose>]>,
    primary: Range<usize>,
    samples: Range<usize>,
}

impl Frames {
    pub(super) fn new(
        source: Arc<dyn Load>,
        stamps: Arc<[Timestamp]>,
        odometry: Arc<[Stamped<Pose>]>,
        range: Option<Range<usize>>,
    ) -> Self {
        let until = |stamp: Timestamp| odometry.partition_point(|o| o.stamp <= stamp);
        let (primary, samples) = match range {
            None => (0..stamps.len(), 0..odometry.len()),
            Some(range) => {
                let end = range.end.min(stamps.len());
                let start = range.start.min(end);
                let first = if start == 0 { 0 } else { until(stamps[start - 1]) };
                let last = if end == start { first } else { until(stamps[end - 1]) };
                (start..end, first..last)
            }
        };
        Self { source, stamps, odometry, primary, samples }
    }
}

impl Iterator for Frames {
    type Item = Result<SensorFrame, FormatError>;

    fn next(&mut self) -> Option<Self::Item> {
        let stamp = self.primary.clone().next().map(|i| self.stamps[i]);
        let sample = self.samples.clone().next().map(|i| &self.odometry[i]);
        if let Some(sample) = sample.filter(|o| stamp.is_none_or(|stamp| o.stamp <= stamp)) {
            self.samples.next();
            let data = SensorData::Odometry(OdometrySample { t_odom_base: sample.value, covariance: None });
            return Some(Ok(SensorFrame { sensor: ODOMETRY.into(), stamp: sample.stamp, data }));
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
