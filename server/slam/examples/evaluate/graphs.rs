//! Pose graphs from bad starts: what `solve` reaches beside the best of many restarts.

use crate::read::Failure;
use nalgebra::{SMatrix, SVector};
use percept_geometry::Pose;
use percept_slam::pose_graph::{
    Edge, Manifold, OptimiseParams, OptimiseReport, PlanarPose, PoseGraph, chordal, optimise, solve,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::time::Instant;

/// `graph FILE [noise=RAD] [first=SEED] [seeds=N] [restarts=N] [aware=1]`: a g2o file with this much noise added to the turns of every
/// measurement, solved for every seed, and beside it restarts from trees and from turned poses. Aware information has
/// the added noise in it, else it is the file's.
pub(crate) fn compare(file: &Path, options: &[String]) -> Result<(), Failure> {
    let option = |name: &str| options.iter().find_map(|o| o.strip_prefix(name)?.strip_prefix('='));
    let number = |name: &str, default: f64| option(name).map_or(Ok(default), str::parse);
    let run = Run {
        noise_rad: number("noise", 0.0)?,
        first: number("first", 0.0)? as u64,
        seeds: number("seeds", 1.0)? as u64,
        restarts: number("restarts", 0.0)? as u64,
        is_aware: number("aware", 0.0)? > 0.0,
    };
    let text = std::fs::read_to_string(file)?;
    if text.contains("EDGE_SE2") {
        let pose = |r: &[f64]| PlanarPose { x: r[0], y: r[1], yaw: r[2] };
        run.compare(&read::<_, 3>(&text, "SE2", 3, pose)?, |information, variance| {
            let turn = &mut information[(2, 2)];
            *turn = 1.0 / (1.0 / *turn + variance);
        })
    } else {
        let pose = |r: &[f64]| {
            let q = nalgebra::Quaternion::new(r[6], r[3], r[4], r[5]);
            Pose::from_parts(
                nalgebra::Translation3::new(r[0], r[1], r[2]),
                nalgebra::UnitQuaternion::from_quaternion(q),
            )
        };
        run.compare(&read::<_, 6>(&text, "SE3:QUAT", 7, pose)?, |information, variance| {
            // Of half the angle.
            let covariance = information.try_inverse().unwrap_or_default();
            let turns = SMatrix::<f64, 6, 6>::from_fn(|r, c| if r == c && r > 2 { variance / 4.0 } else { 0.0 });
            *information = (covariance + turns).try_inverse().unwrap_or(*information);
        })
    }
}

struct Run {
    noise_rad: f64,
    first: u64,
    seeds: u64,
    restarts: u64,
    is_aware: bool,
}

impl Run {
    fn compare<P: Manifold<D>, const D: usize>(
        &self,
        given: &(PoseGraph<P, D>, bool),
        widen: impl Fn(&mut SMatrix<f64, D, D>, f64),
    ) -> Result<(), Failure> {
        let (mut worst, mut behind) = (0.0f64, 0);
        for seed in self.first..self.first + self.seeds {
            let (mut graph, has_poses) = given.clone();
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            for e in &mut graph.edges {
                e.t_from_to = e.t_from_to.step(&turn::<D>(&mut rng, self.noise_rad));
                if self.is_aware {
                    widen(&mut e.information, self.noise_rad.powi(2));
                }
            }
            let mut solved = graph.clone();
            let start = Instant::now();
            let report = solve(&mut solved, has_poses, &OptimiseParams::default())?;
            let ms = start.elapsed().as_secs_f64() * 1e3;
            let mut found = vec![];
            for k in 0..self.restarts {
                found.push(restart(&graph, &solved.poses, k, &mut rng)?);
            }
            let best = found.iter().map(|r| r.chi2).fold(f64::INFINITY, f64::min);
            let OptimiseReport { chi2, iterations, .. } = report;
            print!(
                "seed {seed}: chi2 {chi2:.4}, {iterations} steps, {ms:.0} ms, converged {}, proven {}",
                report.converged, report.is_certified
            );
            if self.restarts > 0 {
                let above = 100.0 * (chi2 / best - 1.0);
                let reached = found.iter().filter(|r| r.chi2 <= best * 1.001).count();
                worst = worst.max(above);
                behind += usize::from(above > 0.1);
                print!("; best restart {best:.4} ({reached} of {}), solve {above:+.3} % of it", self.restarts);
            }
            println!();
        }
        if self.restarts > 0 {
            println!("{behind} of {} more than 0.1 % above the best restart, worst {worst:+.3} %", self.seeds);
        }
        Ok(())
    }
}

/// A turn of this many radians' standard deviation about each axis that there is, as a step.
fn turn<const D: usize>(rng: &mut ChaCha8Rng, sigma: f64) -> SVector<f64, D> {
    let mut normal = || {
        // Box and Muller.
        let (a, b): (f64, f64) = (rng.random(), rng.random());
        sigma * (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    };
    SVector::from_fn(|axis, _| if axis >= D / 2 + D % 2 { normal() } else { 0.0 })
}

/// Optimised from a tree of random edges, from the widest tree at a random root, from chordal poses that were turned, or
/// from solved ones that were.
fn restart<P: Manifold<D>, const D: usize>(
    graph: &PoseGraph<P, D>,
    solved: &[P],
    k: u64,
    rng: &mut ChaCha8Rng,
) -> Result<OptimiseReport, Failure> {
    let mut graph = graph.clone();
    let mut turned = |poses: &mut Vec<P>, sigma: f64| {
        poses.iter_mut().skip(1).for_each(|p| *p = p.step(&turn::<D>(rng, sigma)));
    };
    match k % 4 {
        0 => graph.poses = by_tree(&graph, true, rng),
        1 => graph.poses = by_tree(&graph, false, rng),
        2 => {
            graph.poses = chordal(&graph)?;
            turned(&mut graph.poses, 0.05 * k as f64);
        }
        _ => {
            graph.poses = solved.to_vec();
            turned(&mut graph.poses, 0.05 * k as f64);
        }
    }
    Ok(optimise(&mut graph, &OptimiseParams::default())?)
}

/// Poses along a spanning tree: grown by random edges, or breadth first from a random node.
fn by_tree<P: Manifold<D>, const D: usize>(graph: &PoseGraph<P, D>, is_random: bool, rng: &mut ChaCha8Rng) -> Vec<P> {
    let n = graph.poses.len();
    let mut at = vec![vec![]; n];
    for (k, e) in graph.edges.iter().enumerate() {
        at[e.from as usize].push(k);
        at[e.to as usize].push(k);
    }
    let root = rng.random_range(0..n);
    let mut poses: Vec<Option<P>> = vec![None; n];
    poses[root] = Some(P::identity());
    let mut open: std::collections::VecDeque<usize> = at[root].iter().copied().collect();
    while !open.is_empty() {
        let pick = if is_random { rng.random_range(0..open.len()) } else { 0 };
        open.swap(0, pick);
        let Some(k) = open.pop_front() else { break };
        let e = &graph.edges[k];
        let (from, to) = (e.from as usize, e.to as usize);
        let (new, pose) = match (poses[from], poses[to]) {
            (Some(p), None) => (to, p.compose(&e.t_from_to)),
            (None, Some(p)) => (from, p.compose(&e.t_from_to.inverse())),
            _ => continue,
        };
        poses[new] = Some(pose);
        open.extend(&at[new]);
    }
    // The first is the fixed one: all are seen from it.
    let to_first = poses[0].map_or(P::identity(), |p| graph.poses[0].compose(&p.inverse()));
    poses.iter().map(|p| to_first.compose(&p.unwrap_or(P::identity()))).collect()
}

/// The graph of a g2o text with vertices numbered from 0, and whether it has poses.
fn read<P: Manifold<D>, const D: usize>(
    text: &str,
    kind: &str,
    len: usize,
    pose: impl Fn(&[f64]) -> P,
) -> Result<(PoseGraph<P, D>, bool), Failure> {
    let mut graph = PoseGraph::<P, D> { poses: vec![], edges: vec![], fixed: vec![0] };
    let mut num_nodes = 0;
    for line in text.lines() {
        let mut words = line.split_whitespace();
        let tag = words.next().unwrap_or_default();
        let row: Vec<f64> = words.map(str::parse).collect::<Result<_, _>>()?;
        if tag == format!("VERTEX_{kind}") {
            graph.poses.push(pose(&row[1..]));
        } else if tag == format!("EDGE_{kind}") {
            let (from, to) = (row[0] as u32, row[1] as u32);
            num_nodes = num_nodes.max(from.max(to) as usize + 1);
            let mut upper = row[2 + len..].iter().copied();
            let mut information = SMatrix::<f64, D, D>::zeros();
            for r in 0..D {
                for c in r..D {
                    information[(r, c)] = upper.next().ok_or("too few numbers")?;
                    information[(c, r)] = information[(r, c)];
                }
            }
            graph.edges.push(Edge { from, to, t_from_to: pose(&row[2..]), information });
        }
    }
    let has_poses = !graph.poses.is_empty();
    graph.poses.resize(num_nodes, P::identity());
    Ok((graph, has_poses))
}
