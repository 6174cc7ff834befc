use super::grid::{of_crate, params, with_and_without};
use super::scenes::{Shape, errors, scan, topology};
use crate::map::id;
use nalgebra::Point3;
use percept_geometry::{Aabb3, Correction, KeyframeScan, Pose, se3};
use percept_mapping::{Map, MapEntry, MapParams, MappingError, MeshData, MeshOptions, SurfaceGrid};
use std::sync::Arc;

const SCENE: [Shape; 3] = [
    Shape::Room([-3.0, -2.0, 0.0], [3.0, 2.0, 2.4]),
    Shape::Solid([0.4, -0.3, 0.0], [1.0, 0.4, 0.7]),
    Shape::Sphere([-1.5, 0.8, 0.6], 0.4),
];

fn drive(i: usize) -> Pose {
    let mut t = se3::from_xy_yaw(-1.8 + 0.45 * i as f64, -1.0 + 0.03 * i as f64, 0.2 * i as f64);
    t.translation.vector.z = 1.1;
    t
}

/// Where the second half would be if odometry had lost its way between.
fn lost(i: usize) -> Pose {
    if i < 4 { drive(i) } else { se3::from_xy_yaw(0.21, -0.13, 0.07) * drive(i) }
}

fn scans() -> Vec<Arc<KeyframeScan>> {
    (0..8).map(|i| Arc::new(scan(&SCENE, &drive(i), (-1.57, 1.57), 0.014))).collect()
}

fn of_surface() -> MapParams {
    MapParams { surface: params(), ..MapParams::default() }
}

/// Two submaps of four keyframes.
fn built(scans: &[Arc<KeyframeScan>], pose: fn(usize) -> Pose) -> Map {
    let mut map = Map::new(of_surface()).unwrap();
    for (i, scan) in scans.iter().enumerate() {
        let entry = MapEntry { after_gap: i == 4, ..MapEntry::at(pose(i)) };
        map.insert(id(i), &entry, Arc::clone(scan)).unwrap();
    }
    assert_eq!(map.submaps().len(), 2);
    map
}

fn mesh(map: &Map) -> MeshData {
    map.layers().surface.mesh(&MeshOptions::default()).unwrap()
}

#[test]
fn a_map_that_does_not_ask_for_the_surface_has_none_and_pays_nothing() {
    let mut map = Map::new(MapParams::default()).unwrap();
    map.insert(id(0), &MapEntry::at(drive(0)), Arc::clone(&scans()[0])).unwrap();
    let layers = map.layers();
    assert_eq!(layers.surface.tile_keys().count(), 0);
    assert_eq!(layers.surface.mesh(&MeshOptions::default()), Ok(MeshData::default()));
}

#[test]
fn submaps_that_lie_as_they_were_begun_are_one_grid() {
    let scans = scans();
    let ours = mesh(&built(&scans, drive));
    let mut direct = SurfaceGrid::new(params()).unwrap();
    scans.iter().enumerate().for_each(|(i, scan)| direct.integrate(&drive(i), scan).unwrap());
    let theirs = direct.mesh(&MeshOptions::default()).unwrap();
    let (mean, _) = errors(&ours, &SCENE);
    assert!(mean <= 0.3 * params().voxel_size_m, "{mean}");
    let (a, b) = (ours.triangles.len(), theirs.triangles.len());
    assert!(a > 30_000 && a.abs_diff(b) * 100 < b, "{a} triangles, {b} at once");
}

#[test]
fn halves_under_a_correction_are_what_integrating_them_at_once_gives() {
    let scans = scans();
    let mut map = built(&scans, lost);
    let (off, _) = errors(&mesh(&map), &SCENE);
    let correction = Correction { t_map_base: (0..8).map(|i| (id(i), drive(i))).collect() };
    map.correct(&correction, &[]).unwrap();
    let voxel = params().voxel_size_m;
    let moved = mesh(&map);
    let (mean, _) = errors(&moved, &SCENE);
    assert!(off > voxel && mean <= 0.3 * voxel, "before {off}, after {mean}");
    let direct = mesh(&built(&scans, drive));
    let (a, b) = (moved.triangles.len(), direct.triangles.len());
    // Until then its rims are missing, as far as eight voxels around are needed to tell what lies between them.
    assert!(a.abs_diff(b) * 12 < b, "{a} triangles, {b} at once");
    // Built anew, it is the map that its keyframes give.
    while !map.advance(usize::MAX) {}
    assert!(mesh(&map) == direct);
}

#[test]
fn a_later_submap_carves_what_it_saw_through_also_when_it_was_moved() {
    let [full, empty] = with_and_without();
    for shift in [Pose::identity(), se3::from_xy_yaw(0.013, 0.021, 0.05)] {
        let pose = |i: usize| Pose::translation(-0.8 + 0.02 * (i % 4) as f64, 0.1, 0.8);
        let mut map = Map::new(of_surface()).unwrap();
        for i in 0..8 {
            let shapes = if i < 4 { &full } else { &empty };
            let scan = Arc::new(scan(shapes, &pose(i), (-1.57, 1.57), 0.008));
            let t_map_base = if i < 4 { pose(i) } else { shift * pose(i) };
            map.insert(id(i), &MapEntry { after_gap: i == 4, ..MapEntry::at(t_map_base) }, scan).unwrap();
            if i == 3 {
                assert!(of_crate(&mesh(&map)) > 300);
            }
        }
        map.correct(&Correction { t_map_base: (4..8).map(|i| (id(i), pose(i))).collect() }, &[]).unwrap();
        assert_eq!(map.submaps()[1].t_map_submap() == &Pose::identity(), shift == Pose::identity());
        assert_eq!(of_crate(&mesh(&map)), 0);
    }
}

#[test]
fn a_mesh_that_grows_is_the_mesh_that_is_made_at_once_with_any_number_of_threads() {
    let scans = scans();
    let mut map = Map::new(of_surface()).unwrap();
    for (i, scan) in scans.iter().enumerate() {
        map.insert(id(i), &MapEntry::at(drive(i)), Arc::clone(scan)).unwrap();
        mesh(&map);
    }
    let grown = mesh(&map);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let at_once = pool.install(|| {
            let mut map = Map::new(of_surface()).unwrap();
            for (i, scan) in scans.iter().enumerate() {
                map.insert(id(i), &MapEntry::at(drive(i)), Arc::clone(scan)).unwrap();
            }
            mesh(&map)
        });
        assert!(at_once == grown, "{threads} threads");
    }
}

#[test]
fn there_are_no_cracks_between_tiles() {
    // A ball across four tiles: their edges lie at multiples of 64 voxels.
    let ball = Shape::Sphere([0.02, -0.03, 0.6], 0.5);
    let mut map = Map::new(of_surface()).unwrap();
    for i in 0..14 {
        let step = |i: usize| (i % 3) as f64 - 1.0;
        let d = nalgebra::Vector3::new(step(i), step(i / 3), step(i / 9)).normalize();
        for (k, d) in [d, -d].into_iter().filter(|d| d.norm() > 0.5).enumerate() {
            let t = Pose::translation(1.8 * d.x, 1.8 * d.y, 0.6 + 1.8 * d.z);
            let entry = MapEntry { t_odom_base: Pose::identity(), ..MapEntry::at(t) };
            map.insert(id(2 * i + k), &entry, Arc::new(scan(&[ball], &t, (-1.57, 1.57), 0.012))).unwrap();
        }
    }
    let mesh = mesh(&map);
    assert!(map.layers().surface.tile_keys().count() >= 4);
    assert_eq!(topology(&mesh), (0, 2));
}

#[test]
fn a_region_of_the_map_is_that_part_of_the_whole_and_its_triangles_are_bounded() {
    let map = built(&scans(), drive);
    let surface = map.layers().surface;
    let whole = mesh(&map);
    let region = Aabb3 { min: Point3::new(-0.5, -2.2, 0.0), max: Point3::new(0.3, 0.4, 1.0) };
    let options = MeshOptions { region: Some(region), ..MeshOptions::default() };
    let part = surface.mesh(&options).unwrap();
    let corners = |mesh: &MeshData, t: &[u32; 3]| t.map(|v| mesh.positions[v as usize]);
    let is_in = |t: &&[u32; 3]| corners(&whole, t).iter().any(|p| region.contains(&p.cast()));
    let mut expected: Vec<_> = whole.triangles.iter().filter(is_in).map(|t| corners(&whole, t)).collect();
    let mut found: Vec<_> = part.triangles.iter().map(|t| corners(&part, t)).collect();
    let by_bits = |t: &[Point3<f32>; 3]| t.map(|p| [p.x, p.y, p.z].map(f32::to_bits));
    expected.sort_by_key(by_bits);
    found.sort_by_key(by_bits);
    assert!(expected.len() > 1000 && found == expected, "{} and {}", found.len(), expected.len());
    let limited = surface.mesh(&MeshOptions { max_triangles: 1000, ..options });
    assert_eq!(limited, Err(MappingError::MeshTooLarge { limit: 1000 }));
}

#[test]
fn memory_counts_the_surface_and_its_mesh() {
    let scans = scans();
    let map = built(&scans, drive);
    let mut without = Map::new(MapParams::default()).unwrap();
    for (i, scan) in scans.iter().enumerate() {
        without.insert(id(i), &MapEntry::at(drive(i)), Arc::clone(scan)).unwrap();
    }
    // A voxel takes four bytes, and six with a colour.
    let mut direct = SurfaceGrid::new(params()).unwrap();
    scans.iter().enumerate().for_each(|(i, scan)| direct.integrate(&drive(i), scan).unwrap());
    let (blocks, bytes) = (direct.num_blocks(), direct.memory_bytes());
    assert!(bytes > blocks * 512 * 10 && bytes < blocks * 512 * 11 + 40_000_000, "{bytes} of {blocks} blocks");
    assert!(map.memory().layers > without.memory().layers + blocks * 512 * 10);
    let before = map.memory().tiles;
    let mesh = mesh(&map);
    assert!(map.memory().tiles > before + mesh.triangles.len() * 12);
}
