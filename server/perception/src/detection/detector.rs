//! From a cloud to objects.

use super::classify::most_probable;
use super::propose::propose;
use super::{Candidate, Classifier, Descriptor, DetectionParams, GaussianClassifier, find_structure};
use crate::cloud::{CloudError, RadiusOutlierParams, ShapeFeatures, radius_outliers, voxel_downsample};
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
    /// Upright box, reaching down to the floor unless the object hangs on a wall.
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
        Self::with_classifier(params, Arc::new(GaussianClassifier))
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
        let lone = RadiusOutlierParams { radius_m: 2.5 * params.voxel_size_m, min_neighbors: params.min_neighbors };
        let kept = radius_outliers(&thinned.positions, &lone)?;
        let points: Vec<Point3<f32>> = kept.iter().map(|&i| thinned.positions[i]).collect();
        let structure = find_structure(&points, params)?;
        let proposals = propose(&points, &structure, params)?;
        Ok(proposals
            .iter()
            .filter_map(|p| {
                let features = ShapeFeatures::of(&p.points)?;
                let descriptor = Descriptor::of(&p.points, &p.bbox, &structure);
                let (points, bbox) = (&p.points[..], &p.bbox);
                let candidate = Candidate { points, bbox, features: &features, descriptor: &descriptor };
                let (class, confidence) = most_probable(&self.classifier.posterior(&candidate));
                Some(Detection {
                    class,
                    confidence,
                    bbox: p.bbox,
                    centroid: features.centroid,
                    num_points: features.num_points,
                    features,
                    descriptor,
                })
            })
            .collect())
    }
}
