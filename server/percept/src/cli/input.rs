//! Frames read ahead of their use: decoding and ray casting overlap with the pipeline.

use super::Failure;
use nalgebra::{Point2, Point3};
use percept_geometry::SensorFrame;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};

/// Frames decoded ahead.
const AHEAD: usize = 4;

/// Reads `frames` on a thread of its own; the order stays.
pub(crate) fn read_ahead<I, E>(frames: I) -> Receiver<Result<SensorFrame, Failure>>
where
    I: Iterator<Item = Result<SensorFrame, E>> + Send + 'static,
    E: Into<Failure> + 'static,
{
    let (out, read) = sync_channel(AHEAD);
    std::thread::spawn(move || {
        for frame in frames {
            if out.send(frame.map_err(Into::into)).is_err() {
                return;
            }
        }
    });
    read
}

/// The same, for a stream into a server.
pub(crate) fn read_ahead_async<I, E>(frames: I) -> tokio::sync::mpsc::Receiver<SensorFrame>
where
    I: Iterator<Item = Result<SensorFrame, E>> + Send + 'static,
    E: Into<Failure> + 'static,
{
    let (out, read) = tokio::sync::mpsc::channel(AHEAD);
    std::thread::spawn(move || {
        for frame in frames {
            match frame {
                Ok(frame) => {
                    if out.blocking_send(frame).is_err() {
                        return;
                    }
                }
                Err(e) => eprintln!("percept: frame left out: {}", e.into()),
            }
        }
    });
    read
}

/// Frames no earlier than they come at `rate` times the pace of their stamps.
pub(crate) fn paced<E>(
    frames: impl Iterator<Item = Result<SensorFrame, E>>,
    rate: f64,
) -> impl Iterator<Item = Result<SensorFrame, E>> {
    let mut begun = None;
    frames.inspect(move |frame| {
        let Ok(frame) = frame else { return };
        let (began, first) = *begun.get_or_insert_with(|| (Instant::now(), frame.stamp));
        let due = Duration::from_secs_f64((frame.stamp.seconds_since(first) / rate).max(0.0));
        std::thread::sleep(due.saturating_sub(began.elapsed()));
    })
}

/// How fast a recording is played.
pub(crate) fn parse_rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|r| (0.001..=1000.0).contains(r));
    rate.ok_or_else(|| format!("{text:?} is no rate; write a number from 0.001 to 1000, such as 1"))
}

/// A time in a recording.
pub(crate) fn parse_seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|s: &f64| s.is_finite() && *s >= 0.0);
    seconds.ok_or_else(|| format!("{text:?} is no time; write seconds from 0"))
}

/// A part of a recording, `FIRST:LAST`, LAST excluded; either may be left out.
pub(crate) fn parse_range(text: &str) -> Result<std::ops::Range<usize>, String> {
    let bad = || format!("{text:?} is no range; write FIRST:LAST, e.g. 0:100, :100 or 50:");
    let (first, last) = text.split_once(':').ok_or_else(bad)?;
    let number = |s: &str, absent| if s.is_empty() { Ok(absent) } else { s.parse().map_err(|_| bad()) };
    let range = number(first, 0)?..number(last, usize::MAX)?;
    if range.is_empty() { Err(format!("{text:?} is empty; FIRST must be below LAST")) } else { Ok(range) }
}

/// A place, `X,Y`, metres.
pub(crate) fn parse_point(text: &str) -> Result<Point2<f64>, String> {
    let [x, y] = numbers(text).ok_or_else(|| format!("{text:?} is no place; write X,Y in metres, e.g. 1.5,-2"))?;
    Ok(Point2::new(x, y))
}

/// A place in space, `X,Y,Z`, metres.
pub(crate) fn parse_position(text: &str) -> Result<Point3<f64>, String> {
    let [x, y, z] =
        numbers(text).ok_or_else(|| format!("{text:?} is no place; write X,Y,Z in metres, e.g. 1.5,-2,0.8"))?;
    Ok(Point3::new(x, y, z))
}

/// A pose in the plane: metres, radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FlatPose {
    pub(crate) x_m: f64,
    pub(crate) y_m: f64,
    pub(crate) yaw_rad: f64,
}

/// A pose in the plane, `X,Y,YAW`.
pub(crate) fn parse_pose(text: &str) -> Result<FlatPose, String> {
    let words = || format!("{text:?} is no pose; write X,Y,YAW in metres and radians, e.g. 1.5,-2,0.7");
    let [x_m, y_m, yaw_rad] = numbers(text).ok_or_else(words)?;
    Ok(FlatPose { x_m, y_m, yaw_rad })
}

/// Corners in order, metres.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Polygon(pub(crate) Vec<Point2<f64>>);

/// Corners in order, `X,Y X,Y X,Y ...`.
pub(crate) fn parse_polygon(text: &str) -> Result<Polygon, String> {
    let corners = text.split_whitespace().map(parse_point).collect::<Result<Vec<_>, _>>()?;
    let words = || format!("{text:?} has {} corners; write at least three, X,Y with spaces between", corners.len());
    if corners.len() < 3 { Err(words()) } else { Ok(Polygon(corners)) }
}

/// So many finite numbers with commas between.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let number = |s: &str| s.trim().parse::<f64>().ok().filter(|v| v.is_finite());
    text.split(',').map(number).collect::<Option<Vec<f64>>>()?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use percept_geometry::sensor::ImuSample;
    use percept_geometry::{SensorData, Timestamp};

    #[test]
    fn ranges_are_read_and_nonsense_is_refused() {
        assert_eq!(parse_range("3:10"), Ok(3..10));
        assert_eq!(parse_range(":10"), Ok(0..10));
        assert_eq!(parse_range("3:"), Ok(3..usize::MAX));
        for bad in ["", "3", "a:b", "5:5", "7:3", "-1:3"] {
            assert!(parse_range(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn frames_come_at_the_pace_asked_for_and_faults_at_once() {
        let sample = ImuSample { angular_velocity: Vector3::zeros(), linear_acceleration: Vector3::zeros() };
        let frame = |ms: i64| SensorFrame {
            sensor: "imu".into(),
            stamp: Timestamp(ms * 1_000_000),
            data: SensorData::Imu(sample),
        };
        let recorded = [Ok(frame(5000)), Err("cut"), Ok(frame(5100)), Ok(frame(5050)), Ok(frame(5300))];
        let began = Instant::now();
        let came: Vec<_> = paced(recorded.into_iter(), 10.0).map(|f| f.map(|_| began.elapsed())).collect();
        let at = |i: usize| came[i].unwrap();
        assert!(came[1].is_err() && at(2) >= Duration::from_millis(10) && at(4) >= Duration::from_millis(30));
        assert!(parse_rate("0.5") == Ok(0.5) && parse_rate("0").is_err() && parse_rate("nan").is_err());
        assert!(parse_seconds("12") == Ok(12.0) && parse_seconds("-1").is_err() && parse_seconds("inf").is_err());
    }

    #[test]
    fn places_and_outlines_are_read_and_nonsense_is_refused() {
        assert_eq!(parse_point("1.5, -2"), Ok(Point2::new(1.5, -2.0)));
        assert_eq!(parse_position("1,-2,0.5"), Ok(Point3::new(1.0, -2.0, 0.5)));
        assert!(parse_position("1,2").is_err());
        assert_eq!(parse_pose("1,2,0.5"), Ok(FlatPose { x_m: 1.0, y_m: 2.0, yaw_rad: 0.5 }));
        assert_eq!(parse_polygon("0,0 1,0 1,1").map(|p| p.0.len()), Ok(3));
        for bad in ["", "1", "1,2,3", "nan,0", "1,inf", "a,b", "1;2"] {
            assert!(parse_point(bad).is_err(), "{bad}");
        }
        assert!(parse_polygon("0,0 1,0").is_err() && parse_pose("1,2").is_err());
    }
}
