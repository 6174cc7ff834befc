//! Steps of a pipeline, and what they found.

use super::{bytes_of_indices, filters, regions, segmentation, subsets};
use crate::convert::{geometry, required, unknown_enum};
use crate::v1;
use percept_service::toolbox::{Found, PlaneRemainder, Step, StepReport};
use percept_service::{Error, Result};

/// The steps of a request.
///
/// # Errors
/// Naming `steps[i]`; `STEP_HAS_CLOUD` if a step's request brings a cloud of its own.
pub fn steps(r: &v1::RunPipelineRequest) -> Result<Vec<Step>> {
    let step_at = |(i, s): (usize, &v1::PipelineStep)| step(s).map_err(|e| e.within(&format!("steps[{i}]")));
    r.steps.iter().enumerate().map(step_at).collect()
}

macro_rules! bare {
    ($request:ident $(, $keep:ident)?) => {{
        let alone = $request.cloud.is_none() $(&& !$request.$keep)?;
        if !alone {
            let words = "a step brings a cloud or keep_result; it works on what the step before left";
            return Err(Error::invalid("STEP_HAS_CLOUD", "cloud", words));
        }
    }};
}

fn step(s: &v1::PipelineStep) -> Result<Step> {
    use v1::pipeline_step::Step as S;
    Ok(match required("step", s.step.as_ref())? {
        S::RemoveStatisticalOutliers(r) => {
            bare!(r, keep_result);
            Step::RemoveStatisticalOutliers(filters::outlier_params(r))
        }
        S::RemoveRadiusOutliers(r) => {
            bare!(r, keep_result);
            Step::RemoveRadiusOutliers(filters::radius_params(r))
        }
        S::RemoveNonFinite(r) => {
            bare!(r, keep_result);
            Step::RemoveNonFinite
        }
        S::DownsampleVoxels(r) => {
            bare!(r, keep_result);
            Step::DownsampleVoxels(filters::voxel_size_m(r))
        }
        S::TransformCloud(r) => {
            bare!(r, keep_result);
            Step::Transform(geometry::pose("t_a_b", r.t_a_b.as_ref())?)
        }
        S::EstimateNormals(r) => {
            bare!(r, keep_result);
            Step::EstimateNormals(filters::normal_params(r), filters::normal_orientation(r)?)
        }
        S::SegmentPlanes(r) => {
            bare!(r);
            Step::SegmentPlanes(segmentation::up(r)?, segmentation::planes_params(r), remainder(s.remainder)?)
        }
        S::ClusterPoints(r) => {
            bare!(r);
            Step::ClusterPoints(segmentation::clustering(r)?)
        }
        S::ComputeShapeFeatures(r) => {
            bare!(r);
            Step::ShapeFeatures
        }
        S::DetectObjects(r) => {
            bare!(r);
            Step::DetectObjects(segmentation::environment(r)?)
        }
        S::SamplePoints(r) => {
            bare!(r, keep_result);
            Step::SamplePoints(subsets::sample(r)?)
        }
        S::CropCloud(r) => {
            bare!(r, keep_result);
            Step::Crop(subsets::region(r)?, r.outside)
        }
        S::SegmentGround(r) => {
            bare!(r);
            Step::SegmentGround(regions::ground_params(r), remainder(s.remainder)?)
        }
        S::GrowRegions(r) => {
            bare!(r);
            Step::GrowRegions(regions::region_params(r))
        }
        S::SegmentObjects(r) => {
            bare!(r);
            let (params, viewpoint) = regions::objects_params(r)?;
            Step::SegmentObjects(params, viewpoint)
        }
    })
}

fn remainder(value: i32) -> Result<PlaneRemainder> {
    use v1::PlaneRemainder as R;
    match R::try_from(value) {
        Ok(R::Unspecified | R::Rest) => Ok(PlaneRemainder::Rest),
        Ok(R::Planes) => Ok(PlaneRemainder::Planes),
        Ok(R::All) => Ok(PlaneRemainder::All),
        Err(_) => Err(unknown_enum("remainder", value)),
    }
}

/// What became of the step of that number, as a message; `quiet` leaves its answer out.
pub fn report_to(step: usize, report: &StepReport, quiet: bool) -> v1::PipelineStepResult {
    v1::PipelineStepResult {
        step: step as u32,
        num_points_in: report.num_points_in as u32,
        num_points_out: report.num_points_out as u32,
        elapsed_ms: report.elapsed.as_secs_f64() * 1e3,
        operation: report.operation.to_owned(),
        answer: if quiet { None } else { found_to(&report.found, report.num_points_in) },
    }
}

fn found_to(found: &Found, num_points: usize) -> Option<v1::pipeline_step_result::Answer> {
    use v1::pipeline_step_result::Answer as A;
    Some(match found {
        Found::Nothing => return None,
        Found::Kept(indices) => A::Indices(bytes_of_indices(indices)),
        Found::Planes(planes) => A::Planes(segmentation::planes_to(planes, num_points)),
        Found::Clusters(clusters) => A::Clusters(segmentation::clusters_to(clusters)),
        Found::Shape(features, upright_box) => A::Shape(segmentation::shape_to(&(*features, *upright_box))),
        Found::Shapes(shapes) => {
            let clusters = shapes.iter().map(|(label, features, upright_box)| v1::ClusterShape {
                label: *label,
                features: Some(segmentation::features_to(features)),
                upright_box: Some(geometry::box_to(upright_box)),
            });
            A::Shapes(v1::ClusterShapes { clusters: clusters.collect() })
        }
        Found::Detections(found) => A::Detections(segmentation::detections_to(found)),
        Found::Ground(ground) => A::Ground(regions::ground_to(ground)),
        Found::Regions(grown) => A::Regions(regions::regions_to(grown)),
        Found::Objects(objects) => A::Objects(regions::objects_to(objects)),
    })
}
