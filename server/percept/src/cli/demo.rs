//! `percept demo`: a robot's day without a robot: simulator, server, map, objects, scene graph, path.

use super::client::{AccessArgs, RemoteSession, connect};
use super::eval_objects::{demo_params, truth_in_map};
use super::replay::FILES;
use super::report::Report;
use super::serve::{Running, Signals, runtime};
use super::{Failure, files, input};
use nalgebra::Point2;
use percept_evaluation::{FoundObject, match_detections};
use percept_geometry::{ObjectClass, Pose, Stamped};
use percept_service::pictures;
use percept_sim::Simulation;
use percept_wire::{convert, json, v1};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub(crate) struct DemoArgs {
    /// World and noise; the same seed gives the same day.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Rooms of the world, 1 to 256.
    #[arg(long, default_value_t = 4)]
    rooms: usize,
    /// Folder for pictures and results.
    #[arg(long, default_value = "demo-out")]
    out: PathBuf,
    /// Address of the page to look at afterwards.
    #[arg(long, default_value = "127.0.0.1:8080")]
    rest: String,
    /// Go on serving afterwards, until Ctrl-C (default: if this is a terminal).
    #[arg(long, conflicts_with = "exit")]
    keep: bool,
    /// Exit afterwards.
    #[arg(long)]
    exit: bool,
    /// Threads for computing; 0 takes all cores.
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

pub(crate) fn run(args: DemoArgs) -> Result<(), Failure> {
    crate::telemetry::init("warn", crate::config::LogFormat::Text);
    runtime()?.block_on(demo(&args))
}

async fn demo(args: &DemoArgs) -> Result<(), Failure> {
    let simulation = Simulation::new(demo_params(args.seed, args.rooms))?;
    files::make_folder(&args.out)?;
    let data = tempfile::tempdir()?;
    let mut running = start_server(args, data.path()).await?;
    let grpc = running.addresses.grpc.clone();
    println!(
        "A simulated robot drives {:.0} s through {} rooms (seed {});",
        simulation.duration_s(),
        args.rooms,
        args.seed
    );
    println!("its camera, laser and wheels stream into percept at {grpc}.");
    let outcome = day(args, &simulation, &grpc).await;
    if outcome.is_ok() {
        let wants_more = args.keep || (!args.exit && std::io::stdout().is_terminal());
        if wants_more {
            println!("\nOpen http://{} to look around. Ctrl-C ends it.", running.addresses.rest);
            running.until_stopped(&mut Signals::listen()?).await?;
        } else {
            println!("\nRun it in a terminal, or with --keep, to look around at http://{}.", running.addresses.rest);
        }
    }
    let stopped = running.stop().await;
    outcome.and(stopped)
}

/// A server of its own on a data directory of its own; a REST port that is taken is replaced by a free one.
async fn start_server(args: &DemoArgs, data_dir: &Path) -> Result<Running, Failure> {
    let mut config = crate::config::Config::default();
    config.storage.data_dir = data_dir.to_path_buf();
    config.compute.threads = args.threads;
    config.listen.grpc = "127.0.0.1:0".to_owned();
    config.listen.zenoh = String::new();
    config.listen.rest = match tokio::net::TcpListener::bind(&args.rest).await {
        Ok(_) => args.rest.clone(),
        Err(_) => "127.0.0.1:0".to_owned(),
    };
    Running::start(&config).await
}

async fn day(args: &DemoArgs, simulation: &Simulation, grpc: &str) -> Result<(), Failure> {
    let channel = connect(grpc, &AccessArgs::default()).await?;
    let session = RemoteSession::create(channel, "demo", "demo robot", &simulation.sensors(), None).await?;
    let frames = simulation.frames();
    let bar = super::progress(frames.total(), "driving");
    let source = frames.map(|f| Ok::<_, Failure>(f.frame));
    let outcome = session.stream(input::read_ahead_async(source), |_| bar.inc(1)).await?;
    bar.finish_and_clear();
    println!(
        "\n{:>10}  {} sensor messages, {} of them durable on disk",
        "streamed", outcome.acknowledged, outcome.durable
    );
    let trajectory: Vec<Stamped<Pose>> = session.trajectory().await?.into_iter().map(|p| p.t_map_base).collect();
    tell_trajectory(simulation, &trajectory);
    let objects = tell_objects(simulation, &session, trajectory.last()).await?;
    tell_graph(&session, &args.out).await?;
    let path = tell_path(&session, &trajectory).await?;
    write_pictures(&args.out, &session, &trajectory, &objects, &path).await?;
    println!(
        "{:>10}  {}: overview.png (map, trajectory, objects, path), cloud.png (top view), map.yaml, cloud.ply, ...",
        "written",
        args.out.display()
    );
    Ok(())
}

fn tell_trajectory(simulation: &Simulation, trajectory: &[Stamped<Pose>]) {
    // Truth at the very stamps of the estimate.
    let truth: Vec<_> =
        trajectory.iter().map(|p| Stamped { stamp: p.stamp, value: simulation.pose_at(p.stamp) }).collect();
    let mut report = Report::default();
    report.judge(Some(&truth), trajectory, true);
    println!(
        "{:>10}  {} poses over {:.1} m, off by {:.3} m (RMS against the truth)",
        "localised",
        trajectory.len(),
        report.path_length_m.unwrap_or(0.0),
        report.ate_rmse_m.unwrap_or(f64::NAN)
    );
}

async fn tell_objects(
    simulation: &Simulation,
    session: &RemoteSession,
    last: Option<&Stamped<Pose>>,
) -> Result<Vec<v1::Object>, Failure> {
    let mut scene = v1::scene_service_client::SceneServiceClient::new(session.channel.clone());
    let request = v1::ListObjectsRequest { session_id: session.id.clone(), page_size: 1000, ..Default::default() };
    let objects = scene.list_objects(request).await?.into_inner().objects;
    let truth = truth_in_map(simulation, last.map(|p| p.stamp).unwrap_or_default());
    let boxes = objects.iter().map(|o| {
        let bbox = convert::geometry::oriented_box("box", &o.r#box.unwrap_or_default())?;
        Ok::<FoundObject, percept_service::Error>((convert::scene::class(o.object_class)?, o.confidence, bbox))
    });
    let found: Vec<FoundObject> = boxes.collect::<Result<_, _>>()?;
    let score = match_detections(&truth, &found, 0.25)?;
    let mut counts: Vec<String> = Vec::new();
    for class in ObjectClass::BUILT_IN {
        let n = found.iter().filter(|f| f.0 == class).count();
        if n > 0 {
            counts.push(format!("{n} {}", class.name()));
        }
    }
    println!("{:>10}  {} objects: {}", "found", found.len(), counts.join(", "));
    println!("{:>10}  {} of {} true objects matched at 3D IoU 0.25", "", score.true_positives, truth.len());
    Ok(objects)
}

async fn tell_graph(session: &RemoteSession, out: &Path) -> Result<(), Failure> {
    let graph = session.scene_graph(None).await?;
    let label = |id: &str| graph.nodes.iter().find(|n| n.node_id == id).map_or(id.to_owned(), |n| n.label.clone());
    let rooms: Vec<&v1::Room> = graph.nodes.iter().filter_map(|n| n.room.as_ref()).collect();
    let sizes: Vec<String> = rooms.iter().map(|r| format!("{:.0} m2", r.area_m2)).collect();
    let is_door = |r: &&v1::Relation| r.kind() == v1::RelationKind::ConnectedTo;
    let doors = graph.relations.iter().filter(is_door).count();
    println!("{:>10}  {} rooms ({}), {doors} pairs joined by doors", "divided", rooms.len(), sizes.join(", "));
    println!("{:>10}  {} nodes, {} relations, among them:", "related", graph.nodes.len(), graph.relations.len());
    let says_little = [v1::RelationKind::InRoom, v1::RelationKind::Near, v1::RelationKind::ConnectedTo];
    let mut telling: Vec<&v1::Relation> = graph.relations.iter().filter(|r| !says_little.contains(&r.kind())).collect();
    telling.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    for r in telling.iter().take(3) {
        let kind = r.kind().as_str_name().trim_start_matches("RELATION_KIND_").to_lowercase().replace('_', " ");
        println!("{:>10}    {} is {kind} {}", "", label(&r.subject_id), label(&r.object_id));
    }
    let with_a_table = v1::RelationFilter {
        kinds: vec![v1::RelationKind::InRoom.into()],
        subject_class: v1::ObjectClass::Table.into(),
        ..Default::default()
    };
    let answer = session.scene_graph(Some(with_a_table)).await?;
    let mut found: Vec<&str> = answer.nodes.iter().filter(|n| n.room.is_some()).map(|n| n.label.as_str()).collect();
    found.sort_unstable();
    let said = if found.is_empty() { "none".to_owned() } else { found.join(", ") };
    println!("{:>10}  which rooms have a table? {said}", "asked");
    let text = serde_json::to_vec_pretty(&json::to_json("SceneGraph", &graph)?)?;
    files::write(&out.join("scene_graph.json"), text)?;
    Ok(())
}

/// Plans to the place on the drive that lies furthest from where the robot is now.
async fn tell_path(session: &RemoteSession, trajectory: &[Stamped<Pose>]) -> Result<Vec<Point2<f64>>, Failure> {
    let at = |p: &Stamped<Pose>| Point2::from(p.value.translation.vector.xy());
    let Some(here) = trajectory.last().map(at) else { return Ok(vec![]) };
    let far = trajectory.iter().map(at).max_by(|a, b| (a - here).norm().total_cmp(&(b - here).norm())).unwrap_or(here);
    let mut navigation = v1::navigation_service_client::NavigationServiceClient::new(session.channel.clone());
    let source = v1::map_source::Source::SessionId(session.id.clone());
    let request = v1::PlanPathRequest {
        source: Some(v1::MapSource { source: Some(source) }),
        goal: Some(v1::Vector2 { x: far.x, y: far.y }),
        ..Default::default()
    };
    let plan = navigation.plan_path(request).await?.into_inner();
    match plan.outcome {
        Some(v1::plan_path_response::Outcome::Path(path)) => {
            let clearance = path.min_clearance_m.unwrap_or(f64::INFINITY);
            println!(
                "{:>10}  to ({:.1}, {:.1}): {:.1} m, never nearer than {clearance:.2} m to anything",
                "planned", far.x, far.y, path.length_m
            );
            Ok(path.waypoints.iter().map(|w| Point2::new(w.x_m, w.y_m)).collect())
        }
        Some(v1::plan_path_response::Outcome::NoPath(none)) => {
            println!("{:>10}  to ({:.1}, {:.1}): {}", "no path", far.x, far.y, none.detail);
            Ok(vec![])
        }
        None => Err("the server answered without an outcome".into()),
    }
}

async fn write_pictures(
    out: &Path,
    session: &RemoteSession,
    trajectory: &[Stamped<Pose>],
    objects: &[v1::Object],
    path: &[Point2<f64>],
) -> Result<(), Failure> {
    for (name, _, format) in FILES.iter().filter(|(name, ..)| *name != "overview.png") {
        files::write(&out.join(name), session.export(*format).await?)?;
    }
    let listed = v1::ListObjectsResponse { objects: objects.to_vec(), ..Default::default() };
    files::write(
        &out.join("objects.json"),
        serde_json::to_vec_pretty(&json::to_json("ListObjectsResponse", &listed)?)?,
    )?;
    // The same picture as the server's, with the path in it.
    let grid = percept_formats::nav2::read(&out.join("map.yaml"), &percept_formats::Limits::default())?;
    let boxes = objects.iter().map(|o| {
        let bbox = convert::geometry::oriented_box("box", &o.r#box.unwrap_or_default())?;
        let class = convert::scene::class(o.object_class)?;
        Ok::<_, percept_service::Error>(percept_pictures::MapObject { id: Some(o.object_id), class, bbox })
    });
    let scene = percept_pictures::Overlay {
        trajectory: trajectory.iter().map(|p| p.value).collect(),
        objects: boxes.collect::<Result<_, _>>()?,
        path: path.to_vec(),
        rooms: rooms(session).await?,
        ..Default::default()
    };
    files::write(&out.join("overview.png"), pictures::overview(&grid, &scene, "demo")?)?;
    Ok(())
}

/// Rooms to be drawn.
async fn rooms(session: &RemoteSession) -> Result<Vec<percept_pictures::MapRoom>, Failure> {
    let found = session.rooms().await?;
    let point = |p: &Option<v1::Vector2>| p.as_ref().map_or_else(Point2::origin, |p| Point2::new(p.x, p.y));
    let jambs = |d: &v1::Door| {
        let half = nalgebra::Vector2::new(d.angle_rad.cos(), d.angle_rad.sin()) * (0.5 * d.width_m);
        [point(&d.center) - half, point(&d.center) + half]
    };
    let room = |r: &v1::Room| percept_pictures::MapRoom {
        label: [&r.name, &r.likely_use].into_iter().find(|w| !w.is_empty()).cloned().unwrap_or_default(),
        center: point(&r.center),
        outline: r.outline.iter().map(|p| Point2::new(p.x, p.y)).collect(),
        doors: found.doors.iter().filter(|d| d.room_id_1 == r.room_id).map(jambs).collect(),
    };
    Ok(found.rooms.iter().map(room).collect())
}
