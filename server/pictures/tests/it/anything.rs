//! Whatever is given, a picture or an error comes out.

use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{GridGeometry, ObjectClass, OrientedBox3, PointCloud, Pose, se3};
use percept_mapping::{DenseGrid, DenseHeights, MeshData, VoxelBlock};
use percept_pictures::{
    GridView, MAX_EDGE, MapObject, MapRoom, Overlay, PathDrawing, PathQuantity, PictureError, View, ViewFrom, Zone,
    ZoneKind, ZoneMask, before_after, cloud_view, heights, mesh_view, overview, path_picture, voxels_slice,
    voxels_view,
};
use proptest::prelude::*;
use std::sync::Arc;

/// Ordinary numbers, and others.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -20.0..20.0f64,
        1 => any::<f64>(),
        1 => prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(0.0), Just(-0.0), Just(1e-300), Just(f64::MAX)],
    ]
}

fn single() -> impl Strategy<Value = f32> {
    number().prop_map(|v| v as f32)
}

fn point() -> impl Strategy<Value = Point3<f32>> {
    (single(), single(), single()).prop_map(|(x, y, z)| Point3::new(x, y, z))
}

fn flat_point() -> impl Strategy<Value = Point2<f64>> {
    (number(), number()).prop_map(|(x, y)| Point2::new(x, y))
}

fn pose() -> impl Strategy<Value = Pose> {
    (number(), number(), number()).prop_map(|(x, y, yaw)| se3::from_xy_yaw(x, y, yaw))
}

fn geometry() -> impl Strategy<Value = GridGeometry> {
    (prop_oneof![0.01..0.5f64, number()], flat_point())
        .prop_map(|(resolution, origin)| GridGeometry::new(resolution, origin))
}

fn zone() -> impl Strategy<Value = Zone> {
    (proptest::collection::vec(flat_point(), 0..6), number(), any::<bool>()).prop_map(|(polygon, share, keep_out)| {
        let kind = if keep_out { ZoneKind::KeepOut } else { ZoneKind::SpeedLimit { share } };
        Zone { polygon, kind }
    })
}

fn object() -> impl Strategy<Value = MapObject> {
    (number(), number(), number(), 0usize..7, any::<Option<u64>>()).prop_map(|(x, y, size, class, id)| MapObject {
        id,
        class: ObjectClass::BUILT_IN[class],
        bbox: OrientedBox3::upright(Point3::new(x, y, 0.5), Vector3::repeat(size), y),
    })
}

fn view() -> impl Strategy<Value = View> {
    let from = prop_oneof![
        Just(ViewFrom::Above),
        (number(), prop_oneof![0.0..1.57f64, number()])
            .prop_map(|(azimuth_rad, elevation_rad)| ViewFrom::Oblique { azimuth_rad, elevation_rad })
    ];
    (from, proptest::option::of(number()), 250usize..500).prop_map(|(from, cut_above_m, edge_px)| View {
        from,
        cut_above_m,
        edge_px,
    })
}

fn sound<T>(result: Result<T, PictureError>, size: impl Fn(&T) -> (usize, usize)) {
    if let Ok(image) = result {
        let (width, height) = size(&image);
        assert!(width > 0 && height > 0 && width.max(height) <= MAX_EDGE, "{width} x {height}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn of_grids(
        geometry in geometry(),
        other in geometry(),
        (width, height) in (0usize..30, 0usize..30),
        seed in any::<u8>(),
        trajectory in proptest::collection::vec(pose(), 0..8),
        objects in proptest::collection::vec(object(), 0..8),
        zones in proptest::collection::vec(zone(), 0..4),
        path in proptest::collection::vec(flat_point(), 0..6),
        values in proptest::collection::vec(number(), 0..8),
        title in ".{0,200}",
        tolerance in prop_oneof![Just(0.0), number()],
    ) {
        let room = MapRoom {
            label: title.clone(),
            center: path.first().copied().unwrap_or_default(),
            outline: path.clone(),
            doors: path.windows(2).map(|w| [w[0], w[1]]).collect(),
        };
        let rooms = vec![room; path.len() % 3];
        let cells: Vec<i8> = (0..width * height).map(|i| (i as i8).wrapping_mul(seed as i8)).collect();
        let grid = GridView { geometry, width, height, cells: &cells };
        let size = |i: &percept_geometry::RgbImage| (i.width(), i.height());
        let valued = cells.iter().map(|c| (*c).clamp(-1, 100)).collect();
        let kinds = vec![None, Some(ZoneKind::KeepOut), Some(ZoneKind::SpeedLimit { share: tolerance })];
        let masks =
            vec![ZoneMask { grid: Arc::new(DenseGrid { geometry: other, width, height, cells: valued }), kinds }];
        let drawing = PathDrawing {
            values: if values.len() == trajectory.len() { values } else { vec![] },
            poses: trajectory.clone(),
            quantity: PathQuantity::Cost,
            footprint: path.clone(),
            goal: trajectory.first().map(Into::into),
            masks: masks.clone(),
            notes: vec![title.clone()],
            blocking: path.first().copied(),
            reason: Some(title.clone()),
            zones: zones.clone(),
            ..PathDrawing::default()
        };
        sound(path_picture(grid, &drawing, &title), size);
        sound(overview(grid, &Overlay { trajectory, robot: None, objects, zones, masks, path, rooms }, &title), size);
        sound(before_after(grid, GridView { geometry: other, ..grid }, tolerance, &title), |(i, _)| size(i));
    }

    #[test]
    fn of_heights(geometry in geometry(), width in 0usize..20, ground in proptest::collection::vec(single(), 0..200)) {
        let height = ground.len() / width.max(1);
        let n = if width == 0 { 0 } else { width * height };
        let map = DenseHeights {
            geometry,
            width,
            height,
            ground_m: ground[..n].to_vec(),
            sigma_m: vec![0.1; n],
            top_m: vec![f32::NAN; n],
            overhang_m: vec![f32::NAN; n],
            num_keyframes: vec![1; n],
            is_drop: (0..n).map(|i| i % 17 == 3).collect(),
        };
        sound(heights(&map, "heights"), |i| (i.width(), i.height()));
    }

    #[test]
    fn of_space(
        view in view(),
        points in proptest::collection::vec(point(), 0..40),
        triangles in proptest::collection::vec(any::<[u8; 3]>(), 0..40),
        normals in any::<bool>(),
        keys in proptest::collection::vec(prop_oneof![any::<[i32; 3]>(), Just([0, 1, 0]), Just([0, 0, 0])], 0..5),
        size in prop_oneof![0.01..1.0f64, number()],
        z in number(),
    ) {
        let mesh = MeshData {
            normals: if normals { points.iter().map(|p| p.coords).collect() } else { vec![] },
            colors: vec![],
            triangles: triangles.iter().map(|t| t.map(|i| u32::from(i % 48))).collect(),
            positions: points.clone(),
        };
        let image_size = |i: &percept_geometry::RgbImage| (i.width(), i.height());
        sound(mesh_view(&mesh, &view, "mesh"), image_size);
        sound(cloud_view(&PointCloud::from_positions(points), &view, "cloud"), image_size);
        let percent = |i: usize| if i.is_multiple_of(7) { 100 } else { (i % 5) as i8 - 1 };
        let blocks: Vec<VoxelBlock> = keys
            .into_iter()
            .map(|key| VoxelBlock { key, percent: Box::new(std::array::from_fn(percent)) })
            .collect();
        sound(voxels_view(&blocks, size, &view, "voxels"), image_size);
        sound(voxels_slice(&blocks, size, z, "slice"), image_size);
    }
}
