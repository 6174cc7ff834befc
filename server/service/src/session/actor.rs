//! The actor: takes frames from a bounded queue, one at a time, and publishes what they did.

use super::events::EventKind;
use super::handle::{Command, Moved, Processed, Session, Vetoed, lock};
use super::persist::{Job, Persister};
use super::refusal::{frame_error, stopped};
use crate::{ComputePool, Result};
use percept_geometry::SensorFrame;
use percept_pipeline::{FrameReport, Loop, LoopId, MapChange, Pipeline, Snapshot};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
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
}

impl Actor {
    pub(super) async fn run(mut self, mut commands: mpsc::Receiver<Command>) {
        let mut stops = vec![];
        loop {
            let is_building = self.pipeline.as_ref().is_some_and(Pipeline::is_revising);
            let command = match timeout(if is_building { IDLE } else { Duration::MAX }, commands.recv()).await {
                Ok(Some(command)) => command,
                Ok(None) => break,
                Err(_) => {
                    let _ = self.change(|pipeline| Some(pipeline.finish_revision())).await;
                    continue;
                }
            };
            match command {
                Command::Stop { stopped } => {
                    // What was accepted before is still done.
                    commands.close();
                    stops.push(stopped);
                }
                command => self.obey(command).await,
            }
            if self.pipeline.is_none() {
                break;
            }
        }
        if !stops.is_empty() {
            let _ = self.settle().await;
        }
        self.persister.finish().await;
        self.session.events.close();
        for stopped in stops {
            let _ = stopped.send(());
        }
    }

    /// Does what a command says; without a pipeline, its sender learns that the session is gone.
    async fn obey(&mut self, command: Command) {
        match command {
            Command::Frame { frame, received, reply } => {
                let _ = reply.send(self.frame(*frame, received).await);
            }
            Command::Declare(spec) => {
                if let Some(pipeline) = &mut self.pipeline {
                    pipeline.declare_sensor(*spec);
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
        let objects_changed = !report.changes.is_empty() || !report.map.corrected.is_empty();
        let objects = objects_changed.then(|| (Arc::clone(&snapshot.objects), snapshot.next_object_id));
        self.publish(&report, snapshot);
        let keyframe = report.keyframe.as_ref().map(|k| k.info.id);
        let mut keyframes = report.joined;
        keyframes.extend(report.keyframe);
        let (frame, entry) = (Some((sensor, stamp)), report.trajectory);
        let MapChange { loops, dissolved, corrected, merged } = report.map;
        let job = Job { frame, entry, keyframes, loops, objects, corrected, merged, dissolved };
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
        let loops = report.map.loops.iter().map(|l| EventKind::Loop(Box::new(l.clone())));
        let changes = report.changes.iter().map(|c| EventKind::Object(Box::new(*c)));
        let map = (version != before).then_some(EventKind::MapVersion(version));
        self.session.events.publish(stamp, pose.chain(keyframes).chain(loops).chain(changes).chain(map));
    }

    async fn veto(&mut self, id: LoopId, vetoed: bool) -> Option<Option<Vetoed>> {
        let done = self.change(move |pipeline| pipeline.veto(id, vetoed)).await?;
        let Some((loops, moved)) = done else { return Some(None) };
        let changed = loops.into_iter().find(|l| l.id == id)?;
        Some(Some(Vetoed { changed, moved }))
    }

    async fn settle(&mut self) -> Option<Moved> {
        Some(self.change(|pipeline| Some(pipeline.settle())).await??.1)
    }

    /// Changes the map other than by a frame: the loops that changed, and how the map moved. None inside if there is nothing
    /// to change, none outside if the pipeline is gone.
    async fn change(
        &mut self,
        change: impl FnOnce(&mut Pipeline) -> Option<MapChange> + Send + 'static,
    ) -> Option<Option<(Vec<Loop>, Moved)>> {
        let mut pipeline = self.pipeline.take()?;
        let work = self.compute.run(move || {
            let done = change(&mut pipeline);
            let snapshot = pipeline.snapshot();
            (pipeline, done, snapshot)
        });
        let (pipeline, done, snapshot) = work.await.ok()?;
        self.pipeline = Some(pipeline);
        let Some(change) = done else { return Some(None) };
        let (map_version, objects) = (snapshot.map_version, (Arc::clone(&snapshot.objects), snapshot.next_object_id));
        let num_keyframes = change.corrected.len();
        let is_same = change.loops.is_empty() && change.corrected.is_empty() && change.merged.is_empty();
        if is_same {
            return Some(Some((vec![], Moved { num_keyframes, map_version, ticket: self.persister.newest() })));
        }
        let report = FrameReport { map: change, ..FrameReport::default() };
        self.publish(&report, snapshot);
        let MapChange { loops, dissolved, corrected, merged } = report.map.clone();
        let job = Job { loops, dissolved, corrected, merged, objects: Some(objects), ..Job::default() };
        let ticket = self.persister.submit(job).await;
        Some(Some((report.map.loops, Moved { num_keyframes, map_version, ticket })))
    }
}
