//! Questions about space, in the name of a caller.

use super::Caller;
use crate::Result;
use crate::layers::{
    BoxAnswer, ChangeAnswer, HeightAnswer, MapLayer, OfMap, PointAnswers, RayAnswer, SpaceRay, VoxelAnswer,
};
use nalgebra::{Point2, Point3};
use percept_geometry::{Aabb3, OrientedBox3, TriangleMesh};
use percept_mapping::height::Storey;

impl Caller {
    /// The voxels within a box of the map, or all.
    ///
    /// # Errors
    /// `LAYER_OFF`, `GRID_TOO_LARGE`, `SESSION_NOT_FOUND`.
    pub async fn voxels(
        &self,
        session: &str,
        region: Option<Aabb3>,
        occupied_only: bool,
        since_version: u64,
    ) -> Result<OfMap<VoxelAnswer>> {
        self.may_with("LayersService/GetVoxels", session).await?;
        self.service.voxels(session, region, occupied_only, since_version).await
    }

    /// What is at points of the map.
    ///
    /// # Errors
    /// `TOO_MANY_QUERIES`, `REGION_TOO_FAR`, `LAYER_OFF`, `SESSION_NOT_FOUND`.
    pub async fn query_points(
        &self,
        session: &str,
        points: Vec<Point3<f64>>,
        layer: Option<MapLayer>,
    ) -> Result<OfMap<PointAnswers>> {
        self.may_with("LayersService/QueryPoints", session).await?;
        self.service.query_points(session, points, layer).await
    }

    /// What rays hit first.
    ///
    /// # Errors
    /// `TOO_MANY_QUERIES`, `OUT_OF_RANGE`, `LAYER_OFF`, `SESSION_NOT_FOUND`.
    pub async fn cast_rays(
        &self,
        session: &str,
        rays: Vec<SpaceRay>,
        unknown_ends: bool,
    ) -> Result<OfMap<Vec<RayAnswer>>> {
        self.may_with("LayersService/CastRays", session).await?;
        self.service.cast_rays(session, rays, unknown_ends).await
    }

    /// What is in boxes of the map.
    ///
    /// # Errors
    /// `TOO_MANY_QUERIES`, `GRID_TOO_LARGE`, `LAYER_OFF`, `SESSION_NOT_FOUND`.
    pub async fn check_boxes(&self, session: &str, boxes: Vec<OrientedBox3>) -> Result<OfMap<Vec<BoxAnswer>>> {
        self.may_with("LayersService/CheckBoxes", session).await?;
        self.service.check_boxes(session, boxes).await
    }

    /// How high the ground is, and where a robot can drive.
    ///
    /// # Errors
    /// `LAYER_OFF`, `GRID_TOO_LARGE`, `REGION_EMPTY`, `REGION_TOO_FAR`, `SESSION_NOT_FOUND`.
    pub async fn heights(
        &self,
        session: &str,
        region: Option<(Point2<f64>, Point2<f64>)>,
        storey: Storey,
    ) -> Result<OfMap<HeightAnswer>> {
        self.may_with("LayersService/GetHeights", session).await?;
        self.service.heights(session, region, storey).await
    }

    /// The surface as triangles.
    ///
    /// # Errors
    /// `LAYER_OFF`, `MESH_TOO_LARGE`, `SESSION_NOT_FOUND`.
    pub async fn mesh(
        &self,
        session: &str,
        region: Option<Aabb3>,
        max_triangles: Option<usize>,
    ) -> Result<OfMap<TriangleMesh>> {
        self.may_with("LayersService/GetMesh", session).await?;
        self.service.mesh(session, region, max_triangles).await
    }

    /// Where a layer changed after a version.
    ///
    /// # Errors
    /// `LAYER_OFF`, `SESSION_NOT_FOUND`.
    pub async fn map_changes(
        &self,
        session: &str,
        layer: Option<MapLayer>,
        since_version: u64,
    ) -> Result<OfMap<ChangeAnswer>> {
        self.may_with("LayersService/GetChanges", session).await?;
        self.service.map_changes(session, layer, since_version).await
    }
}
