//! From a cloud to objects.

use super::amodal::completed;
use super::classify::most_probable;
use super::propose::propose;
use super::{Candidate, Classifier, Descriptor, DetectionParams, GaussianClassifier, find_structure};
use crate::cloud::{CloudError, ShapeFeatures, voxel_downsample};
use nalgebra::Point3;
use percept_geometry::{ObjectClass, OrientedBox3, PointCloud};
use std::sync::Arc;

/// An object found in a cloud, in the cloud's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// What it most probably is.
    pub class: ObjectClass,
    /// Probability of the class, 0..1.
    pub confidence: f64,
    /// Upright box, reaching down to the floor unless the object hangs on a wall, and grown to what is hidden of round things
    /// and of boxes.
    pub bbox: OrientedBox3,
    /// Mean of its points (one a voxel), metres.
    pub centroid: Point3<f64>,
    /// Voxels that it takes.
    pub num_points: usize,
    /// Shape of its points.
    pub features: ShapeFeatures,
    /// The numbers that the built-in classifier judged by.
    pub descriptor: Descriptor,
}

/// Finds objects. Holds parameters and a classifier and no memory; clones are cheap.
#[derive(Debug, Clone)]
pub struct Detector {
    params: DetectionParams,
    classifier: Arc<dyn Classifier>,
}

impl Detector {
    /// A detector with the built-in classifier.
    ///
    /// # Errors
    /// `Input` naming the parameter that is out of bounds.
    pub fn new(params: DetectionParams) -> Result<Self, CloudError> {
        Self::with_classifier(params, Arc::new(GaussianClassifier::default()))
    }

    /// A detector with another classifier.
    ///
    /// # Errors
    /// As [`Detector::new`].
    pub fn with_classifier(params: DetectionParams, classifier: Arc<dyn Classifier>) -> Result<Self, CloudError> {
        params.validate()?;
        Ok(Self { params, classifier })
    }

    /// The parameters.
    pub fn params(&self) -> &DetectionParams {
        &self.params
    }

    /// The objects in a cloud whose frame has z up and the floor near z = 0; largest number of points first.
    /// An empty cloud, or one without anything on a floor, has none.
    ///
    /// # Errors
    /// `Input` if a channel of the cloud has another length; `VoxelTooSmall` if coordinates are too large.
    pub fn detect(&self, cloud: &PointCloud) -> Result<Vec<Detection>, CloudError> {
        cloud.validate()?;
        let params = &self.params;
        let thinned = voxel_downsample(&PointCloud::from_positions(cloud.positions.clone()), params.voxel_size_m)?;
        let points = thinned.positions;
        let structure = find_structure(&points, params)?;
        let proposals = propose(&points, &structure, params)?;
        Ok(proposals
            .iter()
            .filter_map(|p| {
                let features = ShapeFeatures::of(&p.points)?;
                let descriptor = Descriptor::of(&p.points, &p.bbox, &p.sides, &structure);
                let candidate =
                    Candidate { points: &p.points, bbox: &p.bbox, features: &features, descriptor: &descriptor };
                let (class, confidence) = most_probable(&self.classifier.posterior(&candidate));
                Some(Detection {
                    class,
                    confidence,
                    bbox: completed(class, &p.bbox, &p.points, &points, &structure),
                    centroid: features.centroid,
                    num_points: features.num_points,
                    features,
                    descriptor,
                })
            })
            .collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    /// Points on the faces of an upright box but its bottom, `step` apart.
    fn faces(b: &OrientedBox3, step: f64, out: &mut Vec<Point3<f32>>) {
        let n = b.size.map(|s| (s / step).ceil() as i32);
        for (i, j, k) in (0..=n.x).flat_map(|i| (0..=n.y).flat_map(move |j| (0..=n.z).map(move |k| (i, j, k)))) {
            if i == 0 || i == n.x || j == 0 || j == n.y || k == n.z {
                let at = |i: i32, n: i32| f64::from(i) / f64::from(n.max(1)) - 0.5;
                let p = Vector3::new(at(i, n.x), at(j, n.y), at(k, n.z)).component_mul(&b.size);
                out.push((b.t_frame_box * Point3::from(p)).cast());
            }
        }
    }

    /// Floor and walls of a room of 5 x 4 m, 2.5 m high, with its middle at the origin.
    fn room() -> Vec<Point3<f32>> {
        let mut out = Vec::new();
        let slab = |center: [f64; 3], size: [f64; 3]| OrientedBox3::upright(center.into(), size.into(), 0.0);
        faces(&slab([0.0, 0.0, -0.005], [5.0, 4.0, 0.01]), 0.04, &mut out);
        for side in [-1.0, 1.0] {
            faces(&slab([side * 2.5, 0.0, 1.25], [0.01, 4.0, 2.5]), 0.04, &mut out);
            faces(&slab([0.0, side * 2.0, 1.25], [5.0, 0.01, 2.5]), 0.04, &mut out);
        }
        out
    }

    fn detect(points: Vec<Point3<f32>>) -> Vec<Detection> {
        let detector = Detector::new(DetectionParams::default()).unwrap();
        detector.detect(&PointCloud::from_positions(points)).unwrap()
    }

    #[test]
    fn an_empty_room_has_no_objects() {
        assert_eq!(detect(room()), []);
    }

    #[test]
    fn boxes_in_a_room_are_found_where_they_stand() {
        let truth = [
            OrientedBox3::upright(Point3::new(1.0, 0.5, 0.25), Vector3::new(0.5, 0.4, 0.5), 0.4),
            OrientedBox3::upright(Point3::new(-1.0, -0.8, 0.2), Vector3::new(0.6, 0.45, 0.4), -0.2),
        ];
        let mut points = room();
        truth.iter().for_each(|b| faces(b, 0.03, &mut points));
        let found = detect(points);
        assert_eq!(found.len(), 2);
        for b in &truth {
            let best = found.iter().max_by(|x, y| x.bbox.iou_upright(b).total_cmp(&y.bbox.iou_upright(b))).unwrap();
            assert!(best.bbox.iou_upright(b) > 0.7, "{:?}", best.bbox);
            assert_eq!(best.class, ObjectClass::Box);
        }
    }

    #[test]
    fn a_cabinet_at_a_wall_is_not_taken_for_wall() {
        let cabinet = OrientedBox3::upright(Point3::new(0.5, 1.8, 0.9), Vector3::new(0.9, 0.36, 1.8), 0.0);
        let mut points = room();
        faces(&cabinet, 0.03, &mut points);
        let found = detect(points);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].class, ObjectClass::Shelf);
        assert!(found[0].bbox.iou_upright(&cabinet) > 0.7, "{:?}", found[0].bbox);
    }

    #[test]
    fn both_faces_of_a_thin_wall_are_wall_and_what_touches_one_is_a_thing() {
        // Seen from both rooms, too low to be known as wall by its height. 0.15 m lie between the faces, and the first lies where
        // voxels meet, so that noise makes two sheets of it.
        let faces_of_wall = [0.19, 0.21, 0.35]
            .map(|y| OrientedBox3::upright(Point3::new(0.0, y, 0.9), Vector3::new(2.4, 0.002, 1.8), 0.0));
        let thing = OrientedBox3::upright(Point3::new(0.4, 0.6, 0.25), Vector3::new(0.5, 0.45, 0.5), 0.0);
        let mut points = room();
        faces_of_wall.iter().chain([&thing]).for_each(|b| faces(b, 0.03, &mut points));
        let found = detect(points);
        assert_eq!(found.len(), 1, "{:?}", found.iter().map(|d| d.bbox).collect::<Vec<_>>());
        assert!(found[0].bbox.iou_upright(&thing) > 0.7, "{:?}", found[0].bbox);
    }

    #[test]
    fn a_table_top_without_visible_legs_stands_on_the_floor() {
        let top = OrientedBox3::upright(Point3::new(0.0, 0.0, 0.72), Vector3::new(1.2, 0.8, 0.03), 0.0);
        let mut points = room();
        faces(&top, 0.03, &mut points);
        let detector = Detector::new(DetectionParams { min_coverage: 0.0, ..DetectionParams::default() }).unwrap();
        let found = detector.detect(&PointCloud::from_positions(points)).unwrap();
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].class, ObjectClass::Table);
        let bottom = found[0].bbox.center().z - 0.5 * found[0].bbox.size.z;
        assert!(bottom.abs() < 0.03, "{bottom}");
    }

    #[test]
    fn a_table_seen_from_below_its_top_has_its_legs() {
        // Half the edges of its top, and legs of which two stand alone.
        let slab =
            |x: f64, y: f64, z: f64, size: [f64; 3]| OrientedBox3::upright(Point3::new(x, y, z), size.into(), 0.0);
        let legs = [(-0.5, -0.35), (0.5, -0.35), (-0.5, 0.35), (0.5, 0.35)];
        let mut points = room();
        legs.iter().for_each(|(x, y)| faces(&slab(*x, *y, 0.36, [0.06, 0.06, 0.72]), 0.03, &mut points));
        for x in [-0.4, 0.4] {
            faces(&slab(x, 0.35, 0.71, [0.26, 0.06, 0.05]), 0.03, &mut points);
        }
        // A bin as high as that, but no leg.
        faces(&slab(-0.5, -1.2, 0.36, [0.35, 0.35, 0.72]), 0.03, &mut points);
        let found = detect(points);
        assert_eq!(found.len(), 2, "{:?}", found.iter().map(|d| (d.class, d.bbox)).collect::<Vec<_>>());
        let whole = slab(0.0, 0.0, 0.37, [1.06, 0.76, 0.74]);
        let boxes = found.iter().map(|d| (d.class, d.bbox.center().coords, d.bbox.size)).collect::<Vec<_>>();
        assert!(found.iter().any(|d| d.bbox.iou_upright(&whole) > 0.7), "{boxes:?}");
    }

    #[test]
    fn the_floor_may_lie_off_zero_and_tilt_a_little() {
        let truth = OrientedBox3::upright(Point3::new(1.0, 0.5, 0.25), Vector3::new(0.5, 0.4, 0.5), 0.4);
        let mut points = room();
        faces(&truth, 0.03, &mut points);
        let t = percept_geometry::se3::exp(&nalgebra::Vector6::new(3.0, 1.0, 0.06, 0.02, -0.02, 0.5));
        let found = detect(PointCloud::from_positions(points).transformed(&t).positions);
        assert_eq!(found.len(), 1);
        assert!(found[0].bbox.iou_upright(&truth.transformed(&t)) > 0.6);
    }

    #[test]
    fn degenerate_clouds_have_no_objects() {
        assert_eq!(detect(vec![]), []);
        assert_eq!(detect(vec![Point3::origin()]), []);
        assert_eq!(detect(vec![Point3::new(1.0, 2.0, 0.5); 1000]), []);
        assert_eq!(detect(vec![Point3::from([f32::NAN; 3]); 10]), []);
        assert_eq!(detect(vec![Point3::new(1e7, -1e7, 1.0); 100]), []);
        assert_eq!(detect((0..1000).map(|i| Point3::new(i as f32 * 0.01, 0.0, 0.5)).collect()), []);
    }

    #[test]
    fn coordinates_beyond_the_voxels_and_bad_parameters_are_named() {
        let detector = Detector::new(DetectionParams::default()).unwrap();
        let far = PointCloud::from_positions(vec![Point3::new(1e30, 0.0, 0.0)]);
        assert!(matches!(detector.detect(&far), Err(CloudError::VoxelTooSmall { .. })));
        let error = Detector::new(DetectionParams { cluster_eps_m: 0.01, ..Default::default() }).unwrap_err();
        assert!(error.to_string().starts_with("cluster_eps_m"), "{error}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn any_cloud_gives_boxes_of_allowed_size_twice_the_same(
            points in prop::collection::vec(prop::array::uniform3(-2.0..2.0f32), 0..3000),
        ) {
            let points: Vec<Point3<f32>> = points.into_iter().map(Point3::from).collect();
            let found = detect(points.clone());
            for d in &found {
                prop_assert!(d.bbox.size.iter().all(|s| s.is_finite() && *s >= 0.0));
                prop_assert!((0.0..=1.0).contains(&d.confidence));
            }
            prop_assert_eq!(found, detect(points));
        }
    }
}
