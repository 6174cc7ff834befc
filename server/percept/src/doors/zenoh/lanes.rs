//! A lane for each session, so that one whose sender must wait does not hold the others.

use super::{BACKLOG, charged, hand_over};
use crate::doors::bounds::{Charge, Memory, Peer};
use futures::StreamExt;
use futures::stream::FuturesOrdered;
use percept_service::check_id;
use std::collections::BTreeMap;
use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc;
use zenoh::sample::Sample;

/// Lanes at most; sessions beyond share one.
const MAX_LANES: usize = 256;
/// Samples of a lane that are decoded beside each other: while one is, the next is put together.
const AHEAD: usize = 2;
/// A lane on which nothing came for so long is closed.
const IDLE: Duration = Duration::from_secs(30);

/// A sample and the memory that it takes.
type Item = (Sample, Charge);
type Open = Mutex<BTreeMap<String, mpsc::Sender<Item>>>;

/// Samples by session, each lane in the order of arrival.
pub(super) struct Lanes<D, G> {
    open: Arc<Open>,
    decode: D,
    give: G,
    memory: Arc<Memory>,
    runtime: tokio::runtime::Handle,
}

impl<D, G, P, F, T> Lanes<D, G>
where
    D: Fn(Sample, Charge) -> P + Clone + Send + Sync + 'static,
    G: Fn(F) -> T + Clone + Send + Sync + 'static,
    P: Future<Output = F> + Send + 'static,
    F: Send + 'static,
    T: Future<Output = ()> + Send + 'static,
{
    /// Lanes that `decode` samples, a few beside each other, and `give` on what came of them, one after the other.
    pub(super) fn new(memory: Arc<Memory>, decode: D, give: G) -> Self {
        Self { open: Arc::default(), decode, give, memory, runtime: tokio::runtime::Handle::current() }
    }

    /// Puts a sample on its session's lane; waits, and so holds the sender, while that is full or has all memory that one
    /// lane may have.
    pub(super) fn put(&self, sample: Sample) {
        let session = sample.key_expr().as_str().split('/').nth(1).unwrap_or_default().to_owned();
        let (peer, size) = (Peer::Lane(session.clone()), sample.payload().len());
        let memory = charged(&self.memory, &peer, size, &self.runtime);
        let mut left = Some((sample, memory));
        // A lane may close between being found and being used; the next one found is a new one.
        while let Some(item) = left {
            left = hand_over(&self.lane(&session), item);
        }
    }

    fn lane(&self, session: &str) -> mpsc::Sender<Item> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let shared = check_id("", session).is_err() || (open.len() >= MAX_LANES && !open.contains_key(session));
        let name = if shared { "" } else { session };
        if let Some(lane) = open.get(name).filter(|lane| !lane.is_closed()) {
            return lane.clone();
        }
        let (lane, samples) = mpsc::channel(BACKLOG);
        open.insert(name.to_owned(), lane.clone());
        self.runtime.spawn(run(
            Arc::clone(&self.open),
            name.to_owned(),
            samples,
            self.decode.clone(),
            self.give.clone(),
        ));
        lane
    }
}

async fn run<F, P: Future<Output = F>, T: Future<Output = ()>>(
    open: Arc<Open>,
    name: String,
    mut samples: mpsc::Receiver<Item>,
    decode: impl Fn(Sample, Charge) -> P,
    give: impl Fn(F) -> T,
) {
    let mut decoding = FuturesOrdered::new();
    loop {
        tokio::select! {
            biased;
            Some(decoded) = decoding.next() => give(decoded).await,
            item = tokio::time::timeout(IDLE, samples.recv()), if decoding.len() < AHEAD => match item {
                Ok(Some((sample, memory))) => decoding.push_back(decode(sample, memory)),
                _ => break,
            },
        }
    }
    {
        let mut open = open.lock().unwrap_or_else(PoisonError::into_inner);
        samples.close();
        open.remove(&name);
    }
    while let Some(decoded) = decoding.next().await {
        give(decoded).await;
    }
    // What came in between.
    while let Some((sample, memory)) = samples.recv().await {
        give(decode(sample, memory).await).await;
    }
}
