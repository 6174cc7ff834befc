//! Questions about space, and their answers.

use super::{geometry, maps, required};
use crate::v1;
use bytes::Bytes;
use nalgebra::{Point2, Point3};
use percept_geometry::{Aabb3, OrientedBox3, TriangleMesh};
use percept_mapping::height::Storey;
use percept_mapping::voxels::VoxelState;
use percept_service::layers::{
    BoxAnswer, ChangeAnswer, HeightAnswer, MapLayer, OfMap, PointAnswers, RayAnswer, SpaceRay, VoxelAnswer,
};
use percept_service::reason;
use percept_service::{Error, Result};

/// Which layer is asked; none if that was left to the server.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn layer(value: i32) -> Result<Option<MapLayer>> {
    Ok(match v1::MapLayer::try_from(value) {
        Ok(v1::MapLayer::Unspecified) => None,
        Ok(v1::MapLayer::Occupancy) => Some(MapLayer::Occupancy),
        Ok(v1::MapLayer::Voxels) => Some(MapLayer::Voxels),
        Ok(v1::MapLayer::Cloud) => Some(MapLayer::Cloud),
        Ok(v1::MapLayer::Height) => Some(MapLayer::Height),
        Ok(v1::MapLayer::Surface) => Some(MapLayer::Surface),
        Err(_) => return Err(super::unknown_enum("layer", value)),
    })
}

fn layer_to(layer: MapLayer) -> i32 {
    match layer {
        MapLayer::Occupancy => v1::MapLayer::Occupancy,
        MapLayer::Voxels => v1::MapLayer::Voxels,
        MapLayer::Cloud => v1::MapLayer::Cloud,
        MapLayer::Height => v1::MapLayer::Height,
        MapLayer::Surface => v1::MapLayer::Surface,
    }
    .into()
}

fn state_to(state: VoxelState) -> i32 {
    match state {
        VoxelState::Unknown => v1::SpaceState::Unknown,
        VoxelState::Free => v1::SpaceState::Free,
        VoxelState::Occupied => v1::SpaceState::Occupied,
    }
    .into()
}

/// An axis-aligned box.
///
/// # Errors
/// Missing or non-finite corners; `REGION_EMPTY`.
pub fn box3(b: Option<&v1::Box3>) -> Result<Option<Aabb3>> {
    let Some(b) = b else { return Ok(None) };
    let min = geometry::vector("region.min", &required("region.min", b.min)?)?;
    let max = geometry::vector("region.max", &required("region.max", b.max)?)?;
    if (0..3).any(|i| min[i] >= max[i]) {
        let message =
            format!("region from {:?} to {:?} is empty; min must be below max", min.as_slice(), max.as_slice());
        return Err(Error::invalid(reason::REGION_EMPTY, "region", message));
    }
    Ok(Some(Aabb3 { min: min.into(), max: max.into() }))
}

/// Points of the map.
///
/// # Errors
/// `OUT_OF_RANGE` naming the point.
pub fn points(points: &[v1::Vector3]) -> Result<Vec<Point3<f64>>> {
    let point = |(i, p)| geometry::vector("points", p).map(Point3::from).map_err(|e| at("points", i, e));
    points.iter().enumerate().map(point).collect()
}

/// Rays in the map.
///
/// # Errors
/// `FIELD_MISSING`, `OUT_OF_RANGE` naming the ray.
pub fn rays(rays: &[v1::SpaceRay]) -> Result<Vec<SpaceRay>> {
    let ray = |r: &v1::SpaceRay| {
        Ok(SpaceRay {
            origin: geometry::vector("origin", &required("origin", r.origin)?)?.into(),
            direction: geometry::vector("direction", &required("direction", r.direction)?)?,
            max_range_m: r.max_range_m,
        })
    };
    rays.iter().enumerate().map(|(i, r)| ray(r).map_err(|e| at("rays", i, e))).collect()
}

/// Boxes in the map.
///
/// # Errors
/// As for oriented boxes, naming the box.
pub fn boxes(boxes: &[v1::OrientedBox]) -> Result<Vec<OrientedBox3>> {
    boxes.iter().enumerate().map(|(i, b)| geometry::oriented_box("boxes", b).map_err(|e| at("boxes", i, e))).collect()
}

/// The error of one of many.
fn at(list: &str, i: usize, e: Error) -> Error {
    match e.field.strip_prefix(list) {
        Some(rest) => Error { field: format!("{list}[{i}]{rest}"), ..e },
        None => e.within(&format!("{list}[{i}]")),
    }
}

/// Voxels as a message.
pub fn voxels_to(found: &OfMap<VoxelAnswer>) -> v1::GetVoxelsResponse {
    let block = |b: &percept_mapping::VoxelBlock| v1::VoxelBlock {
        x: b.key[0],
        y: b.key[1],
        z: b.key[2],
        cells: b.percent.iter().map(|p| *p as u8).collect::<Vec<u8>>().into(),
    };
    v1::GetVoxelsResponse {
        stamp: Some(maps::stamp_to(found.map_version, found.stamp)),
        voxel_size_m: found.answer.voxel_size_m,
        blocks: found.answer.blocks.iter().map(block).collect(),
    }
}

/// What is at points, as a message.
pub fn points_to(found: &OfMap<PointAnswers>) -> v1::QueryPointsResponse {
    let point = |p: &percept_service::layers::PointAnswer| v1::PointAnswer {
        state: state_to(p.state),
        distance_m: p.distance_m,
        gradient: Some(geometry::vector_to(&p.gradient)),
    };
    v1::QueryPointsResponse {
        stamp: Some(maps::stamp_to(found.map_version, found.stamp)),
        layer: layer_to(found.answer.layer),
        max_distance_m: found.answer.max_distance_m,
        points: found.answer.points.iter().map(point).collect(),
    }
}

/// Where rays ended, as a message.
pub fn rays_to(found: &OfMap<Vec<RayAnswer>>) -> v1::CastRaysResponse {
    let ray = |r: &RayAnswer| v1::RayAnswer {
        state: state_to(r.state),
        distance_m: r.distance_m,
        point: Some(geometry::vector_to(&r.point.coords)),
    };
    let stamp = Some(maps::stamp_to(found.map_version, found.stamp));
    v1::CastRaysResponse { stamp, rays: found.answer.iter().map(ray).collect() }
}

/// What is in boxes, as a message.
pub fn boxes_to(found: &OfMap<Vec<BoxAnswer>>) -> v1::CheckBoxesResponse {
    let answer = |b: &BoxAnswer| v1::BoxAnswer {
        state: state_to(b.state()),
        num_occupied: b.num_occupied,
        num_free: b.num_free,
        num_unknown: b.num_unknown,
    };
    let stamp = Some(maps::stamp_to(found.map_version, found.stamp));
    v1::CheckBoxesResponse { stamp, boxes: found.answer.iter().map(answer).collect() }
}

/// Ground that is this much higher or lower than asked for is another storey's, metres, unless said otherwise: half a storey.
const NEAR_WITHIN_M: f64 = 1.5;

/// Which storey is asked for: its name, and of the nearest one a height and how far off it may be, metres; 0: 1.5.
///
/// # Errors
/// `ENUM_UNKNOWN`; `OUT_OF_RANGE` for what is not finite, or below 0.
pub fn storey(storey: i32, near_z_m: f64, near_within_m: f64) -> Result<Storey> {
    Ok(match v1::Storey::try_from(storey) {
        Ok(v1::Storey::Unspecified | v1::Storey::Lowest) => Storey::Lowest,
        Ok(v1::Storey::Highest) => Storey::Highest,
        Ok(v1::Storey::Nearest) => {
            let finite = |field: &str, value: f64, low: f64| {
                let message = format!("{field} is {value}; it must be finite and at least {low}");
                let is_sound = value.is_finite() && value >= low;
                if is_sound { Ok(value) } else { Err(Error::invalid(reason::OUT_OF_RANGE, field, message)) }
            };
            let within_m = finite("near_within_m", near_within_m, 0.0)?;
            let within_m = if within_m == 0.0 { NEAR_WITHIN_M } else { within_m };
            Storey::Near { z_m: finite("near_z_m", near_z_m, f64::MIN)?, within_m }
        }
        Err(_) => return Err(super::unknown_enum("storey", storey)),
    })
}

/// Heights as a message.
pub fn heights_to(found: &OfMap<HeightAnswer>) -> v1::GetHeightsResponse {
    let stamp = Some(maps::stamp_to(found.map_version, found.stamp));
    let Some((h, t)) = &found.answer else { return v1::GetHeightsResponse { stamp, ..Default::default() } };
    v1::GetHeightsResponse {
        stamp,
        geometry: Some(maps::grid_geometry_to(&h.geometry, h.width, h.height)),
        ground_m: floats(&h.ground_m),
        sigma_m: floats(&h.sigma_m),
        top_m: floats(&h.top_m),
        slope_rad: floats(&t.slope_rad),
        step_m: floats(&t.step_m),
        roughness_m: floats(&t.roughness_m),
        traversability: floats(&t.traversability),
        is_drop: h.is_drop.iter().map(|d| u8::from(*d)).collect::<Vec<u8>>().into(),
    }
}

fn floats(values: &[f32]) -> Bytes {
    values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>().into()
}

/// A surface as a message.
pub fn mesh_to(found: &OfMap<TriangleMesh>) -> v1::GetMeshResponse {
    let mesh = &found.answer;
    let positions: Vec<f32> = mesh.positions.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
    let normals: Vec<f32> = mesh.normals.iter().flat_map(|n| [n.x, n.y, n.z]).collect();
    v1::GetMeshResponse {
        stamp: Some(maps::stamp_to(found.map_version, found.stamp)),
        positions: floats(&positions),
        normals: floats(&normals),
        colours: mesh.colors.as_flattened().to_vec().into(),
        triangles: mesh.triangles.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>().into(),
        draco: Bytes::new(),
    }
}

/// Where a layer changed, as a message.
pub fn changes_to(found: &OfMap<ChangeAnswer>) -> v1::GetChangesResponse {
    let corner = |p: &Point2<f64>| Some(v1::Vector2 { x: p.x, y: p.y });
    let region = |(min, max): &(Point2<f64>, Point2<f64>)| v1::Region2 { min: corner(min), max: corner(max) };
    v1::GetChangesResponse {
        stamp: Some(maps::stamp_to(found.map_version, found.stamp)),
        layer: layer_to(found.answer.layer),
        regions: found.answer.regions.iter().map(region).collect(),
    }
}
