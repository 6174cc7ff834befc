//! The back end works beside the frames, so that no frame waits for places to be recognised or for the graph to be solved.
//!
//! What is asked of it is answered at a later frame, the first that is [`delay_s`] of the session's time younger than the
//! frame at which the work was begun; where the work takes longer than that, the frame waits for it. One batch of questions is worked on at a time, and the next holds what
//! was asked meanwhile, or some of it.

use crate::beside::{Executor, Task};
use percept_geometry::{Covariance6, KeyframeId, KeyframeScan, Pose, Timestamp};
use percept_slam::{BackEnd, BackEndKeyframe, BackEndMemory, BackEndUpdate, Evidence, Loop, Relocalisation};
use std::sync::Arc;

/// A batch's answers are taken in so many seconds after it was begun: a batch of a few keyframes takes up to a tenth of that
/// in a small map, so that frames of a busy server do not wait either.
const DELAY_S: f64 = 0.3;
/// The same for each keyframe of the graph, if it may have to be solved: with 4,853 keyframes that took 1.2 s of the 1.8 s that
/// this comes to. Answers that come later show corrections later, and where keyframes come faster than batches are begun the back
/// end falls behind: at one and a half a second, from 30,000 keyframes on. And if it is only looked at.
const DELAY_OF_SOLVING_S: f64 = 0.0003;
const DELAY_OF_LOOKING_S: f64 = 0.0001;
/// Where a robot is that was lost is told as soon as it is known: it is nowhere until then. One step of a search that goes on with
/// the next frame is done by the next frame of a lidar at 10 Hz (`percept eval slam --scenario kidnap`: found after 0.6 s in
/// the mean, 3.1 with the delay of other questions); a look of a 3D lidar or a depth camera takes a tenth of a second or two.
const DELAY_OF_STEP_S: f64 = 0.08;
const DELAY_OF_RELOCALISING_S: f64 = 0.2;
/// Questions in a batch, at most: of a part of the map that joins, all keyframes come at once, and take a tenth of a second
/// each where loops close by them.
const MOST_QUESTIONS: usize = 16;

fn delay_s(back_end: &BackEnd, questions: &[Question]) -> f64 {
    if questions.iter().all(|q| matches!(q, Question::Relocalise(_) | Question::Check(..))) {
        return if back_end.relocalises_in_steps() { DELAY_OF_STEP_S } else { DELAY_OF_RELOCALISING_S };
    }
    let num_keyframes = back_end.poses().len();
    let is_solved = questions.iter().any(|q| matches!(q, Question::Keyframe(_)));
    DELAY_S + num_keyframes as f64 * if is_solved { DELAY_OF_SOLVING_S } else { DELAY_OF_LOOKING_S }
}

/// What is asked of the back end.
pub(crate) enum Question {
    /// What follows from a keyframe.
    Keyframe(BackEndKeyframe),
    /// Where a robot is that was lost.
    Relocalise(Sighting),
    /// Whether a robot that was found is where it is believed to be, base to map at the sighting.
    Check(Sighting, Pose),
    /// To know keyframes that lie as they do; nothing is answered.
    Restore(Vec<BackEndKeyframe>),
}

/// What a robot sees that was lost.
pub(crate) struct Sighting {
    /// What it saw since, oldest first, with base then seen from base now.
    pub(crate) before: Vec<(Pose, Arc<KeyframeScan>)>,
    /// What it sees now.
    pub(crate) scan: KeyframeScan,
    /// Base to odom now.
    pub(crate) t_odom_base: Pose,
    /// Of that, since the start of odometry.
    pub(crate) covariance: Covariance6,
    /// Which of the parts of the map that hang on nothing it belongs to.
    pub(crate) part: u64,
}

/// What the back end has answered.
pub(crate) enum Answer {
    /// What follows from a keyframe.
    Update(KeyframeId, Box<BackEndUpdate>),
    /// Where the robot was at a sighting.
    Relocalised(Relocated),
    /// What a sighting says of where the robot was believed to be.
    Checked(Checked),
}

/// What a sighting says of where a robot was believed to be.
#[derive(Debug)]
pub(crate) struct Checked {
    pub(crate) evidence: Evidence,
    /// As [`Relocated`] has them.
    pub(crate) drift: Covariance6,
    pub(crate) t_odom_base: Pose,
    pub(crate) covariance: Covariance6,
    pub(crate) part: u64,
}

/// Where a robot was at a sighting; none unless that is certain.
#[derive(Debug)]
pub(crate) struct Relocated {
    pub(crate) found: Option<Relocalisation>,
    /// Whether the search goes on when it is asked again.
    pub(crate) is_unfinished: bool,
    /// Covariance of the place where it was found, as the way there from the start has it.
    pub(crate) drift: Covariance6,
    /// Base to odom at the sighting, and its covariance since the start of odometry.
    pub(crate) t_odom_base: Pose,
    pub(crate) covariance: Covariance6,
    pub(crate) part: u64,
}

/// Answers in the order of the questions, and the loops as they are after them, if they changed.
#[derive(Default)]
pub(crate) struct Answers {
    pub(crate) answers: Vec<Answer>,
    pub(crate) loops: Option<Arc<Vec<Loop>>>,
    /// What the back end took after them.
    pub(crate) memory: BackEndMemory,
}

/// A back end, at work or at rest.
pub(crate) struct GraphWorker {
    executor: Option<Arc<dyn Executor>>,
    state: State,
    /// Asked while it was at work.
    questions: Vec<Question>,
}

enum State {
    AtRest(Box<BackEnd>),
    AtWork {
        batch: Task<(Box<BackEnd>, Answers)>,
        /// When its answers are taken in.
        due: Timestamp,
    },
    /// Between the two, within this file alone.
    Moving,
}

impl GraphWorker {
    /// Without an executor work is done when its answers are due.
    pub(crate) fn new(back_end: BackEnd, executor: Option<Arc<dyn Executor>>) -> Self {
        Self { executor, state: State::AtRest(Box::new(back_end)), questions: vec![] }
    }

    pub(crate) fn set_executor(&mut self, executor: Arc<dyn Executor>) {
        self.executor = Some(executor);
    }

    /// Whether there is nothing that was asked and not answered.
    pub(crate) fn is_at_rest(&self) -> bool {
        matches!(self.state, State::AtRest(_))
    }

    /// Asks at a frame.
    pub(crate) fn ask(&mut self, question: Question, stamp: Timestamp) {
        self.questions.push(question);
        self.begin(stamp);
    }

    /// The answers that a frame takes in, if any are due.
    pub(crate) fn answers_at(&mut self, stamp: Timestamp) -> Option<Answers> {
        let State::AtWork { due, .. } = &self.state else { return None };
        if stamp < *due {
            return None;
        }
        let answers = self.wait();
        self.begin(stamp);
        answers
    }

    /// All answers that are still to come, and the back end at rest.
    pub(crate) fn finish(&mut self) -> (Answers, Option<&mut BackEnd>) {
        let mut all = self.wait().unwrap_or_default();
        while !self.questions.is_empty() {
            self.begin(Timestamp(0));
            let Some(rest) = self.wait() else { break };
            all.answers.extend(rest.answers);
            all.loops = rest.loops.or(all.loops);
            all.memory = rest.memory;
        }
        match &mut self.state {
            State::AtRest(back_end) => (all, Some(back_end)),
            State::AtWork { .. } | State::Moving => (all, None),
        }
    }

    /// Begins a batch of what was asked first, if the back end is at rest.
    fn begin(&mut self, stamp: Timestamp) {
        if self.questions.is_empty() || !self.is_at_rest() {
            return;
        }
        let State::AtRest(mut back_end) = std::mem::replace(&mut self.state, State::Moving) else { return };
        let rest = self.questions.split_off(MOST_QUESTIONS.min(self.questions.len()));
        let questions = std::mem::replace(&mut self.questions, rest);
        let due = stamp.plus_seconds(delay_s(&back_end, &questions));
        let batch = Task::begin(self.executor.as_ref(), move || {
            let answers = work(&mut back_end, questions);
            (back_end, answers)
        });
        self.state = State::AtWork { batch, due };
    }

    /// The answers to the batch that is being worked on; the back end is at rest then.
    fn wait(&mut self) -> Option<Answers> {
        let State::AtWork { batch, .. } = &self.state else { return None };
        let (back_end, answers) = batch.finished();
        self.state = State::AtRest(back_end);
        Some(answers)
    }
}

fn work(back_end: &mut BackEnd, questions: Vec<Question>) -> Answers {
    let mut loops_changed = false;
    let mut answer = |question| match question {
        Question::Keyframe(keyframe) => {
            let update = back_end.insert(&keyframe);
            loops_changed |= !update.loops.is_empty() || !update.dissolved.is_empty();
            Some(Answer::Update(keyframe.id, Box::new(update)))
        }
        Question::Relocalise(Sighting { before, scan, t_odom_base, covariance, part }) => {
            let found = back_end.relocalise(&before, &scan);
            let drift = found.as_ref().map_or_else(Covariance6::zeros, |found| back_end.drift_at(found.keyframe));
            let is_unfinished = back_end.is_unfinished();
            Some(Answer::Relocalised(Relocated { found, is_unfinished, drift, t_odom_base, covariance, part }))
        }
        Question::Check(Sighting { scan, t_odom_base, covariance, part, .. }, t_map_base) => {
            let evidence = back_end.check(&scan, &t_map_base);
            let drift = match &evidence {
                Evidence::Agrees(found) => back_end.drift_at(found.keyframe),
                Evidence::Contradicts | Evidence::Nothing => Covariance6::zeros(),
            };
            Some(Answer::Checked(Checked { evidence, drift, t_odom_base, covariance, part }))
        }
        Question::Restore(keyframes) => {
            back_end.resume(keyframes.into_iter(), vec![], 0);
            None
        }
    };
    let answers = questions.into_iter().filter_map(&mut answer).collect();
    let loops = loops_changed.then(|| Arc::new(back_end.loops().to_vec()));
    Answers { answers, loops, memory: back_end.memory() }
}
