//! A level without furniture, cell by cell.

/// What a cell is once furniture is gone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Free, or under furniture that stands free.
    Open,
    /// A wall, or what is joined to one.
    Wall,
    /// The side of a known thing that is joined to a wall.
    Thing,
    /// Nobody knows.
    Unknown,
}

/// A level without what stands free in it.
pub(super) struct Cleared {
    pub(super) kinds: Vec<Kind>,
}

impl Cleared {
    /// Cells that are not open.
    pub(super) fn closed(&self) -> Vec<bool> {
        self.kinds.iter().map(|k| *k != Kind::Open).collect()
    }

    pub(super) fn is_open(&self, i: usize) -> bool {
        self.kinds[i] == Kind::Open
    }
}
