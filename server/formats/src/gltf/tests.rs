use super::*;
use crate::FormatError;
use nalgebra::{Quaternion, UnitQuaternion};
use percept_geometry::GeometryError;
use proptest::prelude::*;

/// JSON and buffer of a container, as the specification has them: lengths whole and multiples of four.
fn open(glb: &[u8]) -> (Value, Vec<u8>) {
    let number = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&glb[..4], number(4), number(8)), (b"glTF".as_slice(), 2, glb.len()));
    let text = number(12);
    assert_eq!((&glb[16..20], text % 4), (b"JSON".as_slice(), 0));
    let json = serde_json::from_slice(&glb[20..20 + text]).unwrap();
    if 20 + text == glb.len() {
        return (json, vec![]);
    }
    let buffer = number(20 + text);
    assert_eq!((&glb[24 + text..28 + text], buffer % 4), (b"BIN\0".as_slice(), 0));
    assert_eq!(28 + text + buffer, glb.len());
    (json, glb[28 + text..].to_vec())
}

/// Bytes of the accessor with this number.
fn accessor<'a>(json: &Value, buffer: &'a [u8], number: &Value) -> &'a [u8] {
    let view = &json["bufferViews"]
        [json["accessors"][number.as_u64().unwrap() as usize]["bufferView"].as_u64().unwrap() as usize];
    let (offset, length) =
        (view["byteOffset"].as_u64().unwrap() as usize, view["byteLength"].as_u64().unwrap() as usize);
    &buffer[offset..offset + length]
}

fn floats(bytes: &[u8]) -> Vec<[f32; 3]> {
    let floats: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
    floats.as_chunks::<3>().0.to_vec()
}

fn mesh() -> TriangleMesh {
    let positions = [[0.1, -2.0, 3.5], [1.0, 0.0, 0.0], [0.0, 1.0, 0.7], [-4.25, 5.0, 1e-7]].map(Point3::from);
    let normals = vec![Vector3::z(), Vector3::x(), Vector3::new(0.6, 0.8, 0.0), -Vector3::y()];
    let colors = vec![[0, 128, 255], [1, 2, 3], [255; 3], [10, 11, 12]];
    TriangleMesh::new(positions.to_vec(), normals, colors, vec![[0, 1, 2], [2, 1, 3]]).unwrap()
}

#[test]
fn a_mesh_keeps_its_numbers_and_stands_upright() {
    let mesh = mesh();
    let (json, buffer) = open(&encode_mesh(&mesh, "map").unwrap());
    let primitive = &json["meshes"][0]["primitives"][0];
    let attribute = |name: &str| accessor(&json, &buffer, &primitive["attributes"][name]);
    assert_eq!(primitive["mode"], 4);
    let positions: Vec<[f32; 3]> = mesh.positions.iter().map(|p| p.coords.into()).collect();
    assert_eq!(floats(attribute("POSITION")), positions);
    assert_eq!(floats(attribute("NORMAL"))[3], [0.0, -1.0, 0.0]);
    let indices: Vec<u32> = accessor(&json, &buffer, &primitive["indices"])
        .as_chunks::<4>()
        .0
        .iter()
        .map(|&b| u32::from_le_bytes(b))
        .collect();
    assert_eq!(indices, [0, 1, 2, 2, 1, 3]);
    let bounds = &json["accessors"][primitive["attributes"]["POSITION"].as_u64().unwrap() as usize];
    assert_eq!(bounds["min"], json!([-4.25, -2.0, 0.0]));
    assert_eq!(bounds["max"], json!([1.0, 5.0, 3.5]));
    let node = &json["nodes"][0];
    assert_eq!((&node["extras"]["frame"], &node["extras"]["unit"]), (&json!("map"), &json!("m")));
    let q: Vec<f64> = node["rotation"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2]));
    assert!((rotation * Vector3::z() - Vector3::y()).norm() < 1e-12);
    assert!((rotation * Vector3::y() + Vector3::z()).norm() < 1e-12);
}

#[test]
fn every_colour_has_a_light_of_its_own() {
    let light: Vec<u16> = (0..=255).map(to_linear).collect();
    assert!(light.array_windows().all(|[a, b]| a < b));
    assert_eq!((light[0], light[255]), (0, 65535));
    // The middle grey of sRGB is 0.2158 of the light.
    assert!((f64::from(light[128]) / 65535.0 - 0.2158).abs() < 1e-4);
    let (json, buffer) = open(&encode_mesh(&mesh(), "map").unwrap());
    let colors = accessor(&json, &buffer, &json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]);
    assert_eq!(colors[..8], [0, 0, light[128] as u8, (light[128] >> 8) as u8, 255, 255, 255, 255]);
}

#[test]
fn normals_with_one_undefined_are_left_out() {
    let mut mesh = mesh();
    mesh.normals[2] = Vector3::zeros();
    let (json, _) = open(&encode_mesh(&mesh, "map").unwrap());
    assert_eq!(json["meshes"][0]["primitives"][0]["attributes"].get("NORMAL"), None);
}

#[test]
fn a_mesh_without_triangles_and_a_cloud_without_points_are_empty_nodes() {
    let without = TriangleMesh { triangles: vec![], ..mesh() };
    for glb in [encode_mesh(&without, "map").unwrap(), encode_cloud(&PointCloud::default(), "map").unwrap()] {
        let (json, buffer) = open(&glb);
        assert_eq!((json["nodes"][0].get("mesh"), json.get("buffers"), buffer.len()), (None, None, 0));
    }
}

#[test]
fn what_fits_no_file_is_an_error() {
    let bad = TriangleMesh { triangles: vec![[0, 1, 9]], ..mesh() };
    let geometry = |e| matches!(e, FormatError::Geometry(GeometryError::OutOfRange { field: "triangles", .. }));
    assert!(geometry(encode_mesh(&bad, "map").unwrap_err()));
    let cloud = PointCloud::from_positions(vec![Point3::new(f32::NAN, 0.0, 0.0)]);
    assert!(matches!(encode_cloud(&cloud, "map"), Err(FormatError::Unsupported { field: "position", .. })));
    #[cfg(target_pointer_width = "64")]
    assert!(matches!(container::size(1 << 32), Err(FormatError::TooLarge { .. })));
}

proptest! {
    #[test]
    fn points_keep_their_bits(points in prop::collection::vec([-1e6..1e6f32, -1e3..1e3f32, -1e-3..1e-3f32], 1..50), frame in ".*") {
        let cloud = PointCloud::from_positions(points.iter().map(|&p| Point3::from(p)).collect());
        let (json, buffer) = open(&encode_cloud(&cloud, &frame).unwrap());
        let primitive = &json["meshes"][0]["primitives"][0];
        prop_assert_eq!((&primitive["mode"], &json["nodes"][0]["name"]), (&json!(0), &json!(frame)));
        prop_assert_eq!(floats(accessor(&json, &buffer, &primitive["attributes"]["POSITION"])), points);
    }
}
