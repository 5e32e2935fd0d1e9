//! The walk in f64, operation for operation OctoMap's `computeRayKeys`.
use super::{Frame, Rays, FREE, RAYS};

/// One source for all instruction sets; see [`super`].
#[inline(always)]
pub fn trace(frame: &Frame, rays: &Rays, window: &mut [u8]) {
    let last = window.len() as i32 - 1;
    let borders = frame.borders();
    for first in (0..rays.cell.len()).step_by(RAYS) {
        let (unit, length) = rays.directions(frame, first);
        let (mut t, mut dt) = ([[f64::MAX; RAYS]; 3], [[f64::MAX; RAYS]; 3]);
        let mut step = [[0i32; RAYS]; 3];
        for axis in 0..3 {
            for i in 0..RAYS {
                let u = unit[axis][i];
                let plus = u > 0.0;
                let border = if plus {
                    borders[axis][1]
                } else {
                    borders[axis][0]
                };
                if plus | (u < 0.0) {
                    t[axis][i] = border / u;
                    dt[axis][i] = frame.resolution / u.abs();
                }
                let stride = frame.strides[axis];
                step[axis][i] = if plus { stride } else { -stride };
            }
        }
        let mut end = [0; RAYS];
        end.copy_from_slice(&rays.cell[first..first + RAYS]);
        let mut cell = [last; RAYS];
        let (mut active, mut exit) = ([false; RAYS], [0.0; RAYS]);
        for i in 0..RAYS {
            // A ray that ends in the sensor's voxel passes no other.
            active[i] = frame.start_cell != end[i];
            cell[i] = if active[i] { frame.start_cell } else { last };
            exit[i] = least(t[0][i], t[1][i], t[2][i]);
        }
        while active.contains(&true) {
            for cell in cell {
                // SAFETY: within the window, which is not empty.
                unsafe {
                    *window.get_unchecked_mut((cell as u32).min(last as u32) as usize) = FREE
                };
            }
            for i in 0..RAYS {
                // The least of the three in the order z, y, x is OctoMap's choice: x if t0 < t1 and t0 < t2, else y if t1 < t2,
                // else z.
                let z = t[2][i] == exit[i];
                let y = !z & (t[1][i] == exit[i]);
                let x = !(y | z);
                t[0][i] = if x { t[0][i] + dt[0][i] } else { t[0][i] };
                t[1][i] = if y { t[1][i] + dt[1][i] } else { t[1][i] };
                t[2][i] = if z { t[2][i] + dt[2][i] } else { t[2][i] };
                let along = if x { step[0][i] } else { step[1][i] };
                let next = cell[i].wrapping_add(if z { step[2][i] } else { along });
                exit[i] = least(t[0][i], t[1][i], t[2][i]);
                active[i] &= (next != end[i]) & (exit[i] <= f64::from(length[i]));
                cell[i] = if active[i] { next } else { cell[i] };
            }
        }
    }
}

#[inline(always)]
fn least(x: f64, y: f64, z: f64) -> f64 {
    let lower = if x < y { x } else { y };
    if lower < z {
        lower
    } else {
        z
    }
}
