//! The learned detectors that sessions may name: the server's own, and those that callers uploaded, which are stored as files
//! of their tenants.
//!
//! Each file is the record's length (4 bytes, little-endian), the record (JSON), the model. All are loaded when the server
//! starts, and, where several share the data, as they appear.

use super::registry::Registry;
use crate::ops::detectors::{DetectorInfo, DetectorOrigin, exists};
use crate::reason;
use crate::{Error, Limits, Result};
use bytes::{BufMut, Bytes, BytesMut};
use percept_inference::{Detector, DetectorSpec, InferenceThreads, ModelLimits};
use percept_perception::detection::{ImageDetector, ImageDetectors};
use percept_store::{BlobId, DETECTORS, FilePlace, StoreError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock};

/// The server's own detectors, and what all run on.
#[derive(Debug)]
pub struct OwnDetectors {
    /// With the SHA-256 of each model's file.
    pub detectors: Vec<(Detector, String)>,
    /// What all detectors run on.
    pub threads: InferenceThreads,
}

impl OwnDetectors {
    /// None, and one thread.
    pub fn none() -> Self {
        Self { detectors: vec![], threads: InferenceThreads::new(1) }
    }
}

/// What is stored beside a model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct UploadedRecord {
    pub(crate) spec: DetectorSpec,
    #[serde(default)]
    pub(crate) uploaded_by: String,
    #[serde(default)]
    pub(crate) create_time_ns: i64,
}

/// A detector that a caller uploaded.
#[derive(Debug, Clone)]
pub(crate) struct Uploaded {
    pub(crate) detector: Arc<Detector>,
    pub(crate) record: UploadedRecord,
    pub(crate) sha256: String,
}

impl Uploaded {
    pub(crate) fn info(&self) -> DetectorInfo {
        let (by, at_ns) = (self.record.uploaded_by.clone(), self.record.create_time_ns);
        DetectorInfo::of(&self.detector, &self.sha256, DetectorOrigin::Upload { by, at_ns })
    }

    /// What is told of it to who uploads a model of this digest.
    ///
    /// # Errors
    /// `DETECTOR_EXISTS` if it is of another.
    pub(crate) fn same(&self, sha256: &str) -> Result<DetectorInfo> {
        if self.sha256 == sha256 { Ok(self.info()) } else { Err(exists(&self.record.spec.name)) }
    }
}

/// What somebody wants to upload.
pub(crate) struct Offered<'a> {
    pub(crate) tenant: &'a str,
    pub(crate) spec: &'a DetectorSpec,
    pub(crate) num_bytes: usize,
    pub(crate) limits: &'a Limits,
}

/// All learned detectors.
pub(crate) struct Shelf {
    of_folder: BTreeMap<String, (Arc<Detector>, String)>,
    uploaded: RwLock<BTreeMap<FilePlace, Uploaded>>,
    pub(crate) threads: InferenceThreads,
    /// What is stored is changed by one at a time.
    pub(crate) changing: tokio::sync::Mutex<()>,
    /// Read while a session begins to name a detector, written while one is deleted.
    pub(crate) naming: tokio::sync::RwLock<()>,
}

fn place(tenant: &str, name: &str) -> FilePlace {
    FilePlace { tenant: tenant.to_owned(), name: name.to_owned() }
}

impl Shelf {
    pub(super) fn new(own: OwnDetectors) -> Self {
        let entry =
            |(detector, sha256): (Detector, String)| (detector.spec().name.clone(), (Arc::new(detector), sha256));
        Self {
            of_folder: own.detectors.into_iter().map(entry).collect(),
            uploaded: RwLock::default(),
            threads: own.threads,
            changing: tokio::sync::Mutex::default(),
            naming: tokio::sync::RwLock::default(),
        }
    }

    fn read(&self) -> std::sync::RwLockReadGuard<'_, BTreeMap<FilePlace, Uploaded>> {
        self.uploaded.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> std::sync::RwLockWriteGuard<'_, BTreeMap<FilePlace, Uploaded>> {
        self.uploaded.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// What a tenant may use: the server's, and its own, which go first.
    pub(crate) fn of_tenant(&self, tenant: &str) -> ImageDetectors {
        let mut all: BTreeMap<String, Arc<dyn ImageDetector>> = BTreeMap::new();
        for (name, (detector, _)) in &self.of_folder {
            all.insert(name.clone(), detector.clone());
        }
        for (place, uploaded) in self.read().iter().filter(|(place, _)| place.tenant == tenant) {
            all.insert(place.name.clone(), uploaded.detector.clone());
        }
        ImageDetectors::new(all)
    }

    /// The one that a session of a tenant names, alone: it is kept for as long as the session holds it.
    pub(super) fn named(&self, tenant: &str, name: &str) -> ImageDetectors {
        let found = self.of_tenant(tenant).get(name);
        ImageDetectors::new(found.map(|detector| (name.to_owned(), detector)).into_iter().collect())
    }

    pub(crate) fn has_uploaded(&self, tenant: &str, name: &str) -> bool {
        self.read().contains_key(&place(tenant, name))
    }

    pub(crate) fn is_of_folder(&self, name: &str) -> bool {
        self.of_folder.contains_key(name)
    }

    /// By name.
    pub(crate) fn list(&self, tenant: &str) -> Vec<DetectorInfo> {
        let own = |(name, (detector, sha256)): (&String, &(Arc<Detector>, String))| {
            (name.clone(), DetectorInfo::of(detector, sha256, DetectorOrigin::Folder))
        };
        let mut all: BTreeMap<String, DetectorInfo> = self.of_folder.iter().map(own).collect();
        let uploaded = self.read();
        let of_tenant = uploaded.iter().filter(|(place, _)| place.tenant == tenant);
        all.extend(of_tenant.map(|(place, uploaded)| (place.name.clone(), uploaded.info())));
        all.into_values().collect()
    }

    /// Whether there is room; the one of this name and specification, if it is there already.
    ///
    /// # Errors
    /// `DETECTOR_EXISTS`, `TOO_MANY_DETECTORS`.
    pub(crate) fn check(&self, offered: &Offered<'_>) -> Result<Option<Uploaded>> {
        let Offered { tenant, spec, num_bytes, limits } = *offered;
        let uploaded = self.read();
        if let Some(there) = uploaded.get(&place(tenant, &spec.name)) {
            return if there.record.spec == *spec { Ok(Some(there.clone())) } else { Err(exists(&spec.name)) };
        }
        if self.is_of_folder(&spec.name) {
            return Err(exists(&spec.name));
        }
        let own = uploaded.keys().filter(|place| place.tenant == tenant).count();
        let used: usize = uploaded.values().map(|u| u.detector.num_bytes()).sum();
        let full = |words: String| Err(Error::exhausted(reason::TOO_MANY_DETECTORS, "", words));
        if own >= limits.max_detectors_per_tenant {
            return full(format!("the tenant has {own} detectors, limits.max_detectors_per_tenant; delete some"));
        }
        if uploaded.len() >= limits.max_detectors {
            return full(format!("the server keeps {} detectors, limits.max_detectors; delete some", uploaded.len()));
        }
        if used.saturating_add(num_bytes) > limits.max_detectors_bytes {
            let limit = limits.max_detectors_bytes;
            return full(format!(
                "the server keeps models of {used} bytes, and {num_bytes} more would exceed limits.max_detectors_bytes, \
                 {limit}; delete some"
            ));
        }
        Ok(None)
    }
}

impl Registry {
    /// Loads what is stored and not loaded, and drops what is not stored any more, where others may have changed it.
    pub(crate) async fn refresh_detectors(&self) {
        if self.root.is_shared() {
            let _alone = self.shelf.changing.lock().await;
            self.load_detectors().await;
        }
    }

    /// The same, whoever may have changed it. What cannot be used is told in the log and left out.
    pub(super) async fn load_detectors(&self) {
        let stored = match self.root.list_files(DETECTORS).await {
            Ok(stored) => stored,
            Err(error) => return tracing::warn!(%error, "uploaded detectors were not looked for"),
        };
        self.shelf.write().retain(|place, _| stored.contains(place));
        for place in stored {
            if self.shelf.has_uploaded(&place.tenant, &place.name) {
                continue;
            }
            match self.load_detector(&place).await {
                Ok(Some(uploaded)) => drop(self.shelf.write().insert(place, uploaded)),
                Ok(None) => {}
                Err(error) => {
                    tracing::error!(
                        tenant = place.tenant,
                        name = place.name,
                        error,
                        "an uploaded detector cannot be used"
                    );
                }
            }
        }
    }

    async fn load_detector(&self, place: &FilePlace) -> std::result::Result<Option<Uploaded>, String> {
        let read = self.root.read_file(DETECTORS, place).await.map_err(|e| e.to_string())?;
        let (Some(bytes), threads) = (read, self.shelf.threads.clone()) else { return Ok(None) };
        let load = move || {
            let (record, model) = parsed(&bytes).ok_or("its record cannot be read")?;
            // It was within the limits of its time.
            let limits = ModelLimits { max_bytes: model.len(), ..ModelLimits::default() };
            let detector = Detector::new(&model, record.spec.clone(), &limits, &threads).map_err(|e| e.to_string())?;
            Ok(Some(Uploaded { detector: Arc::new(detector), record, sha256: BlobId::of(&model).to_string() }))
        };
        tokio::task::spawn_blocking(load).await.map_err(|e| e.to_string())?
    }

    /// Stores one and puts it beside the others. `changing` is held.
    pub(crate) async fn store_detector(
        &self,
        tenant: &str,
        uploaded: Uploaded,
        model: &Bytes,
    ) -> std::result::Result<(), StoreError> {
        let place = place(tenant, &uploaded.record.spec.name);
        self.root.create_file(DETECTORS, &place, written(&uploaded.record, model)).await?;
        self.shelf.write().insert(place, uploaded);
        Ok(())
    }

    /// Takes one away. `changing` and `naming` are held.
    pub(crate) async fn remove_detector(&self, tenant: &str, name: &str) -> std::result::Result<(), StoreError> {
        let place = place(tenant, name);
        self.root.delete_file(DETECTORS, &place).await?;
        self.shelf.write().remove(&place);
        Ok(())
    }

    /// The sessions of a tenant whose parameters name a detector, by id, without waking any. One whose data cannot be read names
    /// none.
    ///
    /// # Errors
    /// Faults of the storage.
    pub(crate) async fn sessions_naming(&self, tenant: &str, name: &str) -> Result<Vec<String>> {
        let mut found = vec![];
        for id in self.ids_of(tenant) {
            match self.meta(&id).await {
                Ok(meta) if meta.params.detection.learned == name => found.push(id),
                Ok(_) => {}
                Err(e) if matches!(e.reason, reason::SESSION_NOT_FOUND | reason::SESSION_FAULTED) => {}
                Err(e) if e.reason == reason::DATA_DAMAGED => {}
                Err(e) => return Err(e),
            }
        }
        Ok(found)
    }
}

fn written(record: &UploadedRecord, model: &[u8]) -> Bytes {
    // Our own types always can be written.
    let record = serde_json::to_vec(record).unwrap_or_default();
    let mut bytes = BytesMut::with_capacity(4 + record.len() + model.len());
    bytes.put_u32_le(record.len() as u32);
    bytes.put_slice(&record);
    bytes.put_slice(model);
    bytes.freeze()
}

fn parsed(bytes: &Bytes) -> Option<(UploadedRecord, Bytes)> {
    let length = u32::from_le_bytes(*bytes.first_chunk()?) as usize;
    let end = length.checked_add(4)?;
    let record = serde_json::from_slice(bytes.get(4..end)?).ok()?;
    Some((record, bytes.slice(end..)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_inference::OutputLayout;

    #[test]
    fn a_file_is_read_as_it_was_written_and_half_of_one_is_not() {
        let spec = DetectorSpec::new("cars", &["car", "person"], OutputLayout::YoloV8);
        let record = UploadedRecord { spec, uploaded_by: "ana".to_owned(), create_time_ns: 7 };
        let bytes = written(&record, b"model");
        assert_eq!(parsed(&bytes), Some((record, Bytes::from_static(b"model"))));
        for n in [0, 3, 4, 20] {
            assert_eq!(parsed(&bytes.slice(..n)), None, "{n}");
        }
        assert_eq!(parsed(&Bytes::from_static(&[0xff; 8])), None);
    }
}
