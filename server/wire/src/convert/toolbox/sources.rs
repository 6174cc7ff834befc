//! Which clouds a request works on.

use crate::convert::maps;
use crate::v1;
use percept_service::Result;
use percept_service::toolbox::SessionCloud;

/// A request to the toolbox.
pub trait Sources {
    /// Its clouds, by their fields.
    fn sources(&self) -> Vec<(&'static str, Option<&v1::CloudSource>)>;
}

/// The clouds of sessions among them.
///
/// # Errors
/// A part of a cloud that is none, naming the field.
pub fn session_clouds(request: &impl Sources) -> Result<Vec<SessionCloud>> {
    let mut out = vec![];
    for (field, source) in request.sources() {
        let Some(v1::cloud_source::Source::Session(wanted)) = source.and_then(|s| s.source.as_ref()) else { continue };
        let field = format!("{field}.session");
        let around = maps::around(wanted.centre.as_ref(), wanted.radius_m).map_err(|e| e.within(&field))?;
        out.push(SessionCloud { field, session: wanted.session_id.clone(), around });
    }
    Ok(out)
}

macro_rules! sources {
    ($($request:ident { $($field:ident),* })+) => {$(
        impl Sources for v1::$request {
            fn sources(&self) -> Vec<(&'static str, Option<&v1::CloudSource>)> {
                vec![$((stringify!($field), self.$field.as_ref())),*]
            }
        }
    )+};
}

sources! {
    UploadCloudRequest { cloud }
    ListCloudsRequest {}
    DownloadCloudRequest {}
    DropCloudRequest {}
    DecodeCloudRequest {}
    EncodeCloudRequest { cloud }
    RemoveNonFiniteRequest { cloud }
    SamplePointsRequest { cloud }
    CropCloudRequest { cloud }
    TransformCloudRequest { cloud }
    RemoveRadiusOutliersRequest { cloud }
    RemoveStatisticalOutliersRequest { cloud }
    DownsampleVoxelsRequest { cloud }
    EstimateNormalsRequest { cloud }
    FindNeighboursRequest { cloud }
    ComputeLocalFeaturesRequest { cloud }
    ComputeShapeFeaturesRequest { cloud }
    FitBoxesRequest { cloud }
    ComputeConvexHullRequest { cloud }
    SegmentPlanesRequest { cloud }
    SegmentGroundRequest { cloud }
    ClusterPointsRequest { cloud }
    GrowRegionsRequest { cloud }
    ComputeSupervoxelsRequest { cloud }
    GroupConvexRequest {}
    PlanOnMapRequest {}
    ValidateOnMapRequest {}
    DrawPathOnMapRequest {}
    SegmentObjectsRequest { cloud }
    DetectObjectsRequest { cloud }
    RegisterCloudsRequest { source, target }
    RegisterCloudsGloballyRequest { source, target }
    ComputePointFeaturesRequest { cloud }
    UnprojectDepthRequest {}
    ConvertDepthRequest {}
    ConvertColourRequest {}
    FilterDepthRequest {}
    ComputeDepthNormalsRequest {}
    SegmentDepthPlanesRequest {}
    FindDepthEdgesRequest {}
    RegisterColourRequest {}
    ExtractFeaturesRequest {}
    DetectInImageRequest {}
    ListImageDetectorsRequest {}
    MatchFeaturesRequest {}
    EstimateEssentialRequest {}
    EstimateHomographyRequest {}
    EstimateTwoViewRequest {}
    TriangulatePointsRequest {}
    SolvePnpRequest {}
    RenderCloudRequest { cloud }
    RenderDepthRequest {}
    RunPipelineRequest { cloud }
}
