//! A learned detector on a recording with depth: `detector MODEL LABELS PATH [--frames A..B] [--layout fastest_det|yolo_v8|
//! boxes_scores] [--threshold S] [--out PNG]`.
//!
//! MODEL is an ONNX file, LABELS a text with one label a line, PATH a recording of depth and colour. Of each frame what was
//! found is told, with the size of its box in space and where its middle is; the largest plane that looks up is taken for
//! z = 0. Times are those of one thread, milliseconds: of detecting, of finding planes, of lifting. PNG shows the last of the
//! frames, with rectangles (thin) and lifted boxes (bold).

use nalgebra::{Point3, UnitQuaternion, Vector3};
use percept_formats::dataset;
use percept_geometry::{CameraIntrinsics, DepthImage, Pose, RgbImage, SensorData};
use percept_inference::{Detector, DetectorSpec, InferenceThreads, ModelLimits, OutputLayout};
use percept_perception::depth::{DepthPlaneParams, depth_planes};
use percept_perception::detection::{Detection2d, LiftParams, Lifter, NotLifted};
use percept_pictures::{ImageThing, encode_png, things_in_image};
use std::error::Error;
use std::ops::Range;
use std::path::Path;
use std::time::Instant;

type Failure = Box<dyn Error + Send + Sync>;

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let usage = "usage: detector MODEL LABELS PATH [--frames A..B] [--layout NAME] [--threshold S] [--out PNG]";
    let [model, labels, path, ..] = &args[..] else { return Err(usage.into()) };
    let after = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let range = after("--frames").map_or(Ok(0..usize::MAX), |r| parse_range(r).ok_or("--frames: write A..B"))?;
    let layout = after("--layout").map_or("fastest_det", String::as_str);
    let layout: OutputLayout = serde_json::from_value(layout.into())?;
    let labels = std::fs::read_to_string(labels)?;
    let mut spec = DetectorSpec::new("detector", &labels.lines().collect::<Vec<_>>(), layout);
    if let Some(threshold) = after("--threshold") {
        spec.score_threshold = threshold.parse()?;
    }
    let start = Instant::now();
    let detector = Detector::new(&std::fs::read(model)?, spec, &ModelLimits::default(), &InferenceThreads::new(1))?;
    let [width, height] = detector.input_px();
    let work = detector.multiply_adds() as f64 / 1e6;
    println!("loaded in {:.0} ms: {width} x {height}, {work:.0} million multiplications", ms_since(start));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| run(&detector, Path::new(path), range, after("--out").map(Path::new)))
}

fn parse_range(text: &str) -> Option<Range<usize>> {
    let (from, to) = text.split_once("..")?;
    Some(from.parse().ok()?..to.parse().ok()?)
}

fn run(detector: &Detector, path: &Path, range: Range<usize>, out: Option<&Path>) -> Result<(), Failure> {
    let recording = dataset::open(path)?;
    let camera = recording.sensors.first().and_then(|s| s.intrinsics).ok_or("the recording has no camera")?;
    let [mut detecting, mut planes, mut lifting] = [vec![], vec![], vec![]];
    let images = recording.frames(None).filter_map(|frame| match frame.map(|f| f.data) {
        Ok(SensorData::Rgbd(depth, color)) => Some(Ok((depth, color))),
        Ok(_) => None,
        Err(error) => Some(Err(error)),
    });
    let mut last = None;
    for (number, images) in images.enumerate().take(range.end).skip(range.start) {
        let (depth, color) = images?;
        let start = Instant::now();
        let found = detector.detect(&color)?;
        detecting.push(ms_since(start));
        let t_map_camera = level(&depth, &camera)?;
        let start = Instant::now();
        let lifter = Lifter::new(&depth, &camera, &t_map_camera, &LiftParams::default())?;
        planes.push(ms_since(start));
        println!("frame {number}: {} found", found.len());
        let mut things = vec![];
        for detection in found {
            let start = Instant::now();
            let lifted = lifter.lift(&detection.bbox);
            lifting.push(ms_since(start));
            tell(&detection, &lifted);
            things.push(thing(&detection, lifted.ok().map(|l| l.bbox), &t_map_camera));
        }
        last = Some((color, things));
    }
    for (what, times) in [("detecting", detecting), ("planes", planes), ("lifting a box", lifting)] {
        print_times(what, times);
    }
    if let (Some(out), Some((color, things))) = (out, last) {
        draw(&color, &camera, &things, out)?;
    }
    Ok(())
}

fn draw(color: &RgbImage, camera: &CameraIntrinsics, things: &[ImageThing], out: &Path) -> Result<(), Failure> {
    Ok(std::fs::write(out, encode_png(&things_in_image(color, camera, things)?)?)?)
}

fn thing(detection: &Detection2d, bbox: Option<percept_geometry::OrientedBox3>, t_map_camera: &Pose) -> ImageThing {
    let b = &detection.bbox;
    let size = bbox.map_or(String::new(), |b| format!(" {:.2} x {:.2} x {:.2} m", b.size.x, b.size.y, b.size.z));
    let label = format!("{} {:.2}{size}", detection.label, detection.score);
    ImageThing::new(label, [b.left_px, b.top_px, b.right_px, b.bottom_px], bbox, t_map_camera)
}

fn tell(detection: &Detection2d, lifted: &Result<percept_perception::detection::Lifted, NotLifted>) {
    let b = &detection.bbox;
    let place = format!("{:.0} {:.0} to {:.0} {:.0} px", b.left_px, b.top_px, b.right_px, b.bottom_px);
    print!("  {:<14} {:.2}  {place:<28}", detection.label, detection.score);
    match lifted {
        Ok(l) => {
            let (size, at) = (l.bbox.size, l.bbox.center());
            let stands = l.support_z_m.map_or(String::new(), |z| format!(", stands at z {z:.2}"));
            println!(
                "{:.2} x {:.2} x {:.2} m at ({:.2}, {:.2}, {:.2}), {:.2} m off, {} points{stands}",
                size.x, size.y, size.z, at.x, at.y, at.z, l.depth_m, l.num_points
            );
        }
        Err(reason) => println!("{reason}"),
    }
}

/// The camera over the largest plane that looks up, as far as the camera is upright within 70 degrees; the camera upright and at
/// z = 0 if there is none.
fn level(depth: &DepthImage, camera: &CameraIntrinsics) -> Result<Pose, Failure> {
    let found = depth_planes(depth, camera, &DepthPlaneParams::default())?;
    let up = -Vector3::y();
    let floor = found.planes.iter().find(|p| p.plane.normal.dot(&up) > 0.34);
    let (normal, offset) = floor.map_or((up, 0.0), |p| (p.plane.normal.into_inner(), p.plane.offset));
    let turn = UnitQuaternion::rotation_between(&normal, &Vector3::z()).unwrap_or_default();
    // The view ahead becomes x as seen from above.
    let ahead = turn * Vector3::z();
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -ahead.y.atan2(ahead.x)) * turn;
    Ok(Pose::from_parts(Point3::new(0.0, 0.0, offset).coords.into(), turn))
}

fn ms_since(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

fn print_times(what: &str, mut ms: Vec<f64>) {
    ms.sort_by(f64::total_cmp);
    let at = |share: f64| ms.get((ms.len().saturating_sub(1) as f64 * share).round() as usize).copied().unwrap_or(0.0);
    println!("{what}: {} times, p50 {:.2} ms, p99 {:.2} ms", ms.len(), at(0.5), at(0.99));
}
