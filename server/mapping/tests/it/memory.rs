//! Maps of which a part is out of memory.

use crate::map::{built, correction, drifted, drive, id, scans};
use percept_geometry::{Correction, se3};
use percept_mapping::{BlobId, Map, MapEntry, MapParams, MapStore, MappingError, Occupancy, SubmapId};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

/// Keeps blobs in memory, and loses them when told to.
#[derive(Debug, Default)]
struct Shelf {
    blobs: Mutex<BTreeMap<BlobId, Vec<u8>>>,
    is_full: AtomicBool,
    /// None: any number.
    max_bytes: Option<usize>,
}

impl MapStore for Shelf {
    fn put(&self, bytes: &[u8]) -> Option<BlobId> {
        let sum =
            bytes.iter().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3));
        let mut name = BlobId([0; 32]);
        name.0[..8].copy_from_slice(&sum.to_le_bytes());
        self.blobs.lock().unwrap().insert(name, bytes.to_vec());
        (!self.is_full.load(Ordering::Relaxed)).then_some(name)
    }

    fn get(&self, id: &BlobId) -> Option<Vec<u8>> {
        self.blobs.lock().unwrap().get(id).cloned()
    }

    fn max_bytes(&self) -> usize {
        self.max_bytes.unwrap_or(usize::MAX)
    }
}

#[test]
fn a_map_within_a_budget_is_the_map_without_and_takes_no_more_than_it() {
    let scans = scans();
    let free = built(&scans, |i| drifted(i, 0.004));
    let budget = free.memory().total() / 3;
    let mut map = Map::new(MapParams::default()).unwrap();
    // What is kept beside the map counts, too.
    map.set_store(Arc::new(Shelf { max_bytes: Some(budget + 1000), ..Shelf::default() }));
    map.set_beside(1000);
    for (i, scan) in scans.iter().enumerate() {
        map.insert(id(i), &MapEntry::at(drifted(i, 0.004)), Arc::clone(scan)).unwrap();
        // The newest submap alone takes some of it.
        assert!(map.memory().total() <= budget || map.submaps().iter().all(|s| !s.is_frozen() || !s.is_loaded()));
    }
    assert!(map.submaps().iter().any(|s| !s.is_loaded()));
    assert!(map.layers() == free.layers(), "what is needed is fetched");
    let (mut free, moved) = (free, correction(drive));
    for map in [&mut map, &mut free] {
        map.correct(&moved, &[]).unwrap();
        while !map.advance(usize::MAX) {}
    }
    assert_eq!((map.layers().occupancy, map.layers().cloud), (free.layers().occupancy, free.layers().cloud));
}

#[test]
fn composed_tiles_stay_while_their_submaps_are_out_of_memory_and_what_is_lost_is_named() {
    let (scans, shelf) = (scans(), Arc::<Shelf>::default());
    let mut map = built(&scans, drive);
    map.set_store(Arc::clone(&shelf) as Arc<dyn MapStore>);
    let whole = map.layers().occupancy.dense(1 << 20).unwrap();
    let first = map.submaps()[0].id();
    assert_eq!(map.evict(first), Ok(true));
    assert!(!map.submaps()[0].is_loaded());
    assert_eq!(map.layers().occupancy.dense(1 << 20).unwrap(), whole);
    assert!(!map.submaps()[0].is_loaded(), "nothing had to be fetched");
    // Lost: the rest of the map works, and says what is missing.
    let kept = std::mem::take(&mut *shelf.blobs.lock().unwrap());
    let shift = se3::from_xy_yaw(1.0, 0.0, 0.0);
    map.correct(&correction(|i| shift * drive(i)), &[]).unwrap();
    let part = map.layers();
    assert!(part.occupancy.num_known() > 1000 && part.cloud.len() > 1000);
    assert_eq!(part.missing(), vec![first]);
    let without = part.occupancy.dense(1 << 20).unwrap();
    assert_eq!(map.load(first), Err(MappingError::SubmapLost { id: first }));
    // Damaged is as good as lost.
    let damaged = kept.iter().map(|(id, bytes)| (*id, bytes[..bytes.len() - 1].to_vec())).collect();
    *shelf.blobs.lock().unwrap() = damaged;
    assert_eq!(map.load(first), Err(MappingError::SubmapLost { id: first }));
    *shelf.blobs.lock().unwrap() = kept;
    // There again, also for who reads without asking for that.
    assert_ne!(part.occupancy.dense(1 << 20).unwrap(), without);
    assert!(part.cloud.len() > 1000);
    assert!(map.layers().missing().is_empty());
    assert_eq!(map.load(first), Ok(()));
    map.correct(&correction(drive), &[]).unwrap();
    assert_eq!(map.layers().occupancy.dense(1 << 20).unwrap(), whole);
    assert!(map.load(SubmapId { robot: 7, run: 0, number: 0 }).is_err());
    // Who reads the grid fetches no cloud.
    assert_eq!(map.evict(first), Ok(true));
    let moved = map.submaps()[0].keyframes().keys().map(|id| (*id, shift * drive(id.0 as usize))).collect();
    map.correct(&Correction { t_map_base: moved }, &[]).unwrap();
    let before = map.memory().layers;
    assert!(map.layers().occupancy.num_known() > 1000);
    let grid = map.memory().layers - before;
    assert!(map.layers().cloud.len() > 1000);
    assert!(0 < grid && grid < map.memory().layers - before, "{grid}");
}

#[test]
fn a_store_that_takes_nothing_leaves_the_map_as_it_is() {
    let scans = scans();
    let mut map = built(&scans, drive);
    let before = map.layers().occupancy.dense(1 << 20).unwrap();
    map.set_store(Arc::new(Shelf { is_full: true.into(), max_bytes: Some(1), ..Shelf::default() }));
    assert!(map.submaps().iter().all(|s| s.is_loaded()));
    assert_eq!(map.layers().occupancy.dense(1 << 20).unwrap(), before);
}

#[test]
fn what_was_stored_ahead_stays_until_there_is_no_room_and_goes_then_without_being_stored() {
    let scans = scans();
    let mut map = built(&scans, drive);
    assert!(map.store_ahead().is_none(), "nowhere to store it");
    let shown = map.layers();
    let shelf = Arc::new(Shelf { max_bytes: Some(map.memory().total() * 6 / 5), ..Shelf::default() });
    map.set_store(Arc::clone(&shelf) as Arc<dyn MapStore>);
    let first = map.store_ahead().unwrap();
    assert!(map.store_ahead().is_none(), "one is under way");
    drop(first);
    let mut num = 0;
    while let Some(ahead) = map.store_ahead() {
        ahead.run();
        num += 1;
    }
    let frozen: Vec<_> = map.submaps().iter().filter(|s| s.is_frozen()).map(|s| s.id()).collect();
    assert_eq!(num, frozen.len());
    assert!(map.submaps().iter().all(|s| s.is_loaded()));
    shelf.is_full.store(true, Ordering::Relaxed);
    assert!(frozen.iter().all(|id| map.evict(*id) == Ok(true)), "all of it is stored");
    assert!(map.layers() == shown);
}
