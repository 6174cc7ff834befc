//! Parts of one surface that something in front of it keeps apart.

use super::supervoxels::{Supervoxel, Supervoxels};
use crate::cloud::DisjointSets;
use crate::search::KdTree;
use nalgebra::{Point3, Vector3};

/// Points kept for the tests of what hides what.
const MAX_POINTS: usize = 8192;
/// Supervoxels beyond which pairs are not tried any more: a scene of another kind.
const MAX_SUPERVOXELS: usize = 4000;

/// How far apart parts may be joined.
pub(super) struct Hidden<'a> {
    pub(super) viewpoint: &'a Point3<f64>,
    /// Widest gap, metres.
    pub(super) max_gap: f64,
    /// Most that surfaces turn or step over the gap, radians.
    pub(super) max_angle: f64,
    /// Size of the patches, metres.
    pub(super) patch: f64,
}

/// Joins groups of supervoxels of which two continue one another's plane over a gap that lies wholly behind something
/// nearer to the viewpoint. A gap through which the background is seen keeps them apart.
pub(super) fn join_hidden(points: &[Point3<f32>], parts: &Supervoxels, groups: &mut [u32], by: &Hidden) {
    let n = parts.supervoxels.len();
    if n > MAX_SUPERVOXELS {
        return;
    }
    let scene = Scene::new(points, parts, groups, by);
    let mut sets = DisjointSets::new(n);
    for a in 0..n {
        for b in a + 1..n {
            let (first, second) = (&parts.supervoxels[a], &parts.supervoxels[b]);
            let apart = sets.root(groups[a]) != sets.root(groups[b]);
            if apart && goes_on(first, second, by) && scene.hides_between(first, second, [groups[a], groups[b]]) {
                sets.unite(groups[a], groups[b]);
            }
        }
    }
    groups.iter_mut().for_each(|g| *g = sets.root(*g));
}

fn goes_on(a: &Supervoxel, b: &Supervoxel, by: &Hidden) -> bool {
    let ab = b.center - a.center;
    let most = by.max_angle.sin() * ab.norm();
    ab.norm() <= by.max_gap + by.patch
        && a.normal.dot(&b.normal) >= by.max_angle.cos()
        && ab.dot(&a.normal).abs() <= most
        && ab.dot(&b.normal).abs() <= most
}

struct Scene<'a> {
    by: &'a Hidden<'a>,
    groups: Vec<Option<u32>>,
    ranges: Vec<f64>,
    places: KdTree,
    /// The same points as unit directions from the viewpoint.
    directions: KdTree,
}

impl<'a> Scene<'a> {
    fn new(points: &[Point3<f32>], parts: &Supervoxels, groups: &[u32], by: &'a Hidden<'a>) -> Self {
        let stride = points.len().div_ceil(MAX_POINTS).max(1);
        let kept: Vec<Point3<f32>> = points.iter().step_by(stride).copied().collect();
        let rays: Vec<Vector3<f64>> = kept.iter().map(|p| p.cast::<f64>() - by.viewpoint).collect();
        let direction = |r: &Vector3<f64>| Point3::from(r.normalize().cast::<f32>());
        Self {
            by,
            groups: parts.labels.iter().step_by(stride).map(|l| l.map(|l| groups[l as usize])).collect(),
            ranges: rays.iter().map(Vector3::norm).collect(),
            places: KdTree::build(&kept),
            directions: KdTree::build(&rays.iter().map(direction).collect::<Vec<_>>()),
        }
    }

    /// Whether there is a gap on the way from one to the other, all of it hidden.
    fn hides_between(&self, a: &Supervoxel, b: &Supervoxel, own: [u32; 2]) -> bool {
        let ab = b.center - a.center;
        let steps = (4.0 * ab.norm() / self.by.patch).ceil().max(1.0) as usize;
        let mut gap = false;
        for step in 1..steps {
            let p = a.center + ab * (step as f64 / steps as f64);
            let near = self.places.nearest_within(&p.cast(), (0.5 * self.by.patch) as f32);
            if near.and_then(|n| self.groups[n.index]).is_some_and(|g| own.contains(&g)) {
                continue;
            }
            if !self.is_hidden(&p) {
                return false;
            }
            gap = true;
        }
        gap
    }

    fn is_hidden(&self, p: &Point3<f64>) -> bool {
        let ray = p - self.by.viewpoint;
        let range = ray.norm();
        let width = (0.25 * self.by.patch / range) as f32;
        let seen = self.directions.nearest_within(&Point3::from((ray / range).cast::<f32>()), width);
        seen.is_some_and(|n| self.ranges[n.index] < range - 0.25 * self.by.patch)
    }
}
