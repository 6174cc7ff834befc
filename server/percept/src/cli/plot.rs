//! Charts as PNG: lines over axes, nothing more.

use super::Failure;
use super::slam_run::SlamRun;
use embedded_graphics::mono_font::{MonoTextStyle, ascii::FONT_7X13};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Line, PrimitiveStyle, Rectangle};
use embedded_graphics::text::{Alignment as Side, Text, TextStyleBuilder};
use percept_evaluation::PosePair;
use percept_geometry::{Pose, RgbImage};
use std::convert::Infallible;

const WIDTH: u32 = 760;
const HEIGHT: u32 = 520;
/// Room around the axes for numbers and names, pixels: left, top, right, bottom.
const MARGIN: [i32; 4] = [78, 34, 18, 46];
/// Points of a line that are drawn; longer ones are thinned.
const MAX_POINTS: usize = 20_000;

const TRUTH: Rgb888 = Rgb888::new(120, 120, 120);
const BLUE: Rgb888 = Rgb888::new(31, 98, 189);
const RED: Rgb888 = Rgb888::new(206, 60, 40);
const BLACK: Rgb888 = Rgb888::new(30, 30, 30);
const GRID: Rgb888 = Rgb888::new(226, 226, 226);

/// A line through points; NaN interrupts it.
struct Series {
    name: &'static str,
    color: Rgb888,
    points: Vec<(f64, f64)>,
}

/// Lines over a pair of axes.
struct Chart {
    title: &'static str,
    x: &'static str,
    y: &'static str,
    /// Whether a metre is as long along x as along y.
    equal: bool,
    series: Vec<Series>,
}

/// Two trajectories over each other, seen along the axis on which the truth moves least, and the error over time.
///
/// # Errors
/// The encoder's.
pub(crate) fn trajectories(pairs: &[PosePair]) -> Result<Vec<u8>, Failure> {
    let (a, b, x, y) = plane(pairs);
    let path = |of: &dyn Fn(&PosePair) -> Pose| {
        pairs.iter().map(|p| of(p).translation.vector).map(|v| (v[a], v[b])).collect::<Vec<_>>()
    };
    let over_time = |of: &dyn Fn(&PosePair) -> f64| -> Vec<(f64, f64)> {
        let start = pairs.first().map(|p| p.stamp).unwrap_or_default();
        pairs.iter().map(|p| (p.stamp.seconds_since(start), of(p))).collect()
    };
    let translation = |p: &PosePair| (p.estimate.translation.vector - p.reference.translation.vector).norm();
    let rotation = |p: &PosePair| p.estimate.rotation.angle_to(&p.reference.rotation).to_degrees();
    let line = |name, color, points| Series { name, color, points };
    draw(&[
        Chart {
            title: "Trajectories",
            x,
            y,
            equal: true,
            series: vec![
                line("reference", TRUTH, path(&|p| p.reference)),
                line("estimate", BLUE, path(&|p| p.estimate)),
            ],
        },
        Chart {
            title: "Absolute error, translation",
            x: "time [s]",
            y: "error [m]",
            equal: false,
            series: vec![line("", RED, over_time(&translation))],
        },
        Chart {
            title: "Absolute error, rotation",
            x: "time [s]",
            y: "error [deg]",
            equal: false,
            series: vec![line("", RED, over_time(&rotation))],
        },
    ])
}

/// A simulated session: trajectories with and without loops, error, time of a frame, memory.
///
/// # Errors
/// The encoder's.
pub(crate) fn session(run: &SlamRun, open: Option<&SlamRun>) -> Result<Vec<u8>, Failure> {
    let aligned = |run: &SlamRun| {
        let mut pairs = run.final_pairs();
        if let Ok(similarity) = percept_evaluation::align(&pairs, percept_evaluation::Alignment::Se3) {
            pairs.iter_mut().for_each(|p| p.estimate = similarity.apply(&p.estimate));
        }
        pairs
    };
    let path = |pairs: &[PosePair], of: &dyn Fn(&PosePair) -> Pose| {
        pairs.iter().map(|p| of(p).translation.vector).map(|v| (v.x, v.y)).collect::<Vec<_>>()
    };
    let line = |name, color, points| Series { name, color, points };
    let pairs = aligned(run);
    let mut paths = vec![line("truth", TRUTH, path(&pairs, &|p| p.reference))];
    let mut errors = vec![];
    if let Some(open) = open {
        paths.push(line("without loops", RED, path(&aligned(open), &|p| p.estimate)));
        errors.push(line("without loops", RED, seconds(open, &open.online_errors())));
    }
    paths.push(line("with loops", BLUE, path(&pairs, &|p| p.estimate)));
    errors.push(line("with loops", BLUE, seconds(run, &run.online_errors())));
    let (mut ms, rss): (Vec<f64>, Vec<f64>) = run.frames.iter().map(|f| (f64::from(f.ms), f64::from(f.rss_mb))).unzip();
    cut_off(&mut ms);
    let chart = |title, y, series| Chart { title, x: "time [s]", y, equal: false, series };
    draw(&[
        Chart { title: "Trajectories", x: "x [m]", y: "y [m]", equal: true, series: paths },
        chart("Error of the pose as said at the time", "error [m]", errors),
        chart("Time of a frame (the longest 0.1 % cut off)", "time [ms]", vec![line("", BLUE, seconds(run, &ms))]),
        chart("Resident memory", "memory [MB]", vec![line("", BLUE, seconds(run, &rss))]),
    ])
}

/// Brings the largest thousandth of values down to the rest: one of them would hide all others.
fn cut_off(values: &mut [f64]) {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(&top) = sorted.get((sorted.len() as f64 * 0.999) as usize) else { return };
    values.iter_mut().for_each(|v| *v = v.min(top));
}

fn seconds(run: &SlamRun, values: &[f64]) -> Vec<(f64, f64)> {
    run.frames.iter().map(|f| f.second).zip(values.iter().copied()).collect()
}

/// The two axes on which the truth moves most, in order, and what they are called.
fn plane(pairs: &[PosePair]) -> (usize, usize, &'static str, &'static str) {
    let extent = |i: usize| {
        let (low, high) = bounds(pairs.iter().map(|p| p.reference.translation.vector[i]));
        high - low
    };
    // Of equals the last: a robot that went straight ahead is seen from above.
    let least = (0..3).rev().min_by(|&a, &b| extent(a).total_cmp(&extent(b))).unwrap_or(2);
    let names = ["x [m]", "y [m]", "z [m]"];
    let (a, b) = [(1, 2), (0, 2), (0, 1)][least];
    (a, b, names[a], names[b])
}

fn bounds(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low <= high { (low, high) } else { (0.0, 1.0) }
}

/// Pixels that shapes are drawn into.
struct Canvas {
    size: Size,
    data: Vec<u8>,
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        self.size
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        for Pixel(at, color) in pixels {
            let (Ok(x), Ok(y)) = (u32::try_from(at.x), u32::try_from(at.y)) else { continue };
            if x < self.size.width && y < self.size.height {
                let i = 3 * (y as usize * self.size.width as usize + x as usize);
                self.data[i..i + 3].copy_from_slice(&[color.r(), color.g(), color.b()]);
            }
        }
        Ok(())
    }
}

/// The charts two in a row, as a PNG.
fn draw(charts: &[Chart]) -> Result<Vec<u8>, Failure> {
    let columns = charts.len().min(2) as u32;
    let rows = (charts.len() as u32).div_ceil(columns.max(1));
    let size = Size::new(columns * WIDTH, rows * HEIGHT);
    let mut canvas = Canvas { size, data: vec![255; 3 * size.width as usize * size.height as usize] };
    for (i, chart) in charts.iter().enumerate() {
        let (column, row) = (i as u32 % columns, i as u32 / columns);
        let corner = Point::new((column * WIDTH) as i32, (row * HEIGHT) as i32);
        // Nothing can fail that writes into memory.
        let Ok(()) = chart.draw(&mut canvas, corner);
    }
    let image = RgbImage::new(size.width as usize, size.height as usize, canvas.data)?;
    Ok(percept_formats::images::encode_rgb_png(&image)?)
}

/// Where values are in pixels.
struct Axis {
    low: f64,
    high: f64,
    from_px: f64,
    to_px: f64,
}

impl Axis {
    fn at(&self, value: f64) -> i32 {
        let share = (value - self.low) / (self.high - self.low);
        (self.from_px + share * (self.to_px - self.from_px)).round().clamp(-1e6, 1e6) as i32
    }

    /// Round numbers about a tenth to a fifth of the axis apart, and how many decimals they need.
    fn ticks(&self) -> (Vec<f64>, usize) {
        let raw = (self.high - self.low) / 6.0;
        let power = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|&s| s >= raw).unwrap_or(raw);
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step).floor() as i64;
        ((first..=last.min(first + 20)).map(|i| i as f64 * step).collect(), (-step.log10().floor()).max(0.0) as usize)
    }
}

impl Chart {
    /// Axes that show all points with some room, those of paths to one scale.
    fn axes(&self, corner: Point) -> (Axis, Axis) {
        let all = || self.series.iter().flat_map(|s| &s.points);
        let (mut x, mut y) = (bounds(all().map(|p| p.0)), bounds(all().map(|p| p.1)));
        let [left, top, right, bottom] = MARGIN.map(f64::from);
        let (width, height) = (f64::from(WIDTH) - left - right, f64::from(HEIGHT) - top - bottom);
        let widen = |range: &mut (f64, f64), to: f64| {
            let half = 0.5 * to.max(1e-9);
            let middle = 0.5 * (range.0 + range.1);
            *range = (middle - half, middle + half);
        };
        if self.equal {
            let metres_per_px = ((x.1 - x.0) / width).max((y.1 - y.0) / height) * 1.06;
            widen(&mut x, metres_per_px * width);
            widen(&mut y, metres_per_px * height);
        } else {
            // Errors, times and memory are seen from zero.
            y = (y.0.min(0.0), if y.1 > 0.0 { 1.06 * y.1 } else { 1.0 });
            let length = x.1 - x.0;
            widen(&mut x, length);
        }
        let (x0, y0) = (f64::from(corner.x) + left, f64::from(corner.y) + top);
        (
            Axis { low: x.0, high: x.1, from_px: x0, to_px: x0 + width },
            Axis { low: y.0, high: y.1, from_px: y0 + height, to_px: y0 },
        )
    }

    fn draw(&self, canvas: &mut Canvas, corner: Point) -> Result<(), Infallible> {
        let (x, y) = self.axes(corner);
        let (left, right) = (x.from_px as i32, x.to_px as i32);
        let (bottom, top) = (y.from_px as i32, y.to_px as i32);
        let write = |canvas: &mut Canvas, text: &str, at: (i32, i32), color: Rgb888, side: Side| {
            let style = TextStyleBuilder::new().alignment(side).build();
            let font = MonoTextStyle::new(&FONT_7X13, color);
            Text::with_text_style(text, Point::new(at.0, at.1), font, style).draw(canvas).map(drop)
        };
        let line = |canvas: &mut Canvas, from: (i32, i32), to: (i32, i32), color: Rgb888, width: u32| {
            let style = PrimitiveStyle::with_stroke(color, width);
            Line::new(Point::new(from.0, from.1), Point::new(to.0, to.1)).into_styled(style).draw(canvas)
        };
        let (ticks, decimals) = x.ticks();
        for tick in ticks {
            line(canvas, (x.at(tick), top), (x.at(tick), bottom), GRID, 1)?;
            write(canvas, &format!("{tick:.decimals$}"), (x.at(tick), bottom + 15), BLACK, Side::Center)?;
        }
        let (ticks, decimals) = y.ticks();
        for tick in ticks {
            line(canvas, (left, y.at(tick)), (right, y.at(tick)), GRID, 1)?;
            write(canvas, &format!("{tick:.decimals$}"), (left - 6, y.at(tick) + 4), BLACK, Side::Right)?;
        }
        for series in &self.series {
            let stride = series.points.len().div_ceil(MAX_POINTS).max(1);
            let shown: Vec<_> = series.points.iter().step_by(stride).collect();
            for ends in shown.windows(2).filter(|e| e.iter().all(|p| p.0.is_finite() && p.1.is_finite())) {
                let at = |p: &(f64, f64)| (x.at(p.0), y.at(p.1));
                line(canvas, at(ends[0]), at(ends[1]), series.color, if self.equal { 2 } else { 1 })?;
            }
        }
        let frame = Rectangle::with_corners(Point::new(left, top), Point::new(right, bottom));
        frame.into_styled(PrimitiveStyle::with_stroke(BLACK, 1)).draw(canvas)?;
        write(canvas, self.title, ((left + right) / 2, top - 12), BLACK, Side::Center)?;
        write(canvas, self.x, ((left + right) / 2, bottom + 34), BLACK, Side::Center)?;
        write(canvas, self.y, (left - 70, top - 12), BLACK, Side::Left)?;
        for (i, series) in self.series.iter().filter(|s| !s.name.is_empty()).enumerate() {
            let at = top + 18 + 17 * i as i32;
            line(canvas, (right - 150, at - 4), (right - 126, at - 4), series.color, 3)?;
            write(canvas, series.name, (right - 118, at), BLACK, Side::Left)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::{Timestamp, se3};

    #[test]
    fn a_plot_shows_both_lines_in_their_colours() {
        let pair = |i: i64| PosePair {
            stamp: Timestamp(i * 100_000_000),
            reference: se3::from_xy_yaw(i as f64, 0.0, 0.0),
            estimate: se3::from_xy_yaw(i as f64, 0.5, 0.01),
        };
        let png = trajectories(&(0..20).map(pair).collect::<Vec<_>>()).unwrap();
        let image = percept_formats::decode_color(&png, &percept_formats::Limits::default()).unwrap();
        assert_eq!((image.width(), image.height()), (2 * WIDTH as usize, 2 * HEIGHT as usize));
        for color in [TRUTH, BLUE, RED] {
            let same = |p: &[u8]| p == [color.r(), color.g(), color.b()];
            let drawn = image.data().chunks_exact(3).filter(|p| same(p)).count();
            assert!(drawn > 100, "{color:?}: {drawn} pixels");
        }
        assert!(trajectories(&[]).is_ok());
    }

    #[test]
    fn ticks_are_round_numbers_within_the_axis() {
        let axis = Axis { low: -0.3, high: 1.27, from_px: 0.0, to_px: 100.0 };
        let (ticks, decimals) = axis.ticks();
        assert_eq!(decimals, 1);
        assert_eq!(ticks.iter().map(|t| format!("{t:.1}")).collect::<Vec<_>>(), ["0.0", "0.5", "1.0"]);
        assert_eq!((axis.at(-0.3), axis.at(1.27)), (0, 100));
    }
}
