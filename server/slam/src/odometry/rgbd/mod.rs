//! Depth cameras: each frame is placed in a model of surfels, then fused into it.
//!
//! Image to vertices ([`frame`]) and brightness ([`intensity`]), model to view ([`surfels`]), frame to view by depth
//! ([`mod@align`]) and brightness ([`photometric`]) at once. Depth slides along smooth surfaces and brightness does not;
//! colour that was not registered to depth is ([`color_registration`]).

mod align;
mod color_registration;
mod found;
mod frame;
mod intensity;
mod moving;
mod noise;
mod photometric;
pub(crate) mod place;
mod surfels;
pub(crate) mod window;

use crate::color_camera::ColorCamera;
use crate::inertial::PoseFactor;
use crate::odometry::{After, Found, LocalModel, Prediction, Registration};
use crate::param_error::{ParamError, check_range};
use crate::scan::Scan;
use crate::tracking::LostReason;
use align::{LEVELS, Problem, Requirements, align};
use color_registration::ColorRegistration;
pub(crate) use found::ViewFound;
use frame::{Frame, Preparer, Vertex};
use moving::Moving;
use nalgebra::{Point3, Vector6};
use percept_geometry::{CameraIntrinsics, Covariance6, KeyframeScan, Pose, se3};
use photometric::{MIN_POINTS, Photometric};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use surfels::{FusionLimits, Surfels, View};
use window::{Placed, Window, unit};

/// Parameters of depth odometry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RgbdParams {
    /// Nearer depth is not used, metres, 0 to 10.
    pub min_depth_m: f64,
    /// Farther depth is not used, metres, 0.5 to 100; its noise grows with the square.
    pub max_depth_m: f64,
    /// The image is shrunk by an integer to at most so many columns, 40 to 1280. More: finer and slower.
    pub max_width_px: usize,
    /// Fewest usable pixels of the shrunk image, as a share, 0.001 to 1.
    pub min_valid_ratio: f64,
    /// Least share of the usable pixels that must meet the model, 0.01 to 1.
    pub min_overlap_ratio: f64,
    /// Least mean weight of those that meet it, 0.05 to 1.
    pub min_inlier_ratio: f64,
    /// Largest correction of a prediction, metres, 0.01 to 10.
    pub max_correction_m: f64,
    /// Largest correction of a prediction, radians, 0.01 to 3.
    pub max_correction_rad: f64,
    /// A surface counts at most so many measurements at 1 m, 1 to 10000. More: less noise, slower change.
    pub max_weight: f64,
    /// Surfaces not seen over so much motion are forgotten, metres (a radian of turning counts half a
    /// metre), 0.5 to 1000.
    pub window_m: f64,
    /// Most surfels in the model, 1e4 to 5e6.
    pub max_surfels: usize,
}

impl Default for RgbdParams {
    fn default() -> Self {
        Self {
            min_depth_m: 0.2,
            max_depth_m: 6.0,
            max_width_px: 320,
            min_valid_ratio: 0.02,
            min_overlap_ratio: 0.15,
            min_inlier_ratio: 0.4,
            max_correction_m: 0.5,
            max_correction_rad: 0.5,
            max_weight: 50.0,
            window_m: 10.0,
            max_surfels: 500_000,
        }
    }
}

impl RgbdParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`ParamError`] with field, value and remedy.
    pub fn validate(&self) -> Result<(), ParamError> {
        let (max, width) = (self.max_depth_m, self.max_width_px as f64);
        check_range("rgbd.min_depth_m", self.min_depth_m, (0.0, 10.0), "within 0 to 10", "use 0.2")?;
        check_range("rgbd.max_depth_m", max, (0.5, 100.0), "within 0.5 to 100", "use 6")?;
        check_range("rgbd.max_depth_m", max, (self.min_depth_m, 100.0), "above min_depth_m", "use 6")?;
        check_range("rgbd.max_width_px", width, (40.0, 1280.0), "within 40 to 1280", "use 320")?;
        let ratios = [
            ("rgbd.min_valid_ratio", self.min_valid_ratio, "use 0.02"),
            ("rgbd.min_overlap_ratio", self.min_overlap_ratio, "use 0.15"),
            ("rgbd.min_inlier_ratio", self.min_inlier_ratio, "use 0.4"),
        ];
        for (field, value, remedy) in ratios {
            check_range(field, value, (0.001, 1.0), "within 0.001 to 1", remedy)?;
        }
        let (m, rad) = (self.max_correction_m, self.max_correction_rad);
        check_range("rgbd.max_correction_m", m, (0.01, 10.0), "within 0.01 to 10", "use 0.5")?;
        check_range("rgbd.max_correction_rad", rad, (0.01, 3.0), "within 0.01 to 3", "use 0.5")?;
        check_range("rgbd.max_weight", self.max_weight, (1.0, 1e4), "within 1 to 10000", "use 50")?;
        check_range("rgbd.window_m", self.window_m, (0.5, 1000.0), "within 0.5 to 1000", "use 10")?;
        let surfels = self.max_surfels as f64;
        check_range("rgbd.max_surfels", surfels, (1e4, 5e6), "within 1e4 to 5e6", "use 500000")
    }
}

/// With more of the frame moving than this share nothing says which part is the room. ATE of `evaluate rgbd
/// rgbd-7scenes-a 2`, where nothing moves, is 22.3 mm with times 0.7, with 0.99 and as it is.
const MAX_MOVING: f64 = 0.8;

/// A prediction surer than this leads to the right place, metres. ATE of `evaluate rgbd rgbd-7scenes-a 2` is 22.3 mm
/// halved, doubled and as it is.
const SURE_M: f64 = 0.05;
/// After a gap: least share of a frame that meets the model, and largest share of that which may contradict it. No run
/// here reaches them: ATE of `evaluate rgbd rgbd-7scenes-a 2`, which has no gap, is 22.3 mm halved, doubled and as it
/// is.
const MIN_MET: f64 = 0.3;
const MAX_WRONG_AFTER_GAP: f64 = 0.04;
/// The same where somebody says that it is there: as of planar lidars.
const MAX_WRONG_AFTER_WORD: f64 = 0.2;
/// And how its brightness has to go with the model's: another place's does not at all, the same one's mostly by nine
/// tenths. Halved and doubled as those before.
const MIN_ALIKE: f64 = 0.5;
/// Largest share of a frame found without one that may contradict the model. ATE of `evaluate rgbd rgbd-7scenes-a 2` is
/// 22.3 mm halved, doubled and as it is.
const MAX_WRONG: f64 = 0.1;

/// A keyframe to start from, waiting for the first frame to tell the camera.
type Pending = (Pose, Arc<KeyframeScan>);

/// The local model of a depth camera and its current frame.
pub(crate) struct Rgbd {
    params: RgbdParams,
    preparer: Preparer,
    frame: Arc<Frame>,
    surfels: Surfels,
    /// How the current frame was placed, once that is believed.
    placed: Option<Arc<ViewFound>>,
    t_base_camera: Pose,
    registration: ColorRegistration,
    /// Where colour was last compared with depth.
    t_odom_compared: Option<Pose>,
    pending: Vec<Pending>,
    window: Window,
}

impl Rgbd {
    pub(crate) fn new(params: RgbdParams) -> Self {
        Self {
            params,
            preparer: Preparer::default(),
            frame: Arc::default(),
            surfels: Surfels::default(),
            placed: None,
            t_base_camera: Pose::identity(),
            registration: ColorRegistration::default(),
            t_odom_compared: None,
            pending: vec![],
            window: Window::default(),
        }
    }

    /// Turns keyframes that wait into surfels, now that the camera is known.
    fn plant(&mut self) {
        let Some(camera) = self.preparer.pinhole else { return };
        for (t_odom_base, scan) in std::mem::take(&mut self.pending) {
            let t_sensor_base = scan.t_base_sensor.inverse();
            let coarse = camera.shrunk(2, true);
            let vertices = self::seed::vertices(&coarse, &scan, &t_sensor_base);
            self.surfels.insert(&vertices, &(t_odom_base * scan.t_base_sensor));
        }
    }

    /// Learns from the first views that differ where the colour camera is.
    fn compare_color(&mut self, t_odom_camera: &Pose) {
        let Some(camera) = self.preparer.pinhole else { return };
        let moved = self.t_odom_compared.is_none_or(|last| {
            let t = last.inverse() * t_odom_camera;
            t.translation.vector.norm() > 0.15 || t.rotation.angle() > 0.15
        });
        if !moved || !self.registration.wants_more() || self.frame.intensity.is_empty() {
            return;
        }
        self.t_odom_compared = Some(*t_odom_camera);
        let depth = (&self.preparer.rays[..], &self.preparer.inverse_depth[..]);
        if self.registration.add(&camera, depth, &self.frame.intensity) {
            self.surfels.forget_light();
            self.window.forget_light();
        }
    }

    /// Whether the frame was found from hardly any prediction and contradicts the model there: with enough freedom the
    /// surfaces of one place fit another's.
    fn is_guesswork(
        &self,
        camera: &CameraIntrinsics,
        view: &View,
        prediction: &Covariance6,
        t_odom_camera: &Pose,
    ) -> bool {
        let is_unsure = (0..3).any(|k| prediction[(k, k)] > SURE_M * SURE_M);
        let t_view_camera = view.t_odom_view.inv_mul(t_odom_camera);
        is_unsure && {
            let (wrong, all) = moving::contradictions(&self.frame, view, camera, &t_view_camera);
            wrong as f64 > MAX_WRONG * all as f64
        }
    }

    /// Where the frame is by what keeps still in it, `found` by all of it; and the frame with what moves marked.
    ///
    /// What moves may have taken the pose along, and then the room seems to move. So it is sought twice, as seen from the
    /// pose found and from the prediction, and the pose is taken by which less of the frame contradicts the model.
    fn without_moving(
        &self,
        camera: &CameraIntrinsics,
        view: &View,
        covariance: Covariance6,
        found: Registration,
    ) -> Result<(Registration, Arc<Frame>, Moving), LostReason> {
        let marked = |t_odom_camera: &Pose| {
            let t_view_camera = view.t_odom_view.inv_mul(t_odom_camera);
            let marked = moving::mark(&self.frame, view, camera, &t_view_camera);
            marked.map(|(frame, moving)| (Arc::new(frame), moving))
        };
        let unmarked = || (Arc::clone(&self.frame), Moving::default());
        if marked(&found.t_odom_base).is_none() {
            let (frame, moving) = unmarked();
            return Ok((found, frame, moving));
        }
        let mut best: Option<(usize, Registration)> = None;
        for start in [view.t_odom_view, found.t_odom_base] {
            let (still, _) = marked(&start).unwrap_or_else(unmarked);
            let Ok(first) = self.align(camera, &still, view, covariance) else { continue };
            let (still, _) = marked(&first.t_odom_base).unwrap_or_else(unmarked);
            let Ok(second) = self.align(camera, &still, view, covariance) else { continue };
            let t_view_camera = view.t_odom_view.inv_mul(&second.t_odom_base);
            let (wrong, _) = moving::contradictions(&self.frame, view, camera, &t_view_camera);
            if best.as_ref().is_none_or(|b| 2 * wrong < b.0) {
                best = Some((wrong, second));
            }
        }
        let (_, best) = best.ok_or(LostReason::ResidualTooLarge)?;
        let (frame, moving) = marked(&best.t_odom_base).unwrap_or_else(unmarked);
        Ok((best, frame, moving))
    }

    /// Places what is valid of a frame in the view, with the camera's covariance of the prediction.
    fn align(
        &self,
        camera: &CameraIntrinsics,
        frame: &Frame,
        view: &View,
        covariance: Covariance6,
    ) -> Result<Registration, LostReason> {
        align(&Problem {
            frame,
            view,
            camera,
            start: Pose::identity(),
            photometric: Some(self.photometric(camera, view))
                .filter(|_| self.is_lit() && view.textured.len() > MIN_POINTS),
            covariance,
            r_base_camera: *self.t_base_camera.rotation.to_rotation_matrix().matrix(),
            requirements: Requirements {
                min_overlap: self.params.min_overlap_ratio,
                min_inlier_ratio: self.params.min_inlier_ratio,
                max_correction: (self.params.max_correction_m, self.params.max_correction_rad),
            },
            levels: &LEVELS,
            pixels_each: 1.0,
        })
    }

    /// The brightness of the model's view against the frame's.
    fn photometric<'a>(&'a self, camera: &CameraIntrinsics, view: &'a View) -> Photometric<'a> {
        let color = self.registration.camera(camera);
        Photometric { intensity: &self.frame.intensity, color, points: &view.textured }
    }

    /// Whether the frame came with an image that shows something.
    fn is_lit(&self) -> bool {
        !self.frame.intensity.is_empty()
    }

    fn limits(&self) -> FusionLimits {
        FusionLimits {
            max_weight: self.params.max_weight as f32,
            window: self.params.window_m as f32,
            max_surfels: self.params.max_surfels,
        }
    }
}

impl LocalModel for Rgbd {
    fn prepare(&mut self, scan: &Scan, _velocity: &Vector6<f64>) -> Result<(), LostReason> {
        let Scan::Depth(scan) = scan else { return Err(LostReason::UnsuitableScan) };
        self.placed = None;
        self.t_base_camera = scan.t_base_sensor;
        let depth = (self.params.min_depth_m as f32, self.params.max_depth_m as f32);
        self.preparer.prepare(scan, self.params.max_width_px, depth, Arc::make_mut(&mut self.frame));
        self.plant();
        let needed = self.params.min_valid_ratio * self.frame.vertices.len() as f64;
        if (self.frame.num_valid as f64) < needed.max(200.0) { Err(LostReason::TooFewPoints) } else { Ok(()) }
    }

    fn is_empty(&self) -> bool {
        self.surfels.is_empty()
    }

    fn register(&self, prediction: &Prediction) -> Result<Registration, LostReason> {
        let Some(camera) = self.preparer.pinhole else { return Err(LostReason::TooFewPoints) };
        let mut view = View::default();
        self.surfels.render(&camera, &(prediction.t_odom_base * self.t_base_camera), &mut view);
        // The prediction's covariance in the camera: exp(xi_base) t_base_camera = t_base_camera exp(xi_camera).
        let ad = se3::adjoint(&self.t_base_camera.inverse());
        let covariance = ad * prediction.covariance * ad.transpose();
        let placed = self.align(&camera, &self.frame, &view, covariance)?;
        let (placed, frame, moving) = self.without_moving(&camera, &view, covariance, placed)?;
        let is_guesswork = || self.is_guesswork(&camera, &view, &prediction.covariance, &placed.t_odom_base);
        if moving.share > MAX_MOVING || is_guesswork() {
            return Err(LostReason::ResidualTooLarge);
        }
        let back = se3::adjoint(&self.t_base_camera);
        let found = ViewFound { view, frame, moving, covariance: placed.covariance };
        let placed = Registration {
            t_odom_base: placed.t_odom_base * self.t_base_camera.inverse(),
            covariance: back * placed.covariance * back.transpose(),
            found: Found::View(Arc::new(found)),
            ..placed
        };
        Ok(Registration { told: by_itself(&placed, prediction), ..placed })
    }

    fn believe(&mut self, placed: &Registration, _t_odom_expected: &Pose) {
        if let Found::View(found) = &placed.found {
            self.placed = Some(Arc::clone(found));
        }
    }

    fn is_certain(&self, placed: &Registration, after: After) -> bool {
        let (Some(camera), Found::View(found)) = (self.preparer.pinhole, &placed.found) else { return false };
        let ViewFound { view, frame, .. } = &**found;
        let t_view_camera = view.t_odom_view.inv_mul(&(placed.t_odom_base * self.t_base_camera));
        let (wrong, all) = moving::contradictions(frame, view, &camera, &t_view_camera);
        let valid = frame.num_valid as f64;
        let most = if after == After::Word { MAX_WRONG_AFTER_WORD } else { MAX_WRONG_AFTER_GAP };
        // Bare surfaces of one room fit another's, as they are and turned about.
        let looks_alike = || self.photometric(&camera, view).correlation(frame, &camera, &t_view_camera);
        all as f64 > MIN_MET * valid
            && (wrong as f64) < most * all as f64
            && (!self.is_lit() || looks_alike().is_some_and(|c| c > MIN_ALIKE))
    }

    fn integrate(&mut self, t_odom_base: &Pose) {
        let limits = self.limits();
        let t_odom_camera = t_odom_base * self.t_base_camera;
        self.compare_color(&t_odom_camera);
        let Some(camera) = self.preparer.pinhole else { return };
        let color = self.registration.camera(&camera);
        let placed = self.placed.as_deref();
        if let Some(placed) = placed {
            self.surfels.cover(&placed.view, &placed.moving.covered);
        }
        let frame = placed.map_or(&self.frame, |placed| &placed.frame);
        self.surfels.fuse(frame, &t_odom_camera, placed.map(|p| (&p.view, &camera)), &color, &limits);
    }

    fn refine(&mut self, t_odom_base: &Pose) -> Option<Pose> {
        let camera = self.preparer.pinhole?;
        let t_odom_camera = t_odom_base * self.t_base_camera;
        let color = self.registration.camera(&camera);
        let found = self.placed.as_deref()?;
        let placed =
            Placed { frame: &found.frame, camera: &camera, color, t_odom_camera, covariance: found.covariance };
        let moved = self.window.consider(&placed);
        self.surfels.follow(&moved);
        self.surfels.anchor_to(self.window.newest());
        moved.last().map(|(_, t)| unit(t * t_odom_base))
    }

    fn color_camera(&self) -> Option<ColorCamera> {
        let camera = self.preparer.pinhole?;
        Some(self.registration.camera(&camera).enlarged(self.preparer.factor as f32))
    }

    fn memory_bytes(&self) -> usize {
        let frame = self.frame.memory_bytes();
        self.surfels.memory_bytes() + self.window.memory_bytes() + 2 * frame
    }

    fn clear(&mut self) {
        self.surfels.clear();
        self.pending.clear();
        self.window.clear();
        self.placed = None;
    }

    fn seed(&mut self, _t_odom_base_last: &Pose, recent: &[(Pose, Arc<KeyframeScan>)]) {
        self.pending = recent.iter().filter(|(_, k)| !k.planar).cloned().collect();
    }
}

/// What a frame told without what was predicted: the information that is there less the prediction's, and the pull against
/// which it held the pose. Where it told nothing rounding may leave less than nothing, which is cut off.
fn by_itself(found: &Registration, prediction: &Prediction) -> Option<PoseFactor> {
    let prior = prediction.covariance.try_inverse()?;
    let mut told = (found.covariance.try_inverse()? - prior).symmetric_eigen();
    told.eigenvalues.iter_mut().for_each(|v| *v = v.max(0.0));
    let pull = se3::log(&prediction.t_odom_base.inv_mul(&found.t_odom_base));
    Some(PoseFactor { t_odom_found: found.t_odom_base, information: told.recompose(), gradient: -(prior * pull) })
}

mod seed {
    //! Vertices from the thinned points of a keyframe: an image again, then plane fits.

    use super::frame::fit_grid;
    use super::{KeyframeScan, Point3, Pose, Vertex};
    use percept_geometry::CameraIntrinsics;

    pub(super) fn vertices(camera: &CameraIntrinsics, scan: &KeyframeScan, t_sensor_base: &Pose) -> Vec<Vertex> {
        let mut inverse_depth = vec![0f32; camera.width * camera.height];
        for p in &scan.hits.positions {
            let p: Point3<f64> = t_sensor_base * p.cast::<f64>();
            let Some(uv) = camera.project(&p) else { continue };
            let (u, v) = ((uv.x + 0.5).floor(), (uv.y + 0.5).floor());
            if u >= 0.0 && v >= 0.0 && (u as usize) < camera.width && (v as usize) < camera.height {
                let cell = &mut inverse_depth[v as usize * camera.width + u as usize];
                *cell = cell.max((1.0 / p.z) as f32);
            }
        }
        fit_grid(camera, &inverse_depth)
    }
}
