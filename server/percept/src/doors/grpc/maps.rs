//! `MapsService`.

use super::{Answer, Api, Streamed, check_size, status, streamed};
use percept_service::{CloudDetail, MapFile, Moved};
use percept_wire::convert::toolbox::sources::session_clouds;
use percept_wire::convert::{draco, drawing, map_import, maps};
use percept_wire::parts::InParts;
use percept_wire::v1;
use sha2::{Digest, Sha256};
use tonic::{Request, Response};

/// SHA-256, lower-case hex.
pub(crate) fn sha256_hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// A file with its digest, whole.
pub(super) fn exported(file: MapFile) -> v1::ExportMapResponse {
    let sha256 = sha256_hex(&file.bytes);
    v1::ExportMapResponse { chunk: Some(maps::file_to(file, sha256)) }
}

pub(super) const fn optimised(moved: &Moved) -> v1::OptimiseMapResponse {
    v1::OptimiseMapResponse { num_keyframes_moved: moved.num_keyframes as u64, map_version: moved.map_version }
}

#[tonic::async_trait]
impl v1::maps_service_server::MapsService for Api {
    type GetOccupancyGridStream = Streamed<v1::GetOccupancyGridResponse>;
    type GetCloudStream = Streamed<v1::GetCloudResponse>;
    type ExportMapStream = Streamed<v1::ExportMapResponse>;
    type CompareMapsStream = Streamed<v1::CompareMapsResponse>;

    async fn get_map_summary(&self, r: Request<v1::GetMapSummaryRequest>) -> Answer<v1::GetMapSummaryResponse> {
        let caller = self.caller(&r)?;
        let session = maps::session_id(r.get_ref().source.as_ref()).map_err(status::grpc)?;
        let summary = caller.map_summary(session).await.map_err(status::grpc)?;
        Ok(Response::new(maps::summary_to(&summary)))
    }

    async fn get_occupancy_grid(
        &self,
        r: Request<v1::GetOccupancyGridRequest>,
    ) -> Answer<Self::GetOccupancyGridStream> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let region = maps::region(r.region.as_ref()).map_err(status::grpc)?;
        let grid = caller.occupancy_grid(session, region, r.resolution_m, r.live).await.map_err(status::grpc)?;
        let chunks = caller.query(session, move || maps::grid_chunks(&grid)).await;
        streamed(chunks.map_err(status::grpc)?, |chunk| v1::GetOccupancyGridResponse { chunk: Some(chunk) })
    }

    async fn get_cloud(&self, r: Request<v1::GetCloudRequest>) -> Answer<Self::GetCloudStream> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let around = maps::around(r.centre.as_ref(), r.radius_m).map_err(status::grpc)?;
        let detail = CloudDetail { voxel_size_m: r.voxel_size_m, max_points: r.max_points };
        let packed = draco::bound("draco_max_error_m", r.draco_max_error_m).map_err(status::grpc)?;
        let cloud = caller.cloud(session, around, detail).await.map_err(status::grpc)?;
        let parts = move || match packed {
            Some(max_error_m) => draco::cloud_parts(&cloud, max_error_m),
            None => Ok(maps::cloud_parts(&cloud)),
        };
        let parts = caller.query(session, parts).await.and_then(|parts| parts);
        streamed(parts.map_err(status::grpc)?, |part| part)
    }

    async fn list_loops(&self, r: Request<v1::ListLoopsRequest>) -> Answer<v1::ListLoopsResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let listed = caller.list_loops(session, r.page_size, &r.page_token).await;
        let (page, map_version) = listed.map_err(status::grpc)?;
        let loops = page.items.iter().map(maps::loop_to).collect();
        Ok(Response::new(v1::ListLoopsResponse { loops, next_page_token: page.next_page_token, map_version }))
    }

    async fn set_loop_veto(&self, r: Request<v1::SetLoopVetoRequest>) -> Answer<v1::SetLoopVetoResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let done = caller.set_loop_veto(session, maps::loop_id(r), r.vetoed).await.map_err(status::grpc)?;
        Ok(Response::new(maps::vetoed_to(&done)))
    }

    async fn optimise_map(&self, r: Request<v1::OptimiseMapRequest>) -> Answer<v1::OptimiseMapResponse> {
        let caller = self.caller(&r)?;
        let session = maps::session_id(r.get_ref().source.as_ref()).map_err(status::grpc)?;
        let done = caller.optimise_map(session).await.map_err(status::grpc)?;
        Ok(Response::new(optimised(&done)))
    }

    async fn import_map(&self, r: Request<v1::ImportMapRequest>) -> Answer<v1::ImportMapResponse> {
        let caller = self.caller(&r)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let r = r.into_inner();
        let session = maps::session_id(r.source.as_ref()).map_err(status::grpc)?.to_owned();
        // Who may not change the session learns nothing of what is wrong with the map.
        caller.may_with("MapsService/ImportMap", &session).await.map_err(status::grpc)?;
        let options = map_import::options(&r).map_err(status::grpc)?;
        let wanted = session_clouds(&r).map_err(status::grpc)?;
        let done = caller.import_map(&session, wanted, move |t| map_import::given(t, &r), options).await;
        Ok(Response::new(map_import::imported_to(&done.map_err(status::grpc)?)))
    }

    async fn compare_maps(&self, r: Request<v1::CompareMapsRequest>) -> Answer<Self::CompareMapsStream> {
        let caller = self.caller(&r)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let r = r.into_inner();
        let session = maps::session_id(r.source.as_ref()).map_err(status::grpc)?.to_owned();
        let tolerance_m = r.tolerance_m;
        let found = caller.compare_maps(&session, move |limits| drawing::before(r, limits), tolerance_m).await;
        streamed(drawing::comparison_to(found.map_err(status::grpc)?).parts(), |part| part)
    }

    async fn export_map(&self, r: Request<v1::ExportMapRequest>) -> Answer<Self::ExportMapStream> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let format = maps::format(r).map_err(status::grpc)?;
        let file = caller.export_map(session, format).await.map_err(status::grpc)?;
        let parts = caller.query(session, move || exported(file).parts()).await;
        streamed(parts.map_err(status::grpc)?, |part| part)
    }
}
