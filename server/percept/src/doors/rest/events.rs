//! Live events of a session, or of all, as server-sent events (HTML Living Standard, section 9.2).

use super::super::grpc::Api;
use super::super::status;
use super::calls;
use super::refused::Refused;
use axum::http::HeaderMap;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures::{Stream, StreamExt};
use percept_service::reason;
use percept_service::{CallContext, Error};
use percept_wire::{json, v1};
use prost::Message;
use serde_json::Value;
use std::convert::Infallible;
use std::time::Duration;
use tonic::Status;
use v1::navigation_service_server::NavigationService;
use v1::sessions_service_server::SessionsService;

/// A comment is sent when nothing happened for this long, so that proxies keep the connection.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// What a browser sends when it comes back: the id of the last event that it saw.
const LAST_EVENT_ID: &str = "last-event-id";

/// `WatchSession`; every event's id is its token.
///
/// # Errors
/// `HEADER_INVALID`, and those of the rpc.
pub(super) async fn watch(
    api: &Api,
    context: CallContext,
    request: Bytes,
    headers: &HeaderMap,
) -> Result<Response, Refused> {
    let mut request = v1::WatchSessionRequest::decode(request).map_err(Error::internal)?;
    // It is newer than the query, which a browser repeats as it was.
    if let Some(token) = last_event(headers)? {
        request.resume_token = Some(token);
    }
    let stream = api.watch_session(calls::asked(context, request)).await?.into_inner();
    let read = |message: v1::WatchSessionResponse| {
        let event = message.event.unwrap_or_default();
        (event.token, json::to_json("SessionEvent", &event))
    };
    Ok(sent(stream.map(move |message| told(message.map(read)))))
}

/// `WatchSessions`; every event's id is its token.
///
/// # Errors
/// `HEADER_INVALID`, and those of the rpc.
pub(super) async fn watch_all(
    api: &Api,
    context: CallContext,
    request: Bytes,
    headers: &HeaderMap,
) -> Result<Response, Refused> {
    let mut request = v1::WatchSessionsRequest::decode(request).map_err(Error::internal)?;
    if let Some(token) = last_event(headers)? {
        request.resume_token = Some(token);
    }
    let stream = api.watch_sessions(calls::asked(context, request)).await?.into_inner();
    let read = |message: v1::WatchSessionsResponse| {
        let event = message.event.unwrap_or_default();
        (event.token, json::to_json("FleetEvent", &event))
    };
    Ok(sent(stream.map(move |message| told(message.map(read)))))
}

/// `WatchPath`; events are numbered by the version of the map.
///
/// # Errors
/// Those of the rpc.
pub(super) async fn watch_path(api: &Api, context: CallContext, request: Bytes) -> Result<Response, Refused> {
    let request = v1::WatchPathRequest::decode(request).map_err(Error::internal)?;
    let stream = api.watch_path(calls::asked(context, request)).await?.into_inner();
    let read = |message: v1::WatchPathResponse| {
        (message.stamp.as_ref().map_or(0, |s| s.map_version), json::to_json("WatchPathResponse", &message))
    };
    Ok(sent(stream.map(move |message| told(message.map(read)))))
}

fn sent(events: impl Stream<Item = Event> + Send + 'static) -> Response {
    let events = events.map(Ok::<_, Infallible>);
    Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response()
}

fn last_event(headers: &HeaderMap) -> Result<Option<u64>, Error> {
    let Some(value) = headers.get(LAST_EVENT_ID) else { return Ok(None) };
    let token = value.to_str().ok().and_then(|v| v.trim().parse().ok());
    let invalid = || {
        let message = format!("{LAST_EVENT_ID} is {value:?}; it must be the id of an event of this stream");
        Error::invalid(reason::HEADER_INVALID, LAST_EVENT_ID, message)
    };
    token.map(Some).ok_or_else(invalid)
}

/// An event, of its token and what it says.
fn told(event: Result<(u64, Result<Value, Error>), Status>) -> Event {
    match event {
        Ok((token, said)) => {
            Event::default().id(token.to_string()).data(said.map(|v| v.to_string()).unwrap_or_default())
        }
        Err(broken) => {
            let problem =
                v1::ErrorInfo::decode(status::from_grpc(&broken).to_error_info().as_slice()).unwrap_or_default();
            let data = json::to_json("ErrorInfo", &problem).map(|v| v.to_string()).unwrap_or_default();
            Event::default().event("problem").data(data)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_event_is_read_from_the_header() {
        let headers = |v: &'static str| HeaderMap::from_iter([(LAST_EVENT_ID.parse().unwrap(), v.parse().unwrap())]);
        assert_eq!(last_event(&HeaderMap::new()).unwrap(), None);
        assert_eq!(last_event(&headers("12")).unwrap(), Some(12));
        assert_eq!(last_event(&headers("x")).unwrap_err().reason, "HEADER_INVALID");
    }
}
