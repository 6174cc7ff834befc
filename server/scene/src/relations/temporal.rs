//! What happened to things between two times: what appeared, went, or stands elsewhere, in or from which room, and in which order.

use super::{NodeId, Relation, RelationFrame, RelationKind};
use crate::rooms::Rooms;
use crate::{Object, ObjectState};
use percept_geometry::{OrientedBox3, Timestamp};

/// What happened within so many seconds happened together: a keyframe's objects are told half a second apart.
const TOGETHER_S: f64 = 2.0;
/// A thing that moved by less, beyond half of its own size, was only seen better, metres: boxes grow by as much while a robot goes
/// round a thing.
const SEEN_BETTER_M: f64 = 0.3;

/// Something that happened to one thing.
struct Event {
    stamp: Timestamp,
    kind: RelationKind,
    bbox: OrientedBox3,
    /// How far it went, metres.
    moved_m: f64,
}

/// What happened after `since` to objects as they are at the end of it, those that are gone among them. By object, then in order.
pub(crate) fn temporal(objects: &[Object], since: Timestamp, rooms: &Rooms) -> Vec<Relation> {
    let mut out = vec![];
    let mut order = vec![];
    for object in objects {
        let events = events(object, since);
        if let Some(last) = events.last() {
            order.push((last.stamp, NodeId::Object(object.id)));
        }
        out.extend(events.into_iter().map(|event| {
            let subject = NodeId::Object(object.id);
            Relation {
                subject,
                kind: event.kind,
                // Where rooms are not known, all that is known is that it happened.
                object: rooms.of(&event.bbox).map_or(subject, |room| NodeId::Room(room.id)),
                frame: RelationFrame::Any,
                strength: 1.0,
                distance_m: event.moved_m,
                stamp: Some(event.stamp),
            }
        }));
    }
    order.sort_unstable();
    out.extend(order.windows(2).map(|pair| {
        let [(before, subject), (after, object)] = [pair[0], pair[1]];
        let is_together = after.seconds_since(before) <= TOGETHER_S;
        Relation {
            subject,
            kind: if is_together { RelationKind::Together } else { RelationKind::Before },
            object,
            frame: RelationFrame::Any,
            strength: 1.0,
            distance_m: 0.0,
            stamp: Some(before),
        }
    }));
    out
}

/// What happened to one object, oldest first.
fn events(object: &Object, since: Timestamp) -> Vec<Event> {
    let then = object.at(since).filter(|o| o.state != ObjectState::Gone);
    let later = || object.history.iter().filter(|h| h.stamp > since);
    // Who came and went in between was there as well.
    let there = || later().find(|h| h.state != ObjectState::Gone);
    let came = || there().map_or((object.first_seen, object.bbox), |h| (h.stamp, h.bbox));
    let went = later().rfind(|h| h.state == ObjectState::Gone).map_or(object.last_seen, |h| h.stamp);
    let event = |stamp, kind, bbox| Event { stamp, kind, bbox, moved_m: 0.0 };
    let is_gone = object.state == ObjectState::Gone;
    match then {
        Some(_) if is_gone => vec![event(went, RelationKind::DisappearedFrom, object.bbox)],
        Some(then) => {
            let moved_m = (object.bbox.center() - then.bbox.center()).norm();
            let half = 0.5 * object.bbox.size.xy().max();
            let has_driven = later().any(|h| h.state == ObjectState::Moving);
            if moved_m < SEEN_BETTER_M + if has_driven { 0.0 } else { half } {
                return vec![];
            }
            let stamp = later().next_back().map_or(object.last_seen, |h| h.stamp);
            let of = |kind, bbox| Event { moved_m, ..event(stamp, kind, bbox) };
            vec![of(RelationKind::MovedFrom, then.bbox), of(RelationKind::MovedTo, object.bbox)]
        }
        None if is_gone && there().is_none() => vec![],
        None => {
            let (stamp, bbox) = came();
            let mut out = vec![event(stamp, RelationKind::AppearedIn, bbox)];
            out.extend(is_gone.then(|| event(went, RelationKind::DisappearedFrom, object.bbox)));
            out
        }
    }
}
