//! Covariance of the pose since the start of odom.
//!
//! A frame placed in a local model is as sure as the model plus one measurement: standing still, the
//! error does not grow. It grows with the way, as the model is renewed, by what was measured for the kind of
//! sensor ([`OdometryNoise`]), more along what the scene holds less. While lost, predictions
//! add up; placed again in the same model, what they added is gone. Along an axis that the scene leaves open the
//! prediction's errors add up as well: those of wheels with the way, those of a velocity that nobody measures with time.

use super::OdometryKind;
use super::noise::{OdometryNoise, way_m};
use crate::motion_noise;
use nalgebra::{Matrix3, Vector6};
use percept_geometry::{Covariance6, Pose, se3};

#[derive(Debug, Clone)]
pub(crate) struct Uncertainty {
    noise: OdometryNoise,
    /// Whether base moves in a plane: z, roll and pitch are assumed, and no drift is known of them.
    is_planar: bool,
    /// Of the local model where base is now.
    model: Covariance6,
    /// Of the predictions since the last placed frame.
    predicted: Covariance6,
    /// Motion since the last placed frame.
    since_placed: Pose,
    last: Covariance6,
    /// Axes that are open and unmeasured now: the standard deviation of the velocity, m/s and rad/s, and of the way that it
    /// has led to since the axis opened, metres and radians.
    unknown_velocity: Vector6<f64>,
    unknown_way: Vector6<f64>,
}

impl Uncertainty {
    pub(crate) fn new(kind: OdometryKind) -> Self {
        Self {
            noise: OdometryNoise::of(kind),
            is_planar: kind == OdometryKind::Lidar2d,
            model: Covariance6::zeros(),
            predicted: Covariance6::zeros(),
            since_placed: Pose::identity(),
            last: Covariance6::zeros(),
            unknown_velocity: Vector6::zeros(),
            unknown_way: Vector6::zeros(),
        }
    }

    pub(crate) fn covariance(&self) -> Covariance6 {
        symmetric(&self.last)
    }

    /// Along the axes of base that are `open` the frame that follows was put where a prediction was, `dt` seconds after the
    /// one before: by wheels where that is `measured`, else by a velocity that was never seen.
    pub(crate) fn filled_in(&mut self, open: &[bool; 6], measured: &[bool; 6], dt: f64) {
        for (k, &open) in open.iter().enumerate() {
            let (velocity, way) = (&mut self.unknown_velocity[k], &mut self.unknown_way[k]);
            if !open || measured[k] {
                (*velocity, *way) = (0.0, 0.0);
                continue;
            }
            *velocity = motion_noise::wandered(k, *velocity, dt);
            // Errors of one velocity add up; those of another time when the axis was open have nothing to do with it.
            let before = *way;
            *way += *velocity * dt;
            self.model[(k, k)] += *way * *way - before * before;
        }
    }

    /// Along the axes of base that are `open` inertia carried the pose on, by now to these variances, m^2 and rad^2.
    pub(crate) fn carried(&mut self, open: &[bool; 6], variances: &Vector6<f64>) {
        for k in 0..6 {
            let (velocity, way) = (&mut self.unknown_velocity[k], &mut self.unknown_way[k]);
            if !open[k] {
                (*velocity, *way) = (0.0, 0.0);
                continue;
            }
            // What it has led to so far is counted; what the velocity is, the IMU knows best.
            let before = if *velocity > 0.0 { *way } else { variances[k].sqrt() };
            (*velocity, *way) = (f64::MIN_POSITIVE, variances[k].sqrt());
            self.model[(k, k)] += (variances[k] - before * before).max(0.0);
        }
    }

    /// Axes of base along which the pose has become a guess: nothing has measured them for seconds.
    pub(crate) fn guessed(&self) -> [bool; 6] {
        std::array::from_fn(|k| self.unknown_way[k] > motion_noise::guessed_way(k))
    }

    /// A frame was placed `t_last_now` from the last estimate, with this covariance against the model. Along the axes of
    /// base that are `open` it was put where the prediction was.
    pub(crate) fn measured(&mut self, t_last_now: &Pose, covariance: &Covariance6, open: &[bool; 6]) -> Covariance6 {
        let t_placed_now = self.since_placed * t_last_now;
        let way_m = way_m(t_placed_now.translation.vector.norm(), t_placed_now.rotation.angle());
        let grown = self.growth(way_m, covariance, open);
        self.model = se3::compose_covariance(&self.model, &t_placed_now, &grown);
        let step = se3::log(t_last_now);
        for k in (0..6).filter(|&k| open[k]) {
            self.model[(k, k)] += motion_noise::by_wheels(k, step[k]);
        }
        self.last = self.model + covariance;
        self.predicted = Covariance6::zeros();
        self.since_placed = Pose::identity();
        self.covariance()
    }

    /// What the way adds along the axes that the scene holds: as the kind's noise has it in the geometric mean, and in the shape of
    /// a measurement's `covariance`.
    fn growth(&self, way_m: f64, covariance: &Covariance6, open: &[bool; 6]) -> Covariance6 {
        // What comes of guesses, and of predictions along open axes, is counted apart.
        let is_held = |k: usize| {
            let is_assumed = self.is_planar && (2..5).contains(&k);
            !open[k] && !is_assumed && self.unknown_velocity[k] <= 0.0
        };
        let mut grown = Covariance6::zeros();
        for (first, growth) in [(0, self.noise.position), (3, self.noise.rotation)] {
            let held = |i: usize, j: usize| is_held(first + i) && is_held(first + j);
            let shape = Matrix3::from_fn(|i, j| if held(i, j) { covariance[(first + i, first + j)] } else { 0.0 });
            let spread = shape.symmetric_eigenvalues();
            let known: Vec<f64> = spread.iter().copied().filter(|v| *v > f64::EPSILON * spread.max()).collect();
            let mean = (known.iter().map(|v| v.ln()).sum::<f64>() / known.len() as f64).exp();
            if mean.is_normal() {
                let scaled = shape * (growth.per_root_m.powi(2) * way_m / mean);
                grown.fixed_view_mut::<3, 3>(first, first).copy_from(&scaled);
            }
        }
        grown
    }

    /// A frame was not placed; its pose is a prediction.
    pub(crate) fn predicted(&mut self, t_last_now: &Pose, covariance: &Covariance6) {
        self.last = se3::compose_covariance(&self.last, t_last_now, covariance);
        self.predicted = se3::compose_covariance(&self.predicted, t_last_now, covariance);
        self.since_placed *= t_last_now;
    }

    /// A new local model starts where base is believed to be.
    pub(crate) fn restarted(&mut self) {
        (self.unknown_velocity, self.unknown_way) = (Vector6::zeros(), Vector6::zeros());
        self.model = se3::compose_covariance(&self.model, &self.since_placed, &self.predicted);
        self.last = self.model;
        self.predicted = Covariance6::zeros();
        self.since_placed = Pose::identity();
    }
}

fn symmetric(c: &Covariance6) -> Covariance6 {
    (c + c.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::covariance::diagonal;

    const FIXED: &[bool; 6] = &[false; 6];

    #[test]
    fn along_an_open_axis_the_error_grows_with_the_way() {
        let mut u = Uncertainty::new(OdometryKind::Lidar3d);
        let open = [true, false, false, false, false, false];
        for _ in 0..400 {
            u.measured(&se3::from_xy_yaw(0.06, 0.0, 0.0), &diagonal(1e-3, 1e-5), &open);
        }
        let (along, across) = (u.covariance()[(0, 0)].sqrt(), u.covariance()[(1, 1)].sqrt());
        // Across the way the heading's drift adds to it.
        assert!((along - 0.065 * 24f64.sqrt()).abs() < 0.01 && across < 0.1, "{along} {across}");
        u.measured(&Pose::identity(), &diagonal(1e-3, 1e-5), &open);
        assert!((u.covariance()[(0, 0)].sqrt() - along).abs() < 1e-3);
    }

    #[test]
    fn along_an_open_axis_that_nothing_measures_the_error_grows_with_time() {
        let mut u = Uncertainty::new(OdometryKind::Lidar3d);
        let open = [true, false, false, false, false, false];
        for _ in 0..250 {
            u.filled_in(&open, FIXED, 0.1);
            u.measured(&Pose::identity(), &diagonal(1e-3, 1e-5), &open);
        }
        // The velocity's standard deviation is a square root of time: two thirds of 0.3 t^1.5 after 25 s.
        let (along, across) = (u.covariance()[(0, 0)].sqrt(), u.covariance()[(1, 1)].sqrt());
        assert!((along - 25.0).abs() < 0.5 && across < 0.02, "{along} {across}");
        assert_eq!(u.guessed(), open);
        u.filled_in(FIXED, FIXED, 0.1);
        assert_eq!(u.guessed(), *FIXED);
        let fixed = u.measured(&Pose::identity(), &diagonal(1e-3, 1e-5), FIXED)[(0, 0)].sqrt();
        assert!((fixed - along).abs() < 0.01, "{fixed}");
    }

    #[test]
    fn an_axis_that_opens_for_moments_adds_independent_errors() {
        let mut u = Uncertainty::new(OdometryKind::Lidar3d);
        for _ in 0..100 {
            for open in [[true, false, false, false, false, false], *FIXED] {
                u.filled_in(&open, FIXED, 0.1);
                u.measured(&Pose::identity(), &diagonal(1e-3, 1e-5), &open);
            }
        }
        // A tenth of a second at 0.3 sqrt(0.1) m/s, a hundred times over.
        let along = u.covariance()[(0, 0)].sqrt();
        assert!((along - 10.0 * 0.1 * 0.3 * 0.1f64.sqrt()).abs() < 1e-4, "{along}");
    }

    #[test]
    fn what_the_scene_holds_less_drifts_more() {
        let mut u = Uncertainty::new(OdometryKind::Lidar3d);
        let mut corridor = diagonal(1e-3, 1e-3);
        corridor[(0, 0)] = 1e-4;
        for _ in 0..100 {
            u.measured(&se3::from_xy_yaw(0.1, 0.0, 0.0), &corridor, FIXED);
        }
        let c = u.covariance() - corridor;
        let noise = OdometryNoise::of(OdometryKind::Lidar3d);
        // Variances as 100 to 1 to 1, a mean as the noise has it.
        let mean = 10.0 * noise.position.per_root_m.powi(2);
        assert!((c[(0, 0)] / (mean * 100f64.powf(2.0 / 3.0)) - 1.0).abs() < 1e-6, "{c}");
    }

    #[test]
    fn a_planar_lidar_knows_of_no_drift_out_of_its_plane() {
        let mut u = Uncertainty::new(OdometryKind::Lidar2d);
        for _ in 0..100 {
            u.measured(&se3::from_xy_yaw(0.1, 0.0, 0.0), &diagonal(1e-3, 1e-3), FIXED);
        }
        let c = u.covariance();
        assert!(c[(2, 2)] < 1.1e-6 && c[(3, 3)] < 1.1e-6 && c[(5, 5)] > 1e-5, "{c}");
    }

    #[test]
    fn error_grows_with_motion_and_loss_but_not_with_time() {
        let mut u = Uncertainty::new(OdometryKind::Lidar3d);
        let one = diagonal(0.01, 0.01);
        let still = u.measured(&Pose::identity(), &one, FIXED);
        for _ in 0..1000 {
            u.measured(&Pose::identity(), &one, FIXED);
        }
        assert!((u.covariance() - still).norm() < 1e-12);
        for _ in 0..100 {
            u.measured(&se3::from_xy_yaw(0.1, 0.0, 0.0), &one, FIXED);
        }
        // Ten metres, and one measurement; across the way the heading's errors add to it.
        let (moved, noise) = (u.covariance(), OdometryNoise::of(OdometryKind::Lidar3d));
        let expected = 10.0 * noise.position.per_root_m.powi(2) + 1e-4;
        assert!((moved[(0, 0)] / expected - 1.0).abs() < 1e-6 && moved[(1, 1)] > moved[(0, 0)]);
        u.predicted(&Pose::identity(), &diagonal(0.5, 0.5));
        assert!(u.covariance()[(0, 0)] > 0.25);
        assert!((u.measured(&Pose::identity(), &one, FIXED) - moved).norm() < 1e-9);
        u.predicted(&Pose::identity(), &diagonal(0.5, 0.5));
        u.restarted();
        assert!(u.measured(&Pose::identity(), &one, FIXED)[(0, 0)] > 0.25);
    }
}
