use super::*;
use crate::{FormatError, Limits, Place};
use nalgebra::Point3;
use percept_geometry::Voxel;
use proptest::prelude::*;

const SCAN_OT: &[u8] = include_bytes!("../../tests/octomap/scan.ot");
const SCAN_BT: &[u8] = include_bytes!("../../tests/octomap/scan.bt");
const COLOR_OT: &[u8] = include_bytes!("../../tests/octomap/color.ot");
const COLOR_BT: &[u8] = include_bytes!("../../tests/octomap/color.bt");

fn read(bytes: &[u8]) -> OctreeMap {
    decode(bytes, &Limits::default()).unwrap()
}

fn leaf(key: [u16; 3], depth: u8, log_odds: f32) -> OctreeLeaf {
    OctreeLeaf { key, depth, log_odds }
}

/// What OctoMap says of a map: number of nodes, and the leaves in its order.
fn as_octomap_says(text: &str) -> (u64, Vec<OctreeLeaf>) {
    let mut lines = text.lines();
    let num_nodes = lines.next().and_then(|l| l.split(' ').nth(3)).unwrap().parse().unwrap();
    let leaf_of = |line: &str| {
        let fields: Vec<&str> = line.split(' ').collect();
        let key = [0, 1, 2].map(|i| fields[i].parse().unwrap());
        leaf(key, fields[3].parse().unwrap(), fields[4].parse().unwrap())
    };
    (num_nodes, lines.map(leaf_of).collect())
}

#[test]
fn what_octomap_wrote_reads_as_octomap_reads_it() {
    for (bytes, text) in [
        (SCAN_OT, include_str!("../../tests/octomap/scan_ot.txt")),
        (SCAN_BT, include_str!("../../tests/octomap/scan_bt.txt")),
        (COLOR_OT, include_str!("../../tests/octomap/color_ot.txt")),
    ] {
        let (map, (num_nodes, leaves)) = (read(bytes), as_octomap_says(text));
        assert_eq!((map.resolution_m(), map.num_nodes()), (0.25, num_nodes));
        assert_eq!(map.leaves(), OctreeMap::new(0.25, leaves).unwrap().leaves());
    }
    assert!(read(SCAN_OT).leaves().iter().any(|l| l.depth < MAX_DEPTH));
}

#[test]
fn what_is_written_is_what_octomap_writes() {
    assert_eq!(encode(&read(SCAN_OT), Encoding::Full), SCAN_OT);
    assert_eq!(encode(&read(SCAN_OT), Encoding::Binary), SCAN_BT);
    assert_eq!(encode(&read(SCAN_BT), Encoding::Binary), SCAN_BT);
    for (bytes, encoding) in [
        (include_bytes!("../../tests/octomap/empty.ot").as_slice(), Encoding::Full),
        (include_bytes!("../../tests/octomap/empty.bt"), Encoding::Binary),
    ] {
        assert_eq!(encode(&OctreeMap::new(0.25, vec![]).unwrap(), encoding), bytes);
        assert_eq!(read(bytes).num_nodes(), 0);
    }
}

#[test]
fn trees_with_more_than_occupancy_are_read_as_occupancy_and_others_named() {
    let color = read(COLOR_OT);
    assert_eq!(color.leaves(), [leaf([32767, 32767, 32760], 16, -0.4), leaf([32768; 3], 15, 1.0)]);
    assert_eq!(read(COLOR_BT), read(&encode(&color, Encoding::Binary)));
    let stamped = read(include_bytes!("../../tests/octomap/stamped.ot"));
    assert_eq!(stamped.leaves(), [leaf([0, 65535, 32768], 16, 1.25), leaf([1, 65535, 32768], 16, -1.25)]);
    let counting = decode(include_bytes!("../../tests/octomap/counting.ot"), &Limits::default());
    let supported = "OcTree, OcTreeStamped and ColorOcTree";
    let value = "OcTreeBase".to_owned();
    assert_eq!(counting, Err(FormatError::Unsupported { format: "OctoMap", field: "id", value, supported }));
}

#[test]
fn a_leaf_above_the_finest_depth_stays_one_and_says_what_it_holds() {
    let map = OctreeMap::new(0.1, vec![leaf([32770, 32768, 32766], 15, 1.5), leaf([0, 0, 0], 16, -1.0)]).unwrap();
    let large = map.leaves()[1];
    assert_eq!((large.lowest_voxel(), large.edge_voxels(), map.edge_m(&large)), (Voxel::new(2, 0, -2), 2, 0.2));
    assert!((map.center(&large) - Point3::new(0.3, 0.1, -0.1)).norm() < 1e-12);
    assert_eq!(map.log_odds(Voxel::new(3, 1, -1)), Some(1.5));
    assert_eq!(map.log_odds(Voxel::new(4, 1, -1)), None);
    assert_eq!(map.log_odds(Voxel::new(-32768, -32768, -32768)), Some(-1.0));
    assert_eq!(map.log_odds(Voxel::new(32768, 0, 0)), None);
    let mut voxels = vec![];
    map.for_each_voxel(9, |v, log_odds| voxels.push((v, log_odds))).unwrap();
    assert_eq!(voxels.len(), 9);
    assert!(voxels.iter().all(|&(v, log_odds)| map.log_odds(v) == Some(log_odds)));
    let error = map.for_each_voxel(8, |_, _| unreachable!()).unwrap_err();
    assert_eq!(error, FormatError::TooLarge { field: "num_voxels", value: 9, limit: 8 });
}

#[test]
fn space_all_of_one_kind_survives() {
    let all = |log_odds| OctreeMap::new(1.0, vec![leaf([0; 3], 0, log_odds)]).unwrap();
    assert_eq!(read(&encode(&all(-1.0), Encoding::Full)), all(-1.0));
    assert_eq!(read(&encode(&all(1.0), Encoding::Binary)).leaves()[0].depth, 0);
    let free = read(&encode(&all(-1.0), Encoding::Binary));
    assert_eq!((free.leaves().len(), free.num_nodes(), free.num_voxels()), (8, 9, 1 << 48));
    assert!(free.leaves().iter().all(|l| !l.is_occupied()));
}

#[test]
fn leaves_that_make_no_map_are_named() {
    let error = |leaves: Vec<OctreeLeaf>| OctreeMap::new(0.1, leaves).unwrap_err().to_string();
    assert!(error(vec![leaf([0; 3], 17, 0.0)]).contains("depth of leaf 0 is '17'"));
    assert!(error(vec![leaf([1, 0, 0], 15, 0.0)]).contains("key of leaf 0 is '[1, 0, 0]'"));
    assert!(error(vec![leaf([3, 3, 3], 16, 0.0), leaf([2, 2, 2], 15, 0.0)]).contains("outside of all other leaves"));
    assert!(error(vec![leaf([0; 3], 16, f32::NAN)]).contains("log_odds"));
    assert!(OctreeMap::new(f64::NAN, vec![]).is_err() && OctreeMap::new(0.0, vec![]).is_err());
    assert_eq!(OctreeLeaf::of_voxel(Voxel::new(32768, 0, 0), 0.0), None);
    assert_eq!(OctreeLeaf::of_voxel(Voxel::new(i32::MAX, 0, 0), 0.0), None);
}

/// A file of `.bt` or `.ot` with such nodes.
fn file(encoding: Encoding, size: &str, nodes: &[u8]) -> Vec<u8> {
    let head = format!("{}\nid OcTree\nsize {size}\nres 0.1\ndata\n", encoding.magic());
    [head.as_bytes(), nodes].concat()
}

#[test]
fn a_file_cut_anywhere_is_an_error() {
    for bytes in [SCAN_OT, SCAN_BT, COLOR_OT, COLOR_BT] {
        for end in 0..bytes.len() {
            assert!(decode(&bytes[..end], &Limits::default()).is_err(), "cut at {end} of {}", bytes.len());
        }
    }
}

#[test]
fn forged_counts_are_found_before_memory_is_taken() {
    let limits = Limits::default();
    let error = |bytes: Vec<u8>| decode(&bytes, &limits).unwrap_err();
    for encoding in [Encoding::Binary, Encoding::Full] {
        let declared = error(file(encoding, "4294967295", &[0; 16]));
        assert_eq!(declared, FormatError::TooLarge { field: "num_nodes", value: 4_294_967_295, limit: 20_000_000 });
        assert!(matches!(error(file(encoding, "19000000", &[0; 16])), FormatError::Truncated { available: 16, .. }));
        assert!(matches!(error(file(encoding, "-1", &[0; 16])), FormatError::Malformed { place: Place::Line(3), .. }));
    }
    // Two free children, and a root with one child.
    for size in ["1", "2", "4"] {
        assert!(error(file(Encoding::Binary, size, &[0b0101, 0, 0, 0])).to_string().contains("size is"), "{size}");
    }
    let root = [0, 0, 0, 0, 1, 0, 0, 128, 63, 0];
    assert!(decode(&file(Encoding::Full, "2", &root), &limits).is_ok());
    assert!(error(file(Encoding::Full, "1", &root)).to_string().contains("size is '1'"));
}

#[test]
fn nodes_deeper_than_the_tree_are_refused() {
    let limits = Limits::default();
    // Every node has one inner child, the first.
    let binary = file(Encoding::Binary, "17", &[3, 0].repeat(17));
    assert!(decode(&binary, &limits).unwrap_err().to_string().contains("depth of a node"));
    let full = file(Encoding::Full, "18", &[0, 0, 0, 0, 1].repeat(18));
    assert!(decode(&full, &limits).unwrap_err().to_string().contains("depth of a node"));
    let deepest = [[0, 0, 0, 0, 1].repeat(16), vec![0, 0, 0, 0, 0]].concat();
    assert_eq!(read(&file(Encoding::Full, "17", &deepest)).leaves(), [leaf([0; 3], 16, 0.0)]);
    let no_children = file(Encoding::Binary, "2", &[3, 0, 0, 0]);
    assert!(decode(&no_children, &limits).unwrap_err().to_string().contains("children of an inner node"));
    let nan = file(Encoding::Full, "1", &[0, 0, 192, 127, 0]);
    assert!(decode(&nan, &limits).unwrap_err().to_string().contains("log-odds is 'NaN'"));
}

#[test]
fn bad_headers_are_named_and_odd_ones_read() {
    let error = |text: &str| decode(text.as_bytes(), &Limits::default()).unwrap_err().to_string();
    let head = "# Octomap OcTree file v2\n";
    assert!(error("ply\n").contains("first line"));
    for res in ["0", "-0.1", "NaN", "inf"] {
        assert!(error(&format!("{head}id OcTree\nsize 0\nres {res}\ndata\n")).contains("res is"), "{res}");
    }
    assert_eq!(error(&format!("{head}size 0\nres 1\ndata\n")), "OctoMap: id is missing");
    assert_eq!(error(&format!("{head}id OcTree\nres 1\ndata\n")), "OctoMap: size is missing");
    assert_eq!(error(&format!("{head}id OcTree\nsize 0\ndata\n")), "OctoMap: res is missing");
    assert_eq!(error(&format!("{head}id OcTree\nsize 0\nres 1\n")), "OctoMap: data is missing");
    let odd = format!("{head}# by hand\r\nid 1 size 0\r\nframe map\nres 5e-2\r\ndata\r\n");
    assert_eq!(read(odd.as_bytes()).resolution_m(), 0.05);
}

/// Leaves of all depths near the centre of space, none overlapping, with few values so that some can be merged.
fn leaves() -> impl Strategy<Value = Vec<OctreeLeaf>> {
    prop::collection::vec((0u16..16, 0u16..16, 0u16..16, 13u8..=16, 0i8..3), 0..300).prop_map(|drawn| {
        let mut leaves: Vec<OctreeLeaf> = vec![];
        for (x, y, z, depth, value) in drawn {
            let edge = 1 << (16 - depth);
            // 32760 is a multiple of every edge.
            let key = [x, y, z].map(|k| 32760 + k / edge * edge);
            let new = leaf(key, depth, f32::from(value) - 1.0);
            let overlaps = |old: &OctreeLeaf| {
                let edge = new.edge_voxels().max(old.edge_voxels());
                (0..3).all(|i| u32::from(old.key[i]) / edge == u32::from(new.key[i]) / edge)
            };
            if !leaves.iter().any(overlaps) {
                leaves.push(new);
            }
        }
        leaves
    })
}

proptest! {
    #[test]
    fn every_voxel_survives_and_pruning_leaves_nothing_to_prune(leaves in leaves(), resolution_m in 1e-3..10.0f64) {
        let map = OctreeMap::new(resolution_m, leaves).unwrap();
        let full = read(&encode(&map, Encoding::Full));
        prop_assert_eq!(&full, &map.pruned());
        prop_assert_eq!(&full.pruned(), &full);
        prop_assert_eq!(full.num_voxels(), map.num_voxels());
        let binary = read(&encode(&map, Encoding::Binary));
        prop_assert!(binary.leaves().len() <= full.leaves().len());
        map.for_each_voxel(u64::MAX, |v, log_odds| {
            assert_eq!(full.log_odds(v), Some(log_odds));
            assert_eq!(binary.log_odds(v).map(|l| l >= 0.0), Some(log_odds >= 0.0));
        }).unwrap();
        prop_assert_eq!(binary.num_voxels(), map.num_voxels());
    }

    #[test]
    fn damaged_bytes_never_panic(
        kind in 0usize..4, hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)
    ) {
        let mut bytes = [SCAN_OT, SCAN_BT, COLOR_OT, COLOR_BT][kind].to_vec();
        for (at, value) in hits {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(map) = decode(&bytes, &Limits { max_points: 10_000, ..Limits::default() }) {
            let again = OctreeMap::new(map.resolution_m(), map.leaves().to_vec()).unwrap();
            prop_assert_eq!(again, map);
        }
    }
}
