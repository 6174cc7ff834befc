//! `percept doctor`: how the streams of a server's sessions fare, in figures and words.

use super::Failure;
use super::client::{AccessArgs, answered, connect};
use percept_wire::v1::sessions_service_client::SessionsServiceClient;
use percept_wire::{json, v1};
use serde_json::{Value, json};

#[derive(Debug, clap::Args)]
pub(crate) struct DoctorArgs {
    /// Session to look at; without it all that are awake.
    session: Option<String>,
    /// gRPC address of the server.
    #[arg(long, env = "PERCEPT_SERVER", default_value = "http://127.0.0.1:50051")]
    server: String,
    #[command(flatten)]
    access: AccessArgs,
    /// Print one JSON object for each session: as REST has them.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &DoctorArgs) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let sessions = runtime.block_on(look(args))?;
    if sessions.is_empty() {
        println!("no session is awake: nothing has come since the server was started, or not for long");
        return Ok(());
    }
    for session in &sessions {
        match args.json {
            true => println!("{}", as_json(session)?),
            false => print!("{}", told(session)),
        }
    }
    let wrong: usize = sessions.iter().map(num_wrong).sum();
    if wrong > 0 {
        Err(format!("{wrong} {} found", if wrong == 1 { "trouble" } else { "troubles" }).into())
    } else {
        Ok(())
    }
}

async fn look(args: &DoctorArgs) -> Result<Vec<v1::Session>, Failure> {
    let connection = connect(&args.server, &args.access).await?;
    let mut sessions = SessionsServiceClient::new(connection);
    let mut names: Vec<String> = args.session.clone().into_iter().collect();
    let mut page_token = String::new();
    while args.session.is_none() {
        let state = v1::SessionState::Awake.into();
        let request = v1::ListSessionsRequest { page_size: 1000, page_token, state, ..Default::default() };
        let page = answered(sessions.list_sessions(request).await)?;
        names.extend(page.sessions.into_iter().map(|s| s.session_id));
        page_token = page.next_page_token;
        if page_token.is_empty() {
            break;
        }
    }
    let mut found = vec![];
    for session_id in names {
        let answer = answered(sessions.get_session(v1::GetSessionRequest { session_id }).await)?;
        found.extend(answer.session);
    }
    Ok(found)
}

fn as_json(session: &v1::Session) -> Result<Value, Failure> {
    let status = |s: &v1::SensorStatus| json::to_json("SensorStatus", s);
    let note = |n: &v1::StreamNote| json::to_json("StreamNote", n);
    let pose = session.pose.as_ref().map(|p| json::to_json("PoseEstimate", p)).transpose()?;
    Ok(json!({
        "session_id": session.session_id,
        "pose": pose,
        "sensors": session.sensors.iter().map(status).collect::<Result<Vec<_>, _>>()?,
        "stream_notes": session.stream_notes.iter().map(note).collect::<Result<Vec<_>, _>>()?,
    }))
}

fn num_wrong(session: &v1::Session) -> usize {
    let troubles: usize = session.sensors.iter().map(|s| s.troubles.len()).sum();
    troubles + session.stream_notes.len() + usize::from(lost(session).is_some())
}

/// Why the pose is lost, if it is.
fn lost(session: &v1::Session) -> Option<&str> {
    session.pose.as_ref().filter(|p| p.state() == v1::TrackingState::Lost).map(|p| p.lost_message.as_str())
}

/// A session for a person.
fn told(session: &v1::Session) -> String {
    let mut lines = vec![session.session_id.clone()];
    lines.push(match (lost(session), &session.pose) {
        (Some(why), _) => format!("  pose      lost: {why}"),
        (None, Some(pose)) if pose.state() == v1::TrackingState::Initialising => {
            format!("  pose      not yet. {}", pose.waiting_message)
        }
        (None, Some(pose)) => format!("  pose      tracked, {:.0} % of a frame fit", pose.inlier_ratio * 100.0),
        (None, None) if session.num_keyframes > 0 => "  pose      none while the session sleeps".to_owned(),
        (None, None) => "  pose      none yet".to_owned(),
    });
    for sensor in &session.sensors {
        let id = sensor.spec.as_ref().map_or("", |spec| spec.sensor_id.as_str());
        lines.push(format!("  {id:<9} {}", figures(sensor)));
        lines.extend(sensor.troubles.iter().map(|t| format!("    ! {}: {}", short(t), t.message)));
    }
    lines.extend(session.stream_notes.iter().map(|n| format!("  {}\n    ! {}", n.stream, n.message)));
    lines.join("\n") + "\n"
}

/// The kind without the three words that all kinds begin with.
fn short(trouble: &v1::StreamTrouble) -> String {
    trouble.kind().as_str_name().split('_').skip(3).collect::<Vec<_>>().join("_")
}

/// One line.
fn figures(sensor: &v1::SensorStatus) -> String {
    let f = sensor.figures.unwrap_or_default();
    if sensor.accepted == 0 {
        return format!("no frame taken, {} refused", sensor.rejected);
    }
    let ms = |s: f64| format!("{:.1} ms", s * 1e3);
    let parts = [
        Some(format!("{} frames", sensor.accepted)),
        sensor.rate_hz.map(|hz| format!("{hz:.1} Hz by its stamps")),
        f.arrival_rate_hz.map(|hz| format!("{hz:.1} Hz as they come")),
        f.jitter_s.map(|s| format!("jitter {}", ms(s))),
        f.longest_interval_s.map(|s| format!("longest pause {}", ms(s))),
        f.frame_bytes.map(|bytes| format!("{:.1} kB each", bytes / 1e3)),
        f.latency_p50_s.zip(f.latency_p95_s).map(|(p50, p95)| format!("worked in after {} (p95 {})", ms(p50), ms(p95))),
        // What was recorded long ago has no delay.
        f.delay_s.filter(|s| s.abs() < 3600.0).map(|s| format!("delay {}", ms(s))),
        f.measured_ratio.map(|share| format!("{:.0} % measured", share * 100.0)),
        f.median_range_m.map(|m| format!("median range {m:.2} m")),
        f.quiet_s.map(|s| format!("last {s:.1} s ago")),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_is_told_with_its_remedy_and_counted() {
        let trouble = v1::StreamTrouble {
            kind: v1::StreamTroubleKind::RangeUnit.into(),
            message: "it seems to be in millimetres: send metres_per_unit 0.001".to_owned(),
        };
        let spec = Some(v1::SensorSpec { sensor_id: "camera".to_owned(), ..Default::default() });
        let figures = Some(v1::StreamFigures { jitter_s: Some(0.0012), ..Default::default() });
        let sensor = v1::SensorStatus { spec, accepted: 3, troubles: vec![trouble], figures, ..Default::default() };
        let note =
            v1::StreamNote { stream: "/scan".to_owned(), message: "not used: no transform".to_owned(), time_ns: 1 };
        let session = v1::Session {
            session_id: "robot-7".to_owned(),
            sensors: vec![sensor],
            stream_notes: vec![note],
            ..Default::default()
        };
        let text = told(&session);
        for part in
            ["robot-7", "camera", "3 frames", "jitter 1.2 ms", "! RANGE_UNIT: it seems", "/scan\n    ! not used"]
        {
            assert!(text.contains(part), "{part} in {text}");
        }
        assert_eq!(num_wrong(&session), 2);
    }
}
