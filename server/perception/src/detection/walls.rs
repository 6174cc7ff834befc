//! Walls: long or high vertical surfaces.

use super::DetectionParams;
use nalgebra::{Matrix2, Point3, Vector2, Vector3};
use percept_geometry::Plane;

/// Points tried as a wall's seed in each round.
const SEEDS: usize = 160;
/// Most walls taken.
const MAX_WALLS: usize = 80;
/// Width of the bins along a wall, metres.
const BIN_M: f64 = 0.1;
/// A gap in a wall up to this long is bridged, metres: what stands before it hides it.
const BRIDGE_M: f64 = 1.3;
/// A wall reaches this far beyond its last bin for what is looked for beside it, metres.
const BESIDE_M: f64 = 0.2;
/// A vertical surface counts as part of a wall where it is seen over this height, metres.
const MIN_SPAN_M: f64 = 0.9;

/// A face of a wall: a vertical plane and where along it the wall has been seen.
#[derive(Debug, Clone, PartialEq)]
pub struct Wall {
    /// Horizontal unit normal; its sign means nothing.
    pub normal: Vector2<f64>,
    /// `normal . p + offset = 0`.
    pub offset: f64,
    /// From and to, metres along `(-normal.y, normal.x)`, ascending.
    pub runs: Vec<[f64; 2]>,
}

impl Wall {
    /// Signed distance of a point from the plane, metres.
    pub fn distance(&self, p: &Point3<f64>) -> f64 {
        self.normal.dot(&p.coords.xy()) + self.offset
    }

    /// Whether a point lies within `margin` metres of a run's surface.
    pub fn contains(&self, p: &Point3<f64>, margin: f64) -> bool {
        self.distance(p).abs() <= margin && self.in_run(p, margin)
    }

    pub(super) fn is_beside(&self, p: &Point3<f64>) -> bool {
        self.in_run(p, BESIDE_M)
    }

    pub(super) fn is_near_run(&self, p: &Point3<f64>) -> bool {
        self.in_run(p, BRIDGE_M)
    }

    fn in_run(&self, p: &Point3<f64>, margin: f64) -> bool {
        let s = along(&self.normal, &p.coords.xy());
        self.runs.iter().any(|[from, to]| s >= from - margin && s <= to + margin)
    }
}

fn along(normal: &Vector2<f64>, p: &Vector2<f64>) -> f64 {
    normal.perp(p)
}

/// A point of a vertical surface.
#[derive(Clone, Copy)]
struct Upright {
    p: Vector2<f64>,
    normal: Vector2<f64>,
    height: f64,
}

/// Finds walls one after another, the one with most points first: the normal of a point and the point give a
/// plane, so that few seeds find even small walls (after Schnabel et al., "Efficient RANSAC for point-cloud
/// shape detection", 2007). Seeds are picked evenly, not by chance. Points are `spacing` metres apart.
pub(super) fn find_walls(
    points: &[Point3<f32>],
    normals: &[Vector3<f32>],
    floor: &Plane,
    spacing: f64,
    params: &DetectionParams,
) -> Vec<Wall> {
    let mut left: Vec<Upright> = points
        .iter()
        .zip(normals)
        .filter_map(|(p, n)| {
            let (p, n) = (p.cast::<f64>(), n.cast::<f64>());
            let height = floor.distance(&p);
            let flat = n.xy().norm();
            (flat > 0.95 && height > params.floor_margin_m).then(|| Upright {
                p: p.coords.xy(),
                normal: n.xy() / flat,
                height,
            })
        })
        .collect();
    let mut walls = Vec::new();
    // Surfaces that are no wall use up rounds too.
    for _ in 0..2 * MAX_WALLS {
        let Some((normal, offset)) = best_plane(&left, params.wall_distance_m) else { break };
        let on = |u: &Upright| (normal.dot(&u.p) + offset).abs() <= params.wall_distance_m;
        let inliers: Vec<Upright> = left.iter().filter(|u| on(u)).copied().collect();
        if (inliers.len() as f64) < least_points(spacing) || walls.len() >= MAX_WALLS {
            break;
        }
        let runs = runs(&inliers, &normal, params);
        if !runs.is_empty() {
            walls.push(Wall { normal, offset, runs });
        }
        left.retain(|u| !on(u) || u.normal.dot(&normal).abs() < 0.8);
    }
    walls
}

/// Points of the smallest piece of wall that counts: 0.4 m by the least span, half of it seen.
fn least_points(spacing: f64) -> f64 {
    (0.5 * 0.4 * MIN_SPAN_M / spacing.powi(2)).max(10.0)
}

/// The vertical plane with most points of its direction, refined.
fn best_plane(points: &[Upright], distance: f64) -> Option<(Vector2<f64>, f64)> {
    let aligned = |u: &Upright, normal: &Vector2<f64>, offset: f64| {
        (normal.dot(&u.p) + offset).abs() <= distance && u.normal.dot(normal).abs() > 0.94
    };
    let step = points.len().div_ceil(SEEDS).max(1);
    let thin = points.len().div_ceil(6000).max(1);
    let mut best: Option<(usize, Vector2<f64>, f64)> = None;
    for seed in points.iter().step_by(step) {
        let (normal, offset) = (seed.normal, -seed.normal.dot(&seed.p));
        let count = points.iter().step_by(thin).filter(|u| aligned(u, &normal, offset)).count();
        if best.is_none_or(|(most, ..)| count > most) {
            best = Some((count, normal, offset));
        }
    }
    let (_, mut normal, mut offset) = best?;
    let support = |normal: &Vector2<f64>, offset| points.iter().filter(|u| aligned(u, normal, offset)).count();
    let seeded = support(&normal, offset);
    for _ in 0..4 {
        let fitted = fit_line(points.iter().filter(|u| aligned(u, &normal, offset)).map(|u| u.p));
        // What is no wider than thick, a pole, fits a line across itself, which has hardly a point of its direction.
        let Some((n, o)) = fitted.filter(|(n, o)| 2 * support(n, *o) >= seeded) else { break };
        (normal, offset) = (n, o);
    }
    Some((normal, offset))
}

/// Least squares in the plane; none for fewer than two points.
fn fit_line(points: impl Iterator<Item = Vector2<f64>> + Clone) -> Option<(Vector2<f64>, f64)> {
    let n = points.clone().count();
    if n < 2 {
        return None;
    }
    let mean = points.clone().sum::<Vector2<f64>>() / n as f64;
    let scatter = points.fold(Matrix2::zeros(), |m, p| m + (p - mean) * (p - mean).transpose());
    let angle = 0.5 * (2.0 * scatter.m12).atan2(scatter.m11 - scatter.m22);
    let normal = Vector2::new(-angle.sin(), angle.cos());
    Some((normal, -normal.dot(&mean)))
}

/// Where along a plane there is wall: stretches that are long, or seen above all furniture.
fn runs(inliers: &[Upright], normal: &Vector2<f64>, params: &DetectionParams) -> Vec<[f64; 2]> {
    let at: Vec<f64> = inliers.iter().map(|u| along(normal, &u.p)).collect();
    let start = at.iter().copied().fold(f64::INFINITY, f64::min);
    let end = at.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    // Planes longer than this come from coordinates that are no room's.
    let num_bins = (((end - start) / BIN_M) as usize + 1).min(100_000);
    let mut bins = vec![(f64::INFINITY, f64::NEG_INFINITY, 0usize); num_bins];
    for (s, u) in at.iter().zip(inliers) {
        let bin = &mut bins[(((s - start) / BIN_M) as usize).min(num_bins - 1)];
        *bin = (bin.0.min(u.height), bin.1.max(u.height), bin.2 + 1);
    }
    let is_high = |b: &(f64, f64, usize)| b.1 >= params.wall_top_m;
    let is_wall = |b: &(f64, f64, usize)| b.2 >= 3 && (b.1 - b.0 >= MIN_SPAN_M || is_high(b));
    let mut out = Vec::new();
    let mut run: Option<(usize, usize, usize, usize)> = None;
    let mut close = |run: Option<(usize, usize, usize, usize)>| {
        if let Some((from, to, walls, high)) = run {
            let seen = walls as f64 * BIN_M;
            if seen >= params.wall_min_length_m || (walls >= 3 && 2 * high >= walls) {
                out.push([start + from as f64 * BIN_M, start + (to + 1) as f64 * BIN_M]);
            }
        }
    };
    for (i, bin) in bins.iter().enumerate().filter(|(_, b)| is_wall(b)) {
        let high = usize::from(is_high(bin));
        run = match run {
            Some((from, to, walls, highs)) if (i - to) as f64 * BIN_M <= BRIDGE_M => {
                Some((from, i, walls + 1, highs + high))
            }
            other => {
                close(other);
                Some((i, i, 1, high))
            }
        };
    }
    close(run);
    out
}
