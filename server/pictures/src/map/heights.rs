//! Heights of the ground: colours, shaded as if lit from the north-west, with contour lines.

use super::{Block, CellLayout, check_shape};
use crate::PictureError;
use crate::canvas::Canvas;
use crate::colors::{INK, MAGENTA, Scale, UNKNOWN, scaled};
use crate::sheet::{ColorBar, Entry, Sheet, Swatch, Window, in_metres};
use nalgebra::Point2;
use percept_geometry::{Cell, RgbImage};
use percept_mapping::DenseHeights;

/// Metres between contour lines: the first of which at most [`MAX_CONTOURS`] cross the range.
const INTERVALS: [f64; 10] = [0.1, 0.5, 1.0, 5.0, 10.0, 50.0, 100.0, 500.0, 1000.0, 5000.0];
const MAX_CONTOURS: f64 = 14.0;

/// The ground by height (viridis: dark low, light high), shaded relief, contour lines, drops magenta, unseen ground bluish grey.
///
/// # Errors
/// `GridTooLarge`, `ShapeMismatch`, `OutOfRange`.
pub fn heights(heights: &DenseHeights, title: &str) -> Result<RgbImage, PictureError> {
    let buffers = [("ground_m", heights.ground_m.len()), ("is_drop", heights.is_drop.len())];
    check_shape(&heights.geometry, heights.width, heights.height, &buffers)?;
    // A few cells that are wildly off must not take the colours from all others.
    let (low, high) = spread(&heights.ground_m);
    let bar = ColorBar::over("height [m]", Scale::Viridis, [low, high].into_iter());
    let interval = interval(bar.high - bar.low);
    let layout = CellLayout::new(heights.geometry, heights.width, heights.height);
    let mut legend = vec![];
    if let Some(interval) = interval {
        legend.push(Entry::new(Swatch::Line(INK), format!("contour each {}", in_metres(interval))));
    }
    if heights.is_drop.contains(&true) {
        legend.push(Entry::new(Swatch::Fill(MAGENTA), "drop"));
    }
    if heights.ground_m.iter().zip(&heights.is_drop).any(|(z, drop)| !z.is_finite() && !drop) {
        legend.push(Entry::new(Swatch::Fill(UNKNOWN), "unknown"));
    }
    let sheet =
        Sheet { title: title.to_owned(), detail: layout.detail(), bar: Some(bar.clone()), legend, ..Sheet::default() };
    let (mut opened, window) = layout.open(sheet, |block| color(heights, &bar, block));
    if let Some(interval) = interval {
        contours(&mut opened.canvas, &window, heights, (&bar, interval), opened.enlarge);
    }
    opened.canvas.clip(None);
    opened.finish(&window);
    opened.canvas.into_image()
}

/// Heights below and above which half a per cent of the cells lie; NaN if none is known.
fn spread(values: &[f32]) -> (f64, f64) {
    // Of very many, every so many tell the same.
    let stride = values.len().div_ceil(1 << 20).max(1);
    let mut finite: Vec<f32> = values.iter().step_by(stride).copied().filter(|v| v.is_finite()).collect();
    if finite.is_empty() {
        finite = values.iter().copied().find(|v| v.is_finite()).into_iter().collect();
    }
    finite.sort_by(f32::total_cmp);
    let at = |share: f64| {
        let place = (share * finite.len().saturating_sub(1) as f64).round() as usize;
        finite.get(place).map_or(f64::NAN, |v| f64::from(*v))
    };
    (at(0.005), at(0.995))
}

fn interval(range: f64) -> Option<f64> {
    if range < 0.1 {
        return None;
    }
    INTERVALS.into_iter().find(|i| range / i <= MAX_CONTOURS)
}

fn color(heights: &DenseHeights, bar: &ColorBar, block: &Block) -> [u8; 3] {
    let (mut sum, mut known, mut is_drop) = (0.0, 0usize, false);
    for i in block.cells(heights.width) {
        is_drop |= heights.is_drop[i];
        if heights.ground_m[i].is_finite() {
            sum += f64::from(heights.ground_m[i]);
            known += 1;
        }
    }
    if is_drop {
        return MAGENTA;
    }
    if known == 0 {
        return UNKNOWN;
    }
    scaled(bar.color(sum / known as f64), relief(heights, block))
}

/// How light a place is by its slope; 1 for flat ground, and where too little is known.
fn relief(heights: &DenseHeights, block: &Block) -> f64 {
    let at = |x: usize, y: usize| {
        let inside = x < heights.width && y < heights.height;
        inside.then(|| f64::from(heights.ground_m[y * heights.width + x])).filter(|z| z.is_finite())
    };
    let (x, y, step) = (block.x.start, block.y.start, block.x.len().max(1));
    let metres = step as f64 * heights.geometry.resolution_m;
    let rise = |a: Option<f64>, b: Option<f64>| match (a, b) {
        (Some(a), Some(b)) => (b - a) / metres,
        _ => 0.0,
    };
    let here = at(x, y);
    let (east, north) = (rise(here, at(x + step, y)), rise(here, at(x, y + step)));
    // Lit from the north-west: what falls towards it is light.
    (1.0 + 0.45 * (east - north).clamp(-1.2, 0.6)).clamp(0.4, 1.12)
}

/// Lines of equal height between the middles of cells (marching squares): light on dark colours, dark on light ones.
fn contours(canvas: &mut Canvas, window: &Window, heights: &DenseHeights, (bar, interval): (&ColorBar, f64), e: i32) {
    // Of cells smaller than two pixels, only as many are looked at as can be seen.
    let step = (2.0 / (heights.geometry.resolution_m * window.per_metre)).ceil().max(1.0) as usize;
    let at = |x: usize, y: usize| f64::from(heights.ground_m[y * heights.width + x]);
    for y in (0..heights.height.saturating_sub(step)).step_by(step) {
        for x in (0..heights.width.saturating_sub(step)).step_by(step) {
            let places = [(x, y), (x + step, y), (x + step, y + step), (x, y + step)];
            let z = places.map(|(x, y)| at(x, y));
            if !z.iter().all(|z| z.is_finite()) {
                continue;
            }
            let (low, high) = z.iter().fold((f64::MAX, f64::MIN), |(l, h), z| (l.min(*z), h.max(*z)));
            // A cliff is an edge, not a slope: its lines would lie on each other.
            if high - low > 3.0 * interval || high.abs() > 1e9 {
                continue;
            }
            let (first, last) = ((low / interval).floor() as i64 + 1, (high / interval).floor() as i64);
            if is_level(heights, x, y, step) {
                continue;
            }
            let corners = places.map(|(x, y)| window.pixel(heights.geometry.center(Cell::new(x as i32, y as i32))));
            for level in (first..=last).map(|level| level as f64 * interval) {
                let color = if bar.share(level) < 0.4 { [214, 216, 226] } else { INK };
                segments(&corners, &z, level, |a, b| canvas.line(a, b, f64::from(e), color));
            }
        }
    }
}

/// Whether the ground rises by less than 2.5 % along both axes, to one side at least of five cells: there, noise would draw the
/// lines, beside a cliff as well as far from it.
fn is_level(heights: &DenseHeights, x: usize, y: usize, step: usize) -> bool {
    const REACH: usize = 5;
    const LEVEL: f64 = 0.025;
    let at = |x: usize, y: usize| f64::from(heights.ground_m[y * heights.width + x]);
    let here = at(x, y);
    let slope = |other: Option<f64>| {
        let rise = other.map(|z| (z - here).abs()).filter(|rise| rise.is_finite());
        rise.map(|rise| rise / ((REACH * step) as f64 * heights.geometry.resolution_m))
    };
    let (reach, up) = (REACH * step, |i: usize, size: usize| Some(i + REACH * step).filter(|i| *i < size));
    let along_x = [x.checked_sub(reach), up(x, heights.width)].map(|x| slope(x.map(|x| at(x, y))));
    let along_y = [y.checked_sub(reach), up(y, heights.height)].map(|y| slope(y.map(|y| at(x, y))));
    [along_x, along_y].iter().all(|sides| sides.iter().flatten().copied().reduce(f64::min).is_none_or(|s| s < LEVEL))
}

/// The pieces of a level's line within a square.
fn segments(corners: &[Point2<f64>; 4], z: &[f64; 4], level: f64, mut draw: impl FnMut(Point2<f64>, Point2<f64>)) {
    let mut crossings: [Option<Point2<f64>>; 4] = [None; 4];
    for i in 0..4 {
        let j = (i + 1) % 4;
        if (z[i] < level) != (z[j] < level) {
            let share = (level - z[i]) / (z[j] - z[i]);
            crossings[i] = Some(corners[i] + (corners[j] - corners[i]) * share);
        }
    }
    let found: Vec<Point2<f64>> = crossings.into_iter().flatten().collect();
    found.chunks_exact(2).for_each(|ends| draw(ends[0], ends[1]));
}
