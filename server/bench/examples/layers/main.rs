//! What the map's layers are worth, by the simulator's exact geometry: `layers rooms|moved|terrain [--worlds N] [--first SEED]
//! [--sensor lidar|rgbd] [--set KEY=VALUE]...`.
//!
//! A robot drives through seeded worlds with a 3D lidar of 16 rings or a depth camera, each with the simulator's noise. Keyframes come
//! as often as in the pipeline and keep what they keep there; they enter a [`percept_mapping::Map`] at their true poses, so that all that
//! is told is the map's own error. `--set surface.voxel_size_m=0.03` changes a parameter of the map.
//!
//! - `rooms`: furnished rooms, every layer on, one lap. What is judged, and what counts as seen, is said in `surface.rs`, `occupied.rs`,
//!   `heights.rs` and `distances.rs`.
//! - `moved`: a cabinet stands for one lap and elsewhere from then on: how long it is left at its old place in each layer (`moved.rs`).
//! - `terrain`: ramps, platforms and a pit: where a robot can drive (`terrain.rs`).

mod bodies;
mod distances;
mod drive;
mod figures;
mod heights;
mod moved;
mod occupied;
mod surface;
mod terrain;

use drive::{Keyframe, Sensor, drive, simulation};
use figures::Table;
use percept_geometry::KeyframeId;
use percept_mapping::{Map, MapEntry, MapParams};
use percept_sim::WorldParams;
use std::sync::Arc;

type Failure = Box<dyn std::error::Error + Send + Sync>;

const USAGE: &str =
    "usage: layers rooms|moved|terrain [--worlds N] [--first SEED] [--sensor lidar|rgbd] [--set KEY=VALUE]...";

struct Args {
    part: String,
    worlds: u64,
    first: u64,
    sensors: Vec<Sensor>,
    params: MapParams,
}

fn main() -> Result<(), Failure> {
    let args = arguments()?;
    for sensor in &args.sensors {
        let mut table = Table::default();
        for seed in args.first..args.first + args.worlds {
            let row = match args.part.as_str() {
                "rooms" => rooms(*sensor, seed, &args.params)?,
                "moved" => moved::world(*sensor, seed, &args.params)?,
                "terrain" => terrain::world(*sensor, seed, &args.params)?,
                _ => return Err(USAGE.into()),
            };
            table.add(&format!("{} {seed}", sensor.name()), row);
        }
        table.summary(sensor.name());
    }
    Ok(())
}

fn arguments() -> Result<Args, Failure> {
    let mut given = std::env::args().skip(1);
    let part = given.next().ok_or(USAGE)?;
    let mut params = MapParams::default();
    (params.voxels.enabled, params.height.enabled, params.surface.enabled) = (true, true, true);
    let mut args = Args { part, worlds: 20, first: 1, sensors: vec![Sensor::Lidar, Sensor::Rgbd], params };
    while let Some(name) = given.next() {
        let value = given.next().ok_or(USAGE)?;
        match name.as_str() {
            "--worlds" => args.worlds = value.parse()?,
            "--first" => args.first = value.parse()?,
            "--set" => {
                let (key, value) = value.split_once('=').ok_or("--set: write KEY=VALUE")?;
                let mut tree = serde_json::to_value(args.params)?;
                let slot =
                    tree.pointer_mut(&format!("/{}", key.replace('.', "/"))).ok_or("--set: no such parameter")?;
                *slot = serde_json::from_str(value)?;
                args.params = serde_json::from_value(tree)?;
            }
            "--sensor" => args.sensors.retain(|s| s.name() == value),
            _ => return Err(USAGE.into()),
        }
    }
    Ok(args)
}

/// A lap through two furnished rooms.
fn rooms(sensor: Sensor, seed: u64, params: &MapParams) -> Result<figures::Row, Failure> {
    let simulation = simulation(sensor, seed, 1, WorldParams { rooms: 2, ..WorldParams::default() })?;
    let keyframes = drive(&simulation, sensor);
    let map = filled(params, &keyframes)?;
    let (world, layers) = (simulation.world(), map.layers());
    let beams = drive::beams(world, &keyframes);
    let mut row = vec![("keyframes", keyframes.len() as f64)];
    row.extend(surface::judge(world, &layers.surface, &beams)?);
    row.extend(occupied::judge_grid(world, &layers.occupancy, &beams)?);
    row.extend(occupied::judge_voxels(world, &layers.voxels, &beams)?);
    row.extend(heights::judge(world, &layers.height, &beams)?);
    row.extend(distances::judge(params, &keyframes)?);
    Ok(row)
}

/// The map of these keyframes.
fn filled(params: &MapParams, keyframes: &[Keyframe]) -> Result<Map, Failure> {
    let mut map = Map::new(*params)?;
    for (i, k) in keyframes.iter().enumerate() {
        map.insert(KeyframeId(i as u64), &MapEntry::at(k.t_world_base), Arc::clone(&k.scan))?;
    }
    Ok(map)
}
