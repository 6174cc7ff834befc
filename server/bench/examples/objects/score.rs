//! Detections and tracks against labels.

use crate::Failure;
use crate::truth::{Frame, TrueObject, class_of};
use nalgebra::Point3;
use percept_evaluation::{IdentityPair, average_precision, best_pairs, calibration_error, identity_score};
use percept_geometry::shapes::convex_intersection_area;
use percept_geometry::{ObjectClass, OrientedBox3, Pose, Timestamp, se3};
use percept_perception::detection::Detection;
use percept_scene::{Observation, Tracker, TrackerParams, Visibility};
use std::collections::BTreeMap;

/// Labelled things with fewer points are not asked for.
pub(crate) const MIN_POINTS: usize = 10;
/// Precision is told of what is nearer than this, metres in the plane.
const NEAR_M: f64 = 40.0;

/// Overlap of footprints, intersection over union.
pub(crate) fn iou_flat(a: &OrientedBox3, b: &OrientedBox3) -> f64 {
    let shared = convex_intersection_area(&a.footprint(), &b.footprint());
    shared / (a.size.x * a.size.y + b.size.x * b.size.y - shared).max(1e-9)
}

/// Pairs (found, labelled) that overlap by at least `least`.
pub(crate) fn pairs(
    found: &[Detection],
    truth: &[TrueObject],
    overlap: impl Fn(&OrientedBox3, &OrientedBox3) -> f64,
    least: f64,
) -> Vec<(usize, usize)> {
    let row = |d: &Detection| truth.iter().map(|o| overlap(&d.bbox, &o.bbox)).collect();
    best_pairs(&found.iter().map(row).collect::<Vec<Vec<f64>>>(), least)
}

fn is_near(p: &Point3<f64>) -> bool {
    p.coords.xy().norm() < NEAR_M
}

/// Kinds that are told apart when asked whether the class is right: labels of vans and trucks go by length only.
fn kind(class: ObjectClass) -> &'static str {
    match class {
        ObjectClass::Car | ObjectClass::Van | ObjectClass::Truck | ObjectClass::Bus => "vehicle",
        ObjectClass::Cyclist | ObjectClass::Motorcycle => "cyclist",
        ObjectClass::Person => "person",
        _ => "unknown",
    }
}

/// Sums over frames.
#[derive(Default)]
pub(crate) struct Score {
    /// Whether what is missed, loose or wrong is printed as it comes.
    pub(crate) lists: bool,
    num_frames: usize,
    num_true: usize,
    hits: BTreeMap<&'static str, usize>,
    /// Detections of a class, of which precision is told: confidence, whether it is right.
    judged: Vec<(f64, bool)>,
    num_class: [usize; 3],
    by_name: BTreeMap<String, [usize; 2]>,
    confusion: BTreeMap<(String, String), usize>,
    center_errors: Vec<f64>,
}

impl Score {
    /// Takes in a frame. Recall counts whatever was found, and again only what was given a class; precision counts that
    /// only.
    pub(crate) fn add(&mut self, frame: &Frame, found: &[Detection]) {
        self.num_frames += 1;
        let asked = |t: &usize| frame.objects[*t].num_points >= MIN_POINTS;
        self.num_true += (0..frame.objects.len()).filter(asked).count();
        let classed: Vec<Detection> = found.iter().filter(|d| d.class != ObjectClass::Unknown).cloned().collect();
        let iou3 = |a: &OrientedBox3, b: &OrientedBox3| a.iou_upright(b);
        let all = pairs(found, &frame.objects, iou3, 0.25);
        let of_class = pairs(&classed, &frame.objects, iou3, 0.25);
        if self.lists {
            list(frame, found);
        }
        let mut count = |name, pairs: &[(usize, usize)]| {
            *self.hits.entry(name).or_default() += pairs.iter().filter(|p| asked(&p.1)).count();
        };
        count("3D@0.25", &all);
        count("3D@0.25 classed", &of_class);
        count("BEV@0.5", &pairs(found, &frame.objects, iou_flat, 0.5));
        count("BEV@0.5 classed", &pairs(&classed, &frame.objects, iou_flat, 0.5));
        for (t, o) in frame.objects.iter().enumerate().filter(|(t, _)| asked(t)) {
            let entry = self.by_name.entry(o.name.clone()).or_default();
            entry[0] += usize::from(of_class.iter().any(|p| p.1 == t));
            entry[1] += 1;
        }
        for &(d, t) in all.iter().filter(|p| asked(&p.1)) {
            let o = &frame.objects[t];
            self.center_errors.push((found[d].bbox.center() - o.bbox.center()).xy().norm());
            *self.confusion.entry((o.name.clone(), found[d].class.name().to_owned())).or_default() += 1;
            if let Some(class) = class_of(&o.name) {
                self.num_class[0] += 1;
                self.num_class[1] += usize::from(kind(class) == kind(found[d].class));
                self.num_class[2] += usize::from(class == found[d].class);
            }
        }
        for (i, d) in classed.iter().enumerate() {
            let pair = of_class.iter().find(|p| p.0 == i).map(|p| p.1);
            let counts = match pair {
                Some(t) => asked(&t) && is_near(&frame.objects[t].bbox.center()),
                None => is_near(&d.bbox.center()) && !frame.is_unlabelled(&d.bbox.center()),
            };
            if counts {
                self.judged.push((d.confidence, pair.is_some()));
            }
        }
    }

    /// Prints the figures.
    pub(crate) fn print(&mut self, mut ms: Vec<f64>) {
        let share = |a: usize, b: usize| a as f64 / b.max(1) as f64;
        print!("  {} frames, {} objects; recall", self.num_frames, self.num_true);
        self.hits.iter().for_each(|(name, hits)| print!("  {name} {:.3}", share(*hits, self.num_true)));
        let right = self.judged.iter().filter(|j| j.1).count();
        println!(
            "\n  precision {:.3} ({right} of {}), average precision {:.3}, calibration error {:.3}",
            share(right, self.judged.len()),
            self.judged.len(),
            average_precision(&self.judged, self.num_true).unwrap_or(0.0),
            calibration_error(&self.judged, 10).unwrap_or(0.0)
        );
        let [num, kind, class] = self.num_class;
        println!("  class right: kind {:.3}, exact {:.3}", share(kind, num), share(class, num));
        println!("  found as some class: {:?}", self.by_name);
        println!("  called: {:?}", self.confusion);
        let mean = self.center_errors.iter().sum::<f64>() / self.center_errors.len().max(1) as f64;
        ms.sort_by(f64::total_cmp);
        let at = |q: f64| ms.get((ms.len().saturating_sub(1) as f64 * q) as usize).copied().unwrap_or(0.0);
        println!("  centres off by {mean:.3} m; ms a scan p50 {:.1} p99 {:.1} max {:.1}", at(0.5), at(0.99), at(1.0));
    }
}

/// Prints each labelled thing with the found one that overlaps it most, where they share less than half seen from
/// above, and what was found where nothing is.
fn list(frame: &Frame, found: &[Detection]) {
    let shape = |b: &OrientedBox3| {
        let (c, s) = (b.center(), b.size);
        let yaw = se3::yaw(&b.t_frame_box).to_degrees();
        format!("{:.1} {:.1} {:.1}, {:.2} x {:.2} x {:.2}, {yaw:.0} deg", c.x, c.y, c.z, s.x, s.y, s.z)
    };
    for o in &frame.objects {
        let best = found.iter().max_by(|a, b| iou_flat(&a.bbox, &o.bbox).total_cmp(&iou_flat(&b.bbox, &o.bbox)));
        let Some(d) = best.filter(|d| iou_flat(&d.bbox, &o.bbox) < 0.5 || d.class == ObjectClass::Unknown) else {
            continue;
        };
        let overlap = iou_flat(&d.bbox, &o.bbox);
        println!("  {} {}, {} points: {}", frame.number, o.name, o.num_points, shape(&o.bbox));
        println!("    overlaps by {overlap:.2} a {} {:.2}: {}", d.class.name(), d.confidence, shape(&d.bbox));
    }
    for d in found.iter().filter(|d| d.class != ObjectClass::Unknown && is_near(&d.bbox.center())) {
        let is_true = frame.objects.iter().any(|o| iou_flat(&d.bbox, &o.bbox) > 0.0);
        if !is_true && !frame.is_unlabelled(&d.bbox.center()) {
            println!(
                "  {} wrong {} {:.2}, {} points: {}",
                frame.number,
                d.class.name(),
                d.confidence,
                d.num_points,
                shape(&d.bbox)
            );
        }
    }
}

/// Follows what was given a class through the frames, 0.1 s apart, and prints how well things keep their identity. A
/// track has a box in those frames in which it is listed and was seen; a match overlaps by a quarter seen from above.
pub(crate) fn track(
    frames: &[Frame],
    found: &[Vec<Detection>],
    t_map_lidar: &[Pose],
    params: &TrackerParams,
) -> Result<(), Failure> {
    let mut tracker = Tracker::new(params.clone())?;
    let mut out: Vec<IdentityPair> = vec![];
    let mut false_boxes = 0;
    for ((i, frame), (found, t)) in frames.iter().enumerate().zip(found.iter().zip(t_map_lidar)) {
        let stamp = Timestamp::from_nanos(100_000_000 * i as i64);
        let place = |b: &OrientedBox3| {
            let center = t * b.center();
            OrientedBox3::upright(center, b.size, se3::yaw(&(t * b.t_frame_box)))
        };
        let observations: Vec<Observation> = found
            .iter()
            .filter(|d| d.class != ObjectClass::Unknown)
            .map(|d| Observation {
                class: d.class,
                confidence: d.confidence,
                bbox: place(&d.bbox),
                num_points: d.num_points,
                is_moving: false,
                is_seen: true,
            })
            .collect();
        tracker.update(stamp, &observations, &|_| Visibility::Unseen);
        let objects = tracker.objects();
        let listed: Vec<_> = objects.iter().filter(|o| o.last_seen == stamp).collect();
        let truth: Vec<OrientedBox3> = frame.objects.iter().map(|o| place(&o.bbox)).collect();
        let row = |b: &OrientedBox3| truth.iter().map(|o| iou_flat(b, o)).collect::<Vec<f64>>();
        let pairs = best_pairs(&listed.iter().map(|o| row(&o.bbox)).collect::<Vec<_>>(), 0.25);
        for (n, o) in listed.iter().enumerate() {
            let id = Some(i64::try_from(o.id.0)?);
            let center = t.inverse() * o.bbox.center();
            match pairs.iter().find(|p| p.0 == n) {
                Some(p) if frame.objects[p.1].num_points >= MIN_POINTS => {
                    out.push((Some(frame.objects[p.1].track), id))
                }
                Some(_) => {}
                None if is_near(&center) && !frame.is_unlabelled(&center) => {
                    false_boxes += 1;
                    out.push((None, id));
                }
                None => {}
            }
        }
        for (n, o) in frame.objects.iter().enumerate() {
            if o.num_points >= MIN_POINTS && pairs.iter().all(|p| p.1 != n) {
                out.push((Some(o.track), None));
            }
        }
    }
    let score = identity_score(&out);
    println!(
        "  tracks: IDF1 {:.3}; {} boxes of {} identified, {} tracked, {false_boxes} of nothing, {} switches",
        score.idf1.unwrap_or(0.0),
        score.num_identified,
        score.num_true,
        score.num_tracked,
        score.num_switches
    );
    Ok(())
}
