//! OctoMap's .bt and .ot.
#![no_main]
use percept_formats::octomap::{Encoding, decode, encode};
use percept_formats::{Limits, OctreeMap};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let limits = Limits { max_points: 100_000, ..Limits::default() };
    if let Ok(map) = decode(bytes, &limits) {
        assert_eq!(OctreeMap::new(map.resolution_m(), map.leaves().to_vec()).unwrap(), map);
        assert_eq!(decode(&encode(&map, Encoding::Full), &limits).unwrap(), map.pruned());
        let binary = decode(&encode(&map, Encoding::Binary), &limits).unwrap();
        assert_eq!(binary.num_voxels(), map.num_voxels());
    }
});
