//! `percept import-map`: a map that comes from elsewhere, into a session of a running server.

use super::client::{AccessArgs, Connection, RemoteSession, answered, connect};
use super::{Failure, input};
use percept_geometry::se3;
use percept_wire::convert::geometry;
use percept_wire::{json, v1};
use std::path::{Path, PathBuf};
use v1::import_map_request::Map;
use v1::maps_service_client::MapsServiceClient;
use v1::sessions_service_client::SessionsServiceClient;
use v1::toolbox_kept_clouds_service_client::ToolboxKeptCloudsServiceClient;

/// Files above this go up in parts, as a cloud that the server keeps meanwhile.
const LARGE_BYTES: usize = 8 << 20;
const PART_BYTES: usize = 1 << 20;

#[derive(Debug, clap::Args)]
pub(crate) struct ImportMapArgs {
    /// The yaml file of a nav2 map with its image beside it; an OctoMap, .bt or .ot; or a cloud, z up: PLY, PCD, LAS, LAZ, XYZ.
    map: PathBuf,
    /// gRPC address of the server.
    #[arg(long, default_value = "http://127.0.0.1:50051")]
    server: String,
    #[command(flatten)]
    access: AccessArgs,
    /// Id of a session that is there and has mapped nothing; its sensors say how the map is seen. None: one is created.
    #[arg(long)]
    session: Option<String>,
    /// Create the session under the id that is given.
    #[arg(long, requires = "session")]
    create: bool,
    /// Where the robot starts, X,Y,YAW, metres and radians, map frame; none: it is looked for.
    #[arg(long, value_parser = input::parse_pose, allow_hyphen_values = true)]
    start: Option<input::FlatPose>,
    /// Height of the sensor above the ground, metres; none: as the session's sensors are declared.
    #[arg(long)]
    sensor_height: Option<f64>,
    /// Edge of the voxels by which points hide each other, metres; none: 0.1.
    #[arg(long)]
    voxel_size: Option<f64>,
    /// Print the answer as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: ImportMapArgs) -> Result<(), Failure> {
    let given = read(&args.map)?;
    super::serve::runtime()?.block_on(into_server(&args, given))
}

/// A map as it was read.
enum Given {
    Whole(Map),
    Cloud(Vec<u8>),
}

fn read(file: &Path) -> Result<Given, Failure> {
    let bytes =
        |path: &Path| std::fs::read(path).map_err(|e| Failure::from(format!("cannot read {}: {e}", path.display())));
    let data = bytes(file)?;
    let suffix = file.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).unwrap_or_default();
    Ok(match suffix.as_str() {
        "yaml" | "yml" => {
            let yaml = percept_formats::nav2::parse_yaml(&data).map_err(|e| e.in_file(file))?;
            let image = bytes(&file.parent().unwrap_or(Path::new("")).join(&yaml.image))?;
            Given::Whole(Map::Nav2(v1::Nav2Map { yaml: data.into(), image: image.into() }))
        }
        "pgm" | "png" => {
            let words = format!("{} is the image of a map; give the yaml file that says how it lies", file.display());
            return Err(words.into());
        }
        "bt" | "ot" => Given::Whole(Map::Octomap(data.into())),
        _ => Given::Cloud(data),
    })
}

async fn into_server(args: &ImportMapArgs, given: Given) -> Result<(), Failure> {
    let channel = connect(&args.server, &args.access).await?;
    let session = match &args.session {
        Some(id) if !args.create => RemoteSession { channel, id: id.clone() },
        id => {
            let name = args.map.file_stem().unwrap_or_default().to_string_lossy();
            RemoteSession::create(channel, id.as_deref().unwrap_or_default(), &name, &[], None).await?
        }
    };
    let (map, kept) = match given {
        Given::Whole(map) => (map, None),
        Given::Cloud(data) => cloud(&session.channel, data).await?,
    };
    let start = args.start.map(|pose| geometry::pose_to(&se3::from_xy_yaw(pose.x_m, pose.y_m, pose.yaw_rad)));
    let request = v1::ImportMapRequest {
        source: Some(session.source()),
        start,
        sensor_height_m: args.sensor_height.unwrap_or_default(),
        voxel_size_m: args.voxel_size.unwrap_or_default(),
        map: Some(map),
    };
    let done = answered(MapsServiceClient::new(session.channel.clone()).import_map(request).await);
    if let Some(handle) = kept {
        // It would be forgotten anyway.
        let _ = ToolboxKeptCloudsServiceClient::new(session.channel.clone())
            .drop_cloud(v1::DropCloudRequest { handle })
            .await;
    }
    if done.is_err() && args.session.is_none() {
        // Nobody asked for a session without a map.
        let request = v1::DeleteSessionRequest { session_id: session.id.clone() };
        let _ = SessionsServiceClient::new(session.channel.clone()).delete_session(request).await;
    }
    let done = done?;
    if args.json {
        let mut answer = json::to_json("ImportMapResponse", &done)?;
        answer["session_id"] = session.id.into();
        println!("{answer}");
        return Ok(());
    }
    let found_by = done.found_by().as_str_name().trim_start_matches("SENSOR_KIND_").to_lowercase();
    println!("{:>10}  {} on {}", "session", session.id, args.server);
    println!("{:>10}  {} views, map version {}", "imported", done.num_keyframes, done.map_version);
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    println!(
        "{:>10}  {} of what is occupied, {} of what is free",
        "they show",
        percent(done.occupied_share),
        percent(done.free_share)
    );
    println!("{:>10}  a {found_by} is found in it", "found by");
    Ok(())
}

/// A cloud as it is, or, if it is large, as one that the server keeps, with its handle.
async fn cloud(channel: &Connection, data: Vec<u8>) -> Result<(Map, Option<String>), Failure> {
    use v1::cloud_source::Source;
    if data.len() <= LARGE_BYTES {
        let file = v1::CloudFile { data: data.into(), ..Default::default() };
        return Ok((Map::Cloud(v1::CloudSource { source: Some(Source::File(file)) }), None));
    }
    let parts: Vec<_> = data
        .chunks(PART_BYTES)
        .map(|part| v1::UploadLargeCloudRequest {
            part: Some(v1::upload_large_cloud_request::Part::Data(part.to_vec().into())),
            ..Default::default()
        })
        .collect();
    let mut client = ToolboxKeptCloudsServiceClient::new(channel.clone());
    let answer = answered(client.upload_large_cloud(tokio_stream::iter(parts)).await)?;
    let handle = answer.kept.ok_or("the server answered without a handle")?.handle;
    Ok((Map::Cloud(v1::CloudSource { source: Some(Source::Handle(handle.clone())) }), Some(handle)))
}
