//! Descriptors: how many there are, and how many connections may have.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Kept for the store, the log, zenoh and timers, so that a flood of connections does not stop them.
const RESERVE: usize = 256;

/// Raises the number of files that this process may open as far as it may raise it; gives what it is then.
pub(crate) fn raise_limit() -> usize {
    let limit = getrlimit(Resource::Nofile);
    let wanted = Rlimit { current: limit.maximum, maximum: limit.maximum };
    // Where the system refuses, the limit is as it was.
    let _ = setrlimit(Resource::Nofile, wanted);
    getrlimit(Resource::Nofile).current.map_or(usize::MAX, |n| usize::try_from(n).unwrap_or(usize::MAX))
}

/// Connections that a door may have, `doors` of them sharing `files` descriptors.
pub(crate) fn max_connections(asked: usize, files: usize, doors: usize) -> usize {
    let reserve = RESERVE.min(files / 2);
    asked.min((files - reserve) / doors.max(1)).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_leave_descriptors_to_the_store() {
        assert_eq!(max_connections(2048, 1 << 20, 2), 2048);
        assert_eq!(max_connections(2048, 1024, 2), 384);
        assert_eq!(max_connections(2048, 100, 2), 25);
        assert_eq!(max_connections(10, 1024, 0), 10);
    }
}
