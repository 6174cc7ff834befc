//! The actor: takes frames from a bounded queue, one at a time, and publishes what they did.

use super::command::{Command, Corrected, Imported, Moved, Processed, Telling, Vetoed};
use super::event::EventKind;
use super::events::EventLog;
use super::fault::Trouble;
use super::frame_look::FrameLook;
use super::handle::{Session, lock};
use super::job::Job;
use super::meta::{SensorDeclaration, SessionMeta};
use super::persist::{Persister, Storing};
use super::recording::{About, Recording};
use super::records::{FrameCounts, StateRecord};
use super::refusal::{failed, frame_error, stamp_repeated, stopped};
use super::scratch::Scratch;
use super::sensor_book::TakenAs;
use crate::{Asker, ComputePool, Limits, Progress, Result, observe};
use percept_geometry::{Pose, SensorFrame, SensorId};
use percept_mapping::given::GivenView;
use percept_pipeline::{FrameError, FrameReport, LoopId, MapChange, Pipeline, Snapshot};
use percept_scene::{Correction, CorrectionError, ObjectId};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, oneshot};
use tokio::time::timeout;

/// A session without frames for so long shows what was decided about its map: no frame waits for that.
const IDLE: Duration = Duration::from_secs(1);

/// One session's writer.
pub(super) struct Actor {
    pub(super) session: Arc<Session>,
    /// Away while a frame is being processed on the pool.
    pub(super) pipeline: Option<Pipeline>,
    pub(super) persister: Persister,
    pub(super) compute: ComputePool,
    pub(super) recording: Option<Recording>,
    /// What was counted of each sensor's frames when the session woke.
    pub(super) stored_counts: BTreeMap<SensorId, FrameCounts>,
    /// Where the robot is said to be.
    telling: VecDeque<Telling>,
}

/// Why an actor ended.
#[derive(Debug)]
pub(super) enum Ending {
    /// All that was accepted is stored.
    Retired,
    /// It was told to.
    Discarded,
    /// The pipeline failed; what was accepted before is stored, as far as the storage took it.
    Panicked,
    /// The session cannot be stored any more.
    Unstorable(Trouble),
}

/// Time that storing what was accepted may take after the pipeline has failed.
const LAST_PATIENCE: Duration = Duration::from_secs(10);

/// Puts what was declared or set anew into force.
fn take_settings(pipeline: &mut Pipeline, meta: &SessionMeta, declared: Option<&SensorDeclaration>) {
    if let Some(declaration) = declared {
        pipeline.declare_sensor(declaration.spec.clone());
    }
    pipeline.set_class_examples(Arc::new(meta.class_examples.clone()));
    if meta.params == *pipeline.params() {
        return;
    }
    // Checked before they came here; what were refused all the same would be a fault of ours.
    if let Err(error) = pipeline.set_params(meta.params.clone()) {
        tracing::error!(session = meta.id, %error, "changed parameters are not in force before the session wakes again");
    }
}

/// A handle and the actor behind it, over a pipeline that may have been restored. The caller runs the actor.
pub(super) fn start(
    meta: SessionMeta,
    mut pipeline: Pipeline,
    before: &StateRecord,
    (persister, scratch, recording): (Persister, Arc<Scratch>, Option<Recording>),
    compute: ComputePool,
    limits: &Limits,
    events: Arc<EventLog>,
) -> (Arc<Session>, impl Future<Output = Ending> + Send + 'static) {
    for declaration in &meta.sensors {
        pipeline.declare_sensor(declaration.spec.clone());
    }
    let (queue, commands) = mpsc::channel(limits.queue_length.max(1));
    let kept = (persister.durable(), persister.storing(), scratch);
    let session = Arc::new(Session::over(meta, &pipeline, before, queue, kept, None, limits, events));
    let (pipeline, stored_counts) = (Some(pipeline), before.frame_counts.clone());
    let telling = VecDeque::new();
    let actor =
        Actor { session: Arc::clone(&session), pipeline, persister, compute, recording, stored_counts, telling };
    (session, actor.run(commands))
}

impl Actor {
    pub(super) async fn run(mut self, mut commands: mpsc::Receiver<Command>) -> Ending {
        let mut discarded = self.session.discarded.subscribe();
        // Whatever is being waited for, such as a storage that takes nothing.
        let ending = tokio::select! {
            biased;
            _ = discarded.wait_for(|is_discarded| *is_discarded) => Ending::Discarded,
            ending = self.obey_all(&mut commands) => ending,
        };
        commands.close();
        if let Ending::Panicked = ending {
            let _ = self.persister.flushed(LAST_PATIENCE).await;
        }
        self.persister.end().await;
        ending
    }

    async fn obey_all(&mut self, commands: &mut mpsc::Receiver<Command>) -> Ending {
        let mut storing = self.persister.storing();
        loop {
            let is_building = self.pipeline.as_ref().is_some_and(Pipeline::is_revising);
            let command = tokio::select! {
                command = timeout(if is_building { IDLE } else { Duration::MAX }, commands.recv()) => command,
                ended = storing.wait_for(|s| matches!(s, Storing::Ended(_))) => {
                    let trouble = match ended.as_deref() {
                        Ok(Storing::Ended(trouble)) => trouble.clone(),
                        _ => Trouble::Passing(stopped()),
                    };
                    return Ending::Unstorable(trouble);
                }
            };
            match command {
                Ok(Some(Command::Retire { patience, done })) => {
                    if let Some(ending) = self.retire(patience, done, commands).await {
                        return ending;
                    }
                }
                Ok(None) => return Ending::Discarded,
                Ok(Some(command)) => self.obey(command).await,
                Err(_) => {
                    let _ = self.change(|pipeline| Some(pipeline.finish_revision())).await;
                }
            }
            if self.pipeline.is_none() {
                return Ending::Panicked;
            }
        }
    }

    /// Ends if all can be stored; goes on otherwise, so that nothing is lost that was accepted.
    async fn retire(
        &mut self,
        patience: Duration,
        done: oneshot::Sender<std::result::Result<(), Trouble>>,
        commands: &mut mpsc::Receiver<Command>,
    ) -> Option<Ending> {
        let _ = self.settle().await;
        let frame_counts = lock(&self.session.book).counts();
        if frame_counts != self.stored_counts {
            self.store(Job { frame_counts, ..Job::default() }).await;
        }
        if let Err(trouble) = self.persister.flushed(patience).await {
            let _ = done.send(Err(trouble));
            return None;
        }
        commands.close();
        // Whoever was quicker than the closing is served.
        while let Some(command) = commands.recv().await {
            self.obey(command).await;
        }
        let stored = self.persister.flushed(patience).await;
        if let Err(trouble) = &stored {
            tracing::error!(?trouble, "the last frames of a session were not stored");
        }
        let _ = done.send(stored);
        Some(Ending::Retired)
    }

    /// Does what a command says; without a pipeline, its sender learns that the session is gone.
    async fn obey(&mut self, command: Command) {
        match command {
            Command::Frame { frame, received, reply, queued } => {
                drop(queued);
                let _ = reply.send(self.frame(*frame, received).await);
            }
            Command::Change { meta: None, done, alone, .. } => {
                let _ = done.send(self.persister.newest());
                drop(alone);
            }
            Command::Change { meta: Some(meta), declared, learned, done, alone } => {
                if let Some(pipeline) = &mut self.pipeline {
                    pipeline.set_image_detectors(learned);
                    take_settings(pipeline, &meta, declared.as_deref());
                    *self.session.snapshot.write().unwrap_or_else(PoisonError::into_inner) =
                        Arc::new(pipeline.snapshot());
                }
                if let Some(recording) = &mut self.recording {
                    recording.change(declared.as_ref().map(|declared| &declared.spec));
                }
                self.session.changed(*meta.clone(), declared.map(|d| *d));
                let ticket = self.store(Job { meta: Some(meta), ..Job::default() }).await;
                let _ = done.send(ticket);
                drop(alone);
            }
            Command::Veto { id, vetoed, reply } => {
                if let Some(answer) = self.veto(id, vetoed).await {
                    let _ = reply.send(answer);
                }
            }
            Command::Correct { id, correction, reply } => {
                if let Some(answer) = self.correct(id, correction).await {
                    let _ = reply.send(answer);
                }
            }
            Command::TellPose(telling) => self.telling.push_back(telling),
            Command::ForgetTold { id, reply } => {
                self.telling.retain(|telling| !Arc::ptr_eq(&telling.id, &id));
                let _ = reply.send(());
            }
            Command::Settle { reply } => {
                if let Some(answer) = self.settle().await {
                    let _ = reply.send(answer);
                }
            }
            Command::Import { views, start, progress, reply } => {
                if let Err(unwanted) = progress.check() {
                    let _ = reply.send(Err(unwanted));
                } else if let Some(answer) = self.import(views, start, &progress).await {
                    let _ = reply.send(answer);
                }
            }
            Command::Retire { done, .. } => {
                let _ = done.send(Ok(()));
            }
        }
    }

    async fn frame(&mut self, frame: SensorFrame, came: Instant) -> Result<Processed> {
        let (sensor, stamp, kind) = (frame.sensor.clone(), frame.stamp, frame.data.kind());
        let (waited, began, look) = (came.elapsed(), Instant::now(), FrameLook::of(&frame.data));
        let mut pipeline = self.pipeline.take().ok_or_else(stopped)?;
        let sender = self.sender();
        // Who has gone wants nothing any more.
        self.telling.retain(|telling| !telling.reply.is_closed());
        let told = self.telling.front().map(|telling| telling.t_map_base);
        let (pipeline, outcome, frame) = self
            .compute
            .run_for(&sender, move || {
                pipeline.tell_pose(told);
                let outcome = pipeline.process(&frame).map(|report| {
                    let memory = report.keyframe.as_ref().map(|_| pipeline.memory().total());
                    (report, pipeline.snapshot(), memory)
                });
                (pipeline, outcome, frame)
            })
            .await
            .map_err(|_| failed())?;
        self.pipeline = Some(pipeline);
        let (report, snapshot, memory) = match outcome {
            Ok(done) => done,
            Err(e) => {
                let mut refused = frame_error(&e);
                let mut book = lock(&self.session.book);
                // A frame that is sent again is no bad input.
                let taken = book.taken_as(&sensor, stamp, &look);
                if taken == TakenAs::Another && matches!(e, FrameError::StampNotIncreasing { .. }) {
                    refused = stamp_repeated(stamp);
                }
                if taken != TakenAs::Same {
                    book.rejected(&sensor, &refused);
                }
                drop(book);
                observe::frame_refused(Some(kind), refused.reason);
                return Err(refused);
            }
        };
        observe::frame_accepted(kind, waited, began.elapsed());
        if let Some(recording) = &mut self.recording {
            let new = report.joined.len() + usize::from(report.keyframe.is_some());
            let num_keyframes = snapshot.keyframes.len().saturating_sub(new);
            let about = || About { params: self.session.meta().params, num_keyframes };
            recording.add(frame, report.pose.as_ref(), about);
        }
        if let Some(bytes) = memory {
            self.session.share.memory(bytes);
        }
        let objects_changed = !report.map.objects.is_empty() || !report.map.corrected.is_empty();
        let objects = objects_changed.then(|| (Arc::clone(&snapshot.tracked), snapshot.next_object_id));
        self.publish(&report, snapshot);
        let keyframe = report.keyframe.as_ref().map(|k| k.info.id);
        let mut keyframes = report.joined;
        keyframes.extend(report.keyframe);
        let (frame, entry, mended) = (Some((sensor.clone(), stamp)), report.trajectory, report.mended);
        let MapChange { loops, dissolved, corrected, merged, .. } = report.map;
        let counts = lock(&self.session.book).counts_with_accepted(&sensor);
        let frame_counts = counts.map(|counts| (sensor.clone(), counts)).into_iter().collect();
        let received = Some(came);
        let job = Job {
            received,
            frame,
            frame_counts,
            entry,
            mended,
            keyframes,
            loops,
            objects,
            corrected,
            merged,
            dissolved,
            ..Job::default()
        };
        let ticket = self.store(job).await;
        if let (Some(told), Some(pose)) = (report.told, &report.pose)
            && let Some(telling) = self.telling.pop_front()
        {
            let _ = telling.reply.send((told, pose.clone()));
        }
        let latency = came.elapsed();
        lock(&self.session.book).accepted(&sensor, stamp, ticket, (latency, look));
        let latency_s = latency.as_secs_f64();
        Ok(Processed { pose: report.pose, keyframe, latency_s, ticket, is_duplicate: false })
    }

    /// Queues what is to be stored, with the version of the map that callers see by now; its ticket.
    async fn store(&mut self, job: Job) -> u64 {
        let map_version = self.session.snapshot().map_version;
        self.persister.submit(Job { map_version, ..job }).await
    }

    fn sender(&self) -> Asker {
        self.compute.admission().sender(self.session.tenant(), self.session.id())
    }

    fn publish(&self, report: &FrameReport, snapshot: Snapshot) {
        let before = self.session.snapshot().map_version;
        let version = snapshot.map_version;
        let stamp = snapshot.pose.as_ref().map(|p| p.stamp).unwrap_or_default();
        self.session.share.map(snapshot.keyframes.len(), snapshot.objects.len());
        if let Some(pose) = &report.pose {
            self.session.share.tracking(pose.state, pose.stamp);
        }
        *self.session.snapshot.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(snapshot);
        let pose = report.pose.iter().map(|p| EventKind::Pose(Box::new(p.clone())));
        let keyframes = report.joined.iter().chain(&report.keyframe).map(|k| EventKind::Keyframe(k.info.clone()));
        let loops = report.map.loops.iter().map(|l| EventKind::Loop(Box::new(l.clone())));
        let objects = self.session.snapshot().objects.clone();
        let now = |id| objects.iter().find(|o| o.id == id).cloned();
        let changes = report.map.objects.iter().map(|c| EventKind::Object(Box::new((*c, now(c.id)))));
        let map = (version != before).then_some(EventKind::MapVersion(version));
        self.session.events.publish(stamp, pose.chain(keyframes).chain(loops).chain(changes).chain(map));
    }

    async fn veto(&mut self, id: LoopId, vetoed: bool) -> Option<Option<Vetoed>> {
        let done = self.change(move |pipeline| pipeline.veto(id, vetoed)).await?;
        let Some((change, moved)) = done else { return Some(None) };
        let changed = change.loops.into_iter().find(|l| l.id == id)?;
        Some(Some(Vetoed { changed, moved }))
    }

    /// Does as a person says of an object. None if the pipeline is gone.
    async fn correct(
        &mut self,
        id: ObjectId,
        correction: Correction,
    ) -> Option<std::result::Result<Corrected, CorrectionError>> {
        // Sent back by the work, which runs once and to its end.
        let (refuse, refused) = std::sync::mpsc::channel();
        let done = self
            .change(move |pipeline| match pipeline.annotate(id, correction) {
                Ok(change) => Some(change),
                Err(error) => {
                    let _ = refuse.send(error);
                    None
                }
            })
            .await?;
        match (done, refused.try_recv()) {
            (Some((change, moved)), _) => {
                let mut ids: Vec<ObjectId> = change.objects.iter().map(|c| c.id).chain([id]).collect();
                ids.sort_unstable();
                ids.dedup();
                Some(Ok(Corrected { ids, moved }))
            }
            (None, Ok(error)) => Some(Err(error)),
            (None, Err(_)) => None,
        }
    }

    async fn settle(&mut self) -> Option<Moved> {
        Some(self.change(|pipeline| Some(pipeline.settle())).await??.1)
    }

    /// Begins with a map that was given. None inside if there is one already, none outside if the pipeline is gone. If it is not
    /// wanted any more once it is in, the session ends and begins anew as it is stored, without it.
    async fn import(
        &mut self,
        views: Vec<GivenView>,
        start: Option<Pose>,
        progress: &Progress,
    ) -> Option<Result<Option<Imported>>> {
        let mut pipeline = self.pipeline.take()?;
        let sender = self.sender();
        let work = self.compute.run_for(&sender, move || {
            let done = pipeline.take_given(views, start);
            let snapshot = pipeline.snapshot();
            (pipeline, done, snapshot)
        });
        let (pipeline, done, snapshot) = work.await.ok()?;
        self.session.share.memory(pipeline.memory().total());
        self.pipeline = Some(pipeline);
        let Ok(keyframes) = done else { return Some(Ok(None)) };
        if let Err(unwanted) = progress.check() {
            self.session.discarded.send_replace(true);
            return Some(Err(unwanted));
        }
        let map_version = snapshot.map_version;
        let report = FrameReport { joined: keyframes, ..FrameReport::default() };
        self.publish(&report, snapshot);
        let ticket = self.store(Job { keyframes: report.joined, start, ..Job::default() }).await;
        Some(Ok(Some(Imported { map_version, ticket })))
    }

    /// Changes the map other than by a frame: what changed, and how the map moved. None inside if there is nothing
    /// to change, none outside if the pipeline is gone.
    async fn change(
        &mut self,
        change: impl FnOnce(&mut Pipeline) -> Option<MapChange> + Send + 'static,
    ) -> Option<Option<(MapChange, Moved)>> {
        let mut pipeline = self.pipeline.take()?;
        let sender = self.sender();
        let work = self.compute.run_for(&sender, move || {
            let done = change(&mut pipeline);
            let snapshot = pipeline.snapshot();
            (pipeline, done, snapshot)
        });
        let (pipeline, done, snapshot) = work.await.ok()?;
        self.pipeline = Some(pipeline);
        let Some(change) = done else { return Some(None) };
        let (map_version, objects) = (snapshot.map_version, (Arc::clone(&snapshot.tracked), snapshot.next_object_id));
        let num_keyframes = change.corrected.len();
        let is_same = change.loops.is_empty()
            && change.corrected.is_empty()
            && change.merged.is_empty()
            && change.objects.is_empty();
        if is_same {
            // No keyframe moved, but parts of the map may have been built anew, and objects seen again.
            let shown = self.session.snapshot();
            if map_version != shown.map_version || !Arc::ptr_eq(&snapshot.objects, &shown.objects) {
                self.publish(&FrameReport::default(), snapshot);
            }
            return Some(Some((change, Moved { num_keyframes, map_version, ticket: self.persister.newest() })));
        }
        let report = FrameReport { map: change, ..FrameReport::default() };
        self.publish(&report, snapshot);
        let MapChange { loops, dissolved, corrected, merged, .. } = report.map.clone();
        let job = Job { loops, dissolved, corrected, merged, objects: Some(objects), ..Job::default() };
        let ticket = self.store(job).await;
        Some(Some((report.map, Moved { num_keyframes, map_version, ticket })))
    }
}
