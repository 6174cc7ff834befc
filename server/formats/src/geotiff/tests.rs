use super::*;
use nalgebra::Point2;
use proptest::prelude::*;

fn map(width: usize, height: usize, cells: Vec<i8>) -> GridMap {
    GridMap { geometry: GridGeometry::new(0.05, Point2::new(-1.5, 2.25)), width, height, cells }
}

/// PackBits undone, by the rule of section 9.
fn unpack(bytes: &[u8]) -> Vec<u8> {
    let (mut out, mut at) = (vec![], 0);
    while at < bytes.len() {
        let n = bytes[at] as i8;
        if n >= 0 {
            out.extend(&bytes[at + 1..at + 2 + n as usize]);
            at += 2 + n as usize;
        } else {
            assert_ne!(n, -128);
            out.extend(std::iter::repeat_n(bytes[at + 1], 1 + n.unsigned_abs() as usize));
            at += 2;
        }
    }
    out
}

/// Type, count and value of a tag, as a reader follows them.
fn tag(tiff: &[u8], number: u16) -> (u16, usize, &[u8]) {
    let short = |at: usize| u16::from_le_bytes([tiff[at], tiff[at + 1]]);
    let long = |at: usize| u32::from_le_bytes(tiff[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&tiff[..4], long(4) % 2), (b"II*\0".as_slice(), 0));
    let directory = long(4);
    let places = (0..short(directory)).map(|i| directory + 2 + 12 * usize::from(i));
    let numbers: Vec<u16> = places.clone().map(short).collect();
    assert!(numbers.is_sorted());
    let at = places.clone().find(|&at| short(at) == number).unwrap();
    let (kind, count) = (short(at + 2), long(at + 4));
    let bytes = count * [0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8][usize::from(kind)];
    let value = if bytes <= 4 { at + 8 } else { long(at + 8) };
    (kind, count, &tiff[value..value + bytes])
}

fn longs(value: &[u8]) -> Vec<usize> {
    value.as_chunks::<4>().0.iter().map(|&b| u32::from_le_bytes(b) as usize).collect()
}

fn doubles(value: &[u8]) -> Vec<f64> {
    value.as_chunks::<8>().0.iter().map(|&b| f64::from_le_bytes(b)).collect()
}

#[test]
fn a_grid_says_where_it_lies() {
    let tiff = encode(&map(3, 2, vec![0, 100, -1, 1, 2, 3]), "map of room 7").unwrap();
    assert_eq!(doubles(tag(&tiff, 33550).2), [0.05, 0.05, 0.0]);
    assert_eq!(doubles(tag(&tiff, 33922).2), [0.0, 0.0, 0.0, -1.5, 2.35, 0.0]);
    assert_eq!(tag(&tiff, 34737).2, b"map of room 7|\0");
    assert_eq!(tag(&tiff, 42113).2, b"255\0");
    let keys: Vec<u16> = tag(&tiff, 34735).2.as_chunks::<2>().0.iter().map(|&b| u16::from_le_bytes(b)).collect();
    assert_eq!(keys[..4], [1, 1, 0, 4]);
    assert_eq!(keys[12..16], [1026, 34737, 14, 0]);
}

#[test]
fn a_world_file_begins_at_the_upper_left_centre() {
    let geometry = GridGeometry::new(0.5, Point2::new(-1.0, 2.0));
    assert_eq!(world_file(&geometry, 4), "0.5\n0.0\n0.0\n-0.5\n-0.75\n3.75\n");
}

#[test]
fn what_fits_no_file_is_an_error() {
    let error = |map: &GridMap, frame: &str| encode(map, frame).unwrap_err().to_string();
    assert!(error(&map(0, 3, vec![]), "map").contains("size is '0 x 3'"));
    assert!(error(&map(2, 3, vec![0]), "map").contains("expected 6 elements"));
    for frame in ["", "a|b", "Raum für Gäste", "a\nb"] {
        assert!(error(&map(1, 1, vec![0]), frame).contains("printable ASCII"), "{frame}");
    }
}

proptest! {
    #[test]
    fn rows_unpack_to_what_they_were(row in prop::collection::vec(prop_oneof![Just(7u8), 0..3u8, any::<u8>()], 0..700)) {
        let mut packed = vec![];
        pack_row(&row, &mut packed);
        prop_assert_eq!(unpack(&packed), &row[..]);
        prop_assert!(packed.len() <= row.len() + row.len().div_ceil(128));
    }

    #[test]
    fn cells_come_back_from_all_strips(width in 1usize..300, height in 1usize..500, seed in any::<u64>()) {
        let value = |i: usize| ((i as u64 / 5).wrapping_mul(seed | 1) >> 40) % 102;
        let map = map(width, height, (0..width * height).map(|i| value(i) as i8 - 1).collect());
        let tiff = encode(&map, "map").unwrap();
        prop_assert_eq!((longs(tag(&tiff, 256).2), longs(tag(&tiff, 257).2)), (vec![width], vec![height]));
        let (offsets, sizes) = (longs(tag(&tiff, 273).2), longs(tag(&tiff, 279).2));
        prop_assert_eq!(offsets.len(), height.div_ceil(longs(tag(&tiff, 278).2)[0]));
        let image: Vec<u8> = offsets.iter().zip(&sizes).flat_map(|(&at, n)| unpack(&tiff[at..at + n])).collect();
        let cells: Vec<u8> = map.cells.chunks_exact(width).rev().flatten().map(|&c| c as u8).collect();
        prop_assert_eq!(image, cells);
    }
}
