//! Voxels: a slice at a height, and cubes in space.

use super::View;
use super::camera::Camera;
use super::picture::Frame;
use super::raster::Tile;
use crate::canvas::PixelBox;
use crate::colors::{Scale, scaled};
use crate::map::{check_shape, grid_legend, open_grid};
use crate::sheet::{ColorBar, Sheet, in_metres};
use crate::{GridView, PictureError};
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{GridGeometry, RgbImage, Voxel};
use percept_mapping::VoxelBlock;
use std::collections::HashMap;

/// Voxels along an edge of a block.
const EDGE: i32 = 8;
/// From this on a voxel is occupied, per cent.
const OCCUPIED_FROM: i8 = 51;

fn check_size(voxel_size_m: f64) -> Result<(), PictureError> {
    if (1e-4..=1e4).contains(&voxel_size_m) {
        return Ok(());
    }
    let requirement = "between 1e-4 and 1e4";
    Err(PictureError::OutOfRange { field: "voxel_size_m", value: voxel_size_m, requirement })
}

/// The layer of voxels that holds a height (metres, map frame): occupied dark, free white, unknown bluish grey. Slices of the same blocks
/// at different heights show the same rectangle of the map.
///
/// # Errors
/// `OutOfRange` for a size or height that cannot be; `GridTooLarge` for blocks too far from each other.
pub fn voxels_slice(blocks: &[VoxelBlock], voxel_size_m: f64, z_m: f64, title: &str) -> Result<RgbImage, PictureError> {
    check_size(voxel_size_m)?;
    let Some(layer) = Voxel::containing(&Point3::new(0.0, 0.0, z_m), voxel_size_m).map(|v| i64::from(v.z)) else {
        return Err(PictureError::OutOfRange { field: "z_m", value: z_m, requirement: "a height of the map" });
    };
    let range = |axis: usize| {
        let keys = || blocks.iter().map(|b| i64::from(b.key[axis]));
        let (low, high) = (keys().min().unwrap_or(0), keys().max().unwrap_or(-1));
        (low * i64::from(EDGE), ((high - low + 1) * i64::from(EDGE)) as usize)
    };
    let ((x0, width), (y0, height)) = (range(0), range(1));
    let geometry = GridGeometry::new(voxel_size_m, Point2::new(x0 as f64, y0 as f64) * voxel_size_m);
    check_shape(&geometry, width, height, &[])?;
    let mut cells = vec![-1i8; width * height];
    for block in blocks {
        let at = |axis: usize| i64::from(block.key[axis]) * i64::from(EDGE);
        let z = layer - at(2);
        if !(0..i64::from(EDGE)).contains(&z) {
            continue;
        }
        let (column, row) = ((at(0) - x0) as usize, (at(1) - y0) as usize);
        for y in 0..EDGE as usize {
            let from = (z as usize * EDGE as usize + y) * EDGE as usize;
            let to = (row + y) * width + column;
            cells[to..to + EDGE as usize].copy_from_slice(&block.percent[from..from + EDGE as usize]);
        }
    }
    let grid = GridView { geometry, width, height, cells: &cells };
    let bottom = layer as f64 * voxel_size_m;
    let detail = format!("z from {bottom:.2} to {:.2} m", bottom + voxel_size_m);
    let sheet = Sheet { title: title.to_owned(), detail, legend: grid_legend(&grid), ..Sheet::default() };
    let (mut opened, window) = open_grid(&grid, sheet);
    opened.canvas.clip(None);
    opened.finish(&window);
    opened.canvas.into_image()
}

/// Occupied voxels as cubes, coloured by height; from above with [`View::above`].
///
/// # Errors
/// `OutOfRange` for a size or view that cannot be; `TooMuchOverdraw`.
pub fn voxels_view(
    blocks: &[VoxelBlock],
    voxel_size_m: f64,
    view: &View,
    title: &str,
) -> Result<RgbImage, PictureError> {
    check_size(voxel_size_m)?;
    let camera = view.camera()?;
    let cubes = visible(blocks, voxel_size_m, &camera);
    let half = 0.5 * voxel_size_m;
    let centers: Vec<Point3<f32>> = cubes.iter().map(|c| c.center).collect();
    // Their centres lie below the cut; what they reach above it belongs to them.
    let frame = Frame::around(view, &centers, half * 3f64.sqrt())?;
    let bar = ColorBar::over("height [m]", Scale::Viridis, frame.heights.into_iter());
    let faces = Face::seen(&camera, &frame, voxel_size_m);
    let reach = faces.iter().fold(Point2::new(0.0f64, 0.0), |sum, f| {
        Point2::new(sum.x + f.u[0].abs() + f.v[0].abs(), sum.y + f.u[1].abs() + f.v[1].abs())
    });
    let bounds = |i: usize| {
        let [x, y, _] = frame.pixel(&cubes[i].center).map(f64::from);
        let (x0, y0) = ((x - reach.x).floor() as i32 - 1, (y - reach.y).floor() as i32 - 1);
        let (x1, y1) = ((x + reach.x).ceil() as i32 + 1, (y + reach.y).ceil() as i32 + 1);
        Some(PixelBox { x0, y0, x1, y1 })
    };
    let mut raster = frame.raster();
    let draw = |i: usize, tile: &mut Tile| {
        let color = bar.color(f64::from(cubes[i].center.z));
        let center = frame.pixel(&cubes[i].center).map(f64::from);
        let seen = faces.iter().filter(|f| cubes[i].open & f.bit != 0);
        seen.for_each(|face| face.draw(center, scaled(color, face.shade), tile));
    };
    raster.draw(cubes.len(), bounds, draw)?;
    let sheet = Sheet { title: title.to_owned(), bar: Some(bar.clone()), ..Sheet::default() };
    let what = format!("{} voxels of {}", count(blocks), in_metres(voxel_size_m));
    frame.finish(sheet, &what, &raster, 0.8)
}

fn count(blocks: &[VoxelBlock]) -> usize {
    blocks.iter().map(|b| b.percent.iter().filter(|p| **p >= OCCUPIED_FROM).count()).sum()
}

struct Cube {
    center: Point3<f32>,
    /// Faces that no other cube covers: a bit for each of x, y, z.
    open: u8,
}

/// Occupied voxels below the cut of which the viewer may see a face.
fn visible(blocks: &[VoxelBlock], size: f64, camera: &Camera) -> Vec<Cube> {
    let by_key: HashMap<[i32; 3], &VoxelBlock> = blocks.iter().map(|b| (b.key, b)).collect();
    let towards = camera.ahead.map(|a| if a < 0.0 { 1 } else { -1 });
    let lies_below = |center: &Point3<f32>| camera.shows(center);
    let center = |block: &VoxelBlock, at: [i32; 3]| {
        let number = |i: usize| f64::from(block.key[i]) * f64::from(EDGE) + f64::from(at[i]) + 0.5;
        Point3::new((number(0) * size) as f32, (number(1) * size) as f32, (number(2) * size) as f32)
    };
    let is_occupied = |block: &VoxelBlock, at: [i32; 3]| {
        let place = (at[2] * EDGE + at[1]) * EDGE + at[0];
        block.percent[place as usize] >= OCCUPIED_FROM && lies_below(&center(block, at))
    };
    let covered = |block: &VoxelBlock, at: [i32; 3], axis: usize| {
        let mut next = at;
        next[axis] += towards[axis];
        if (0..EDGE).contains(&next[axis]) {
            return is_occupied(block, next);
        }
        let mut key = block.key;
        key[axis] = key[axis].saturating_add(towards[axis]);
        next[axis] = next[axis].rem_euclid(EDGE);
        key != block.key && by_key.get(&key).is_some_and(|other| is_occupied(other, next))
    };
    let mut out = vec![];
    for block in blocks {
        for place in 0..EDGE * EDGE * EDGE {
            let at = [place % EDGE, place / EDGE % EDGE, place / EDGE / EDGE];
            if is_occupied(block, at) {
                let open = (0..3).filter(|axis| !covered(block, at, *axis)).fold(0, |open, axis| open | 1 << axis);
                if open != 0 {
                    out.push(Cube { center: center(block, at), open });
                }
            }
        }
    }
    out
}

/// A face of all cubes: in parallel projection it looks alike everywhere.
struct Face {
    bit: u8,
    /// From the cube's centre to the face's, and its two halves of an edge: pixels right, pixels down, metres away.
    out: [f64; 3],
    u: [f64; 3],
    v: [f64; 3],
    shade: f64,
}

impl Face {
    /// Those that the viewer sees.
    fn seen(camera: &Camera, frame: &Frame, size: f64) -> Vec<Self> {
        let in_picture = |v: Vector3<f64>| {
            let at = camera.project(&Point3::from(v));
            [at.x * frame.per_metre, -at.y * frame.per_metre, at.z]
        };
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        let seen = (0..3).filter(|axis| camera.ahead[*axis].abs() > 1e-6);
        seen.map(|axis| {
            let towards = axes[axis] * (-camera.ahead[axis].signum() * 0.5 * size);
            Self {
                bit: 1 << axis,
                out: in_picture(towards),
                u: in_picture(axes[(axis + 1) % 3] * (0.5 * size)),
                v: in_picture(axes[(axis + 2) % 3] * (0.5 * size)),
                shade: [0.78, 0.6, 1.0][axis],
            }
        })
        .collect()
    }

    fn draw(&self, center: [f64; 3], color: [u8; 3], tile: &mut Tile) {
        let (u, v) = (&self.u, &self.v);
        let whole = u[0] * v[1] - u[1] * v[0];
        if whole.abs() < 1e-9 {
            return;
        }
        let middle = [center[0] + self.out[0], center[1] + self.out[1]];
        let reach = [u[0].abs() + v[0].abs(), u[1].abs() + v[1].abs()];
        let low = |i: usize| (middle[i] - reach[i] - 0.5).floor() as i32;
        let high = |i: usize| (middle[i] + reach[i] + 0.5).ceil() as i32;
        let part = tile.part(&PixelBox { x0: low(0), y0: low(1), x1: high(0), y1: high(1) });
        for y in part.y0..part.y1 {
            for x in part.x0..part.x1 {
                let d = [f64::from(x) + 0.5 - middle[0], f64::from(y) + 0.5 - middle[1]];
                let (s, t) = ((d[0] * v[1] - d[1] * v[0]) / whole, (u[0] * d[1] - u[1] * d[0]) / whole);
                if s.abs() <= 1.0001 && t.abs() <= 1.0001 {
                    tile.set(x, y, (center[2] + self.out[2] + s * u[2] + t * v[2]) as f32, || color);
                }
            }
        }
    }
}
