//! How a stream has come in of late, in figures.

use super::frame_look::FrameLook;
use percept_geometry::Timestamp;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Frames that figures are of. Five seconds of a lidar, a quarter of a second of an IMU.
const WINDOW: usize = 50;

/// A stream over its newest 50 frames.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StreamFigures {
    /// Mean rate by the stamps, hertz. None before two frames.
    pub rate_hz: Option<f64>,
    /// Mean rate of arrival by the server's clock, hertz. None before two frames.
    pub arrival_rate_hz: Option<f64>,
    /// Standard deviation of the times between stamps, seconds. None before three frames.
    pub jitter_s: Option<f64>,
    /// Longest time between two stamps, seconds. None before two frames.
    pub longest_interval_s: Option<f64>,
    /// From stamp to arrival by the server's clock, median, seconds: the clocks' offset and the way together. Negative if the
    /// sensor's clock is ahead. None before the first frame.
    pub delay_s: Option<f64>,
    /// Since the newest frame came, seconds. None before the first.
    pub quiet_s: Option<f64>,
    /// Bytes of a frame, mean, packing aside. None before the first.
    pub frame_bytes: Option<f64>,
    /// From arrival until the frame was worked in, waiting included: median and 95th percentile, seconds. None before the first.
    pub latency_s: Option<(f64, f64)>,
    /// Share of beams or pixels that measured something, mean. None for what has none.
    pub measured_ratio: Option<f64>,
    /// Share of a planar scan's returns that stand alone, mean. None for what is no planar scan.
    pub stray_ratio: Option<f64>,
    /// Median distance measured, metres. None if nothing was.
    pub median_range_m: Option<f64>,
}

/// Others go on if one of them sent something in so many seconds.
const GOES_ON_S: f64 = 1.0;
/// A stream is silent after so many of its intervals, and so many seconds.
const SILENT: (f64, f64) = (10.0, 2.0);

impl StreamFigures {
    /// For how long nothing has come, if that is unusual and the session's newest frame came just now (`newest_s` ago).
    pub(super) fn silent_s(&self, newest_s: Option<f64>) -> Option<f64> {
        let usual_s = 1.0 / self.arrival_rate_hz.filter(|rate| *rate > 0.0)?;
        let is_silent = |quiet_s: &f64| *quiet_s > SILENT.0 * usual_s && *quiet_s > SILENT.1;
        newest_s.filter(|newest_s| *newest_s < GOES_ON_S).and(self.quiet_s.filter(is_silent))
    }
}

#[derive(Debug, Clone, Copy)]
struct Came {
    stamp: Timestamp,
    at: Instant,
    /// Behind the stamp, server's clock, seconds.
    delay_s: f64,
    latency_s: f64,
    look: FrameLook,
}

/// The newest frames of a stream.
#[derive(Debug, Clone, Default)]
pub(crate) struct Recent {
    frames: VecDeque<Came>,
}

impl Recent {
    /// Adds a frame that was worked in `latency` after it had come.
    pub(crate) fn add(&mut self, stamp: Timestamp, ahead_ns: i64, latency: Duration, look: FrameLook) {
        let now = Instant::now();
        let latency_s = latency.as_secs_f64();
        let at = now.checked_sub(latency).unwrap_or(now);
        self.frames.push_back(Came { stamp, at, delay_s: -1e-9 * ahead_ns as f64 - latency_s, latency_s, look });
        if self.frames.len() > WINDOW {
            self.frames.pop_front();
        }
    }

    /// By how much the stamps are ahead of another stream's that come at the same time, seconds, the declared offsets of both counted;
    /// none if that is no more than streams are, or they do not come at the same time.
    pub(super) fn ahead_of(&self, offset_s: f64, other: &Self, other_offset_s: f64) -> Option<f64> {
        let (of_stamps, of_arrival) =
            (self.usual_s().zip(other.usual_s())).map(|(a, b)| (APART.1 * a.0.max(b.0), APART.1 * a.1.max(b.1)))?;
        let apart = |frame: &Came| {
            let came_s = |other: &Came| seconds_between(frame.at, other.at);
            let beside = other.frames.iter().min_by(|a, b| came_s(a).abs().total_cmp(&came_s(b).abs()))?;
            let ahead_s = frame.stamp.seconds_since(beside.stamp) + offset_s - other_offset_s - came_s(beside);
            (came_s(beside).abs() <= of_arrival).then_some(ahead_s)
        };
        let all: Vec<f64> = self.frames.iter().filter_map(apart).collect();
        let are_most = 2 * all.len() > self.frames.len();
        percentile(all, 0.5).filter(|ahead_s| are_most && ahead_s.abs() > APART.0.max(of_stamps))
    }

    /// Time between frames, mean, by stamps and by arrival, seconds.
    fn usual_s(&self) -> Option<(f64, f64)> {
        let (first, last) = self.frames.front().zip(self.frames.back())?;
        let num = self.frames.len().checked_sub(1).filter(|n| *n > 0)? as f64;
        Some((last.stamp.seconds_since(first.stamp) / num, seconds_between(last.at, first.at) / num))
    }

    /// What they tell at `now`.
    pub(crate) fn figures(&self, now: Instant) -> StreamFigures {
        let Some((first, last)) = self.frames.front().zip(self.frames.back()) else { return StreamFigures::default() };
        let rate = |span_s: f64| (span_s > 0.0).then(|| (self.frames.len() - 1) as f64 / span_s);
        let pairs = self.frames.iter().zip(self.frames.iter().skip(1));
        let intervals: Vec<f64> = pairs.map(|(a, b)| b.stamp.seconds_since(a.stamp)).collect();
        let of = |value: fn(&Came) -> Option<f64>| -> Vec<f64> { self.frames.iter().filter_map(value).collect() };
        let latencies = of(|f| Some(f.latency_s));
        StreamFigures {
            rate_hz: rate(last.stamp.seconds_since(first.stamp)),
            arrival_rate_hz: rate(last.at.saturating_duration_since(first.at).as_secs_f64()),
            jitter_s: (intervals.len() > 1).then(|| deviation(&intervals)),
            longest_interval_s: intervals.iter().copied().reduce(f64::max),
            delay_s: percentile(of(|f| Some(f.delay_s)), 0.5),
            quiet_s: Some(now.saturating_duration_since(last.at).as_secs_f64()),
            frame_bytes: mean(&of(|f| Some(f.look.bytes as f64))),
            latency_s: percentile(latencies.clone(), 0.5).zip(percentile(latencies, 0.95)),
            measured_ratio: mean(&of(|f| f.look.measured)),
            stray_ratio: mean(&of(|f| f.look.stray)),
            median_range_m: percentile(of(|f| f.look.median_m), 0.5),
        }
    }
}

/// Two streams are apart from so many seconds on, and so many intervals of the slower one; frames come at the same time if no more
/// of these lie between them, for a recording is sent faster than time goes. What goes with a frame is waited for 0.1 s, and placed
/// half a second from it at most.
const APART: (f64, f64) = (1.0, 3.0);

/// From `b` to `a`, negative if that is before.
fn seconds_between(a: Instant, b: Instant) -> f64 {
    a.saturating_duration_since(b).as_secs_f64() - b.saturating_duration_since(a).as_secs_f64()
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn deviation(values: &[f64]) -> f64 {
    let mean = mean(values).unwrap_or(0.0);
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// Nearest rank.
fn percentile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    values.get((share * last as f64).round() as usize).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fifty frames every 0.1 s by the stamps, which begin at so many seconds, that come from so long after `now` on.
    fn stream(now: Instant, begin_s: f64, every: Duration, late: Duration) -> Recent {
        let mut recent = Recent::default();
        for i in 0..50u32 {
            let stamp = Timestamp::from_secs_f64(1000.0 + begin_s + 0.1 * f64::from(i));
            let at = now + late + every * i;
            recent.frames.push_back(Came { stamp, at, delay_s: 0.0, latency_s: 0.0, look: FrameLook::default() });
        }
        recent
    }

    #[test]
    fn clocks_apart_and_links_that_are_slow_are_seen_whatever_the_pace() {
        let now = Instant::now();
        for every in [Duration::from_millis(100), Duration::from_micros(200)] {
            let lidar = stream(now, 0.0, every, Duration::ZERO);
            let jitter = every.mul_f64(0.4);
            assert_eq!(stream(now, 0.0, every, jitter).ahead_of(0.0, &lidar, 0.0), None);
            for begin_s in [-60.0, 3.0] {
                let ahead_s = stream(now, begin_s, every, jitter).ahead_of(0.0, &lidar, 0.0).unwrap();
                assert!((ahead_s - begin_s).abs() < 0.2, "{ahead_s}");
                assert_eq!(stream(now, begin_s, every, jitter).ahead_of(-begin_s, &lidar, 0.0), None, "declared");
            }
        }
        // Right stamps, held up for two seconds on the way.
        let every = Duration::from_millis(100);
        let lidar = stream(now, 0.0, every, Duration::ZERO);
        let late = stream(now, 0.0, every, Duration::from_secs(2)).ahead_of(0.0, &lidar, 0.0).unwrap();
        assert!((late + 2.0).abs() < 0.2, "{late}");
        // One that ended long before the other's newest frames.
        let fast = Duration::from_micros(200);
        assert_eq!(
            stream(now, -100.0, fast, Duration::ZERO).ahead_of(0.0, &stream(now, 0.0, fast, fast * 1000), 0.0),
            None
        );
    }

    #[test]
    fn figures_are_those_of_the_newest_frames() {
        let mut recent = Recent::default();
        assert_eq!(recent.figures(Instant::now()), StreamFigures::default());
        for i in 0..200u32 {
            // A pause of a second long ago, one of 0.3 s just now; two seconds behind the server.
            let pause = if i < 20 { 0.0 } else { 1.0 } + if i < 180 { 0.0 } else { 0.2 };
            let look = FrameLook { bytes: 1000, measured: Some(0.5), stray: None, median_m: Some(2.0), digest: 0 };
            let stamp = Timestamp::from_secs_f64(0.1 * f64::from(i) + pause);
            recent.add(stamp, -2_000_000_000, Duration::from_millis(if i % 10 == 0 { 80 } else { 20 }), look);
        }
        let figures = recent.figures(Instant::now());
        let near = |value: Option<f64>, right: f64| (value.unwrap() - right).abs() < 0.02 * right.abs();
        assert!(near(figures.rate_hz, 49.0 / 5.1), "{figures:?}");
        assert!(near(figures.longest_interval_s, 0.3), "{figures:?}");
        assert!(near(figures.jitter_s, 0.2 * (48.0f64).sqrt() / 49.0), "{figures:?}");
        assert!(near(figures.delay_s, 1.98), "{figures:?}");
        assert_eq!(figures.latency_s, Some((0.02, 0.08)));
        assert_eq!((figures.frame_bytes, figures.median_range_m), (Some(1000.0), Some(2.0)));
        assert!(figures.quiet_s.unwrap() < 1.0);
    }
}
