//! The convex hull in space.

use super::{Scatter, convex_hull, symmetric_eigen3};
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::cloud::is_finite;
use rustc_hash::FxHashMap;

/// Steps of the lattice that points are put on, to each side: what f32 resolves, and 25 bits a difference.
const STEPS: f64 = (1 << 24) as f64;
/// Thinner than this share of its size a cloud is flat: that is what f32 resolves.
const FLAT: f64 = 3e-7;

/// The convex hull of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Hull3 {
    /// Its corners, metres.
    pub vertices: Vec<Point3<f64>>,
    /// Triangles of corners, counter-clockwise from outside; none if the cloud is flat.
    pub triangles: Vec<[u32; 3]>,
    /// Volume, cubic metres; 0 if flat.
    pub volume_m3: f64,
    /// Area of the surface, square metres; both sides of it if flat.
    pub area_m2: f64,
}

/// The convex hull of the finite ones of `points`; none if there is none. Clouds on a plane (to the resolution of f32)
/// have the hull of a polygon without volume, those on a line two corners, equal points one.
///
/// Source: Barber, Dobkin and Huhdanpaa, "The quickhull algorithm for convex hulls", 1996. Points are put
/// on a lattice of 2^24 steps to either side, where who sees a facet is decided exactly: points on a plane or on a line
/// make no trouble.
pub fn convex_hull_3d(points: &[Point3<f32>]) -> Option<Hull3> {
    let anchor: Point3<f64> = points.iter().find(|p| is_finite(p))?.cast();
    let local: Vec<Vector3<f64>> = points.iter().filter(|p| is_finite(p)).map(|p| p.cast::<f64>() - anchor).collect();
    let scatter = Scatter::of(points)?;
    let axes = symmetric_eigen3(&scatter.covariance()).vectors;
    let widths = axes.map(|axis| {
        let along = local.iter().map(|p| axis.dot(p));
        along.clone().fold(f64::NEG_INFINITY, f64::max) - along.fold(f64::INFINITY, f64::min)
    });
    let size = widths[2].max(widths[1]).max(widths[0]);
    let magnitude = anchor.coords.amax() + size;
    let hull = if widths[0] <= FLAT * magnitude { None } else { Quickhull::run(&on_lattice(&local)) };
    Some(match hull {
        Some(triangles) => solid(&local, &triangles, anchor),
        None => flat(&local, &axes, anchor, widths[2] <= FLAT * magnitude),
    })
}

fn on_lattice(points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let per_metre = STEPS / points.iter().map(Vector3::amax).fold(f64::MIN_POSITIVE, f64::max);
    points.iter().map(|p| p.map(|v| (v * per_metre).round())).collect()
}

fn solid(points: &[Vector3<f64>], triangles: &[[u32; 3]], anchor: Point3<f64>) -> Hull3 {
    let mut number: FxHashMap<u32, u32> = FxHashMap::default();
    let mut out = Hull3 { vertices: Vec::new(), triangles: Vec::new(), volume_m3: 0.0, area_m2: 0.0 };
    for triangle in triangles {
        let [a, b, c] = triangle.map(|i| points[i as usize]);
        let cross = (b - a).cross(&(c - a));
        out.area_m2 += 0.5 * cross.norm();
        out.volume_m3 += a.dot(&cross) / 6.0;
        out.triangles.push(triangle.map(|i| {
            *number.entry(i).or_insert_with(|| {
                out.vertices.push(anchor + points[i as usize]);
                out.vertices.len() as u32 - 1
            })
        }));
    }
    out.volume_m3 = out.volume_m3.max(0.0);
    out
}

fn flat(points: &[Vector3<f64>], axes: &[Vector3<f64>; 3], anchor: Point3<f64>, is_point: bool) -> Hull3 {
    let on = |p: &Vector3<f64>| Point2::new(axes[2].dot(p), axes[1].dot(p));
    let polygon = if is_point { vec![on(&points[0])] } else { convex_hull(&points.iter().map(on).collect::<Vec<_>>()) };
    let middle = points.iter().map(|p| axes[0].dot(p)).sum::<f64>() / points.len() as f64;
    let doubled: f64 =
        (0..polygon.len()).map(|i| polygon[i].coords.perp(&polygon[(i + 1) % polygon.len()].coords)).sum();
    let lift = |q: &Point2<f64>| anchor + axes[2] * q.x + axes[1] * q.y + axes[0] * middle;
    Hull3 {
        vertices: polygon.iter().map(lift).collect(),
        triangles: Vec::new(),
        volume_m3: 0.0,
        area_m2: doubled.abs(),
    }
}

struct Facet {
    corners: [u32; 3],
    /// Across the edge from corner i to corner i + 1.
    neighbors: [u32; 3],
    /// Not of unit length: whole numbers below 2^52, without rounding.
    normal: Vector3<f64>,
    /// Points that see it, the farthest last.
    outside: Vec<u32>,
    alive: bool,
}

struct Quickhull<'a> {
    points: &'a [Vector3<f64>],
    facets: Vec<Facet>,
}

impl<'a> Quickhull<'a> {
    /// Triangles; none if all points are on a plane.
    fn run(points: &'a [Vector3<f64>]) -> Option<Vec<[u32; 3]>> {
        let mut hull = Self { points, facets: Vec::new() };
        hull.begin()?;
        let mut todo: Vec<u32> = (0..4).collect();
        while let Some(facet) = todo.pop() {
            if !hull.facets[facet as usize].alive {
                continue;
            }
            if let Some(&eye) = hull.facets[facet as usize].outside.last() {
                let first = hull.facets.len() as u32;
                hull.extend(facet, eye)?;
                todo.extend(first..hull.facets.len() as u32);
            }
        }
        Some(hull.facets.iter().filter(|f| f.alive).map(|f| f.corners).collect())
    }

    /// How far a point is above a facet, in no unit but with the right sign: positive if it sees it.
    fn height(&self, facet: u32, point: u32) -> f64 {
        let facet = &self.facets[facet as usize];
        above(&facet.normal, &(self.points[point as usize] - self.points[facet.corners[0] as usize]))
    }

    fn facet(&mut self, corners: [u32; 3], neighbors: [u32; 3]) {
        let [a, b, c] = corners.map(|i| self.points[i as usize]);
        let normal = (b - a).cross(&(c - a));
        self.facets.push(Facet { corners, neighbors, normal, outside: Vec::new(), alive: true });
    }

    /// A tetrahedron of far points, and who sees its sides.
    fn begin(&mut self) -> Option<()> {
        let farthest = |value: &dyn Fn(&Vector3<f64>) -> f64| {
            let best = self.points.iter().enumerate().max_by(|a, b| value(a.1).total_cmp(&value(b.1)))?;
            Some(best.0 as u32)
        };
        let at = |i: u32| self.points[i as usize];
        let a = farthest(&|p| p.x)?;
        let b = farthest(&|p| (p - at(a)).norm_squared())?;
        let c = farthest(&|p| (p - at(a)).cross(&(at(b) - at(a))).norm_squared())?;
        let across = (at(b) - at(a)).cross(&(at(c) - at(a)));
        let d = farthest(&|p| (p - at(a)).dot(&across).abs())?;
        let side = above(&across, &(at(d) - at(a)));
        if side == 0.0 {
            return None;
        }
        // d above the triangle: its other side is the first facet.
        let (b, c) = if side > 0.0 { (c, b) } else { (b, c) };
        self.facet([a, b, c], [1, 2, 3]);
        self.facet([b, a, d], [0, 3, 2]);
        self.facet([c, b, d], [0, 1, 3]);
        self.facet([a, c, d], [0, 2, 1]);
        let all: Vec<u32> = (0..self.points.len() as u32).filter(|i| ![a, b, c, d].contains(i)).collect();
        self.assign(&all, 0);
        Some(())
    }

    /// Gives each point to the first facet from `first` on that it sees.
    fn assign(&mut self, points: &[u32], first: u32) {
        let mut farthest = vec![0.0; self.facets.len() - first as usize];
        for &point in points {
            for facet in first..self.facets.len() as u32 {
                let height = self.height(facet, point);
                if height > 0.0 {
                    let (most, outside) =
                        (&mut farthest[(facet - first) as usize], &mut self.facets[facet as usize].outside);
                    outside.push(point);
                    if height > *most {
                        *most = height;
                    } else {
                        let last = outside.len() - 1;
                        outside.swap(last, last - 1);
                    }
                    break;
                }
            }
        }
    }

    /// Replaces the facets that `eye` sees by a cone from the rim of what it sees.
    fn extend(&mut self, facet: u32, eye: u32) -> Option<()> {
        let (mut seen, mut rim, mut orphans) = (vec![facet], Vec::new(), Vec::new());
        self.facets[facet as usize].alive = false;
        let mut next = 0;
        while let Some(&from) = seen.get(next) {
            next += 1;
            orphans.append(&mut self.facets[from as usize].outside);
            let Facet { corners, neighbors, .. } = self.facets[from as usize];
            for i in 0..3 {
                let other = neighbors[i];
                if !self.facets[other as usize].alive {
                    continue;
                }
                if self.height(other, eye) > 0.0 {
                    self.facets[other as usize].alive = false;
                    seen.push(other);
                } else {
                    rim.push((corners[i], corners[(i + 1) % 3], other));
                }
            }
        }
        // A neighbour that was not seen when its edge was looked at never is later: heights do not change.
        let first = self.facets.len() as u32;
        let starts: FxHashMap<u32, u32> = rim.iter().zip(first..).map(|(edge, facet)| (edge.0, facet)).collect();
        let ends: FxHashMap<u32, u32> = rim.iter().zip(first..).map(|(edge, facet)| (edge.1, facet)).collect();
        if starts.len() != rim.len() || ends.len() != rim.len() {
            return None;
        }
        for (number, &(a, b, beyond)) in (first..).zip(&rim) {
            self.facet([a, b, eye], [beyond, *starts.get(&b)?, *ends.get(&a)?]);
            let corners = self.facets[beyond as usize].corners;
            let edge = (0..3).find(|&i| corners[i] == b && corners[(i + 1) % 3] == a)?;
            self.facets[beyond as usize].neighbors[edge] = number;
        }
        orphans.retain(|&p| p != eye);
        self.assign(&orphans, first);
        Some(())
    }
}

/// `normal . p` of whole numbers below 2^52 and 2^26, its sign without error.
fn above(normal: &Vector3<f64>, p: &Vector3<f64>) -> f64 {
    let terms = normal.component_mul(p);
    let sum = terms.sum();
    // Three products and two sums are rounded, each by at most 2^-53 of what is in it.
    if sum.abs() > 1e-15 * terms.abs().sum() {
        return sum;
    }
    (0..3).map(|a| normal[a] as i128 * p[a] as i128).sum::<i128>() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn all_points_are_inside_and_the_surface_is_closed(
            points in prop::collection::vec(prop::array::uniform3(-4.0..4.0f32), 4..120), snap in any::<bool>(),
        ) {
            let points: Vec<Point3<f32>> =
                points.into_iter().map(|p| Point3::from(if snap { p.map(f32::round) } else { p })).collect();
            let hull = convex_hull_3d(&points).unwrap();
            for t in &hull.triangles {
                let [a, b, c] = t.map(|i| hull.vertices[i as usize]);
                if let Some(n) = (b - a).cross(&(c - a)).try_normalize(1e-4) {
                    for p in &points {
                        prop_assert!(n.dot(&(p.cast::<f64>() - a)) < 1e-5);
                    }
                }
            }
            // Euler: every edge is of two triangles.
            prop_assert!(hull.triangles.is_empty() || hull.triangles.len() == 2 * hull.vertices.len() - 4);
            prop_assert!(hull.volume_m3 <= percept_geometry::Aabb3::of(&points).size().product() + 1e-9);
        }
    }

    #[test]
    fn a_lattice_in_a_cube_has_the_volume_and_area_of_the_cube() {
        let points: Vec<Point3<f32>> =
            (0..1331).map(|i| Point3::new((i % 11) as f32, (i / 11 % 11) as f32, (i / 121) as f32) * 0.25).collect();
        let hull = convex_hull_3d(&points).unwrap();
        assert!((hull.volume_m3 - 2.5f64.powi(3)).abs() < 1e-6, "{}", hull.volume_m3);
        assert!((hull.area_m2 - 6.0 * 2.5f64.powi(2)).abs() < 1e-6, "{}", hull.area_m2);
    }

    #[test]
    fn a_sphere_has_nearly_the_volume_of_the_ball() {
        let points: Vec<Point3<f32>> = (0..20_000)
            .map(|i| {
                let z = 1.0 - 2.0 * (i as f32 + 0.5) / 20_000.0;
                let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
                Point3::new(1e3 + cos * (1.0 - z * z).sqrt(), sin * (1.0 - z * z).sqrt(), z)
            })
            .collect();
        let hull = convex_hull_3d(&points).unwrap();
        assert!((hull.volume_m3 / (4.0 / 3.0 * std::f64::consts::PI) - 1.0).abs() < 2e-3);
        assert!((hull.area_m2 / (4.0 * std::f64::consts::PI) - 1.0).abs() < 2e-3);
    }

    #[test]
    fn flat_clouds_have_polygons() {
        assert_eq!(convex_hull_3d(&[]), None);
        assert_eq!(convex_hull_3d(&[Point3::from([f32::NAN; 3])]), None);
        let with = |points: &[Point3<f32>]| {
            let hull = convex_hull_3d(points).unwrap();
            (hull.vertices.len(), hull.triangles.len(), hull.volume_m3)
        };
        assert_eq!(with(&[Point3::new(1e7, 2.0, 3.0); 5]), (1, 0, 0.0));
        assert_eq!(with(&(0..9).map(|i| Point3::new(i as f32, 2.0, 0.5 * i as f32)).collect::<Vec<_>>()), (2, 0, 0.0));
        let square: Vec<Point3<f32>> = (0..100).map(|i| Point3::new((i % 10) as f32, 7.0, (i / 10) as f32)).collect();
        let hull = convex_hull_3d(&square).unwrap();
        assert!(hull.volume_m3 == 0.0 && (hull.area_m2 - 2.0 * 81.0).abs() < 1e-9);
    }
}
