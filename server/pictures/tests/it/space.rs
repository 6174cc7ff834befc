//! Meshes, clouds and voxels.

use crate::{INK, OCCUPIED, count, extent, same_on_any_threads, scale_bar};
use nalgebra::Point3;
use percept_geometry::PointCloud;
use percept_mapping::{MeshData, VoxelBlock};
use percept_pictures::{PictureError, View, cloud_view, mesh_view, voxels_slice, voxels_view};

const RED: [u8; 3] = [255, 0, 0];
const BLUE: [u8; 3] = [0, 0, 255];

/// A level square with corners at `low` and `high`, seen from above.
fn square(mesh: &mut MeshData, low: [f32; 2], high: [f32; 2], z: f32, color: [u8; 3]) {
    let first = mesh.positions.len() as u32;
    let corners = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]];
    mesh.positions.extend(corners.map(|c| Point3::new(c[0], c[1], z)));
    mesh.colors.extend([color; 4]);
    mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
}

fn is_reddish(p: [u8; 3]) -> bool {
    p[0] > 80 && p[1] < 20 && p[2] < 20
}

fn is_bluish(p: [u8; 3]) -> bool {
    p[2] > 80 && p[1] < 20 && p[0] < 20
}

#[test]
fn what_is_higher_hides_what_is_below_unless_it_is_cut_away() {
    let mut mesh = MeshData::default();
    square(&mut mesh, [0.0, 0.0], [4.0, 4.0], 0.0, BLUE);
    square(&mut mesh, [1.0, 1.0], [3.0, 3.0], 1.0, RED);
    square(&mut mesh, [0.0, 0.0], [4.0, 4.0], 3.0, [0, 255, 0]);
    let image = mesh_view(&mesh, &View::above(), "squares").unwrap();
    let row = image.height() / 2;
    let red = (0..image.width()).filter(|x| is_reddish(image.at(*x, row))).count() as f64;
    let blue = (0..image.width()).filter(|x| is_bluish(image.at(*x, row))).count() as f64;
    // Two metres of red; of blue a metre at each side.
    assert!((red / blue - 1.0).abs() < 0.03, "{red} {blue}");
    assert_eq!(count(&image, [0, 255, 0]), 0);
    // 4 m and 6 % of room in 1100 pixels; the bar has 1 m.
    assert!((red / scale_bar(&image) as f64 - 2.0).abs() < 0.02, "{red} {}", scale_bar(&image));
    same_on_any_threads(|| mesh_view(&mesh, &View::default(), "squares").unwrap());
}

#[test]
fn back_sides_are_not_drawn() {
    let mut mesh = MeshData::default();
    square(&mut mesh, [0.0, 0.0], [4.0, 4.0], 0.0, RED);
    mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    let image = mesh_view(&mesh, &View::above(), "").unwrap();
    assert_eq!(image.data().chunks_exact(3).filter(|p| is_reddish([p[0], p[1], p[2]])).count(), 0);
}

#[test]
fn a_wall_that_goes_through_the_cut_is_a_dark_line_from_above() {
    let mut mesh = MeshData::default();
    square(&mut mesh, [0.0, 0.0], [4.0, 4.0], 0.0, RED);
    let corners = [[1.0, 1.0, 0.0], [1.0, 3.0, 0.0], [1.0, 3.0, 2.5], [1.0, 1.0, 2.5]];
    mesh.positions.extend(corners.map(Point3::from));
    mesh.colors.extend([BLUE; 4]);
    mesh.triangles.extend([[4, 5, 6], [4, 6, 7]]);
    let image = mesh_view(&mesh, &View::above(), "").unwrap();
    let in_drawing = |y: usize| (200..800).filter(|x| image.at(*x, y) == INK).count();
    let long = (150..1100).filter(|y| in_drawing(*y) >= 2).count() as f64;
    assert!((long / scale_bar(&image) as f64 - 2.0).abs() < 0.03, "{long}");
}

#[test]
fn triangles_that_are_none_do_no_harm() {
    let mut mesh = MeshData::default();
    square(&mut mesh, [0.0, 0.0], [1.0, 1.0], 0.0, RED);
    mesh.positions.extend([Point3::new(f32::NAN, 0.0, 0.0), Point3::new(f32::INFINITY, 1e38, 0.0)]);
    mesh.colors.extend([RED; 2]);
    mesh.triangles.extend([[0, 0, 0], [0, 1, 4], [0, 1, 5], [7, 8, u32::MAX], [0, 1, 1]]);
    mesh_view(&mesh, &View::default(), "").unwrap();
    mesh.colors.pop();
    assert!(matches!(mesh_view(&mesh, &View::default(), ""), Err(PictureError::ShapeMismatch { field: "colors", .. })));
    mesh_view(&MeshData::default(), &View::default(), "nothing").unwrap();
}

#[test]
fn triangles_that_all_cover_the_picture_are_refused() {
    let mut mesh = MeshData::default();
    square(&mut mesh, [0.0, 0.0], [1.0, 1.0], 0.0, RED);
    mesh.triangles = vec![[0, 1, 2]; 20_000];
    let error = mesh_view(&mesh, &View { cut_above_m: None, ..View::above() }, "").unwrap_err();
    assert!(matches!(error, PictureError::TooMuchOverdraw { .. }));
}

#[test]
fn points_lie_where_the_scale_says() {
    let positions = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.5], [2.0, 2.0, 1.0], [1.0, 1.0, 9.0], [f32::NAN, 0.0, 0.0]];
    let colors = vec![RED, RED, BLUE, [0, 255, 0], [0, 255, 0]];
    let cloud = PointCloud { colors: Some(colors), ..PointCloud::from_positions(positions.map(Point3::from).to_vec()) };
    let image = cloud_view(&cloud, &View::above(), "points").unwrap();
    let (red, blue) = (extent(&image, RED).unwrap(), extent(&image, BLUE).unwrap());
    let metre = scale_bar(&image) as f64;
    assert!(((red.0[1] - red.0[0]) as f64 / metre - 4.0).abs() < 0.08);
    assert!(((red.1[0] - blue.1[0]) as f64 / metre - 2.0).abs() < 0.02);
    assert_eq!(count(&image, [0, 255, 0]), 0, "a point above the cut is seen");
    same_on_any_threads(|| cloud_view(&cloud, &View::default(), "points").unwrap());
    let cut = PointCloud { colors: Some(vec![RED]), ..cloud };
    assert!(cloud_view(&cut, &View::default(), "").is_err());
    cloud_view(&PointCloud::default(), &View::default(), "").unwrap();
}

fn block(key: [i32; 3], occupied: &[[usize; 3]]) -> VoxelBlock {
    let mut percent = Box::new([-1i8; 512]);
    percent[..64].fill(10);
    occupied.iter().for_each(|[x, y, z]| percent[(z * 8 + y) * 8 + x] = 90);
    VoxelBlock { key, percent }
}

#[test]
fn a_slice_shows_the_voxels_of_its_height() {
    let blocks = [block([0, 0, 0], &[[3, 4, 0], [1, 1, 5]]), block([-2, 1, 0], &[])];
    let dark = |z_m: f64| {
        let image = voxels_slice(&blocks, 0.1, z_m, "slice").unwrap();
        let occupied = percept_color(90);
        (0..image.height())
            .flat_map(|y| (0..930).map(move |x| (x, y)))
            .filter(|(x, y)| image.at(*x, *y) == occupied)
            .count()
    };
    // 24 columns in at least 900 pixels: 38 pixels a voxel.
    assert_eq!((dark(0.05), dark(0.55), dark(0.3)), (38 * 38, 38 * 38, 0));
    assert!(voxels_slice(&blocks, 0.1, f64::NAN, "").is_err());
    assert!(voxels_slice(&blocks, 0.0, 0.0, "").is_err());
    assert!(voxels_slice(&[], 0.1, 0.0, "").is_ok());
    let apart = [block([i32::MIN, 0, 0], &[]), block([i32::MAX, 0, 0], &[])];
    assert!(matches!(voxels_slice(&apart, 0.1, 0.0, ""), Err(PictureError::GridTooLarge { .. })));
}

/// Colour of a cell.
fn percept_color(percent: u32) -> [u8; 3] {
    let mix = |a: f64, b: f64| (a + (b - a) * (f64::from(percent) - 50.0) / 50.0).round() as u8;
    [mix(130.0, f64::from(OCCUPIED[0])), mix(130.0, f64::from(OCCUPIED[1])), mix(130.0, f64::from(OCCUPIED[2]))]
}

#[test]
fn cubes_are_drawn_and_cut() {
    let blocks = [block([0, 0, 0], &[[0, 0, 0], [7, 7, 7]]), block([0, 0, 1], &[[0, 0, 0]])];
    let highest = [253, 231, 37];
    let image = voxels_view(&blocks, 0.1, &View { cut_above_m: None, ..View::above() }, "cubes").unwrap();
    assert!(count(&image, highest) > 1000);
    same_on_any_threads(|| voxels_view(&blocks, 0.1, &View::default(), "cubes").unwrap());
    let cut = View { cut_above_m: Some(-1.0), ..View::default() };
    voxels_view(&blocks, 0.1, &cut, "nothing").unwrap();
    let far = [block([i32::MAX, i32::MIN, 0], &[[0, 0, 0]])];
    voxels_view(&far, 0.1, &View::default(), "").unwrap();
}
