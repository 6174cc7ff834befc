//! Times the surface layer on an RGB-D recording with known poses, in the layout of 7-Scenes:
//! `surface DIR [--every N] [--voxel M] [--ply FILE]`. Times are those of the processor, summed over threads: on one with
//! `RAYON_NUM_THREADS=1`.

use image::{DynamicImage, ImageReader};
use nalgebra::{Matrix4, Point3};
use percept_geometry::{
    CameraIntrinsics, DepthImage, KeyframeId, KeyframeScan, PointCloud, Pose, RgbImage, SensorId, Timestamp, se3,
};
use percept_mapping::{Map, MapEntry, MapParams, MeshData, MeshOptions, OccupancyParams, SurfaceGrid, SurfaceParams};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Rounds of each measurement, of which the median is told.
const ROUNDS: usize = 7;
/// Returns beyond this are left out, metres.
const RANGE_MAX_M: f64 = 4.0;

/// Voxels of truncation: what other libraries were timed with.
const TRUNCATION_VOXELS: f64 = 4.0;

struct Args {
    dir: PathBuf,
    every: usize,
    voxel_size_m: f64,
    ply: Option<PathBuf>,
}

fn main() -> Result<(), Failure> {
    let args = arguments()?;
    let frames = Frame::all(&args.dir, args.every)?;
    let camera = camera(&args.dir.join("camera-intrinsics.txt"))?;
    let params = SurfaceParams {
        enabled: true,
        voxel_size_m: args.voxel_size_m,
        range_max_m: Some(RANGE_MAX_M),
        truncation_m: Some(TRUNCATION_VOXELS * args.voxel_size_m),
        ..SurfaceParams::default()
    };
    println!("{} frames, voxels of {} m, {} threads", frames.len(), args.voxel_size_m, rayon::current_num_threads());
    let mut grid = SurfaceGrid::new(params)?;
    for with_color in [false, true] {
        let mut rounds = vec![];
        for _ in 0..ROUNDS {
            grid = SurfaceGrid::new(params)?;
            let began = processor_ms();
            for frame in &frames {
                let color = frame.color.as_ref().filter(|_| with_color);
                grid.integrate_depth(&frame.depth, color, &camera, &frame.t_map_camera)?;
            }
            rounds.push((processor_ms() - began) / frames.len() as f64);
        }
        let blocks = grid.num_blocks();
        let what = if with_color { "with colour" } else { "without colour" };
        println!("integrate {what}: {} ms a frame, {blocks} blocks, {} bytes", told(rounds), grid.memory_bytes());
    }
    let options = MeshOptions { min_weight: 3.0, ..MeshOptions::default() };
    let (mut rounds, mut mesh) = (vec![], MeshData::default());
    for _ in 0..ROUNDS {
        let began = processor_ms();
        mesh = grid.mesh(&options)?;
        rounds.push(processor_ms() - began);
    }
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    println!("mesh from scratch: {} ms, {vertices} vertices, {triangles} triangles", told(rounds));
    if let Some(path) = &args.ply {
        write_ply(path, &mesh)?;
    }
    as_keyframes(&params, &frames, &camera)
}

/// The same frames as a session takes them in: as keyframes of a map, which is meshed after each.
fn as_keyframes(params: &SurfaceParams, frames: &[Frame], camera: &CameraIntrinsics) -> Result<(), Failure> {
    let occupancy = OccupancyParams::default();
    let mut map = Map::new(MapParams { occupancy, surface: *params, ..MapParams::default() })?;
    let (mut integrating, mut meshing, mut triangles) = (vec![], vec![], 0);
    let mut alone = SurfaceGrid::new(*params)?;
    for (i, frame) in frames.iter().enumerate() {
        let scan = Arc::new(frame.scan(camera));
        let began = processor_ms();
        alone.integrate(&frame.t_map_camera, &scan)?;
        integrating.push(processor_ms() - began);
        map.insert(KeyframeId(i as u64), &MapEntry::at(frame.t_map_camera), scan)?;
        let began = processor_ms();
        triangles = map.layers().surface.mesh(&MeshOptions::default())?.triangles.len();
        meshing.push(processor_ms() - began);
    }
    println!("keyframes of every second pixel: {} ms each", told(integrating));
    println!("mesh of the map after each: {} ms, {triangles} triangles at last", told(meshing));
    let began = processor_ms();
    map.layers().surface.mesh(&MeshOptions::default())?;
    println!("mesh of the map unchanged: {:.1} ms", processor_ms() - began);
    Ok(())
}

struct Frame {
    depth: DepthImage,
    color: Option<RgbImage>,
    t_map_camera: Pose,
}

impl Frame {
    fn all(dir: &Path, every: usize) -> Result<Vec<Self>, Failure> {
        let mut names: Vec<PathBuf> = std::fs::read_dir(dir)?.map(|e| e.map(|e| e.path())).collect::<Result<_, _>>()?;
        names.retain(|p| p.to_string_lossy().ends_with(".depth.png"));
        names.sort();
        names.iter().step_by(every).map(|path| Self::read(path)).collect()
    }

    fn read(path: &Path) -> Result<Self, Failure> {
        let beside = |end: &str| path.to_string_lossy().replace(".depth.png", end);
        let DynamicImage::ImageLuma16(depth) = ImageReader::open(path)?.decode()? else {
            return Err(format!("{} is not of 16 bits", path.display()).into());
        };
        let (width, height) = (depth.width() as usize, depth.height() as usize);
        let depth = DepthImage::from_u16(width, height, depth.as_raw(), 1e-3)?;
        let color = ImageReader::open(beside(".color.jpg"))?.decode()?.into_rgb8();
        let color = RgbImage::new(color.width() as usize, color.height() as usize, color.into_raw())?;
        let matrix = Matrix4::from_row_slice(&numbers(Path::new(&beside(".pose.txt")), 16)?);
        let rotation = nalgebra::UnitQuaternion::from_matrix(&matrix.fixed_view::<3, 3>(0, 0).into_owned());
        let t_map_camera = Pose::from_parts(matrix.fixed_view::<3, 1>(0, 3).into_owned().into(), rotation);
        Ok(Self { depth, color: Some(color), t_map_camera })
    }

    /// Every second pixel of every second row, as a keyframe.
    fn scan(&self, camera: &CameraIntrinsics) -> KeyframeScan {
        let pixels =
            (0..self.depth.height()).step_by(2).flat_map(|v| (0..self.depth.width()).step_by(2).map(move |u| (u, v)));
        let (mut positions, mut colors): (Vec<Point3<f32>>, Vec<[u8; 3]>) = Default::default();
        for (u, v) in pixels.filter(|(u, v)| self.depth.at(*u, *v) > 0.0) {
            let ray = camera.ray(u as f64, v as f64);
            positions.push(Point3::from(ray.coords * f64::from(self.depth.at(u, v))).cast());
            colors.push(self.color.as_ref().map_or([0; 3], |c| c.at(u, v)));
        }
        KeyframeScan {
            stamp: Timestamp(0),
            sensor: SensorId::from("camera"),
            t_base_sensor: se3::from_xy_yaw(0.0, 0.0, 0.0),
            base_height_m: 0.0,
            hits: PointCloud { colors: Some(colors), ..PointCloud::from_positions(positions) },
            misses: vec![],
            planar: false,
            features: None,
        }
    }
}

fn arguments() -> Result<Args, Failure> {
    let usage = "usage: surface DIR [--every N] [--voxel METRES] [--ply FILE]";
    let mut given = std::env::args().skip(1);
    let dir = given.next().ok_or(usage)?.into();
    let mut args = Args { dir, every: 5, voxel_size_m: 0.02, ply: None };
    while let Some(name) = given.next() {
        let value = given.next().ok_or(usage)?;
        match name.as_str() {
            "--every" => args.every = value.parse::<usize>()?.max(1),
            "--voxel" => args.voxel_size_m = value.parse()?,
            "--ply" => args.ply = Some(value.into()),
            _ => return Err(usage.into()),
        }
    }
    Ok(args)
}

fn camera(path: &Path) -> Result<CameraIntrinsics, Failure> {
    let k = numbers(path, 9)?;
    Ok(CameraIntrinsics::pinhole(640, 480, k[0], k[4], k[2], k[5]))
}

fn numbers(path: &Path, count: usize) -> Result<Vec<f64>, Failure> {
    let text = std::fs::read_to_string(path)?;
    let found: Vec<f64> = text.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
    if found.len() == count { Ok(found) } else { Err(format!("{}: not {count} numbers", path.display()).into()) }
}

/// What this process has taken of the processor, milliseconds.
fn processor_ms() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 * 1e-6
}

/// The median, and the least: a machine that others use too makes rounds longer, never shorter.
fn told(mut values: Vec<f64>) -> String {
    values.sort_by(f64::total_cmp);
    let at = |i: usize| values.get(i).copied().unwrap_or(f64::NAN);
    format!("{:.2} (least {:.2})", at(values.len() / 2), at(0))
}

/// Binary PLY with normals and colours.
fn write_ply(path: &Path, mesh: &MeshData) -> Result<(), Failure> {
    let mut out = std::io::BufWriter::new(std::fs::File::create(path)?);
    write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", mesh.positions.len())?;
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        writeln!(out, "property float {name}")?;
    }
    for name in ["red", "green", "blue"] {
        writeln!(out, "property uchar {name}")?;
    }
    let faces = mesh.triangles.len();
    write!(out, "element face {faces}\nproperty list uchar uint vertex_indices\nend_header\n")?;
    for ((p, n), color) in mesh.positions.iter().zip(&mesh.normals).zip(&mesh.colors) {
        for v in p.iter().chain(n.iter()) {
            out.write_all(&v.to_le_bytes())?;
        }
        out.write_all(color)?;
    }
    for triangle in &mesh.triangles {
        out.write_all(&[3])?;
        for vertex in triangle {
            out.write_all(&vertex.to_le_bytes())?;
        }
    }
    Ok(out.flush()?)
}
