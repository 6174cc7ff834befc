//! The fan against the walk.

use super::*;
use crate::occupancy::beams;
use crate::occupancy::mark::Heights;
use percept_geometry::Cell;
use proptest::prelude::*;
use std::f64::consts::TAU;

/// Marks of beams to these places, by the fan and by the walk; none by the fan if it is not sure.
fn both(g: &GridGeometry, from: Point2<f64>, ends: &[Point2<f64>]) -> (Option<PlanarMarks>, PlanarMarks) {
    let beams: Vec<Beam> = ends.iter().map(|to| Beam { to: *to, end: g.cell(to).unwrap(), is_hit: false }).collect();
    let cells = || ends.iter().chain([&from]).map(|p| g.cell(p).unwrap());
    let (x, y) = (|| cells().map(|c| c.x), || cells().map(|c| c.y));
    let low = Cell::new(x().min().unwrap() - 1, y().min().unwrap() - 1);
    let high = Cell::new(x().max().unwrap() + 1, y().max().unwrap() + 1);
    let mut walked = PlanarMarks::new(Heights::NONE, low, high);
    let mut fanned = walked.clone();
    beams::free(&mut walked, g, &from, &beams);
    (free(&mut fanned, g, &from, &beams).then_some(fanned), walked)
}

/// Edge of cells, corner of the first, and a place, all of which may be round.
fn place() -> impl Strategy<Value = (GridGeometry, Point2<f64>)> {
    let resolution = prop::sample::select(vec![0.05, 0.1, 0.25, 0.013]);
    let origin = prop::sample::select(vec![Point2::origin(), Point2::new(-1.03, 0.27), Point2::new(700.0, -4e4)]);
    let cells = prop_oneof![-2000.0..2000.0f64, (-40..40i32).prop_map(|v| f64::from(v) * 0.5)];
    (resolution, origin, cells.clone(), cells).prop_map(|(resolution, origin, x, y)| {
        (GridGeometry::new(resolution, origin), origin + nalgebra::Vector2::new(x, y) * resolution)
    })
}

/// Ranges in cells: walls, jumps, and anything.
fn ranges(most: f64) -> impl Strategy<Value = Vec<f64>> {
    let wall = (1..80usize, 0.0..most).prop_map(|(n, range)| vec![range; n]);
    let slanted = (1..80usize, 0.0..most, -0.5..0.5f64)
        .prop_map(move |(n, range, by)| (0..n).map(|i| (range + by * i as f64).clamp(0.0, most)).collect());
    let any = prop::collection::vec(0.0..most, 1..20);
    prop::collection::vec(prop_oneof![wall, slanted, any], 1..8).prop_map(|walls| walls.concat())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1500))]

    #[test]
    fn a_fan_frees_what_walks_along_its_beams_free(
        (g, from) in place(), ranges in prop_oneof![ranges(12.0), ranges(90.0), ranges(900.0)], turn in 0.0..TAU,
        step in prop_oneof![Just(TAU / 360.0), Just(TAU / 1440.0), Just(-TAU / 360.0), Just(0.05), 0.0..0.2f64],
    ) {
        let end = |(i, range): (usize, &f64)| {
            let (sin, cos) = (turn + step * i as f64).sin_cos();
            from + nalgebra::Vector2::new(cos, sin) * (range * g.resolution_m)
        };
        let ends: Vec<_> = ranges.iter().enumerate().map(end).collect();
        let (fanned, walked) = both(&g, from, &ends);
        if let Some(fanned) = fanned {
            prop_assert!(fanned == walked);
        }
    }

    #[test]
    fn so_it_does_where_beams_lie_on_borders_and_end_there(
        (g, from) in place(), steps in prop::collection::vec((-40..40i32, -40..40i32), 1..60), part in 1..5i32,
    ) {
        let end = |(x, y): &(i32, i32)| {
            from + nalgebra::Vector2::new(f64::from(*x), f64::from(*y)) * (g.resolution_m / f64::from(part))
        };
        let ends: Vec<_> = steps.iter().map(end).collect();
        let (fanned, walked) = both(&g, from, &ends);
        if let Some(fanned) = fanned {
            prop_assert!(fanned == walked);
        }
    }

    #[test]
    fn so_it_does_along_rows_and_columns(
        (g, from) in place(), reach in prop::collection::vec((-600.0..600.0f64, -1e-3..1e-3f64, any::<bool>()), 1..40), off in -1.0..1.0f64,
    ) {
        let end = |(far, aside, is_row): &(f64, f64, bool)| {
            let aside = aside * off.powi(9);
            from + g.resolution_m * if *is_row { nalgebra::Vector2::new(*far, aside) } else { nalgebra::Vector2::new(aside, *far) }
        };
        let ends: Vec<_> = reach.iter().map(end).collect();
        let (fanned, walked) = both(&g, from, &ends);
        if let Some(fanned) = fanned {
            prop_assert!(fanned == walked);
        }
    }
}

#[test]
fn a_fan_from_anywhere_is_sure() {
    let g = GridGeometry::new(0.05, Point2::origin());
    let sure = (0..200).filter(|i| {
        let from = Point2::new(3.0 * (0.7 * f64::from(*i)).sin(), 40.0 * (1.1 * f64::from(*i)).cos());
        let end = |k: i32| {
            let (sin, cos) = (0.3 * f64::from(*i) + TAU / 360.0 * f64::from(k)).sin_cos();
            from + nalgebra::Vector2::new(cos, sin) * (3.0 + 2.0 * (0.1 * f64::from(k)).sin())
        };
        both(&g, from, &(0..360).map(end).collect::<Vec<_>>()).0.is_some()
    });
    assert!(sure.count() >= 199);
}

#[test]
fn no_beams_free_nothing_and_one_of_no_length_its_cell() {
    let g = GridGeometry::new(0.1, Point2::origin());
    let from = Point2::new(-0.33, 0.21);
    for ends in [vec![], vec![from]] {
        let (fanned, walked) = both(&g, from, &ends);
        assert_eq!(walked.free.iter().map(|word| word.count_ones() as usize).sum::<usize>(), ends.len());
        assert_eq!(fanned, Some(walked));
    }
}

#[test]
fn it_is_not_where_a_beam_goes_through_corners_of_cells() {
    let g = GridGeometry::new(0.125, Point2::origin());
    assert!(both(&g, Point2::new(0.25, 0.25), &[Point2::new(2.3, 2.3)]).0.is_none());
    assert!(both(&g, Point2::new(0.25, 0.3), &[Point2::new(2.3, 2.3)]).0.is_some());
}
