//! A furnished room whose depth along any ray has a closed form.

use nalgebra::{Point3, Translation3, Vector3};
use percept_geometry::{CameraIntrinsics, DepthImage, LaserScan, PointCloud, Pose, RgbImage, SensorSpec, se3};
use percept_slam::{CloudScan, DepthScan, PlanarScan, Scan};
use std::sync::Arc;

/// Walls, floor and ceiling seen from inside, boxes from outside: minimum and maximum corners.
pub(crate) struct Room {
    pub(crate) walls: (Vector3<f64>, Vector3<f64>),
    pub(crate) boxes: Vec<(Vector3<f64>, Vector3<f64>)>,
}

impl Room {
    /// 6 x 5 x 2.5 m with a table, a shelf, a crate and a pillar.
    pub(crate) fn furnished() -> Self {
        let v = Vector3::new;
        Self {
            walls: (v(-3.0, -2.5, 0.0), v(3.0, 2.5, 2.5)),
            boxes: vec![
                (v(1.2, -0.8, 0.0), v(2.0, 0.4, 0.75)),
                (v(2.6, 1.0, 0.0), v(3.0, 2.2, 1.9)),
                (v(0.4, 1.6, 0.0), v(0.9, 2.1, 0.5)),
                (v(-1.9, -1.4, 0.0), v(-1.6, -1.1, 2.5)),
                (v(-2.8, 1.0, 0.0), v(-2.0, 2.0, 1.1)),
            ],
        }
    }

    /// A corridor along x without ends in sight.
    pub(crate) fn corridor() -> Self {
        let v = Vector3::new;
        Self { walls: (v(-500.0, -1.0, 0.0), v(500.0, 1.0, 2.5)), boxes: vec![] }
    }

    /// Distance to the first surface.
    pub(crate) fn range(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> f64 {
        let slab = |(min, max): &(Vector3<f64>, Vector3<f64>)| {
            let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
            for k in 0..3 {
                let (a, b) = ((min[k] - origin[k]) / direction[k], (max[k] - origin[k]) / direction[k]);
                near = near.max(a.min(b));
                far = far.min(a.max(b));
            }
            (near, far)
        };
        let hit = |b: &(Vector3<f64>, Vector3<f64>)| {
            let (near, far) = slab(b);
            (near <= far && near > 0.0).then_some(near)
        };
        self.boxes.iter().filter_map(hit).fold(slab(&self.walls).1, f64::min)
    }

    pub(crate) fn depth(&self, t_world_base: &Pose, noise: &mut Noise) -> Scan {
        self.depth_by(CameraIntrinsics::primesense(), t_world_base, noise)
    }

    /// The same by another camera.
    pub(crate) fn depth_by(&self, k: CameraIntrinsics, t_world_base: &Pose, noise: &mut Noise) -> Scan {
        let t_base_sensor = camera_mount();
        let t = t_world_base * t_base_sensor;
        let origin = Point3::from(t.translation.vector);
        let data = (0..k.width * k.height)
            .map(|i| {
                let ray = k.ray((i % k.width) as f64, (i / k.width) as f64);
                let z = self.range(&origin, &(t.rotation * ray.coords));
                if z > 5.0 { 0.0 } else { (z + 0.0015 * z * z * noise.next()) as f32 }
            })
            .collect();
        let depth = Arc::new(DepthImage::new(k.width, k.height, data).unwrap());
        Scan::Depth(DepthScan { depth, color: None, intrinsics: k, t_base_sensor })
    }

    /// The same with colour: everything in blocks of that many metres, each of its own grey.
    pub(crate) fn painted(&self, t_world_base: &Pose, block_m: f64, noise: &mut Noise) -> Scan {
        let scan = self.depth(t_world_base, noise);
        let Scan::Depth(s) = scan else { return scan };
        let (k, t) = (s.intrinsics, t_world_base * s.t_base_sensor);
        let origin = Point3::from(t.translation.vector);
        let grey = |u: f64, v: f64| {
            let direction = t.rotation * k.ray(u, v).coords;
            shade(&(origin + direction * self.range(&origin, &direction)), block_m)
        };
        // Four rays a pixel, as its area sees.
        let pixel = |i: usize| {
            let (u, v) = ((i % k.width) as f64, (i / k.width) as f64);
            let rays = [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)];
            [(rays.iter().map(|(du, dv)| grey(u + du, v + dv)).sum::<f64>() / 4.0) as u8; 3]
        };
        let color = RgbImage::new(k.width, k.height, (0..k.width * k.height).flat_map(pixel).collect()).unwrap();
        Scan::Depth(DepthScan { color: Some(Arc::new(color)), ..s })
    }

    /// `rings` from -15 to 15 degrees, 900 columns; each point at its own time of a 0.1 s sweep that ends
    /// at the stamp, with base moving to `t_world_base` at constant `velocity`.
    pub(crate) fn cloud(
        &self,
        t_world_base: &Pose,
        rings: usize,
        velocity: &nalgebra::Vector6<f64>,
        noise: &mut Noise,
    ) -> Scan {
        let t_base_sensor = lidar_mount();
        let (mut positions, mut offsets) = (vec![], vec![]);
        for column in 0..900 {
            let time = 0.1 * (f64::from(column) / 899.0 - 1.0);
            let t = t_world_base * se3::exp(&(velocity * time)) * t_base_sensor;
            let origin = Point3::from(t.translation.vector);
            for ring in 0..rings {
                let up = (-15.0 + 30.0 * ring as f64 / (rings - 1) as f64).to_radians();
                let around = f64::from(column) / 900.0 * std::f64::consts::TAU;
                let d = Vector3::new(up.cos() * around.cos(), up.cos() * around.sin(), up.sin());
                let r = self.range(&origin, &(t.rotation * d)) + 0.01 * noise.next();
                positions.push(Point3::from((d * r).cast::<f32>()));
                offsets.push(time as f32);
            }
        }
        let cloud = PointCloud { positions, time_offsets_s: Some(offsets), ..PointCloud::default() };
        Scan::Cloud(CloudScan { cloud: Arc::new(cloud), t_base_sensor })
    }

    /// 270 degrees in half degrees, all beams at once.
    pub(crate) fn scan(&self, t_world_base: &Pose, noise: &mut Noise) -> Scan {
        self.sweep(|_| *t_world_base, 0.0, noise)
    }

    /// The same, beam after beam: where base is so many seconds after the first one.
    pub(crate) fn sweep(&self, t_world_base: impl Fn(f64) -> Pose, time_increment_s: f64, noise: &mut Noise) -> Scan {
        let t_base_sensor = lidar_mount();
        let (angle_min_rad, angle_increment_rad) = (-135f64.to_radians(), 0.5f64.to_radians());
        let ranges_m = (0..541)
            .map(|i| {
                let t = t_world_base(f64::from(i) * time_increment_s) * t_base_sensor;
                let a = angle_min_rad + f64::from(i) * angle_increment_rad;
                let direction = t.rotation * Vector3::new(a.cos(), a.sin(), 0.0);
                (self.range(&Point3::from(t.translation.vector), &direction) + 0.01 * noise.next()) as f32
            })
            .collect();
        let scan = LaserScan {
            angle_min_rad,
            angle_increment_rad,
            range_min_m: 0.05,
            range_max_m: 20.0,
            time_increment_s,
            ranges_m,
            intensities: None,
            later_echoes_m: vec![],
        };
        Scan::Planar(PlanarScan { scan: Arc::new(scan), t_base_sensor })
    }

    /// How far a point is from the nearest surface that a planar lidar at its height can see, metres.
    pub(crate) fn distance(&self, p: &Point3<f64>) -> f64 {
        let beside = |(min, max): &(Vector3<f64>, Vector3<f64>)| {
            let outside = (0..2).map(|k| (min[k] - p[k]).max(p[k] - max[k]));
            let inside = outside.clone().fold(f64::NEG_INFINITY, f64::max);
            if inside < 0.0 { -inside } else { outside.map(|d| d.max(0.0).powi(2)).sum::<f64>().sqrt() }
        };
        self.boxes.iter().filter(|b| b.0.z <= p.z && p.z <= b.1.z).map(beside).fold(beside(&self.walls), f64::min)
    }
}

/// Grey of the block that a point lies in, 40 to 167.
fn shade(p: &Point3<f64>, block_m: f64) -> f64 {
    // Off the surfaces' own coordinates, which would else lie on the border of two blocks.
    let block = p.coords.map(|x| ((x + 0.0137) / block_m).floor() as i64);
    let mixed = (block.x * 7_919 + block.y * 104_729 + block.z * 1_299_709).wrapping_mul(2_654_435_761);
    40.0 + ((mixed >> 9) & 0x7F) as f64
}

/// The camera 0.5 m up, 0.1 m ahead, looking forward.
pub(crate) fn camera_mount() -> Pose {
    Pose::from_parts(Translation3::new(0.1, 0.0, 0.5), SensorSpec::optical_rotation())
}

/// The lidar 0.4 m up, turned a little.
pub(crate) fn lidar_mount() -> Pose {
    Pose::from_parts(Translation3::new(0.05, 0.0, 0.4), nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, 0.2))
}

/// Standard normal numbers, the same every time (sum of twelve uniform ones from a linear congruence).
pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    pub(crate) fn next(&mut self) -> f64 {
        let mut uniform = || {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }
}

/// A drive through the room from rest to rest: pose of base at frame `i` of `n`.
pub(crate) fn drive(i: usize, n: usize) -> Pose {
    drive_at(i as f64 / n as f64)
}

/// The same after a share of it.
pub(crate) fn drive_at(share: f64) -> Pose {
    let s = std::f64::consts::TAU * share;
    let a = s - s.sin();
    se3::from_xy_yaw(0.7 * a.sin() - 0.6, 0.5 * (1.0 - a.cos()) - 0.4, 0.8 * (2.0 * a).sin())
}

/// Base's velocity over the last step of 0.1 s.
pub(crate) fn velocity(i: usize, n: usize) -> nalgebra::Vector6<f64> {
    if i == 0 { nalgebra::Vector6::zeros() } else { se3::log(&(drive(i - 1, n).inverse() * drive(i, n))) / 0.1 }
}
