//! Streets made of boxes, seen by the beams of a lidar, and what is found in them.

use nalgebra::{Point3, Vector3};
use percept_geometry::{ObjectClass, OrientedBox3, PointCloud};
use percept_perception::detection::Detection;
use percept_perception::detection::outdoor::{OutdoorDetector, OutdoorParams};

/// Height of the sensor above the ground under it, metres.
const SENSOR_M: f64 = 1.73;

/// A street: solid boxes on ground that rises by a share of x.
struct Street {
    solids: Vec<OrientedBox3>,
    slope: f64,
}

impl Street {
    fn new(slope: f64) -> Self {
        Self { solids: vec![], slope }
    }

    /// Adds a box whose foot is `lift` above the ground under its middle.
    fn solid(&mut self, x: f64, y: f64, lift: f64, size: [f64; 3], yaw: f64) {
        let z = self.slope * x - SENSOR_M + lift + 0.5 * size[2];
        self.solids.push(OrientedBox3::upright(Point3::new(x, y, z), size.into(), yaw));
    }

    /// A car of 4.2 x 1.7 x 1.5 m: its body, and a cabin. The box of the whole.
    fn car(&mut self, x: f64, y: f64, yaw: f64) -> OrientedBox3 {
        self.solid(x, y, 0.2, [4.2, 1.7, 0.7], yaw);
        let back = -0.3;
        self.solid(x + back * yaw.cos(), y + back * yaw.sin(), 0.9, [2.4, 1.5, 0.6], yaw);
        let z = self.slope * x - SENSOR_M + 0.75;
        OrientedBox3::upright(Point3::new(x, y, z), Vector3::new(4.2, 1.7, 1.5), yaw)
    }

    /// Someone 1.75 m tall in mid-step: legs, trunk, head.
    fn person(&mut self, x: f64, y: f64) {
        self.solid(x - 0.15, y, 0.0, [0.2, 0.2, 0.8], 0.0);
        self.solid(x + 0.15, y, 0.0, [0.2, 0.2, 0.8], 0.0);
        self.solid(x, y, 0.8, [0.28, 0.5, 0.7], 0.0);
        self.solid(x, y, 1.5, [0.2, 0.2, 0.25], 0.0);
    }

    /// What 64 rings from -24.8 to 2 degrees see, 0.18 degrees from beam to beam.
    fn scan(&self) -> PointCloud {
        let mut points = Vec::new();
        for ring in 0..64 {
            let (down, up) = (2.0 - 26.8 * f64::from(ring) / 63.0).to_radians().sin_cos();
            for beam in 0..2000 {
                let (sin, cos) = (0.18 * f64::from(beam)).to_radians().sin_cos();
                let direction = Vector3::new(cos * up, sin * up, down);
                let fall = self.slope * direction.x - direction.z;
                let mut range = if fall > 0.0 { SENSOR_M / fall } else { f64::INFINITY };
                self.solids.iter().filter_map(|b| meets(b, &direction)).for_each(|r| range = range.min(r));
                if range < 80.0 {
                    // Two centimetres of noise, the same every time.
                    let noise = 0.02 * (f64::from(ring * 2000 + beam) * 12.9898).sin();
                    points.push(Point3::from((direction * (range + noise)).cast::<f32>()));
                }
            }
        }
        PointCloud::from_positions(points)
    }
}

/// Where a beam from the origin enters a box.
fn meets(b: &OrientedBox3, direction: &Vector3<f64>) -> Option<f64> {
    let origin = b.t_frame_box.inverse_transform_point(&Point3::origin());
    let direction = b.t_frame_box.inverse_transform_vector(direction);
    let (mut near, mut far) = (0.0f64, f64::INFINITY);
    for axis in 0..3 {
        let half = 0.5 * b.size[axis];
        let ends = [-half, half].map(|end| (end - origin[axis]) / direction[axis]);
        (near, far) = (near.max(ends[0].min(ends[1])), far.min(ends[0].max(ends[1])));
    }
    (near > 0.0 && near <= far).then_some(near)
}

fn detect(scan: &PointCloud) -> Vec<Detection> {
    OutdoorDetector::new(OutdoorParams::default()).unwrap().detect(scan).unwrap()
}

fn is_vehicle(d: &&Detection) -> bool {
    matches!(d.class, ObjectClass::Car | ObjectClass::Van)
}

#[test]
fn parked_cars_are_found_one_by_one_and_whole() {
    let mut street = Street::new(0.0);
    // Two bumper to bumper along the road, one across it farther on, one behind.
    let cars = [
        street.car(9.0, 4.0, 0.0),
        street.car(14.0, 4.0, 0.0),
        street.car(22.0, -5.0, 1.4),
        street.car(-12.0, -3.5, 3.1),
    ];
    let found = detect(&street.scan());
    assert_eq!(found.iter().filter(is_vehicle).count(), cars.len(), "{found:#?}");
    for car in &cars {
        let best = found.iter().filter(is_vehicle).map(|d| d.bbox.iou_upright(car)).fold(0.0, f64::max);
        assert!(best > 0.5, "{best} at {:?}", car.center());
    }
}

#[test]
fn a_car_on_a_hill_stands_on_it() {
    let mut street = Street::new(0.06);
    let car = street.car(12.0, 4.0, 0.2);
    let found = detect(&street.scan());
    let overlap = |d: &&Detection| d.bbox.iou_upright(&car);
    let best = found.iter().max_by(|a, b| overlap(a).total_cmp(&overlap(b))).unwrap();
    assert!(overlap(&best) > 0.3, "{:?}", best.bbox);
    let foot = best.bbox.center().z - 0.5 * best.bbox.size.z;
    assert!((foot - (0.06 * 12.0 - SENSOR_M)).abs() < 0.25, "{foot}");
}

#[test]
fn someone_before_a_wall_is_a_person_and_the_wall_is_no_vehicle() {
    let mut street = Street::new(0.0);
    street.solid(10.0, 8.0, 0.0, [60.0, 0.3, 6.0], 0.0);
    street.person(10.0, 7.0);
    let found = detect(&street.scan());
    let named: Vec<&Detection> = found.iter().filter(|d| d.class != ObjectClass::Unknown).collect();
    assert_eq!(named.len(), 1, "{named:#?}");
    assert_eq!(named[0].class, ObjectClass::Person);
    assert!((named[0].bbox.center().xy() - nalgebra::Point2::new(10.0, 7.0)).norm() < 0.3);
}

#[test]
fn an_empty_street_has_no_road_users() {
    let mut street = Street::new(0.02);
    assert_eq!(detect(&street.scan()), []);
    street.solid(0.0, 12.0, 0.0, [100.0, 1.0, 8.0], 0.0);
    street.solid(0.0, -12.0, 0.0, [100.0, 1.0, 8.0], 0.0);
    let found = detect(&street.scan());
    assert!(found.iter().all(|d| d.class == ObjectClass::Unknown), "{found:#?}");
}

#[test]
fn degenerate_scans_have_no_road_users() {
    let named = |points: Vec<Point3<f32>>| {
        detect(&PointCloud::from_positions(points)).iter().filter(|d| d.class != ObjectClass::Unknown).count()
    };
    assert_eq!(named(vec![]), 0);
    assert_eq!(named(vec![Point3::origin()]), 0);
    assert_eq!(named(vec![Point3::new(5.0, 2.0, 0.0); 1000]), 0);
    assert_eq!(named(vec![Point3::from([f32::NAN; 3]); 100]), 0);
    assert_eq!(named(vec![Point3::new(1e30, -1e30, f32::INFINITY); 100]), 0);
    // One wall and nothing else.
    assert_eq!(
        named((0..100_000).map(|i| Point3::new(10.0, (i % 1000) as f32 * 0.02, (i / 1000) as f32 * 0.02)).collect()),
        0
    );
}

#[test]
fn noise_everywhere_is_answered_twice_the_same() {
    let mut state = 1u64;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u32 << 24) as f32 - 0.5
    };
    let points = (0..300_000).map(|_| Point3::new(160.0 * random(), 160.0 * random(), 8.0 * random())).collect();
    let scan = PointCloud::from_positions(points);
    let found = detect(&scan);
    assert_eq!(found, detect(&scan));
    assert!(found.iter().all(|d| (0.0..=1.0).contains(&d.confidence) && d.bbox.size.iter().all(|s| s.is_finite())));
}

#[test]
fn a_bad_parameter_and_a_channel_that_does_not_fit_are_named() {
    let error = |params| OutdoorDetector::new(params).unwrap_err().to_string();
    assert!(error(OutdoorParams { min_points: 1, ..Default::default() }).starts_with("min_points"));
    assert!(error(OutdoorParams { voxel_size_m: f64::NAN, ..Default::default() }).starts_with("voxel_size_m"));
    let mut params = OutdoorParams::default();
    params.ground.sensor_height_m = -1.0;
    assert!(error(params).starts_with("sensor_height_m"));
    let mut scan = PointCloud::from_positions(vec![Point3::origin(); 3]);
    scan.intensities = Some(vec![0.5; 2]);
    assert!(OutdoorDetector::new(OutdoorParams::default()).unwrap().detect(&scan).is_err());
}
