//! Every input, every way to fail, every state: after how long it is reported, as what, which quality follows, and how
//! far the offset was from that of a bridge without the fault meanwhile. The table is kept in `docs/fault-matrix.md`.

use std::{env, fmt::Write as _, fs, path::Path};

use crate::{
    emergencies,
    rig::{Kind, Part, Rig},
};

/// A fault lasts for so long in the matrix.
const LASTS_MS: u32 = 10_000;

const PARTS: [(Part, &str); 7] = [
    (Part::Sensor, "sensor"),
    (Part::SpindleThermometer, "spindle thermometer"),
    (Part::AxisThermometer, "axis thermometer"),
    (Part::Position, "`Position`"),
    (Part::Control, "`Control`"),
    (Part::Speed, "`Spindle`"),
    (Part::Blocks, "blocks of samples"),
];

#[derive(Clone, Copy)]
enum State {
    Restarted,
    Off,
    Live,
    FallBack,
}

const STATES: [(State, &str); 4] = [
    (State::Restarted, "restarted, never engaged"),
    (State::Off, "not engaged"),
    (State::Live, "live"),
    (State::FallBack, "on the temperature model"),
];

impl State {
    fn rig(self) -> Rig {
        let mut rig = match self {
            Self::Restarted => {
                let mut rig = Rig::new(1);
                rig.run(3_500);
                rig
            }
            _ => Rig::engaged(1),
        };
        match self {
            Self::Off => rig.engage = false,
            Self::FallBack => rig.blind = true,
            _ => {}
        }
        rig.run(2_000);
        rig.emergencies.clear();
        rig
    }
}

/// Why a fault is none of this input.
fn has_no_meaning(part: Part, kind: Kind) -> Option<&'static str> {
    match (part, kind) {
        (Part::Control, Kind::Bias | Kind::Drift) => Some("bits have no size"),
        (Part::Blocks, Kind::Stuck | Kind::Garbage | Kind::Bias | Kind::Drift) => {
            Some("as of the sensor")
        }
        _ => None,
    }
}

fn cell(part: Part, kind: Kind, state: State) -> String {
    if let Some(why) = has_no_meaning(part, kind) {
        return why.into();
    }
    let (mut sound, mut broken) = (state.rig(), state.rig());
    let before = broken.last.quality;
    broken.fault = Some((part, kind, broken.ms + 1));
    let began = broken.ms;
    let (mut worst_nm, mut changed) = (0, None);
    for _ in 0..LASTS_MS {
        sound.live();
        broken.live();
        let off = sound.applied_nm().into_iter().zip(broken.applied_nm());
        worst_nm = off.map(|(a, b)| a.abs_diff(b)).fold(worst_nm, u32::max);
        if broken.last.quality != before {
            changed.get_or_insert(broken.ms - began);
        }
    }
    let first = broken.emergencies.first().map(|(ms, fault)| (ms - began, format!("`{fault:?}`")));
    let found = match (first, changed) {
        (Some((reported, name)), None) => format!("{reported} ms {name}"),
        (Some((reported, name)), Some(at)) => format!("{} ms {name}", reported.min(at)),
        (None, Some(at)) => format!("{at} ms by its quality"),
        (None, None) => "not detected".into(),
    };
    let quality = broken.last.quality as u8;
    format!("{found}; {quality}; {:.1} µm", f64::from(worst_nm) / 1_000.0)
}

const HEAD: &str = "# Fault matrix

For each input that fails, in every state, the table says what a bridge does. The first entry is the number of
milliseconds until the fault is reported, and the emergency. The second is the quality after 10 s of the fault. The
third is the largest difference, in these 10 s, from the offset of a bridge without the fault. It is on X or Z, with a
slew limit of 20 µm/s; where no offset is available, it is from 0. Made and compared by a test:
`TRUEUP_WRITE_MATRIX=1 cargo test -p trueup-node --test faults matrix -- --ignored` writes it.

The machine has a spindle with a sensor, a thermometer (4 µm/K) and a warm-up model, one after the other. X has a
thermometer (2 µm/K) and a table (20 µm/m), and is on its way at up to 3.8 m/min. *Off* is a cable pulled or a sender
that is silent. *Open* and *short* are the wires (of a CAN frame: none comes). *Bias* is 10 µm, 5 K, 10 mm, 120 r/min.
*Drift* is that much a minute (of the speed 10 r/min a second). *Slow* is a lag of 5 s or a frame every 400 ms,
*delayed* is 1 s. *Intermittent* is gone for 30 of 200 ms, 300 of 1000 ms, or every second frame.

**Not detectable.** A bias of a sensor, or a slow drift of an input that nothing else watches, looks like the machine
itself. Its whole size is the error: the sensor's 1 : 1, a thermometer's times its law (µm/K), a position's times the
slope of its tables. If you need more, watch with a second source. A thermometer that changes faster than its mass can
is not believed until it has stayed within the limit for 60 s. The limit is 10 K/min here. One that stops is found
after 40 s, longer than here, if its noise is half a step or more and another one goes on. A sensor that jumps by more
than 3.9 µm in 50 µs (before its low-pass: by some 30 µm) is reported, and believed. A position that its axis cannot
have reached since the last is not believed until three more have followed from it. The limit is its rapid traverse,
here 6 m/min. One that a CNC sends wrong but within reach is the CNC's word. The offset follows it at the slew limit
and within the largest offset.

";

fn matrix() -> String {
    let mut text = HEAD.to_string();
    text += "| input | fault |";
    STATES.iter().for_each(|(_, name)| write!(text, " {name} |").expect("a string"));
    text += "\n|---|---|---|---|---|---|\n";
    for (part, name) in PARTS {
        for kind in Kind::ALL {
            let fault = format!("{kind:?}").to_lowercase();
            write!(text, "| {name} | {fault} |").expect("a string");
            for (state, _) in STATES {
                write!(text, " {} |", cell(part, kind, state)).expect("a string");
            }
            text += "\n";
        }
    }
    text += "\n## Every fault and its emergency\nFrom the moment at which a master can read the fault from an object.\n\n";
    text += &emergencies::list();
    text
}

#[test]
#[ignore = "long: 280 faults of ten seconds"]
fn the_matrix_of_faults_is_what_the_bridge_does() {
    let made = matrix();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/fault-matrix.md");
    if env::var_os("TRUEUP_WRITE_MATRIX").is_some() {
        fs::write(&path, &made).expect("the folder of the documents");
    }
    let stored = fs::read_to_string(&path).expect("docs/fault-matrix.md");
    for (stored, made) in stored.lines().zip(made.lines()) {
        assert_eq!(stored, made, "write it again: TRUEUP_WRITE_MATRIX=1");
    }
    assert_eq!(stored.lines().count(), made.lines().count());
}

#[test]
fn a_dead_input_is_reported_and_moves_little_while_a_bias_is_followed_and_reported() {
    let seen = |part, kind, state| cell(part, kind, state);
    let cable = seen(Part::Sensor, Kind::Off, State::Live);
    assert!(cable.contains("`Sensor`; 2; 0.") || cable.contains("`Sensor`; 2; 1."), "{cable}");
    let silent = seen(Part::Control, Kind::Off, State::Live);
    assert!(silent.contains("`CncLost`") || silent.contains("quality"), "{silent}");
    let bias = seen(Part::AxisThermometer, Kind::Bias, State::Live);
    assert!(bias.contains("`TemperatureRate4`; 4; 0."), "{bias}");
    let drift = seen(Part::AxisThermometer, Kind::Drift, State::Live);
    assert_eq!(drift, "not detected; 1; 1.5 µm");
    let gone = seen(Part::AxisThermometer, Kind::Open, State::Live);
    assert!(gone.contains("`Thermometer4`"), "{gone}");
}
