//! Makes what frames did durable, in their order, many at a time, and says how far it has come.

use super::fault::{Fault, Trouble};
use super::job::Job;
use super::records::StateRecord;
use super::writer::Writer;
use crate::reason;
use crate::{Error, observe};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

/// Frames that may wait for the disk before ingest waits, too.
pub(super) const BACKLOG: usize = 256;
/// Frames that nobody waits for become durable together, so long after those before them, or once so many have come: a file
/// and its flush cost about as much processor time as a planar scan, whatever is in it: with 64 lasers at
/// 10 Hz, a fifth of a core at four a second. What a sender has to keep until it is durable is short all the same.
const GATHER: Duration = Duration::from_millis(500);
const GATHERED: usize = 16;
/// First and longest pause between tries after a fault of the storage that passes. A robot that waits for room on the disk
/// should not wait longer than this after there is some.
const RETRY: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));

/// How the storage is, as a session sees it.
#[derive(Debug, Clone, Default)]
pub(crate) enum Storing {
    /// It takes what it is given.
    #[default]
    Well,
    /// It does not at the moment; tries go on.
    Waiting(Error),
    /// It will not: tries have ended.
    Ended(Trouble),
}

impl Storing {
    /// What a caller is told who wants something stored.
    pub(crate) fn error(&self) -> Option<Error> {
        match self {
            Self::Well => None,
            Self::Waiting(error) => Some(error.clone()),
            Self::Ended(trouble) => Some(trouble.error()),
        }
    }
}

/// How far a session's frames are durable, and how far somebody waits for that.
#[derive(Debug, Clone)]
pub struct Durable {
    reached: watch::Receiver<u64>,
    wanted: Arc<watch::Sender<u64>>,
}

impl Durable {
    /// Of a session of which nothing becomes durable.
    pub(super) fn nothing() -> Self {
        Self { reached: watch::channel(0).1, wanted: Arc::new(watch::channel(0).0) }
    }

    /// Whether the effects of a ticket's frame survive a crash.
    pub fn has(&self, ticket: u64) -> bool {
        *self.reached.borrow() >= ticket
    }

    /// Waits until they do, which is sooner for being waited for; false if they never will.
    pub async fn reach(&mut self, ticket: u64) -> bool {
        let wanted = |w: &mut u64| {
            let is_new = *w < ticket;
            *w = (*w).max(ticket);
            is_new
        };
        self.wanted.send_if_modified(wanted);
        self.reached.wait_for(|reached| *reached >= ticket).await.is_ok()
    }
}

/// Sends jobs to the task that stores them.
pub(crate) struct Persister {
    jobs: mpsc::Sender<(u64, Job)>,
    next_ticket: u64,
    durable: Durable,
    storing: watch::Receiver<Storing>,
    task: Option<JoinHandle<()>>,
}

impl Persister {
    /// Starts the task of a session whose stored state is given with the writer.
    pub(super) fn start(writer: Writer, state: &StateRecord) -> Self {
        let (jobs, queue) = mpsc::channel(BACKLOG);
        let (durable_tx, reached) = watch::channel(state.ticket);
        let (wanted_tx, wanted) = watch::channel(state.ticket);
        let (storing_tx, storing) = watch::channel(Storing::Well);
        let durable = Durable { reached, wanted: Arc::new(wanted_tx) };
        let task = Some(tokio::spawn(run(writer, queue, wanted, durable_tx, storing_tx)));
        Self { jobs, next_ticket: state.ticket + 1, durable, storing, task }
    }

    pub(crate) fn durable(&self) -> Durable {
        self.durable.clone()
    }

    pub(crate) fn storing(&self) -> watch::Receiver<Storing> {
        self.storing.clone()
    }

    /// Queues a job; waits when the backlog is full. Answers with its ticket.
    pub(crate) async fn submit(&mut self, mut job: Job) -> u64 {
        job.backlog = Some(observe::store_backlog());
        let ticket = self.next_ticket;
        self.next_ticket += 1;
        let _ = self.jobs.send((ticket, job)).await;
        ticket
    }

    /// The newest ticket.
    pub(crate) fn newest(&self) -> u64 {
        self.next_ticket - 1
    }

    /// Waits until all that was queued is durable; for a storage that does not take it, no longer than `patience`.
    pub(crate) async fn flushed(&mut self, patience: Duration) -> Result<(), Trouble> {
        let newest = self.newest();
        let mut durable = self.durable.clone();
        if tokio::time::timeout(patience, durable.reach(newest)).await == Ok(true) {
            return Ok(());
        }
        Err(match self.storing.borrow().clone() {
            Storing::Ended(trouble) => trouble,
            Storing::Waiting(error) => Trouble::Passing(error),
            Storing::Well => {
                Trouble::Lasting(Fault::new(reason::STORAGE_SLOW, "the storage did not take the last frames in time"))
            }
        })
    }

    /// Ends the task; what is not durable by now is given up.
    pub(crate) async fn end(&mut self) {
        let (closed, _) = mpsc::channel(1);
        self.jobs = closed;
        if let Some(task) = self.task.take() {
            task.abort();
            let _ = task.await;
        }
    }
}

async fn run(
    mut writer: Writer,
    mut queue: mpsc::Receiver<(u64, Job)>,
    mut wanted: watch::Receiver<u64>,
    durable: watch::Sender<u64>,
    storing: watch::Sender<Storing>,
) {
    let mut batch = Vec::new();
    let mut next = tokio::time::Instant::now();
    while queue.recv_many(&mut batch, BACKLOG).await > 0 {
        gather(&mut queue, &mut batch, &mut wanted, next).await;
        next = tokio::time::Instant::now() + GATHER;
        let mut pause = RETRY.0;
        loop {
            match writer.write(&batch).await {
                Ok(()) => break,
                Err(Trouble::Passing(error)) => {
                    observe::store_fault(error.reason);
                    let _ = storing.send(Storing::Waiting(error));
                    tokio::time::sleep(pause).await;
                    pause = (pause * 2).min(RETRY.1);
                }
                Err(trouble) => {
                    observe::store_fault(trouble.error().reason);
                    tracing::error!(?trouble, "a session is not stored any more");
                    let _ = storing.send(Storing::Ended(trouble));
                    return;
                }
            }
        }
        storing.send_if_modified(|s| !matches!(std::mem::take(s), Storing::Well));
        batch.iter().filter_map(|(_, job)| job.received).for_each(|at| observe::frame_durable(at.elapsed()));
        if let Some((ticket, _)) = batch.last() {
            let _ = durable.send(*ticket);
        }
        batch.clear();
        writer.tidy().await;
    }
}

/// Takes further jobs into a batch, until so many have come, or somebody waits for one, or the time has.
async fn gather(
    queue: &mut mpsc::Receiver<(u64, Job)>,
    batch: &mut Vec<(u64, Job)>,
    wanted: &mut watch::Receiver<u64>,
    until: tokio::time::Instant,
) {
    let first = batch.first().map_or(0, |(ticket, _)| *ticket);
    while batch.len() < GATHERED {
        tokio::select! {
            biased;
            _ = wanted.wait_for(|w| *w >= first) => return,
            num_more = queue.recv_many(batch, BACKLOG) => if num_more == 0 { return },
            () = tokio::time::sleep_until(until) => return,
        }
    }
}
