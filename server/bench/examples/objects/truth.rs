//! KITTI's labels: scans, boxes in the lidar's frame, and what the camera sees.

use crate::Failure;
use nalgebra::{Matrix3x4, Matrix4, Point3, Vector3, Vector4};
use percept_formats::{Limits, read_cloud_file};
use percept_geometry::{ObjectClass, OrientedBox3, PointCloud};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// A labelled thing.
pub(crate) struct TrueObject {
    /// What the label says.
    pub(crate) name: String,
    /// Its track.
    pub(crate) track: i64,
    /// Box in the lidar's frame.
    pub(crate) bbox: OrientedBox3,
    /// Points of the scan in it.
    pub(crate) num_points: usize,
}

/// A scan and what is labelled in it.
pub(crate) struct Frame {
    pub(crate) number: usize,
    pub(crate) scan: PointCloud,
    pub(crate) objects: Vec<TrueObject>,
    /// Parts of the image in which nothing was labelled: left, top, right, bottom, pixels.
    pub(crate) ignored: Vec<[f64; 4]>,
    pub(crate) camera: Camera,
}

/// The colour camera on the left.
#[derive(Clone)]
pub(crate) struct Camera {
    image_lidar: Matrix3x4<f64>,
    lidar_camera: Matrix4<f64>,
    size: [f64; 2],
}

impl Camera {
    fn new(text: &str, size: [f64; 2]) -> Result<Self, Failure> {
        let numbers = |names: [&str; 2], count: usize| -> Result<Vec<f64>, Failure> {
            let line = text.lines().find(|l| names.iter().any(|n| l.starts_with(n)));
            let words = line.ok_or("calib.txt lacks a line")?.split_whitespace().skip(1);
            let numbers: Vec<f64> = words.map(str::parse).collect::<Result<_, _>>()?;
            if numbers.len() < count { Err("calib.txt has a short line".into()) } else { Ok(numbers) }
        };
        let p = Matrix3x4::from_row_slice(&numbers(["P2", "P2"], 12)?[..12]);
        let r = nalgebra::Matrix3::from_row_slice(&numbers(["R0_rect", "R_rect"], 9)?[..9]);
        let t = Matrix3x4::from_row_slice(&numbers(["Tr_velo_to_cam", "Tr_velo_cam"], 12)?[..12]);
        let (mut rect, mut camera_lidar) = (Matrix4::identity(), Matrix4::identity());
        rect.fixed_view_mut::<3, 3>(0, 0).copy_from(&r);
        camera_lidar.fixed_view_mut::<3, 4>(0, 0).copy_from(&t);
        let camera_lidar = rect * camera_lidar;
        let lidar_camera = camera_lidar.try_inverse().ok_or("calib.txt: no rotation")?;
        Ok(Self { image_lidar: p * camera_lidar, lidar_camera, size })
    }

    /// Where a place is in the image, pixels; none behind the camera or outside.
    pub(crate) fn pixel(&self, p: &Point3<f64>) -> Option<[f64; 2]> {
        let q = self.image_lidar * p.to_homogeneous();
        let at = [q.x / q.z, q.y / q.z];
        let inside = |i: usize| (0.0..self.size[i]).contains(&at[i]);
        (q.z > 0.1 && inside(0) && inside(1)).then_some(at)
    }

    fn bbox(&self, [height, width, length, x, y, z, turn]: [f64; 7]) -> OrientedBox3 {
        let center = (self.lidar_camera * Vector4::new(x, y - 0.5 * height, z, 1.0)).xyz();
        OrientedBox3::upright(center.into(), Vector3::new(length, width, height), -turn - std::f64::consts::FRAC_PI_2)
    }
}

impl Frame {
    /// Whether nothing was labelled where this is, so that it is neither right nor wrong: outside the image, or in a
    /// part of it that was left out.
    pub(crate) fn is_unlabelled(&self, p: &Point3<f64>) -> bool {
        let inside = |[u, v]: [f64; 2], r: &[f64; 4]| (r[0]..=r[2]).contains(&u) && (r[1]..=r[3]).contains(&v);
        self.camera.pixel(p).is_none_or(|at| self.ignored.iter().any(|r| inside(at, r)))
    }
}

/// What a label's name is among our classes; none for other things.
pub(crate) fn class_of(name: &str) -> Option<ObjectClass> {
    match name {
        "Car" => Some(ObjectClass::Car),
        "Van" => Some(ObjectClass::Van),
        "Truck" => Some(ObjectClass::Truck),
        "Bus" => Some(ObjectClass::Bus),
        "Pedestrian" | "Person_sitting" => Some(ObjectClass::Person),
        "Cyclist" => Some(ObjectClass::Cyclist),
        "Motorcycle" => Some(ObjectClass::Motorcycle),
        _ => None,
    }
}

/// Number of points in a box.
pub(crate) fn points_in(scan: &PointCloud, bbox: &OrientedBox3) -> usize {
    scan.positions.iter().filter(|p| bbox.contains(&p.cast())).count()
}

/// The frames of a folder of KITTI's tracking or object benchmark, those in `range` counted from the first.
pub(crate) fn frames(folder: &Path, range: Range<usize>) -> Result<Vec<Frame>, Failure> {
    let mut scans: Vec<PathBuf> =
        std::fs::read_dir(folder.join("velodyne"))?.map(|e| Ok(e?.path())).collect::<Result<_, Failure>>()?;
    scans.sort();
    let wanted = scans.into_iter().skip(range.start).take(range.end.saturating_sub(range.start));
    let tracking = std::fs::read_to_string(folder.join("label_02.txt")).ok();
    wanted
        .map(|path| {
            let name = path.file_stem().and_then(|s| s.to_str()).unwrap_or_default().to_owned();
            let number: usize = name.parse()?;
            let scan = read_cloud_file(&path, &Limits::default())?.cloud;
            let (labels, calibration, size) = match &tracking {
                // Images of the tracking benchmark's first drives.
                Some(text) => (of_frame(text, number), folder.join("calib.txt"), [1242.0, 375.0]),
                None => (
                    std::fs::read_to_string(folder.join(format!("label_2/{name}.txt")))?
                        .lines()
                        .zip(0..)
                        .map(|(l, i)| format!("{i} {l}"))
                        .collect(),
                    folder.join(format!("calib/{name}.txt")),
                    png_size(&folder.join(format!("image_2/{name}.png")))?,
                ),
            };
            let camera = Camera::new(&std::fs::read_to_string(calibration)?, size)?;
            let mut frame = Frame { number, scan, objects: vec![], ignored: vec![], camera };
            for label in &labels {
                frame.add(label)?;
            }
            Ok(frame)
        })
        .collect()
}

/// The labels of a frame, without its number.
fn of_frame(text: &str, number: usize) -> Vec<String> {
    let split = |line: &str| line.split_once(' ').map(|(frame, rest)| (frame.to_owned(), rest.to_owned()));
    let of_it = |(frame, rest): (String, String)| (frame.parse() == Ok(number)).then_some(rest);
    text.lines().filter_map(split).filter_map(of_it).collect()
}

fn png_size(path: &Path) -> Result<[f64; 2], Failure> {
    let bytes = std::fs::read(path)?;
    let number = |at: usize| -> Result<f64, Failure> {
        let four: [u8; 4] = bytes.get(at..at + 4).ok_or("image_2: a short file")?.try_into()?;
        Ok(f64::from(u32::from_be_bytes(four)))
    };
    Ok([number(16)?, number(20)?])
}

impl Frame {
    /// Adds a label: track, class, and the numbers of KITTI's format.
    fn add(&mut self, label: &str) -> Result<(), Failure> {
        let words: Vec<&str> = label.split_whitespace().collect();
        let [track, name, ..] = words[..] else { return Err("a short label".into()) };
        let numbers: Vec<f64> = words[2..].iter().map(|w| w.parse()).collect::<Result<_, _>>()?;
        if name == "DontCare" {
            self.ignored.push(numbers.get(3..7).ok_or("a short label")?.try_into()?);
            return Ok(());
        }
        let bbox = self.camera.bbox(numbers.get(7..14).ok_or("a short label")?.try_into()?);
        let num_points = points_in(&self.scan, &bbox);
        self.objects.push(TrueObject { name: name.into(), track: track.parse()?, bbox, num_points });
        Ok(())
    }
}
