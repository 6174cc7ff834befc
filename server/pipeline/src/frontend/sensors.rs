//! The session's sensors: what a frame must be to be processed, and how it is handed to the odometry.

use super::floor_beams::off_the_floor;
use super::stray_returns::if_not_of_strays;
use crate::FrameError;
use percept_geometry::{SensorData, SensorFrame, SensorId, SensorKind, SensorSpec, Timestamp, cloud};
use percept_slam::{CloudScan, DepthScan, ImageScan, PlanarScan, Scan};
use std::collections::BTreeMap;
use std::sync::Arc;

/// No sweep takes longer: points whose times lie farther from the frame's stamp are in another unit, seconds.
const MOST_OFFSET_S: f32 = 10.0;

/// Checks a frame against its sensor's declaration and last stamp, changing nothing.
///
/// # Errors
/// What is wrong, by variant.
pub fn check_frame(spec: &SensorSpec, last: Option<Timestamp>, frame: &SensorFrame) -> Result<(), FrameError> {
    let sensor = || frame.sensor.clone();
    let sent = frame.data.kind();
    // An rgbd sensor may leave the colour out of a frame; a depth sensor's colour is not expected.
    let fits = sent == spec.kind || (spec.kind == SensorKind::Rgbd && sent == SensorKind::Depth);
    if !fits {
        return Err(FrameError::KindMismatch { sensor: sensor(), declared: spec.kind, sent });
    }
    if let Some(last) = last.filter(|&last| frame.stamp <= last) {
        return Err(FrameError::StampNotIncreasing { sensor: sensor(), stamp: frame.stamp, last });
    }
    let size = match &frame.data {
        SensorData::Depth(d) | SensorData::Rgbd(d, _) => Some((d.width(), d.height())),
        SensorData::Camera(c) => Some((c.width(), c.height())),
        _ => None,
    };
    if let (Some((width, height)), Some(k)) = (size, &spec.intrinsics)
        && (width, height) != (k.width, k.height)
    {
        return Err(FrameError::IntrinsicsMismatch {
            sensor: sensor(),
            width,
            height,
            expected_width: k.width,
            expected_height: k.height,
        });
    }
    match &frame.data {
        SensorData::Cloud(c) => check_cloud(c),
        SensorData::Imu(sample) => sample.validate().map_err(FrameError::Implausible),
        SensorData::Odometry(sample) => sample.validate().map_err(FrameError::Implausible),
        _ => Ok(()),
    }
}

fn check_cloud(cloud: &percept_geometry::PointCloud) -> Result<(), FrameError> {
    let mut finite = cloud.positions.iter().filter(|p| cloud::is_finite(p));
    let Some(first) = finite.next() else {
        return Err(FrameError::CloudEmpty { num_points: cloud.len() });
    };
    if finite.clone().all(|p| p == first) {
        return Err(FrameError::CloudDegenerate { num_points: 1 + finite.count() });
    }
    let far = cloud.time_offsets_s.iter().flatten().find(|t| t.abs() > MOST_OFFSET_S);
    far.map_or(Ok(()), |&seconds| Err(FrameError::TimeOffsetTooLarge { seconds }))
}

#[derive(Debug, Clone)]
struct Entry {
    spec: SensorSpec,
    last_stamp: Option<Timestamp>,
}

/// Declared sensors, their last stamps, and which of them moves the pose.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sensors {
    entries: BTreeMap<SensorId, Entry>,
    pose_sensor: Option<SensorId>,
    first_frame: Option<Timestamp>,
}

/// Seconds without a frame after which another sensor of the same kind may take over: more than links drop out for.
const SILENCE_S: f64 = 2.0;

/// Seconds for which a better pose sensor that is declared but silent is waited for.
const PATIENCE_S: f64 = 1.0;

impl Sensors {
    pub(crate) fn declare(&mut self, spec: SensorSpec) {
        let last_stamp = self.entries.get(&spec.id).and_then(|e| e.last_stamp);
        self.entries.insert(spec.id.clone(), Entry { spec, last_stamp });
    }

    pub(crate) fn spec(&self, id: &SensorId) -> Option<&SensorSpec> {
        self.entries.get(id).map(|e| &e.spec)
    }

    pub(crate) fn set_last_stamp(&mut self, id: &SensorId, stamp: Timestamp) {
        if let Some(entry) = self.entries.get_mut(id) {
            entry.last_stamp = Some(stamp);
        }
    }

    pub(crate) fn set_pose_sensor(&mut self, id: SensorId) {
        self.pose_sensor = Some(id);
    }

    /// Checks the frame, notes its stamp, and gives the spec and the stamp on the session's clock.
    pub(crate) fn admit(&mut self, frame: &SensorFrame) -> Result<(SensorSpec, Timestamp), FrameError> {
        let entry = self
            .entries
            .get_mut(&frame.sensor)
            .ok_or_else(|| FrameError::UnknownSensor { sensor: frame.sensor.clone() })?;
        check_frame(&entry.spec, entry.last_stamp, frame)?;
        entry.last_stamp = Some(frame.stamp);
        Ok((entry.spec.clone(), frame.stamp.plus_seconds(entry.spec.time_offset_s)))
    }

    /// The sensor that moves the pose, once it is chosen.
    pub(crate) fn pose_sensor(&self) -> Option<&SensorId> {
        self.pose_sensor.as_ref()
    }

    /// Whether `id` is the sensor that moves the pose. Chosen once: the one asked for, else the best kind
    /// declared; if that one stays silent for a second, the sensor that does send. One of the same kind takes over from
    /// a chosen one that has gone silent: a sensor that was replaced, or declared anew.
    pub(crate) fn is_pose_sensor(&mut self, id: &SensorId, wanted: &str, stamp: Timestamp) -> bool {
        if let Some(chosen) = &self.pose_sensor {
            let may_take_over = || self.rank(id).is_some() && self.is_same_kind(chosen, id);
            if chosen != id && wanted.is_empty() && self.is_silent(chosen, stamp) && may_take_over() {
                self.pose_sensor = Some(id.clone());
                return true;
            }
            return chosen == id;
        }
        if !wanted.is_empty() {
            self.pose_sensor = (id.0 == wanted).then(|| id.clone());
            return id.0 == wanted;
        }
        let best = self.entries.keys().filter_map(|id| self.rank(id)).min();
        let waited = stamp.seconds_since(*self.first_frame.get_or_insert(stamp));
        let chosen = self.rank(id).is_some() && (self.rank(id) == best || waited > PATIENCE_S);
        if chosen {
            self.pose_sensor = Some(id.clone());
        }
        chosen
    }
}

impl Sensors {
    /// How well poses are found by it, lower is better; none where they are not.
    fn rank(&self, id: &SensorId) -> Option<u8> {
        let spec = &self.entries.get(id)?.spec;
        rank(spec.kind).filter(|_| spec.can_move_the_pose())
    }

    /// Whether a sensor has sent nothing for longer than one that is only late.
    fn is_silent(&self, id: &SensorId, now: Timestamp) -> bool {
        let last = self.entries.get(id).and_then(|e| Some(e.last_stamp?.plus_seconds(e.spec.time_offset_s)));
        last.is_none_or(|last| now.seconds_since(last) > SILENCE_S)
    }

    fn is_same_kind(&self, a: &SensorId, b: &SensorId) -> bool {
        let kind = |id| self.entries.get(id).map(|e: &Entry| e.spec.kind);
        kind(a).is_some() && kind(a) == kind(b)
    }
}

/// Lower is preferred; none for kinds that cannot carry the pose.
fn rank(kind: SensorKind) -> Option<u8> {
    match kind {
        SensorKind::Lidar3d => Some(0),
        SensorKind::Lidar2d => Some(1),
        SensorKind::Rgbd | SensorKind::Depth => Some(2),
        SensorKind::Camera => Some(3),
        SensorKind::Imu | SensorKind::Odometry => None,
    }
}

/// The frame as the odometry takes it; none for kinds without geometry.
pub(crate) fn scan_of(spec: &SensorSpec, data: &SensorData) -> Option<Scan> {
    let t_base_sensor = spec.t_base_sensor;
    match data {
        SensorData::Depth(depth) => Some(Scan::Depth(DepthScan {
            depth: Arc::new(depth.clone()),
            color: None,
            intrinsics: spec.intrinsics?,
            t_base_sensor,
        })),
        SensorData::Rgbd(depth, color) => Some(Scan::Depth(DepthScan {
            depth: Arc::new(depth.clone()),
            color: Some(Arc::new(color.clone())),
            intrinsics: spec.intrinsics?,
            t_base_sensor,
        })),
        SensorData::Cloud(cloud) => Some(Scan::Cloud(CloudScan { cloud: Arc::new(cloud.clone()), t_base_sensor })),
        SensorData::Scan(scan) => {
            let scan = Arc::new(if_not_of_strays(off_the_floor(scan, &t_base_sensor)).into_owned());
            Some(Scan::Planar(PlanarScan { scan, t_base_sensor }))
        }
        SensorData::Camera(image) => Some(Scan::Image(ImageScan {
            image: Arc::new(image.clone()),
            depth: None,
            second: None,
            intrinsics: spec.intrinsics?,
            t_base_sensor,
        })),
        SensorData::Imu(_) | SensorData::Odometry(_) => None,
    }
}
