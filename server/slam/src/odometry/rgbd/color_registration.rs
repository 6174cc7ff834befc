//! Registration of a colour camera to the depth camera, from the images themselves.
//!
//! Many depth cameras are recorded without registering colour to depth: another focal length and a
//! baseline of a few centimetres put a surface's colour tens of pixels away. Where depth jumps there is
//! mostly an edge of brightness, too, so the camera under which most jumps fall on edges is the one
//! (Levinson and Thrun, "Automatic online calibration of cameras and lasers", 2013, section III).
//! Registered images stay as they are: another camera has to explain clearly more than chance finds among all that were
//! tried, since where everything has texture some camera always fits better (peak to sidelobe ratio: Bolme et al., "Visual
//! object tracking using adaptive correlation filters", 2010, section 3.5).

use super::intensity::Intensity;
use crate::color_camera::ColorCamera;
use nalgebra::Vector3;
use percept_geometry::CameraIntrinsics;

/// Frames whose edges are kept. ATE of `evaluate rgbd rgbd-7scenes-a 2`: halved 22.5, doubled 22.7 mm (22.3).
const MAX_FRAMES: usize = 8;
/// Edges kept of one frame. ATE of `evaluate rgbd rgbd-7scenes-a 2`: halved 22.4, doubled 22.3 mm (22.3).
const MAX_EDGES: usize = 400;
/// Fewest edges to judge by. ATE of `evaluate rgbd rgbd-7scenes-a 2` is 22.3 mm halved, doubled and as it is.
const MIN_EDGES: usize = 150;
/// Another camera must bring the edges more gradient than the one believed by so many standard deviations of all cameras
/// that were tried: sqrt(2 ln 3675), where the largest of 3,675 normal numbers lies. Recorded: 4.7 and more where colour
/// is not registered (`rgbd-7scenes-a`), -0.8 where it is; simulated: 0.8 and less, and in rooms with texture of 2 to 30 cm
/// 3.1 and less.
const CLEARLY: f32 = 4.05;

/// What one camera differs by from another.
#[derive(Debug, Clone, Copy)]
struct Change {
    scale: f32,
    du: f32,
    dv: f32,
    bx: f32,
}

impl Change {
    fn applied_to(&self, camera: &ColorCamera) -> ColorCamera {
        ColorCamera {
            fx: camera.fx * self.scale,
            fy: camera.fy * self.scale,
            cx: camera.cx + self.du,
            cy: camera.cy + self.dv,
            bx: camera.bx + self.bx,
        }
    }
}

/// One frame's jumps of depth, as points on the nearer surface, and its edges of brightness.
#[derive(Debug, Clone)]
struct Edges {
    points: Vec<Vector3<f32>>,
    width: usize,
    height: usize,
    /// Gradient, capped and smoothed, in units of its mean.
    wide: Vec<f32>,
    sharp: Vec<f32>,
}

/// Collects edges and keeps the colour camera that explains them.
#[derive(Debug, Clone, Default)]
pub(crate) struct ColorRegistration {
    frames: Vec<Edges>,
    camera: Option<ColorCamera>,
}

impl ColorRegistration {
    /// The camera as now believed.
    pub(crate) fn camera(&self, depth: &CameraIntrinsics) -> ColorCamera {
        self.camera.unwrap_or_else(|| ColorCamera::registered(depth))
    }

    /// Whether more frames would help.
    pub(crate) fn wants_more(&self) -> bool {
        self.frames.len() < MAX_FRAMES
    }

    /// Takes a frame's edges in; whether the camera moved by more than a pixel, so that what was seen
    /// with the old one is void. `inverse_depth` (1/m, 0 for none) along `rays` and `intensity` are on
    /// grids of one size.
    pub(crate) fn add(
        &mut self,
        depth: &CameraIntrinsics,
        (rays, inverse_depth): (&[[f32; 2]], &[f32]),
        intensity: &Intensity,
    ) -> bool {
        let edges = Edges::of(rays, inverse_depth, intensity);
        if edges.points.len() < 30 {
            return false;
        }
        self.frames.push(edges);
        if self.frames.iter().map(|f| f.points.len()).sum::<usize>() < MIN_EDGES {
            return false;
        }
        let before = self.camera(depth);
        // The search over everything is dear: with the first, second, fourth and eighth frame.
        if self.frames.len().is_power_of_two() {
            self.camera = self.search(depth);
        } else {
            self.camera = self.camera.map(|camera| self.refine(camera, 1.0));
        }
        let now = self.camera(depth);
        let half = (0.5 * (depth.width as f64 / depth.fx) as f32, 0.5 * (depth.height as f64 / depth.fy) as f32);
        shift_px(&now, &before, half) > 1.0
    }

    /// Mean gradient under the edges: sharp and wide.
    fn scores(&self, camera: &ColorCamera) -> (f32, f32) {
        let (mut sharp, mut wide, mut n) = (0f32, 0f32, 0usize);
        for f in &self.frames {
            for p in &f.points {
                let (u, v) = camera.project(p);
                let inside = u >= 0.0 && v >= 0.0 && u + 0.5 < f.width as f32 && v + 0.5 < f.height as f32;
                // What falls outside says nothing, so it counts as chance would.
                let i = inside.then(|| (v + 0.5) as usize * f.width + (u + 0.5) as usize);
                sharp += i.map_or(1.0, |i| f.sharp[i]);
                wide += i.map_or(1.0, |i| f.wide[i]);
            }
            n += f.points.len();
        }
        (sharp / n.max(1) as f32, wide / n.max(1) as f32)
    }

    /// The camera that explains clearly more than the depth's own, if one does: focal lengths from 3/4 to 4/3 of the
    /// depth's and offsets that cameras side by side have.
    fn search(&self, depth: &CameraIntrinsics) -> Option<ColorCamera> {
        let unmoved = ColorCamera::registered(depth);
        let step = depth.width as f32 / 80.0;
        let (at_unmoved, wide) = self.scores(&unmoved);
        let mut best = (wide, unmoved);
        let mut tried = Spread::default();
        for s in -7..=7 {
            for b in -3..=3 {
                for du in -3..=3 {
                    for dv in -2..=2 {
                        let change = Change {
                            scale: 1.04f32.powi(s),
                            du: du as f32 * step,
                            dv: dv as f32 * step,
                            bx: b as f32 * step,
                        };
                        let camera = change.applied_to(&unmoved);
                        let (sharp, wide) = self.scores(&camera);
                        tried.add(sharp);
                        if wide > best.0 {
                            best = (wide, camera);
                        }
                    }
                }
            }
        }
        let found = self.refine(self.refine(best.1, step), 1.0);
        (self.scores(&found).0 - at_unmoved > CLEARLY * tried.deviation()).then_some(found)
    }

    /// Climbs along the axes with halving steps.
    fn refine(&self, mut camera: ColorCamera, step: f32) -> ColorCamera {
        let mut best = self.scores(&camera).0;
        let mut step = step;
        while step > 0.2 {
            let mut moved = false;
            let none = Change { scale: 1.0, du: 0.0, dv: 0.0, bx: 0.0 };
            // At a depth of two metres a baseline is a shift: both are tried against each other, too.
            let changes = |s: f32| {
                [
                    Change { scale: 1.0 + 0.01 * s, ..none },
                    Change { du: s, ..none },
                    Change { dv: s, ..none },
                    Change { bx: 2.0 * s, ..none },
                    Change { du: s, bx: -2.0 * s, ..none },
                ]
            };
            for change in changes(step).into_iter().chain(changes(-step)) {
                let next = change.applied_to(&camera);
                let score = self.scores(&next).0;
                if score > best {
                    (best, camera, moved) = (score, next, true);
                }
            }
            if !moved {
                step *= 0.5;
            }
        }
        camera
    }
}

/// How far numbers lie apart.
#[derive(Debug, Default)]
struct Spread {
    n: f64,
    sum: f64,
    squares: f64,
}

impl Spread {
    fn add(&mut self, x: f32) {
        self.n += 1.0;
        self.sum += f64::from(x);
        self.squares += f64::from(x).powi(2);
    }

    fn deviation(&self) -> f32 {
        let mean = self.sum / self.n.max(1.0);
        (self.squares / self.n.max(1.0) - mean * mean).max(0.0).sqrt() as f32
    }
}

/// Largest shift of a point seen by both, pixels; `half` is the tangent of half the angle of view.
fn shift_px(camera: &ColorCamera, other: &ColorCamera, half: (f32, f32)) -> f32 {
    let corner = |c: &ColorCamera, z: f32| c.project(&Vector3::new(half.0 * z, half.1 * z, z));
    [1.0, 3.0]
        .into_iter()
        .map(|z| {
            let (a, b) = (corner(camera, z), corner(other, z));
            (a.0 - b.0).abs().max((a.1 - b.1).abs())
        })
        .fold(0.0, f32::max)
}

impl Edges {
    fn of(rays: &[[f32; 2]], inverse_depth: &[f32], intensity: &Intensity) -> Self {
        let (width, height) = (intensity.width, intensity.height);
        let mut points = jumps(rays, inverse_depth, width, height);
        let keep = points.len().div_ceil(MAX_EDGES).max(1);
        points = points.into_iter().step_by(keep).collect();
        let gradient = capped_gradient(intensity);
        let sharp = mean_of_square(&gradient, width, height, 1);
        let wide = mean_of_square(&gradient, width, height, width / 100);
        Self { points, width, height, wide, sharp }
    }
}

/// The nearer side of every jump between neighbours by more than 6 % of the depth.
fn jumps(rays: &[[f32; 2]], inverse_depth: &[f32], width: usize, height: usize) -> Vec<Vector3<f32>> {
    let mut out = vec![];
    for v in 1..height.saturating_sub(1) {
        for u in 1..width.saturating_sub(1) {
            let (i, here) = (v * width + u, inverse_depth[v * width + u]);
            for j in [i + 1, i + width] {
                let there = inverse_depth[j];
                let (near, far) = (here.max(there), here.min(there));
                if far > 0.0 && near > 1.06 * far {
                    let (a, b) = (rays[i], rays[j]);
                    out.push(Vector3::new(0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 1.0) / near);
                }
            }
        }
    }
    out
}

/// Norm of the gradient up to three times its mean, in units of its mean then.
fn capped_gradient(intensity: &Intensity) -> Vec<f32> {
    let (width, height, data) = (intensity.width, intensity.height, &intensity.data);
    let mut out = vec![0f32; width * height];
    for v in 1..height - 1 {
        for u in 1..width - 1 {
            let i = v * width + u;
            out[i] = (data[i + 1] - data[i - 1]).hypot(data[i + width] - data[i - width]);
        }
    }
    for _ in 0..2 {
        let mean = out.iter().sum::<f32>() / out.len().max(1) as f32;
        out.iter_mut().for_each(|g| *g = (*g / mean.max(1e-6)).min(3.0));
    }
    out
}

fn mean_of_square(from: &[f32], width: usize, height: usize, r: usize) -> Vec<f32> {
    let along = |from: &[f32], n: usize, stride: usize, lines: usize, next: usize| {
        let mut out = vec![0f32; from.len()];
        for line in 0..lines {
            for k in 0..n {
                let (a, b) = (k.saturating_sub(r), (k + r).min(n - 1));
                let sum: f32 = (a..=b).map(|x| from[line * next + x * stride]).sum();
                out[line * next + k * stride] = sum / (b + 1 - a) as f32;
            }
        }
        out
    };
    along(&along(from, width, 1, height, width), height, width, width, 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::RgbImage;

    const SIZE: (usize, usize) = (320, 240);

    fn lens() -> CameraIntrinsics {
        CameraIntrinsics::pinhole(SIZE.0, SIZE.1, 260.0, 260.0, 160.0, 120.0)
    }

    /// Numbers from 0 to 1, the same every time.
    struct Chance(u64);

    impl Chance {
        fn next(&mut self) -> f32 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 40) as f32 / (1u64 << 24) as f32
        }
    }

    /// Boards before a wall of 4 m, far to near: centre, half sizes, grey.
    fn boards(seed: u64) -> Vec<(Vector3<f32>, (f32, f32), f32)> {
        let mut chance = Chance(seed);
        let board = |k: usize| {
            let z = 3.5 - 0.08 * k as f32;
            let (x, y) = ((chance.next() - 0.5) * z, (chance.next() - 0.5) * 0.8 * z);
            let half = (0.1 + 0.2 * chance.next(), 0.1 + 0.2 * chance.next());
            (Vector3::new(x, y, z), half, 20.0 + 220.0 * chance.next())
        };
        (0..25).map(board).collect()
    }

    /// Rays, inverse depth and brightness: the board seen at each pixel, by `of` its number, point and grey.
    fn seen(
        seed: u64,
        color: &ColorCamera,
        grey: impl Fn(f32, &Vector3<f32>) -> f32,
    ) -> (Vec<[f32; 2]>, Vec<f32>, Intensity) {
        let boards = boards(seed);
        let rays: Vec<[f32; 2]> = (0..SIZE.0 * SIZE.1)
            .map(|i| [((i % SIZE.0) as f32 - 160.0) / 260.0, ((i / SIZE.0) as f32 - 120.0) / 260.0])
            .collect();
        let mut depth = vec![0.25; rays.len()];
        let mut image = vec![0f32; rays.len()];
        for (i, shade) in image.iter_mut().enumerate() {
            // Where the colour camera's ray meets a plane of depth z.
            let meets = |z: f32| {
                let (u, v) = ((i % SIZE.0) as f32, (i / SIZE.0) as f32);
                Vector3::new(((u - color.cx) * z - color.bx) / color.fx, (v - color.cy) * z / color.fy, z)
            };
            *shade = grey(90.0, &meets(4.0));
            for (at, half, own) in &boards {
                let inside = |p: Vector3<f32>| (p.x - at.x).abs() < half.0 && (p.y - at.y).abs() < half.1;
                if inside(Vector3::new(rays[i][0], rays[i][1], 1.0) * at.z) {
                    depth[i] = 1.0 / at.z;
                }
                if inside(meets(at.z)) {
                    *shade = grey(*own, &meets(at.z));
                }
            }
        }
        let rgb = image.iter().flat_map(|&x| [x as u8; 3]).collect();
        let mut intensity = Intensity::default();
        intensity.fill(&RgbImage::new(SIZE.0, SIZE.1, rgb).unwrap(), 1, SIZE, None);
        (rays, depth, intensity)
    }

    #[test]
    fn a_camera_beside_is_found_and_one_that_is_registered_stays() {
        let registered = ColorCamera::registered(&lens());
        let beside = Change { scale: 1.08, du: 5.0, dv: -4.0, bx: -7.0 }.applied_to(&registered);
        for truth in [beside, registered] {
            let mut registration = ColorRegistration::default();
            for seed in 1..=4 {
                let (rays, depth, intensity) = seen(seed, &truth, |own, _| own);
                registration.add(&lens(), (&rays, &depth), &intensity);
            }
            let off = shift_px(&registration.camera(&lens()), &truth, (0.5, 0.4));
            assert!(off < 2.0, "{off} px: {:?}", registration.camera(&lens()));
        }
    }

    #[test]
    fn texture_everywhere_moves_no_camera() {
        for cell_m in [0.02, 0.05, 0.1, 0.2] {
            let registered = ColorCamera::registered(&lens());
            let mut registration = ColorRegistration::default();
            for seed in 1..=4 {
                let blocks = |own: f32, p: &Vector3<f32>| {
                    let cell = p.map(|x| (x / cell_m).floor() as i64);
                    let mixed = (cell.x * 7_919 + cell.y * 104_729 + cell.z * 1_299_709 + own as i64)
                        .wrapping_mul(2_654_435_761);
                    40.0 + ((mixed >> 9) & 0x7F) as f32
                };
                let (rays, depth, intensity) = seen(seed, &registered, blocks);
                assert!(!registration.add(&lens(), (&rays, &depth), &intensity), "cells of {cell_m} m");
            }
        }
    }
}
