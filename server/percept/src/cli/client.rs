//! The tools as clients of a running server: create a session, stream frames, read results.

use super::Failure;
use percept_geometry::{Pose, SensorFrame, SensorId, SensorSpec, Stamped, Timestamp};
use percept_service::{OverloadPolicy, SensorDeclaration};
use percept_wire::convert::{geometry, sensors};
use percept_wire::parts::InParts;
use percept_wire::v1;
use percept_wire::v1::sensors_service_client::SensorsServiceClient;
use percept_wire::v1::sessions_service_client::SessionsServiceClient;
use std::collections::BTreeMap;
use std::net::IpAddr;
use std::path::PathBuf;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};
use tonic::{Request, Response, Status};

/// Messages under way to the server.
const WINDOW: usize = 8;

/// How a tool says who it is.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct TokenArgs {
    /// Key or token to call the server with.
    #[arg(long, env = "PERCEPT_TOKEN", hide_env_values = true, conflicts_with = "token_file")]
    token: Option<String>,
    /// File that holds it, so that it does not show among the processes.
    #[arg(long, env = "PERCEPT_TOKEN_FILE")]
    token_file: Option<PathBuf>,
}

impl TokenArgs {
    fn read(&self) -> Result<Bearer, Failure> {
        let token = match (&self.token, &self.token_file) {
            (Some(token), _) => Some(token.clone()),
            (None, Some(file)) => {
                Some(std::fs::read_to_string(file).map_err(|e| format!("cannot read {}: {e}", file.display()))?)
            }
            (None, None) => None,
        };
        let Some(token) = token.map(|t| t.trim().to_owned()).filter(|t| !t.is_empty()) else { return Ok(Bearer(None)) };
        let mut value: MetadataValue<Ascii> =
            format!("Bearer {token}").parse().map_err(|_| "the token has characters that no token has")?;
        value.set_sensitive(true);
        Ok(Bearer(Some(value)))
    }
}

/// Puts the token on every call.
#[derive(Clone)]
pub(crate) struct Bearer(Option<MetadataValue<Ascii>>);

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(value) = &self.0 {
            request.metadata_mut().insert("authorization", value.clone());
        }
        Ok(request)
    }
}

/// Calls go through it.
pub(crate) type Connection = InterceptedService<Channel, Bearer>;

/// How a client of a server that speaks TLS knows it, and is known by it.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct TlsArgs {
    /// Authorities of the server's certificate, PEM; without it those of the system.
    #[arg(long, env = "PERCEPT_CA_FILE")]
    ca_file: Option<PathBuf>,
    /// Certificate to show to the server, PEM.
    #[arg(long, requires = "key")]
    cert: Option<PathBuf>,
    /// Its private key, PEM.
    #[arg(long, requires = "cert")]
    key: Option<PathBuf>,
}

impl TlsArgs {
    fn config(&self) -> Result<ClientTlsConfig, Failure> {
        let read = |path: &PathBuf| {
            std::fs::read(path).map_err(|e| Failure::from(format!("cannot read {}: {e}", path.display())))
        };
        let config = match &self.ca_file {
            Some(file) => ClientTlsConfig::new().ca_certificate(Certificate::from_pem(read(file)?)),
            None => ClientTlsConfig::new().with_native_roots(),
        };
        Ok(match (&self.cert, &self.key) {
            (Some(cert), Some(key)) => config.identity(Identity::from_pem(read(cert)?, read(key)?)),
            _ => config,
        })
    }
}

/// How a tool is let in.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct AccessArgs {
    #[command(flatten)]
    token: TokenArgs,
    #[command(flatten)]
    tls: TlsArgs,
    /// Send the token without encryption to another machine all the same, over a network that is trusted.
    #[arg(long)]
    allow_insecure_token: bool,
}

/// Connects to `http://HOST:PORT` or, with TLS, `https://HOST:PORT`; the scheme may be left out, and is https where
/// certificates are given.
pub(crate) async fn connect(server: &str, access: &AccessArgs) -> Result<Connection, Failure> {
    let (bearer, tls) = (access.token.read()?, &access.tls);
    let has_certificates = tls.ca_file.is_some() || tls.cert.is_some();
    let scheme = if has_certificates { "https" } else { "http" };
    let address = if server.contains("://") { server.to_owned() } else { format!("{scheme}://{server}") };
    let is_encrypted = address.starts_with("https://");
    if !is_encrypted && has_certificates {
        return Err(format!("server is {server}, which is not encrypted; write https:// to use certificates").into());
    }
    let mut endpoint = Endpoint::from_shared(address)?;
    let host = endpoint.uri().host().unwrap_or_default().trim_start_matches('[').trim_end_matches(']');
    let is_near = host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback());
    if bearer.0.is_some() && !(is_encrypted || is_near || access.allow_insecure_token) {
        let words = format!(
            "the token would travel readably to {server}; write https://, or --allow-insecure-token if the network is trusted"
        );
        return Err(words.into());
    }
    if is_encrypted {
        endpoint = endpoint.tls_config(tls.config()?)?;
    }
    let endpoint =
        endpoint.initial_stream_window_size(16 << 20).initial_connection_window_size(32 << 20).tcp_nodelay(true);
    let channel = endpoint.connect().await.map_err(|e| {
        let causes = super::with_causes(&e);
        let remedy = remedy(&causes, is_encrypted);
        format!("cannot reach {server}: {causes}; {remedy}")
    })?;
    Ok(InterceptedService::new(channel, bearer))
}

/// What to do, by the words in which rustls says what went wrong: its errors come wrapped, and have no type here.
fn remedy(causes: &str, is_encrypted: bool) -> &'static str {
    match causes {
        _ if !is_encrypted => "is `percept serve` running there, and is it without TLS, or else write https://?",
        _ if causes.contains("InvalidContentType") => {
            "that port does not speak TLS: write http://, and give no certificates, or set tls.cert_file of the server"
        }
        _ if causes.contains("UnknownIssuer") => "name the file with the authority of its certificate by --ca-file",
        _ if causes.contains("CertificateRequired") => "show a certificate by --cert and --key",
        _ => "is `percept serve` running there?",
    }
}

/// The words for a connection that broke under a call; none for any other error. A server that speaks TLS breaks one that
/// comes without at the first call, not before.
pub(crate) fn lost(error: &(dyn std::error::Error + Send + Sync + 'static)) -> Option<String> {
    let transport = error.downcast_ref::<Status>().and_then(|status| std::error::Error::source(status))?;
    transport.downcast_ref::<tonic::transport::Error>()?;
    Some(format!(
        "the connection to the server broke: {}; is it still running, is that its gRPC port (listen.grpc, 50051 as a rule) and \
         not its REST port, and where it speaks TLS, is its address written with https://?",
        super::with_causes(transport)
    ))
}

/// What the server said of what it refused, which names field and remedy; none of other failures.
pub(crate) fn refused(error: &(dyn std::error::Error + Send + Sync + 'static)) -> Option<String> {
    let status = error.downcast_ref::<Status>()?;
    let is_said = std::error::Error::source(status).is_none() && !status.message().is_empty();
    is_said.then(|| status.message().to_owned())
}

/// What a server answered; of what it refused its own words, which name field and remedy.
pub(crate) fn answered<T>(answer: Result<Response<T>, Status>) -> Result<T, Failure> {
    answer.map(Response::into_inner).map_err(|status| refused(&status).map_or_else(|| status.into(), Failure::from))
}

/// A session on a server.
pub(crate) struct RemoteSession {
    pub(crate) channel: Connection,
    pub(crate) id: String,
}

/// A pose of a session's trajectory.
pub(crate) struct RemotePose {
    pub(crate) t_map_base: Stamped<Pose>,
    pub(crate) tracked: bool,
    /// Whether lengths are metres.
    pub(crate) is_metric: bool,
}

/// What became of streamed frames.
#[derive(Debug, Default)]
pub(crate) struct StreamOutcome {
    pub(crate) acknowledged: u64,
    pub(crate) rejections: Vec<v1::ErrorInfo>,
    pub(crate) durable: u64,
}

fn declaration(spec: &SensorSpec) -> v1::SensorSpec {
    sensors::declaration_to(&SensorDeclaration { spec: spec.clone(), overload: OverloadPolicy::Block })
}

impl RemoteSession {
    /// Creates a session with these sensors; `id` empty: the server chooses one.
    pub(crate) async fn create(
        channel: Connection,
        id: &str,
        name: &str,
        specs: &[SensorSpec],
        params: Option<v1::PipelineParams>,
    ) -> Result<Self, Failure> {
        let request = v1::CreateSessionRequest {
            params,
            session_id: (!id.is_empty()).then(|| id.to_owned()),
            display_name: name.to_owned(),
            mode: v1::SessionMode::Mapping.into(),
            sensors: specs.iter().map(declaration).collect(),
            ..v1::CreateSessionRequest::default()
        };
        let created = SessionsServiceClient::new(channel.clone()).create_session(request).await?.into_inner();
        let id = created.session.ok_or("the server answered without a session")?.session_id;
        Ok(Self { channel, id })
    }

    /// Joins a session that exists, and declares the sensors that it lacks; those of the same name stay as they are.
    pub(crate) async fn join(channel: Connection, id: &str, specs: &[SensorSpec]) -> Result<Self, Failure> {
        let mut client = SensorsServiceClient::new(channel.clone());
        let request = v1::ListSensorsRequest { session_id: id.to_owned() };
        let known = client.list_sensors(request).await?.into_inner().sensors;
        for wanted in specs.iter().map(declaration) {
            let same = known.iter().filter_map(|s| s.spec.as_ref()).find(|s| s.sensor_id == wanted.sensor_id);
            match same {
                Some(same) if same.kind == wanted.kind => {}
                Some(same) => {
                    let (id, is, sent) = (&same.sensor_id, same.kind().as_str_name(), wanted.kind().as_str_name());
                    return Err(
                        format!("the session's sensor {id} is a {is}, and what is to be sent is a {sent}").into()
                    );
                }
                None => {
                    let request = v1::DeclareSensorRequest { session_id: id.to_owned(), spec: Some(wanted) };
                    client.declare_sensor(request).await?;
                }
            }
        }
        Ok(Self { channel, id: id.to_owned() })
    }

    /// Its map, in requests.
    pub(crate) fn source(&self) -> v1::MapSource {
        v1::MapSource { source: Some(v1::map_source::Source::SessionId(self.id.clone())) }
    }

    /// Streams frames in, acknowledged one by one; `frames` ends the stream by ending.
    pub(crate) async fn stream(
        &self,
        mut frames: mpsc::Receiver<SensorFrame>,
        mut on_ack: impl FnMut(&v1::FrameAck),
    ) -> Result<StreamOutcome, Failure> {
        let (out, requests) = mpsc::channel(WINDOW);
        let session = self.id.clone();
        let send = async move {
            let mut numbers: BTreeMap<SensorId, u64> = BTreeMap::new();
            while let Some(frame) = frames.recv().await {
                let number = numbers.entry(frame.sensor.clone()).or_default();
                *number += 1;
                let message = Some(sensors::frame_to(&session, *number, &frame));
                if out.send(v1::StreamFramesRequest { message }).await.is_err() {
                    return;
                }
            }
        };
        let mut client = SensorsServiceClient::new(self.channel.clone());
        let receive = async {
            let mut acks = client.stream_frames(ReceiverStream::new(requests)).await?.into_inner();
            let mut outcome = StreamOutcome::default();
            while let Some(answer) = acks.message().await? {
                let Some(ack) = answer.ack else { continue };
                outcome.durable = ack.durable_count;
                if let Some(v1::frame_ack::Outcome::Rejection(e)) = &ack.outcome {
                    outcome.rejections.push(e.clone());
                }
                if ack.outcome.is_some() {
                    outcome.acknowledged += 1;
                    on_ack(&ack);
                }
            }
            Ok::<_, Failure>(outcome)
        };
        let ((), outcome) = tokio::join!(send, receive);
        outcome
    }

    /// The trajectory.
    pub(crate) async fn trajectory(&self) -> Result<Vec<RemotePose>, Failure> {
        let request = v1::GetTrajectoryRequest { session_id: self.id.clone(), ..Default::default() };
        let mut client = SessionsServiceClient::new(self.channel.clone());
        let mut parts = client.get_trajectory(request).await?.into_inner();
        let mut out = Vec::new();
        while let Some(part) = parts.message().await? {
            for p in part.poses {
                let value = geometry::pose("t_map_base", p.t_map_base.as_ref())?;
                let tracked = p.state() == v1::TrackingState::Tracking;
                let is_metric = p.scale() == v1::Scale::Metric;
                out.push(RemotePose {
                    t_map_base: Stamped { stamp: Timestamp(p.stamp_ns), value },
                    tracked,
                    is_metric,
                });
            }
        }
        Ok(out)
    }

    /// Makes the small corrections that wait for more.
    pub(crate) async fn optimise(&self) -> Result<(), Failure> {
        let mut client = v1::maps_service_client::MapsServiceClient::new(self.channel.clone());
        let source = v1::map_source::Source::SessionId(self.id.clone());
        let source = Some(v1::MapSource { source: Some(source) });
        client.optimise_map(v1::OptimiseMapRequest { source }).await?;
        Ok(())
    }

    /// Loops that hold the map together.
    pub(crate) async fn num_active_loops(&self) -> Result<usize, Failure> {
        let mut client = v1::maps_service_client::MapsServiceClient::new(self.channel.clone());
        let (mut count, mut page_token) = (0, String::new());
        loop {
            let request = v1::ListLoopsRequest { source: Some(self.source()), page_size: 1000, page_token };
            let page = client.list_loops(request).await?.into_inner();
            count += page.loops.iter().filter(|l| l.state() == v1::LoopState::Active).count();
            if page.next_page_token.is_empty() {
                return Ok(count);
            }
            page_token = page.next_page_token;
        }
    }

    /// Robot, objects and their relations.
    pub(crate) async fn scene_graph(&self, filter: Option<v1::RelationFilter>) -> Result<v1::SceneGraph, Failure> {
        let mut client = v1::scene_service_client::SceneServiceClient::new(self.channel.clone());
        let request = v1::GetSceneGraphRequest { session_id: self.id.clone(), filter, ..Default::default() };
        let mut parts = client.get_scene_graph(request).await?.into_inner();
        let mut all = Vec::new();
        while let Some(part) = parts.message().await? {
            all.push(part);
        }
        Ok(v1::GetSceneGraphResponse::joined(all).graph.unwrap_or_default())
    }

    /// Rooms of the session's map, and the doors between them.
    pub(crate) async fn rooms(&self) -> Result<v1::GetRoomsResponse, Failure> {
        let mut client = v1::scene_service_client::SceneServiceClient::new(self.channel.clone());
        let request = v1::GetRoomsRequest { session_id: self.id.clone(), with_places: false };
        let mut parts = client.get_rooms(request).await?.into_inner();
        let mut all = Vec::new();
        while let Some(part) = parts.message().await? {
            all.push(part);
        }
        Ok(v1::GetRoomsResponse::joined(all))
    }

    /// A file of the session's map.
    pub(crate) async fn export(&self, format: v1::MapFormat) -> Result<Vec<u8>, Failure> {
        let source = v1::map_source::Source::SessionId(self.id.clone());
        let source = Some(v1::MapSource { source: Some(source) });
        let request = v1::ExportMapRequest { source, format: format.into(), max_error_m: None };
        let mut client = v1::maps_service_client::MapsServiceClient::new(self.channel.clone());
        let mut parts = client.export_map(request).await?.into_inner();
        let mut out = Vec::new();
        while let Some(part) = parts.message().await? {
            out.extend_from_slice(&part.chunk.unwrap_or_default().data);
        }
        Ok(out)
    }
}
