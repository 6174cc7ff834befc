//! The flat in space: as a surface, a cloud, and voxels.

use nalgebra::{Point3, Vector3};
use percept_geometry::PointCloud;
use percept_mapping::{MeshData, VoxelBlock};
use std::collections::BTreeMap;

/// Lowest and highest corner, colour.
type Slab = ([f32; 3], [f32; 3], [u8; 3]);

/// A corner, two edges, colour.
type Face = (Vector3<f32>, Vector3<f32>, Vector3<f32>, [u8; 3]);

const WALL: [u8; 3] = [214, 208, 196];
const WOOD: [u8; 3] = [168, 112, 62];

/// Boxes: lowest corner, highest corner, colour.
fn boxes() -> Vec<Slab> {
    let wall = |x0, y0, x1, y1| ([x0, y0, 0.0], [x1, y1, 2.5], WALL);
    vec![
        wall(0.0, -0.15, 10.8, 0.0),
        wall(0.0, 7.0, 10.8, 7.15),
        wall(-0.15, 0.0, 0.0, 7.0),
        wall(10.8, 0.0, 10.95, 7.0),
        wall(4.5, 0.0, 4.65, 2.4),
        wall(4.5, 3.4, 4.65, 7.0),
        wall(4.5, 3.4, 7.0, 3.55),
        wall(8.0, 3.4, 10.8, 3.55),
        ([1.2, 4.4, 0.68], [2.8, 5.4, 0.75], WOOD),
        ([1.25, 4.45, 0.0], [1.33, 4.53, 0.68], WOOD),
        ([2.67, 4.45, 0.0], [2.75, 4.53, 0.68], WOOD),
        ([1.25, 5.27, 0.0], [1.33, 5.35, 0.68], WOOD),
        ([2.67, 5.27, 0.0], [2.75, 5.35, 0.68], WOOD),
        ([3.9, 0.3, 0.0], [4.4, 1.7, 1.8], [120, 76, 48]),
        ([8.4, 5.2, 0.0], [10.2, 6.6, 0.5], [70, 96, 150]),
        ([8.4, 6.4, 0.5], [10.2, 6.6, 0.9], [120, 76, 48]),
        ([6.0, 0.2, 0.0], [7.2, 0.7, 0.6], [160, 60, 52]),
    ]
}

/// Six faces of a box, each as a corner and two edges, in the order in which the surface looks outwards.
fn faces((low, high, color): &Slab) -> Vec<Face> {
    let (low, high) = (Vector3::from(*low), Vector3::from(*high));
    let size = high - low;
    let edge = |axis: usize| {
        let mut edge = Vector3::zeros();
        edge[axis] = size[axis];
        edge
    };
    let mut out = vec![];
    for axis in 0..3 {
        let (u, v) = (edge((axis + 1) % 3), edge((axis + 2) % 3));
        out.push((low, v, u, *color));
        out.push((low + edge(axis), u, v, *color));
    }
    out
}

fn all_faces(with_ceiling: bool) -> Vec<Face> {
    let mut out: Vec<_> = boxes().iter().flat_map(faces).collect();
    let (x, y) = (Vector3::new(10.8, 0.0, 0.0), Vector3::new(0.0, 7.0, 0.0));
    out.push((Vector3::zeros(), x, y, [196, 180, 150]));
    if with_ceiling {
        out.push((Vector3::new(0.0, 0.0, 2.5), y, x, [240; 3]));
    }
    out
}

/// The surface of the flat in squares of about 10 cm, with its colours or grey.
pub(crate) fn mesh(colored: bool) -> MeshData {
    let mut mesh = MeshData::default();
    for (corner, u, v, color) in all_faces(true) {
        let steps = |edge: &Vector3<f32>| (edge.norm() / 0.1).ceil().max(1.0) as u32;
        let (nu, nv) = (steps(&u), steps(&v));
        let first = mesh.positions.len() as u32;
        let normal = u.cross(&v).normalize();
        for j in 0..=nv {
            for i in 0..=nu {
                mesh.positions.push(Point3::from(corner + u * (i as f32 / nu as f32) + v * (j as f32 / nv as f32)));
                mesh.normals.push(normal);
                mesh.colors.push(if colored { color } else { [128; 3] });
            }
        }
        for (i, j) in (0..nv).flat_map(|j| (0..nu).map(move |i| (i, j))) {
            let a = first + j * (nu + 1) + i;
            mesh.triangles.extend([[a, a + 1, a + nu + 2], [a, a + nu + 2, a + nu + 1]]);
        }
    }
    mesh
}

/// A hilly surface of two times `edge` squared triangles, 100 m wide.
pub(crate) fn terrain(edge: u32) -> MeshData {
    let mut mesh = MeshData::default();
    let at = |i: u32| 100.0 * i as f32 / edge as f32;
    for (x, y) in (0..=edge).flat_map(|j| (0..=edge).map(move |i| (at(i), at(j)))) {
        let z = 4.0 * (0.11 * x).sin() * (0.09 * y).cos() + 0.6 * (0.5 * x + 0.3 * y).sin();
        mesh.positions.push(Point3::new(x, y, z));
    }
    for (i, j) in (0..edge).flat_map(|j| (0..edge).map(move |i| (i, j))) {
        let a = j * (edge + 1) + i;
        mesh.triangles.extend([[a, a + 1, a + edge + 2], [a, a + edge + 2, a + edge + 1]]);
    }
    mesh
}

/// Points on the surface of the flat, `per_m2` on a square metre, with a little noise.
pub(crate) fn cloud(per_m2: f32, colored: bool) -> PointCloud {
    let mut state = 1u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    let (mut positions, mut colors) = (vec![], vec![]);
    for (corner, u, v, color) in all_faces(true) {
        for _ in 0..(u.cross(&v).norm() * per_m2) as usize {
            let noise = Vector3::new(random(), random(), random()).map(|r| 0.02 * (r - 0.5));
            positions.push(Point3::from(corner + u * random() + v * random() + noise));
            colors.push(color);
        }
    }
    PointCloud { colors: colored.then_some(colors), ..PointCloud::from_positions(positions) }
}

/// The flat in voxels of `size` metres: boxes and floor occupied, free within the walls.
pub(crate) fn voxels(size: f32) -> Vec<VoxelBlock> {
    let mut blocks: BTreeMap<[i32; 3], Box<[i8; 512]>> = BTreeMap::new();
    let mut set = |low: [f32; 3], high: [f32; 3], percent: i8| {
        let range = |i: usize| {
            (low[i] / size).round() as i32..((high[i] / size).round() as i32).max((low[i] / size).round() as i32 + 1)
        };
        for z in range(2) {
            for y in range(1) {
                for x in range(0) {
                    let block = blocks.entry([x, y, z].map(|v| v.div_euclid(8))).or_insert_with(|| Box::new([-1; 512]));
                    let [x, y, z] = [x, y, z].map(|v| v.rem_euclid(8) as usize);
                    block[(z * 8 + y) * 8 + x] = percent;
                }
            }
        }
    };
    set([0.0, 0.0, 0.0], [10.8, 7.0, 2.5], 12);
    set([0.0, 0.0, -size], [10.8, 7.0, 0.0], 90);
    boxes().iter().for_each(|(low, high, _)| set(*low, *high, 95));
    blocks.into_iter().map(|(key, percent)| VoxelBlock { key, percent }).collect()
}
