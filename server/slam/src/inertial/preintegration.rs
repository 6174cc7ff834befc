//! Samples between two frames as one factor between their states.
//!
//! Source: Forster, Carlone, Dellaert, Scaramuzza, "On-manifold preintegration for real-time visual-inertial odometry", 2017,
//! sections VI and appendix. We integrate by trapezoids between samples instead of holding each, and count errors of scale
//! and alignment of the gyro, which grow with the turn.

use super::buffer::{Noise, Reading};
use super::gravity::GRAVITY;
use super::so3::{right_jacobian, right_jacobian_inverse};
use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use percept_geometry::Pose;
use percept_geometry::se3::skew;

/// Numbers of a state's tangent: position (in the body's axes), rotation, velocity (in odom), gyro bias, accelerometer bias.
pub(super) const STATE: usize = 15;
/// And of gravity's direction.
pub(super) const DIRECTION: usize = 2;

/// How far biases wander in a second, rad/s and m/s^2: those of the ADIS16448 in Burri et al., "The EuRoC micro aerial
/// vehicle datasets", 2016.
const WALK: (f64, f64) = (2e-5, 3e-3);
/// Error of a turn as a share of it: a gyro of a few euros is good to half a per cent or so once its factory has calibrated it.
pub(super) const TURN_SHARE: f64 = 0.003;

pub(super) type Matrix9 = SMatrix<f64, 9, 9>;
type Vector15 = SVector<f64, 15>;

/// What is known of the body (the IMU's origin in axes of base) at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NavState {
    /// Body to odom.
    pub(crate) t_odom_body: Pose,
    /// In odom, m/s.
    pub(crate) velocity: Vector3<f64>,
    /// In axes of base, rad/s.
    pub(crate) gyro_bias: Vector3<f64>,
    /// In axes of base, m/s^2.
    pub(crate) accel_bias: Vector3<f64>,
}

impl NavState {
    /// The state that lies off this one by a tangent vector.
    pub(super) fn moved(&self, d: &SVector<f64, STATE>) -> Self {
        let t = &self.t_odom_body;
        let p = t.translation.vector + t.rotation * d.fixed_rows::<3>(0);
        let mut rotation = t.rotation * UnitQuaternion::from_scaled_axis(d.fixed_rows::<3>(3).into_owned());
        rotation.renormalize();
        Self {
            t_odom_body: Pose::from_parts(p.into(), rotation),
            velocity: self.velocity + d.fixed_rows::<3>(6),
            gyro_bias: self.gyro_bias + d.fixed_rows::<3>(9),
            accel_bias: self.accel_bias + d.fixed_rows::<3>(12),
        }
    }

    /// The tangent vector that leads from `before` to this state.
    pub(super) fn from(&self, before: &Self) -> SVector<f64, STATE> {
        let mut d = SVector::<f64, STATE>::zeros();
        d.fixed_rows_mut::<6>(0).copy_from(&off(&before.t_odom_body, &self.t_odom_body));
        d.fixed_rows_mut::<3>(6).copy_from(&(self.velocity - before.velocity));
        d.fixed_rows_mut::<3>(9).copy_from(&(self.gyro_bias - before.gyro_bias));
        d.fixed_rows_mut::<3>(12).copy_from(&(self.accel_bias - before.accel_bias));
        d
    }
}

/// How `t` lies from `before`: position in its axes, then rotation.
pub(super) fn off(before: &Pose, t: &Pose) -> Vector6<f64> {
    let between = before.inv_mul(t);
    let (p, r) = (between.translation.vector, between.rotation.scaled_axis());
    Vector6::new(p.x, p.y, p.z, r.x, r.y, r.z)
}

/// Gravity in odom, of constant length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Gravity(pub(crate) Vector3<f64>);

impl Gravity {
    pub(crate) fn along(down: &Vector3<f64>) -> Self {
        Self(down.normalize() * GRAVITY)
    }

    /// Two axes across it, in odom.
    fn across(&self) -> SMatrix<f64, 3, DIRECTION> {
        let g = self.0.normalize();
        let helper = if g.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
        let a = g.cross(&helper).normalize();
        SMatrix::from_columns(&[a, g.cross(&a)])
    }

    /// Turned by these angles about those axes.
    pub(super) fn moved(&self, d: &SVector<f64, DIRECTION>) -> Self {
        Self(UnitQuaternion::from_scaled_axis(self.across() * d) * self.0)
    }

    /// The angles, about the axes across `before`, that lead from it to this one.
    pub(super) fn from(&self, before: &Self) -> SVector<f64, DIRECTION> {
        let turn = UnitQuaternion::rotation_between(&before.0, &self.0).unwrap_or_default();
        before.across().tr_mul(&turn.scaled_axis())
    }

    /// How the vector changes with the angles.
    pub(super) fn derivative(&self) -> SMatrix<f64, 3, DIRECTION> {
        -skew(&self.0) * self.across()
    }
}

/// The motion that samples tell, without gravity and the velocity at the beginning, in axes of the body there.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Preintegrated {
    pub(crate) dt: f64,
    r: UnitQuaternion<f64>,
    v: Vector3<f64>,
    p: Vector3<f64>,
    /// The biases that were taken off.
    gyro_bias: Vector3<f64>,
    accel_bias: Vector3<f64>,
    /// Derivatives of r (right), v and p by the gyro's bias, of v and p by the accelerometer's.
    r_bg: Matrix3<f64>,
    v_bg: Matrix3<f64>,
    p_bg: Matrix3<f64>,
    v_ba: Matrix3<f64>,
    p_ba: Matrix3<f64>,
    /// Of r (right perturbation), v, p.
    covariance: Matrix9,
}

impl Preintegrated {
    /// Of readings in a row, with these biases taken off.
    pub(crate) fn of(readings: &[Reading], noise: &Noise, gyro_bias: &Vector3<f64>, accel_bias: &Vector3<f64>) -> Self {
        let mut out = Self {
            dt: 0.0,
            r: UnitQuaternion::identity(),
            v: Vector3::zeros(),
            p: Vector3::zeros(),
            gyro_bias: *gyro_bias,
            accel_bias: *accel_bias,
            r_bg: Matrix3::zeros(),
            v_bg: Matrix3::zeros(),
            p_bg: Matrix3::zeros(),
            v_ba: Matrix3::zeros(),
            p_ba: Matrix3::zeros(),
            covariance: Matrix9::zeros(),
        };
        for pair in readings.windows(2) {
            out.add(&pair[0], &pair[1], noise);
        }
        let turn = TURN_SHARE * out.r.angle();
        for k in 0..3 {
            out.covariance[(k, k)] += turn * turn;
        }
        out
    }

    fn add(&mut self, a: &Reading, b: &Reading, noise: &Noise) {
        let dt = b.stamp.seconds_since(a.stamp);
        if dt <= 0.0 {
            return;
        }
        let turn = ((a.rate + b.rate) * 0.5 - self.gyro_bias) * dt;
        let (f0, f1) = (a.force - self.accel_bias, b.force - self.accel_bias);
        let step = UnitQuaternion::from_scaled_axis(turn);
        let jr = right_jacobian(&turn) * dt;
        let r0 = *self.r.to_rotation_matrix().matrix();
        let back = *step.inverse().to_rotation_matrix().matrix();
        let r1 = r0 * back.transpose();
        let force = (r0 * f0 + r1 * f1) * 0.5;
        // How the mean force changes with the rotation at the beginning, with the turn rate, and with the readings.
        let by_r = (r0 * skew(&f0) + r1 * skew(&f1) * back) * -0.5;
        let by_w = r1 * skew(&f1) * jr * -0.5;
        let by_f = (r0 + r1) * 0.5;
        let half = 0.5 * dt * dt;

        let mut f = Matrix9::identity();
        f.fixed_view_mut::<3, 3>(0, 0).copy_from(&back);
        f.fixed_view_mut::<3, 3>(3, 0).copy_from(&(by_r * dt));
        f.fixed_view_mut::<3, 3>(6, 0).copy_from(&(by_r * half));
        f.fixed_view_mut::<3, 3>(6, 3).copy_from(&(Matrix3::identity() * dt));
        let mut g = SMatrix::<f64, 9, 6>::zeros();
        g.fixed_view_mut::<3, 3>(0, 0).copy_from(&jr);
        g.fixed_view_mut::<3, 3>(3, 0).copy_from(&(by_w * dt));
        g.fixed_view_mut::<3, 3>(6, 0).copy_from(&(by_w * half));
        g.fixed_view_mut::<3, 3>(3, 3).copy_from(&(by_f * dt));
        g.fixed_view_mut::<3, 3>(6, 3).copy_from(&(by_f * half));
        let (w2, f2) = (noise.rate * noise.rate / dt, noise.force * noise.force / dt);
        let q = SMatrix::<f64, 6, 6>::from_diagonal(&Vector6::new(w2, w2, w2, f2, f2, f2));
        self.covariance = f * self.covariance * f.transpose() + g * q * g.transpose();

        let (v_bg, v_ba) = (by_r * self.r_bg - by_w, -by_f);
        self.p_bg += self.v_bg * dt + v_bg * half;
        self.p_ba += self.v_ba * dt + v_ba * half;
        self.v_bg += v_bg * dt;
        self.v_ba += v_ba * dt;
        self.r_bg = back * self.r_bg - jr;

        self.p += self.v * dt + force * half;
        self.v += force * dt;
        self.r *= step;
        self.dt += dt;
    }

    /// Rotation, velocity and position with other biases, to first order.
    fn with_biases(&self, s: &NavState) -> (UnitQuaternion<f64>, Vector3<f64>, Vector3<f64>) {
        let (bg, ba) = (s.gyro_bias - self.gyro_bias, s.accel_bias - self.accel_bias);
        let r = self.r * UnitQuaternion::from_scaled_axis(self.r_bg * bg);
        (r, self.v + self.v_bg * bg + self.v_ba * ba, self.p + self.p_bg * bg + self.p_ba * ba)
    }

    /// The state to which this motion leads.
    pub(crate) fn predict(&self, s: &NavState, gravity: &Gravity) -> NavState {
        let (r, v, p) = self.with_biases(s);
        let (at, g) = (&s.t_odom_body, gravity.0);
        let position = at.translation.vector + s.velocity * self.dt + g * (0.5 * self.dt * self.dt) + at.rotation * p;
        NavState {
            t_odom_body: Pose::from_parts(position.into(), at.rotation * r),
            velocity: s.velocity + g * self.dt + at.rotation * v,
            ..*s
        }
    }

    /// How much two states and gravity disagree with this motion, biases that wander included, with the derivatives by both
    /// states and by gravity, and the information.
    pub(super) fn factor(&self, a: &NavState, b: &NavState, gravity: &Gravity) -> Factor {
        let (r, v, p) = self.with_biases(a);
        let ra = *a.t_odom_body.rotation.to_rotation_matrix().matrix();
        let rb = *b.t_odom_body.rotation.to_rotation_matrix().matrix();
        let (dt, g) = (self.dt, gravity.0);
        let moved_v = ra.transpose() * (b.velocity - a.velocity - g * dt);
        let way = b.t_odom_body.translation.vector - a.t_odom_body.translation.vector;
        let moved_p = ra.transpose() * (way - a.velocity * dt - g * (0.5 * dt * dt));
        let off_r = (r.inverse() * a.t_odom_body.rotation.inverse() * b.t_odom_body.rotation).scaled_axis();

        let mut residual = Vector15::zeros();
        residual.fixed_rows_mut::<3>(0).copy_from(&off_r);
        residual.fixed_rows_mut::<3>(3).copy_from(&(moved_v - v));
        residual.fixed_rows_mut::<3>(6).copy_from(&(moved_p - p));
        residual.fixed_rows_mut::<3>(9).copy_from(&(b.gyro_bias - a.gyro_bias));
        residual.fixed_rows_mut::<3>(12).copy_from(&(b.accel_bias - a.accel_bias));

        let jr_inv = right_jacobian_inverse(&off_r);
        let by_bias = self.r_bg * (a.gyro_bias - self.gyro_bias);
        let exp_back = *UnitQuaternion::from_scaled_axis(-off_r).to_rotation_matrix().matrix();
        let one = Matrix3::identity();
        let (mut ja, mut jb) = (SMatrix::<f64, 15, STATE>::zeros(), SMatrix::<f64, 15, STATE>::zeros());
        let put = |j: &mut SMatrix<f64, 15, STATE>, row: usize, column: usize, block: Matrix3<f64>| {
            j.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        put(&mut ja, 0, 3, -jr_inv * rb.transpose() * ra);
        put(&mut ja, 0, 9, -jr_inv * exp_back * right_jacobian(&by_bias) * self.r_bg);
        put(&mut ja, 3, 3, skew(&moved_v));
        put(&mut ja, 3, 6, -ra.transpose());
        put(&mut ja, 3, 9, -self.v_bg);
        put(&mut ja, 3, 12, -self.v_ba);
        put(&mut ja, 6, 0, -one);
        put(&mut ja, 6, 3, skew(&moved_p));
        put(&mut ja, 6, 6, -ra.transpose() * dt);
        put(&mut ja, 6, 9, -self.p_bg);
        put(&mut ja, 6, 12, -self.p_ba);
        put(&mut ja, 9, 9, -one);
        put(&mut ja, 12, 12, -one);
        put(&mut jb, 0, 3, jr_inv);
        put(&mut jb, 3, 6, ra.transpose());
        put(&mut jb, 6, 0, ra.transpose() * rb);
        put(&mut jb, 9, 9, one);
        put(&mut jb, 12, 12, one);
        let mut jg = SMatrix::<f64, 15, DIRECTION>::zeros();
        let by_g = ra.transpose() * gravity.derivative();
        jg.fixed_view_mut::<3, DIRECTION>(3, 0).copy_from(&(by_g * -dt));
        jg.fixed_view_mut::<3, DIRECTION>(6, 0).copy_from(&(by_g * (-0.5 * dt * dt)));

        let mut covariance = SMatrix::<f64, 15, 15>::zeros();
        covariance.fixed_view_mut::<9, 9>(0, 0).copy_from(&self.covariance);
        for k in 0..9 {
            // Integrated noise of one or two steps has no full rank.
            covariance[(k, k)] += 1e-12;
        }
        for k in 0..3 {
            covariance[(9 + k, 9 + k)] = (WALK.0 * WALK.0 * dt).max(1e-16);
            covariance[(12 + k, 12 + k)] = (WALK.1 * WALK.1 * dt).max(1e-16);
        }
        let information = covariance.cholesky().map_or_else(SMatrix::zeros, |c| c.inverse());
        Factor { residual, ja, jb, jg, information }
    }
}

/// A linearised factor between two states and gravity.
pub(super) struct Factor {
    pub(super) residual: Vector15,
    pub(super) ja: SMatrix<f64, 15, STATE>,
    pub(super) jb: SMatrix<f64, 15, STATE>,
    pub(super) jg: SMatrix<f64, 15, DIRECTION>,
    pub(super) information: SMatrix<f64, 15, 15>,
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::buffer::ImuBuffer;
    use super::*;
    use percept_geometry::Timestamp;
    use percept_geometry::sensor::ImuSample;
    use rand::{Rng, RngExt, SeedableRng};

    const QUIET: Noise = Noise { rate: 1e-3, force: 1e-2 };

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(s)
    }

    /// Standard normal numbers, by Box and Muller.
    pub(in crate::inertial) fn gauss(rng: &mut impl Rng) -> Vector3<f64> {
        let mut one = || {
            let (a, b): (f64, f64) =
                (rng.random_range(f64::EPSILON..1.0), rng.random_range(0.0..std::f64::consts::TAU));
            (-2.0 * a.ln()).sqrt() * b.cos()
        };
        Vector3::from_fn(|_, _| one())
    }

    /// A hand that turns and shakes: rates and forces at a time.
    fn felt(t: f64) -> (Vector3<f64>, Vector3<f64>) {
        let rate = Vector3::new((2.0 * t).sin(), 0.5 * (3.0 * t).cos(), 3.0 * (1.3 * t).sin());
        (rate, Vector3::new(2.0 * (5.0 * t).sin(), 1.0 + t, 9.8 + (4.0 * t).cos()))
    }

    fn readings(hz: u32, seconds: f64, off: impl Fn(u32) -> (Vector3<f64>, Vector3<f64>)) -> Vec<Reading> {
        let mut imu = ImuBuffer::default();
        for i in 0..=(f64::from(hz) * seconds).round() as u32 {
            let t = f64::from(i) / f64::from(hz);
            let ((w, f), (dw, df)) = (felt(t), off(i));
            let sample = ImuSample { angular_velocity: w + dw, linear_acceleration: f + df };
            imu.push(at(t), &sample, &Pose::identity());
        }
        imu.sound_stretch(at(0.0), at(seconds)).unwrap()
    }

    fn exact(hz: u32, seconds: f64) -> Vec<Reading> {
        readings(hz, seconds, |_| (Vector3::zeros(), Vector3::zeros()))
    }

    fn state(rng: &mut impl Rng) -> NavState {
        let pose = Pose::new(gauss(rng), gauss(rng));
        NavState { t_odom_body: pose, velocity: gauss(rng), gyro_bias: gauss(rng) * 0.02, accel_bias: gauss(rng) * 0.1 }
    }

    fn gravity(rng: &mut impl Rng) -> Gravity {
        Gravity::along(&gauss(rng))
    }

    #[test]
    fn preintegration_is_direct_integration_from_any_state_and_gravity() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        for _ in 0..20 {
            let (s, g) = (state(&mut rng), gravity(&mut rng));
            // Directly, in odom, in steps of a hundred microseconds.
            let (n, h) = (5000, 1e-4);
            let (mut r, mut p, mut v) = (s.t_odom_body.rotation, s.t_odom_body.translation.vector, s.velocity);
            for i in 0..n {
                let (w, f) = felt((f64::from(i) + 0.5) * h);
                let half = r * UnitQuaternion::from_scaled_axis((w - s.gyro_bias) * (0.5 * h));
                let a = half * (f - s.accel_bias) + g.0;
                p += v * h + a * (0.5 * h * h);
                v += a * h;
                r *= UnitQuaternion::from_scaled_axis((w - s.gyro_bias) * h);
            }
            let found = Preintegrated::of(&exact(400, 0.5), &QUIET, &s.gyro_bias, &s.accel_bias).predict(&s, &g);
            assert!(found.t_odom_body.rotation.angle_to(&r) < 2e-5);
            assert!((found.velocity - v).norm() < 1e-4 && (found.t_odom_body.translation.vector - p).norm() < 1e-4);
        }
    }

    #[test]
    fn other_biases_are_followed_to_first_order() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        let samples = exact(200, 0.3);
        for _ in 0..20 {
            let s = state(&mut rng);
            let g = gravity(&mut rng);
            let anew = Preintegrated::of(&samples, &QUIET, &s.gyro_bias, &s.accel_bias).predict(&s, &g);
            let zero = Vector3::zeros();
            let moved = Preintegrated::of(&samples, &QUIET, &zero, &zero).predict(&s, &g);
            // Second order: (0.02 rad/s * 0.3 s)^2 of a turn, and of what 10 m/s^2 do in 0.3 s.
            let d = anew.from(&moved);
            assert!(d.fixed_rows::<3>(3).norm() < 1e-4 && d.fixed_rows::<3>(0).norm() < 1e-4, "{d}");
            assert!(d.fixed_rows::<3>(6).norm() < 1e-3, "{d}");
        }
    }

    #[test]
    fn derivatives_are_those_of_small_steps() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let zero = Vector3::zeros();
        for _ in 0..20 {
            let (a, g) = (state(&mut rng), gravity(&mut rng));
            let motion = Preintegrated::of(&exact(100, 0.2), &QUIET, &zero, &zero);
            // Near the prediction, but not on it.
            let d = SVector::<f64, STATE>::from_fn(|_, _| rng.random_range(-0.1..0.1));
            let b = motion.predict(&a, &g).moved(&d);
            let f = motion.factor(&a, &b, &g);
            let h = 1e-6;
            for k in 0..STATE {
                let e = SVector::<f64, STATE>::ith(k, h);
                let by_a = (motion.factor(&a.moved(&e), &b, &g).residual
                    - motion.factor(&a.moved(&-e), &b, &g).residual)
                    / (2.0 * h);
                let by_b = (motion.factor(&a, &b.moved(&e), &g).residual
                    - motion.factor(&a, &b.moved(&-e), &g).residual)
                    / (2.0 * h);
                assert!((by_a - f.ja.column(k)).norm() < 1e-6, "a {k}: {}", by_a - f.ja.column(k));
                assert!((by_b - f.jb.column(k)).norm() < 1e-6, "b {k}: {}", by_b - f.jb.column(k));
            }
            for k in 0..DIRECTION {
                let e = SVector::<f64, DIRECTION>::ith(k, h);
                let by_g = (motion.factor(&a, &b, &g.moved(&e)).residual
                    - motion.factor(&a, &b, &g.moved(&-e)).residual)
                    / (2.0 * h);
                assert!((by_g - f.jg.column(k)).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn tangents_lead_there_and_back() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        for _ in 0..50 {
            let (s, g) = (state(&mut rng), gravity(&mut rng));
            let d = SVector::<f64, STATE>::from_fn(|_, _| rng.random_range(-0.5..0.5));
            assert!((s.moved(&d).from(&s) - d).norm() < 1e-12);
            let d = SVector::<f64, DIRECTION>::from_fn(|_, _| rng.random_range(-0.5..0.5));
            assert!((g.moved(&d).from(&g) - d).norm() < 1e-12);
            assert!((g.moved(&d).0.norm() - GRAVITY).abs() < 1e-12);
        }
    }

    #[test]
    fn the_covariance_is_that_of_many_noisy_runs() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let (zero, hz, seconds) = (Vector3::zeros(), 200, 0.25);
        let noise = Noise { rate: 2e-3, force: 2e-2 };
        // A sample of white noise of this density.
        let (w, f) = (noise.rate * f64::from(hz).sqrt(), noise.force * f64::from(hz).sqrt());
        let truth = Preintegrated::of(&exact(hz, seconds), &noise, &zero, &zero);
        let mut sum = Matrix9::zeros();
        let runs = 3000;
        for _ in 0..runs {
            let noises: Vec<_> = (0..=50).map(|_| (gauss(&mut rng) * w, gauss(&mut rng) * f)).collect();
            let noisy = Preintegrated::of(&readings(hz, seconds, |i| noises[i as usize]), &noise, &zero, &zero);
            let mut d = SVector::<f64, 9>::zeros();
            d.fixed_rows_mut::<3>(0).copy_from(&(truth.r.inverse() * noisy.r).scaled_axis());
            d.fixed_rows_mut::<3>(3).copy_from(&(noisy.v - truth.v));
            d.fixed_rows_mut::<3>(6).copy_from(&(noisy.p - truth.p));
            sum += d * d.transpose();
        }
        let mut told = truth.covariance;
        for k in 0..3 {
            told[(k, k)] -= (TURN_SHARE * truth.r.angle()).powi(2);
        }
        // Against each other in the coordinates in which what is told is the identity; 3000 runs are good to 0.03, and
        // trapezoids leave half a sample at either end out.
        let half = told.cholesky().unwrap().l().try_inverse().unwrap();
        let ratio = half * (sum / f64::from(runs)) * half.transpose();
        assert!((ratio - Matrix9::identity()).abs().max() < 0.15, "{ratio}");
    }
}
