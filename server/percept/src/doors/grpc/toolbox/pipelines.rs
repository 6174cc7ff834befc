//! Pipelines: decode, call, encode.

use percept_service::Result;
use percept_service::toolbox::Toolbox;
use percept_wire::convert::geometry;
use percept_wire::convert::toolbox::{self as convert, pipeline};
use percept_wire::v1;

operations! {
    toolbox_pipelines_service_server::ToolboxPipelinesService, "ToolboxPipelinesService/*",
    one {}
    parts {
        run_pipeline(RunPipelineRequest) -> RunPipelineResponse as RunPipelineStream,
    }
}

pub(in crate::doors::grpc) fn run_pipeline(t: &Toolbox, r: v1::RunPipelineRequest) -> Result<v1::RunPipelineResponse> {
    let steps = pipeline::steps(&r)?;
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let (cloud, reports) = t.run_pipeline(cloud, &steps)?;
    let results = reports.iter().zip(&r.steps).enumerate();
    let results = results.map(|(i, (report, s))| pipeline::report_to(i, report, s.quiet)).collect();
    let sent = r.send_cloud.then(|| geometry::cloud_to(&cloud));
    let kept = if r.keep_result { Some(convert::kept_to(&t.keep(cloud, None)?)) } else { None };
    Ok(v1::RunPipelineResponse { results, cloud: sent, kept })
}
