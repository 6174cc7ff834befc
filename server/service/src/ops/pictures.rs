//! Pictures of maps for people, as PNG.

use crate::{Error, Result, reason};
use percept_formats::GridMap;
use percept_geometry::PointCloud;
use percept_mapping::{DenseHeights, MeshData, Traversability, VoxelBlock};
use percept_pictures::{MapObject, Overlay, PictureError, View, encode_png};
use percept_pipeline::Snapshot;
use percept_planning::{Zone, ZoneKind};
use percept_scene::ObjectState;

/// Whatever is higher above the floor than this is cut away, so that ceilings do not hide the rooms, metres: below the usual 2.4.
const CEILING_M: f64 = 2.2;

/// What a snapshot knows, and zones, to be drawn over a grid.
pub fn overlay(snapshot: &Snapshot, zones: &[Zone]) -> Overlay {
    let there = snapshot.objects.iter().filter(|o| o.state != ObjectState::Gone);
    let zone = |z: &Zone| percept_pictures::Zone {
        polygon: z.polygon.clone(),
        kind: match z.kind {
            ZoneKind::KeepOut => percept_pictures::ZoneKind::KeepOut,
            ZoneKind::SpeedLimit { share } => percept_pictures::ZoneKind::SpeedLimit { share },
        },
    };
    Overlay {
        trajectory: snapshot.trajectory_in_one_unit().map(|(t, _)| t).collect(),
        robot: None,
        objects: there.map(|o| MapObject { id: Some(o.id.0), class: o.class, bbox: o.bbox }).collect(),
        zones: zones.iter().map(zone).collect(),
        path: vec![],
    }
}

fn refused(e: &PictureError) -> Error {
    match e {
        PictureError::GridTooLarge { .. } | PictureError::TooMuchOverdraw { .. } => {
            Error::exhausted(reason::PICTURE_TOO_LARGE, "format", e.to_string())
        }
        e => Error::internal(e),
    }
}

fn png(drawn: std::result::Result<percept_geometry::RgbImage, PictureError>) -> Result<Vec<u8>> {
    drawn.and_then(|image| encode_png(&image)).map_err(|e| refused(&e))
}

/// The grid, one pixel a cell: white free, dark occupied, grey unknown; the first row has the largest y.
///
/// # Errors
/// `PICTURE_TOO_LARGE`.
pub fn occupancy(grid: &GridMap) -> Result<Vec<u8>> {
    png(percept_pictures::occupancy(grid))
}

/// The grid with what is known to be in it.
///
/// # Errors
/// `PICTURE_TOO_LARGE`.
pub fn overview(grid: &GridMap, overlay: &Overlay, title: &str) -> Result<Vec<u8>> {
    png(percept_pictures::overview(grid, overlay, title))
}

fn view(from_above: bool) -> View {
    if from_above { View::above() } else { View { cut_above_m: Some(CEILING_M), ..View::default() } }
}

/// The cloud from above, or from aside.
///
/// # Errors
/// `PICTURE_TOO_LARGE`.
pub fn cloud(cloud: &PointCloud, from_above: bool, title: &str) -> Result<Vec<u8>> {
    png(percept_pictures::cloud_view(cloud, &view(from_above), title))
}

/// The surface from aside.
///
/// # Errors
/// `PICTURE_TOO_LARGE`.
pub fn mesh(mesh: &MeshData, title: &str) -> Result<Vec<u8>> {
    png(percept_pictures::mesh_view(mesh, &view(false), title))
}

/// Occupied voxels from aside.
///
/// # Errors
/// `PICTURE_TOO_LARGE`.
pub fn voxels(blocks: &[VoxelBlock], voxel_size_m: f64, title: &str) -> Result<Vec<u8>> {
    png(percept_pictures::voxels_view(blocks, voxel_size_m, &view(false), title))
}

/// Heights of the ground.
///
/// # Errors
/// `PICTURE_TOO_LARGE`.
pub fn heights(heights: &DenseHeights, title: &str) -> Result<Vec<u8>> {
    png(percept_pictures::heights(heights, title))
}

/// Where a robot can drive.
///
/// # Errors
/// `PICTURE_TOO_LARGE`.
pub fn traversability(drivable: &Traversability, title: &str) -> Result<Vec<u8>> {
    png(percept_pictures::traversability(drivable, title))
}
