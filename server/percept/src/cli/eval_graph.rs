//! `percept eval graph`: a pose graph optimised.

use super::Failure;
use percept_bench::g2o::{numbered, pose_graph};
use percept_formats::g2o::{G2oFile, G2oGraph, Indefinite};
use percept_formats::{Limits, parse_g2o, read_file, write_g2o};
use percept_slam::pose_graph::{Manifold, OptimiseParams, OptimiseReport, PlanarPose, solve};
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;

#[derive(Debug, clap::Args)]
pub(crate) struct GraphArgs {
    /// A g2o file: VERTEX_SE2 and EDGE_SE2, or VERTEX_SE3:QUAT and EDGE_SE3:QUAT.
    file: PathBuf,
    /// Where the optimised graph goes, as g2o.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Steps at most.
    #[arg(long, default_value_t = OptimiseParams::default().max_iterations)]
    max_iterations: usize,
    /// Replace information that is not positive semi-definite by the nearest that is, instead of refusing the file.
    #[arg(long)]
    project_information: bool,
    /// Print one JSON object instead of a line.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &GraphArgs) -> Result<(), Failure> {
    let in_file = |e: &dyn std::fmt::Display| Failure::from(format!("{}: {e}", args.file.display()));
    let bytes = read_file(&args.file, &Limits::default())?;
    let indefinite = if args.project_information { Indefinite::Project } else { Indefinite::Refuse };
    let mut file = parse_g2o(&bytes, &Limits::default(), indefinite).map_err(|e| in_file(&e))?;
    let params = OptimiseParams { max_iterations: args.max_iterations, ..OptimiseParams::default() };
    let solved = match &mut file {
        G2oFile::Planar(graph) => {
            let to = |[x, y, yaw]: [f64; 3]| PlanarPose { x, y, yaw };
            optimised(graph, to, |p: &PlanarPose| [p.x, p.y, p.yaw], &params)
        }
        G2oFile::Spatial(graph) => optimised(graph, |p| p, |p| *p, &params),
    };
    let (report, nodes, edges, ms) = solved.map_err(|e| in_file(&e))?;
    if let Some(path) = &args.out {
        let mut text = Vec::new();
        write_g2o(&mut text, &file)?;
        std::fs::write(path, text).map_err(|e| format!("{}: {e}", path.display()))?;
    }
    if args.json {
        println!(
            "{}",
            json!({
                "poses": nodes, "edges": edges, "chi2_start": finite(report.chi2_start), "chi2": finite(report.chi2),
                "iterations": report.iterations, "converged": report.converged, "certified": report.is_certified,
                "ms": ms,
            })
        );
    } else {
        let OptimiseReport { chi2_start, chi2, iterations, .. } = report;
        let end = match (report.is_certified, report.converged) {
            (true, _) => "converged, proven to be the least",
            (_, true) => "converged",
            _ => "not converged",
        };
        println!(
            "{nodes} poses, {edges} edges: chi2 {chi2_start:.6} to {chi2:.6}, {iterations} steps, {ms:.1} ms, {end}"
        );
    }
    Ok(())
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// Solves the file's graph in place: report, poses, edges and milliseconds (without reading and writing).
fn optimised<R: Copy, P: Manifold<D>, const D: usize, const I: usize>(
    file: &mut G2oGraph<R, I>,
    from_row: impl Fn(R) -> P,
    to_row: impl Fn(&P) -> R,
    params: &OptimiseParams,
) -> Result<(OptimiseReport, usize, usize, f64), Failure> {
    let (mut graph, has_poses) = pose_graph(file, from_row)?;
    if !has_poses {
        file.vertices = numbered(file)?.into_keys().map(|id| (id, to_row(&P::identity()))).collect();
    }
    let start = Instant::now();
    let report = solve(&mut graph, has_poses, params)?;
    let ms = start.elapsed().as_secs_f64() * 1e3;
    file.vertices.iter_mut().zip(&graph.poses).for_each(|(v, p)| v.1 = to_row(p));
    Ok((report, graph.poses.len(), graph.edges.len(), ms))
}
