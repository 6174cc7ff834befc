//! How far a body is off after a motion that no scan measured: one model of what hands, robots and wheels do, asked by all who need
//! to know. How far those are off that scans do measure is told by [`crate::OdometryNoise`].
//!
//! The numbers come from recordings, by `evaluate carmen|kitti-tracking|handheld` (examples of this crate), which print how far
//! velocities differ that lie a time apart, and how far poses are off that go on with the velocity before. Root mean squares of an axis:
//!
//! | seconds apart | Intel's robot | lidar in a hand | car |
//! | --- | --- | --- | --- |
//! | 0.5: m/s/sqrt(s), rad/s/sqrt(s) | 0.56, 0.73 | 0.48, 0.35 | 0.20, 0.06 |
//! | 2 | 0.33, 0.44 | 0.38, 0.20 | |
//! | 5 | 0.26, 0.34 | 0.25, 0.14 | |
//! | 0.5: m/s^2, rad/s^2 | 1.4, 1.6 | 0.9, 1.0 | 0.4, 0.13 |
//! | 1 | 0.7, 0.7 | 0.5, 0.4 | 0.2, 0.06 |

use percept_geometry::Covariance6;

/// How fast the velocity of what is carried or bumps along may change, m/s^2 and rad/s^2: what predictions and sweeps
/// allow for. Four and eight times the hand's root mean square over half a second, as a hand that begins to move
/// exceeds its mean by far. Halved and doubled in sweeps, recordings are the same (`evaluate handheld`,
/// `kitti-tracking`).
pub(crate) const HANDS: (f64, f64) = (4.0, 8.0);
/// The same of what drives in a plane: Intel's robot over half to one second, and twice that for turns, as it turns on
/// the spot.
pub(crate) const WHEELED: (f64, f64) = (1.5, 4.0);
/// Of both, one standard deviation over half a second: the middle of the table's figures.
const USUAL: (f64, f64) = (1.0, 2.0);

/// How the velocity may wander along an axis that nothing measures, m/s / sqrt(s) and rad/s / sqrt(s): a robot that
/// drives off is noticed by nothing. Positions: the table's figures of 2 to 5 s. Turns: less than there, as what a
/// scene leaves open is seldom the axis that a robot turns about: `evaluate lidar-sim rosette seconds=30` tells of 0.90
/// degrees with 0.1 and 2.06 with 0.3, and is off by 0.74.
const WANDERS: (f64, f64) = (0.3, 0.1);

/// Where nothing told the motion for so long, seconds, a pose is a guess. An accelerometer that is off by 0.05 m/s^2 has led 0.6 m
/// astray by then, a velocity that nobody measures 2.2 m.
pub(crate) const GUESSED_AFTER_S: f64 = 5.0;

/// What is known of the way over a gap that nothing measured, standard deviations in metres and radians: nothing,
/// beside what finds the robot again, which is good to 0.1 m and 0.05 rad; and not less than that, so
/// that the graph's numbers stay within six decimals of each other. `planar_log lidar2d-csail --no-odometry --blind
/// 0.1,20` is the same halved and doubled.
pub(crate) const OVER_GAP: (f64, f64) = (10.0, 3.0);

/// What wheels are off by along one axis: m / sqrt(m) and rad / sqrt(rad). Intel's (`evaluate carmen intel.clf`) are
/// off by 0.092 m and 0.080 rad after ways of 1 m, in which they turned by 1.05 rad: two axes and one. With 0.02 rad
/// the rosette of [`WANDERS`] tells of 0.90 degrees, with 0.08 of 1.00.
const WHEELS: (f64, f64) = (0.065, 0.08);

/// Standard deviations of position (m) and orientation (rad) of an axis, of a pose that lies between two frames `gap_s` apart and was
/// interpolated: a constant acceleration bends the way by an eighth of it times the square of the time.
pub fn interpolated(gap_s: f64) -> (f64, f64) {
    accelerated(0.125 * gap_s * gap_s)
}

/// The same of one that goes on for `ahead_s` with a velocity taken over the `gap_s` before, which is that of its middle.
pub fn extrapolated(ahead_s: f64, gap_s: f64) -> (f64, f64) {
    accelerated(0.5 * ahead_s * (ahead_s + gap_s))
}

fn accelerated(seconds2: f64) -> (f64, f64) {
    (USUAL.0 * seconds2, USUAL.1 * seconds2)
}

/// The standard deviation of the velocity along an axis that nothing measures (the first three are positions), `dt_s` seconds after it
/// was `sigma`, m/s or rad/s.
pub(crate) fn wandered(axis: usize, sigma: f64, dt_s: f64) -> f64 {
    let rate = if axis < 3 { WANDERS.0 } else { WANDERS.1 };
    (sigma * sigma + rate * rate * dt_s).sqrt()
}

/// How far a velocity that nobody measures has led along an axis when a pose has become a guess, metres or radians: the velocity's
/// standard deviation is rate * sqrt(t), and its way 2/3 rate * t^(3/2).
pub(crate) fn guessed_way(axis: usize) -> f64 {
    let rate = if axis < 3 { WANDERS.0 } else { WANDERS.1 };
    2.0 / 3.0 * rate * GUESSED_AFTER_S.powf(1.5)
}

/// The variance that wheels add along an axis that the scene leaves open, m^2 or rad^2, by a step along it.
pub(crate) fn by_wheels(axis: usize, step: f64) -> f64 {
    let rate = if axis < 3 { WHEELS.0 } else { WHEELS.1 };
    rate * rate * step.abs()
}

/// What wheels of an unknown make that say nothing of themselves may be off by: 2 cm and 10 % of the way, 10 mrad, 10 % of the turn and
/// 50 mrad a metre. `way_m` and `turned_rad` are all that was driven and turned. Wide enough for skid-steered robots, and for Intel's
/// (57 mrad a metre, all to one side); the scans decide within it.
pub fn unknown_wheels(way_m: f64, turned_rad: f64) -> Covariance6 {
    let t = 0.02 + 0.1 * way_m;
    let r = 0.01 + 0.1 * turned_rad + 0.05 * way_m;
    Covariance6::from_diagonal(&[t, t, t, r, r, r].map(|sigma| sigma * sigma).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_velocity_that_nobody_measures_leads_as_far_as_a_guess_in_the_time_that_makes_one() {
        for axis in [0, 5] {
            let (mut velocity, mut way) = (0.0, 0.0);
            for _ in 0..5000 {
                velocity = wandered(axis, velocity, 1e-3);
                way += velocity * 1e-3;
            }
            assert!((way / guessed_way(axis) - 1.0).abs() < 1e-2, "{way}");
        }
    }

    #[test]
    fn a_pose_ahead_of_frames_is_less_sure_than_one_between_them() {
        let is = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).hypot(a.1 - b.1) < 1e-12;
        assert!(is(interpolated(0.4), (0.02, 0.04)));
        assert!(is(extrapolated(0.2, 0.2), (0.04, 0.08)));
        assert!(is(extrapolated(0.0, 0.2), (0.0, 0.0)));
    }
}
