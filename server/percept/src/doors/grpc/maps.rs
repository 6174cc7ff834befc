//! `MapsService`.

use super::{Answer, Api, Streamed, status, streamed};
use percept_wire::{convert::maps, v1};
use sha2::{Digest, Sha256};
use tonic::{Request, Response};

/// SHA-256, lower-case hex.
pub(crate) fn sha256_hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

#[tonic::async_trait]
impl v1::maps_service_server::MapsService for Api {
    type GetOccupancyGridStream = Streamed<v1::GetOccupancyGridResponse>;
    type GetCloudStream = Streamed<v1::GetCloudResponse>;
    type ExportMapStream = Streamed<v1::ExportMapResponse>;

    async fn get_map_summary(&self, r: Request<v1::GetMapSummaryRequest>) -> Answer<v1::GetMapSummaryResponse> {
        let session = maps::session_id(r.get_ref().source.as_ref()).map_err(status::grpc)?;
        let summary = self.service.map_summary(session).await.map_err(status::grpc)?;
        Ok(Response::new(maps::summary_to(&summary)))
    }

    async fn get_occupancy_grid(
        &self,
        r: Request<v1::GetOccupancyGridRequest>,
    ) -> Answer<Self::GetOccupancyGridStream> {
        let r = r.get_ref();
        let session = maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let region = maps::region(r.region.as_ref()).map_err(status::grpc)?;
        let grid = self.service.occupancy_grid(session, region, r.resolution_m).await.map_err(status::grpc)?;
        streamed(maps::grid_chunks(&grid), |chunk| v1::GetOccupancyGridResponse { chunk: Some(chunk) })
    }

    async fn get_cloud(&self, r: Request<v1::GetCloudRequest>) -> Answer<Self::GetCloudStream> {
        let r = r.get_ref();
        let session = maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let around = maps::around(r).map_err(status::grpc)?;
        let cloud = self.service.cloud(session, around).await.map_err(status::grpc)?;
        streamed(maps::cloud_chunks(&cloud), |chunk| v1::GetCloudResponse { chunk: Some(chunk) })
    }

    async fn list_loops(&self, r: Request<v1::ListLoopsRequest>) -> Answer<v1::ListLoopsResponse> {
        let r = r.get_ref();
        let session = maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let listed = self.service.list_loops(session, r.page_size, &r.page_token).await;
        let (page, map_version) = listed.map_err(status::grpc)?;
        let loops = page.items.iter().map(maps::loop_to).collect();
        Ok(Response::new(v1::ListLoopsResponse { loops, next_page_token: page.next_page_token, map_version }))
    }

    async fn set_loop_veto(&self, r: Request<v1::SetLoopVetoRequest>) -> Answer<v1::SetLoopVetoResponse> {
        let r = r.get_ref();
        let session = maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let done = self.service.set_loop_veto(session, maps::loop_id(r), r.vetoed).await.map_err(status::grpc)?;
        Ok(Response::new(maps::vetoed_to(&done)))
    }

    async fn optimise_map(&self, r: Request<v1::OptimiseMapRequest>) -> Answer<v1::OptimiseMapResponse> {
        let session = maps::session_id(r.get_ref().source.as_ref()).map_err(status::grpc)?;
        let done = self.service.optimise_map(session).await.map_err(status::grpc)?;
        let num_keyframes_moved = done.num_keyframes as u64;
        Ok(Response::new(v1::OptimiseMapResponse { num_keyframes_moved, map_version: done.map_version }))
    }

    async fn export_map(&self, r: Request<v1::ExportMapRequest>) -> Answer<Self::ExportMapStream> {
        let r = r.get_ref();
        let session = maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let format = maps::format(r.format).map_err(status::grpc)?;
        let file = self.service.export_map(session, format).await.map_err(status::grpc)?;
        let sha256 = sha256_hex(&file.bytes);
        streamed(maps::file_chunks(file, sha256), |chunk| v1::ExportMapResponse { chunk: Some(chunk) })
    }
}
