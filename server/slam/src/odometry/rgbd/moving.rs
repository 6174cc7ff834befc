//! What moves by itself: it hides what was seen before, and where it was one sees through.
//!
//! A robust kernel alone follows a person who walks past a blank wall: the person fits itself, and the wall fits whatever
//! slides along it. But in a scene that keeps still nothing appears in front of a surface that was in plain view, and no
//! surface is seen through. Such pixels are seeds; what hangs together with them within a body's width goes with them.
//!
//! Source: Palazzolo et al., "ReFusion: 3D reconstruction in dynamic environments for RGB-D cameras exploiting residuals",
//! 2019, section III.C (residuals as seeds, flood fill in depth, registration again).

use super::frame::{Frame, Rigid32, Vertex, pixel};
use super::noise::sigma;
use super::surfels::View;
use percept_geometry::{CameraIntrinsics, Pose};
use std::collections::VecDeque;

/// Seeds count in tiles of so many pixels, where they are at least `DENSE`: single ones are noise and edges.
const TILE: usize = 8;
/// A fifth of a tile's pixels; halved, `evaluate rgbd` has 25.4 mm (22.6), as noise is taken for motion.
const DENSE: u32 = 12;
/// Fewer seeds than this part of the pixels are the model's own errors; nor could what is so small drag the pose along.
/// ATE of `evaluate rgbd rgbd-7scenes-a`, where nothing moves: halved 22.6, doubled 23.0 mm (22.6).
const FEWEST: usize = 130;
/// What hangs together with a seed, along its surface up to this far, moves with it, metres: half a person and an arm.
/// `evaluate rgbd` is the same, 22.6 mm, halved and doubled.
const REACH: f32 = 0.5;

/// What was found to move.
#[derive(Debug, Default)]
pub(crate) struct Moving {
    /// Pixels of the view in front of whose surfaces something stands.
    pub(crate) covered: Vec<u32>,
    /// Share of the frame's valid vertices.
    pub(crate) share: f64,
}

/// The frame, seen from `t_view_camera`, with what moves in it marked as not valid; none if nothing does.
pub(crate) fn mark(
    frame: &Frame,
    view: &View,
    camera: &CameraIntrinsics,
    t_view_camera: &Pose,
) -> Option<(Frame, Moving)> {
    let t = Rigid32::from(t_view_camera);
    let meets: Vec<Meeting> = frame.vertices.iter().map(|v| meet(v, view, camera, &t)).collect();
    let mut gone = vec![false; view.vertices.len()];
    let mut seeds = vec![false; frame.vertices.len()];
    for (seed, m) in seeds.iter_mut().zip(&meets) {
        match *m {
            Meeting::Before(at) => *seed = view.is_established(at),
            Meeting::Through(at) => gone[at] = true,
            Meeting::On(_) | Meeting::None => {}
        }
    }
    only_dense(&mut gone, frame.width);
    only_dense(&mut seeds, frame.width);
    let count = |s: &[bool]| s.iter().filter(|s| **s).count();
    if FEWEST * (count(&seeds) + count(&gone)) < seeds.len() {
        return None;
    }
    // What was seen through has gone, and the rest of it went, too: what lies on it now is what moves.
    let in_front = seeds.iter().zip(&meets).filter(|(seed, _)| **seed).filter_map(|(_, m)| m.pixel());
    let mut covered: Vec<u32> = in_front.map(|at| at as u32).collect();
    covered.sort_unstable();
    covered.dedup();
    grow(&mut gone, &view.vertices, frame.width, |_| true);
    for (seed, m) in seeds.iter_mut().zip(&meets) {
        *seed |= matches!(*m, Meeting::On(at) if gone[at]);
    }
    let keeps_still = |m: &Meeting| matches!(*m, Meeting::On(at) if view.is_established(at) && !gone[at]);
    grow(&mut seeds, &frame.vertices, frame.width, |i| !keeps_still(&meets[i]));
    let mut marked = frame.clone();
    marked.vertices.iter_mut().zip(&seeds).filter(|(_, s)| **s).for_each(|(v, _)| v.p *= -1.0);
    marked.measure();
    let share = 1.0 - marked.num_valid as f64 / frame.num_valid.max(1) as f64;
    Some((marked, Moving { covered, share }))
}

/// How a vertex lies to what the model has at its pixel of the view.
#[derive(Clone, Copy)]
enum Meeting {
    None,
    On(usize),
    Before(usize),
    Through(usize),
}

impl Meeting {
    fn pixel(self) -> Option<usize> {
        match self {
            Self::None => None,
            Self::On(at) | Self::Before(at) | Self::Through(at) => Some(at),
        }
    }
}

#[inline]
fn meet(v: &Vertex, view: &View, camera: &CameraIntrinsics, t: &Rigid32) -> Meeting {
    if v.p.z <= 0.0 {
        return Meeting::None;
    }
    let q = t.apply(&v.p);
    let Some(at) = pixel(camera, &q) else { return Meeting::None };
    let model = &view.vertices[at];
    if model.p.z <= 0.0 {
        return Meeting::None;
    }
    let (d, margin) = (q - model.p, 0.15 + 4.0 * sigma(q.z.max(model.p.z)));
    // By both surfaces' planes, since depth along a grazing ray says little.
    let off = model.n.dot(&d).abs().min((t.r * v.n).dot(&d).abs());
    match off > margin {
        false => Meeting::On(at),
        true if d.z < 0.0 => Meeting::Before(at),
        true => Meeting::Through(at),
    }
}

/// Single seeds are noise and edges.
fn only_dense(seeds: &mut [bool], width: usize) {
    let columns = width.div_ceil(TILE);
    let tile = |i: usize| i / width / TILE * columns + i % width / TILE;
    let mut count = vec![0u32; columns * (seeds.len() / width).div_ceil(TILE)];
    (0..seeds.len()).filter(|&i| seeds[i]).for_each(|i| count[tile(i)] += 1);
    seeds.iter_mut().enumerate().for_each(|(i, s)| *s &= count[tile(i)] >= DENSE);
}

/// Vertices, whether marked or not, that lie well in front of or behind what the model has there, and those that meet any
/// of it.
pub(crate) fn contradictions(
    frame: &Frame,
    view: &View,
    camera: &CameraIntrinsics,
    t_view_camera: &Pose,
) -> (usize, usize) {
    let t = Rigid32::from(t_view_camera);
    frame.vertices.iter().filter(|v| v.p.z != 0.0).fold((0, 0), |(wrong, all), v| {
        let v = Vertex { p: v.p * v.p.z.signum(), n: v.n };
        match meet(&v, view, camera, &t) {
            Meeting::None => (wrong, all),
            Meeting::On(_) => (wrong, all + 1),
            Meeting::Before(_) | Meeting::Through(_) => (wrong + 1, all + 1),
        }
    })
}

/// Adds what hangs together with the seeds.
fn grow(seeds: &mut [bool], vertices: &[Vertex], width: usize, into: impl Fn(usize) -> bool) {
    let height = seeds.len() / width;
    let mut queue: VecDeque<(usize, f32)> = (0..seeds.len()).filter(|&i| seeds[i]).map(|i| (i, 0.0)).collect();
    while let Some((i, far)) = queue.pop_front() {
        let p = vertices[i].p;
        let (u, v) = (i % width, i / width);
        let around = [
            (u > 0, i.wrapping_sub(1)),
            (u + 1 < width, i + 1),
            (v > 0, i.wrapping_sub(width)),
            (v + 1 < height, i + width),
        ];
        for (_, j) in around.into_iter().filter(|n| n.0) {
            let q = vertices[j].p;
            let step = (q - p).norm();
            // Larger steps than this are another surface.
            if !seeds[j] && into(j) && q.z > 0.0 && step < 0.01 + 0.02 * p.z && far + step < REACH {
                seeds[j] = true;
                queue.push_back((j, far + step));
            }
        }
    }
}
