//! The program's options, one line each in `README.md`.

use std::process::exit;
use trueup_chip::{
    chip::InjectedFaults,
    frame::CanFrame,
    serial_line::Parity,
    simulation_time::{NEVER, ms_to_ticks},
    world::{NOMINAL_SUPPLY_V, StimulusPlan},
};

/// Options of the command line.
#[derive(Default)]
pub struct CommandLineOptions {
    /// The file of the image.
    pub image: String,
    /// For how long it runs, in ticks.
    pub run: u64,
    /// Faults from outside.
    pub faults: InjectedFaults,
    /// The inputs of the run.
    pub plan: StimulusPlan,
    /// Of the wires.
    pub ports: [Option<u16>; 2],
    /// The RS-485 line as its master has it: speed, parity, stop bits.
    pub plc: (f64, Parity, u32),
    /// Pins that a switch holds at ground: port, pin.
    pub low: Vec<(usize, u32)>,
    /// Where the log of the image goes.
    pub rtt: Option<String>,
    /// CYCCNT counts while the processor sleeps.
    pub awake: bool,
    /// The summary leaves out the bytes of the serial line.
    pub quiet: bool,
    /// It starts as after the chip's own loader.
    pub from_loader: bool,
    /// Number of functions to print, those that take the most time first.
    pub trace: u64,
    /// Frequency of LSI, in Hz.
    pub lsi: u64,
    /// VBAT has a battery of its own.
    pub battery: bool,
    /// Frequency of the crystal, in Hz.
    pub crystal: u64,
    /// The flash takes its largest times.
    pub slow_flash: bool,
    /// The supply, in V.
    pub supply: f64,
    /// Volts at the converters' inputs 0 to 15.
    pub inputs: [f64; 16],
    /// The option bytes are those after a first run.
    pub bor: bool,
    /// Sectors 8 to 11 are protected against writes.
    pub write_protected: bool,
    /// The word of the SRAM whose lowest bit is stuck at 1; 0: none.
    pub ram_stuck: u32,
    /// Thermometers whose wire is broken, a bit each.
    pub broken: u32,
    /// Number of thermometers.
    pub rtds: u32,
    /// Times without interrupts and times of handlers are printed.
    pub masked: bool,
    /// The file that keeps the flash between runs.
    pub flash: Option<String>,
    /// Where the bytes of the serial line go.
    pub serial_out: Option<String>,
    /// The file of the script.
    pub script: Option<String>,
    /// The script comes line by line on standard input.
    pub live: bool,
    /// Where the log of the board's output goes.
    pub log: Option<String>,
}

/// Reads the command line, and ends the program if it is wrong.
pub fn parse_options() -> CommandLineOptions {
    let mut o = default_options();
    let mut args = std::env::args().skip(1);
    let number = |v: Option<String>, what: &str| -> u64 {
        v.and_then(|v| v.parse().ok()).unwrap_or_else(|| exit_with_usage(what))
    };
    let decimal = |v: Option<String>, what: &str| -> f64 {
        v.and_then(|v| v.parse().ok()).unwrap_or_else(|| exit_with_usage(what))
    };
    while let Some(a) = args.next() {
        match a.as_str() {
            "--ms" => o.run = ms_to_ticks(number(args.next(), &a)),
            "--code" => o.plan.code = number(args.next(), &a) as f64,
            "--code-after" => o.plan.code_after = number(args.next(), &a) as f64,
            "--step-ms" => o.plan.step_at = ms_to_ticks(number(args.next(), &a)),
            "--noise" => o.plan.noise = number(args.next(), &a) as f64,
            "--engage-ms" => o.plan.engage_at = ms_to_ticks(number(args.next(), &a)),
            "--zero-ms" => o.plan.zero_at = ms_to_ticks(number(args.next(), &a)),
            "--cnc-until-ms" => o.plan.cnc_until = ms_to_ticks(number(args.next(), &a)),
            "--no-cnc" => o.plan.cnc_from = NEVER,
            "--rpm" => o.plan.rpm = number(args.next(), &a) as u16,
            "--positions" => o.plan.positions = number(args.next(), &a),
            "--say" => {
                let at = ms_to_ticks(number(args.next(), &a));
                o.plan.says.push((at, parse_serial_text(args.next())));
            }
            "--frame" => {
                let at = ms_to_ticks(number(args.next(), &a));
                o.plan.frames.push((at, parse_frame(args.next())));
            }
            "--hse-stops" => o.faults.hse_stops = ms_to_ticks(number(args.next(), &a)),
            "--hse-dead" => o.faults.hse_dead = true,
            "--pll-dead" => o.faults.pll_dead = true,
            "--lse-dead" => o.faults.lse_dead = true,
            "--battery" => o.battery = true,
            "--capture-dead" => o.faults.capture_dead = true,
            "--crc-dead" => o.faults.crc_dead = true,
            "--serial-dma-stuck" => o.faults.serial_dma_stuck = true,
            "--from-loader" => o.from_loader = true,
            "--stray-flash-write" => o.faults.stray_write = ms_to_ticks(number(args.next(), &a)),
            "--upset" => {
                let at = ms_to_ticks(number(args.next(), &a));
                let to = args.next().unwrap_or_else(|| exit_with_usage("--upset"));
                let to = u32::from_str_radix(to.trim_start_matches("0x"), 16);
                o.faults.upset = (at, to.unwrap_or_else(|_| exit_with_usage("--upset")));
            }
            "--adc-stalls" => o.faults.adc_stalls = ms_to_ticks(number(args.next(), &a)),
            "--supply" => o.supply = decimal(args.next(), &a),
            "--input" => {
                let channel = number(args.next(), &a) as usize;
                let volts = decimal(args.next(), &a);
                *o.inputs.get_mut(channel).unwrap_or_else(|| exit_with_usage(&a)) = volts;
            }
            "--can-alone" => o.faults.can_alone = true,
            "--can-short" => o.faults.can_short = true,
            "--can-stuck" => o.faults.can_stuck = true,
            "--rtds" => o.rtds = number(args.next(), &a) as u32,
            "--rtd-broken" => o.broken |= 1 << number(args.next(), &a),
            "--lsi" => o.lsi = number(args.next(), &a),
            "--crystal" => o.crystal = number(args.next(), &a),
            "--bor" => o.bor = true,
            "--write-protected" => o.write_protected = true,
            "--ram-stuck" => {
                let at = args.next().unwrap_or_else(|| exit_with_usage("--ram-stuck"));
                let at = u32::from_str_radix(at.trim_start_matches("0x"), 16);
                o.ram_stuck = at.unwrap_or_else(|_| exit_with_usage("--ram-stuck"));
            }
            "--slow-flash" => o.slow_flash = true,
            "--serial" => o.ports[0] = Some(number(args.next(), &a) as u16),
            "--modbus" => o.ports[1] = Some(number(args.next(), &a) as u16),
            "--modbus-baud" => o.plc.0 = number(args.next(), &a) as f64,
            "--modbus-no-parity" => (o.plc.1, o.plc.2) = (Parity::None, 2),
            "--low" => o.low.push(parse_pin(&args.next().unwrap_or_else(|| exit_with_usage(&a)))),
            "--serial-out" => o.serial_out = args.next(),
            "--script" => o.script = args.next(),
            "--live" => o.live = true,
            "--log" => o.log = args.next(),
            "--rtt" => o.rtt = args.next(),
            "--flash" => o.flash = args.next(),
            "--cyccnt-in-sleep" => o.awake = true,
            "--masked" => o.masked = true,
            "--quiet" => o.quiet = true,
            "--trace" => o.trace = number(args.next(), &a),
            _ if a.starts_with('-') || !o.image.is_empty() => exit_with_usage(&a),
            _ => o.image = a,
        }
    }
    if o.image.is_empty() {
        exit_with_usage("no image");
    }
    o
}

/// Returns a sound board that runs for two seconds.
fn default_options() -> CommandLineOptions {
    CommandLineOptions {
        run: ms_to_ticks(2000),
        plc: (19_200.0, Parity::Even, 1),
        lsi: 32_000,
        crystal: 8_000_000,
        supply: NOMINAL_SUPPLY_V,
        rtds: 8,
        plan: StimulusPlan {
            code: 1000.0,
            code_after: 1200.0,
            step_at: ms_to_ticks(1000),
            noise: 1.0,
            cnc_from: ms_to_ticks(50),
            engage_at: ms_to_ticks(400),
            zero_at: NEVER,
            cnc_until: NEVER,
            rpm: 3000,
            positions: 100,
            ..StimulusPlan::default()
        },
        ..CommandLineOptions::default()
    }
}

fn parse_serial_text(text: Option<String>) -> Vec<u8> {
    text.unwrap_or_else(|| exit_with_usage("--say")).replace("\\r", "\r").into_bytes()
}

/// Returns a frame written as `302#0011`.
fn parse_frame(text: Option<String>) -> CanFrame {
    let text = text.unwrap_or_else(|| exit_with_usage("--frame"));
    let (id, data) = text.split_once('#').unwrap_or_else(|| exit_with_usage("--frame"));
    let byte = |i: usize| u8::from_str_radix(&data[2 * i..2 * i + 2], 16);
    let bytes: Vec<u8> = (0..data.len() / 2)
        .map(|i| byte(i).unwrap_or_else(|_| exit_with_usage("--frame")))
        .collect();
    CanFrame::new(
        u32::from_str_radix(id, 16).unwrap_or_else(|_| exit_with_usage("--frame")),
        &bytes,
    )
}

/// Returns the port and number of a pin like `PC12`.
fn parse_pin(name: &str) -> (usize, u32) {
    let &[b'P', port @ b'A'..=b'I', ..] = name.as_bytes() else { exit_with_usage(name) };
    (usize::from(port - b'A'), name[2..].parse().unwrap_or_else(|_| exit_with_usage(name)))
}

/// Prints what is wrong and how the program is called, and ends it.
pub fn exit_with_usage(what: &str) -> ! {
    eprintln!(
        "{what}: see README.md\nusage: trueup-chip IMAGE.elf [--ms N] [--say MS TEXT] [--hse-dead] [--pll-dead] [--can-alone] [--can-short] [--serial PORT] …"
    );
    exit(2)
}
