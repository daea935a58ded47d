//! Physical faults of a machine, and how large each is at a size of 1.
//!
//! A size is above 0. The effect of a fault grows with it, in proportion or nearly so; a direction that can
//! be either is drawn with the machine.

macro_rules! faults {
    ($($(#[doc = $doc:literal])+ $variant:ident = $name:literal;)*) => {
        /// A physical fault.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum PhysicalFault {
            $($(#[doc = $doc])+ $variant,)*
        }

        impl PhysicalFault {
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
    /// The displacement sensor shows more or less than 1 µm of 1 µm: a factor of e^(±0.1·size).
    SensorGain = "sensor-gain";
    /// The displacement sensor's reading follows the temperature of its coil: ±0.1·size µm/K.
    CoilTemperature = "coil-temperature";
    /// Tool and holder beyond the sensor warm up and grow, where the
    /// sensor cannot see them: 50 mm · size of steel.
    UnseenHolder = "unseen-holder";
    /// The spindle gives way to the axial cutting force: 5 nm/N · size.
    AxialStiffness = "axial-stiffness";
    /// The shaft grows with the square of the speed, at once: 10 nm · size at 1000 r/min.
    SpeedGrowth = "speed-growth";
    /// Each tool grows with the square of the speed by a coefficient of its own: 10 nm · size at
    /// 1000 r/min, a share of that, back, or not at all.
    ToolGrowth = "tool-growth";
    /// Tool and holder come cold out of the magazine at each change, and warm behind the nose: 50 mm · size
    /// of steel.
    ColdTool = "cold-tool";
    /// Less coolant flows along the housing: it takes less heat away,
    /// the conductances times e^(−0.2·size).
    LostCooling = "lost-cooling";
    /// The air of the room is not held at its temperature: it swings by 1 K · size over the day, and
    /// wanders by half of that.
    Room = "room";
    /// The friction of the nut heats the screw: 0.2 K · size at 1 m/min.
    ScrewHeating = "screw-heating";
    /// An axis is mounted out of square with another one: ±10 µm/m · size.
    Mounting = "mounting";
    /// The nut is worn: it has a play, which may be larger at one end: 2 µm · size in the
    /// middle.
    Wear = "wear";
    /// The thermometer of a scale hangs in the air next to it, in a room that swings by
    /// 1 K · size.
    MisplacedThermometer = "misplaced-thermometer";
    /// The gauge that measures the machine drifts: ±1 µm/h · size.
    GaugeDrift = "gauge-drift";
}
