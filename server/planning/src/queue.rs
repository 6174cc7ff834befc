//! The open list of a search whose estimates never fall: a ring of buckets.

/// Costs are whole numbers of 2^-30 cells: sums are exact, so that ways of the same length are known to be the same, and
/// sqrt 2 is off by 3e-10 of its value at most. 64 bits hold 1.7e10 cells.
pub(crate) const ONE: u64 = 1 << 30;

/// sqrt 2, rounded.
pub(crate) const DIAGONAL: u64 = 1_518_500_250;

/// Shortest way over a grid without obstacles.
#[inline]
pub(crate) fn octile(dx: u32, dy: u32) -> u64 {
    u64::from(dx.max(dy)) * ONE + u64::from(dx.min(dy)) * (DIAGONAL - ONE)
}

/// log2 of a bucket's width if there is room for all: an eighth of a cell.
const FINE: u32 = 27;

/// log2 of the most buckets.
const MOST: u32 = 14;

/// An entry of the open list.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Entry {
    pub(crate) cost: u64,
    pub(crate) index: u32,
    /// The step that led here.
    pub(crate) step: u8,
}

/// Buckets of entries by estimate; within one the last comes first. What is taken is in order up to a bucket's width, so
/// that a search has to accept improvements of what it expanded, and ends when it leaves the goal's bucket.
///
/// Source: Dial, "Algorithm 360: shortest-path forest with topological ordering", 1969.
#[derive(Debug)]
pub(crate) struct BucketQueue {
    ring: Vec<Vec<Entry>>,
    shift: u32,
    /// Number of the bucket being emptied, counted on without end.
    current: u64,
    len: usize,
}

impl BucketQueue {
    /// For estimates that are at most `spread` above the one last taken.
    pub(crate) fn new(first: u64, spread: u64) -> Self {
        let mut shift = FINE;
        while (spread >> shift) + 2 > 1 << MOST {
            shift += 1;
        }
        let buckets = ((spread >> shift) + 2).next_power_of_two() as usize;
        Self { ring: vec![Vec::new(); buckets], shift, current: first >> shift, len: 0 }
    }

    #[inline]
    pub(crate) fn push(&mut self, estimate: u64, entry: Entry) {
        let bucket = (estimate >> self.shift).max(self.current);
        let slot = bucket as usize & (self.ring.len() - 1);
        self.ring[slot].push(entry);
        self.len += 1;
    }

    /// The next entry, if any is left in a bucket that begins below `limit`.
    #[inline]
    pub(crate) fn pop(&mut self, limit: u64) -> Option<Entry> {
        while self.len > 0 {
            let slot = self.current as usize & (self.ring.len() - 1);
            if let Some(entry) = self.ring[slot].pop() {
                self.len -= 1;
                return Some(entry);
            }
            self.current += 1;
            if self.current.checked_mul(1 << self.shift).is_none_or(|begin| begin >= limit) {
                return None;
            }
        }
        None
    }

    /// All entries with an estimate below this were taken.
    pub(crate) fn emptied_below(&self) -> u64 {
        if self.len == 0 { u64::MAX } else { self.current << self.shift }
    }
}
