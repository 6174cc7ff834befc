//! Point clouds and planar laser scans: positions plus optional channels.

use crate::{GeometryError, Pose};
use nalgebra::Point3;

/// `N` points with optional channels of the same length, in one frame.
///
/// Positions are metres. A position with a non-finite coordinate is 'no return'; producers that can
/// drop such points should ([`PointCloud::retain_finite`]).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PointCloud {
    /// N x 3, metres.
    pub positions: Vec<Point3<f32>>,
    /// N x 3 RGB8.
    pub colors: Option<Vec<[u8; 3]>>,
    /// N, sensor units as they came (KITTI 0..1).
    pub intensities: Option<Vec<f32>>,
    /// N x 3, unit length; all zero where undefined.
    pub normals: Option<Vec<nalgebra::Vector3<f32>>>,
    /// N, seconds after the message's stamp (may be negative), for deskewing.
    pub time_offsets_s: Option<Vec<f32>>,
}

impl PointCloud {
    /// A cloud of positions only.
    pub fn from_positions(positions: Vec<Point3<f32>>) -> Self {
        Self { positions, ..Self::default() }
    }

    /// What its channels take, bytes.
    pub fn memory_bytes(&self) -> usize {
        let channels = [
            (self.colors.is_some(), 3),
            (self.intensities.is_some(), 4),
            (self.normals.is_some(), 12),
            (self.time_offsets_s.is_some(), 4),
        ];
        self.len() * (12 + channels.iter().map(|(there, bytes)| usize::from(*there) * bytes).sum::<usize>())
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Checks that every channel has one entry a point.
    ///
    /// # Errors
    /// `ShapeMismatch` naming the channel.
    pub fn validate(&self) -> Result<(), GeometryError> {
        let expected = self.positions.len();
        let check = |field, actual: Option<usize>| match actual {
            Some(actual) if actual != expected => Err(GeometryError::ShapeMismatch { field, expected, actual }),
            _ => Ok(()),
        };
        check("colours", self.colors.as_ref().map(Vec::len))?;
        check("intensities", self.intensities.as_ref().map(Vec::len))?;
        check("normals", self.normals.as_ref().map(Vec::len))?;
        check("time_offsets_s", self.time_offsets_s.as_ref().map(Vec::len))
    }

    /// The points at `indices`, with all channels, in that order. Copies.
    ///
    /// Panics if an index is out of range: indices come from our own algorithms.
    pub fn select(&self, indices: &[usize]) -> Self {
        Self {
            positions: indices.iter().map(|&i| self.positions[i]).collect(),
            colors: self.colors.as_ref().map(|c| indices.iter().map(|&i| c[i]).collect()),
            intensities: self.intensities.as_ref().map(|c| indices.iter().map(|&i| c[i]).collect()),
            normals: self.normals.as_ref().map(|c| indices.iter().map(|&i| c[i]).collect()),
            time_offsets_s: self.time_offsets_s.as_ref().map(|c| indices.iter().map(|&i| c[i]).collect()),
        }
    }

    /// Drops points with a non-finite coordinate, keeping order and channels.
    pub fn retain_finite(&self) -> Self {
        let keep: Vec<usize> = (0..self.len()).filter(|&i| is_finite(&self.positions[i])).collect();
        if keep.len() == self.len() { self.clone() } else { self.select(&keep) }
    }

    /// The cloud with coordinates in frame a, from coordinates in b. Normals turn along.
    pub fn transformed(&self, t_a_b: &Pose) -> Self {
        let r = t_a_b.rotation.to_rotation_matrix();
        let t = t_a_b.translation.vector;
        Self {
            positions: self
                .positions
                .iter()
                .map(|p| Point3::from((r * p.coords.cast::<f64>() + t).cast::<f32>()))
                .collect(),
            normals: self.normals.as_ref().map(|ns| ns.iter().map(|n| (r * n.cast::<f64>()).cast::<f32>()).collect()),
            ..self.clone_channels()
        }
    }

    fn clone_channels(&self) -> Self {
        Self {
            positions: Vec::new(),
            colors: self.colors.clone(),
            intensities: self.intensities.clone(),
            normals: None,
            time_offsets_s: self.time_offsets_s.clone(),
        }
    }
}

/// Whether all three coordinates are finite.
pub fn is_finite(p: &Point3<f32>) -> bool {
    p.x.is_finite() && p.y.is_finite() && p.z.is_finite()
}

/// One sweep of a planar lidar; beam i points along `angle_min_rad + i * angle_increment_rad` in the
/// sensor's xy plane, counter-clockwise from x.
#[derive(Debug, Clone, PartialEq)]
pub struct LaserScan {
    /// Angle of beam 0, radians.
    pub angle_min_rad: f64,
    /// Angle between beams, radians; negative for a clockwise sensor.
    pub angle_increment_rad: f64,
    /// Ranges below this are no measurement, metres.
    pub range_min_m: f64,
    /// Ranges at or beyond this are 'no return within range', metres.
    pub range_max_m: f64,
    /// Seconds between beams; 0 if the whole scan was taken at once.
    pub time_increment_s: f64,
    /// B ranges, metres (REP-117): +inf no return, NaN or -inf invalid.
    pub ranges_m: Vec<f32>,
    /// B intensities, or none.
    pub intensities: Option<Vec<f32>>,
    /// E x B ranges, echo by echo: what each beam met behind `ranges_m` (through glass or rain), metres; NaN or inf where
    /// nothing. Empty: one echo.
    pub later_echoes_m: Vec<f32>,
}

/// What one beam of a scan says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Beam {
    /// Something was hit at this range (m).
    Hit(f32),
    /// Nothing within this range (m): free, with no end.
    Free(f32),
    /// No measurement: says nothing.
    Invalid,
}

impl LaserScan {
    /// What beam `i` says (REP-117); zero is no measurement, whatever the least range.
    pub fn beam(&self, i: usize) -> Beam {
        self.reading(self.ranges_m[i])
    }

    /// What the beams met, with the beam's number: first echoes in beam order, then those behind them, echo by echo.
    pub fn echoes(&self) -> impl Iterator<Item = (usize, Beam)> + '_ {
        let later = self.later_echoes_m.iter().enumerate().filter_map(|(k, &r)| match self.reading(r) {
            hit @ Beam::Hit(_) => Some((k % self.ranges_m.len().max(1), hit)),
            Beam::Free(_) | Beam::Invalid => None,
        });
        (0..self.ranges_m.len()).map(|i| (i, self.beam(i))).chain(later)
    }

    /// What a range says (REP-117); zero is no measurement, whatever the least range.
    pub fn reading(&self, r: f32) -> Beam {
        // The limits as ranges are stored: 5.6 m as such is a little less.
        let (min, max) = (self.range_min_m as f32, self.range_max_m as f32);
        if r.is_nan() || r <= 0.0 || r < min {
            Beam::Invalid
        } else if r >= max {
            Beam::Free(max)
        } else {
            Beam::Hit(r)
        }
    }

    /// Angle of beam `i`, radians in the sensor frame.
    pub fn angle(&self, i: usize) -> f64 {
        self.angle_min_rad + i as f64 * self.angle_increment_rad
    }

    /// The hits as points in the sensor frame (z = 0), in the order of [`LaserScan::echoes`].
    pub fn hits(&self) -> Vec<Point3<f32>> {
        self.echoes()
            .filter_map(|(i, beam)| match beam {
                Beam::Hit(r) => {
                    let (sin, cos) = self.angle(i).sin_cos();
                    Some(Point3::new((f64::from(r) * cos) as f32, (f64::from(r) * sin) as f32, 0.0))
                }
                _ => None,
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_of_another_length_are_named() {
        let mut cloud = PointCloud::from_positions(vec![Point3::origin(); 3]);
        cloud.intensities = Some(vec![0.0; 2]);
        assert_eq!(
            cloud.validate(),
            Err(GeometryError::ShapeMismatch { field: "intensities", expected: 3, actual: 2 })
        );
    }

    fn beams(range_min_m: f64, range_max_m: f64, ranges_m: Vec<f32>) -> Vec<Beam> {
        let scan = LaserScan {
            angle_min_rad: 0.0,
            angle_increment_rad: 0.1,
            range_min_m,
            range_max_m,
            time_increment_s: 0.0,
            ranges_m,
            intensities: None,
            later_echoes_m: vec![],
        };
        (0..scan.ranges_m.len()).map(|i| scan.beam(i)).collect()
    }

    #[test]
    fn beams_follow_rep_117() {
        let found = beams(0.1, 10.0, vec![1.0, f32::INFINITY, f32::NAN, f32::NEG_INFINITY, 0.05, 10.0, 12.0, 0.1]);
        let (free, invalid) = (Beam::Free(10.0), Beam::Invalid);
        assert_eq!(found, [Beam::Hit(1.0), free, invalid, invalid, invalid, free, free, Beam::Hit(0.1)]);
    }

    #[test]
    fn later_echoes_are_further_hits_of_the_same_beams() {
        let scan = LaserScan {
            angle_min_rad: 0.0,
            angle_increment_rad: 0.1,
            range_min_m: 0.1,
            range_max_m: 10.0,
            time_increment_s: 0.0,
            ranges_m: vec![1.0, 2.0],
            intensities: None,
            later_echoes_m: vec![f32::NAN, 3.0, 12.0, 4.0],
        };
        let expected = [(0, Beam::Hit(1.0)), (1, Beam::Hit(2.0)), (1, Beam::Hit(3.0)), (1, Beam::Hit(4.0))];
        assert_eq!(scan.echoes().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn a_beam_of_the_full_range_is_no_hit_and_zero_is_no_measurement() {
        // 5.6 is 5.5999999 as f32.
        assert_eq!(beams(0.0, 5.6, vec![5.6, 0.0, -1.0]), [Beam::Free(5.6), Beam::Invalid, Beam::Invalid]);
    }
}
