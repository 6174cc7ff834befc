//! What tenants use of the server, and what they may: rates, places, shares of the computing time.
//!
//! Asked before anything is done, in the name of a tenant; what is over its quota is told to come back, and when.
//! Bounds of addresses and of the server as a whole are the doors' and in [`crate::Limits`].

mod quotas;
mod rate;

pub use quotas::{Quota, Quotas};

use crate::{Error, Result, observe, reason};
use rate::Bucket;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::{Duration, Instant};

/// Rates that were not asked for so long are full again, and need not be remembered.
const IDLE: Duration = Duration::from_secs(120);
/// Remembered tenants and sessions from which on the idle ones are looked for.
const MANY: usize = 1024;

/// What is held at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Held {
    /// An ingest stream.
    IngestStream,
    /// A watch of events.
    Watch,
}

/// The use of the server by its tenants.
#[derive(Default)]
pub struct Admission {
    quotas: RwLock<Arc<Quotas>>,
    used: Mutex<Used>,
}

#[derive(Default)]
struct Used {
    tenants: HashMap<String, TenantUse>,
    /// By tenant and session.
    sessions: HashMap<(String, String), Rates>,
}

/// Of frames.
struct Rates {
    frames: Bucket,
    bytes: Bucket,
    asked: Instant,
}

struct TenantUse {
    requests: Bucket,
    ingest: Rates,
    computing_ms: Bucket,
    streams: usize,
    watches: usize,
    asked: Instant,
}

impl Rates {
    fn full(frames: usize, bytes: usize, now: Instant) -> Self {
        Self { frames: Bucket::full(frames, now), bytes: Bucket::full(bytes, now), asked: now }
    }

    fn wait(&mut self, frames: usize, bytes: usize, now: Instant) -> Option<Duration> {
        self.asked = now;
        self.frames.wait(frames, now).max(self.bytes.wait(bytes, now))
    }

    fn take(&mut self, num_bytes: usize) {
        self.frames.take(1.0);
        self.bytes.take(num_bytes as f64);
    }
}

impl Used {
    fn tenant(&mut self, tenant: &str, quota: &Quota, now: Instant) -> &mut TenantUse {
        if self.tenants.len() >= MANY && !self.tenants.contains_key(tenant) {
            self.tenants.retain(|_, u| u.streams + u.watches > 0 || now.duration_since(u.asked) < IDLE);
        }
        let used = self.tenants.entry(tenant.to_owned()).or_insert_with(|| TenantUse {
            requests: Bucket::full(quota.max_requests_per_s, now),
            ingest: Rates::full(quota.max_frames_per_s, quota.max_frame_bytes_per_s, now),
            computing_ms: Bucket::full(quota.max_computing_ms_per_s, now),
            streams: 0,
            watches: 0,
            asked: now,
        });
        used.asked = now;
        used
    }

    fn session(&mut self, tenant: &str, session: &str, quota: &Quota, now: Instant) -> &mut Rates {
        let key = (tenant.to_owned(), session.to_owned());
        if self.sessions.len() >= MANY && !self.sessions.contains_key(&key) {
            self.sessions.retain(|_, rates| now.duration_since(rates.asked) < IDLE);
        }
        let (frames, bytes) = (quota.max_session_frames_per_s, quota.max_session_frame_bytes_per_s);
        self.sessions.entry(key).or_insert_with(|| Rates::full(frames, bytes, now))
    }
}

impl Admission {
    /// By these quotas.
    pub fn new(quotas: Quotas) -> Arc<Self> {
        Arc::new(Self { quotas: RwLock::new(Arc::new(quotas)), used: Mutex::default() })
    }

    /// Puts other quotas into force; what is used already counts.
    pub fn set(&self, quotas: Quotas) {
        *self.quotas.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(quotas);
    }

    /// The quotas in force.
    pub fn quotas(&self) -> Arc<Quotas> {
        Arc::clone(&self.quotas.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// How many sessions a tenant may have, 0 for any number.
    pub(crate) fn max_sessions(&self, tenant: &str) -> usize {
        self.quotas().of(tenant).max_sessions
    }

    fn used(&self) -> MutexGuard<'_, Used> {
        self.used.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts a request.
    ///
    /// # Errors
    /// `RATE_LIMITED`.
    pub(crate) fn request(&self, tenant: &str) -> Result<()> {
        let quotas = self.quotas();
        let quota = quotas.of(tenant);
        let most = quota.max_requests_per_s;
        if most == 0 {
            return Ok(());
        }
        let now = Instant::now();
        let mut used = self.used();
        let bucket = &mut used.tenant(tenant, quota, now).requests;
        if let Some(wait) = bucket.wait(most, now) {
            return Err(limited(&format!("{most} requests a second"), wait));
        }
        bucket.take(1.0);
        Ok(())
    }

    /// Counts a frame of so many bytes, if it may come now; else how long until it may.
    pub(crate) fn frame(&self, tenant: &str, session: &str, num_bytes: usize) -> std::result::Result<(), Duration> {
        let quotas = self.quotas();
        let quota = quotas.of(tenant);
        let (frames, bytes) = (quota.max_frames_per_s, quota.max_frame_bytes_per_s);
        let (own_frames, own_bytes) = (quota.max_session_frames_per_s, quota.max_session_frame_bytes_per_s);
        let (is_bound, is_own_bound) = (frames + bytes > 0, own_frames + own_bytes > 0);
        if !is_bound && !is_own_bound {
            return Ok(());
        }
        let now = Instant::now();
        let mut used = self.used();
        let mut wait = None;
        if is_bound {
            wait = used.tenant(tenant, quota, now).ingest.wait(frames, bytes, now);
        }
        if is_own_bound {
            wait = wait.max(used.session(tenant, session, quota, now).wait(own_frames, own_bytes, now));
        }
        if let Some(wait) = wait {
            return Err(wait);
        }
        if is_bound {
            used.tenant(tenant, quota, now).ingest.take(num_bytes);
        }
        if is_own_bound {
            used.session(tenant, session, quota, now).take(num_bytes);
        }
        Ok(())
    }

    /// A place for what lasts.
    ///
    /// # Errors
    /// `TOO_MANY_STREAMS`, `TOO_MANY_WATCHERS`.
    pub(crate) fn hold(self: &Arc<Self>, tenant: &str, held: Held) -> Result<TenantPlace> {
        let quotas = self.quotas();
        let quota = quotas.of(tenant);
        let mut used = self.used();
        let used = used.tenant(tenant, quota, Instant::now());
        let (count, most, reason, what) = match held {
            Held::IngestStream => {
                (&mut used.streams, quota.max_ingest_streams, reason::TOO_MANY_STREAMS, "ingest streams")
            }
            Held::Watch => (&mut used.watches, quota.max_watchers, reason::TOO_MANY_WATCHERS, "watchers"),
        };
        if most > 0 && *count >= most {
            observe::shed(reason);
            let words = format!("{most} {what} of the tenant are open, its quota; end some");
            return Err(Error::exhausted(reason, "", words));
        }
        *count += 1;
        Ok(TenantPlace { admission: Arc::clone(self), tenant: tenant.to_owned(), held })
    }

    fn release(&self, tenant: &str, held: Held) {
        if let Some(used) = self.used().tenants.get_mut(tenant) {
            match held {
                Held::IngestStream => used.streams = used.streams.saturating_sub(1),
                Held::Watch => used.watches = used.watches.saturating_sub(1),
            }
        }
    }

    /// Somebody whose frames are computed.
    pub(crate) fn sender(&self, tenant: &str, session: &str) -> Asker {
        Asker { name: session.to_owned(), weight: self.quotas().of(tenant).weight, account: None }
    }

    /// Somebody whose questions or toolbox requests are computed; who has the same name shares turns.
    ///
    /// # Errors
    /// `RATE_LIMITED` if the tenant's computing time is used up.
    pub(crate) fn asker(self: &Arc<Self>, tenant: &str, name: &str) -> Result<Asker> {
        let quotas = self.quotas();
        let quota = quotas.of(tenant);
        let most = quota.max_computing_ms_per_s;
        if most > 0 {
            let now = Instant::now();
            if let Some(wait) = self.used().tenant(tenant, quota, now).computing_ms.wait(most, now) {
                return Err(limited(&format!("{most} ms of computing time a second"), wait));
            }
        }
        let account = (most > 0).then(|| (Arc::clone(self), tenant.to_owned()));
        Ok(Asker { name: name.to_owned(), weight: quota.weight, account })
    }

    fn computed(&self, tenant: &str, time: Duration) {
        if let Some(used) = self.used().tenants.get_mut(tenant) {
            used.computing_ms.take(time.as_secs_f64() * 1e3);
        }
    }
}

/// Refused for now, because a tenant's rate is used up.
pub(crate) fn limited(rate: &str, wait: Duration) -> Error {
    observe::shed(reason::RATE_LIMITED);
    let words = format!("the tenant's quota of {rate} is used up; try again in {:.3} s", wait.as_secs_f64());
    Error::too_fast(reason::RATE_LIMITED, words, wait)
}

/// A tenant's place for what lasts; dropping gives it back.
pub struct TenantPlace {
    admission: Arc<Admission>,
    tenant: String,
    held: Held,
}

impl Drop for TenantPlace {
    fn drop(&mut self) {
        self.admission.release(&self.tenant, self.held);
    }
}

/// Whose work it is that is computed.
#[derive(Clone)]
pub struct Asker {
    name: String,
    weight: usize,
    account: Option<(Arc<Admission>, String)>,
}

impl Asker {
    /// Somebody without a quota.
    pub fn named(name: impl Into<String>) -> Self {
        Self { name: name.into(), weight: 1, account: None }
    }

    /// Who shares turns.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// Its share.
    pub(crate) fn weight(&self) -> usize {
        self.weight
    }

    /// Notes how long its work took.
    pub(crate) fn charge(&self, time: Duration) {
        if let Some((admission, tenant)) = &self.account {
            admission.computed(tenant, time);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(each: Quota) -> Arc<Admission> {
        let tenants = [("free".to_owned(), Quota::default())].into();
        Admission::new(Quotas { each, tenants })
    }

    #[test]
    fn a_tenant_that_is_too_fast_is_told_when_to_come_back_and_others_are_not() {
        let admission = with(Quota { max_requests_per_s: 5, ..Quota::default() });
        let refused = (0..20).find_map(|_| admission.request("a").err()).unwrap();
        assert_eq!(refused.reason, "RATE_LIMITED");
        assert!(refused.retry_after.unwrap() <= Duration::from_millis(400), "{refused:?}");
        assert!(admission.request("b").is_ok());
        assert!((0..100).all(|_| admission.request("free").is_ok()));
    }

    #[test]
    fn frames_are_bound_by_tenant_and_by_session_in_number_and_in_bytes() {
        let count = |quota: Quota, session: fn(usize) -> &'static str, bytes: usize| {
            let admission = with(quota);
            (0..100).filter(|i| admission.frame("a", session(*i), bytes).is_ok()).count()
        };
        let two = |i: usize| ["x", "y"][i % 2];
        // One more each, while the test takes its time.
        assert!((10..=11).contains(&count(Quota { max_frames_per_s: 10, ..Quota::default() }, two, 1)));
        assert!((20..=22).contains(&count(Quota { max_session_frames_per_s: 10, ..Quota::default() }, two, 1)));
        assert_eq!(count(Quota { max_frame_bytes_per_s: 1000, ..Quota::default() }, two, 300), 4);
        assert_eq!(count(Quota { max_session_frame_bytes_per_s: 1000, ..Quota::default() }, two, 5000), 2);
        assert_eq!(count(Quota::default(), two, usize::MAX), 100);
    }

    #[test]
    fn places_are_given_back() {
        let admission = with(Quota { max_watchers: 2, ..Quota::default() });
        let mut held: Vec<_> = (0..2).map(|_| admission.hold("a", Held::Watch).unwrap()).collect();
        assert_eq!(admission.hold("a", Held::Watch).err().unwrap().reason, "TOO_MANY_WATCHERS");
        assert!(admission.hold("a", Held::IngestStream).is_ok() && admission.hold("b", Held::Watch).is_ok());
        held.pop();
        assert!(admission.hold("a", Held::Watch).is_ok());
    }

    #[test]
    fn computing_time_is_charged_when_it_was_used() {
        let admission = with(Quota { max_computing_ms_per_s: 100, ..Quota::default() });
        admission.asker("a", "a").unwrap().charge(Duration::from_millis(1100));
        let refused = admission.asker("a", "a").err().unwrap();
        let wait = refused.retry_after.unwrap().as_secs_f64();
        assert!((9.0..=10.0).contains(&wait), "{wait}");
        assert!(admission.asker("b", "b").is_ok());
        // Other quotas count from then on.
        admission.set(Quotas::default());
        assert!(admission.asker("a", "a").is_ok());
    }

    #[test]
    fn ever_new_sessions_take_no_memory_for_long() {
        let admission = with(Quota { max_session_frames_per_s: 10, ..Quota::default() });
        for i in 0..3 * MANY {
            assert!(admission.frame("a", &format!("s{i}"), 1).is_ok());
        }
        let mut used = admission.used();
        let later = Instant::now() + 2 * IDLE;
        used.session("a", "new", &Quota::default(), later);
        assert_eq!(used.sessions.len(), 1);
    }
}
