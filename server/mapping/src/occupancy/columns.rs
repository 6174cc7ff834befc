//! What a scan in space says of the floor around: by columns of azimuth, over the ground.

use super::marks::{Frame, Heights, Mark, ScanUpdate};
use crate::ground::{Ground, Patch};
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
#[derive(Clone, Default)]
struct Column {
    /// Ground and obstacles, as they came.
    ends: Vec<End>,
    /// Where its beams are over the ground and in the band: so far, horizontally from the sensor, metres.
    farthest_free: f64,
    free: Point2<f64>,
    beams: Vec<Beam>,
}

/// How steep a beam is, rise over run, and how far it went, horizontally, metres.
#[derive(Clone, Copy)]
struct Beam {
    slope: f32,
    range: f32,
}

/// Where a beam ended, in the map.
#[derive(Clone, Copy)]
struct End {
    range: f64,
    at: Point2<f64>,
    is_obstacle: bool,
}

impl Column {
    fn include(&mut self, slope: f64, range: f64) {
        if slope.is_finite() {
            self.beams.push(Beam { slope: slope as f32, range: range as f32 });
        }
    }

    /// Puts the beams in order, rising, and of those that are much alike leaves one: 64 bins from 45 degrees down to 45 degrees up. It
    /// went as far as the shortest of them.
    fn settle(&mut self) {
        self.ends.sort_by(|a, b| a.range.total_cmp(&b.range));
        self.beams.sort_by(|a, b| a.slope.total_cmp(&b.slope));
        let bin = |beam: &Beam| ((beam.slope.clamp(-1.0, 1.0) + 1.0) * 31.99) as u8;
        self.beams.dedup_by(|beam, kept| {
            let is_alike = bin(beam) == bin(kept);
            if is_alike {
                kept.range = kept.range.min(beam.range);
            }
            is_alike
        });
    }
}

impl<'a> Columns<'a> {
    pub(super) fn new(frame: &'a Frame<'a>, ground: &'a Ground) -> Self {
        // As many columns as cells on the circle of the largest range, so that no cell is skipped.
        let count = (TAU * frame.params.range_max() / frame.geometry.resolution_m).ceil().max(360.0) as usize;
        Self { frame, ground, columns: vec![Column::default(); count] }
    }

    /// Marks what hits and misses (map frame) say.
    pub(super) fn mark(mut self, update: &mut ScanUpdate, hits: &[Point3<f64>], misses: &[Point3<f64>]) {
        hits.iter().for_each(|p| self.read_return(update, p));
        misses.iter().for_each(|p| self.read_free(p, self.frame.sensor.z - self.frame.floor_z));
        let step = TAU / self.columns.len() as f64;
        for (i, mut column) in std::mem::take(&mut self.columns).into_iter().enumerate() {
            column.settle();
            let azimuth = (i as f64 + 0.5) * step - PI;
            let hint = std::cell::Cell::new(0);
            let passed = |cell| self.passed(cell, azimuth, &column.beams, &hint, |_, _| true);
            let first = column.ends.iter().position(|e| e.is_obstacle);
            match first {
                Some(first) => self.frame.free_before(update, &column.ends[first].at, passed),
                None if column.farthest_free > 0.0 => {
                    self.frame.free_towards(update, &column.free, column.farthest_free, passed);
                }
                None => {}
            }
            // Behind an obstacle, between ground and ground that were seen over it, by the beams that ended there: those that went on
            // graze what stands in between.
            for pair in column.ends[first.unwrap_or(column.ends.len())..].windows(2) {
                if !pair[0].is_obstacle && !pair[1].is_obstacle {
                    let ended =
                        |beam: &Beam, range: f64| (range..=pair[1].range + END_M).contains(&f64::from(beam.range));
                    let passed = |cell| self.passed(cell, azimuth, &column.beams, &hint, ended);
                    self.frame.free_between(update, &pair[0].at, &pair[1].at, passed);
                }
            }
        }
    }

    fn read_return(&mut self, update: &mut ScanUpdate, p: &Point3<f64>) {
        let (params, sensor) = (self.frame.params, self.frame.sensor);
        let range = (p.xy() - sensor.xy()).norm();
        if !(range >= params.range_min_m && range > 0.0 && range.is_finite() && p.z.is_finite()) {
            return;
        }
        let azimuth = (p.y - sensor.y).atan2(p.x - sensor.x);
        let ground = *self.ground.at(azimuth, range);
        let height = p.z - ground.z_at(range);
        self.column(azimuth).include((p.z - sensor.z) / range, range);
        if range > params.range_max() {
            return self.read_free(p, height);
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
            return self.read_free(p, height);
        }
        if height < params.band_min_m + ground.doubt {
            return;
        }
        self.frame.hit_at(update, &p.xy(), Heights::at(params, height));
        self.column(azimuth).ends.push(End { range, at: p.xy(), is_obstacle: true });
    }

    /// A beam that met nothing in the band on its way to `end`, so high above the ground: free as far as it is over the floor
    /// and below the band's top.
    fn read_free(&mut self, end: &Point3<f64>, height: f64) {
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
        let column = self.column((end.y - sensor.y).atan2(end.x - sensor.x));
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

    /// What a column says of a free cell: the heights at which those of its beams (in order) pass there that count. `hint` is the
    /// first beam that did in the cell before.
    fn passed(
        &self,
        cell: Cell,
        azimuth: f64,
        beams: &[Beam],
        hint: &std::cell::Cell<usize>,
        counts: impl Fn(&Beam, f64) -> bool,
    ) -> Mark {
        let (params, center) = (self.frame.params, self.frame.geometry.center(cell));
        let range = (center - self.frame.sensor.xy()).norm();
        let above = self.frame.sensor.z - self.ground.at(azimuth, range).z_at(range);
        // Most beams pass far from the band; where the first of those in it is changes little from cell to cell.
        let lowest = ((params.band_min_m - above) / range) as f32;
        let mut first = hint.get();
        while beams.get(first).is_some_and(|beam| beam.slope < lowest) {
            first += 1;
        }
        while first > 0 && beams[first - 1].slope >= lowest {
            first -= 1;
        }
        hint.set(first);
        let mut heights = Heights::NONE;
        for beam in &beams[first..] {
            let height = above + f64::from(beam.slope) * range;
            if height >= params.band_max_m {
                break;
            }
            if counts(beam, range) {
                heights = heights.joined(Heights::at(params, height));
            }
        }
        Mark::Free(heights)
    }
}
