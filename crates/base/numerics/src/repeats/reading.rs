//! A reading at a place; which stops are the same place, and of which cycle each is.

/// One reading. All numbers count from 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RepeatReading {
    /// The place that is meant to be the same.
    pub place: usize,
    /// From which side the place was approached: 0 or 1.
    pub side: usize,
    /// The cycle: places come again from one to the next.
    pub cycle: usize,
    /// The value that was read; all of one unit.
    pub value: f64,
}

/// Returns the cycle of each stop, a place and a side, in the order in which they came: the j-th arrival at a
/// place from a side is of cycle j, from 0.
///
/// ```
/// let there_and_back_twice = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0), (1, 0), (1, 1), (0, 1)];
/// let cycles = trueup_numerics::repeats::cycle_numbers(&there_and_back_twice);
/// assert_eq!(cycles, [0, 0, 0, 0, 1, 1, 1, 1]);
/// ```
#[must_use]
pub fn cycle_numbers(stops: &[(usize, usize)]) -> Vec<usize> {
    let places = stops.iter().map(|stop| stop.0 + 1).max().unwrap_or(0);
    let mut counts = vec![[0; 2]; places];
    let mut cycle_of = |&(place, side): &(usize, usize)| {
        let count = &mut counts[place][side.min(1)];
        *count += 1;
        *count - 1
    };
    stops.iter().map(&mut cycle_of).collect()
}

/// Positions nearer to each other than this share of the smallest step are one place.
///
/// Source: ISO 230-2 lets a target differ from an even grid by up to 30 % of the step; a position that is
/// meant to be the same is nearer by far, and a tenth lies between.
pub const POSITION_TOLERANCE_PER_STEP: f64 = 0.1;

/// Returns the places that `positions` are meant to be, rising, and the place of each position. `step` is the
/// smallest that was meant, in the same unit; 0: only equal positions are one place.
#[must_use]
pub fn group_positions(positions: &[f64], step: f64) -> (Vec<f64>, Vec<usize>) {
    let mut order: Vec<usize> = (0..positions.len()).collect();
    order.sort_by(|&a, &b| positions[a].total_cmp(&positions[b]));
    let mut place_of = vec![0; positions.len()];
    // The first of a place, the sum of what the others are beyond it, and their number.
    let mut groups: Vec<(f64, f64, f64)> = Vec::new();
    for row in order {
        let position = positions[row];
        match groups.last_mut() {
            Some((first, sum, count))
                if position - *first <= POSITION_TOLERANCE_PER_STEP * step =>
            {
                *sum += position - *first;
                *count += 1.0;
            }
            _ => groups.push((position, 0.0, 1.0)),
        }
        place_of[row] = groups.len() - 1;
    }
    (groups.into_iter().map(|(first, sum, count)| first + sum / count).collect(), place_of)
}
