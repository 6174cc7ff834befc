//! First and second moments of points.

use nalgebra::{Matrix3, Point3, Vector3};

/// Sums over points, about an anchor near them so that distance from the origin costs no digits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scatter {
    anchor: Point3<f64>,
    count: f64,
    sum: Vector3<f64>,
    /// xx, xy, xz, yy, yz, zz.
    squares: [f64; 6],
}

impl Scatter {
    /// No points yet; `anchor` should lie among those to come, metres.
    pub fn new(anchor: Point3<f64>) -> Self {
        Self { anchor, count: 0.0, sum: Vector3::zeros(), squares: [0.0; 6] }
    }

    /// Moments from the number of points, their sum and the sums of xx, xy, xz, yy, yz, zz, all about `anchor`.
    pub(crate) fn from_sums(anchor: Point3<f64>, sums: &[f64; 10]) -> Self {
        let [count, x, y, z, squares @ ..] = *sums;
        Self { anchor, count, sum: Vector3::new(x, y, z), squares }
    }

    /// Moments of the finite ones of `points`; none if there is none.
    pub fn of<'a>(points: impl IntoIterator<Item = &'a Point3<f32>>) -> Option<Self> {
        let mut finite = points.into_iter().filter(|p| percept_geometry::cloud::is_finite(p));
        let first = finite.next()?;
        let mut out = Self::new(first.cast());
        out.add(&first.cast());
        finite.for_each(|p| out.add(&p.cast()));
        Some(out)
    }

    /// Takes a finite point in.
    #[inline]
    pub fn add(&mut self, p: &Point3<f64>) {
        let o = p - self.anchor;
        self.count += 1.0;
        self.sum += o;
        self.squares[0] += o.x * o.x;
        self.squares[1] += o.x * o.y;
        self.squares[2] += o.x * o.z;
        self.squares[3] += o.y * o.y;
        self.squares[4] += o.y * o.z;
        self.squares[5] += o.z * o.z;
    }

    /// The moments of both sets of points.
    pub fn merged(&self, other: &Self) -> Self {
        let shift = other.anchor - self.anchor;
        let mut out = *self;
        out.count += other.count;
        out.sum += other.sum + shift * other.count;
        // Sum of (o + s)(o + s)' over the other's offsets o.
        let pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        for ((square, theirs), (i, j)) in out.squares.iter_mut().zip(other.squares).zip(pairs) {
            *square += theirs + other.sum[i] * shift[j] + shift[i] * other.sum[j] + other.count * shift[i] * shift[j];
        }
        out
    }

    /// Number of points.
    pub fn num_points(&self) -> usize {
        self.count as usize
    }

    /// Mean; the anchor if there is no point.
    pub fn mean(&self) -> Point3<f64> {
        self.anchor + self.sum / self.count.max(1.0)
    }

    /// Covariance (divided by the number of points), square metres; zero if there is no point.
    pub fn covariance(&self) -> Matrix3<f64> {
        let n = self.count.max(1.0);
        let mean = self.sum / n;
        let [xx, xy, xz, yy, yz, zz] = self.squares.map(|s| s / n);
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) - mean * mean.transpose()
    }
}
