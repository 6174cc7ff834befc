//! What a frame shows at first sight: whether a sensor measures, and in which unit.

use percept_geometry::{DepthImage, PointCloud, SensorData};
use percept_pipeline::share_of_strays;
use std::hash::{DefaultHasher, Hash, Hasher};

/// So many values are looked at: a share of 5 % is told to 1 % (standard error of a binomial).
const SAMPLES: usize = 512;
/// Steps of this share of the whole spread samples evenly and fall in with no pattern of rows and columns (Weyl's sequence).
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// A frame at first sight.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct FrameLook {
    /// Bytes as it was sent, packing aside.
    pub(crate) bytes: usize,
    /// Share of its beams or pixels that measured something. None for what has none.
    pub(crate) measured: Option<f64>,
    /// Share of its returns that stand alone. None for what is no planar scan.
    pub(crate) stray: Option<f64>,
    /// Median distance, metres. None if nothing was measured.
    pub(crate) median_m: Option<f64>,
    /// Of the values that are looked at: a frame that is sent again has the same.
    pub(crate) digest: u64,
}

impl FrameLook {
    pub(crate) fn of(data: &SensorData) -> Self {
        match data {
            SensorData::Depth(depth) => Self { bytes: 2 * depth.data().len(), ..Self::of_depth(depth) },
            SensorData::Rgbd(depth, color) => {
                Self { bytes: 2 * depth.data().len() + color.data().len(), ..Self::of_depth(depth) }
            }
            SensorData::Camera(image) => {
                let bytes = image.data();
                Self { bytes: bytes.len(), digest: digest(sampled(bytes.len()).map(|i| bytes[i])), ..Self::default() }
            }
            SensorData::Cloud(cloud) => Self { bytes: bytes_of(cloud), ..Self::of_cloud(cloud) },
            SensorData::Scan(scan) => {
                let ranges = &scan.ranges_m;
                // Beams that met nothing within range measured that.
                let of = |range: f32| (!range.is_nan() && range > 0.0).then_some(f64::from(range));
                let look = Self::of_ranges(ranges.len(), |i| of(ranges[i]));
                Self { bytes: size_of_val(&ranges[..]), stray: Some(share_of_strays(scan)), ..look }
            }
            SensorData::Imu(sample) => {
                let values = sample.angular_velocity.iter().chain(&sample.linear_acceleration);
                Self { bytes: size_of_val(sample), digest: digest(values.map(|v| v.to_bits())), ..Self::default() }
            }
            SensorData::Odometry(sample) => {
                let t = &sample.t_odom_base;
                let values = t.translation.vector.iter().chain(t.rotation.coords.iter());
                Self { bytes: size_of_val(sample), digest: digest(values.map(|v| v.to_bits())), ..Self::default() }
            }
        }
    }

    fn of_depth(depth: &DepthImage) -> Self {
        let data = depth.data();
        Self::of_ranges(data.len(), |i| (data[i].is_finite() && data[i] > 0.0).then(|| f64::from(data[i])))
    }

    fn of_cloud(cloud: &PointCloud) -> Self {
        let at = |i: usize| f64::from(cloud.positions[i].coords.norm());
        Self::of_ranges(cloud.positions.len(), |i| Some(at(i)).filter(|r| r.is_finite() && *r > 0.0))
    }

    fn of_ranges(len: usize, range: impl Fn(usize) -> Option<f64>) -> Self {
        let seen: Vec<Option<f64>> = sampled(len).map(range).collect();
        let measured: Vec<f64> = seen.iter().flatten().copied().collect();
        let mut ranges: Vec<f64> = measured.iter().copied().filter(|r| r.is_finite()).collect();
        ranges.sort_by(f64::total_cmp);
        Self {
            bytes: 0,
            stray: None,
            measured: Some(measured.len() as f64 / seen.len().max(1) as f64),
            median_m: ranges.get(ranges.len() / 2).copied(),
            digest: digest(seen.iter().map(|r| r.map(f64::to_bits))),
        }
    }
}

/// Which of so many values are looked at.
fn sampled(len: usize) -> impl Iterator<Item = usize> {
    let at = move |k: usize| match len <= SAMPLES {
        true => k,
        false => ((k as f64 * GOLDEN).fract() * len as f64) as usize,
    };
    (0..len.min(SAMPLES)).map(at)
}

fn digest<T: Hash>(values: impl IntoIterator<Item = T>) -> u64 {
    let mut hasher = DefaultHasher::new();
    values.into_iter().for_each(|value| value.hash(&mut hasher));
    hasher.finish()
}

fn bytes_of(cloud: &PointCloud) -> usize {
    let each = 12
        + 3 * usize::from(cloud.colors.is_some())
        + 4 * usize::from(cloud.intensities.is_some())
        + 12 * usize::from(cloud.normals.is_some())
        + 4 * usize::from(cloud.time_offsets_s.is_some());
    each * cloud.positions.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::LaserScan;

    #[test]
    fn a_look_tells_unit_and_share() {
        let depth = DepthImage::new(640, 480, (0..640 * 480).map(|i| if i % 10 == 0 { 1850.0 } else { 0.0 }).collect());
        let depth = depth.unwrap();
        let look = FrameLook::of(&SensorData::Depth(depth.clone()));
        assert_eq!(look, FrameLook::of(&SensorData::Depth(depth)));
        assert_eq!((look.bytes, look.median_m), (614_400, Some(1850.0)));
        assert!((look.measured.unwrap() - 0.1).abs() < 0.05, "{look:?}");
        let scan = LaserScan {
            angle_min_rad: 0.0,
            angle_increment_rad: 0.01,
            range_min_m: 0.1,
            range_max_m: 20.0,
            time_increment_s: 0.0,
            ranges_m: vec![f32::INFINITY, f32::NAN, 3.0, 4.0],
            intensities: None,
            later_echoes_m: vec![],
        };
        let another = LaserScan { ranges_m: vec![f32::INFINITY, f32::NAN, 3.001, 4.0], ..scan.clone() };
        let (look, another) = (FrameLook::of(&SensorData::Scan(scan)), FrameLook::of(&SensorData::Scan(another)));
        assert_eq!((look.bytes, look.measured, look.median_m), (another.bytes, another.measured, another.median_m));
        assert_ne!(look, another, "measured anew");
        assert_eq!((look.measured, look.median_m), (Some(0.75), Some(4.0)));
        let nothing = FrameLook::of(&SensorData::Cloud(PointCloud::from_positions(vec![])));
        assert_eq!((nothing.measured, nothing.median_m), (Some(0.0), None));
    }
}
