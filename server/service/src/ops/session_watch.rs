//! Watch one session: of what happens in it, what is wanted.

use super::fleet::FleetGroup;
use crate::session::event::{Event, EventKind};
use percept_scene::{ObjectFilter, ObjectId};
use std::collections::BTreeSet;

/// Which events of a session are watched. That events are missing is told in any case.
#[derive(Debug, Clone, Default)]
pub struct EventFilter {
    /// Of these kinds; empty: of all.
    pub groups: Vec<FleetGroup>,
    /// Of objects, only of those that fit, and what becomes of these from then on.
    pub objects: Option<ObjectFilter>,
    followed: BTreeSet<ObjectId>,
}

impl EventFilter {
    /// Of these kinds and objects.
    pub fn new(groups: Vec<FleetGroup>, objects: Option<ObjectFilter>) -> Self {
        Self { groups, objects, followed: BTreeSet::new() }
    }

    /// Whether an event is wanted; they have to come in order.
    pub fn wants(&mut self, event: &Event) -> bool {
        let group = FleetGroup::of(&event.kind);
        if !self.groups.is_empty() && group.is_some_and(|group| !self.groups.contains(&group)) {
            return false;
        }
        match (&self.objects, &event.kind) {
            (Some(filter), EventKind::Object(changed)) => {
                let (change, object) = &**changed;
                if object.as_ref().is_some_and(|o| filter.fits(o)) {
                    self.followed.insert(change.id);
                }
                self.followed.contains(&change.id)
            }
            // What was missed may have been about any.
            _ => true,
        }
    }
}
