//! Pictures of maps for people: occupancy, overview with trajectory, objects and path, top view of the cloud.

use crate::reason;
use crate::{Error, Result};
use nalgebra::Point2;
use percept_formats::{GridMap, images};
use percept_geometry::{ObjectClass, OrientedBox3, PointCloud, Pose, RgbImage};
use percept_pipeline::Snapshot;
use percept_scene::ObjectState;

/// Longest edge of a picture, pixels.
const MAX_EDGE: usize = 4096;
/// An overview is enlarged until its longest edge has about this many pixels.
const WANTED_EDGE: usize = 900;

const UNKNOWN: [u8; 3] = [205, 205, 205];
const TRAJECTORY: [u8; 3] = [30, 100, 220];
const PATH: [u8; 3] = [220, 30, 160];
const ROBOT: [u8; 3] = [20, 150, 60];

/// A picture under construction; row 0 on top.
struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl Canvas {
    fn new(width: usize, height: usize, color: [u8; 3]) -> Self {
        Self { width, height, pixels: color.repeat(width * height) }
    }

    fn set(&mut self, x: i64, y: i64, color: [u8; 3]) {
        if x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height {
            let i = (y as usize * self.width + x as usize) * 3;
            self.pixels[i..i + 3].copy_from_slice(&color);
        }
    }

    fn disc(&mut self, center: Point2<f64>, radius: i64, color: [u8; 3]) {
        let (cx, cy) = (center.x.round() as i64, center.y.round() as i64);
        for dy in -radius..=radius {
            for dx in -radius..=radius {
                if dx * dx + dy * dy <= radius * radius {
                    self.set(cx + dx, cy + dy, color);
                }
            }
        }
    }

    fn line(&mut self, a: Point2<f64>, b: Point2<f64>, thickness: i64, color: [u8; 3]) {
        let steps = ((b - a).amax().ceil() as usize).clamp(1, 4 * MAX_EDGE);
        for i in 0..=steps {
            self.disc(a + (b - a) * (i as f64 / steps as f64), thickness / 2, color);
        }
    }

    fn into_png(self) -> Result<Vec<u8>> {
        let image = RgbImage::new(self.width, self.height, self.pixels).map_err(Error::internal)?;
        images::encode_rgb_png(&image).map_err(Error::internal)
    }
}

fn shade(percent: i8) -> [u8; 3] {
    if percent < 0 {
        return UNKNOWN;
    }
    let v = 255 - (i32::from(percent) * 255 / 100) as u8;
    [v, v, v]
}

/// Colour of a class, for boxes.
fn class_color(class: ObjectClass) -> [u8; 3] {
    match class {
        ObjectClass::Unknown => [130, 130, 130],
        ObjectClass::Table => [200, 120, 30],
        ObjectClass::Chair => [230, 180, 0],
        ObjectClass::Shelf => [120, 60, 160],
        ObjectClass::Box => [190, 50, 40],
        ObjectClass::Cylinder => [0, 150, 160],
        ObjectClass::Person => [240, 60, 200],
    }
}

fn check_size(width: usize, height: usize) -> Result<()> {
    if width.max(height) <= MAX_EDGE * 4 {
        return Ok(());
    }
    let message = format!("a picture of {width}x{height} pixels is too large; read the grid by regions");
    Err(Error::exhausted(reason::PICTURE_TOO_LARGE, "format", message))
}

fn draw_grid(grid: &GridMap, scale: usize) -> Canvas {
    let mut canvas = Canvas::new(grid.width * scale, grid.height * scale, UNKNOWN);
    for (i, &percent) in grid.cells.iter().enumerate().filter(|(_, c)| **c >= 0) {
        let (x, y) = (i % grid.width, grid.height - 1 - i / grid.width);
        for dy in 0..scale {
            for dx in 0..scale {
                canvas.set((x * scale + dx) as i64, (y * scale + dy) as i64, shade(percent));
            }
        }
    }
    canvas
}

/// The grid, one pixel a cell: white free, black occupied, grey unknown; the first row has the largest y.
///
/// # Errors
/// `PICTURE_TOO_LARGE`.
pub fn occupancy(grid: &GridMap) -> Result<Vec<u8>> {
    check_size(grid.width, grid.height)?;
    draw_grid(grid, 1).into_png()
}

/// What is drawn over a grid; map frame, metres.
#[derive(Debug, Clone, Default)]
pub struct Overlay {
    /// Where the robot was; the last pose is where it is.
    pub trajectory: Vec<Pose>,
    /// Boxes with their classes.
    pub objects: Vec<(ObjectClass, OrientedBox3)>,
    /// A planned path.
    pub path: Vec<Point2<f64>>,
}

impl Overlay {
    /// What a snapshot knows.
    pub fn of(snapshot: &Snapshot) -> Self {
        let there = snapshot.objects.iter().filter(|o| o.state != ObjectState::Gone);
        Self {
            trajectory: snapshot.trajectory_in_one_unit().map(|(t, _)| t).collect(),
            objects: there.map(|o| (o.class, o.bbox)).collect(),
            path: vec![],
        }
    }
}

/// The grid with trajectory (blue), robot (green), objects (coloured by class) and path (magenta).
///
/// # Errors
/// `PICTURE_TOO_LARGE`.
pub fn overview(grid: &GridMap, overlay: &Overlay) -> Result<Vec<u8>> {
    check_size(grid.width, grid.height)?;
    let scale = (WANTED_EDGE / grid.width.max(grid.height).max(1)).clamp(1, 8);
    let mut canvas = draw_grid(grid, scale);
    let per_metre = scale as f64 / grid.geometry.resolution_m;
    let height = canvas.height as f64;
    let origin = grid.geometry.origin;
    let pixel = move |p: Point2<f64>| Point2::new((p.x - origin.x) * per_metre, height - (p.y - origin.y) * per_metre);
    let position = |t: &Pose| pixel(t.translation.vector.xy().into());
    overlay.trajectory.windows(2).for_each(|p| canvas.line(position(&p[0]), position(&p[1]), 2, TRAJECTORY));
    for (class, bbox) in &overlay.objects {
        let corners = bbox.footprint().map(pixel);
        (0..4).for_each(|i| canvas.line(corners[i], corners[(i + 1) % 4], 3, class_color(*class)));
    }
    overlay.path.windows(2).for_each(|p| canvas.line(pixel(p[0]), pixel(p[1]), 3, PATH));
    if let Some(goal) = overlay.path.last() {
        canvas.disc(pixel(*goal), 6, PATH);
    }
    if let Some(robot) = overlay.trajectory.last() {
        canvas.disc(position(robot), 6, ROBOT);
        let ahead = robot * nalgebra::Point3::new(0.5, 0.0, 0.0);
        canvas.line(position(robot), pixel(ahead.xy()), 3, ROBOT);
    }
    canvas.into_png()
}

/// The cloud from above, its own colours (or shaded by height); higher points cover lower ones, but whatever
/// is above 2.2 m is left out, so that ceilings do not hide the rooms.
///
/// # Errors
/// None for a cloud that is not empty.
pub fn cloud_top(cloud: &PointCloud) -> Result<Vec<u8>> {
    const CEILING_M: f32 = 2.2;
    let bounds = percept_geometry::Aabb3::of(&cloud.positions);
    let size = bounds.size();
    let per_metre = (WANTED_EDGE as f64 / size.x.max(size.y).max(0.1)).min(40.0);
    let edge = |s: f64| ((s * per_metre).ceil() as usize + 1).min(MAX_EDGE);
    let mut canvas = Canvas::new(edge(size.x), edge(size.y), [24, 26, 30]);
    let mut order: Vec<usize> = (0..cloud.len()).filter(|&i| cloud.positions[i].z < CEILING_M).collect();
    order.sort_by(|&a, &b| cloud.positions[a].z.total_cmp(&cloud.positions[b].z));
    for i in order {
        let p = cloud.positions[i].cast::<f64>();
        let share = ((p.z - bounds.min.z) / size.z.clamp(0.1, f64::from(CEILING_M))).clamp(0.0, 1.0);
        let by_height = [(60.0 + 190.0 * share) as u8, (90.0 + 80.0 * share) as u8, (200.0 - 150.0 * share) as u8];
        let color = cloud.colors.as_ref().map_or(by_height, |c| c[i]);
        let at = Point2::new(
            (p.x - bounds.min.x) * per_metre,
            canvas.height as f64 - 1.0 - (p.y - bounds.min.y) * per_metre,
        );
        canvas.disc(at, 1, color);
    }
    canvas.into_png()
}
