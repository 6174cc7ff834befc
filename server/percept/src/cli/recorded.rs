//! What a recording of percept's own says of the session that was recorded.

use percept_formats::dataset::Dataset;
use percept_pipeline::PipelineParams;
use percept_service::params_of;
use serde_json::Value;

/// Parameters that are told of at most.
const MOST_TOLD: usize = 8;

/// The session that was recorded.
pub(crate) struct RecordedSession {
    /// Where the recording begins.
    pub(crate) params: PipelineParams,
    /// What a person who replays it should know.
    pub(crate) notes: Vec<String>,
}

impl RecordedSession {
    /// None if the recording says nothing of its session: it is not percept's own, or older.
    pub(crate) fn of(recording: &Dataset) -> Option<Self> {
        let read = |text: &String| serde_json::from_str::<Value>(text).ok();
        let stored: Vec<Value> = recording.about.iter().filter_map(|a| a.get("params")).filter_map(read).collect();
        let params = params_of(&recording.name, stored.first()?.clone(), &PipelineParams::default());
        let mut notes = vec![];
        let other = others(&params);
        if !other.is_empty() {
            let more = other.len().saturating_sub(MOST_TOLD);
            let told = other[..other.len() - more].join(", ");
            let more = if more > 0 { format!(", and {more} more") } else { String::new() };
            notes.push(format!("the session was recorded with {told}{more}"));
        }
        if stored.windows(2).any(|pair| pair[0] != pair[1]) {
            notes.push(
                "the session's parameters were changed while it was recorded: those of the beginning are told"
                    .to_owned(),
            );
        }
        let keyframes =
            recording.about.first().and_then(|a| a.get("keyframes")).and_then(|n| n.parse().ok()).unwrap_or(0);
        if keyframes > 0 {
            notes.push(format!(
                "the session had a map of {keyframes} keyframes when the recording began, which is not in it: what is played \
                 begins without"
            ));
        }
        Some(Self { params, notes })
    }
}

/// Parameters that are not as by default, `name = value`.
fn others(params: &PipelineParams) -> Vec<String> {
    let (Ok(params), Ok(defaults)) = (serde_json::to_value(params), serde_json::to_value(PipelineParams::default()))
    else {
        return vec![];
    };
    let mut out = vec![];
    compare("", &params, &defaults, &mut out);
    out
}

fn compare(name: &str, value: &Value, default: &Value, out: &mut Vec<String>) {
    match (value, default) {
        (Value::Object(value), Value::Object(default)) => {
            for (key, value) in value {
                let name = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
                compare(&name, value, default.get(key).unwrap_or(&Value::Null), out);
            }
        }
        _ if value != default => out.push(format!("{name} = {value}")),
        _ => {}
    }
}
