//! `SensorsService`.

use super::super::listener::Held;
use super::{Answer, Api, Streamed, check_size, ingest, peer_of, status};
use percept_service::admission;
use percept_wire::{convert, v1};
use tonic::{Request, Response, Streaming};

#[tonic::async_trait]
impl v1::sensors_service_server::SensorsService for Api {
    type StreamFramesStream = Streamed<v1::StreamFramesResponse>;

    async fn declare_sensor(&self, r: Request<v1::DeclareSensorRequest>) -> Answer<v1::DeclareSensorResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let spec = convert::required("spec", r.spec.as_ref()).map_err(status::grpc)?;
        let declaration = convert::sensors::declaration(spec).map_err(|e| status::grpc(e.within("spec")))?;
        let sensor = caller.declare_sensor(&r.session_id, declaration).await.map_err(status::grpc)?;
        Ok(Response::new(v1::DeclareSensorResponse { sensor: Some(convert::streams::status_to(&sensor)) }))
    }

    async fn get_sensor(&self, r: Request<v1::GetSensorRequest>) -> Answer<v1::GetSensorResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let sensor = caller.sensor(&r.session_id, &r.sensor_id.as_str().into()).await.map_err(status::grpc)?;
        Ok(Response::new(v1::GetSensorResponse { sensor: Some(convert::streams::status_to(&sensor)) }))
    }

    async fn update_sensor(&self, r: Request<v1::UpdateSensorRequest>) -> Answer<v1::UpdateSensorResponse> {
        let caller = self.caller(&r)?;
        let update = convert::updates::sensor(r.get_ref()).map_err(status::grpc)?;
        let changed = caller.update_sensor(&update.session, &update.id, &update.etag, &update.changes).await;
        let sensor = Some(convert::streams::status_to(&changed.map_err(status::grpc)?));
        Ok(Response::new(v1::UpdateSensorResponse { sensor }))
    }

    async fn list_sensors(&self, r: Request<v1::ListSensorsRequest>) -> Answer<v1::ListSensorsResponse> {
        let caller = self.caller(&r)?;
        let statuses = caller.list_sensors(&r.get_ref().session_id).await.map_err(status::grpc)?;
        let sensors = statuses.iter().map(convert::streams::status_to).collect();
        Ok(Response::new(v1::ListSensorsResponse { sensors }))
    }

    async fn stream_frames(&self, r: Request<Streaming<v1::StreamFramesRequest>>) -> Answer<Self::StreamFramesStream> {
        let caller = self.caller(&r)?;
        let place = self.bounds.ingest_stream(&peer_of(r.extensions())).map_err(status::grpc)?;
        let place = (place, caller.hold(admission::Held::IngestStream).map_err(status::grpc)?);
        let held = r.extensions().get::<Held>().cloned().unwrap_or_default();
        Ok(Response::new(ingest::stream(self.clone(), caller, r.into_inner(), held, place)))
    }

    async fn send_frame(&self, r: Request<v1::SendFrameRequest>) -> Answer<v1::SendFrameResponse> {
        let caller = self.caller(&r)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let message = convert::required("message", r.into_inner().message).map_err(status::grpc)?;
        let incoming =
            ingest::decode_at_once(&caller, "SensorsService/SendFrame", message).await.map_err(status::grpc)?;
        let (_, processed) = caller.send_frame(incoming).await.map_err(status::grpc)?;
        Ok(Response::new(v1::SendFrameResponse { result: Some(convert::sessions::result_to(&processed)) }))
    }

    async fn sync_time(&self, r: Request<v1::SyncTimeRequest>) -> Answer<v1::SyncTimeResponse> {
        let caller = self.caller(&r)?;
        let (client_send_ns, server_ns) = (r.get_ref().client_send_ns, caller.clock_ns().map_err(status::grpc)?);
        Ok(Response::new(v1::SyncTimeResponse { client_send_ns, server_ns }))
    }
}
