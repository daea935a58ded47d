//! The nonlinear values of a page, and how they may be varied.

/// The kind of a nonlinear value, and with that how it may be varied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NonlinearParameter {
    /// In s, above 0: between the spacing of the rows and three times the longest record.
    TimeConstant,
    /// The same while it falls: also within a factor of five of the one while it rises.
    FallingTimeConstant,
    /// In mm, above 0: between the spacing of the positions and most of the travel.
    Period,
    /// In s, above 0: between the spacing of the rows and a third of the record.
    TimePeriod,
    /// The same of an instrument's reading, without a bound.
    ReadingPeriod,
    /// A position in mm.
    Origin,
    /// In s: up to a tenth of the longest record; below 0 only with a second clock.
    Shift,
    /// In s, above 0: how late a thermometer is, up to a tenth of the longest record.
    ThermometerDelay,
    /// In µm, inside the range of the prediction.
    Limit,
    /// A time in s. It is searched, not fitted.
    Instant,
    /// The value of a column from which a line begins, within [`FitSpec::nonlinear_parameter_bounds`](super::FitSpec::nonlinear_parameter_bounds).
    Bend,
}

impl NonlinearParameter {
    /// Returns whether it is varied by ratios.
    #[must_use]
    pub fn is_log_scaled(self) -> bool {
        matches!(
            self,
            Self::TimeConstant
                | Self::FallingTimeConstant
                | Self::ThermometerDelay
                | Self::Period
                | Self::TimePeriod
                | Self::ReadingPeriod
        )
    }
}
