//! Wheels that lie: a recording's odometry, spoiled at chosen times as wheels spoil it.

use super::Failure;
use percept_geometry::{Pose, SensorData, SensorFrame, Timestamp, se3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

/// How long a fault lasts, seconds; a stream that stops does so for five times as long.
const LASTS_S: f64 = 2.0;
const STOPS_S: f64 = 10.0;
/// Wheels that slip in a turn report so many radians within a second that were not turned: 14 degrees, as in an office log.
const SLIPS_S: f64 = 1.0;
const SLIPS_RAD: f64 = 0.245;
/// A wheel that spins makes so many metres of way that was not driven.
const SPINS_M: f64 = 1.0;
/// A mount is off by so many metres, ahead and to the left as much.
const MOUNT_OFF_M: f64 = 0.04;
/// Turning is misread where there is some: so many radians at least while it lasts.
const TURNS_RAD: f64 = 0.3;
/// Faults are so many seconds apart at least, so that each is one.
const APART_S: f64 = 2.0;

/// What goes wrong with wheels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Corruption {
    /// Half of the turning is reported, for two seconds: a wheel slips in a turn.
    HalfTurn,
    /// Twice the turning is reported, for two seconds.
    DoubleTurn,
    /// Fourteen degrees more than were turned are reported within a second of a turn.
    Slip,
    /// A metre is reported within two seconds that was not driven: wheels spin.
    Spin,
    /// Nothing is reported for ten seconds.
    Stop,
    /// The odometry's own origin is 4 cm ahead and 4 cm to the left of where it is said to be, all the time.
    Mount,
}

/// The reported motion of a whole recording, before anything is spoiled.
pub(crate) fn samples(frames: impl Iterator<Item = Result<SensorFrame, Failure>>) -> Vec<(Timestamp, Pose)> {
    let sample = |frame: Result<SensorFrame, Failure>| match frame.ok()? {
        SensorFrame { stamp, data: SensorData::Odometry(sample), .. } => Some((stamp, sample.t_odom_base)),
        _ => None,
    };
    frames.filter_map(sample).collect()
}

/// When faults begin: up to `count` places drawn by `seed` among those where this kind of fault shows, in order.
pub(crate) fn places(samples: &[(Timestamp, Pose)], kind: Corruption, count: usize, seed: u64) -> Vec<Timestamp> {
    if kind == Corruption::Mount {
        return vec![];
    }
    let lasts = lasts_s(kind);
    let shows = |from: usize| {
        let end = samples.partition_point(|s| s.0.seconds_since(samples[from].0) <= lasts);
        let part = &samples[from..end];
        let steps = part.windows(2).map(|pair| pair[0].1.inv_mul(&pair[1].1));
        let is_turn = matches!(kind, Corruption::HalfTurn | Corruption::DoubleTurn | Corruption::Slip);
        let is_whole = samples.last().is_some_and(|last| last.0.seconds_since(samples[from].0) > 2.0 * lasts);
        is_whole && (!is_turn || steps.map(|step| step.rotation.angle()).sum::<f64>() >= TURNS_RAD)
    };
    let candidates: Vec<Timestamp> = (0..samples.len()).filter(|&i| shows(i)).map(|i| samples[i].0).collect();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut chosen: Vec<Timestamp> = vec![];
    // Where hardly any place is left free the tries run out.
    for _ in 0..100 * count {
        if chosen.len() == count || candidates.is_empty() {
            break;
        }
        let place = candidates[random.random_range(0..candidates.len())];
        if chosen.iter().all(|other| place.seconds_since(*other).abs() > lasts + APART_S) {
            chosen.push(place);
        }
    }
    chosen.sort_unstable();
    chosen
}

fn lasts_s(kind: Corruption) -> f64 {
    match kind {
        Corruption::Stop => STOPS_S,
        Corruption::Slip => SLIPS_S,
        _ => LASTS_S,
    }
}

/// Spoils the odometry among frames as they pass.
pub(crate) struct Corrupted {
    kind: Corruption,
    begins: Vec<Timestamp>,
    /// The newest sample as it was recorded, and as it was passed on.
    last: Option<(Timestamp, Pose, Pose)>,
}

impl Corrupted {
    /// Faults of one kind, each beginning at one of these times, in order.
    pub(crate) fn new(kind: Corruption, begins: Vec<Timestamp>) -> Self {
        Self { kind, begins, last: None }
    }

    /// The frame as it arrives; none if it does not.
    pub(crate) fn pass(&mut self, mut frame: SensorFrame) -> Option<SensorFrame> {
        let SensorData::Odometry(sample) = &mut frame.data else { return Some(frame) };
        let recorded = sample.t_odom_base;
        let Some((stamp, before, passed)) = self.last else {
            self.last = Some((frame.stamp, recorded, recorded));
            return Some(frame);
        };
        let is_within = self.is_within(frame.stamp);
        if is_within && self.kind == Corruption::Stop {
            return None;
        }
        let step = before.inv_mul(&recorded);
        let seconds = frame.stamp.seconds_since(stamp);
        sample.t_odom_base = passed * if is_within { self.spoiled(&step, seconds) } else { step };
        self.last = Some((frame.stamp, recorded, sample.t_odom_base));
        Some(frame)
    }

    fn is_within(&self, stamp: Timestamp) -> bool {
        if self.kind == Corruption::Mount {
            return true;
        }
        let begun = self.begins.partition_point(|begin| *begin < stamp);
        begun > 0 && stamp.seconds_since(self.begins[begun - 1]) <= lasts_s(self.kind)
    }

    fn spoiled(&self, step: &Pose, seconds: f64) -> Pose {
        let turned = |share: f64| {
            let rotation = step.rotation.powf(share);
            Pose::from_parts(step.translation, rotation)
        };
        match self.kind {
            Corruption::HalfTurn => turned(0.5),
            Corruption::DoubleTurn => turned(2.0),
            Corruption::Slip => {
                let turning = se3::yaw(step).signum();
                step * se3::from_xy_yaw(0.0, 0.0, turning * SLIPS_RAD * seconds / SLIPS_S)
            }
            Corruption::Spin => step * se3::from_xy_yaw(SPINS_M * seconds / LASTS_S, 0.0, 0.0),
            Corruption::Stop => *step,
            Corruption::Mount => {
                let t_base_wheels = se3::from_xy_yaw(MOUNT_OFF_M, MOUNT_OFF_M, 0.0);
                t_base_wheels.inverse() * step * t_base_wheels
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::sensor::OdometrySample;

    /// Ten samples a second, a metre and half a radian a second, for a hundred seconds.
    fn drive() -> Vec<SensorFrame> {
        let step = se3::from_xy_yaw(0.1, 0.0, 0.05);
        let mut t_odom_base = Pose::identity();
        let frame = |i: u32| {
            t_odom_base *= step;
            let data = SensorData::Odometry(OdometrySample { t_odom_base, covariance: None });
            SensorFrame { sensor: "wheels".into(), stamp: Timestamp::from_secs_f64(0.1 * f64::from(i)), data }
        };
        (0..1000).map(frame).collect()
    }

    fn passed(kind: Corruption, begins: Vec<Timestamp>) -> Vec<(Timestamp, Pose)> {
        let mut corrupted = Corrupted::new(kind, begins);
        samples(drive().into_iter().filter_map(move |frame| corrupted.pass(frame)).map(Ok))
    }

    #[test]
    fn faults_begin_at_as_many_places_as_asked_for_and_do_not_meet() {
        let samples = samples(drive().into_iter().map(Ok));
        for kind in [Corruption::HalfTurn, Corruption::Spin, Corruption::Stop] {
            let begins = places(&samples, kind, 5, 7);
            assert_eq!(begins.len(), 5);
            assert!(begins.windows(2).all(|pair| pair[1].seconds_since(pair[0]) > lasts_s(kind)));
            assert_eq!(begins, places(&samples, kind, 5, 7));
            assert_ne!(begins, places(&samples, kind, 5, 8));
        }
        let straight: Vec<_> =
            samples.iter().map(|(t, p)| (*t, Pose::from_parts(p.translation, Pose::identity().rotation))).collect();
        assert!(places(&straight, Corruption::HalfTurn, 5, 7).is_empty());
    }

    #[test]
    fn what_is_reported_is_off_by_what_the_fault_makes_of_it() {
        let honest = samples(drive().into_iter().map(Ok));
        let begin = vec![Timestamp::from_secs_f64(50.0)];
        let last = |samples: &[(Timestamp, Pose)]| samples.last().unwrap().1;
        let turned = |kind| last(&passed(kind, begin.clone())).rotation.inverse() * last(&honest).rotation;
        assert!((turned(Corruption::HalfTurn).angle() - 0.5).abs() < 1e-6);
        assert!((turned(Corruption::DoubleTurn).angle() - 1.0).abs() < 1e-6);
        assert!((turned(Corruption::Slip).angle() - SLIPS_RAD).abs() < 1e-6);

        let way = |samples: &[(Timestamp, Pose)]| {
            samples.windows(2).map(|pair| pair[0].1.inv_mul(&pair[1].1).translation.vector.norm()).sum::<f64>()
        };
        assert!((way(&passed(Corruption::Spin, begin.clone())) - way(&honest) - 1.0).abs() < 0.02);
        let stopped = passed(Corruption::Stop, begin.clone());
        assert_eq!(honest.len() - stopped.len(), 100);
        assert!(last(&stopped).inv_mul(&last(&honest)).translation.vector.norm() < 1e-6);

        let off = passed(Corruption::Mount, vec![]);
        let step = off[5].1.inv_mul(&off[6].1).translation.vector;
        // A turn of 0.05 rad moves a point 4 cm ahead and to the left by 2 mm to the left and backwards.
        assert!((step.x - 0.098).abs() < 2e-4 && (step.y - 0.002).abs() < 2e-4, "{step}");
    }
}
