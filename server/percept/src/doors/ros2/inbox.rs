//! Samples of a robot's topics on their way from the network to its task, in the order in which they came.

use super::super::bounds::{Charge, Memory, Peer};
use super::super::zenoh::{charged, hand_over};
use std::sync::Arc;
use tokio::sync::mpsc;
use zenoh::sample::Sample;

/// Samples that wait; beyond it the link is held, and ROS publishers drop at their end.
const BACKLOG: usize = 32;

/// A sample of a topic, and the memory that it takes.
pub(super) struct Incoming {
    pub(super) topic: Arc<str>,
    pub(super) sample: Sample,
    _memory: Charge,
}

/// Where samples are put. Cheap to clone.
#[derive(Clone)]
pub(super) struct Inbox {
    memory: Arc<Memory>,
    peer: Peer,
    runtime: tokio::runtime::Handle,
    samples: mpsc::Sender<Incoming>,
}

impl Inbox {
    /// An inbox of a session's robot, and its other end.
    pub(super) fn new(memory: &Arc<Memory>, session: &str) -> (Self, mpsc::Receiver<Incoming>) {
        let (samples, taken) = mpsc::channel(BACKLOG);
        let runtime = tokio::runtime::Handle::current();
        (Self { memory: Arc::clone(memory), peer: Peer::Lane(session.to_owned()), runtime, samples }, taken)
    }

    /// Puts a sample in; waits, on zenoh's own thread, while there is no room.
    pub(super) fn put(&self, topic: &Arc<str>, sample: Sample) {
        let memory = charged(&self.memory, &self.peer, sample.payload().len(), &self.runtime);
        drop(hand_over(&self.samples, Incoming { topic: Arc::clone(topic), sample, _memory: memory }));
    }
}
