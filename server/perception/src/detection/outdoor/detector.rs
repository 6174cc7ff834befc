//! From a scan to road users.

use super::complete::whole_box;
use super::model::{CLASSES, OutdoorModel};
use super::segments::{Segment, segments};
use super::standing::Standing;
use super::traits::{Shape, Surroundings, Traits};
use super::{OutdoorParams, trained};
use crate::cloud::{CloudError, ShapeFeatures};
use crate::detection::sides::Sides;
use crate::detection::{Descriptor, Detection, Structure};
use nalgebra::{Point3, Vector3};
use percept_geometry::shapes::convex_intersection_area;
use percept_geometry::{ObjectClass, OrientedBox3, Plane, PointCloud};
use rayon::prelude::*;

/// Two boxes that share more than this part of the smaller one's footprint are one object.
const SAME_SHARE: f64 = 0.3;

/// A part of a scan that may be one object, before it is decided.
#[derive(Debug, Clone)]
pub struct OutdoorCandidate {
    /// Its points, in the scan's frame.
    pub points: Vec<Point3<f32>>,
    /// The numbers that it is judged by.
    pub traits: Traits,
    /// Probability of each of [`CLASSES`].
    pub posterior: [f64; CLASSES.len()],
    /// Number of the candidate that it is a part of; later in the list.
    pub parent: Option<usize>,
    is_narrow: bool,
    shape: Shape,
}

impl OutdoorCandidate {
    /// The box that it has if it is of this class.
    pub fn bbox(&self, class: ObjectClass) -> OrientedBox3 {
        whole_box(&self.shape, class)
    }

    /// Probability that it is an object of any class.
    fn likely(&self) -> f64 {
        1.0 - self.posterior[0]
    }
}

/// Finds road users in single scans of a lidar. Holds parameters and a model and no memory.
#[derive(Debug, Clone)]
pub struct OutdoorDetector {
    params: OutdoorParams,
    model: OutdoorModel,
}

impl OutdoorDetector {
    /// A detector with the built-in model.
    ///
    /// # Errors
    /// `Input` naming the parameter that is out of bounds.
    pub fn new(params: OutdoorParams) -> Result<Self, CloudError> {
        Self::with_model(params, trained::model())
    }

    /// A detector with another model.
    ///
    /// # Errors
    /// As [`OutdoorDetector::new`].
    pub fn with_model(params: OutdoorParams, model: OutdoorModel) -> Result<Self, CloudError> {
        params.validate()?;
        Ok(Self { params, model })
    }

    /// The parameters.
    pub fn params(&self) -> &OutdoorParams {
        &self.params
    }

    /// The objects in a scan in its sensor's frame (z up, metres), the surest first. A scan without anything on a
    /// ground has none; points that are not finite are passed over.
    ///
    /// # Errors
    /// `Input` if a channel of the scan has another length.
    pub fn detect(&self, scan: &PointCloud) -> Result<Vec<Detection>, CloudError> {
        let candidates = self.candidates(scan)?;
        let mut chosen: Vec<(ObjectClass, f64, OrientedBox3, &OutdoorCandidate)> =
            choose(&candidates, self.params.min_confidence)
                .into_iter()
                .filter_map(|i| {
                    let candidate = &candidates[i];
                    let (class, confidence) = self.named(candidate)?;
                    Some((class, confidence, candidate.bbox(class), candidate))
                })
                .collect();
        // The surest first, then of the unknown the largest.
        let order =
            |(class, confidence, _, candidate): &(ObjectClass, f64, OrientedBox3, &OutdoorCandidate)| match class {
                ObjectClass::Unknown => (true, -(candidate.points.len() as f64)),
                _ => (false, -confidence),
            };
        chosen.sort_by(|a, b| {
            let (a, b) = (order(a), order(b));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
        });
        let mut out: Vec<Detection> = Vec::new();
        for (class, confidence, bbox, candidate) in chosen {
            if out.iter().any(|d| is_same(&d.bbox, &bbox)) {
                continue;
            }
            let Some(features) = ShapeFeatures::of(&candidate.points) else { continue };
            let floor = Plane::through(&Point3::new(0.0, 0.0, candidate.shape.ground), Vector3::z_axis());
            let sides = Sides::of(&candidate.points);
            let descriptor = Descriptor::of(&candidate.points, &bbox, &sides, &Structure { floor, walls: vec![] });
            let (centroid, num_points) = (features.centroid, features.num_points);
            out.push(Detection { class, confidence, bbox, centroid, num_points, features, descriptor });
        }
        Ok(out)
    }

    /// All parts of a scan that are judged, those of smaller gaps first. The model is trained with these.
    ///
    /// # Errors
    /// As [`OutdoorDetector::detect`].
    pub fn candidates(&self, scan: &PointCloud) -> Result<Vec<OutdoorCandidate>, CloudError> {
        scan.validate()?;
        let standing = Standing::of(&scan.positions, &self.params)?;
        let segments = segments(&standing, &self.params);
        let around = Surroundings::new(&standing, &self.params);
        let shape = |s: &Segment| Shape::of(&s.points, &standing, &around, &self.params);
        let shapes: Vec<Option<Shape>> = segments.par_iter().with_min_len(8).map(shape).collect();
        // What is too long is no candidate, nor is what that is a part of.
        let mut number = 0;
        let numbers: Vec<Option<usize>> = shapes
            .iter()
            .map(|s| {
                number += usize::from(s.is_some());
                s.is_some().then(|| number - 1)
            })
            .collect();
        Ok(shapes
            .into_iter()
            .zip(&segments)
            .filter_map(|(shape, segment)| {
                let shape = shape?;
                Some(OutdoorCandidate {
                    points: segment.points.iter().map(|&i| standing.points[i as usize]).collect(),
                    traits: shape.traits,
                    posterior: self.model.posterior(&shape.traits),
                    parent: segment.parent.and_then(|p| numbers[p]),
                    is_narrow: segment.is_narrow,
                    shape,
                })
            })
            .collect())
    }

    /// What a candidate is taken for.
    fn named(&self, candidate: &OutdoorCandidate) -> Option<(ObjectClass, f64)> {
        let (best, p) = (1..CLASSES.len()).map(|i| (i, candidate.posterior[i])).max_by(|a, b| a.1.total_cmp(&b.1))?;
        if candidate.likely() >= self.params.min_confidence {
            return Some((CLASSES[best], p));
        }
        self.params.tell_unknown.then_some((ObjectClass::Unknown, 1.0 - candidate.likely()))
    }
}

/// Of a tree of candidates those that stand for it: a whole if it is as likely an object as the likeliest of its parts,
/// else these. Where none is likely to be an object, the largest that hang together closely.
fn choose(candidates: &[OutdoorCandidate], min_confidence: f64) -> Vec<usize> {
    let mut best: Vec<f64> = candidates.iter().map(OutdoorCandidate::likely).collect();
    let mut stands = vec![true; candidates.len()];
    // Parts come before the whole.
    for i in 0..candidates.len() {
        let is_some_object = best[i] >= min_confidence;
        stands[i] = if is_some_object { candidates[i].likely() >= best[i] } else { candidates[i].is_narrow };
        if let Some(parent) = candidates[i].parent {
            best[parent] = best[parent].max(best[i]);
        }
    }
    // From the roots down: what is part of a chosen one is not chosen.
    let mut is_taken = vec![false; candidates.len()];
    let mut out = Vec::new();
    for i in (0..candidates.len()).rev() {
        is_taken[i] = candidates[i].parent.is_some_and(|p| is_taken[p]);
        if !is_taken[i] && stands[i] {
            is_taken[i] = true;
            out.push(i);
        }
    }
    out.reverse();
    out
}

fn is_same(a: &OrientedBox3, b: &OrientedBox3) -> bool {
    let reach = 0.5 * (a.size.xy().norm() + b.size.xy().norm());
    if (a.center().xy() - b.center().xy()).norm() > reach {
        return false;
    }
    let least = (a.size.x * a.size.y).min(b.size.x * b.size.y);
    convex_intersection_area(&a.footprint(), &b.footprint()) > SAME_SHARE * least
}
