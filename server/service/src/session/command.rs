//! What doors ask of a session's actor, and what it answers.

use super::fault::Trouble;
use super::meta::{SensorDeclaration, SessionMeta};
use super::refusal::stopped;
use crate::observe::Held;
use crate::{Progress, Result};
use percept_geometry::{KeyframeId, Pose, SensorFrame};
use percept_mapping::given::GivenView;
use percept_perception::detection::ImageDetectors;
use percept_pipeline::{Loop, LoopId, PoseEstimate, Told};
use percept_scene::{Correction, CorrectionError, ObjectId};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::{OwnedMutexGuard, oneshot};

/// Running number of an accepted frame in its session; durable once the session's `durable` has reached it.
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
    /// The frame had been taken in before; nothing was done with it this time.
    pub is_duplicate: bool,
}

/// The answer to a submitted frame, when it comes.
pub struct Pending(pub(super) oneshot::Receiver<Result<Processed>>);

impl Pending {
    /// What became of the frame.
    ///
    /// # Errors
    /// What is wrong with it; `SESSION_STOPPED` if the session ended before its turn came: nothing was done with it.
    pub async fn answer(self) -> Result<Processed> {
        self.0.await.unwrap_or_else(|_| Err(stopped()))
    }
}

/// Where the robot is said to be, base to map, and who waits for what comes of it.
pub(crate) struct Telling {
    /// Its own, to take it back by.
    pub(crate) id: Arc<()>,
    pub(crate) t_map_base: Pose,
    pub(crate) reply: oneshot::Sender<(Told, PoseEstimate)>,
}

/// What became of a submitted frame so far.
pub(crate) enum Submitted {
    /// It waits its turn.
    Taken(Pending),
    /// The session has just been put to sleep: wake it and submit again.
    Asleep(Box<SensorFrame>),
}

/// What became of an offered frame.
pub(crate) enum Offered {
    /// It waits its turn, or will be dropped and counted.
    Taken,
    /// The session has just been put to sleep: wake it and offer again.
    Asleep(Box<SensorFrame>),
}

pub(crate) enum Command {
    Frame {
        frame: Box<SensorFrame>,
        received: Instant,
        reply: oneshot::Sender<Result<Processed>>,
        queued: Held,
    },
    /// None: nothing changes, and the ticket tells when what is there is durable.
    Change {
        meta: Option<Box<SessionMeta>>,
        declared: Option<Box<SensorDeclaration>>,
        /// The learned detector that it names.
        learned: ImageDetectors,
        done: oneshot::Sender<Ticket>,
        /// Kept until it is in force: the next change builds on this one, whoever still waits for it.
        alone: OwnedMutexGuard<()>,
    },
    Veto {
        id: LoopId,
        vetoed: bool,
        reply: oneshot::Sender<Option<Vetoed>>,
    },
    /// What a person says of an object.
    Correct {
        id: ObjectId,
        correction: Correction,
        reply: oneshot::Sender<std::result::Result<Corrected, CorrectionError>>,
    },
    Settle {
        reply: oneshot::Sender<Moved>,
    },
    /// Where the robot is, as somebody says; answered by the next frame that moves the pose.
    TellPose(Telling),
    /// Takes back what was told, if no frame has answered it yet.
    ForgetTold {
        id: Arc<()>,
        reply: oneshot::Sender<()>,
    },
    /// None if there is a map already. Once it is not wanted any more, nothing is stored, and the session ends.
    Import {
        views: Vec<GivenView>,
        start: Option<Pose>,
        progress: Progress,
        reply: oneshot::Sender<Result<Option<Imported>>>,
    },
    /// Store everything, then end; go on if it cannot be stored.
    Retire {
        patience: Duration,
        done: oneshot::Sender<std::result::Result<(), Trouble>>,
    },
}

/// How the map moved, other than by a frame.
#[derive(Debug, Clone, Copy)]
pub struct Moved {
    /// Keyframes that moved.
    pub num_keyframes: usize,
    /// Version of the map with it.
    pub map_version: u64,
    /// Durable once the session's `durable` has reached it.
    pub ticket: Ticket,
}

/// A map that was given is in.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Imported {
    /// Version of the map with it.
    pub map_version: u64,
    /// Durable once the session's `durable` has reached it.
    pub ticket: Ticket,
}

/// What a person's correction of an object did.
#[derive(Debug, Clone)]
pub(crate) struct Corrected {
    /// The object, and those that it made or changed, ascending.
    pub ids: Vec<ObjectId>,
    /// The map with it.
    pub moved: Moved,
}

/// What a veto did.
#[derive(Debug, Clone)]
pub struct Vetoed {
    /// The loop, with its new state.
    pub changed: Loop,
    /// The map that followed.
    pub moved: Moved,
}
