//! What all clients together, and each alone, may take of the server: places for connections, streams and watchers, and
//! memory for what is under way. Taken before it is used, given back by dropping.

use percept_service::{Error, Limits, observe, reason};
use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Notify;

/// How long a message waits for memory before it is refused.
const PATIENCE: Duration = Duration::from_secs(1);

/// Who shares a part of the bounds.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) enum Peer {
    /// A client's address; of IPv6 the network of 64 bits, of which one machine may have all.
    Address(IpAddr),
    /// A session on zenoh, which does not say who sends.
    Lane(String),
}

impl Peer {
    /// The peer at the other end of a connection.
    pub(crate) fn at(address: SocketAddr) -> Self {
        Self::Address(match address.ip().to_canonical() {
            IpAddr::V6(ip) if !ip.is_loopback() => {
                let [a, b, c, d, ..] = ip.segments();
                IpAddr::V6(Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0))
            }
            ip => ip,
        })
    }
}

/// All bounds of a server.
#[derive(Clone)]
pub(crate) struct Bounds {
    pub(crate) memory: Arc<Memory>,
    /// Of what HTTP/2 keeps of bodies before it is asked for. An account of its own, so that large bodies under way do not
    /// keep small requests out.
    pub(crate) windows: Arc<Memory>,
    pub(crate) ingest_streams: Arc<Places>,
    pub(crate) watchers: Arc<Places>,
}

impl Bounds {
    /// As the limits say.
    pub(crate) fn new(limits: &Limits) -> Self {
        Self {
            memory: Memory::new(limits.max_bytes_in_flight, limits.max_bytes_in_flight_per_peer),
            windows: Memory::new(limits.max_bytes_in_flight / 2, limits.max_bytes_in_flight_per_peer / 2),
            ingest_streams: Places::new(limits.max_ingest_streams, limits.max_ingest_streams),
            watchers: Places::new(limits.max_watchers, limits.max_watchers_per_peer),
        }
    }

    /// A place for an ingest stream.
    ///
    /// # Errors
    /// `TOO_MANY_STREAMS`.
    pub(crate) fn ingest_stream(&self, peer: &Peer) -> Result<Place, Error> {
        self.ingest_streams.take(peer).ok_or_else(|| {
            let most = self.ingest_streams.most;
            let words = format!("{most} ingest streams are open, the limit; send several sensors on one stream");
            observe::shed(reason::TOO_MANY_STREAMS);
            Error::exhausted(reason::TOO_MANY_STREAMS, "", words)
        })
    }

    /// A place for a watcher.
    ///
    /// # Errors
    /// `TOO_MANY_WATCHERS`.
    pub(crate) fn watcher(&self, peer: &Peer) -> Result<Place, Error> {
        self.watchers.take(peer).ok_or_else(|| {
            let (all, one) = (self.watchers.most, self.watchers.most_per_peer);
            let words = format!("the limit of {all} watchers, or of {one} from one address, is reached; end some");
            observe::shed(reason::TOO_MANY_WATCHERS);
            Error::exhausted(reason::TOO_MANY_WATCHERS, "", words)
        })
    }
}

/// Places, in all and for each peer.
pub(crate) struct Places {
    most: usize,
    most_per_peer: usize,
    taken: Mutex<Taken>,
}

#[derive(Default)]
struct Taken {
    all: usize,
    by_peer: HashMap<Peer, usize>,
}

impl Taken {
    fn of(&self, peer: &Peer) -> usize {
        self.by_peer.get(peer).copied().unwrap_or_default()
    }

    fn add(&mut self, peer: &Peer, count: usize) {
        self.all += count;
        *self.by_peer.entry(peer.clone()).or_default() += count;
    }

    fn remove(&mut self, peer: &Peer, count: usize) {
        self.all -= count;
        if let Some(taken) = self.by_peer.get_mut(peer) {
            *taken -= count;
            if *taken == 0 {
                self.by_peer.remove(peer);
            }
        }
    }
}

fn lock(taken: &Mutex<Taken>) -> MutexGuard<'_, Taken> {
    taken.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A place that is taken.
pub(crate) struct Place {
    places: Arc<Places>,
    peer: Peer,
}

impl Places {
    /// As many places.
    pub(crate) fn new(most: usize, most_per_peer: usize) -> Arc<Self> {
        Arc::new(Self { most, most_per_peer, taken: Mutex::default() })
    }

    /// A place, if there is one left for this peer.
    pub(crate) fn take(self: &Arc<Self>, peer: &Peer) -> Option<Place> {
        let mut taken = lock(&self.taken);
        if taken.all >= self.most || taken.of(peer) >= self.most_per_peer {
            return None;
        }
        taken.add(peer, 1);
        Some(Place { places: Arc::clone(self), peer: peer.clone() })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        lock(&self.places.taken).remove(&self.peer, 1);
    }
}

/// Memory of what is under way, bytes.
pub(crate) struct Memory {
    most: usize,
    most_per_peer: usize,
    taken: Mutex<Taken>,
    freed: Notify,
}

/// Memory that is taken.
pub(crate) struct Charge {
    memory: Arc<Memory>,
    peer: Peer,
    bytes: usize,
}

impl Memory {
    /// So much, in all and for each peer.
    pub(crate) fn new(most: usize, most_per_peer: usize) -> Arc<Self> {
        Arc::new(Self { most, most_per_peer, taken: Mutex::default(), freed: Notify::new() })
    }

    /// Nothing yet, for a peer.
    pub(crate) fn charge(self: &Arc<Self>, peer: &Peer) -> Charge {
        Charge { memory: Arc::clone(self), peer: peer.clone(), bytes: 0 }
    }

    /// Bytes that are taken.
    #[cfg(test)]
    pub(crate) fn taken(&self) -> usize {
        lock(&self.taken).all
    }
}

impl Charge {
    /// Takes more, now or not at all.
    pub(crate) fn try_grow(&mut self, bytes: usize) -> bool {
        let mut taken = lock(&self.memory.taken);
        let fits = taken.all + bytes <= self.memory.most && taken.of(&self.peer) + bytes <= self.memory.most_per_peer;
        if fits {
            taken.add(&self.peer, bytes);
            self.bytes += bytes;
        }
        fits
    }

    /// Takes more, once it is there.
    pub(crate) async fn grow_when_there(&mut self, bytes: usize) {
        let memory = Arc::clone(&self.memory);
        loop {
            let freed = memory.freed.notified();
            tokio::pin!(freed);
            // From here on nothing that is given back goes unnoticed.
            freed.as_mut().enable();
            if self.try_grow(bytes) {
                return;
            }
            freed.await;
        }
    }

    /// Takes more; waits a little for others to give theirs back.
    ///
    /// # Errors
    /// `MEMORY_EXHAUSTED`.
    pub(crate) async fn grow(&mut self, bytes: usize) -> Result<(), Error> {
        tokio::time::timeout(PATIENCE, self.grow_when_there(bytes)).await.map_err(|_| {
            let words = "the server has no memory left for what is under way; try again, or send less at a time";
            observe::shed(reason::MEMORY_EXHAUSTED);
            Error::exhausted(reason::MEMORY_EXHAUSTED, "", words)
        })
    }

    /// Bytes that are taken.
    pub(crate) fn bytes(&self) -> usize {
        self.bytes
    }

    /// A part of it, at most all, on its own.
    pub(crate) fn split(&mut self, bytes: usize) -> Self {
        let bytes = bytes.min(self.bytes);
        self.bytes -= bytes;
        Self { memory: Arc::clone(&self.memory), peer: self.peer.clone(), bytes }
    }

    /// Takes over what another one has taken of the same memory for the same peer.
    pub(crate) fn absorb(&mut self, mut other: Self) {
        self.bytes += std::mem::take(&mut other.bytes);
    }
}

impl Drop for Charge {
    fn drop(&mut self) {
        if self.bytes > 0 {
            lock(&self.memory.taken).remove(&self.peer, self.bytes);
            self.memory.freed.notify_waiters();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peer(n: u8) -> Peer {
        Peer::at(SocketAddr::from(([10, 0, 0, n], 1)))
    }

    #[test]
    fn places_end_for_one_peer_and_for_all() {
        let places = Places::new(3, 2);
        let mut held = vec![places.take(&peer(1)).unwrap(), places.take(&peer(1)).unwrap()];
        assert!(places.take(&peer(1)).is_none(), "beyond the peer's share");
        held.push(places.take(&peer(2)).unwrap());
        assert!(places.take(&peer(3)).is_none(), "beyond all");
        held.remove(0);
        assert!(places.take(&peer(3)).is_some());
        drop(held);
        assert!(lock(&places.taken).by_peer.is_empty(), "nothing is remembered of who has gone");
    }

    #[test]
    fn one_machine_is_one_peer_whichever_of_its_addresses_it_uses() {
        let at = |ip: &str| Peer::at(SocketAddr::new(ip.parse().unwrap(), 1));
        assert_eq!(at("2001:db8::1"), at("2001:db8::ffff:1"));
        assert_ne!(at("2001:db8::1"), at("2001:db8:0:1::1"));
        assert_eq!(at("::ffff:10.0.0.1"), at("10.0.0.1"));
        assert_ne!(at("::1"), at("10.0.0.1"));
    }

    #[tokio::test]
    async fn memory_ends_for_one_peer_and_for_all_and_comes_back() {
        let memory = Memory::new(100, 60);
        let (mut a, mut b) = (memory.charge(&peer(1)), memory.charge(&peer(2)));
        assert!(a.try_grow(60) && !a.try_grow(1));
        assert!(!b.try_grow(41) && b.try_grow(40));
        let mut waiting = memory.charge(&peer(3));
        let mut grow = Box::pin(waiting.grow_when_there(50));
        assert!(futures::poll!(&mut grow).is_pending());
        drop(a);
        grow.await;
        drop((b, waiting));
        assert_eq!(memory.taken(), 0);
    }

    #[tokio::test]
    async fn who_waits_in_vain_is_told_to_try_again() {
        let memory = Memory::new(100, 100);
        let mut all = memory.charge(&peer(1));
        assert!(all.try_grow(100));
        let error = memory.charge(&peer(2)).grow(1).await.unwrap_err();
        assert_eq!((error.code, error.reason), (percept_service::ErrorCode::ResourceExhausted, "MEMORY_EXHAUSTED"));
    }
}
