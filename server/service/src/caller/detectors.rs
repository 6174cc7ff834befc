//! Learned detectors, in the name of a caller: they are the tenant's.

use super::Caller;
use super::audit::Act;
use crate::{DetectorInfo, Result};
use percept_inference::DetectorSpec;

impl Caller {
    /// Stores a model for the caller's tenant.
    ///
    /// # Errors
    /// `MODEL_TOO_LARGE`, `MODEL_INVALID`, `DETECTOR_EXISTS`, `TOO_MANY_DETECTORS`, `ID_INVALID`, `OUT_OF_RANGE`,
    /// `PERMISSION_DENIED`; faults of the storage.
    pub async fn upload_detector(&self, spec: DetectorSpec, model: bytes::Bytes) -> Result<DetectorInfo> {
        const NAME: &str = "DetectorsService/UploadDetector";
        self.may(NAME)?;
        let act = Act::begin(&self.context, NAME, "");
        let principal = &self.context.principal;
        let whose = (principal.tenant.as_str(), principal.name.as_str());
        let done = self.service.upload_detector(whose, self.owner(), spec, model).await;
        act.end(&done);
        done
    }

    /// The detectors that the caller may use, by name.
    ///
    /// # Errors
    /// `PERMISSION_DENIED`.
    pub async fn list_detectors(&self) -> Result<Vec<DetectorInfo>> {
        self.may("DetectorsService/ListDetectors")?;
        Ok(self.service.list_detectors(&self.context.principal.tenant).await)
    }

    /// Removes one that a caller of this tenant has uploaded.
    ///
    /// # Errors
    /// `DETECTOR_NOT_FOUND`, `DETECTOR_OF_SERVER`, `DETECTOR_IN_USE`, `PERMISSION_DENIED`; faults of the storage.
    pub async fn delete_detector(&self, name: &str) -> Result<()> {
        const NAME: &str = "DetectorsService/DeleteDetector";
        self.may(NAME)?;
        let act = Act::begin(&self.context, NAME, "");
        let done = self.service.delete_detector(&self.context.principal.tenant, name).await;
        act.end(&done);
        done
    }
}
