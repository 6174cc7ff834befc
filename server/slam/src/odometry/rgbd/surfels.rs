//! The local model: surfels, rendered at a predicted view and fused with each placed frame.
//!
//! Source: Keller et al., "Real-time 3D reconstruction in dynamic scenes using point-based fusion", 2013.
//! We depart from it in rendering: surfels of one surface that fall on one pixel are averaged by weight,
//! since taking the nearest would pull the surface towards the camera by its noise.

use super::frame::{Frame, Rigid32, Vertex, pixel};
use super::noise::sigma;
use super::photometric::{MIN_CONTRAST, TexturedPoint};
use crate::color_camera::ColorCamera;
use crate::odometry::way_m;
use nalgebra::Vector3;
use percept_geometry::{CameraIntrinsics, Pose};
use rayon::prelude::*;

const NONE: u32 = u32::MAX;
/// Surfels a task: fixed, so that the number of threads changes nothing.
const CHUNK: usize = 8192;
/// A surface is established with so many frames' weight. `evaluate rgbd rgbd-7scenes-a`: ATE halved, doubled and as it
/// is 22.6 mm.
const ESTABLISHED: f32 = 4.0;
/// Frames in a row after which what stands in front of a surface counts as the scene: some seconds. Four seconds at 15
/// Hz; halved and doubled make no difference to `evaluate rgbd`.
const PATIENCE: u16 = 60;

/// A small disc of surface in odom.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surfel {
    pub(crate) p: Vector3<f32>,
    pub(crate) n: Vector3<f32>,
    /// Sum of the measurements' weights, capped.
    pub(crate) weight: f32,
    /// Motion travelled when last measured, metres.
    pub(crate) last_seen: f32,
    /// As [`super::intensity`] has it; NaN if not seen in colour.
    pub(crate) intensity: f32,
    /// The kept frame that it was last measured with: it moves with that.
    anchor: u32,
    /// Frames in a row in which something stood in front of it.
    covered: u16,
}

/// The model as a camera at `t_odom_view` sees it.
#[derive(Debug, Default)]
pub(crate) struct View {
    pub(crate) t_odom_view: Pose,
    /// In the view's frame.
    pub(crate) vertices: Vec<Vertex>,
    /// Those of its surfels that fix motion by their brightness.
    pub(crate) textured: Vec<TexturedPoint>,
    /// The heaviest surfel's place and brightness.
    lights: Vec<TexturedPoint>,
    /// Heaviest surfel of the pixel.
    index: Vec<u32>,
    nearest: Vec<f32>,
    weight: Vec<f32>,
    projected: Vec<(u32, f32)>,
}

/// How surfels are fused and forgotten; see [`super::RgbdParams`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct FusionLimits {
    pub(crate) max_weight: f32,
    pub(crate) window: f32,
    pub(crate) max_surfels: usize,
}

impl View {
    /// Bytes, about.
    pub(crate) fn memory_bytes(&self) -> usize {
        let pixels = self.index.capacity() * (size_of::<u32>() + 2 * size_of::<f32>());
        let points = (self.textured.capacity() + self.lights.capacity()) * size_of::<TexturedPoint>();
        self.vertices.capacity() * size_of::<Vertex>() + pixels + points
    }

    /// A view that is a frame of its own: nothing is fused with it.
    pub(crate) fn of(t_odom_view: Pose, vertices: Vec<Vertex>, textured: Vec<TexturedPoint>) -> Self {
        Self { t_odom_view, vertices, textured, ..Self::default() }
    }

    /// Whether a pixel's surface was seen in several frames.
    #[inline]
    pub(crate) fn is_established(&self, pixel: usize) -> bool {
        let z = self.vertices[pixel].p.z;
        z > 0.0 && self.weight[pixel] >= ESTABLISHED * surfel_weight(z)
    }

    /// Points whose brightness differs from the next pixel's on the same surface.
    fn find_texture(&mut self, width: usize) {
        self.textured.clear();
        for i in 0..self.lights.len().saturating_sub(width) {
            let here = &self.lights[i];
            if here.intensity.is_nan() || self.vertices[i].p.z <= 0.0 {
                continue;
            }
            let step = |there: &TexturedPoint| {
                let same = (there.p.z - here.p.z).abs() < 0.05 * here.p.z;
                if same { (there.intensity - here.intensity).abs() } else { f32::NAN }
            };
            let (right, below) = (step(&self.lights[i + 1]), step(&self.lights[i + width]));
            if right.max(below) > MIN_CONTRAST && !right.is_nan() && !below.is_nan() {
                self.textured.push(*here);
            }
        }
    }
}

/// The frame that is fused.
struct Live<'a> {
    frame: &'a Frame,
    color: &'a ColorCamera,
    to_odom: Rigid32,
    to_view: Rigid32,
    to_camera: Rigid32,
}

/// Brightness of a point of the camera's frame; NaN where there is none.
#[inline]
fn light(frame: &Frame, color: &ColorCamera, p: &Vector3<f32>) -> f32 {
    if frame.intensity.is_empty() || p.z <= 0.1 {
        return f32::NAN;
    }
    let (u, v) = color.project(p);
    frame.intensity.sample(u, v).map_or(f32::NAN, |s| s.value)
}

#[derive(Debug, Default)]
pub(crate) struct Surfels {
    surfels: Vec<Surfel>,
    /// Motion travelled, metres: translation plus half a metre a radian.
    travelled: f32,
    last_pose: Option<Pose>,
    anchor: u32,
}

impl Surfels {
    /// Bytes.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.surfels.capacity() * size_of::<Surfel>()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.surfels.is_empty()
    }

    pub(crate) fn clear(&mut self) {
        self.surfels.clear();
        self.last_pose = None;
    }

    /// Forgets brightness: it was looked up with a camera that turned out wrong.
    pub(crate) fn forget_light(&mut self) {
        self.surfels.iter_mut().for_each(|s| s.intensity = f32::NAN);
    }

    /// Renders into `view` with a pinhole at `t_odom_view`.
    pub(crate) fn render(&self, camera: &CameraIntrinsics, t_odom_view: &Pose, view: &mut View) {
        let num_pixels = camera.width * camera.height;
        view.t_odom_view = *t_odom_view;
        view.vertices.clear();
        view.vertices.resize(num_pixels, Vertex::default());
        view.index.clear();
        view.index.resize(num_pixels, NONE);
        view.nearest.clear();
        view.nearest.resize(num_pixels, f32::INFINITY);
        view.weight.clear();
        view.weight.resize(num_pixels, 0.0);
        view.lights.clear();
        view.lights.resize(num_pixels, TexturedPoint { p: Vector3::zeros(), intensity: f32::NAN });
        let t_view_odom = Rigid32::from(&t_odom_view.inverse());
        self.project(camera, &t_view_odom, &mut view.projected);
        for &(pixel, z) in &view.projected {
            if pixel != NONE {
                let nearest = &mut view.nearest[pixel as usize];
                *nearest = nearest.min(z);
            }
        }
        let mut heaviest = vec![0f32; num_pixels];
        for (i, &(pixel, z)) in view.projected.iter().enumerate() {
            if pixel == NONE || z > view.nearest[pixel as usize] + 0.01 + 4.0 * sigma(z) {
                continue;
            }
            let (pixel, s) = (pixel as usize, &self.surfels[i]);
            let sum = &mut view.vertices[pixel];
            let p = t_view_odom.apply(&s.p);
            sum.p += p * s.weight;
            sum.n += t_view_odom.r * s.n * s.weight;
            view.weight[pixel] += s.weight;
            if s.weight > heaviest[pixel] {
                heaviest[pixel] = s.weight;
                view.index[pixel] = i as u32;
                view.lights[pixel] = TexturedPoint { p, intensity: s.intensity };
            }
        }
        for (v, &w) in view.vertices.iter_mut().zip(&view.weight) {
            if w > 0.0 {
                v.p /= w;
                let norm = v.n.norm();
                // Surfaces that face apart met in this pixel: an edge, of no use as a plane.
                *v = if norm > 0.7 * w { Vertex { n: v.n / norm, p: v.p } } else { Vertex::default() };
            }
        }
        view.find_texture(camera.width);
    }

    /// Pixel and depth of every surfel that faces the view and lies in it.
    fn project(&self, camera: &CameraIntrinsics, t_view_odom: &Rigid32, out: &mut Vec<(u32, f32)>) {
        let (fx, fy) = (camera.fx as f32, camera.fy as f32);
        let (cx, cy) = (camera.cx as f32 + 0.5, camera.cy as f32 + 0.5);
        let (width, height) = (camera.width as f32, camera.height as f32);
        out.clear();
        out.resize(self.surfels.len(), (NONE, 0.0));
        out.par_chunks_mut(CHUNK).zip(self.surfels.par_chunks(CHUNK)).for_each(|(out, surfels)| {
            for (o, s) in out.iter_mut().zip(surfels) {
                let p = t_view_odom.apply(&s.p);
                if p.z < 0.1 || (t_view_odom.r * s.n).dot(&p) >= 0.0 {
                    continue;
                }
                let (u, v) = (fx * p.x / p.z + cx, fy * p.y / p.z + cy);
                if u >= 0.0 && v >= 0.0 && u < width && v < height {
                    *o = (v as u32 * camera.width as u32 + u as u32, p.z);
                }
            }
        });
    }

    /// Adds a frame taken at `t_odom_camera`, with the view rendered before it was placed.
    pub(crate) fn fuse(
        &mut self,
        frame: &Frame,
        t_odom_camera: &Pose,
        view: Option<(&View, &CameraIntrinsics)>,
        color: &ColorCamera,
        limits: &FusionLimits,
    ) {
        self.travel(t_odom_camera);
        let to_odom = Rigid32::from(t_odom_camera);
        match view {
            None => {
                let new = frame.vertices.iter().filter(|v| v.p.z > 0.0);
                let seen = self.now();
                self.surfels.extend(new.map(|v| surfel(v, &to_odom, seen, light(frame, color, &v.p))));
            }
            Some((view, camera)) => {
                let to_view = Rigid32::from(&(view.t_odom_view.inverse() * t_odom_camera));
                let to_camera = Rigid32::from(&t_odom_camera.inverse());
                let live = Live { frame, color, to_odom, to_view, to_camera };
                for v in frame.vertices.iter().filter(|v| v.p.z > 0.0) {
                    self.fuse_vertex(v, &live, view, camera, limits);
                }
            }
        }
        self.forget(limits);
    }

    fn fuse_vertex(
        &mut self,
        v: &Vertex,
        live: &Live<'_>,
        view: &View,
        camera: &CameraIntrinsics,
        limits: &FusionLimits,
    ) {
        let q = live.to_view.apply(&v.p);
        let index = match pixel(camera, &q) {
            Some(pixel) => view.index[pixel],
            None => NONE,
        };
        let now = self.now();
        let measured = |light| surfel(v, &live.to_odom, now, light);
        if index == NONE {
            self.surfels.push(measured(light(live.frame, live.color, &v.p)));
            return;
        }
        let measured = measured(f32::NAN);
        let s = &mut self.surfels[index as usize];
        let gate = 0.015 + 4.0 * sigma(v.p.z);
        // Along the line of sight: positive if the model lies in front of what the frame sees.
        let sight = (live.to_odom.r * v.p).normalize();
        let behind = sight.dot(&(measured.p - s.p));
        if behind.abs() < gate && s.n.dot(&measured.n) > 0.5 {
            let share = measured.weight / (s.weight + measured.weight);
            // Along the normal only, so that surfels do not drift over the surface.
            s.p += s.n * (share * s.n.dot(&(measured.p - s.p)));
            s.n = (s.n + (measured.n - s.n) * share).normalize();
            // Looked up where the surfel is, not where the frame measured: brightness must not smear.
            let light = light(live.frame, live.color, &live.to_camera.apply(&s.p));
            s.intensity = if s.intensity.is_nan() || light.is_nan() {
                s.intensity.max(light)
            } else {
                s.intensity + (light - s.intensity) * share
            };
            s.weight = (s.weight + measured.weight).min(limits.max_weight);
            s.last_seen = measured.last_seen;
            // It now is where the newest views have it.
            s.anchor = measured.anchor;
            s.covered = 0;
        } else if behind > 3.0 * gate {
            // Seen through: it has moved away.
            s.weight -= 3.0 * surfel_weight(live.to_camera.apply(&s.p).z);
        } else if behind < -gate {
            let light = light(live.frame, live.color, &v.p);
            self.surfels.push(Surfel { intensity: light, ..measured });
        }
    }

    /// Adds surfels as they are, for a start from keyframes.
    pub(crate) fn insert(&mut self, vertices: &[Vertex], t_odom_camera: &Pose) {
        self.travel(t_odom_camera);
        let to_odom = Rigid32::from(t_odom_camera);
        let seen = self.now();
        self.surfels.extend(vertices.iter().filter(|v| v.p.z > 0.0).map(|v| surfel(v, &to_odom, seen, f32::NAN)));
    }

    /// What is measured from now on moves with this kept frame.
    pub(crate) fn anchor_to(&mut self, anchor: u32) {
        self.anchor = anchor;
    }

    /// Moves the surfels with the kept frames that they were last measured with; `moved` by rising number, in odom.
    pub(crate) fn follow(&mut self, moved: &[(u32, Pose)]) {
        let Some(first) = moved.first().map(|m| m.0) else { return };
        let moved: Vec<Rigid32> = moved.iter().map(|m| Rigid32::from(&m.1)).collect();
        self.surfels.par_chunks_mut(CHUNK).flatten().for_each(|s| {
            if let Some(t) = s.anchor.checked_sub(first).and_then(|k| moved.get(k as usize)) {
                s.p = t.apply(&s.p);
                s.n = t.r * s.n;
            }
        });
    }

    /// When and with what something is seen now.
    fn now(&self) -> (f32, u32) {
        (self.travelled, self.anchor)
    }

    /// Something stands in front of what these pixels of the view show: after a while it is what is there.
    pub(crate) fn cover(&mut self, view: &View, pixels: &[u32]) {
        for &pixel in pixels {
            let Some(s) = self.surfels.get_mut(view.index[pixel as usize] as usize) else { continue };
            s.covered += 1;
            if s.covered > PATIENCE {
                s.weight = 0.0;
            }
        }
    }

    fn travel(&mut self, t_odom_camera: &Pose) {
        if let Some(last) = self.last_pose {
            let t_last_now = last.inverse() * t_odom_camera;
            self.travelled += way_m(t_last_now.translation.vector.norm(), t_last_now.rotation.angle()) as f32;
        }
        self.last_pose = Some(*t_odom_camera);
    }

    /// Drops what was seen through, not seen for long, or seen once in passing.
    fn forget(&mut self, limits: &FusionLimits) {
        let now = self.travelled;
        let full = self.surfels.len() > limits.max_surfels;
        let window = if full { self.window_for(limits.max_surfels * 4 / 5) } else { limits.window };
        self.surfels.retain(|s| {
            let age = now - s.last_seen;
            s.weight > 0.0 && age <= window && (age < 0.5 || s.weight > 2.0 * surfel_weight(1.0))
        });
    }

    /// The window that leaves about `count` surfels.
    fn window_for(&self, count: usize) -> f32 {
        let mut ages: Vec<f32> = self.surfels.iter().map(|s| self.travelled - s.last_seen).collect();
        let k = count.min(ages.len() - 1);
        *ages.select_nth_unstable_by(k, f32::total_cmp).1
    }
}

/// Weight of one measurement at depth `z`: 1 at one metre, by the inverse variance.
fn surfel_weight(z: f32) -> f32 {
    let s = sigma(1.0) / sigma(z);
    (s * s).min(4.0)
}

fn surfel(v: &Vertex, to_odom: &Rigid32, (last_seen, anchor): (f32, u32), intensity: f32) -> Surfel {
    Surfel {
        p: to_odom.apply(&v.p),
        n: to_odom.r * v.n,
        weight: surfel_weight(v.p.z),
        last_seen,
        intensity,
        anchor,
        covered: 0,
    }
}
