//! Relations: motions that somebody checked, against those of a trajectory. No common frame, no alignment.

use crate::{ErrorStatistics, EvaluationError, Trajectory, positive};
use percept_geometry::{Pose, Timestamp};

/// Relations over more than this are counted as loops, too, seconds.
const LOOP_S: f64 = 60.0;

/// A motion that was checked by hand.
#[derive(Debug, Clone, PartialEq)]
pub struct TrueRelation {
    /// First time; may be the later one.
    pub stamp_1: Timestamp,
    /// Second time.
    pub stamp_2: Timestamp,
    /// The body at the second time, seen from the first.
    pub t_1_2: Pose,
}

/// How well a trajectory agrees with relations.
#[derive(Debug, Clone, PartialEq)]
pub struct RelationScore {
    /// Length of the translation by which the motions differ, metres.
    pub translation_m: ErrorStatistics,
    /// Angle by which they differ, degrees.
    pub rotation_deg: ErrorStatistics,
    /// Relations that the trajectory has no pose for: a method must not gain by leaving out what is hard.
    pub num_missed: usize,
    /// The same two errors of the relations over more than a minute; `None` if there is none.
    pub loops: Option<(ErrorStatistics, ErrorStatistics)>,
}

/// Errors of `trajectory` over `relations`. A pose between two of the trajectory's is interpolated if those are at
/// most `max_gap_s` apart; relations with a stamp in a wider gap or outside are missed.
///
/// Source: Kuemmerle, Steder, Dornhege, Ruhnke, Grisetti, Stachniss, Kleiner, "On measuring the accuracy of SLAM
/// algorithms", 2009, eq. 3, with absolute instead of squared errors as in its tables; the deviations are those
/// about the mean.
///
/// # Errors
/// `InvalidParam` for a gap that is not positive, `NoRelations` if none can be judged.
pub fn score_relations(
    trajectory: &Trajectory,
    relations: &[TrueRelation],
    max_gap_s: f64,
) -> Result<RelationScore, EvaluationError> {
    positive("max_gap_s", max_gap_s)?;
    let judged = |r: &TrueRelation| -> Option<(f64, f64, bool)> {
        let t_map_1 = trajectory.at_within(r.stamp_1, max_gap_s)?;
        let t_map_2 = trajectory.at_within(r.stamp_2, max_gap_s)?;
        let error = r.t_1_2.inverse() * (t_map_1.inverse() * t_map_2);
        let is_loop = r.stamp_2.seconds_since(r.stamp_1).abs() > LOOP_S;
        Some((error.translation.vector.norm(), error.rotation.angle().to_degrees(), is_loop))
    };
    let errors: Vec<(f64, f64, bool)> = relations.iter().filter_map(judged).collect();
    let of = |only_loops: bool| {
        let chosen = || errors.iter().filter(|e| e.2 || !only_loops);
        let translation = ErrorStatistics::of(&chosen().map(|e| e.0).collect::<Vec<_>>())?;
        Some((translation, ErrorStatistics::of(&chosen().map(|e| e.1).collect::<Vec<_>>())?))
    };
    let none = EvaluationError::NoRelations { num_relations: relations.len(), max_gap_s };
    let (translation_m, rotation_deg) = of(false).ok_or(none)?;
    Ok(RelationScore { translation_m, rotation_deg, num_missed: relations.len() - errors.len(), loops: of(true) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::{Stamped, se3};

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(s)
    }

    /// One metre a second along x, turning a tenth of a radian a second, poses at these seconds.
    fn drive(seconds: &[f64]) -> Trajectory {
        let pose = |&s: &f64| Stamped { stamp: at(s), value: se3::from_xy_yaw(s, 0.0, 0.1 * s) };
        Trajectory::new(seconds.iter().map(pose).collect()).unwrap()
    }

    fn truth(s1: f64, s2: f64, along_m: f64, turn: f64) -> TrueRelation {
        let t_1_2 = se3::from_xy_yaw(s1, 0.0, 0.1 * s1).inverse() * se3::from_xy_yaw(s2, 0.0, 0.1 * s2);
        TrueRelation { stamp_1: at(s1), stamp_2: at(s2), t_1_2: t_1_2 * se3::from_xy_yaw(along_m, 0.0, turn) }
    }

    #[test]
    fn errors_are_those_put_in_forwards_and_backwards() {
        let relations = [truth(0.0, 3.0, 0.1, 0.0), truth(3.0, 1.0, 0.0, 0.02), truth(1.0, 70.0, 0.2, 0.01)];
        let score = score_relations(&drive(&[0.0, 1.0, 2.0, 3.0, 70.0]), &relations, 2.0).unwrap();
        assert!((score.translation_m.mean - 0.1).abs() < 1e-9 && (score.translation_m.max - 0.2).abs() < 1e-9);
        assert!((score.rotation_deg.mean - 0.01f64.to_degrees()).abs() < 1e-9);
        let (translation, rotation) = score.loops.unwrap();
        assert_eq!((translation.count, rotation.count, score.num_missed), (1, 1, 0));
        assert!((translation.mean - 0.2).abs() < 1e-9);
    }

    #[test]
    fn poses_are_interpolated_in_small_gaps_only_and_what_is_missed_is_counted() {
        let relations = [truth(0.5, 2.0, 0.0, 0.0), truth(0.0, 5.0, 0.0, 0.0), truth(-1.0, 2.0, 0.0, 0.0)];
        let score = score_relations(&drive(&[0.0, 1.0, 2.0, 8.0]), &relations, 2.0).unwrap();
        assert_eq!((score.translation_m.count, score.num_missed), (1, 2));
        // The way between two poses is taken as an arc: over 0.1 rad and 1 m it bulges by 12.5 mm.
        assert!((score.translation_m.max - 0.0125).abs() < 1e-4 && score.loops.is_none());
        // A stamp at the edge of a gap is there, though it was rounded outwards.
        let edge = [TrueRelation { stamp_2: at(2.0001), ..truth(0.0, 2.0, 0.0, 0.0) }];
        assert_eq!(score_relations(&drive(&[0.0, 2.0]), &edge, 0.5).unwrap().num_missed, 0);
        let none = score_relations(&drive(&[0.0, 8.0]), &[truth(1.0, 2.0, 0.0, 0.0)], 2.0).unwrap_err();
        assert_eq!(none, EvaluationError::NoRelations { num_relations: 1, max_gap_s: 2.0 });
        assert!(score_relations(&drive(&[0.0]), &[], 2.0).is_err());
        assert!(score_relations(&drive(&[0.0]), &relations, f64::NAN).is_err());
    }
}
