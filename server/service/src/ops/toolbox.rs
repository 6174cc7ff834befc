//! The perception toolbox: one cloud or image in, facts out; no session.

use crate::{Error, Result, Service};
use nalgebra::{Point3, Unit, Vector3};
use percept_geometry::{CameraIntrinsics, DepthImage, OrientedBox3, PointCloud, Pose, RgbImage};
use percept_perception::cloud::{
    CloudError, ClusterParams, Clusters, DbscanParams, NormalParams, PlanesParams, ShapeFeatures,
    StatisticalOutlierParams, TypedPlane, cluster, dbscan, estimate_normals, segment_planes, statistical_outliers,
    upright_box, voxel_downsample,
};
use percept_perception::depth::{UnprojectParams, unproject};
use percept_perception::detection::{Detection, Detector};
use percept_perception::registration::{
    IcpParams, IcpResult, RegistrationError, align_point_to_plane, align_point_to_point,
};

/// What connects points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Clustering {
    /// Every pair nearer than the distance.
    Euclidean(ClusterParams),
    /// Only points with enough neighbours.
    Dbscan(DbscanParams),
}

/// What registration minimises.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RegistrationMethod {
    /// Distances of points.
    PointToPoint,
    /// Distances from the target's surface.
    PointToPlane,
}

fn cloud_error(e: CloudError) -> Error {
    match e {
        CloudError::Input(e) => e.into(),
        CloudError::VoxelTooSmall { voxel_size_m, coordinate_m, at_least_m } => Error::invalid(
            "VOXEL_TOO_SMALL",
            "voxel_size_m",
            format!(
                "voxel_size_m is {voxel_size_m}, too small for a coordinate of {coordinate_m} m; use at least {at_least_m}"
            ),
        ),
    }
}

fn registration_error(e: &RegistrationError) -> Error {
    Error::invalid("REGISTRATION_INVALID", "", e.to_string())
}

impl Service {
    /// Points whose mean distance to their neighbours is no outlier, and their indices.
    ///
    /// # Errors
    /// `OUT_OF_RANGE` naming the parameter.
    pub async fn remove_statistical_outliers(
        &self,
        cloud: PointCloud,
        params: StatisticalOutlierParams,
    ) -> Result<(PointCloud, Vec<usize>)> {
        let work = move || {
            let kept = statistical_outliers(&cloud.positions, &params)?;
            Ok((cloud.select(&kept), kept))
        };
        self.compute.request(work).await?
    }

    /// One centroid a voxel.
    ///
    /// # Errors
    /// `OUT_OF_RANGE`, `VOXEL_TOO_SMALL`.
    pub async fn downsample_voxels(&self, cloud: PointCloud, voxel_size_m: f64) -> Result<PointCloud> {
        self.compute.request(move || voxel_downsample(&cloud, voxel_size_m)).await?.map_err(cloud_error)
    }

    /// The cloud with normals towards the viewpoint (m).
    ///
    /// # Errors
    /// `OUT_OF_RANGE` naming the parameter.
    pub async fn estimate_normals(
        &self,
        mut cloud: PointCloud,
        params: NormalParams,
        viewpoint: Point3<f64>,
    ) -> Result<PointCloud> {
        let work = move || {
            cloud.normals = Some(estimate_normals(&cloud.positions, &params, Some(&viewpoint))?);
            Ok(cloud)
        };
        self.compute.request(work).await?
    }

    /// Planes in turn, largest first; z is up.
    ///
    /// # Errors
    /// `OUT_OF_RANGE` naming the parameter.
    pub async fn segment_planes(&self, cloud: PointCloud, params: PlanesParams) -> Result<Vec<TypedPlane>> {
        let up: Unit<Vector3<f64>> = Vector3::z_axis();
        let work = move || segment_planes(&cloud.positions, &up, &params);
        Ok(self.compute.request(work).await??)
    }

    /// Connected groups of points.
    ///
    /// # Errors
    /// `OUT_OF_RANGE` naming the parameter.
    pub async fn cluster_points(&self, cloud: PointCloud, method: Clustering) -> Result<Clusters> {
        let work = move || match method {
            Clustering::Euclidean(params) => cluster(&cloud.positions, &params),
            Clustering::Dbscan(params) => dbscan(&cloud.positions, &params),
        };
        Ok(self.compute.request(work).await??)
    }

    /// Shape of a cloud, and the smallest upright box around it.
    ///
    /// # Errors
    /// `CLOUD_EMPTY` without a finite point.
    pub async fn shape_features(&self, cloud: PointCloud) -> Result<(ShapeFeatures, OrientedBox3)> {
        let work = move || {
            let n = cloud.len();
            let shape = ShapeFeatures::of(&cloud.positions).zip(upright_box(&cloud.positions));
            shape.ok_or_else(|| {
                Error::invalid(
                    "CLOUD_EMPTY",
                    "cloud",
                    format!("cloud has {n} points and none is finite; send at least one"),
                )
            })
        };
        self.compute.request(work).await?
    }

    /// Objects in a cloud whose z is up and whose floor is near z = 0.
    ///
    /// # Errors
    /// Clouds whose channels do not fit.
    pub async fn detect_objects(&self, cloud: PointCloud) -> Result<Vec<Detection>> {
        let params = self.default_params().detection.detector;
        let work = move || {
            let detector = Detector::new(params).map_err(Error::internal)?;
            detector.detect(&cloud).map_err(cloud_error)
        };
        self.compute.request(work).await?
    }

    /// Lays a source over a target from an initial `t_target_source`.
    ///
    /// # Errors
    /// `REGISTRATION_INVALID`: too few points, parameters out of bounds.
    pub async fn register_clouds(
        &self,
        source: PointCloud,
        target: PointCloud,
        initial: Pose,
        method: RegistrationMethod,
        params: IcpParams,
    ) -> Result<IcpResult> {
        let work = move || match method {
            RegistrationMethod::PointToPoint => {
                align_point_to_point(&source.positions, &target.positions, &initial, &params)
                    .map_err(|e| registration_error(&e))
            }
            RegistrationMethod::PointToPlane => {
                let normals = match target.normals {
                    Some(normals) => normals,
                    None => {
                        let params = NormalParams { radius_m: params.max_distance_m, ..NormalParams::default() };
                        estimate_normals(&target.positions, &params, None)?
                    }
                };
                align_point_to_plane(&source.positions, &target.positions, &normals, &initial, &params)
                    .map_err(|e| registration_error(&e))
            }
        };
        self.compute.request(work).await?
    }

    /// A depth image as a cloud in the optical frame.
    ///
    /// # Errors
    /// `OUT_OF_RANGE`, `SIZE_MISMATCH` naming the field.
    pub async fn unproject_depth(
        &self,
        depth: DepthImage,
        color: Option<RgbImage>,
        intrinsics: CameraIntrinsics,
        params: UnprojectParams,
    ) -> Result<PointCloud> {
        let work = move || unproject(&depth, color.as_ref(), &intrinsics, &params);
        Ok(self.compute.request(work).await??)
    }
}
