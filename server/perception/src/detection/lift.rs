//! From a box in an image to one in space.
//!
//! A detector of images says where in the image a thing is, not which of the pixels there are the thing's. The depth image
//! says: what goes on beyond the box is the table, floor or wall that the thing is seen against; of the rest, what hangs
//! together about the depth that most of the middle has is the thing.

use super::ImageBox;
use crate::cloud::upright_box_trimmed;
use crate::depth::{DepthPlane, DepthPlaneParams, RayTable, VertexMap, depth_planes};
use nalgebra::Point3;
use percept_geometry::{CameraIntrinsics, DepthImage, GeometryError, OrientedBox3, Pose};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Width of the window of depths that the mode is taken over, as a part of the depth: 5 cm at a metre.
const MODE_WIDTH: f32 = 0.05;
/// Of larger boxes every second, third, ... column and row is looked at: 240 x 160 pixels take some 5 ms.
const MAX_PIXELS: usize = 38_400;
/// Planes within 18 degrees of level carry things.
const HORIZONTAL_COS: f64 = 0.95;
/// Pixels that a thing grows over to: those around, and two away, across a hole of one pixel.
const AROUND: [(isize, isize); 12] =
    [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1), (2, 0), (-2, 0), (0, 2), (0, -2)];

/// How boxes are lifted. The defaults are for depth cameras within some metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LiftParams {
    /// Planes that things are seen against; `min_pixels` is of images of 640 x 480, and shrinks with smaller ones.
    pub planes: DepthPlaneParams,
    /// A plane with less than this share of its pixels in the box is what the thing is seen against, 0 to 1.
    pub own_plane_share: f64,
    /// The part of the box, along each edge, that is its middle, 0.1 to 1.
    pub middle: f64,
    /// Neighbouring pixels whose depth differs by more than this part of it are of different things, 0.001 to 0.5.
    pub max_jump_fraction: f64,
    /// A thing is at most this many times as deep as it is wide or high in the image, whichever is more, 0.1 to 10.
    pub max_depth_ratio: f64,
    /// A thing has at least so many pixels with depth.
    pub min_points: usize,
    /// Part of a thing's points left out on each side of each axis when its box is fitted, 0 to 0.2.
    pub box_trim: f64,
    /// A thing whose bottom is at most this high above a horizontal plane stands on it, metres, 0 to 1.
    pub stand_gap_m: f64,
}

impl Default for LiftParams {
    fn default() -> Self {
        Self {
            planes: DepthPlaneParams { max_distance_m: 0.012, ..DepthPlaneParams::default() },
            own_plane_share: 0.7,
            middle: 0.6,
            max_jump_fraction: 0.02,
            max_depth_ratio: 1.5,
            min_points: 80,
            box_trim: 0.02,
            stand_gap_m: 0.05,
        }
    }
}

impl LiftParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        self.planes.validate()?;
        let bounds = [
            ("own_plane_share", self.own_plane_share, 0.0, 1.0, "between 0 and 1"),
            ("middle", self.middle, 0.1, 1.0, "between 0.1 and 1"),
            ("max_jump_fraction", self.max_jump_fraction, 0.001, 0.5, "between 0.001 and 0.5"),
            ("max_depth_ratio", self.max_depth_ratio, 0.1, 10.0, "between 0.1 and 10"),
            ("min_points", self.min_points as f64, 3.0, 1e9, "between 3 and 1e9"),
            ("box_trim", self.box_trim, 0.0, 0.2, "between 0 and 0.2"),
            ("stand_gap_m", self.stand_gap_m, 0.0, 1.0, "between 0 and 1"),
        ];
        for (field, value, low, high, requirement) in bounds {
            if !(value >= low && value <= high) {
                return Err(GeometryError::OutOfRange { field, value, requirement });
            }
        }
        Ok(())
    }
}

/// A thing in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lifted {
    /// Upright box around what is seen of it, in the frame that the camera's pose is given in; its hidden side is not guessed.
    pub bbox: OrientedBox3,
    /// Pixels that were taken for the thing's; of a large box, in which not all are looked at, about.
    pub num_points: usize,
    /// Depth that most of its middle has, metres.
    pub depth_m: f64,
    /// Height of the horizontal plane that it stands on, metres in the box's frame, if one was seen.
    pub support_z_m: Option<f64>,
}

/// Why a box was not lifted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NotLifted {
    /// No pixel's centre of the image lies in it.
    OutsideImage,
    /// Too few of its pixels have a depth: too near, too far, or nothing that reflects.
    TooFewDepths,
    /// What is seen lies in planes that go on beyond it: a thing too flat, or none.
    WithinPlane,
    /// What hangs together in its middle has too few pixels.
    TooFewPoints,
}

impl std::fmt::Display for NotLifted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::OutsideImage => "outside of the image",
            Self::TooFewDepths => "too few depths",
            Self::WithinPlane => "within a plane that goes on beyond it",
            Self::TooFewPoints => "too few points that hang together",
        })
    }
}

/// A depth image in which boxes are lifted, and its planes.
#[derive(Debug, Clone)]
pub struct Lifter {
    params: LiftParams,
    t_map_camera: Pose,
    intrinsics: CameraIntrinsics,
    vertices: VertexMap,
    planes: Vec<DepthPlane>,
    /// `H x W`: the plane of each pixel.
    labels: Vec<Option<u16>>,
}

/// Pixels of a box: every `step`-th of the columns and rows, ends excluded.
#[derive(Debug, Clone, Copy)]
struct Window {
    u: [usize; 2],
    v: [usize; 2],
    step: usize,
}

impl Window {
    /// The pixels of a `width` x `height` image whose centres lie in a box.
    fn of(b: &ImageBox, width: usize, height: usize) -> Option<Self> {
        let range = |from: f64, to: f64, size: usize| {
            let end = |px: f64| (px - 0.5).ceil().clamp(0.0, size as f64) as usize;
            [end(from), end(to)]
        };
        let (u, v) = (range(b.left_px, b.right_px, width), range(b.top_px, b.bottom_px, height));
        if !b.is_proper() || u[0] >= u[1] || v[0] >= v[1] {
            return None;
        }
        let num_pixels = (u[1] - u[0]) * (v[1] - v[0]);
        let step = (num_pixels as f64 / MAX_PIXELS as f64).sqrt().ceil().max(1.0) as usize;
        Some(Self { u, v, step })
    }

    /// The part of it in its middle, along each edge.
    fn middle(&self, part: f64) -> Self {
        let shrunk = |[from, to]: [usize; 2]| {
            let cut = ((to - from) as f64 * 0.5 * (1.0 - part)) as usize;
            [from + cut, to - cut]
        };
        Self { u: shrunk(self.u), v: shrunk(self.v), step: self.step }
    }

    /// Columns of those that are looked at.
    fn columns(&self) -> usize {
        (self.u[1] - self.u[0]).div_ceil(self.step)
    }

    /// The place of a pixel among those that are looked at, row by row.
    fn index(&self, (u, v): (usize, usize)) -> usize {
        (v - self.v[0]) / self.step * self.columns() + (u - self.u[0]) / self.step
    }

    /// The pixel so many places away, and how far that is along the longer axis, pixels.
    fn neighbour(&self, (u, v): (usize, usize), (du, dv): (isize, isize)) -> Option<((usize, usize), usize)> {
        let step = self.step as isize;
        let (u, v) = (u.checked_add_signed(du * step)?, v.checked_add_signed(dv * step)?);
        let away = du.unsigned_abs().max(dv.unsigned_abs()) * self.step;
        self.contains(u, v).then_some(((u, v), away))
    }

    fn contains(&self, u: usize, v: usize) -> bool {
        (self.u[0]..self.u[1]).contains(&u) && (self.v[0]..self.v[1]).contains(&v)
    }

    fn pixels(self) -> impl Iterator<Item = (usize, usize)> {
        let rows = (self.v[0]..self.v[1]).step_by(self.step);
        rows.flat_map(move |v| (self.u[0]..self.u[1]).step_by(self.step).map(move |u| (u, v)))
    }
}

impl Lifter {
    /// Finds what things may be seen against. Boxes come out upright along the z of the pose's frame, which points up.
    ///
    /// # Errors
    /// `OutOfRange` naming the parameter; `ShapeMismatch` if the image is not of the intrinsics' size.
    pub fn new(
        depth: &DepthImage,
        intrinsics: &CameraIntrinsics,
        t_map_camera: &Pose,
        params: &LiftParams,
    ) -> Result<Self, GeometryError> {
        params.validate()?;
        let vertices = VertexMap::new(depth, &RayTable::new(intrinsics)?)?;
        let shrunk = (depth.width() * depth.height()) as f64 / (640.0 * 480.0);
        let min_pixels = (params.planes.min_pixels as f64 * shrunk.min(1.0)) as usize;
        let found = depth_planes(depth, intrinsics, &DepthPlaneParams { min_pixels, ..params.planes })?;
        let (params, intrinsics, t_map_camera) = (*params, *intrinsics, *t_map_camera);
        Ok(Self { params, t_map_camera, intrinsics, vertices, planes: found.planes, labels: found.labels })
    }

    /// Lifts a box of the depth image, or of a colour image registered to it.
    ///
    /// Of the pixels in the box those of planes that go on beyond it are left out. The depth is the mode of the others in the
    /// middle (the window of a twentieth of it that holds most). From the pixels there the thing grows over neighbours without a
    /// jump in depth, as long as they are in the box and not much deeper than the thing is wide. A box of least footprint is put
    /// around the points, and made to stand on a horizontal plane just below it.
    ///
    /// # Errors
    /// Why there is no box in space.
    pub fn lift(&self, b: &ImageBox) -> Result<Lifted, NotLifted> {
        let window = Window::of(b, self.vertices.width, self.vertices.height).ok_or(NotLifted::OutsideImage)?;
        let least = self.params.min_points.div_ceil(window.step * window.step).max(3);
        let seen = window.pixels().filter(|&(u, v)| self.vertices.at(u, v).is_some()).count();
        if seen < least {
            return Err(NotLifted::TooFewDepths);
        }
        let behind = self.planes_behind(window);
        let is_free = |u: usize, v: usize| self.plane_at(u, v).is_none_or(|plane| !behind[plane]);
        let free: Vec<(usize, usize)> =
            window.pixels().filter(|&(u, v)| is_free(u, v) && self.depth(u, v) > 0.0).collect();
        if free.len() < least {
            return Err(NotLifted::WithinPlane);
        }
        let middle = window.middle(self.params.middle);
        let depths =
            |within: Window| free.iter().filter(move |p| within.contains(p.0, p.1)).map(|p| self.depth(p.0, p.1));
        let depth = mode(depths(middle).collect()).or_else(|| mode(depths(window).collect()));
        let depth = depth.ok_or(NotLifted::TooFewPoints)?;
        let members = self.grow(window, &is_free, &free, depth);
        if members.len() < least {
            return Err(NotLifted::TooFewPoints);
        }
        let lifted = self.boxed(&members, depth, &behind).ok_or(NotLifted::TooFewPoints)?;
        Ok(Lifted { num_points: members.len() * window.step * window.step, ..lifted })
    }

    fn depth(&self, u: usize, v: usize) -> f32 {
        self.vertices.at(u, v).map_or(0.0, |p| p.z)
    }

    fn plane_at(&self, u: usize, v: usize) -> Option<usize> {
        self.labels[v * self.vertices.width + u].map(usize::from)
    }

    /// For each plane whether the thing in the window is seen against it.
    fn planes_behind(&self, window: Window) -> Vec<bool> {
        let mut inside = vec![0usize; self.planes.len()];
        window.pixels().filter_map(|(u, v)| self.plane_at(u, v)).for_each(|plane| inside[plane] += 1);
        let share = self.params.own_plane_share / (window.step * window.step) as f64;
        self.planes.iter().zip(inside).map(|(plane, n)| (n as f64) < share * plane.num_pixels as f64).collect()
    }

    /// Pixels that hang together with those of about this depth; the largest such set if there are several.
    fn grow(
        &self,
        window: Window,
        is_free: &impl Fn(usize, usize) -> bool,
        free: &[(usize, usize)],
        depth: f32,
    ) -> Vec<Point3<f32>> {
        let mut is_taken = vec![false; window.columns() * (window.v[1] - window.v[0]).div_ceil(window.step)];
        let reach = self.reach(window, depth);
        let mut best: Vec<Point3<f32>> = vec![];
        for &seed in free.iter().filter(|p| (self.depth(p.0, p.1) - depth).abs() <= MODE_WIDTH * depth) {
            if std::mem::replace(&mut is_taken[window.index(seed)], true) {
                continue;
            }
            let (mut members, mut queue) = (vec![], VecDeque::from([seed]));
            while let Some(here) = queue.pop_front() {
                members.extend(self.vertices.at(here.0, here.1));
                let z = self.depth(here.0, here.1);
                for there in AROUND {
                    let Some((there, away)) = window.neighbour(here, there) else { continue };
                    if is_taken[window.index(there)] || !is_free(there.0, there.1) {
                        continue;
                    }
                    // A surface goes on as much farther as it is pixels away; beyond three, another begins.
                    let jump = self.params.max_jump_fraction as f32 * z * away.min(3) as f32;
                    let next = self.depth(there.0, there.1);
                    if next > 0.0 && (next - z).abs() <= jump && (next - depth).abs() <= reach {
                        is_taken[window.index(there)] = true;
                        queue.push_back(there);
                    }
                }
            }
            if members.len() > best.len() {
                best = members;
            }
        }
        best
    }

    /// How far from the depth of its middle a thing may go, metres.
    fn reach(&self, window: Window, depth: f32) -> f32 {
        let ray = |u: usize, v: usize| self.intrinsics.ray(u as f64, v as f64);
        let across = ray(window.u[1] - 1, window.v[1] - 1) - ray(window.u[0], window.v[0]);
        (self.params.max_depth_ratio * f64::from(depth) * across.amax()) as f32
    }

    fn boxed(&self, members: &[Point3<f32>], depth: f32, behind: &[bool]) -> Option<Lifted> {
        let in_map: Vec<Point3<f32>> = members.iter().map(|p| (self.t_map_camera * p.cast::<f64>()).cast()).collect();
        let mut bbox = upright_box_trimmed(&in_map, self.params.box_trim)?;
        let bottom = bbox.center().z - 0.5 * bbox.size.z;
        let support_z_m = self.support(&bbox, behind).filter(|z| (bottom - z).abs() <= self.params.stand_gap_m);
        if let Some(z) = support_z_m {
            let top = (bottom + bbox.size.z).max(z);
            bbox.size.z = top - z;
            bbox.t_frame_box.translation.vector.z = 0.5 * (top + z);
        }
        Some(Lifted { bbox, num_points: members.len(), depth_m: f64::from(depth), support_z_m })
    }

    /// Height, under the middle of a box, of the horizontal plane that is nearest to its bottom.
    fn support(&self, bbox: &OrientedBox3, behind: &[bool]) -> Option<f64> {
        let center = bbox.center();
        let bottom = center.z - 0.5 * bbox.size.z;
        let heights = self.planes.iter().zip(behind).filter(|(_, behind)| **behind).filter_map(|(plane, _)| {
            let plane = plane.plane.transformed(&self.t_map_camera);
            (plane.normal.z > HORIZONTAL_COS).then(|| center.z - plane.distance(&center) / plane.normal.z)
        });
        heights.min_by(|a, b| (a - bottom).abs().total_cmp(&(b - bottom).abs()))
    }
}

/// The middle of the window of depths, a twentieth of a depth wide, that holds most of them; the nearest of equals.
fn mode(mut depths: Vec<f32>) -> Option<f32> {
    depths.sort_unstable_by(f32::total_cmp);
    let (mut end, mut best) = (0, (0, None));
    for (start, &nearest) in depths.iter().enumerate() {
        while end < depths.len() && depths[end] <= nearest * (1.0 + MODE_WIDTH) {
            end += 1;
        }
        if end - start > best.0 {
            best = (end - start, Some(depths[(start + end) / 2]));
        }
    }
    best.1
}
