//! The list: what goes wrong, how it is brought about, and what must become of it. Cases that fit into one life of the
//! board are one run.

use trueup_canopen::emergency::Fault;
use trueup_core::cnc::{OffsetFlags, OffsetQuality};
use trueup_link::status::{ResetReason, StateBits};

use crate::case::Case;

/// Image that runs on the chip.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Image {
    /// The one that is flashed.
    Flashed,
    /// The one that breaks on command.
    Breaking,
    /// The one that is flashed, with a calibration that is damaged.
    NoCalibration,
    /// The same, with a calibration of another schema.
    OtherSchema,
}

/// A life of the board, and the faults in it.
pub struct Run {
    pub name: &'static str,
    pub image: Image,
    pub options: &'static [&'static str],
    pub script: String,
    pub ms: u32,
    /// The bus is dead: objects are asked for over the serial line.
    pub is_serial: bool,
    /// How each is brought about, and what is expected.
    pub cases: Vec<(String, Case)>,
}

/// The word of RAM that commands the breaking image, in scripts.
const KEY: &str = "KEY";
const ENGAGED: &str = "0 flags 2\n250 flags 3\n";

fn run(name: &'static str, script: &str, ms: u32) -> Run {
    let script = format!("{ENGAGED}{script}");
    let (image, is_serial) = (Image::Flashed, false);
    Run { name, image, options: &["--bor"], script, ms, is_serial, cases: Vec::new() }
}

impl Run {
    fn case(mut self, how: &str, case: Case) -> Self {
        self.cases.push((how.into(), case));
        self
    }

    fn options(self, options: &'static [&'static str]) -> Self {
        Self { options, ..self }
    }

    fn image(self, image: Image) -> Self {
        Self { image, ..self }
    }

    fn serial(self) -> Self {
        Self { is_serial: true, ..self }
    }
}

/// Returns all of it.
pub fn runs() -> Vec<Run> {
    vec![
        tasks_that_hold_up_the_supervisor(),
        tasks_that_do_not(),
        faults_of_the_core(),
        registers(),
        image_changes(),
        ram(),
        sampling(),
        cable(),
        codes(),
        thermometers(),
        spi(),
        no_thermometer(),
        can(),
        can_floods(),
        serial(),
        serial_dma(),
        masters(),
        silent_cnc(),
        crystal_stops(),
        dead_crystal(),
        dead_pll(),
        unknown_crystal(),
        slow_lsi(),
        fast_lsi(),
        supply(),
        write_protected(),
        factory_options(),
        unusable("calibration", Image::NoCalibration, "an image whose calibration is damaged"),
        unusable("schema", Image::OtherSchema, "an image whose calibration has another schema"),
    ]
}

fn hang(task: &'static str, at: u32, within: u32) -> Case {
    Case::new("a task hangs", at, within)
        .restart(ResetReason::Watchdog)
        .task(task)
        .emergency(Fault::WatchdogReset)
}

/// At and above its priority: the watchdog bites after 104 ms at 32 kHz, and a start takes 100 ms.
fn tasks_that_hold_up_the_supervisor() -> Run {
    let tasks = [
        (2, "serial_receive"),
        (3, "sample"),
        (4, "can_receive_0"),
        (5, "can_receive_1"),
        (6, "listen"),
        (7, "supervise"),
        (8, "service"),
        (9, "transmit"),
        (12, "modbus_line"),
        (13, "modbus"),
    ];
    let mut script = String::new();
    for (at, (number, _)) in (300..).step_by(450).zip(tasks) {
        let after = at + 2;
        script += &format!("{at} poke {KEY} {number:x}\n{after} say V\\r\n{after} modbus 01\n");
    }
    let mut run = run("tasks above", &script, 300 + 450 * 10).image(Image::Breaking);
    for (at, (_, task)) in (300..).step_by(450).zip(tasks) {
        run = run.case(&format!("`{task}` never ends"), hang(task, at, 400));
    }
    run
}

/// Below it: the supervisor waits for a second.
fn tasks_that_do_not() -> Run {
    let tasks = [(10, "thermometers"), (11, "idle")];
    let mut script = String::new();
    for (at, (number, _)) in (300..).step_by(1_500).zip(tasks) {
        script += &format!("{at} poke {KEY} {number:x}\n");
    }
    let mut run = run("tasks below", &script, 300 + 1_500 * 2).image(Image::Breaking);
    for (at, (_, task)) in (300..).step_by(1_500).zip(tasks) {
        run = run.case(&format!("`{task}` never ends"), hang(task, at, 1_450));
    }
    run
}

fn faults_of_the_core() -> Run {
    use ResetReason::{HardFault, Panic, StackOverflow};
    let all = [
        (32, "a panic", "`panic!`", Panic),
        (33, "division by zero", "`udiv` by 0", HardFault),
        (34, "an address without memory", "a read of 0x3000_0000", HardFault),
        (35, "unaligned access", "`ldrd` from an odd address", HardFault),
        (36, "stack overflow", "a function that calls itself", StackOverflow),
        (37, "a null pointer", "a read of 0x10", HardFault),
        (38, "a stray write to the store", "a write to 0x0808_0000", HardFault),
        (39, "a stray write to the image", "a write to 0x0800_0000", HardFault),
        (40, "data are run", "a jump into the RAM", HardFault),
        (41, "an unknown instruction", "`udf`", HardFault),
    ];
    let mut script = String::new();
    for (at, (key, ..)) in (300..).step_by(300).zip(all) {
        script += &format!("{at} poke {KEY} {key:x}\n");
    }
    let mut run = run("core", &script, 300 + 300 * 10).image(Image::Breaking);
    for (at, (_, fault, how, reason)) in (300..).step_by(300).zip(all) {
        let case = Case::new(fault, at, 250).restart(reason).task("supervise");
        run = run.case(how, case.emergency(Fault::Stopped));
    }
    run
}

fn registers() -> Run {
    let all = [
        ("4000042c 1", "a bit of TIM3_ARR flips: the sampling rate"),
        ("40012010 1", "a bit of ADC1_SMPR2 flips: the sampling time"),
        ("40011010 2000", "a bit of USART1_CR2 flips: stop bits"),
        ("40020400 40000", "a bit of GPIOB_MODER flips: CAN's pin"),
        ("40023840 1", "a bit of RCC_APB1ENR flips: a timer's clock"),
    ];
    let mut script = String::new();
    for (at, (what, _)) in (300..).step_by(300).zip(all) {
        script += &format!("{at} poke {what}\n");
    }
    let mut run = run("registers", &script, 300 + 300 * all.len() as u32);
    for (at, (_, how)) in (300..).step_by(300).zip(all) {
        let case = Case::new("a register changes", at, 250).restart(ResetReason::Registers);
        run = run.case(how, case.task("supervise").emergency(Fault::Stopped));
    }
    run
}

fn image_changes() -> Run {
    // A vector that nothing uses, so that no code is another one. Its turn, once in 1.4 s, was just over: the next one finds it.
    run("image", "400 poke 0800013c 10\n", 3_300).case(
        "a bit of the flash flips",
        Case::new("the image changes", 400, 2_800)
            .quality(OffsetQuality::Fault)
            .state(StateBits::SELF_TEST_FAILED)
            .emergency(Fault::SelfTest),
    )
}

fn ram() -> Run {
    let damaged = Case::new("the RAM is damaged", 0, 300).quality(OffsetQuality::Fault);
    let options = &["--bor", "--ram-stuck", "20012340"];
    let emergency = damaged.state(StateBits::SELF_TEST_FAILED).emergency(Fault::SelfTest);
    run("ram", "", 600).options(options).case("a bit that is always 1", emergency)
}

fn sampling() -> Run {
    let script = "700 adc_overrun\n1000 dma_error 0\n1300 adc_stall\n1600 noise 0\n";
    let lost = |fault, at| {
        Case::new(fault, at, 40)
            .quality(OffsetQuality::TemperatureModel)
            .flag(OffsetFlags::SAMPLES_MISSING, "samples missing")
            .emergency(Fault::SamplesMissing)
    };
    run("sampling", script, 2_000)
        .case("OVR is set", lost("the converter is overrun", 700))
        .case("a transfer error of the stream", lost("the DMA of the converter fails", 1_000))
        .case("it converts no more", lost("the converter stalls", 1_300))
        .case(
            "the same code for ever",
            Case::new("the sensor is stuck", 1_600, 400)
                .quality(OffsetQuality::TemperatureModel)
                .flag(OffsetFlags::SENSOR_FAULT, "sensor")
                .emergency(Fault::Sensor),
        )
}

fn cable() -> Run {
    let off = |fault, at| {
        Case::new(fault, at, 300)
            .quality(OffsetQuality::TemperatureModel)
            .flag(OffsetFlags::SENSOR_FAULT, "sensor")
            .emergency(Fault::Sensor)
    };
    run("cable", "700 pattern 0\n900 pattern\n2300 pattern 4095\n", 2_600)
        .case("the input at 0 V", off("the sensor's cable is off", 700))
        .case("the input at its end", off("the sensor's cable is short to the supply", 2_300))
}

fn codes() -> Run {
    let garbage = Case::new("the sensor's codes are garbage", 1_300, 100)
        .quality(OffsetQuality::TemperatureModel)
        .flag(OffsetFlags::SENSOR_FAULT, "sensor")
        .emergency(Fault::Sensor);
    let jumps = Case::new("the sensor jumps", 700, 100)
        .state(StateBits::SENSOR_ANOMALOUS)
        .emergency(Fault::SensorOdd);
    run("codes", "700 code 1000\n1300 noise 1500\n", 1_700)
        .case("another level from one code to the next, and it stays", jumps)
        .case("anything from one code to the next", garbage)
}

/// The sensor goes on; what would take its place has gone.
fn dead_source(fault: &'static str, at: u32, within: u32) -> Case {
    Case::new(fault, at, within).state(StateBits::SOURCE_DEAD).emergency(Fault::SourceDead)
}

fn thermometers() -> Run {
    let dead = |fault, at| dead_source(fault, at, 600);
    run("thermometers", "800 rtd 0 open\n1600 rtd 0 20\n2400 rtd 0 short\n", 3_200)
        .case("its wire is off", dead("a thermometer is open", 800))
        .case("its wires touch", dead("a thermometer is short", 2_400))
}

fn spi() -> Run {
    run("spi", "800 miso 0\n", 2_200)
        .case("MISO is low for ever", dead_source("the thermometers' bus is stuck", 800, 1_200))
}

fn no_thermometer() -> Run {
    let missing =
        dead_source("the thermometers are missing", 0, 1_400).quality(OffsetQuality::Live);
    run("no thermometer", "", 1_800)
        .options(&["--bor", "--rtds", "0"])
        .case("none is fitted", missing)
}

fn can() -> Run {
    // The CNC is on the bus alone, and is lost with it.
    let lost = |fault, at| Case::new(fault, at, 500).quality(OffsetQuality::Hold);
    let script = "200 say S8\\rO\\r\n500 alone 1\n1000 alone 0\n1500 flags 2\n1700 flags 3\n2000 short 1\n2600 short 0\n3100 flags 2\n3300 flags 3\n3600 stuck 1\n";
    run("can", script, 4_300)
        .serial()
        .case(
            "nobody acknowledges",
            lost("the bus has no partner", 500)
                .state(StateBits::CAN_ERROR_PASSIVE)
                .emergency(Fault::CanPassive),
        )
        .case(
            "every frame is destroyed",
            lost("the bus is short", 2_000).state(StateBits::CAN_BUS_OFF).emergency(Fault::CanOff),
        )
        .case(
            "the bus is dominant for ever",
            lost("the bus is stuck", 3_600).state(StateBits::CAN_BUS_OFF).emergency(Fault::CanOff),
        )
}

fn can_floods() -> Run {
    let script = "400 flood foreign 6\n700 flood none 0\n900 flood forged 6\n1200 flood none 0\n";
    run("can floods", script, 1_300)
        .case("6 frames of strangers a ms", Case::new("the bus is flooded", 400, 300))
        .case(
            "6 frames a ms with the CNC's identifiers and wrong checksums",
            Case::new("the bus is flooded with forged frames", 900, 300)
                .quality(OffsetQuality::Hold)
                .flag(OffsetFlags::CNC_LOST, "CNC lost")
                .emergency(Fault::CncLost),
        )
}

fn serial() -> Run {
    let script = "300 say S8\\rO\\r\n400 serial_flood noise\n600 serial_flood off\n700 say VVVVVVVV\\r\n700 serial_error break 8\n800 say VVVVVVVV\\r\n800 serial_error framing 8\n900 say VVVVVVVV\\r\n900 serial_error noise 8\n1000 serial_flood V\\r\n2400 serial_flood off\n";
    run("serial", script, 2_500)
        .case("random bytes at the line's rate", Case::new("noise on the serial line", 400, 200))
        .case("8 breaks", Case::new("breaks on the serial line", 700, 90))
        .case("8 bytes without a stop bit", Case::new("framing errors on the serial line", 800, 90))
        .case("8 bytes with the noise flag", Case::new("noisy bytes on the serial line", 900, 90))
        .case(
            "`V` at the line's rate for 1.4 s, longer than any task may wait",
            Case::new("the serial line is flooded", 1_000, 1_400),
        )
}

fn serial_dma() -> Run {
    run("serial dma", "300 say S8\\rO\\r\n", 700)
        .options(&["--bor", "--serial-dma-stuck"])
        .case("its streams do not move", Case::new("the DMA of the serial line is dead", 300, 300))
}

fn masters() -> Run {
    run("masters", "400 control2 20\n400 flags2 2\n", 700).case(
        "another `Control`",
        Case::new("a second master", 400, 190)
            .state(StateBits::SECOND_MASTER)
            .emergency(Fault::SecondMaster),
    )
}

fn silent_cnc() -> Run {
    run("silent cnc", "700 control 0\n", 1_100).case(
        "no `Control`",
        Case::new("the CNC falls silent", 700, 300)
            .quality(OffsetQuality::Hold)
            .flag(OffsetFlags::CNC_LOST, "CNC lost")
            .emergency(Fault::CncLost),
    )
}

fn crystal_stops() -> Run {
    run("crystal stops", "200 say S8\\rO\\r\n500 hse 0\n700 say S8\\rO\\r\n", 1_200).serial().case(
        "no more edges",
        Case::new("the crystal stops", 500, 600)
            .restart(ResetReason::Crystal)
            .flag(OffsetFlags::BOARD_DEGRADED, "board degraded")
            .state(StateBits::FALLBACK_CLOCK)
            .history(Fault::Crystal),
    )
}

fn without_can(name: &'static str, options: &'static [&'static str], case: Case, how: &str) -> Run {
    let case = case
        .quality(OffsetQuality::Fault)
        .flag(OffsetFlags::BOARD_DEGRADED, "board degraded")
        .state(StateBits::FALLBACK_CLOCK);
    run(name, "55 say S8\\rO\\r\n150 say S8\\rO\\r\n", 700)
        .serial()
        .options(options)
        .case(how, case)
}

fn dead_crystal() -> Run {
    let case = Case::new("the crystal is dead", 0, 500).history(Fault::Crystal);
    without_can("dead crystal", &["--bor", "--hse-dead"], case, "it never starts")
}

fn unknown_crystal() -> Run {
    let case = Case::new("an unknown crystal", 0, 500).history(Fault::Crystal);
    without_can("unknown crystal", &["--bor", "--crystal", "10000000"], case, "one of 10 MHz")
}

fn dead_pll() -> Run {
    let case = Case::new("the PLL is dead", 0, 1_500).history(Fault::Pll);
    let mut run = without_can("dead pll", &["--bor", "--pll-dead"], case, "it never locks");
    run.script += "700 say S8\\rO\\r\n";
    run.ms = 1_600;
    run
}

fn slow_lsi() -> Run {
    run("slow lsi", "", 700)
        .options(&["--bor", "--lsi", "17000"])
        .case("17 kHz", Case::new("the watchdog's oscillator is slow", 300, 400))
}

fn fast_lsi() -> Run {
    run("fast lsi", "", 700)
        .options(&["--bor", "--lsi", "47000"])
        .case("47 kHz", Case::new("the watchdog's oscillator is fast", 300, 400))
}

fn supply() -> Run {
    let dip = Case::new("the supply dips", 500, 300).restart(ResetReason::BrownOut);
    let pin = Case::new("the reset pin is pulled", 900, 300).restart(ResetReason::Pin);
    let off = Case::new("the power goes", 1_300, 300).restart(ResetReason::PowerOn);
    run("supply", "500 reset brown_out\n900 reset pin\n1300 reset power\n", 1_700)
        .case("below the brown-out level", dip.emergency(Fault::Restarted))
        .case("low for a moment", pin.emergency(Fault::Restarted))
        .case("off and on", off.emergency(Fault::Restarted))
}

fn write_protected() -> Run {
    run("write-protected", "500 flags 7\n520 flags 3\n", 900)
        .options(&["--bor", "--write-protected"])
        .case(
            "the option bytes protect the store: the start tells",
            Case::new("the store cannot be written", 0, 250)
                .quality(OffsetQuality::Fault)
                .state(StateBits::STORE_FAILING)
                .emergency(Fault::Store),
        )
        .case(
            "the same, and a `Zero` comes",
            Case::new("the store cannot be written", 500, 300).state(StateBits::STORE_FAILING),
        )
}

fn factory_options() -> Run {
    run("factory options", "", 1_000).options(&[]).case(
        "no brown-out level: it is set at this start",
        Case::new("option bytes as from the factory", 600, 300),
    )
}

fn unusable(name: &'static str, image: Image, how: &str) -> Run {
    run(name, "", 500).image(image).case(
        how,
        Case::new("no calibration that can be used", 0, 300)
            .quality(OffsetQuality::Fault)
            .emergency(Fault::NoCalibration),
    )
}
