//! `SensorsService`.

use super::{Answer, Api, Streamed, check_size, ingest, status};
use percept_wire::{convert, v1};
use tonic::{Request, Response, Streaming};

#[tonic::async_trait]
impl v1::sensors_service_server::SensorsService for Api {
    type StreamFramesStream = Streamed<v1::StreamFramesResponse>;

    async fn declare_sensor(&self, r: Request<v1::DeclareSensorRequest>) -> Answer<v1::DeclareSensorResponse> {
        let r = r.get_ref();
        let spec = convert::required("spec", r.spec.as_ref()).map_err(status::grpc)?;
        let declaration = convert::sensors::declaration(spec).map_err(|e| status::grpc(e.within("spec")))?;
        let sensor = self.service.declare_sensor(&r.session_id, declaration).await.map_err(status::grpc)?;
        Ok(Response::new(v1::DeclareSensorResponse { sensor: Some(convert::sensors::status_to(&sensor)) }))
    }

    async fn list_sensors(&self, r: Request<v1::ListSensorsRequest>) -> Answer<v1::ListSensorsResponse> {
        let session = self.service.session(&r.get_ref().session_id).await.map_err(status::grpc)?;
        let sensors = session.sensors().iter().map(convert::sensors::status_to).collect();
        Ok(Response::new(v1::ListSensorsResponse { sensors }))
    }

    async fn stream_frames(&self, r: Request<Streaming<v1::StreamFramesRequest>>) -> Answer<Self::StreamFramesStream> {
        Ok(Response::new(ingest::stream(self.clone(), r.into_inner())))
    }

    async fn send_frame(&self, r: Request<v1::SendFrameRequest>) -> Answer<v1::SendFrameResponse> {
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let message = convert::required("message", r.get_ref().message.as_ref()).map_err(status::grpc)?;
        let incoming = ingest::decode(self, message).await.map_err(status::grpc)?;
        let (_, processed) = self.service.send_frame(incoming).await.map_err(status::grpc)?;
        Ok(Response::new(v1::SendFrameResponse { result: Some(convert::sessions::result_to(&processed)) }))
    }

    async fn sync_time(&self, r: Request<v1::SyncTimeRequest>) -> Answer<v1::SyncTimeResponse> {
        let (client_send_ns, server_ns) = (r.get_ref().client_send_ns, self.service.clock_ns());
        Ok(Response::new(v1::SyncTimeResponse { client_send_ns, server_ns }))
    }
}
