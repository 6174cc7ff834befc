//! A lane for each session, so that one whose sender must wait does not hold the others.

use super::{BACKLOG, hand_over};
use percept_service::check_id;
use std::collections::BTreeMap;
use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc;
use zenoh::sample::Sample;

/// Lanes at most; sessions beyond share one.
const MAX_LANES: usize = 256;
/// A lane on which nothing came for so long is closed.
const IDLE: Duration = Duration::from_secs(30);

type Open = Mutex<BTreeMap<String, mpsc::Sender<Sample>>>;

/// Samples by session, each lane in the order of arrival.
pub(super) struct Lanes<F> {
    open: Arc<Open>,
    take: F,
    runtime: tokio::runtime::Handle,
}

impl<F, T> Lanes<F>
where
    F: Fn(Sample) -> T + Clone + Send + 'static,
    T: Future<Output = ()> + Send + 'static,
{
    /// Lanes that give samples to `take`, one after the other.
    pub(super) fn new(take: F) -> Self {
        Self { open: Arc::default(), take, runtime: tokio::runtime::Handle::current() }
    }

    /// Puts a sample on its session's lane; waits, and so holds the sender, while that is full.
    pub(super) fn put(&self, sample: Sample) {
        let session = sample.key_expr().as_str().split('/').nth(1).unwrap_or_default().to_owned();
        let mut left = Some(sample);
        // A lane may close between being found and being used; the next one found is a new one.
        while let Some(sample) = left {
            left = hand_over(&self.lane(&session), sample);
        }
    }

    fn lane(&self, session: &str) -> mpsc::Sender<Sample> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let shared = check_id("", session).is_err() || (open.len() >= MAX_LANES && !open.contains_key(session));
        let name = if shared { "" } else { session };
        if let Some(lane) = open.get(name).filter(|lane| !lane.is_closed()) {
            return lane.clone();
        }
        let (lane, samples) = mpsc::channel(BACKLOG);
        open.insert(name.to_owned(), lane.clone());
        self.runtime.spawn(run(Arc::clone(&self.open), name.to_owned(), samples, self.take.clone()));
        lane
    }
}

async fn run<T: Future<Output = ()>>(
    open: Arc<Open>,
    name: String,
    mut samples: mpsc::Receiver<Sample>,
    take: impl Fn(Sample) -> T,
) {
    while let Ok(Some(sample)) = tokio::time::timeout(IDLE, samples.recv()).await {
        take(sample).await;
    }
    {
        let mut open = open.lock().unwrap_or_else(PoisonError::into_inner);
        samples.close();
        open.remove(&name);
    }
    // What came in between.
    while let Some(sample) = samples.recv().await {
        take(sample).await;
    }
}
