//! `ToolboxService`.

use super::{Answer, Api, check_size, status};
use percept_wire::convert::{geometry, toolbox};
use percept_wire::v1;
use tonic::{Request, Response};

#[tonic::async_trait]
impl v1::toolbox_service_server::ToolboxService for Api {
    async fn remove_statistical_outliers(
        &self,
        r: Request<v1::RemoveStatisticalOutliersRequest>,
    ) -> Answer<v1::RemoveStatisticalOutliersResponse> {
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let cloud = toolbox::cloud("cloud", r.get_ref().cloud.as_ref(), self.service.limits()).map_err(status::grpc)?;
        let params = toolbox::outlier_params(r.get_ref());
        let (cloud, kept) = self.service.remove_statistical_outliers(cloud, params).await.map_err(status::grpc)?;
        let indices = kept.into_iter().map(|i| i as u32).collect();
        let cloud = Some(geometry::cloud_to(&cloud));
        Ok(Response::new(v1::RemoveStatisticalOutliersResponse { cloud, indices }))
    }

    async fn downsample_voxels(&self, r: Request<v1::DownsampleVoxelsRequest>) -> Answer<v1::DownsampleVoxelsResponse> {
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let cloud = toolbox::cloud("cloud", r.get_ref().cloud.as_ref(), self.service.limits()).map_err(status::grpc)?;
        let size = r.get_ref().voxel_size_m.unwrap_or(0.05);
        let cloud = self.service.downsample_voxels(cloud, size).await.map_err(status::grpc)?;
        Ok(Response::new(v1::DownsampleVoxelsResponse { cloud: Some(geometry::cloud_to(&cloud)) }))
    }

    async fn estimate_normals(&self, r: Request<v1::EstimateNormalsRequest>) -> Answer<v1::EstimateNormalsResponse> {
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let cloud = toolbox::cloud("cloud", r.get_ref().cloud.as_ref(), self.service.limits()).map_err(status::grpc)?;
        let (params, viewpoint) = toolbox::normal_params(r.get_ref()).map_err(status::grpc)?;
        let cloud = self.service.estimate_normals(cloud, params, viewpoint).await.map_err(status::grpc)?;
        Ok(Response::new(v1::EstimateNormalsResponse { cloud: Some(geometry::cloud_to(&cloud)) }))
    }

    async fn segment_planes(&self, r: Request<v1::SegmentPlanesRequest>) -> Answer<v1::SegmentPlanesResponse> {
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let cloud = toolbox::cloud("cloud", r.get_ref().cloud.as_ref(), self.service.limits()).map_err(status::grpc)?;
        let params = toolbox::planes_params(r.get_ref());
        let planes = self.service.segment_planes(cloud, params).await.map_err(status::grpc)?;
        Ok(Response::new(v1::SegmentPlanesResponse { planes: toolbox::planes_to(&planes) }))
    }

    async fn cluster_points(&self, r: Request<v1::ClusterPointsRequest>) -> Answer<v1::ClusterPointsResponse> {
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let cloud = toolbox::cloud("cloud", r.get_ref().cloud.as_ref(), self.service.limits()).map_err(status::grpc)?;
        let method = toolbox::clustering(r.get_ref()).map_err(status::grpc)?;
        let clusters = self.service.cluster_points(cloud, method).await.map_err(status::grpc)?;
        Ok(Response::new(toolbox::clusters_to(&clusters)))
    }

    async fn compute_shape_features(
        &self,
        r: Request<v1::ComputeShapeFeaturesRequest>,
    ) -> Answer<v1::ComputeShapeFeaturesResponse> {
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let cloud = toolbox::cloud("cloud", r.get_ref().cloud.as_ref(), self.service.limits()).map_err(status::grpc)?;
        let (features, upright_box) = self.service.shape_features(cloud).await.map_err(status::grpc)?;
        let features = Some(toolbox::features_to(&features));
        let upright_box = Some(geometry::box_to(&upright_box));
        Ok(Response::new(v1::ComputeShapeFeaturesResponse { features, upright_box }))
    }

    async fn detect_objects(&self, r: Request<v1::DetectObjectsRequest>) -> Answer<v1::DetectObjectsResponse> {
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let cloud = toolbox::cloud("cloud", r.get_ref().cloud.as_ref(), self.service.limits()).map_err(status::grpc)?;
        let found = self.service.detect_objects(cloud).await.map_err(status::grpc)?;
        Ok(Response::new(toolbox::detections_to(&found)))
    }

    async fn register_clouds(&self, r: Request<v1::RegisterCloudsRequest>) -> Answer<v1::RegisterCloudsResponse> {
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let limits = self.service.limits();
        let source = toolbox::cloud("source", r.get_ref().source.as_ref(), limits).map_err(status::grpc)?;
        let target = toolbox::cloud("target", r.get_ref().target.as_ref(), limits).map_err(status::grpc)?;
        let initial = geometry::pose("initial_guess", r.get_ref().initial_guess.as_ref()).map_err(status::grpc)?;
        let (method, params) = toolbox::registration(r.get_ref()).map_err(status::grpc)?;
        let registered = self.service.register_clouds(source, target, initial, method, params).await;
        Ok(Response::new(toolbox::registration_to(&registered.map_err(status::grpc)?)))
    }

    async fn unproject_depth(&self, r: Request<v1::UnprojectDepthRequest>) -> Answer<v1::UnprojectDepthResponse> {
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let unprojection = toolbox::unprojection(r.get_ref(), self.service.limits()).map_err(status::grpc)?;
        let (depth, color, intrinsics, params) = unprojection;
        let cloud = self.service.unproject_depth(depth, color, intrinsics, params).await.map_err(status::grpc)?;
        Ok(Response::new(v1::UnprojectDepthResponse { cloud: Some(geometry::cloud_to(&cloud)) }))
    }
}
