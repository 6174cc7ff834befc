//! How submaps are told apart.

use serde::{Deserialize, Serialize};

/// Which submap, among those of all robots and all their runs. Says neither where nor when it was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct SubmapId {
    /// Whose it is.
    pub robot: u32,
    /// Of which run.
    pub run: u32,
    /// Which of that.
    pub number: u32,
}
