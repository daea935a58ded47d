//! How far repeats lie apart, next to how far targets do.

/// The scatter of repeats and the shape of the means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RepeatScatter {
    /// The standard deviation of readings at one target in one direction, in µm, over all of them;
    /// `None` without repeats.
    pub repeats_um: Option<f64>,
    /// The root mean square of the means about their own mean, in µm.
    pub shape_um: f64,
    /// Readings behind a mean, on average.
    readings_a_mean: f64,
}

impl RepeatScatter {
    /// Of the readings at each target, by direction.
    pub(super) fn from_targets(by_target: &[[Vec<f64>; 2]]) -> Self {
        let groups: Vec<&Vec<f64>> =
            by_target.iter().flatten().filter(|group| !group.is_empty()).collect();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let about = |values: &[f64]| {
            let mean = mean(values);
            values.iter().map(|um| (um - mean).powi(2)).sum::<f64>()
        };
        let means: Vec<f64> = groups.iter().map(|group| mean(group)).collect();
        let readings: usize = groups.iter().map(|group| group.len()).sum();
        let freedom = readings - groups.len();
        let squares: f64 = groups.iter().map(|group| about(group)).sum();
        Self {
            repeats_um: (freedom > 0).then(|| (squares / freedom as f64).sqrt()),
            shape_um: (about(&means) / means.len() as f64).sqrt(),
            readings_a_mean: readings as f64 / groups.len() as f64,
        }
    }

    /// Returns the standard error of a mean, in µm.
    pub(super) fn standard_error_um(&self) -> Option<f64> {
        self.repeats_um.map(|um| um / self.readings_a_mean.sqrt())
    }

    /// Returns the part of the shape that the scatter of the means does not explain, in µm.
    pub(super) fn systematic_rms_um(&self) -> f64 {
        let noise = self.standard_error_um().unwrap_or(0.0);
        (self.shape_um.powi(2) - noise.powi(2)).max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeats_and_shape_are_distinguished() {
        // Means 1, 3, 5 and 7, each of two readings one off: s² = 2·4/4 = 2, the mean's s² = 1;
        // the means' mean square about 4 is 5.
        let pair = |mean: f64| vec![mean - 1.0, mean + 1.0];
        let scatter =
            RepeatScatter::from_targets(&[[pair(1.0), pair(3.0)], [pair(5.0), pair(7.0)]]);
        assert_eq!(scatter.repeats_um, Some(2_f64.sqrt()));
        assert!((scatter.shape_um - 5_f64.sqrt()).abs() < 1e-12);
        assert!((scatter.systematic_rms_um() - 2.0).abs() < 1e-12);
    }

    #[test]
    fn without_repeats_all_of_the_shape_is_taken_for_systematic() {
        let scatter = RepeatScatter::from_targets(&[[vec![1.0], vec![]], [vec![3.0], vec![]]]);
        assert_eq!((scatter.repeats_um, scatter.shape_um), (None, 1.0));
        assert_eq!(scatter.systematic_rms_um(), 1.0);
    }
}
