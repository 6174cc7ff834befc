//! The ground that a robot covers.

use crate::PlanError;
use crate::polygon::{Edge, contains, edges};
use nalgebra::{Point2, Vector2};

/// Outline of the robot seen from above, in its base frame: x ahead, y to the left.
#[derive(Debug, Clone, PartialEq)]
pub enum Footprint {
    /// A disc around the base.
    Disc {
        /// Metres, above 0 and at most 100.
        radius_m: f64,
    },
    /// Corners in either order around, metres; three or more, none farther than 100 m from the base. Edges meet at corners
    /// only, and the base is inside or on an edge. It need not be convex.
    Polygon(Vec<Point2<f64>>),
}

/// Corners of a polygon are no farther from the base, metres.
const FARTHEST_M: f64 = 100.0;

/// Corners of a polygon at most: the check for crossings looks at all pairs of edges.
const MOST_CORNERS: usize = 256;

impl Footprint {
    /// A rectangle with the base in its middle, `length_m` along x.
    pub fn rectangle(length_m: f64, width_m: f64) -> Self {
        let (x, y) = (0.5 * length_m, 0.5 * width_m);
        Self::Polygon(vec![Point2::new(x, y), Point2::new(-x, y), Point2::new(-x, -y), Point2::new(x, -y)])
    }

    /// Checks the outline.
    ///
    /// # Errors
    /// `InvalidParam`: `footprint.radius_m`, or `footprint.polygon` with the number of corners, the coordinate, or the
    /// index of the edge or corner that is refused (edge i goes from corner i to the next), or how far outside base lies, metres.
    pub fn validate(&self) -> Result<(), PlanError> {
        let refuse = |field, value, remedy| Err(PlanError::InvalidParam { field, value, remedy });
        let corners = match self {
            Self::Disc { radius_m } if *radius_m > 0.0 && *radius_m <= FARTHEST_M => return Ok(()),
            Self::Disc { radius_m } => {
                return refuse("footprint.radius_m", *radius_m, "choose above 0 and at most 100");
            }
            Self::Polygon(corners) => corners,
        };
        let field = "footprint.polygon";
        if corners.len() < 3 || corners.len() > MOST_CORNERS {
            return refuse(field, corners.len() as f64, "give 3 to 256 corners");
        }
        if let Some(bad) = corners.iter().flat_map(|c| c.iter()).find(|v| !v.is_finite()) {
            return refuse(field, *bad, "give finite coordinates in metres");
        }
        if let Some(far) = corners.iter().map(|c| c.coords.norm()).find(|d| *d > FARTHEST_M) {
            return refuse(field, far, "keep corners within 100 m of the base");
        }
        let edges: Vec<Edge> = edges(corners).collect();
        if let Some(i) = edges.iter().position(|(a, b)| (b - a).norm() < 1e-6) {
            return refuse(field, i as f64, "leave out the edge of this number: its ends are in one place");
        }
        for (i, edge) in edges.iter().enumerate() {
            let is_neighbor = |j: usize| j == i || (j + 1) % edges.len() == i || (i + 1) % edges.len() == j;
            let folds_back = {
                let next = edges[(i + 1) % edges.len()];
                let (d, e) = (edge.1 - edge.0, next.1 - next.0);
                d.perp(&e).abs() <= 1e-12 * d.norm() * e.norm() && d.dot(&e) < 0.0
            };
            if folds_back || edges.iter().enumerate().any(|(j, other)| !is_neighbor(j) && meet(edge, other)) {
                return refuse(
                    field,
                    i as f64,
                    "let edges meet at corners only: the edge of this number crosses another",
                );
            }
        }
        let outside = edges.iter().map(|e| to_edge(&Point2::origin(), e)).fold(f64::INFINITY, f64::min);
        if outside > 1e-9 && !contains(corners, &Point2::origin()) {
            return refuse(
                field,
                outside,
                "give corners in the base frame, around the base at (0, 0), which is so many metres outside",
            );
        }
        Ok(())
    }

    /// Radius of the largest disc around the base that the outline holds, metres.
    pub fn inscribed_radius_m(&self) -> f64 {
        match self {
            Self::Disc { radius_m } => *radius_m,
            Self::Polygon(corners) => {
                edges(corners).map(|e| to_edge(&Point2::origin(), &e)).fold(f64::INFINITY, f64::min)
            }
        }
    }

    /// Radius of the smallest disc around the base that holds the outline, metres: what a turn on the spot covers.
    pub fn circumscribed_radius_m(&self) -> f64 {
        match self {
            Self::Disc { radius_m } => *radius_m,
            Self::Polygon(corners) => corners.iter().map(|c| c.coords.norm()).fold(0.0, f64::max),
        }
    }

    /// Discs (centre in the base frame, radius) that cover the outline: its bounding rectangle in pieces about as long as
    /// wide.
    pub(crate) fn covering_discs(&self) -> Vec<(Point2<f64>, f64)> {
        let corners = match self {
            Self::Disc { radius_m } => return vec![(Point2::origin(), *radius_m)],
            Self::Polygon(corners) => corners,
        };
        let low = corners.iter().fold(Point2::origin(), |low, c| low.inf(c));
        let high = corners.iter().fold(Point2::origin(), |high, c| high.sup(c));
        let size = high - low;
        let along = usize::from(size.y > size.x);
        // More than eight are no quicker than a look at the cells.
        let pieces = (size[along] / size[1 - along].max(1e-9)).ceil().clamp(1.0, 8.0);
        let mut step = Vector2::zeros();
        step[along] = size[along] / pieces;
        let radius = 0.5 * step[along].hypot(size[1 - along]);
        let first = nalgebra::center(&low, &high) - step * (0.5 * (pieces - 1.0));
        (0..pieces as usize).map(|i| (first + step * i as f64, radius)).collect()
    }
}

fn to_edge(p: &Point2<f64>, (a, b): &Edge) -> f64 {
    let along = b - a;
    let share = ((p - a).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
    (a + along * share - p).norm()
}

/// Whether two segments have a point in common.
fn meet(one: &Edge, other: &Edge) -> bool {
    let side = |(a, b): &Edge, p: &Point2<f64>| (b - a).perp(&(p - a));
    let ends = [side(one, &other.0), side(one, &other.1), side(other, &one.0), side(other, &one.1)];
    if ends[0] * ends[1] < 0.0 && ends[2] * ends[3] < 0.0 {
        return true;
    }
    let touches = |p: &Point2<f64>, edge: &Edge| to_edge(p, edge) < 1e-9;
    touches(&other.0, one) || touches(&other.1, one) || touches(&one.0, other) || touches(&one.1, other)
}
