//! Clouds kept for later requests: named by handles, for a stated time, within a budget.
//!
//! Nothing is forgotten before its time to make room: what does not fit is refused.

use crate::admission::{Admission, Quota};
use crate::clock::now_ns;
use crate::{Error, Limits, Result, observe};
use percept_geometry::PointCloud;
use std::collections::HashMap;
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

/// All that are kept for one owner.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptList {
    /// Oldest first.
    pub clouds: Vec<KeptCloud>,
    /// Of the budget, what they use, bytes.
    pub used_bytes: usize,
    /// The budget of all owners together, bytes.
    pub max_bytes: usize,
}

struct Entry {
    owner: String,
    /// Running number.
    number: u64,
    cloud: Arc<PointCloud>,
    size_bytes: usize,
    keep_ns: i64,
    expires_ns: i64,
}

#[derive(Default)]
struct Shelf {
    /// By the handle of the cloud.
    entries: HashMap<String, Entry>,
    used_bytes: usize,
    next: u64,
}

/// The kept clouds of a server.
pub struct KeptClouds {
    shelf: Mutex<Shelf>,
    max_clouds: usize,
    max_bytes: usize,
    max_s: usize,
    admission: Arc<Admission>,
}

/// The tenant of an owner: the first line of its name.
pub(crate) fn tenant_of(owner: &str) -> &str {
    owner.split('\n').next().unwrap_or_default()
}

impl KeptClouds {
    /// An empty shelf that forgets what has expired, asked or not.
    pub(crate) fn open(limits: &Limits, admission: Arc<Admission>) -> Arc<Self> {
        let kept = Arc::new(Self::new(limits, admission));
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

    fn new(limits: &Limits, admission: Arc<Admission>) -> Self {
        Self {
            shelf: Mutex::default(),
            max_clouds: limits.max_kept_clouds,
            max_bytes: limits.max_kept_bytes,
            max_s: limits.max_kept_s,
            admission,
        }
    }

    /// The shelf without what has expired.
    fn swept(&self, now_ns: i64) -> MutexGuard<'_, Shelf> {
        let mut shelf = self.shelf.lock().unwrap_or_else(PoisonError::into_inner);
        shelf.entries.retain(|_, e| e.expires_ns > now_ns);
        shelf.used_bytes = shelf.entries.values().map(|e| e.size_bytes).sum();
        observe::kept_clouds(shelf.entries.len(), shelf.used_bytes);
        shelf
    }

    fn described(handle: &str, e: &Entry) -> KeptCloud {
        KeptCloud {
            handle: handle.to_owned(),
            num_points: e.cloud.len(),
            size_bytes: e.size_bytes,
            expires_ns: e.expires_ns,
        }
    }

    pub(crate) fn keep(&self, owner: &str, cloud: Arc<PointCloud>, keep_s: Option<f64>) -> Result<KeptCloud> {
        let keep_s = keep_s.unwrap_or(self.max_s as f64);
        if !(keep_s > 0.0 && keep_s <= self.max_s as f64) {
            let words = format!("keep_s is {keep_s}; it must be positive and at most {}", self.max_s);
            return Err(Error::invalid("OUT_OF_RANGE", "keep_s", words));
        }
        let (now, size_bytes) = (now_ns(), cloud.memory_bytes());
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
        self.check_quota(&shelf, tenant_of(owner), size_bytes)?;
        let (number, handle) = (shelf.next, new_handle()?);
        let keep_ns = (keep_s * 1e9) as i64;
        let (owner, expires_ns) = (owner.to_owned(), now.saturating_add(keep_ns));
        let entry = Entry { owner, number, cloud, size_bytes, keep_ns, expires_ns };
        let described = Self::described(&handle, &entry);
        shelf.entries.insert(handle, entry);
        shelf.used_bytes += size_bytes;
        observe::kept_clouds(shelf.entries.len(), shelf.used_bytes);
        shelf.next += 1;
        Ok(described)
    }

    fn check_quota(&self, shelf: &Shelf, tenant: &str, size_bytes: usize) -> Result<()> {
        let quotas = self.admission.quotas();
        let Quota { max_kept_clouds, max_kept_bytes, .. } = quotas.of(tenant);
        if max_kept_clouds + max_kept_bytes == 0 {
            return Ok(());
        }
        let own = shelf.entries.values().filter(|e| tenant_of(&e.owner) == tenant);
        let (n, used) = own.fold((0, 0), |(n, used), e| (n + 1, used + e.size_bytes));
        let fits = |most: usize, needed: usize| most == 0 || needed <= most;
        if fits(*max_kept_clouds, n + 1) && fits(*max_kept_bytes, used + size_bytes) {
            return Ok(());
        }
        let words = format!(
            "{n} clouds of {used} bytes are kept for the tenant and this one has {size_bytes}; its quotas are \
             {max_kept_clouds} and {max_kept_bytes} bytes (0: any); drop clouds, or wait until they expire"
        );
        Err(Error::exhausted("KEPT_CLOUDS_FULL", "", words))
    }

    pub(crate) fn get(&self, owner: &str, field: &str, handle: &str) -> Result<Arc<PointCloud>> {
        let now = now_ns();
        let mut shelf = self.swept(now);
        let entry = shelf.entries.get_mut(handle).filter(|e| e.owner == owner);
        let entry = entry.ok_or_else(|| not_found(field, handle))?;
        entry.expires_ns = now.saturating_add(entry.keep_ns);
        Ok(Arc::clone(&entry.cloud))
    }

    pub(crate) fn list(&self, owner: &str) -> KeptList {
        let shelf = self.swept(now_ns());
        let mut own: Vec<(&String, &Entry)> = shelf.entries.iter().filter(|(_, e)| e.owner == owner).collect();
        own.sort_by_key(|(_, e)| e.number);
        let used_bytes = own.iter().map(|(_, e)| e.size_bytes).sum();
        let clouds = own.into_iter().map(|(handle, e)| Self::described(handle, e)).collect();
        KeptList { clouds, used_bytes, max_bytes: self.max_bytes }
    }

    pub(crate) fn forget(&self, owner: &str, handle: &str) -> Result<()> {
        let mut shelf = self.swept(now_ns());
        if shelf.entries.get(handle).is_none_or(|e| e.owner != owner) {
            return Err(not_found("handle", handle));
        }
        shelf.entries.remove(handle);
        Ok(())
    }
}

/// 128 bits that nobody can guess: who knows a handle was told it.
fn new_handle() -> Result<String> {
    let mut secret = [0; 16];
    getrandom::fill(&mut secret).map_err(Error::internal)?;
    Ok(format!("c-{:032x}", u128::from_be_bytes(secret)))
}

fn not_found(field: &str, handle: &str) -> Error {
    let shown: String = handle.chars().take(80).collect();
    let words = format!("{field} is {shown:?}, which is not kept or has expired; upload the cloud again");
    Error::not_found("CLOUD_NOT_FOUND", field, words)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Quotas;
    use nalgebra::Point3;

    const ME: &str = "me";

    fn cloud(n: usize) -> Arc<PointCloud> {
        Arc::new(PointCloud::from_positions(vec![Point3::origin(); n]))
    }

    fn shelf() -> KeptClouds {
        let limits = Limits { max_kept_clouds: 2, max_kept_bytes: 120, max_kept_s: 100, ..Limits::default() };
        KeptClouds::new(&limits, Arc::default())
    }

    #[test]
    fn a_tenant_keeps_no_more_than_its_quota_whoever_of_it_asks() {
        let each = Quota { max_kept_bytes: 100, ..Quota::default() };
        let admission = Admission::new(Quotas { each, ..Quotas::default() });
        let kept = KeptClouds::new(&Limits::default(), admission);
        kept.keep("site-a\nkey-1", cloud(6), None).unwrap();
        assert_eq!(kept.keep("site-a\nkey-2", cloud(3), None).unwrap_err().reason, "KEPT_CLOUDS_FULL");
        kept.keep("site-a\nkey-2", cloud(2), None).unwrap();
        kept.keep("site-b\nkey-1", cloud(8), None).unwrap();
    }

    #[test]
    fn a_full_budget_refuses_and_forgets_nothing() {
        let kept = shelf();
        let first = kept.keep(ME, cloud(6), None).unwrap();
        assert_eq!(first.size_bytes, 72);
        assert_eq!(kept.keep(ME, cloud(5), None).unwrap_err().reason, "KEPT_CLOUDS_FULL");
        let second = kept.keep(ME, cloud(4), None).unwrap();
        assert_eq!(kept.list(ME).used_bytes, 120);
        assert_eq!(kept.keep(ME, cloud(0), None).unwrap_err().reason, "KEPT_CLOUDS_FULL");
        assert_eq!(kept.get(ME, "cloud_handle", &first.handle).unwrap().len(), 6);
        kept.forget(ME, &second.handle).unwrap();
        assert_eq!(kept.list(ME).used_bytes, 72);
        assert_eq!(kept.forget(ME, &second.handle).unwrap_err().reason, "CLOUD_NOT_FOUND");
        assert_ne!(kept.keep(ME, cloud(1), None).unwrap().handle, second.handle);
    }

    #[test]
    fn the_clouds_of_others_are_as_if_they_were_not_there() {
        let kept = shelf();
        let mine = kept.keep(ME, cloud(6), None).unwrap();
        assert_eq!(kept.get("you", "cloud_handle", &mine.handle).unwrap_err().reason, "CLOUD_NOT_FOUND");
        assert_eq!(kept.forget("you", &mine.handle).unwrap_err().reason, "CLOUD_NOT_FOUND");
        let theirs = kept.list("you");
        assert!(theirs.clouds.is_empty() && theirs.used_bytes == 0);
        assert!(kept.get(ME, "cloud_handle", &mine.handle).is_ok());
        assert_eq!(kept.list(ME).clouds.len(), 1);
    }

    #[test]
    fn handles_tell_nothing_of_one_another() {
        let kept = KeptClouds::new(&Limits::default(), Arc::default());
        let handles: Vec<String> = (0..100).map(|_| kept.keep(ME, cloud(1), None).unwrap().handle).collect();
        let bits = |h: &String| u128::from_str_radix(h.strip_prefix("c-").unwrap(), 16).unwrap();
        // Of 128 fair coins all but one in 10^9 throws differ in 30 to 98.
        for pair in handles.windows(2) {
            let differing = (bits(&pair[0]) ^ bits(&pair[1])).count_ones();
            assert!((25..=103).contains(&differing), "{pair:?}");
        }
        let listed: Vec<String> = kept.list(ME).clouds.into_iter().map(|c| c.handle).collect();
        assert_eq!(listed, handles, "oldest first");
    }

    #[test]
    fn what_has_expired_is_gone_and_makes_room() {
        let kept = shelf();
        let short = kept.keep(ME, cloud(10), Some(1.0)).unwrap();
        drop(kept.swept(short.expires_ns - 1));
        assert!(kept.get(ME, "cloud_handle", &short.handle).is_ok());
        let used = kept.list(ME).clouds[0].expires_ns;
        assert!(used >= short.expires_ns);
        drop(kept.swept(used));
        assert_eq!(kept.get(ME, "cloud_handle", &short.handle).unwrap_err().field, "cloud_handle");
        assert_eq!(kept.list(ME).used_bytes, 0);
        for keep_s in [0.0, -1.0, f64::NAN, 100.1] {
            assert_eq!(kept.keep(ME, cloud(1), Some(keep_s)).unwrap_err().field, "keep_s");
        }
    }
}
