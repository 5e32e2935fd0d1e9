//! An order of an image's pixels in which those that follow one another are neighbours: rays side by side are then about equally
//! long and often in the same voxel.

/// How far along Hilbert's curve a pixel is: pixels that follow one another are neighbours. Images have at most 2^16 pixels a side.
pub fn hilbert(mut u: usize, mut v: usize) -> u64 {
    let mut along = 0;
    for bit in (0..16).rev() {
        let side = 1usize << bit;
        let (right, below) = (u & side != 0, v & side != 0);
        along = along << 2 | (3 * u64::from(right)) ^ u64::from(below);
        // The quarters at the beginning and the end are turned.
        if !below {
            if right {
                (u, v) = (
                    side.wrapping_sub(1).wrapping_sub(u),
                    side.wrapping_sub(1).wrapping_sub(v),
                );
            }
            std::mem::swap(&mut u, &mut v);
        }
    }
    along
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_goes_from_neighbour_to_neighbour() {
        let mut pixels: Vec<_> = (0..32usize)
            .flat_map(|v| (0..32).map(move |u| (u, v)))
            .collect();
        pixels.sort_by_key(|(u, v)| hilbert(*u, *v));
        for two in pixels.windows(2) {
            let ((u, v), (a, b)) = (two[0], two[1]);
            assert_eq!(u.abs_diff(a) + v.abs_diff(b), 1, "{two:?}");
        }
    }
}
