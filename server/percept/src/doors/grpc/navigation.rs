//! `NavigationService`.

use super::{Answer, Api, check_size, ingest, status};
use percept_wire::{convert, convert::navigation, v1};
use tonic::{Request, Response};

#[tonic::async_trait]
impl v1::navigation_service_server::NavigationService for Api {
    async fn plan_path(&self, r: Request<v1::PlanPathRequest>) -> Answer<v1::PlanPathResponse> {
        let r = r.get_ref();
        let session = convert::maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let params = self.service.snapshot(session).await.map_err(status::grpc)?.params.clone();
        let request = navigation::request(r.start.as_ref(), r.goal.as_ref(), r.params.as_ref(), &params);
        let plan = self.service.plan_path(session, request.map_err(status::grpc)?).await.map_err(status::grpc)?;
        Ok(Response::new(navigation::plan_to(&plan)))
    }

    async fn navigate(&self, r: Request<v1::NavigateRequest>) -> Answer<v1::NavigateResponse> {
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let r = r.get_ref();
        let message = convert::required("message", r.message.as_ref()).map_err(status::grpc)?;
        let incoming = ingest::decode(self, message).await.map_err(|e| status::grpc(e.within("message")))?;
        let params = self.service.snapshot(&incoming.session).await.map_err(status::grpc)?.params.clone();
        let request = navigation::request(None, r.goal.as_ref(), r.params.as_ref(), &params).map_err(status::grpc)?;
        let answer = self.service.navigate(incoming, request).await.map_err(status::grpc)?;
        Ok(Response::new(navigation::navigation_to(&answer)))
    }
}
