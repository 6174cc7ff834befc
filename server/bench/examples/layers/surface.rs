//! The mesh against the true surface.
//!
//! Accuracy: distances of the mesh's vertices from the nearest true surface. Completeness: the true surface is sampled where beams truly
//! ended, one sample a cube of 2 cm, within the layer's range; a sample is covered if a triangle is within 2 cm, or within 5 cm, which is
//! the usual threshold for rooms (Sucar et al., "iMAP", 2021) and a voxel. Seen is a sample that beams of one keyframe at least ended
//! at; of those that three keyframes saw the share is told apart, as a single look errs by all of its noise.

use crate::Failure;
use crate::drive::Beam;
use crate::figures::{Row, quantile, share};
use nalgebra::{Point3, Vector3};
use percept_geometry::Voxel;
use percept_mapping::surface::SurfaceMap;
use percept_mapping::{MeshData, MeshOptions};
use percept_sim::World;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};

/// Edge of the cubes in which the true surface is sampled, metres.
const SAMPLE_M: f64 = 0.02;
/// Covered, metres.
const NEAR_M: [f64; 2] = [0.02, 0.05];

pub(crate) fn judge(world: &World, surface: &SurfaceMap, beams: &[Beam]) -> Result<Row, Failure> {
    let mesh = surface.mesh(&MeshOptions::default())?;
    let mut off: Vec<f64> = mesh.positions.par_iter().map(|p| world.surface_distance(&p.cast())).collect();
    if let Some(path) = std::env::var_os("LAYERS_VERTICES") {
        let rows = mesh.positions.iter().zip(&mesh.normals).zip(&off);
        let row = |((p, n), d): ((&Point3<f32>, &Vector3<f32>), &f64)| {
            format!("{:.3},{:.3},{:.3},{:.2},{:.2},{:.2},{d:.4}\n", p.x, p.y, p.z, n.x, n.y, n.z)
        };
        std::fs::write(path, rows.map(row).collect::<String>())?;
    }
    off.sort_by(f64::total_cmp);
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    let far = off.iter().filter(|d| **d > 0.05).count();
    let samples = samples(beams, surface.params().range_max());
    let index = Triangles::new(&mesh);
    let all: Vec<(f64, usize)> = samples.par_iter().map(|(p, looks)| (index.distance(p, NEAR_M[1]), *looks)).collect();
    let covered = |near: f64, looks: usize| {
        let seen = || all.iter().filter(|(_, l)| *l >= looks);
        share(seen().filter(|(d, _)| *d <= near).count(), seen().count())
    };
    Ok(vec![
        ("surface: vertices", off.len() as f64),
        ("surface: vertex to truth, mean, m", mean),
        ("surface: p50, m", quantile(&off, 0.5)),
        ("surface: p95, m", quantile(&off, 0.95)),
        ("surface: worst, m", quantile(&off, 1.0)),
        ("surface: share of vertices beyond 5 cm", share(far, off.len())),
        ("surface: samples seen", all.len() as f64),
        ("surface: covered within 2 cm", covered(NEAR_M[0], 1)),
        ("surface: covered within 5 cm", covered(NEAR_M[1], 1)),
        ("surface: seen thrice, within 2 cm", covered(NEAR_M[0], 3)),
        ("surface: seen thrice, within 5 cm", covered(NEAR_M[1], 3)),
    ])
}

/// Places of the true surface, and how many keyframes saw each.
fn samples(beams: &[Beam], range_max: f64) -> Vec<(Point3<f64>, usize)> {
    // A place, how many keyframes saw it, and the latest of them.
    let mut cubes = BTreeMap::<_, (Point3<f64>, usize, u32)>::new();
    for beam in beams.iter().filter(|b| b.range_m <= range_max) {
        let Some(v) = Voxel::containing(&beam.end, SAMPLE_M) else { continue };
        let cube = cubes.entry((v.x, v.y, v.z)).or_insert((beam.end, 1, beam.keyframe));
        if cube.2 != beam.keyframe {
            (cube.1, cube.2) = (cube.1 + 1, beam.keyframe);
        }
    }
    cubes.into_values().map(|(p, looks, _)| (p, looks)).collect()
}

/// Triangles by the cubes that their boxes reach into.
struct Triangles<'a> {
    mesh: &'a MeshData,
    cubes: HashMap<(i32, i32, i32), Vec<u32>>,
}

/// Edge of those cubes: the farthest that is asked for, so that a place's neighbours hold all that is near.
const CUBE_M: f64 = NEAR_M[1];

impl<'a> Triangles<'a> {
    fn new(mesh: &'a MeshData) -> Self {
        let mut cubes: HashMap<(i32, i32, i32), Vec<u32>> = HashMap::new();
        for (number, triangle) in mesh.triangles.iter().enumerate() {
            let corners = triangle.map(|v| mesh.positions[v as usize].cast::<f64>());
            let low = corners[0].inf(&corners[1]).inf(&corners[2]).map(|v| (v / CUBE_M).floor() as i32);
            let high = corners[0].sup(&corners[1]).sup(&corners[2]).map(|v| (v / CUBE_M).floor() as i32);
            for x in low.x..=high.x {
                for y in low.y..=high.y {
                    for z in low.z..=high.z {
                        cubes.entry((x, y, z)).or_default().push(number as u32);
                    }
                }
            }
        }
        Self { mesh, cubes }
    }

    /// To the nearest triangle, metres; infinite if none is within `limit`, which is no more than a cube.
    fn distance(&self, p: &Point3<f64>, limit: f64) -> f64 {
        let cube = p.map(|v| (v / CUBE_M).floor() as i32);
        let around = (-1..=1).flat_map(|x| (-1..=1).flat_map(move |y| (-1..=1).map(move |z| (x, y, z))));
        let near = around.filter_map(|(x, y, z)| self.cubes.get(&(cube.x + x, cube.y + y, cube.z + z))).flatten();
        let distance = |number: &u32| {
            let corners = self.mesh.triangles[*number as usize].map(|v| self.mesh.positions[v as usize].cast::<f64>());
            (nearest(p, &corners) - p).norm()
        };
        near.map(distance).filter(|d| *d <= limit).fold(f64::INFINITY, f64::min)
    }
}

/// The place of a triangle that is nearest to `p`: within it if `p` lies over it, else on an edge.
fn nearest(p: &Point3<f64>, [a, b, c]: &[Point3<f64>; 3]) -> Point3<f64> {
    let normal = (b - a).cross(&(c - a));
    let is_inside = |from: &Point3<f64>, to: &Point3<f64>| (to - from).cross(&(p - from)).dot(&normal) >= 0.0;
    if normal.norm() > 1e-15 && is_inside(a, b) && is_inside(b, c) && is_inside(c, a) {
        let unit: Vector3<f64> = normal.normalize();
        return p - unit * (p - a).dot(&unit);
    }
    let on_edge = |from: &Point3<f64>, to: &Point3<f64>| {
        let along = to - from;
        let s = ((p - from).dot(&along) / along.norm_squared().max(1e-30)).clamp(0.0, 1.0);
        from + along * s
    };
    let edges = [on_edge(a, b), on_edge(b, c), on_edge(c, a)];
    edges.into_iter().min_by(|q, r| (q - p).norm().total_cmp(&(r - p).norm())).unwrap_or(*a)
}
