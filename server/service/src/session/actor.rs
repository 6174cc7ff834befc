//! The actor: takes frames from a bounded queue, one at a time, and publishes what they did.

use super::events::EventKind;
use super::handle::{Command, Processed, Session, Vetoed, lock};
use super::persist::{Job, Persister};
use super::refusal::{frame_error, stopped};
use crate::{ComputePool, ErrorCode, Result};
use percept_geometry::{Correction, KeyframeId, Pose, SensorFrame, SensorId, Timestamp};
use percept_pipeline::{FrameReport, Loop, LoopId, Pipeline, Snapshot, VetoReport};
use std::sync::{Arc, PoisonError};
use std::time::Instant;
use tokio::sync::mpsc;

/// One session's writer.
pub(super) struct Actor {
    pub(super) session: Arc<Session>,
    /// Away while a frame is being processed on the pool.
    pub(super) pipeline: Option<Pipeline>,
    pub(super) persister: Persister,
    pub(super) compute: ComputePool,
}

impl Actor {
    pub(super) async fn run(mut self, mut commands: mpsc::Receiver<Command>) {
        while let Some(command) = commands.recv().await {
            match command {
                Command::Frame { frame, received, reply } => {
                    let answer = self.frame(*frame, received).await;
                    let fatal = answer.as_ref().is_err_and(|e| e.code == ErrorCode::Internal);
                    let _ = reply.send(answer);
                    if fatal && self.pipeline.is_none() {
                        break;
                    }
                }
                Command::Declare(spec) => {
                    if let Some(pipeline) = &mut self.pipeline {
                        pipeline.declare_sensor(*spec);
                    }
                }
                Command::Correct { correction, reply } => {
                    if let Some(snapshot) = self.correct(correction).await {
                        let _ = reply.send(snapshot);
                    }
                }
                Command::Veto { id, vetoed, reply } => {
                    if let Some(answer) = self.veto(id, vetoed).await {
                        let _ = reply.send(answer);
                    }
                }
                Command::Settle { reply } => {
                    if let Some(answer) = self.settle().await {
                        let _ = reply.send(answer);
                    }
                }
                Command::Stop { stopped } => {
                    commands.close();
                    while let Some(command) = commands.recv().await {
                        self.last_of(command).await;
                    }
                    let _ = self.settle().await;
                    self.persister.finish().await;
                    self.session.events.close();
                    let _ = stopped.send(());
                    return;
                }
            }
        }
        self.persister.finish().await;
        self.session.events.close();
    }

    /// What was accepted before the stop is still done.
    async fn last_of(&mut self, command: Command) {
        match command {
            Command::Frame { frame, received, reply } => {
                let _ = reply.send(self.frame(*frame, received).await);
            }
            Command::Correct { correction, reply } => {
                if let Some(snapshot) = self.correct(correction).await {
                    let _ = reply.send(snapshot);
                }
            }
            Command::Veto { id, vetoed, reply } => {
                if let Some(answer) = self.veto(id, vetoed).await {
                    let _ = reply.send(answer);
                }
            }
            Command::Settle { reply } => {
                if let Some(answer) = self.settle().await {
                    let _ = reply.send(answer);
                }
            }
            Command::Declare(_) => {}
            Command::Stop { stopped } => {
                let _ = stopped.send(());
            }
        }
    }

    async fn frame(&mut self, frame: SensorFrame, received: Instant) -> Result<Processed> {
        let (sensor, stamp) = (frame.sensor.clone(), frame.stamp);
        let mut pipeline = self.pipeline.take().ok_or_else(stopped)?;
        let (pipeline, outcome) = self
            .compute
            .run(move || {
                let outcome = pipeline.process(&frame).map(|report| (report, pipeline.snapshot()));
                (pipeline, outcome)
            })
            .await?;
        self.pipeline = Some(pipeline);
        let (report, snapshot) = match outcome {
            Ok(done) => done,
            Err(e) => {
                lock(&self.session.book).rejected(&sensor);
                return Err(frame_error(&e));
            }
        };
        lock(&self.session.book).accepted(&sensor, stamp);
        let objects_changed = !report.changes.is_empty() || !report.corrected.is_empty();
        let objects = objects_changed.then(|| (Arc::clone(&snapshot.objects), snapshot.next_object_id));
        self.publish(&report, snapshot);
        let keyframe = report.keyframe.as_ref().map(|k| k.info.id);
        let mut keyframes = report.joined;
        keyframes.extend(report.keyframe);
        let (entry, loops, corrected) = (report.trajectory, report.loops, report.corrected);
        let (merged, dissolved) = (report.merged, report.dissolved);
        let job = Job { sensor, stamp, entry, keyframes, loops, objects, corrected, merged, dissolved };
        let ticket = self.persister.submit(job).await;
        Ok(Processed { pose: report.pose, keyframe, latency_s: received.elapsed().as_secs_f64(), ticket })
    }

    fn publish(&self, report: &FrameReport, snapshot: Snapshot) {
        let before = self.session.snapshot().map_version;
        let version = snapshot.map_version;
        let stamp = snapshot.pose.as_ref().map(|p| p.stamp).unwrap_or_default();
        *self.session.snapshot.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(snapshot);
        let pose = report.pose.iter().map(|p| EventKind::Pose(Box::new(p.clone())));
        let keyframes = report.joined.iter().chain(&report.keyframe).map(|k| EventKind::Keyframe(k.info.clone()));
        let loops = report.loops.iter().map(|l| EventKind::Loop(Box::new(l.clone())));
        let changes = report.changes.iter().map(|c| EventKind::Object(Box::new(*c)));
        let map = (version != before).then_some(EventKind::MapVersion(version));
        self.session.events.publish(stamp, pose.chain(keyframes).chain(loops).chain(changes).chain(map));
    }

    async fn correct(&mut self, correction: Correction) -> Option<Snapshot> {
        self.change(move |pipeline| {
            pipeline.apply(&correction);
            ((), vec![], correction.t_map_base)
        })
        .await
        .map(|((), snapshot)| snapshot)
    }

    async fn veto(&mut self, id: LoopId, vetoed: bool) -> Option<Option<Vetoed>> {
        let change = move |pipeline: &mut Pipeline| match pipeline.veto(id, vetoed) {
            None => (None, vec![], vec![]),
            Some(VetoReport { changed, corrected }) => {
                (Some((changed.clone(), corrected.len())), vec![changed], corrected)
            }
        };
        let (done, snapshot) = self.change(change).await?;
        let map_version = snapshot.map_version;
        Some(done.map(|(changed, num_moved)| Vetoed { changed, num_moved, map_version }))
    }

    async fn settle(&mut self) -> Option<(usize, u64)> {
        let change = |pipeline: &mut Pipeline| {
            let corrected = pipeline.settle();
            (corrected.len(), vec![], corrected)
        };
        self.change(change).await.map(|(num_moved, snapshot)| (num_moved, snapshot.map_version))
    }

    /// Changes the map other than by a frame: what `change` answers, the loops it changed and the keyframes it moved.
    async fn change<T: Send + 'static>(
        &mut self,
        change: impl FnOnce(&mut Pipeline) -> (T, Vec<Loop>, Vec<(KeyframeId, Pose)>) + Send + 'static,
    ) -> Option<(T, Snapshot)> {
        let mut pipeline = self.pipeline.take()?;
        let work = self.compute.run(move || {
            let done = change(&mut pipeline);
            let snapshot = pipeline.snapshot();
            (pipeline, done, snapshot)
        });
        let (pipeline, (answer, loops, corrected), snapshot) = work.await.ok()?;
        self.pipeline = Some(pipeline);
        if loops.is_empty() && corrected.is_empty() {
            return Some((answer, snapshot));
        }
        let report = FrameReport { loops, corrected, ..FrameReport::default() };
        self.publish(&report, snapshot.clone());
        let job = Job {
            sensor: SensorId(String::new()),
            stamp: Timestamp::default(),
            entry: None,
            keyframes: vec![],
            loops: report.loops,
            objects: Some((Arc::clone(&snapshot.objects), snapshot.next_object_id)),
            corrected: report.corrected,
            merged: vec![],
            dissolved: vec![],
        };
        self.persister.submit(job).await;
        Some((answer, snapshot))
    }
}
