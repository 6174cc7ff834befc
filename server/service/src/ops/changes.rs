//! Changes of sessions and sensors: what may change while a session lives, and what who holds an old copy is told.

use super::labels::{check_display_name, check_labels};
use super::zone_masks::{self, MaskChange};
use super::zones::check_zones;
use crate::reason;
use crate::session::meta::{OverloadPolicy, SensorDeclaration, SessionMeta, SessionMode};
use crate::{Error, ErrorCode, Result, SensorStatus, Service, SessionDescription, SessionZone, check_id};
use percept_geometry::{CameraIntrinsics, Pose, SensorId, SensorKind};
use percept_pipeline::{PipelineParams, may_change};
use serde_json::Value;
use std::collections::BTreeMap;

/// What becomes of a session; what is none stays.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SessionChanges {
    /// For people.
    pub display_name: Option<String>,
    /// All labels.
    pub labels: Option<BTreeMap<String, String>>,
    /// All zones.
    pub zones: Option<Vec<SessionZone>>,
    /// All zone masks.
    pub zone_masks: Option<Vec<MaskChange>>,
    /// What it does with frames: it cannot become another, and the same is no change.
    pub mode: Option<SessionMode>,
    /// Parameters, one by one.
    pub params: Vec<ParamChange>,
}

/// What becomes of a parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct ParamChange {
    /// Dotted, e.g. `planning.robot_radius_m`.
    pub path: String,
    /// None: the server's default.
    pub value: Option<Value>,
    /// Whether it was named by itself, not with all of its section.
    pub is_named: bool,
}

/// What becomes of a sensor; what is none stays.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SensorChanges {
    /// What it measures: it cannot become another, and the same is no change.
    pub kind: Option<SensorKind>,
    /// Where it is mounted.
    pub t_base_sensor: Option<Pose>,
    /// A camera's; none inside takes them away.
    pub intrinsics: Option<Option<CameraIntrinsics>>,
    /// Seconds to add to its stamps.
    pub time_offset_s: Option<f64>,
    /// What happens to its frames under overload.
    pub overload: Option<OverloadPolicy>,
}

impl Service {
    /// Changes what callers set of a session, durably and in force when this answers. An `etag` that is not empty has to be
    /// the session's.
    ///
    /// # Errors
    /// `ETAG_MISMATCH`, `FIELD_IMMUTABLE`, `PARAMETER_OUT_OF_RANGE`, `LABELS_INVALID`, `DISPLAY_NAME_INVALID`,
    /// `SESSION_NOT_FOUND`, `SESSION_FAULTED`; faults of the storage.
    pub async fn update_session(&self, id: &str, etag: &str, changes: &SessionChanges) -> Result<SessionDescription> {
        check_id("session_id", id)?;
        let defaults = self.default_params();
        let names_one = |c: &ParamChange| c.path == "detection.learned";
        let _named = self.registry.naming(changes.params.iter().any(names_one)).await;
        let changed = self.registry.change(id, |_, meta| {
            check_etag(etag, &meta.etag())?;
            changes.apply(meta, defaults)?;
            super::check_learned(&meta.params, &self.registry.shelf.of_tenant(&meta.tenant)).map(|()| None)
        });
        changed.await?;
        self.describe_session(id).await
    }

    /// Changes the declaration of a sensor, durably and in force when this answers. An `etag` that is not empty has to be the
    /// sensor's.
    ///
    /// # Errors
    /// `ETAG_MISMATCH`, `FIELD_IMMUTABLE`, `SENSOR_IN_USE`, `SENSOR_NOT_FOUND`, `OUT_OF_RANGE`, `SESSION_NOT_FOUND`,
    /// `SESSION_FAULTED`; faults of the storage.
    pub async fn update_sensor(
        &self,
        session: &str,
        sensor: &SensorId,
        etag: &str,
        changes: &SensorChanges,
    ) -> Result<SensorStatus> {
        check_id("session_id", session)?;
        check_id("sensor_id", &sensor.0)?;
        let changed = self.registry.change(session, |live, meta| {
            let missing = || crate::session::refusal::sensor_not_found(sensor);
            let has_sent = live.sensors().iter().any(|s| s.declaration.spec.id == *sensor && s.last_stamp.is_some());
            let declaration = meta.sensors.iter_mut().find(|s| s.spec.id == *sensor).ok_or_else(missing)?;
            check_etag(etag, &declaration.etag())?;
            let changed = changes.applied(declaration, has_sent)?;
            if changed == *declaration {
                return Ok(None);
            }
            *declaration = changed.clone();
            Ok(Some(changed))
        });
        changed.await?;
        self.sensor(session, sensor).await
    }
}

/// Refuses a change by who has not seen the newest state.
fn check_etag(given: &str, current: &str) -> Result<()> {
    if given.is_empty() || given == current {
        return Ok(());
    }
    let shown: String = given.chars().take(80).collect();
    let words = format!(
        "etag is {shown:?}, but it was changed since and is {current:?} now; get it again, and change what is there now"
    );
    let error = Error::new(ErrorCode::Aborted, reason::ETAG_MISMATCH, words);
    Err(Error { field: "etag".to_owned(), ..error })
}

fn immutable(field: &str, remedy: &str) -> Error {
    let words = format!("{field} cannot change once it is set; {remedy}");
    Error::invalid(reason::FIELD_IMMUTABLE, field, words)
}

impl SessionChanges {
    fn apply(&self, meta: &mut SessionMeta, defaults: &PipelineParams) -> Result<()> {
        if self.mode.is_some_and(|mode| mode != meta.mode) {
            return Err(immutable("mode", "create another session"));
        }
        let params = changed_params(&meta.params, defaults, &self.params)?;
        if let Some(zones) = &self.zones {
            check_zones(zones)?;
            meta.zones.clone_from(zones);
        }
        if let Some(changes) = &self.zone_masks {
            meta.zone_masks = zone_masks::changed(&meta.zone_masks, changes)?;
        }
        if let Some(name) = &self.display_name {
            check_display_name(name)?;
            meta.display_name.clone_from(name);
        }
        if let Some(labels) = &self.labels {
            check_labels(labels)?;
            meta.labels.clone_from(labels);
        }
        meta.params = params;
        Ok(())
    }
}

fn changed_params(
    current: &PipelineParams,
    defaults: &PipelineParams,
    changes: &[ParamChange],
) -> Result<PipelineParams> {
    if changes.is_empty() {
        return Ok(current.clone());
    }
    let tree = |params: &PipelineParams| serde_json::to_value(params).map_err(Error::internal);
    let (before, defaults) = (tree(current)?, tree(defaults)?);
    let mut wanted = before.clone();
    for change in changes {
        let pointer = format!("/{}", change.path.replace('.', "/"));
        // All of a section goes back to its defaults, as far as it can.
        if change.value.is_none() && !change.is_named && !may_change(&change.path) {
            continue;
        }
        let value = change.value.as_ref().or_else(|| defaults.pointer(&pointer));
        let (Some(slot), Some(value)) = (wanted.pointer_mut(&pointer), value) else {
            return Err(Error::internal(format!("no parameter {}", change.path)));
        };
        slot.clone_from(value);
    }
    let params: PipelineParams = serde_json::from_value(wanted)
        .map_err(|e| Error::invalid(reason::PARAMETER_OUT_OF_RANGE, "params", format!("params do not fit: {e}")))?;
    let after = tree(&params)?;
    for ParamChange { path, .. } in changes.iter().filter(|change| !may_change(&change.path)) {
        let pointer = format!("/{}", path.replace('.', "/"));
        if before.pointer(&pointer) != after.pointer(&pointer) {
            let remedy = "odometry and the map's layers hold on to it; create another session with it";
            return Err(immutable(&format!("params.{path}"), remedy));
        }
    }
    params.validate().map_err(|e| super::params_error(&e))?;
    Ok(params)
}

impl SensorChanges {
    fn applied(&self, declared: &SensorDeclaration, has_sent: bool) -> Result<SensorDeclaration> {
        let mut changed = declared.clone();
        let spec = &mut changed.spec;
        if self.kind.is_some_and(|kind| kind != spec.kind) {
            return Err(immutable("kind", "declare the sensor under another name"));
        }
        // What wheels and IMUs sent is used up within seconds; what other sensors sent is in the map, as it was declared.
        let leaves_traces = !matches!(spec.kind, SensorKind::Imu | SensorKind::Odometry);
        let refuse = |field: &str, is_other: bool| {
            if is_other && has_sent && leaves_traces {
                return Err(in_use(&declared.spec.id, field));
            }
            Ok(())
        };
        if let Some(t_base_sensor) = self.t_base_sensor {
            refuse("t_base_sensor", t_base_sensor != spec.t_base_sensor)?;
            spec.t_base_sensor = t_base_sensor;
        }
        if let Some(intrinsics) = self.intrinsics {
            refuse("intrinsics", intrinsics != spec.intrinsics)?;
            spec.intrinsics = intrinsics;
        }
        if let Some(time_offset_s) = self.time_offset_s {
            refuse("time_offset_s", time_offset_s != spec.time_offset_s)?;
            spec.time_offset_s = time_offset_s;
        }
        let needs_intrinsics = matches!(spec.kind, SensorKind::Depth | SensorKind::Rgbd | SensorKind::Camera);
        if needs_intrinsics && spec.intrinsics.is_none() {
            let words = "intrinsics is missing; a camera needs them";
            return Err(Error::invalid(reason::FIELD_MISSING, "intrinsics", words));
        }
        spec.validate()?;
        if let Some(overload) = self.overload {
            changed.overload = overload;
        }
        Ok(changed)
    }
}

/// What a sensor has sent is in the map as it was declared.
pub(crate) fn in_use(sensor: &SensorId, field: &str) -> Error {
    let words = format!(
        "sensor {:?} has sent frames already, and what they showed is in the map by its old {field}; declare the changed \
         sensor under another name",
        sensor.0
    );
    let error = Error::new(ErrorCode::FailedPrecondition, reason::SENSOR_IN_USE, words);
    Error { field: field.to_owned(), ..error }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_pipeline::Pipeline;

    fn change(path: &str, value: Option<Value>, is_named: bool) -> ParamChange {
        ParamChange { path: path.to_owned(), value, is_named }
    }

    fn leaves(value: &Value, path: &str, out: &mut Vec<String>) {
        match value.as_object() {
            Some(fields) => fields.iter().for_each(|(name, value)| {
                leaves(value, &if path.is_empty() { name.clone() } else { format!("{path}.{name}") }, out)
            }),
            None => out.push(path.to_owned()),
        }
    }

    #[test]
    fn a_parameter_may_change_exactly_if_the_pipeline_takes_it() {
        let defaults = PipelineParams::default();
        let (mut all, mut tried) = (vec![], 0);
        leaves(&serde_json::to_value(&defaults).unwrap(), "", &mut all);
        for path in all {
            let pointer = format!("/{}", path.replace('.', "/"));
            let mut tree = serde_json::to_value(&defaults).unwrap();
            let Some(slot) = tree.pointer_mut(&pointer) else { continue };
            let Some(number) = slot.as_f64() else { continue };
            *slot = if slot.is_u64() { (number as u64 + 1).into() } else { (number * 1.01).into() };
            let Ok(params) = serde_json::from_value::<PipelineParams>(tree) else { continue };
            if params.validate().is_err() || params == defaults {
                continue;
            }
            let mut pipeline = Pipeline::new(defaults.clone()).unwrap();
            assert_eq!(pipeline.set_params(params).is_ok(), may_change(&path), "{path}");
            tried += 1;
        }
        assert!(tried > 60, "{tried}");
    }

    #[test]
    fn what_is_named_without_a_value_goes_back_to_its_default() {
        let defaults = PipelineParams::default();
        let mut current = defaults.clone();
        current.planning.robot_radius_m = 0.4;
        current.map.cloud.voxel_size_m = 0.2;
        let radius = changed_params(&current, &defaults, &[change("planning.robot_radius_m", None, true)]).unwrap();
        assert_eq!(radius.planning, defaults.planning);
        // A whole section goes back as far as it may; what stays is refused only where it is named.
        let section = [change("planning.robot_radius_m", None, false), change("map.cloud.voxel_size_m", None, false)];
        let section = changed_params(&current, &defaults, &section).unwrap();
        assert_eq!((section.planning, section.map), (defaults.planning, current.map));
        let named = changed_params(&current, &defaults, &[change("map.cloud.voxel_size_m", None, true)]);
        let refused = named.unwrap_err();
        assert_eq!((refused.reason, refused.field.as_str()), ("FIELD_IMMUTABLE", "params.map.cloud.voxel_size_m"));
        let same = [change("map.cloud.voxel_size_m", Some(0.2.into()), true)];
        assert_eq!(changed_params(&current, &defaults, &same).unwrap(), current, "the same is no change");
    }

    #[test]
    fn only_who_has_seen_the_newest_state_may_change_it() {
        assert!(check_etag("", "a").is_ok() && check_etag("a", "a").is_ok());
        let stale = check_etag("a", "b").unwrap_err();
        assert_eq!((stale.code, stale.reason, stale.field.as_str()), (ErrorCode::Aborted, "ETAG_MISMATCH", "etag"));
    }
}
