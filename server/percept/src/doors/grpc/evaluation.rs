//! `EvaluationService`.

use super::{Answer, Api, Streamed, check_size, status, streamed};
use percept_wire::parts::InParts;
use percept_wire::{convert::evaluation, v1};
use tonic::{Request, Response};

#[tonic::async_trait]
impl v1::evaluation_service_server::EvaluationService for Api {
    type EvaluateTrajectoryStream = Streamed<v1::EvaluateTrajectoryResponse>;

    async fn evaluate_trajectory(
        &self,
        r: Request<v1::EvaluateTrajectoryRequest>,
    ) -> Answer<Self::EvaluateTrajectoryStream> {
        let caller = self.caller(&r)?;
        caller.may("EvaluationService/*").map_err(status::grpc)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let comparison = evaluation::comparison(r.get_ref()).map_err(status::grpc)?;
        let (score, pairs) = caller.evaluate_trajectory(comparison).await.map_err(status::grpc)?;
        let (metrics, pairs) = (Some(evaluation::score_to(&score)), evaluation::pairs_to(&pairs));
        streamed(v1::EvaluateTrajectoryResponse { metrics, pairs }.parts(), |part| part)
    }

    async fn evaluate_relations(
        &self,
        r: Request<v1::EvaluateRelationsRequest>,
    ) -> Answer<v1::EvaluateRelationsResponse> {
        let caller = self.caller(&r)?;
        caller.may("EvaluationService/*").map_err(status::grpc)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let (trajectory, relations) = evaluation::relations(r.get_ref()).map_err(status::grpc)?;
        let max_gap_s = r.get_ref().max_gap_s;
        let score = caller.evaluate_relations(trajectory, relations, max_gap_s).await.map_err(status::grpc)?;
        Ok(Response::new(v1::EvaluateRelationsResponse { metrics: Some(evaluation::relation_score_to(&score)) }))
    }

    async fn evaluate_detections(
        &self,
        r: Request<v1::EvaluateDetectionsRequest>,
    ) -> Answer<v1::EvaluateDetectionsResponse> {
        let caller = self.caller(&r)?;
        caller.may("EvaluationService/*").map_err(status::grpc)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let (truth, found) = evaluation::boxes(r.get_ref()).map_err(status::grpc)?;
        let score = caller.evaluate_detections(truth, found, r.get_ref().min_iou).await.map_err(status::grpc)?;
        Ok(Response::new(v1::EvaluateDetectionsResponse { metrics: Some(evaluation::detection_to(&score)) }))
    }
}
