//! Watch all sessions at once: those that the caller may read, and of these what it wants.

use crate::SessionView;
use crate::caller::CallContext;
use crate::session::event::EventKind;
use crate::session::fleet::{FleetEvent, FleetKind, FleetLog};
use percept_identity::{Access, Pattern, Principal};
use std::sync::Arc;

/// Events that belong together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FleetGroup {
    /// Frames that were registered.
    Pose,
    /// Frames that became keyframes.
    Keyframe,
    /// Objects that changed.
    Object,
    /// Loops that were found, or changed their state.
    Loop,
    /// Maps that have a new version.
    Map,
    /// Sessions that were created, woken, put to sleep, set apart, deleted.
    Life,
    /// Sessions whose settings callers have changed.
    Settings,
}

/// Which events are watched. That events are missing is told in any case.
#[derive(Debug, Clone, Default)]
pub struct FleetFilter {
    /// Of sessions whose id fits; none: of all.
    pub pattern: Option<Pattern>,
    /// Of these kinds; empty: of all.
    pub groups: Vec<FleetGroup>,
}

/// What a caller sees of what happens.
#[derive(Clone)]
pub struct FleetWatch {
    log: Arc<FleetLog>,
    principal: Arc<Principal>,
    filter: FleetFilter,
}

impl FleetWatch {
    pub(crate) fn new(log: &Arc<FleetLog>, context: &CallContext, filter: FleetFilter) -> Self {
        Self { log: Arc::clone(log), principal: Arc::clone(&context.principal), filter }
    }

    /// Token of the newest event of any session.
    pub fn newest_token(&self) -> u64 {
        self.log.newest_token()
    }

    /// What there is to see after `token` among the next `limit` events, and the token up to which was looked; waits until
    /// something happened. `None` when nothing more will come.
    pub async fn after(&self, token: u64, limit: usize) -> Option<(Vec<FleetEvent>, u64)> {
        self.log.after(token, limit, |event| self.wants(event)).await
    }

    fn wants(&self, event: &FleetEvent) -> bool {
        let may_see = *event.tenant == *self.principal.tenant && self.principal.may(Access::Read, &event.session);
        let fits = self.filter.pattern.as_ref().is_none_or(|pattern| pattern.matches(&event.session));
        let groups = &self.filter.groups;
        may_see && fits && (groups.is_empty() || group(&event.kind).is_none_or(|group| groups.contains(&group)))
    }
}

impl FleetGroup {
    /// Of what happens in a session; none: told whatever is wanted.
    pub(super) fn of(kind: &EventKind) -> Option<Self> {
        Some(match kind {
            EventKind::Pose(_) => Self::Pose,
            EventKind::Keyframe(_) => Self::Keyframe,
            EventKind::Object(_) => Self::Object,
            EventKind::Loop(_) => Self::Loop,
            EventKind::MapVersion(_) => Self::Map,
            EventKind::Resync(_) => return None,
        })
    }
}

/// None: told whatever is wanted.
fn group(kind: &FleetKind) -> Option<FleetGroup> {
    Some(match kind {
        FleetKind::Session(kind) => return FleetGroup::of(kind),
        FleetKind::Resync(_) => return None,
        FleetKind::Created | FleetKind::State(_) | FleetKind::Deleted => FleetGroup::Life,
        FleetKind::Updated(_) => FleetGroup::Settings,
    })
}

/// Whether a caller may see a session at all.
pub(crate) fn may_see(principal: &Principal, view: &SessionView) -> bool {
    view.tenant == principal.tenant && principal.may(Access::Read, &view.id)
}
