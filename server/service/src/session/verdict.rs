//! How a sensor's stream fares, for an operator: good, or what is wrong and what to do about it.

use super::sensor_book::{NoPose, SensorStatus};
use percept_pipeline::{ImuFault, MountOffset};
use std::fmt;

/// A clock off by more than this is worth telling, seconds.
const TELLING_OFFSET_S: f64 = 0.02;

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
    },
    /// Frames came faster than they are processed.
    Dropped {
        /// How many.
        count: u64,
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
        let counted = |count: u64, trouble: fn(u64) -> StreamTrouble| (count > 0).then(|| trouble(count));
        let clock = status.clock_offset_s.filter(|offset_s| offset_s.abs() > TELLING_OFFSET_S);
        let clock = clock.map(|offset_s| {
            let time_offset_s = status.declaration.spec.time_offset_s - offset_s;
            StreamTrouble::ClockOffset { offset_s, time_offset_s }
        });
        // Until its samples are taken for when they were felt, all that an IMU says is off.
        let faults = status.imu_faults.iter().filter(|_| clock.is_none());
        let imu = faults.map(|&fault| StreamTrouble::Imu { fault, rate_hz: status.rate_hz });
        let mut troubles: Vec<StreamTrouble> = [
            counted(status.rejected, |count| StreamTrouble::Rejected { count }),
            counted(status.dropped, |count| StreamTrouble::Dropped { count }),
            counted(status.gaps, |count| StreamTrouble::Gaps { count }),
            clock.clone(),
            status.mount_offset.map(StreamTrouble::MountOffset),
        ]
        .into_iter()
        .flatten()
        .collect();
        troubles.extend(imu);
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
            Self::Rejected { count } => write!(f, "{count} frames refused as bad input"),
            Self::Dropped { count } => {
                write!(f, "{count} frames dropped because they came faster than they are processed")
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
            Self::NoPose(NoPose::NothingSees) => f.write_str(
                "no pose comes of it alone: declare a lidar, a depth camera or a camera, too (DeclareSensor)",
            ),
            Self::NoPose(NoPose::WantedIsAbsent) => f.write_str(
                "there is no pose, since slam.pose_sensor names a sensor that is not declared, or that sees nothing; declare \
                 it, or create the session anew without pose_sensor",
            ),
        }
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
