//! Field masks (AIP-134, AIP-161): which fields of a session or a sensor a request is about, and what they become.

use super::{geometry, navigation, required, sensors, zones};
use crate::{params, v1};
use percept_geometry::SensorId;
use percept_service::reason;
use percept_service::{
    Error, Limits, MaskCells, MaskChange, ParamChange, Result, SensorChanges, SessionChanges, SessionMode, SessionZone,
};
use prost_types::FieldMask;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Fields of a session that callers set.
const SETTABLE: &str = "display_name, labels, zones, zone_masks, params and what is below it";
/// Fields of a sensor's declaration that may be named.
const OF_A_SENSOR: &str = "t_base_sensor, intrinsics, time_offset_s, overload_policy";

/// Which session, as its caller has seen it, and what becomes of it.
pub struct SessionUpdate {
    /// The session.
    pub id: String,
    /// Empty: whatever is there.
    pub etag: String,
    /// What becomes of it.
    pub changes: SessionChanges,
}

/// Which sensor, as its caller has seen it, and what becomes of it.
pub struct SensorUpdate {
    /// Its session.
    pub session: String,
    /// The sensor.
    pub id: SensorId,
    /// Empty: whatever is there.
    pub etag: String,
    /// What becomes of it.
    pub changes: SensorChanges,
}

/// Each once: what is named a thousand times is copied once.
fn paths(mask: Option<&FieldMask>) -> Option<BTreeSet<&str>> {
    let each: BTreeSet<&str> = mask?.paths.iter().map(String::as_str).collect();
    (!each.is_empty()).then_some(each)
}

fn unknown(path: &str, known: &str) -> Error {
    let shown: String = path.chars().take(80).collect();
    Error::invalid(reason::MASK_PATH_UNKNOWN, "update_mask", format!("update_mask names {shown:?}; there are {known}"))
}

fn nothing(known: &str) -> Error {
    let words =
        format!("nothing is to change; set a field, or name what goes back to its default in update_mask: {known}");
    Error::invalid(reason::FIELD_MISSING, "update_mask", words)
}

/// A change of a session.
///
/// # Errors
/// `FIELD_MISSING`, `MASK_PATH_UNKNOWN`, `FIELD_READ_ONLY`, `ENUM_UNKNOWN`, `PARAMETER_OUT_OF_RANGE`; what is wrong with a zone, or the
/// file of a zone mask.
pub fn session(r: &v1::UpdateSessionRequest, limits: &Limits) -> Result<SessionUpdate> {
    let session = required("session", r.session.as_ref())?;
    let mut changes = SessionChanges::default();
    match paths(r.update_mask.as_ref()) {
        Some(paths) => {
            for path in paths {
                name(&mut changes, session, path, limits)?;
            }
        }
        None => {
            changes.display_name = Some(session.display_name.clone()).filter(|name| !name.is_empty());
            changes.labels = Some(labels(session)).filter(|labels| !labels.is_empty());
            changes.zones = Some(zones(session)?).filter(|zones| !zones.is_empty());
            changes.zone_masks = Some(zone_masks(session, limits)?).filter(|masks| !masks.is_empty());
            changes.mode = mode(session.mode)?;
            let all = param_changes(session, "")?.unwrap_or_default();
            changes.params = all.into_iter().filter(|change| change.value.is_some()).collect();
            if changes == SessionChanges::default() {
                return Err(nothing(SETTABLE));
            }
        }
    }
    let etag = if r.etag.is_empty() { &session.etag } else { &r.etag };
    Ok(SessionUpdate { id: session.session_id.clone(), etag: etag.clone(), changes })
}

fn name(changes: &mut SessionChanges, session: &v1::Session, path: &str, limits: &Limits) -> Result<()> {
    let (field, below) = path.split_once('.').map_or((path, None), |(field, below)| (field, Some(below)));
    match (field, below) {
        ("display_name", None) => changes.display_name = Some(session.display_name.clone()),
        ("labels", None) => changes.labels = Some(labels(session)),
        ("zones", None) => changes.zones = Some(zones(session)?),
        ("zone_masks", None) => changes.zone_masks = Some(zone_masks(session, limits)?),
        ("params", Some("")) => return Err(unknown(path, SETTABLE)),
        ("params", below) => {
            let below = below.unwrap_or_default();
            changes.params.extend(param_changes(session, below)?.ok_or_else(|| unknown(path, SETTABLE))?);
        }
        // The path says which, so that it is never another.
        ("session_id", None) => {}
        ("mode", None) => changes.mode = mode(session.mode)?,
        ("sensors", _) => return Err(read_only(path, "change sensors by UpdateSensor, and add some by DeclareSensor")),
        ("display_name" | "labels" | "zones" | "zone_masks" | "session_id" | "mode", Some(_)) => {
            return Err(unknown(path, SETTABLE));
        }
        (field, _) if crate::json::descriptor("Session")?.get_field_by_name(field).is_some() => {
            return Err(read_only(path, "leave it out of the mask"));
        }
        _ => return Err(unknown(path, SETTABLE)),
    }
    Ok(())
}

fn read_only(path: &str, remedy: &str) -> Error {
    let words = format!("update_mask names {path:?}, which the server tells and nobody sets; {remedy}");
    Error::invalid(reason::FIELD_READ_ONLY, path, words)
}

fn labels(session: &v1::Session) -> std::collections::BTreeMap<String, String> {
    session.labels.clone().into_iter().collect()
}

fn zones(session: &v1::Session) -> Result<Vec<SessionZone>> {
    let of = |(i, z): (usize, &v1::Zone)| {
        let zone = zones::zone(z).map_err(|e| e.within(&format!("session.zones[{i}]")))?;
        Ok(SessionZone { name: z.name.clone(), zone })
    };
    session.zones.iter().enumerate().map(of).collect()
}

fn zone_masks(session: &v1::Session, limits: &Limits) -> Result<Vec<MaskChange>> {
    let of = |mask: &v1::ZoneMask| {
        let grid = match &mask.map {
            None => None,
            Some(v1::zone_mask::Map::Grid(grid)) => Some(("grid", navigation::grid(grid))),
            Some(v1::zone_mask::Map::Nav2(files)) => Some(("nav2", navigation::nav2(files, limits))),
        };
        let cells = |(field, grid): (&str, Result<_>)| {
            grid.and_then(|grid| MaskCells::new(grid, limits)).map(Arc::new).map_err(|e| e.within(field))
        };
        let (cells, meaning) = (grid.map(cells).transpose()?, zones::mask_meaning(mask.kind.as_ref())?);
        Ok(MaskChange { name: mask.name.clone(), meaning, cells })
    };
    let numbered =
        |(i, mask): (usize, &v1::ZoneMask)| of(mask).map_err(|e: Error| e.within(&format!("zone_masks[{i}]")));
    session.zone_masks.iter().enumerate().map(numbered).collect()
}

fn mode(value: i32) -> Result<Option<SessionMode>> {
    use v1::SessionMode as M;
    match M::try_from(value) {
        Ok(M::Unspecified) => Ok(None),
        Ok(M::Mapping) => Ok(Some(SessionMode::Mapping)),
        Ok(M::IngestOnly) => Ok(Some(SessionMode::IngestOnly)),
        Err(_) => Err(super::unknown_enum("mode", value)),
    }
}

fn param_changes(session: &v1::Session, below: &str) -> Result<Option<Vec<ParamChange>>> {
    params::changes(session.params.as_ref(), below)
}

/// A change of a sensor.
///
/// # Errors
/// `FIELD_MISSING`, `MASK_PATH_UNKNOWN`, `ENUM_UNKNOWN`; what is wrong with mount and intrinsics.
pub fn sensor(r: &v1::UpdateSensorRequest) -> Result<SensorUpdate> {
    let spec = required("spec", r.spec.as_ref())?;
    let mut changes = SensorChanges::default();
    let implied = || {
        let set = [
            ("kind", spec.kind != 0),
            ("t_base_sensor", spec.t_base_sensor.is_some()),
            ("intrinsics", spec.intrinsics.is_some()),
            ("time_offset_s", spec.time_offset_s != 0.0),
            ("overload_policy", spec.overload_policy != 0),
        ];
        set.into_iter().filter(|(_, is_set)| *is_set).map(|(field, _)| field).collect()
    };
    let named: BTreeSet<&str> = paths(r.update_mask.as_ref()).unwrap_or_else(implied);
    if named.is_empty() {
        return Err(nothing(OF_A_SENSOR));
    }
    for field in named {
        match field {
            "sensor_id" => {}
            "kind" => changes.kind = Some(sensors::kind(spec.kind)?),
            "t_base_sensor" => {
                changes.t_base_sensor = Some(geometry::pose("t_base_sensor", spec.t_base_sensor.as_ref())?);
            }
            "intrinsics" => {
                let intrinsics = spec.intrinsics.as_ref().map(sensors::intrinsics).transpose();
                changes.intrinsics = Some(intrinsics.map_err(|e| e.within("intrinsics"))?);
            }
            "time_offset_s" => changes.time_offset_s = Some(spec.time_offset_s),
            "overload_policy" => changes.overload = Some(sensors::overload(spec.overload_policy)?),
            other => return Err(unknown(other, OF_A_SENSOR)),
        }
    }
    let id = SensorId(spec.sensor_id.clone());
    Ok(SensorUpdate { session: r.session_id.clone(), id, etag: r.etag.clone(), changes })
}

#[cfg(test)]
#[allow(clippy::panic)]
mod tests {
    use super::*;

    fn asked(session: v1::Session, mask: &[&str]) -> Result<SessionChanges> {
        let paths = mask.iter().map(|p| (*p).to_owned()).collect();
        let update_mask = (!mask.is_empty()).then_some(FieldMask { paths });
        let r = v1::UpdateSessionRequest { session: Some(session), update_mask, etag: String::new() };
        super::session(&r, &Limits::default()).map(|update| update.changes)
    }

    fn session(json: serde_json::Value) -> v1::Session {
        crate::json::from_json("Session", json).unwrap()
    }

    #[test]
    fn only_what_is_named_changes_and_without_a_mask_what_is_set() {
        let sent = session(serde_json::json!({
            "display_name": "A", "labels": {"site": "north"}, "params": {"planning": {"robot_radius_m": 0.3}},
        }));
        let named = asked(sent.clone(), &["display_name"]).unwrap();
        assert_eq!(named, SessionChanges { display_name: Some("A".to_owned()), ..Default::default() });
        let all = asked(sent, &[]).unwrap();
        assert_eq!(all.labels.unwrap()["site"], "north");
        let [radius] = &all.params[..] else { panic!("{:?}", all.params) };
        assert_eq!((radius.path.as_str(), radius.value.as_ref()), ("planning.robot_radius_m", Some(&0.3.into())));
        assert_eq!(asked(v1::Session::default(), &[]).unwrap_err().reason, "FIELD_MISSING");
    }

    #[test]
    fn what_is_named_again_and_again_is_taken_once() {
        let once = asked(v1::Session::default(), &["params"]).unwrap().params.len();
        let often = asked(v1::Session::default(), &["params"; 1000]).unwrap().params.len();
        assert_eq!((once > 0, once), (true, often));
    }

    #[test]
    fn a_section_names_all_below_it_and_what_is_not_set_goes_back_to_its_default() {
        let sent = session(serde_json::json!({"params": {"relations": {"max_distance_m": 2.0}}}));
        let changes = asked(sent, &["params.relations"]).unwrap().params;
        let mut paths: Vec<(&str, bool)> = changes.iter().map(|c| (c.path.as_str(), c.value.is_some())).collect();
        paths.sort_unstable();
        let unset = ["contact_m", "min_strength", "next_to_m", "num_near"].map(|name| (name, false));
        let mut expected = [unset.to_vec(), vec![("max_distance_m", true)]].concat();
        expected.sort_unstable();
        let expected: Vec<_> = expected.iter().map(|(name, set)| (format!("relations.{name}"), *set)).collect();
        assert!(paths.iter().copied().eq(expected.iter().map(|(name, set)| (name.as_str(), *set))), "{paths:?}");
        assert!(changes.iter().all(|c| !c.is_named));
        let cleared = asked(v1::Session::default(), &["params.relations.contact_m"]).unwrap().params;
        assert!(matches!(&cleared[..], [ParamChange { value: None, is_named: true, .. }]));
    }

    #[test]
    fn what_is_no_field_and_what_nobody_sets_is_refused_by_name() {
        let refused = |path: &str| asked(v1::Session::default(), &[path]).unwrap_err();
        for path in ["", "*", "colour", "params.sparkle", "display_name.first", "labels.site", "params.", "params.plan"]
        {
            assert_eq!(refused(path).reason, "MASK_PATH_UNKNOWN", "{path}");
        }
        for path in ["pose", "sensors", "tenant", "num_keyframes", "etag"] {
            assert_eq!((refused(path).reason, refused(path).field.as_str()), ("FIELD_READ_ONLY", path));
        }
    }
}
