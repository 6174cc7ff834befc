//! Clouds and planar scans to base, with the motion during the sweep undone.

use crate::inertial::Curve;
use crate::scan::PlanarScan;
use nalgebra::{Matrix3, Point3, Vector3, Vector6};
use percept_geometry::{PointCloud, Pose, se3};
use rayon::prelude::*;

/// Poses are computed for so many instants of a sweep: 100 ms in steps of 0.8 ms, 1 mm at 1.2 m/s.
const NUM_INSTANTS: usize = 128;
/// And where an IMU felt the motion, which may turn by 3 rad/s: 0.6 mrad.
const NUM_FELT_INSTANTS: usize = 512;

/// Points of `cloud` in base at the message's stamp, assuming base's constant `velocity` (m/s, rad/s),
/// on top of the motion that an IMU felt if it did.
///
/// Points without a return stay non-finite. Source: Vizzo et al., "KISS-ICP", 2023, section III-A.
pub(crate) fn to_base(
    cloud: &PointCloud,
    t_base_sensor: &Pose,
    velocity: &Vector6<f64>,
    curve: Option<&Curve>,
) -> Vec<Point3<f32>> {
    let offsets = cloud.time_offsets_s.as_ref().filter(|o| o.len() == cloud.len());
    let (min, max) = offsets.map_or((0.0, 0.0), |o| {
        o.iter().filter(|t| t.is_finite()).fold((0f32, 0f32), |(a, b), &t| (a.min(t), b.max(t)))
    });
    let at = |time: f64| {
        let felt = curve.map_or_else(Pose::identity, |c| c.at(time));
        let t = se3::exp(&(velocity * time)) * felt * t_base_sensor;
        (*t.rotation.to_rotation_matrix().matrix(), t.translation.vector)
    };
    let apply = |(r, t): &(Matrix3<f64>, Vector3<f64>), p: &Point3<f32>| {
        Point3::from((r * p.coords.cast::<f64>() + t).cast::<f32>())
    };
    let Some(offsets) = offsets.filter(|_| max > min && (curve.is_some() || velocity.norm() > 0.0)) else {
        let still = at(0.0);
        return cloud.positions.par_iter().with_min_len(4096).map(|p| apply(&still, p)).collect();
    };
    let num = if curve.is_some() { NUM_FELT_INSTANTS } else { NUM_INSTANTS };
    let step = (max - min) / (num - 1) as f32;
    let instants: Vec<_> = (0..num).map(|i| at(f64::from(min + step * i as f32))).collect();
    let nearest = |t: f32| (((t - min) / step).round() as usize).min(num - 1);
    cloud
        .positions
        .par_iter()
        .with_min_len(4096)
        .zip(offsets.par_iter())
        .map(|(p, &t)| apply(&instants[nearest(t)], p))
        .collect()
}

/// A planar scan whose beams were taken one after the other while base moved on at a constant velocity.
pub(crate) struct Sweep<'a> {
    scan: &'a PlanarScan,
    velocity: &'a Vector6<f64>,
    is_moving: bool,
}

impl<'a> Sweep<'a> {
    /// `velocity` is base's in base, m/s and rad/s.
    pub(crate) fn new(scan: &'a PlanarScan, velocity: &'a Vector6<f64>) -> Self {
        let is_moving = scan.scan.time_increment_s != 0.0 && velocity.norm() > 0.0;
        Self { scan, velocity, is_moving }
    }

    /// The end of a beam at a range (metres), in base as it was when the first beam was taken.
    pub(crate) fn end(&self, beam: usize, range: f64) -> Point3<f64> {
        let s = &self.scan.scan;
        let (sin, cos) = s.angle(beam).sin_cos();
        let p = self.scan.t_base_sensor * Point3::new(range * cos, range * sin, 0.0);
        if self.is_moving { se3::exp(&(self.velocity * (beam as f64 * s.time_increment_s))) * p } else { p }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_a_turning_sensor_come_back_to_where_they_were() {
        // A fixed point seen 0.1 s apart by a sensor that drives and turns.
        let velocity = Vector6::new(2.0, 0.5, 0.0, 0.0, 0.0, 1.0);
        let fixed = Point3::new(5.0, 3.0, 1.0);
        let offsets = [0.0f32, 0.05, 0.1, -0.03];
        let positions =
            offsets.iter().map(|&t| (se3::exp(&(velocity * f64::from(t))).inverse() * fixed).cast::<f32>()).collect();
        let cloud = PointCloud { positions, time_offsets_s: Some(offsets.to_vec()), ..PointCloud::default() };
        for p in to_base(&cloud, &Pose::identity(), &velocity, None) {
            // Half a step of the instants at 2 m/s and 1 rad/s over 6 m.
            assert!((p.cast::<f64>() - fixed).norm() < 0.005);
        }
    }
}
