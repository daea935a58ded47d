use super::*;
use trueup_core::{
    bridge::TickInput,
    cnc::Control,
    design_parameters::CODES_PER_TICK,
    thermometer::RawTemperatureReading,
    units::{AdcCode, Rpm},
};
use trueup_link::frames;
use trueup_machine::{RunFile, compile};
use trueup_node::node::{Interface, Node};

/// A spindle whose sensor drifts with its own temperature by 0.2 µm/°C.
const DRIFTING: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n\
    [inputs]\nsensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }\n\
    temp_coil_c = { channel = 0, kind = \"pt100\" }\n\
    [spindle]\nsource = \"sensor\"\n\
    [spindle.sensor]\nk0_um = 0.0\nzero_counts = 5048.0\num_per_count = 0.0152587890625\n\
    temperature = \"temp_coil_c\"\n\
    [[term]]\nquantity = \"elongation\"\ncause = \"sensor-temperature-drift\"\n\
    column = \"temp_coil_c\"\num_per_c = 0.2\nreference_c = 20.0\n";

#[test]
fn the_counts_of_a_sensor_with_a_temperature_are_those_that_the_board_was_given() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("m.toml");
    fs::write(&path, DRIFTING).expect("a folder of ours");
    let machine = MachineFile::read(&path).expect("right");
    let compiled = compile(&machine).expect("it fits");
    let mut node = Node::new(compiled.calibration().into());
    let log = folder.path().join("run.log");
    let mut recorder = Recorder::create(&log, Some(&path), "can0", None).expect("a new file");

    // On average 100.5 codes of 12 bits above the zero of 631, so 804 counts and 12.27 µm.
    let codes: [AdcCode; CODES_PER_TICK] = std::array::from_fn(|n| AdcCode(731 + (n % 2) as u16));
    let mut temperatures = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
    // A PT100 at 30 °C: 100·(1 + 3.9083·10⁻³·30 − 5.775·10⁻⁷·30²) Ω.
    temperatures[0] = RawTemperatureReading(111_672_925);
    for ms in 0..3_000_u32 {
        if ms % 20 == 0 {
            let engaged = Control { engage: ms >= 60, ..Control::REFERENCED };
            let control = frames::encode_control(engaged, (ms / 20) as u8);
            node.receive(Interface::Can, &control).expect("in order");
        }
        let input = TickInput {
            codes: Some(&codes),
            speed: Some(Rpm(24_000)),
            temperatures: Some(&temperatures),
        };
        let at = UNIX_EPOCH + Duration::from_millis(ms.into());
        for frame in node.tick(1, input).into_iter().chain(node.next_service_frame()) {
            recorder.receive(&frame, at).expect("the disk is not full");
        }
    }
    recorder.flush().expect("the disk is not full");

    let run = RunFile::read(&log.with_extension("csv")).expect("a run file");
    let last = |name: &str| *run.column(name).expect(name).last().expect("a row");
    let [counts, offset_um, coil_c] = ["sensor_counts", "offset_z_um", "temp_coil_c"].map(last);
    println!("{counts} counts, {offset_um} µm, {coil_c} °C");
    // A nanometre on the wire is 0.066 counts.
    assert!((counts - 5852.0).abs() < 0.1, "{counts} counts");
    assert!((coil_c - 30.0).abs() < 0.011, "{coil_c} °C");
    // The drift is in the offsets: 12.27 + 0.2·(30 − 20) µm.
    assert!((offset_um - 14.27).abs() < 0.011, "{offset_um} µm");
}

#[test]
fn the_last_readings_are_undone_one_after_the_other() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    let mut recorder =
        Recorder::create(&path, None, "can0", Some(Quantity::Dz)).expect("a new file");
    let mut node = Node::new(trueup_node::configuration::NodeConfiguration::default());
    for ms in 0..2_000_u32 {
        // A reading each half second; the last but one was a slip, and so was the one that waits.
        if ms % 500 == 250 {
            recorder.record_gauge_reading(f64::from(ms) / 100.0);
        }
        if ms == 1_400 {
            assert_eq!(recorder.gauge_reading_count(), 3);
            assert_eq!(recorder.undo_gauge_reading().expect("the disk is not full"), Some(12.5));
        }
        for frame in node.tick(1, TickInput::default()) {
            let at = UNIX_EPOCH + Duration::from_millis(ms.into());
            recorder.receive(&frame, at).expect("the disk is not full");
        }
    }
    recorder.record_gauge_reading(99.0);
    assert_eq!(recorder.undo_gauge_reading().expect("the disk is not full"), Some(99.0));
    recorder.flush().expect("the disk is not full");
    assert_eq!(recorder.gauge_reading_count(), 3);
    let run = RunFile::read(&path).expect("a run file, with its log beside it");
    let read = run.column("measured_dz_um").expect("the gauge's column").iter();
    let read: Vec<f64> = read.copied().filter(|um| !um.is_nan()).collect();
    assert_eq!((read, run.row_count() as u64), (vec![2.5, 7.5, 17.5], recorder.row_count()));
    assert!(path.with_extension("log").exists());
}

#[test]
fn without_a_law_on_the_board_the_elongation_itself_is_written_down() {
    let column = |text: &str| {
        let machine = MachineFile::parse(text, Path::new("m.toml")).expect("right");
        MachineColumns::from_machine(&machine).header().split(',').nth(8).map(str::to_owned)
    };
    assert_eq!(column(DRIFTING).as_deref(), Some("sensor_counts"));
    // The board would tell 0 µm for ever.
    let unused = DRIFTING.replace("source = \"sensor\"\n", "");
    let unused = unused.split("[[term]]").next().expect("what is before it");
    assert_eq!(column(unused).as_deref(), Some("elongation_um"));
}

#[test]
fn a_recording_that_cannot_begin_is_for_the_user_to_mend() {
    let folder = tempfile::tempdir().expect("a folder");
    let begin = |name: &str| Recorder::create(&folder.path().join(name), None, "can0", None);
    begin("here").expect("a new folder");
    for (name, phrase) in [
        ("here", "bridge.log: the recording cannot be created: another one is there"),
        ("here/bridge.csv", "bridge.log: the recording cannot be created: "),
        ("none/run.log", "run.log: the recording cannot be created: "),
    ] {
        let error = begin(name).err().expect("it is in the way");
        assert!(
            error.is::<UnusableInputError>() && error.to_string().contains(phrase),
            "{error:#}"
        );
    }
}

#[test]
fn a_line_of_the_log_is_candumps() {
    let at = UNIX_EPOCH + Duration::from_micros(1_436_509_052_249_713);
    let frame = Frame::new(0x181, &[0x8B, 0xCB, 0, 0x11]).expect("short");
    assert_eq!(format_candump_line("can0", &frame, at), "(1436509052.249713) can0 181#8BCB0011");
    let empty = Frame::new(0x001, &[]).expect("short");
    assert_eq!(format_candump_line("vcan1", &empty, UNIX_EPOCH), "(0000000000.000000) vcan1 001#");
}

#[test]
fn the_clock_counts_lost_cycles_and_whole_rounds_of_the_counter() {
    let mut clock = BridgeClock::default();
    let mut at = UNIX_EPOCH;
    for (counter, after_ms, ms) in
        [(250, 0, 0), (251, 1, 1), (251, 0, 1), (5, 3, 11), (6, 1_025, 1_036), (6, 2_560, 3_596)]
    {
        at += Duration::from_millis(after_ms);
        clock.update(counter, at);
        assert_eq!(clock.ms, ms, "counter {counter}");
    }
}
