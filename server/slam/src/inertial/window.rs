//! A window of the newest states, smoothed over inertial factors between them and registrations of each.
//!
//! What leaves the window stays as a prior on the oldest state (Schur complement). Gravity's direction is one unknown of all
//! states. Since each factor ties a state to its neighbour and gravity alone, the equations are solved by eliminating one
//! state after the other, and what marginalising needs is the first of those steps.
//!
//! Source: Forster et al., "On-manifold preintegration for real-time visual-inertial odometry", 2017 (factors); Sibley,
//! Matthies, Sukhatme, "Sliding window filter with application to planetary landing", 2010 (fixed lag, marginalisation).

use super::preintegration::{DIRECTION, Gravity, NavState, Preintegrated, STATE, off};
use nalgebra::{Cholesky, Const, Matrix6, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use percept_geometry::Pose;
use std::collections::VecDeque;

/// States in the window: two seconds at the usual ten frames a second, in which biases and gravity are told apart by turning.
const LENGTH: usize = 20;
/// Steps of Gauss and Newton for each new state: the window was at its minimum before. Error of `inertial rosette
/// seconds=20` of percept-pipeline: halved 9.0, doubled 8.4 mm (8.2).
const ITERATIONS: usize = 2;

/// A state with gravity's direction.
pub(super) const BOTH: usize = STATE + DIRECTION;
type Information = SMatrix<f64, BOTH, BOTH>;
type Gradient = SVector<f64, BOTH>;

/// What placing a frame tells by itself about the body, or about base, as whoever makes it says: the cost is
/// `gradient . d + d . information . d / 2`, where d leads from `t_odom_found` to the pose (position in its axes, then rotation).
/// Open directions have no information.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PoseFactor {
    pub(crate) t_odom_found: Pose,
    pub(crate) information: Matrix6<f64>,
    pub(crate) gradient: Vector6<f64>,
}

impl PoseFactor {
    /// A pose with its information.
    #[cfg(test)]
    pub(super) fn at(t_odom_found: Pose, information: Matrix6<f64>) -> Self {
        Self { t_odom_found, information, gradient: Vector6::zeros() }
    }

    /// Where the frame is by itself, whatever it was placed with; what it leaves open stays as it was found.
    pub(crate) fn alone(&self) -> Pose {
        let spread = self.information.pseudo_inverse(1e-6).unwrap_or_else(|_| Matrix6::zeros());
        let d = -spread * self.gradient;
        let (p, r) = (Vector3::new(d[0], d[1], d[2]), Vector3::new(d[3], d[4], d[5]));
        self.t_odom_found * Pose::from_parts(p.into(), UnitQuaternion::from_scaled_axis(r))
    }

    /// The same with as much variance added along each direction.
    pub(crate) fn blurred(&self, floor: &Matrix6<f64>) -> Self {
        // (H^-1 + F)^-1 == (I + H F)^-1 H, also where H is singular; the place of the minimum stays.
        let Some(inverse) = (Matrix6::identity() + self.information * floor).try_inverse() else { return self.clone() };
        let information = inverse * self.information;
        Self {
            t_odom_found: self.t_odom_found,
            information: (information + information.transpose()) * 0.5,
            gradient: inverse * self.gradient,
        }
    }
}

/// A quadratic cost around a state and gravity.
#[derive(Debug, Clone)]
struct Prior {
    state: NavState,
    gravity: Gravity,
    information: Information,
    gradient: Gradient,
}

/// What is left of a state that was eliminated: how it follows from the next one and gravity.
struct Eliminated {
    factor: Cholesky<f64, Const<STATE>>,
    gradient: SVector<f64, STATE>,
    /// Information between it and the next state and gravity.
    across: SMatrix<f64, STATE, BOTH>,
}

/// The smoother.
#[derive(Debug, Clone)]
pub(crate) struct Window {
    prior: Prior,
    states: VecDeque<NavState>,
    /// Of each state but the oldest: from the state before.
    motions: VecDeque<Preintegrated>,
    /// Of each state.
    registrations: VecDeque<Option<PoseFactor>>,
    gravity: Gravity,
}

impl Window {
    /// A window that begins with a state and gravity, of these standard deviations squared: of the state's tangent and of
    /// gravity's direction, rad^2.
    pub(crate) fn new(
        state: NavState,
        gravity: Gravity,
        variances: &SVector<f64, STATE>,
        direction_variance: f64,
    ) -> Self {
        let mut diagonal = Gradient::repeat(1.0 / direction_variance);
        diagonal.fixed_rows_mut::<STATE>(0).copy_from(&variances.map(|v| 1.0 / v));
        let information = Information::from_diagonal(&diagonal);
        Self {
            prior: Prior { state, gravity, information, gradient: Gradient::zeros() },
            states: VecDeque::from([state]),
            motions: VecDeque::new(),
            registrations: VecDeque::from([None]),
            gravity,
        }
    }

    /// The newest state.
    pub(crate) fn newest(&self) -> &NavState {
        &self.states[self.states.len() - 1]
    }

    pub(crate) fn gravity(&self) -> &Gravity {
        &self.gravity
    }

    /// The newest state and gravity, moved on by a motion, with their covariance.
    pub(crate) fn predict(&self, motion: &Preintegrated) -> Option<(NavState, Information)> {
        let (_, message) = self.eliminate()?;
        let (from, to) = (self.newest(), motion.predict(self.newest(), &self.gravity));
        let (_, (information, _)) = pass(&message, motion, from, &to, &self.gravity)?;
        Some((to, information.try_inverse()?))
    }

    /// Adds a state and smooths; the oldest one leaves when there are too many. Whether that could be solved.
    pub(crate) fn add(&mut self, motion: Preintegrated, registration: Option<PoseFactor>) -> bool {
        let state = motion.predict(self.newest(), &self.gravity);
        self.states.push_back(state);
        self.motions.push_back(motion);
        self.registrations.push_back(registration);
        for _ in 0..ITERATIONS {
            if self.step().is_none() {
                return false;
            }
        }
        if self.states.len() > LENGTH { self.marginalise().is_some() } else { true }
    }

    /// Covariance of the newest state and gravity.
    pub(crate) fn covariance(&self) -> Option<Information> {
        let (_, (information, _)) = self.eliminate()?;
        information.try_inverse()
    }

    /// All moves with odom: `t` takes old coordinates to new ones.
    pub(crate) fn follow(&mut self, t: &Pose) {
        let moved = |s: &NavState| NavState { t_odom_body: t * s.t_odom_body, velocity: t.rotation * s.velocity, ..*s };
        // Gravity's tangent is about axes that do not turn along, so that its part of the prior has to be turned.
        let gravity = Gravity(t.rotation * self.prior.gravity.0);
        let back = t.rotation.inverse().to_rotation_matrix().matrix() * gravity.derivative();
        let change = (self.prior.gravity.derivative().transpose() * back) / self.prior.gravity.0.norm_squared();
        let mut both = Information::identity();
        both.fixed_view_mut::<DIRECTION, DIRECTION>(STATE, STATE).copy_from(&change);
        // Velocity's tangent is in odom.
        let turned = *t.rotation.inverse().to_rotation_matrix().matrix();
        both.fixed_view_mut::<3, 3>(6, 6).copy_from(&turned);
        self.prior = Prior {
            state: moved(&self.prior.state),
            gravity,
            information: both.transpose() * self.prior.information * both,
            gradient: both.transpose() * self.prior.gradient,
        };
        self.states.iter_mut().for_each(|s| *s = moved(s));
        self.registrations.iter_mut().flatten().for_each(|r| r.t_odom_found = t * r.t_odom_found);
        self.gravity = Gravity(t.rotation * self.gravity.0);
    }

    /// One step of Gauss and Newton.
    fn step(&mut self) -> Option<()> {
        let (eliminated, (information, gradient)) = self.eliminate()?;
        let mut step = -information.cholesky()?.solve(&gradient);
        if !step.iter().all(|x| x.is_finite()) {
            return None;
        }
        let gravity = self.gravity.moved(&step.fixed_rows::<DIRECTION>(STATE).into_owned());
        let last = self.states.len() - 1;
        self.states[last] = self.states[last].moved(&step.fixed_rows::<STATE>(0).into_owned());
        for (k, e) in eliminated.iter().enumerate().rev() {
            let own = -e.factor.solve(&(e.gradient + e.across * step));
            self.states[k] = self.states[k].moved(&own);
            step.fixed_rows_mut::<STATE>(0).copy_from(&own);
        }
        self.gravity = gravity;
        Some(())
    }

    /// What the prior says of the oldest state and gravity as they are now.
    fn first(&self) -> (Information, Gradient) {
        let p = &self.prior;
        let mut d = Gradient::zeros();
        d.fixed_rows_mut::<STATE>(0).copy_from(&self.states[0].from(&p.state));
        d.fixed_rows_mut::<DIRECTION>(STATE).copy_from(&self.gravity.from(&p.gravity));
        (p.information, p.gradient + p.information * d)
    }

    /// The same with what placing a state's frame tells.
    fn with_registration(&self, k: usize, (mut h, mut g): (Information, Gradient)) -> (Information, Gradient) {
        if let Some(r) = &self.registrations[k] {
            let d = off(&r.t_odom_found, &self.states[k].t_odom_body);
            let mut block = h.fixed_view_mut::<6, 6>(0, 0);
            block += r.information;
            let mut rows = g.fixed_rows_mut::<6>(0);
            rows += r.gradient + r.information * d;
        }
        (h, g)
    }

    /// Eliminates all states but the newest, of which information and gradient remain, with gravity's.
    fn eliminate(&self) -> Option<(Vec<Eliminated>, (Information, Gradient))> {
        let mut message = self.with_registration(0, self.first());
        let mut out = Vec::with_capacity(self.motions.len());
        for (k, motion) in self.motions.iter().enumerate() {
            let (eliminated, next) = pass(&message, motion, &self.states[k], &self.states[k + 1], &self.gravity)?;
            out.push(eliminated);
            message = self.with_registration(k + 1, next);
        }
        Some((out, message))
    }

    /// The oldest state leaves; what it told stays as a prior on the next one.
    fn marginalise(&mut self) -> Option<()> {
        let message = self.with_registration(0, self.first());
        let motion = self.motions.pop_front()?;
        let (_, (information, gradient)) = pass(&message, &motion, &self.states[0], &self.states[1], &self.gravity)?;
        self.states.pop_front();
        self.registrations.pop_front();
        self.prior = Prior { state: self.states[0], gravity: self.gravity, information, gradient };
        Some(())
    }
}

/// From what is known of a state and gravity to what that tells of the next state and gravity.
fn pass(
    (h, g): &(Information, Gradient),
    motion: &Preintegrated,
    from: &NavState,
    to: &NavState,
    gravity: &Gravity,
) -> Option<(Eliminated, (Information, Gradient))> {
    let f = motion.factor(from, to, gravity);
    let mut jn = SMatrix::<f64, 15, BOTH>::zeros();
    jn.fixed_view_mut::<15, STATE>(0, 0).copy_from(&f.jb);
    jn.fixed_view_mut::<15, DIRECTION>(0, STATE).copy_from(&f.jg);
    let (wa, wn) = (f.information * f.ja, f.information * jn);
    let own = h.fixed_view::<STATE, STATE>(0, 0) + f.ja.tr_mul(&wa);
    let mut across = f.ja.tr_mul(&wn);
    let mut block = across.fixed_view_mut::<STATE, DIRECTION>(0, STATE);
    block += h.fixed_view::<STATE, DIRECTION>(0, STATE);
    let gradient = g.fixed_rows::<STATE>(0) + wa.tr_mul(&f.residual);
    let mut next = jn.tr_mul(&wn);
    let mut block = next.fixed_view_mut::<DIRECTION, DIRECTION>(STATE, STATE);
    block += h.fixed_view::<DIRECTION, DIRECTION>(STATE, STATE);
    let mut next_gradient = wn.tr_mul(&f.residual);
    let mut rows = next_gradient.fixed_rows_mut::<DIRECTION>(STATE);
    rows += g.fixed_rows::<DIRECTION>(STATE);
    let factor = ((own + own.transpose()) * 0.5).cholesky()?;
    let message = next - across.tr_mul(&factor.solve(&across));
    let message_gradient = next_gradient - across.tr_mul(&factor.solve(&gradient));
    let message = (message + message.transpose()) * 0.5;
    Some((Eliminated { factor, gradient, across }, (message, message_gradient)))
}

#[cfg(test)]
mod tests {
    use super::super::buffer::{ImuBuffer, Noise};
    use super::*;
    use crate::inertial::preintegration::tests::gauss;
    use nalgebra::{DMatrix, DVector, UnitQuaternion, Vector3};
    use percept_geometry::Timestamp;
    use percept_geometry::sensor::ImuSample;
    use rand::{Rng, SeedableRng};

    const NOISE: Noise = Noise { rate: 2e-4, force: 2e-3 };
    const HZ: f64 = 200.0;

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(s)
    }

    /// A hand's pose, in closed form: it is swung, tilted and swayed.
    fn truth(t: f64) -> Pose {
        let r = UnitQuaternion::from_euler_angles(0.3 * (2.1 * t).sin(), 0.2 * (2.9 * t).sin(), 1.2 * (1.5 * t).sin());
        Pose::from_parts(Vector3::new(0.8 * (0.7 * t).sin(), 0.4 * (1.1 * t).cos(), 0.1 * (5.0 * t).sin()).into(), r)
    }

    /// What an IMU feels there, by differences of the closed form that are right to 1e-6.
    fn felt(t: f64, gravity: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let h = 1e-3;
        let [a, b, c] = [t - h, t, t + h].map(truth);
        let rate = (a.rotation.inverse() * c.rotation).scaled_axis() / (2.0 * h);
        let bend = (a.translation.vector - b.translation.vector * 2.0 + c.translation.vector) / (h * h);
        (rate, b.rotation.inverse() * (bend - gravity))
    }

    struct Hand {
        imu: ImuBuffer,
        gravity: Vector3<f64>,
        biases: (Vector3<f64>, Vector3<f64>),
    }

    fn hand(seconds: f64, seed: u64) -> Hand {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let gravity = Vector3::new(0.4, -0.3, -9.8).normalize() * 9.81;
        let biases = (gauss(&mut rng) * 0.01, gauss(&mut rng) * 0.1);
        let mut imu = ImuBuffer::default();
        for i in 0..=(seconds * HZ) as u32 {
            let t = f64::from(i) / HZ;
            let (w, f) = felt(t, &gravity);
            let sample = ImuSample {
                angular_velocity: w + biases.0 + gauss(&mut rng) * (NOISE.rate * HZ.sqrt()),
                linear_acceleration: f + biases.1 + gauss(&mut rng) * (NOISE.force * HZ.sqrt()),
            };
            imu.push(at(t), &sample, &Pose::identity());
        }
        Hand { imu, gravity, biases }
    }

    fn begin(h: &Hand, off_by: f64) -> Window {
        let velocity = (truth(1e-4).translation.vector - truth(-1e-4).translation.vector) / 2e-4;
        let zero = Vector3::zeros();
        let state = NavState {
            t_odom_body: truth(0.0),
            velocity: velocity + Vector3::new(off_by, 0.0, -off_by),
            gyro_bias: zero,
            accel_bias: zero,
        };
        let tilted = UnitQuaternion::from_scaled_axis(Vector3::new(0.2, -0.1, 0.0) * off_by) * h.gravity;
        let sigma = |k: usize| [0.01, 0.005, 0.1, 0.02, 0.2][k / 3];
        let variances = SVector::<f64, STATE>::from_fn(|k, _| sigma(k) * sigma(k));
        Window::new(state, Gravity::along(&tilted), &variances, 1e-3)
    }

    fn motion(h: &Hand, w: &Window, from: f64, to: f64) -> Preintegrated {
        let s = w.newest();
        Preintegrated::of(&h.imu.sound_stretch(at(from), at(to)).unwrap(), &NOISE, &s.gyro_bias, &s.accel_bias)
    }

    const PLACED: (f64, f64) = (0.01, 0.004);

    fn information() -> Matrix6<f64> {
        let i = |s: f64| 1.0 / (s * s);
        Matrix6::from_diagonal(&Vector6::new(
            i(PLACED.0),
            i(PLACED.0),
            i(PLACED.0),
            i(PLACED.1),
            i(PLACED.1),
            i(PLACED.1),
        ))
    }

    fn placed(t: f64, rng: &mut impl Rng) -> Pose {
        let truth = truth(t);
        let rotation = truth.rotation * UnitQuaternion::from_scaled_axis(gauss(rng) * PLACED.1);
        Pose::from_parts((truth.translation.vector + gauss(rng) * PLACED.0).into(), rotation)
    }

    #[test]
    fn biases_gravity_and_velocity_are_found_and_poses_are_better_than_their_registrations() {
        let h = hand(10.0, 7);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(8);
        let mut w = begin(&h, 0.1);
        let (mut square, mut count) = (0.0, 0);
        for k in 1..100 {
            let (from, to) = (0.1 * f64::from(k - 1), 0.1 * f64::from(k));
            assert!(w.add(motion(&h, &w, from, to), Some(PoseFactor::at(placed(to, &mut rng), information()))));
            if k > 50 {
                square += (w.newest().t_odom_body.translation.vector - truth(to).translation.vector).norm_squared();
                count += 3;
            }
        }
        let s = w.newest();
        assert!((square / f64::from(count)).sqrt() < 0.7 * PLACED.0, "{}", (square / f64::from(count)).sqrt());
        let d = truth(9.9 + 1e-4).translation.vector - truth(9.9 - 1e-4).translation.vector;
        let sigma = w.covariance().unwrap();
        let of = |k: usize| 4.0 * (0..3).map(|i| sigma[(k + i, k + i)]).sum::<f64>().sqrt();
        assert!((s.velocity - d / 2e-4).norm() < of(6) && of(6) < 0.1);
        assert!((s.gyro_bias - h.biases.0).norm() < of(9) && of(9) < 0.01, "{} {}", s.gyro_bias, h.biases.0);
        assert!((s.accel_bias - h.biases.1).norm() < of(12) && of(12) < 0.2, "{} {}", s.accel_bias, h.biases.1);
        assert!(w.gravity().0.angle(&h.gravity) < 0.005, "{}", w.gravity().0.angle(&h.gravity));
    }

    #[test]
    fn an_open_direction_is_carried_by_inertia() {
        let h = hand(10.0, 9);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(10);
        let mut w = begin(&h, 0.0);
        for k in 1..100 {
            let (from, to) = (0.1 * f64::from(k - 1), 0.1 * f64::from(k));
            let t = placed(to, &mut rng);
            // From the sixth second on nothing is seen along x of odom.
            let mut along = Vector6::zeros();
            along.fixed_rows_mut::<3>(0).copy_from(&(t.rotation.inverse() * Vector3::x()));
            let keep = Matrix6::identity() - along * along.transpose();
            let seen = if k > 60 { keep * information() * keep } else { information() };
            // What is said along it is wrong, too.
            let t = if k > 60 { Pose::translation(5.0, 0.0, 0.0) * t } else { t };
            assert!(w.add(motion(&h, &w, from, to), Some(PoseFactor::at(t, seen))));
        }
        let off = w.newest().t_odom_body.translation.vector - truth(9.9).translation.vector;
        let c = w.covariance().unwrap().fixed_view::<3, 3>(0, 0).into_owned();
        let along = w.newest().t_odom_body.rotation.inverse() * Vector3::x();
        let sigma = along.dot(&(c * along)).sqrt();
        assert!(off.x.abs() < 3.0 * sigma && sigma < 0.15 && off.yz().norm() < 0.02, "{off} {sigma}");
    }

    /// The cost of a window of all states as one dense problem.
    fn dense(w: &Window) -> (DMatrix<f64>, DVector<f64>) {
        let n = w.states.len();
        let (mut h, mut g) =
            (DMatrix::zeros(STATE * n + DIRECTION, STATE * n + DIRECTION), DVector::zeros(STATE * n + DIRECTION));
        let gravity = STATE * n;
        let place = |k: usize, i: usize| if i < STATE { STATE * k + i } else { gravity + i - STATE };
        let mut add = |index: &dyn Fn(usize) -> usize, size: usize, hs: &DMatrix<f64>, gs: &DVector<f64>| {
            for i in 0..size {
                g[index(i)] += gs[i];
                for j in 0..size {
                    h[(index(i), index(j))] += hs[(i, j)];
                }
            }
        };
        let (h0, g0) = w.first();
        add(
            &|i| place(0, i),
            BOTH,
            &DMatrix::from_fn(BOTH, BOTH, |i, j| h0[(i, j)]),
            &DVector::from_fn(BOTH, |i, _| g0[i]),
        );
        for k in 0..n {
            let none = (Information::zeros(), Gradient::zeros());
            let (hr, gr) = w.with_registration(k, none);
            add(
                &|i| place(k, i),
                BOTH,
                &DMatrix::from_fn(BOTH, BOTH, |i, j| hr[(i, j)]),
                &DVector::from_fn(BOTH, |i, _| gr[i]),
            );
        }
        for (k, m) in w.motions.iter().enumerate() {
            let f = m.factor(&w.states[k], &w.states[k + 1], &w.gravity);
            let mut j = DMatrix::zeros(15, 2 * STATE + DIRECTION);
            j.view_mut((0, 0), (15, STATE)).copy_from(&f.ja);
            j.view_mut((0, STATE), (15, STATE)).copy_from(&f.jb);
            j.view_mut((0, 2 * STATE), (15, DIRECTION)).copy_from(&f.jg);
            let i = DMatrix::from_fn(15, 15, |a, b| f.information[(a, b)]);
            let r = DVector::from_fn(15, |a, _| f.residual[a]);
            let index = |i: usize| if i < STATE { place(k, i) } else { place(k + 1, i - STATE) };
            add(&index, 2 * STATE + DIRECTION, &(j.transpose() * &i * &j), &(j.transpose() * &i * r));
        }
        (h, g)
    }

    #[test]
    fn elimination_is_the_dense_solution() {
        let h = hand(2.0, 11);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(12);
        let mut w = begin(&h, 0.05);
        for k in 1..6 {
            let (from, to) = (0.1 * f64::from(k - 1), 0.1 * f64::from(k));
            w.add(motion(&h, &w, from, to), Some(PoseFactor::at(placed(to, &mut rng), information())));
        }
        let (dense_h, dense_g) = dense(&w);
        let (eliminated, (information, gradient)) = w.eliminate().unwrap();
        let step = dense_h.clone().cholesky().unwrap().solve(&dense_g);
        let last = STATE * (w.states.len() - 1);
        let own = information.cholesky().unwrap().solve(&gradient);
        for i in 0..BOTH {
            assert!((own[i] - step[last + i]).abs() < 1e-8 * step.norm().max(1e-3), "{i}");
        }
        assert_eq!(eliminated.len(), 5);
        let inverse = dense_h.try_inverse().unwrap();
        let told = w.covariance().unwrap();
        for i in 0..BOTH {
            let (a, b) = (inverse[(last + i, last + i)], told[(i, i)]);
            assert!((a / b - 1.0).abs() < 1e-6, "{i}: {a} {b}");
        }
    }

    #[test]
    fn a_window_that_is_turned_and_moved_goes_on_alike() {
        let h = hand(4.0, 13);
        let t = Pose::new(Vector3::new(3.0, -2.0, 1.0), Vector3::new(0.4, -0.9, 0.7));
        let (mut a, mut b) = (begin(&h, 0.1), begin(&h, 0.1));
        for k in 1u32..40 {
            let (from, to) = (0.1 * f64::from(k - 1), 0.1 * f64::from(k));
            let p = placed(to, &mut rand_chacha::ChaCha8Rng::seed_from_u64(k.into()));
            if k == 20 {
                b.follow(&t);
            }
            let seen = if k < 20 { p } else { t * p };
            let (ma, mb) = (motion(&h, &a, from, to), motion(&h, &b, from, to));
            a.add(ma, Some(PoseFactor::at(p, information())));
            b.add(mb, Some(PoseFactor::at(seen, information())));
        }
        let off = (t * a.newest().t_odom_body).inverse() * b.newest().t_odom_body;
        assert!(off.translation.vector.norm() < 1e-5 && off.rotation.angle() < 1e-5, "{off}");
        assert!((a.newest().accel_bias - b.newest().accel_bias).norm() < 1e-3);
    }
}
