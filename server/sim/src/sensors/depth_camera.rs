//! A structured-light depth camera with a colour image registered to it.

use super::raster::{Sample, render};
use super::{Scene, check_rate, check_share, mount};
use crate::rng::{Purpose, stream};
use crate::{SimError, check};
use percept_geometry::{
    CameraIntrinsics, DepthImage, Distortion, GeometryError, Pose, RgbImage, SensorData, SensorKind, SensorSpec,
};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// A depth camera and its faults.
///
/// Source of the noise: Nguyen, Izadi, Lovell, "Modeling Kinect sensor noise for improved 3D
/// reconstruction and tracking", 2012. Neighbouring pixels err independently, which real ones do not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthCameraParams {
    /// Images a second.
    pub rate_hz: f64,
    /// Intrinsics of both images; without distortion.
    pub intrinsics: CameraIntrinsics,
    /// Whether a colour image comes with the depth.
    pub color: bool,
    /// Whether depth comes at all: without, it is a mere camera, and `color` has to be there.
    pub depth: bool,
    /// Height of the camera over the floor, metres, 0.05 to 2.5.
    pub height_m: f64,
    /// How far from the robot's middle the camera sits, in the direction in which it looks, metres, -0.2 to 0.2.
    pub forward_m: f64,
    /// How far the camera looks down, radians, -1 to 1.
    pub pitch_rad: f64,
    /// Where it looks, radians from ahead to the left, -3.2 to 3.2.
    pub yaw_rad: f64,
    /// Nearest depth measured, metres.
    pub range_min_m: f64,
    /// Farthest depth measured, metres.
    pub range_max_m: f64,
    /// Factor on the standard deviation 0.0012 + 0.0019 (z - 0.4)^2 m; 0 for none.
    pub noise_scale: f64,
    /// Depths are multiples of this, metres; 0 for none.
    pub quantum_m: f64,
    /// Share of pixels without depth for no reason.
    pub dropout_rate: f64,
    /// Whether depth is lost or mixed at edges, and lost at grazing angles.
    pub edge_effects: bool,
    /// Distance of projector and camera, metres: what the projector cannot reach has no depth; 0 for none.
    pub baseline_m: f64,
    /// Standard deviation of colour, levels of 255.
    pub color_noise: f64,
}

impl Default for DepthCameraParams {
    fn default() -> Self {
        Self {
            rate_hz: 15.0,
            intrinsics: CameraIntrinsics::primesense(),
            color: true,
            depth: true,
            height_m: 0.6,
            forward_m: 0.1,
            pitch_rad: 0.12,
            yaw_rad: 0.0,
            range_min_m: 0.4,
            range_max_m: 8.0,
            noise_scale: 1.0,
            quantum_m: 0.001,
            dropout_rate: 0.002,
            edge_effects: true,
            baseline_m: 0.075,
            color_noise: 2.0,
        }
    }
}

impl DepthCameraParams {
    /// A camera without any fault, for tests of geometry.
    pub fn ideal() -> Self {
        Self {
            noise_scale: 0.0,
            quantum_m: 0.0,
            dropout_rate: 0.0,
            edge_effects: false,
            baseline_m: 0.0,
            color_noise: 0.0,
            ..Self::default()
        }
    }

    /// Standard deviation of depth straight on at `z` metres, metres. Eq. 2 of the source.
    pub fn sigma_m(&self, z: f64) -> f64 {
        self.noise_scale * (0.0012 + 0.0019 * (z - 0.4) * (z - 0.4))
    }

    /// What it is as a sensor, by what comes.
    pub(crate) fn kind(&self) -> SensorKind {
        match (self.depth, self.color) {
            (false, _) => SensorKind::Camera,
            (true, true) => SensorKind::Rgbd,
            (true, false) => SensorKind::Depth,
        }
    }

    /// Camera's optical frame to base.
    pub fn t_base_sensor(&self) -> Pose {
        let mut t = mount(self.forward_m, self.height_m, self.pitch_rad, self.yaw_rad);
        t.rotation *= SensorSpec::optical_rotation();
        t
    }

    /// Checks bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), SimError> {
        if !self.color && !self.depth {
            return Err(SimError::OutOfRange { field: "color", value: 0.0, requirement: "true without depth" });
        }
        check_rate(self.rate_hz)?;
        if let Err(GeometryError::OutOfRange { field, value, requirement }) = self.intrinsics.validate() {
            return Err(SimError::OutOfRange { field, value, requirement });
        }
        if self.intrinsics.distortion != Distortion::None {
            return Err(SimError::OutOfRange { field: "distortion", value: f64::NAN, requirement: "none" });
        }
        check("height_m", self.height_m, 0.05, 2.5, "between 0.05 and 2.5")?;
        check("forward_m", self.forward_m, -0.2, 0.2, "between -0.2 and 0.2")?;
        check("pitch_rad", self.pitch_rad, -1.0, 1.0, "between -1 and 1")?;
        check("yaw_rad", self.yaw_rad, -3.2, 3.2, "between -3.2 and 3.2")?;
        check("range_min_m", self.range_min_m, 0.0, 100.0, "between 0 and 100")?;
        check("range_max_m", self.range_max_m, self.range_min_m, 1000.0, "between range_min_m and 1000")?;
        check("noise_scale", self.noise_scale, 0.0, 100.0, "between 0 and 100")?;
        check("quantum_m", self.quantum_m, 0.0, 0.1, "between 0 and 0.1")?;
        check_share("dropout_rate", self.dropout_rate)?;
        check("baseline_m", self.baseline_m, 0.0, 0.5, "between 0 and 0.5")?;
        check("color_noise", self.color_noise, 0.0, 100.0, "between 0 and 100")
    }
}

/// The image number `frame`, taken at `t_s`, all pixels at once.
pub(crate) fn capture(
    params: &DepthCameraParams,
    scene: &Scene<'_>,
    frame: u64,
    t_s: f64,
) -> Result<SensorData, GeometryError> {
    let camera = &params.intrinsics;
    let t_world_optical = scene.drive.pose_at(t_s) * params.t_base_sensor();
    let samples = render(&scene.world.view(t_s), &t_world_optical, camera);
    let (width, height) = (camera.width, camera.height);
    let mut depth = vec![0f32; width * height];
    let mut color = vec![0u8; width * height * 3];
    depth.par_chunks_mut(width).zip(color.par_chunks_mut(3 * width)).enumerate().for_each(|(v, (depth, color))| {
        let mut rng = stream(scene.seed, Purpose::DepthCamera, frame, v as u64);
        let row = Row { samples: &samples, width, height, v };
        measure_row(params, &row, &mut rng, depth, color);
    });
    let depth = DepthImage::new(width, height, depth)?;
    match params.kind() {
        SensorKind::Camera => Ok(SensorData::Camera(RgbImage::new(width, height, color)?)),
        SensorKind::Rgbd => Ok(SensorData::Rgbd(depth, RgbImage::new(width, height, color)?)),
        _ => Ok(SensorData::Depth(depth)),
    }
}

/// A row of an image with its neighbours.
struct Row<'a> {
    samples: &'a [Sample],
    width: usize,
    height: usize,
    v: usize,
}

impl Row<'_> {
    fn at(&self, u: usize) -> &Sample {
        &self.samples[self.v * self.width + u]
    }

    /// The neighbour across a jump in depth, if the pixel lies at the edge of something.
    fn across_edge(&self, u: usize) -> Option<&Sample> {
        let here = self.at(u);
        let i = self.v * self.width + u;
        let is_edge = |j: usize| {
            let there = &self.samples[j];
            there.solid != here.solid && (there.depth - here.depth).abs() > 0.02 + 0.01 * here.depth
        };
        [
            (u > 0, i.wrapping_sub(1)),
            (u + 1 < self.width, i + 1),
            (self.v > 0, i.wrapping_sub(self.width)),
            (self.v + 1 < self.height, i + self.width),
        ]
        .into_iter()
        .find(|&(inside, j)| inside && is_edge(j))
        .map(|(_, j)| &self.samples[j])
    }

    /// Which pixels the projector, `baseline` to the right of the camera, does not light.
    fn shadow(&self, focal_baseline: f64) -> Vec<bool> {
        // Column in the projector's image, but for constants. A surface to the right that comes out at
        // a smaller column stands in the light's way.
        let mut leftmost = f64::INFINITY;
        let mut out = vec![false; self.width];
        for u in (0..self.width).rev() {
            let column = u as f64 - focal_baseline / f64::from(self.at(u).depth);
            out[u] = column > leftmost + 1.0;
            leftmost = leftmost.min(column);
        }
        out
    }
}

fn measure_row(params: &DepthCameraParams, row: &Row<'_>, rng: &mut impl Rng, depth: &mut [f32], color: &mut [u8]) {
    let shadow = (params.baseline_m > 0.0).then(|| row.shadow(params.baseline_m * params.intrinsics.fx));
    let dropped = (params.dropout_rate * 65536.0) as u64;
    // Two bytes added have a triangular density of this standard deviation.
    let color_scale = (params.color_noise / (2.0f64 * (65536.0 - 1.0) / 12.0).sqrt()) as f32;
    for u in 0..row.width {
        let sample = row.at(u);
        let bits = rng.next_u64();
        for c in 0..3 {
            let pair = (bits >> (16 * c) & 255) as f32 + (bits >> (16 * c + 8) & 255) as f32 - 255.0;
            color[3 * u + c] = (f32::from(sample.rgb[c]) + color_scale * pair + 0.5).clamp(0.0, 255.0) as u8;
        }
        let dark = shadow.as_ref().is_some_and(|s| s[u]);
        if bits >> 48 >= dropped && !dark {
            depth[u] = measure(params, row, u, rng);
        }
    }
}

/// Depth of one pixel, metres; 0 where there is none.
fn measure(params: &DepthCameraParams, row: &Row<'_>, u: usize, rng: &mut impl Rng) -> f32 {
    let sample = row.at(u);
    let mut z = f64::from(sample.depth);
    if params.edge_effects {
        if let Some(other) = row.across_edge(u) {
            // Figures by eye from Kinect recordings: about a third of edge pixels are lost, a seventh
            // hang between the surfaces, a quarter belong to the neighbour.
            match rng.random_range(0..100) {
                0..30 => return 0.0,
                30..45 if other.depth.is_finite() => z += rng.random_range(0.0..1.0) * (f64::from(other.depth) - z),
                45..70 => z = f64::from(other.depth),
                _ => {}
            }
        }
        // Below about 7 degrees to the surface the pattern smears; below 2 there is nothing.
        let grazing = (0.12 - f64::from(sample.cos_incidence)) / 0.09;
        if grazing > 0.0 && rng.random_range(0.0..1.0) < grazing {
            return 0.0;
        }
    }
    if !z.is_finite() {
        return 0.0;
    }
    let mut sigma = params.sigma_m(z);
    if sample.cos_incidence < 0.5 {
        // The source's term for slanted surfaces, which counts beyond 60 degrees; held at its value for
        // 82 degrees, beyond which it runs away.
        let angle = f64::from(sample.cos_incidence).acos();
        let rest = (std::f64::consts::FRAC_PI_2 - angle).max(0.14);
        sigma += params.noise_scale * 0.0001 / z.sqrt() * angle * angle / (rest * rest);
    }
    let gauss: f64 = StandardNormal.sample(rng);
    z += sigma * gauss;
    if params.quantum_m > 0.0 {
        // Depths are positive, so that truncation after adding a half rounds.
        z = ((z / params.quantum_m + 0.5) as i64) as f64 * params.quantum_m;
    }
    if z >= params.range_min_m && z <= params.range_max_m { z as f32 } else { 0.0 }
}
