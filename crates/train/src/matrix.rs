//! Matrices as views of slices, and their product. This is the only file with `unsafe` code: the product passes
//! pointers to an external kernel, after every view was checked against its slice.
//!
//! The code is generic over the number type, so a test can check in f64 the gradients that a training computes in f32.

use std::ops::{AddAssign, SubAssign};

use num_traits::Float;

/// Number type of network computations: f32, or f64 for checks.
pub trait Real: Float + AddAssign + SubAssign + Default + Send + Sync + std::fmt::Debug + 'static {
    /// Converts a value from f32 without loss.
    fn of(value: f32) -> Self;

    /// Exponential function, with the same result on every platform.
    fn exponential(self) -> Self;
}

impl Real for f32 {
    fn of(value: f32) -> f32 {
        value
    }

    fn exponential(self) -> f32 {
        libm::expf(self)
    }
}

impl Real for f64 {
    fn of(value: f32) -> f64 {
        f64::from(value)
    }

    fn exponential(self) -> f64 {
        libm::exp(self)
    }
}

/// Read-only view of a slice as a matrix.
#[derive(Clone, Copy, Debug)]
pub struct View<'a, T> {
    data: &'a [T],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

impl<'a, T> View<'a, T> {
    /// Returns a view of `data` as a row-major matrix of `rows` x `columns` without gaps.
    ///
    /// # Panics
    /// If `data` is too short.
    pub fn new(data: &'a [T], rows: usize, columns: usize) -> View<'a, T> {
        View::strided(data, rows, columns, columns)
    }

    /// Returns a view of `data` as a matrix of `rows` x `columns` whose rows begin `stride` entries apart, for some
    /// columns of a wider matrix.
    ///
    /// # Panics
    /// If `data` is too short, or if the rows overlap.
    pub fn strided(data: &'a [T], rows: usize, columns: usize, stride: usize) -> View<'a, T> {
        let view = View { data, rows, columns, row_stride: stride, column_stride: 1 };
        assert!(within(data.len(), rows, columns, stride), "a view lies inside its slice");
        view
    }

    /// Returns the transpose of the matrix, as a view of the same slice.
    pub fn t(self) -> View<'a, T> {
        View {
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
            ..self
        }
    }
}

fn within(len: usize, rows: usize, columns: usize, stride: usize) -> bool {
    rows == 0 || columns == 0 || ((rows - 1) * stride + columns <= len && (columns <= stride || rows == 1))
}

/// Treatment of the values that a product's output slice already has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// The product replaces the values.
    Replace,
    /// The product is added to the values.
    Add,
}

/// Computes the product of the matrices `a` and `b`. Writes it into the slice `into`, whose rows begin `stride` entries
/// apart, or adds it there, as `output` says.
///
/// # Panics
/// If the shapes do not match each other or the slice.
#[expect(unsafe_code, reason = "the kernel takes pointers; every view is checked before it gets one")]
pub fn multiply<T: Real>(into: &mut [T], stride: usize, output: Output, a: View<T>, b: View<T>) {
    let (m, n, k) = (a.rows, b.columns, a.columns);
    assert_eq!(k, b.rows, "the shapes of the factors match");
    assert!(within(into.len(), m, n, stride), "the product lies inside its slice");
    if m == 0 || n == 0 {
        return;
    }
    let signed = |stride: usize| isize::try_from(stride).expect("a stride is far below the largest number");
    // SAFETY: each pointer comes from a slice that holds all rows and columns at these strides: `within` was
    // asserted for `into` here and for `a` and `b` when the views were made; transposing swaps both pairs. `into`
    // is borrowed mutably, so it overlaps neither factor, and none of its rows overlap, as `within` asserts.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            into.as_mut_ptr(),
            1,
            signed(stride),
            output == Output::Add,
            a.data.as_ptr(),
            signed(a.column_stride),
            signed(a.row_stride),
            b.data.as_ptr(),
            signed(b.column_stride),
            signed(b.row_stride),
            T::one(),
            T::one(),
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_whole_transposed_and_strided_views() {
        let a = [1.0f64, 2.0, 3.0, 4.0, 5.0, 6.0];
        let b = [1.0f64, -1.0, 0.5, 2.0];
        let mut c = [1.0f64; 6];
        // The last two columns of a 2 x 3 matrix, times a 2 x 2 matrix transposed.
        let columns = View::strided(&a[1..], 2, 2, 3);
        multiply(&mut c, 3, Output::Add, columns, View::new(&b, 2, 2).t());
        assert_eq!(c, [1.0 - 1.0, 1.0 + 7.0, 1.0, 1.0 - 1.0, 1.0 + 14.5, 1.0]);
        multiply(&mut c, 2, Output::Replace, View::new(&a, 2, 3).t(), View::new(&b, 2, 2));
        assert_eq!(c, [3.0, 7.0, 4.5, 8.0, 6.0, 9.0]);
    }

    #[test]
    #[should_panic(expected = "inside its slice")]
    fn a_view_beyond_its_slice_is_refused() {
        View::new(&[0.0f32; 5], 2, 3);
    }
}
