//! What is no rpc: health, the OpenAPI document, and two pages for people.

use super::super::grpc::Api;
use axum::Router;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use bytes::Bytes;

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
    Alive,
    Ready,
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
const TEXT: &str = "text/plain; charset=utf-8";

/// All pages.
#[rustfmt::skip]
pub(super) const PAGES: &[Page] = &[
    page("/", "LivePage", "Sessions, live, in a browser", HTML, Content::Html(include_str!("live.html"))),
    page("/docs", "DocsPage", "This API, to browse and try", HTML, Content::Html(include_str!("docs.html"))),
    page("/openapi.json", "OpenApi", "This document", "application/json", Content::OpenApi),
    page("/livez", "Live", "Whether the process runs", TEXT, Content::Alive),
    page("/readyz", "Ready", "Whether requests are taken", TEXT, Content::Ready),
    page("/healthz", "Health", "Whether requests are taken", TEXT, Content::Ready),
];

/// Pages load nothing from elsewhere.
const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; connect-src 'self'; img-src 'self' blob: data:; style-src 'unsafe-inline'; \
     script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

/// Routes of all pages; `document` is the OpenAPI document.
pub(super) fn router(api: &Api, document: Bytes) -> Router {
    PAGES.iter().fold(Router::new(), |router, page| {
        let (api, document) = (api.clone(), document.clone());
        router.route(page.path, get(move || async move { answer(page, &api, document) }))
    })
}

fn answer(page: &Page, api: &Api, document: Bytes) -> Response {
    let (status, body) = match page.content {
        Content::Html(text) => (StatusCode::OK, Bytes::from_static(text.as_bytes())),
        Content::OpenApi => (StatusCode::OK, document),
        Content::Alive => (StatusCode::OK, Bytes::from_static(b"ok\n")),
        Content::Ready if *api.stopping.borrow() => {
            (StatusCode::SERVICE_UNAVAILABLE, Bytes::from_static(b"stopping\n"))
        }
        Content::Ready => (StatusCode::OK, Bytes::from_static(b"ok\n")),
    };
    let mut response = (status, [(header::CONTENT_TYPE, page.media_type)], body).into_response();
    let headers = response.headers_mut();
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    if matches!(page.content, Content::Html(_)) {
        headers.insert(header::CONTENT_SECURITY_POLICY, POLICY);
    }
    response
}
