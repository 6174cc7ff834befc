//! Operations: how they stand, and which are listed.

use super::{fleet, unknown_enum};
use crate::v1;
use percept_service::{Error, Operation, OperationKind, OperationList, OperationState, Result};

/// An operation as a message.
pub fn operation_to(o: &Operation) -> v1::Operation {
    v1::Operation {
        operation_id: o.id.clone(),
        kind: kind_to(o.kind).into(),
        session_id: o.session.clone(),
        state: state_to(o.state).into(),
        progress: Some(v1::OperationProgress { fraction: o.how_far.fraction, stage: o.how_far.stage.clone() }),
        cancel_requested: o.cancel_requested,
        error: o.error.as_ref().map(error_to),
        result_size_bytes: o.result_bytes.map(|n| n as u64),
        create_time_ns: o.create_time_ns,
        run_time_ns: o.run_time_ns,
        end_time_ns: o.end_time_ns,
        expire_time_ns: o.expire_time_ns,
        request_id: o.request_id.clone(),
    }
}

fn kind_to(kind: OperationKind) -> v1::OperationKind {
    match kind {
        OperationKind::OptimiseMap => v1::OperationKind::OptimiseMap,
        OperationKind::ExportMap => v1::OperationKind::ExportMap,
        OperationKind::RunPipeline => v1::OperationKind::RunPipeline,
        OperationKind::RegisterCloudsGlobally => v1::OperationKind::RegisterCloudsGlobally,
        OperationKind::ImportMap => v1::OperationKind::ImportMap,
    }
}

fn state_to(state: OperationState) -> v1::OperationState {
    match state {
        OperationState::Queued => v1::OperationState::Queued,
        OperationState::Running => v1::OperationState::Running,
        OperationState::Done => v1::OperationState::Done,
        OperationState::Failed => v1::OperationState::Failed,
        OperationState::Cancelled => v1::OperationState::Cancelled,
    }
}

fn error_to(e: &Error) -> v1::ErrorInfo {
    v1::ErrorInfo {
        reason: e.reason.to_owned(),
        message: e.message.clone(),
        field: e.field.clone(),
        code: e.code.name().to_owned(),
        trace_id: String::new(),
        server: e.server.clone(),
        retry_after_s: e.retry_after.map_or(0.0, |wait| wait.as_secs_f64()),
    }
}

/// Which operations a list is of.
///
/// # Errors
/// `ENUM_UNKNOWN`, `PATTERN_INVALID`.
pub fn list(r: &v1::ListOperationsRequest) -> Result<OperationList> {
    use v1::OperationState as S;
    let state = match S::try_from(r.state).map_err(|_| unknown_enum("state", r.state))? {
        S::Unspecified => None,
        S::Queued => Some(OperationState::Queued),
        S::Running => Some(OperationState::Running),
        S::Done => Some(OperationState::Done),
        S::Failed => Some(OperationState::Failed),
        S::Cancelled => Some(OperationState::Cancelled),
    };
    let pattern = fleet::pattern(&r.session_pattern)?;
    Ok(OperationList { state, pattern, page_size: r.page_size, page_token: r.page_token.clone() })
}
