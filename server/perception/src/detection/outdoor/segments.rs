//! Points that may be one object, at several gaps: a tree of parts.

use super::OutdoorParams;
use super::standing::Standing;
use super::voxels::Voxels;
use crate::cloud::DisjointSets;
use nalgebra::Point3;

/// Gaps that are bridged along the ground at the sensor, metres, from the legs of a person to the cabin and the load of
/// a truck.
const GAPS_M: [f64; 4] = [0.2, 0.35, 0.6, 1.0];
/// Gaps in steps of the beams: what hits a surface at a slant is a few steps apart.
const STEPS: f64 = 2.0;
/// Voxels as a part of the gap: points of one are joined at any rate.
const VOXEL_OF_GAP: f64 = 0.5;

/// A part of what stands: all of the points that hang together at a gap.
pub(super) struct Segment {
    /// Indices of its points, ascending.
    pub(super) points: Vec<u32>,
    /// Number of the segment that it is a part of, at a larger gap; later in the list.
    pub(super) parent: Option<usize>,
    /// Whether it hangs together at a gap that is narrow enough for a thing of no known class.
    pub(super) is_narrow: bool,
}

/// Things of unknown class hang together at this gap, metres.
const NARROW_M: f64 = 0.6;

/// All segments, those of smaller gaps first. Segments that have the same points at several gaps are there once.
///
/// The gap grows with range as the beams part: along the ground by the step of a ring, upward by that between rings.
/// Heights are therefore scaled so that both are the same. What hangs together at a gap does so at every larger one.
pub(super) fn segments(standing: &Standing, params: &OutdoorParams) -> Vec<Segment> {
    let mut out: Vec<Segment> = Vec::new();
    let mut segment_of: Vec<Option<usize>> = vec![None; standing.points.len()];
    for gap in GAPS_M {
        let (cluster_of, num_clusters) = clusters(standing, gap, params);
        // What hung together before goes on to do so, though the voxels are larger now.
        let mut sets = DisjointSets::new(num_clusters);
        let mut first: Vec<Option<u32>> = vec![None; out.len()];
        for (cluster, segment) in cluster_of.iter().zip(&segment_of) {
            if let Some(s) = *segment {
                sets.unite(*first[s].get_or_insert(*cluster), *cluster);
            }
        }
        let mut members: Vec<Vec<u32>> = vec![Vec::new(); num_clusters];
        for (point, cluster) in (0..).zip(&cluster_of) {
            members[sets.root(*cluster) as usize].push(point);
        }
        for points in members.into_iter().filter(|m| m.len() >= params.min_points) {
            let part = segment_of[points[0] as usize];
            let is_same = part.is_some_and(|s| out[s].points.len() == points.len())
                && points.iter().all(|&p| segment_of[p as usize] == part);
            if !is_same {
                let number = out.len();
                for &p in &points {
                    if let Some(part) = segment_of[p as usize].replace(number).filter(|&part| part != number) {
                        out[part].parent = Some(number);
                    }
                }
                out.push(Segment { points, parent: None, is_narrow: gap <= NARROW_M });
            }
        }
    }
    out
}

/// Number of the cluster of each point at a gap, and how many there are.
fn clusters(standing: &Standing, gap: f64, params: &OutdoorParams) -> (Vec<u32>, usize) {
    let voxels = Voxels::new(standing, params.voxel_size_m.max(VOXEL_OF_GAP * gap));
    let scaled: Vec<Point3<f32>> = voxels.means.iter().map(|p| scaled(p, gap, params)).collect();
    let found = voxels.joined(&scaled, gap, STEPS * params.horizontal_step_rad);
    let mut out = vec![0; standing.points.len()];
    for (voxel, label) in found.labels.iter().enumerate() {
        // One voxel is enough for a cluster, and all are finite.
        let label = label.unwrap_or(0);
        voxels.members(voxel).iter().for_each(|&i| out[i as usize] = label);
    }
    (out, found.num_clusters)
}

/// Height scaled so that the gap along the ground is right upward, too.
fn scaled(p: &Point3<f32>, gap: f64, params: &OutdoorParams) -> Point3<f32> {
    let range = f64::from(p.x.hypot(p.y));
    let (along, upward) =
        (gap + STEPS * params.horizontal_step_rad * range, gap + STEPS * params.vertical_step_rad * range);
    Point3::new(p.x, p.y, p.z * (along / upward) as f32)
}
