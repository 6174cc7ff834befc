//! `OperationsService`.

use super::maps::{exported, optimised};
use super::toolbox::{register_clouds_globally, run_pipeline};
use super::{Answer, Api, Streamed, check_size, status};
use bytes::Bytes;
use percept_service::reason;
use percept_service::toolbox::Toolbox;
use percept_service::{Caller, Error, ErrorCode, Operation, OperationKind, OperationStart, Result};
use percept_wire::convert::toolbox::sources::{Sources, session_clouds};
use percept_wire::convert::{map_import, maps, operations, required};
use percept_wire::parts::InParts;
use percept_wire::v1;
use prost::Message;
use tonic::{Request, Response};
use v1::read_operation_result_response::Result as Outcome;
use v1::start_operation_request::Work;

const RULE: &str = "OperationsService/*";

/// What an operation found, in parts, as it is kept.
fn encoded(outcome: Outcome) -> Vec<Bytes> {
    let parts = v1::ReadOperationResultResponse { result: Some(outcome) }.parts();
    parts.into_iter().map(|part| part.encode_to_vec().into()).collect()
}

async fn optimise_map(caller: &Caller, start: OperationStart, r: &v1::OptimiseMapRequest) -> Result<Operation> {
    let session = maps::session_id(r.source.as_ref())?;
    caller.start_optimise_map(start, session, |moved| encoded(Outcome::OptimiseMap(optimised(&moved)))).await
}

async fn export_map(caller: &Caller, start: OperationStart, r: &v1::ExportMapRequest) -> Result<Operation> {
    let (session, format) = (maps::session_id(r.source.as_ref())?, maps::format(r)?);
    caller.start_export_map(start, session, format, |file| encoded(Outcome::ExportMap(exported(file)))).await
}

async fn import_map(caller: &Caller, start: OperationStart, r: v1::ImportMapRequest) -> Result<Operation> {
    let session = maps::session_id(r.source.as_ref())?.to_owned();
    // Who may not change the session learns nothing of what is wrong with the map.
    caller.may_with("MapsService/ImportMap", &session).await?;
    let (options, wanted) = (map_import::options(&r)?, session_clouds(&r)?);
    let answer = |done| encoded(Outcome::ImportMap(map_import::imported_to(&done)));
    caller.start_import_map(start, &session, wanted, move |t| map_import::given(t, &r), options, answer).await
}

async fn toolbox<Q: Sources + Send + 'static>(
    caller: &Caller,
    start: OperationStart,
    kind: OperationKind,
    r: Q,
    run: impl FnOnce(&Toolbox, Q) -> Result<Outcome> + Send + 'static,
) -> Result<Operation> {
    let wanted = session_clouds(&r)?;
    caller.start_toolbox(start, kind, wanted, |t| run(t, r).map(encoded)).await
}

/// The error, its field as the request around has it.
fn inside(work: &'static str) -> impl Fn(Error) -> Error {
    move |e| if e.field.is_empty() { e } else { e.within(work) }
}

#[tonic::async_trait]
impl v1::operations_service_server::OperationsService for Api {
    type ReadOperationResultStream = Streamed<v1::ReadOperationResultResponse>;

    async fn start_operation(&self, r: Request<v1::StartOperationRequest>) -> Answer<v1::StartOperationResponse> {
        let caller = self.caller(&r)?;
        caller.may(RULE).map_err(status::grpc)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let r = r.into_inner();
        let start = OperationStart::new(r.request_id.clone(), r.encoded_len()).map_err(status::grpc)?;
        let started = match required("work", r.work).map_err(status::grpc)? {
            Work::OptimiseMap(r) => optimise_map(&caller, start, &r).await.map_err(inside("optimise_map")),
            Work::ExportMap(r) => export_map(&caller, start, &r).await.map_err(inside("export_map")),
            Work::ImportMap(r) => import_map(&caller, start, r).await.map_err(inside("import_map")),
            Work::RunPipeline(r) => {
                let run = |t: &Toolbox, r| run_pipeline(t, r).map(Outcome::RunPipeline);
                toolbox(&caller, start, OperationKind::RunPipeline, r, run).await.map_err(inside("run_pipeline"))
            }
            Work::RegisterCloudsGlobally(r) => {
                let run = |t: &Toolbox, r| register_clouds_globally(t, r).map(Outcome::RegisterCloudsGlobally);
                let started = toolbox(&caller, start, OperationKind::RegisterCloudsGlobally, r, run).await;
                started.map_err(inside("register_clouds_globally"))
            }
        };
        let operation = Some(operations::operation_to(&started.map_err(status::grpc)?));
        Ok(Response::new(v1::StartOperationResponse { operation }))
    }

    async fn get_operation(&self, r: Request<v1::GetOperationRequest>) -> Answer<v1::GetOperationResponse> {
        let found = self.caller(&r)?.operation(&r.get_ref().operation_id).map_err(status::grpc)?;
        let operation = Some(operations::operation_to(&found));
        Ok(Response::new(v1::GetOperationResponse { operation }))
    }

    async fn list_operations(&self, r: Request<v1::ListOperationsRequest>) -> Answer<v1::ListOperationsResponse> {
        let caller = self.caller(&r)?;
        let list = operations::list(r.get_ref()).map_err(status::grpc)?;
        let page = caller.list_operations(&list).map_err(status::grpc)?;
        let operations = page.items.iter().map(operations::operation_to).collect();
        Ok(Response::new(v1::ListOperationsResponse { operations, next_page_token: page.next_page_token }))
    }

    async fn wait_operation(&self, r: Request<v1::WaitOperationRequest>) -> Answer<v1::WaitOperationResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let mut stopping = self.stopping.clone();
        let waited = tokio::select! {
            waited = caller.wait_operation(&r.operation_id, r.timeout_s) => waited,
            _ = stopping.wait_for(|s| *s) => {
                let words = "the server is stopping, and its operations with it; start it again when it is back";
                Err(Error::new(ErrorCode::Unavailable, reason::STOPPING, words))
            }
        };
        let operation = Some(operations::operation_to(&waited.map_err(status::grpc)?));
        Ok(Response::new(v1::WaitOperationResponse { operation }))
    }

    async fn cancel_operation(&self, r: Request<v1::CancelOperationRequest>) -> Answer<v1::CancelOperationResponse> {
        let cancelled = self.caller(&r)?.cancel_operation(&r.get_ref().operation_id).map_err(status::grpc)?;
        let operation = Some(operations::operation_to(&cancelled));
        Ok(Response::new(v1::CancelOperationResponse { operation }))
    }

    async fn read_operation_result(
        &self,
        r: Request<v1::ReadOperationResultRequest>,
    ) -> Answer<Self::ReadOperationResultStream> {
        let parts = self.caller(&r)?.operation_result(&r.get_ref().operation_id).map_err(status::grpc)?;
        let count = parts.len();
        // One at a time, so that a large result is not in memory twice.
        let part = move |i: usize| {
            let part = v1::ReadOperationResultResponse::decode(parts[i].clone());
            part.map_err(|e| status::grpc(Error::internal(e)))
        };
        Ok(Response::new(Box::pin(tokio_stream::iter((0..count).map(part)))))
    }

    async fn delete_operation(&self, r: Request<v1::DeleteOperationRequest>) -> Answer<v1::DeleteOperationResponse> {
        self.caller(&r)?.delete_operation(&r.get_ref().operation_id).map_err(status::grpc)?;
        Ok(Response::new(v1::DeleteOperationResponse {}))
    }
}
