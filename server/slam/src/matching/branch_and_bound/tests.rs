//! The search against poses that are known, and against trying every pose.

use super::*;

/// An L of walls with a pillar.
fn map() -> Vec<Point2<f64>> {
    let wall = |i: i32| f64::from(i) * 0.05;
    let mut points: Vec<Point2<f64>> = (0..160).map(|i| Point2::new(wall(i), 0.0)).collect();
    points.extend((0..100).map(|i| Point2::new(0.0, wall(i))));
    points.extend((0..8).map(|i| Point2::new(5.0 + wall(i), 2.0)));
    points
}

/// The best pose and its rivals, a tenth of the work at a time.
fn sought(pyramid: &Pyramid, query: &[Point2<f64>], region: &Region, min_score: f64, rival: f64) -> Vec<Fit> {
    let mut search = pyramid.begin(query, region, min_score, (rival, 3));
    let found = (0..1000).find_map(|_| pyramid.go_on(&mut search, &mut (PATIENCE / 100)));
    let Some(Outcome::Found(found)) = found else { panic!("{found:?}") };
    found
}

#[test]
fn points_are_found_wherever_they_are() {
    let t_map_query = Isometry2::new(Vector2::new(3.0, 1.5), 2.5);
    let query: Vec<_> = map().iter().step_by(2).map(|p| t_map_query.inverse() * p).collect();
    let pyramid = Pyramid::new(0.1, &map()).unwrap();
    let found = sought(&pyramid, &query, &pyramid.everywhere(), 0.5, 0.8);
    assert_eq!(found.len(), 1, "{found:?}");
    let off = found[0].t.inverse() * t_map_query;
    assert!(off.translation.vector.norm() < 0.15 && off.rotation.angle().abs() < 0.02, "{off}");
    assert!(f64::from(found[0].sum) > 0.8 * 255.0 * query.len() as f64);
}

#[test]
fn points_are_found_at_the_end_of_a_map_larger_than_the_most_cells() {
    let away = Vector2::new(2000.0, 1000.0);
    let there: Vec<_> = map().iter().map(|p| p + away).collect();
    let pyramid = Pyramid::new(0.1, &[&map()[..50], &there].concat()).unwrap();
    assert!(f64::from(pyramid.levels[0].width) <= MAX_CELLS + 1.0 && pyramid.geometry.resolution_m == 0.4);
    let t_map_query = Isometry2::new(Vector2::new(3.0, 1.5) + away, 2.5);
    let query: Vec<_> = there.iter().step_by(2).map(|p| t_map_query.inverse() * p).collect();
    let region = Region { center: Isometry2::translation(2005.0, 1004.0), translation: 15.0, rotation: 3.0 };
    let off = sought(&pyramid, &query, &region, 0.5, 0.95)[0].t.inverse() * t_map_query;
    assert!(off.translation.vector.norm() < 0.6 && off.rotation.angle().abs() < 0.1, "{off}");
}

#[test]
fn a_search_that_is_left_and_gone_on_with_finds_the_same() {
    let query: Vec<_> = map().iter().step_by(3).map(|p| Isometry2::new(Vector2::new(1.0, -2.0), 1.0) * p).collect();
    let pyramid = Pyramid::new(0.1, &map()).unwrap();
    let region = pyramid.everywhere();
    let mut at_once = pyramid.begin(&query, &region, 0.3, (0.5, 10));
    let Some(Outcome::Found(all)) = pyramid.go_on(&mut at_once, &mut usize::MAX.clone()) else { panic!("not found") };
    let mut in_steps = pyramid.begin(&query, &region, 0.3, (0.5, 10));
    let steps = (1..).find_map(|k| pyramid.go_on(&mut in_steps, &mut 50).map(|found| (k, found)));
    let Some((steps, Outcome::Found(found))) = steps else { panic!("not found") };
    assert!(steps > 10 && all.len() == found.len(), "{steps}");
    assert!(all.iter().zip(&found).all(|(a, b)| a.t == b.t && a.sum == b.sum));
}

#[test]
fn the_search_finds_what_trying_every_pose_finds() {
    let query: Vec<_> = map().iter().step_by(5).map(|p| Isometry2::new(Vector2::new(0.3, -0.2), 0.1) * p).collect();
    let pyramid = Pyramid::new(0.1, &map()).unwrap();
    let region = Region { center: Isometry2::identity(), translation: 0.8, rotation: 0.2 };
    let found = sought(&pyramid, &query, &region, 0.0, 1.0)[0];
    let mut best = 0u32;
    let lever = query.iter().map(|p| p.coords.norm()).fold(1.0, f64::max).min(MAX_LEVER_M);
    let n = (region.rotation * lever / 0.1).ceil() as i32;
    for a in -n..=n {
        let t = Isometry2::rotation(f64::from(a) * region.rotation / f64::from(n));
        let cells: Vec<_> = query.iter().map(|p| pyramid.cell(&(t * p))).collect();
        for (y, x) in (-8..=8).flat_map(|y| (-8..=8).map(move |x| (y, x))) {
            best = best.max(pyramid.sum(&cells, (x, y), 0, 0));
        }
    }
    assert_eq!(found.sum, best);
}
