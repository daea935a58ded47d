use std::path::Path;

use ratatui::{Terminal, backend::TestBackend, style::Color};
use trueup_core::{
    bridge::TickInput,
    cnc::Control,
    design_parameters::{CODES_PER_TICK, TEMPERATURE_CHANNEL_COUNT},
    thermometer::RawTemperatureReading,
    units::{AdcCode, Rpm},
};
use trueup_link::frames;
use trueup_machine::{MachineFile, compile, machine_file::Quantity};
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface as NodeLine, Node},
};

use super::*;
use crate::{
    compensation_model::CompensationModel,
    state::{ModelSource, PressedKey, ScreenAction},
};

/// A spindle whose sensor has a thermometer of its own, and which heats X.
const MACHINE: &str = "[machine]\nname = \"lathe 7\"\nkind = \"3-axis\"\n\
    [inputs]\nsensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }\n\
    temp_coil_c = { channel = 0, kind = \"pt100\" }\n\
    [spindle]\nsource = \"sensor\"\n\
    [spindle.sensor]\nk0_um = 0.0\nzero_counts = 5048.0\num_per_count = 0.0152587890625\n\
    [axis.x.thermal]\nsensor = \"temp_coil_c\"\nreference_c = 20.0\nconstant_um_per_c = 0.5\nmode = \"constant\"\n";

/// Returns what a screen knows after `ms` of a bridge whose sensor gives `code`, engaged if requested.
fn watched(ms: u32, code: u16, engage: bool) -> ScreenState {
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("right");
    let compiled = compile(&machine).expect("it fits");
    let blob = compiled.blob();
    let mut node = Node::new(NodeConfiguration { blob, ..compiled.calibration().into() });
    let mut state = ScreenState::new("tcp:bridge:3333", Quantity::Elongation, false);
    state.link = LinkState::Up;
    state.laws = Some(CompensationModel::from_machine(machine));
    state.source = ModelSource::File("m.toml".into());
    let codes: [AdcCode; CODES_PER_TICK] = std::array::from_fn(|n| AdcCode(code + (n % 2) as u16));
    let mut temperatures = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
    // A PT100 at 30 °C: 100·(1 + 3.9083·10⁻³·30 − 5.775·10⁻⁷·30²) Ω.
    temperatures[0] = RawTemperatureReading(111_672_925);
    for now in 0..ms {
        if now % 20 == 0 {
            let control = Control { engage: engage && now >= 60, ..Control::REFERENCED };
            let control = frames::encode_control(control, (now / 20) as u8);
            node.receive(NodeLine::Can, &control).expect("in order");
        }
        let input = TickInput {
            codes: Some(&codes),
            speed: Some(Rpm(24_000)),
            temperatures: Some(&temperatures),
        };
        for frame in node.tick(1, input).into_iter().chain(node.next_service_frame()) {
            state.receive(&frame, f64::from(now) / 1_000.0);
        }
        if now % 200 == 199 {
            state.sample_live_values(f64::from(now) / 1_000.0);
        }
    }
    state
}

fn screen(state: &ScreenState, (width, height): (u16, u16), has_colour: bool) -> (String, bool) {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("it has no device");
    terminal.draw(|frame| draw(frame, state, Theme { has_colour })).expect("it has no device");
    let buffer = terminal.backend().buffer();
    let is_coloured = buffer.content.iter().any(|cell| cell.fg != Color::Reset);
    let rows = buffer.content.chunks(width.into());
    let text = rows.map(|row| row.iter().map(|cell| cell.symbol()).collect::<String>() + "\n");
    (text.collect(), is_coloured)
}

fn has(text: &str, phrases: &[&str]) {
    for phrase in phrases {
        assert!(text.contains(phrase), "{phrase} is missing:\n{text}");
    }
}

#[test]
fn at_three_sizes_the_number_the_finger_moves_stands_on_the_screen() {
    // 100.5 codes above the zero of 631: 12.27 µm, at 1.7860 V; 0.5 µm/K · 10 K against X.
    let state = watched(4_000, 731, true);
    for size in [(80, 24), (120, 40), (60, 15)] {
        let (text, _) = screen(&state, size, false);
        println!("{text}");
        has(
            &text,
            &[
                "lathe 7",
                "LIVE  every input is fresh",
                "Growth",
                "+12.27 µm",
                "1.7859 V",
                "731.50 codes",
                "given to the CNC      -5.00      +0.00     +12.27",
                "coil 30.00 °C",
                "No faults",
                "q quit",
                "nothing is engaged",
            ],
        );
    }
    let (text, _) = screen(&state, (80, 24), false);
    has(
        &text,
        &[
            "spindle growth        +0.00      +0.00     +12.27",
            "axis heat             -5.00      +0.00      +0.00",
            "rest                  +0.00      +0.00      +0.00",
            "growth, µm, the last",
            "crc 0, sequence 0, malformed 0, lost 0",
        ],
    );
}

#[test]
fn a_pushed_target_moves_volts_and_growth() {
    let before = watched(4_000, 731, false);
    let after = watched(4_000, 741, false);
    let (text, _) = screen(&before, (80, 24), false);
    has(&text, &["restarted: engage anew", "+12.27 µm"]);
    let (text, _) = screen(&after, (80, 24), false);
    // Ten codes are 80 counts: 1.22 µm, 24 mV.
    has(&text, &["+13.49 µm", "1.8103 V", "741.50 codes"]);
}

#[test]
fn a_fault_stands_there_with_its_remedy_at_every_size_and_without_colour() {
    // At 0 V the sensor is out of its range, or its cable off.
    let state = watched(4_000, 0, true);
    for size in [(80, 24), (120, 40), (60, 15)] {
        let (text, is_coloured) = screen(&state, size, false);
        assert!(!is_coloured, "no colour was allowed");
        has(&text, &["gives no reading", "sensor: out of range or stuck"]);
    }
    assert!(screen(&state, (80, 24), true).1, "with colours it has some");
}

#[test]
fn silence_is_reported_and_not_shown_as_the_last_offset() {
    let mut state = watched(4_000, 731, true);
    state.link = LinkState::Down("the bridge has closed the line".into());
    state.sample_live_values(6.0);
    let (text, _) = screen(&state, (80, 24), false);
    has(&text, &["NO OFFSETS COME for 2 s", "line down, trying again: the bridge has closed"]);
    // The last ones stand there as what they are.
    has(
        &text,
        &["given to the CNC       none", "2 s ago               -5.00      +0.00     +12.27"],
    );
    assert!(!text.contains("given to the CNC      -5.00"), "{text}");
}

#[test]
fn what_is_old_is_grey_and_has_its_age() {
    let mut state = watched(4_000, 731, true);
    state.sample_live_values(15.0);
    let old = [
        "NO OFFSETS COME for 11 s",
        "Growth    +12.27 µm (1",
        "coil 30.00 °C (1",
        "No report of faults is received",
        "11 s ago              -5.00",
    ];
    for size in [(80, 24), (60, 20)] {
        has(&screen(&state, size, false).0, &old);
    }
    let mut terminal = Terminal::new(TestBackend::new(80, 24)).expect("it has no device");
    let theme = Theme { has_colour: false };
    terminal.draw(|frame| draw(frame, &state, theme)).expect("it has no device");
    let buffer = terminal.backend().buffer();
    let row = |text: &str| {
        let row = buffer.content.chunks(80).find(|row| {
            row.iter().map(ratatui::buffer::Cell::symbol).collect::<String>().contains(text)
        });
        row.unwrap_or_else(|| panic!("{text} is missing"))
    };
    for text in ["coil 30.00", "ago              -5.00"] {
        assert!(row(text)[0].modifier.contains(Modifier::DIM), "{text} is not grey");
    }
    assert!(screen(&state, (80, 24), false).0.contains("axis heat                 ?"));
    let mut fault = watched(4_000, 0, true);
    fault.sample_live_values(15.0);
    has(&screen(&fault, (80, 24), false).0, &["As it was 1", "sensor: out of range or stuck"]);
    // The trend does not go on with it.
    let growth = state.trend.series(0);
    assert!(growth.iter().all(|(at_s, _)| *at_s < -8.0), "{growth:?}");
}

#[test]
fn a_bridge_that_waits_for_engage_has_no_fault() {
    let state = watched(4_000, 731, false);
    for size in [(80, 24), (60, 20)] {
        let (text, _) = screen(&state, size, false);
        has(&text, &["WAITING  for Engage: off at the CNC, then on", "restarted: engage anew"]);
        assert!(!text.contains("FAULT"), "{text}");
    }
    // A sensor that is lost is one.
    has(&screen(&watched(4_000, 0, true), (80, 24), false).0, &["sensor: out of range or stuck"]);
}

#[test]
fn at_60_by_20_nothing_essential_is_cut() {
    let mut state = watched(4_000, 731, true);
    state.recording = Some("bridge-20261126T060000".into());
    state.set_recording_counts(2, 12_345);
    state.gauge.latest = Some((14.0, 4.0));
    state.gauge.connection_error = None;
    let (text, _) = screen(&state, (60, 20), false);
    println!("{text}");
    has(
        &text,
        &[
            "lathe 7, calibration ",
            " of m.toml",
            "tcp:bridge:3333",
            "REC  bridge-20261126T060000  12345 rows  2 readings",
            "LIVE  every input is fresh, age",
            "noise 0.",
            "gauge elongation +14.00 µm",
            "given to the CNC      -5.00      +0.00     +12.27",
            "coil 30.00 °C",
            "malformed 0",
            "unpaired 0",
            "No faults",
            "r end recording",
            "u undo",
            "? help",
        ],
    );
    let crc = state.board.calibration.expect("it was received");
    has(&text, &[&format!("{crc:08x}")]);
}

#[test]
fn volts_of_a_boards_own_calibration_are_marked_as_nominal() {
    let mut state = watched(4_000, 731, true);
    assert!(!screen(&state, (80, 24), false).0.contains("nominal"));
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("right");
    state.laws = CompensationModel::from_board_blob(compile(&machine).expect("it fits").blob());
    state.source = ModelSource::Board;
    for size in [(80, 24), (60, 20)] {
        has(&screen(&state, size, false).0, &[" V nominal    731.50 codes  noise 0."]);
    }
}

#[test]
fn readings_stand_in_the_trend_and_the_last_is_undone() {
    let mut state = watched(4_000, 731, true);
    assert_eq!(state.handle_key(PressedKey::Char('u')), None);
    has(&screen(&state, (80, 24), false).0, &["no reading of the gauge is in the recording"]);
    state.recording = Some("bridge-1".into());
    for um in [14.0, 15.0] {
        state.gauge.latest = Some((um, 4.0));
        state.record_gauge_reading(um);
    }
    state.set_recording_counts(2, 40);
    state.sample_live_values(4.2);
    let (text, _) = screen(&state, (80, 30), false);
    // 4 s of record: the axis is 10 s long.
    has(&text, &["growth, µm, the last 10 s; • gauge", "-10 s", "-5 s", "now", "•", "+15.00"]);
    assert_eq!(state.handle_key(PressedKey::Char('u')), Some(ScreenAction::Unmark));
    state.undo_gauge_reading();
    state.set_recording_counts(1, 40);
    let (text, _) = screen(&state, (80, 30), false);
    assert!(!text.contains("+15.00 ┤") && text.contains("1 reading"), "{text}");
    // The last of the series: gauge minus bridge, 15 − 12.27.
    (0..8).find(|_| {
        state.handle_key(PressedKey::Char('t'));
        state.series == crate::trend::GAUGE_DIFFERENCE_INDEX
    });
    has(
        &screen(&state, (80, 30), false).0,
        &["gauge elongation minus bridge, µm, the last 10 s: +2.73"],
    );
}

#[test]
fn another_calibration_than_the_files_is_reported() {
    let mut state = watched(4_000, 731, true);
    has(&screen(&state, (80, 24), false).0, &[" of m.toml"]);
    let other = MACHINE.replace("k0_um = 0.0", "k0_um = 1.0");
    state.laws = Some(CompensationModel::from_machine(
        MachineFile::parse(&other, Path::new("m.toml")).expect("right"),
    ));
    has(&screen(&state, (80, 24), false).0, &[" NOT of m.toml"]);
}

#[test]
fn keys_record_mark_turn_the_trend_and_help() {
    let mut state = watched(4_000, 731, true);
    assert_eq!(state.handle_key(PressedKey::Char('g')), None);
    has(&screen(&state, (80, 24), false).0, &["press r first"]);
    assert_eq!(state.handle_key(PressedKey::Char('r')), Some(ScreenAction::Record));
    state.recording = Some("bridge-1".into());
    assert_eq!(state.handle_key(PressedKey::Char('g')), None);
    // In half of Europe the point is a comma.
    for key in ['-', '3', ',', '5', 'x', '1'] {
        assert_eq!(state.handle_key(PressedKey::Char(key)), None);
    }
    has(&screen(&state, (80, 24), false).0, &["measured elongation in µm: -3.51_"]);
    assert_eq!(state.handle_key(PressedKey::Backspace), None);
    assert_eq!(state.handle_key(PressedKey::Enter), Some(ScreenAction::Mark(-3.5)));
    // q is not quit while a number is typed.
    state.handle_key(PressedKey::Char('g'));
    assert_eq!(state.handle_key(PressedKey::Char('q')), None);
    assert_eq!(state.handle_key(PressedKey::Enter), None, "nothing was typed");
    has(&screen(&state, (80, 24), false).0, &["in µm: _   type the reading in µm, such as -3.5"]);
    assert_eq!(state.handle_key(PressedKey::Escape), None);
    assert_eq!(state.handle_key(PressedKey::Char('r')), Some(ScreenAction::EndRecording));

    has(&screen(&state, (80, 24), false).0, &["growth, µm, the last"]);
    state.handle_key(PressedKey::Char('t'));
    has(&screen(&state, (80, 24), false).0, &["offset of X, µm, the last"]);
    (0..3).for_each(|_| _ = state.handle_key(PressedKey::Char('t')));
    has(&screen(&state, (80, 24), false).0, &["coil, °C, the last"]);
    state.handle_key(PressedKey::Char('t'));
    has(&screen(&state, (80, 24), false).0, &["growth, µm, the last"]);

    state.handle_key(PressedKey::Char('?'));
    has(&screen(&state, (60, 15), false).0, &["quit; the bridge goes on as it was"]);
    assert_eq!(state.handle_key(PressedKey::Escape), None, "it closes the help");
    assert_eq!(
        state.handle_key(PressedKey::Escape),
        None,
        "nor does it end a recording, once too often pressed"
    );
    assert_eq!(state.handle_key(PressedKey::Char('q')), Some(ScreenAction::Quit));
    assert_eq!(state.handle_key(PressedKey::Interrupt), Some(ScreenAction::Quit));
}

#[test]
fn a_gauge_that_speaks_is_written_down_at_once_and_an_old_reading_never() {
    let mut state = watched(4_000, 731, true);
    (state.gauge.is_live, state.recording) = (true, Some("there".into()));
    assert_eq!(state.handle_gauge_reading(Ok(-2.5), 4.0), None);
    assert_eq!(state.handle_key(PressedKey::Char('g')), Some(ScreenAction::Mark(-2.5)));
    has(&screen(&state, (80, 24), false).0, &["gauge elongation -2.50 µm"]);
    state.sample_live_values(9.0);
    assert_eq!(state.handle_key(PressedKey::Char('g')), None, "it is five seconds old");
    has(&screen(&state, (80, 24), false).0, &["or press its button", "(5 s ago)"]);
    assert_eq!(state.handle_gauge_reading(Ok(-2.75), 10.0), Some(ScreenAction::Mark(-2.75)));
    assert_eq!(state.handle_gauge_reading(Err("indicator: gone".into()), 11.0), None);
    has(&screen(&state, (80, 24), false).0, &["indicator: gone"]);
}

#[test]
fn no_size_is_too_small_to_draw() {
    let mut state = watched(1_000, 0, true);
    for width in [1, 2, 7, 20, 300] {
        for height in [1, 2, 3, 5, 8, 60] {
            state.is_helping = !state.is_helping;
            screen(&state, (width, height), true);
        }
    }
}
