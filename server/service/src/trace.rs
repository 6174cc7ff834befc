//! Which trace a request belongs to, as W3C Trace Context names it: taken from the caller, or begun here.
//!
//! A door enters the context around its handler ([`TraceContext::scope`]); whoever writes an error or a line of the log
//! below asks for [`current`].

use std::fmt;
use std::future::Future;
use std::hash::{BuildHasher, RandomState};
use std::sync::atomic::{AtomicU64, Ordering};

tokio::task_local! {
    static CURRENT: TraceContext;
}

/// The trace of a request and the span in it that answers.
///
/// **Source**: W3C Trace Context, version 00, section 3.2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct TraceContext {
    /// Names the trace in every service that it passes; never 0.
    pub trace_id: u128,
    /// Names the span; never 0.
    pub span_id: u64,
    /// Whether the caller records the trace.
    pub is_sampled: bool,
}

impl TraceContext {
    /// A trace of its own. Its ids are unlike all others; they are no secret.
    pub fn begin() -> Self {
        let trace_id = (u128::from(fresh()) << 64) | u128::from(fresh());
        Self { trace_id, span_id: fresh(), is_sampled: false }
    }

    /// What a caller's `traceparent` says; none if it is no such header. Later versions are read as far as they are
    /// like version 00.
    pub fn parse(traceparent: &str) -> Option<Self> {
        let mut parts = traceparent.trim().split('-');
        let (version, trace, span, flags) = (parts.next()?, parts.next()?, parts.next()?, parts.next()?);
        let version = hex(version, 2).filter(|v| *v != 0xff)?;
        if version == 0 && parts.next().is_some() {
            return None;
        }
        let trace_id = hex(trace, 32).filter(|id| *id != 0)?;
        let span_id = hex(span, 16).filter(|id| *id != 0)? as u64;
        Some(Self { trace_id, span_id, is_sampled: hex(flags, 2)? & 1 == 1 })
    }

    /// The same trace, with a span of ours.
    #[must_use]
    pub fn child(self) -> Self {
        Self { span_id: fresh(), ..self }
    }

    /// The trace's id, 32 hexadecimal digits.
    pub fn trace_id_hex(&self) -> String {
        format!("{:032x}", self.trace_id)
    }

    /// Runs `work` with this as its [`current`] context.
    pub fn scope<F: Future>(self, work: F) -> impl Future<Output = F::Output> {
        CURRENT.scope(self, work)
    }
}

/// As the header `traceparent` has it.
impl fmt::Display for TraceContext {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "00-{:032x}-{:016x}-{:02x}", self.trace_id, self.span_id, u8::from(self.is_sampled))
    }
}

/// The context of the request that this task answers; none outside of one.
pub fn current() -> Option<TraceContext> {
    CURRENT.try_with(|context| *context).ok()
}

/// Lower-case hexadecimal of exactly `digits` digits.
fn hex(text: &str, digits: usize) -> Option<u128> {
    let fine = text.len() == digits && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
    fine.then(|| u128::from_str_radix(text, 16).ok()).flatten()
}

/// Random, never 0: the standard library keys its hashes with the system's randomness.
fn fresh() -> u64 {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    RandomState::new().hash_one(COUNT.fetch_add(1, Ordering::Relaxed)).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: &str = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01";

    #[test]
    fn the_example_of_the_standard_goes_through_unchanged() {
        let context = TraceContext::parse(EXAMPLE).unwrap();
        assert_eq!(context.trace_id_hex(), "4bf92f3577b34da6a3ce929d0e0e4736");
        assert_eq!(context.to_string(), EXAMPLE);
        assert!(context.is_sampled);
        let child = context.child();
        assert_eq!(child.trace_id, context.trace_id);
        assert_ne!(child.span_id, context.span_id);
    }

    #[test]
    fn what_is_no_traceparent_is_let_be() {
        let wrong = [
            "",
            "00",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01-more",
            "ff-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01",
            "00-4BF92F3577B34DA6A3CE929D0E0E4736-00f067aa0ba902b7-01",
            "00-00000000000000000000000000000000-00f067aa0ba902b7-01",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-0000000000000000-01",
            "00-+bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01",
        ];
        for text in wrong {
            assert_eq!(TraceContext::parse(text), None, "{text}");
        }
        assert!(TraceContext::parse(&EXAMPLE.replacen("00", "cc", 1).replace("-01", "-01-what")).is_some());
    }

    #[test]
    fn traces_begun_here_differ() {
        let all: std::collections::HashSet<_> = (0..1000).map(|_| TraceContext::begin().trace_id).collect();
        assert_eq!(all.len(), 1000);
    }

    #[tokio::test]
    async fn a_handler_sees_the_context_of_its_request() {
        let context = TraceContext::begin();
        assert_eq!(context.scope(async { current() }).await, Some(context));
        assert_eq!(current(), None);
    }
}
