//! How far a sensor's clock is off the pose sensor's: the shift at which both saw the same turning.
//!
//! Source: the correlation of angular rates by which Kelly, Roy and Sukhatme, "Determining the time delay between inertial
//! and visual sensor measurements", 2014, begin.

use percept_geometry::{SensorId, Timestamp};
use std::collections::{BTreeMap, VecDeque};

/// Turning that is kept, seconds.
const WINDOW_S: f64 = 20.0;
/// Largest offset that is looked for, seconds.
const REACH_S: f64 = 1.2;
/// Steps of the search and of the one around what that finds, seconds: turning of robots and hands varies more slowly.
const STEPS_S: (f64, f64) = (0.04, 0.01);
/// A second shift at which both agree by more than this share of the best: who swings to and fro is like itself a swing later.
const RIVAL: f64 = 0.9;
/// Poses between two estimates.
const EVERY: usize = 50;
/// Turning has to vary by this much to tell anything, rad/s; and both have to agree so well.
const LEAST: (f64, f64) = (0.1, 0.8);

#[derive(Debug, Clone, Default)]
struct Rates(VecDeque<(Timestamp, f64)>);

impl Rates {
    fn push(&mut self, stamp: Timestamp, rate: f64) {
        if self.0.back().is_some_and(|last| last.0 >= stamp) {
            return;
        }
        self.0.push_back((stamp, rate));
        while self.0.front().is_some_and(|s| stamp.seconds_since(s.0) > WINDOW_S + 2.0 * REACH_S) {
            self.0.pop_front();
        }
    }

    fn at(&self, stamp: Timestamp) -> Option<f64> {
        let after = self.0.partition_point(|s| s.0 < stamp);
        let before = self.0.get(after.checked_sub(1)?)?;
        let next = self.0.get(after)?;
        let span = next.0.seconds_since(before.0);
        let share = stamp.seconds_since(before.0) / span;
        (span < 0.5).then_some(before.1 + share * (next.1 - before.1))
    }
}

/// Turning as the pose sensor and others saw it.
#[derive(Debug, Clone, Default)]
pub(crate) struct ClockOffsets {
    poses: Rates,
    since: usize,
    sensors: BTreeMap<SensorId, Rates>,
    found: BTreeMap<SensorId, f64>,
}

impl ClockOffsets {
    /// A sensor measured turning, rad/s, about any axis, at its own stamp.
    pub(crate) fn saw(&mut self, sensor: &SensorId, stamp: Timestamp, rate: f64) {
        match self.sensors.get_mut(sensor) {
            Some(rates) => rates.push(stamp, rate),
            None => {
                let mut rates = Rates::default();
                rates.push(stamp, rate);
                self.sensors.insert(sensor.clone(), rates);
            }
        }
    }

    /// The sensor's stamps are told otherwise from now on.
    pub(crate) fn forget(&mut self, sensor: &SensorId) {
        self.sensors.remove(sensor);
        self.found.remove(sensor);
    }

    /// Two poses tell how fast the robot turned in between; whether that gave a new estimate.
    pub(crate) fn turned(&mut self, from: Timestamp, to: Timestamp, angle: f64) -> bool {
        let dt = to.seconds_since(from);
        if !(1e-3..0.5).contains(&dt) {
            return false;
        }
        self.poses.push(from.plus_seconds(0.5 * dt), angle / dt);
        self.since += 1;
        if self.since < EVERY {
            return false;
        }
        self.since = 0;
        let new = self.sensors.iter().filter_map(|(id, rates)| Some((id.clone(), offset(&self.poses, rates)?)));
        let new: Vec<_> = new.collect();
        let any = !new.is_empty();
        for (id, offset) in new {
            let held = self.found.entry(id).or_insert(offset);
            *held += 0.3 * (offset - *held);
        }
        any
    }

    /// Seconds by which each sensor's stamps are late, as far as that is known.
    pub(crate) fn found(&self) -> &BTreeMap<SensorId, f64> {
        &self.found
    }
}

/// Seconds by which `rates` are late behind `poses`.
fn offset(poses: &Rates, rates: &Rates) -> Option<f64> {
    let score = |late: f64| agreement(poses, rates, late).unwrap_or(-1.0);
    let steps = (REACH_S / STEPS_S.0).round() as i32;
    let coarse: Vec<f64> = (-steps..=steps).map(|k| score(f64::from(k) * STEPS_S.0)).collect();
    let at = alone(&coarse)?;
    let around = (at as f64 - f64::from(steps)) * STEPS_S.0;
    let n = (STEPS_S.0 / STEPS_S.1).round() as i32;
    let fine: Vec<f64> = (-n..=n).map(|k| score(around + f64::from(k) * STEPS_S.1)).collect();
    let (best, most) = fine.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    if most < LEAST.1 || best == 0 || best + 1 == fine.len() {
        return None;
    }
    // The parabola through the best and its neighbours.
    let (a, b, c) = (fine[best - 1], most, fine[best + 1]);
    let bend = a - 2.0 * b + c;
    let between = if bend < -1e-12 { (0.5 * (a - c) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    Some(around + (best as f64 + between - f64::from(n)) * STEPS_S.1)
}

/// The best of scores in a row if none beyond its own hill comes near it, the ends included, behind which more may lie.
fn alone(scores: &[f64]) -> Option<usize> {
    let (best, most) = scores.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let is_top = |k: usize| {
        let before = k.checked_sub(1).and_then(|k| scores.get(k)).is_none_or(|s| *s <= scores[k]);
        before && scores.get(k + 1).is_none_or(|s| *s <= scores[k])
    };
    let is_inside = best > 0 && best + 1 < scores.len();
    let rivals = (0..scores.len()).any(|k| k != best && is_top(k) && scores[k] > RIVAL * most);
    (is_inside && !rivals).then_some(best)
}

/// Correlation of the two if `rates` came `late` seconds later.
fn agreement(poses: &Rates, rates: &Rates, late: f64) -> Option<f64> {
    let pairs: Vec<(f64, f64)> =
        poses.0.iter().filter_map(|(t, a)| Some((*a, rates.at(t.plus_seconds(late))?))).collect();
    if pairs.len() < 2 * EVERY / 3 {
        return None;
    }
    let n = pairs.len() as f64;
    let (ma, mb) = (pairs.iter().map(|p| p.0).sum::<f64>() / n, pairs.iter().map(|p| p.1).sum::<f64>() / n);
    let (mut saa, mut sbb, mut sab) = (0.0, 0.0, 0.0);
    for (a, b) in pairs {
        saa += (a - ma) * (a - ma);
        sbb += (b - mb) * (b - mb);
        sab += (a - ma) * (b - mb);
    }
    let least = n * LEAST.0 * LEAST.0;
    (saa > least && sbb > least).then(|| sab / (saa * sbb).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(s)
    }

    /// Turning of a robot, rad/s: never the same twice.
    fn rate(t: f64) -> f64 {
        0.8 * (0.9 * t).sin() + 0.5 * (2.3 * t + 1.0).sin()
    }

    fn angle(t: f64) -> f64 {
        -0.8 / 0.9 * (0.9 * t).cos() - 0.5 / 2.3 * (2.3 * t + 1.0).cos()
    }

    fn estimate(late: f64, rate: impl Fn(f64) -> f64, angle: impl Fn(f64) -> f64) -> Option<f64> {
        let (mut clocks, imu) = (ClockOffsets::default(), SensorId("imu".to_owned()));
        for k in 0..3000 {
            let t = 0.01 * f64::from(k);
            clocks.saw(&imu, at(t + late), rate(t));
            if k > 0 && k % 10 == 0 {
                clocks.turned(at(t - 0.1), at(t), angle(t) - angle(t - 0.1));
            }
        }
        clocks.found().get(&imu).copied()
    }

    #[test]
    fn a_late_and_an_early_clock_are_found_to_milliseconds() {
        for late in [-0.12, 0.0, 0.035, 0.2, 0.9] {
            let found = estimate(late, rate, angle).unwrap();
            assert!((found - late).abs() < 0.004, "{late}: {found}");
        }
    }

    #[test]
    fn who_swings_to_and_fro_tells_nothing_since_any_swing_is_like_the_next() {
        let swing = |t: f64| (5.0 * t).sin();
        assert_eq!(estimate(1.0, |t| swing(t).abs(), |t| -(5.0 * t).cos() / 5.0), None);
    }

    #[test]
    fn who_does_not_turn_or_turns_otherwise_tells_nothing() {
        assert_eq!(estimate(0.1, |_| 0.0, |_| 0.0), None);
        assert_eq!(estimate(0.1, |t| rate(3.1 * t + 7.0), angle), None);
    }
}
