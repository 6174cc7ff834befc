use super::grid::params;
use crate::scans::spatial;
use nalgebra::Point3;
use percept_geometry::{Pose, se3};
use percept_mapping::{Damaged, Layer, Reader, SurfaceGrid};
use proptest::prelude::*;

fn grid(points: &[([f32; 3], [u8; 3])], is_colored: bool) -> SurfaceGrid {
    let mut scan = spatial(0.4, points.iter().map(|p| Point3::from(p.0)).collect());
    scan.hits.colors = is_colored.then(|| points.iter().map(|p| p.1).collect());
    let mut grid = SurfaceGrid::new(params()).unwrap();
    grid.integrate(&Pose::identity(), &scan).unwrap();
    grid.integrate(&se3::from_xy_yaw(0.1, -0.2, 0.3), &scan).unwrap();
    grid
}

fn bytes(grid: &SurfaceGrid) -> Vec<u8> {
    let mut out = vec![];
    grid.encode(&mut out);
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_part_that_was_stored_is_the_part_that_is_read(
        points in prop::collection::vec((prop::array::uniform3(-3.0..3.0f32), prop::array::uniform3(0..=255u8)), 0..60),
        is_colored: bool,
    ) {
        let grid = grid(&points, is_colored);
        let stored = bytes(&grid);
        let read = SurfaceGrid::decode(&params(), &mut Reader::new(&stored)).unwrap();
        prop_assert!(read == grid);
        prop_assert_eq!(bytes(&read), stored);
        prop_assert_eq!(read.memory_bytes(), grid.memory_bytes());
    }

    #[test]
    fn damaged_bytes_are_refused_or_read_and_never_a_panic(
        points in prop::collection::vec((prop::array::uniform3(-2.0..2.0f32), prop::array::uniform3(0..=255u8)), 1..20),
        cut in 0.0..1.0f64, flips in prop::collection::vec((0.0..1.0f64, 1..=255u8), 1..4),
    ) {
        let stored = bytes(&grid(&points, true));
        let short = &stored[..(stored.len() as f64 * cut) as usize];
        prop_assert_eq!(SurfaceGrid::decode(&params(), &mut Reader::new(short)).err(), Some(Damaged));
        let mut flipped = stored.clone();
        for (at, bits) in flips {
            flipped[(stored.len() as f64 * at) as usize] ^= bits;
        }
        // What is read, whatever it is, can be used.
        if let Ok(read) = SurfaceGrid::decode(&params(), &mut Reader::new(&flipped)) {
            let mesh = read.mesh(&percept_mapping::MeshOptions::default()).unwrap();
            prop_assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < mesh.positions.len()));
        }
    }
}

#[test]
fn a_count_beyond_what_there_is_takes_no_memory() {
    for count in [1u32, 1 << 21, u32::MAX] {
        let mut stored = count.to_le_bytes().to_vec();
        stored.extend([0; 40]);
        assert_eq!(SurfaceGrid::decode(&params(), &mut Reader::new(&stored)).err(), Some(Damaged));
    }
}
