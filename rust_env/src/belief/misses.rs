//! The commonest update of all, many voxels at a time: a miss in a voxel in which nothing was ever hit.
//!
//! Such voxels have one of few values: unknown, or what 1, 2, 3, ... misses make, down to the clamp. What a miss changes,
//! in value and in entropy, is known beforehand for each rung of this ladder; all other voxels are left to the caller.
use super::lockstep::Lanes;
use super::octree::{entropy_units, SensorModel};

/// OctoMap's model has six rungs: unknown and five misses until the clamp.
const RUNGS: usize = 8;

#[derive(Clone, Debug)]
pub struct Misses {
    lanes: Lanes,
    sensor: SensorModel,
    /// Values before and after a miss, and the change of entropy in units of 2^-32 bit.
    rungs: Vec<(f32, f32, i64)>,
}

impl Misses {
    pub fn new(lanes: Lanes, sensor: &SensorModel) -> Self {
        let mut rungs = Vec::with_capacity(RUNGS);
        // An unknown voxel stores 0 and has no entropy in the sum.
        let (mut value, mut entropy) = (0.0f32, 0);
        while sensor.miss < 0.0 && rungs.len() < RUNGS {
            let next = (value + sensor.miss).clamp(sensor.clamp_min, sensor.clamp_max);
            let after = entropy_units(next) as i64;
            rungs.push((value, next, after - entropy));
            if next == value {
                break;
            }
            (value, entropy) = (next, after);
        }
        Self {
            lanes,
            sensor: *sensor,
            rungs,
        }
    }

    pub fn lanes(&self) -> Lanes {
        self.lanes
    }

    pub fn sensor(&self) -> &SensorModel {
        &self.sensor
    }

    /// Miss voxels of a word that are unknown or free: returns those that were on the ladder (they stay or become free; the
    /// others are as they were), and the change of the sum of entropies.
    #[inline]
    pub fn apply(&self, voxels: u64, log_odds: &mut [f32; 64]) -> (u64, i64) {
        match self.lanes {
            Lanes::Scalar => (0, 0),
            // A "miss" that is none: nothing stays at the clamp.
            #[cfg(target_arch = "x86_64")]
            _ if self.rungs.is_empty() => (0, 0),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Lanes` is only made where the features were detected.
            Lanes::Avx2 => unsafe { self.apply_avx2(voxels, log_odds) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            Lanes::Avx512 => unsafe { self.apply_avx512(voxels, log_odds) },
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,popcnt")]
    fn apply_avx512(&self, voxels: u64, log_odds: &mut [f32; 64]) -> (u64, i64) {
        use std::arch::x86_64::*;
        let (mut done, mut entropy) = (0, 0);
        let clamped = _mm512_set1_ps(self.sensor.clamp_min);
        for (part, values) in log_odds.chunks_exact_mut(16).enumerate() {
            let all = (voxels >> (16 * part)) as u16;
            if all == 0 {
                continue;
            }
            // SAFETY: sixteen values.
            let old = unsafe { _mm512_loadu_ps(values.as_ptr()) };
            let mut left = all & !_mm512_cmp_ps_mask::<_CMP_EQ_OQ>(old, clamped);
            if left != 0 {
                let mut new = old;
                for (before, after, change) in &self.rungs {
                    let here =
                        _mm512_mask_cmp_ps_mask::<_CMP_EQ_OQ>(left, old, _mm512_set1_ps(*before));
                    new = _mm512_mask_mov_ps(new, here, _mm512_set1_ps(*after));
                    entropy += i64::from(here.count_ones()) * change;
                    left ^= here;
                    if left == 0 {
                        break;
                    }
                }
                // SAFETY: as above.
                unsafe { _mm512_storeu_ps(values.as_mut_ptr(), new) };
            }
            done |= u64::from(all & !left) << (16 * part);
        }
        (done, entropy)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,popcnt")]
    fn apply_avx2(&self, voxels: u64, log_odds: &mut [f32; 64]) -> (u64, i64) {
        use std::arch::x86_64::*;
        let (mut done, mut entropy) = (0, 0);
        let clamped = _mm256_set1_ps(self.sensor.clamp_min);
        let bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
        for (part, values) in log_odds.chunks_exact_mut(8).enumerate() {
            let all = (voxels >> (8 * part)) as u8;
            if all == 0 {
                continue;
            }
            let lanes = _mm256_and_si256(_mm256_set1_epi32(i32::from(all)), bit);
            let lanes = _mm256_castsi256_ps(_mm256_cmpeq_epi32(lanes, bit));
            // SAFETY: eight values.
            let old = unsafe { _mm256_loadu_ps(values.as_ptr()) };
            let still = _mm256_cmp_ps::<_CMP_EQ_OQ>(old, clamped);
            let mut left = all & !(_mm256_movemask_ps(still) as u8);
            if left != 0 {
                let mut new = old;
                for (before, after, change) in &self.rungs {
                    let equal = _mm256_cmp_ps::<_CMP_EQ_OQ>(old, _mm256_set1_ps(*before));
                    let here = _mm256_and_ps(equal, lanes);
                    new = _mm256_blendv_ps(new, _mm256_set1_ps(*after), here);
                    let here = _mm256_movemask_ps(here) as u8 & left;
                    entropy += i64::from(here.count_ones()) * change;
                    left ^= here;
                    if left == 0 {
                        break;
                    }
                }
                // SAFETY: as above.
                unsafe { _mm256_storeu_ps(values.as_mut_ptr(), new) };
            }
            done |= u64::from(all & !left) << (8 * part);
        }
        (done, entropy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn default_ladder_ends_at_the_clamp() {
        let sensor = SensorModel::default();
        let misses = Misses::new(Lanes::Scalar, &sensor);
        assert_eq!(misses.rungs.len(), 6);
        assert_eq!(misses.rungs[0].0, 0.0);
        assert_eq!(misses.rungs[5], (sensor.clamp_min, sensor.clamp_min, 0));
    }

    proptest! {
        #[test]
        fn each_voxel_changes_as_by_itself(
            voxels in any::<u64>(),
            steps in prop::collection::vec(0u8..10, 64),
            miss in prop::sample::select(vec![0.4, 0.3, 0.49, 0.01]),
        ) {
            let sensor = SensorModel::from_probabilities(0.7, miss, 0.1192, 0.971).unwrap();
            // Steps down the ladder; every tenth voxel was hit once.
            let values: Vec<f32> = steps
                .iter()
                .map(|n| (0..*n).fold(if *n == 9 { sensor.hit } else { 0.0 }, |v, _| (v + sensor.miss).max(sensor.clamp_min)))
                .collect();
            let before: [f32; 64] = values.try_into().unwrap();
            for lanes in Lanes::available() {
                let mut after = before;
                let (done, entropy) = Misses::new(lanes, &sensor).apply(voxels, &mut after);
                prop_assert_eq!(done & !voxels, 0);
                let mut sum = 0;
                for i in 0..64 {
                    let expected = if done >> i & 1 == 1 {
                        let new = (before[i] + sensor.miss).clamp(sensor.clamp_min, sensor.clamp_max);
                        sum += entropy_units(new) as i64;
                        sum -= if before[i] == 0.0 { 0 } else { entropy_units(before[i]) as i64 };
                        new
                    } else {
                        before[i]
                    };
                    prop_assert_eq!(after[i].to_bits(), expected.to_bits(), "{:?} {}", lanes, i);
                }
                prop_assert_eq!(sum, entropy, "{:?}", lanes);
                if lanes != Lanes::Scalar && miss == 0.4 {
                    let ladder = (0..64).filter(|i| steps[*i] < 9).fold(0, |m, i| m | 1u64 << i);
                    prop_assert_eq!(done & ladder, voxels & ladder);
                }
            }
        }
    }
}
