//! Causes that may be hidden in a challenge.

/// Where a challenge's believed model stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BaseModel {
    /// Elongation, source sensor.
    Sensor,
    /// Elongation, source temperature.
    Temperature,
    /// Elongation, source warm-up.
    Warmup,
    /// An axis through heat-up and cool-down.
    AxisThermal,
    /// An axis, many positions in both directions.
    AxisGeometry,
}

macro_rules! causes {
    ($($(#[$doc:meta])* $variant:ident = $name:literal, $expected:ident, [$($base:ident),+];)+) => {
        /// A cause that may be hidden: every cause of the diagnosis' table, nothing but noise, and effects
        /// that have no name there.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum HiddenCause { $($(#[$doc])* $variant,)+ }

        impl HiddenCause {
            /// All of them.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// Returns the name in the table of causes; names that are not there begin with `clean` or
            /// `unnamed`.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)+ }
            }

            /// Returns the name by which a diagnosis should call it: that in the table of causes, which
            /// `unnamed-abbe` was given after its draws were.
            #[must_use]
            pub fn expected_name(self) -> &'static str {
                match self {
                    Self::Abbe => Self::AngularError.name(),
                    Self::DriftByRun => Self::Drift.name(),
                    other => other.name(),
                }
            }

            /// Returns the columns on which an effect without a name depends.
            #[must_use]
            pub fn unnamed_effect_inputs(self) -> &'static [&'static str] {
                match self {
                    Self::PreloadChange | Self::CriticalSpeed => &["spindle_rpm"],
                    _ => &[],
                }
            }

            /// Returns what a diagnosis should make of it.
            #[must_use]
            pub fn expected_diagnosis(self) -> ExpectedDiagnosis {
                match self { $(Self::$variant => ExpectedDiagnosis::$expected,)+ }
            }

            /// Returns the bases in which it can be distinguished from all others.
            pub(super) fn base_models(self) -> &'static [BaseModel] {
                match self { $(Self::$variant => &[$(BaseModel::$base),+],)+ }
            }
        }
    };
}

/// The answer expected from a diagnosis of a challenge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExpectedDiagnosis {
    /// Verdict `clean`: there is nothing but noise.
    Clean,
    /// The cause named and claimed, and compensated.
    Compensated,
    /// The cause named and claimed, but nothing that a board may correct.
    Reported,
    /// Structure without a name: `unexplained`, or a term that helps but not all is explained.
    Unnamed,
}

causes! {
    /// White noise alone: rows are independent.
    CleanWhite = "clean-white", Clean, [Sensor, Temperature, Warmup, AxisThermal, AxisGeometry];
    /// Noise with a memory, a correlation of 0.5 to 0.97 from row to row.
    CleanCorrelated = "clean-correlated", Clean, [Sensor, Temperature, Warmup, AxisThermal, AxisGeometry];
    /// p + o: a constant offset o in µm.
    SensorOffset = "sensor-offset", Compensated, [Sensor];
    /// g·p: the sensor shows the growth with a gain g, 1 is right.
    SensorGain = "sensor-gain", Compensated, [Sensor];
    /// p + c·p²: c in 1/µm.
    SensorCurvature = "sensor-curvature", Compensated, [Sensor];
    /// min(p, limit): the sensor shows no more than a limit in µm.
    SensorSaturation = "sensor-saturation", Compensated, [Sensor];
    /// p + c·(T − T_ref), T the sensor's own temperature.
    SensorTemperatureDrift = "sensor-temperature-drift", Compensated, [Sensor];
    /// p(t − shift), linear between rows.
    TimeShift = "time-shift", Reported, [Sensor];
    /// p from the lagged column.
    ThermalLag = "thermal-lag", Compensated, [Temperature, AxisThermal];
    /// p + a·(1 − e^(−t/τ)), or p + c·(lag_τ(T) − T_ref) of the column in use.
    SlowMode = "slow-mode", Compensated, [Sensor, Temperature];
    /// p + c·(lag_τ(T) − T_ref) of a column that is not in use; τ may be 0.
    ExtraHeatPath = "extra-heat-path", Compensated, [Sensor, Temperature, Warmup];
    /// s·p: the growth is a factor s of what is believed.
    GrowthAmplitude = "growth-amplitude", Compensated, [Temperature, Warmup];
    /// Another time constant of the warm-up.
    GrowthRate = "growth-rate", Compensated, [Warmup];
    /// Another time constant while it falls.
    CoolingAsymmetry = "cooling-asymmetry", Compensated, [Temperature, Warmup];
    /// Another slope of an axis over its temperature.
    ExpansionSlope = "expansion-slope", Compensated, [AxisThermal];
    /// The temperature at which an axis is right is another one.
    ReferenceTemperature = "reference-temperature", Compensated, [AxisThermal];
    /// p + c·(n/1000)²: n in r/min, c in µm.
    CentrifugalGrowth = "centrifugal-growth", Compensated, [Sensor, Temperature, Warmup];
    /// p − c·load: the load in N pushes the tool back, c in µm/N.
    CuttingLoad = "cutting-load", Compensated, [Sensor, Temperature, Warmup];
    /// p + c·P/1000: the position P in mm, c in µm/m.
    PitchScale = "pitch-scale", Compensated, [AxisGeometry];
    /// A table of errors, one per direction.
    PitchError = "pitch-error", Compensated, [AxisGeometry];
    /// p + a·sin(2πP/L + φ), with a second harmonic in half of the draws.
    PitchPeriodic = "pitch-periodic", Compensated, [AxisGeometry];
    /// p + w where d < 0: the axis came from above, the width w in µm.
    Backlash = "backlash", Compensated, [AxisGeometry];
    /// p + c·P/1000 where d < 0: a width that changes along the axis by c in µm/m.
    PositionDependentBacklash = "position-dependent-backlash", Compensated, [AxisGeometry];
    /// p + w(F) where d < 0: a width for each feed F at which positions are approached.
    FeedDependentBacklash = "feed-dependent-backlash", Compensated, [AxisGeometry];
    /// p + a smooth curve over the position of another axis, its best straight line taken out.
    Straightness = "straightness", Compensated, [AxisGeometry];
    /// p + c·P_other/1000: the position of another axis in mm, c in µm/m.
    CrossAxis = "cross-axis", Compensated, [AxisGeometry];
    /// p + c·x of a pressure x, or p + a while a switch is closed: a column that no law reads.
    Dependence = "dependence", Reported, [Sensor, Temperature];
    /// p + s from an instant on, s in µm.
    Step = "step", Reported, [Sensor, Temperature, AxisGeometry];
    /// p + c·t/3600: the time t in s, c in µm/h.
    Drift = "drift", Reported, [Sensor, AxisGeometry];
    /// A few rows that are grossly wrong.
    Outliers = "outliers", Reported, [Sensor, Temperature, Warmup, AxisThermal, AxisGeometry];
    /// p + c·(lag_τ(T) − T_ref)·(P − P₀)/1000 of an axis whose machine file has no thermal law.
    AxisExpansion = "axis-expansion", Compensated, [AxisGeometry];
    /// Another constant of an axis over its temperature: all of it shifts, wherever it stands.
    ExpansionConstant = "expansion-constant", Compensated, [AxisThermal];
    /// The thermometer that the growth is believed by follows its part by a lag.
    ThermometerLag = "thermometer-lag", Reported, [Temperature];
    /// `drift` where the time was not recorded: p + c·run, c in µm.
    DriftByRun = "drift-by-run", Reported, [AxisGeometry];
    /// p + θ(P)·(L − L₀)/1000: the axis tilts along its travel P, by θ in µrad, and the tool is off by
    /// the tilt times its lever L along another axis. θ is a line or a smooth curve.
    AngularError = "angular-error", Compensated, [AxisGeometry];
    /// An error that is periodic in what the reference instrument reads.
    ReferenceInstrument = "reference-instrument", Reported, [Sensor, AxisGeometry];
    /// After a reversal the axis takes up its backlash over a way, not at once.
    PreSliding = "unnamed-pre-sliding", Unnamed, [AxisGeometry];
    /// Above a speed the preload is another one, and with it the growth.
    PreloadChange = "unnamed-preload-change", Unnamed, [Sensor, Temperature];
    /// `angular-error` as older score cards drew it, when it had no name: θ a smooth curve, L₀ = 0.
    Abbe = "unnamed-abbe", Compensated, [AxisGeometry];
    /// The shaft bows under its unbalance, outwards below a critical speed and inwards above it.
    CriticalSpeed = "unnamed-critical-speed", Unnamed, [Sensor, Temperature];
    /// p + a·sin(2πt/L + φ): an input that was not recorded switches with the clock.
    PeriodicInTime = "periodic-in-time", Reported, [Sensor, Temperature];
}
