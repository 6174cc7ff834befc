//! A keyframe's scan as bytes, for the store.
//!
//! Layout, little-endian: magic `PKS1`; stamp i64; sensor name (u16 length, UTF-8); t_base_sensor as 7 f64
//! (x, y, z, qx, qy, qz, qw); base height f64; flags u8 (1 planar, 2 colours, 4 features are SIFT); number of hits u32; hits 3 f32
//! each; colours 3 u8 each if flagged; number of misses u32; misses 3 f32 each.
//!
//! With features the magic is `PKS2` and there follow the camera (width, height u32; fx, fy, cx, cy f64), the number of
//! features u16, and each as descriptor 4 u64, point 3 f32, pixel 2 f32. Both are read.

use nalgebra::{Point2, Point3};
use percept_geometry::{
    CameraIntrinsics, FeatureMethod, KeyframeFeature, KeyframeFeatures, KeyframeScan, PointCloud, SensorId, Timestamp,
    se3,
};
use std::sync::Arc;

const MAGIC: &[u8; 4] = b"PKS1";
const MAGIC_WITH_FEATURES: &[u8; 4] = b"PKS2";

/// The bytes are not a keyframe's scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("keyframe record is damaged: {0}")]
pub(crate) struct CodecError(&'static str);

pub(crate) fn encode(scan: &KeyframeScan) -> Vec<u8> {
    let (hits, misses) = (&scan.hits.positions, &scan.misses);
    let mut out = Vec::with_capacity(128 + hits.len() * 15 + misses.len() * 12);
    out.extend_from_slice(if scan.features.is_some() { MAGIC_WITH_FEATURES } else { MAGIC });
    out.extend_from_slice(&scan.stamp.nanos().to_le_bytes());
    let name = scan.sensor.0.as_bytes();
    out.extend_from_slice(&(name.len() as u16).to_le_bytes());
    out.extend_from_slice(name);
    let t = scan.t_base_sensor.translation.vector;
    let numbers =
        [t.x, t.y, t.z].into_iter().chain(se3::quaternion_xyzw(&scan.t_base_sensor)).chain([scan.base_height_m]);
    numbers.for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
    let is_sift = scan.features.as_ref().is_some_and(|f| f.method == FeatureMethod::Sift);
    out.push(u8::from(scan.planar) | u8::from(scan.hits.colors.is_some()) << 1 | u8::from(is_sift) << 2);
    put_points(&mut out, hits);
    if let Some(colors) = &scan.hits.colors {
        out.extend_from_slice(colors.as_flattened());
    }
    put_points(&mut out, misses);
    if let Some(features) = &scan.features {
        put_features(&mut out, features);
    }
    out
}

fn put_features(out: &mut Vec<u8>, features: &KeyframeFeatures) {
    let c = &features.camera;
    [c.width, c.height].iter().for_each(|&n| out.extend_from_slice(&(n as u32).to_le_bytes()));
    [c.fx, c.fy, c.cx, c.cy].iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
    let kept = &features.features[..features.features.len().min(usize::from(u16::MAX))];
    out.extend_from_slice(&(kept.len() as u16).to_le_bytes());
    for f in kept {
        f.descriptor.iter().for_each(|w| out.extend_from_slice(&w.to_le_bytes()));
        let (p, uv) = (f.p_base, f.pixel);
        [p.x, p.y, p.z, uv.x, uv.y].iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
    }
}

fn put_points(out: &mut Vec<u8>, points: &[Point3<f32>]) {
    out.extend_from_slice(&(points.len() as u32).to_le_bytes());
    for p in points {
        for v in [p.x, p.y, p.z] {
            out.extend_from_slice(&v.to_le_bytes());
        }
    }
}

struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], CodecError> {
        let (head, rest) = self.0.split_at_checked(n).ok_or(CodecError("it ends too early"))?;
        self.0 = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], CodecError> {
        self.take(N)?.try_into().map_err(|_| CodecError("it ends too early"))
    }

    fn points(&mut self) -> Result<Vec<Point3<f32>>, CodecError> {
        let n = u32::from_le_bytes(self.array()?) as usize;
        let bytes = self.take(n.checked_mul(12).ok_or(CodecError("too many points"))?)?;
        let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        Ok(bytes.chunks_exact(12).map(|b| Point3::new(value(b), value(&b[4..]), value(&b[8..]))).collect())
    }
}

impl Reader<'_> {
    fn features(&mut self, method: FeatureMethod) -> Result<KeyframeFeatures, CodecError> {
        let [width, height] = [u32::from_le_bytes(self.array()?) as usize, u32::from_le_bytes(self.array()?) as usize];
        let mut k = [0.0; 4];
        for v in &mut k {
            *v = f64::from_le_bytes(self.array()?);
        }
        let camera = CameraIntrinsics::pinhole(width, height, k[0], k[1], k[2], k[3]);
        camera.validate().map_err(|_| CodecError("its camera is no camera"))?;
        let n = usize::from(u16::from_le_bytes(self.array()?));
        let mut features = vec![];
        for _ in 0..n {
            let mut descriptor = [0; 4];
            for w in &mut descriptor {
                *w = u64::from_le_bytes(self.array()?);
            }
            let mut v = [0f32; 5];
            for x in &mut v {
                *x = f32::from_le_bytes(self.array()?);
            }
            let (p_base, pixel) = (Point3::new(v[0], v[1], v[2]), Point2::new(v[3], v[4]));
            features.push(KeyframeFeature { descriptor, p_base, pixel });
        }
        Ok(KeyframeFeatures { method, camera, features })
    }
}

pub(crate) fn decode(bytes: &[u8]) -> Result<KeyframeScan, CodecError> {
    let mut r = Reader(bytes);
    let magic = r.array::<4>()?;
    if &magic != MAGIC && &magic != MAGIC_WITH_FEATURES {
        return Err(CodecError("it has another magic number"));
    }
    let stamp = Timestamp(i64::from_le_bytes(r.array()?));
    let name_len = usize::from(u16::from_le_bytes(r.array()?));
    let name = std::str::from_utf8(r.take(name_len)?).map_err(|_| CodecError("its sensor name is not text"))?;
    let mut numbers = [0.0; 8];
    for n in &mut numbers {
        *n = f64::from_le_bytes(r.array()?);
    }
    let [x, y, z, qx, qy, qz, qw, base_height_m] = numbers;
    let t_base_sensor = se3::pose_from_parts("t_base_sensor", [x, y, z], [qx, qy, qz, qw])
        .map_err(|_| CodecError("its sensor pose is no pose"))?;
    let [flags] = r.array()?;
    let positions = r.points()?;
    let colors = if flags & 2 != 0 {
        Some(r.take(positions.len() * 3)?.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect())
    } else {
        None
    };
    let misses = r.points()?;
    let method = if flags & 4 != 0 { FeatureMethod::Sift } else { FeatureMethod::Orb };
    let features = if &magic == MAGIC_WITH_FEATURES { Some(Arc::new(r.features(method)?)) } else { None };
    if !r.0.is_empty() {
        return Err(CodecError("bytes are left over"));
    }
    let hits = PointCloud { positions, colors, ..PointCloud::default() };
    Ok(KeyframeScan {
        stamp,
        sensor: SensorId(name.to_owned()),
        t_base_sensor,
        base_height_m,
        hits,
        misses,
        planar: flags & 1 != 0,
        features,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scan() -> KeyframeScan {
        KeyframeScan {
            stamp: Timestamp(-5),
            sensor: "front".into(),
            t_base_sensor: se3::from_xy_yaw(0.1, 0.2, 0.3),
            base_height_m: 0.25,
            hits: PointCloud {
                positions: vec![Point3::new(1.0, 2.0, 3.0), Point3::new(f32::NAN, 0.0, -1.0)],
                colors: Some(vec![[1, 2, 3], [4, 5, 6]]),
                ..PointCloud::default()
            },
            misses: vec![Point3::new(9.0, 8.0, 7.0)],
            planar: true,
            features: None,
        }
    }

    fn with_features(method: FeatureMethod) -> KeyframeScan {
        let feature = |k: u64| KeyframeFeature {
            descriptor: [k, !k, k << 7, 3],
            p_base: Point3::new(1.0, f32::NAN, k as f32),
            pixel: Point2::new(3.5, k as f32),
        };
        let camera = CameraIntrinsics::primesense();
        let features = KeyframeFeatures { method, camera, features: (0..3).map(feature).collect() };
        KeyframeScan { features: Some(Arc::new(features)), ..scan() }
    }

    #[test]
    fn a_scan_survives_the_round_trip_bit_for_bit() {
        for scan in [scan(), with_features(FeatureMethod::Orb), with_features(FeatureMethod::Sift)] {
            let bytes = encode(&scan);
            let read = decode(&bytes).unwrap();
            assert_eq!(encode(&read), bytes);
            assert_eq!(read.features.map(|f| f.method), scan.features.map(|f| f.method));
        }
        // Records of before features came are as they were.
        assert_eq!(&encode(&scan())[..4], b"PKS1");
    }

    #[test]
    fn a_record_cut_at_any_length_is_refused() {
        for bytes in [encode(&scan()), encode(&with_features(FeatureMethod::Sift))] {
            for n in 0..bytes.len() {
                assert!(decode(&bytes[..n]).is_err(), "{n}");
            }
            assert!(decode(&[bytes.as_slice(), &[0]].concat()).is_err());
        }
    }

    #[test]
    fn damaged_records_are_refused_or_read_but_never_larger_than_their_bytes() {
        // xorshift64*, the same every time.
        let mut state = 0x2545_f491_4f6c_dd1du64;
        let mut draw = || {
            state ^= state >> 12;
            state ^= state << 25;
            state ^= state >> 27;
            state.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33
        };
        for record in [encode(&scan()), encode(&with_features(FeatureMethod::Sift))] {
            for _ in 0..20_000 {
                let mut bytes = record.clone();
                for _ in 0..=draw() % 4 {
                    let at = draw() as usize % bytes.len();
                    // Often the largest counts, which nothing may be set aside for.
                    bytes[at] = if draw() % 3 == 0 { 0xff } else { draw() as u8 };
                }
                bytes.truncate(bytes.len() - draw() as usize % 8);
                check(&bytes);
            }
            // Rubbish after a sound beginning, of any length.
            for n in 0..record.len() {
                let rubbish = (0..draw() % 300).map(|_| draw() as u8);
                check(&record[..n].iter().copied().chain(rubbish).collect::<Vec<u8>>());
            }
        }
    }

    fn check(bytes: &[u8]) {
        let Ok(scan) = decode(bytes) else { return };
        let features = scan.features.as_ref().map_or(0, |f| f.features.capacity() * 52);
        let points = (scan.hits.positions.capacity() + scan.misses.capacity()) * 12;
        assert!(features / 2 + points <= bytes.len(), "{} bytes", bytes.len());
    }
}
