//! Image features on frames of a recording: pairs ten frames apart, as the peers' cases take them.

use super::Case;
use crate::{Args, BenchError};
use nalgebra::{Isometry3, Matrix4, Point2};
use percept_formats::{Limits, decode_color, read_file};
use percept_geometry::{CameraIntrinsics, GrayImage};
use percept_perception::features2d::{
    Descriptors, Features, MatchParams, Orb, OrbParams, Sift, SiftParams, match_features,
};
use percept_perception::multiview::{EssentialEstimate, RansacParams, estimate_essential};
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};

/// Pairs (0, 10), (10, 20) … (90, 100).
const PAIRS: usize = 10;

/// A case of many frames or pairs: a function of each, and what is told of all results.
struct Stream<R, F, E> {
    items: usize,
    count: usize,
    work: F,
    extra: E,
    last: Vec<R>,
}

impl<R, F: FnMut(usize) -> Result<R, BenchError>, E: Fn(&[R]) -> Value> Case for Stream<R, F, E> {
    fn items(&self) -> usize {
        self.items
    }

    fn run(&mut self) -> Result<Option<usize>, BenchError> {
        self.last.clear();
        for i in 0..self.count {
            self.last.push((self.work)(i)?);
        }
        Ok(Some(self.count))
    }

    fn extra(&self) -> Map<String, Value> {
        match (self.extra)(&self.last) {
            Value::Object(map) => map,
            _ => Map::new(),
        }
    }
}

fn mean(values: impl Iterator<Item = usize>) -> f64 {
    let values: Vec<usize> = values.collect();
    values.iter().sum::<usize>() as f64 / values.len().max(1) as f64
}

fn gray(dir: &Path, frame: usize) -> Result<GrayImage, BenchError> {
    let limits = Limits::default();
    let bytes = read_file(&dir.join(format!("{frame:04}.color.jpg")), &limits).map_err(BenchError::new)?;
    Ok(decode_color(&bytes, &limits).map_err(BenchError::new)?.to_gray())
}

fn frames(args: &Args) -> Result<Vec<GrayImage>, BenchError> {
    let dir: PathBuf = args.required("dir")?;
    (0..=PAIRS).map(|i| gray(&dir, i * 10)).collect()
}

/// Either method.
enum Extractor {
    Orb(Orb),
    Sift(Box<Sift>),
}

impl Extractor {
    fn new(kind: &str, max_features: usize) -> Result<Self, BenchError> {
        match kind {
            "orb" => {
                Ok(Self::Orb(Orb::new(OrbParams { max_features, ..OrbParams::default() }).map_err(BenchError::new)?))
            }
            "sift" => {
                let params = SiftParams { max_features, ..SiftParams::default() };
                Ok(Self::Sift(Box::new(Sift::new(params).map_err(BenchError::new)?)))
            }
            _ => Err(BenchError(format!("kind={kind} is neither orb nor sift"))),
        }
    }

    fn extract(&mut self, image: &GrayImage) -> Result<Features, BenchError> {
        match self {
            Self::Orb(orb) => orb.extract(image),
            Self::Sift(sift) => sift.extract(image),
        }
        .map_err(BenchError::new)
    }
}

fn features(args: &Args, kind: &str) -> Result<Box<dyn Case>, BenchError> {
    let images = frames(args)?;
    let mut extractor = Extractor::new(kind, args.or("max_features", 1000)?)?;
    let (items, count) = (images[0].data().len(), images.len());
    Ok(Box::new(Stream {
        items,
        count,
        work: move |i: usize| extractor.extract(&images[i]),
        extra: |last: &[Features]| json!({"keypoints_mean": mean(last.iter().map(|f| f.keypoints.len()))}),
        last: Vec::new(),
    }))
}

/// `features_orb dir= max_features=`.
pub(super) fn orb(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    features(args, "orb")
}

/// `features_sift dir= max_features=`.
pub(super) fn sift(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    features(args, "sift")
}

/// Features of all frames, found before the clock starts.
fn all_features(args: &Args) -> Result<Vec<Features>, BenchError> {
    let mut extractor = Extractor::new(&args.required::<String>("kind")?, args.or("max_features", 1000)?)?;
    frames(args)?.iter().map(|image| extractor.extract(image)).collect()
}

/// `match_features dir= kind= max_features= ratio=`: brute force, ratio test.
pub(super) fn matching(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let found = all_features(args)?;
    let params = MatchParams { ratio: args.or("ratio", 0.75)?, ..MatchParams::default() };
    let descriptors: Vec<Descriptors> = found.into_iter().map(|f| f.descriptors).collect();
    let n = descriptors[0].len();
    Ok(Box::new(Stream {
        items: n * n,
        count: PAIRS,
        work: move |i: usize| match_features(&descriptors[i], &descriptors[i + 1], &params).map_err(BenchError::new),
        extra: |last: &[Vec<_>]| json!({"matches_mean": mean(last.iter().map(Vec::len))}),
        last: Vec::new(),
    }))
}

/// The numbers of a text file.
fn numbers(path: &Path) -> Result<Vec<f64>, BenchError> {
    let text =
        String::from_utf8(read_file(path, &Limits::default()).map_err(BenchError::new)?).map_err(BenchError::new)?;
    text.split_whitespace().map(|w| w.parse().map_err(BenchError::new)).collect()
}

/// Pixels of the first and of the second frame.
type Pixels = (Vec<Point2<f64>>, Vec<Point2<f64>>);

/// `essential dir= kind=`: the motion of each pair from matches at ratio 0.8, against the recording's poses.
pub(super) fn essential(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let dir: PathBuf = args.required("dir")?;
    let k = numbers(&dir.join("K.txt"))?;
    let camera = CameraIntrinsics::pinhole(640, 480, k[0], k[4], k[2], k[5]);
    let poses = numbers(&dir.join("poses.txt"))?;
    let pose = |i: usize| Matrix4::from_row_slice(&poses[i * 16..i * 16 + 16]);
    let truth = (0..PAIRS)
        .map(|i| {
            let t = pose(10 * i + 10).try_inverse().ok_or_else(|| BenchError("poses.txt: not a pose".to_owned()))?;
            Ok(isometry(&(t * pose(10 * i))))
        })
        .collect::<Result<Vec<Isometry3<f64>>, BenchError>>()?;
    let found = all_features(args)?;
    let params = MatchParams { ratio: args.or("ratio", 0.8)?, ..MatchParams::default() };
    let at = |f: &Features, i: u32| {
        let k = f.keypoints[i as usize];
        Point2::new(f64::from(k.u), f64::from(k.v))
    };
    let pairs = (0..PAIRS)
        .map(|i| {
            let (a, b) = (&found[i], &found[i + 1]);
            let matches = match_features(&a.descriptors, &b.descriptors, &params).map_err(BenchError::new)?;
            Ok(matches.iter().map(|m| (at(a, m.query_index), at(b, m.train_index))).unzip())
        })
        .collect::<Result<Vec<Pixels>, BenchError>>()?;
    let matches_mean = mean(pairs.iter().map(|p| p.0.len()));
    let search = RansacParams { seed: args.or("seed", 0)?, ..RansacParams::default() };
    Ok(Box::new(Stream {
        items: 1,
        count: PAIRS,
        work: move |i: usize| {
            estimate_essential(&pairs[i].0, &pairs[i].1, &camera, &camera, &search).map_err(BenchError::new)
        },
        extra: move |last: &[EssentialEstimate]| {
            let turned = last.iter().zip(&truth).map(|(p, t)| p.t_b_a.rotation.angle_to(&t.rotation).to_degrees());
            // The sign counts for nothing here, as in the peers' case.
            let aside = last.iter().zip(&truth).map(|(p, t)| {
                let cos = p.t_b_a.translation.vector.dot(&t.translation.vector.normalize());
                cos.abs().min(1.0).acos().to_degrees()
            });
            json!({
                "r_err_deg_median": median(turned.collect()),
                "t_dir_err_deg_median": median(aside.collect()),
                "inliers_mean": mean(last.iter().map(|p| p.inliers.len())),
                "matches_mean": matches_mean,
                "iterations_mean": mean(last.iter().map(|p| p.iterations)),
            })
        },
        last: Vec::new(),
    }))
}

/// Of a matrix whose rotation was written with few digits.
fn isometry(m: &Matrix4<f64>) -> Isometry3<f64> {
    let r = nalgebra::Rotation3::from_matrix(&m.fixed_view::<3, 3>(0, 0).into_owned());
    let t = nalgebra::Translation3::new(m[(0, 3)], m[(1, 3)], m[(2, 3)]);
    Isometry3::from_parts(t, nalgebra::UnitQuaternion::from_rotation_matrix(&r))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n == 0 { f64::NAN } else { 0.5 * (values[(n - 1) / 2] + values[n / 2]) }
}
