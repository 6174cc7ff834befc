//! Loops in a building drawn by walls, scanned by casting rays.

use super::*;
use crate::loops::lost;
use crate::matching::branch_and_bound::{self, Pyramid};
use nalgebra::{Point3, Vector2};
use percept_geometry::{PointCloud, Timestamp};

/// Walls from end to end, metres.
#[derive(Default)]
struct Building(Vec<(Point2<f64>, Point2<f64>)>);

impl Building {
    fn walls(mut self, walls: &[[f64; 4]]) -> Self {
        self.0.extend(walls.iter().map(|w| (Point2::new(w[0], w[1]), Point2::new(w[2], w[3]))));
        self
    }

    fn cuboid(self, x: f64, y: f64, width: f64, height: f64) -> Self {
        let (r, t) = (x + width, y + height);
        self.walls(&[[x, y, r, y], [r, y, r, t], [r, t, x, t], [x, t, x, y]])
    }

    /// 24 x 14 m around a core, with rooms and furniture of which no two are alike.
    fn office() -> Self {
        Self::default()
            .cuboid(0.0, 0.0, 24.0, 14.0)
            .cuboid(6.0, 4.0, 11.0, 5.5)
            .walls(&[[0.0, 9.5, 3.2, 9.5], [4.4, 9.5, 6.0, 9.5], [17.0, 4.0, 20.5, 4.0], [22.0, 4.0, 24.0, 4.0]])
            .walls(&[[9.0, 12.0, 9.0, 14.0], [14.0, 0.0, 14.0, 1.6], [10.5, 0.0, 10.5, 1.1]])
            .cuboid(1.0, 10.8, 1.4, 0.7)
            .cuboid(11.0, 12.9, 2.2, 0.6)
            .cuboid(19.0, 12.2, 0.8, 1.1)
            .cuboid(22.3, 7.0, 0.9, 1.9)
            .cuboid(0.3, 2.0, 0.6, 1.3)
            .cuboid(4.2, 0.2, 1.7, 0.5)
            .cuboid(21.0, 0.6, 1.2, 0.8)
    }

    fn range(&self, origin: &Point2<f64>, direction: &Vector2<f64>) -> f64 {
        let hit = |(a, b): &(Point2<f64>, Point2<f64>)| {
            let along = b - a;
            let cross = direction.perp(&along);
            let (t, s) = ((a - origin).perp(&along) / cross, (a - origin).perp(direction) / cross);
            (t > 0.0 && (0.0..=1.0).contains(&s)).then_some(t)
        };
        self.0.iter().filter_map(hit).fold(f64::INFINITY, f64::min)
    }

    /// 270 degrees, ranges up to 12 m with a centimetre of noise.
    fn scan(&self, t_world_base: &Isometry2<f64>, noise: &mut Noise) -> Arc<KeyframeScan> {
        let (mut hits, mut misses) = (vec![], vec![]);
        for i in 0..361 {
            let angle = -2.356 + f64::from(i) * 0.01309;
            let direction = Vector2::new(angle.cos(), angle.sin());
            let r = self.range(&t_world_base.translation.vector.into(), &(t_world_base.rotation * direction));
            let end = |r: f64| Point3::new(direction.x * r, direction.y * r, 0.0).cast();
            match r < 12.0 {
                true => hits.push(end(r + 0.01 * noise.next())),
                false => misses.push(end(10.0)),
            }
        }
        Arc::new(KeyframeScan {
            // Another one for every scan.
            stamp: Timestamp((noise.0 >> 1) as i64),
            sensor: "laser".into(),
            t_base_sensor: Pose::identity(),
            base_height_m: 0.0,
            hits: PointCloud::from_positions(hits),
            misses,
            planar: true,
            features: None,
        })
    }
}

/// Standard normal numbers, the same every time (sum of twelve uniform ones from a linear congruence).
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn next(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Poses every half metre along straight lines between corners, looking ahead.
fn route(corners: &[[f64; 2]]) -> Vec<Isometry2<f64>> {
    let leg = |w: &[[f64; 2]]| {
        let (a, b) = (Vector2::from(w[0]), Vector2::from(w[1]));
        let way = b - a;
        let steps = (way.norm() / 0.5).ceil() as usize;
        (0..steps).map(move |k| Isometry2::new(a + way * (k as f64 / steps as f64), way.y.atan2(way.x))).collect()
    };
    corners.windows(2).flat_map(|w| -> Vec<_> { leg(w) }).collect()
}

/// A robot that drives and believes to be where its odometry says.
struct Drive {
    places: PlanarPlaces,
    poses: KeyframePoses,
    truth: Vec<Isometry2<f64>>,
    drift: Covariance6,
    noise: Noise,
}

impl Drive {
    fn new(seed: u64) -> Self {
        Self {
            places: PlanarPlaces::new(25.0),
            poses: KeyframePoses::new(),
            truth: vec![],
            drift: Covariance6::identity() * 1e-4,
            noise: Noise(seed),
        }
    }

    /// One keyframe at each pose; odometry is off by `error` (right perturbation) at every step.
    fn along(&mut self, building: &Building, route: &[Isometry2<f64>], error: &Isometry2<f64>) -> Vec<LoopClosure> {
        let mut found = vec![];
        for t in route {
            let believed = match (self.truth.last(), self.poses.last_key_value()) {
                (Some(before), Some((_, last))) => last * spatial(&(before.inverse() * t * error)),
                _ => spatial(t),
            };
            let id = KeyframeId(self.truth.len() as u64);
            self.truth.push(*t);
            self.poses.insert(id, believed);
            let scan = building.scan(t, &mut self.noise);
            found.extend(self.places.insert(id, &scan.into(), &self.drift, &self.poses));
        }
        found
    }

    /// How far a closure is off, metres and radians.
    fn error(&self, c: &LoopClosure) -> (f64, f64) {
        let truth = self.truth[c.from.0 as usize].inverse() * self.truth[c.to.0 as usize];
        let off = truth.inverse() * planar(&c.t_from_to);
        (off.translation.vector.norm(), off.rotation.angle().abs())
    }

    /// Asks with views from a way, the last of them the newest.
    fn relocalise_views(
        &mut self,
        way: &[Isometry2<f64>],
        mut views: Vec<Arc<KeyframeScan>>,
    ) -> Option<crate::loops::Relocalisation> {
        let scan = views.pop()?;
        let from_now = way.last()?.inverse();
        let before: Vec<_> = way.iter().zip(views).map(|(t, view)| (spatial(&(from_now * t)), view)).collect();
        let mut found = self.places.relocalise_driven(&before, &scan, &self.poses);
        while found.is_none() && self.places.is_unfinished() {
            found = self.places.relocalise_driven(&before, &scan, &self.poses);
        }
        found
    }

    fn relocalise_driven(
        &mut self,
        building: &Building,
        way: &[Isometry2<f64>],
    ) -> Option<crate::loops::Relocalisation> {
        let views = way.iter().map(|t| building.scan(t, &mut self.noise)).collect();
        self.relocalise_views(way, views)
    }
}

const ROUND: [[f64; 2]; 5] = [[3.0, 2.0], [19.0, 2.5], [19.5, 11.0], [4.0, 11.0], [3.0, 2.0]];

#[test]
fn a_round_through_the_office_closes_with_a_centimetre() {
    let mut drive = Drive::new(1);
    let (office, slip) = (Building::office(), Isometry2::new(Vector2::new(0.003, 0.002), 0.001));
    let found = drive.along(&office, &route(&[&ROUND[..], &ROUND[1..3]].concat()), &slip);
    let believed = planar(&drive.poses[&KeyframeId(drive.truth.len() as u64 - 1)]);
    let drifted = drive.truth.last().unwrap().inverse() * believed;
    assert!(drifted.translation.vector.norm() > 0.8, "{drifted}");
    let far = found.iter().filter(|c| c.to.0 - c.from.0 > 60);
    // No back end moves the poses here: loops are looked for where odometry believes to be.
    assert!(far.count() >= 4, "{}", found.len());
    for c in &found {
        let (metres, radians) = drive.error(c);
        // The local map is gathered by the drifting poses: 4 m to each side of a millimetre per step.
        assert!(metres < 0.06 && radians < 0.02, "{c:?}: {metres} {radians}");
    }
}

#[test]
fn in_a_corridor_without_features_nothing_is_tied_along_it() {
    let corridor = Building::default().walls(&[[-100.0, -1.0, 100.0, -1.0], [-100.0, 1.0, 100.0, 1.0]]);
    let mut drive = Drive::new(2);
    let slip = Isometry2::translation(0.01, 0.0);
    let found = drive.along(&corridor, &route(&[[0.0, 0.0], [25.0, 0.0], [0.0, 0.0]]), &slip);
    assert!(found.is_empty(), "{found:?}");
}

#[test]
fn what_lies_beyond_the_range_that_was_set_closes_no_loops() {
    // The ends of the corridor tell where one is in it, and are never nearer than 6 m.
    let corridor = Building::default().cuboid(-8.0, -1.0, 16.0, 2.0);
    let way = route(&[[-2.0, 0.0], [2.0, 0.0], [-2.0, 0.0], [2.0, 0.0], [-2.0, 0.0], [2.0, 0.0]]);
    let found = |max_range_m| {
        let mut drive = Drive { places: PlanarPlaces::new(max_range_m), ..Drive::new(8) };
        drive.along(&corridor, &way, &Isometry2::translation(0.005, 0.0)).len()
    };
    assert!(found(25.0) > 5, "{}", found(25.0));
    assert_eq!(found(4.0), 0);
}

#[test]
fn rooms_that_look_alike_are_not_joined() {
    // Two rooms with the same furniture, 7 m apart, both seen before.
    let room =
        |b: Building, x: f64| b.cuboid(x, 0.0, 5.0, 6.0).cuboid(x + 0.5, 4.5, 1.2, 0.7).cuboid(x + 3.8, 1.0, 0.6, 1.5);
    let building = room(room(Building::default(), 0.0), 7.0);
    let mut drive = Drive::new(3);
    let still = Isometry2::identity();
    let tour = |x: f64| route(&[[x + 1.5, 1.0], [x + 1.5, 3.5], [x + 3.0, 4.5], [x + 3.0, 1.0], [x + 1.5, 1.0]]);
    drive.along(&building, &tour(0.0), &still);
    drive.along(&building, &tour(7.0), &still);
    // Far away, then back in one of them, believed to be in between.
    drive.along(&building, &route(&[[60.0, 60.0], [80.0, 60.0]]), &still);
    drive.drift = Covariance6::identity() * 4.0;
    drive.along(&building, &tour(7.0)[..1], &Isometry2::translation(-3.5, 0.0));
    drive.drift = Covariance6::identity() * 9.0;
    let found = drive.along(&building, &tour(7.0), &still);
    let wrong = found.iter().filter(|c| drive.error(c).0 > 0.1).count();
    assert_eq!(wrong, 0, "{found:?}");
    let scan = building.scan(&tour(0.0)[3], &mut drive.noise);
    assert_eq!(drive.places.relocalise(&scan, &drive.poses), None);
    assert_eq!(drive.relocalise_driven(&building, &tour(0.0)), None);
}

#[test]
fn a_place_that_was_missed_for_long_is_looked_for_where_drift_leads_first() {
    // Two rooms with the same furniture, 12 m apart, both seen before.
    let room =
        |b: Building, x: f64| b.cuboid(x, 0.0, 5.0, 6.0).cuboid(x + 0.5, 4.5, 1.2, 0.7).cuboid(x + 3.8, 1.0, 0.6, 1.5);
    let building = room(room(Building::default(), 0.0), 12.0);
    let mut drive = Drive::new(3);
    let still = Isometry2::identity();
    let tour = |x: f64| route(&[[x + 1.5, 1.0], [x + 1.5, 3.5], [x + 3.0, 4.5], [x + 3.0, 1.0], [x + 1.5, 1.0]]);
    drive.along(&building, &tour(0.0), &still);
    drive.along(&building, &tour(12.0), &still);
    drive.along(&building, &route(&[[60.0, 60.0], [80.0, 60.0]]), &still);
    // Back in the first, 1.4 m off, having driven past known places without a tie for so long that anything is thought possible.
    drive.places.missed_m = 300.0;
    drive.along(&building, &tour(0.0)[..1], &Isometry2::translation(1.0, 1.0));
    let found = drive.along(&building, &tour(0.0), &still);
    assert!(!found.is_empty() && found.iter().all(|c| drive.error(c).0 < 0.1), "{found:?}");
}

#[test]
fn where_the_newest_view_leaves_something_open_those_before_tell_the_place() {
    // A corridor that is bare but for a few metres with alcoves and pillars, seen by a lidar that reaches 4 m.
    let alcove = |b: Building, x: f64, side: f64, width: f64, depth: f64| {
        let (edge, back, end) = (side, side * (1.0 + depth), x + width);
        b.walls(&[[x, edge, x, back], [x, back, end, back], [end, back, end, edge]])
    };
    let left = [[-5.0, 1.0, 10.0, 1.0], [10.7, 1.0, 12.5, 1.0], [13.9, 1.0, 14.6, 1.0], [15.1, 1.0, 45.0, 1.0]];
    let right = [[-5.0, -1.0, 11.2, -1.0], [13.1, -1.0, 45.0, -1.0]];
    let corridor = Building::default().walls(&left).walls(&right).cuboid(14.1, -0.9, 0.3, 0.4);
    let corridor = alcove(alcove(corridor, 10.0, 1.0, 0.7, 1.0), 12.5, 1.0, 1.4, 1.6);
    let corridor = alcove(alcove(corridor, 14.6, 1.0, 0.5, 0.6), 11.2, -1.0, 1.9, 1.2);
    let mut drive = Drive { places: PlanarPlaces::new(4.0), ..Drive::new(5) };
    let still = Isometry2::identity();
    drive.along(&corridor, &route(&[[0.0, 0.0], [40.0, 0.0]]), &still);
    drive.along(&Building::default(), &route(&[[60.0, 60.0], [80.0, 60.0]]), &still);
    // Back, a metre off, and not searched for before all that can be seen is bare again.
    drive.drift = Covariance6::identity() * 4.0;
    drive.places.searched_m = f64::INFINITY;
    drive.along(&corridor, &route(&[[10.0, 0.0], [10.5, 0.0]]), &Isometry2::translation(1.0, 0.0));
    assert_eq!(drive.along(&corridor, &route(&[[10.5, 0.0], [17.5, 0.0]]), &still), []);
    drive.places.searched_m = 0.0;
    let found = drive.along(&corridor, &route(&[[17.5, 0.0], [20.0, 0.0]]), &still);
    assert!(!found.is_empty() && found.iter().all(|c| drive.error(c).0 < 0.1), "{found:?}");
}

#[test]
fn a_kidnapped_robot_is_found_where_it_has_been_and_nowhere_else() {
    let mut drive = Drive::new(4);
    let office = Building::office();
    drive.along(&office, &route(&ROUND), &Isometry2::identity());
    let mut num_found = 0;
    for k in 0..8 {
        let at = &drive.truth[(k * 13 + 4) % drive.truth.len()];
        let aside = Isometry2::new(Vector2::new(0.3, -0.2), drive.noise.uniform() - 0.5);
        let t_world_base = at * aside;
        let scan = office.scan(&t_world_base, &mut drive.noise);
        let Some(found) = drive.places.relocalise(&scan, &drive.poses) else { continue };
        num_found += 1;
        let t = planar(&(drive.poses[&found.keyframe] * found.t_keyframe_base));
        let off = t.inverse() * t_world_base;
        assert!(off.translation.vector.norm() < 0.04 && off.rotation.angle().abs() < 0.015, "{off}");
    }
    assert!(num_found >= 6, "{num_found} of 8");
    // Other rooms, of the same style.
    let elsewhere = Building::default()
        .cuboid(0.0, 0.0, 9.0, 7.0)
        .cuboid(2.0, 2.5, 1.5, 0.8)
        .cuboid(7.9, 5.0, 0.7, 1.4)
        .walls(&[[5.0, 7.0, 5.0, 5.2], [5.0, 4.2, 5.0, 3.0]]);
    for k in 0..8 {
        let at = Isometry2::new(Vector2::new(1.0 + 0.4 * f64::from(k), 1.2), 0.8 * f64::from(k));
        let scan = elsewhere.scan(&at, &mut drive.noise);
        assert_eq!(drive.places.relocalise(&scan, &drive.poses), None, "{k}");
    }
}

#[test]
fn a_robot_that_drives_since_it_was_lost_is_found_by_the_way_and_not_before() {
    let mut drive = Drive::new(6);
    let office = Building::office();
    drive.along(&office, &route(&ROUND), &Isometry2::identity());
    let way: Vec<_> = drive.truth[12..20].iter().map(|t| t * Isometry2::new(Vector2::new(0.2, 0.1), 0.1)).collect();
    assert_eq!(drive.relocalise_driven(&office, &way[..2]), None);
    let found = drive.relocalise_driven(&office, &way).unwrap();
    let off = (drive.poses[&found.keyframe] * found.t_keyframe_base).inverse() * spatial(way.last().unwrap());
    assert!(off.translation.vector.norm() < 0.04, "{off}");
    // The same way, but its beginning was seen elsewhere.
    let elsewhere = Building::default().cuboid(0.0, 0.0, 9.0, 7.0).cuboid(2.0, 2.5, 1.5, 0.8);
    let mut views: Vec<_> = way.iter().map(|t| office.scan(t, &mut drive.noise)).collect();
    for (k, view) in views.iter_mut().take(4).enumerate() {
        *view = elsewhere.scan(&Isometry2::new(Vector2::new(1.0 + 0.4 * k as f64, 1.2), 0.8), &mut drive.noise);
    }
    assert_eq!(drive.relocalise_views(&way, views), None);
}

#[test]
fn a_keyframe_that_left_is_not_answered_with() {
    let mut drive = Drive::new(5);
    let office = Building::office();
    drive.along(&office, &route(&ROUND), &Isometry2::identity());
    (0..20).for_each(|k| drive.places.forget(KeyframeId(k)));
    let found = drive.along(&office, &route(&ROUND[..3]), &Isometry2::identity());
    assert!(!found.is_empty() && found.iter().all(|c| c.from.0 >= 20));
}

#[test]
fn a_robot_that_circles_in_one_room_is_found_in_it() {
    // The room of 6 x 4 m has four pieces of furniture; nothing else says which way round it is.
    let room = Building::default()
        .cuboid(-3.0, -2.0, 6.0, 4.0)
        .cuboid(1.2, 0.6, 0.8, 0.8)
        .cuboid(2.0, -1.6, 0.5, 0.9)
        .cuboid(-2.4, -1.5, 0.8, 0.5)
        .cuboid(0.6, -1.7, 0.4, 0.5);
    let step = Isometry2::new(Vector2::new(0.48, 0.0), 0.42);
    let circle = |first: usize, n: usize| -> Vec<Isometry2<f64>> {
        let on = std::iter::successors(Some(Isometry2::translation(-0.8, -1.1)), |t| Some(t * step));
        on.skip(first).take(n).collect()
    };
    let mut drive = Drive::new(7);
    drive.along(&room, &circle(0, 30), &Isometry2::identity());
    let mut num_found = 0;
    for k in 0..8 {
        let way = circle(3 * k, 8);
        let Some(found) = drive.relocalise_driven(&room, &way) else { continue };
        num_found += 1;
        let off = (drive.poses[&found.keyframe] * found.t_keyframe_base).inverse() * spatial(way.last().unwrap());
        assert!(off.translation.vector.norm() < 0.04, "{off}");
    }
    assert!(num_found >= 6, "{num_found} of 8");
}

#[test]
fn a_place_is_found_in_a_map_as_large_as_a_building() {
    // One corner to be recognised, and walls without end in one direction 150 m away.
    let corner = |i: i32| {
        let along = 0.05 * f64::from(i);
        [Point2::new(along, 0.0), Point2::new(0.0, 0.6 * along), Point2::new(5.0 + 0.1 * along, 2.0)]
    };
    let known: Vec<Point2<f64>> = (0..160).flat_map(corner).collect();
    let far = (0..400).map(|i| Point2::new(150.0, 130.0 + 0.05 * f64::from(i)));
    let pyramid = Pyramid::new(lost::CELL_M, &known.iter().copied().chain(far).collect::<Vec<_>>()).unwrap();
    let t_map_query = Isometry2::new(Vector2::new(3.0, 1.5), 2.5);
    let query = spread_out(known.iter().map(|p| t_map_query.inverse() * p));
    let found = pyramid.optima(&query, &pyramid.everywhere(), lost::MIN_SCORE, (branch_and_bound::RIVAL, 1)).unwrap();
    let found = found[0];
    let off = t_map_query.inverse() * found.t;
    assert!(off.translation.vector.norm() < 0.15 && off.rotation.angle().abs() < 0.03, "{off}");
}
