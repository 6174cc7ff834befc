//! The handle on a running session: doors put frames and commands into its actor's queue, and read what it published.

use super::actor::Actor;
use super::events::EventLog;
use super::meta::{OverloadPolicy, SensorDeclaration, SessionMeta, SessionMode};
use super::persist::Persister;
use super::refusal::{frame_error, sensor_not_found, stopped};
use super::sensor_book::{SensorBook, SensorStatus};
use crate::{ComputePool, Error, Limits, Result};
use percept_geometry::{KeyframeId, SensorFrame, SensorId, SensorSpec, Timestamp};
use percept_pipeline::{Loop, LoopId, Pipeline, PoseEstimate, Snapshot};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Instant;
use tokio::sync::{Notify, mpsc, oneshot, watch};

/// Running number of an accepted frame in its session; durable once [`Session::durable`] has reached it.
pub type Ticket = u64;

/// What an accepted frame did.
#[derive(Debug, Clone)]
pub struct Processed {
    /// Pose after it; none for sensors that do not move the pose.
    pub pose: Option<PoseEstimate>,
    /// Set if it became a keyframe.
    pub keyframe: Option<KeyframeId>,
    /// Time in queue and pipeline, seconds.
    pub latency_s: f64,
    /// Its number.
    pub ticket: Ticket,
}

/// The answer to a submitted frame, when it comes.
pub type Pending = oneshot::Receiver<Result<Processed>>;

pub(crate) enum Command {
    Frame { frame: Box<SensorFrame>, received: Instant, reply: oneshot::Sender<Result<Processed>> },
    Declare(Box<SensorSpec>),
    Veto { id: LoopId, vetoed: bool, reply: oneshot::Sender<Option<Vetoed>> },
    Settle { reply: oneshot::Sender<Moved> },
    Stop { stopped: oneshot::Sender<()> },
}

/// How the map moved, other than by a frame.
#[derive(Debug, Clone, Copy)]
pub struct Moved {
    /// Keyframes that moved.
    pub num_keyframes: usize,
    /// Version of the map with it.
    pub map_version: u64,
    /// Durable once [`Session::durable`] has reached it.
    pub ticket: Ticket,
}

/// What a veto did.
#[derive(Debug, Clone)]
pub struct Vetoed {
    /// The loop, with its new state.
    pub changed: Loop,
    /// The map that followed.
    pub moved: Moved,
}

/// A handle on a running session; queries through it never wait for ingest.
pub struct Session {
    meta: RwLock<SessionMeta>,
    pub(super) snapshot: RwLock<Arc<Snapshot>>,
    pub(super) events: EventLog,
    pub(super) book: Mutex<SensorBook>,
    queue: mpsc::Sender<Command>,
    durable: watch::Receiver<Ticket>,
    fault: watch::Receiver<Option<Error>>,
    inboxes: Mutex<BTreeMap<SensorId, Arc<Inbox>>>,
    queue_length: usize,
}

/// Frames of one sensor that waits under `DropOldest`.
struct Inbox {
    frames: Mutex<VecDeque<SensorFrame>>,
    filled: Notify,
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Session {
    /// Starts the actor over a pipeline, which may have been restored.
    pub(crate) fn start(
        meta: SessionMeta,
        mut pipeline: Pipeline,
        last_stamps: &BTreeMap<SensorId, Timestamp>,
        persister: Persister,
        compute: ComputePool,
        limits: &Limits,
        events: EventLog,
    ) -> Arc<Self> {
        let mut book = SensorBook::default();
        for declaration in &meta.sensors {
            pipeline.declare_sensor(declaration.spec.clone());
            book.declare(declaration.clone(), last_stamps.get(&declaration.spec.id).copied());
        }
        let (queue, commands) = mpsc::channel(limits.queue_length.max(1));
        let session = Arc::new(Self {
            meta: RwLock::new(meta),
            snapshot: RwLock::new(Arc::new(pipeline.snapshot())),
            events,
            book: Mutex::new(book),
            queue,
            durable: persister.durable(),
            fault: persister.fault(),
            inboxes: Mutex::default(),
            queue_length: limits.queue_length.max(1),
        });
        let actor = Actor { session: Arc::clone(&session), pipeline: Some(pipeline), persister, compute };
        tokio::spawn(actor.run(commands));
        session
    }

    /// What the session was created with, and its sensors.
    pub fn meta(&self) -> SessionMeta {
        self.meta.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The newest snapshot.
    pub fn snapshot(&self) -> Arc<Snapshot> {
        Arc::clone(&self.snapshot.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Events, for watchers.
    pub fn events(&self) -> &EventLog {
        &self.events
    }

    /// Health of every sensor, by name.
    pub fn sensors(&self) -> Vec<SensorStatus> {
        let snapshot = self.snapshot();
        let with_offsets = |s: &SensorStatus| {
            let id = &s.declaration.spec.id;
            let clock_offset_s = snapshot.clock_offsets.get(id).copied();
            let mount_offset = snapshot.mount_offsets.get(id).copied();
            SensorStatus { clock_offset_s, mount_offset, ..s.clone() }
        };
        lock(&self.book).all().map(with_offsets).collect()
    }

    /// Frames waiting.
    pub fn queue_len(&self) -> usize {
        self.queue.max_capacity() - self.queue.capacity()
    }

    /// The newest ticket whose effects survive a crash, as it grows.
    pub fn durable(&self) -> watch::Receiver<Ticket> {
        self.durable.clone()
    }

    /// Notes a sender's running number.
    pub fn numbered(&self, sensor: &SensorId, sequence: u64) {
        lock(&self.book).numbered(sensor, sequence);
    }

    /// Counts a frame that a door refused before it got here.
    pub fn rejected(&self, sensor: &SensorId) {
        lock(&self.book).rejected(sensor);
    }

    /// Waits for room in the queue, then hands the frame over. The answer comes through what is returned.
    ///
    /// # Errors
    /// `SENSOR_NOT_FOUND`, `STORAGE_FAULT`, `SESSION_STOPPED`; in `IngestOnly` what is wrong with the frame.
    pub async fn submit(&self, frame: SensorFrame) -> Result<Pending> {
        if let Some(fault) = self.fault.borrow().clone() {
            return Err(fault);
        }
        self.check_sensor(&frame.sensor)?;
        let (reply, pending) = oneshot::channel();
        if self.meta.read().unwrap_or_else(PoisonError::into_inner).mode == SessionMode::IngestOnly {
            let _ = reply.send(self.count_only(&frame));
            return Ok(pending);
        }
        let command = Command::Frame { frame: Box::new(frame), received: Instant::now(), reply };
        self.queue.send(command).await.map_err(|_| stopped())?;
        Ok(pending)
    }

    /// Submits and waits for the answer.
    ///
    /// # Errors
    /// As [`Session::submit`], and what the pipeline refused.
    pub async fn process(&self, frame: SensorFrame) -> Result<Processed> {
        self.submit(frame).await?.await.map_err(|_| stopped())?
    }

    /// Waits until a frame's effects survive a crash.
    ///
    /// # Errors
    /// The storage's fault if there is one.
    pub async fn wait_durable(&self, ticket: Ticket) -> Result<()> {
        let (mut durable, mut fault) = (self.durable.clone(), self.fault.clone());
        tokio::select! {
            reached = durable.wait_for(|d| *d >= ticket) => reached.map(|_| ()).map_err(|_| stopped()),
            failed = fault.wait_for(Option::is_some) => Err(failed.ok().and_then(|f| f.clone()).unwrap_or_else(stopped)),
        }
    }

    /// Takes a frame from a door that cannot wait: by the sensor's policy it waits all the same, or the
    /// oldest waiting frame is dropped and counted.
    ///
    /// # Errors
    /// As [`Session::submit`] for blocking sensors; `SENSOR_NOT_FOUND`.
    pub async fn offer(self: &Arc<Self>, frame: SensorFrame) -> Result<()> {
        let policy = self.check_sensor(&frame.sensor)?;
        if policy == OverloadPolicy::Block {
            let _answer = self.submit(frame).await?;
            return Ok(());
        }
        let inbox = self.inbox(&frame.sensor);
        let dropped = {
            let mut frames = lock(&inbox.frames);
            let dropped = (frames.len() >= self.queue_length).then(|| frames.pop_front()).flatten();
            frames.push_back(frame);
            dropped
        };
        if let Some(frame) = dropped {
            lock(&self.book).dropped(&frame.sensor);
        }
        inbox.filled.notify_one();
        Ok(())
    }

    fn inbox(self: &Arc<Self>, sensor: &SensorId) -> Arc<Inbox> {
        let mut inboxes = lock(&self.inboxes);
        let inbox = inboxes.entry(sensor.clone()).or_insert_with(|| {
            let inbox = Arc::new(Inbox { frames: Mutex::default(), filled: Notify::new() });
            tokio::spawn(forward(Arc::downgrade(self), Arc::clone(&inbox)));
            inbox
        });
        Arc::clone(inbox)
    }

    fn check_sensor(&self, id: &SensorId) -> Result<OverloadPolicy> {
        lock(&self.book).get(id).map(|s| s.declaration.overload).ok_or_else(|| sensor_not_found(id))
    }

    fn count_only(&self, frame: &SensorFrame) -> Result<Processed> {
        let mut book = lock(&self.book);
        let Some(status) = book.get(&frame.sensor) else { return Err(sensor_not_found(&frame.sensor)) };
        let checked = percept_pipeline::check_frame(&status.declaration.spec, status.last_stamp, frame);
        match checked {
            Ok(()) => {
                book.accepted(&frame.sensor, frame.stamp);
                Ok(Processed { pose: None, keyframe: None, latency_s: 0.0, ticket: 0 })
            }
            Err(e) => {
                book.rejected(&frame.sensor);
                Err(frame_error(&e))
            }
        }
    }

    /// Declares a sensor in the running session; the caller has stored it.
    pub(crate) async fn declare(&self, declaration: SensorDeclaration) -> Result<()> {
        let spec = declaration.spec.clone();
        lock(&self.book).declare(declaration.clone(), None);
        {
            let mut meta = self.meta.write().unwrap_or_else(PoisonError::into_inner);
            meta.sensors.retain(|s| s.spec.id != spec.id);
            meta.sensors.push(declaration);
            meta.sensors.sort_by(|a, b| a.spec.id.cmp(&b.spec.id));
        }
        self.queue.send(Command::Declare(Box::new(spec))).await.map_err(|_| stopped())
    }

    pub(crate) fn num_sensors(&self) -> usize {
        lock(&self.book).len()
    }

    /// Takes a loop out of the map, or undoes that; none if there is no such loop.
    ///
    /// # Errors
    /// `SESSION_STOPPED`.
    pub async fn veto(&self, id: LoopId, vetoed: bool) -> Result<Option<Vetoed>> {
        let (reply, done) = oneshot::channel();
        self.queue.send(Command::Veto { id, vetoed, reply }).await.map_err(|_| stopped())?;
        done.await.map_err(|_| stopped())
    }

    /// Makes the small corrections that wait for more.
    ///
    /// # Errors
    /// `SESSION_STOPPED`.
    pub async fn settle(&self) -> Result<Moved> {
        let (reply, done) = oneshot::channel();
        self.queue.send(Command::Settle { reply }).await.map_err(|_| stopped())?;
        done.await.map_err(|_| stopped())
    }

    /// Finishes what was accepted, stores it, ends the watches.
    pub(crate) async fn stop(&self) {
        let (stopped, done) = oneshot::channel();
        if self.queue.send(Command::Stop { stopped }).await.is_ok() {
            let _ = done.await;
        }
    }
}

/// Moves frames from an inbox to the queue for as long as the session lives.
async fn forward(session: std::sync::Weak<Session>, inbox: Arc<Inbox>) {
    loop {
        inbox.filled.notified().await;
        loop {
            let Some(frame) = lock(&inbox.frames).pop_front() else { break };
            let Some(session) = session.upgrade() else { return };
            if session.submit(frame).await.is_err_and(|e| e.reason == "SESSION_STOPPED") {
                return;
            }
        }
    }
}
