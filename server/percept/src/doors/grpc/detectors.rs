//! `DetectorsService`.

use super::{Answer, Api, Streamed, check_size, status, streamed};
use percept_wire::convert::detectors;
use percept_wire::parts::InParts;
use percept_wire::v1;
use tonic::{Request, Response};

#[tonic::async_trait]
impl v1::detectors_service_server::DetectorsService for Api {
    type ListDetectorsStream = Streamed<v1::ListDetectorsResponse>;

    async fn upload_detector(&self, r: Request<v1::UploadDetectorRequest>) -> Answer<v1::UploadDetectorResponse> {
        let caller = self.caller(&r)?;
        // Who may not upload learns nothing of what is wrong with the model.
        caller.may("DetectorsService/UploadDetector").map_err(status::grpc)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let v1::UploadDetectorRequest { spec, model } = r.into_inner();
        let spec = detectors::spec(spec).map_err(status::grpc)?;
        let info = caller.upload_detector(spec, model).await.map_err(status::grpc)?;
        Ok(Response::new(v1::UploadDetectorResponse { detector: Some(detectors::detector_to(&info)) }))
    }

    async fn list_detectors(&self, r: Request<v1::ListDetectorsRequest>) -> Answer<Self::ListDetectorsStream> {
        let all = self.caller(&r)?.list_detectors().await.map_err(status::grpc)?;
        streamed(detectors::detectors_to(&all).parts(), |part| part)
    }

    async fn delete_detector(&self, r: Request<v1::DeleteDetectorRequest>) -> Answer<v1::DeleteDetectorResponse> {
        self.caller(&r)?.delete_detector(&r.get_ref().name).await.map_err(status::grpc)?;
        Ok(Response::new(v1::DeleteDetectorResponse {}))
    }
}
