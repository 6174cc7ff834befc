//! The handle on a running session: doors put frames and commands into its actor's queue, and read what it published.

use super::command::{
    Command, Corrected, Imported, Moved, Offered, Pending, Processed, Submitted, Telling, Ticket, Vetoed,
};
use super::events::EventLog;
use super::fault::{Fault, Trouble};
use super::frame_look::FrameLook;
use super::meta::{OverloadPolicy, SensorDeclaration, SessionMeta, SessionMode};
use super::persist::{Durable, Storing};
use super::records::{FrameCounts, StateRecord};
use super::refusal::{check_stamp, frame_error, not_yet_durable, sensor_not_found, stopped};
use super::scratch::Scratch;
use super::sensor_book::{SensorBook, SensorStatus, StreamNote};
use crate::observe::{self, SessionShare};
use crate::{Error, Limits, Progress, Result};
use percept_geometry::{Pose, SensorFrame, SensorId, Timestamp};
use percept_mapping::given::GivenView;
use percept_perception::detection::ImageDetectors;
use percept_pipeline::{LoopId, Pipeline, PoseEstimate, Snapshot, Told};
use percept_scene::{Correction, CorrectionError, ObjectId};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock};
use std::time::{Duration, Instant};
use tokio::sync::{Notify, mpsc, oneshot, watch};
use tokio::time::timeout;

/// Who says where the robot is waits so long for a frame: the slowest lidars turn ten times meanwhile.
const TELLING_PATIENCE: Duration = Duration::from_secs(5);

/// A handle on a session that is awake; queries through it never wait for ingest.
pub struct Session {
    id: String,
    tenant: String,
    meta: RwLock<SessionMeta>,
    pub(super) snapshot: RwLock<Arc<Snapshot>>,
    pub(super) events: Arc<EventLog>,
    pub(super) book: Mutex<SensorBook>,
    pub(super) share: SessionShare,
    queue: mpsc::Sender<Command>,
    durable: Durable,
    storing: watch::Receiver<Storing>,
    scratch: Arc<Scratch>,
    /// Set if the session is only read.
    fault: OnceLock<Fault>,
    inboxes: Mutex<BTreeMap<SensorId, Arc<Inbox>>>,
    changing: Arc<tokio::sync::Mutex<()>>,
    /// Set to end at once: what is not stored is not wanted any more.
    pub(super) discarded: watch::Sender<bool>,
    queue_length: usize,
}

impl Drop for Session {
    fn drop(&mut self) {
        // Those who wait for frames find that there is no session any more.
        lock(&self.inboxes).values().for_each(|inbox| inbox.filled.notify_one());
    }
}

/// Frames of one sensor that waits under `DropOldest`.
struct Inbox {
    frames: Mutex<VecDeque<Box<SensorFrame>>>,
    filled: Notify,
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Session {
    /// A handle on a session that is damaged: it can be read, and nothing else.
    pub(super) fn read_only(
        meta: SessionMeta,
        pipeline: &Pipeline,
        before: &StateRecord,
        fault: Fault,
        limits: &Limits,
        events: Arc<EventLog>,
    ) -> Arc<Self> {
        let (queue, _) = mpsc::channel(1);
        let nothing =
            (Durable::nothing(), watch::channel(Storing::Well).1, Scratch::in_directory(None, &Arc::default()));
        Arc::new(Self::over(meta, pipeline, before, queue, nothing, Some(fault), limits, events))
    }

    pub(super) fn over(
        meta: SessionMeta,
        pipeline: &Pipeline,
        before: &StateRecord,
        queue: mpsc::Sender<Command>,
        (durable, storing, scratch): (Durable, watch::Receiver<Storing>, Arc<Scratch>),
        fault: Option<Fault>,
        limits: &Limits,
        events: Arc<EventLog>,
    ) -> Self {
        let mut book = SensorBook::default();
        for declaration in &meta.sensors {
            book.declare(declaration.clone(), before);
        }
        let (snapshot, share) = (pipeline.snapshot(), SessionShare::default());
        share.map(snapshot.keyframes.len(), snapshot.objects.len());
        share.memory(pipeline.memory().total());
        Self {
            id: meta.id.clone(),
            tenant: meta.tenant.clone(),
            meta: RwLock::new(meta),
            snapshot: RwLock::new(Arc::new(snapshot)),
            events,
            book: Mutex::new(book),
            share,
            queue,
            durable,
            storing,
            scratch,
            fault: fault.map_or_else(OnceLock::new, OnceLock::from),
            inboxes: Mutex::default(),
            changing: Arc::default(),
            discarded: watch::channel(false).0,
            queue_length: limits.queue_length.max(1),
        }
    }

    /// Its id.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Whose it is.
    pub fn tenant(&self) -> &str {
        &self.tenant
    }

    /// What the session was created with, and its sensors.
    pub fn meta(&self) -> SessionMeta {
        self.meta.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The newest snapshot.
    pub fn snapshot(&self) -> Arc<Snapshot> {
        Arc::clone(&self.snapshot.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Health of every sensor, by name.
    pub fn sensors(&self) -> Vec<SensorStatus> {
        let snapshot = self.snapshot();
        let book = lock(&self.book);
        let is_to_place = self.meta().mode != SessionMode::IngestOnly;
        let no_pose = book.no_pose(&snapshot.params.slam.pose_sensor).filter(|_| is_to_place);
        let with_findings = |s: SensorStatus| {
            let id = &s.declaration.spec.id;
            let clock_offset_s = snapshot.clock_offsets.get(id).copied();
            let mount_offset = snapshot.mount_offsets.get(id).copied();
            let imu_faults = snapshot.imu_faults.get(id).cloned().unwrap_or_default();
            let wheels_faults = snapshot.wheels_faults.get(id).cloned().unwrap_or_default();
            SensorStatus { clock_offset_s, mount_offset, imu_faults, wheels_faults, no_pose, ..s }
        };
        book.all_now().into_iter().map(with_findings).collect()
    }

    /// Newest accepted stamps, and what was counted of frames.
    pub(super) fn streams(&self) -> (BTreeMap<SensorId, Timestamp>, BTreeMap<SensorId, FrameCounts>) {
        let book = lock(&self.book);
        (book.last_stamps(), book.counts())
    }

    /// What doors have to say of streams that are no sensors, or not as they came, by name.
    pub fn stream_notes(&self) -> Vec<StreamNote> {
        lock(&self.book).notes()
    }

    /// Notes what is to be said of a stream; none if there is nothing any more.
    pub(crate) fn note_stream(&self, stream: &str, message: Option<String>) {
        lock(&self.book).note(stream, message);
    }

    /// Frames waiting.
    pub fn queue_len(&self) -> usize {
        self.queue.max_capacity() - self.queue.capacity()
    }

    /// Up to which ticket the effects of frames survive a crash.
    pub fn durable(&self) -> Durable {
        self.durable.clone()
    }

    /// Notes a sender's running number.
    pub fn numbered(&self, sensor: &SensorId, sequence: u64) {
        lock(&self.book).numbered(sensor, sequence);
    }

    /// Counts a frame that a door refused before it got here.
    pub fn rejected(&self, sensor: &SensorId, because: &Error) {
        lock(&self.book).rejected(sensor, because);
    }

    /// Whether the session does anything that sleeping would interrupt.
    pub(crate) fn is_busy(&self) -> bool {
        self.queue_len() > 0 || lock(&self.inboxes).values().any(|inbox| !lock(&inbox.frames).is_empty())
    }

    /// Whether what it takes in is being stored: putting it to sleep would hold up its callers for nothing otherwise.
    pub(crate) fn is_stored_well(&self) -> bool {
        matches!(*self.storing.borrow(), Storing::Well)
    }

    /// Why the storage does not take what the session holds, while tries go on.
    pub(super) fn waits_for_storage(&self) -> Option<Error> {
        match &*self.storing.borrow() {
            Storing::Waiting(error) => Some(error.clone()),
            Storing::Well | Storing::Ended(_) => None,
        }
    }

    /// The session is only read from now on.
    pub(super) fn set_apart(&self, fault: Fault) {
        let _ = self.fault.set(fault);
    }

    /// Why frames cannot be taken at the moment, or any more.
    fn check_storing(&self) -> Result<()> {
        if let Some(fault) = self.fault.get() {
            return Err(fault.error());
        }
        let error = self.storing.borrow().error();
        error.or_else(|| self.scratch.error()).map_or(Ok(()), Err)
    }

    /// Waits for room in the queue, then hands the frame over. The answer comes through what is returned. A session that
    /// has just been put to sleep gives the frame back.
    ///
    /// # Errors
    /// `SENSOR_NOT_FOUND`, `STAMP_IMPLAUSIBLE`, `STORAGE_FAULT`, `STORAGE_FULL`, `SESSION_FAULTED`; in `IngestOnly` what is
    /// wrong with the frame.
    pub(crate) async fn submit(&self, frame: Box<SensorFrame>) -> Result<Submitted> {
        self.check_storing()?;
        self.check_sensor(&frame.sensor)?;
        // Not within the condition, whose lock would be held while the refusal is counted.
        let before_ns = lock(&self.book).ahead_ns(&frame.sensor);
        if let Err(implausible) = check_stamp(frame.stamp, before_ns) {
            self.rejected(&frame.sensor, &implausible);
            return Err(implausible);
        }
        let (reply, pending) = oneshot::channel();
        if self.meta.read().unwrap_or_else(PoisonError::into_inner).mode == SessionMode::IngestOnly {
            let _ = reply.send(self.count_only(&frame));
            return Ok(Submitted::Taken(Pending(pending)));
        }
        let queued = observe::frame_queued();
        let command = Command::Frame { frame, received: Instant::now(), reply, queued };
        match self.queue.send(command).await {
            Ok(()) => Ok(Submitted::Taken(Pending(pending))),
            Err(mpsc::error::SendError(Command::Frame { frame, .. })) => Ok(Submitted::Asleep(frame)),
            Err(_) => Err(stopped()),
        }
    }

    /// What became of a frame that was taken in before: sent again, it is not an error.
    pub(crate) fn taken_before(&self, sensor: &SensorId, stamp: Timestamp) -> Option<Processed> {
        let ticket = lock(&self.book).ticket_of(sensor, stamp)?;
        Some(Processed { pose: None, keyframe: None, latency_s: 0.0, ticket, is_duplicate: true })
    }

    /// The ticket with which a frame is durable that was refused for its stamp, for it may have been taken in before.
    pub fn ticket_of_refused(&self, sensor: &SensorId, stamp: Timestamp) -> Option<Ticket> {
        lock(&self.book).ticket_covering(sensor, stamp)
    }

    /// Waits until a frame's effects survive a crash.
    ///
    /// # Errors
    /// `NOT_YET_DURABLE` if the storage does not take it at the moment: the frame stays taken in, and becomes durable when
    /// the storage is well again. `SESSION_FAULTED` if it never will.
    pub async fn wait_durable(&self, ticket: Ticket) -> Result<()> {
        let (mut durable, mut storing) = (self.durable.clone(), self.storing.clone());
        tokio::select! {
            biased;
            is_reached = durable.reach(ticket) => if is_reached { Ok(()) } else { Err(stopped()) },
            failed = storing.wait_for(|s| !matches!(s, Storing::Well)) => Err(match failed.as_deref() {
                Ok(Storing::Waiting(cause)) => not_yet_durable(cause),
                Ok(Storing::Ended(trouble)) => trouble.error(),
                _ => stopped(),
            }),
        }
    }

    /// Takes a frame from a door that cannot wait: by the sensor's policy it waits all the same, or the
    /// oldest waiting frame is dropped and counted.
    ///
    /// # Errors
    /// As [`Session::submit`].
    pub(crate) async fn offer(self: &Arc<Self>, frame: Box<SensorFrame>) -> Result<Offered> {
        let policy = self.check_sensor(&frame.sensor)?;
        if policy == OverloadPolicy::Block {
            return Ok(match self.submit(frame).await? {
                Submitted::Taken(_) => Offered::Taken,
                Submitted::Asleep(frame) => Offered::Asleep(frame),
            });
        }
        self.check_storing()?;
        if self.queue.is_closed() {
            return Ok(Offered::Asleep(frame));
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
            observe::frame_dropped(frame.data.kind());
        }
        inbox.filled.notify_one();
        Ok(Offered::Taken)
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
                let look = FrameLook::of(&frame.data);
                book.accepted(&frame.sensor, frame.stamp, 0, (Duration::ZERO, look));
                Ok(Processed { pose: None, keyframe: None, latency_s: 0.0, ticket: 0, is_duplicate: false })
            }
            Err(e) => {
                let refused = frame_error(&e);
                book.rejected(&frame.sensor, &refused);
                Err(refused)
            }
        }
    }

    /// Changes what is declared and set, durably. Changes come one at a time: `change` says what becomes of what is there,
    /// `learned` finds the detector that it names then.
    ///
    /// # Errors
    /// Those of `change`; `SESSION_STOPPED`, and why it is not stored.
    pub(super) async fn change(
        &self,
        change: impl FnOnce(&mut SessionMeta) -> Result<Option<SensorDeclaration>>,
        learned: impl FnOnce(&SessionMeta) -> ImageDetectors,
    ) -> Result<()> {
        self.check_storing()?;
        let alone = Arc::clone(&self.changing).lock_owned().await;
        let mut meta = self.meta();
        let declared = change(&mut meta)?.map(Box::new);
        let is_new = meta != self.meta();
        meta.revision += 1;
        let (done, changed) = oneshot::channel();
        let learned = learned(&meta);
        let meta = is_new.then(|| Box::new(meta));
        self.queue.send(Command::Change { meta, declared, learned, done, alone }).await.map_err(|_| stopped())?;
        let ticket = changed.await.map_err(|_| stopped())?;
        self.wait_durable(ticket).await
    }

    /// What the actor does of it.
    pub(super) fn changed(&self, meta: SessionMeta, declared: Option<SensorDeclaration>) {
        if let Some(declaration) = declared {
            lock(&self.book).redeclare(declaration);
        }
        *self.meta.write().unwrap_or_else(PoisonError::into_inner) = meta;
    }

    /// Takes a loop out of the map, or undoes that; none if there is no such loop.
    ///
    /// # Errors
    /// `SESSION_STOPPED`.
    pub async fn veto(&self, id: LoopId, vetoed: bool) -> Result<Option<Vetoed>> {
        self.check_storing()?;
        let (reply, done) = oneshot::channel();
        self.queue.send(Command::Veto { id, vetoed, reply }).await.map_err(|_| stopped())?;
        done.await.map_err(|_| stopped())
    }

    /// Does as a person says of an object.
    ///
    /// # Errors
    /// `SESSION_STOPPED`; inside, why it cannot be.
    pub(crate) async fn correct(
        &self,
        id: ObjectId,
        correction: Correction,
    ) -> Result<std::result::Result<Corrected, CorrectionError>> {
        self.check_storing()?;
        let (reply, done) = oneshot::channel();
        self.queue.send(Command::Correct { id, correction, reply }).await.map_err(|_| stopped())?;
        done.await.map_err(|_| stopped())
    }

    /// Says where the robot is, base to map; none if no frame that moves the pose comes in time, and nothing was changed.
    ///
    /// # Errors
    /// `SESSION_STOPPED`.
    pub(crate) async fn tell_pose(&self, t_map_base: Pose) -> Result<Option<(Told, PoseEstimate)>> {
        self.check_storing()?;
        let (id, (reply, mut done)) = (Arc::new(()), oneshot::channel());
        let telling = Telling { id: Arc::clone(&id), t_map_base, reply };
        self.queue.send(Command::TellPose(telling)).await.map_err(|_| stopped())?;
        if let Ok(done) = timeout(TELLING_PATIENCE, &mut done).await {
            return done.map(Some).map_err(|_| stopped());
        }
        // A frame that is being worked in may answer it still: only what is taken back has changed nothing.
        let (reply, forgotten) = oneshot::channel();
        self.queue.send(Command::ForgetTold { id, reply }).await.map_err(|_| stopped())?;
        forgotten.await.map_err(|_| stopped())?;
        Ok(done.try_recv().ok())
    }

    /// Makes the small corrections that wait for more.
    ///
    /// # Errors
    /// `SESSION_STOPPED`.
    pub async fn settle(&self) -> Result<Moved> {
        self.check_storing()?;
        let (reply, done) = oneshot::channel();
        self.queue.send(Command::Settle { reply }).await.map_err(|_| stopped())?;
        done.await.map_err(|_| stopped())
    }

    /// Begins with a map that was given; none if there is one already.
    ///
    /// # Errors
    /// `SESSION_STOPPED`.
    pub(crate) async fn import(
        &self,
        views: Vec<GivenView>,
        start: Option<Pose>,
        progress: &Progress,
    ) -> Result<Option<Imported>> {
        self.check_storing()?;
        let (reply, done) = oneshot::channel();
        let import = Command::Import { views, start, progress: progress.clone(), reply };
        self.queue.send(import).await.map_err(|_| stopped())?;
        done.await.map_err(|_| stopped())?
    }

    /// Waits until what was imported is durable. If it cannot be stored now the session ends, and begins anew as it is stored, which
    /// is without it: no map is shown that the next start does not have.
    pub(crate) async fn wait_imported(&self, ticket: Ticket, before: Arc<Snapshot>) -> Result<()> {
        let Err(error) = self.wait_durable(ticket).await else { return Ok(()) };
        let cause = self.storing.borrow().error().unwrap_or(error);
        *self.snapshot.write().unwrap_or_else(PoisonError::into_inner) = before;
        self.discard().await;
        if self.durable.has(ticket) { Ok(()) } else { Err(cause) }
    }

    /// Finishes what was accepted, stores it, ends. If it cannot be stored, the session goes on.
    pub(super) async fn retire(&self, patience: Duration) -> std::result::Result<(), Trouble> {
        let (done, retired) = oneshot::channel();
        if self.queue.send(Command::Retire { patience, done }).await.is_err() {
            return Ok(());
        }
        retired.await.unwrap_or(Ok(()))
    }

    /// Ends without storing anything more.
    pub(super) async fn discard(&self) {
        self.discarded.send_replace(true);
        self.queue.closed().await;
    }
}

/// Moves frames from an inbox to the queue for as long as the session lives.
async fn forward(session: std::sync::Weak<Session>, inbox: Arc<Inbox>) {
    loop {
        inbox.filled.notified().await;
        loop {
            let Some(session) = session.upgrade() else { return };
            let Some(frame) = lock(&inbox.frames).pop_front() else { break };
            match session.submit(frame).await {
                Ok(Submitted::Asleep(_)) => return,
                Err(e) => tracing::debug!(reason = e.reason, "a waiting frame was refused"),
                Ok(Submitted::Taken(_)) => {}
            }
        }
    }
}
