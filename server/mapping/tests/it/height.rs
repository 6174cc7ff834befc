//! Heights and traversability of ground that is written down, seen with noise.

use crate::ground::seen;
use crate::scans::planar;
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{Cell, Correction, KeyframeId, KeyframeScan, Pose, se3};
use percept_mapping::{
    Damaged, DenseHeights, HeightGrid, HeightParams, Layer, Map, MapEntry, MapParams, MappingError, Reader, Storey,
    Traversability,
};
use proptest::prelude::*;
use std::sync::Arc;

/// Of ranges, metres.
const SIGMA: f64 = 0.015;
const MOST: usize = 1 << 20;

fn params() -> MapParams {
    MapParams { height: HeightParams { enabled: true, ..Default::default() }, ..Default::default() }
}

/// Nearly normal numbers, always the same.
struct Noise(u32);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(self.0 >> 8) / f64::from(1u32 << 24) - 0.5
    }

    fn next(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum()
    }
}

/// The scan with noise along its beams.
fn noisy(mut scan: KeyframeScan, seed: u32) -> KeyframeScan {
    let sensor = Point3::from(scan.t_base_sensor.translation.vector).cast::<f32>();
    let mut noise = Noise(seed);
    for p in &mut scan.hits.positions {
        let d = *p - sensor;
        *p += d.normalize() * (SIGMA * noise.next()) as f32;
    }
    scan
}

/// Looks at a surface from places along x, by a sensor so high above it.
fn looks(from: &[f64], height: f64, surface: impl Fn(f64, f64) -> f64) -> Vec<(Pose, Arc<KeyframeScan>)> {
    let look = |(i, x): (usize, &f64)| {
        let (pose, scan) = seen(*x, height, &surface);
        (pose, Arc::new(noisy(scan, 77 + i as u32)))
    };
    from.iter().enumerate().map(look).collect()
}

fn add(map: &mut Map, looks: &[(Pose, Arc<KeyframeScan>)], after_gap: bool) {
    let first = map.keyframes().len() as u64;
    for (i, (pose, scan)) in looks.iter().enumerate() {
        let entry = MapEntry { after_gap: after_gap && i == 0, ..MapEntry::at(*pose) };
        map.insert(KeyframeId(first + i as u64), &entry, Arc::clone(scan)).unwrap();
    }
}

fn mapped(looks: &[(Pose, Arc<KeyframeScan>)]) -> Map {
    let mut map = Map::new(params()).unwrap();
    add(&mut map, looks, false);
    map
}

fn all(map: &Map) -> DenseHeights {
    map.layers().height.dense(Storey::Highest, MOST).unwrap()
}

fn drivable(map: &Map) -> Traversability {
    let heights = map.layers().height;
    let (min, max) = heights.bounds().unwrap();
    heights.traversability(min, max, Storey::Highest, MOST).unwrap()
}

/// Centres within a rectangle, and what a map says there.
fn values<'a, T: Copy>(
    of: (&'a percept_geometry::GridGeometry, usize, &'a [T]),
    x: (f64, f64),
    y: (f64, f64),
) -> impl Iterator<Item = (Point2<f64>, T)> + 'a {
    let (geometry, width, values) = of;
    let at = move |i: usize| geometry.center(Cell::new((i % width) as i32, (i / width) as i32));
    let within = move |p: &Point2<f64>| (x.0..x.1).contains(&p.x) && (y.0..y.1).contains(&p.y);
    values.iter().enumerate().map(move |(i, v)| (at(i), *v)).filter(move |(p, _)| within(p))
}

/// Mean and largest error of the ground against a surface; cells of which it is known, and of which it is not.
fn errors(
    heights: &DenseHeights,
    surface: impl Fn(f64, f64) -> f64,
    x: (f64, f64),
    y: (f64, f64),
) -> (f64, f64, usize, usize) {
    let of = (&heights.geometry, heights.width, &heights.ground_m[..]);
    let (mut sum, mut most, mut num, mut unknown) = (0.0, 0.0f64, 0, 0);
    for (p, z) in values(of, x, y) {
        if z.is_nan() {
            unknown += 1;
            continue;
        }
        let off = f64::from(z) - surface(p.x, p.y);
        (sum, most, num) = (sum + off, most.max(off.abs()), num + 1);
    }
    (sum / num as f64, most, num, unknown)
}

fn mean(values: impl Iterator<Item = f32>) -> f64 {
    let known: Vec<f64> = values.filter(|v| !v.is_nan()).map(f64::from).collect();
    known.iter().sum::<f64>() / known.len() as f64
}

/// Share of the known cells that can be driven, and how many are known.
fn share(drivable: &Traversability, x: (f64, f64), y: (f64, f64)) -> (f64, usize) {
    let of = (&drivable.geometry, drivable.width, &drivable.traversability[..]);
    let known: Vec<f32> = values(of, x, y).map(|(_, t)| t).filter(|t| !t.is_nan()).collect();
    (known.iter().filter(|t| **t > 0.0).count() as f64 / known.len() as f64, known.len())
}

#[test]
fn a_ramp_is_as_high_and_as_steep_as_it_is() {
    let ramp = |x: f64, _: f64| 0.1 * (x - 4.0).clamp(0.0, 8.0);
    let map = mapped(&looks(&[0.0, 2.5, 5.0, 7.5, 10.0], 1.2, ramp));
    let (off, most, num, unknown) = errors(&all(&map), ramp, (0.0, 11.5), (-2.5, 2.5));
    assert!(off.abs() < 0.02 && most < 0.08 && num > 10 * unknown, "{off} {most} {num} {unknown}");
    let drivable = drivable(&map);
    let slopes = || values((&drivable.geometry, drivable.width, &drivable.slope_rad[..]), (4.5, 11.5), (-1.5, 1.5));
    let slope = mean(slopes().map(|(_, s)| s));
    assert!((slope - 0.1f64.atan()).abs() < 1f64.to_radians(), "{}", slope.to_degrees());
    let (share, num) = share(&drivable, (0.5, 11.5), (-1.5, 1.5));
    assert!(share > 0.98 && num > 2000, "{share} of {num}");
}

#[test]
fn a_kerb_is_a_step_where_it_is_and_nowhere_else() {
    let kerb = |_: f64, y: f64| if y > 3.0 { 0.12 } else { 0.0 };
    let map = mapped(&looks(&[-1.0, 0.0, 1.0, 2.0], 1.7, kerb));
    let drivable = drivable(&map);
    let steps = (&drivable.geometry, drivable.width, &drivable.step_m[..]);
    let (x, mut near, mut num) = ((-1.0, 3.0), 0, 0);
    for (p, step) in values(steps, x, (0.5, 5.5)).filter(|(_, s)| !s.is_nan()) {
        let off = (p.y - 3.0).abs();
        if off < 0.15 {
            (near, num) = (near + usize::from((0.09..0.17).contains(&step)), num + 1);
        } else if off > 0.36 {
            assert!(step < 0.09, "{step} at {p}");
        }
    }
    assert!(num > 80 && 10 * near > 9 * num, "{near} of {num}");
    let blocked = share(&drivable, x, (2.9, 3.1));
    assert!(blocked.0 < 0.1, "{blocked:?}");
    assert!(share(&drivable, x, (0.5, 2.6)).0 == 1.0 && share(&drivable, x, (3.4, 5.0)).0 > 0.99);
    let heights = all(&map);
    let (off, _, num, unknown) = errors(&heights, kerb, x, (3.1, 5.0));
    assert!(off.abs() < 0.02 && num > 8 * unknown, "{off} {num} {unknown}");
    // As planners take it.
    let grid = drivable.to_grid();
    assert_eq!(grid.validate(), Ok(()));
    let cells = (&grid.geometry, grid.width, &grid.cells[..]);
    assert!(values(cells, x, (2.9, 3.1)).filter(|(_, v)| *v == 100).count() > 50);
    assert!(values(cells, x, (0.5, 2.6)).all(|(_, v)| v <= 50));
}

#[test]
fn stairs_up_and_down_and_a_pit_are_not_driven() {
    let up = |x: f64, _: f64| if x > 3.0 { 0.17 * ((x - 3.0) / 0.28).ceil().min(8.0) } else { 0.0 };
    let down = |x: f64, _: f64| if x > 2.0 { -0.17 * ((x - 2.0) / 0.28).ceil() } else { 0.0 };
    let pit = |x: f64, y: f64| if (1.6..4.0).contains(&x) && y.abs() < 1.0 { -1.0 } else { 0.0 };
    for (name, map, edge) in [
        ("up", mapped(&looks(&[0.0, 0.5, 1.0], 1.2, up)), 3.0),
        ("down", mapped(&looks(&[0.0, 0.5, 1.0], 1.2, down)), 2.0),
        ("pit", mapped(&looks(&[-1.0, -0.5, 0.0, 0.4], 1.2, pit)), 1.6),
    ] {
        let drivable = drivable(&map);
        let of = (&drivable.geometry, drivable.width, &drivable.traversability[..]);
        // Whoever goes along x is stopped.
        for row in (-6..6).map(|i| f64::from(i) * 0.1) {
            let stops = values(of, (edge - 0.35, edge + 0.75), (row, row + 0.1)).any(|(_, t)| t == 0.0);
            assert!(stops, "{name}: the edge at y {row}");
        }
        let before = share(&drivable, (0.4, edge - 0.4), (-0.7, 0.7));
        assert!(before.0 == 1.0 && before.1 > 30, "{name}: {before:?}");
    }
    let map = mapped(&looks(&[0.0, 0.4], 1.2, pit));
    let heights = all(&map);
    let drops = values((&heights.geometry, heights.width, &heights.is_drop[..]), (1.5, 2.6), (-0.9, 0.9));
    assert!(drops.filter(|(_, d)| *d).count() > 50);
    let bottom = errors(&heights, |_, _| -1.0, (3.2, 3.9), (-0.5, 0.5));
    assert!(bottom.0.abs() < 0.03 && bottom.2 > 20, "{bottom:?}");
    let beside = values((&heights.geometry, heights.width, &heights.is_drop[..]), (0.2, 1.4), (-2.0, 2.0));
    assert_eq!(beside.filter(|(_, d)| *d).count(), 0);
}

#[test]
fn gravel_is_rough_and_a_cambered_hill_is_smooth_and_both_are_as_high_as_they_are() {
    // Of a wavelength of 0.5 m in both directions: a root mean square of 0.03 m.
    let turn = std::f64::consts::TAU / 0.5;
    let gravel = |x: f64, y: f64| 0.06 * (turn * x).sin() * (turn * y).sin();
    let hill = |x: f64, y: f64| (x * 0.12).sin() - 0.03 * y.abs();
    let (rough, smooth) =
        (mapped(&looks(&[0.0, 1.0, 2.0, 3.0], 1.2, gravel)), mapped(&looks(&[0.0, 2.0, 4.0, 6.0], 1.7, hill)));
    let (x, y) = ((0.5, 3.5), (-1.5, 1.5));
    let off = errors(&all(&rough), gravel, x, y);
    assert!(off.0.abs() < 0.02 && off.2 > 20 * off.3, "{off:?}");
    let (rough, drivable) = (drivable(&rough), drivable(&smooth));
    let of = |t: &Traversability| mean(values((&t.geometry, t.width, &t.roughness_m[..]), x, y).map(|(_, v)| v));
    assert!((0.015..0.04).contains(&of(&rough)) && of(&drivable) < 0.012, "{} {}", of(&rough), of(&drivable));
    let off = errors(&all(&smooth), hill, (0.0, 8.0), (-3.0, 3.0));
    assert!(off.0.abs() < 0.02 && off.1 < 0.1 && off.2 > 20 * off.3, "{off:?}");
    let share = share(&drivable, (0.0, 8.0), (-2.5, 2.5));
    assert!(share.0 > 0.99 && share.1 > 2000, "{share:?}");
}

/// A box of 0.6 m by 0.6 m, 0.5 m high.
fn with_box(x: f64, y: f64) -> f64 {
    if (2.0..2.6).contains(&x) && (-0.3..0.3).contains(&y) { 0.5 } else { 0.0 }
}

#[test]
fn a_box_that_is_taken_away_returns_to_ground_in_one_submap_and_across_two() {
    let from = [0.0, 0.5, 1.0];
    let (there, gone) = (looks(&from, 1.2, with_box), looks(&from, 1.2, |_, _| 0.0));
    for across in [false, true] {
        let mut map = mapped(&there);
        let before = all(&map);
        let tops = |h: &DenseHeights| {
            let of = (&h.geometry, h.width, &h.top_m[..]);
            values(of, (1.9, 2.7), (-0.4, 0.4)).filter(|(_, t)| !t.is_nan()).map(|(_, t)| t).collect::<Vec<f32>>()
        };
        let standing = tops(&before);
        assert!(standing.len() >= 20, "{}", standing.len());
        assert!(standing.iter().fold(0.0f32, |a, b| a.max(*b)) < 0.56);
        assert!(share(&drivable(&map), (2.1, 2.5), (-0.2, 0.2)).0 == 0.0);
        for i in 0..3 {
            add(&mut map, &gone, across && i == 0);
        }
        assert_eq!(map.submaps().len(), 1 + usize::from(across));
        let after = all(&map);
        assert!(tops(&after).is_empty(), "{across}: {:?}", tops(&after));
        let off = errors(&after, |_, _| 0.0, (1.9, 2.7), (-0.4, 0.4));
        assert!(off.1 < 0.06 && off.2 > 50, "{across}: {off:?}");
        assert_eq!(share(&drivable(&map), (1.9, 2.7), (-0.4, 0.4)).0, 1.0);
    }
}

#[test]
fn who_goes_by_leaves_nothing_and_who_stays_is_seen_the_second_time() {
    let (gone, there) = (looks(&[0.0, 0.5], 1.2, |_, _| 0.0), looks(&[0.0, 0.5], 1.2, with_box));
    let mut map = mapped(&gone);
    let stands = |map: &Map| all(map).top_m.iter().filter(|t| !t.is_nan()).count();
    add(&mut map, &there[..1], false);
    let first = stands(&map);
    add(&mut map, &there[1..], false);
    add(&mut map, &there[..1], false);
    assert!(first <= 2 && stands(&map) > 10, "{first} {}", stands(&map));
}

#[test]
fn what_stands_stays_while_the_ground_beside_and_under_it_is_seen() {
    // A table's top 0.7 m high, seen first; then only the ground under it. Its edges are those of blocks of cells: beams are known to
    // have passed by block.
    let table = |p: &Point3<f32>| (1.6..2.4).contains(&p.x) && p.y.abs() < 0.4;
    let (pose, flat) = seen(0.0, 1.2, |_, _| 0.0);
    let mut with = flat.clone();
    let mut tops = vec![];
    for i in 0..9 {
        for j in -4..5 {
            tops.push(Point3::new(1.64 + 0.09 * i as f32, 0.09 * j as f32, 0.7));
        }
    }
    // What goes through the top ends there; what passes under it goes on.
    let through = |p: &Point3<f32>| {
        let share = (1.2 - 0.7) / (1.2 - p.z);
        table(&Point3::new(share * p.x, share * p.y, 0.7))
    };
    with.hits.positions.retain(|p| !through(p));
    let under = with.clone();
    with.hits.positions.extend(&tops);
    let mut map = Map::new(params()).unwrap();
    add(&mut map, &[(pose, Arc::new(with))], false);
    let num = |map: &Map| all(map).top_m.iter().filter(|t| (*t - 0.7).abs() < 0.01).count();
    let before = num(&map);
    assert!(before > 40, "{before}");
    let under = Arc::new(under);
    add(&mut map, &vec![(pose, Arc::clone(&under)); 10], false);
    // Of the edge towards the sensor a block is lost: just under the top beams pass at its height, to the bin.
    let left = num(&map);
    assert!(4 * left >= 3 * before, "{left} of {before}");
    add(&mut map, &vec![(pose, under); 10], true);
    assert_eq!((num(&map), map.submaps().len()), (left, 2));
}

#[test]
fn a_submap_that_is_moved_is_the_map_that_is_built_there() {
    let ground = |x: f64, y: f64| 0.05 * x + if (3.0..3.6).contains(&x) && (1.0..1.6).contains(&y) { 0.6 } else { 0.0 };
    let looks = looks(&[0.0, 0.7, 1.4, 2.1], 1.2, ground);
    let t = Vector3::new(3.43, -1.27, 1.36);
    let turn = nalgebra::UnitQuaternion::from_euler_angles(0.02, -0.03, 0.7);
    let moved = Pose::from_parts(t.into(), turn);
    let mut map = mapped(&looks);
    let poses = looks.iter().enumerate().map(|(i, (pose, _))| (KeyframeId(i as u64), moved * pose));
    map.correct(&Correction { t_map_base: poses.collect() }, &[]).unwrap();
    let there: Vec<_> = looks.iter().map(|(pose, scan)| (moved * pose, Arc::clone(scan))).collect();
    let direct = mapped(&there);
    let (min, max) = direct.layers().height.bounds().unwrap();
    let of = |map: &Map| map.layers().height.region(min, max, Storey::Highest, MOST).unwrap();
    let (ours, theirs) = (of(&map), of(&direct));
    let both: Vec<(f32, f32)> = ours.ground_m.iter().copied().zip(theirs.ground_m.iter().copied()).collect();
    let known = both.iter().filter(|(a, b)| !a.is_nan() && !b.is_nan());
    let off: Vec<f64> = known.map(|(a, b)| f64::from(a - b)).collect();
    let n = off.len() as f64;
    let (bias, rms) = (off.iter().sum::<f64>() / n, (off.iter().map(|d| d * d).sum::<f64>() / n).sqrt());
    assert!(n > 5000.0 && bias.abs() < 0.002 && rms < 0.015, "{n} {bias} {rms}");
    let tops = |h: &DenseHeights| h.top_m.iter().copied().fold(f32::NAN, f32::max);
    assert!((tops(&ours) - tops(&theirs)).abs() < 0.06, "{} {}", tops(&ours), tops(&theirs));
    // Built anew, it is that to the bit.
    while !map.advance(usize::MAX) {}
    assert!(of(&map).ground_m.iter().map(|v| v.to_bits()).eq(theirs.ground_m.iter().map(|v| v.to_bits())));
}

#[test]
fn submaps_laid_over_each_other_are_one_that_saw_it_all() {
    let ground = |x: f64, y: f64| 0.04 * x - 0.02 * y;
    let looks = looks(&[0.0, 1.0, 2.0, 3.0], 1.2, ground);
    let mut map = mapped(&looks[..2]);
    add(&mut map, &looks[2..], true);
    let direct = mapped(&looks);
    assert_eq!((map.submaps().len(), direct.submaps().len()), (2, 1));
    let (ours, theirs) = (all(&map), all(&direct));
    assert_eq!((ours.width, ours.height), (theirs.width, theirs.height));
    for (a, b) in ours.ground_m.iter().zip(&theirs.ground_m).filter(|(_, b)| !b.is_nan()) {
        assert!((a - b).abs() < 0.01, "{a} {b}");
    }
    assert_eq!(ours.num_keyframes, theirs.num_keyframes);
}

#[test]
fn two_storeys_are_not_mixed_and_each_is_read_by_its_height() {
    let floor = |x: f64, _: f64| 0.02 * x;
    let lower = looks(&[0.0, 1.0, 2.0], 1.2, floor);
    let up = Pose::translation(0.3, 0.0, 3.2);
    let upper: Vec<_> = lower.iter().map(|(pose, scan)| (up * pose, Arc::clone(scan))).collect();
    for first_is_lower in [true, false] {
        let (first, then) = if first_is_lower { (&lower, &upper) } else { (&upper, &lower) };
        let mut map = mapped(first);
        add(&mut map, then, true);
        let heights = map.layers().height;
        let of = |storey| heights.dense(storey, MOST).unwrap();
        let near = |z_m: f64| of(Storey::Near { z_m, within_m: 1.0 });
        let above = |x: f64, y: f64| floor(x - 0.3, y) + 3.2;
        let (x, y) = ((-2.0, 4.0), (-2.0, 2.0));
        for (own, all, surface) in [
            (near(0.3), of(Storey::Lowest), &floor as &dyn Fn(f64, f64) -> f64),
            (near(3.0), of(Storey::Highest), &above),
        ] {
            let off = errors(&own, surface, x, y);
            assert!(off.0.abs() < 0.02 && off.1 < 0.08 && off.2 > 1500, "{off:?}");
            // Where one alone is known it is both the lowest and the highest.
            for (a, b) in own.ground_m.iter().zip(&all.ground_m).filter(|(a, _)| !a.is_nan()) {
                assert_eq!(a.to_bits(), b.to_bits());
            }
        }
    }
}

#[test]
fn a_layer_that_is_not_wanted_or_sees_no_heights_stays_empty() {
    let looks = looks(&[0.0], 1.2, |_, _| 0.0);
    let mut map = Map::new(MapParams::default()).unwrap();
    add(&mut map, &looks, false);
    assert_eq!(map.layers().height.tile_keys().count(), 0);
    let mut map = Map::new(params()).unwrap();
    add(&mut map, &[(Pose::identity(), Arc::new(planar(&[[3.0, 0.0]], &[[0.0, 5.0]])))], false);
    let heights = map.layers().height;
    assert_eq!((heights.tile_keys().count(), heights.bounds()), (0, None));
    assert_eq!(heights.dense(Storey::Lowest, 0).unwrap().ground_m.len(), 0);
    let bad = MapParams { height: HeightParams { clearance_m: f64::NAN, ..Default::default() }, ..Default::default() };
    assert!(matches!(Map::new(bad), Err(MappingError::InvalidParam { field: "clearance_m", .. })));
}

#[test]
fn regions_are_bounded_and_faults_named() {
    let map = mapped(&looks(&[0.0], 1.2, |_, _| 0.0));
    let heights = map.layers().height;
    let (a, b) = (Cell::new(0, 0), Cell::new(9, 9));
    let region = |a, b, most| heights.region(a, b, Storey::Lowest, most).map(|r| r.ground_m.len());
    assert_eq!((region(a, b, 100), region(b, a, 100)), (Ok(100), Err(MappingError::RegionEmpty)));
    assert_eq!(region(a, b, 99), Err(MappingError::RegionTooLarge { cells: 100, limit: 99 }));
    let ends = (Cell::new(i32::MIN, i32::MIN), Cell::new(i32::MAX, i32::MAX));
    assert!(matches!(region(ends.0, ends.1, MOST), Err(MappingError::RegionTooLarge { .. })));
    let drivable = |a, b, most| heights.traversability(a, b, Storey::Lowest, most).map(|t| (t.width, t.height));
    // With two cells around it that the footprint reaches, and ten that an edge may hide.
    assert_eq!((drivable(a, b, 1156), drivable(b, a, 196)), (Ok((10, 10)), Err(MappingError::RegionEmpty)));
    assert_eq!(drivable(a, b, 1155), Err(MappingError::RegionTooLarge { cells: 1156, limit: 1155 }));
    // What is read in parts is what is read at once.
    let whole = heights.traversability(Cell::new(-30, -30), Cell::new(30, 30), Storey::Lowest, MOST).unwrap();
    let part = heights.traversability(a, b, Storey::Lowest, MOST).unwrap();
    for (i, t) in part.traversability.iter().enumerate() {
        assert_eq!(t.to_bits(), whole.traversability[(i / 10 + 30) * 61 + i % 10 + 30].to_bits());
    }
}

fn bytes(grid: &HeightGrid) -> Vec<u8> {
    let mut out = vec![];
    grid.encode(&mut out);
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_stored_part_is_had_again_to_the_last_bit_and_what_is_cut_or_changed_never_panics(
        points in prop::collection::vec((-9.0..9.0f32, -9.0..9.0f32, -3.0..4.0f32), 0..400),
        yaw in -3.0..3.0f64, z in -50.0..50.0f64, at in 0.0..1.0f64, change in 1..255u8,
    ) {
        let params = params().height;
        let mut grid = HeightGrid::new(params).unwrap();
        let hits = points.iter().map(|p| Point3::new(p.0, p.1, if p.2 < 1.0 { 0.02 * p.2 } else { p.2 - 1.0 })).collect();
        let mut pose = se3::from_xy_yaw(0.3, -7.0, yaw);
        pose.translation.vector.z = z;
        for _ in 0..2 {
            grid.integrate(&pose, &crate::scans::spatial(1.2, Clone::clone(&hits))).unwrap();
        }
        let stored = bytes(&grid);
        let back = HeightGrid::decode(&params, &mut Reader::new(&stored)).unwrap();
        prop_assert!(back == grid && bytes(&back) == stored);
        let end = (at * stored.len() as f64) as usize;
        prop_assert_eq!(HeightGrid::decode(&params, &mut Reader::new(&stored[..end])), Err(Damaged));
        let mut other = stored;
        other[end] ^= change;
        if let Ok(other) = HeightGrid::decode(&params, &mut Reader::new(&other)) {
            prop_assert!(other != grid || bytes(&other) == bytes(&grid));
        }
    }

    #[test]
    fn points_without_meaning_say_nothing(x in -1e30..1e30f32, z in prop::num::f32::ANY) {
        let mut grid = HeightGrid::new(params().height).unwrap();
        let hits = vec![Point3::new(x, 1.0, z), Point3::new(z, x, 0.0), Point3::new(f32::NAN, x, z)];
        grid.integrate(&Pose::identity(), &crate::scans::spatial(1.2, hits.clone())).unwrap();
        grid.integrate(&se3::from_xy_yaw(1e12, 0.0, 0.0), &crate::scans::spatial(1.2, hits)).unwrap();
        let stored = bytes(&grid);
        prop_assert!(HeightGrid::decode(grid.params(), &mut Reader::new(&stored)).unwrap() == grid);
    }
}

#[test]
fn the_map_is_the_same_with_any_number_of_threads() {
    let looks = looks(&[0.0, 1.0, 7.0], 1.2, with_box);
    let built = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let map = mapped(&looks);
            (map.layers().height, drivable(&map).to_grid())
        })
    };
    assert!(built(1) == built(3));
}
