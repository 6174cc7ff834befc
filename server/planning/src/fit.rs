//! Whether a robot fits at a pose and along an arc.

use crate::costmap::{CellState, Costmap};
use crate::polygon::{contains, crosses};
use crate::steering::Arc;
use crate::{Footprint, Pose2};
use nalgebra::{Point2, Vector2};
use percept_geometry::{Cell, se3::wrap_angle};

/// A footprint over a costmap. Obstacles are the squares of cells that are not free; touching one is no overlap.
#[derive(Debug, Clone)]
pub(crate) struct Fit<'a> {
    costmap: &'a Costmap,
    footprint: &'a Footprint,
    discs: Vec<(Point2<f64>, f64)>,
    inscribed: f64,
    circumscribed: f64,
}

/// Overlaps of less than this are rounding, of stored clearances among others, metres.
const ROUNDING: f64 = 1e-6;

/// Between the poses that are looked at, a part of the robot may enter an obstacle by so much, metres.
const SLIT: f64 = 5e-4;

/// Poses looked at for the first that overlaps, at most.
const MOST_STEPS: f64 = 1e5;

/// A way from a pose.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Motion {
    /// On an arc.
    Arc(Arc),
    /// Straight to a pose, turning evenly by the shorter way.
    Straight(Pose2),
}

impl Motion {
    /// The pose after this share of the way.
    fn at(&self, from: &Pose2, share: f64) -> Pose2 {
        match self {
            Self::Arc(arc) => arc.after(from, arc.length * share),
            Self::Straight(to) => Pose2 {
                position: from.position + (to.position - from.position) * share,
                yaw_rad: from.yaw_rad + wrap_angle(to.yaw_rad - from.yaw_rad) * share,
            },
        }
    }

    /// No point within this radius around the base moves more, metres.
    fn farthest_move(&self, from: &Pose2, radius: f64) -> f64 {
        match self {
            Self::Arc(arc) => arc.length.abs() * (1.0 + arc.curvature.abs() * radius),
            Self::Straight(to) => {
                (to.position - from.position).norm() + wrap_angle(to.yaw_rad - from.yaw_rad).abs() * radius
            }
        }
    }
}

impl<'a> Fit<'a> {
    pub(crate) fn new(costmap: &'a Costmap, footprint: &'a Footprint) -> Self {
        Self {
            costmap,
            footprint,
            discs: footprint.covering_discs(),
            inscribed: footprint.inscribed_radius_m(),
            circumscribed: footprint.circumscribed_radius_m(),
        }
    }

    /// Whether the footprint overlaps no obstacle.
    pub(crate) fn is_clear(&self, pose: &Pose2) -> bool {
        self.is_clear_by(pose, 0.0)
    }

    /// Whether nothing is overlapped on the way from a pose, but for [`SLIT`].
    ///
    /// Between two poses no point of the robot moves more than it does from the pose in their middle: if that is clear by
    /// as much, so is all between; else each half is looked at.
    pub(crate) fn is_drivable(&self, from: &Pose2, motion: &Motion) -> bool {
        let moves = 0.5 * motion.farthest_move(from, self.circumscribed);
        self.is_clear(&motion.at(from, 1.0)) && self.is_span_drivable(from, motion, (0.0, 1.0), moves)
    }

    fn is_span_drivable(&self, from: &Pose2, motion: &Motion, (begin, end): (f64, f64), moves: f64) -> bool {
        let middle = 0.5 * (begin + end);
        let pose = motion.at(from, middle);
        if self.is_clear_by(&pose, moves) {
            return true;
        }
        self.is_clear(&pose)
            && (moves <= SLIT
                || self.is_span_drivable(from, motion, (begin, middle), 0.5 * moves)
                    && self.is_span_drivable(from, motion, (middle, end), 0.5 * moves))
    }

    /// The first pose on the way that overlaps an obstacle, to [`SLIT`], and is not excused; none if [`Fit::is_drivable`].
    pub(crate) fn first_overlap(
        &self,
        from: &Pose2,
        motion: &Motion,
        is_excused: impl Fn(&Pose2) -> bool,
    ) -> Option<Pose2> {
        if self.is_drivable(from, motion) {
            return None;
        }
        let steps = (motion.farthest_move(from, self.circumscribed) / SLIT).ceil().clamp(1.0, MOST_STEPS);
        let mut poses = (0..=steps as usize).map(|i| motion.at(from, i as f64 / steps));
        poses.find(|pose| !self.is_clear(pose) && !is_excused(pose))
    }

    /// Whether the footprint is at least `margin` from every obstacle; with a margin, may say no where it is up to sqrt 2
    /// of it.
    fn is_clear_by(&self, pose: &Pose2, margin: f64) -> bool {
        let (clearance, off) = self.costmap.clearance_near(&pose.position);
        if clearance - off >= self.circumscribed + margin {
            return true;
        }
        if clearance + off + ROUNDING < self.inscribed + margin {
            return false;
        }
        let (sin, cos) = pose.yaw_rad.sin_cos();
        let placed = |p: &Point2<f64>| pose.position + Vector2::new(p.x * cos - p.y * sin, p.x * sin + p.y * cos);
        let covers = |(center, radius): &(Point2<f64>, f64)| {
            let (clearance, off) = self.costmap.clearance_near(&placed(center));
            clearance - off >= radius + margin
        };
        if self.discs.iter().all(covers) {
            return true;
        }
        // Coarse margins are decided by halving them: it costs less than a look at the cells.
        margin <= self.costmap.geometry().resolution_m && self.obstacle_within(pose, margin).is_none()
    }

    /// The first cell, row by row, that is not free and that the footprint overlaps, or comes nearer to than `margin`.
    pub(crate) fn obstacle_within(&self, pose: &Pose2, margin: f64) -> Option<Cell> {
        let (sin, cos) = pose.yaw_rad.sin_cos();
        let placed = |p: &Point2<f64>| pose.position + Vector2::new(p.x * cos - p.y * sin, p.x * sin + p.y * cos);
        let grown = Vector2::repeat(margin - ROUNDING);
        let size = Vector2::repeat(self.costmap.geometry().resolution_m);
        let square = |cell: Cell| {
            let low = self.costmap.geometry().corner(cell);
            (low - grown, low + size + grown)
        };
        match self.footprint {
            Footprint::Disc { radius_m } => {
                let reach = Vector2::repeat(radius_m + margin);
                let overlaps = |cell: Cell| {
                    let low = self.costmap.geometry().corner(cell);
                    let nearest = low.sup(&(low + size).inf(&pose.position));
                    (nearest - pose.position).norm() < radius_m + margin - ROUNDING
                };
                self.costmap.obstacle_in(&(pose.position - reach), &(pose.position + reach), overlaps)
            }
            Footprint::Polygon(corners) => {
                let corners: Vec<Point2<f64>> = corners.iter().map(placed).collect();
                let low = corners.iter().fold(corners[0], |low, c| low.inf(c));
                let high = corners.iter().fold(corners[0], |high, c| high.sup(c));
                let overlaps = |cell: Cell| {
                    let (low, high) = square(cell);
                    let edge = |i: usize| (corners[i], corners[(i + 1) % corners.len()] - corners[i]);
                    let cut = (0..corners.len()).map(edge).any(|(a, along)| crosses(&a, &along, &low, &high));
                    cut || contains(&corners, &low)
                };
                self.costmap.obstacle_in(&(low - grown), &(high + grown), overlaps)
            }
        }
    }
}

impl Costmap {
    /// Clearance of the cell nearest to a point, metres, and the point's distance from that cell's centre: the clearance of
    /// the point differs by no more.
    pub(crate) fn clearance_near(&self, p: &Point2<f64>) -> (f64, f64) {
        let cell = |v: f64, origin: f64, size: usize| {
            ((v - origin) / self.geometry().resolution_m).clamp(0.0, size as f64 - 1.0) as i32
        };
        let origin = self.geometry().origin;
        let cell = Cell::new(cell(p.x, origin.x, self.width()), cell(p.y, origin.y, self.height()));
        let clearance = f64::from(self.clearances()[self.at(cell)]);
        // f32 storage may be off by a part in 1e7.
        (clearance, (self.geometry().center(cell) - p).norm() + 1e-6 * clearance.min(1e3))
    }

    /// The first cell that is not free and that `overlaps` accepts in a rectangle of the map frame, row by row. What lies
    /// beyond the rim is not looked at.
    fn obstacle_in(&self, low: &Point2<f64>, high: &Point2<f64>, overlaps: impl Fn(Cell) -> bool) -> Option<Cell> {
        let (origin, resolution) = (self.geometry().origin, self.geometry().resolution_m);
        let cell = |v: f64, origin: f64, size: usize| ((v - origin) / resolution).clamp(-1.0, size as f64) as i32;
        let first = |v: f64, origin: f64, size: usize| cell(v, origin, size).max(0);
        let last = |v: f64, origin: f64, size: usize| cell(v, origin, size).min(size as i32 - 1);
        let columns = first(low.x, origin.x, self.width())..=last(high.x, origin.x, self.width());
        for y in first(low.y, origin.y, self.height())..=last(high.y, origin.y, self.height()) {
            let is_obstacle = |x: &i32| self.states()[self.at(Cell::new(*x, y))] != CellState::Free;
            if let Some(x) = columns.clone().filter(is_obstacle).find(|x| overlaps(Cell::new(*x, y))) {
                return Some(Cell::new(x, y));
            }
        }
        None
    }
}
