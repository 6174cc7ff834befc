//! Which patches of surface make one convex object.

use super::supervoxels::{Supervoxel, Supervoxels};
use crate::cloud::{DisjointSets, at_least};
use nalgebra::Vector3;
use percept_geometry::GeometryError;
use serde::{Deserialize, Serialize};

/// How [`group_convex`] joins supervoxels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConvexityParams {
    /// Normals closer than this are one surface even if it bends inward a little (noise), radians.
    pub concavity_tolerance_rad: f64,
    /// Step between two patches that is taken for noise, metres; a larger one is a gap or an edge in depth.
    pub max_step_m: f64,
    /// Groups of fewer supervoxels go to the largest group that they touch.
    pub min_supervoxels: usize,
}

impl Default for ConvexityParams {
    fn default() -> Self {
        Self { concavity_tolerance_rad: 0.1745, max_step_m: 7.5e-4, min_supervoxels: 3 }
    }
}

impl ConvexityParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        at_least("min_supervoxels", self.min_supervoxels, 1, "at least 1")?;
        let not_negative = [("concavity_tolerance_rad", self.concavity_tolerance_rad), ("max_step_m", self.max_step_m)];
        for (field, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(GeometryError::OutOfRange { field, value, requirement: "not negative" });
            }
        }
        Ok(())
    }
}

/// A group for each supervoxel, from 0: those connected by convex edges. What bends inward (where one thing stands on
/// or leans against another) parts them. `seed_size_m` is that of the supervoxels.
///
/// Source: Stein et al., "Object partitioning using local convexity", 2014: eqs. 3 (convexity), 6 (sanity), and the
/// merging of small groups; steps in depth as in its implementation by the authors.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn group_convex(
    parts: &Supervoxels,
    seed_size_m: f64,
    params: &ConvexityParams,
) -> Result<Vec<u32>, GeometryError> {
    params.validate()?;
    let at = |i: u32| &parts.supervoxels[i as usize];
    let mut sets = DisjointSets::new(parts.supervoxels.len());
    for &(a, b) in &parts.edges {
        if is_convex(at(a), at(b), seed_size_m, params) {
            sets.unite(a, b);
        }
    }
    merge_small(parts, &mut sets, params.min_supervoxels);
    let mut number = vec![None; parts.supervoxels.len()];
    let mut next = 0..;
    Ok((0..parts.supervoxels.len() as u32)
        .map(|i| *number[sets.root(i) as usize].get_or_insert_with(|| next.next().unwrap_or(u32::MAX)))
        .collect())
}

fn is_convex(a: &Supervoxel, b: &Supervoxel, seed_size: f64, params: &ConvexityParams) -> bool {
    let ab = b.center - a.center;
    let (cross, turn) = (a.normal.cross(&b.normal), a.normal.angle(&b.normal));
    // A patch beside the plane of the other, more than their turn explains: not the same surface.
    let step = ab.dot(&a.normal).abs().min(ab.dot(&b.normal).abs());
    if step > cross.norm() * seed_size + params.max_step_m {
        return false;
    }
    // Eq. 6: the line in which both planes meet has to lie between the patches, else they only touch at a corner.
    if !is_sane(&cross, &ab, turn) {
        return false;
    }
    // Eq. 3: the normals spread apart along the way from one to the other.
    ab.dot(&b.normal) >= ab.dot(&a.normal) || turn < params.concavity_tolerance_rad
}

fn is_sane(cross: &Vector3<f64>, ab: &Vector3<f64>, turn: f64) -> bool {
    let along = cross.angle(ab).to_degrees();
    let angle = along.min(180.0 - along);
    // Nearly parallel planes meet anywhere: a soft step at 25 degrees of turn.
    angle >= 60.0 / (1.0 + (-0.25 * (turn.to_degrees() - 25.0)).exp())
}

/// Small groups, in the order of their first supervoxel, join the largest that they touch; once around.
fn merge_small(parts: &Supervoxels, sets: &mut DisjointSets, least: usize) {
    let n = parts.supervoxels.len();
    let mut sizes = vec![0usize; n];
    (0..n as u32).for_each(|i| sizes[sets.root(i) as usize] += 1);
    let mut around: Vec<Vec<u32>> = vec![Vec::new(); n];
    for &(a, b) in &parts.edges {
        let (a, b) = (sets.root(a), sets.root(b));
        if a != b {
            around[a as usize].push(b);
            around[b as usize].push(a);
        }
    }
    for group in 0..n as u32 {
        if sets.root(group) != group || sizes[group as usize] >= least {
            continue;
        }
        let touching: Vec<u32> = around[group as usize].iter().map(|&other| sets.root(other)).collect();
        let largest = touching.into_iter().filter(|&o| o != group).max_by_key(|&o| (sizes[o as usize], u32::MAX - o));
        if let Some(other) = largest {
            let size = sizes[group as usize] + sizes[other as usize];
            let moved = [std::mem::take(&mut around[group as usize]), std::mem::take(&mut around[other as usize])];
            sets.unite(group, other);
            let root = sets.root(group) as usize;
            sizes[root] = size;
            around[root] = moved.concat();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn patch(center: [f64; 3], normal: [f64; 3]) -> Supervoxel {
        Supervoxel { center: Point3::from(center), normal: Vector3::from(normal).normalize(), num_voxels: 20 }
    }

    #[test]
    fn a_ridge_is_one_thing_and_a_valley_is_two() {
        let groups = |a: Supervoxel, b: Supervoxel| {
            let parts = Supervoxels { labels: Vec::new(), supervoxels: vec![a, b], edges: vec![(0, 1)] };
            let params = ConvexityParams { min_supervoxels: 1, ..ConvexityParams::default() };
            group_convex(&parts, 0.04, &params).unwrap()
        };
        let ridge = (patch([-0.02, 0.0, -0.005], [-0.5, 0.0, 1.0]), patch([0.02, 0.0, -0.005], [0.5, 0.0, 1.0]));
        assert_eq!(groups(ridge.0, ridge.1), [0, 0]);
        let valley = (patch([-0.02, 0.0, 0.005], [0.5, 0.0, 1.0]), patch([0.02, 0.0, 0.005], [-0.5, 0.0, 1.0]));
        assert_eq!(groups(valley.0, valley.1), [0, 1]);
        let even = (patch([-0.02, 0.0, 0.0], [0.02, 0.0, 1.0]), patch([0.02, 0.0, 0.0], [-0.02, 0.0, 1.0]));
        assert_eq!(groups(even.0, even.1), [0, 0]);
        let step = (patch([-0.02, 0.0, 0.0], [0.0, 0.0, 1.0]), patch([0.02, 0.0, 0.01], [0.0, 0.0, 1.0]));
        assert_eq!(groups(step.0, step.1), [0, 1]);
    }
}
