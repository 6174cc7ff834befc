//! Operations in turn on one cloud that stays here.

use super::{Clustering, Environment, NormalOrientation, Region, Sample, Toolbox, clouds, regions, subsets};
use crate::{Error, Result};
use nalgebra::{Point3, Unit, Vector3};
use percept_geometry::{OrientedBox3, PointCloud, Pose};
use percept_perception::cloud::{
    Clusters, NormalParams, PlanesParams, RadiusOutlierParams, ShapeFeatures, StatisticalOutlierParams, TypedPlane,
};
use percept_perception::detection::Detection;
use percept_perception::segmentation::{Ground, GroundParams, Objects, ObjectsParams, RegionGrowingParams};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Steps of one request, at most.
const MAX_STEPS: usize = 64;

/// Which points go on after planes, or ground, were found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlaneRemainder {
    /// Those of no plane.
    Rest,
    /// Those of planes.
    Planes,
    /// All.
    All,
}

/// An operation on the cloud that the step before left.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// [`clouds::remove_statistical_outliers`].
    RemoveStatisticalOutliers(StatisticalOutlierParams),
    /// [`clouds::remove_radius_outliers`].
    RemoveRadiusOutliers(RadiusOutlierParams),
    /// Points with a non-finite coordinate go.
    RemoveNonFinite,
    /// [`clouds::downsample_voxels`], metres.
    DownsampleVoxels(f64),
    /// To another frame, by `t_a_b`.
    Transform(Pose),
    /// [`clouds::estimate_normals`].
    EstimateNormals(NormalParams, NormalOrientation),
    /// [`clouds::segment_planes`], with what is up.
    SegmentPlanes(Unit<Vector3<f64>>, PlanesParams, PlaneRemainder),
    /// [`clouds::cluster_points`].
    ClusterPoints(Clustering),
    /// [`clouds::shape_features`] of each cluster, or of the whole cloud before any were found.
    ShapeFeatures,
    /// [`clouds::detect_objects`].
    DetectObjects(Environment),
    /// [`subsets::sample_points`].
    SamplePoints(Sample),
    /// [`subsets::crop_cloud`], and whether what is outside is kept.
    Crop(Region, bool),
    /// [`regions::segment_ground`].
    SegmentGround(GroundParams, PlaneRemainder),
    /// [`regions::grow_regions`].
    GrowRegions(RegionGrowingParams),
    /// [`regions::segment_objects`], and the viewpoint, metres.
    SegmentObjects(ObjectsParams, Point3<f64>),
}

impl Step {
    /// Its field in the contract.
    const fn name(&self) -> &'static str {
        match self {
            Self::RemoveStatisticalOutliers(_) => "remove_statistical_outliers",
            Self::RemoveRadiusOutliers(_) => "remove_radius_outliers",
            Self::RemoveNonFinite => "remove_non_finite",
            Self::DownsampleVoxels(_) => "downsample_voxels",
            Self::Transform(_) => "transform_cloud",
            Self::EstimateNormals(..) => "estimate_normals",
            Self::SegmentPlanes(..) => "segment_planes",
            Self::ClusterPoints(_) => "cluster_points",
            Self::ShapeFeatures => "compute_shape_features",
            Self::DetectObjects(_) => "detect_objects",
            Self::SamplePoints(_) => "sample_points",
            Self::Crop(..) => "crop_cloud",
            Self::SegmentGround(..) => "segment_ground",
            Self::GrowRegions(_) => "grow_regions",
            Self::SegmentObjects(..) => "segment_objects",
        }
    }
}

/// What a step found; indices and labels are of the points that it was given.
#[derive(Debug, Clone, PartialEq)]
pub enum Found {
    /// The cloud is all there is.
    Nothing,
    /// Indices of the kept points.
    Kept(Vec<usize>),
    /// Planes, largest first.
    Planes(Vec<TypedPlane>),
    /// Groups.
    Clusters(Clusters),
    /// Shape of the whole cloud.
    Shape(ShapeFeatures, OrientedBox3),
    /// Shapes of the clusters with their labels.
    Shapes(Vec<(u32, ShapeFeatures, OrientedBox3)>),
    /// Objects.
    Detections(Vec<Detection>),
    /// What of a scan is ground.
    Ground(Ground),
    /// Smooth regions.
    Regions(Clusters),
    /// What stands on a plane.
    Objects(Objects),
}

/// What became of a step.
#[derive(Debug, Clone, PartialEq)]
pub struct StepReport {
    /// The step's field in the contract.
    pub operation: &'static str,
    /// Points that it was given.
    pub num_points_in: usize,
    /// Points that it left.
    pub num_points_out: usize,
    /// Time that it took.
    pub elapsed: Duration,
    /// What it found.
    pub found: Found,
}

/// What the steps work on.
struct Bench {
    cloud: Arc<PointCloud>,
    clusters: Option<Clusters>,
}

impl Toolbox {
    /// Runs the steps in turn; the cloud that the last one left, and what each found.
    ///
    /// # Errors
    /// Those of the steps, with `steps[i].name.` before their field; `STEPS_INVALID`, `COMPUTATION_TOO_LONG`.
    pub fn run_pipeline(&self, cloud: Arc<PointCloud>, steps: &[Step]) -> Result<(Arc<PointCloud>, Vec<StepReport>)> {
        if !(1..=MAX_STEPS).contains(&steps.len()) {
            let words = format!("steps has {} entries; send 1 to {MAX_STEPS}", steps.len());
            return Err(Error::invalid("STEPS_INVALID", "steps", words));
        }
        let mut bench = Bench { cloud, clusters: None };
        let mut reports = Vec::with_capacity(steps.len());
        for (i, step) in steps.iter().enumerate() {
            let operation = step.name();
            self.begin_step(i, steps.len(), operation)?;
            let (begin, num_points_in) = (Instant::now(), bench.cloud.len());
            let found = self.step(&mut bench, step).map_err(|e| e.within(&format!("steps[{i}].{operation}")))?;
            let (elapsed, num_points_out) = (begin.elapsed(), bench.cloud.len());
            reports.push(StepReport { operation, num_points_in, num_points_out, elapsed, found });
        }
        Ok((bench.cloud, reports))
    }

    fn step(&self, bench: &mut Bench, step: &Step) -> Result<Found> {
        let cloud = Arc::clone(&bench.cloud);
        Ok(match step {
            Step::RemoveStatisticalOutliers(params) => bench.keep(clouds::remove_statistical_outliers(&cloud, params)?),
            Step::RemoveRadiusOutliers(params) => bench.keep(clouds::remove_radius_outliers(&cloud, params)?),
            Step::RemoveNonFinite => bench.replace(cloud.retain_finite()),
            Step::DownsampleVoxels(size) => bench.replace(clouds::downsample_voxels(&cloud, *size)?),
            Step::Transform(t_a_b) => bench.replace(cloud.transformed(t_a_b)),
            Step::EstimateNormals(params, orientation) => {
                // The points stay what they were, and their clusters with them.
                bench.cloud = Arc::new(clouds::estimate_normals(&cloud, params, orientation)?);
                Found::Nothing
            }
            Step::SegmentPlanes(up, params, remainder) => {
                let planes = clouds::segment_planes(&cloud, up, params)?;
                let inliers = planes.iter().flat_map(|p| p.segment.inliers.iter().copied());
                bench.take(inliers, *remainder);
                Found::Planes(planes)
            }
            Step::ClusterPoints(method) => {
                let clusters = clouds::cluster_points(&cloud, method)?;
                bench.clusters = Some(clusters.clone());
                Found::Clusters(clusters)
            }
            Step::ShapeFeatures => match &bench.clusters {
                Some(clusters) => Found::Shapes(shapes(&cloud, clusters)?),
                None => clouds::shape_features(&cloud.positions).map(|(f, b)| Found::Shape(f, b))?,
            },
            Step::SamplePoints(sample) => bench.keep(subsets::sample_points(&cloud, sample)?),
            Step::Crop(region, outside) => bench.keep(subsets::crop_cloud(&cloud, region, *outside)?),
            Step::SegmentGround(params, remainder) => {
                let ground = regions::segment_ground(&cloud, params)?;
                bench.take((0..cloud.len()).filter(|&i| ground.is_ground[i]), *remainder);
                Found::Ground(ground)
            }
            Step::GrowRegions(params) => {
                let grown = regions::grow_regions(&cloud, params)?;
                bench.clusters = Some(grown.clone());
                Found::Regions(grown)
            }
            Step::SegmentObjects(params, viewpoint) => {
                let objects = regions::segment_objects(&cloud, viewpoint, params)?;
                bench.clusters = Some(objects.clusters.clone());
                Found::Objects(objects)
            }
            Step::DetectObjects(environment) => {
                Found::Detections(clouds::detect_objects(&cloud, self.detector(), environment)?)
            }
        })
    }
}

impl Bench {
    fn replace(&mut self, cloud: PointCloud) -> Found {
        *self = Self { cloud: Arc::new(cloud), clusters: None };
        Found::Nothing
    }

    fn keep(&mut self, (cloud, kept): (PointCloud, Vec<usize>)) -> Found {
        self.replace(cloud);
        Found::Kept(kept)
    }

    /// Goes on with the points that were found, or the others.
    fn take(&mut self, found: impl Iterator<Item = usize>, remainder: PlaneRemainder) {
        if remainder == PlaneRemainder::All {
            return;
        }
        let mut is_found = vec![false; self.cloud.len()];
        found.for_each(|i| is_found[i] = true);
        let wanted = remainder == PlaneRemainder::Planes;
        let kept: Vec<usize> = (0..is_found.len()).filter(|&i| is_found[i] == wanted).collect();
        self.replace(self.cloud.select(&kept));
    }
}

fn shapes(cloud: &PointCloud, clusters: &Clusters) -> Result<Vec<(u32, ShapeFeatures, OrientedBox3)>> {
    let mut points = vec![vec![]; clusters.num_clusters];
    for (label, p) in clusters.labels.iter().zip(&cloud.positions) {
        if let Some(label) = label {
            points[*label as usize].push(*p);
        }
    }
    let shape = |(label, points): (usize, &Vec<_>)| clouds::shape_features(points).map(|(f, b)| (label as u32, f, b));
    points.iter().enumerate().map(shape).collect()
}
