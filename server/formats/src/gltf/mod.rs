//! glTF 2.0, binary (`.glb`): triangle meshes and point clouds out, for viewers and web pages.
//!
//! Source: Khronos Group, "glTF 2.0 Specification", 2021. One node holds one mesh of one primitive. Its coordinates are those
//! of the map frame (metres, z up); the node's rotation puts them into glTF's, where y is up. `extras` of the node say so.
//! Nothing is read here.

mod container;

use crate::FormatError;
use container::Container;
use nalgebra::{Point3, Vector3};
use percept_geometry::{PointCloud, TriangleMesh};
use serde_json::{Map, Value, json};
use std::f64::consts::FRAC_1_SQRT_2;

const FORMAT: &str = "glTF";

/// How a primitive's vertices are joined.
const POINTS: u8 = 0;
const TRIANGLES: u8 = 4;

/// Bytes of a `.glb` of a mesh with coordinates in `frame` (its name goes into the file).
///
/// Positions and indices keep their bits. Normals are made unit to what f32 holds; if one is undefined (zero), they are left
/// out, and viewers shade flat. Colours become glTF's linear ones, of 16 bits so that none of the 256 is lost. A mesh
/// without triangles is a valid file whose node is empty.
///
/// # Errors
/// `Geometry` if the mesh's parts do not fit each other; `TooLarge` beyond the 4 GiB that the format's lengths hold.
pub fn encode_mesh(mesh: &TriangleMesh, frame: &str) -> Result<Vec<u8>, FormatError> {
    mesh.validate()?;
    if mesh.triangles.is_empty() {
        return Container::new().finish(document(frame, None, false));
    }
    let mut container = Container::new();
    let mut attributes = vertices(&mut container, &mesh.positions, &mesh.colors);
    if let Some(normals) = unit_normals(&mesh.normals) {
        attributes.insert("NORMAL".to_owned(), container.floats(&normals, None));
    }
    let indices = container.indices(mesh.triangles.as_flattened());
    let primitive = json!({ "attributes": attributes, "indices": indices, "mode": TRIANGLES, "material": 0 });
    container.finish(document(frame, Some(primitive), true))
}

/// Bytes of a `.glb` of a cloud with coordinates in `frame`, as points; its positions, colours and normals.
///
/// As of meshes, colours become linear, and normals are left out if one is undefined. An empty cloud is a valid file whose
/// node is empty.
///
/// # Errors
/// `Geometry` if a channel has another length than the positions; `Unsupported` for a position that is not finite (drop
/// points without return first); `TooLarge` beyond the 4 GiB that the format's lengths hold.
pub fn encode_cloud(cloud: &PointCloud, frame: &str) -> Result<Vec<u8>, FormatError> {
    cloud.validate()?;
    if !cloud.positions.iter().all(percept_geometry::cloud::is_finite) {
        let (value, supported) = ("not finite".to_owned(), "finite numbers: drop points without return first");
        return Err(FormatError::Unsupported { format: FORMAT, field: "position", value, supported });
    }
    if cloud.is_empty() {
        return Container::new().finish(document(frame, None, false));
    }
    let mut container = Container::new();
    let colors = cloud.colors.as_deref().unwrap_or_default();
    let mut attributes = vertices(&mut container, &cloud.positions, colors);
    if let Some(normals) = unit_normals(cloud.normals.as_deref().unwrap_or_default()) {
        attributes.insert("NORMAL".to_owned(), container.floats(&normals, None));
    }
    container.finish(document(frame, Some(json!({ "attributes": attributes, "mode": POINTS })), false))
}

/// What triangles and points have alike: positions, and colours if there are any.
fn vertices(container: &mut Container, positions: &[Point3<f32>], colors: &[[u8; 3]]) -> Map<String, Value> {
    let coords: Vec<[f32; 3]> = positions.iter().map(|p| p.coords.into()).collect();
    let bounds = coords.iter().fold(([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]), |(min, max), p| {
        ([0, 1, 2].map(|k| p[k].min(min[k])), [0, 1, 2].map(|k| p[k].max(max[k])))
    });
    let mut attributes = Map::new();
    attributes.insert("POSITION".to_owned(), container.floats(&coords, Some(bounds)));
    if !colors.is_empty() {
        let linear: [u16; 256] = std::array::from_fn(|i| to_linear(i as u8));
        let colors: Vec<[u16; 4]> = colors.iter().map(|c| linear_color(*c, &linear)).collect();
        attributes.insert("COLOR_0".to_owned(), container.colors(&colors));
    }
    attributes
}

fn linear_color([r, g, b]: [u8; 3], linear: &[u16; 256]) -> [u16; 4] {
    [linear[usize::from(r)], linear[usize::from(g)], linear[usize::from(b)], u16::MAX]
}

/// A value of sRGB as a share of light, 0..65535. Source: IEC 61966-2-1.
fn to_linear(value: u8) -> u16 {
    let v = f64::from(value) / 255.0;
    let light = if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
    (light * 65535.0).round() as u16
}

/// Normals of unit length; none if there are none, or one is undefined.
fn unit_normals(normals: &[Vector3<f32>]) -> Option<Vec<[f32; 3]>> {
    let unit = |n: &Vector3<f32>| Some(n.cast::<f64>().try_normalize(1e-6)?.cast::<f32>().into());
    if normals.is_empty() { None } else { normals.iter().map(unit).collect() }
}

/// The JSON without what the container adds. Quarter of a turn back about x: map's z to glTF's y.
fn document(frame: &str, primitive: Option<Value>, has_material: bool) -> Map<String, Value> {
    let mut node = json!({
        "name": frame,
        "rotation": [-FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2],
        "extras": { "frame": frame, "unit": "m", "axes": "x forward, y left, z up, before this node's rotation" },
    });
    let mut out = Map::new();
    out.insert("asset".to_owned(), json!({ "version": "2.0", "generator": "percept" }));
    if let Some(primitive) = primitive {
        node["mesh"] = json!(0);
        out.insert("meshes".to_owned(), json!([{ "name": frame, "primitives": [primitive] }]));
    }
    if has_material {
        // Without one a surface is a polished metal that is seen from one side, which is black in most rooms.
        let material =
            json!({ "doubleSided": true, "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 1 } });
        out.insert("materials".to_owned(), json!([material]));
    }
    out.insert("nodes".to_owned(), json!([node]));
    out.insert("scenes".to_owned(), json!([{ "nodes": [0] }]));
    out.insert("scene".to_owned(), json!(0));
    out
}

#[cfg(test)]
mod tests;
