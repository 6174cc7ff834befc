//! Recordings of ROS messages: MCAP, rosbag2 and bags of ROS 1.
//!
//! What is replayed is one topic that poses can be found by, and beside it wheels and an inertial sensor. Which, is found by the
//! types of the topics, in the order of [`rank`], or said ([`OpenOptions::topic`]). Mounts are taken from `/tf` and `/tf_static`,
//! calibration from the `camera_info` beside the images. What was taken, what was left and what had to be supposed is told in
//! [`Dataset::notes`].

mod load;
mod survey;

use super::{Dataset, DatasetKind, OpenOptions, stamps};
use crate::FormatError;
use load::{Loader, Pictures};
use percept_bags::Recording;
use percept_geometry::{CameraIntrinsics, Pose, SensorFrame, SensorKind, SensorSpec, Timestamp};
use percept_ros::FrameTree;
use std::path::Path;
use std::sync::Arc;
use survey::{Content, Survey, Topic, is_sensing, odometry_of_transforms, sensor_id};

/// Colour and depth whose stamps differ by no more belong together, nanoseconds: half of the time between frames at 30 Hz.
const PAIR_NS: u64 = 17_000_000;
/// Names that a robot's own frame has by REP-105, the usual one first.
const BASES: [&str; 2] = ["base_link", "base_footprint"];

/// Opens a recording.
///
/// # Errors
/// `Recording` if it cannot be read at all, or has no topic that poses can be found by.
pub(super) fn open(path: &Path, options: &OpenOptions) -> Result<Dataset, FormatError> {
    let recording = Recording::open(path).map_err(FormatError::recording)?;
    let survey = Survey::of(&recording)?;
    let mut notes = survey.warnings.clone();
    let primary = primary(&survey, options)?;
    let topic = &survey.topics[primary];
    let partner = if options.depth_only { None } else { partner(&survey, primary) };
    // Clocks that are apart leave no pair: depth alone is a recording, too.
    let partner = partner.filter(|color| !pairs(&topic.stamps, &survey.topics[*color].stamps).is_empty());
    let base = base_frame(&survey, options);
    let base_name = base.clone().unwrap_or_default();
    let mount =
        |topic: &Topic, kind, notes: &mut Vec<String>| mount(&survey.frames, base.as_deref(), topic, kind, notes);
    let kind = kind_of(&topic.content, partner.is_some());
    let intrinsics = if matches!(kind, SensorKind::Lidar2d | SensorKind::Lidar3d) {
        None
    } else {
        Some(calibration(&survey, topic).ok_or_else(|| not_calibrated(path, topic))?)
    };
    let spec = |id, kind, t_base_sensor, intrinsics| SensorSpec {
        id,
        kind,
        t_base_sensor,
        intrinsics,
        time_offset_s: 0.0,
        range_max_m: None,
    };
    let mut sensors = vec![spec(sensor_id(&topic.name), kind, mount(topic, kind, &mut notes), intrinsics)];
    let mut beside: Vec<SensorFrame> = vec![];
    let mut taken = vec![primary];
    taken.extend(partner);
    let chosen_odometry = first_of(&survey, |c| *c == Content::Odometry);
    if let Some(i) = chosen_odometry {
        taken.push(i);
        // Its samples are of the frame that moves, which is the base but for a transform that stands still.
        let t_base_child = base.as_deref().and_then(|b| survey.frames.t_a_b(b, &survey.topics[i].child_frame_id));
        let id = sensor_id(&survey.topics[i].name);
        sensors.push(spec(id, SensorKind::Odometry, t_base_child.unwrap_or_else(Pose::identity), None));
        beside.extend(survey.topics[i].samples.iter().cloned());
    } else {
        let samples = odometry_of_transforms(&survey, &base_name);
        if !samples.is_empty() {
            notes.push(format!("no odometry was recorded; that of transforms from odom to {base_name} is taken"));
            sensors.push(spec(sensor_id("tf"), SensorKind::Odometry, Pose::identity(), None));
            beside.extend(samples);
        }
    }
    if let Some(i) = first_of(&survey, |c| *c == Content::Imu) {
        taken.push(i);
        let imu = &survey.topics[i];
        sensors.push(spec(sensor_id(&imu.name), SensorKind::Imu, mount(imu, SensorKind::Imu, &mut notes), None));
        beside.extend(imu.samples.iter().cloned());
    }
    let beside = in_order(beside);
    for (i, t) in survey.topics.iter().enumerate() {
        if let Some(fault) = &t.fault {
            notes.push(format!("{}: {} of {} messages cannot be read: {fault}", t.name, t.num_unreadable, t.count));
        }
        if is_sensing(&t.content) && !taken.contains(&i) && t.count > 0 {
            notes.push(format!(
                "{} ({}, {} messages) is not replayed: one topic at a time, --topic chooses",
                t.name, t.type_name, t.count
            ));
        }
    }
    let (stamps_as_recorded, pictures) = match partner {
        Some(color) => {
            let pairs = pairs(&topic.stamps, &survey.topics[color].stamps);
            notes.push(format!(
                "{} of {} depth images have a colour image of {}",
                pairs.len(),
                topic.count,
                survey.topics[color].name
            ));
            (pairs.iter().map(|p| topic.stamps[p.0]).collect(), Pictures::Pairs { color, pairs })
        }
        None => (topic.stamps.clone(), Pictures::Each),
    };
    let rising = stamps::strictly_increasing(&stamps_as_recorded);
    Ok(Dataset {
        name: super::files::name(path),
        kind: DatasetKind::Ros,
        sensors,
        reference: None,
        reference_source: None,
        relations: None,
        is_timed: !stamps::are_useless(&stamps_as_recorded),
        restamped: stamps::restamped(&stamps_as_recorded, &rising),
        notes,
        stamps: rising.into(),
        beside: beside.into(),
        source: Arc::new(Loader::new(recording, topic.clone(), primary, pictures, options.limits)),
    })
}

/// What is replayed rather than others: lidars, then cameras that know distance, then cameras.
fn rank(content: &Content) -> u8 {
    match content {
        Content::Cloud => 0,
        Content::Scan => 1,
        Content::Depth { .. } => 2,
        _ => 3,
    }
}

/// The topic that poses are found by.
fn primary(survey: &Survey, options: &OpenOptions) -> Result<usize, FormatError> {
    let listed = || {
        let each = survey.topics.iter().map(|t| format!("{} ({}, {})", t.name, t.type_name, t.count));
        each.take(40).collect::<Vec<_>>().join(", ")
    };
    let refused = |reason: String| Err(FormatError::Recording { reason });
    if let Some(wanted) = &options.topic {
        let found = survey.topics.iter().position(|t| t.name.trim_start_matches('/') == wanted.trim_start_matches('/'));
        return match found {
            Some(i) if is_sensing(&survey.topics[i].content) && survey.topics[i].count > 0 => Ok(i),
            Some(i) => {
                let t = &survey.topics[i];
                refused(format!(
                    "topic {} ({}, {} messages) is nothing that poses are found by",
                    t.name, t.type_name, t.count
                ))
            }
            None => refused(format!("no topic {wanted}; there are {}", listed())),
        };
    }
    // A depth camera's own cloud says what its images say, without their order.
    let is_of_camera = |t: &Topic| {
        t.content == Content::Cloud
            && survey.topics.iter().any(|d| matches!(d.content, Content::Depth { .. }) && d.frame_id == t.frame_id)
    };
    let is_usable = |t: &Topic| {
        let is_image = matches!(t.content, Content::Depth { .. } | Content::Color { .. });
        is_sensing(&t.content) && t.count > t.num_unreadable && (!is_image || calibration(survey, t).is_some())
    };
    let usable = survey.topics.iter().enumerate().filter(|(_, t)| is_usable(t));
    let best = usable.min_by_key(|(i, t)| (is_of_camera(t), rank(&t.content), std::cmp::Reverse(t.count), *i));
    best.map(|(i, _)| i).map_or_else(
        || refused(format!(
            "no topic that poses are found by: a LaserScan, a PointCloud2, or an Image with its camera_info is needed; there are {}",
            listed()
        )),
        Ok,
    )
}

/// Of several the one with most messages.
fn first_of(survey: &Survey, is_wanted: impl Fn(&Content) -> bool) -> Option<usize> {
    let wanted = survey.topics.iter().enumerate().filter(|(_, t)| is_wanted(&t.content) && !t.samples.is_empty());
    wanted.max_by_key(|(i, t)| (t.samples.len(), std::cmp::Reverse(*i))).map(|(i, _)| i)
}

fn kind_of(content: &Content, has_color: bool) -> SensorKind {
    match content {
        Content::Scan => SensorKind::Lidar2d,
        Content::Depth { .. } if has_color => SensorKind::Rgbd,
        Content::Depth { .. } => SensorKind::Depth,
        Content::Color { .. } => SensorKind::Camera,
        _ => SensorKind::Lidar3d,
    }
}

/// The topic of colour images that a topic of depth images is registered to: one of its frame and calibration.
fn partner(survey: &Survey, depth: usize) -> Option<usize> {
    let topic = &survey.topics[depth];
    if !matches!(topic.content, Content::Depth { .. }) {
        return None;
    }
    let of_depth = calibration(survey, topic)?;
    let fits = |t: &Topic| {
        matches!(t.content, Content::Color { .. })
            && t.frame_id == topic.frame_id
            && calibration(survey, t).is_some_and(|c| (c.width, c.height) == (of_depth.width, of_depth.height))
    };
    let fitting = survey.topics.iter().enumerate().filter(|(_, t)| fits(t));
    fitting.max_by_key(|(i, t)| (t.count, std::cmp::Reverse(*i))).map(|(i, _)| i)
}

/// A topic without the ending that image transports add, and without its own name: `/camera/depth` of
/// `/camera/depth/image_raw/compressedDepth`.
fn namespace(topic: &str) -> &str {
    let topic = ["/compressedDepth", "/compressed"].iter().find_map(|e| topic.strip_suffix(e)).unwrap_or(topic);
    topic.rsplit_once('/').map_or("", |(space, _)| space)
}

/// Intrinsics of a topic of images: of the `camera_info` in its namespace, else of one in its frame.
fn calibration(survey: &Survey, images: &Topic) -> Option<CameraIntrinsics> {
    let (Content::Depth { size, .. } | Content::Color { size, .. }) = &images.content else { return None };
    let is_rectified = images.name.contains("rect");
    let of = |t: &Topic| match &t.content {
        Content::Calibration { raw, rectified } => {
            let found = if is_rectified { *rectified } else { *raw };
            found.or(*raw).filter(|c| size.is_none_or(|s| s == (c.width, c.height)))
        }
        _ => None,
    };
    let beside = survey.topics.iter().filter(|t| namespace(&t.name) == namespace(&images.name)).find_map(of);
    beside.or_else(|| survey.topics.iter().filter(|t| t.frame_id == images.frame_id).find_map(of))
}

fn not_calibrated(path: &Path, topic: &Topic) -> FormatError {
    let reason = format!(
        "{}: {} has no camera_info of its size beside it (K and P of zero say that a camera is not calibrated)",
        path.display(),
        topic.name
    );
    FormatError::Recording { reason }
}

/// The robot's own frame: as said, or as REP-105 names it, or what odometry moves.
fn base_frame(survey: &Survey, options: &OpenOptions) -> Option<String> {
    let named = options.base_frame.clone();
    let usual = || BASES.iter().find(|b| survey.frames.contains(b)).map(|b| (*b).to_owned());
    let moving = || {
        let odometry = first_of(survey, |c| *c == Content::Odometry).map(|i| survey.topics[i].child_frame_id.clone());
        odometry.filter(|f| !f.is_empty())
    };
    named.or_else(usual).or_else(moving)
}

/// Where a sensor sits on the base, by the transforms.
fn mount(frames: &FrameTree, base: Option<&str>, topic: &Topic, kind: SensorKind, notes: &mut Vec<String>) -> Pose {
    if let Some(t_base_sensor) = base.and_then(|base| frames.t_a_b(base, &topic.frame_id)) {
        return t_base_sensor;
    }
    let is_camera = matches!(kind, SensorKind::Depth | SensorKind::Rgbd | SensorKind::Camera);
    let base = base.unwrap_or("base_link");
    let how = if is_camera { ", looking ahead" } else { "" };
    notes.push(format!(
        "no transform from {base} to {}: {} is supposed to sit at the base{how}; --base-frame names another base",
        topic.frame_id, topic.name
    ));
    let turned = if is_camera { SensorSpec::optical_rotation() } else { nalgebra::UnitQuaternion::identity() };
    Pose::from_parts(nalgebra::Translation3::identity(), turned)
}

/// Each depth image with the nearest colour image, near enough in time; numbers of messages.
fn pairs(depth: &[Timestamp], color: &[Timestamp]) -> Vec<(usize, usize)> {
    let mut by_time: Vec<(Timestamp, usize)> = color.iter().copied().zip(0..).collect();
    by_time.sort_unstable();
    let nearest = |stamp: Timestamp| {
        let after = by_time.partition_point(|c| c.0 < stamp);
        let around = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|i| by_time.get(i));
        around.map(|c| (c.0.0.abs_diff(stamp.0), c.1)).min().filter(|(apart, _)| *apart <= PAIR_NS)
    };
    depth.iter().enumerate().filter_map(|(i, stamp)| Some((i, nearest(*stamp)?.1))).collect()
}

/// Samples in the order of their stamps, each stamp of a sensor once.
fn in_order(mut samples: Vec<SensorFrame>) -> Vec<SensorFrame> {
    samples.sort_by(|a, b| (a.stamp, &a.sensor).cmp(&(b.stamp, &b.sensor)));
    samples.dedup_by(|a, b| a.stamp == b.stamp && a.sensor == b.sensor);
    samples
}
