//! The gRPC door: the contract's services over HTTP/2, with health and reflection. One file a noun.

mod evaluation;
mod ingest;
mod maps;
mod navigation;
mod scene;
mod sensors;
mod sessions;
mod toolbox;

use super::status;
use futures::Stream;
use percept_service::{Error, Service};
use percept_wire::v1;
use std::pin::Pin;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tonic::transport::server::TcpIncoming;
use tonic::{Response, Status};
use tonic_health::ServingStatus;

/// All services over one set of operations.
#[derive(Clone)]
pub(crate) struct Api {
    pub(crate) service: Service,
    /// Turns true when the server stops: watches end.
    pub(crate) stopping: watch::Receiver<bool>,
}

type Answer<T> = Result<Response<T>, Status>;
type Streamed<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// A list as a stream of messages.
fn streamed<C: Send + 'static, T: 'static>(
    chunks: Vec<C>,
    wrap: impl Fn(C) -> T + Send + 'static,
) -> Answer<Streamed<T>> {
    Ok(Response::new(Box::pin(tokio_stream::iter(chunks.into_iter().map(move |c| Ok(wrap(c)))))))
}

/// Refuses a message over the limit with our own words; the transport's own limit lies above.
fn check_size(message: &impl prost::Message, api: &Api) -> Result<(), Error> {
    let (size, limit) = (message.encoded_len(), api.service.limits().max_message_bytes);
    if size <= limit {
        return Ok(());
    }
    let words = format!("message has {size} bytes, the limit is {limit}; send less at a time, or downsample");
    Err(Error::exhausted("MESSAGE_TOO_LARGE", "", words))
}

/// Serves until `stopping` turns true, then finishes what is under way.
pub(crate) async fn serve(api: Api, listener: TcpListener) -> Result<(), tonic::transport::Error> {
    let (health, health_service) = tonic_health::server::health_reporter();
    let names = [
        "percept.v1.SessionsService",
        "percept.v1.SensorsService",
        "percept.v1.MapsService",
        "percept.v1.SceneService",
        "percept.v1.NavigationService",
        "percept.v1.ToolboxService",
        "percept.v1.EvaluationService",
    ];
    for name in names.into_iter().chain([""]) {
        health.set_service_status(name, ServingStatus::Serving).await;
    }
    let mut stopping = api.stopping.clone();
    let drain = async move {
        let _ = stopping.wait_for(|s| *s).await;
        for name in names.into_iter().chain([""]) {
            health.set_service_status(name, ServingStatus::NotServing).await;
        }
    };
    let reflection = |v: tonic_reflection::server::Builder<'static>| {
        v.register_encoded_file_descriptor_set(percept_wire::DESCRIPTORS)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    let v1_reflection = reflection(tonic_reflection::server::Builder::configure()).build_v1();
    let v1alpha_reflection = reflection(tonic_reflection::server::Builder::configure()).build_v1alpha();
    // Our own limit answers first; this one keeps memory bounded should a sender ignore it.
    let limit = api.service.limits().max_message_bytes.saturating_mul(2);
    macro_rules! limited {
        ($server:path) => {
            <$server>::new(api.clone()).max_decoding_message_size(limit).max_encoding_message_size(limit)
        };
    }
    let mut server = tonic::transport::Server::builder()
        .initial_stream_window_size(16 << 20)
        .initial_connection_window_size(32 << 20)
        .max_frame_size(1 << 20)
        .http2_keepalive_interval(Some(Duration::from_secs(20)))
        .add_service(health_service)
        .add_service(limited!(v1::sessions_service_server::SessionsServiceServer<Api>))
        .add_service(limited!(v1::sensors_service_server::SensorsServiceServer<Api>))
        .add_service(limited!(v1::maps_service_server::MapsServiceServer<Api>))
        .add_service(limited!(v1::scene_service_server::SceneServiceServer<Api>))
        .add_service(limited!(v1::navigation_service_server::NavigationServiceServer<Api>))
        .add_service(limited!(v1::toolbox_service_server::ToolboxServiceServer<Api>))
        .add_service(limited!(v1::evaluation_service_server::EvaluationServiceServer<Api>));
    if let Ok(v1) = v1_reflection {
        server = server.add_service(v1);
    }
    if let Ok(v1alpha) = v1alpha_reflection {
        server = server.add_service(v1alpha);
    }
    // Without it small answers wait for the peer's acknowledgement, 40 ms. The builder's own switch does not reach
    // sockets of a listener that we bind.
    let incoming = TcpIncoming::from(listener).with_nodelay(Some(true));
    server.serve_with_incoming_shutdown(incoming, drain).await
}
