//! The REST door: the contract's messages as JSON over HTTP/1.1, live events by SSE, maps as files.
//!
//! Comes in: HTTP requests. Goes out: JSON, files, or `application/problem+json`. Nothing is decided here: a
//! request becomes the protobuf message of its rpc and is answered by the very handlers of the gRPC door.
//! Start with [`routes`]: one table from which both the router and the OpenAPI document are made.

mod body;
mod comments;
mod events;
mod fields;
mod files;
mod openapi;
mod pages;
mod range;
mod refused;
mod routes;
mod transcode;

use super::grpc::Api;
use axum::Router;
use axum::extract::{FromRequestParts, RawPathParams, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, Version, header};
use axum::middleware::map_response;
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodFilter, on};
use axum::serve::ListenerExt;
use bytes::Bytes;
use percept_service::Error;
use prost::Message;
use refused::Refused;
use routes::{Bound, Kind, Verb};
use std::sync::Arc;
use tokio::net::TcpListener;
use tower_http::compression::CompressionLayer;

/// JSON below this is not worth compressing, above `COMPRESS_AT_MOST_BYTES` not worth the wait.
const COMPRESS_AT_LEAST_BYTES: u64 = 1 << 10;
const COMPRESS_AT_MOST_BYTES: u64 = 4 << 20;

/// Serves until `stopping` turns true, then finishes what is under way.
pub(crate) async fn serve(api: Api, listener: TcpListener) -> std::io::Result<()> {
    let mut stopping = api.stopping.clone();
    let app = router(api).map_err(std::io::Error::other)?;
    // Without it small answers wait for the peer's acknowledgement; a socket that refuses it still works.
    let listener = listener.tap_io(|socket| drop(socket.set_nodelay(true)));
    let drain = async move {
        let _ = stopping.wait_for(|s| *s).await;
    };
    axum::serve(listener, app).with_graceful_shutdown(drain).await
}

/// Everything that the door answers.
fn router(api: Api) -> Result<Router, Error> {
    let bound = Bound::all()?;
    let document = Bytes::from(openapi::document(&bound).to_string());
    let mut router = pages::router(&api, document);
    for route in bound {
        let (path, verb, route, api) = (route.route.path, route.route.verb, Arc::new(route), api.clone());
        let handler = move |request: Request| handle(Arc::clone(&route), api.clone(), request);
        router = router.route(path, on(filter(verb), handler));
    }
    Ok(router
        .fallback(not_found)
        .method_not_allowed_fallback(not_allowed)
        .layer(CompressionLayer::new().compress_when(worth_compressing))
        .layer(map_response(never_sniffed)))
}

const fn filter(verb: Verb) -> MethodFilter {
    match verb {
        Verb::Get => MethodFilter::GET,
        Verb::Post => MethodFilter::POST,
        Verb::Delete => MethodFilter::DELETE,
    }
}

async fn handle(route: Arc<Bound>, api: Api, request: Request) -> Response {
    answer(&route, api, request).await.unwrap_or_else(IntoResponse::into_response)
}

async fn answer(route: &Bound, api: Api, request: Request) -> Result<Response, Refused> {
    let (mut parts, body) = request.into_parts();
    let input = route.rpc.input();
    let mut message = match route.route.verb {
        Verb::Post => {
            fields::no_query(&parts.uri)?;
            let format = transcode::content_format(&parts.headers)?;
            let bytes = body::read(body, &parts.headers, api.service.limits()).await?;
            transcode::decode(input, format, bytes).await?
        }
        Verb::Get | Verb::Delete => fields::from_query(input, &parts.uri, &route.route.query_fields(&route.rpc))?,
    };
    let names = path_parameters(&mut parts).await?;
    for (name, field) in route.route.fill {
        let text = names.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str()).unwrap_or_default();
        fields::fill_from_path(&mut message, name, field, text)?;
    }
    let request = Bytes::from(message.encode_to_vec());
    match route.route.kind {
        Kind::Message(call) => {
            let output = call(api, request).await?;
            transcode::encode(route.rpc.output(), &parts.headers, output).await
        }
        Kind::SceneGraph(call) => {
            if routes::wants_dot(&parts)? {
                return routes::scene_as_dot(&api, request).await;
            }
            let output = call(api, request).await?;
            transcode::encode(route.rpc.output(), &parts.headers, output).await
        }
        Kind::Events => events::watch(&api, request, &parts.headers).await,
        Kind::File => {
            let name = names.iter().find(|(n, _)| n == "name").map(|(_, v)| v.as_str()).unwrap_or_default();
            files::export(&api, request, name, &parts.headers).await
        }
    }
}

async fn path_parameters(parts: &mut Parts) -> Result<Vec<(String, String)>, Refused> {
    let params = RawPathParams::from_request_parts(parts, &()).await;
    let params = params.map_err(|e| Error::invalid("PATH_INVALID", "", format!("the path cannot be read: {e}")))?;
    Ok(params.iter().map(|(name, value)| (name.to_owned(), value.to_owned())).collect())
}

async fn not_found(uri: Uri) -> Refused {
    let path: String = uri.path().chars().take(200).collect();
    let message = format!("there is nothing at {path}; /openapi.json lists what there is, /docs shows it");
    Error::not_found("ROUTE_NOT_FOUND", "", message).into()
}

async fn not_allowed(method: Method, uri: Uri) -> Refused {
    let path: String = uri.path().chars().take(200).collect();
    let message = format!("{method} is not served at {path}; the Allow header lists the methods that are");
    Refused::http(StatusCode::METHOD_NOT_ALLOWED, "METHOD_NOT_ALLOWED", message)
}

/// JSON and pages only: files have strong entity tags, which compression would belie, and events must not wait.
fn worth_compressing(_: StatusCode, _: Version, headers: &HeaderMap, _: &axum::http::Extensions) -> bool {
    let text = |name| headers.get(name).and_then(|v| v.to_str().ok()).unwrap_or_default();
    let media = text(header::CONTENT_TYPE);
    let length = text(header::CONTENT_LENGTH).parse().unwrap_or(COMPRESS_AT_LEAST_BYTES);
    (media.starts_with("application/json") || media.starts_with("text/html"))
        && (COMPRESS_AT_LEAST_BYTES..=COMPRESS_AT_MOST_BYTES).contains(&length)
}

async fn never_sniffed(mut response: Response) -> Response {
    response.headers_mut().insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    response
}
