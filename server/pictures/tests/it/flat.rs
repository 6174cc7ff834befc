//! Maps from above.

use crate::{OCCUPIED, count, extent, grid, same_on_any_threads, scale_bar};
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{GridGeometry, ObjectClass, OrientedBox3, RgbImage, se3};
use percept_mapping::{DenseGrid, DenseHeights, HeightParams, Traversability};
use percept_pictures::{
    GridView, MAX_EDGE, MapObject, Overlay, PathDrawing, PictureError, Zone, ZoneKind, ZoneMask, before_after, heights,
    occupancy, overview, path_picture, side_by_side, traversability,
};
use std::sync::Arc;

const BLUE: [u8; 3] = [0, 114, 178];
const MAGENTA: [u8; 3] = [200, 0, 140];
const GREEN: [u8; 3] = [0, 158, 115];
const RED: [u8; 3] = [204, 24, 30];
const UNKNOWN: [u8; 3] = [200, 207, 218];

#[test]
fn walls_are_as_far_apart_as_the_scale_bar_says() {
    let mut grid = grid();
    // At x = -1 and x = 4: five metres apart.
    for row in grid.cells.chunks_exact_mut(100) {
        (row[10], row[60]) = (100, 100);
    }
    let image = overview(&grid, &Overlay::default(), "walls").unwrap();
    // 90 pixels a metre: the bar has 2 m.
    assert_eq!(scale_bar(&image), 180);
    let row = (0..image.height())
        .max_by_key(|y| (0..image.width()).filter(|x| image.at(*x, *y) == OCCUPIED).count())
        .unwrap();
    let dark: Vec<usize> = (0..1000).filter(|x| image.at(*x, row) == OCCUPIED).collect();
    let second = *dark.iter().find(|x| **x > dark[0] + 100).unwrap();
    assert_eq!(second - dark[0], 5 * 180 / 2);
    assert_eq!(dark.iter().filter(|x| **x < second).count(), 9, "a cell of 10 cm is 9 pixels wide");
}

#[test]
fn y_goes_up() {
    let mut grid = grid();
    grid.cells[59 * 100..].fill(100);
    let image = overview(&grid, &Overlay::default(), "").unwrap();
    let (columns, _) = extent(&image, OCCUPIED).unwrap();
    let top = (0..image.height()).find(|y| image.at(columns[0] + 300, *y) == OCCUPIED).unwrap();
    assert!(top < 150, "{top}");
    let plain = occupancy(&grid).unwrap();
    assert_eq!((plain.width(), plain.height()), (100, 60));
    assert_eq!((plain.at(50, 0), plain.at(50, 59)), (OCCUPIED, [255; 3]));
}

#[test]
fn rooms_of_any_size_fill_the_picture() {
    for (width, height) in [(1, 1), (3, 2), (50, 40), (899, 20), (901, 600), (5000, 3)] {
        let cells = vec![0; width * height];
        let view = GridView { geometry: GridGeometry::new(0.05, Point2::origin()), width, height, cells: &cells };
        let image = overview(view, &Overlay::default(), "room").unwrap();
        let longest = image.width().max(image.height());
        assert!((900..=MAX_EDGE).contains(&longest), "{width} x {height}: {longest}");
    }
}

#[test]
fn one_occupied_cell_of_a_huge_map_is_seen() {
    let side = 8000;
    let mut cells = vec![0i8; side * side];
    cells[4321 * side + 1234] = 100;
    let view =
        GridView { geometry: GridGeometry::new(0.05, Point2::origin()), width: side, height: side, cells: &cells };
    let image = overview(view, &Overlay::default(), "huge").unwrap();
    assert!(image.width().max(image.height()) <= MAX_EDGE);
    // Left of the legend there is one pixel of it.
    let left = (0..image.height()).flat_map(|y| (0..2800).map(move |x| (x, y)));
    assert_eq!(left.filter(|(x, y)| image.at(*x, *y) == OCCUPIED).count(), 1);
}

#[test]
fn the_legend_has_what_is_in_the_picture_and_nothing_else() {
    let grid = grid();
    let empty = overview(&grid, &Overlay::default(), "").unwrap();
    for color in [BLUE, MAGENTA, GREEN, RED, UNKNOWN, OCCUPIED] {
        assert_eq!(count(&empty, color), 0, "{color:?}");
    }
    let square = |x: f64| [[x, 2.0], [x + 1.0, 2.0], [x + 1.0, 3.0], [x, 3.0]].map(Point2::from).to_vec();
    let bbox = OrientedBox3::upright(Point3::new(5.0, 4.0, 0.5), Vector3::new(1.0, 1.0, 1.0), 0.3);
    let overlay = Overlay {
        trajectory: (0..20).map(|i| se3::from_xy_yaw(0.1 * f64::from(i), 2.0, 0.0)).collect(),
        objects: vec![MapObject { id: Some(3), class: ObjectClass::Table, bbox }],
        zones: vec![
            Zone { polygon: square(3.0), kind: ZoneKind::KeepOut },
            Zone { polygon: square(6.0), kind: ZoneKind::SpeedLimit { share: 0.5 } },
        ],
        path: vec![Point2::new(2.0, 2.0), Point2::new(4.0, 5.0)],
        robot: None,
        masks: vec![],
        rooms: vec![],
    };
    let full = overview(&grid, &overlay, "").unwrap();
    // Right of the drawing stands the legend: the lines' colours are found there, too.
    let side = |color| {
        (0..full.height())
            .flat_map(|y| (940..full.width()).map(move |x| (x, y)))
            .filter(|(x, y)| full.at(*x, *y) == color)
            .count()
    };
    for color in [BLUE, MAGENTA, GREEN, RED, [213, 94, 0]] {
        assert!(side(color) > 20, "{color:?}");
    }
    same_on_any_threads(|| overview(&grid, &overlay, "").unwrap());
}

#[test]
fn a_path_shows_its_values_and_where_it_is_blocked() {
    let grid = grid();
    let poses: Vec<_> = (0..50).map(|i| se3::from_xy_yaw(-1.0 + 0.1 * f64::from(i), 3.0, 0.0)).collect();
    let values = (0..50).map(|i| if i < 25 { 0.3 } else { 1.3 }).collect();
    let path = PathDrawing { poses, values, ..PathDrawing::default() };
    let image = path_picture(&grid, &path, "path").unwrap();
    // Both ends of the scale lie in the drawing, along the path.
    let near = |color: [u8; 3]| {
        let drawn = (0..image.height()).flat_map(|y| (40..930).map(move |x| (x, y)));
        drawn.filter(|(x, y)| (0..3).all(|i| image.at(*x, *y)[i].abs_diff(color[i]) < 8)).count()
    };
    assert!(near([253, 231, 37]) > 20 && near([68, 1, 84]) > 20);
    let short = PathDrawing { values: vec![1.0], ..path };
    assert!(matches!(path_picture(&grid, &short, ""), Err(PictureError::ShapeMismatch { field: "values", .. })));
    let blocked = PathDrawing {
        blocking: Some(Point2::new(2.0, 3.0)),
        reason: Some("a wall".to_owned()),
        ..PathDrawing::default()
    };
    let image = path_picture(&grid, &blocked, "none").unwrap();
    assert!(count(&image, RED) > 100);
}

#[test]
fn a_mask_is_hatched_where_its_cells_say_so_and_nowhere_else() {
    let grid = grid();
    let (low, size) = (grid.geometry.origin, grid.geometry.resolution_m * grid.width as f64);
    // Four columns over the grid's width: nothing, keep out, slow, unknown.
    let mask = |values: [i8; 4]| {
        let cells = [values; 4].as_flattened().to_vec();
        let grid = DenseGrid::new(GridGeometry::new(0.25 * size, low), 4, 4, cells).unwrap();
        let kinds = vec![None, None, Some(ZoneKind::KeepOut), Some(ZoneKind::SpeedLimit { share: 0.3 })];
        ZoneMask { grid: Arc::new(grid), kinds }
    };
    let of = |values| {
        let drawing = PathDrawing { masks: vec![mask(values)], ..PathDrawing::default() };
        path_picture(&grid, &drawing, "").unwrap()
    };
    let (none, some) = (of([0, -1, 0, -1]), of([0, 1, 2, -1]));
    assert_eq!(none, path_picture(&grid, &PathDrawing::default(), "").unwrap());
    let differs = |image: &RgbImage, x: usize| (100..600).filter(|y| none.at(x, *y) != image.at(x, *y)).count();
    // The drawing begins where a mask that is slow everywhere does; then quarters of its 900 pixels, in their middles.
    let everywhere = of([2; 4]);
    let left = (0..200).find(|x| differs(&everywhere, *x) > 200).unwrap();
    let quarters = [0, 1, 2, 3].map(|i| differs(&some, left + 225 * i + 112));
    assert!(quarters[0] < 5 && quarters[1] > 50 && quarters[2] > 200 && quarters[3] < 5, "{quarters:?}");
}

#[test]
fn what_appeared_and_what_has_gone_is_counted_across_grids_that_lie_differently() {
    let mut before = grid();
    before.cells[20 * 100 + 30] = 100;
    // The same place, ten columns and five rows more at the left and below; the thing has moved by 1 m along x.
    let geometry = GridGeometry::new(0.1, Point2::new(-3.0, 0.5));
    let mut after = DenseGrid { geometry, width: 110, height: 65, cells: vec![0; 110 * 65] };
    after.cells[25 * 110 + 50] = 100;
    after.cells[2] = 100;
    let (image, changes) = before_after(&before, &after, 0.0, "").unwrap();
    assert_eq!((changes.num_appeared, changes.num_gone, changes.num_newly_seen), (1, 1, 1));
    assert!((changes.cell_area_m2 - 0.01).abs() < 1e-12);
    assert!(count(&image, GREEN) > 0 && count(&image, RED) > 0);
    let (_, same) = before_after(&before, &before, 0.0, "").unwrap();
    assert_eq!((same.num_appeared, same.num_gone), (0, 0));
    // A wall that is a cell off has not moved if that much is forgiven.
    let mut off = grid();
    off.cells[20 * 100 + 31] = 100;
    assert_eq!(before_after(&before, &off, 0.1, "").unwrap().1.num_appeared, 0);
    assert_eq!(before_after(&before, &off, 0.0, "").unwrap().1.num_appeared, 1);
    assert!(before_after(&before, &off, f64::NAN, "").is_err());
}

fn slope(width: usize, height: usize) -> DenseHeights {
    let n = width * height;
    DenseHeights {
        geometry: GridGeometry::new(0.1, Point2::origin()),
        width,
        height,
        ground_m: (0..n).map(|i| 0.05 * (i % width) as f32).collect(),
        sigma_m: vec![0.01; n],
        top_m: vec![f32::NAN; n],
        overhang_m: vec![f32::NAN; n],
        num_keyframes: vec![3; n],
        is_drop: vec![false; n],
    }
}

#[test]
fn heights_become_lighter_uphill_and_drops_are_magenta() {
    let mut map = slope(60, 40);
    map.is_drop[20 * 60 + 30] = true;
    map.ground_m[0] = f32::NAN;
    let image = heights(&map, "slope").unwrap();
    assert!(count(&image, MAGENTA) >= 225 && count(&image, UNKNOWN) >= 225);
    let light = |x: usize| image.at(x, 300).iter().map(|c| u32::from(*c)).sum::<u32>();
    assert!(light(150) < light(850), "{} {}", light(150), light(850));
    let params = HeightParams::default();
    assert!(count(&traversability(&Traversability::of(&map, &params), "").unwrap(), MAGENTA) >= 225);
    let cut = DenseHeights { is_drop: vec![], ..map };
    assert!(matches!(heights(&cut, ""), Err(PictureError::ShapeMismatch { field: "is_drop", .. })));
}

#[test]
fn panels_stand_beside_each_other_within_the_largest_picture() {
    let image = overview(&grid(), &Overlay::default(), "").unwrap();
    let both = side_by_side(&[(&image, "before"), (&image, "after")], 2).unwrap();
    assert!(both.width() > 2 * image.width() && both.height() > image.height());
    let many = vec![(&image, "one of many"); 20];
    let all = side_by_side(&many, 5).unwrap();
    assert!(all.width().max(all.height()) <= MAX_EDGE);
    assert!(side_by_side(&[], 1).is_err() && side_by_side(&many, 0).is_err());
}

#[test]
fn grids_that_cannot_be_are_refused_before_memory_is_taken() {
    let view = |width, height, resolution_m| GridView {
        geometry: GridGeometry::new(resolution_m, Point2::origin()),
        width,
        height,
        cells: &[],
    };
    let error = |v: GridView<'_>| overview(v, &Overlay::default(), "").unwrap_err();
    assert!(matches!(error(view(100_000, 100_000, 0.05)), PictureError::GridTooLarge { .. }));
    assert!(matches!(error(view(usize::MAX, 2, 0.05)), PictureError::GridTooLarge { .. }));
    assert!(matches!(error(view(10, 10, 0.05)), PictureError::ShapeMismatch { expected: 100, actual: 0, .. }));
    for resolution in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300] {
        assert!(matches!(error(view(0, 0, resolution)), PictureError::OutOfRange { field: "resolution_m", .. }));
    }
    assert!(overview(view(0, 0, 0.05), &Overlay::default(), "").is_ok());
}
