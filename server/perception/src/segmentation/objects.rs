//! Objects on a table or a floor, from one view.

use super::occlusion::{Hidden, join_hidden};
use super::{ConvexityParams, SupervoxelParams, group_convex, supervoxels};
use crate::cloud::{CloudError, Clusters, PlaneParams, at_least, positive, segment_plane};
use crate::search::KdTree;
use nalgebra::Point3;
use percept_geometry::{GeometryError, Plane, cloud::is_finite};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How [`segment_objects`] works.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObjectsParams {
    /// How the plane that objects stand on is searched.
    pub plane: PlaneParams,
    /// What is less high above the plane belongs to it, metres.
    pub min_height_m: f64,
    /// Patches of surface.
    pub supervoxels: SupervoxelParams,
    /// What makes them one object.
    pub convexity: ConvexityParams,
    /// Widest gap, hidden by something in front, over which parts of one plane are one object, metres.
    pub max_hidden_gap_m: f64,
    /// Most that such parts turn from each other, radians.
    pub max_hidden_angle_rad: f64,
    /// Objects have at least so many points.
    pub min_points: usize,
    /// Points of no object go to the nearest one within this distance, metres.
    pub rest_m: f64,
}

impl Default for ObjectsParams {
    fn default() -> Self {
        Self {
            plane: PlaneParams { distance_m: 0.006, ..PlaneParams::default() },
            min_height_m: 0.006,
            supervoxels: SupervoxelParams::default(),
            convexity: ConvexityParams::default(),
            max_hidden_gap_m: 0.2,
            max_hidden_angle_rad: 0.1,
            min_points: 300,
            rest_m: 0.02,
        }
    }
}

impl ObjectsParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        self.plane.validate()?;
        self.supervoxels.validate()?;
        self.convexity.validate()?;
        positive("min_height_m", self.min_height_m)?;
        positive("rest_m", self.rest_m)?;
        positive("max_hidden_gap_m", self.max_hidden_gap_m)?;
        positive("max_hidden_angle_rad", self.max_hidden_angle_rad)?;
        at_least("min_points", self.min_points, 1, "at least 1")
    }
}

/// Objects of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Objects {
    /// The plane that they stand on, its normal towards `viewpoint`; none if there is no plane, nor are there objects.
    pub support: Option<Plane>,
    /// The object of each point.
    pub clusters: Clusters,
}

/// What stands on the largest plane, seen from `viewpoint` (metres, the frame of the cloud): points above the plane are
/// cut into supervoxels, and these joined to objects where the surface is convex, or where it goes on behind something that
/// hides it. Objects may touch and stand on each
/// other; one that is itself concave may be parted.
///
/// # Errors
/// `OutOfRange` naming the parameter, `VoxelTooSmall`.
pub fn segment_objects(
    points: &[Point3<f32>],
    viewpoint: &Point3<f64>,
    params: &ObjectsParams,
) -> Result<Objects, CloudError> {
    params.validate()?;
    let none = || Clusters { labels: vec![None; points.len()], num_clusters: 0 };
    let Some(found) = segment_plane(points, &params.plane)? else {
        return Ok(Objects { support: None, clusters: none() });
    };
    let support = towards(found.plane, viewpoint);
    let above = |p: &Point3<f32>| is_finite(p) && support.distance(&p.cast()) > params.min_height_m;
    let indices: Vec<usize> = (0..points.len()).filter(|&i| above(&points[i])).collect();
    let standing: Vec<Point3<f32>> = indices.iter().map(|&i| points[i]).collect();
    let parts = supervoxels(&standing, viewpoint, &params.supervoxels)?;
    let mut groups = group_convex(&parts, params.supervoxels.seed_size_m, &params.convexity)?;
    let hidden = Hidden {
        viewpoint,
        max_gap: params.max_hidden_gap_m,
        max_angle: params.max_hidden_angle_rad,
        patch: params.supervoxels.seed_size_m,
    };
    join_hidden(&standing, &parts, &mut groups, &hidden);
    let of_part = |label: &Option<u32>| label.map(|l| groups[l as usize]);
    let (mut labels, num_clusters) = large_only(parts.labels.iter().map(of_part).collect(), params.min_points);
    give_rest(&standing, &mut labels, params.rest_m as f32);
    let mut clusters = none();
    clusters.num_clusters = num_clusters;
    indices.iter().zip(labels).for_each(|(&i, label)| clusters.labels[i] = label);
    Ok(Objects { support: Some(support), clusters })
}

fn towards(plane: Plane, viewpoint: &Point3<f64>) -> Plane {
    if plane.distance(viewpoint) < 0.0 { Plane { normal: -plane.normal, offset: -plane.offset } } else { plane }
}

/// Groups of at least so many points, numbered anew by their first.
fn large_only(labels: Vec<Option<u32>>, min_points: usize) -> (Vec<Option<u32>>, usize) {
    let groups = labels.iter().flatten().max().map_or(0, |&m| m as usize + 1);
    let mut sizes = vec![0usize; groups];
    labels.iter().flatten().for_each(|&l| sizes[l as usize] += 1);
    let mut number = vec![None; groups];
    let mut count = 0;
    let mut renumber = |l: u32| {
        (sizes[l as usize] >= min_points).then(|| {
            *number[l as usize].get_or_insert_with(|| {
                count += 1;
                count as u32 - 1
            })
        })
    };
    let out = labels.into_iter().map(|l| l.and_then(&mut renumber)).collect();
    (out, count)
}

/// Points of no object go to that of the nearest point that has one.
fn give_rest(points: &[Point3<f32>], labels: &mut [Option<u32>], within: f32) {
    let given: Vec<usize> = (0..points.len()).filter(|&i| labels[i].is_some()).collect();
    let rest: Vec<usize> = (0..points.len()).filter(|&i| labels[i].is_none()).collect();
    if given.is_empty() || rest.is_empty() {
        return;
    }
    let tree = KdTree::build(&given.iter().map(|&i| points[i]).collect::<Vec<_>>());
    let nearest: Vec<Option<usize>> =
        rest.par_iter().map(|&i| tree.nearest_within(&points[i], within).map(|n| given[n.index])).collect();
    for (&i, near) in rest.iter().zip(&nearest) {
        labels[i] = near.and_then(|near| labels[near]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet(origin: [f32; 3], u: [f32; 3], v: [f32; 3], out: &mut Vec<Point3<f32>>) {
        let (o, u, v) = (nalgebra::Vector3::from(origin), nalgebra::Vector3::from(u), nalgebra::Vector3::from(v));
        let (nu, nv) = ((u.norm() / 0.002) as usize, (v.norm() / 0.002) as usize);
        for i in 0..nu * nv {
            out.push(Point3::from(o + u * ((i % nu) as f32 / nu as f32) + v * ((i / nu) as f32 / nv as f32)));
        }
    }

    #[test]
    fn a_small_box_on_a_large_one_is_an_object_of_its_own() {
        let mut points = Vec::new();
        sheet([-0.4, -0.4, 0.0], [0.8, 0.0, 0.0], [0.0, 0.8, 0.0], &mut points);
        let table = points.len();
        // Top and the two sides towards the viewpoint.
        sheet([-0.1, -0.1, 0.1], [0.2, 0.0, 0.0], [0.0, 0.2, 0.0], &mut points);
        sheet([-0.1, -0.1, 0.0], [0.2, 0.0, 0.0], [0.0, 0.0, 0.1], &mut points);
        sheet([0.1, -0.1, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.1], &mut points);
        // What is under the small one is not seen.
        points.retain(|p| p.z != 0.1 || p.x.abs().max(p.y.abs()) > 0.05);
        let large = points.len();
        sheet([-0.05, -0.05, 0.2], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], &mut points);
        sheet([-0.05, -0.05, 0.1], [0.1, 0.0, 0.0], [0.0, 0.0, 0.1], &mut points);
        sheet([0.05, -0.05, 0.1], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1], &mut points);
        let viewpoint = Point3::new(0.8, -0.8, 0.9);
        let found = segment_objects(&points, &viewpoint, &ObjectsParams::default()).unwrap();
        assert_eq!(found.clusters.num_clusters, 2);
        let share = |range: std::ops::Range<usize>, label: Option<u32>| {
            let n = range.len() as f64;
            found.clusters.labels[range].iter().filter(|l| **l == label).count() as f64 / n
        };
        let label = |i: usize| found.clusters.labels[i];
        assert!(share(0..table, None) > 0.98);
        assert!(share(table..large, label(table)) > 0.9);
        // Patches at the foot of the small one go to either.
        let middle_of_top = large + 1275;
        assert!(share(large..points.len(), label(middle_of_top)) > 0.7);
        assert_ne!(label(table), label(middle_of_top));
    }

    #[test]
    fn nothing_stands_in_a_cloud_without_a_plane() {
        let with =
            |points: &[Point3<f32>]| segment_objects(points, &Point3::origin(), &ObjectsParams::default()).unwrap();
        assert_eq!(with(&[]).support, None);
        assert_eq!(with(&[Point3::from([f32::NAN; 3]); 5]).clusters.labels, [None; 5]);
    }
}
