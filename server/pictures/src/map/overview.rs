//! The grid with all that is known to be in it: where the robot was and is, things, zones, a path.

use super::labels::Labels;
use super::{CellLayout, GridView, Zone, ZoneMask, zones};
use crate::canvas::{Canvas, PixelBox};
use crate::colors::{
    self, AMBER, BLUE, Color, FREE, GREEN, INK, MAGENTA, OCCUPIED, PURPLE, RED, SKY, SOFT_INK, UNKNOWN, VERMILION,
};
use crate::sheet::{Entry, Sheet, Swatch, Window, marker};
use crate::{MAX_EDGE, PictureError};
use nalgebra::{Point2, Point3};
use percept_geometry::{ObjectClass, OrientedBox3, Pose, RgbImage};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// A thing in the map.
#[derive(Debug, Clone, PartialEq)]
pub struct MapObject {
    /// Its number as the scene has it, or none.
    pub id: Option<u64>,
    /// What it is.
    pub class: ObjectClass,
    /// Where it stands, map frame.
    pub bbox: OrientedBox3,
}

/// A room of the map.
#[derive(Debug, Clone, PartialEq)]
pub struct MapRoom {
    /// What it is called.
    pub label: String,
    /// Where that is written, map frame, metres.
    pub center: Point2<f64>,
    /// Its border in order, map frame, metres.
    pub outline: Vec<Point2<f64>>,
    /// Its doors, each once in one of the rooms that it joins: from jamb to jamb, map frame, metres.
    pub doors: Vec<[Point2<f64>; 2]>,
}

/// What is drawn over a grid; map frame, metres. What is not finite is left out.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Overlay {
    /// Where the robot was, in order.
    pub trajectory: Vec<Pose>,
    /// Where it is; none: the last pose of the trajectory, if there is one.
    pub robot: Option<Pose>,
    /// Things, each with its box and a label.
    pub objects: Vec<MapObject>,
    /// Keep-out and speed zones.
    pub zones: Vec<Zone>,
    /// The same cell by cell.
    pub masks: Vec<ZoneMask>,
    /// A planned path, from the robot to the goal.
    pub path: Vec<Point2<f64>>,
    /// Rooms, each in a tint and with its label.
    pub rooms: Vec<MapRoom>,
}

/// Tints of rooms, in turn.
const TINTS: [Color; 6] = [SKY, AMBER, GREEN, PURPLE, VERMILION, BLUE];
/// So strong.
const TINT: f64 = 0.16;

/// Colour of a class, for boxes.
pub(super) fn class_color(class: ObjectClass) -> Color {
    match class {
        ObjectClass::Unknown => SOFT_INK,
        ObjectClass::Table => VERMILION,
        ObjectClass::Chair => AMBER,
        ObjectClass::Shelf => [110, 64, 170],
        ObjectClass::Box => [140, 70, 20],
        ObjectClass::Cylinder => SKY,
        ObjectClass::Person => PURPLE,
        ObjectClass::Car => BLUE,
        ObjectClass::Van => [0, 80, 130],
        ObjectClass::Truck => [0, 54, 92],
        ObjectClass::Bus => [86, 130, 180],
        ObjectClass::Cyclist => GREEN,
        ObjectClass::Motorcycle => [90, 150, 40],
        ObjectClass::Named(_) => MAGENTA,
    }
}

/// The grid alone, one pixel a cell and nothing around it: white free, dark occupied, bluish grey unknown; the first row of the
/// picture has the largest y.
///
/// # Errors
/// `GridTooLarge`, also beyond four times [`MAX_EDGE`] along an edge; `ShapeMismatch`, `OutOfRange`.
pub fn occupancy<'a>(grid: impl Into<GridView<'a>>) -> Result<RgbImage, PictureError> {
    let grid = grid.into();
    grid.check()?;
    if grid.width.max(grid.height) > 4 * MAX_EDGE {
        return Err(PictureError::GridTooLarge { width: grid.width, height: grid.height });
    }
    let rows = grid.cells.chunks_exact(grid.width.max(1)).rev();
    let pixels = rows.flatten().flat_map(|&percent| colors::occupancy(percent)).collect();
    RgbImage::new(grid.width, grid.height, pixels).map_err(|e| PictureError::Encode(e.to_string()))
}

/// The sheet and window of a grid, its cells drawn: any that is occupied wins over free ones of the same pixel, those over unknown.
pub(crate) fn open_grid(grid: &GridView<'_>, sheet: Sheet) -> (crate::sheet::Opened, Window) {
    let layout = CellLayout::new(grid.geometry, grid.width, grid.height);
    let detail =
        if sheet.detail.is_empty() { layout.detail() } else { format!("{}; {}", layout.detail(), sheet.detail) };
    layout.open(Sheet { detail, ..sheet }, |block| {
        let highest = block.cells(grid.width).map(|i| grid.cells[i]).max().unwrap_or(-1);
        colors::occupancy(highest)
    })
}

/// Which of unknown, free and occupied cells there are.
pub(crate) fn grid_legend(grid: &GridView<'_>) -> Vec<Entry> {
    let has = |is: fn(i8) -> bool| grid.cells.par_iter().any(|c| is(*c));
    let all: [(bool, Color, &str); 3] = [
        (has(|c| c > 50), OCCUPIED, "occupied"),
        (has(|c| (0..=50).contains(&c)), FREE, "free"),
        (has(|c| c < 0), UNKNOWN, "unknown"),
    ];
    all.into_iter().filter(|a| a.0).map(|(_, color, words)| Entry::new(Swatch::Fill(color), words)).collect()
}

/// The grid with trajectory (blue), robot (green), things (a colour a class, with labels), zones and path (magenta), legend, ticks in
/// metres, scale bar and axes.
///
/// # Errors
/// `GridTooLarge`, `ShapeMismatch`, `OutOfRange`.
pub fn overview<'a>(grid: impl Into<GridView<'a>>, overlay: &Overlay, title: &str) -> Result<RgbImage, PictureError> {
    let grid = grid.into();
    grid.check()?;
    let robot = overlay.robot.or(overlay.trajectory.last().copied());
    let sheet = Sheet { title: title.to_owned(), legend: legend(&grid, overlay, robot.is_some()), ..Sheet::default() };
    let (mut opened, window) = open_grid(&grid, sheet);
    let (e, plot) = (opened.enlarge, opened.plot);
    let size = f64::from(e);
    let canvas = &mut opened.canvas;
    draw_rooms(canvas, &window, &overlay.rooms, size);
    zones::draw_masks(canvas, &window, plot, &overlay.masks, e);
    zones::draw(canvas, &window, &overlay.zones, e);
    let flat = |p: &Pose| window.pixel(p.translation.vector.xy().into());
    let trajectory: Vec<_> = overlay.trajectory.iter().map(flat).collect();
    canvas.polyline(&thinned(&trajectory), 2.0 * size, BLUE);
    for object in &overlay.objects {
        canvas.closed(&object.bbox.footprint().map(|p| window.pixel(p)), 2.4 * size, class_color(object.class));
    }
    let path: Vec<_> = overlay.path.iter().map(|p| window.pixel(*p)).collect();
    canvas.polyline(&thinned(&path), 3.2 * size, MAGENTA);
    let mut labels = Labels::new(plot, e);
    if let Some(goal) = path.last() {
        marker(canvas, *goal, 8.0 * size, MAGENTA);
        labels.keep_free(around(*goal, 11.0 * size));
    }
    if let Some(robot) = robot {
        draw_robot(canvas, &window, &robot, size, GREEN);
        labels.keep_free(around(flat(&robot), 13.0 * size));
    }
    for room in &overlay.rooms {
        labels.write(canvas, window.pixel(room.center), -9.0 * size, &room.label, SOFT_INK);
    }
    for (at, text, color) in zones::labels(&window, &overlay.zones) {
        labels.write(canvas, at, -9.0 * size, &text, color);
    }
    for object in &overlay.objects {
        let corners = object.bbox.footprint().map(|p| window.pixel(p));
        let center = window.pixel(object.bbox.center().xy());
        let reach = corners.iter().map(|c| (c.y - center.y).abs()).fold(0.0, f64::max);
        let id = object.id.map(|id| format!(" {id}")).unwrap_or_default();
        labels.write(canvas, center, reach, &format!("{}{id}", object.class.name()), INK);
    }
    let left_out = labels.left_out;
    opened.canvas.clip(None);
    opened.finish(&window);
    if left_out > 0 {
        opened.write_below(&format!("{left_out} labels had no room"));
    }
    opened.canvas.into_image()
}

fn legend(grid: &GridView<'_>, overlay: &Overlay, has_robot: bool) -> Vec<Entry> {
    let mut out = grid_legend(grid);
    if overlay.trajectory.len() > 1 {
        out.push(Entry::new(Swatch::Line(BLUE), "trajectory"));
    }
    if has_robot {
        out.push(Entry::new(Swatch::Disc(GREEN), "robot"));
    }
    if !overlay.path.is_empty() {
        out.push(Entry::new(Swatch::Line(MAGENTA), "path"));
        out.push(Entry::new(Swatch::Disc(MAGENTA), "goal"));
    }
    if !overlay.rooms.is_empty() {
        let tint = colors::mix(colors::PAPER, TINTS[0], TINT);
        out.push(Entry::new(Swatch::Fill(tint), format!("rooms ({})", overlay.rooms.len())));
    }
    if overlay.rooms.iter().any(|room| !room.doors.is_empty()) {
        out.push(Entry::new(Swatch::Line(RED), "doors"));
    }
    out.extend(zones::legend(&overlay.zones, &overlay.masks));
    let named = overlay.objects.iter().map(|o| o.class).filter(|c| matches!(c, ObjectClass::Named(_)));
    let named: BTreeSet<ObjectClass> = named.collect();
    for class in ObjectClass::BUILT_IN.into_iter().chain(named) {
        let count = overlay.objects.iter().filter(|o| o.class == class).count();
        if count > 0 {
            out.push(Entry::new(Swatch::Outline(class_color(class)), format!("{} ({count})", class.name())));
        }
    }
    out
}

/// Rooms in tints, and a line across each door.
fn draw_rooms(canvas: &mut Canvas, window: &Window, rooms: &[MapRoom], size: f64) {
    for (i, room) in rooms.iter().enumerate().filter(|(_, room)| room.outline.len() >= 3) {
        let corners: Vec<Point2<f64>> = room.outline.iter().map(|p| window.pixel(*p)).collect();
        canvas.polygon(&corners, |_, _| Some((TINTS[i % TINTS.len()], TINT)));
    }
    for [a, b] in rooms.iter().flat_map(|room| &room.doors) {
        canvas.line(window.pixel(*a), window.pixel(*b), 3.0 * size, RED);
    }
}

/// A disc with an arrow ahead.
pub(super) fn draw_robot(canvas: &mut Canvas, window: &Window, robot: &Pose, size: f64, color: Color) {
    let at = window.pixel(robot.translation.vector.xy().into());
    let ahead = window.pixel((robot * Point3::new(1.0, 0.0, 0.0)).xy()) - at;
    if let Some(ahead) = ahead.try_normalize(1e-9) {
        canvas.arrow(at, at + ahead * (26.0 * size), 4.6 * size, colors::PAPER);
        canvas.arrow(at, at + ahead * (25.0 * size), 3.0 * size, color);
    }
    marker(canvas, at, 9.0 * size, color);
}

pub(super) fn around(at: Point2<f64>, reach: f64) -> PixelBox {
    let pixel = |v: f64| v.clamp(-1e6, 1e6).round() as i32;
    PixelBox { x0: pixel(at.x - reach), y0: pixel(at.y - reach), x1: pixel(at.x + reach), y1: pixel(at.y + reach) }
}

/// Points of a line without those that lie within a pixel of the one before.
pub(super) fn thinned(points: &[Point2<f64>]) -> Vec<Point2<f64>> {
    let mut out: Vec<Point2<f64>> = vec![];
    for (i, p) in points.iter().enumerate() {
        let is_end = i + 1 == points.len();
        // NaN is kept: it interrupts the line.
        let is_near = |last: &Point2<f64>| (p - last).norm() < 1.0;
        if is_end || !out.last().is_some_and(is_near) {
            out.push(*p);
        }
    }
    out
}
