//! The back end as the map graph has it: constraints, place index, optimisation and culling, at work beside the frames.

use super::worker::{Answers, GraphWorker, Question};
use crate::{Executor, SlamParams};
use percept_geometry::Timestamp;
use percept_slam::loops::place_recognition;
use percept_slam::{BackEnd, BackEndMemory, Loop, OdometryKind, OdometryNoise};
use std::sync::Arc;

/// The back end, once a kind of sensor whose loops can be found moves the pose and loops are wanted.
#[derive(Default)]
pub(super) struct Constraints {
    executor: Option<Arc<dyn Executor>>,
    worker: Option<GraphWorker>,
    loops: Arc<Vec<Loop>>,
    memory: BackEndMemory,
    noise: Option<OdometryNoise>,
}

impl Constraints {
    pub(super) fn set_executor(&mut self, executor: Arc<dyn Executor>) {
        if let Some(worker) = &mut self.worker {
            worker.set_executor(Arc::clone(&executor));
        }
        self.executor = Some(executor);
    }

    /// Makes the back end for the kind of sensor that moves the pose, unless there is one.
    pub(super) fn prepare(&mut self, params: &SlamParams, kind: OdometryKind) {
        if self.worker.is_none() {
            self.worker = self.worker(params, kind);
            self.noise = Some(OdometryNoise::of(kind));
        }
    }

    /// Of the odometry that moves the pose; none before there is one.
    pub(super) fn noise(&self) -> Option<&OdometryNoise> {
        self.noise.as_ref()
    }

    /// A back end that knows nothing yet; none if loops are not wanted, or cannot be found by what this kind sees.
    pub(super) fn worker(&self, params: &SlamParams, kind: OdometryKind) -> Option<GraphWorker> {
        let recognition = place_recognition(kind, &params.odometry, params.back_end.place_limits());
        let recognition = recognition.filter(|_| params.back_end.enabled)?;
        Some(GraphWorker::new(
            BackEnd::new(params.back_end.clone(), OdometryNoise::of(kind), recognition),
            self.executor.clone(),
        ))
    }

    /// Forgets all keyframes and loops; those that were known.
    pub(super) fn begin_anew(&mut self, params: &SlamParams, kind: OdometryKind) -> Arc<Vec<Loop>> {
        let next_loop = self.worker.take().and_then(|mut w| w.finish().1.map(|b| b.next_loop()));
        let Some(next_loop) = next_loop else { return Arc::default() };
        let before = std::mem::take(&mut self.loops);
        self.prepare(params, kind);
        if let Some(back_end) = self.at_rest() {
            back_end.resume(std::iter::empty(), vec![], next_loop);
        }
        before
    }

    /// Whether there is a back end.
    pub(super) fn is_active(&self) -> bool {
        self.worker.is_some()
    }

    /// Whether something is being worked on.
    pub(super) fn is_working(&self) -> bool {
        self.worker.as_ref().is_some_and(|w| !w.is_at_rest())
    }

    /// Asks at a frame; whether there is somebody to be asked.
    pub(super) fn ask(&mut self, question: Question, stamp: Timestamp) -> bool {
        if let Some(worker) = &mut self.worker {
            worker.ask(question, stamp);
        }
        self.worker.is_some()
    }

    /// The answers that a frame takes in, if any are due.
    pub(super) fn answers_at(&mut self, stamp: Timestamp) -> Option<Answers> {
        let answers = self.worker.as_mut()?.answers_at(stamp)?;
        self.note(&answers);
        Some(answers)
    }

    /// All answers that are still to come.
    pub(super) fn finish(&mut self) -> Option<Answers> {
        let answers = self.worker.as_mut()?.finish().0;
        self.note(&answers);
        Some(answers)
    }

    fn note(&mut self, answers: &Answers) {
        if !answers.answers.is_empty() {
            self.memory = answers.memory;
        }
        if let Some(loops) = &answers.loops {
            self.loops = Arc::clone(loops);
        }
    }

    /// The back end, with nothing left to be answered.
    pub(super) fn at_rest(&mut self) -> Option<&mut BackEnd> {
        self.worker.as_mut()?.finish().1
    }

    /// What the back end took when it last answered.
    pub(super) fn memory(&self) -> BackEndMemory {
        self.memory
    }

    /// Loops in the order of finding, those not believed included.
    pub(super) fn loops(&self) -> Arc<Vec<Loop>> {
        Arc::clone(&self.loops)
    }

    pub(super) fn set_loops(&mut self, loops: Vec<Loop>) {
        self.loops = Arc::new(loops);
    }
}
