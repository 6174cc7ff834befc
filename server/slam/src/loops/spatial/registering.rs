//! Local maps registered beside the frames: that takes up to a second, and no frame shall wait for it.

use super::local_map::{Placed, Surface};
use super::verified;
use percept_geometry::{KeyframeId, KeyframeScan, Pose};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};

/// What a local map's keyframes saw, and where they are believed to be, base to map.
#[derive(Debug)]
pub(super) struct Views {
    /// Base to map at the keyframe that the map is tied by.
    pub(super) t_map_anchor: Pose,
    pub(super) keyframes: Vec<(KeyframeId, Arc<KeyframeScan>, Pose)>,
}

impl Views {
    fn surface(&self) -> Option<Surface> {
        let placed: Vec<Placed<'_>> = self.keyframes.iter().map(|(id, scan, t)| (*id, scan.as_ref(), *t)).collect();
        Surface::around(&self.t_map_anchor, &placed)
    }
}

/// Base at the later map's anchor, seen from base at the earlier one's; none unless that is certain.
fn lay_over(from: &Views, to: &Views) -> Option<Pose> {
    // Both surfaces have the axes of the session's map, and each its origin at its anchor.
    let found = verified(&to.surface()?, &from.surface()?)?.t_target_source;
    let [r_from, r_to] = [from, to].map(|v| Pose::from_parts(Default::default(), v.t_map_anchor.rotation));
    Some(r_from.inverse() * found * r_to)
}

/// One registration at a time. When it is asked for does not depend on how long it takes, so neither does the map.
#[derive(Debug)]
pub(super) struct Registering<T> {
    /// A thread of its own: one that works on frames would wait for itself.
    thread: Option<ThreadPool>,
    running: Option<(T, Receiver<Option<Pose>>)>,
}

impl<T> Default for Registering<T> {
    fn default() -> Self {
        Self { thread: None, running: None }
    }
}

impl<T> Registering<T> {
    /// Begins to lay the later map's surface over the earlier one's; what was begun before has to be taken first.
    pub(super) fn begin(&mut self, what: T, from: Views, to: Views) {
        let (answer, answered) = channel();
        // Whoever asked may be gone.
        let work = move || {
            answer.send(lay_over(&from, &to)).ok();
        };
        if self.thread.is_none() {
            self.thread = ThreadPoolBuilder::new().num_threads(1).build().ok();
        }
        match &self.thread {
            Some(thread) => thread.spawn(work),
            // No more threads are to be had: the frame does it.
            None => work(),
        }
        self.running = Some((what, answered));
    }

    /// What was begun, with its answer: waits for it if need be.
    pub(super) fn take(&mut self) -> Option<(T, Option<Pose>)> {
        let (what, answered) = self.running.take()?;
        Some((what, answered.recv().ok().flatten()))
    }
}
