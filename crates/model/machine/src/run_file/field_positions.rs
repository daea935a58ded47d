//! At which character of its line each field of a column stands, for reports of its faults: two
//! bytes a field where lines are of usual length, as a long run has as many of them as of values.

/// The places of a column's fields, row by row, from 1.
#[derive(Clone, Debug)]
pub(super) enum FieldPositions {
    Near(Vec<u16>),
    /// As soon as one does not fit.
    Far(Vec<u32>),
}

impl FieldPositions {
    pub(super) fn new() -> Self {
        Self::Near(Vec::new())
    }

    pub(super) fn push(&mut self, place: usize) {
        // A line has less than a million characters.
        let place = u32::try_from(place).unwrap_or(u32::MAX);
        match (&mut *self, u16::try_from(place)) {
            (Self::Near(all), Ok(place)) => all.push(place),
            (Self::Near(all), Err(_)) => {
                let far = all.iter().map(|&near| near.into()).chain([place]);
                *self = Self::Far(far.collect());
            }
            (Self::Far(all), _) => all.push(place),
        }
    }

    pub(super) fn get(&self, row: usize) -> Option<usize> {
        match self {
            Self::Near(all) => all.get(row).map(|&place| place.into()),
            Self::Far(all) => all.get(row).map(|&place| place as usize),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_place_is_given_back_near_and_far() {
        let places = [1, 65_535, 65_536, 7, 1_000_000];
        let mut retained = FieldPositions::new();
        places.iter().for_each(|&place| retained.push(place));
        let back: Vec<Option<usize>> = (0..=places.len()).map(|row| retained.get(row)).collect();
        assert_eq!(back, [Some(1), Some(65_535), Some(65_536), Some(7), Some(1_000_000), None]);
    }
}
