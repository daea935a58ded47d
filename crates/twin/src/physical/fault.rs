//! What may be wrong with a machine.

macro_rules! faults {
    ($($(#[doc = $doc:literal])+ $variant:ident = $name:literal;)*) => {
        /// A physical fault.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum Fault {
            $($(#[doc = $doc])+ $variant,)*
        }

        impl Fault {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// Its name in tables: `unseen-holder`.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }
        }
    };
}

faults! {
    /// The displacement sensor shows more or less than 1 µm of 1 µm.
    SensorGain = "sensor-gain";
    /// The displacement sensor's reading follows the temperature of its coil.
    CoilTemperature = "coil-temperature";
    /// Tool and holder beyond the sensor warm up and grow, where the sensor cannot see them.
    UnseenHolder = "unseen-holder";
    /// The spindle gives way to the axial cutting force.
    AxialStiffness = "axial-stiffness";
    /// The shaft grows with the square of the speed, at once.
    SpeedGrowth = "speed-growth";
    /// Less coolant flows along the housing: it takes less heat away.
    LostCooling = "lost-cooling";
    /// The air of the room is not held at its temperature.
    Room = "room";
    /// The friction of the nut heats the screw.
    ScrewHeating = "screw-heating";
    /// An axis is mounted out of square with another one.
    Mounting = "mounting";
    /// The nut is worn: it has a play, larger where it worked most.
    Wear = "wear";
    /// The thermometer of a scale hangs in the air beside it.
    MisplacedThermometer = "misplaced-thermometer";
    /// The gauge that measures the machine drifts.
    GaugeDrift = "gauge-drift";
}
