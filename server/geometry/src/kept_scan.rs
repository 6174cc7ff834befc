//! What a keyframe saw, in memory or out of it.

use crate::KeyframeScan;
use std::sync::{Arc, PoisonError, RwLock, Weak};

/// Where a scan lies that is out of memory.
pub trait ScanSource: std::fmt::Debug + Send + Sync {
    /// The scan as it was; none if it is gone or damaged.
    fn fetch(&self) -> Option<KeyframeScan>;
}

/// What a keyframe saw. Clones are one: once it is out of memory, it is for all who have it, and each fetches it while it is
/// needed.
#[derive(Debug, Clone)]
pub struct KeptScan {
    held: Arc<RwLock<Held>>,
}

#[derive(Debug)]
struct Held {
    /// None while it is out of memory.
    scan: Option<Arc<KeyframeScan>>,
    /// What somebody has fetched and still uses.
    in_use: Weak<KeyframeScan>,
    source: Option<Arc<dyn ScanSource>>,
}

impl From<Arc<KeyframeScan>> for KeptScan {
    fn from(scan: Arc<KeyframeScan>) -> Self {
        Self { held: Arc::new(RwLock::new(Held { in_use: Weak::new(), scan: Some(scan), source: None })) }
    }
}

impl From<&Arc<KeyframeScan>> for KeptScan {
    fn from(scan: &Arc<KeyframeScan>) -> Self {
        Arc::clone(scan).into()
    }
}

impl KeptScan {
    fn read<T>(&self, look: impl FnOnce(&Held) -> T) -> T {
        look(&self.held.read().unwrap_or_else(PoisonError::into_inner))
    }

    fn write<T>(&self, change: impl FnOnce(&mut Held) -> T) -> T {
        change(&mut self.held.write().unwrap_or_else(PoisonError::into_inner))
    }

    /// The scan, fetched if it is out of memory, where it stays; none if it cannot be had.
    pub fn get(&self) -> Option<Arc<KeyframeScan>> {
        let (scan, source) = self.read(|h| (h.scan.clone().or_else(|| h.in_use.upgrade()), h.source.clone()));
        if scan.is_some() {
            return scan;
        }
        let fetched = Arc::new(source?.fetch()?);
        self.write(|h| h.in_use = Arc::downgrade(&fetched));
        Some(fetched)
    }

    /// Whether it is in memory for good.
    pub fn is_loaded(&self) -> bool {
        self.read(|h| h.scan.is_some())
    }

    /// What it takes in memory, bytes.
    pub fn memory_bytes(&self) -> usize {
        size_of::<Held>() + self.read(|h| h.scan.as_ref().map_or(0, |s| s.memory_bytes()))
    }

    /// Has `keep` put it somewhere while it stays in memory, so that taking it out costs nothing later. Whether it is put.
    pub fn put(&self, keep: impl FnOnce(&Arc<KeyframeScan>) -> Option<Arc<dyn ScanSource>>) -> bool {
        let (scan, source) = self.read(|h| (h.scan.clone(), h.source.clone()));
        let (Some(scan), None) = (scan, &source) else { return source.is_some() };
        let put = keep(&scan);
        let is_put = put.is_some();
        self.write(|h| h.source = h.source.take().or(put));
        is_put
    }

    /// Takes it out of memory, once `keep` has put it somewhere; how many bytes that frees, none if it was not put.
    pub fn evict(&self, keep: impl FnOnce(&Arc<KeyframeScan>) -> Option<Arc<dyn ScanSource>>) -> usize {
        let (scan, source) = self.read(|h| (h.scan.clone(), h.source.clone()));
        let Some(scan) = scan else { return 0 };
        let Some(source) = source.or_else(|| keep(&scan)) else { return 0 };
        self.write(|h| {
            h.in_use = Arc::downgrade(&scan);
            (h.scan, h.source) = (None, Some(source));
        });
        scan.memory_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PointCloud, Pose, Timestamp};
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[derive(Debug)]
    struct Shelf(KeyframeScan, AtomicUsize);

    impl ScanSource for Shelf {
        fn fetch(&self) -> Option<KeyframeScan> {
            (self.1.fetch_add(1, Ordering::Relaxed) < 2).then(|| self.0.clone())
        }
    }

    #[test]
    fn a_scan_out_of_memory_is_fetched_while_it_is_used_and_is_out_for_all_who_have_it() {
        let scan = Arc::new(KeyframeScan {
            stamp: Timestamp(7),
            sensor: "lidar".into(),
            t_base_sensor: Pose::identity(),
            base_height_m: 0.0,
            hits: PointCloud::from_positions(vec![nalgebra::Point3::new(1.0, 2.0, 3.0); 100]),
            misses: vec![],
            planar: true,
            features: None,
        });
        let kept = KeptScan::from(&scan);
        let other = kept.clone();
        assert_eq!(kept.evict(|_| None), 0);
        assert!(kept.is_loaded());
        let shelf = Arc::new(Shelf(scan.as_ref().clone(), AtomicUsize::new(0)));
        assert!(!kept.put(|_| None));
        assert!(kept.put(|_| Some(shelf.clone())) && kept.is_loaded());
        assert_eq!(kept.evict(|_| panic!("it is put")), scan.memory_bytes());
        assert!(!other.is_loaded() && other.memory_bytes() < 200);
        assert!(Arc::ptr_eq(&other.get().unwrap(), &scan), "who still has it lends it");
        let expected = scan.as_ref().clone();
        drop(scan);
        let (a, b) = (other.get().unwrap(), kept.get().unwrap());
        assert!(Arc::ptr_eq(&a, &b) && *a == expected);
        assert_eq!(shelf.1.load(Ordering::Relaxed), 1);
        drop((a, b));
        assert!(kept.get().is_some());
        assert!(kept.get().is_none(), "what is lost is none");
    }
}
