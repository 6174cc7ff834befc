//! Parameters: what was sent is laid over the defaults; unknown names cannot arise, values are checked.
//!
//! The proto and the Rust trees have the same field names (a test holds them equal), so that one generic
//! conversion through JSON serves all of them. Their enums have the same words: `sift` in code and configuration is
//! `FEATURE_METHOD_SIFT` in the contract.

use crate::{json, v1};
use percept_geometry::SensorSpec;
use percept_pipeline::PipelineParams;
use percept_planning::PlanParams;
use percept_service::reason;
use percept_service::{Error, ParamChange, Result};
use prost::Message;
use prost_reflect::{DynamicMessage, EnumDescriptor, Kind, MessageDescriptor, SerializeOptions};
use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;

/// Session parameters over the defaults of the preset, which goes by the sensors if it is not chosen.
///
/// # Errors
/// `PARAMETER_OUT_OF_RANGE`.
pub fn pipeline(
    sent: Option<&v1::PipelineParams>,
    defaults: &PipelineParams,
    sensors: &[SensorSpec],
) -> Result<PipelineParams> {
    let wanted: PipelineParams = overlay("PipelineParams", sent, defaults)?;
    let preset = wanted.preset.chosen(sensors);
    let mut params = overlay("PipelineParams", sent, &defaults.clone().for_preset(preset))?;
    params.preset = preset;
    params
        .validate()
        .map_err(|e| Error::invalid(reason::PARAMETER_OUT_OF_RANGE, format!("params.{}", e.section), e.message))?;
    Ok(params)
}

/// Planning parameters over a session's.
///
/// # Errors
/// `PARAMETER_OUT_OF_RANGE`.
pub fn planning(sent: Option<&v1::PlanningParams>, defaults: &PlanParams) -> Result<PlanParams> {
    let params = overlay("PlanningParams", sent, defaults)?;
    params.validate().map_err(|e| Error::invalid(reason::PARAMETER_OUT_OF_RANGE, "params", e.to_string()))?;
    Ok(params)
}

/// Session parameters as a message with every field set.
///
/// # Errors
/// `INTERNAL` if a field is missing in the contract.
pub fn pipeline_to(params: &PipelineParams) -> Result<v1::PipelineParams> {
    let mut tree = serde_json::to_value(params).map_err(Error::internal)?;
    each_enum(&json::descriptor("PipelineParams")?, &mut tree, "params", &mut |kind, value, _| {
        let name = value.as_str().map(|word| format!("{}{}", prefix(kind), word.to_uppercase()));
        *value = name.map_or(Value::Null, Value::String);
        Ok(())
    })?;
    json::from_json("PipelineParams", tree)
}

/// What becomes of the parameters at and below a dotted path (empty: of all): the values that were sent, and the default of
/// those that were not. None if there is no such path.
///
/// # Errors
/// `PARAMETER_OUT_OF_RANGE` for words that are unknown.
pub fn changes(sent: Option<&v1::PipelineParams>, below: &str) -> Result<Option<Vec<ParamChange>>> {
    let tree = sent.map(|sent| words(&json::descriptor("PipelineParams")?, sent)).transpose()?.unwrap_or_default();
    let mut paths = vec![];
    leaves(&json::descriptor("PipelineParams")?, "", &mut paths);
    let section = format!("{below}.");
    paths.retain(|path| below.is_empty() || path == below || path.starts_with(&section));
    let change = |path: String| {
        let value = tree.pointer(&format!("/{}", path.replace('.', "/"))).filter(|value| !value.is_null());
        ParamChange { value: value.cloned(), is_named: path == below, path }
    };
    Ok((!paths.is_empty()).then(|| paths.into_iter().map(change).collect()))
}

/// Dotted paths of all fields that hold a value.
fn leaves(message: &MessageDescriptor, prefix: &str, out: &mut Vec<String>) {
    for field in message.fields() {
        let path = format!("{prefix}{}", field.name());
        match field.kind() {
            Kind::Message(inner) => leaves(&inner, &format!("{path}."), out),
            _ => out.push(path),
        }
    }
}

/// What was sent, as the code and the configuration write it.
fn words(descriptor: &MessageDescriptor, sent: &impl Message) -> Result<Value> {
    let dynamic =
        DynamicMessage::decode(descriptor.clone(), sent.encode_to_vec().as_slice()).map_err(Error::internal)?;
    let options = SerializeOptions::new().use_proto_field_name(true).stringify_64_bit_integers(false);
    let mut tree = dynamic.serialize_with_options(serde_json::value::Serializer, &options).map_err(Error::internal)?;
    each_enum(descriptor, &mut tree, "params", &mut to_word)?;
    Ok(tree)
}

fn overlay<M: Message, P: Serialize + DeserializeOwned + Clone>(
    name: &str,
    sent: Option<&M>,
    defaults: &P,
) -> Result<P> {
    let Some(sent) = sent else { return Ok(defaults.clone()) };
    let mut tree = serde_json::to_value(defaults).map_err(Error::internal)?;
    lay_over(&mut tree, words(&json::descriptor(name)?, sent)?);
    serde_json::from_value(tree)
        .map_err(|e| Error::invalid(reason::PARAMETER_OUT_OF_RANGE, "params", format!("params do not fit: {e}")))
}

/// Every enum of a tree, with its path.
fn each_enum(
    message: &MessageDescriptor,
    tree: &mut Value,
    path: &str,
    with: &mut impl FnMut(&EnumDescriptor, &mut Value, &str) -> Result<()>,
) -> Result<()> {
    for field in message.fields() {
        let Some(value) = tree.get_mut(field.name()) else { continue };
        let path = format!("{path}.{}", field.name());
        match field.kind() {
            Kind::Message(inner) => each_enum(&inner, value, &path, with)?,
            Kind::Enum(kind) => with(&kind, value, &path)?,
            _ => {}
        }
    }
    Ok(())
}

/// What the names of an enum's values begin with: `FEATURE_METHOD_`.
fn prefix(kind: &EnumDescriptor) -> String {
    kind.default_value().name().trim_end_matches("UNSPECIFIED").to_owned()
}

/// The word for the name of a value, null for the unspecified one; what has no name is refused.
fn to_word(kind: &EnumDescriptor, value: &mut Value, path: &str) -> Result<()> {
    let prefix = prefix(kind);
    let word = |name: &str| name.trim_start_matches(&prefix).to_lowercase();
    let Some(name) = value.as_str() else {
        let known: Vec<String> = kind.values().skip(1).map(|v| word(v.name())).collect();
        let field = path.rsplit('.').next().unwrap_or(path);
        let message = format!("{field}: {value} is unknown; use {}", known.join(" or "));
        return Err(Error::invalid(reason::PARAMETER_OUT_OF_RANGE, path, message));
    };
    *value = if name == kind.default_value().name() { Value::Null } else { Value::String(word(name)) };
    Ok(())
}

fn lay_over(tree: &mut Value, patch: Value) {
    match (tree, patch) {
        (Value::Object(tree), Value::Object(patch)) => {
            for (name, value) in patch {
                lay_over(tree.entry(name).or_insert(Value::Null), value);
            }
        }
        // An enum that was left unspecified.
        (_, Value::Null) => {}
        (slot, value) => *slot = value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_pipeline::Preset;

    /// Paths of all leaves of a message.
    fn proto_leaves(message: &MessageDescriptor, prefix: &str, out: &mut Vec<String>) {
        for field in message.fields() {
            let path = format!("{prefix}{}", field.name());
            match field.kind() {
                Kind::Message(inner) => proto_leaves(&inner, &format!("{path}."), out),
                _ => {
                    assert!(field.supports_presence(), "{path} must be optional");
                    out.push(path);
                }
            }
        }
    }

    fn rust_leaves(value: &Value, prefix: &str, out: &mut Vec<String>) {
        match value {
            Value::Object(map) => map.iter().for_each(|(k, v)| rust_leaves(v, &format!("{prefix}{k}."), out)),
            _ => out.push(prefix.trim_end_matches('.').to_owned()),
        }
    }

    #[test]
    fn the_contract_and_the_code_have_the_same_parameters() {
        let (mut proto, mut rust) = (vec![], vec![]);
        proto_leaves(&json::descriptor("PipelineParams").unwrap(), "", &mut proto);
        rust_leaves(&serde_json::to_value(PipelineParams::default()).unwrap(), "", &mut rust);
        proto.sort();
        rust.sort();
        assert_eq!(proto, rust);
    }

    /// What a session gets without a lidar that sees far.
    fn indoors() -> PipelineParams {
        PipelineParams::default().for_preset(Preset::Indoor)
    }

    #[test]
    fn what_is_sent_replaces_only_itself() {
        let defaults = PipelineParams::default();
        let all = pipeline_to(&defaults).unwrap();
        assert_eq!(pipeline(Some(&all), &PipelineParams::default(), &[]).unwrap(), indoors());
        let sent: v1::PipelineParams =
            json::from_json("PipelineParams", serde_json::json!({"planning": {"robot_radius_m": 0.3}})).unwrap();
        let mut wanted = indoors();
        wanted.planning.robot_radius_m = 0.3;
        assert_eq!(pipeline(Some(&sent), &defaults, &[]).unwrap(), wanted);
    }

    #[test]
    fn words_of_the_code_are_names_of_the_contract() {
        let sent = |value| {
            let tree = serde_json::json!({"slam": {"odometry": {"keyframe": {"features": value}}}});
            let sent: v1::PipelineParams = json::from_json("PipelineParams", tree).unwrap();
            pipeline(Some(&sent), &PipelineParams::default(), &[])
        };
        let sift = sent(serde_json::json!("FEATURE_METHOD_SIFT")).unwrap();
        assert_eq!(serde_json::to_value(&sift).unwrap()["slam"]["odometry"]["keyframe"]["features"], "sift");
        let back = pipeline_to(&sift).unwrap();
        assert_eq!(pipeline(Some(&back), &PipelineParams::default(), &[]).unwrap(), sift);
        assert_eq!(sent(serde_json::json!("FEATURE_METHOD_UNSPECIFIED")).unwrap(), indoors());
        let e = sent(serde_json::json!(9)).unwrap_err();
        assert_eq!(e.reason, "PARAMETER_OUT_OF_RANGE");
        assert!(e.to_string().contains("features: 9 is unknown; use orb or sift"), "{e}");
    }

    #[test]
    fn values_out_of_bounds_are_named() {
        let sent =
            json::from_json("PipelineParams", serde_json::json!({"planning": {"robot_radius_m": -1.0}})).unwrap();
        let e = pipeline(Some(&sent), &PipelineParams::default(), &[]).unwrap_err();
        assert_eq!(e.reason, "PARAMETER_OUT_OF_RANGE");
        assert!(e.message.contains("robot_radius_m"), "{e}");
    }

    #[test]
    fn the_preset_goes_by_the_sensors_and_what_is_sent_stands_over_it() {
        let lidar = |range_max_m| SensorSpec {
            id: "lidar".into(),
            kind: percept_geometry::SensorKind::Lidar3d,
            t_base_sensor: percept_geometry::Pose::identity(),
            intrinsics: None,
            time_offset_s: 0.0,
            range_max_m,
        };
        let far = [lidar(Some(100.0))];
        let outdoors = PipelineParams::default().for_preset(Preset::Outdoor);
        assert_eq!(pipeline(None, &PipelineParams::default(), &far).unwrap(), outdoors);
        let sent = |tree| json::from_json("PipelineParams", tree).unwrap();
        let own = sent(serde_json::json!({"map": {"occupancy": {"resolution_m": 0.1}}}));
        let params = pipeline(Some(&own), &PipelineParams::default(), &far).unwrap();
        assert_eq!((params.map.occupancy.resolution_m, params.preset), (0.1, Preset::Outdoor));
        assert_eq!(params.map.cloud, outdoors.map.cloud);
        let chosen = sent(serde_json::json!({"preset": "PRESET_INDOOR"}));
        assert_eq!(pipeline(Some(&chosen), &PipelineParams::default(), &far).unwrap(), indoors());
    }
}
