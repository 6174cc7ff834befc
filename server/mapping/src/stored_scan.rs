//! Scans of keyframes out of memory: as bytes in the map's store, to the last bit what they were.

use crate::bytes::{Damaged, Reader, put_f32, put_u32, put_u64};
use crate::store::{BlobId, MapStore};
use nalgebra::{Point2, Point3};
use percept_geometry::{KeyframeFeature, KeyframeFeatures, KeyframeScan, PointCloud, ScanSource};
use std::sync::Arc;

/// First bytes of a stored scan; the number is that of the layout.
const MAGIC: &[u8; 4] = b"PSS1";

/// A scan in a store. What does not grow with the number of points stays in memory.
#[derive(Debug)]
struct StoredScan {
    store: Arc<dyn MapStore>,
    id: BlobId,
    /// Without points and features.
    head: KeyframeScan,
}

/// Puts a scan into a store; none if that does not take it.
pub(crate) fn store_scan(store: &Arc<dyn MapStore>, scan: &KeyframeScan) -> Option<Arc<dyn ScanSource>> {
    let id = store.put(&encode(scan))?;
    let bare = |f: &Arc<KeyframeFeatures>| Arc::new(KeyframeFeatures { features: vec![], ..**f });
    let head = KeyframeScan {
        hits: PointCloud::default(),
        misses: vec![],
        features: scan.features.as_ref().map(bare),
        sensor: scan.sensor.clone(),
        ..*scan
    };
    Some(Arc::new(StoredScan { store: Arc::clone(store), id, head }))
}

impl ScanSource for StoredScan {
    fn fetch(&self) -> Option<KeyframeScan> {
        decode(&self.head, &self.store.get(&self.id)?).ok()
    }
}

fn encode(scan: &KeyframeScan) -> Vec<u8> {
    let hits = &scan.hits;
    let mut out = Vec::with_capacity(64 + scan.memory_bytes());
    out.extend_from_slice(MAGIC);
    put_points(&mut out, &hits.positions);
    put_channel(&mut out, hits.colors.as_deref(), |out, c| out.extend_from_slice(c));
    put_channel(&mut out, hits.intensities.as_deref(), |out, v| put_f32(out, *v));
    put_channel(&mut out, hits.normals.as_deref(), |out, n| n.iter().for_each(|v| put_f32(out, *v)));
    put_channel(&mut out, hits.time_offsets_s.as_deref(), |out, v| put_f32(out, *v));
    put_points(&mut out, &scan.misses);
    let features = scan.features.as_ref().map(|f| &f.features[..]);
    put_channel(&mut out, features, |out, f| {
        f.descriptor.iter().for_each(|w| put_u64(out, *w));
        f.p_base.iter().chain(f.pixel.iter()).for_each(|v| put_f32(out, *v));
    });
    out
}

fn decode(head: &KeyframeScan, bytes: &[u8]) -> Result<KeyframeScan, Damaged> {
    let mut from = Reader::new(bytes.strip_prefix(MAGIC).ok_or(Damaged)?);
    let hits = PointCloud {
        positions: points(&mut from)?,
        colors: channel(&mut from, |from| Ok([from.u8()?, from.u8()?, from.u8()?]))?,
        intensities: channel(&mut from, Reader::f32)?,
        normals: channel(&mut from, |from| Ok([from.f32()?, from.f32()?, from.f32()?].into()))?,
        time_offsets_s: channel(&mut from, Reader::f32)?,
    };
    let misses = points(&mut from)?;
    let features = channel(&mut from, |from| {
        let descriptor = [from.u64()?, from.u64()?, from.u64()?, from.u64()?];
        let p_base = Point3::new(from.f32()?, from.f32()?, from.f32()?);
        Ok(KeyframeFeature { descriptor, p_base, pixel: Point2::new(from.f32()?, from.f32()?) })
    })?;
    let features = match (&head.features, features) {
        (Some(bare), Some(features)) => Some(Arc::new(KeyframeFeatures { features, ..**bare })),
        (None, None) => None,
        _ => return Err(Damaged),
    };
    match from.is_at_end() {
        true => Ok(KeyframeScan { hits, misses, features, sensor: head.sensor.clone(), ..*head }),
        false => Err(Damaged),
    }
}

fn put_points(out: &mut Vec<u8>, points: &[Point3<f32>]) {
    put_channel(out, Some(points), |out, p| p.iter().for_each(|v| put_f32(out, *v)));
}

fn points(from: &mut Reader<'_>) -> Result<Vec<Point3<f32>>, Damaged> {
    channel(from, |from| Ok(Point3::new(from.f32()?, from.f32()?, from.f32()?)))?.ok_or(Damaged)
}

/// One more than there are values, or 0 for no channel; then the values.
fn put_channel<T>(out: &mut Vec<u8>, values: Option<&[T]>, mut put: impl FnMut(&mut Vec<u8>, &T)) {
    put_u32(out, values.map_or(0, |v| v.len() as u32 + 1));
    values.unwrap_or_default().iter().for_each(|v| put(out, v));
}

fn channel<'a, T>(
    from: &mut Reader<'a>,
    mut value: impl FnMut(&mut Reader<'a>) -> Result<T, Damaged>,
) -> Result<Option<Vec<T>>, Damaged> {
    let Some(count) = from.u32()?.checked_sub(1) else { return Ok(None) };
    if count as usize > from.len() {
        return Err(Damaged);
    }
    (0..count).map(|_| value(from)).collect::<Result<_, _>>().map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::{CameraIntrinsics, FeatureMethod, Timestamp, se3};
    use std::sync::Mutex;

    #[derive(Debug, Default)]
    struct Shelf(Mutex<Vec<Vec<u8>>>);

    impl MapStore for Shelf {
        fn put(&self, bytes: &[u8]) -> Option<BlobId> {
            self.0.lock().unwrap().push(bytes.to_vec());
            Some(BlobId([0; 32]))
        }

        fn get(&self, _: &BlobId) -> Option<Vec<u8>> {
            self.0.lock().unwrap().last().cloned()
        }

        fn max_bytes(&self) -> usize {
            usize::MAX
        }
    }

    fn scan(has_channels: bool) -> KeyframeScan {
        let p = |i: usize| Point3::new(i as f32 * 0.1, -1.0 / (i as f32 + 1.0), f32::MIN_POSITIVE);
        let feature = |i: usize| KeyframeFeature {
            descriptor: [i as u64, u64::MAX - i as u64, 7, 0],
            p_base: p(i),
            pixel: Point2::new(i as f32, 3.5),
        };
        let camera = CameraIntrinsics::pinhole(640, 480, 500.5, 501.0, 320.0, 240.0);
        let features =
            || KeyframeFeatures { method: FeatureMethod::Sift, camera, features: (0..9).map(feature).collect() };
        let there = |n: usize| if has_channels { Some(n) } else { None };
        KeyframeScan {
            stamp: Timestamp(123),
            sensor: "front".into(),
            t_base_sensor: se3::from_xy_yaw(0.1, 0.2, 0.3),
            base_height_m: 0.05,
            hits: PointCloud {
                positions: (0..50).map(p).collect(),
                colors: there(50).map(|n| (0..n).map(|i| [i as u8, 1, 255]).collect()),
                intensities: there(50).map(|n| (0..n).map(|i| i as f32).collect()),
                normals: there(50).map(|n| (0..n).map(|i| p(i).coords).collect()),
                time_offsets_s: there(50).map(|n| (0..n).map(|i| -(i as f32)).collect()),
            },
            misses: (0..7).map(p).collect(),
            planar: !has_channels,
            features: has_channels.then(|| Arc::new(features())),
        }
    }

    #[test]
    fn a_stored_scan_is_had_again_to_the_last_bit() {
        for scan in [scan(false), scan(true)] {
            let store: Arc<dyn MapStore> = Arc::new(Shelf::default());
            assert_eq!(store_scan(&store, &scan).unwrap().fetch().as_ref(), Some(&scan));
        }
    }

    #[test]
    fn what_is_cut_or_changed_is_damaged() {
        let (scan, bytes) = (scan(true), encode(&scan(true)));
        assert_eq!(decode(&scan, &bytes).as_ref(), Ok(&scan));
        for end in 0..bytes.len() {
            assert_eq!(decode(&scan, &bytes[..end]), Err(Damaged));
        }
        let huge = [MAGIC.as_slice(), &[0xff; 8]].concat();
        assert_eq!(decode(&scan, &huge), Err(Damaged));
        assert_eq!(decode(&scan, &[&bytes[..], &[0]].concat()), Err(Damaged));
    }
}
