//! Zones that are stored with a session: every path in it keeps to them.

use super::zone_masks::SessionMask;
use crate::session::annotations::{RoomName, SessionZone};
use crate::session::meta::SessionMeta;
use crate::{Error, Result, reason};
use percept_planning::Zone;

/// Zones of a session, at most.
const MAX_ZONES: usize = 1_000;
/// Characters of a zone's name, at most.
const MAX_NAME_CHARS: usize = 64;

/// Checks zones that are to be stored.
///
/// # Errors
/// `OUT_OF_RANGE` naming the zone, `DISPLAY_NAME_INVALID`.
pub(super) fn check_zones(zones: &[SessionZone]) -> Result<()> {
    if zones.len() > MAX_ZONES {
        let message = format!("there are {} zones, at most {MAX_ZONES} are stored; merge some", zones.len());
        return Err(Error::invalid(reason::OUT_OF_RANGE, "zones", message));
    }
    for (i, SessionZone { name, zone }) in zones.iter().enumerate() {
        if name.chars().count() > MAX_NAME_CHARS || name.chars().any(char::is_control) {
            let message = format!("the name has more than {MAX_NAME_CHARS} characters, or control characters");
            return Err(Error::invalid(reason::DISPLAY_NAME_INVALID, format!("zones[{i}].name"), message));
        }
        let refused =
            |e: &dyn std::fmt::Display| Error::invalid(reason::OUT_OF_RANGE, format!("zones[{i}]"), e.to_string());
        zone.validate().map_err(|e| refused(&e))?;
    }
    Ok(())
}

/// What people drew into a session's map: all that paths keep to, and what rooms are called.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Zones {
    /// Polygons.
    pub areas: Vec<Zone>,
    /// Cells.
    pub masks: Vec<SessionMask>,
    /// Of rooms.
    pub room_names: Vec<RoomName>,
}

/// Those of a session, without the names of the areas.
pub(super) fn zones_of(meta: &SessionMeta) -> Zones {
    Zones {
        areas: meta.zones.iter().map(|z| z.zone.clone()).collect(),
        masks: meta.zone_masks.clone(),
        room_names: meta.room_names.clone(),
    }
}
