//! What the newest scan says of boxes in the map: its beams, by direction, asked which of them pass through a box and which end in it.

use nalgebra::{Point3, Vector3};
use percept_geometry::{KeyframeScan, OrientedBox3, Pose};
use percept_mapping::CloudMap;
use percept_scene::Visibility;

/// Bins of 2 degrees: what lidars with few rings have them apart.
const COLUMNS: usize = 180;
const ROWS: usize = 90;
/// A beam has to go on for so long in a box, or end behind it by what is left of that, to have found it empty, metres: more than poses
/// and ranges are off by.
const MARGIN_M: f64 = 0.1;
/// Share of a box's sample points that must be seen through, or seen at all.
const SHARE: f64 = 0.6;
/// Beams that end in a box that is seen through are at most this share of those that say anything: of a table that stands most
/// may pass under its top.
const MOST_HITS: f64 = 0.05;
/// A beam that passes this near tells of a point, metres; one that ends so near, twice that: lidars with few rings have beams 8 cm apart
/// at 2 m.
const BESIDE_M: f64 = 0.03;
/// Of a thing's points so many are looked at,
const MOST_POINTS: usize = 100;
/// and this share of them at least has to be seen through.
const SHARE_OF_POINTS: f64 = 0.25;
/// What lies so near to a side of a box may be the wall that the thing stands at, metres: three deviations of a lidar's noise.
const AT_WALL_M: f64 = 0.04;
/// A thing of which the map has fewer points is none of its own.
const FEW_POINTS: usize = 10;
/// The inner part of a box, by edges: things do not fill theirs.
const INNER: f64 = 0.6;

/// The beams of a scan, by direction.
pub(crate) struct Beams {
    t_base_sensor: Pose,
    /// Sensor frame, metres, ascending by bin.
    ends: Vec<Vector3<f32>>,
    /// Where the beams of each bin begin among them, `ROWS x COLUMNS` and the end.
    starts: Vec<u32>,
}

/// Beams that pass the inner part of a box, in one direction: how many found it empty, and how many something in it, or before it and at
/// its face.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    through: u32,
    at: u32,
}

impl Beams {
    pub(crate) fn new(scan: &KeyframeScan) -> Self {
        let t_sensor_base = scan.t_base_sensor.inverse();
        let mut placed: Vec<(u32, Vector3<f32>)> = Vec::with_capacity(scan.hits.len() + scan.misses.len());
        for p in scan.hits.positions.iter().chain(&scan.misses) {
            let end = (t_sensor_base * p.cast::<f64>()).coords;
            placed.extend(bin(&end).map(|(row, column)| ((row * COLUMNS + column) as u32, end.cast())));
        }
        // Stable, so that the order is the scan's.
        placed.sort_by_key(|(bin, _)| *bin);
        let starts = (0..=(ROWS * COLUMNS) as u32).map(|bin| placed.partition_point(|p| p.0 < bin) as u32).collect();
        Self { t_base_sensor: scan.t_base_sensor, ends: placed.into_iter().map(|p| p.1).collect(), starts }
    }

    /// Whether a robot at `t_map_base` saw that nothing is left of what the map has in a box: beams go by its points and end well behind,
    /// and next to none ends at one. Under the top of a table they pass, too, but by few of its points.
    pub(crate) fn finds_empty(&self, t_map_base: &Pose, bbox: &OrientedBox3, points: &[Point3<f32>]) -> bool {
        // The floor is there whatever stands on it.
        let is_above = |p: &Point3<f64>| above_bottom(bbox.t_frame_box.inverse_transform_point(p).z, bbox.size.z);
        let is_of_it = |p: &&Point3<f32>| bbox.contains(&p.cast()) && is_above(&p.cast());
        // Few are near: only these are turned into the box's frame.
        let (center, reach) = (bbox.center().cast::<f32>(), 0.5 * bbox.size.norm() as f32);
        let near = points.iter().filter(|p| nalgebra::distance_squared(p, &center) <= reach * reach);
        let inside: Vec<&Point3<f32>> = near.filter(is_of_it).collect();
        let t_sensor_map = (t_map_base * self.t_base_sensor).inverse();
        let step = inside.len().div_ceil(MOST_POINTS).max(1);
        let (mut num, mut through, mut hits) = (0, 0, 0);
        for p in inside.into_iter().step_by(step) {
            num += 1;
            match self.looks_at(&(t_sensor_map * p.cast::<f64>()).coords) {
                Some(true) => through += 1,
                Some(false) => hits += 1,
                None => {}
            }
        }
        f64::from(through) >= SHARE_OF_POINTS * f64::from(num.max(1))
            && f64::from(hits) <= MOST_HITS * f64::from(hits + through)
    }

    /// Whether a thing that stood in a box, and through whose middle a robot at `t_map_base` sees, is gone: the map holds nothing of it
    /// any more, or nothing of that is left. The front of a shelf is open, and beams end at its back, under a chair they pass:
    /// by the box alone both are seen through.
    pub(crate) fn has_gone(&self, t_map_base: &Pose, bbox: &OrientedBox3, cloud: &CloudMap) -> bool {
        let off = |size: f64| size - 2.0 * AT_WALL_M.min(0.2 * size);
        let size = Vector3::new(off(bbox.size.x), off(bbox.size.y), bbox.size.z);
        let inner = OrientedBox3 { size, ..*bbox };
        let known = cloud.points_within(&inner.center(), 0.5 * size.norm()).positions;
        let is_of_it = |p: &&Point3<f32>| {
            let p = inner.t_frame_box.inverse_transform_point(&p.cast());
            p.coords.iter().zip(&size).all(|(at, size)| at.abs() <= 0.5 * size) && above_bottom(p.z, size.z)
        };
        known.iter().filter(is_of_it).take(FEW_POINTS).count() < FEW_POINTS
            || self.finds_empty(t_map_base, &inner, &known)
    }

    /// What the beams say of a point, sensor frame: that they go on behind it (true), that one ends there (false), or nothing.
    fn looks_at(&self, point: &Vector3<f64>) -> Option<bool> {
        let (range, (row, column)) = (point.norm(), bin(point)?);
        let mut goes_on = false;
        for row in row.saturating_sub(1)..=(row + 1).min(ROWS - 1) {
            for column in [column + COLUMNS - 1, column, column + 1].map(|c| c % COLUMNS) {
                let at = row * COLUMNS + column;
                for end in &self.ends[self.starts[at] as usize..self.starts[at + 1] as usize] {
                    let end = end.cast::<f64>();
                    let length = end.norm();
                    let aside = end.cross(point).norm() / length;
                    if (length - range).abs() < MARGIN_M && aside <= 2.0 * BESIDE_M {
                        return Some(false);
                    }
                    goes_on |= aside <= BESIDE_M && length >= range + MARGIN_M;
                }
            }
        }
        goes_on.then_some(true)
    }

    /// What a robot at `t_map_base` saw of a box in the map.
    pub(crate) fn visibility(&self, t_map_base: &Pose, bbox: &OrientedBox3) -> Visibility {
        let t_box_sensor = bbox.t_frame_box.inverse() * (t_map_base * self.t_base_sensor);
        let lattice = |edge: f64| lattice(&t_box_sensor.inverse(), &(edge * bbox.size));
        let samples = lattice(INNER);
        let looked = Looked::at(samples.iter().chain(&lattice(1.0)));
        let (mut tallies, mut through, mut hits) = (vec![Tally::default(); looked.num()], 0u32, 0u32);
        for (slot, (row, column)) in looked.bins().enumerate() {
            let at = row * COLUMNS + column;
            for end in &self.ends[self.starts[at] as usize..self.starts[at + 1] as usize] {
                let end = Point3::from(end.cast::<f64>());
                let (from, to) = (Point3::from(t_box_sensor.translation.vector), t_box_sensor * end);
                hits += u32::from(ends_in(&to, &bbox.size));
                let tally = &mut tallies[slot];
                match passes(&from, &to, &bbox.size) {
                    Some(true) => (tally.through, through) = (tally.through + 1, through + 1),
                    Some(false) => tally.at += 1,
                    None => {}
                }
            }
        }
        let (mut seen_through, mut seen) = (0, 0);
        for bin in samples.iter().filter_map(bin) {
            let around = looked.around(bin).fold(Tally::default(), |sum, slot| Tally {
                through: sum.through + tallies[slot].through,
                at: sum.at + tallies[slot].at,
            });
            seen_through += usize::from(around.through > around.at);
            seen += usize::from(around.through + around.at > 0);
        }
        let share = |num: usize| num as f64 / samples.len() as f64;
        if share(seen_through) >= SHARE && f64::from(hits) <= MOST_HITS * f64::from(hits + through) {
            Visibility::SeenThrough
        } else if share(seen) >= SHARE {
            Visibility::Occupied
        } else {
            Visibility::Unseen
        }
    }
}

/// The bins in which a box lies: a rectangle of rows and columns, which may go around the back.
struct Looked {
    rows: (usize, usize),
    first_column: usize,
    num_columns: usize,
}

impl Looked {
    fn at<'a>(points: impl Iterator<Item = &'a Vector3<f64>>) -> Self {
        let bins: Vec<(usize, usize)> = points.filter_map(bin).collect();
        if bins.is_empty() {
            return Self { rows: (0, 0), first_column: 0, num_columns: 0 };
        }
        let row = |of: fn(usize, usize) -> usize, start| bins.iter().map(|b| b.0).fold(start, of);
        let rows = (row(usize::min, ROWS - 1).saturating_sub(1), (row(usize::max, 0) + 1).min(ROWS - 1));
        // The columns left when the widest gap between two is taken away.
        let mut columns: Vec<usize> = bins.iter().map(|b| b.1).collect();
        columns.sort_unstable();
        columns.dedup();
        let next = |i: usize| columns[(i + 1) % columns.len()];
        let gap = |i: usize| (next(i) + COLUMNS - columns[i] - 1) % COLUMNS;
        let Some(widest) = (0..columns.len()).max_by_key(|i| gap(*i)) else {
            return Self { rows, first_column: 0, num_columns: 0 };
        };
        let num_columns = (COLUMNS - gap(widest) + 2).min(COLUMNS);
        Self { rows, first_column: (next(widest) + COLUMNS - 1) % COLUMNS, num_columns }
    }

    fn num(&self) -> usize {
        (self.rows.1 - self.rows.0 + 1) * self.num_columns
    }

    fn bins(&self) -> impl Iterator<Item = (usize, usize)> {
        let columns = move |row| (0..self.num_columns).map(move |k| (row, (self.first_column + k) % COLUMNS));
        (self.rows.0..=self.rows.1).flat_map(columns)
    }

    /// The places of a bin and those beside it: beams of few rings leave bins between them.
    fn around(&self, (row, column): (usize, usize)) -> impl Iterator<Item = usize> {
        let rows = row.saturating_sub(1)..=(row + 1).min(ROWS - 1);
        let slot = move |row: usize, aside: usize| {
            let k = (column + COLUMNS + aside - 1 - self.first_column) % COLUMNS;
            let is_inside = (self.rows.0..=self.rows.1).contains(&row) && k < self.num_columns;
            is_inside.then(|| (row - self.rows.0) * self.num_columns + k)
        };
        rows.flat_map(move |row| (0..3).filter_map(move |aside| slot(row, aside)))
    }
}

/// Whether a beam found the inner part of a box empty (true), or ended in it, or before it and at the box; none if it says nothing of
/// it. In the box's frame.
fn passes(from: &Point3<f64>, to: &Point3<f64>, size: &Vector3<f64>) -> Option<bool> {
    let beam = to - from;
    let length = beam.norm();
    let (enters, leaves) = crossing(from, &beam, &(INNER * size))?;
    if length >= leaves.max(enters + MARGIN_M) {
        return Some(true);
    }
    let (reaches, _) = crossing(from, &beam, size)?;
    (length >= reaches - MARGIN_M).then_some(false)
}

/// Where a beam enters and leaves a box around the origin, metres along it; it may end before. None if it passes by, or begins inside.
fn crossing(from: &Point3<f64>, beam: &Vector3<f64>, size: &Vector3<f64>) -> Option<(f64, f64)> {
    let direction = beam.try_normalize(1e-9)?;
    let (mut enters, mut leaves) = (0.0, f64::INFINITY);
    for axis in 0..3 {
        let (half, along) = (0.5 * size[axis], direction[axis]);
        if along.abs() < 1e-12 {
            if from[axis].abs() > half {
                return None;
            }
            continue;
        }
        let (a, b) = ((-half - from[axis]) / along, (half - from[axis]) / along);
        enters = f64::max(enters, a.min(b));
        leaves = f64::min(leaves, a.max(b));
    }
    (enters > 0.0 && enters < leaves).then_some((enters, leaves))
}

/// Whether a beam's end lies in a box, its top with it, and not at what the box stands on or at.
fn ends_in(end: &Point3<f64>, size: &Vector3<f64>) -> bool {
    let aside = |axis: usize| end[axis].abs() <= 0.5 * size[axis] - MARGIN_M.min(0.2 * size[axis]);
    aside(0) && aside(1) && above_bottom(end.z, size.z) && end.z <= 0.5 * size.z + MARGIN_M
}

/// Whether a height in a box lies above what it stands on.
fn above_bottom(z: f64, height: f64) -> bool {
    z + 0.5 * height >= MARGIN_M.min(0.3 * height)
}

fn bin(end: &Vector3<f64>) -> Option<(usize, usize)> {
    use std::f64::consts::{PI, TAU};
    let range = end.norm();
    if !(1e-6..f64::INFINITY).contains(&range) {
        return None;
    }
    let column = ((end.y.atan2(end.x) + PI) / TAU * COLUMNS as f64) as usize % COLUMNS;
    let row = (((end.z / range).clamp(-1.0, 1.0).asin() + PI / 2.0) / PI * ROWS as f64) as usize;
    Some((row.min(ROWS - 1), column))
}

/// A 3 x 3 x 3 lattice in a box of this size, sensor frame.
fn lattice(t_sensor_box: &Pose, size: &Vector3<f64>) -> Vec<Vector3<f64>> {
    let at = |k: i32, size: f64| f64::from(k - 1) * 0.5 * size;
    let point = |i: i32| Point3::new(at(i % 3, size.x), at(i / 3 % 3, size.y), at(i / 9, size.z));
    (0..27).map(|i| (t_sensor_box * point(i)).coords).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::{PointCloud, SensorId, Timestamp, se3};
    use std::f64::consts::TAU;

    /// Smallest and largest corner.
    type Block = ([f64; 3], [f64; 3]);

    const CRATE: Block = ([1.0, -0.25, 0.0], [1.8, 0.25, 0.5]);
    const CABINET: Block = ([3.4, -0.5, 0.0], [4.0, 0.5, 1.6]);

    fn table(x: f64) -> Vec<Block> {
        let leg = |dx: f64, y: f64| ([x + dx, y, 0.0], [x + dx + 0.04, y + 0.04, 0.72]);
        let top = ([x, -0.4, 0.72], [x + 0.8, 0.4, 0.75]);
        vec![top, leg(0.0, -0.4), leg(0.76, -0.4), leg(0.0, 0.36), leg(0.76, 0.36)]
    }

    /// What a lidar of so many rings sees at a height in a room of 8 m by 6 m, with noise of 1 cm.
    fn scan(height: f64, rings: i32, blocks: &[Block]) -> KeyframeScan {
        let sensor = Point3::new(0.0, 0.0, height);
        let mut hits = Vec::new();
        for (ring, column) in (0..rings).flat_map(|ring| (0..720).map(move |column| (ring, column))) {
            let elevation = -0.6 + 0.95 * f64::from(ring) / f64::from(rings - 1);
            let azimuth = f64::from(column) * TAU / 720.0;
            let d = Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            let of = |(low, high): &Block| {
                let center = Point3::from(*low) + 0.5 * (Point3::from(*high) - Point3::from(*low));
                crossing(&Point3::from(sensor - center), &d, &(Point3::from(*high) - Point3::from(*low)))
            };
            let walls = [(4.0, d.x), (3.0, d.y), (if d.z > 0.0 { 2.5 - height } else { height }, d.z)];
            let far = walls.iter().map(|(half, d)| half / d.abs().max(1e-9)).fold(f64::INFINITY, f64::min);
            let range = blocks.iter().filter_map(|b| Some(of(b)?.0)).fold(far, f64::min);
            let noise = f64::from((ring * 7919 + column * 104_729) % 201 - 100) * 1e-4;
            hits.push((d * (range + noise)).cast::<f32>().into());
        }
        let mut t_base_sensor = Pose::identity();
        t_base_sensor.translation.vector.z = height;
        let hits = PointCloud::from_positions(hits).transformed(&t_base_sensor);
        KeyframeScan {
            stamp: Timestamp(0),
            sensor: SensorId::from("lidar"),
            t_base_sensor,
            base_height_m: 0.0,
            hits,
            misses: vec![],
            planar: false,
            features: None,
        }
    }

    fn around(block: &Block) -> OrientedBox3 {
        let (low, high) = (Point3::from(block.0), Point3::from(block.1));
        OrientedBox3::upright(low + 0.5 * (high - low), high - low, 0.0)
    }

    fn seen(height: f64, rings: i32, blocks: &[Block], of: &OrientedBox3) -> Visibility {
        Beams::new(&scan(height, rings, blocks)).visibility(&Pose::identity(), of)
    }

    #[test]
    fn what_was_taken_away_is_seen_through_also_between_rings_and_at_a_wall() {
        for (height, rings) in [(1.2, 24), (1.2, 64), (0.5, 24), (0.5, 64)] {
            for block in [CRATE, CABINET] {
                let place = around(&block);
                assert_eq!(seen(height, rings, &[], &place), Visibility::SeenThrough, "{height} {rings} {block:?}");
                assert_ne!(
                    seen(height, rings, &[block], &place),
                    Visibility::SeenThrough,
                    "{height} {rings} {block:?}"
                );
                // A box that has the thing a little off.
                let off = OrientedBox3 { t_frame_box: se3::from_xy_yaw(0.04, 0.03, 0.05) * place.t_frame_box, ..place };
                assert_ne!(seen(height, rings, &[block], &off), Visibility::SeenThrough, "{height} {rings} {block:?}");
            }
        }
    }

    #[test]
    fn a_table_stands_though_beams_pass_under_its_top() {
        for x in [0.9, 1.5, 2.3] {
            let place = around(&([x, -0.4, 0.0], [x + 0.8, 0.4, 0.75]));
            // What the map has of it.
            let known = |height: f64| scan(height, 200, &table(x)).hits.transformed(&Pose::identity()).positions;
            let known = [known(1.2), known(0.4)].concat();
            for (height, rings) in [(1.2, 24), (1.2, 64), (0.5, 24), (0.5, 64), (0.3, 24)] {
                let finds_empty = |blocks: &[Block]| {
                    let beams = Beams::new(&scan(height, rings, blocks));
                    beams.finds_empty(&Pose::identity(), &place, &known)
                };
                assert!(!finds_empty(&table(x)), "{x} {height} {rings}");
                assert!(finds_empty(&[]), "{x} {height} {rings}");
                assert_eq!(seen(height, rings, &[], &place), Visibility::SeenThrough, "{x} {height} {rings}");
            }
            assert_ne!(seen(1.2, 64, &table(x), &place), Visibility::SeenThrough, "{x}");
        }
    }

    #[test]
    fn nothing_is_left_of_what_was_taken_away() {
        for (height, rings) in [(1.2, 24), (1.2, 64), (0.5, 24), (0.5, 64)] {
            for block in [CRATE, CABINET] {
                let known = scan(1.0, 200, &[block]).hits.positions;
                let finds_empty = |blocks: &[Block]| {
                    Beams::new(&scan(height, rings, blocks)).finds_empty(&Pose::identity(), &around(&block), &known)
                };
                assert!(finds_empty(&[]) && !finds_empty(&[block]), "{height} {rings} {block:?}");
                // Nor where something stands before it.
                assert!(!finds_empty(&[([0.6, -2.0, 0.0], [0.7, 2.0, 2.0])]), "{height} {rings} {block:?}");
            }
        }
    }

    #[test]
    fn what_is_hidden_or_behind_is_not_seen() {
        let screen = ([0.6, -2.0, 0.0], [0.7, 2.0, 2.0]);
        assert_eq!(seen(1.2, 64, &[screen], &around(&CRATE)), Visibility::Unseen);
        assert_eq!(seen(1.2, 24, &[CRATE], &around(&CRATE)), Visibility::Occupied);
        let outside = around(&([6.0, -0.5, 0.0], [7.0, 0.5, 1.0]));
        assert_eq!(seen(1.2, 64, &[], &outside), Visibility::Unseen);
        // A place all around the sensor.
        let here = around(&([-0.5, -0.5, 0.0], [0.5, 0.5, 1.5]));
        assert_eq!(seen(1.2, 64, &[], &here), Visibility::Unseen);
    }
}
