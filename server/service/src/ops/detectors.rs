//! Learned detectors that callers add to those of the server: upload, list, delete.
//!
//! They belong to a tenant. A model is checked and tried before it is stored; a session that names one keeps it from being
//! deleted, awake or not.

use crate::clock::now_ns;
use crate::reason;
use crate::session::fault::store_error;
use crate::session::shelf::{Offered, Uploaded, UploadedRecord};
use crate::{Error, ErrorCode, Result, Service, check_id};
use percept_inference::{Detector, DetectorSpec, InferenceError, ModelLimits};
use percept_store::{BlobId, StoreError};
use std::sync::Arc;

/// Where a detector comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DetectorOrigin {
    /// The server's folder.
    Folder,
    /// A caller of the tenant uploaded it.
    Upload {
        /// The caller's name.
        by: String,
        /// Server's clock, nanoseconds since the Unix epoch.
        at_ns: i64,
    },
}

/// A detector that a caller may use.
#[derive(Debug, Clone)]
pub struct DetectorInfo {
    /// Name, layout, labels, thresholds, input.
    pub spec: DetectorSpec,
    /// Of the model's file.
    pub num_bytes: usize,
    /// SHA-256 of the model's file, lower-case hex.
    pub sha256: String,
    /// Of the model's input.
    pub input_shape: Vec<usize>,
    /// Multiplications and additions of a run, about.
    pub multiply_adds: u64,
    /// Where it comes from.
    pub origin: DetectorOrigin,
}

impl DetectorInfo {
    pub(crate) fn of(detector: &Detector, sha256: &str, origin: DetectorOrigin) -> Self {
        Self {
            spec: detector.spec().clone(),
            num_bytes: detector.num_bytes(),
            sha256: sha256.to_owned(),
            input_shape: detector.input_shape(),
            multiply_adds: detector.multiply_adds(),
            origin,
        }
    }
}

impl Service {
    /// Stores a model for a tenant, in the name of `principal`; durable when this answers. `owner` is who computes. The same
    /// model and specification again is no error.
    ///
    /// # Errors
    /// `MODEL_TOO_LARGE`, `MODEL_INVALID`, `DETECTOR_EXISTS`, `TOO_MANY_DETECTORS`, `ID_INVALID`, `OUT_OF_RANGE`; faults of the
    /// storage.
    pub async fn upload_detector(
        &self,
        (tenant, principal): (&str, &str),
        owner: String,
        spec: DetectorSpec,
        model: bytes::Bytes,
    ) -> Result<DetectorInfo> {
        check_id("spec.name", &spec.name)?;
        spec.validate().map_err(|e| model_error(&e))?;
        let limit = self.limits.max_detector_bytes;
        if model.len() > limit {
            let words = format!("model has {} bytes, the limit is {limit}; choose a smaller one", model.len());
            return Err(Error::exhausted(reason::MODEL_TOO_LARGE, "model", words));
        }
        let shelf = Arc::clone(&self.registry.shelf);
        let offered = Offered { tenant, spec: &spec, num_bytes: model.len(), limits: &self.limits };
        self.registry.refresh_detectors().await;
        // What cannot be taken anyway is not worked on.
        let hashed = model.clone();
        let sha256 = tokio::task::spawn_blocking(move || BlobId::of(&hashed).to_string()).await;
        let sha256 = sha256.map_err(Error::internal)?;
        if let Some(there) = shelf.check(&offered)? {
            return there.same(&sha256);
        }
        let (threads, bytes, wanted) = (shelf.threads.clone(), model.clone(), spec.clone());
        let load = move |_: &crate::toolbox::Toolbox| {
            let limits = ModelLimits { max_bytes: limit, ..ModelLimits::default() };
            Detector::new(&bytes, wanted, &limits, &threads).map_err(|e| model_error(&e))
        };
        let detector = self.toolbox(owner, vec![], load).await?;
        let record = UploadedRecord { spec: spec.clone(), uploaded_by: principal.to_owned(), create_time_ns: now_ns() };
        let uploaded = Uploaded { detector: Arc::new(detector), record, sha256 };
        let _alone = shelf.changing.lock().await;
        // Others may have come meanwhile.
        if let Some(there) = shelf.check(&offered)? {
            return there.same(&uploaded.sha256);
        }
        let info = uploaded.info();
        match self.registry.store_detector(tenant, uploaded, &model).await {
            Err(StoreError::AlreadyExists { .. }) => Err(exists(&spec.name)),
            stored => stored.map(|()| info).map_err(|e| store_error(&e)),
        }
    }

    /// The detectors that a tenant may use, by name.
    pub async fn list_detectors(&self, tenant: &str) -> Vec<DetectorInfo> {
        self.registry.refresh_detectors().await;
        self.registry.shelf.list(tenant)
    }

    /// Removes one that was uploaded, durably.
    ///
    /// # Errors
    /// `DETECTOR_NOT_FOUND`, `DETECTOR_OF_SERVER`, `DETECTOR_IN_USE`; faults of the storage.
    pub async fn delete_detector(&self, tenant: &str, name: &str) -> Result<()> {
        self.registry.refresh_detectors().await;
        let shelf = &self.registry.shelf;
        let _alone = shelf.changing.lock().await;
        // No session begins to name it meanwhile.
        let _unnamed = shelf.naming.write().await;
        if !shelf.has_uploaded(tenant, name) {
            if shelf.is_of_folder(name) {
                let words = format!("{name:?} is of the server's folder; who runs the server can take it away");
                let error = Error::new(ErrorCode::FailedPrecondition, reason::DETECTOR_OF_SERVER, words);
                return Err(Error { field: "name".to_owned(), ..error });
            }
            let unknown = super::unknown_detector("name", name, &shelf.of_tenant(tenant), reason::DETECTOR_NOT_FOUND);
            return Err(Error { code: ErrorCode::NotFound, ..unknown });
        }
        let users = self.registry.sessions_naming(tenant, name).await?;
        if let Some(first) = users.first() {
            let more = if users.len() > 1 { format!(" and {} more", users.len() - 1) } else { String::new() };
            let words = format!(
                "detector {name:?} is named by the session {first:?}{more}; set params.detection.learned to another, or to none"
            );
            let error = Error::new(ErrorCode::FailedPrecondition, reason::DETECTOR_IN_USE, words);
            return Err(Error { field: "name".to_owned(), ..error });
        }
        self.registry.remove_detector(tenant, name).await.map_err(|e| store_error(&e))
    }
}

pub(crate) fn exists(name: &str) -> Error {
    let words = format!("there is a detector {name:?} already; choose another name, or delete that one");
    let error = Error::new(ErrorCode::AlreadyExists, reason::DETECTOR_EXISTS, words);
    Error { field: "spec.name".to_owned(), ..error }
}

/// What is wrong with a model or its specification.
fn model_error(e: &InferenceError) -> Error {
    use InferenceError as E;
    let message = e.to_string();
    match e {
        E::OutOfRange { field, .. } => Error::invalid(reason::OUT_OF_RANGE, format!("spec.{field}"), message),
        E::BadText { field, .. } => Error::invalid(reason::OUT_OF_RANGE, format!("spec.{field}"), message),
        E::LabelsMismatch { .. } => Error::invalid(reason::MODEL_INVALID, "spec.labels", message),
        E::OutputMismatch { .. } => Error::invalid(reason::MODEL_INVALID, "spec.layout", message),
        E::TooLarge { .. } => Error::exhausted(reason::MODEL_TOO_LARGE, "model", message),
        _ => Error::invalid(reason::MODEL_INVALID, "model", message),
    }
}
