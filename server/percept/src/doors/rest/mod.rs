//! The REST door: the contract's messages as JSON over HTTP/1.1, live events by SSE, maps as files.
//!
//! Comes in: HTTP requests. Goes out: JSON, files, or `application/problem+json`. Nothing is decided here: a
//! request becomes the protobuf message of its rpc and is answered by the very handlers of the gRPC door.
//! Start with [`routes`]: one table from which both the router and the OpenAPI document are made.

mod body;
pub(super) mod by_name;
mod calls;
mod comments;
mod events;
mod fields;
mod files;
mod foxglove;
mod hosts;
mod openapi;
mod pages;
mod patch;
mod range;
mod refused;
mod routes;
mod strict;
mod transcode;

use super::grpc::Api;
use super::identify::{self, Door};
use super::listener::{Framing, Listener};
use crate::telemetry::operations;
use crate::telemetry::requests::{Answered, Observe};
use axum::Router;
use axum::extract::{FromRequestParts, RawPathParams, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, Version, header};
use axum::middleware::{Next, from_fn, map_response};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodFilter, get, on};
use bytes::Bytes;
use hosts::Hosts;
use percept_service::reason;
use percept_service::{Error, observe};
use refused::Refused;
use routes::{Bound, Kind, Verb};
use std::sync::Arc;
use tower_http::compression::CompressionLayer;

/// JSON below this is not worth compressing, above `COMPRESS_AT_MOST_BYTES` not worth the wait.
const COMPRESS_AT_LEAST_BYTES: u64 = 1 << 10;
const COMPRESS_AT_MOST_BYTES: u64 = 4 << 20;

/// A session as Foxglove opens it.
const FOXGLOVE: &str = "/v1/sessions/{session_id}/foxglove";

/// Serves until the server stops, then finishes what is under way.
///
/// # Errors
/// What the system says of the address.
pub(crate) async fn serve(api: Api, listener: Listener) -> std::io::Result<()> {
    let hosts = Hosts::new(listener.address()?, &api.listen.allowed_hosts);
    let app = router(api, hosts).map_err(std::io::Error::other)?;
    listener.serve(app, |_| Framing::Whole).await;
    Ok(())
}

/// Serves what watches the server, apart from the door that everybody uses, until the process ends.
///
/// # Errors
/// What the system says of the address.
pub(crate) async fn serve_telemetry(api: Api, listener: Listener) -> std::io::Result<()> {
    let address = listener.address()?;
    let mut app = pages::telemetry(&api).fallback(not_found);
    // What only this machine reaches, a page in its browser may reach, too; elsewhere scrapers come by any name.
    if address.ip().is_loopback() {
        let hosts = Hosts::new(address, &api.listen.allowed_hosts);
        app = app.layer(from_fn(move |request: Request, next: Next| ours_only(hosts.clone(), request, next)));
    }
    listener.serve(app, |_| Framing::Whole).await;
    Ok(())
}

/// Everything that the door answers.
fn router(api: Api, hosts: Hosts) -> Result<Router, Error> {
    let bound = Bound::all()?;
    let gate = api.gate.clone();
    let document = Bytes::from(openapi::document(&bound).to_string());
    let mut router = pages::router(&api, document);
    for route in bound {
        let (path, verb, route, api) = (route.route.path, route.route.verb, Arc::new(route), api.clone());
        let operation = operations::of_rpc(route.route.rpc);
        let handler = move |request: Request| handle(Arc::clone(&route), operation, api.clone(), request);
        router = router.route(path, on(filter(verb), handler));
    }
    let foxglove = api.clone();
    router = router.route(FOXGLOVE, get(move |request: Request| opened_in_foxglove(foxglove.clone(), request)));
    Ok(router
        .fallback(not_found)
        .method_not_allowed_fallback(not_allowed)
        .layer(from_fn(move |request, next| gate.clone().admit(Door::Rest, request, next)))
        .layer(CompressionLayer::new().compress_when(worth_compressing))
        .layer(from_fn(move |request: Request, next: Next| ours_only(hosts.clone(), request, next)))
        .layer(map_response(never_sniffed))
        .layer(Observe(observe::Door::Rest)))
}

async fn ours_only(hosts: Hosts, request: Request, next: Next) -> Response {
    let (parts, body) = request.into_parts();
    match hosts.check(&parts) {
        Ok(()) => next.run(Request::from_parts(parts, body)).await,
        Err(refused) => refused.into_response(),
    }
}

const fn filter(verb: Verb) -> MethodFilter {
    match verb {
        Verb::Get => MethodFilter::GET,
        Verb::Post => MethodFilter::POST,
        Verb::Patch => MethodFilter::PATCH,
        Verb::Delete => MethodFilter::DELETE,
    }
}

async fn handle(route: Arc<Bound>, operation: operations::Operation, api: Api, request: Request) -> Response {
    let mut response = answer(&route, api, request).await.unwrap_or_else(IntoResponse::into_response);
    response.extensions_mut().insert(Answered { operation });
    response
}

async fn answer(route: &Bound, api: Api, request: Request) -> Result<Response, Refused> {
    let (mut parts, body) = request.into_parts();
    let context = identify::context(&parts.extensions)?;
    let (input, mut is_large) = (route.rpc.input(), false);
    let mut message = match route.route.verb {
        Verb::Post => {
            fields::no_query(&parts.uri)?;
            let format = transcode::content_format(&parts.headers)?;
            let bytes = body::read(body, &parts.headers, api.service.limits()).await?;
            is_large = transcode::is_large(&bytes);
            transcode::decode(input, format, bytes).await?
        }
        Verb::Patch => {
            let format = transcode::content_format(&parts.headers)?;
            let bytes = body::read(body, &parts.headers, api.service.limits()).await?;
            patch::request(input, route.route.body, format, bytes, &parts).await?
        }
        Verb::Get | Verb::Delete => fields::from_query(input, &parts.uri, &route.route.query_fields(&route.rpc))?,
    };
    let names = path_parameters(&mut parts).await?;
    for (name, field) in route.route.fill {
        let text = names.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str()).unwrap_or_default();
        fields::fill_from_path(&mut message, name, field, text)?;
    }
    let request = transcode::encoded(message, is_large).await?;
    match route.route.kind {
        Kind::Message(call) => {
            let output = call(api, context, request).await?;
            transcode::encode(route.rpc.output(), &parts.headers, output).await
        }
        Kind::Tagged(call, tag) => {
            let output = call(api, context, request).await?;
            let tag = tag(&output);
            let mut response = transcode::encode(route.rpc.output(), &parts.headers, output).await?;
            patch::tell_tag(&mut response, tag.as_deref());
            Ok(response)
        }
        Kind::SceneGraph(call) => {
            if routes::wants_dot(&parts)? {
                return routes::scene_as_dot(&api, context, request).await;
            }
            let output = call(api, context, request).await?;
            transcode::encode(route.rpc.output(), &parts.headers, output).await
        }
        Kind::Picture(call) => {
            let output = call(api, context, request).await?;
            if transcode::wants_message(&parts.headers) {
                return transcode::encode(route.rpc.output(), &parts.headers, output).await;
            }
            Ok(files::picture(output)?)
        }
        Kind::Events => events::watch(&api, context, request, &parts.headers).await,
        Kind::PathEvents => events::watch_path(&api, context, request).await,
        Kind::FleetEvents => events::watch_all(&api, context, request, &parts.headers).await,
        Kind::OperationResult => files::result(&api, context, request, route.rpc.output(), &parts.headers).await,
        Kind::File => {
            let name = names.iter().find(|(n, _)| n == "name").map(|(_, v)| v.as_str()).unwrap_or_default();
            files::export(&api, context, request, name, &parts.headers).await
        }
    }
}

async fn opened_in_foxglove(api: Api, request: Request) -> Response {
    let (mut parts, body) = request.into_parts();
    let opened = async {
        let names = path_parameters(&mut parts).await?;
        let session = names.into_iter().find(|(n, _)| n == "session_id").map(|(_, v)| v).unwrap_or_default();
        foxglove::open(api, session, Request::from_parts(parts, body)).await
    };
    let mut response = opened.await.unwrap_or_else(IntoResponse::into_response);
    response.extensions_mut().insert(Answered { operation: operations::FOXGLOVE });
    response
}

async fn path_parameters(parts: &mut Parts) -> Result<Vec<(String, String)>, Refused> {
    let params = RawPathParams::from_request_parts(parts, &()).await;
    let params =
        params.map_err(|e| Error::invalid(reason::PATH_INVALID, "", format!("the path cannot be read: {e}")))?;
    Ok(params.iter().map(|(name, value)| (name.to_owned(), value.to_owned())).collect())
}

async fn not_found(uri: Uri) -> Refused {
    let path: String = uri.path().chars().take(200).collect();
    let message = format!("there is nothing at {path}; /openapi.json lists what there is, /docs shows it");
    Error::not_found(reason::ROUTE_NOT_FOUND, "", message).into()
}

async fn not_allowed(method: Method, uri: Uri) -> Refused {
    let path: String = uri.path().chars().take(200).collect();
    let message = format!("{method} is not served at {path}; the Allow header lists the methods that are");
    Refused::http(StatusCode::METHOD_NOT_ALLOWED, reason::METHOD_NOT_ALLOWED, message)
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
