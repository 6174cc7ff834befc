use super::*;
use percept_geometry::GrayImage;
use proptest::prelude::*;

fn round_trip(map: &GridMap) -> GridMap {
    let (mut image, mut yaml) = (vec![], vec![]);
    write_pgm(&mut image, map).unwrap();
    write_yaml(&mut yaml, &map.geometry, "map.pgm").unwrap();
    decode(&parse_yaml(&yaml).unwrap(), &image, &Limits::default()).unwrap()
}

#[test]
fn a_map_survives_and_its_first_image_row_is_the_highest_y() {
    let geometry = GridGeometry::new(0.05, Point2::new(-1.23456789, 2.5e-7));
    let map = GridMap { geometry, width: 3, height: 2, cells: vec![0, 100, -1, -1, -1, 0] };
    assert_eq!(round_trip(&map), map);
    let mut image = vec![];
    write_pgm(&mut image, &map).unwrap();
    assert!(image.ends_with(&[205, 205, 254, 254, 0, 205]));
    let graded = GridMap { cells: vec![10, 70, 50, -1, 25, 65], ..map };
    assert_eq!(round_trip(&graded).cells, [0, 100, -1, -1, 0, 100]);
}

#[test]
fn pixels_mean_what_map_server_says() {
    let yaml = |text: &str| {
        parse_yaml(
            format!("image: \"a b.pgm\" # x\nresolution: 0.1\norigin:\n  - -1\n  - 2.5\n  - 0\n{text}").as_bytes(),
        )
        .unwrap()
    };
    let image = b"P5 4 1 255 \x00\xcd\xfe\x80";
    let cells = |text: &str| decode(&yaml(text), image, &Limits::default()).unwrap().cells;
    assert_eq!(yaml("").image, "a b.pgm");
    assert_eq!(yaml("").origin, Point2::new(-1.0, 2.5));
    assert_eq!(cells("free_thresh: 0.196\n"), [100, -1, 0, -1]);
    assert_eq!(cells("free_thresh: 0.25\n"), [100, 0, 0, -1]);
    assert_eq!(cells("negate: 1\nfree_thresh: 0.196\n"), [0, 100, 100, -1]);
    assert_eq!(cells("mode: raw\n"), [0, -1, -1, -1]);
    assert_eq!(cells("mode: scale\nfree_thresh: 0.196\n"), [100, 0, 0, 67]);
}

#[test]
fn bad_yaml_is_named() {
    let error = |text: &str| parse_yaml(text.as_bytes()).unwrap_err().to_string();
    assert_eq!(error("image: a\norigin: [0, 0, 0]\n"), "nav2 map: resolution is missing");
    assert_eq!(
        error("image: a\nresolution: five\n"),
        "nav2 map, line 2: resolution is 'five', expected a finite number"
    );
    assert!(error("image: a\nresolution: 0.1\norigin: [0, 0, east]\n").contains("a finite number"));
    assert!(error("image: a\nresolution: 0.1\norigin: [0, 0]\n").contains("[x, y, yaw]"));
    assert!(error("image: a\nresolution: -0.1\norigin: [0, 0, 0]\n").contains("positive"));
    let rest = "image: a\nresolution: 0.1\norigin: [0, 0, 0]\n";
    assert!(error(&format!("{rest}negate: perhaps\n")).contains("line 4: negate is 'perhaps'"));
    assert!(error(&format!("{rest}occupied_thresh: 65\n")).contains("a share from 0 to 1"));
    assert!(error(&format!("{rest}free_thresh: 0.7\n")).contains("free_thresh is '0.7'"));
    for (word, negate) in [("1", true), ("0", false), ("Yes", true), ("off", false), ("TRUE # light", true)] {
        assert_eq!(parse_yaml(format!("{rest}negate: {word}\n").as_bytes()).unwrap().negate, negate, "{word}");
    }
}

fn yaml(mode: Mode) -> MapYaml {
    let image = "map.png".to_owned();
    let (occupied_thresh, free_thresh) = (0.65, 0.196);
    let origin = Point2::origin();
    MapYaml { image, resolution_m: 0.05, origin, yaw_rad: 0.0, negate: false, occupied_thresh, free_thresh, mode }
}

#[test]
fn a_png_reads_as_its_pgm_does_and_transparency_as_nav2_has_it() {
    let limits = Limits::default();
    let grays: Vec<u8> = (0..=255).collect();
    let png = crate::images::encode_gray_png(&GrayImage::new(16, 16, grays.clone()).unwrap()).unwrap();
    let pgm = [b"P5 16 16 255 ".as_slice(), &grays].concat();
    for mode in [Mode::Trinary, Mode::Scale, Mode::Raw] {
        for negate in [false, true] {
            let yaml = MapYaml { negate, ..yaml(mode) };
            assert_eq!(decode(&yaml, &png, &limits).unwrap(), decode(&yaml, &pgm, &limits).unwrap());
        }
    }
    // White and clear: half as bright in trinary, unknown in scale, not looked at in raw.
    let clear = crate::images::encode_png_la8(2, 1, &[255, 0, 10, 255]).unwrap();
    let cells = |mode| decode(&yaml(mode), &clear, &limits).unwrap().cells;
    assert_eq!(
        (cells(Mode::Trinary), cells(Mode::Scale), cells(Mode::Raw)),
        (vec![-1, -1], vec![-1, 100], vec![-1, 10])
    );
    let colors = percept_geometry::RgbImage::new(2, 1, vec![255, 255, 255, 30, 0, 0]).unwrap();
    let png = crate::images::encode_rgb_png(&colors).unwrap();
    assert_eq!(decode(&yaml(Mode::Trinary), &png, &limits).unwrap().cells, [0, 100]);
}

#[test]
fn a_hundred_thousand_by_as_many_takes_no_memory() {
    let limits = Limits::default();
    let pgm = b"P5 100000 100000 255 \x00";
    let mut png = crate::images::encode_png_la8(1, 1, &[0, 0]).unwrap();
    png[16..24].copy_from_slice(&[0, 1, 0x86, 0xa0, 0, 1, 0x86, 0xa0]);
    let error = FormatError::TooLarge { field: "num_pixels", value: 10_000_000_000, limit: 64_000_000 };
    assert_eq!(decode(&yaml(Mode::Trinary), pgm, &limits), Err(error.clone()));
    assert_eq!(decode(&yaml(Mode::Trinary), &png, &limits), Err(error));
    // A line of 200,000 cells is not much; turned it spans 141,422 by 141,422.
    let line = [b"P5 200000 1 255 ".as_slice(), &[0; 200_000]].concat();
    let turned = MapYaml { yaw_rad: std::f64::consts::FRAC_PI_4, ..yaml(Mode::Trinary) };
    assert!(matches!(decode(&turned, &line, &limits), Err(FormatError::TooLarge { field: "num_pixels", .. })));
}

#[test]
fn a_quarter_turn_moves_every_cell_and_loses_none() {
    let image = b"P5 3 2 255 \x00\xfe\xcd\xfe\x00\x00";
    let turned = MapYaml { origin: Point2::new(1.0, 2.0), yaw_rad: std::f64::consts::FRAC_PI_2, ..yaml(Mode::Trinary) };
    let map = decode(&turned, image, &Limits::default()).unwrap();
    assert_eq!((map.width, map.height), (2, 3));
    // Rows of the straight one from below: 0 100 100, 100 0 -1. Its x is the turned one's y, its y points to -x.
    assert_eq!(map.cells, [100, 0, 0, 100, -1, 100]);
    assert!((map.geometry.origin - Point2::new(0.9, 2.0)).norm() < 1e-9);
}

#[test]
fn scale_needs_transparency_and_cells_their_number() {
    let geometry = GridGeometry::new(0.05, Point2::origin());
    let map = GridMap { geometry, width: 1, height: 1, cells: vec![50] };
    let error = encode_image(&map, Mode::Scale, ImageKind::Pgm).unwrap_err();
    assert_eq!(
        error.to_string(),
        "nav2 map: image of mode scale 'PGM' is not supported, only PNG: it has transparency"
    );
    let short = GridMap { width: 2, ..map };
    assert!(matches!(encode_image(&short, Mode::Raw, ImageKind::Png), Err(FormatError::Geometry(_))));
}

fn maps() -> impl Strategy<Value = GridMap> {
    (1usize..20, 1usize..20, 0.01..1.0f64, -1e3..1e3f64, -1e3..1e3f64).prop_flat_map(|(width, height, res, x, y)| {
        let geometry = GridGeometry::new(res, Point2::new(x, y));
        let cells = prop::collection::vec(-1i8..=100, width * height);
        cells.prop_map(move |cells| GridMap { geometry, width, height, cells })
    })
}

proptest! {
    #[test]
    fn every_mode_and_image_keeps_what_it_says(map in maps(), mode in 0usize..3, png in any::<bool>()) {
        let mode = [Mode::Trinary, Mode::Raw, Mode::Scale][mode];
        let kind = if png || mode == Mode::Scale { ImageKind::Png } else { ImageKind::Pgm };
        let image = encode_image(&map, mode, kind).unwrap();
        let mut yaml = vec![];
        write_yaml_of(&mut yaml, &map.geometry, "map.png", mode).unwrap();
        let back = decode(&parse_yaml(&yaml).unwrap(), &image, &Limits::default()).unwrap();
        let kept = |&c: &i8| match c {
            _ if mode != Mode::Trinary => c,
            0..=25 => 0,
            65..=100 => 100,
            _ => -1,
        };
        prop_assert_eq!(back, GridMap { cells: map.cells.iter().map(kept).collect(), ..map });
    }

    #[test]
    fn a_turned_wall_has_no_gap_and_lies_where_it_is(yaw_rad in -7.0..7.0f64, row in 2usize..18) {
        let mut pixels = vec![254u8; 20 * 20];
        pixels[row * 20..(row + 1) * 20].fill(0);
        let image = [b"P5 20 20 255 ".as_slice(), &pixels].concat();
        let map = decode(&MapYaml { yaw_rad, resolution_m: 1.0, ..yaml(Mode::Trinary) }, &image, &Limits::default()).unwrap();
        let y = 19.5 - row as f64;
        let turn = nalgebra::Rotation2::new(yaw_rad);
        // Every place along the middle of the wall lies in a wall.
        for i in 0..=190 {
            let p = turn * Point2::new(0.5 + f64::from(i) * 0.1, y);
            let cell = map.geometry.cell(&p).unwrap();
            prop_assert_eq!(map.cells[cell.y as usize * map.width + cell.x as usize], 100);
        }
        // Walls and free space end within a cell of where they end.
        for (i, &c) in map.cells.iter().enumerate() {
            let center = map.geometry.center(percept_geometry::Cell::new((i % map.width) as i32, (i / map.width) as i32));
            let p = turn.inverse() * center;
            prop_assert!(c != 100 || (p.y - y).abs() < 1.0, "{} {}", p, y);
            let outside = p.x < -0.5 || p.y < -0.5 || p.x > 20.5 || p.y > 20.5;
            prop_assert!(!outside || c == -1);
        }
    }
}
