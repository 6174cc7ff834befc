//! Lists of sessions, and events of all of them.

use super::{layers, maps, scene, sessions};
use crate::v1;
use percept_scene::ObjectFilter;
use percept_service::reason;
use percept_service::{
    Error, EventFilter, EventKind, FleetEvent, FleetFilter, FleetGroup, FleetKind, Pattern, Result, SessionList,
    SessionOrder, SessionOrderKey,
};

/// Terms of a selector, at most.
const MAX_TERMS: usize = 32;

/// Which sessions a list is of.
///
/// # Errors
/// `ENUM_UNKNOWN`, `PATTERN_INVALID`, `LABEL_SELECTOR_INVALID`, `ORDER_INVALID`.
pub fn list(r: &v1::ListSessionsRequest) -> Result<SessionList> {
    Ok(SessionList {
        state: sessions::wanted_state(r.state)?,
        pattern: pattern(&r.session_pattern)?,
        labels: selector(&r.label_selector)?,
        order: order(&r.order_by)?,
        page_size: r.page_size,
        page_token: r.page_token.clone(),
    })
}

pub(super) fn pattern(text: &str) -> Result<Option<Pattern>> {
    if text.is_empty() {
        return Ok(None);
    }
    Pattern::new(text).map(Some).map_err(|_| {
        let shown: String = text.chars().take(80).collect();
        let words = format!(
            "session_pattern is {shown:?}; write 1 to 64 characters of a-z A-Z 0-9 _ - and * for any others, e.g. robot-*"
        );
        Error::invalid(reason::PATTERN_INVALID, "session_pattern", words)
    })
}

fn selector(text: &str) -> Result<Vec<(String, Option<String>)>> {
    if text.trim().is_empty() {
        return Ok(vec![]);
    }
    let term = |term: &str| {
        let (key, value) = term.split_once('=').map_or((term, None), |(key, value)| (key, Some(value.trim())));
        let key = key.trim();
        let fine = !key.is_empty() && !key.contains(char::is_whitespace) && !value.unwrap_or_default().contains('=');
        fine.then(|| (key.to_owned(), value.map(str::to_owned)))
    };
    let read: Option<Vec<_>> = text.split(',').map(term).collect();
    read.filter(|terms| terms.len() <= MAX_TERMS).ok_or_else(|| {
        let shown: String = text.chars().take(80).collect();
        let words = format!(
            "label_selector is {shown:?}; write up to {MAX_TERMS} of key=value, or key for any value, with commas between them"
        );
        Error::invalid(reason::LABEL_SELECTOR_INVALID, "label_selector", words)
    })
}

fn order(text: &str) -> Result<SessionOrder> {
    let mut words = text.split_whitespace();
    let by = match words.next() {
        None | Some("session_id") => Some(SessionOrderKey::Id),
        Some("create_time_ns") => Some(SessionOrderKey::CreateTime),
        Some("last_used_ns") => Some(SessionOrderKey::LastUsed),
        Some(_) => None,
    };
    let is_descending = match words.next() {
        None | Some("asc") => Some(false),
        Some("desc") => Some(true),
        Some(_) => None,
    };
    match (by, is_descending, words.next()) {
        (Some(by), Some(is_descending), None) => Ok(SessionOrder { by, is_descending }),
        _ => {
            let shown: String = text.chars().take(80).collect();
            let words = format!(
                "order_by is {shown:?}; write session_id, create_time_ns or last_used_ns, and desc behind it for the last first"
            );
            Err(Error::invalid(reason::ORDER_INVALID, "order_by", words))
        }
    }
}

/// Which events are watched.
///
/// # Errors
/// `ENUM_UNKNOWN`, `PATTERN_INVALID`.
pub fn filter(r: &v1::WatchSessionsRequest) -> Result<FleetFilter> {
    Ok(FleetFilter { pattern: pattern(&r.session_pattern)?, groups: groups(&r.kinds)? })
}

/// Which events of one session are watched.
///
/// # Errors
/// `ENUM_UNKNOWN`, also for kinds that no session has of its own; `CLASS_NAME_INVALID`, those of a box.
pub fn of_session(r: &v1::WatchSessionRequest) -> Result<EventFilter> {
    let groups = groups(&r.kinds)?;
    let is_of_fleet = |group: &FleetGroup| matches!(group, FleetGroup::Life | FleetGroup::Settings);
    if let Some(k) = groups.iter().position(is_of_fleet) {
        return Err(super::unknown_enum("kinds", r.kinds[k]));
    }
    Ok(EventFilter::new(groups, r.objects.as_ref().map(watched_objects).transpose()?))
}

fn watched_objects(r: &v1::ObjectWatch) -> Result<ObjectFilter> {
    Ok(ObjectFilter {
        class: scene::class_named("objects.label", &r.label)?,
        text: r.text.clone(),
        region: layers::box3(r.region.as_ref()).map_err(|e| e.within("objects"))?,
        include_gone: true,
        ..ObjectFilter::default()
    })
}

fn groups(kinds: &[i32]) -> Result<Vec<FleetGroup>> {
    use v1::FleetEventKind as K;
    let group = |&kind: &i32| match K::try_from(kind) {
        Ok(K::Pose) => Ok(FleetGroup::Pose),
        Ok(K::Keyframe) => Ok(FleetGroup::Keyframe),
        Ok(K::Object) => Ok(FleetGroup::Object),
        Ok(K::Loop) => Ok(FleetGroup::Loop),
        Ok(K::Map) => Ok(FleetGroup::Map),
        Ok(K::Life) => Ok(FleetGroup::Life),
        Ok(K::Settings) => Ok(FleetGroup::Settings),
        Ok(K::Unspecified) | Err(_) => Err(super::unknown_enum("kinds", kind)),
    };
    kinds.iter().map(group).collect()
}

/// An event as a message.
pub fn event_to(event: &FleetEvent) -> v1::FleetEvent {
    use v1::fleet_event::Event as E;
    let life = |step: v1::LifeStep, state: v1::SessionState| {
        E::Life(v1::SessionLife { step: step.into(), state: state.into() })
    };
    let kind = match &event.kind {
        FleetKind::Session(EventKind::Pose(p)) => E::Pose(sessions::pose_to(p)),
        FleetKind::Session(EventKind::Keyframe(k)) => E::KeyframeAdded(sessions::keyframe_to(k)),
        FleetKind::Session(EventKind::Object(changed)) => {
            E::ObjectChanged(scene::change_to(&changed.0, changed.1.as_ref()))
        }
        FleetKind::Session(EventKind::Loop(l)) => E::LoopChanged(maps::loop_to(l)),
        FleetKind::Session(EventKind::MapVersion(v)) => E::MapVersion(*v),
        FleetKind::Session(EventKind::Resync(missed)) | FleetKind::Resync(missed) => {
            E::Resync(v1::Resync { missed: *missed })
        }
        FleetKind::Created => life(v1::LifeStep::Created, v1::SessionState::Unspecified),
        FleetKind::State(state) => life(v1::LifeStep::Moved, sessions::state_to(*state)),
        FleetKind::Deleted => life(v1::LifeStep::Deleted, v1::SessionState::Unspecified),
        FleetKind::Updated(etag) => E::NewEtag(etag.to_string()),
    };
    v1::FleetEvent {
        token: event.token,
        session_id: event.session.to_string(),
        stamp_ns: event.stamp.nanos(),
        event: Some(kind),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn selectors_name_labels_with_a_value_or_any() {
        let read = |text: &str| selector(text).map(|terms| terms.len());
        let site = ("site".to_owned(), Some("north".to_owned()));
        assert_eq!(selector(" site=north , hall").unwrap(), [site, ("hall".to_owned(), None)]);
        assert_eq!((read("").unwrap(), read("  ").unwrap(), read("a=").unwrap()), (0, 0, 1));
        for bad in ["=north", ",", "a,,b", "a b", "a=b=c", &"a,".repeat(40)] {
            assert_eq!(read(bad).unwrap_err().reason, "LABEL_SELECTOR_INVALID", "{bad}");
        }
    }

    #[test]
    fn orders_are_words() {
        let read = |text: &str| order(text).map(|o| (o.by, o.is_descending));
        assert_eq!(read("").unwrap(), (SessionOrderKey::Id, false));
        assert_eq!(read("create_time_ns desc").unwrap(), (SessionOrderKey::CreateTime, true));
        for bad in ["age", "session_id down", "session_id desc desc", "create_time_ns,session_id"] {
            assert_eq!(read(bad).unwrap_err().reason, "ORDER_INVALID", "{bad}");
        }
    }
}
