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
/// A shift is known where its standard deviation is below this, seconds, or below this share of it.
const KNOWN: (f64, f64) = (0.005, 1.0 / 6.0);
/// Below so many seconds of turning the deviation itself is poorly known: it has to be below this share then.
const SHORT: (f64, f64) = (15.0, 1.0 / 20.0);
/// What was known is forgotten where a later estimate, itself too poor to be known, is so many of its deviations away.
const CONTRADICTS: f64 = 3.0;
/// Over which turning is taken to grow evenly, to either side, seconds: about the time between two poses.
const SLOPE_S: f64 = 0.1;
/// Poses over which what wheels are off by goes on, as where they slip: a second of a lidar's.
const LASTS: usize = 10;

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
        let is_short = self.poses.0.front().is_none_or(|first| to.seconds_since(first.0) < SHORT.0);
        for (id, Shift { late, deviation }) in new {
            let share = if is_short { SHORT.1 } else { KNOWN.1 };
            if deviation < KNOWN.0.max(share * late.abs()) {
                let held = self.found.entry(id).or_insert(late);
                *held += 0.3 * (late - *held);
            } else if self.found.get(&id).is_some_and(|held| (held - late).abs() > CONTRADICTS * deviation) {
                self.found.remove(&id);
            }
        }
        any
    }

    /// Seconds by which each sensor's stamps are late, as far as that is known.
    pub(crate) fn found(&self) -> &BTreeMap<SensorId, f64> {
        &self.found
    }
}

/// Seconds by which a sensor's stamps are late, and the standard deviation of that.
#[derive(Debug, Clone, Copy)]
struct Shift {
    late: f64,
    deviation: f64,
}

/// By how much `rates` are late behind `poses`.
fn offset(poses: &Rates, rates: &Rates) -> Option<Shift> {
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
    let late = around + (best as f64 + between - f64::from(n)) * STEPS_S.1;
    let deviation = deviation(poses, rates, late)?;
    Some(Shift { late, deviation })
}

/// Standard deviation of a shift, seconds: that of the delay which makes the two agree best, to first order, where what they differ
/// by may go on for some poses (the estimate of its variance is Newey's and West's, 1987).
fn deviation(poses: &Rates, rates: &Rates, late: f64) -> Option<f64> {
    let step = SLOPE_S;
    let around = |of: &Rates, t: Timestamp| {
        let at = |s: f64| of.at(t.plus_seconds(s));
        Some((at(0.0)?, (at(step)? - at(-step)?) / (2.0 * step)))
    };
    let both = |(t, _): &(Timestamp, f64)| Some((around(poses, *t)?, around(rates, t.plus_seconds(late))?));
    let samples: Vec<((f64, f64), (f64, f64))> = poses.0.iter().filter_map(both).collect();
    let n = samples.len() as f64;
    let (ma, mb) = (samples.iter().map(|s| s.0.0).sum::<f64>() / n, samples.iter().map(|s| s.1.0).sum::<f64>() / n);
    let (mut saa, mut sab, mut steep) = (0.0, 0.0, 0.0);
    for ((a, slope_a), (b, slope_b)) in &samples {
        saa += (a - ma) * (a - ma);
        sab += (a - ma) * (b - mb);
        // What either is off by is not squared, so that it does not pass for turning.
        steep += slope_a * slope_b;
    }
    let pull = |((a, slope), (b, _)): &((f64, f64), (f64, f64))| slope * (b - mb - sab / saa * (a - ma));
    let pulls: Vec<f64> = samples.iter().map(pull).collect();
    let together = |lag: usize| pulls.iter().zip(&pulls[lag.min(pulls.len())..]).map(|(p, q)| p * q).sum::<f64>();
    let lasting = (1..=LASTS).map(|lag| 2.0 * (1.0 - lag as f64 / (LASTS + 1) as f64) * together(lag)).sum::<f64>();
    let variance = (together(0) + lasting).max(0.0) / (steep * steep);
    (steep > 0.0 && variance.is_finite()).then(|| variance.sqrt())
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
    fn wheels_that_slip_are_not_taken_for_a_clock_that_is_off() {
        // They turn by something else for half a second at a time, so that the two agree to 0.94 to 0.99.
        for seed in 0..60u32 {
            let slip = |t: f64| {
                let mut word = (2.0 * t).floor() as u64 + 1000 * u64::from(seed);
                // splitmix64 (Steele, Lea and Flood 2014).
                for factor in [0xbf58_476d_1ce4_e5b9, 0x94d0_49bb_1331_11eb_u64] {
                    word = word.wrapping_add(0x9e37_79b9_7f4a_7c15);
                    word = (word ^ (word >> 30)).wrapping_mul(factor);
                }
                0.7 * ((word >> 40) as f64 / f64::from(1 << 24) - 0.5)
            };
            let found = estimate(0.0, |t| rate(t) + slip(t), angle);
            assert!(found.is_none_or(|late| late.abs() < 0.02), "{seed}: {found:?}");
            let late = estimate(0.3, |t| rate(t) + slip(t), angle);
            assert!(late.is_none_or(|late| (late - 0.3).abs() < 0.1), "{seed}: {late:?}");
        }
    }

    #[test]
    fn who_does_not_turn_or_turns_otherwise_tells_nothing() {
        assert_eq!(estimate(0.1, |_| 0.0, |_| 0.0), None);
        assert_eq!(estimate(0.1, |t| rate(3.1 * t + 7.0), angle), None);
    }
}
