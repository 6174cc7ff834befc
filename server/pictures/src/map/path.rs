//! A path with its clearance or cost along it, or why there is none.

use super::labels::Labels;
use super::overview::{around, draw_robot, grid_legend, open_grid};
use super::{GridView, Zone, ZoneMask, zones};
use crate::PictureError;
use crate::canvas::Canvas;
use crate::colors::{BLUE, GREEN, INK, MAGENTA, RED, Scale};
use crate::sheet::{ColorBar, Entry, Sheet, Swatch, Window, cross, marker};
use nalgebra::{Point2, Point3};
use percept_geometry::{Pose, RgbImage, se3};

/// What the colours along a path mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PathQuantity {
    /// Distance to the nearest obstacle, metres.
    #[default]
    Clearance,
    /// What a metre costs there, as the planner counts it.
    Cost,
    /// Metres a second.
    Speed,
}

impl PathQuantity {
    fn name(self) -> &'static str {
        match self {
            Self::Clearance => "clearance [m]",
            Self::Cost => "cost of a metre",
            Self::Speed => "speed [m/s]",
        }
    }

    fn scale(self) -> Scale {
        match self {
            Self::Cost => Scale::Cividis,
            Self::Clearance | Self::Speed => Scale::Viridis,
        }
    }
}

/// Where a path begins or ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathEnd {
    /// Map frame, metres.
    pub position: Point2<f64>,
    /// Where the robot looks, radians; none: no matter where, and no arrow.
    pub yaw_rad: Option<f64>,
}

impl From<&Pose> for PathEnd {
    fn from(pose: &Pose) -> Self {
        Self { position: pose.translation.vector.xy().into(), yaw_rad: Some(se3::yaw(pose)) }
    }
}

/// A path, or the search for one; map frame, metres. What is not finite is left out.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PathDrawing {
    /// Poses of base from start to goal; empty where there is no path.
    pub poses: Vec<Pose>,
    /// A number for each pose, or none at all: then the path has one colour.
    pub values: Vec<f64>,
    /// What they are.
    pub quantity: PathQuantity,
    /// Corners of the robot in base, metres; empty: not drawn.
    pub footprint: Vec<Point2<f64>>,
    /// Where the robot starts.
    pub start: Option<PathEnd>,
    /// Where it is to go.
    pub goal: Option<PathEnd>,
    /// The first place that blocks the way.
    pub blocking: Option<Point2<f64>>,
    /// Why there is no path, in words; of a path that is there, why it cannot be driven.
    pub reason: Option<String>,
    /// Keep-out and speed zones.
    pub zones: Vec<Zone>,
    /// The same cell by cell.
    pub masks: Vec<ZoneMask>,
    /// What else is written beside the drawing, a line each.
    pub notes: Vec<String>,
}

/// The grid with the path coloured by a quantity along it, footprints every so often, start, goal, and what blocks the way.
///
/// # Errors
/// `GridTooLarge`, `OutOfRange`; `ShapeMismatch` for cells or values that are too few or too many.
pub fn path_picture<'a>(
    grid: impl Into<GridView<'a>>,
    path: &PathDrawing,
    title: &str,
) -> Result<RgbImage, PictureError> {
    let grid = grid.into();
    grid.check()?;
    if !path.values.is_empty() && path.values.len() != path.poses.len() {
        let (expected, actual) = (path.poses.len(), path.values.len());
        return Err(PictureError::ShapeMismatch { field: "values", expected, actual });
    }
    let (mut opened, window) = open_grid(&grid, sheet(&grid, path, title));
    let (e, plot) = (opened.enlarge, opened.plot);
    let size = f64::from(e);
    let canvas = &mut opened.canvas;
    zones::draw_masks(canvas, &window, plot, &path.masks, e);
    zones::draw(canvas, &window, &path.zones, e);
    draw_footprints(canvas, &window, path, size);
    draw_line(canvas, &window, path, size);
    let mut labels = Labels::new(plot, e);
    let goal = path.goal.or(path.poses.last().map(PathEnd::from));
    let start = path.start.or(path.poses.first().map(PathEnd::from));
    let mut named = vec![];
    for (end, words, color) in [(goal, "goal", MAGENTA), (start, "start", GREEN)] {
        let Some(PathEnd { position, yaw_rad }) = end else { continue };
        let at = window.pixel(position);
        match yaw_rad {
            Some(yaw) => {
                draw_robot(canvas, &window, &se3::from_xy_yaw(position.x, position.y, yaw), size, color);
            }
            None => marker(canvas, at, 9.0 * size, color),
        }
        named.push((at, words));
    }
    if let Some(blocking) = path.blocking {
        let at = window.pixel(blocking);
        cross(canvas, at, 10.0 * size, RED);
        named.push((at, "blocked here"));
    }
    named.iter().for_each(|(at, _)| labels.keep_free(around(*at, 12.0 * size)));
    // Beyond the arrow's head.
    named.iter().for_each(|(at, words)| labels.write(canvas, *at, 27.0 * size, words, INK));
    for (at, text, color) in zones::labels(&window, &path.zones) {
        labels.write(canvas, at, -9.0 * size, &text, color);
    }
    opened.canvas.clip(None);
    opened.finish(&window);
    opened.canvas.into_image()
}

fn bar(path: &PathDrawing) -> Option<ColorBar> {
    let has = path.values.iter().any(|v| v.is_finite());
    has.then(|| ColorBar::over(path.quantity.name(), path.quantity.scale(), path.values.iter().copied()))
}

fn sheet(grid: &GridView<'_>, path: &PathDrawing, title: &str) -> Sheet {
    let mut legend = grid_legend(grid);
    let mut add = |there: bool, swatch: Swatch, words: &str| {
        if there {
            legend.push(Entry::new(swatch, words));
        }
    };
    add(path.start.is_some() || !path.poses.is_empty(), Swatch::Disc(GREEN), "start");
    add(path.goal.is_some() || !path.poses.is_empty(), Swatch::Disc(MAGENTA), "goal");
    add(!path.poses.is_empty() && bar(path).is_none(), Swatch::Line(BLUE), "path");
    add(!path.poses.is_empty() && path.footprint.len() > 2, Swatch::Outline(BLUE), "footprint");
    add(path.blocking.is_some(), Swatch::Cross(RED), "first blocking place");
    legend.extend(zones::legend(&path.zones, &path.masks));
    let finite = |p: &[Pose]| (p[1].translation.vector.xy() - p[0].translation.vector.xy()).norm();
    let length: f64 = path.poses.windows(2).map(finite).filter(|d| d.is_finite()).sum();
    let (detail, mut notes) = match &path.reason {
        Some(reason) if path.poses.is_empty() => (format!("no path: {reason}"), vec![format!("No path: {reason}")]),
        Some(reason) => (format!("path of {length:.2} m, blocked: {reason}"), vec![format!("Blocked: {reason}")]),
        None if path.poses.is_empty() => ("no path".to_owned(), vec![]),
        None => (format!("path of {length:.2} m"), smallest(path)),
    };
    notes.extend(path.notes.iter().cloned());
    Sheet { title: title.to_owned(), detail, bar: bar(path), legend, notes, ..Sheet::default() }
}

fn smallest(path: &PathDrawing) -> Vec<String> {
    let least = path.values.iter().copied().filter(|v| v.is_finite()).reduce(f64::min);
    match (path.quantity, least) {
        // Whoever says more of the path knows it better than its samples.
        (PathQuantity::Clearance, Some(least)) if path.notes.is_empty() => {
            vec![format!("smallest clearance {least:.2} m")]
        }
        _ => vec![],
    }
}

fn draw_line(canvas: &mut Canvas, window: &Window, path: &PathDrawing, size: f64) {
    let points: Vec<Point2<f64>> = path.poses.iter().map(|p| window.pixel(p.translation.vector.xy().into())).collect();
    // A dark rim, or light colours are lost on free ground.
    canvas.polyline(&points, 7.0 * size, INK);
    let bar = bar(path);
    for (i, ends) in points.windows(2).enumerate() {
        let value = |j: usize| path.values.get(j).copied().unwrap_or(f64::NAN);
        let middle = 0.5 * (value(i) + value(i + 1));
        let color = match &bar {
            Some(bar) if middle.is_finite() => bar.color(middle),
            Some(_) => [160; 3],
            None => BLUE,
        };
        canvas.line(ends[0], ends[1], 4.6 * size, color);
    }
    // Where it begins and ends is seen even where both are one place.
    if let [only] = points[..] {
        marker(canvas, only, 6.0 * size, BLUE);
    }
}

/// Outlines of the robot along the path, far enough apart to be told from each other.
fn draw_footprints(canvas: &mut Canvas, window: &Window, path: &PathDrawing, size: f64) {
    if path.footprint.len() < 3 {
        return;
    }
    let reach = path.footprint.iter().map(|p| p.coords.norm()).filter(|r| r.is_finite()).fold(0.0, f64::max);
    let apart = (2.4 * reach).max(60.0 * size / window.per_metre);
    // What is not finite neither is drawn nor stops what comes after it.
    let length =
        |p: &[Pose]| Some((p[1].translation.vector - p[0].translation.vector).norm()).filter(|d| d.is_finite());
    let mut left: f64 = path.poses.windows(2).filter_map(length).sum();
    let mut since = f64::INFINITY;
    for (i, pose) in path.poses.iter().enumerate() {
        let step = if i == 0 { 0.0 } else { length(&path.poses[i - 1..=i]).unwrap_or(0.0) };
        (since, left) = (since + step, left - step);
        let is_end = i + 1 == path.poses.len();
        if !is_end && (since < apart || left < 0.9 * apart) {
            continue;
        }
        since = 0.0;
        let corners: Vec<Point2<f64>> =
            path.footprint.iter().map(|p| window.pixel((pose * Point3::new(p.x, p.y, 0.0)).xy())).collect();
        canvas.polygon(&corners, |_, _| Some((BLUE, 0.14)));
        canvas.closed(&corners, 1.6 * size, BLUE);
    }
}
