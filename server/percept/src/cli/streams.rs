//! Which sensors of a recording are streamed.

use percept_geometry::{SensorData, SensorFrame, SensorId, SensorKind, SensorSpec};

/// A sensor that can be asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Stream {
    /// Depth and colour as one sensor.
    Rgbd,
    /// Depth without colour.
    Depth,
    /// Colour without depth.
    Camera,
    /// 3D lidar.
    Lidar3d,
    /// Planar lidar.
    Lidar2d,
    /// Wheels.
    Odometry,
    /// Inertial sensor.
    Imu,
}

impl Stream {
    fn kind(self) -> SensorKind {
        match self {
            Self::Rgbd => SensorKind::Rgbd,
            Self::Depth => SensorKind::Depth,
            Self::Camera => SensorKind::Camera,
            Self::Lidar3d => SensorKind::Lidar3d,
            Self::Lidar2d => SensorKind::Lidar2d,
            Self::Odometry => SensorKind::Odometry,
            Self::Imu => SensorKind::Imu,
        }
    }
}

/// What is streamed; none: all.
#[derive(Debug, Clone)]
pub(crate) struct Chosen(Option<Vec<SensorKind>>, bool);

impl Chosen {
    /// These, or all if none is named, with wheels or without.
    pub(crate) fn new(sensors: &[Stream], with_wheels: bool) -> Self {
        let kinds = (!sensors.is_empty()).then(|| sensors.iter().map(|s| s.kind()).collect());
        Self(kinds, with_wheels)
    }

    fn takes(&self, kind: SensorKind) -> bool {
        let named = self.0.as_ref().is_none_or(|kinds| kinds.contains(&kind));
        named && (self.1 || kind != SensorKind::Odometry)
    }

    /// What a sensor is streamed as: a depth camera with colour as one or both of its halves, if it is not wanted whole.
    /// Two halves are two sensors.
    fn parts(&self, id: &SensorId, kind: SensorKind) -> Vec<(SensorId, SensorKind)> {
        if kind != SensorKind::Rgbd || self.takes(kind) {
            return if self.takes(kind) { vec![(id.clone(), kind)] } else { vec![] };
        }
        match (self.takes(SensorKind::Camera), self.takes(SensorKind::Depth)) {
            (true, true) => {
                vec![(id.clone(), SensorKind::Camera), (SensorId(format!("{id}-depth")), SensorKind::Depth)]
            }
            (true, false) => vec![(id.clone(), SensorKind::Camera)],
            (false, true) => vec![(id.clone(), SensorKind::Depth)],
            (false, false) => vec![],
        }
    }

    /// The sensors as the session declares them.
    pub(crate) fn specs(&self, sensors: &[SensorSpec]) -> Vec<SensorSpec> {
        let of = |s: &SensorSpec| {
            let part = |(id, kind)| SensorSpec { id, kind, ..s.clone() };
            self.parts(&s.id, s.kind).into_iter().map(part).collect::<Vec<_>>()
        };
        sensors.iter().flat_map(of).collect()
    }

    /// What is streamed of a frame.
    pub(crate) fn frames(&self, frame: SensorFrame) -> Vec<SensorFrame> {
        let parts = self.parts(&frame.sensor, frame.data.kind());
        let SensorData::Rgbd(depth, color) = &frame.data else {
            return if parts.is_empty() { vec![] } else { vec![frame] };
        };
        let of = |(sensor, kind)| {
            let data = match kind {
                SensorKind::Camera => SensorData::Camera(color.clone()),
                SensorKind::Depth => SensorData::Depth(depth.clone()),
                _ => frame.data.clone(),
            };
            SensorFrame { sensor, stamp: frame.stamp, data }
        };
        parts.into_iter().map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::{DepthImage, RgbImage, Timestamp};

    fn kinds(chosen: &[SensorKind]) -> Vec<(String, SensorKind)> {
        let depth = DepthImage::new(1, 1, vec![1.0]).unwrap();
        let data = SensorData::Rgbd(depth, RgbImage::new(1, 1, vec![0; 3]).unwrap());
        let frame = SensorFrame { sensor: "camera".into(), stamp: Timestamp(0), data };
        let frames = Chosen((!chosen.is_empty()).then(|| chosen.to_vec()), true).frames(frame);
        frames.into_iter().map(|f| (f.sensor.0, f.data.kind())).collect()
    }

    #[test]
    fn a_depth_camera_with_colour_is_streamed_whole_or_by_its_halves() {
        let (camera, depth) = (SensorKind::Camera, SensorKind::Depth);
        assert_eq!(kinds(&[]), [("camera".to_owned(), SensorKind::Rgbd)]);
        assert_eq!(kinds(&[camera]), [("camera".to_owned(), camera)]);
        assert_eq!(kinds(&[depth]), [("camera".to_owned(), depth)]);
        assert_eq!(kinds(&[camera, depth]), [("camera".to_owned(), camera), ("camera-depth".to_owned(), depth)]);
        assert!(kinds(&[SensorKind::Lidar2d]).is_empty());
    }
}
