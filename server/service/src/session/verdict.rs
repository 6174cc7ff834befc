//! How a sensor's stream fares, for an operator: good, or what is wrong and what to do about it.

use super::sensor_book::{NoPose, Refusal, SensorStatus};
use super::stream_figures::StreamFigures;
use percept_geometry::{CameraIntrinsics, SensorId, SensorKind};
use percept_pipeline::{ImuFault, MOSTLY_STRAY, MountOffset, WheelsFault};
use std::fmt;

/// A clock off by more than this is worth telling, seconds.
const TELLING_OFFSET_S: f64 = 0.02;
/// Stamps ahead of the server's clock by more than this are no jitter of clocks that are kept by the network, seconds.
const AHEAD_S: f64 = 0.1;
/// No depth camera sees so far, and no lidar; nothing is so near to either, metres.
const FARTHEST_M: (f64, f64) = (100.0, 1000.0);
const NEAREST_M: f64 = 0.05;
/// Below this share of beams or pixels a sensor is covered, or too near or too far from everything.
const LITTLE: f64 = 0.05;
/// A camera's mount is turned by less than this where nobody has turned it, radians.
const UNTURNED: f64 = 0.02;
/// Principal points lie within this share of the image's size around its middle; pixels are so nearly square; and angles of
/// view, of a side, are between these, radians: 8 and 172 degrees.
const LENS: (f64, f64, (f64, f64)) = (0.2, 1.3, (0.14, 3.0));

/// No lidar and no camera sends more frames a second, and no IMU or wheels more samples, hertz: stamps that say so are in a
/// larger unit than nanoseconds.
const FASTEST_HZ: (f64, f64) = (1e3, 2e4);
/// The units that stamps come in instead, nanoseconds, smallest first.
const STAMP_UNITS: [(f64, &str); 3] = [(1e3, "microseconds"), (1e6, "milliseconds"), (1e9, "seconds")];
/// When stamps are from that count since 1970, seconds: of this century.
const CENTURY_S: std::ops::Range<f64> = 946_684_800.0..4_102_444_800.0;
/// No robot carries a sensor so far from its base, metres.
const FARTHEST_MOUNT_M: f64 = 30.0;

/// How a stream fares; `Display` says it to an operator.
#[derive(Debug, Clone, PartialEq)]
pub enum Verdict {
    /// Nothing came yet.
    NoFrame,
    /// Nothing is wrong.
    Good,
    /// What is wrong; never empty.
    Troubled(Vec<StreamTrouble>),
}

/// Something that is wrong with a stream; `Display` says it to an operator, with a remedy.
#[derive(Debug, Clone, PartialEq)]
pub enum StreamTrouble {
    /// Frames were refused as bad input.
    Rejected {
        /// How many.
        count: u64,
        /// For which reasons.
        refusals: Vec<Refusal>,
    },
    /// Frames came faster than they are processed.
    Dropped {
        /// How many.
        count: u64,
        /// Bytes of a frame, mean.
        frame_bytes: Option<f64>,
        /// From arrival until worked in, median, seconds.
        latency_s: Option<f64>,
    },
    /// Numbers are missing in the sender's sequence.
    Gaps {
        /// How many.
        count: u64,
    },
    /// Its stamps are late behind the pose sensor's.
    ClockOffset {
        /// By how much, beyond the declared offset, seconds; negative if they are early.
        offset_s: f64,
        /// The offset that would be right, seconds.
        time_offset_s: f64,
    },
    /// What it sees contradicts the pose sensor's map.
    MountOffset(MountOffset),
    /// Something is wrong with an IMU, so that it is not used, or not all of what it measures.
    Imu {
        /// What.
        fault: ImuFault,
        /// Its rate by its stamps, hertz.
        rate_hz: Option<f64>,
    },
    /// Nothing comes any more, while other sensors go on.
    Silent {
        /// For how long, seconds.
        silent_s: f64,
    },
    /// Its stamps are ahead of the server's clock.
    ClockAhead {
        /// By how much, way and all, seconds.
        ahead_s: f64,
    },
    /// Its stamps are far from another sensor's that come at the same time.
    ClockApart {
        /// By how much it is ahead, seconds.
        ahead_s: f64,
        /// The other sensor.
        than: SensorId,
    },
    /// Its stamps are in another unit than nanoseconds.
    StampUnit {
        /// Its rate by its stamps, hertz.
        rate_hz: f64,
        /// What they seem to be.
        unit: &'static str,
    },
    /// Its mount is farther from the robot's base than any robot reaches.
    MountFar {
        /// How far, metres.
        distance_m: f64,
    },
    /// Its distances are in another unit than metres.
    RangeUnit {
        /// The median, if it were metres.
        median_m: f64,
    },
    /// Hardly any beam or pixel measures something.
    SeesLittle {
        /// The share of those that do.
        ratio: f64,
    },
    /// Most returns of a planar lidar stand alone.
    StrayReturns {
        /// The share of those that do.
        ratio: f64,
    },
    /// The mount of a camera has it look straight up: that of a body frame, most likely.
    OpticalFrame,
    /// The intrinsics are hardly those of the images.
    Intrinsics {
        /// Which of them, and why.
        what: String,
    },
    /// Wheels contradict the pose sensor.
    Wheels(WheelsFault),
    /// No pose can come of what is declared.
    NoPose(NoPose),
}

/// What IMU drivers of widespread units give, by how much larger than rad/s.
const DEGREES: f64 = 180.0 / std::f64::consts::PI;

impl SensorStatus {
    /// How its stream fares.
    pub fn verdict(&self) -> Verdict {
        Verdict::of(self)
    }
}

impl Verdict {
    fn of(status: &SensorStatus) -> Self {
        if status.accepted == 0 && status.rejected == 0 {
            return Self::NoFrame;
        }
        let figures = &status.figures;
        let spec = &status.declaration.spec;
        let clock = status.clock_offset_s.filter(|offset_s| offset_s.abs() > TELLING_OFFSET_S);
        let clock = clock.map(|offset_s| {
            let time_offset_s = status.declaration.spec.time_offset_s - offset_s;
            StreamTrouble::ClockOffset { offset_s, time_offset_s }
        });
        // Until its samples are taken for when they were felt, all that an IMU says is off.
        let faults = status.imu_faults.iter().filter(|_| clock.is_none());
        let imu = faults.map(|&fault| StreamTrouble::Imu { fault, rate_hz: figures.rate_hz });
        let mut troubles: Vec<StreamTrouble> = [
            (status.rejected > 0)
                .then(|| StreamTrouble::Rejected { count: status.rejected, refusals: status.refusals.clone() }),
            (status.dropped > 0).then_some(StreamTrouble::Dropped {
                count: status.dropped,
                frame_bytes: figures.frame_bytes,
                latency_s: figures.latency_s.map(|(median, _)| median),
            }),
            (status.gaps > 0).then_some(StreamTrouble::Gaps { count: status.gaps }),
            status.silent_s.map(|silent_s| StreamTrouble::Silent { silent_s }),
            figures.delay_s.filter(|s| *s < -AHEAD_S).map(|s| StreamTrouble::ClockAhead { ahead_s: -s }),
            stamp_unit(status),
            status.apart.clone().map(|(than, ahead_s)| StreamTrouble::ClockApart { ahead_s, than }),
            clock.clone(),
            range_unit(spec.kind, figures),
            figures.measured_ratio.filter(|r| *r < LITTLE).map(|ratio| StreamTrouble::SeesLittle { ratio }),
            figures.stray_ratio.filter(|r| *r > MOSTLY_STRAY).map(|ratio| StreamTrouble::StrayReturns { ratio }),
            Some(spec.t_base_sensor.translation.vector.norm())
                .filter(|m| *m > FARTHEST_MOUNT_M)
                .map(|distance_m| StreamTrouble::MountFar { distance_m }),
            (is_camera(spec.kind) && spec.t_base_sensor.rotation.angle() < UNTURNED)
                .then_some(StreamTrouble::OpticalFrame),
            spec.intrinsics.as_ref().and_then(odd_lens).map(|what| StreamTrouble::Intrinsics { what }),
            status.mount_offset.map(StreamTrouble::MountOffset),
        ]
        .into_iter()
        .flatten()
        .collect();
        troubles.extend(imu);
        troubles.extend(wheels_told(&status.wheels_faults).map(StreamTrouble::Wheels));
        troubles.extend(status.no_pose.map(StreamTrouble::NoPose));
        if troubles.is_empty() { Self::Good } else { Self::Troubled(troubles) }
    }

    /// What is wrong; empty if nothing is.
    pub fn troubles(&self) -> &[StreamTrouble] {
        match self {
            Self::NoFrame | Self::Good => &[],
            Self::Troubled(troubles) => troubles,
        }
    }
}

fn is_camera(kind: SensorKind) -> bool {
    matches!(kind, SensorKind::Depth | SensorKind::Rgbd | SensorKind::Camera)
}

/// Stamps nearer to each other than any sensor of this kind measures.
fn stamp_unit(status: &SensorStatus) -> Option<StreamTrouble> {
    let fastest_hz = if status.declaration.spec.kind.can_move_the_pose() { FASTEST_HZ.0 } else { FASTEST_HZ.1 };
    let rate_hz = status.figures.rate_hz.filter(|rate| *rate > fastest_hz)?;
    let stamp = status.last_stamp.map_or(0.0, |stamp| stamp.nanos() as f64);
    let is_date = |(ns, _): &(f64, &str)| CENTURY_S.contains(&(stamp * ns * 1e-9));
    let is_rate = |(ns, _): &(f64, &str)| rate_hz / ns <= fastest_hz;
    let [.., largest] = STAMP_UNITS;
    let found = STAMP_UNITS.into_iter().find(is_date).or_else(|| STAMP_UNITS.into_iter().find(is_rate));
    Some(StreamTrouble::StampUnit { rate_hz, unit: found.unwrap_or(largest).1 })
}

/// Wheels that are unlike in way and in turning are told once.
fn wheels_told(faults: &[WheelsFault]) -> impl Iterator<Item = WheelsFault> {
    let unlike =
        faults.iter().filter_map(|f| if let WheelsFault::Unlike { agreement } = f { Some(*agreement) } else { None });
    let least = unlike.reduce(f64::min).map(|agreement| WheelsFault::Unlike { agreement });
    let others = faults.iter().copied().filter(|f| !matches!(f, WheelsFault::Unlike { .. }));
    others.chain(least)
}

/// Distances that no sensor of this kind measures.
fn range_unit(kind: SensorKind, figures: &StreamFigures) -> Option<StreamTrouble> {
    let farthest_m = if is_camera(kind) { FARTHEST_M.0 } else { FARTHEST_M.1 };
    let is_odd = |m: &f64| *m > farthest_m || *m < NEAREST_M;
    figures.median_range_m.filter(is_odd).map(|median_m| StreamTrouble::RangeUnit { median_m })
}

/// What of a lens no camera has.
fn odd_lens(k: &CameraIntrinsics) -> Option<String> {
    let (width, height) = (k.width as f64, k.height as f64);
    let off = ((k.cx - 0.5 * width) / width, (k.cy - 0.5 * height) / height);
    let angle = |f: f64, size: f64| 2.0 * (0.5 * size / f).atan();
    let is_view = |angle: f64| (LENS.2.0..LENS.2.1).contains(&angle);
    let (across, up) = (angle(k.fx, width), angle(k.fy, height));
    if off.0.abs() > LENS.0 || off.1.abs() > LENS.0 {
        return Some(format!(
            "the middle of the lens is said to be at ({:.0}, {:.0}) px of an image of {}x{}",
            k.cx, k.cy, k.width, k.height
        ));
    }
    if k.fx.max(k.fy) > LENS.1 * k.fx.min(k.fy) {
        return Some(format!("fx_px is {:.0} and fy_px {:.0}, but pixels are square", k.fx, k.fy));
    }
    let (across, up) = (!(is_view(across) && is_view(up))).then_some((across.to_degrees(), up.to_degrees()))?;
    Some(format!("they make an angle of view of {across:.0} by {up:.0} degrees"))
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoFrame => f.write_str("no frame yet"),
            Self::Good => f.write_str("good"),
            Self::Troubled(troubles) => {
                let words: Vec<String> = troubles.iter().map(ToString::to_string).collect();
                f.write_str(&words.join("; "))
            }
        }
    }
}

impl fmt::Display for StreamTrouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rejected { count, refusals } => {
                write!(f, "{count} frames refused as bad input")?;
                for (i, r) in refusals.iter().enumerate() {
                    let begin = if i == 0 { ": " } else { ", " };
                    write!(f, "{begin}{} for {} (the last: {})", r.count, r.reason, r.message)?;
                }
                Ok(())
            }
            Self::Dropped { count, frame_bytes, latency_s } => {
                write!(f, "{count} frames dropped because they came faster than they are processed")?;
                if let (Some(bytes), Some(s)) = (frame_bytes, latency_s) {
                    write!(f, " (one of {:.0} kB takes {:.0} ms, waiting included)", bytes / 1e3, s * 1e3)?;
                }
                f.write_str("; send fewer or smaller ones, or let the sender wait (overload_policy BLOCK)")
            }
            Self::Gaps { count } => write!(f, "{count} frames missing in the sender's numbering"),
            Self::ClockOffset { offset_s, time_offset_s } => {
                let (ms, which) = ((offset_s.abs() * 1e3).round(), if *offset_s > 0.0 { "late" } else { "early" });
                write!(
                    f,
                    "its stamps are {ms} ms {which}, compared with the pose sensor's; set its time_offset_s to \
                     {time_offset_s:.3} (UpdateSensor)"
                )
            }
            Self::MountOffset(off) => {
                let (cm, degrees) = ((off.distance_m * 100.0).round(), off.angle_rad.to_degrees().round());
                write!(
                    f,
                    "what it sees contradicts the pose sensor's map as if it were mounted {cm} cm and {degrees} degrees \
                     off; measure both mounts and declare it under a new name with the right t_base_sensor"
                )
            }
            Self::Imu { fault, rate_hz } => imu_words(f, fault, *rate_hz),
            Self::Silent { silent_s } => write!(
                f,
                "nothing has come for {silent_s:.1} s, while other sensors go on; check its driver, its cable and what carries \
                 its messages"
            ),
            Self::ClockAhead { ahead_s } => write!(
                f,
                "its stamps are {ahead_s:.2} s ahead of the server's clock; set the robot's clock, e.g. by NTP (SyncTime \
                 measures the offset)"
            ),
            Self::ClockApart { ahead_s, than } => write!(
                f,
                "its stamps are {:.1} s {} those of {}, which come at the same time, so that the two are not used together; have \
                 both stamped by one clock, or declare its time_offset_s; if the stamps are right, its messages are held up on \
                 the way",
                ahead_s.abs(),
                if *ahead_s > 0.0 { "ahead of" } else { "behind" },
                than.0
            ),
            Self::StampUnit { rate_hz, unit } => write!(
                f,
                "by its stamps it sends {rate_hz:.0} frames a second: they seem to be in {unit}; send nanoseconds since 1970"
            ),
            Self::MountFar { distance_m } => write!(
                f,
                "its mount is {distance_m:.0} m from the robot's base; send t_base_sensor in metres, from base_link to the \
                 sensor (UpdateSensor)"
            ),
            Self::RangeUnit { median_m } => {
                write!(f, "what it sees lies {median_m:.3} m away in the median, if that is metres; ")?;
                match *median_m > 1.0 {
                    true => f.write_str("it seems to be in millimetres: send metres_per_unit 0.001, or metres"),
                    false => f.write_str("its unit seems to be too small: send the metres_per_unit that its driver states, or metres"),
                }
            }
            Self::SeesLittle { ratio } => write!(
                f,
                "only {:.1} % of what it sends are measurements; check that nothing covers it, and that it is neither too near \
                 nor too far from everything",
                ratio * 100.0
            ),
            Self::StrayReturns { ratio } => write!(
                f,
                "{:.0} % of its returns stand alone, as from dust, rain, smoke or another lidar's light: such scans are not \
                 used, and the robot is lost without wheels; clean its window, or wait until it is over",
                ratio * 100.0
            ),
            Self::OpticalFrame => f.write_str(
                "its mount is not turned, so that it looks straight up: a camera's frame has z ahead, x right, y down; for one \
                 that looks ahead declare t_base_sensor with the rotation (x, y, z, w) = (-0.5, 0.5, -0.5, 0.5) (UpdateSensor)",
            ),
            Self::Intrinsics { what } => {
                write!(f, "its intrinsics are hardly those of its images: {what}; declare those of this resolution")
            }
            Self::Wheels(fault) => wheels_words(f, fault),
            Self::NoPose(NoPose::NothingSees) => f.write_str(
                "no pose comes of it alone: declare a lidar, a depth camera or a camera, too (DeclareSensor)",
            ),
            Self::NoPose(NoPose::PlaneIsSteep) => f.write_str(
                "no pose comes of it: planar lidars alone see, their planes are steep on the robot by their mounts, and a robot that \
                 drives is found in a level one; declare a level lidar, a 3D lidar or a camera, too, or put t_base_sensor right \
                 (UpdateSensor)",
            ),
            Self::NoPose(NoPose::WantedIsAbsent) => f.write_str(
                "there is no pose, since slam.pose_sensor names a sensor that is not declared, or that sees nothing; declare \
                 it, or create the session anew without pose_sensor",
            ),
        }
    }
}

fn wheels_words(f: &mut fmt::Formatter<'_>, fault: &WheelsFault) -> fmt::Result {
    match fault {
        WheelsFault::Way { factor } if *factor < 0.0 => f.write_str(
            "it drives the other way than the pose sensor sees; turn its sign, or the frame that it is told in, or the mount of \
             that sensor, if that looks backwards",
        ),
        WheelsFault::Way { factor } => write!(
            f,
            "it tells {factor:.2} times the way that the pose sensor sees; check the wheels' diameter and gear, whether they slip, \
             and whether that sensor's mount is level"
        ),
        WheelsFault::Turns { factor } if *factor < 0.0 => f.write_str(
            "it turns the other way than the pose sensor sees; angles grow counter-clockwise, seen from above; or the mount of \
             that sensor is wrong, if it hangs upside down",
        ),
        WheelsFault::Turns { factor } => write!(
            f,
            "it tells {factor:.2} times the turning that the pose sensor sees; check the wheels' distance from each other, and \
             that angles are in radians"
        ),
        WheelsFault::Unlike { agreement } => write!(
            f,
            "it tells another motion than the pose sensor sees (they agree to {agreement:.2}, 1 is well); check that it tells \
             base's own pose, and its clock"
        ),
    }
}

fn imu_words(f: &mut fmt::Formatter<'_>, fault: &ImuFault, rate_hz: Option<f64>) -> fmt::Result {
    match fault {
        ImuFault::Uncovered { behind_s } if *behind_s > 0.1 => write!(
            f,
            "not used: its samples come {behind_s:.2} s after the frames that need them, or have stopped; send each sample \
             before the frames of later stamps"
        ),
        ImuFault::Uncovered { .. } => write!(
            f,
            "not used: its samples are too far apart ({:.1} Hz); send 50 Hz or more, and all that there are",
            rate_hz.unwrap_or(0.0)
        ),
        ImuFault::ForceUnlikeGravity { mean } => {
            let unit = match *mean {
                m if (0.7..1.3).contains(&m) => "it seems to be in g; multiply by 9.81",
                m if (700.0..1300.0).contains(&m) => "it seems to be in thousandths of g; multiply by 0.00981",
                m if m < 0.3 => "gravity seems to have been taken out, or nothing is measured; send the raw reading",
                _ => "send m/s^2 as the sensor feels it, gravity included",
            };
            write!(f, "its linear_acceleration is not used: {mean:.2} in the mean, where gravity is 9.81 m/s^2; {unit}")
        }
        ImuFault::TurnsScaled { factor } if *factor < 0.2 => write!(
            f,
            "not used: its angular_velocity tells {:.0} % of how much the robot turned; check that the gyro is on, and send \
             rad/s",
            factor * 100.0
        ),
        ImuFault::TurnsScaled { factor } => {
            let unit = match (factor / DEGREES - 1.0).abs() < 0.25 {
                true => "it seems to be in degrees; send rad/s",
                false => "send rad/s",
            };
            write!(f, "not used: its angular_velocity tells {factor:.1} times as much turning as there was; {unit}")
        }
        ImuFault::TurnsAboutOtherAxes { angle_rad, axis } => write!(
            f,
            "not used: it turns about other axes than the robot, as if its mount had to be turned by {:.0} degrees about \
             ({:.2}, {:.2}, {:.2}) of base; correct t_base_sensor (UpdateSensor)",
            angle_rad.to_degrees(),
            axis.x,
            axis.y,
            axis.z
        ),
        ImuFault::TurnsUnlike { agreement } => write!(
            f,
            "not used: it turns otherwise than the robot does (they agree to {agreement:.2}, 1 is well); its clock may be off \
             by more than can be measured, or it is another robot's, or broken"
        ),
        ImuFault::Misleading => f.write_str(
            "not used: frames are found nearer to where they are expected without it; check t_base_sensor, its place \
             included, its clock, and how firmly it is mounted",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::super::records::StateRecord;
    use super::*;
    use crate::{OverloadPolicy, SensorDeclaration};
    use percept_geometry::{Pose, SensorId, SensorSpec, Timestamp};

    /// A camera that looks ahead, with a frame in.
    fn camera() -> SensorStatus {
        let spec = SensorSpec {
            id: SensorId::from("camera"),
            kind: SensorKind::Depth,
            t_base_sensor: Pose::from_parts(nalgebra::Translation3::identity(), SensorSpec::optical_rotation()),
            intrinsics: Some(CameraIntrinsics::pinhole(640, 480, 525.0, 525.0, 319.5, 239.5)),
            time_offset_s: 0.0,
            range_max_m: None,
        };
        let declaration = SensorDeclaration { spec, overload: OverloadPolicy::default() };
        let figures = StreamFigures {
            delay_s: Some(0.02),
            measured_ratio: Some(0.9),
            median_range_m: Some(2.0),
            ..StreamFigures::default()
        };
        SensorStatus { accepted: 1, figures, ..SensorStatus::stored(declaration, &StateRecord::default()) }
    }

    fn only_trouble(status: &SensorStatus) -> StreamTrouble {
        let verdict = status.verdict();
        let [trouble] = verdict.troubles() else { panic!("{verdict}") };
        trouble.clone()
    }

    #[test]
    fn a_sound_stream_is_good() {
        assert_eq!(camera().verdict(), Verdict::Good);
        // What was recorded years ago comes late, and that is no trouble.
        let mut recorded = camera();
        recorded.figures.delay_s = Some(3e8);
        assert_eq!(recorded.verdict(), Verdict::Good);
    }

    #[test]
    fn what_figures_and_declaration_show_is_told_by_itself() {
        let with = |change: fn(&mut SensorStatus)| {
            let mut status = camera();
            change(&mut status);
            only_trouble(&status)
        };
        let millimetres = with(|s| s.figures.median_range_m = Some(1850.0));
        assert_eq!(millimetres, StreamTrouble::RangeUnit { median_m: 1850.0 });
        assert!(millimetres.to_string().contains("metres_per_unit 0.001"), "{millimetres}");
        assert_eq!(with(|s| s.figures.measured_ratio = Some(0.01)), StreamTrouble::SeesLittle { ratio: 0.01 });
        assert_eq!(with(|s| s.figures.delay_s = Some(-2.5)), StreamTrouble::ClockAhead { ahead_s: 2.5 });
        let units = [(3e4, 17e14, "microseconds"), (1e7, 17e11, "milliseconds"), (1e9, 17e8, "seconds")];
        for (rate_hz, stamp, unit) in units {
            let (status, last_stamp) = (camera(), Some(Timestamp::from_nanos(stamp as i64)));
            let figures = StreamFigures { rate_hz: Some(rate_hz), ..status.figures.clone() };
            let trouble = only_trouble(&SensorStatus { figures, last_stamp, ..status });
            assert_eq!(trouble, StreamTrouble::StampUnit { rate_hz, unit });
        }
        let far = with(|s| s.declaration.spec.t_base_sensor.translation.vector.z = 1000.0);
        assert_eq!(far, StreamTrouble::MountFar { distance_m: 1000.0 });
        assert_eq!(with(|s| s.silent_s = Some(7.0)), StreamTrouble::Silent { silent_s: 7.0 });
        assert_eq!(with(|s| s.declaration.spec.t_base_sensor = Pose::identity()), StreamTrouble::OpticalFrame);
        let lens = with(|s| {
            // Those of 640 x 480 for an image of half the size.
            s.declaration.spec.intrinsics = Some(CameraIntrinsics::pinhole(320, 240, 525.0, 525.0, 319.5, 239.5));
        });
        assert!(matches!(lens, StreamTrouble::Intrinsics { .. }), "{lens:?}");
        let twice = with(|s| s.wheels_faults = [0.3, 0.1].map(|agreement| WheelsFault::Unlike { agreement }).to_vec());
        assert_eq!(twice, StreamTrouble::Wheels(WheelsFault::Unlike { agreement: 0.1 }));
        let wheels = with(|s| s.wheels_faults = vec![WheelsFault::Turns { factor: 0.5 }]);
        assert!(wheels.to_string().contains("0.50 times the turning"), "{wheels}");
    }

    #[test]
    fn refusals_are_told_by_reason() {
        let mut status = camera();
        let refusal = |reason, count, message: &str| Refusal { reason, count, message: message.to_owned() };
        status.rejected = 5;
        status.refusals = vec![refusal("STAMP_NOT_INCREASING", 4, "late"), refusal("CLOUD_EMPTY", 1, "empty")];
        let words = status.verdict().to_string();
        assert_eq!(
            words,
            "5 frames refused as bad input: 4 for STAMP_NOT_INCREASING (the last: late), 1 for CLOUD_EMPTY (the last: empty)"
        );
    }
}
