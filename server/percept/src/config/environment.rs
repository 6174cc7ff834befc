//! Settings from the environment.

use super::origin::Origins;
use super::{Config, ConfigError};
use serde_json::Value;
use std::collections::BTreeMap;
use std::ffi::OsString;

/// Read by the tests and the gate. What options of the commands read, they say themselves: [`crate::cli::variables`].
const OTHER: [&str; 3] = ["PERCEPT_BIN", "PERCEPT_CI_CACHE", "PERCEPT_DATA"];

/// Variables that were called otherwise before.
const RENAMED: [(&str, &str); 1] = [("PERCEPT_LIMITS_MAX_MAP_MB", "PERCEPT_LIMITS_MAX_SESSION_MEMORY_MB")];

/// Kubernetes and Docker describe a service called `percept` by variables that begin so; no section is called so.
const LINKS: [&str; 2] = ["PERCEPT_PORT", "PERCEPT_SERVICE_"];

/// Lays every `PERCEPT_<PATH OF THE FIELD>` of `variables` over `config`.
///
/// # Errors
/// `UnknownVariable`, `Variable`.
pub(super) fn lay_over(
    config: &mut Config,
    variables: impl Iterator<Item = (OsString, OsString)>,
    origins: &mut Origins,
) -> Result<(), ConfigError> {
    let known = names();
    // One environment may serve several commands, such as that of a container: its server and its health check.
    let options = crate::cli::variables();
    // Sorted, so that of several mistakes always the same is told.
    let ours: BTreeMap<String, OsString> = variables
        .filter_map(|(name, value)| name.into_string().ok().map(|name| (name, value)))
        .filter(|(name, _)| name.starts_with("PERCEPT_"))
        .filter(|(name, _)| !OTHER.contains(&name.as_str()) && !LINKS.iter().any(|link| name.starts_with(link)))
        .collect();
    for (name, value) in ours {
        let Some(field) = known.get(&name) else {
            if options.contains(&name) {
                continue;
            }
            let nearest = nearest(&name, known.keys());
            return Err(ConfigError::UnknownVariable { name, nearest });
        };
        let value = value.to_string_lossy().into_owned();
        let refused = |expected: String| ConfigError::Variable { name: name.clone(), value: value.clone(), expected };
        *config = with(config, field, &value).map_err(refused)?;
        origins.variable(field, &name);
    }
    Ok(())
}

/// The variable of each field.
pub(super) fn names() -> BTreeMap<String, String> {
    let variable = |field: String| (format!("PERCEPT_{}", field.replace('.', "_").to_uppercase()), field);
    fields(&tree(&Config::default())).into_iter().map(|(field, _)| variable(field)).collect()
}

/// Paths of all fields with their values; null where a field has no value unless it is set.
pub(super) fn fields(tree: &Value) -> Vec<(String, Value)> {
    let Value::Object(map) = tree else { return Vec::new() };
    let below = |(name, value): (&String, &Value)| match value {
        Value::Object(_) => fields(value).into_iter().map(|(path, leaf)| (format!("{name}.{path}"), leaf)).collect(),
        leaf => vec![(name.clone(), leaf.clone())],
    };
    map.iter().flat_map(below).collect()
}

/// A configuration as a tree. Keys are strings and values plain, so that nothing is refused.
pub(super) fn tree(config: &Config) -> Value {
    serde_json::to_value(config).unwrap_or(Value::Null)
}

fn with(config: &Config, field: &str, text: &str) -> Result<Config, String> {
    let mut tree = tree(config);
    let pointer = format!("/{}", field.replace('.', "/"));
    let slot = tree.pointer_mut(&pointer).ok_or("is no field")?;
    *slot = value_like(slot, text)?;
    serde_json::from_value(tree).map_err(|e| format!("does not fit: {e}"))
}

/// `text` as a value of the kind that the default has.
fn value_like(default: &Value, text: &str) -> Result<Value, String> {
    let number = || text.parse::<f64>().ok().filter(|v| v.is_finite()).map(Value::from);
    match default {
        Value::String(_) => Ok(Value::from(text)),
        Value::Bool(_) => text.parse::<bool>().map(Value::from).map_err(|_| "write true or false".to_owned()),
        Value::Number(n) if n.is_f64() => number().ok_or_else(|| "write a number".to_owned()),
        Value::Number(_) => text.parse::<u64>().map(Value::from).map_err(|_| "write a whole number from 0".to_owned()),
        Value::Null => number().ok_or_else(|| "write a number, or unset it".to_owned()),
        _ => serde_json::from_str(text).map_err(|_| "write it as JSON, such as [1, 2]".to_owned()),
    }
}

/// What a variable is called now, or the known one that is written most alike.
fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a String>) -> Option<String> {
    if let Some((_, now)) = RENAMED.iter().find(|(before, _)| *before == name) {
        return Some((*now).to_owned());
    }
    let (distance, best) = known.map(|k| (strsim::levenshtein(name, k), k)).min()?;
    (distance <= name.len() / 4).then(|| best.clone())
}
