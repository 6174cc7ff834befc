//! What views say of a robot that was found, as it drives on.

use super::*;
use percept_geometry::{PointCloud, se3};

/// A robot that was found where it sees 3 m in every direction, half a metre of the way between views.
struct Robot {
    probation: Probation,
    way_m: f64,
}

impl Robot {
    fn found() -> Self {
        let around =
            |i: i32| Point3::new(3.0 * (f64::from(i) * 0.1).cos() as f32, 3.0 * (f64::from(i) * 0.1).sin() as f32, 0.0);
        let seen = KeyframeScan {
            stamp: Timestamp(0),
            sensor: "lidar".into(),
            t_base_sensor: Pose::identity(),
            base_height_m: 0.0,
            hits: PointCloud::from_positions((0..63).map(around).collect()),
            misses: vec![],
            planar: true,
            features: None,
        };
        let (found, at) = here(0.0);
        Self { probation: Probation::new(found, at, &seen, 0.0), way_m: 0.0 }
    }

    /// Drives away, or to and fro around where it was found.
    fn sees(&mut self, agrees: bool, is_away: bool) -> Verdict {
        self.way_m += 0.5;
        let (found, at) = here(if is_away { self.way_m } else { 0.5 });
        if agrees {
            self.probation.agree(found, at, self.way_m)
        } else {
            self.probation.contradict()
        }
        self.probation.verdict(self.way_m)
    }
}

fn here(x: f64) -> (Relocalisation, FoundAt) {
    let covariance = Covariance6::identity() * 1e-4;
    let t_odom_base = se3::from_xy_yaw(x, 0.0, 0.0);
    let found = Relocalisation { keyframe: KeyframeId(0), t_keyframe_base: t_odom_base, covariance, inlier_ratio: 0.9 };
    (found, FoundAt { t_odom_base, of_odometry: covariance, in_map: covariance })
}

#[test]
fn what_it_sees_where_it_was_found_proves_nothing_and_four_views_from_elsewhere_do() {
    let mut robot = Robot::found();
    assert!((0..20).all(|_| robot.sees(true, false) == Verdict::Open));
    let mut robot = Robot::found();
    let verdicts: Vec<Verdict> = (0..13).map(|_| robot.sees(true, true)).collect();
    // Once and a half as far as it sees is 4.5 m.
    assert_eq!(verdicts.iter().position(|v| *v == Verdict::Confirmed), Some(12), "{verdicts:?}");
}

#[test]
fn three_views_that_contradict_are_enough_while_it_is_not_certain_and_not_afterwards() {
    let mut robot = Robot::found();
    let told = [true, false, true, false, true, false].map(|agrees| robot.sees(agrees, true));
    assert_eq!(told.iter().position(|v| *v == Verdict::Withdrawn), Some(5));
    let mut robot = Robot::found();
    let verdicts: Vec<Verdict> = (0..13).map(|_| robot.sees(true, true)).collect();
    assert_eq!(verdicts.last(), Some(&Verdict::Confirmed));
    // A room whose furniture was moved; with a view now and then that fits.
    assert!((0..40).all(|i| robot.sees(i % 10 == 9, true) != Verdict::Withdrawn));
    let until = (0..40).position(|_| robot.sees(false, true) == Verdict::Withdrawn);
    assert_eq!(until, Some(19), "10 m without one");
}
