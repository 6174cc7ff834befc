//! How streams fare, as messages.

use super::sensors::declaration_to;
use crate::v1;
use percept_geometry::Timestamp;
use percept_pipeline::ImuFault;
use percept_service::{Refusal, SensorStatus, StreamFigures, StreamNote, StreamTrouble, Verdict};

/// A stream's health as a message.
pub fn status_to(s: &SensorStatus) -> v1::SensorStatus {
    v1::SensorStatus {
        spec: Some(declaration_to(&s.declaration)),
        accepted: s.accepted,
        rejected: s.rejected,
        dropped: s.dropped,
        gaps: s.gaps,
        rate_hz: s.figures.rate_hz,
        last_stamp_ns: s.last_stamp.map(Timestamp::nanos),
        verdict: verdict_to(&s.verdict()).into(),
        verdict_message: s.verdict().to_string(),
        troubles: s.verdict().troubles().iter().map(trouble_to).collect(),
        clock_offset_s: s.clock_offset_s,
        etag: s.declaration.etag(),
        figures: Some(figures_to(&s.figures)),
        refusals: s.refusals.iter().map(refusal_to).collect(),
    }
}

/// What is to be said of a stream as a message.
pub fn note_to(n: StreamNote) -> v1::StreamNote {
    v1::StreamNote { stream: n.stream, message: n.message, time_ns: n.time_ns }
}

fn refusal_to(r: &Refusal) -> v1::Refusal {
    v1::Refusal { reason: r.reason.to_owned(), count: r.count, message: r.message.clone() }
}

fn figures_to(f: &StreamFigures) -> v1::StreamFigures {
    v1::StreamFigures {
        arrival_rate_hz: f.arrival_rate_hz,
        jitter_s: f.jitter_s,
        longest_interval_s: f.longest_interval_s,
        delay_s: f.delay_s,
        quiet_s: f.quiet_s,
        frame_bytes: f.frame_bytes,
        latency_p50_s: f.latency_s.map(|(median, _)| median),
        latency_p95_s: f.latency_s.map(|(_, p95)| p95),
        measured_ratio: f.measured_ratio,
        median_range_m: f.median_range_m,
    }
}

fn verdict_to(verdict: &Verdict) -> v1::StreamVerdict {
    match verdict {
        Verdict::NoFrame => v1::StreamVerdict::NoFrame,
        Verdict::Good => v1::StreamVerdict::Good,
        Verdict::Troubled(_) => v1::StreamVerdict::Troubled,
    }
}

fn trouble_to(trouble: &StreamTrouble) -> v1::StreamTrouble {
    use v1::StreamTroubleKind as K;
    let kind = match trouble {
        StreamTrouble::Rejected { .. } => K::Rejected,
        StreamTrouble::Dropped { .. } => K::Dropped,
        StreamTrouble::Gaps { .. } => K::Gaps,
        StreamTrouble::ClockOffset { .. } => K::ClockOffset,
        StreamTrouble::MountOffset { .. } => K::MountOffset,
        StreamTrouble::Imu { fault, .. } => match fault {
            ImuFault::Uncovered { .. } => K::SamplesMissing,
            ImuFault::ForceUnlikeGravity { .. } => K::ForceUnlikeGravity,
            ImuFault::TurnsScaled { .. } | ImuFault::TurnsAboutOtherAxes { .. } | ImuFault::TurnsUnlike { .. } => {
                K::TurnsUnlike
            }
            ImuFault::Misleading => K::Misleading,
        },
        StreamTrouble::Silent { .. } => K::Silent,
        StreamTrouble::ClockAhead { .. } => K::ClockAhead,
        StreamTrouble::StampUnit { .. } => K::StampUnit,
        StreamTrouble::MountFar { .. } => K::MountFar,
        StreamTrouble::ClockApart { .. } => K::ClockApart,
        StreamTrouble::StrayReturns { .. } => K::StrayReturns,
        StreamTrouble::RangeUnit { .. } => K::RangeUnit,
        StreamTrouble::SeesLittle { .. } => K::SeesLittle,
        StreamTrouble::OpticalFrame => K::OpticalFrame,
        StreamTrouble::Intrinsics { .. } => K::Intrinsics,
        StreamTrouble::Wheels(_) => K::WheelsUnlike,
        StreamTrouble::NoPose(_) => K::NoPose,
    };
    v1::StreamTrouble { kind: kind.into(), message: trouble.to_string() }
}
