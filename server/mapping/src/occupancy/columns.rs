//! What a scan in space says of the floor around: by columns of azimuth, over the ground.

use super::mark::{Heights, Mark};
use super::marks::{Frame, ScanUpdate};
use crate::ground::{Ground, Patch, Place, sector_of};
use nalgebra::{Point2, Point3};
use percept_geometry::grid::walk;
use percept_geometry::{Cell, by_processor};
use std::f64::consts::{PI, TAU};

/// A beam that goes deeper than this below the band's bottom looks down a drop (stairs, a pit), metres.
const DROP_M: f64 = 0.2;
/// Beams end together if they do within this, metres.
const END_M: f64 = 0.05;
/// A beam went on over a cell if it ended so far behind it, metres: else it may have grazed what stands there.
const BEYOND_M: f32 = 1.0;

/// A beam that falls by more, rise over run, may end on what lies flat.
const FALLS: f32 = -0.05;
/// So much higher than where it ended a beam has passed over what it ended on, metres: three times the noise of a depth camera 3 m away,
/// and the height of a bit. In the demo's rooms tops of tables went to pieces without it.
const GRAZES_M: f32 = 0.1;

/// The columns of a scan.
pub(super) struct Columns<'a> {
    frame: &'a Frame<'a>,
    ground: &'a Ground,
    columns: Vec<Column>,
}

/// What is known of a column, and how steep its beams are. One set of slopes does for all ranges: beams that end early leave the
/// band there, or end at the obstacle that bounds what is free.
#[derive(Clone)]
struct Column {
    /// Ground and obstacles, as they came.
    ends: Vec<End>,
    /// Where its beams are over the ground and in the band: so far, horizontally from the sensor, metres.
    farthest_free: f64,
    free: Point2<f64>,
    /// Of beams that are much alike one: bins from 45 degrees down to 45 degrees up. It went as far as the shortest of them.
    beams: [Beam; NUM_BEAMS],
}

/// A lidar of 64 rings has them 0.006 to 0.009 radians apart: each passes at its own height.
const NUM_BEAMS: usize = 320;
/// Half of what a beam is wide, radians: a VLP-16's diverges by 3 mrad. What one hit another beam that passed a centimetre beside it
/// would have hit.
const HALF_WIDTH_RAD: f32 = 0.0015;
/// Nearer than this a beam is a line, metres: it is thinner than a third of a bit of heights, and what lies flat, a table's top, goes to
/// pieces where every beam that grazes it counts for more (the demo's rooms).
const LINE_M: f32 = 5.0;

/// How steep a beam is, rise over run, and how far it went, horizontally, metres; infinitely steep is none.
#[derive(Clone, Copy)]
struct Beam {
    slope: f32,
    range: f32,
}

impl Beam {
    const NONE: Self = Self { slope: f32::INFINITY, range: f32::INFINITY };
}

/// Where a beam ended, in the map.
#[derive(Clone, Copy)]
struct End {
    range: f64,
    at: Point2<f64>,
    is_obstacle: bool,
}

impl Column {
    const EMPTY: Self =
        Self { ends: vec![], farthest_free: 0.0, free: Point2::new(0.0, 0.0), beams: [Beam::NONE; NUM_BEAMS] };

    fn include(&mut self, slope: f64, range: f64) {
        if slope.is_finite() {
            let kept = &mut self.beams[((slope.clamp(-1.0, 1.0) + 1.0) * (0.4999 * NUM_BEAMS as f64)) as usize];
            *kept = Beam { slope: kept.slope.min(slope as f32), range: kept.range.min(range as f32) };
        }
    }

    /// The beams, rising; what ended is in order then, too.
    fn settle(&mut self) -> Vec<Beam> {
        self.ends.sort_by(|a, b| a.range.total_cmp(&b.range));
        self.beams.iter().filter(|beam| beam.slope.is_finite()).copied().collect()
    }
}

/// The ground in a direction as the sensor looks down on it, ring by ring: how far below the sensor it would be under it, metres,
/// and by how much that falls with range.
struct Profile {
    sector: usize,
    rings: Vec<(f32, f32)>,
}

/// Free cells of a column while they are marked, and what of it is said of them. Heights over the band's bottom are in
/// [`Heights`]' bits.
struct Passing<'a> {
    frame: &'a Frame<'a>,
    ground: &'a Ground,
    profile: Profile,
    bits_per_m: f32,
    cells: Vec<Cell>,
    /// By cell: its range, metres; the sensor's height over the band there; the heights at which beams pass.
    ranges: Vec<f32>,
    above: Vec<f32>,
    heights: Vec<u64>,
}

impl<'a> Passing<'a> {
    fn new(frame: &'a Frame<'a>, ground: &'a Ground) -> Self {
        let (cells, ranges, above, heights) = (vec![], vec![], vec![], vec![]);
        let bits_per_m = 64.0 / (frame.params.band_max_m - frame.params.band_min_m) as f32;
        let profile = Profile { sector: usize::MAX, rings: vec![] };
        Self { frame, ground, profile, bits_per_m, cells, ranges, above, heights }
    }

    /// Goes on with a column in this direction, radians.
    fn turn_to(&mut self, azimuth: f64) {
        let (sector, sensor_z) = (sector_of(azimuth), self.frame.sensor.z);
        if sector != self.profile.sector {
            self.profile.sector = sector;
            self.profile.rings.clear();
            let seen_from = |patch: &Patch| ((sensor_z - patch.z_at(0.0)) as f32, patch.slope as f32);
            self.profile.rings.extend(self.ground.along(sector).map(seen_from));
        }
    }

    /// Frees the cells from one place to another with the heights at which some beams pass there; with that of the end, or
    /// without. Of those that only went on over them nothing but that is known.
    fn free(
        &mut self,
        update: &mut ScanUpdate,
        beams: &[Beam],
        (from, to): (&Point2<f64>, &Point2<f64>),
        with_end: bool,
        that: That,
    ) {
        self.cells.clear();
        self.ranges.clear();
        self.above.clear();
        let geometry = self.frame.geometry;
        walk(geometry, from, to, |cell| {
            let off = geometry.center(cell) - self.frame.sensor.xy();
            let range = (off.x * off.x + off.y * off.y).sqrt() as f32;
            let (below, falls) = self.profile.rings[self.ground.ring_at(range.into())];
            self.cells.push(cell);
            self.ranges.push(range);
            self.above.push((below - falls * range - self.frame.params.band_min_m as f32) * self.bits_per_m);
        });
        let num = if with_end { self.cells.len() } else { self.cells.len().saturating_sub(1) };
        self.heights.clear();
        self.heights.resize(num, 0);
        pass(beams, that, &self.ranges[..num], &self.above[..num], self.bits_per_m, &mut self.heights);
        for (cell, heights) in self.cells.iter().zip(&self.heights) {
            let heights = Heights::of_bits(*heights);
            match that {
                That::Came | That::Ended(_) => update.mark(*cell, Mark::Free(heights)),
                That::WentOn if heights != Heights::NONE => update.mark(*cell, Mark::Over(heights)),
                That::WentOn => {}
            }
        }
    }
}

/// Cells that are worked on together.
const CHUNK: usize = 16;
/// More than rounding errs by, in bits of heights.
const ROUNDED_BITS: f32 = 0.05;

/// The lowest six bits of the whole number below 0 to 63: a conversion would ask whether it fits.
#[inline(always)]
fn whole(v: f32) -> u64 {
    // From 2^23 on an `f32` holds whole numbers, in its last bits.
    u64::from(((v - 0.5) + (8_388_608.0 + 64.0)).to_bits() & 63)
}

/// Which beams of a column count in a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
enum That {
    /// All: nothing stood in their way so far.
    Came,
    /// Those that came so far, and ended before a range.
    Ended(f32),
    /// Those that went on.
    WentOn,
}

/// Half of what a beam is wide at a range, metres.
#[inline(always)]
fn half_width_m(range: f32) -> f32 {
    HALF_WIDTH_RAD * (range - LINE_M).max(0.0)
}

/// How far before its end a beam that falls may graze what it ended on, a table's top, metres: until it is [`GRAZES_M`] above. One
/// that hardly falls ends on what stands upright.
#[inline(always)]
fn grazing_m(slope: f32) -> f32 {
    if slope < FALLS { GRAZES_M / -slope } else { f32::NEG_INFINITY }
}

by_processor! {
    [avx512]
    /// Adds the heights at which beams pass cells (one each of ranges, heights of the sensor over the band in bits, and what is added
    /// to).
    fn pass(
        beams: &[Beam],
        that: That,
        ranges: &[f32],
        above: &[f32],
        bits_per_m: f32,
        heights: &mut [u64],
    ) {
        let (ended_before, beyond) = match that {
            That::Came => (f32::INFINITY, f32::NEG_INFINITY),
            That::Ended(before) => (before, 0.0),
            That::WentOn => (f32::INFINITY, BEYOND_M),
        };
        for ((ranges, above), heights) in ranges.chunks(CHUNK).zip(above.chunks(CHUNK)).zip(heights.chunks_mut(CHUNK)) {
            let around = |of: &[f32]| of.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
            let ((nearest, farthest), (lowest, highest)) = (around(ranges), around(above));
            let aside = half_width_m(farthest) * bits_per_m + ROUNDED_BITS;
            for beam in beams {
                // Beams that pass below or above all of these cells' bands say nothing of them.
                let (a, b) = (beam.slope * bits_per_m * nearest, beam.slope * bits_per_m * farthest);
                let (low, high) = (lowest + a.min(b) - aside, highest + a.max(b) + aside);
                if high < 0.0 || low > 64.0 || beam.range > ended_before {
                    continue;
                }
                let reach = beam.range - beyond.max(grazing_m(beam.slope));
                for ((range, above), heights) in ranges.iter().zip(above).zip(heights.iter_mut()) {
                    let bit = above + beam.slope * bits_per_m * range;
                    let width = half_width_m(*range) * bits_per_m;
                    let (low, high) = (bit - width, bit + width);
                    let is_in = (high >= 0.0) & (low < 64.0) & (*range <= reach);
                    let low = if low > 0.0 { low } else { 0.0 };
                    let high = if high < 63.5 { high } else { 63.5 };
                    // What is out of the band counts nowhere, whatever its bits.
                    let (low, high) = (whole(low), whole(high));
                    let bits = (u64::MAX >> (63 - (high.wrapping_sub(low) & 63))) << low;
                    *heights |= if is_in { bits } else { 0 };
                }
            }
        }
    }
}

impl<'a> Columns<'a> {
    pub(super) fn new(frame: &'a Frame<'a>, ground: &'a Ground) -> Self {
        // As many columns as cells on the circle of the largest range, so that no cell is skipped.
        let count = (TAU * frame.params.range_max() / frame.geometry.resolution_m).ceil().max(360.0) as usize;
        Self { frame, ground, columns: vec![Column::EMPTY; count] }
    }

    /// Marks what hits and misses (map frame) say.
    pub(super) fn mark(mut self, update: &mut ScanUpdate, hits: &[Point3<f64>], misses: &[Point3<f64>]) {
        let ground = self.ground;
        hits.iter().zip(ground.places()).for_each(|(p, place)| self.read_return(update, p, place));
        for p in misses {
            let azimuth = Place::of(&self.frame.sensor, p).azimuth;
            self.read_free(p, azimuth.into(), self.frame.sensor.z - self.frame.floor_z);
        }
        let (step, sensor, frame) = (TAU / self.columns.len() as f64, self.frame.sensor.xy(), self.frame);
        let mut passing = Passing::new(frame, ground);
        for (i, mut column) in std::mem::take(&mut self.columns).into_iter().enumerate() {
            let beams = column.settle();
            passing.turn_to((i as f64 + 0.5) * step - PI);
            let first = column.ends.iter().position(|e| e.is_obstacle);
            match first {
                Some(first) => {
                    let end = &column.ends[first].at;
                    passing.free(update, &beams, (&sensor, end), false, That::Came);
                }
                None if column.farthest_free > 0.0 => {
                    let share = (frame.params.range_max() / column.farthest_free).min(1.0);
                    let end = sensor + (column.free - sensor) * share;
                    passing.free(update, &beams, (&sensor, &end), true, That::Came);
                }
                None => {}
            }
            if let Some(first) = first {
                let reach =
                    beams.iter().map(|beam| f64::from(beam.range)).fold(0.0, f64::max).min(frame.params.range_max());
                let obstacle = &column.ends[first];
                if reach > obstacle.range + f64::from(BEYOND_M) {
                    let end = sensor + (obstacle.at - sensor) * (reach / obstacle.range);
                    passing.free(update, &beams, (&obstacle.at, &end), true, That::WentOn);
                }
            }
            // Behind an obstacle, between ground and ground that were seen over it, by the beams that ended there: those that went on
            // graze what stands in between.
            for pair in column.ends[first.unwrap_or(column.ends.len())..].windows(2) {
                if !pair[0].is_obstacle && !pair[1].is_obstacle {
                    let ends = (&pair[0].at, &pair[1].at);
                    passing.free(update, &beams, ends, true, That::Ended((pair[1].range + END_M) as f32));
                }
            }
        }
    }

    fn read_return(&mut self, update: &mut ScanUpdate, p: &Point3<f64>, place: &Place) {
        let (params, sensor) = (self.frame.params, self.frame.sensor);
        let (range, azimuth) = (f64::from(place.range), f64::from(place.azimuth));
        if !(range >= params.range_min_m && range > 0.0 && range.is_finite()) {
            return;
        }
        let ground = *self.ground.under(place).unwrap_or_else(|| self.ground.at(azimuth, range));
        let height = p.z - ground.z_at(range);
        self.column(azimuth).include((p.z - sensor.z) / range, range);
        if range > params.range_max() {
            return self.read_free(p, azimuth, height);
        }
        if ground.is_drop {
            return self.drop_before(update, p, azimuth, &ground);
        }
        if height > params.band_max_m {
            return;
        }
        if height < params.band_min_m {
            let at = Point2::from(p.coords.xy());
            if ground.is_seen {
                self.column(azimuth).ends.push(End { range, at, is_obstacle: false });
            }
            return self.read_free(p, azimuth, height);
        }
        if height < params.band_min_m + ground.doubt {
            return;
        }
        let width = f64::from(half_width_m(range as f32));
        self.frame.hit_at(update, &p.xy(), Heights::between(params, height - width, height + width));
        self.column(azimuth).ends.push(End { range, at: p.xy(), is_obstacle: true });
    }

    /// A beam that met nothing in the band on its way to `end`, so high above the ground: free as far as it is over the floor
    /// and below the band's top.
    fn read_free(&mut self, end: &Point3<f64>, azimuth: f64, height: f64) {
        let (params, sensor) = (self.frame.params, self.frame.sensor);
        let (h0, h1) = (sensor.z - self.frame.floor_z, height);
        let slope = (end.z - sensor.z) / (end.xy() - sensor.xy()).norm();
        let (bottom, top) = (params.band_min_m - DROP_M, params.band_max_m);
        let share = match h1 {
            h if h > top => ((top - h0).max(0.0) / (h1 - h0)).max(0.0),
            h if h < bottom => ((h0 - bottom).max(0.0) / (h0 - h1)).max(0.0),
            _ => 1.0,
        };
        let end = sensor.xy() + (end.xy() - sensor.xy()) * share;
        let range = (end - sensor.xy()).norm();
        if !(range.is_finite() && range > 0.0) {
            return;
        }
        let column = self.column(azimuth);
        column.include(slope, range);
        if range > column.farthest_free {
            (column.farthest_free, column.free) = (range, end);
        }
    }

    /// A beam that went below the ground: where it did, there is none, and nobody can drive.
    fn drop_before(&mut self, update: &mut ScanUpdate, p: &Point3<f64>, azimuth: f64, ground: &Patch) {
        let sensor = self.frame.sensor;
        let range = (p.xy() - sensor.xy()).norm();
        let share = (sensor.z - ground.z_at(range)) / (sensor.z - p.z);
        if !(0.0..=1.0).contains(&share) {
            return;
        }
        let at = sensor.xy() + (p.xy() - sensor.xy()) * share;
        self.frame.hit_at(update, &at, Heights::at(self.frame.params, self.frame.params.band_min_m));
        self.column(azimuth).ends.push(End { range: range * share, at, is_obstacle: true });
    }

    fn column(&mut self, azimuth: f64) -> &mut Column {
        let last = self.columns.len() - 1;
        &mut self.columns[(((azimuth + PI) / TAU * (last + 1) as f64) as usize).min(last)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_pass_at_the_heights_that_they_are_wide() {
        let (bits_per_m, ended_before) = (64.0 / 1.7, 12.0);
        let ranges: Vec<f32> = (0..150).map(|i| 0.05 + 0.1 * i as f32).collect();
        let above: Vec<f32> = ranges.iter().map(|r| 60.0 + 3.0 * r.sin()).collect();
        let beams: Vec<Beam> =
            (-40..20).map(|i| Beam { slope: 0.011 * i as f32, range: 20.0 + 0.3 * i as f32 }).collect();
        for that in [That::Came, That::Ended(ended_before), That::WentOn] {
            let mut heights = vec![0; ranges.len()];
            pass(&beams, that, &ranges, &above, bits_per_m, &mut heights);
            for ((range, above), heights) in ranges.iter().zip(&above).zip(&heights) {
                let counts = |beam: &&Beam| match that {
                    That::Came => *range <= beam.range - grazing_m(beam.slope),
                    That::Ended(before) => {
                        *range <= beam.range - grazing_m(beam.slope).max(0.0) && beam.range <= before
                    }
                    That::WentOn => *range <= beam.range - grazing_m(beam.slope).max(BEYOND_M),
                };
                let (mut least, mut most) = (0u64, 0u64);
                for beam in beams.iter().filter(counts) {
                    let bit = above + beam.slope * bits_per_m * range;
                    let width = half_width_m(*range) * bits_per_m;
                    for k in 0..64u32 {
                        let (from, to, off) = (k as f32, k as f32 + 1.0, 0.01);
                        least |= u64::from(bit + width >= from + off && bit - width <= to - off) << k;
                        most |= u64::from(bit + width >= from - off && bit - width <= to + off) << k;
                    }
                }
                assert!(
                    least & !heights == 0 && heights & !most == 0,
                    "{that:?} {range}: {heights:x} {least:x} {most:x}"
                );
            }
        }
    }
}
