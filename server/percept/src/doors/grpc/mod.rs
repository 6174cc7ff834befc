//! The gRPC door: the contract's services over HTTP/2, with health and reflection. One file a noun.

mod calls;
mod detectors;
mod evaluation;
pub(crate) mod ingest;
mod layers;
mod maps;
mod navigation;
mod operations;
mod scene;
mod sensors;
mod server;
mod sessions;
mod toolbox;

use super::bounds::{Bounds, Peer};
use super::identify::{self, Door, Gate};
use super::listener::{Listener, PeerIdentity};
use super::status;
use crate::config::Listen;
use crate::telemetry::requests::Observe;
use axum::middleware::from_fn;
use futures::Stream;
use percept_service::reason;
use percept_service::{CallContext, Caller, Error, Guarded, Readiness, observe};
use percept_wire::{json, v1};
use std::net::{Ipv4Addr, SocketAddr};
use std::pin::Pin;
use std::sync::Arc;
use tokio::sync::watch;
use tonic::service::Routes;
use tonic::{Extensions, Request, Response, Status};
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

/// All services over one set of operations.
#[derive(Clone)]
pub(crate) struct Api {
    pub(crate) service: Guarded,
    /// Tells who calls.
    pub(crate) gate: Gate,
    /// How the doors are set up.
    pub(crate) listen: Arc<Listen>,
    /// What clients may take.
    pub(crate) bounds: Bounds,
    /// Turns true when the server stops: watches end.
    pub(crate) stopping: watch::Receiver<bool>,
    /// Whether the REST door shows the metrics.
    pub(crate) shows_metrics: bool,
}

impl Api {
    /// The operations, in the name of who made a request.
    fn caller<T>(&self, request: &Request<T>) -> Result<Caller, Status> {
        identify::context(request.extensions()).and_then(|context| self.service.caller(context)).map_err(status::grpc)
    }
}

/// What clients take that were told nothing: larger answers are streamed.
const ANSWER_BYTES: usize = 4 << 20;

type Answer<T> = Result<Response<T>, Status>;
type Streamed<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// Who sent a request, whichever door it came through.
pub(super) fn peer_of(extensions: &Extensions) -> Peer {
    let of_rest = || extensions.get::<CallContext>().and_then(|context| context.peer.parse().ok());
    let address = extensions.get::<PeerIdentity>().map(|identity| identity.address).or_else(of_rest);
    Peer::at(address.unwrap_or_else(|| SocketAddr::from((Ipv4Addr::UNSPECIFIED, 0))))
}

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
    Err(Error::exhausted(reason::MESSAGE_TOO_LARGE, "", words))
}

/// Serves until the server stops, then finishes what is under way.
pub(crate) async fn serve(api: Api, listener: Listener) {
    let (reporter, health_service) = tonic_health::server::health_reporter();
    let changes = api.service.health().watch();
    let is_ready = changes.borrow().is_ready();
    tell_health(&reporter, is_ready).await;
    tokio::spawn(follow_health(reporter, changes, is_ready, api.stopping.clone()));
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
            <$server>::new(api.clone()).max_decoding_message_size(limit).max_encoding_message_size(ANSWER_BYTES)
        };
    }
    let mut routes = Routes::new(health_service)
        .add_service(limited!(v1::sessions_service_server::SessionsServiceServer<Api>))
        .add_service(limited!(v1::sensors_service_server::SensorsServiceServer<Api>))
        .add_service(limited!(v1::maps_service_server::MapsServiceServer<Api>))
        .add_service(limited!(v1::layers_service_server::LayersServiceServer<Api>))
        .add_service(limited!(v1::scene_service_server::SceneServiceServer<Api>))
        .add_service(limited!(v1::navigation_service_server::NavigationServiceServer<Api>))
        .add_service(limited!(v1::toolbox_kept_clouds_service_server::ToolboxKeptCloudsServiceServer<Api>))
        .add_service(limited!(v1::toolbox_clouds_service_server::ToolboxCloudsServiceServer<Api>))
        .add_service(limited!(v1::toolbox_shapes_service_server::ToolboxShapesServiceServer<Api>))
        .add_service(limited!(v1::toolbox_segmentation_service_server::ToolboxSegmentationServiceServer<Api>))
        .add_service(limited!(v1::toolbox_registration_service_server::ToolboxRegistrationServiceServer<Api>))
        .add_service(limited!(v1::toolbox_depth_service_server::ToolboxDepthServiceServer<Api>))
        .add_service(limited!(v1::toolbox_images_service_server::ToolboxImagesServiceServer<Api>))
        .add_service(limited!(v1::toolbox_pictures_service_server::ToolboxPicturesServiceServer<Api>))
        .add_service(limited!(v1::toolbox_pipelines_service_server::ToolboxPipelinesServiceServer<Api>))
        .add_service(limited!(v1::toolbox_planning_service_server::ToolboxPlanningServiceServer<Api>))
        .add_service(limited!(v1::detectors_service_server::DetectorsServiceServer<Api>))
        .add_service(limited!(v1::operations_service_server::OperationsServiceServer<Api>))
        .add_service(limited!(v1::evaluation_service_server::EvaluationServiceServer<Api>))
        .add_service(limited!(v1::server_service_server::ServerServiceServer<Api>));
    if let (true, Ok(v1), Ok(v1alpha)) = (api.listen.reflection, v1_reflection, v1alpha_reflection) {
        routes = routes.add_service(v1).add_service(v1alpha);
    }
    let gate = api.gate.clone();
    let router = routes.prepare().into_axum_router();
    let router = router.layer(from_fn(move |request, next| gate.clone().admit(Door::Grpc, request, next)));
    let router = router.layer(from_fn(calls::guard)).layer(Observe(observe::Door::Grpc));
    listener.serve(router, calls::framing).await;
}

/// Tells how the server stands for each service of the contract, and for the whole, which has no name.
async fn tell_health(reporter: &HealthReporter, is_ready: bool) {
    let status = if is_ready { ServingStatus::Serving } else { ServingStatus::NotServing };
    for name in health_names() {
        reporter.set_service_status(name, status).await;
    }
}

async fn stopped(stopping: &mut watch::Receiver<bool>) {
    let _ = stopping.wait_for(|s| *s).await;
}

/// Of each service of the contract, and of the whole, which has none.
fn health_names() -> impl Iterator<Item = String> {
    json::pool().services().map(|service| service.full_name().to_owned()).chain([String::new()])
}

/// Tells every change; `told` is what was told last.
async fn follow_health(
    mut reporter: HealthReporter,
    mut changes: watch::Receiver<Readiness>,
    mut told: bool,
    mut stopping: watch::Receiver<bool>,
) {
    loop {
        // What changed before this task began is told, too. Telling the same again would be a change to those who watch.
        let is_ready = changes.borrow_and_update().is_ready();
        if is_ready != told {
            tell_health(&reporter, is_ready).await;
            told = is_ready;
        }
        tokio::select! {
            changed = changes.changed() => if changed.is_err() {
                return;
            },
            // Those who watch would keep their connections open; so their watches end.
            () = stopped(&mut stopping) => {
                for name in health_names() {
                    reporter.clear_service_status(&name).await;
                }
                return;
            }
        }
    }
}
