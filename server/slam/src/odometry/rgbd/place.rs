//! Whether two keyframes show one place: dense alignment of one to the surfaces of others, and what speaks against it.

use super::align::{LEVELS, Problem, Requirements, align};
use super::frame::{Frame, pixel};
use super::noise::sigma;
use super::surfels::{Surfels, View};
use super::{frame::Rigid32, seed};
use crate::odometry::Registration;
use nalgebra::Matrix3;
use percept_geometry::{CameraIntrinsics, Covariance6, KeyframeScan, Pose, se3};

/// The points of a keyframe are a grid about so wide again.
const WIDTH: usize = 160;

/// A keyframe aligned to others.
#[derive(Debug, Clone)]
pub(crate) struct Placed {
    /// Base of the keyframe in the frame that the others were given in.
    pub(crate) t_place_base: Pose,
    /// Right perturbation in base.
    pub(crate) covariance: Covariance6,
    /// Share of the keyframe's points that lie on surfaces of the others.
    pub(crate) inlier_ratio: f64,
    /// Of the points that meet others' surfaces along their ray, the share that lies well behind these: seen through.
    pub(crate) seen_through: f64,
    /// The same well in front: they hide what the others saw, or should have been seen by them.
    pub(crate) in_front: f64,
}

/// Aligns `scan` to `others` (base to place) from a first guess with its covariance (right perturbation in base).
/// None without features' camera, or if it does not fit.
pub(crate) fn place(
    others: &[(Pose, &KeyframeScan)],
    scan: &KeyframeScan,
    t_place_base: &Pose,
    covariance: &Covariance6,
) -> Option<Placed> {
    let full = scan.features.as_ref()?.camera;
    let camera = full.shrunk(full.width.div_ceil(WIDTH).max(1), true);
    let t_sensor_base = scan.t_base_sensor.inverse();
    let frame = Frame::of_vertices(camera.width, seed::vertices(&camera, scan, &t_sensor_base));
    if frame.num_valid < 500 {
        return None;
    }
    let mut surfels = Surfels::default();
    for (t_place_other, other) in others {
        let lens = other.features.as_ref().map_or(full, |f| f.camera);
        let lens = lens.shrunk(lens.width.div_ceil(WIDTH).max(1), true);
        let vertices = seed::vertices(&lens, other, &other.t_base_sensor.inverse());
        surfels.insert(&vertices, &(t_place_other * other.t_base_sensor));
    }
    let ad = se3::adjoint(&t_sensor_base);
    let mut view = View::default();
    surfels.render(&camera, &(t_place_base * scan.t_base_sensor), &mut view);
    let problem = Problem {
        frame: &frame,
        view: &view,
        camera: &camera,
        start: Pose::identity(),
        photometric: None,
        covariance: ad * covariance * ad.transpose(),
        r_base_camera: Matrix3::identity(),
        requirements: Requirements { min_overlap: 0.15, min_inlier_ratio: 0.4, max_correction: (0.3, 0.3) },
        levels: &LEVELS,
        pixels_each: 1.0,
    };
    let found = align(&problem).ok()?;
    Some(judged(&surfels, &frame, &camera, scan, found))
}

/// Renders at the pose found and counts what agrees with it and what does not.
fn judged(
    surfels: &Surfels,
    frame: &Frame,
    camera: &CameraIntrinsics,
    scan: &KeyframeScan,
    found: Registration,
) -> Placed {
    let mut view = View::default();
    surfels.render(camera, &found.t_odom_base, &mut view);
    let identity = Rigid32::from(&Pose::identity());
    let (mut met, mut through, mut front, mut on) = (0usize, 0usize, 0usize, 0usize);
    for v in frame.vertices.iter().filter(|v| v.p.z > 0.0) {
        let p = identity.apply(&v.p);
        let Some(model) = pixel(camera, &p).map(|i| &view.vertices[i]).filter(|m| m.p.z > 0.0) else { continue };
        let margin = 0.05 + 4.0 * sigma(p.z);
        met += 1;
        through += usize::from(model.p.z < p.z - 2.0 * margin);
        front += usize::from(model.p.z > p.z + 2.0 * margin);
        on += usize::from(model.n.dot(&(p - model.p)).abs() < margin);
    }
    let share = |n: usize| n as f64 / met.max(1) as f64;
    let back = se3::adjoint(&scan.t_base_sensor);
    Placed {
        t_place_base: found.t_odom_base * scan.t_base_sensor.inverse(),
        covariance: back * found.covariance * back.transpose(),
        inlier_ratio: on as f64 / frame.num_valid.max(1) as f64,
        seen_through: share(through),
        in_front: share(front),
    }
}
