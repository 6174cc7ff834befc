//! Spans of requests for a collector, by OTLP over gRPC. One span a request, named by its operation.

use crate::config::Telemetry;
use opentelemetry::trace::{SpanContext, SpanId, SpanKind, Status, TraceFlags, TraceId, TraceState};
use opentelemetry::{InstrumentationScope, KeyValue};
use opentelemetry_otlp::{SpanExporter, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::{BatchSpanProcessor, SpanData, SpanProcessor};
use percept_service::observe::Door;
use percept_service::trace::TraceContext;
use std::sync::OnceLock;
use std::time::{Instant, SystemTime};

struct Export {
    /// Sends in batches from a thread of its own; what it cannot hold is dropped.
    processor: BatchSpanProcessor,
    scope: InstrumentationScope,
    /// Share of the traces that begin here.
    share: f64,
}

/// A request that is over.
#[derive(Debug)]
pub(super) struct RequestSpan {
    pub(super) trace: TraceContext,
    /// The caller's span.
    pub(super) parent_span_id: Option<u64>,
    pub(super) door: Door,
    pub(super) operation: &'static str,
    /// Name of the gRPC code.
    pub(super) code: &'static str,
    pub(super) bytes_in: u64,
    pub(super) bytes_out: u64,
    pub(super) began: Instant,
}

static EXPORT: OnceLock<Export> = OnceLock::new();

/// Exports from now on if a collector is named. Within the runtime, whose tasks do the sending.
pub(super) fn begin(config: &Telemetry) {
    if config.otlp_endpoint.is_empty() {
        return;
    }
    let exporter = SpanExporter::builder().with_tonic().with_endpoint(&config.otlp_endpoint).build();
    let exporter = match exporter {
        Ok(exporter) => exporter,
        Err(error) => {
            tracing::error!(%error, endpoint = config.otlp_endpoint, "traces are not exported");
            return;
        }
    };
    let mut processor = BatchSpanProcessor::builder(exporter).build();
    let version = KeyValue::new("service.version", env!("CARGO_PKG_VERSION"));
    processor.set_resource(&Resource::builder().with_service_name("percept").with_attribute(version).build());
    let scope = InstrumentationScope::builder("percept").build();
    let _ = EXPORT.set(Export { processor, scope, share: config.trace_share });
}

/// Sends what waits, for a few seconds at most.
pub(super) fn end() {
    if let Some(export) = EXPORT.get()
        && let Err(error) = export.processor.shutdown()
    {
        tracing::warn!(%error, "the last traces were not exported");
    }
}

/// Decides whether a trace that begins here is recorded; a caller decides for its own.
pub(super) fn sampled(mut trace: TraceContext) -> TraceContext {
    let Some(export) = EXPORT.get() else { return trace };
    trace.is_sampled = within(trace, export.share);
    trace
}

/// Whether a trace is one of this share of all, 0 to 1: by its id, so that all of its requests are or none.
pub(super) fn within(trace: TraceContext, share: f64) -> bool {
    share > 0.0 && (trace.trace_id as u64 as f64) < share * (u64::MAX as f64 + 1.0)
}

/// Hands over the span of a request that is over.
pub(super) fn finished(span: &RequestSpan) {
    let Some(export) = EXPORT.get().filter(|_| span.trace.is_sampled) else { return };
    let end_time = SystemTime::now();
    let attributes = vec![
        KeyValue::new("rpc.system", span.door.name()),
        KeyValue::new("rpc.method", span.operation),
        KeyValue::new("rpc.response.status_code", span.code),
        KeyValue::new("percept.bytes_in", i64::try_from(span.bytes_in).unwrap_or(i64::MAX)),
        KeyValue::new("percept.bytes_out", i64::try_from(span.bytes_out).unwrap_or(i64::MAX)),
    ];
    let is_fault = matches!(span.code, "INTERNAL" | "UNKNOWN" | "UNAVAILABLE" | "DATA_LOSS" | "DEADLINE_EXCEEDED");
    let span_id = SpanId::from_bytes(span.trace.span_id.to_be_bytes());
    let trace_id = TraceId::from_bytes(span.trace.trace_id.to_be_bytes());
    export.processor.on_end(SpanData {
        span_context: SpanContext::new(trace_id, span_id, TraceFlags::SAMPLED, false, TraceState::default()),
        // 0 is none.
        parent_span_id: SpanId::from_bytes(span.parent_span_id.unwrap_or_default().to_be_bytes()),
        parent_span_is_remote: span.parent_span_id.is_some(),
        span_kind: SpanKind::Server,
        name: span.operation.into(),
        start_time: end_time.checked_sub(span.began.elapsed()).unwrap_or(end_time),
        end_time,
        attributes,
        dropped_attributes_count: 0,
        events: Default::default(),
        links: Default::default(),
        status: if is_fault { Status::error(span.code) } else { Status::Unset },
        instrumentation_scope: export.scope.clone(),
    });
}
