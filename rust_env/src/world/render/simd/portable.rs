//! Plain arrays, which the compiler vectorises as far as the target allows.
use super::{Lanes, Simd};

#[derive(Clone, Copy)]
pub struct Portable<const N: usize>;

impl<const N: usize> Portable<N> {
    #[inline(always)]
    fn zip<T>(a: [f32; N], b: [f32; N], f: impl Fn(f32, f32) -> T) -> [T; N] {
        std::array::from_fn(|i| f(a[i], b[i]))
    }
}

impl<const N: usize> Simd for Portable<N> {
    type F = [f32; N];
    type M = [bool; N];
    const LANES: usize = N;

    #[inline(always)]
    fn splat(self, x: f32) -> [f32; N] {
        [x; N]
    }
    #[inline(always)]
    fn load(self, from: &[f32]) -> [f32; N] {
        std::array::from_fn(|i| from[i])
    }
    #[inline(always)]
    fn store(self, a: [f32; N], to: &mut [f32]) {
        to[..N].copy_from_slice(&a);
    }
    #[inline(always)]
    fn add(self, a: [f32; N], b: [f32; N]) -> [f32; N] {
        Self::zip(a, b, |x, y| x + y)
    }
    #[inline(always)]
    fn sub(self, a: [f32; N], b: [f32; N]) -> [f32; N] {
        Self::zip(a, b, |x, y| x - y)
    }
    #[inline(always)]
    fn mul(self, a: [f32; N], b: [f32; N]) -> [f32; N] {
        Self::zip(a, b, |x, y| x * y)
    }
    #[inline(always)]
    fn div(self, a: [f32; N], b: [f32; N]) -> [f32; N] {
        Self::zip(a, b, |x, y| x / y)
    }
    #[inline(always)]
    fn min(self, a: [f32; N], b: [f32; N]) -> [f32; N] {
        Self::zip(a, b, |x, y| if x < y { x } else { y })
    }
    #[inline(always)]
    fn max(self, a: [f32; N], b: [f32; N]) -> [f32; N] {
        Self::zip(a, b, |x, y| if x > y { x } else { y })
    }
    #[inline(always)]
    fn mul_add(self, a: [f32; N], b: [f32; N], c: [f32; N]) -> [f32; N] {
        // Not f32::mul_add: without the FMA instruction that is a slow library call.
        std::array::from_fn(|i| a[i] * b[i] + c[i])
    }
    #[inline(always)]
    fn mul_sub(self, a: [f32; N], b: [f32; N], c: [f32; N]) -> [f32; N] {
        std::array::from_fn(|i| a[i] * b[i] - c[i])
    }
    #[inline(always)]
    fn sqrt(self, a: [f32; N]) -> [f32; N] {
        a.map(f32::sqrt)
    }
    #[inline(always)]
    fn floor(self, a: [f32; N]) -> [f32; N] {
        a.map(f32::floor)
    }
    #[inline(always)]
    fn ceil(self, a: [f32; N]) -> [f32; N] {
        a.map(f32::ceil)
    }
    #[inline(always)]
    fn le(self, a: [f32; N], b: [f32; N]) -> [bool; N] {
        Self::zip(a, b, |x, y| x <= y)
    }
    #[inline(always)]
    fn lt(self, a: [f32; N], b: [f32; N]) -> [bool; N] {
        Self::zip(a, b, |x, y| x < y)
    }
    #[inline(always)]
    fn and(self, a: [bool; N], b: [bool; N]) -> [bool; N] {
        std::array::from_fn(|i| a[i] & b[i])
    }
    #[inline(always)]
    fn or(self, a: [bool; N], b: [bool; N]) -> [bool; N] {
        std::array::from_fn(|i| a[i] | b[i])
    }
    #[inline(always)]
    fn select(self, mask: [bool; N], a: [f32; N], b: [f32; N]) -> [f32; N] {
        std::array::from_fn(|i| if mask[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    fn bits(self, mask: [bool; N]) -> u32 {
        let mut bits = 0;
        for (i, &m) in mask.iter().enumerate() {
            bits |= u32::from(m) << i;
        }
        bits
    }
    #[inline(always)]
    fn reduce_min(self, a: [f32; N]) -> f32 {
        a.into_iter()
            .fold(f32::INFINITY, |m, x| if x < m { x } else { m })
    }
    #[inline(always)]
    fn reduce_max(self, a: [f32; N]) -> f32 {
        a.into_iter()
            .fold(f32::NEG_INFINITY, |m, x| if x > m { x } else { m })
    }
}

impl Lanes for Portable<8> {
    type S8 = Portable<8>;
    type S16 = Portable<16>;
    #[inline(always)]
    fn s8(self) -> Portable<8> {
        self
    }
    #[inline(always)]
    fn s16(self) -> Portable<16> {
        Portable
    }
}
