//! Puts sessions to sleep that nobody uses, and more of them when memory runs short; watches the storage.

use super::fault::store_error;
use super::life::counts;
use super::registry::Registry;
use super::slot::{Phase, Slot};
use crate::{Error, Health, Part};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Weak};
use std::time::Duration;

/// How often sessions are looked through.
const EVERY: Duration = Duration::from_millis(500);
/// A session that was used more recently than this is left awake whatever memory says: it would be woken again at once.
const RECENT_MS: u64 = 2_000;
/// Share of the sessions in question that are put to sleep in one round when memory runs short: it takes a moment until
/// memory that was given back can be seen.
const SHARE: usize = 8;

/// The least that a session is left with, bytes: the submap around the robot, and what is composed of it.
const LEAST_ROOM: usize = 4 << 20;
/// Below this share of the budget sessions get more again.
const ROOMY: f64 = 0.8;

/// How often what awake sessions have gathered is noted: so old is what a list says of them after a crash.
const NOTED: Duration = Duration::from_secs(10);

/// How often the storage is asked while all is well and while it is not.
const ASK_WELL: Duration = Duration::from_secs(10);
const ASK_ILL: Duration = Duration::from_millis(500);
/// How long an answer may take.
const ASK_PATIENCE: Duration = Duration::from_secs(5);

/// Tells whether the storage takes data, until the registry is gone: asked now and then, and at once when a write failed. Where
/// there is room for what asks, there may be none for a keyframe: a session that waits says so, too.
pub(super) async fn watch_storage(registry: Weak<Registry>, health: Health) {
    let (mut failures, mut is_well, mut asked, mut has_waited) = (0, true, None::<tokio::time::Instant>, false);
    loop {
        let Some(registry) = registry.upgrade() else { return };
        let newest = registry.root.num_failures();
        let waits = who_waits(&registry);
        let is_due = asked.is_none_or(|at| at.elapsed() >= if is_well { ASK_WELL } else { ASK_ILL });
        if is_due || newest != failures || waits.is_some() {
            failures = newest;
            asked = Some(tokio::time::Instant::now());
            let answer = tokio::time::timeout(ASK_PATIENCE, registry.root.probe()).await;
            let answer = answer.unwrap_or(Err(percept_store::StoreError::Stalled { waited: ASK_PATIENCE }));
            let answer = answer.map_err(|e| store_error(&e));
            // One write that failed may do so by chance: seen twice it lasts.
            let answer = answer.and_then(|()| waits.clone().filter(|_| has_waited).map_or(Ok(()), Err));
            is_well = answer.is_ok();
            health.report(Part::Storage, answer);
        }
        has_waited = waits.is_some();
        drop(registry);
        tokio::time::sleep(ASK_ILL).await;
    }
}

/// What a session is told that has something to store and cannot, while tries go on; of many, one.
fn who_waits(registry: &Registry) -> Option<Error> {
    registry.slots().iter().find_map(|slot| match slot.phase() {
        Phase::Awake(session) => session.waits_for_storage(),
        _ => None,
    })
}

/// Runs until the registry is gone.
pub(super) async fn keep(registry: Weak<Registry>) {
    loop {
        tokio::time::sleep(EVERY).await;
        let Some(registry) = registry.upgrade() else { return };
        round(&registry);
    }
}

/// Notes what awake sessions have gathered, for a list after a crash, until the registry is gone.
pub(super) async fn note_awake(registry: Weak<Registry>) {
    loop {
        tokio::time::sleep(NOTED).await;
        let Some(registry) = registry.upgrade() else { return };
        for slot in registry.slots() {
            let Phase::Awake(session) = slot.phase() else { continue };
            let (before, now) = (slot.known().counts, Some(counts(&session)));
            if now != before && session.is_stored_well() {
                slot.update_known(|known| known.counts = now);
                registry.write_summary(&slot, &session).await;
            }
        }
    }
}

fn round(registry: &Arc<Registry>) {
    let idle_ms = (registry.limits.sleep_after_s as u64).saturating_mul(1000);
    let mut awake: Vec<(u64, Arc<Slot>)> = Vec::new();
    for slot in registry.slots() {
        if let Phase::Awake(session) = slot.phase()
            && !session.is_busy()
            && session.is_stored_well()
        {
            awake.push((slot.unused_ms(), slot));
        }
    }
    awake.sort_by_key(|(unused_ms, _)| std::cmp::Reverse(*unused_ms));
    let mut left = Vec::new();
    for (unused_ms, slot) in awake {
        if unused_ms >= idle_ms {
            registry.retire_soon(&slot);
        } else if unused_ms >= RECENT_MS {
            left.push(slot);
        }
    }
    let Some(resident) = resident_bytes() else { return };
    let budget = budget_bytes(registry.limits.max_memory_mb);
    if resident > budget {
        let few = left.len().div_ceil(SHARE);
        left.iter().take(few).for_each(|slot| registry.retire_soon(slot));
    }
    let most = registry.limits.max_session_memory_mb << 20;
    let room = registry.room.load(Ordering::Relaxed);
    registry.room.store(next_room(room, most, !left.is_empty(), resident as f64 / budget as f64), Ordering::Relaxed);
}

/// Bytes that each session may take from now on, where `room` is what each may now and `most` is the most: less while more than
/// the process' budget is `used`, a share, and nobody can sleep instead; more again once much of it is free.
fn next_room(room: usize, most: usize, can_sleep: bool, used: f64) -> usize {
    match used {
        used if used > 1.0 && !can_sleep => (room - room / 8).max(LEAST_ROOM).min(most),
        used if used < ROOMY => (room + room / 8 + 1).min(most),
        _ => room,
    }
}

/// Memory that this process has, bytes; none where the system does not say.
fn resident_bytes() -> Option<u64> {
    // In KiB, whatever the size of a page.
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let kib: u64 = status.lines().find_map(|l| l.strip_prefix("VmRSS:")?.split_whitespace().next()?.parse().ok())?;
    Some(kib << 10)
}

/// The budget; half of the machine's memory if none is set.
fn budget_bytes(max_memory_mb: usize) -> u64 {
    static HALF: std::sync::OnceLock<u64> = std::sync::OnceLock::new();
    if max_memory_mb > 0 {
        return (max_memory_mb as u64) << 20;
    }
    *HALF.get_or_init(|| {
        let meminfo = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
        let total = meminfo.lines().find_map(|l| l.strip_prefix("MemTotal:")?.split_whitespace().next()?.parse().ok());
        total.map_or(u64::MAX, |kib: u64| kib * 512)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sessions_make_do_with_less_while_memory_is_short_and_nobody_can_sleep() {
        let most = 256 << 20;
        let run =
            |room: usize, can_sleep: bool, used: f64| (0..200).fold(room, |r, _| next_room(r, most, can_sleep, used));
        assert_eq!(run(most, false, 1.1), LEAST_ROOM);
        assert_eq!(run(most, true, 1.1), most, "who sleeps gives back more");
        assert_eq!(run(LEAST_ROOM, false, 0.9), LEAST_ROOM, "not to and fro");
        assert_eq!(run(LEAST_ROOM, false, 0.5), most);
        // One that was told to take less keeps to it.
        assert_eq!(next_room(1 << 20, 1 << 20, false, 2.0), 1 << 20);
    }
}
