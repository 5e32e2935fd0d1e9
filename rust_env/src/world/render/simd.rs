//! Vectors of 8 and 16 floats for the ray kernels, one implementation per instruction set.
//!
//! A kernel is written once against [`Simd`] and run through [`Isa::run`], which compiles it once for each
//! instruction set (everything below `run` is inlined into one function with the right target features).
//! The values of `Simd` types are tokens: they can only be had where the processor has the instructions.
//!
//! Kernels use no closures (nor `array::map`, `from_fn`, `fold`): a closure is a function of its own, which does not get
//! the target features of the function that it is written in unless it happens to be inlined there.
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod portable;

pub use portable::Portable;

use crate::instructions::{widest, Instructions};

/// Lanes of `f32`. Comparisons are ordered (false for NaN); `min` and `max` return `b` if `a` or `b` is NaN.
pub trait Simd: Copy {
    type F: Copy;
    type M: Copy;
    const LANES: usize;

    fn splat(self, x: f32) -> Self::F;
    /// The first `LANES` values; panics if there are fewer.
    fn load(self, from: &[f32]) -> Self::F;
    fn store(self, a: Self::F, to: &mut [f32]);
    fn add(self, a: Self::F, b: Self::F) -> Self::F;
    fn sub(self, a: Self::F, b: Self::F) -> Self::F;
    fn mul(self, a: Self::F, b: Self::F) -> Self::F;
    fn div(self, a: Self::F, b: Self::F) -> Self::F;
    fn min(self, a: Self::F, b: Self::F) -> Self::F;
    fn max(self, a: Self::F, b: Self::F) -> Self::F;
    /// a * b + c, rounded once or twice.
    fn mul_add(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F;
    /// a * b - c, rounded once or twice.
    fn mul_sub(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F;
    fn sqrt(self, a: Self::F) -> Self::F;
    fn floor(self, a: Self::F) -> Self::F;
    fn ceil(self, a: Self::F) -> Self::F;
    fn le(self, a: Self::F, b: Self::F) -> Self::M;
    fn lt(self, a: Self::F, b: Self::F) -> Self::M;
    fn and(self, a: Self::M, b: Self::M) -> Self::M;
    fn or(self, a: Self::M, b: Self::M) -> Self::M;
    /// `a` where the mask is set, else `b`.
    fn select(self, mask: Self::M, a: Self::F, b: Self::F) -> Self::F;
    /// Bit i = lane i.
    fn bits(self, mask: Self::M) -> u32;
    fn reduce_min(self, a: Self::F) -> f32;
    fn reduce_max(self, a: Self::F) -> f32;

    #[inline(always)]
    fn zero(self) -> Self::F {
        self.splat(0.0)
    }
    #[inline(always)]
    fn ge(self, a: Self::F, b: Self::F) -> Self::M {
        self.le(b, a)
    }
    #[inline(always)]
    fn gt(self, a: Self::F, b: Self::F) -> Self::M {
        self.lt(b, a)
    }
    #[inline(always)]
    fn cross(self, a: [Self::F; 3], b: [Self::F; 3]) -> [Self::F; 3] {
        [
            self.mul_sub(a[1], b[2], self.mul(a[2], b[1])),
            self.mul_sub(a[2], b[0], self.mul(a[0], b[2])),
            self.mul_sub(a[0], b[1], self.mul(a[1], b[0])),
        ]
    }
    #[inline(always)]
    fn dot(self, a: [Self::F; 3], b: [Self::F; 3]) -> Self::F {
        self.mul_add(a[2], b[2], self.mul_add(a[1], b[1], self.mul(a[0], b[0])))
    }
    #[inline(always)]
    fn sub3(self, a: [Self::F; 3], b: [Self::F; 3]) -> [Self::F; 3] {
        [
            self.sub(a[0], b[0]),
            self.sub(a[1], b[1]),
            self.sub(a[2], b[2]),
        ]
    }
    #[inline(always)]
    fn add3(self, a: [Self::F; 3], b: [Self::F; 3]) -> [Self::F; 3] {
        [
            self.add(a[0], b[0]),
            self.add(a[1], b[1]),
            self.add(a[2], b[2]),
        ]
    }
    /// x, y and z of `LANES` vectors.
    #[inline(always)]
    fn load3<const N: usize>(self, from: &[[f32; N]; 3]) -> [Self::F; 3] {
        [
            self.load(&from[0]),
            self.load(&from[1]),
            self.load(&from[2]),
        ]
    }
    #[inline(always)]
    fn store3<const N: usize>(self, a: [Self::F; 3], to: &mut [[f32; N]; 3]) {
        self.store(a[0], &mut to[0]);
        self.store(a[1], &mut to[1]);
        self.store(a[2], &mut to[2]);
    }
    /// One of 8 vectors in all lanes.
    #[inline(always)]
    fn splat3_of(self, vectors: &[[f32; 8]; 3], lane: usize) -> [Self::F; 3] {
        [
            self.splat(vectors[0][lane]),
            self.splat(vectors[1][lane]),
            self.splat(vectors[2][lane]),
        ]
    }
    #[inline(always)]
    fn splat3(self, a: [f32; 3]) -> [Self::F; 3] {
        [self.splat(a[0]), self.splat(a[1]), self.splat(a[2])]
    }
}

/// A matching pair of 8-lane and 16-lane vectors.
pub trait Lanes: Copy {
    type S8: Simd;
    type S16: Simd;
    fn s8(self) -> Self::S8;
    fn s16(self) -> Self::S16;
}

/// Work that is compiled once per instruction set. Implementations of `run` must be `#[inline(always)]`.
pub trait Kernel {
    type Output;
    fn run<L: Lanes>(self, lanes: L) -> Self::Output;
}

/// The instruction sets that kernels are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Isa {
    Portable,
    Avx2,
    Avx512,
}

impl Isa {
    /// What this processor can run, the fastest last.
    pub fn available() -> Vec<Isa> {
        let mut all = vec![Isa::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            if avx2::Avx2::detect().is_some() {
                all.push(Isa::Avx2);
            }
            if avx512::Avx512::detect().is_some() {
                all.push(Isa::Avx512);
            }
        }
        all
    }

    /// The fastest that may be used, see [`crate::instructions`].
    pub fn best() -> Isa {
        let allowed = |isa: &Isa| match isa {
            Isa::Portable => true,
            Isa::Avx2 => widest() >= Instructions::Avx2,
            Isa::Avx512 => widest() >= Instructions::Avx512,
        };
        let all = Self::available().into_iter();
        all.rev().find(allowed).unwrap_or(Isa::Portable)
    }

    /// Runs `kernel` with this instruction set, or with the portable code if the processor lacks it.
    #[inline]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        #[cfg(target_arch = "x86_64")]
        match self {
            Isa::Avx512 => {
                if let Some(token) = avx512::Avx512::detect() {
                    return token.run(kernel);
                }
            }
            Isa::Avx2 => {
                if let Some(token) = avx2::Avx2::detect() {
                    return token.run(kernel);
                }
            }
            Isa::Portable => {}
        }
        kernel.run(Portable::<8>)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every operation of every instruction set against plain scalar code, NaN and infinities included.
    struct Compare;
    impl Kernel for Compare {
        type Output = ();
        #[inline(always)]
        fn run<L: Lanes>(self, lanes: L) {
            check(lanes.s8());
            check(lanes.s16());
        }
    }

    #[inline(always)]
    fn check<S: Simd>(s: S) {
        let special = [
            0.0,
            -0.0,
            1.5,
            -2.25,
            7.75,
            -3.5,
            f32::INFINITY,
            f32::NEG_INFINITY,
            f32::NAN,
            1e-3,
            4.0,
            -8.5,
            0.3,
            2.0,
            9.0,
            -1.0,
        ];
        for shift in 0..16 {
            let x: Vec<f32> = (0..16).map(|i| special[i]).collect();
            let y: Vec<f32> = (0..16).map(|i| special[(i + shift) % 16]).collect();
            let (a, b) = (s.load(&x), s.load(&y));
            let same = |got: S::F, want: &dyn Fn(f32, f32) -> f32, name: &str| {
                let mut out = [0.0; 16];
                s.store(got, &mut out);
                for i in 0..S::LANES {
                    let w = want(x[i], y[i]);
                    assert!(
                        out[i] == w
                            || (out[i].is_nan() && w.is_nan())
                            || (out[i] - w).abs() <= 1e-6 * w.abs(),
                        "{name}({}, {}) = {}, expected {w}",
                        x[i],
                        y[i],
                        out[i]
                    );
                }
            };
            same(s.add(a, b), &|p, q| p + q, "add");
            same(s.sub(a, b), &|p, q| p - q, "sub");
            same(s.mul(a, b), &|p, q| p * q, "mul");
            same(s.div(a, b), &|p, q| p / q, "div");
            same(s.min(a, b), &|p, q| if p < q { p } else { q }, "min");
            same(s.max(a, b), &|p, q| if p > q { p } else { q }, "max");
            same(
                s.mul_add(a, b, s.splat(2.0)),
                &|p, q| p * q + 2.0,
                "mul_add",
            );
            same(
                s.mul_sub(a, b, s.splat(2.0)),
                &|p, q| p * q - 2.0,
                "mul_sub",
            );
            same(s.sqrt(a), &|p, _| p.sqrt(), "sqrt");
            same(s.floor(a), &|p, _| p.floor(), "floor");
            same(s.ceil(a), &|p, _| p.ceil(), "ceil");
            let mask = s.lt(a, b);
            same(
                s.select(mask, a, b),
                &|p, q| if p < q { p } else { q },
                "select",
            );
            let bits = |m: S::M, want: &dyn Fn(f32, f32) -> bool| {
                for i in 0..S::LANES {
                    assert_eq!(s.bits(m) >> i & 1 == 1, want(x[i], y[i]));
                }
                assert_eq!(u64::from(s.bits(m)) >> S::LANES, 0);
            };
            bits(mask, &|p, q| p < q);
            bits(s.le(a, b), &|p, q| p <= q);
            bits(s.and(s.le(a, b), s.ge(a, s.zero())), &|p, q| {
                p <= q && p >= 0.0
            });
            bits(s.or(s.gt(a, b), s.ge(a, s.zero())), &|p, q| {
                p > q || p >= 0.0
            });
        }
        let plain: Vec<f32> = (0..16).map(|i| ((i * 7) % 16) as f32 - 5.0).collect();
        let all = &plain[..S::LANES];
        assert_eq!(
            s.reduce_min(s.load(&plain)),
            all.iter().copied().fold(f32::INFINITY, f32::min)
        );
        assert_eq!(
            s.reduce_max(s.load(&plain)),
            all.iter().copied().fold(f32::NEG_INFINITY, f32::max)
        );
    }

    #[test]
    fn every_instruction_set_computes_the_same() {
        for isa in Isa::available() {
            eprintln!("checking {isa:?}");
            isa.run(Compare);
        }
    }
}
