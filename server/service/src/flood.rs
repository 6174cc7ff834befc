//! Faults that may come a hundred thousand times a second are told once a while, with how often they came.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// What repeats is told at most this often.
const INTERVAL: Duration = Duration::from_secs(10);
/// Kinds of faults told apart; a flood of ever new ones is counted as one.
const MOST_KINDS: usize = 256;
/// The kind that stands for those beyond [`MOST_KINDS`].
const OTHERS: &str = "others";

/// Decides which of many alike faults goes into the log. A kind is what they have in common, such as reason and key.
pub struct RateLimitedLog {
    interval: Duration,
    kinds: Mutex<HashMap<String, Kind>>,
}

struct Kind {
    told: Instant,
    untold: u64,
}

impl Default for RateLimitedLog {
    fn default() -> Self {
        Self::every(INTERVAL)
    }
}

impl RateLimitedLog {
    /// Tells each kind at most once an `interval`.
    pub fn every(interval: Duration) -> Self {
        Self { interval, kinds: Mutex::default() }
    }

    /// Notes a fault. If it is to be told now: how many of its kind were not, since the last one was.
    pub fn admit(&self, kind: &str) -> Option<u64> {
        self.admit_at(kind, Instant::now())
    }

    /// Kinds whose interval is over with faults that were not told, and how many; they count as told.
    pub fn overdue(&self) -> Vec<(String, u64)> {
        self.overdue_at(Instant::now())
    }

    fn admit_at(&self, kind: &str, now: Instant) -> Option<u64> {
        let mut kinds = self.lock();
        if kinds.len() >= MOST_KINDS && !kinds.contains_key(kind) {
            kinds.retain(|_, k| k.untold > 0 || now.duration_since(k.told) < self.interval);
        }
        let name = if kinds.len() >= MOST_KINDS && !kinds.contains_key(kind) { OTHERS } else { kind };
        match kinds.get_mut(name) {
            None => {
                kinds.insert(name.to_owned(), Kind { told: now, untold: 0 });
                Some(0)
            }
            Some(k) if now.duration_since(k.told) >= self.interval => {
                k.told = now;
                Some(std::mem::take(&mut k.untold))
            }
            Some(k) => {
                k.untold += 1;
                None
            }
        }
    }

    fn overdue_at(&self, now: Instant) -> Vec<(String, u64)> {
        let mut kinds = self.lock();
        let due = kinds.iter_mut().filter(|(_, k)| k.untold > 0 && now.duration_since(k.told) >= self.interval);
        due.map(|(name, k)| {
            k.told = now;
            (name.clone(), std::mem::take(&mut k.untold))
        })
        .collect()
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<String, Kind>> {
        self.kinds.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_is_told_once_an_interval_with_its_count() {
        let (log, begin) = (RateLimitedLog::every(Duration::from_secs(10)), Instant::now());
        assert_eq!(log.admit_at("a", begin), Some(0));
        for _ in 0..100_000 {
            assert_eq!(log.admit_at("a", begin + Duration::from_secs(9)), None);
        }
        assert_eq!(log.admit_at("b", begin), Some(0), "another kind is told at once");
        assert_eq!(log.admit_at("a", begin + Duration::from_secs(10)), Some(100_000));
        assert_eq!(log.admit_at("a", begin + Duration::from_secs(20)), Some(0));
    }

    #[test]
    fn what_was_counted_when_a_flood_ends_is_told_afterwards() {
        let (log, begin) = (RateLimitedLog::every(Duration::from_secs(10)), Instant::now());
        for _ in 0..3 {
            log.admit_at("a", begin);
        }
        assert!(log.overdue_at(begin + Duration::from_secs(9)).is_empty());
        assert_eq!(log.overdue_at(begin + Duration::from_secs(10)), [("a".to_owned(), 2)]);
        assert!(log.overdue_at(begin + Duration::from_secs(30)).is_empty());
    }

    #[test]
    fn ever_new_kinds_take_no_more_memory_nor_lines() {
        let (log, begin) = (RateLimitedLog::every(Duration::from_secs(10)), Instant::now());
        let told = (0..100_000).filter(|i| log.admit_at(&format!("kind {i}"), begin).is_some()).count();
        assert!(told <= MOST_KINDS + 1, "{told} lines");
        assert!(log.lock().len() <= MOST_KINDS + 1);
    }
}
