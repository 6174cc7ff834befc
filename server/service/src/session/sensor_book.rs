//! What the session sees of each sensor's stream.

use super::frame_look::FrameLook;
use super::meta::SensorDeclaration;
use super::records::{FrameCounts, StateRecord};
use super::refusal::ahead_ns;
use super::stream_figures::{Recent, StreamFigures};
use crate::Error;
use percept_geometry::{SensorId, SensorKind, Timestamp};
use percept_pipeline::{ImuFault, MountOffset, WheelsFault};
use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

/// Reasons of refusals that are told apart; further ones are counted alone.
const MAX_REFUSALS: usize = 8;
/// Streams beside the sensors that something is noted of; robots have some hundred topics.
const MAX_NOTES: usize = 256;

/// Health of one sensor's stream.
#[derive(Debug, Clone)]
pub struct SensorStatus {
    /// The sensor.
    pub declaration: SensorDeclaration,
    /// Frames accepted.
    pub accepted: u64,
    /// Frames refused as bad input.
    pub rejected: u64,
    /// Frames dropped under overload.
    pub dropped: u64,
    /// Missing numbers in the sender's sequence.
    pub gaps: u64,
    /// The newest frames in figures.
    pub figures: StreamFigures,
    /// Why frames were refused, the most frequent reason first; of the first eight reasons.
    pub refusals: Vec<Refusal>,
    /// Newest accepted stamp, the sensor's clock.
    pub last_stamp: Option<Timestamp>,
    /// Seconds by which its stamps are late behind the pose sensor's, beyond the declared offset, once that is known.
    pub clock_offset_s: Option<f64>,
    /// How far its mount is off, if what it sees contradicts the pose sensor's map.
    pub mount_offset: Option<MountOffset>,
    /// What is wrong with an IMU, as far as the frames that it went with tell.
    pub imu_faults: Vec<ImuFault>,
    /// How wheels contradict the pose sensor.
    pub wheels_faults: Vec<WheelsFault>,
    /// For how long nothing has come, while other sensors of the session go on, seconds.
    pub silent_s: Option<f64>,
    /// Another sensor of the session, and by how much these stamps are ahead of that one's though both come at the same time, seconds:
    /// another clock, or a link that is slower by so much.
    pub apart: Option<(SensorId, f64)>,
    /// Why the session cannot have a pose, as far as its sensors tell.
    pub no_pose: Option<NoPose>,
}

/// Frames that were refused for one reason.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// As errors have it, e.g. `STAMP_NOT_INCREASING`.
    pub reason: &'static str,
    /// How many.
    pub count: u64,
    /// What the newest of them was told.
    pub message: String,
}

/// What a door has to say of a stream that is no sensor, or not as it came.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StreamNote {
    /// What it is called where it comes from: a topic.
    pub stream: String,
    /// In words, for an operator.
    pub message: String,
    /// Server's clock, nanoseconds since the Unix epoch.
    pub time_ns: i64,
}

/// Why a session cannot have a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoPose {
    /// No sensor is declared that sees anything.
    NothingSees,
    /// The one that is to move the pose is not declared, or sees nothing.
    WantedIsAbsent,
    /// All that see are planar lidars whose plane is steep on the robot.
    PlaneIsSteep,
}

impl SensorStatus {
    fn counts(&self) -> FrameCounts {
        let Self { accepted, rejected, dropped, gaps, .. } = *self;
        FrameCounts { accepted, rejected, dropped, gaps }
    }

    /// Of a sensor of which nothing has come since the session woke, by what is stored of it.
    pub(crate) fn stored(declaration: SensorDeclaration, state: &StateRecord) -> Self {
        let id = &declaration.spec.id;
        let FrameCounts { accepted, rejected, dropped, gaps } = state.frame_counts.get(id).copied().unwrap_or_default();
        let last_stamp = state.last_stamps.get(id).copied();
        Self {
            declaration,
            accepted,
            rejected,
            dropped,
            gaps,
            figures: StreamFigures::default(),
            refusals: Vec::new(),
            last_stamp,
            clock_offset_s: None,
            mount_offset: None,
            imu_faults: Vec::new(),
            wheels_faults: Vec::new(),
            silent_s: None,
            apart: None,
            no_pose: None,
        }
    }
}

/// Frames whose tickets are remembered, for senders who send again what they do not know to be stored.
const TICKETS: usize = 256;

/// A frame that was taken in.
#[derive(Debug, Clone, Copy)]
struct Taken {
    stamp: Timestamp,
    ticket: u64,
    /// None of one that was taken in before the session woke.
    look: Option<FrameLook>,
}

/// A sensor.
#[derive(Debug, Clone)]
struct Entry {
    status: SensorStatus,
    recent: Recent,
    /// The newest frames, oldest first.
    tickets: VecDeque<Taken>,
    last_sequence: u64,
    /// How far the newest stamp was ahead of the server's clock when it was taken in, nanoseconds.
    ahead_ns: Option<i64>,
}

impl Entry {
    /// By how much its stamps are ahead of another sensor's, if they are apart.
    fn ahead_of(&self, other: &Self) -> Option<f64> {
        let offset_s = |e: &Self| e.status.declaration.spec.time_offset_s;
        self.recent.ahead_of(offset_s(self), &other.recent, offset_s(other))
    }
}

/// What was taken in of a stamp before a frame of the same stamp came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TakenAs {
    /// Nothing that is remembered.
    Nothing,
    /// The same frame: it is sent again.
    Same,
    /// Another frame.
    Another,
}

/// All sensors of a session.
#[derive(Debug, Clone, Default)]
pub(crate) struct SensorBook {
    entries: BTreeMap<SensorId, Entry>,
    notes: BTreeMap<String, StreamNote>,
}

impl SensorBook {
    /// Takes in what is known of a sensor: where its stamps have come to, and what was counted, before the session slept.
    pub(crate) fn declare(&mut self, declaration: SensorDeclaration, before: &StateRecord) {
        let id = declaration.spec.id.clone();
        let status = SensorStatus::stored(declaration, before);
        // What was taken in before a restart is durable.
        let taken = |stamp| Taken { stamp, ticket: 0, look: None };
        let tickets = status.last_stamp.map(taken).into_iter().collect();
        self.entries.insert(id, Entry { status, recent: Recent::default(), tickets, last_sequence: 0, ahead_ns: None });
    }

    /// Notes what is to be said of a stream, or that there is nothing to be said of it any more.
    pub(crate) fn note(&mut self, stream: &str, message: Option<String>) {
        let Some(message) = message else {
            self.notes.remove(stream);
            return;
        };
        if self.notes.len() < MAX_NOTES || self.notes.contains_key(stream) {
            let (stream, time_ns) = (stream.to_owned(), crate::clock::now_ns());
            self.notes.insert(stream.clone(), StreamNote { stream, message, time_ns });
        }
    }

    /// What is noted of streams, by name.
    pub(crate) fn notes(&self) -> Vec<StreamNote> {
        self.notes.values().cloned().collect()
    }

    /// Changes the declaration of a sensor that goes on: what was counted stays.
    pub(crate) fn redeclare(&mut self, declaration: SensorDeclaration) {
        match self.entries.get_mut(&declaration.spec.id).filter(|e| e.status.last_stamp.is_some()) {
            Some(entry) => entry.status.declaration = declaration,
            None => self.declare(declaration, &StateRecord::default()),
        }
    }

    pub(crate) fn get(&self, id: &SensorId) -> Option<&SensorStatus> {
        self.entries.get(id).map(|e| &e.status)
    }

    pub(crate) fn all(&self) -> impl Iterator<Item = &SensorStatus> {
        self.entries.values().map(|e| &e.status)
    }

    /// All sensors with what their streams are like now.
    pub(crate) fn all_now(&self) -> Vec<SensorStatus> {
        let now = Instant::now();
        let figures: Vec<StreamFigures> = self.entries.values().map(|e| e.recent.figures(now)).collect();
        let newest_s = figures.iter().filter_map(|f| f.quiet_s).reduce(f64::min);
        let reference = self.reference();
        let of = |(entry, figures): (&Entry, StreamFigures)| {
            let silent_s = figures.silent_s(newest_s);
            let apart = reference.and_then(|to| Some((to.status.declaration.spec.id.clone(), entry.ahead_of(to)?)));
            SensorStatus { figures, silent_s, apart, ..entry.status.clone() }
        };
        self.entries.values().zip(figures).map(of).collect()
    }

    /// The sensor whose stamps others are compared with: one that sees and that most agree with; of several a lidar.
    fn reference(&self) -> Option<&Entry> {
        let sees = |e: &&Entry| e.status.declaration.spec.can_move_the_pose();
        let num_apart = |to: &Entry| self.entries.values().filter(|e| e.ahead_of(to).is_some()).count();
        let is_no_lidar =
            |e: &Entry| !matches!(e.status.declaration.spec.kind, SensorKind::Lidar2d | SensorKind::Lidar3d);
        self.entries.values().filter(sees).min_by_key(|e| (num_apart(e), is_no_lidar(e)))
    }

    /// How far a sensor's newest stamp was ahead of the server's clock when it was taken in, nanoseconds.
    pub(crate) fn ahead_ns(&self, id: &SensorId) -> Option<i64> {
        self.entries.get(id)?.ahead_ns
    }

    /// Why there cannot be a pose, if `wanted` (empty for any) is to move it.
    pub(crate) fn no_pose(&self, wanted: &str) -> Option<NoPose> {
        let sees = |s: &SensorStatus| s.declaration.spec.kind.can_move_the_pose();
        if !wanted.is_empty() {
            let is_there = self.get(&SensorId(wanted.to_owned())).is_some_and(sees);
            return (!is_there).then_some(NoPose::WantedIsAbsent);
        }
        if !self.all().any(sees) {
            return Some(NoPose::NothingSees);
        }
        let is_level = |s: &SensorStatus| s.declaration.spec.can_move_the_pose();
        (!self.all().any(is_level)).then_some(NoPose::PlaneIsSteep)
    }

    /// The ticket of a frame that was taken in not long ago.
    pub(crate) fn ticket_of(&self, id: &SensorId, stamp: Timestamp) -> Option<u64> {
        let tickets = &self.entries.get(id)?.tickets;
        tickets.iter().rev().find(|t| t.stamp == stamp).map(|t| t.ticket)
    }

    /// What was taken in of a stamp, beside what came of it now.
    pub(crate) fn taken_as(&self, id: &SensorId, stamp: Timestamp, look: &FrameLook) -> TakenAs {
        let taken = self.entries.get(id).and_then(|e| e.tickets.iter().rev().find(|t| t.stamp == stamp));
        match taken {
            None => TakenAs::Nothing,
            Some(taken) if taken.look.is_none_or(|l| l == *look) => TakenAs::Same,
            Some(_) => TakenAs::Another,
        }
    }

    /// A ticket with which a frame of this stamp is durable if it was taken in at all: its own, or the newest of its sensor
    /// for one of long ago.
    pub(crate) fn ticket_covering(&self, id: &SensorId, stamp: Timestamp) -> Option<u64> {
        self.ticket_of(id, stamp).or_else(|| Some(self.entries.get(id)?.tickets.back()?.ticket))
    }

    /// The newest accepted stamps.
    pub(crate) fn last_stamps(&self) -> BTreeMap<SensorId, Timestamp> {
        self.entries.iter().filter_map(|(id, entry)| Some((id.clone(), entry.status.last_stamp?))).collect()
    }

    /// What was counted of each sensor.
    pub(crate) fn counts(&self) -> BTreeMap<SensorId, FrameCounts> {
        self.entries.iter().map(|(id, entry)| (id.clone(), entry.status.counts())).collect()
    }

    /// What will have been counted of a sensor once its frame at hand is noted as accepted.
    pub(crate) fn counts_with_accepted(&self, id: &SensorId) -> Option<FrameCounts> {
        let counts = self.get(id)?.counts();
        Some(FrameCounts { accepted: counts.accepted + 1, ..counts })
    }

    /// Notes a frame that was worked in `latency` after it had come.
    pub(crate) fn accepted(
        &mut self,
        id: &SensorId,
        stamp: Timestamp,
        ticket: u64,
        (latency, look): (Duration, FrameLook),
    ) {
        let Some(entry) = self.entries.get_mut(id) else { return };
        entry.status.accepted += 1;
        entry.status.last_stamp = Some(stamp);
        let ahead_ns = ahead_ns(stamp);
        entry.ahead_ns = Some(ahead_ns);
        entry.recent.add(stamp, ahead_ns, latency, look);
        entry.tickets.push_back(Taken { stamp, ticket, look: Some(look) });
        if entry.tickets.len() > TICKETS {
            entry.tickets.pop_front();
        }
    }

    pub(crate) fn rejected(&mut self, id: &SensorId, because: &Error) {
        let Some(entry) = self.entries.get_mut(id) else { return };
        entry.status.rejected += 1;
        let refusals = &mut entry.status.refusals;
        if let Some(known) = refusals.iter_mut().find(|r| r.reason == because.reason) {
            known.count += 1;
            known.message.clone_from(&because.message);
        } else if refusals.len() < MAX_REFUSALS {
            refusals.push(Refusal { reason: because.reason, count: 1, message: because.message.clone() });
        }
        refusals.sort_by_key(|r| std::cmp::Reverse(r.count));
    }

    pub(crate) fn dropped(&mut self, id: &SensorId) {
        if let Some(entry) = self.entries.get_mut(id) {
            entry.status.dropped += 1;
        }
    }

    /// Counts the numbers that a numbered sender left out; a smaller number means that it started anew.
    pub(crate) fn numbered(&mut self, id: &SensorId, sequence: u64) {
        let Some(entry) = self.entries.get_mut(id).filter(|_| sequence > 0) else { return };
        if entry.last_sequence > 0 && sequence > entry.last_sequence {
            entry.status.gaps = entry.status.gaps.saturating_add(sequence - entry.last_sequence - 1);
        }
        entry.last_sequence = sequence;
    }
}
