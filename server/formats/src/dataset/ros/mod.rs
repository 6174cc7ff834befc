//! Recordings of ROS messages: MCAP, rosbag2 and bags of ROS 1.
//!
//! What is replayed is one topic that poses can be found by, and beside it wheels and an inertial sensor. Which, is found by the
//! types of the topics, in the order of [`Content::rank`], or said ([`OpenOptions::topic`]). Mounts are taken from `/tf` and `/tf_static`,
//! calibration from the `camera_info` beside the images. What was taken, what was left and what had to be supposed is told in
//! [`Dataset::notes`].

mod load;
mod survey;

use super::{Dataset, DatasetKind, OpenOptions, stamps};
use crate::FormatError;
use load::{Loader, Pictures};
use percept_bags::{ABOUT, Recording};
use percept_geometry::{Pose, SensorFrame, SensorKind, SensorSpec, Timestamp};
use percept_ros::FrameTree;
use percept_ros::topics::{self, Content, PAIR_APART_NS, Topic, sensor_id};
use std::path::Path;
use std::sync::Arc;
use survey::{Recorded, Survey, odometry_of_transforms};

/// So many topics are told of at most, in one note.
const MOST_TOLD: usize = 40;

/// Opens a recording.
///
/// # Errors
/// `Recording` if it cannot be read at all, or has no topic that poses can be found by.
pub(super) fn open(path: &Path, options: &OpenOptions) -> Result<Dataset, FormatError> {
    let recording = Recording::open(path).map_err(FormatError::recording)?;
    let survey = Survey::of(&recording)?;
    let mut notes = survey.warnings.clone();
    let primary = primary(path, &survey, options)?;
    let recorded = &survey.topics[primary];
    let topic = &recorded.topic;
    let partner = if options.depth_only { None } else { partner(&survey, primary) };
    // Clocks that are apart leave no pair: depth alone is a recording, too.
    let partner = partner.filter(|color| !pairs(&recorded.stamps, &survey.topics[*color].stamps).is_empty());
    let base = base_frame(&survey, options);
    let base_name = base.clone().unwrap_or_default();
    let mount =
        |topic: &Topic, kind, notes: &mut Vec<String>| mount(&survey.frames, base.as_deref(), topic, kind, notes);
    let kind = topic.content.kind(partner.is_some());
    let intrinsics = if matches!(kind, SensorKind::Lidar2d | SensorKind::Lidar3d) {
        None
    } else {
        Some(topics::calibration(told(&survey), topic).ok_or_else(|| not_calibrated(path, topic))?)
    };
    let spec = |id, kind, t_base_sensor, intrinsics| SensorSpec {
        id,
        kind,
        t_base_sensor,
        intrinsics,
        time_offset_s: 0.0,
        range_max_m: None,
    };
    let mut sensors = vec![spec(topic.sensor_id(), kind, mount(topic, kind, &mut notes), intrinsics)];
    let mut beside: Vec<SensorFrame> = vec![];
    let mut taken = vec![primary];
    taken.extend(partner);
    let chosen_odometry = first_of(&survey, |c| *c == Content::Odometry);
    if let Some(i) = chosen_odometry {
        taken.push(i);
        // Its samples are of the frame that moves, which is the base but for a transform that stands still.
        let t_base_child = base.as_deref().and_then(|b| survey.frames.t_a_b(b, &survey.topics[i].topic.child_frame_id));
        let id = survey.topics[i].topic.sensor_id();
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
        let t_base_imu = mount(&imu.topic, SensorKind::Imu, &mut notes);
        sensors.push(spec(imu.topic.sensor_id(), SensorKind::Imu, t_base_imu, None));
        beside.extend(imu.samples.iter().cloned());
    }
    let beside = in_order(beside);
    let topics = contents(&survey, &taken);
    for (i, t) in survey.topics.iter().enumerate() {
        if let Some(fault) = &t.fault {
            notes.push(format!(
                "{}: {} of {} messages cannot be read: {fault}",
                t.topic.name, t.num_unreadable, t.count
            ));
        }
        if t.topic.content.is_sensing() && !taken.contains(&i) && t.count > 0 {
            notes.push(format!(
                "{} ({}, {} messages) is not replayed: one topic at a time, --topic chooses",
                t.topic.name, t.topic.type_name, t.count
            ));
        }
    }
    let (stamps_as_recorded, pictures) = match partner {
        Some(color) => {
            let pairs = pairs(&recorded.stamps, &survey.topics[color].stamps);
            notes.push(format!(
                "{} of {} depth images have a colour image of {}",
                pairs.len(),
                recorded.count,
                survey.topics[color].topic.name
            ));
            (pairs.iter().map(|p| recorded.stamps[p.0]).collect(), Pictures::Pairs { color, pairs })
        }
        None => (recorded.stamps.clone(), Pictures::Each),
    };
    let about = recording.metadata(ABOUT).cloned().collect();
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
        topics,
        about,
        stamps: rising.into(),
        beside: beside.into(),
        source: Arc::new(Loader::new(recording, recorded.clone(), primary, pictures, options.limits)),
    })
}

/// All topics in words, those that are taken first.
fn contents(survey: &Survey, taken: &[usize]) -> Vec<String> {
    let told = |i: usize| {
        let Recorded { topic, count, .. } = &survey.topics[i];
        let use_ = match &topic.content {
            _ if taken.contains(&i) => format!("replayed as {}", topic.sensor_id()),
            Content::Transforms => "mounts".to_owned(),
            Content::Calibration { .. } => "calibration".to_owned(),
            _ => "not replayed".to_owned(),
        };
        format!("{} ({}, {count}): {use_}", topic.name, topic.type_name)
    };
    let left = (0..survey.topics.len()).filter(|i| !taken.contains(i));
    taken.iter().copied().chain(left).map(told).collect()
}

/// The topic that poses are found by.
fn primary(path: &Path, survey: &Survey, options: &OpenOptions) -> Result<usize, FormatError> {
    let listed = || {
        let each = survey.topics.iter().map(|t| format!("{} ({}, {})", t.topic.name, t.topic.type_name, t.count));
        let each: Vec<String> = each.take(MOST_TOLD).collect();
        if each.is_empty() {
            "none: it is cut before its first message, or nothing was recorded".to_owned()
        } else {
            each.join(", ")
        }
    };
    let refused = |reason: String| Err(FormatError::Recording { reason: format!("{}: {reason}", path.display()) });
    if let Some(wanted) = &options.topic {
        let found =
            survey.topics.iter().position(|t| t.topic.name.trim_start_matches('/') == wanted.trim_start_matches('/'));
        return match found {
            Some(i) if survey.topics[i].topic.content.is_sensing() && survey.topics[i].count > 0 => Ok(i),
            Some(i) => {
                let t = &survey.topics[i];
                refused(format!(
                    "topic {} ({}, {} messages) is nothing that poses are found by",
                    t.topic.name, t.topic.type_name, t.count
                ))
            }
            None => refused(format!("no topic {wanted}; there are {}", listed())),
        };
    }
    let is_of_camera = |t: &Recorded| topics::is_of_depth_camera(told(survey), &t.topic);
    let is_usable = |t: &Recorded| {
        let content = &t.topic.content;
        let is_readable = content.is_sensing() && t.count > t.num_unreadable;
        is_readable && (!content.is_image() || topics::calibration(told(survey), &t.topic).is_some())
    };
    let usable = survey.topics.iter().enumerate().filter(|(_, t)| is_usable(t));
    let best = usable.min_by_key(|(i, t)| (is_of_camera(t), t.topic.content.rank(), std::cmp::Reverse(t.count), *i));
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
    let wanted = survey.topics.iter().enumerate().filter(|(_, t)| is_wanted(&t.topic.content) && !t.samples.is_empty());
    wanted.max_by_key(|(i, t)| (t.samples.len(), std::cmp::Reverse(*i))).map(|(i, _)| i)
}

/// The topic of colour images that a topic of depth images is registered to: of several the one with most messages.
fn partner(survey: &Survey, depth: usize) -> Option<usize> {
    let depth = &survey.topics[depth].topic;
    let fitting = survey.topics.iter().enumerate().filter(|(_, t)| topics::is_partner(told(survey), depth, &t.topic));
    fitting.max_by_key(|(i, t)| (t.count, std::cmp::Reverse(*i))).map(|(i, _)| i)
}

/// What the topics have told.
fn told(survey: &Survey) -> impl Iterator<Item = &Topic> + Clone {
    survey.topics.iter().map(|t| &t.topic)
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
    let usual = || topics::usual_base(&survey.frames).map(str::to_owned);
    let moving = || {
        let odometry =
            first_of(survey, |c| *c == Content::Odometry).map(|i| survey.topics[i].topic.child_frame_id.clone());
        odometry.filter(|f| !f.is_empty())
    };
    named.or_else(usual).or_else(moving)
}

/// Where a sensor sits on the base, by the transforms.
fn mount(frames: &FrameTree, base: Option<&str>, topic: &Topic, kind: SensorKind, notes: &mut Vec<String>) -> Pose {
    let (t_base_sensor, supposed) = topics::mount(frames, base, topic, kind);
    notes.extend(supposed.map(|words| format!("{words}; --base-frame names another base")));
    t_base_sensor
}

/// Each depth image with the nearest colour image, near enough in time; numbers of messages.
fn pairs(depth: &[Timestamp], color: &[Timestamp]) -> Vec<(usize, usize)> {
    let mut by_time: Vec<(Timestamp, usize)> = color.iter().copied().zip(0..).collect();
    by_time.sort_unstable();
    let nearest = |stamp: Timestamp| {
        let after = by_time.partition_point(|c| c.0 < stamp);
        let around = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|i| by_time.get(i));
        around.map(|c| (c.0.0.abs_diff(stamp.0), c.1)).min().filter(|(apart, _)| *apart <= PAIR_APART_NS)
    };
    depth.iter().enumerate().filter_map(|(i, stamp)| Some((i, nearest(*stamp)?.1))).collect()
}

/// Samples in the order of their stamps, each stamp of a sensor once.
fn in_order(mut samples: Vec<SensorFrame>) -> Vec<SensorFrame> {
    samples.sort_by(|a, b| (a.stamp, &a.sensor).cmp(&(b.stamp, &b.sensor)));
    samples.dedup_by(|a, b| a.stamp == b.stamp && a.sensor == b.sensor);
    samples
}
