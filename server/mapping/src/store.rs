//! Where submaps go that are not in memory, and what memory there is.

use serde::{Deserialize, Serialize};

/// Name of stored bytes: what the store makes of them, a digest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct BlobId(pub [u8; 32]);

/// Takes what does not fit into memory, and gives it back. Called by the writer and by readers, which wait for it.
pub trait MapStore: std::fmt::Debug + Send + Sync {
    /// Keeps bytes under a name that follows from them; none if they cannot be kept.
    fn put(&self, bytes: &[u8]) -> Option<BlobId>;
    /// The same for what has room in memory still: that it cannot be kept is no fault.
    fn put_ahead(&self, bytes: &[u8]) -> Option<BlobId> {
        self.put(bytes)
    }
    /// Whether [`Self::put_ahead`] is worth a try.
    fn takes_ahead(&self) -> bool {
        true
    }
    /// The bytes of a name, whole; none if they are gone or damaged.
    fn get(&self, id: &BlobId) -> Option<Vec<u8>>;
    /// Bytes that the map, and what the caller keeps beside it, may take in memory now. May change: others need memory, too.
    fn max_bytes(&self) -> usize;
}

/// What a map takes in memory, by part, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MapMemory {
    /// What keyframes saw.
    pub scans: usize,
    /// Submaps' layers.
    pub layers: usize,
    /// Composed tiles.
    pub tiles: usize,
}

impl MapMemory {
    /// All of it.
    pub fn total(&self) -> usize {
        self.scans + self.layers + self.tiles
    }
}
