//! What the newest frames see is in the way at once, and out of it again, though the robot stands and makes no keyframe.

use crate::drive::empty;
use nalgebra::{Point2, Point3, UnitQuaternion, Vector3};
use percept_geometry::{
    CameraIntrinsics, DepthImage, LaserScan, OrientedBox3, PointCloud, Pose, SensorData, SensorFrame, SensorKind,
    SensorSpec, Timestamp, se3,
};
use percept_mapping::{LiveParams, Occupancy};
use percept_pipeline::{Pipeline, PipelineParams, Snapshot};
use percept_scene::{Object, ObjectChange, ObjectChangeKind, ObjectState};
use percept_sim::{MainSensor, Scenario, Simulation};
use std::f64::consts::{PI, TAU};

/// A room of 8 x 6 m around the origin; upright round pillars `(x, y, radius)` stand in it.
pub(crate) struct Room(pub(crate) Vec<(f64, f64, f64)>);

impl Room {
    /// Range along a beam from a point in the room; walls and floor end it. Pillars are 1.7 m high.
    fn range(&self, from: &Point3<f64>, along: &Vector3<f64>) -> f64 {
        let mut range = f64::INFINITY;
        for (axis, wall) in [(0, 4.0), (1, 3.0)] {
            if along[axis].abs() > 1e-9 {
                range = range.min((wall * along[axis].signum() - from[axis]) / along[axis]);
            }
        }
        if along.z < -1e-9 {
            range = range.min(-from.z / along.z);
        }
        for (x, y, radius) in &self.0 {
            let to = from.xy() - Point2::new(*x, *y);
            let (a, b, c) = (along.xy().norm_squared(), along.xy().dot(&to), to.norm_squared() - radius * radius);
            let root = b * b - a * c;
            let at = (-b - root.max(0.0).sqrt()) / a;
            if root > 0.0 && at > 0.0 && from.z + at * along.z < 1.7 {
                range = range.min(at);
            }
        }
        range
    }

    /// 720 beams in a plane 0.3 m up.
    fn planar(&self, base: &Pose) -> SensorData {
        let from = base * Point3::new(0.0, 0.0, 0.3);
        let beam = |i: usize| {
            base * Vector3::new((i as f64 * TAU / 720.0 - PI).cos(), (i as f64 * TAU / 720.0 - PI).sin(), 0.0)
        };
        SensorData::Scan(LaserScan {
            angle_min_rad: -PI,
            angle_increment_rad: TAU / 720.0,
            range_min_m: 0.05,
            range_max_m: 20.0,
            time_increment_s: 0.0,
            ranges_m: (0..720).map(|i| self.range(&from, &beam(i)) as f32).collect(),
            intensities: None,
            later_echoes_m: vec![],
        })
    }

    /// 32 rings of 512 beams, from 25 degrees down to 5 up, 1 m up.
    fn spatial(&self, base: &Pose) -> SensorData {
        let from = base * Point3::new(0.0, 0.0, 1.0);
        let mut ends = vec![];
        for (ring, i) in (0..32).flat_map(|ring| (0..512).map(move |i| (ring, i))) {
            let (up, turn) = ((-25.0 + 30.0 * f64::from(ring) / 31.0).to_radians(), f64::from(i) * TAU / 512.0);
            let along = Vector3::new(up.cos() * turn.cos(), up.cos() * turn.sin(), up.sin());
            ends.push((along * self.range(&from, &(base * along))).cast().into());
        }
        SensorData::Cloud(PointCloud::from_positions(ends))
    }

    /// Of [`camera`].
    fn depth(&self, base: &Pose) -> SensorData {
        let (camera, t) = (camera(), base * spec(SensorKind::Depth).t_base_sensor);
        let from = t.translation.vector.into();
        let depth = |i: usize| {
            let (u, v) = ((i % camera.width) as f64, (i / camera.width) as f64);
            let along = Vector3::new((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0);
            // Unit depth, so that the range along it is the depth.
            self.range(&from, &(t * along)) as f32
        };
        let data = (0..camera.width * camera.height).map(depth).collect();
        SensorData::Depth(DepthImage::new(camera.width, camera.height, data).unwrap())
    }
}

/// Of a depth camera 0.6 m up that looks ahead.
fn camera() -> CameraIntrinsics {
    CameraIntrinsics::pinhole(160, 120, 130.0, 130.0, 79.5, 59.5)
}

fn spec(kind: SensorKind) -> SensorSpec {
    let (height, rotation, intrinsics) = match kind {
        SensorKind::Lidar2d => (0.3, UnitQuaternion::identity(), None),
        SensorKind::Depth => (0.6, SensorSpec::optical_rotation(), Some(camera())),
        _ => (1.0, UnitQuaternion::identity(), None),
    };
    SensorSpec {
        id: "lidar".into(),
        kind,
        t_base_sensor: Pose::from_parts(Vector3::new(0.0, 0.0, height).into(), rotation),
        intrinsics,
        time_offset_s: 0.0,
        range_max_m: None,
    }
}

pub(crate) struct Robot {
    pipeline: Pipeline,
    kind: SensorKind,
    /// Tenths of a second.
    now: i64,
}

impl Robot {
    pub(crate) fn new(kind: SensorKind, params: PipelineParams) -> Self {
        let mut pipeline = Pipeline::new(params).unwrap();
        pipeline.declare_sensor(spec(kind));
        Self { pipeline, kind, now: 0 }
    }

    /// A tenth of a second later.
    pub(crate) fn sees(&mut self, room: &Room, x: f64) {
        let base = se3::from_xy_yaw(x, 0.0, 0.0);
        let data = match self.kind {
            SensorKind::Lidar2d => room.planar(&base),
            SensorKind::Depth => room.depth(&base),
            _ => room.spatial(&base),
        };
        self.now += 1;
        let stamp = Timestamp(self.now * 100_000_000);
        self.pipeline.process(&SensorFrame { sensor: "lidar".into(), stamp, data }).unwrap();
    }

    /// Is here for so many tenths of a second.
    pub(crate) fn stands(&mut self, room: &Room, tenths: usize) -> Snapshot {
        (0..tenths).for_each(|_| self.sees(room, 0.0));
        self.pipeline.snapshot()
    }
}

/// Probabilities of the map and of now, at a place as seen from where the robot began.
pub(crate) fn at(snapshot: &Snapshot, x: f64, y: f64) -> (f64, f64) {
    let read = |grid: &dyn Occupancy| {
        let cell = grid.geometry().cell(&Point2::new(x, y)).unwrap();
        grid.probability(cell).unwrap_or(0.5)
    };
    (read(&snapshot.layers.occupancy), read(&snapshot.grid_now()))
}

#[test]
fn who_steps_before_a_robot_that_stands_is_in_the_way_and_who_leaves_is_not() {
    for kind in [SensorKind::Lidar2d, SensorKind::Lidar3d] {
        let mut robot = Robot::new(kind, PipelineParams::default());
        let (empty, occupied) = (Room(vec![]), Room(vec![(2.0, 0.0, 0.25)]));
        let before = robot.stands(&empty, 10);
        let keyframes = before.keyframes.len();
        // The near side of the pillar.
        let place = (1.78, 0.03);
        assert!(at(&before, place.0, place.1).1 < 0.5, "{kind:?}");
        let first = robot.stands(&occupied, 1);
        assert!(at(&first, place.0, place.1).1 > 0.5, "{kind:?}: seen by the first frame");
        let there = robot.stands(&occupied, 25);
        let (map, now) = at(&there, place.0, place.1);
        assert_eq!(there.keyframes.len(), keyframes, "{kind:?}: who stays no longer makes no keyframe");
        assert!(map < 0.5 && now > 0.5, "{kind:?}: {map} {now}");
        let gone = robot.stands(&empty, 1);
        assert!(at(&gone, place.0, place.1).1 < 0.5, "{kind:?}: {:?}", at(&gone, place.0, place.1));
        // The same picture gives the same, however often it is asked.
        assert_eq!(there.grid_now(), there.grid_now());
    }
}

#[test]
fn what_the_map_has_learned_of_and_has_gone_is_out_of_the_way_within_a_second() {
    for kind in [SensorKind::Lidar2d, SensorKind::Lidar3d] {
        let mut robot = Robot::new(kind, PipelineParams::default());
        let (empty, occupied) = (Room(vec![]), Room(vec![(1.5, 1.5, 0.4)]));
        // To and fro, so that keyframes make it as sure as can be.
        for i in 0..400 {
            robot.sees(&occupied, (1.0 - (f64::from(i) * 0.05).cos()) * -0.75);
        }
        robot.stands(&occupied, 5);
        // The side that it sees.
        let place = (1.17, 1.28);
        let sure = robot.pipeline.snapshot();
        assert!(at(&sure, place.0, place.1).0 > 0.9, "{kind:?}: {:?}", at(&sure, place.0, place.1));
        let gone = robot.stands(&empty, 10);
        let (map, now) = at(&gone, place.0, place.1);
        assert!(map > 0.5 && now < 0.5, "{kind:?}: {map} {now}: the map learns it more slowly");
        // Walls stand.
        assert!(at(&gone, 1.5, 3.02).1 > 0.5, "{kind:?}");
    }
}

#[test]
fn what_was_seen_too_long_ago_does_not_count_nor_anything_where_it_is_not_wanted() {
    let (empty, occupied) = (Room(vec![]), Room(vec![(2.0, 0.0, 0.25)]));
    let off = PipelineParams { live: LiveParams { time_s: 0.0, ..LiveParams::default() }, ..PipelineParams::default() };
    let mut robot = Robot::new(SensorKind::Lidar2d, off);
    robot.stands(&empty, 10);
    let blind = robot.stands(&occupied, 10);
    assert_eq!(blind.grid_now(), blind.layers.occupancy);
    assert_eq!(blind.live.stamp(), None);

    let mut robot = Robot::new(SensorKind::Lidar2d, PipelineParams::default());
    robot.stands(&empty, 10);
    robot.stands(&occupied, 20);
    // It is hidden from then on by one who stands before it: what is behind is not looked at.
    let hidden = Room(vec![(2.0, 0.0, 0.25), (1.0, 0.0, 0.3)]);
    let soon = robot.stands(&hidden, 5);
    assert!(at(&soon, 1.78, 0.03).1 > 0.5);
    let later = robot.stands(&hidden, 40);
    assert!(at(&later, 1.78, 0.03).1 < 0.5);
    assert!(at(&later, 0.73, 0.03).1 > 0.5);
}

#[test]
fn who_walks_through_a_room_leaves_nothing_in_the_cloud() {
    let mut robot = Robot::new(SensorKind::Lidar3d, PipelineParams::default());
    let still = (3.0, -2.0, 0.4);
    // The robot drives at 0.4 m/s, the person crosses before it at 1 m/s, from wall to wall.
    for i in 0..90 {
        let y = -2.5 + 0.1 * f64::from((i - 20).clamp(0, 50));
        robot.sees(&Room(vec![still, (2.2, y, 0.25)]), -2.0 + 0.04 * f64::from(i));
    }
    let snapshot = robot.pipeline.snapshot();
    let cloud = snapshot.layers.cloud.to_cloud();
    // The map begins where the robot did. Where the person began and ended, something stands or stood.
    let beside = |x: f64, y: f64, radius: f64| {
        let near = |p: &&Point3<f32>| {
            let (dx, dy) = (f64::from(p.x) - 2.0 - x, f64::from(p.y) - y);
            p.z > 0.3 && dx * dx + dy * dy < radius * radius
        };
        cloud.positions.iter().filter(near).count()
    };
    let on_the_way: usize = (0..8).map(|k| beside(2.2, -1.6 + 0.4 * f64::from(k), 0.3)).sum();
    // 113 if nothing that moves were taken out.
    assert!(on_the_way < 12, "{on_the_way} points are left of the walk");
    assert!(beside(3.0, -2.0, 0.5) > 50, "what stands is there");
}

#[test]
fn walls_keep_their_thickness_though_a_frame_sees_them_in_the_next_cell() {
    for kind in [SensorKind::Lidar2d, SensorKind::Lidar3d] {
        let mut robot = Robot::new(kind, PipelineParams::default());
        let room = Room(vec![]);
        // The wall at x = 4 lies on the border of two cells.
        for i in 0..60 {
            robot.sees(&room, -0.7 * (f64::from(i) * 0.1).sin());
        }
        let snapshot = robot.stands(&room, 30);
        for y in [-1.95, -0.45, 0.05, 1.55] {
            for x in [3.95, 4.05] {
                let (map, now) = at(&snapshot, x, y);
                assert!(map <= 0.5 || now > 0.5, "{kind:?} at {x}, {y}: {map} {now}");
            }
        }
    }
}

/// Whether something is told to stand at a place, as seen from where the robot began.
fn stands_at(snapshot: &Snapshot, x: f64, y: f64) -> bool {
    let is_there = |o: &Object| (o.bbox.center().xy() - Point2::new(x, y)).norm() < 0.4;
    snapshot.objects.iter().any(|o| o.state != ObjectState::Gone && is_there(o))
}

#[test]
fn what_is_taken_away_before_a_robot_that_stands_is_gone_within_three_seconds() {
    let mut robot = Robot::new(SensorKind::Lidar3d, PipelineParams::default());
    let thing = (2.5, 0.2, 0.4);
    let (empty, occupied) = (Room(vec![]), Room(vec![thing]));
    for i in 0..200 {
        robot.sees(&occupied, (1.0 - (f64::from(i) * 0.05).cos()) * -0.75);
    }
    let there = robot.stands(&occupied, 50);
    assert!(stands_at(&there, 2.5, 0.2), "{:?}", there.objects);
    // Whoever steps before it hides it.
    let hidden = robot.stands(&Room(vec![thing, (1.2, 0.1, 0.4)]), 50);
    assert!(stands_at(&hidden, 2.5, 0.2));
    let gone = robot.stands(&empty, 30);
    assert!(!stands_at(&gone, 2.5, 0.2));
    // Nor is what the map still has of it taken for a thing when the robot sets off.
    for i in 0..100 {
        robot.sees(&empty, (1.0 - (f64::from(i) * 0.05).cos()) * -0.75);
        assert!(!stands_at(&robot.pipeline.snapshot(), 2.5, 0.2), "{i}");
    }
}

#[test]
fn nothing_that_stands_is_told_as_gone() {
    // Shelves are open in front and chairs below: beams go through the middle of both.
    let params = Scenario::Loops.params(MainSensor::Lidar3d, 4, 26.0, 1).unwrap();
    let home = Simulation::new(params).unwrap();
    let t_map_world = home.t_world_start().inverse();
    let stands: Vec<OrientedBox3> =
        home.objects_at(Timestamp::default()).iter().map(|o| o.bbox.transformed(&t_map_world)).collect();
    let mut pipeline = empty(&home, PipelineParams::default());
    let (mut gone, mut appeared) = (vec![], 0);
    for frame in home.frames() {
        let changes = pipeline.process(&frame.frame).unwrap().map.objects;
        appeared += changes.iter().filter(|c| c.kind == ObjectChangeKind::Appeared).count();
        let objects = pipeline.snapshot().objects;
        let of = |c: &ObjectChange| objects.iter().find(|o| o.id == c.id).filter(|_| c.kind == ObjectChangeKind::Gone);
        // Well seen, not a piece of something at the edge of what is looked at.
        let is_there = |o: &&Object| stands.iter().any(|s| s.iou_upright(&o.bbox) > 0.5);
        gone.extend(
            changes.iter().filter_map(of).filter(is_there).map(|o| (frame.measured_s, o.class, o.bbox.center())),
        );
    }
    assert!(appeared > 8, "{appeared}");
    assert!(gone.is_empty(), "{gone:?}");
}
