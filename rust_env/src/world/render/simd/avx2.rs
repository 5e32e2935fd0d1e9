//! 8 lanes in one AVX register, 16 in two.
use super::{Kernel, Lanes, Simd};
use std::arch::x86_64::*;

/// Proof that the processor has avx2, fma, bmi1, bmi2, lzcnt, popcnt.
#[derive(Clone, Copy)]
pub struct Avx2(());

impl Avx2 {
    #[inline]
    pub fn detect() -> Option<Self> {
        // The standard library caches the answer; this is a load and a test.
        (std::arch::is_x86_feature_detected!("avx2")
            && std::arch::is_x86_feature_detected!("fma")
            && std::arch::is_x86_feature_detected!("bmi1")
            && std::arch::is_x86_feature_detected!("bmi2")
            && std::arch::is_x86_feature_detected!("lzcnt")
            && std::arch::is_x86_feature_detected!("popcnt"))
        .then_some(Self(()))
    }

    /// The features of AVX-512 kernels include those of AVX2.
    #[inline(always)]
    pub(super) fn implied_by(_: super::avx512::Avx512) -> Self {
        Self(())
    }

    #[inline]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
        fn with_features<K: Kernel>(token: Avx2, kernel: K) -> K::Output {
            kernel.run(token)
        }
        // SAFETY: the token proves the features.
        unsafe { with_features(self, kernel) }
    }
}

impl Simd for Avx2 {
    type F = __m256;
    type M = __m256;
    const LANES: usize = 8;

    #[inline(always)]
    fn splat(self, x: f32) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_set1_ps(x) }
    }
    #[inline(always)]
    fn load(self, from: &[f32]) -> __m256 {
        let from = &from[..8];
        // SAFETY: as everywhere here the token proves the instructions; the slice holds 8 floats, alignment is not required.
        unsafe { _mm256_loadu_ps(from.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, a: __m256, to: &mut [f32]) {
        let to = &mut to[..8];
        // SAFETY: as everywhere here the token proves the instructions; the slice holds 8 floats, alignment is not required.
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), a) }
    }
    #[inline(always)]
    fn add(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_add_ps(a, b) }
    }
    #[inline(always)]
    fn sub(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_sub_ps(a, b) }
    }
    #[inline(always)]
    fn mul(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_mul_ps(a, b) }
    }
    #[inline(always)]
    fn div(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_div_ps(a, b) }
    }
    #[inline(always)]
    fn min(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_min_ps(a, b) }
    }
    #[inline(always)]
    fn max(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_max_ps(a, b) }
    }
    #[inline(always)]
    fn mul_add(self, a: __m256, b: __m256, c: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_fmadd_ps(a, b, c) }
    }
    #[inline(always)]
    fn mul_sub(self, a: __m256, b: __m256, c: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_fmsub_ps(a, b, c) }
    }
    #[inline(always)]
    fn sqrt(self, a: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_sqrt_ps(a) }
    }
    #[inline(always)]
    fn floor(self, a: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_floor_ps(a) }
    }
    #[inline(always)]
    fn ceil(self, a: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_ceil_ps(a) }
    }
    #[inline(always)]
    fn le(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_cmp_ps::<_CMP_LE_OQ>(a, b) }
    }
    #[inline(always)]
    fn lt(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(a, b) }
    }
    #[inline(always)]
    fn and(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_and_ps(a, b) }
    }
    #[inline(always)]
    fn or(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_or_ps(a, b) }
    }
    #[inline(always)]
    fn select(self, mask: __m256, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_blendv_ps(b, a, mask) }
    }
    #[inline(always)]
    fn bits(self, mask: __m256) -> u32 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe { _mm256_movemask_ps(mask) as u32 }
    }
    #[inline(always)]
    fn reduce_min(self, a: __m256) -> f32 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe {
            let r = _mm256_min_ps(a, _mm256_permute2f128_ps::<1>(a, a));
            let r = _mm256_min_ps(r, _mm256_shuffle_ps::<0x4e>(r, r));
            _mm256_cvtss_f32(_mm256_min_ps(r, _mm256_shuffle_ps::<0xb1>(r, r)))
        }
    }
    #[inline(always)]
    fn reduce_max(self, a: __m256) -> f32 {
        // SAFETY: a token exists only where the processor has these instructions.
        unsafe {
            let r = _mm256_max_ps(a, _mm256_permute2f128_ps::<1>(a, a));
            let r = _mm256_max_ps(r, _mm256_shuffle_ps::<0x4e>(r, r));
            _mm256_cvtss_f32(_mm256_max_ps(r, _mm256_shuffle_ps::<0xb1>(r, r)))
        }
    }
}

/// Twice the lanes of `S`.
#[derive(Clone, Copy)]
pub struct Pair<S>(S);

impl<S: Simd> Simd for Pair<S> {
    type F = (S::F, S::F);
    type M = (S::M, S::M);
    const LANES: usize = 2 * S::LANES;

    #[inline(always)]
    fn splat(self, x: f32) -> Self::F {
        (self.0.splat(x), self.0.splat(x))
    }
    #[inline(always)]
    fn load(self, from: &[f32]) -> Self::F {
        (self.0.load(from), self.0.load(&from[S::LANES..]))
    }
    #[inline(always)]
    fn store(self, a: Self::F, to: &mut [f32]) {
        self.0.store(a.0, to);
        self.0.store(a.1, &mut to[S::LANES..]);
    }
    #[inline(always)]
    fn add(self, a: Self::F, b: Self::F) -> Self::F {
        (self.0.add(a.0, b.0), self.0.add(a.1, b.1))
    }
    #[inline(always)]
    fn sub(self, a: Self::F, b: Self::F) -> Self::F {
        (self.0.sub(a.0, b.0), self.0.sub(a.1, b.1))
    }
    #[inline(always)]
    fn mul(self, a: Self::F, b: Self::F) -> Self::F {
        (self.0.mul(a.0, b.0), self.0.mul(a.1, b.1))
    }
    #[inline(always)]
    fn div(self, a: Self::F, b: Self::F) -> Self::F {
        (self.0.div(a.0, b.0), self.0.div(a.1, b.1))
    }
    #[inline(always)]
    fn min(self, a: Self::F, b: Self::F) -> Self::F {
        (self.0.min(a.0, b.0), self.0.min(a.1, b.1))
    }
    #[inline(always)]
    fn max(self, a: Self::F, b: Self::F) -> Self::F {
        (self.0.max(a.0, b.0), self.0.max(a.1, b.1))
    }
    #[inline(always)]
    fn le(self, a: Self::F, b: Self::F) -> Self::M {
        (self.0.le(a.0, b.0), self.0.le(a.1, b.1))
    }
    #[inline(always)]
    fn lt(self, a: Self::F, b: Self::F) -> Self::M {
        (self.0.lt(a.0, b.0), self.0.lt(a.1, b.1))
    }
    #[inline(always)]
    fn and(self, a: Self::M, b: Self::M) -> Self::M {
        (self.0.and(a.0, b.0), self.0.and(a.1, b.1))
    }
    #[inline(always)]
    fn or(self, a: Self::M, b: Self::M) -> Self::M {
        (self.0.or(a.0, b.0), self.0.or(a.1, b.1))
    }
    #[inline(always)]
    fn mul_add(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F {
        (self.0.mul_add(a.0, b.0, c.0), self.0.mul_add(a.1, b.1, c.1))
    }
    #[inline(always)]
    fn mul_sub(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F {
        (self.0.mul_sub(a.0, b.0, c.0), self.0.mul_sub(a.1, b.1, c.1))
    }
    #[inline(always)]
    fn sqrt(self, a: Self::F) -> Self::F {
        (self.0.sqrt(a.0), self.0.sqrt(a.1))
    }
    #[inline(always)]
    fn floor(self, a: Self::F) -> Self::F {
        (self.0.floor(a.0), self.0.floor(a.1))
    }
    #[inline(always)]
    fn ceil(self, a: Self::F) -> Self::F {
        (self.0.ceil(a.0), self.0.ceil(a.1))
    }
    #[inline(always)]
    fn select(self, mask: Self::M, a: Self::F, b: Self::F) -> Self::F {
        (
            self.0.select(mask.0, a.0, b.0),
            self.0.select(mask.1, a.1, b.1),
        )
    }
    #[inline(always)]
    fn bits(self, mask: Self::M) -> u32 {
        self.0.bits(mask.0) | self.0.bits(mask.1) << S::LANES
    }
    #[inline(always)]
    fn reduce_min(self, a: Self::F) -> f32 {
        self.0.reduce_min(self.0.min(a.0, a.1))
    }
    #[inline(always)]
    fn reduce_max(self, a: Self::F) -> f32 {
        self.0.reduce_max(self.0.max(a.0, a.1))
    }
}

impl Lanes for Avx2 {
    type S8 = Avx2;
    type S16 = Pair<Avx2>;
    #[inline(always)]
    fn s8(self) -> Avx2 {
        self
    }
    #[inline(always)]
    fn s16(self) -> Pair<Avx2> {
        Pair(self)
    }
}
