//! Parameters: what was sent is laid over the defaults; unknown names cannot arise, values are checked.
//!
//! The proto and the Rust trees have the same field names (a test holds them equal), so that one generic
//! conversion through JSON serves all of them.

use crate::{json, v1};
use percept_pipeline::PipelineParams;
use percept_planning::PlanParams;
use percept_service::{Error, Result};
use prost::Message;
use prost_reflect::{DynamicMessage, SerializeOptions};
use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;

/// Session parameters over their defaults.
///
/// # Errors
/// `PARAMETER_OUT_OF_RANGE`.
pub fn pipeline(sent: Option<&v1::PipelineParams>, defaults: &PipelineParams) -> Result<PipelineParams> {
    let params = overlay("PipelineParams", sent, defaults)?;
    params
        .validate()
        .map_err(|e| Error::invalid("PARAMETER_OUT_OF_RANGE", format!("params.{}", e.section), e.message))?;
    Ok(params)
}

/// Planning parameters over a session's.
///
/// # Errors
/// `PARAMETER_OUT_OF_RANGE`.
pub fn planning(sent: Option<&v1::PlanningParams>, defaults: &PlanParams) -> Result<PlanParams> {
    let params = overlay("PlanningParams", sent, defaults)?;
    params.validate().map_err(|e| Error::invalid("PARAMETER_OUT_OF_RANGE", "params", e.to_string()))?;
    Ok(params)
}

/// Session parameters as a message with every field set.
///
/// # Errors
/// `INTERNAL` if a field is missing in the contract.
pub fn pipeline_to(params: &PipelineParams) -> Result<v1::PipelineParams> {
    json::from_json("PipelineParams", serde_json::to_value(params).map_err(Error::internal)?)
}

fn overlay<M: Message, P: Serialize + DeserializeOwned + Clone>(
    name: &str,
    sent: Option<&M>,
    defaults: &P,
) -> Result<P> {
    let Some(sent) = sent else { return Ok(defaults.clone()) };
    let mut tree = serde_json::to_value(defaults).map_err(Error::internal)?;
    let dynamic =
        DynamicMessage::decode(json::descriptor(name)?, sent.encode_to_vec().as_slice()).map_err(Error::internal)?;
    let options = SerializeOptions::new().use_proto_field_name(true).stringify_64_bit_integers(false);
    let patch = dynamic.serialize_with_options(serde_json::value::Serializer, &options).map_err(Error::internal)?;
    lay_over(&mut tree, patch);
    serde_json::from_value(tree)
        .map_err(|e| Error::invalid("PARAMETER_OUT_OF_RANGE", "params", format!("params do not fit: {e}")))
}

fn lay_over(tree: &mut Value, patch: Value) {
    match (tree, patch) {
        (Value::Object(tree), Value::Object(patch)) => {
            for (name, value) in patch {
                lay_over(tree.entry(name).or_insert(Value::Null), value);
            }
        }
        (slot, value) => *slot = value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use prost_reflect::{Kind, MessageDescriptor};

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

    #[test]
    fn what_is_sent_replaces_only_itself() {
        let defaults = PipelineParams::default();
        let all = pipeline_to(&defaults).unwrap();
        assert_eq!(pipeline(Some(&all), &PipelineParams::default()).unwrap(), defaults);
        let sent: v1::PipelineParams =
            json::from_json("PipelineParams", serde_json::json!({"planning": {"robot_radius_m": 0.3}})).unwrap();
        let mut wanted = defaults.clone();
        wanted.planning.robot_radius_m = 0.3;
        assert_eq!(pipeline(Some(&sent), &defaults).unwrap(), wanted);
    }

    #[test]
    fn values_out_of_bounds_are_named() {
        let sent =
            json::from_json("PipelineParams", serde_json::json!({"planning": {"robot_radius_m": -1.0}})).unwrap();
        let e = pipeline(Some(&sent), &PipelineParams::default()).unwrap_err();
        assert_eq!(e.reason, "PARAMETER_OUT_OF_RANGE");
        assert!(e.message.contains("robot_radius_m"), "{e}");
    }
}
