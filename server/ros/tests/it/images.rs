//! Images of each encoding, made here byte by byte.

use image::ImageEncoder;
use percept_geometry::{DepthImage, RgbImage, Timestamp};
use percept_ros::convert::{
    ConvertError, color, color_message, compressed_color, compressed_depth, depth, depth_message,
};
use percept_ros::messages::{CompressedImage, Header, Image};
use proptest::prelude::*;
use std::borrow::Cow;

fn image(encoding: &'static str, width: u32, height: u32, step: u32, data: &[u8]) -> Image<'static> {
    Image { encoding, width, height, step, data: Cow::Owned(data.to_vec()), ..Default::default() }
}

#[test]
fn channels_are_taken_in_their_order_and_padding_is_left_out() {
    // A pixel of (1, 2, 3) over one of (4, 5, 6).
    let cases: [(&str, u32, &[u8]); 7] = [
        ("rgb8", 4, &[1, 2, 3, 99, 4, 5, 6]),
        ("bgr8", 3, &[3, 2, 1, 6, 5, 4]),
        ("8UC3", 0, &[3, 2, 1, 6, 5, 4]),
        ("rgba8", 5, &[1, 2, 3, 99, 99, 4, 5, 6, 99]),
        ("bgra8", 4, &[3, 2, 1, 99, 6, 5, 4, 99]),
        ("rgb16", 6, &[99, 1, 99, 2, 99, 3, 99, 4, 99, 5, 99, 6]),
        ("bgr16", 6, &[99, 3, 99, 2, 99, 1, 99, 6, 99, 5, 99, 4]),
    ];
    for (encoding, step, data) in cases {
        let read = color(&image(encoding, 1, 2, step, data)).unwrap();
        assert_eq!((read.width(), read.height(), read.data()), (1, 2, &[1, 2, 3, 4, 5, 6][..]), "{encoding}");
    }
    assert_eq!(color(&image("mono8", 2, 1, 2, &[7, 8])).unwrap().data(), [7, 7, 7, 8, 8, 8]);
    let high_first = Image { is_bigendian: 1, ..image("mono16", 1, 1, 2, &[7, 99]) };
    assert_eq!(color(&high_first).unwrap().data(), [7, 7, 7]);
}

#[test]
fn mosaics_of_one_colour_become_that_colour() {
    let (r, g, b) = (200, 100, 50);
    for (encoding, tile) in [
        ("bayer_rggb8", [[r, g], [g, b]]),
        ("bayer_bggr8", [[b, g], [g, r]]),
        ("bayer_gbrg8", [[g, b], [r, g]]),
        ("bayer_grbg8", [[g, r], [b, g]]),
    ] {
        let data: Vec<u8> = (0..20).map(|i| tile[i / 5 % 2][i % 5 % 2]).collect();
        let read = color(&image(encoding, 5, 4, 5, &data)).unwrap();
        assert!(read.data().as_chunks::<3>().0.iter().all(|p| *p == [r, g, b]), "{encoding}");
    }
}

#[test]
fn shared_colour_is_that_of_bt_601() {
    // Full red of BT.601 in video range: Y 81, U 90, V 240; white 235, 128, 128; black 16, 128, 128.
    let near = |read: &[u8], expected: [u8; 3]| read.iter().zip(expected).all(|(a, b)| a.abs_diff(b) <= 2);
    for (encoding, [y, u, y2, v]) in [("yuv422", [1, 0, 3, 2]), ("yuv422_yuy2", [0, 1, 2, 3])] {
        let pair = |lumas: [u8; 2], blue: u8, red: u8| {
            let mut bytes = [0; 4];
            (bytes[y], bytes[y2], bytes[u], bytes[v]) = (lumas[0], lumas[1], blue, red);
            bytes
        };
        let data = [pair([81, 81], 90, 240), pair([235, 16], 128, 128)].concat();
        let read = color(&image(encoding, 4, 1, 8, &data)).unwrap();
        let pixels: Vec<&[u8]> = read.data().chunks(3).collect();
        assert!(near(pixels[0], [255, 0, 0]) && near(pixels[1], [255, 0, 0]), "{encoding} {pixels:?}");
        assert!(near(pixels[2], [255; 3]) && near(pixels[3], [0; 3]), "{encoding} {pixels:?}");
        assert_eq!(
            color(&image(encoding, 3, 2, 6, &[data.clone(), data[..4].to_vec()].concat())).unwrap().data().len(),
            18
        );
    }
}

#[test]
fn depth_is_metres_and_no_return_is_zero() {
    let millimetres: Vec<u8> = [0u16, 2000, 65535].iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(depth(&image("16UC1", 3, 1, 6, &millimetres)).unwrap().data(), [0.0, 2.0, 0.0]);
    let high_first = Image { is_bigendian: 1, ..image("16UC1", 1, 1, 2, &[0x07, 0xd0]) };
    assert_eq!(depth(&high_first).unwrap().data(), [2.0]);
    let metres: Vec<u8> = [f32::NAN, 2.5, f32::INFINITY].iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(depth(&image("32FC1", 3, 1, 12, &metres)).unwrap().data(), [0.0, 2.5, 0.0]);
}

#[test]
fn what_cannot_be_an_image_says_why() {
    let error = |i: &Image<'_>| color(i).unwrap_err().to_string();
    assert!(error(&image("nv21", 1, 1, 1, &[0])).contains("encoding: nv21 found, expected rgb8"));
    assert!(error(&image("rgb8", 2, 2, 5, &[0; 12])).contains("step of rows: 5 found"));
    assert!(error(&image("rgb8", 2, 2, 6, &[0; 11])).contains("12 bytes are declared"));
    assert!(error(&image("rgb8", u32::MAX, u32::MAX, u32::MAX, &[0; 11])).contains("step of rows"));
    assert!(error(&image("mono8", u32::MAX, u32::MAX, u32::MAX, &[0; 11])).contains("11 are there"));
    assert!(error(&image("rgb8", 0, 2, 0, &[])).contains("a pixel at least"));
    assert!(depth(&image("rgb8", 1, 1, 3, &[0; 3])).unwrap_err().to_string().contains("16UC1"));
}

fn compressed(format: &'static str, data: Vec<u8>) -> CompressedImage<'static> {
    CompressedImage { format, data: Cow::Owned(data), ..Default::default() }
}

fn png16(width: u32, height: u32, values: &[u16]) -> Vec<u8> {
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_ne_bytes()).collect();
    let mut out = vec![];
    let encoder = image::codecs::png::PngEncoder::new(&mut out);
    encoder.write_image(&bytes, width, height, image::ExtendedColorType::L16).unwrap();
    out
}

/// The header of `compressedDepth` with its parameters.
fn header(a: f32, b: f32) -> Vec<u8> {
    [&1i32.to_le_bytes()[..], &a.to_le_bytes(), &b.to_le_bytes()].concat()
}

/// Wilson 2017, appendix: the encoder of the paper, in numbers and nibbles.
fn rvl(values: &[u16]) -> Vec<u8> {
    let mut nibbles = vec![];
    let mut number = |mut value: u32| {
        loop {
            let rest = value >> 3;
            nibbles.push((value & 7) | if rest > 0 { 8 } else { 0 });
            value = rest;
            if value == 0 {
                break;
            }
        }
    };
    let (mut at, mut previous) = (0, 0i32);
    while at < values.len() {
        let zeros = values[at..].iter().take_while(|v| **v == 0).count();
        let run = values[at + zeros..].iter().take_while(|v| **v != 0).count();
        number(zeros as u32);
        number(run as u32);
        for &value in &values[at + zeros..at + zeros + run] {
            let difference = i32::from(value) - previous;
            number(((difference << 1) ^ (difference >> 31)).cast_unsigned());
            previous = i32::from(value);
        }
        at += zeros + run;
    }
    let word = |c: &[u32]| (0..8).fold(0, |word, i| word << 4 | c.get(i).copied().unwrap_or(0));
    nibbles.chunks(8).flat_map(|c| word(c).to_le_bytes()).collect()
}

fn rvl_data(width: u32, height: u32, values: &[u16], parameters: Vec<u8>) -> Vec<u8> {
    [parameters, width.to_le_bytes().to_vec(), height.to_le_bytes().to_vec(), rvl(values)].concat()
}

#[test]
fn runs_of_zeros_and_differences_are_those_of_the_paper() {
    // Two zeros, two values; 5 as 10 (1010 with its mark, 1), 2 as 4.
    assert_eq!(rvl(&[0, 0, 5, 7]), 0x22a1_4000u32.to_le_bytes());
    let data = rvl_data(4, 1, &[0, 0, 5, 7], header(0.0, 0.0));
    let read = compressed_depth(&compressed("16UC1; compressedDepth rvl", data), 100).unwrap();
    assert_eq!(read, DepthImage::from_u16(4, 1, &[0, 0, 5, 7], 0.001).unwrap());
}

#[test]
fn compressed_depth_is_metres_in_each_of_its_forms() {
    let units = [0u16, 500, 1000, 2000];
    let metres = [0.0, 0.5, 1.0, 2.0];
    for (format, data) in [
        ("16UC1; compressedDepth png", [header(0.0, 0.0), png16(2, 2, &units)].concat()),
        ("16UC1; compressedDepth", [header(0.0, 0.0), png16(2, 2, &units)].concat()),
        ("16UC1; compressedDepth rvl", rvl_data(2, 2, &units, header(0.0, 0.0))),
        ("16UC1; png compressed ", png16(2, 2, &units)),
    ] {
        let read = compressed_depth(&compressed(format, data), 4).unwrap();
        assert_eq!((read.width(), read.height(), read.data()), (2, 2, &metres[..]), "{format}");
    }
}

#[test]
fn inverse_depth_is_within_its_quantum() {
    // As compressed_depth_image_transport has it by default: quantization 100, 10 m at most.
    let (quantization, most) = (100.0f32, 10.0f32);
    let a = quantization * (quantization + 1.0);
    let b = 1.0 - a / most;
    let metres = [0.5f32, 1.0, 3.3, 9.0];
    let stored: Vec<u16> = metres.iter().map(|d| (a / d + b) as u16).collect();
    for (format, data) in [
        ("32FC1; compressedDepth png", [header(a, b), png16(5, 1, &[&stored[..], &[0]].concat())].concat()),
        ("32FC1; compressedDepth rvl", rvl_data(5, 1, &[&stored[..], &[0]].concat(), header(a, b))),
    ] {
        let read = compressed_depth(&compressed(format, data), 5).unwrap();
        for (read, d) in read.data().iter().zip(metres) {
            // One step of q is d^2 / a metres.
            assert!((read - d).abs() <= d * d / a * 1.1, "{format}: {read} for {d}");
        }
        assert_eq!(read.data()[4], 0.0);
    }
    let nan = compressed("32FC1; compressedDepth png", [header(f32::NAN, b), png16(1, 1, &[1])].concat());
    assert!(compressed_depth(&nan, 5).unwrap_err().to_string().contains("parameter at byte 4: NaN found"));
}

#[test]
fn pictures_are_read_up_to_their_limit_and_cut_ones_are_errors() {
    let pixels: Vec<u8> = (0..8 * 6).flat_map(|i| [i as u8 * 4, 100, 50]).collect();
    let (mut png, mut jpeg) = (vec![], vec![]);
    image::codecs::png::PngEncoder::new(&mut png).write_image(&pixels, 8, 6, image::ExtendedColorType::Rgb8).unwrap();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 95)
        .write_image(&pixels, 8, 6, image::ExtendedColorType::Rgb8)
        .unwrap();
    assert_eq!(compressed_color(&compressed("png", png.clone()), 48).unwrap().data(), pixels);
    let read = compressed_color(&compressed("rgb8; jpeg compressed bgr8", jpeg.clone()), 48).unwrap();
    assert!(read.data().iter().zip(&pixels).all(|(a, b)| a.abs_diff(*b) < 24));
    for (file, tail) in [(png, 16), (jpeg, 1)] {
        let error = compressed_color(&compressed("", file.clone()), 47).unwrap_err();
        assert!(matches!(error, ConvertError::TooLarge { value: 48, limit: 47, .. }), "{error}");
        for end in 0..file.len() - tail {
            assert!(compressed_color(&compressed("", file[..end].to_vec()), 48).is_err(), "cut at {end}");
        }
    }
}

#[test]
fn what_is_published_reads_back() {
    let header = Header::new(Timestamp(5), "camera");
    let rgb = RgbImage::new(2, 1, vec![1, 2, 3, 4, 5, 6]).unwrap();
    assert_eq!(color(&color_message(&rgb, header).unwrap()).unwrap(), rgb);
    let metres = DepthImage::new(2, 1, vec![0.0, 1.25]).unwrap();
    assert_eq!(depth(&depth_message(&metres, header).unwrap()).unwrap(), metres);
}

proptest! {
    #[test]
    fn runs_read_back(values in prop::collection::vec(prop_oneof![Just(0u16), any::<u16>(), 900u16..1100], 1..60)) {
        let data = rvl_data(values.len() as u32, 1, &values, header(0.0, 0.0));
        let read = compressed_depth(&compressed("16UC1; compressedDepth rvl", data), 60).unwrap();
        let expected = DepthImage::from_u16(values.len(), 1, &values, 0.001).unwrap();
        prop_assert_eq!(read, expected);
    }

    #[test]
    fn any_image_never_panics(
        kind in 0usize..22, sizes in prop::array::uniform3(prop_oneof![0u32..20, any::<u32>()]), high in 0u8..2,
        data in prop::collection::vec(any::<u8>(), 0..600),
    ) {
        const ENCODINGS: [&str; 22] = [
            "rgb8", "bgr8", "rgba8", "bgra8", "mono8", "mono16", "rgb16", "bgr16", "8UC1", "8UC3", "8UC4", "bayer_rggb8", "bayer_bggr8",
            "bayer_gbrg8", "bayer_grbg8", "yuv422", "uyvy", "yuyv", "yuv422_yuy2", "16UC1", "32FC1", "",
        ];
        let message = Image { is_bigendian: high, ..image(ENCODINGS[kind], sizes[0], sizes[1], sizes[2], &data) };
        let _ = (color(&message), depth(&message));
    }

    #[test]
    fn any_compressed_image_never_panics(
        kind in 0usize..6, cut in any::<prop::sample::Index>(), hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        tail in prop::collection::vec(any::<u8>(), 0..60),
    ) {
        let formats = ["32FC1; compressedDepth png", "16UC1; compressedDepth rvl", "32FC1; compressedDepth rvl", "jpeg", "png", "16UC1; compressedDepth rvl"];
        let units = [0u16, 500, 1000, 2000];
        let mut data = match kind {
            0 => [header(1.0, 0.0), png16(2, 2, &units)].concat(),
            1 | 2 => rvl_data(2, 2, &units, header(1.0, 0.0)),
            5 => [header(1.0, 0.0), vec![200, 0, 0, 0, 5, 0, 0, 0], tail].concat(),
            _ => png16(2, 2, &units),
        };
        for (at, value) in hits {
            let at = at.index(data.len());
            data[at] = value;
        }
        let cut = cut.index(data.len() + 1);
        for data in [data.clone(), data[..cut].to_vec()] {
            let message = compressed(formats[kind], data);
            let _ = (compressed_color(&message, 1000), compressed_depth(&message, 1000));
        }
    }
}
