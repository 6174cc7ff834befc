//! `LayersService`.

use super::{Answer, Api, Streamed, status, streamed};
use percept_wire::convert::{draco, layers, maps};
use percept_wire::parts::InParts;
use percept_wire::v1;
use tonic::{Request, Status};

/// An answer, made and cut where computing is done.
macro_rules! in_parts {
    ($caller:ident, $session:ident, $found:expr, $to:path) => {{
        let found = $found.await.map_err(status::grpc)?;
        let parts = $caller.query($session, move || $to(&found).parts()).await;
        streamed(parts.map_err(status::grpc)?, |part| part)
    }};
}

fn session_of(source: Option<&v1::MapSource>) -> Result<&str, Status> {
    maps::session_id(source).map_err(status::grpc)
}

#[tonic::async_trait]
impl v1::layers_service_server::LayersService for Api {
    type GetVoxelsStream = Streamed<v1::GetVoxelsResponse>;
    type QueryPointsStream = Streamed<v1::QueryPointsResponse>;
    type CastRaysStream = Streamed<v1::CastRaysResponse>;
    type CheckBoxesStream = Streamed<v1::CheckBoxesResponse>;
    type GetHeightsStream = Streamed<v1::GetHeightsResponse>;
    type GetMeshStream = Streamed<v1::GetMeshResponse>;
    type GetChangesStream = Streamed<v1::GetChangesResponse>;

    async fn get_voxels(&self, r: Request<v1::GetVoxelsRequest>) -> Answer<Self::GetVoxelsStream> {
        let (caller, r) = (self.caller(&r)?, r.get_ref());
        let session = session_of(r.source.as_ref())?;
        let region = layers::box3(r.region.as_ref()).map_err(status::grpc)?;
        let found = caller.voxels(session, region, r.occupied_only, r.since_version);
        in_parts!(caller, session, found, layers::voxels_to)
    }

    async fn query_points(&self, r: Request<v1::QueryPointsRequest>) -> Answer<Self::QueryPointsStream> {
        let (caller, r) = (self.caller(&r)?, r.get_ref());
        let session = session_of(r.source.as_ref())?;
        let points = layers::points(&r.points).map_err(status::grpc)?;
        let layer = layers::layer(r.layer).map_err(status::grpc)?;
        in_parts!(caller, session, caller.query_points(session, points, layer), layers::points_to)
    }

    async fn cast_rays(&self, r: Request<v1::CastRaysRequest>) -> Answer<Self::CastRaysStream> {
        let (caller, r) = (self.caller(&r)?, r.get_ref());
        let session = session_of(r.source.as_ref())?;
        let rays = layers::rays(&r.rays).map_err(status::grpc)?;
        in_parts!(caller, session, caller.cast_rays(session, rays, r.unknown_ends), layers::rays_to)
    }

    async fn check_boxes(&self, r: Request<v1::CheckBoxesRequest>) -> Answer<Self::CheckBoxesStream> {
        let (caller, r) = (self.caller(&r)?, r.get_ref());
        let session = session_of(r.source.as_ref())?;
        let boxes = layers::boxes(&r.boxes).map_err(status::grpc)?;
        in_parts!(caller, session, caller.check_boxes(session, boxes), layers::boxes_to)
    }

    async fn get_heights(&self, r: Request<v1::GetHeightsRequest>) -> Answer<Self::GetHeightsStream> {
        let (caller, r) = (self.caller(&r)?, r.get_ref());
        let session = session_of(r.source.as_ref())?;
        let region = maps::region(r.region.as_ref()).map_err(status::grpc)?;
        let storey = layers::storey(r.storey, r.near_z_m, r.near_within_m).map_err(status::grpc)?;
        in_parts!(caller, session, caller.heights(session, region, storey), layers::heights_to)
    }

    async fn get_mesh(&self, r: Request<v1::GetMeshRequest>) -> Answer<Self::GetMeshStream> {
        let (caller, r) = (self.caller(&r)?, r.get_ref());
        let session = session_of(r.source.as_ref())?;
        let region = layers::box3(r.region.as_ref()).map_err(status::grpc)?;
        let max_triangles = usize::try_from(r.max_triangles).ok().filter(|n| *n > 0);
        let packed = draco::bound("draco_max_error_m", r.draco_max_error_m).map_err(status::grpc)?;
        let found = caller.mesh(session, region, max_triangles).await.map_err(status::grpc)?;
        let answer = move || match packed {
            Some(max_error_m) => draco::mesh_to(&found, max_error_m),
            None => Ok(layers::mesh_to(&found)),
        };
        let parts = caller.query(session, move || Ok(answer()?.parts())).await.and_then(|parts| parts);
        streamed(parts.map_err(status::grpc)?, |part| part)
    }

    async fn get_changes(&self, r: Request<v1::GetChangesRequest>) -> Answer<Self::GetChangesStream> {
        let (caller, r) = (self.caller(&r)?, r.get_ref());
        let session = session_of(r.source.as_ref())?;
        let layer = layers::layer(r.layer).map_err(status::grpc)?;
        in_parts!(caller, session, caller.map_changes(session, layer, r.since_version), layers::changes_to)
    }
}
