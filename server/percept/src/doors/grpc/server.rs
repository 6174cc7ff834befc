//! `ServerService`.

use super::{Answer, Api, status};
use percept_wire::{convert, v1};
use tonic::{Request, Response};

#[tonic::async_trait]
impl v1::server_service_server::ServerService for Api {
    async fn get_server_info(&self, r: Request<v1::GetServerInfoRequest>) -> Answer<v1::GetServerInfoResponse> {
        let info = self.caller(&r)?.server_info().map_err(status::grpc)?;
        let server = Some(convert::server::info_to(&info));
        Ok(Response::new(v1::GetServerInfoResponse { server }))
    }
}
