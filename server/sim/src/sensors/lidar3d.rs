//! A 3D lidar: spinning rings, or a rosette that never repeats.

use super::{Scene, check_rate, check_share, mount};
use crate::rng::{Purpose, stream};
use crate::{SimError, check};
use nalgebra::{Point3, Vector3};
use percept_geometry::{PointCloud, Pose, SensorData};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// How the beams move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScanPattern {
    /// `rings` beams that turn about z, counter-clockwise, from behind.
    Spinning,
    /// One beam bent by two prisms that turn at rates without a common period, about x.
    Rosette,
}

/// A 3D lidar and its faults.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Lidar3dParams {
    /// Sweeps a second; each lasts the whole period and is stamped with its beginning.
    pub rate_hz: f64,
    /// How the beams move.
    pub pattern: ScanPattern,
    /// Beams above each other, 1 to 128 (spinning).
    pub rings: usize,
    /// Directions a turn, 16 to 8192 (spinning).
    pub columns: usize,
    /// Elevation of the lowest beam, radians (spinning).
    pub elevation_min_rad: f64,
    /// Elevation of the highest beam, radians (spinning).
    pub elevation_max_rad: f64,
    /// Points a sweep, up to 1,000,000 (rosette).
    pub rosette_points: usize,
    /// Half angle of the cone that is seen, radians, 0.05 to 1.5 (rosette).
    pub rosette_half_angle_rad: f64,
    /// Nearest range measured, metres.
    pub range_min_m: f64,
    /// Farthest range measured, metres.
    pub range_max_m: f64,
    /// Standard deviation of range, metres.
    pub range_noise_m: f64,
    /// Share of beams without return for no reason.
    pub dropout_rate: f64,
    /// Whether each column is taken where the robot is at its own time, as in a real sweep.
    pub motion_distortion: bool,
    /// Height over the floor, metres, 0.05 to 2.5.
    pub height_m: f64,
}

impl Default for Lidar3dParams {
    fn default() -> Self {
        Self {
            rate_hz: 10.0,
            pattern: ScanPattern::Spinning,
            rings: 16,
            columns: 1800,
            elevation_min_rad: -15f64.to_radians(),
            elevation_max_rad: 15f64.to_radians(),
            rosette_points: 20_000,
            rosette_half_angle_rad: 0.6,
            range_min_m: 0.4,
            range_max_m: 50.0,
            range_noise_m: 0.02,
            dropout_rate: 0.005,
            motion_distortion: true,
            height_m: 0.8,
        }
    }
}

impl Lidar3dParams {
    /// Sensor to base.
    pub fn t_base_sensor(&self) -> Pose {
        mount(0.0, self.height_m, 0.0, 0.0)
    }

    /// Checks bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), SimError> {
        check_rate(self.rate_hz)?;
        check("rings", self.rings as f64, 1.0, 128.0, "between 1 and 128")?;
        check("columns", self.columns as f64, 16.0, 8192.0, "between 16 and 8192")?;
        check("elevation_min_rad", self.elevation_min_rad, -1.5, 1.5, "between -1.5 and 1.5")?;
        let low = self.elevation_min_rad;
        check("elevation_max_rad", self.elevation_max_rad, low, 1.5, "between elevation_min_rad and 1.5")?;
        check("rosette_points", self.rosette_points as f64, 1.0, 1e6, "between 1 and 1,000,000")?;
        check("rosette_half_angle_rad", self.rosette_half_angle_rad, 0.05, 1.5, "between 0.05 and 1.5")?;
        check("range_min_m", self.range_min_m, 0.0, 100.0, "between 0 and 100")?;
        check("range_max_m", self.range_max_m, self.range_min_m, 1000.0, "between range_min_m and 1000")?;
        check("range_noise_m", self.range_noise_m, 0.0, 1.0, "between 0 and 1")?;
        check_share("dropout_rate", self.dropout_rate)?;
        check("height_m", self.height_m, 0.05, 2.5, "between 0.05 and 2.5")
    }

    /// Groups of beams that share a time, and beams in a group.
    fn shape(&self) -> (usize, usize) {
        match self.pattern {
            ScanPattern::Spinning => (self.columns, self.rings),
            // A few points share a pose: within 50 microseconds the robot moves less than a tenth of a millimetre.
            ScanPattern::Rosette => (self.rosette_points.div_ceil(8), 8),
        }
    }

    /// Direction of a beam in the sensor frame, unit length; `t_s` counts from the start of the drive.
    fn direction(&self, column: usize, ring: usize, t_s: f64) -> Vector3<f64> {
        match self.pattern {
            ScanPattern::Spinning => {
                let share = if self.rings > 1 { ring as f64 / (self.rings - 1) as f64 } else { 0.5 };
                let elevation = self.elevation_min_rad + share * (self.elevation_max_rad - self.elevation_min_rad);
                let azimuth = -PI + TAU * column as f64 / self.columns as f64;
                let (sin, cos) = azimuth.sin_cos();
                Vector3::new(elevation.cos() * cos, elevation.cos() * sin, elevation.sin())
            }
            ScanPattern::Rosette => {
                // Two prisms at 121.7 and -77.3 turns a second: petals that move on with every sweep.
                let (a, b) = (TAU * 121.7 * t_s, -TAU * 77.3 * t_s);
                let half = 0.5 * self.rosette_half_angle_rad;
                let (left, up) = (half * (a.cos() + b.cos()), half * (a.sin() + b.sin()));
                let bend = left.hypot(up);
                let s = if bend > 1e-12 { bend.sin() / bend } else { 1.0 };
                Vector3::new(bend.cos(), left * s, up * s)
            }
        }
    }
}

/// A return in the sensor frame at its own time.
struct Return {
    position: Point3<f32>,
    intensity: f32,
    offset_s: f32,
}

/// The sweep number `frame` that begins at `t_s`. Beams without return are left out; points are
/// ordered by time, then by ring, each in the sensor frame of its own time.
pub(crate) fn sweep(params: &Lidar3dParams, scene: &Scene<'_>, frame: u64, t_s: f64) -> SensorData {
    let (columns, rings) = params.shape();
    let period = 1.0 / params.rate_hz;
    let groups: Vec<Vec<Return>> = (0..columns)
        .into_par_iter()
        .with_min_len(16)
        .map(|column| {
            let offset = period * column as f64 / columns as f64;
            let pose_time = if params.motion_distortion { t_s + offset } else { t_s };
            let t_world_sensor = scene.drive.pose_at(pose_time) * params.t_base_sensor();
            let view = scene.world.view(pose_time);
            let mut rng = stream(scene.seed, Purpose::Lidar3d, frame, column as u64);
            let origin = Point3::from(t_world_sensor.translation.vector);
            let mut out = Vec::with_capacity(rings);
            for ring in 0..rings {
                let beam_offset = offset + period * ring as f64 / (columns * rings) as f64;
                let beam_time = if params.pattern == ScanPattern::Rosette { t_s + beam_offset } else { pose_time };
                let direction = params.direction(column, ring, beam_time);
                let world_direction = t_world_sensor.rotation * direction;
                let Some((range, solid)) = view.cast(&origin, &world_direction, params.range_max_m) else { continue };
                let (normal, color) = solid.appearance(&(origin + world_direction * range));
                let cos = normal.dot(&world_direction).abs();
                let Some(range) = measure(params, range, cos, &mut rng) else { continue };
                let luma = f64::from(0.299 * color[0] + 0.587 * color[1] + 0.114 * color[2]);
                out.push(Return {
                    position: Point3::from((direction * range).cast::<f32>()),
                    intensity: (luma * cos) as f32,
                    offset_s: offset as f32,
                });
            }
            out
        })
        .collect();
    let returns = || groups.iter().flatten();
    SensorData::Cloud(PointCloud {
        positions: returns().map(|r| r.position).collect(),
        intensities: Some(returns().map(|r| r.intensity).collect()),
        time_offsets_s: Some(returns().map(|r| r.offset_s).collect()),
        ..PointCloud::default()
    })
}

/// Range with noise, metres; none where nothing comes back.
fn measure(params: &Lidar3dParams, range: f64, cos_incidence: f64, rng: &mut impl Rng) -> Option<f64> {
    // Below about 3 degrees to the surface too little light returns.
    if rng.random_range(0.0..1.0) < params.dropout_rate || cos_incidence < 0.05 {
        return None;
    }
    let gauss: f64 = StandardNormal.sample(rng);
    let noisy = range + params.range_noise_m * gauss;
    (range >= params.range_min_m && noisy > 0.0 && noisy <= params.range_max_m).then_some(noisy)
}
