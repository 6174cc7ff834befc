//! When a frame becomes a keyframe, and what of it is kept.

mod depth;
mod features;

use crate::color_camera::ColorCamera;
use crate::deskew::Sweep;
use crate::downsample::Thinner;
use crate::inertial::Curve;
use crate::param_error::{ParamError, check_range};
use crate::scan::{CloudScan, PlanarScan, Scan};
pub(crate) use depth::FULL_WIDTH;
use depth::depth_hits;
use nalgebra::Point3;
use percept_geometry::cloud::Beam;
use percept_geometry::{FeatureMethod, KeyframeScan, PointCloud, Pose, SensorId, Timestamp, Voxel, cloud};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// When a frame becomes a keyframe, and how much of it is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeyframeParams {
    /// A keyframe at least every so many metres, 0.01 to 100. Smaller: denser maps, more memory.
    pub distance_m: f64,
    /// A keyframe at least every so many radians of turning, 0.01 to pi.
    pub angle_rad: f64,
    /// Keep every n-th row and column of a depth image 640 or more pixels wide, 1 to 64; of a narrower one fewer are left out, in
    /// proportion, so that it shows surfaces as finely.
    pub depth_stride_px: usize,
    /// Depth beyond this is not kept, metres, 0.1 to 100: noise grows with the square of the depth.
    pub max_depth_m: f64,
    /// Keep about one lidar point per voxel of this edge, metres, 0.01 to 10.
    pub voxel_size_m: f64,
    /// A beam without a return frees space up to here, metres, 0.1 to 1000.
    pub free_range_m: f64,
    /// What depth cameras with colour know places by: orb, or sift, which is steadier and takes eight times as long for each
    /// keyframe. A camera without depth always uses orb: it knows places by the points that it tracks.
    pub features: FeatureMethod,
}

impl Default for KeyframeParams {
    fn default() -> Self {
        Self {
            distance_m: 0.5,
            angle_rad: 0.35,
            depth_stride_px: 4,
            max_depth_m: 10.0,
            voxel_size_m: 0.1,
            free_range_m: 10.0,
            features: FeatureMethod::Orb,
        }
    }
}

impl KeyframeParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`ParamError`] with field, value and remedy.
    pub fn validate(&self) -> Result<(), ParamError> {
        let pi = std::f64::consts::PI;
        check_range("keyframe.distance_m", self.distance_m, (0.01, 100.0), "within 0.01 to 100", "use 0.5")?;
        check_range("keyframe.angle_rad", self.angle_rad, (0.01, pi), "within 0.01 to pi", "use 0.35")?;
        let stride = self.depth_stride_px as f64;
        check_range("keyframe.depth_stride_px", stride, (1.0, 64.0), "within 1 to 64", "use 4")?;
        check_range("keyframe.max_depth_m", self.max_depth_m, (0.1, 100.0), "within 0.1 to 100", "use 10")?;
        check_range("keyframe.voxel_size_m", self.voxel_size_m, (0.01, 10.0), "within 0.01 to 10", "use 0.1")?;
        check_range("keyframe.free_range_m", self.free_range_m, (0.1, 1000.0), "within 0.1 to 1000", "use 10")
    }
}

/// Decides which frames become keyframes: those that moved or turned far enough from the last one.
#[derive(Debug, Clone)]
pub struct KeyframePolicy {
    params: KeyframeParams,
    t_odom_last: Option<Pose>,
}

impl KeyframePolicy {
    /// No keyframe yet: the first pose considered becomes one.
    pub fn new(params: KeyframeParams) -> Self {
        Self { params, t_odom_last: None }
    }

    /// Goes on with other distances.
    pub fn set_params(&mut self, params: KeyframeParams) {
        self.params = params;
    }

    /// Goes on from a keyframe made before a restart.
    pub fn resume(&mut self, t_odom_base_last: &Pose) {
        self.t_odom_last = Some(*t_odom_base_last);
    }

    /// Whether the frame at this pose becomes a keyframe; if so it is the one to move away from next.
    pub fn consider(&mut self, t_odom_base: &Pose) -> bool {
        let far = self.t_odom_last.is_none_or(|last| {
            let t_last_now = last.inverse() * t_odom_base;
            t_last_now.translation.vector.norm() >= self.params.distance_m
                || t_last_now.rotation.angle() >= self.params.angle_rad
        });
        if far {
            self.t_odom_last = Some(*t_odom_base);
        }
        far
    }
}

/// How base moved while a scan was taken.
#[derive(Debug, Clone, Default)]
pub(crate) struct SweepMotion {
    /// Base's, m/s and rad/s, on top of the curve if there is one.
    pub(crate) velocity: nalgebra::Vector6<f64>,
    /// As an IMU felt it.
    pub(crate) curve: Option<Arc<Curve>>,
}

/// What a keyframe keeps of its scan: ends of beams in base, thinned, and free beams of a planar scan.
///
/// `velocity` is base's (m/s, rad/s) for undoing the motion during a lidar's sweep.
pub fn keyframe_scan(
    params: &KeyframeParams,
    stamp: Timestamp,
    sensor: &SensorId,
    scan: &Scan,
    velocity: &nalgebra::Vector6<f64>,
) -> KeyframeScan {
    let motion = SweepMotion { velocity: *velocity, curve: None };
    keyframe_scan_seen_by(params, stamp, sensor, scan, &motion, None)
}

/// The same, with the colour camera where an odometry has found it to be.
pub(crate) fn keyframe_scan_seen_by(
    params: &KeyframeParams,
    stamp: Timestamp,
    sensor: &SensorId,
    scan: &Scan,
    motion: &SweepMotion,
    color: Option<ColorCamera>,
) -> KeyframeScan {
    let features = match scan {
        Scan::Depth(s) => features::of(params.features, s, color).map(Arc::new),
        Scan::Cloud(_) | Scan::Planar(_) | Scan::Image(_) => None,
    };
    KeyframeScan { features, ..ends_of(params, stamp, sensor, scan, motion) }
}

/// Where the beams of a scan end, thinned as a keyframe's, to be worked out when it is wanted; the same every time. Work runs on the
/// current rayon pool.
pub type LaterScan = Arc<dyn Fn() -> KeyframeScan + Send + Sync>;

/// As [`keyframe_scan`], without what places are known by, when it is wanted.
pub fn ends_later(
    params: &KeyframeParams,
    stamp: Timestamp,
    sensor: &SensorId,
    scan: &Scan,
    velocity: &nalgebra::Vector6<f64>,
) -> LaterScan {
    later(params, (stamp, sensor, scan), SweepMotion { velocity: *velocity, curve: None })
}

pub(crate) fn later(
    params: &KeyframeParams,
    (stamp, sensor, scan): (Timestamp, &SensorId, &Scan),
    motion: SweepMotion,
) -> LaterScan {
    let (params, sensor, scan) = (params.clone(), sensor.clone(), scan.clone());
    Arc::new(move || ends_of(&params, stamp, &sensor, &scan, &motion))
}

/// A keyframe's scan without what places are known by.
fn ends_of(
    params: &KeyframeParams,
    stamp: Timestamp,
    sensor: &SensorId,
    scan: &Scan,
    motion: &SweepMotion,
) -> KeyframeScan {
    let (hits, misses) = match scan {
        Scan::Depth(s) => (depth_hits(params, s), vec![]),
        Scan::Cloud(s) => (cloud_hits(params, s, motion), vec![]),
        Scan::Planar(s) => planar_ends(params, s, &motion.velocity),
        // What a camera saw is known only with its map: see `Odometry::keyframe_scan`.
        Scan::Image(_) => (PointCloud::default(), vec![]),
    };
    KeyframeScan {
        stamp,
        sensor: sensor.clone(),
        t_base_sensor: *scan.t_base_sensor(),
        hits,
        misses,
        base_height_m: 0.0,
        planar: matches!(scan, Scan::Planar(_)),
        features: None,
    }
}

fn cloud_hits(params: &KeyframeParams, s: &CloudScan, motion: &SweepMotion) -> PointCloud {
    let curve = motion.curve.as_deref();
    let in_base = crate::deskew::to_base(&s.cloud, &s.t_base_sensor, &motion.velocity, curve);
    let is_usable = |&i: &u32| {
        let p = &in_base[i as usize];
        cloud::is_finite(&s.cloud.positions[i as usize]) && Voxel::containing(&p.cast(), params.voxel_size_m).is_some()
    };
    let usable: Vec<u32> = (0..in_base.len() as u32).filter(is_usable).collect();
    let keep = Thinner::default().even(&in_base, &usable, params.voxel_size_m);
    let keep: Vec<usize> = keep.into_iter().map(|i| i as usize).collect();
    let mut hits = PointCloud {
        positions: in_base,
        colors: s.cloud.colors.clone(),
        intensities: s.cloud.intensities.clone(),
        ..PointCloud::default()
    };
    if hits.validate().is_err() {
        (hits.colors, hits.intensities) = (None, None);
    }
    hits.select(&keep)
}

fn planar_ends(
    params: &KeyframeParams,
    s: &PlanarScan,
    velocity: &nalgebra::Vector6<f64>,
) -> (PointCloud, Vec<Point3<f32>>) {
    let sweep = Sweep::new(s, velocity);
    let (mut hits, mut misses) = (vec![], vec![]);
    for (i, beam) in s.scan.echoes() {
        match beam {
            Beam::Hit(r) => hits.push(sweep.end(i, f64::from(r)).cast()),
            Beam::Free(r) => misses.push(sweep.end(i, f64::from(r).min(params.free_range_m)).cast()),
            Beam::Invalid => {}
        }
    }
    (PointCloud::from_positions(hits), misses)
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::{LaserScan, se3};

    #[test]
    fn a_keyframe_comes_with_distance_or_turning() {
        let mut policy = KeyframePolicy::new(KeyframeParams::default());
        let at = |x, yaw| se3::from_xy_yaw(x, 0.0, yaw);
        let decisions: Vec<bool> = [at(0.0, 0.0), at(0.4, 0.0), at(0.6, 0.0), at(0.6, 0.3), at(0.6, 0.4), at(0.7, 0.4)]
            .iter()
            .map(|t| policy.consider(t))
            .collect();
        assert_eq!(decisions, [true, false, true, false, true, false]);
    }

    #[test]
    fn beams_without_return_free_space_only_up_to_the_maps_range() {
        let scan = LaserScan {
            angle_min_rad: 0.0,
            angle_increment_rad: 0.5,
            range_min_m: 0.0,
            range_max_m: 80.0,
            time_increment_s: 0.0,
            ranges_m: vec![2.0, f32::INFINITY, f32::NAN, 0.0, 80.0, 81.9],
            intensities: None,
            later_echoes_m: vec![],
        };
        let scan = Scan::Planar(PlanarScan { scan: Arc::new(scan), t_base_sensor: se3::from_xy_yaw(1.0, 0.0, 0.0) });
        let kept = keyframe_scan(
            &KeyframeParams::default(),
            Timestamp(0),
            &"laser".into(),
            &scan,
            &nalgebra::Vector6::zeros(),
        );
        assert_eq!(kept.hits.positions, [Point3::new(3.0, 0.0, 0.0)]);
        assert_eq!(kept.misses.len(), 3);
        for miss in &kept.misses {
            assert!(((miss - Point3::new(1.0, 0.0, 0.0)).norm() - 10.0).abs() < 1e-5);
        }
        assert!(kept.planar);
    }
}
