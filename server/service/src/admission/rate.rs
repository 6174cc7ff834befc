//! A token bucket that may run into debt: what comes is let in while there is anything left, whatever its size, and is
//! paid off before the next. So a frame larger than a second's allowance passes, and the mean rate holds.

use std::time::{Duration, Instant};

/// What a second allows may come at once.
const BURST_S: f64 = 1.0;
/// Nobody is told to come back sooner.
const LEAST_WAIT: Duration = Duration::from_millis(1);

/// What is left of a rate.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bucket {
    left: f64,
    at: Instant,
}

impl Bucket {
    /// A second's allowance, unused.
    pub(super) fn full(rate: usize, now: Instant) -> Self {
        Self { left: rate as f64 * BURST_S, at: now }
    }

    /// How long until there is room; none if there is some. `rate` is a second's allowance, 0 for any.
    pub(super) fn wait(&mut self, rate: usize, now: Instant) -> Option<Duration> {
        if rate == 0 {
            return None;
        }
        let rate = rate as f64;
        let earned = now.saturating_duration_since(self.at).as_secs_f64() * rate;
        self.left = (self.left + earned).min(rate * BURST_S);
        self.at = now;
        (self.left <= 0.0).then(|| Duration::from_secs_f64(-self.left / rate).max(LEAST_WAIT))
    }

    /// Takes an amount; to be asked for by [`Self::wait`] before.
    pub(super) fn take(&mut self, amount: f64) {
        self.left -= amount;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What passes in so many seconds, if `size` comes whenever it may.
    fn passed(rate: usize, size: f64, seconds: u64) -> f64 {
        let begin = Instant::now();
        let (mut now, mut bucket, mut sum) = (begin, Bucket::full(rate, begin), 0.0);
        while now < begin + Duration::from_secs(seconds) {
            match bucket.wait(rate, now) {
                Some(wait) => now += wait,
                None => {
                    bucket.take(size);
                    sum += size;
                }
            }
        }
        sum
    }

    #[test]
    fn the_mean_rate_holds_for_small_and_for_large() {
        for (rate, size) in [(10, 1.0), (1000, 1.0), (1000, 10.0), (1000, 5000.0)] {
            let sum = passed(rate, size, 100);
            let allowed = rate as f64 * 101.0;
            assert!((sum - allowed).abs() <= size + 0.02 * allowed, "{rate} a second, {size} at a time: {sum}");
        }
    }

    #[test]
    fn nothing_is_saved_up_beyond_a_second() {
        let begin = Instant::now();
        let mut bucket = Bucket::full(10, begin);
        let later = begin + Duration::from_secs(3600);
        let mut passed = 0;
        while bucket.wait(10, later).is_none() {
            bucket.take(1.0);
            passed += 1;
        }
        assert_eq!(passed, 10);
        assert_eq!(Bucket::full(0, begin).wait(0, begin), None);
    }
}
