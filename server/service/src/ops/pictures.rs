//! Pictures of maps for people, as PNG.

use crate::{Error, Result, SessionMask, Zones, reason};
use percept_formats::GridMap;
use percept_geometry::{PointCloud, RgbImage};
use percept_mapping::{DenseHeights, MeshData, Traversability, VoxelBlock};
use percept_pictures::{MapObject, MapRoom, Overlay, PictureError, View, encode_png};
use percept_pipeline::Snapshot;
use percept_planning::{SpeedLimits, Zone, ZoneKind};
use percept_scene::ObjectState;

/// Whatever is higher above the floor than this is cut away, so that ceilings do not hide the rooms, metres: below the usual 2.4.
const CEILING_M: f64 = 2.2;
/// Grids of more cells are drawn without rooms: a second's work.
const MAX_CELLS: usize = 4_000_000;

/// What a snapshot knows, and zones, to be drawn over a grid.
pub fn overlay(snapshot: &Snapshot, zones: &Zones) -> Overlay {
    let there = snapshot.objects.iter().filter(|o| o.state != ObjectState::Gone);
    let speed = SpeedLimits::default().max_speed_mps;
    let mask = |m: &SessionMask| m.drawn(speed, snapshot.params.planning.occupied_probability);
    Overlay {
        trajectory: snapshot.trajectory_in_one_unit().map(|(t, _)| t).collect(),
        robot: None,
        objects: there.map(|o| MapObject { id: Some(o.id.0), class: o.class, bbox: o.bbox }).collect(),
        zones: zones.areas.iter().map(zone).collect(),
        masks: zones.masks.iter().map(mask).collect(),
        path: vec![],
        rooms: rooms(snapshot, zones),
    }
}

/// Rooms to be drawn: none where the map has too many cells to be divided.
fn rooms(snapshot: &Snapshot, zones: &Zones) -> Vec<MapRoom> {
    let Ok(found) = super::rooms::listed(snapshot, &zones.room_names, MAX_CELLS) else { return vec![] };
    let jambs = |id| {
        let of_room = found.rooms.doors.iter().filter(move |d| d.rooms.0 == id);
        of_room.map(|d| {
            let half = nalgebra::Vector2::new(d.angle_rad.cos(), d.angle_rad.sin()) * (0.5 * d.width_m);
            [d.center - half, d.center + half]
        })
    };
    let room = |node: &percept_scene::RoomNode| MapRoom {
        label: node.label(),
        center: node.room.center,
        outline: node.room.outline.clone(),
        doors: jambs(node.room.id).collect(),
    };
    found.nodes.iter().map(room).collect()
}

/// A zone to be drawn.
pub(super) fn zone(z: &Zone) -> percept_pictures::Zone {
    percept_pictures::Zone {
        polygon: z.polygon.clone(),
        kind: match z.kind {
            ZoneKind::KeepOut => percept_pictures::ZoneKind::KeepOut,
            ZoneKind::SpeedLimit { share } => percept_pictures::ZoneKind::SpeedLimit { share },
        },
    }
}

pub(super) fn refused(e: &PictureError) -> Error {
    match e {
        PictureError::GridTooLarge { .. } | PictureError::TooMuchOverdraw { .. } => {
            Error::exhausted(reason::PICTURE_TOO_LARGE, "format", e.to_string())
        }
        e => Error::internal(e),
    }
}

pub(super) fn png(drawn: std::result::Result<RgbImage, PictureError>) -> Result<Vec<u8>> {
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

/// Columns of a sheet of layers, by their number: about twice as wide as high.
fn columns(num_panels: usize) -> usize {
    if num_panels < 5 { num_panels.min(2) } else { 3 }
}

/// Pictures beside each other, each with its caption.
///
/// # Errors
/// `PICTURE_TOO_LARGE`.
pub fn side_by_side(panels: &[(RgbImage, &str)]) -> Result<Vec<u8>> {
    let panels: Vec<(&RgbImage, &str)> = panels.iter().map(|(image, caption)| (image, *caption)).collect();
    png(percept_pictures::side_by_side(&panels, columns(panels.len())))
}

/// Pictures of a snapshot's layers; none of a layer that is off or empty.
pub(super) mod layers {
    use super::{overlay, refused, view};
    use crate::ops::{layers, maps};
    use crate::{Limits, Result, Zones, reason};
    use percept_geometry::RgbImage;
    use percept_pictures::PictureError;
    use percept_pipeline::Snapshot;

    type Drawn = Result<Option<RgbImage>>;

    fn drawn(picture: std::result::Result<RgbImage, PictureError>) -> Drawn {
        picture.map(Some).map_err(|e| refused(&e))
    }

    /// What a question finds where its layer is on.
    fn there<T>(found: Result<T>) -> Result<Option<T>> {
        match found {
            Ok(found) => Ok(Some(found)),
            Err(e) if e.reason == reason::LAYER_OFF => Ok(None),
            Err(e) => Err(e),
        }
    }

    pub(in crate::ops) fn overview(s: &Snapshot, zones: &Zones, name: &str, limits: &Limits) -> Drawn {
        let grid = maps::dense(&s.layers.occupancy, None, None, limits)?;
        if grid.cells.is_empty() {
            return Ok(None);
        }
        drawn(percept_pictures::overview(&grid, &overlay(s, zones), name))
    }

    pub(in crate::ops) fn heights(s: &Snapshot, name: &str, limits: &Limits) -> Drawn {
        let found = there(layers::all_heights(&s.layers, limits))?.flatten();
        found.map_or(Ok(None), |(heights, _)| drawn(percept_pictures::heights(&heights, name)))
    }

    pub(in crate::ops) fn traversability(s: &Snapshot, name: &str, limits: &Limits) -> Drawn {
        let found = there(layers::all_heights(&s.layers, limits))?.flatten();
        found.map_or(Ok(None), |(_, drivable)| drawn(percept_pictures::traversability(&drivable, name)))
    }

    pub(in crate::ops) fn voxels(s: &Snapshot, name: &str) -> Drawn {
        let found = there(layers::all_voxels(&s.layers))?.filter(|(blocks, _)| !blocks.is_empty());
        let draw = |(blocks, size): (Vec<_>, f64)| percept_pictures::voxels_view(&blocks, size, &view(false), name);
        found.map_or(Ok(None), |found| drawn(draw(found)))
    }

    pub(in crate::ops) fn surface(s: &Snapshot, name: &str) -> Drawn {
        let found = there(layers::mesh_data_of(&s.layers, None, None))?.filter(|mesh| !mesh.triangles.is_empty());
        found.map_or(Ok(None), |mesh| drawn(percept_pictures::mesh_view(&mesh, &view(false), name)))
    }

    pub(in crate::ops) fn cloud(s: &Snapshot, name: &str) -> Drawn {
        let cloud = s.layers.cloud.to_cloud();
        if cloud.is_empty() {
            return Ok(None);
        }
        drawn(percept_pictures::cloud_view(&cloud, &view(false), name))
    }
}
