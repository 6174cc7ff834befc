//! What a scan in space says of the floor around: by columns of azimuth, over the ground.

use super::marks::{Frame, Heights, Mark, ScanUpdate};
use crate::ground::{Ground, Patch, Place, sector_of};
use nalgebra::{Point2, Point3};
use percept_geometry::Cell;
use std::f64::consts::{PI, TAU};

/// A beam that goes deeper than this below the band's bottom looks down a drop (stairs, a pit), metres.
const DROP_M: f64 = 0.2;
/// Beams end together if they do within this, metres.
const END_M: f64 = 0.05;

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
    /// Of beams that are much alike one: 64 bins from 45 degrees down to 45 degrees up. It went as far as the shortest of them.
    beams: [Beam; NUM_BEAMS],
}

const NUM_BEAMS: usize = 64;

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
            let kept = &mut self.beams[((slope.clamp(-1.0, 1.0) + 1.0) * 31.99) as usize];
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

/// What a column says of free cells.
struct Passing<'a> {
    frame: &'a Frame<'a>,
    ground: &'a Ground,
    profile: &'a Profile,
    /// In order.
    beams: &'a [Beam],
    /// The first beam that was not below the band in the cell before.
    first: std::cell::Cell<usize>,
    /// From height over the band's bottom to bits.
    bits_per_m: f32,
}

/// From here to twice this an `f32` holds whole numbers.
const WHOLE: f32 = (1 << 23) as f32;

impl Passing<'_> {
    /// The heights at which those of the beams pass a cell that count.
    fn mark(&self, cell: Cell, counts: impl Fn(&Beam, f32) -> bool) -> Mark {
        let off = self.frame.geometry.center(cell) - self.frame.sensor.xy();
        let range = (off.x * off.x + off.y * off.y).sqrt() as f32;
        let (below, falls) = self.profile.rings[self.ground.ring_at(range.into())];
        // Where the sensor is, from the bottom of the band.
        let above = below - falls * range - self.frame.params.band_min_m as f32;
        // Most beams pass far from the band; where the first of those in it is changes little from cell to cell.
        let is_below = |beam: &Beam| above + beam.slope * range < 0.0;
        let mut first = self.first.get();
        while self.beams.get(first).is_some_and(is_below) {
            first += 1;
        }
        while first > 0 && !is_below(&self.beams[first - 1]) {
            first -= 1;
        }
        self.first.set(first);
        let (above, per_slope) = (above * self.bits_per_m, range * self.bits_per_m);
        let mut heights = 0u64;
        for beam in &self.beams[first..] {
            let bit = above + beam.slope * per_slope;
            if bit >= 64.0 {
                break;
            }
            // The whole part is in the lowest bits then: a conversion would ask whether it fits.
            let whole = (bit.max(0.0) + (WHOLE - 0.5)).to_bits() & 63;
            heights |= u64::from(counts(beam, range)) << whole;
        }
        Mark::Free(Heights::of_bits(heights))
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
        let (step, frame) = (TAU / self.columns.len() as f64, self.frame);
        let bits_per_m = 64.0 / (frame.params.band_max_m - frame.params.band_min_m) as f32;
        let mut profile = Profile { sector: usize::MAX, rings: vec![] };
        for (i, mut column) in std::mem::take(&mut self.columns).into_iter().enumerate() {
            let beams = column.settle();
            let sector = sector_of((i as f64 + 0.5) * step - PI);
            if sector != profile.sector {
                profile.sector = sector;
                profile.rings.clear();
                let seen_from = |patch: &Patch| ((frame.sensor.z - patch.z_at(0.0)) as f32, patch.slope as f32);
                profile.rings.extend(ground.along(sector).map(seen_from));
            }
            let (profile, beams, first) = (&profile, &beams[..], std::cell::Cell::new(0));
            let passing = Passing { frame, ground, profile, beams, first, bits_per_m };
            let passed = |cell| passing.mark(cell, |_, _| true);
            let first = column.ends.iter().position(|e| e.is_obstacle);
            match first {
                Some(first) => frame.free_before(update, &column.ends[first].at, passed),
                None if column.farthest_free > 0.0 => {
                    frame.free_towards(update, &column.free, column.farthest_free, passed);
                }
                None => {}
            }
            // Behind an obstacle, between ground and ground that were seen over it, by the beams that ended there: those that went on
            // graze what stands in between.
            for pair in column.ends[first.unwrap_or(column.ends.len())..].windows(2) {
                if !pair[0].is_obstacle && !pair[1].is_obstacle {
                    let last = (pair[1].range + END_M) as f32;
                    let ended = |beam: &Beam, range: f32| range <= beam.range && beam.range <= last;
                    frame.free_between(update, &pair[0].at, &pair[1].at, |cell| passing.mark(cell, ended));
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
        self.frame.hit_at(update, &p.xy(), Heights::at(params, height));
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
