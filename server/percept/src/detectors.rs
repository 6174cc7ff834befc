//! Learned detectors: models in a folder, each beside what has to be known of it.

use percept_inference::{Detector, DetectorSpec, InferenceThreads, ModelLimits};
use percept_service::OwnDetectors;
use percept_store::BlobId;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Where learned detectors come from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Detectors {
    /// Folder of models that find things in images: NAME.onnx beside NAME.toml, which says its layout (fastest_det,
    /// yolo_v8 or boxes_scores) and labels; without labels these are the lines of NAME.names. Empty: none. One that cannot
    /// be used is told in the log, and left out.
    pub dir: PathBuf,
    /// Threads that they run on, 1 to 64.
    pub threads: usize,
}

impl Default for Detectors {
    fn default() -> Self {
        Self { dir: PathBuf::from(""), threads: 1 }
    }
}

/// Loads what the folder holds. What cannot be used stops nothing.
pub(crate) fn load(settings: &Detectors) -> OwnDetectors {
    let threads = InferenceThreads::new(settings.threads);
    let mut own = OwnDetectors { detectors: vec![], threads: threads.clone() };
    if settings.dir.as_os_str().is_empty() {
        return own;
    }
    let entries = match std::fs::read_dir(&settings.dir) {
        Ok(entries) => entries,
        Err(error) => {
            tracing::error!(dir = %settings.dir.display(), %error, "the folder of learned detectors cannot be read");
            return own;
        }
    };
    let mut models: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).collect();
    models.retain(|path| path.extension().is_some_and(|e| e == "onnx"));
    models.sort();
    for path in models {
        match one(&path, &threads) {
            Ok((detector, sha256)) => {
                let spec = detector.spec();
                tracing::info!(name = spec.name, labels = spec.labels.len(), "a learned detector is there");
                own.detectors.push((detector, sha256));
            }
            Err(error) => tracing::error!(model = %path.display(), error, "a learned detector cannot be used"),
        }
    }
    own
}

fn one(model: &Path, threads: &InferenceThreads) -> Result<(Detector, String), String> {
    let limits = ModelLimits::default();
    let name = model.file_stem().and_then(|s| s.to_str()).ok_or("its name is not UTF-8")?.to_owned();
    let spec = spec(model, &name)?;
    let size = std::fs::metadata(model).map_err(|e| e.to_string())?.len();
    if size > limits.max_bytes as u64 {
        return Err(format!("it has {size} bytes, more than {}", limits.max_bytes));
    }
    let bytes = std::fs::read(model).map_err(|e| e.to_string())?;
    let detector = Detector::new(&bytes, spec, &limits, threads).map_err(|e| e.to_string())?;
    Ok((detector, BlobId::of(&bytes).to_string()))
}

/// What `NAME.toml` says, and `NAME.names`.
fn spec(model: &Path, name: &str) -> Result<DetectorSpec, String> {
    let read = |path: &Path| std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()));
    let path = model.with_extension("toml");
    let refused = |e: toml::de::Error| format!("{}: {}", path.display(), e.message());
    let mut said: toml::Table = toml::from_str(&read(&path)?).map_err(refused)?;
    said.insert("name".to_owned(), name.into());
    if !said.contains_key("labels") {
        let lines = read(&model.with_extension("names"))?;
        let labels: Vec<toml::Value> = lines.lines().map(str::trim).filter(|l| !l.is_empty()).map(Into::into).collect();
        said.insert("labels".to_owned(), labels.into());
    }
    DetectorSpec::deserialize(toml::Value::Table(said)).map_err(refused)
}
