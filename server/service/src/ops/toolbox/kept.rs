//! Clouds kept for later requests: named by handles, for a stated time, within a budget.
//!
//! Nothing is forgotten before its time to make room: what does not fit is refused.

use crate::ops::sessions::now_ns;
use crate::{Error, Limits, Result};
use percept_geometry::PointCloud;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How often the forgotten are looked for.
const SWEEP: Duration = Duration::from_secs(5);

/// A cloud that is kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptCloud {
    /// Names it.
    pub handle: String,
    /// Points.
    pub num_points: usize,
    /// What it takes of the budget, bytes.
    pub size_bytes: usize,
    /// When it is forgotten unless it is used, nanoseconds since the Unix epoch.
    pub expires_ns: i64,
}

/// All that are kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptList {
    /// Oldest first.
    pub clouds: Vec<KeptCloud>,
    /// Budget that is used, bytes.
    pub used_bytes: usize,
    /// Budget in all, bytes.
    pub max_bytes: usize,
}

struct Entry {
    cloud: Arc<PointCloud>,
    size_bytes: usize,
    keep_ns: i64,
    expires_ns: i64,
}

#[derive(Default)]
struct Shelf {
    /// By the number of the cloud.
    entries: BTreeMap<u64, Entry>,
    used_bytes: usize,
    next: u64,
}

/// The kept clouds of a server.
pub struct KeptClouds {
    shelf: Mutex<Shelf>,
    max_clouds: usize,
    max_bytes: usize,
    max_s: usize,
    /// Told apart from the handles of a server before a restart.
    begin_ns: i64,
}

impl KeptClouds {
    /// An empty shelf that forgets what has expired, asked or not.
    pub(crate) fn open(limits: &Limits) -> Arc<Self> {
        let kept = Arc::new(Self::new(limits));
        let weak = Arc::downgrade(&kept);
        tokio::spawn(async move {
            loop {
                tokio::time::sleep(SWEEP).await;
                let Some(kept) = weak.upgrade() else { return };
                drop(kept.swept(now_ns()));
            }
        });
        kept
    }

    fn new(limits: &Limits) -> Self {
        Self {
            shelf: Mutex::default(),
            max_clouds: limits.max_kept_clouds,
            max_bytes: limits.max_kept_bytes,
            max_s: limits.max_kept_s,
            begin_ns: now_ns(),
        }
    }

    /// The shelf without what has expired.
    fn swept(&self, now_ns: i64) -> MutexGuard<'_, Shelf> {
        let mut shelf = self.shelf.lock().unwrap_or_else(PoisonError::into_inner);
        shelf.entries.retain(|_, e| e.expires_ns > now_ns);
        shelf.used_bytes = shelf.entries.values().map(|e| e.size_bytes).sum();
        shelf
    }

    fn described(&self, number: u64, e: &Entry) -> KeptCloud {
        KeptCloud {
            handle: format!("c-{:x}-{number:x}", self.begin_ns),
            num_points: e.cloud.len(),
            size_bytes: e.size_bytes,
            expires_ns: e.expires_ns,
        }
    }

    fn number(&self, handle: &str) -> Option<u64> {
        let number = handle.strip_prefix(&format!("c-{:x}-", self.begin_ns))?;
        u64::from_str_radix(number, 16).ok().filter(|n| format!("{n:x}") == number)
    }

    pub(crate) fn keep(&self, cloud: Arc<PointCloud>, keep_s: Option<f64>) -> Result<KeptCloud> {
        let keep_s = keep_s.unwrap_or(self.max_s as f64);
        if !(keep_s > 0.0 && keep_s <= self.max_s as f64) {
            let words = format!("keep_s is {keep_s}; it must be positive and at most {}", self.max_s);
            return Err(Error::invalid("OUT_OF_RANGE", "keep_s", words));
        }
        let (now, size_bytes) = (now_ns(), size_of(&cloud));
        let mut shelf = self.swept(now);
        if shelf.entries.len() >= self.max_clouds || shelf.used_bytes + size_bytes > self.max_bytes {
            let (n, used) = (shelf.entries.len(), shelf.used_bytes);
            let words = format!(
                "{n} clouds of {used} bytes are kept and this one has {size_bytes}; the limits are {} and {} bytes; \
                 drop clouds, or wait until they expire",
                self.max_clouds, self.max_bytes
            );
            return Err(Error::exhausted("KEPT_CLOUDS_FULL", "", words));
        }
        let number = shelf.next;
        let keep_ns = (keep_s * 1e9) as i64;
        let entry = Entry { cloud, size_bytes, keep_ns, expires_ns: now.saturating_add(keep_ns) };
        let described = self.described(number, &entry);
        shelf.entries.insert(number, entry);
        shelf.used_bytes += size_bytes;
        shelf.next += 1;
        Ok(described)
    }

    pub(crate) fn get(&self, field: &str, handle: &str) -> Result<Arc<PointCloud>> {
        let now = now_ns();
        let mut shelf = self.swept(now);
        let entry = self.number(handle).and_then(|n| shelf.entries.get_mut(&n));
        let entry = entry.ok_or_else(|| not_found(field, handle))?;
        entry.expires_ns = now.saturating_add(entry.keep_ns);
        Ok(Arc::clone(&entry.cloud))
    }

    pub(crate) fn list(&self) -> KeptList {
        let shelf = self.swept(now_ns());
        let clouds = shelf.entries.iter().map(|(n, e)| self.described(*n, e)).collect();
        KeptList { clouds, used_bytes: shelf.used_bytes, max_bytes: self.max_bytes }
    }

    pub(crate) fn forget(&self, handle: &str) -> Result<()> {
        let mut shelf = self.swept(now_ns());
        let found = self.number(handle).and_then(|n| shelf.entries.remove(&n));
        found.map(|_| ()).ok_or_else(|| not_found("handle", handle))
    }
}

fn not_found(field: &str, handle: &str) -> Error {
    let shown: String = handle.chars().take(80).collect();
    let words = format!("{field} is {shown:?}, which is not kept or has expired; upload the cloud again");
    Error::not_found("CLOUD_NOT_FOUND", field, words)
}

fn size_of(c: &PointCloud) -> usize {
    let channels = [
        (c.colors.is_some(), 3),
        (c.intensities.is_some(), 4),
        (c.normals.is_some(), 12),
        (c.time_offsets_s.is_some(), 4),
    ];
    c.len() * (12 + channels.iter().map(|(there, bytes)| usize::from(*there) * bytes).sum::<usize>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn cloud(n: usize) -> Arc<PointCloud> {
        Arc::new(PointCloud::from_positions(vec![Point3::origin(); n]))
    }

    fn shelf() -> KeptClouds {
        KeptClouds::new(&Limits { max_kept_clouds: 2, max_kept_bytes: 120, max_kept_s: 100, ..Limits::default() })
    }

    #[test]
    fn a_full_budget_refuses_and_forgets_nothing() {
        let kept = shelf();
        let first = kept.keep(cloud(6), None).unwrap();
        assert_eq!(first.size_bytes, 72);
        assert_eq!(kept.keep(cloud(5), None).unwrap_err().reason, "KEPT_CLOUDS_FULL");
        let second = kept.keep(cloud(4), None).unwrap();
        assert_eq!(kept.list().used_bytes, 120);
        assert_eq!(kept.keep(cloud(0), None).unwrap_err().reason, "KEPT_CLOUDS_FULL");
        assert_eq!(kept.get("cloud_handle", &first.handle).unwrap().len(), 6);
        kept.forget(&second.handle).unwrap();
        assert_eq!(kept.list().used_bytes, 72);
        assert_eq!(kept.forget(&second.handle).unwrap_err().reason, "CLOUD_NOT_FOUND");
        assert_ne!(kept.keep(cloud(1), None).unwrap().handle, second.handle);
    }

    #[test]
    fn what_has_expired_is_gone_and_makes_room() {
        let kept = shelf();
        let short = kept.keep(cloud(10), Some(1.0)).unwrap();
        drop(kept.swept(short.expires_ns - 1));
        assert!(kept.get("cloud_handle", &short.handle).is_ok());
        let used = kept.list().clouds[0].expires_ns;
        assert!(used >= short.expires_ns);
        drop(kept.swept(used));
        assert_eq!(kept.get("cloud_handle", &short.handle).unwrap_err().field, "cloud_handle");
        assert_eq!(kept.list().used_bytes, 0);
        for keep_s in [0.0, -1.0, f64::NAN, 100.1] {
            assert_eq!(kept.keep(cloud(1), Some(keep_s)).unwrap_err().field, "keep_s");
        }
    }
}
