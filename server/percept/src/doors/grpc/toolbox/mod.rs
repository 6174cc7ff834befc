//! `ToolboxService`: every rpc decodes, calls and encodes on the pool, in the file of its group.

mod depth;
mod filters;
mod images;
mod kept;
mod pictures;
mod regions;
mod registration;
mod segmentation;
mod shapes;

use super::{Answer, Api, Streamed, check_size, status, streamed};
use percept_service::Result;
use percept_service::toolbox::Toolbox;
use percept_wire::v1;
use tonic::{Request, Response, Streaming};

impl Api {
    async fn toolbox<Q, A>(&self, r: Request<Q>, run: fn(&Toolbox, Q) -> Result<A>) -> Answer<A>
    where
        Q: prost::Message + 'static,
        A: Send + 'static,
    {
        let caller = self.caller(&r)?;
        caller.may("ToolboxService/*").map_err(status::grpc)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let r = r.into_inner();
        caller.toolbox(move |t| run(t, r)).await.map(Response::new).map_err(status::grpc)
    }
}

#[tonic::async_trait]
impl v1::toolbox_service_server::ToolboxService for Api {
    type DownloadCloudStream = Streamed<v1::DownloadCloudResponse>;

    async fn upload_large_cloud(
        &self,
        r: Request<Streaming<v1::UploadLargeCloudRequest>>,
    ) -> Answer<v1::UploadLargeCloudResponse> {
        let caller = self.caller(&r)?;
        caller.may("ToolboxService/*").map_err(status::grpc)?;
        let upload = kept::received(r.into_inner(), caller.limits()).await?;
        let kept = caller.toolbox(move |t| kept::upload_large_cloud(t, upload)).await;
        kept.map(Response::new).map_err(status::grpc)
    }

    async fn download_cloud(&self, r: Request<v1::DownloadCloudRequest>) -> Answer<Self::DownloadCloudStream> {
        streamed(self.toolbox(r, kept::download_cloud).await?.into_inner(), |part| part)
    }

    async fn upload_cloud(&self, r: Request<v1::UploadCloudRequest>) -> Answer<v1::UploadCloudResponse> {
        self.toolbox(r, kept::upload_cloud).await
    }

    async fn list_clouds(&self, r: Request<v1::ListCloudsRequest>) -> Answer<v1::ListCloudsResponse> {
        self.toolbox(r, kept::list_clouds).await
    }

    async fn drop_cloud(&self, r: Request<v1::DropCloudRequest>) -> Answer<v1::DropCloudResponse> {
        self.toolbox(r, kept::drop_cloud).await
    }

    async fn run_pipeline(&self, r: Request<v1::RunPipelineRequest>) -> Answer<v1::RunPipelineResponse> {
        self.toolbox(r, kept::run_pipeline).await
    }

    async fn decode_cloud(&self, r: Request<v1::DecodeCloudRequest>) -> Answer<v1::DecodeCloudResponse> {
        self.toolbox(r, kept::decode_cloud).await
    }

    async fn encode_cloud(&self, r: Request<v1::EncodeCloudRequest>) -> Answer<v1::EncodeCloudResponse> {
        self.toolbox(r, kept::encode_cloud).await
    }

    async fn remove_non_finite(&self, r: Request<v1::RemoveNonFiniteRequest>) -> Answer<v1::RemoveNonFiniteResponse> {
        self.toolbox(r, filters::remove_non_finite).await
    }

    async fn transform_cloud(&self, r: Request<v1::TransformCloudRequest>) -> Answer<v1::TransformCloudResponse> {
        self.toolbox(r, filters::transform_cloud).await
    }

    async fn remove_statistical_outliers(
        &self,
        r: Request<v1::RemoveStatisticalOutliersRequest>,
    ) -> Answer<v1::RemoveStatisticalOutliersResponse> {
        self.toolbox(r, filters::remove_statistical_outliers).await
    }

    async fn remove_radius_outliers(
        &self,
        r: Request<v1::RemoveRadiusOutliersRequest>,
    ) -> Answer<v1::RemoveRadiusOutliersResponse> {
        self.toolbox(r, filters::remove_radius_outliers).await
    }

    async fn downsample_voxels(&self, r: Request<v1::DownsampleVoxelsRequest>) -> Answer<v1::DownsampleVoxelsResponse> {
        self.toolbox(r, filters::downsample_voxels).await
    }

    async fn estimate_normals(&self, r: Request<v1::EstimateNormalsRequest>) -> Answer<v1::EstimateNormalsResponse> {
        self.toolbox(r, filters::estimate_normals).await
    }

    async fn segment_planes(&self, r: Request<v1::SegmentPlanesRequest>) -> Answer<v1::SegmentPlanesResponse> {
        self.toolbox(r, segmentation::segment_planes).await
    }

    async fn cluster_points(&self, r: Request<v1::ClusterPointsRequest>) -> Answer<v1::ClusterPointsResponse> {
        self.toolbox(r, segmentation::cluster_points).await
    }

    async fn compute_shape_features(
        &self,
        r: Request<v1::ComputeShapeFeaturesRequest>,
    ) -> Answer<v1::ComputeShapeFeaturesResponse> {
        self.toolbox(r, segmentation::compute_shape_features).await
    }

    async fn detect_objects(&self, r: Request<v1::DetectObjectsRequest>) -> Answer<v1::DetectObjectsResponse> {
        self.toolbox(r, segmentation::detect_objects).await
    }

    async fn register_clouds(&self, r: Request<v1::RegisterCloudsRequest>) -> Answer<v1::RegisterCloudsResponse> {
        self.toolbox(r, registration::register_clouds).await
    }

    async fn register_clouds_globally(
        &self,
        r: Request<v1::RegisterCloudsGloballyRequest>,
    ) -> Answer<v1::RegisterCloudsGloballyResponse> {
        self.toolbox(r, registration::register_clouds_globally).await
    }

    async fn compute_point_features(
        &self,
        r: Request<v1::ComputePointFeaturesRequest>,
    ) -> Answer<v1::ComputePointFeaturesResponse> {
        self.toolbox(r, registration::compute_point_features).await
    }

    async fn unproject_depth(&self, r: Request<v1::UnprojectDepthRequest>) -> Answer<v1::UnprojectDepthResponse> {
        self.toolbox(r, depth::unproject_depth).await
    }

    async fn convert_depth(&self, r: Request<v1::ConvertDepthRequest>) -> Answer<v1::ConvertDepthResponse> {
        self.toolbox(r, depth::convert_depth).await
    }

    async fn convert_color(&self, r: Request<v1::ConvertColorRequest>) -> Answer<v1::ConvertColorResponse> {
        self.toolbox(r, depth::convert_color).await
    }

    async fn estimate_essential(
        &self,
        r: Request<v1::EstimateEssentialRequest>,
    ) -> Answer<v1::EstimateEssentialResponse> {
        self.toolbox(r, images::estimate_essential).await
    }

    async fn estimate_homography(
        &self,
        r: Request<v1::EstimateHomographyRequest>,
    ) -> Answer<v1::EstimateHomographyResponse> {
        self.toolbox(r, images::estimate_homography).await
    }

    async fn estimate_two_view(&self, r: Request<v1::EstimateTwoViewRequest>) -> Answer<v1::EstimateTwoViewResponse> {
        self.toolbox(r, images::estimate_two_view).await
    }

    async fn triangulate_points(
        &self,
        r: Request<v1::TriangulatePointsRequest>,
    ) -> Answer<v1::TriangulatePointsResponse> {
        self.toolbox(r, images::triangulate_points).await
    }

    async fn solve_pnp(&self, r: Request<v1::SolvePnpRequest>) -> Answer<v1::SolvePnpResponse> {
        self.toolbox(r, images::solve_pnp).await
    }

    async fn render_cloud(&self, r: Request<v1::RenderCloudRequest>) -> Answer<v1::RenderCloudResponse> {
        self.toolbox(r, pictures::render_cloud).await
    }

    async fn render_depth(&self, r: Request<v1::RenderDepthRequest>) -> Answer<v1::RenderDepthResponse> {
        self.toolbox(r, pictures::render_depth).await
    }

    async fn segment_ground(&self, r: Request<v1::SegmentGroundRequest>) -> Answer<v1::SegmentGroundResponse> {
        self.toolbox(r, regions::segment_ground).await
    }

    async fn grow_regions(&self, r: Request<v1::GrowRegionsRequest>) -> Answer<v1::GrowRegionsResponse> {
        self.toolbox(r, regions::grow_regions).await
    }

    async fn compute_supervoxels(
        &self,
        r: Request<v1::ComputeSupervoxelsRequest>,
    ) -> Answer<v1::ComputeSupervoxelsResponse> {
        self.toolbox(r, regions::compute_supervoxels).await
    }

    async fn group_convex(&self, r: Request<v1::GroupConvexRequest>) -> Answer<v1::GroupConvexResponse> {
        self.toolbox(r, regions::group_convex).await
    }

    async fn segment_objects(&self, r: Request<v1::SegmentObjectsRequest>) -> Answer<v1::SegmentObjectsResponse> {
        self.toolbox(r, regions::segment_objects).await
    }

    async fn sample_points(&self, r: Request<v1::SamplePointsRequest>) -> Answer<v1::SamplePointsResponse> {
        self.toolbox(r, filters::sample_points).await
    }

    async fn crop_cloud(&self, r: Request<v1::CropCloudRequest>) -> Answer<v1::CropCloudResponse> {
        self.toolbox(r, filters::crop_cloud).await
    }

    async fn find_neighbors(&self, r: Request<v1::FindNeighborsRequest>) -> Answer<v1::FindNeighborsResponse> {
        self.toolbox(r, shapes::find_neighbors).await
    }

    async fn compute_local_features(
        &self,
        r: Request<v1::ComputeLocalFeaturesRequest>,
    ) -> Answer<v1::ComputeLocalFeaturesResponse> {
        self.toolbox(r, shapes::compute_local_features).await
    }

    async fn fit_boxes(&self, r: Request<v1::FitBoxesRequest>) -> Answer<v1::FitBoxesResponse> {
        self.toolbox(r, shapes::fit_boxes).await
    }

    async fn compute_convex_hull(
        &self,
        r: Request<v1::ComputeConvexHullRequest>,
    ) -> Answer<v1::ComputeConvexHullResponse> {
        self.toolbox(r, shapes::compute_convex_hull).await
    }

    async fn extract_features(&self, r: Request<v1::ExtractFeaturesRequest>) -> Answer<v1::ExtractFeaturesResponse> {
        self.toolbox(r, images::extract_features).await
    }

    async fn match_features(&self, r: Request<v1::MatchFeaturesRequest>) -> Answer<v1::MatchFeaturesResponse> {
        self.toolbox(r, images::match_features).await
    }

    async fn filter_depth(&self, r: Request<v1::FilterDepthRequest>) -> Answer<v1::FilterDepthResponse> {
        self.toolbox(r, depth::filter_depth).await
    }

    async fn compute_depth_normals(
        &self,
        r: Request<v1::ComputeDepthNormalsRequest>,
    ) -> Answer<v1::ComputeDepthNormalsResponse> {
        self.toolbox(r, depth::compute_depth_normals).await
    }

    async fn segment_depth_planes(
        &self,
        r: Request<v1::SegmentDepthPlanesRequest>,
    ) -> Answer<v1::SegmentDepthPlanesResponse> {
        self.toolbox(r, depth::segment_depth_planes).await
    }

    async fn find_depth_edges(&self, r: Request<v1::FindDepthEdgesRequest>) -> Answer<v1::FindDepthEdgesResponse> {
        self.toolbox(r, depth::find_depth_edges).await
    }

    async fn register_color(&self, r: Request<v1::RegisterColorRequest>) -> Answer<v1::RegisterColorResponse> {
        self.toolbox(r, depth::register_color).await
    }
}
