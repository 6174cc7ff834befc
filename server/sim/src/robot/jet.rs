//! A number with its first and second derivative by time: exact derivatives of closed forms, by the chain rule.

use std::ops::{Add, Mul, Neg, Sub};

/// Value, first and second derivative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Jet {
    pub(super) value: f64,
    pub(super) rate: f64,
    pub(super) bend: f64,
}

impl Jet {
    /// Time itself.
    pub(super) fn time(t_s: f64) -> Self {
        Self { value: t_s, rate: 1.0, bend: 0.0 }
    }

    pub(super) fn constant(value: f64) -> Self {
        Self { value, rate: 0.0, bend: 0.0 }
    }

    /// A function of this number, by its value and its derivatives there.
    fn through(self, value: f64, slope: f64, bend: f64) -> Self {
        Self { value, rate: slope * self.rate, bend: bend * self.rate * self.rate + slope * self.bend }
    }

    pub(super) fn sin(self) -> Self {
        let (s, c) = self.value.sin_cos();
        self.through(s, c, -s)
    }

    pub(super) fn cos(self) -> Self {
        let (s, c) = self.value.sin_cos();
        self.through(c, -s, -c)
    }

    /// Nothing before 0, everything after 1, and between them a polynomial whose first three derivatives are continuous.
    pub(super) fn eased(self) -> Self {
        if self.value <= 0.0 {
            return Self::constant(0.0);
        }
        if self.value >= 1.0 {
            return Self::constant(1.0);
        }
        let x = self.value;
        let value = x.powi(4) * (35.0 - 84.0 * x + 70.0 * x * x - 20.0 * x.powi(3));
        let slope = 140.0 * x.powi(3) * (1.0 - x).powi(3);
        let bend = 420.0 * x.powi(2) * (1.0 - x).powi(2) * (1.0 - 2.0 * x);
        self.through(value, slope, bend)
    }

    /// This number's derivative; what it needs beyond the second derivative is left out, so that only value and rate hold.
    pub(super) fn derivative(self) -> Self {
        Self { value: self.rate, rate: self.bend, bend: f64::NAN }
    }
}

impl Add for Jet {
    type Output = Self;
    fn add(self, b: Self) -> Self {
        Self { value: self.value + b.value, rate: self.rate + b.rate, bend: self.bend + b.bend }
    }
}

impl Sub for Jet {
    type Output = Self;
    fn sub(self, b: Self) -> Self {
        self + -b
    }
}

impl Neg for Jet {
    type Output = Self;
    fn neg(self) -> Self {
        self * -1.0
    }
}

impl Mul<f64> for Jet {
    type Output = Self;
    fn mul(self, b: f64) -> Self {
        Self { value: self.value * b, rate: self.rate * b, bend: self.bend * b }
    }
}

impl Mul for Jet {
    type Output = Self;
    fn mul(self, b: Self) -> Self {
        Self {
            value: self.value * b.value,
            rate: self.rate * b.value + self.value * b.rate,
            bend: self.bend * b.value + 2.0 * self.rate * b.rate + self.value * b.bend,
        }
    }
}
