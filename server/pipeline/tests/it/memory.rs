//! A session whose map does not fit into memory is the same session.

use crate::drive::{empty, planar};
use percept_geometry::SensorFrame;
use percept_mapping::{BlobId, MapStore};
use percept_pipeline::{Pipeline, PipelineParams};
use std::sync::{Arc, Mutex};

/// Keeps what there is no room for, and counts how often it is asked.
#[derive(Debug, Default)]
struct Shelf {
    blobs: Mutex<Vec<Vec<u8>>>,
    num_fetched: Mutex<usize>,
}

impl MapStore for Shelf {
    fn put(&self, bytes: &[u8]) -> Option<BlobId> {
        let mut blobs = self.blobs.lock().unwrap();
        blobs.push(bytes.to_vec());
        let mut id = BlobId([0; 32]);
        id.0[..8].copy_from_slice(&(blobs.len() as u64 - 1).to_le_bytes());
        Some(id)
    }

    fn get(&self, id: &BlobId) -> Option<Vec<u8>> {
        *self.num_fetched.lock().unwrap() += 1;
        let number = u64::from_le_bytes(id.0[..8].try_into().unwrap());
        self.blobs.lock().unwrap().get(number as usize).cloned()
    }

    fn max_bytes(&self) -> usize {
        1
    }
}

fn driven(frames: &[SensorFrame], store: Option<Arc<Shelf>>) -> Pipeline {
    let mut pipeline = empty(&planar(90.0), PipelineParams::default());
    if let Some(store) = store {
        pipeline.set_map_store(store);
    }
    for frame in frames {
        // A report that is kept would hold its keyframe's scan in memory.
        pipeline.process(frame).unwrap();
    }
    pipeline.settle();
    pipeline
}

#[test]
fn a_session_that_keeps_no_scan_in_memory_closes_the_same_loops_and_has_the_same_trajectory() {
    let frames: Vec<_> = planar(90.0).frames().map(|f| f.frame).collect();
    let shelf = Arc::new(Shelf::default());
    let (free, bounded) = (driven(&frames, None), driven(&frames, Some(Arc::clone(&shelf))));
    // The submap that is being filled stays.
    assert!(2 * bounded.memory().map.scans < free.memory().map.scans);
    assert!(*shelf.num_fetched.lock().unwrap() > 0, "loops were measured in what is out of memory");
    let (free, bounded) = (free.snapshot(), bounded.snapshot());
    // Places, graph and local model are the same, whatever of the map is in memory.
    let beside = |s: &percept_pipeline::Snapshot| (s.memory.places, s.memory.graph, s.memory.odometry);
    assert_eq!(beside(&free), beside(&bounded));
    assert!(free.memory.places > 0 && free.memory.graph > 0 && free.memory.odometry > 100_000, "{:?}", free.memory);
    assert!(free.loops.len() > 3);
    assert_eq!(free.loops, bounded.loops);
    assert_eq!(free.keyframes, bounded.keyframes);
    assert!(free.trajectory().eq(bounded.trajectory()));
}
