//! The program's options, one line each in `README.md`.

use std::process::exit;
use trueup_chip::{
    chip::Faults,
    frame::Frame,
    time::{NEVER, ms},
    wire::Parity,
    world::{NOMINAL_SUPPLY, Plan},
};

pub struct Options {
    pub image: String,
    pub run: u64,
    pub faults: Faults,
    pub plan: Plan,
    /// Of the wires.
    pub ports: [Option<u16>; 2],
    /// The RS-485 line as its master has it: speed, parity, stop bits.
    pub plc: (f64, Parity, u32),
    pub low: Vec<(usize, u32)>,
    pub rtt: Option<String>,
    pub awake: bool,
    pub quiet: bool,
    pub from_loader: bool,
    pub trace: u64,
    pub lsi: u64,
    pub battery: bool,
    pub crystal: u64,
    pub slow_flash: bool,
    pub supply: f64,
    pub inputs: [f64; 16],
    pub bor: bool,
    pub write_protected: bool,
    pub ram_stuck: u32,
    pub broken: u32,
    pub rtds: u32,
    pub masked: bool,
    pub flash: Option<String>,
    pub serial_out: Option<String>,
    pub script: Option<String>,
    pub live: bool,
    pub log: Option<String>,
}

pub fn options() -> Options {
    let mut o = defaults();
    let mut args = std::env::args().skip(1);
    let number = |v: Option<String>, what: &str| -> u64 {
        v.and_then(|v| v.parse().ok()).unwrap_or_else(|| usage(what))
    };
    let decimal = |v: Option<String>, what: &str| -> f64 {
        v.and_then(|v| v.parse().ok()).unwrap_or_else(|| usage(what))
    };
    while let Some(a) = args.next() {
        match a.as_str() {
            "--ms" => o.run = ms(number(args.next(), &a)),
            "--code" => o.plan.code = number(args.next(), &a) as f64,
            "--code-after" => o.plan.code_after = number(args.next(), &a) as f64,
            "--step-ms" => o.plan.step_at = ms(number(args.next(), &a)),
            "--noise" => o.plan.noise = number(args.next(), &a) as f64,
            "--engage-ms" => o.plan.engage_at = ms(number(args.next(), &a)),
            "--zero-ms" => o.plan.zero_at = ms(number(args.next(), &a)),
            "--cnc-until-ms" => o.plan.cnc_until = ms(number(args.next(), &a)),
            "--no-cnc" => o.plan.cnc_from = NEVER,
            "--rpm" => o.plan.rpm = number(args.next(), &a) as u16,
            "--positions" => o.plan.positions = number(args.next(), &a),
            "--say" => {
                let at = ms(number(args.next(), &a));
                o.plan.says.push((at, text_to_say(args.next())));
            }
            "--frame" => {
                let at = ms(number(args.next(), &a));
                o.plan.frames.push((at, frame(args.next())));
            }
            "--hse-stops" => o.faults.hse_stops = ms(number(args.next(), &a)),
            "--hse-dead" => o.faults.hse_dead = true,
            "--pll-dead" => o.faults.pll_dead = true,
            "--lse-dead" => o.faults.lse_dead = true,
            "--battery" => o.battery = true,
            "--capture-dead" => o.faults.capture_dead = true,
            "--crc-dead" => o.faults.crc_dead = true,
            "--serial-dma-stuck" => o.faults.serial_dma_stuck = true,
            "--from-loader" => o.from_loader = true,
            "--stray-flash-write" => o.faults.stray_write = ms(number(args.next(), &a)),
            "--upset" => {
                let at = ms(number(args.next(), &a));
                let to = args.next().unwrap_or_else(|| usage("--upset"));
                let to = u32::from_str_radix(to.trim_start_matches("0x"), 16);
                o.faults.upset = (at, to.unwrap_or_else(|_| usage("--upset")));
            }
            "--adc-stalls" => o.faults.adc_stalls = ms(number(args.next(), &a)),
            "--supply" => o.supply = decimal(args.next(), &a),
            "--input" => {
                let channel = number(args.next(), &a) as usize;
                let volts = decimal(args.next(), &a);
                *o.inputs.get_mut(channel).unwrap_or_else(|| usage(&a)) = volts;
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
                let at = args.next().unwrap_or_else(|| usage("--ram-stuck"));
                let at = u32::from_str_radix(at.trim_start_matches("0x"), 16);
                o.ram_stuck = at.unwrap_or_else(|_| usage("--ram-stuck"));
            }
            "--slow-flash" => o.slow_flash = true,
            "--serial" => o.ports[0] = Some(number(args.next(), &a) as u16),
            "--modbus" => o.ports[1] = Some(number(args.next(), &a) as u16),
            "--modbus-baud" => o.plc.0 = number(args.next(), &a) as f64,
            "--modbus-no-parity" => (o.plc.1, o.plc.2) = (Parity::None, 2),
            "--low" => o.low.push(pin(&args.next().unwrap_or_else(|| usage(&a)))),
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
            _ if a.starts_with('-') || !o.image.is_empty() => usage(&a),
            _ => o.image = a,
        }
    }
    if o.image.is_empty() {
        usage("no image");
    }
    o
}

/// Returns a sound board that runs for two seconds.
fn defaults() -> Options {
    Options {
        image: String::new(),
        run: ms(2000),
        faults: Faults::default(),
        ports: [None; 2],
        plc: (19_200.0, Parity::Even, 1),
        low: Vec::new(),
        rtt: None,
        awake: false,
        quiet: false,
        from_loader: false,
        trace: 0,
        lsi: 32_000,
        battery: false,
        crystal: 8_000_000,
        slow_flash: false,
        supply: NOMINAL_SUPPLY,
        inputs: [0.0; 16],
        bor: false,
        write_protected: false,
        ram_stuck: 0,
        broken: 0,
        rtds: 8,
        masked: false,
        flash: None,
        serial_out: None,
        script: None,
        live: false,
        log: None,
        plan: Plan {
            code: 1000.0,
            code_after: 1200.0,
            step_at: ms(1000),
            noise: 1.0,
            cnc_from: ms(50),
            engage_at: ms(400),
            zero_at: NEVER,
            cnc_until: NEVER,
            rpm: 3000,
            says: Vec::new(),
            positions: 100,
            frames: Vec::new(),
        },
    }
}

fn text_to_say(text: Option<String>) -> Vec<u8> {
    text.unwrap_or_else(|| usage("--say")).replace("\\r", "\r").into_bytes()
}

/// Returns a frame written as `302#0011`.
fn frame(text: Option<String>) -> Frame {
    let text = text.unwrap_or_else(|| usage("--frame"));
    let (id, data) = text.split_once('#').unwrap_or_else(|| usage("--frame"));
    let byte = |i: usize| u8::from_str_radix(&data[2 * i..2 * i + 2], 16);
    let bytes: Vec<u8> =
        (0..data.len() / 2).map(|i| byte(i).unwrap_or_else(|_| usage("--frame"))).collect();
    Frame::new(u32::from_str_radix(id, 16).unwrap_or_else(|_| usage("--frame")), &bytes)
}

/// Returns the port and number of a pin like `PC12`.
fn pin(name: &str) -> (usize, u32) {
    let &[b'P', port @ b'A'..=b'I', ..] = name.as_bytes() else { usage(name) };
    (usize::from(port - b'A'), name[2..].parse().unwrap_or_else(|_| usage(name)))
}

pub fn usage(what: &str) -> ! {
    eprintln!(
        "{what}: see README.md\nusage: trueup-chip IMAGE.elf [--ms N] [--say MS TEXT] [--hse-dead] [--pll-dead] [--can-alone] [--can-short] [--serial PORT] …"
    );
    exit(2)
}
