//! What is no rpc: health, metrics, the OpenAPI document, and two pages for people.

use super::super::grpc::Api;
use crate::telemetry::operations::Operation;
use crate::telemetry::requests::Answered;
use axum::Router;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use bytes::Bytes;
use percept_service::{Readiness, observe, reason};
use percept_wire::convert;
use serde_json::{Value, json};

/// A page.
pub(super) struct Page {
    pub(super) path: &'static str,
    /// Its name in the OpenAPI document.
    pub(super) id: &'static str,
    pub(super) about: &'static str,
    pub(super) media_type: &'static str,
    content: Content,
}

#[derive(Clone, Copy)]
enum Content {
    Html(&'static str),
    OpenApi,
    Reasons,
    Alive,
    Ready,
    Metrics,
}

impl Page {
    /// What it holds, as OpenAPI describes it.
    pub(super) fn schema(&self) -> Value {
        match self.content {
            Content::OpenApi => json!({"type": "object"}),
            Content::Ready => json!({
                "type": "object",
                "required": ["ready", "reasons"],
                "properties": {
                    "ready": {"type": "boolean"},
                    "reasons": {"type": "array", "items": {"$ref": "#/components/schemas/NotReadyReason"}},
                },
            }),
            Content::Html(_) | Content::Reasons | Content::Alive | Content::Metrics => json!({"type": "string"}),
        }
    }
}

const fn page(
    path: &'static str,
    id: &'static str,
    about: &'static str,
    media_type: &'static str,
    content: Content,
) -> Page {
    Page { path, id, about, media_type, content }
}

const HTML: &str = "text/html; charset=utf-8";
/// What `viewer/` is built to; `build.rs` makes it.
const VIEWER: &str = include_str!(concat!(env!("OUT_DIR"), "/viewer.html"));
const TEXT: &str = "text/plain; charset=utf-8";
const JSON: &str = "application/json";

/// All pages.
#[rustfmt::skip]
pub(super) const PAGES: &[Page] = &[
    page("/", "LivePage", "Sessions, live in three dimensions, in a browser", HTML, Content::Html(VIEWER)),
    page("/docs", "DocsPage", "This API, to browse and try", HTML, Content::Html(include_str!("docs.html"))),
    page("/openapi.json", "OpenApi", "This document", JSON, Content::OpenApi),
    page("/reasons", "Reasons", "Every reason of an error, and what it means", "text/markdown; charset=utf-8", Content::Reasons),
    page("/livez", "Live", "Whether the process runs", TEXT, Content::Alive),
    page("/readyz", "Ready", "Whether requests are taken, and if not, why", JSON, Content::Ready),
    page("/healthz", "Health", "The same as /readyz", JSON, Content::Ready),
    page("/metrics", "Metrics", "What is counted and timed, for Prometheus, unless it is served elsewhere", observe::TEXT_MEDIA_TYPE, Content::Metrics),
];

/// Pages load nothing from elsewhere.
const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; connect-src 'self'; img-src 'self' blob: data:; style-src 'unsafe-inline'; \
     script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

/// Routes of all pages; `document` is the OpenAPI document.
pub(super) fn router(api: &Api, document: Bytes) -> Router {
    let is_served = |page: &&Page| match page.content {
        Content::Metrics => api.shows_metrics,
        _ => api.listen.docs || !matches!(page.path, "/docs" | "/openapi.json" | "/reasons"),
    };
    let shown = PAGES.iter().filter(is_served);
    routed(shown, api, &document)
}

/// Routes of what watches the server.
pub(super) fn telemetry(api: &Api) -> Router {
    let watching = |page: &&Page| matches!(page.content, Content::Metrics | Content::Alive | Content::Ready);
    routed(PAGES.iter().filter(watching), api, &Bytes::new())
}

fn routed<'a>(pages: impl Iterator<Item = &'static Page> + 'a, api: &Api, document: &Bytes) -> Router {
    pages.fold(Router::new(), |router, page| {
        let (api, document) = (api.clone(), document.clone());
        router.route(page.path, get(move || async move { answer(page, &api, document) }))
    })
}

fn answer(page: &Page, api: &Api, document: Bytes) -> Response {
    let (status, body) = match page.content {
        Content::Html(text) => (StatusCode::OK, Bytes::from_static(text.as_bytes())),
        Content::OpenApi => (StatusCode::OK, document),
        Content::Reasons => (StatusCode::OK, Bytes::from(reason::markdown())),
        Content::Alive => (StatusCode::OK, Bytes::from_static(b"ok\n")),
        Content::Ready => readiness(&api.service.health().readiness()),
        Content::Metrics => (StatusCode::OK, Bytes::from(observe::text())),
    };
    let mut response = (status, [(header::CONTENT_TYPE, page.media_type)], body).into_response();
    response.extensions_mut().insert(Answered { operation: Operation::brief(page.path) });
    let headers = response.headers_mut();
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    if matches!(page.content, Content::Html(_)) {
        headers.insert(header::CONTENT_SECURITY_POLICY, POLICY);
    }
    response
}

fn readiness(readiness: &Readiness) -> (StatusCode, Bytes) {
    let status = if readiness.is_ready() { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let reasons: Vec<_> = convert::server::reasons_to(readiness)
        .into_iter()
        .map(|r| json!({"part": r.part, "reason": r.reason, "message": r.message}))
        .collect();
    let body = json!({"ready": readiness.is_ready(), "reasons": reasons});
    (status, Bytes::from(body.to_string()))
}
