//! `NavigationService`.

use super::{Answer, Api, check_size, ingest, status};
use percept_wire::{convert, convert::navigation, v1};
use tonic::{Request, Response};

#[tonic::async_trait]
impl v1::navigation_service_server::NavigationService for Api {
    async fn plan_path(&self, r: Request<v1::PlanPathRequest>) -> Answer<v1::PlanPathResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = convert::maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let params = caller.snapshot("NavigationService/PlanPath", session).await.map_err(status::grpc)?.params.clone();
        let request =
            navigation::request(r.start.as_ref(), r.goal.as_ref(), r.params.as_ref(), r.options.as_ref(), &params);
        let plan = caller.plan_path(session, request.map_err(status::grpc)?).await.map_err(status::grpc)?;
        Ok(Response::new(navigation::plan_to(&plan)))
    }

    async fn validate_path(&self, r: Request<v1::ValidatePathRequest>) -> Answer<v1::ValidatePathResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = convert::maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let snapshot = caller.snapshot("NavigationService/ValidatePath", session).await.map_err(status::grpc)?;
        let params = percept_wire::params::planning(r.params.as_ref(), &snapshot.params.planning);
        let poses = navigation::poses(&r.poses).map_err(status::grpc)?;
        let options = navigation::options(r.options.as_ref()).map_err(status::grpc)?;
        let params = Some(params.map_err(status::grpc)?);
        let check = caller.validate_path(session, poses, params, options).await.map_err(status::grpc)?;
        Ok(Response::new(navigation::check_to(&check)))
    }

    async fn navigate(&self, r: Request<v1::NavigateRequest>) -> Answer<v1::NavigateResponse> {
        let caller = self.caller(&r)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let mut r = r.into_inner();
        let message = convert::required("message", r.message.take()).map_err(status::grpc)?;
        let incoming = ingest::decode(&caller, "NavigationService/Navigate", message)
            .await
            .map_err(|e| status::grpc(e.within("message")))?;
        let params = caller
            .snapshot("NavigationService/Navigate", &incoming.session)
            .await
            .map_err(status::grpc)?
            .params
            .clone();
        let request = navigation::request(None, r.goal.as_ref(), r.params.as_ref(), r.options.as_ref(), &params);
        let request = request.map_err(status::grpc)?;
        let answer = caller.navigate(incoming, request).await.map_err(status::grpc)?;
        Ok(Response::new(navigation::navigation_to(&answer)))
    }
}
