use super::scenes::{Shape, camera, errors, images, looking, scan, topology};
use nalgebra::{Point3, Vector3};
use percept_geometry::{Aabb3, CameraIntrinsics, DepthImage, Distortion, GeometryError, Pose, RgbImage};
use percept_mapping::{MappingError, MeshData, MeshOptions, SurfaceGrid, SurfaceParams};

pub(super) fn params() -> SurfaceParams {
    SurfaceParams { enabled: true, voxel_size_m: 0.04, ..SurfaceParams::default() }
}

const BALL: Shape = Shape::Sphere([0.013, -0.021, 0.5], 0.5);

/// Towards the faces, edges and corners of a cube.
fn directions() -> impl Iterator<Item = Vector3<f64>> {
    let step = |i: i32| f64::from(i % 3 - 1);
    (0..27)
        .map(move |i| Vector3::new(step(i), step(i / 3), step(i / 9)))
        .filter(|d| d.norm() > 0.5)
        .map(|d| d.normalize())
}

fn ball_from_images() -> SurfaceGrid {
    let mut grid = SurfaceGrid::new(params()).unwrap();
    for d in directions() {
        let eye = Vector3::new(0.0, 0.0, 0.5) + 1.8 * d;
        let t = looking(eye.into(), [0.0, 0.0, 0.5]);
        let (depth, color) = images(&[BALL], &t);
        grid.integrate_depth(&depth, Some(&color), &camera(), &t).unwrap();
    }
    grid
}

fn check_ball(mesh: &MeshData, worst_mean: f64) {
    assert!(mesh.triangles.len() > 1000);
    assert_eq!(topology(mesh), (0, 2), "open edges, and a sphere's characteristic");
    let voxel = params().voxel_size_m;
    let (mean, largest) = errors(mesh, &[BALL]);
    assert!(mean <= worst_mean * voxel && largest <= 1.5 * voxel, "mean {mean}, largest {largest}");
    let center = Vector3::new(0.013, -0.021, 0.5);
    for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
        let out = (p.coords.cast::<f64>() - center).normalize();
        assert!(n.cast::<f64>().dot(&out) > 0.8, "normals point out: {n} at {p}");
    }
    let mut volume = 0.0;
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize].coords.cast::<f64>() - center);
        volume += a.dot(&b.cross(&c)) / 6.0;
    }
    let expected = 4.0 / 3.0 * std::f64::consts::PI * 0.125;
    assert!((volume / expected - 1.0).abs() < 0.06, "triangles turn outward: {volume} of {expected}");
}

#[test]
fn a_ball_seen_from_all_sides_is_a_closed_surface_where_it_is() {
    let grid = ball_from_images();
    let mesh = grid.mesh(&MeshOptions::default()).unwrap();
    check_ball(&mesh, 0.3);
    assert!(mesh.colors.iter().all(|c| *c == [200, 100, 50]));
}

#[test]
fn keyframes_show_the_same_ball_as_images() {
    let mut grid = SurfaceGrid::new(params()).unwrap();
    for d in directions() {
        let eye = Vector3::new(0.0, 0.0, 0.5) + 1.8 * d;
        let t = Pose::translation(eye.x, eye.y, eye.z);
        grid.integrate(&t, &scan(&[BALL], &t, (-1.57, 1.57), 0.012)).unwrap();
    }
    let mesh = grid.mesh(&MeshOptions::default()).unwrap();
    check_ball(&mesh, 0.3);
    assert!(mesh.colors.iter().all(|c| *c == [200, 100, 50]));
}

#[test]
fn walls_and_a_box_lie_where_they_are() {
    let shapes = [Shape::Room([-2.0, -1.5, 0.0], [2.0, 1.5, 2.2]), Shape::Solid([0.4, -0.3, 0.0], [1.0, 0.4, 0.7])];
    let poses = [[-1.0, 0.0, 1.0], [0.0, 1.0, 1.2], [1.6, -1.0, 1.1], [0.0, -1.0, 1.5]];
    let mut grid = SurfaceGrid::new(params()).unwrap();
    for at in poses {
        let t = Pose::translation(at[0], at[1], at[2]);
        grid.integrate(&t, &scan(&shapes, &t, (-1.57, 1.57), 0.012)).unwrap();
    }
    let mesh = grid.mesh(&MeshOptions::default()).unwrap();
    let (mean, _) = errors(&mesh, &shapes);
    assert!(mesh.triangles.len() > 30_000 && mean <= 0.3 * 0.04, "{} triangles, mean {mean}", mesh.triangles.len());
    let mut by_images = SurfaceGrid::new(params()).unwrap();
    for (at, d) in poses.iter().flat_map(|at| directions().map(move |d| (*at, d))) {
        let t = looking(at, (Vector3::from(at) + d).into());
        by_images.integrate_depth(&images(&shapes, &t).0, None, &camera(), &t).unwrap();
    }
    let mesh = by_images.mesh(&MeshOptions::default()).unwrap();
    let (mean, _) = errors(&mesh, &shapes);
    assert!(mesh.triangles.len() > 30_000 && mean <= 0.3 * 0.04, "{} triangles, mean {mean}", mesh.triangles.len());
    assert!(mesh.colors.iter().all(|c| *c == [128; 3]), "grey without colours");
}

const WALLS: Shape = Shape::Room([-2.0, -1.5, 0.0], [2.0, 1.5, 2.2]);
const CRATE: Shape = Shape::Solid([0.4, -0.3, 0.3], [1.0, 0.4, 0.9]);

/// Vertices of a mesh well within the place where the crate was, walls left out.
pub(super) fn of_crate(mesh: &MeshData) -> usize {
    let place = Aabb3 { min: Point3::new(0.3, -0.4, 0.2), max: Point3::new(1.1, 0.5, 1.0) };
    mesh.positions.iter().filter(|p| place.contains(&p.cast())).count()
}

pub(super) fn with_and_without() -> [Vec<Shape>; 2] {
    [vec![WALLS, CRATE], vec![WALLS]]
}

#[test]
fn what_has_gone_is_gone_once_three_keyframes_saw_through_it() {
    let [full, empty] = with_and_without();
    let pose = |i: usize| Pose::translation(-0.8 + 0.02 * i as f64, 0.1, 0.8);
    let (mut grid, mut keeping) =
        (SurfaceGrid::new(params()).unwrap(), SurfaceGrid::new(SurfaceParams { carve: false, ..params() }).unwrap());
    let mut look = |shapes: &[Shape], i: usize| {
        let scan = scan(shapes, &pose(i), (-1.57, 1.57), 0.008);
        grid.integrate(&pose(i), &scan).unwrap();
        keeping.integrate(&pose(i), &scan).unwrap();
        [&grid, &keeping].map(|g| g.mesh(&MeshOptions::default()).unwrap())
    };
    let [before, _] = (0..12).map(|i| look(&full, i)).last().unwrap();
    assert!(of_crate(&before) > 300);
    let [after, kept] = (0..3).map(|i| look(&empty, i)).last().unwrap();
    assert_eq!(of_crate(&after), 0);
    assert!(of_crate(&kept) > 100, "not without carving");
    let walls = |mesh: &MeshData| mesh.positions.len() - of_crate(mesh);
    assert!(walls(&after) * 100 > walls(&before) * 99, "the walls stand");
}

#[test]
fn what_has_gone_is_gone_once_three_images_saw_through_it() {
    let [full, empty] = with_and_without();
    let t = looking([-1.5, 0.0, 0.7], [1.0, 0.0, 0.7]);
    let mut grid = SurfaceGrid::new(params()).unwrap();
    let mut look = |shapes: &[Shape]| {
        grid.integrate_depth(&images(shapes, &t).0, None, &camera(), &t).unwrap();
        grid.mesh(&MeshOptions::default()).unwrap()
    };
    let before = (0..80).map(|_| look(&full)).last().unwrap();
    assert!(of_crate(&before) > 100);
    let after = (0..3).map(|_| look(&empty)).last().unwrap();
    assert_eq!(of_crate(&after), 0);
}

#[test]
fn nothing_that_stands_is_carved_by_looking_again_from_elsewhere() {
    let shapes = with_and_without()[0].clone();
    let (mut carving, mut keeping) =
        (SurfaceGrid::new(params()).unwrap(), SurfaceGrid::new(SurfaceParams { carve: false, ..params() }).unwrap());
    for i in 0..10 {
        let t = Pose::translation(-1.4 + 0.27 * f64::from(i), 0.9 - 0.1 * f64::from(i), 1.0 + 0.04 * f64::from(i));
        let scan = scan(&shapes, &t, (-1.57, 1.57), 0.012);
        carving.integrate(&t, &scan).unwrap();
        keeping.integrate(&t, &scan).unwrap();
    }
    let count = |grid: &SurfaceGrid| grid.mesh(&MeshOptions::default()).unwrap().triangles.len();
    let (carved, kept) = (count(&carving), count(&keeping));
    assert!(carved.abs_diff(kept) * 200 <= kept, "{carved} of {kept}");
}

#[test]
fn a_clone_does_not_see_later_changes() {
    let t = looking([-1.5, 0.0, 0.7], [1.0, 0.0, 0.7]);
    let mut grid = SurfaceGrid::new(params()).unwrap();
    grid.integrate_depth(&images(&[BALL], &t).0, None, &camera(), &t).unwrap();
    let (before, mesh) = (grid.clone(), grid.mesh(&MeshOptions::default()).unwrap());
    grid.integrate_depth(&images(&[WALLS], &t).0, None, &camera(), &t).unwrap();
    assert!(before != grid && before.mesh(&MeshOptions::default()).unwrap() == mesh);
    assert!(before.memory_bytes() < grid.memory_bytes());
}

#[test]
fn a_mesh_within_a_region_is_that_part_of_the_whole() {
    let grid = ball_from_images();
    let whole = grid.mesh(&MeshOptions::default()).unwrap();
    let region = Aabb3 { min: Point3::new(0.1, -0.2, 0.3), max: Point3::new(0.9, 0.33, 1.2) };
    let part = grid.mesh(&MeshOptions { region: Some(region), ..MeshOptions::default() }).unwrap();
    let corners = |mesh: &MeshData, t: &[u32; 3]| t.map(|v| mesh.positions[v as usize]);
    let is_in = |mesh: &MeshData, t: &&[u32; 3]| corners(mesh, t).iter().any(|p| region.contains(&p.cast()));
    let expected: Vec<_> = whole.triangles.iter().filter(|t| is_in(&whole, t)).map(|t| corners(&whole, t)).collect();
    let found: Vec<_> = part.triangles.iter().map(|t| corners(&part, t)).collect();
    assert!(expected.len() > 100 && expected.len() < whole.triangles.len());
    assert_eq!(found, expected);
}

#[test]
fn limits_of_a_mesh_are_said() {
    let grid = ball_from_images();
    let num = grid.mesh(&MeshOptions::default()).unwrap().triangles.len();
    let limited = |max_triangles: usize| grid.mesh(&MeshOptions { max_triangles, ..MeshOptions::default() });
    assert!(limited(num).is_ok());
    assert_eq!(limited(num - 1), Err(MappingError::MeshTooLarge { limit: num - 1 }));
    let weighed = |min_weight: f32| grid.mesh(&MeshOptions { min_weight, ..MeshOptions::default() });
    assert!(matches!(weighed(0.0), Err(MappingError::InvalidParam { field: "min_weight", .. })));
    assert!(matches!(weighed(f32::NAN), Err(MappingError::InvalidParam { field: "min_weight", .. })));
    assert!(weighed(200.0).unwrap().triangles.is_empty(), "nothing was seen so often");
    let region = Some(Aabb3::empty());
    assert_eq!(grid.mesh(&MeshOptions { region, ..MeshOptions::default() }), Err(MappingError::RegionEmpty));
}

#[test]
fn images_that_do_not_fit_are_refused_and_change_nothing() {
    let mut grid = SurfaceGrid::new(params()).unwrap();
    let (depth, color) = images(&[BALL], &looking([-1.5, 0.0, 0.5], [0.0, 0.0, 0.5]));
    let small = RgbImage::new(2, 1, vec![0; 6]).unwrap();
    let bent = CameraIntrinsics { distortion: Distortion::Fisheye([0.0; 4]), ..camera() };
    let (narrow, flat) = (DepthImage::new(1, 1, vec![1.0]).unwrap(), CameraIntrinsics { fx: 0.0, ..camera() });
    let mut nowhere = Pose::identity();
    nowhere.translation.vector.x = f64::NAN;
    let here = Pose::identity();
    let named = |e: Result<(), MappingError>| match e {
        Err(MappingError::Scan(
            GeometryError::ShapeMismatch { field, .. } | GeometryError::OutOfRange { field, .. },
        )) => field,
        other => panic!("{other:?}"),
    };
    assert_eq!(named(grid.integrate_depth(&narrow, None, &camera(), &here)), "depth columns");
    assert_eq!(named(grid.integrate_depth(&depth, Some(&small), &camera(), &here)), "colour columns");
    assert_eq!(named(grid.integrate_depth(&depth, Some(&color), &bent, &here)), "distortion");
    assert_eq!(named(grid.integrate_depth(&depth, Some(&color), &flat, &here)), "fx");
    assert_eq!(grid.integrate_depth(&depth, None, &camera(), &nowhere), Err(MappingError::PoseNotFinite));
    assert!(grid.is_empty());
    // Where voxels have no numbers, nothing is known.
    grid.integrate_depth(&depth, None, &camera(), &Pose::translation(1e12, 0.0, 0.0)).unwrap();
    assert!(grid.is_empty());
}

#[test]
fn parameters_out_of_bounds_are_named() {
    let named = |p: SurfaceParams| match SurfaceGrid::new(p) {
        Err(MappingError::InvalidParam { field, .. }) => field,
        other => panic!("{other:?}"),
    };
    let p = SurfaceParams::default();
    assert_eq!(named(SurfaceParams { voxel_size_m: f64::NAN, ..p }), "voxel_size_m");
    assert_eq!(named(SurfaceParams { voxel_size_m: 0.001, ..p }), "voxel_size_m");
    assert_eq!(named(SurfaceParams { truncation_m: Some(0.05), ..p }), "truncation_m");
    assert_eq!(named(SurfaceParams { truncation_m: Some(1.0), ..p }), "truncation_m");
    assert_eq!(named(SurfaceParams { range_min_m: -0.1, ..p }), "range_min_m");
    assert_eq!(named(SurfaceParams { range_max_m: Some(0.05), ..p }), "range_max_m");
    assert_eq!(named(SurfaceParams { range_max_m: Some(501.0), ..p }), "range_max_m");
    assert_eq!(named(SurfaceParams { max_weight: 0.5, ..p }), "max_weight");
    assert_eq!(named(SurfaceParams { max_weight: 256.0, ..p }), "max_weight");
    assert!(SurfaceGrid::new(p).is_ok());
}
