//! Distances to the nearest marked cell of a grid, up to a reach: one pass along each axis.

/// No marked cell within reach.
pub const FAR: u16 = u16::MAX;

/// The least sum over the axes of `cost(|step|)` from each cell of a grid (x fastest) to a cell with `marked`, where
/// `cost(0) = 0` and steps go up to `reach` along each axis; `FAR` where there is none. With `cost(k) = k * k` these
/// are squared Euclidean distances.
pub fn to_marked(
    marked: impl Iterator<Item = bool>,
    dims: [usize; 3],
    reach: usize,
    cost: impl Fn(usize) -> u16,
) -> Vec<u16> {
    let mut field: Vec<u16> = marked.map(|m| if m { 0 } else { FAR }).collect();
    let [nx, ny, nz] = dims;
    debug_assert_eq!(field.len(), nx * ny * nz);
    let mut next = field.clone();
    // Within rows, planes and the whole respectively, so that no step leaves its row.
    for (stride, period) in [(1, nx), (nx, nx * ny), (nx * ny, nx * ny * nz)] {
        if period == 0 {
            return field;
        }
        next.copy_from_slice(&field);
        for (from, to) in field.chunks(period).zip(next.chunks_mut(period)) {
            for k in 1..=reach.min((period - 1) / stride) {
                let (shift, cost) = (k * stride, cost(k));
                for (t, f) in to[shift..].iter_mut().zip(from) {
                    *t = (*t).min(f.saturating_add(cost));
                }
                for (t, f) in to.iter_mut().zip(&from[shift..]) {
                    *t = (*t).min(f.saturating_add(cost));
                }
            }
        }
        std::mem::swap(&mut field, &mut next);
    }
    field
}

/// Marks the cells whose centre is nearer than `radius` cells to a marked cell's square or cube.
pub fn inflated(marked: impl Iterator<Item = bool>, dims: [usize; 3], radius: f32) -> Vec<bool> {
    // From a cell's centre to the near face of the cell k further: k - 1/2, squared and times four: (2k - 1)^2.
    let radius = radius.clamp(0.0, 120.0);
    let limit = 4.0 * radius * radius;
    let reach = (radius + 0.5).ceil() as usize;
    let distances = to_marked(marked, dims, reach, |k| {
        ((2 * k - 1) * (2 * k - 1)).min(FAR as usize) as u16
    });
    distances
        .into_iter()
        .map(|d| d == 0 || f32::from(d) < limit)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn equals_the_search_over_all_pairs(
            dims in (1usize..9, 1usize..9, 1usize..9),
            seed in proptest::collection::vec(0usize..729, 0..12),
            reach in 0usize..6,
        ) {
            let dims = [dims.0, dims.1, dims.2];
            let n = dims[0] * dims[1] * dims[2];
            let mut marks = vec![false; n];
            for s in seed {
                marks[s % n] = true;
            }
            let at = |i: usize| [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
            let got = to_marked(marks.iter().copied(), dims, reach, |k| (k * k) as u16);
            for (i, got) in got.into_iter().enumerate() {
                let expected = (0..n)
                    .filter(|j| marks[*j])
                    .map(|j| [0, 1, 2].map(|a| at(i)[a].abs_diff(at(j)[a])))
                    .filter(|d| d.iter().all(|d| *d <= reach))
                    .map(|d| d.iter().map(|d| d * d).sum::<usize>() as u16)
                    .min();
                prop_assert_eq!(got, expected.unwrap_or(FAR));
            }
        }
    }

    #[test]
    fn inflation_reaches_cells_whose_centre_is_within_the_radius() {
        // Cell 5 of 11 in a row is marked; its faces are 0.5 cells from its centre.
        let row = |radius| {
            let grown = inflated((0..11).map(|i| i == 5), [11, 1, 1], radius);
            grown.iter().filter(|b| **b).count()
        };
        assert_eq!(row(0.0), 1);
        assert_eq!(row(0.5), 1, "the neighbours' centres are exactly 0.5 away");
        assert_eq!(row(0.6), 3);
        assert_eq!(row(2.51), 7);
    }
}
