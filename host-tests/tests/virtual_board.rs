//! The real firmware on the emulated board: it computes what the host computes, to the bit, twice
//! the same, and says the same on both of its wires.

use std::time::Instant;

use trueup_core::{
    bridge::TickInput,
    cnc::{CncMessage, Control, OffsetQuality, SpindleState},
    units::{AdcCode, Rpm, TimestampMs},
};
use trueup_emulator::{
    analogue_front_end::AnalogueFrontEnd,
    board::{self, VirtualBoard},
    cnc_client::CncClient,
    firmware_images, setup,
};
use trueup_link::{frame::Frame, frames, receiver::OffsetReceiver, slcan::AdapterMessage};
use trueup_machine::{CompiledCalibration, MachineFile, compile};
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface, Node},
};
use trueup_pipe::{Block, FRAMES_PER_BLOCK};

/// Blocks handed over at once.
const BATCH: usize = board::MAX_BATCH_BLOCKS as usize;

type Sent = Vec<(TimestampMs, Frame)>;

fn compiled() -> CompiledCalibration {
    let path = setup::project_root().join("data/paper_spindle.toml");
    let mut machine = MachineFile::read(&path).expect("the project's own machine file");
    machine.limits.slew_um_per_s = 1_000.0;
    compile(&machine).expect("it compiles")
}

fn boot() -> VirtualBoard {
    let image = firmware_images::build_virtual_board_image().expect("the image builds");
    VirtualBoard::boot(&image, compiled().blob()).expect("the board boots")
}

/// Returns a life with everything in it: growth, a speed that changes, a broken wire, spikes, a CNC that
/// engages, disengages, sends damaged and repeated frames, falls silent and comes back.
fn eventful_life(ms: u32) -> Vec<Block> {
    let mut front_end = AnalogueFrontEnd::new(0.328, 42);
    let mut random = 7_u32;
    let mut counter = 0;
    (0..ms)
        .map(|n| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let chance = random >> 16;
            let volts = 1.54 + 0.3 * (f64::from(n) / 900.0).sin();
            let mut codes = front_end.convert_block(|_| volts);
            match n {
                1_500..1_560 | 10_500.. => codes = [AdcCode(0); 20],
                2_900..3_150 => codes = [AdcCode(631); 20],
                _ if chance.is_multiple_of(50) => {
                    codes[usize::from(chance as u8 % 20)] = AdcCode(4095)
                }
                _ => {}
            }
            let mut sent = [None; FRAMES_PER_BLOCK];
            let silent = (4_000..4_700).contains(&n) || (5_200..8_600).contains(&n);
            if n % 20 == 7 && !silent {
                let engage = n > 400 && !(3_300..3_600).contains(&n);
                let zero = (3_700..3_800).contains(&n);
                sent[0] = Some(frames::encode_control(
                    Control { engage, zero, ..Control::REFERENCED },
                    counter,
                ));
                // Some are sent twice, some are damaged on the way.
                if !chance.is_multiple_of(97) {
                    counter = counter.wrapping_add(1);
                }
                if chance.is_multiple_of(11) {
                    let mut data = *sent[0].expect("just made").data();
                    data[3] ^= 0x10;
                    sent[0] = Frame::new(frames::CONTROL_ID, &data).ok();
                }
            }
            if n % 20 == 13 && chance.is_multiple_of(3) {
                let speed = Rpm((chance % 24_000) as u16);
                sent[1] = Some(frames::encode_spindle(
                    SpindleState { speed, load_n: -5 },
                    (n / 20) as u8,
                ));
            }
            let speed = (n > 100).then_some(Rpm(12_000));
            Block { codes, speed, frames: sent, ..Block::default() }
        })
        .collect()
}

fn on_the_board(blocks: &[Block]) -> Sent {
    let mut board = boot();
    let batches = blocks.chunks(BATCH);
    batches.flat_map(|batch| board.step(batch).expect("the board lives")).collect()
}

fn on_the_host(blocks: &[Block]) -> Sent {
    let compiled = compiled();
    // The status tells the blob's CRC.
    let blob = compiled.blob();
    let mut node = Node::new(NodeConfiguration { blob, ..compiled.calibration().into() });
    let mut sent = Sent::new();
    for block in blocks {
        for frame in block.frames.iter().flatten() {
            // What is refused is part of this life.
            node.receive(Interface::Can, frame).ok();
        }
        let input = TickInput {
            codes: Some(&block.codes),
            speed: block.speed,
            temperatures: Some(&block.temperatures),
        };
        let frames = node.tick(1, input).into_iter().chain(node.next_service_frame());
        sent.extend(frames.into_iter().map(|frame| (node.now(), frame)));
        // As the board's log does, once a second; the status tells it.
        if node.now().0 % 1_000 == 10 {
            node.take_display_values();
        }
    }
    sent
}

#[test]
fn board_and_host_send_the_same_frames_to_the_bit_through_an_eventful_life() {
    let blocks = eventful_life(14_000);
    let (board, host) = (on_the_board(&blocks), on_the_host(&blocks));
    let first = board.iter().zip(&host).position(|(board, host)| board != host);
    assert_eq!(first, None, "the first frame that differs");
    assert_eq!(board.len(), host.len());

    // The board does not just idle: every quality that a sensor can have has been there.
    let mut receiver = OffsetReceiver::new();
    let outputs = board.iter().filter_map(|(_, frame)| receiver.accept(frame).ok().flatten());
    let mut seen = [0; 7];
    outputs.for_each(|output| seen[output.quality as usize] += 1);
    println!("{} frames the same; ticks by quality: {seen:?}", board.len());
    for quality in [
        OffsetQuality::Off,
        OffsetQuality::Live,
        OffsetQuality::Hold,
        OffsetQuality::RampingOut,
        OffsetQuality::Fault,
    ] {
        assert!(seen[quality as usize] > 0, "never {quality:?}");
    }
}

#[test]
fn two_runs_on_the_board_are_the_same_to_the_bit() {
    let blocks = eventful_life(3_000);
    assert_eq!(on_the_board(&blocks), on_the_board(&blocks));
}

#[test]
fn the_serial_line_says_what_the_bus_says_and_growth_lifts_the_tool() {
    const SETTLED_VOLTS: f64 = 9_164.0 * 10.0 / 32_768.0;
    let mut board = boot();
    let mut front_end = AnalogueFrontEnd::new(0.328, 1);
    let mut cnc =
        CncClient::open(board.open_buffered_serial().expect("a line")).expect("an open channel");
    for _ in 0..20 {
        let control = Control::ENGAGED;
        cnc.send_message(CncMessage::Control(control)).expect("accepted");
        let blocks: Vec<Block> = (0..20)
            .map(|_| Block {
                codes: front_end.convert_block(|_| SETTLED_VOLTS),
                speed: Some(Rpm(24_000)),
                ..Block::default()
            })
            .collect();
        for (_, on_the_bus) in board.step(&blocks).expect("the board lives") {
            assert_eq!(cnc.next_event().expect("a frame"), AdapterMessage::Frame(on_the_bus));
            let output = cnc.offsets.accept(&on_the_bus).expect("valid");
            // The paper: 9164 counts are 62.8 µm of growth. The tool tip is too low, so up: +Z.
            if let Some(output) = output.filter(|output| output.flags.0 == 0) {
                let [x, y, z] = output.offset.expect("available");
                assert_eq!((x.0, y.0), (0, 0));
                assert!(
                    output.quality != OffsetQuality::Live || (z.0 - 62_805).abs() < 100,
                    "{output:?}"
                );
            }
        }
    }
    assert_eq!(cnc.offsets.counters().lost + cnc.offsets.unpaired_frame_count(), 0);
    let log = board.log();
    println!("{}", log.join("\n"));
    assert!(log.iter().any(|line| line.contains("is up")), "{log:?}");
}

#[test]
fn the_log_measures_the_noise_of_the_front_end() {
    let mut board = boot();
    let mut front_end = AnalogueFrontEnd::new(0.328, 1);
    for _ in 0..12 {
        let blocks: Vec<Block> = (0..BATCH)
            .map(|_| Block { codes: front_end.convert_block(|_| 3.0), ..Block::default() })
            .collect();
        board.step(&blocks).expect("the board lives");
    }
    // The log has its own way to the host: give it a moment.
    std::thread::sleep(std::time::Duration::from_millis(300));
    let log = board.log();
    let parse_noise = |line: &String| -> Option<f64> {
        line.split("noise ").nth(1)?.split(' ').next()?.parse().ok()
    };
    let noise: Vec<f64> = log.iter().filter_map(parse_noise).skip(1).collect();
    println!("noise in codes, from second to second: {noise:?}");
    // 1 LSB and the rounding of the converter: √(1 + 1/12) = 1.041.
    assert!(noise.len() >= 2 && noise.iter().all(|n| (1.02..1.06).contains(n)), "{log:?}");
}

#[test]
fn a_board_without_clients_is_much_faster_than_time() {
    let blocks = eventful_life(20_000);
    let mut board = boot();
    let started = Instant::now();
    for batch in blocks.chunks(BATCH) {
        board.step(batch).expect("the board lives");
    }
    let ratio = 20.0 / started.elapsed().as_secs_f64();
    println!("20 s of board time passed {ratio:.0} times faster than real time");
    assert!(ratio > 5.0, "{ratio}");
}

#[test]
fn a_malformed_line_rings_the_bell_and_is_counted_in_the_log() {
    let mut board = boot();
    let mut cnc =
        CncClient::open(board.open_buffered_serial().expect("a line")).expect("an open channel");
    for bad in ["t30", "X", "S9"] {
        let refused = cnc.query(bad).expect_err("a line that is none");
        assert!(refused.to_string().contains(bad), "{refused}");
    }
    let mut front_end = AnalogueFrontEnd::new(0.328, 1);
    let blocks: Vec<Block> = (0..20)
        .map(|_| Block { codes: front_end.convert_block(|_| 3.0), ..Block::default() })
        .collect();
    board.step(&blocks).expect("the board lives");
    std::thread::sleep(std::time::Duration::from_millis(300));
    let log = board.log();
    assert!(
        log.iter().any(|line| line.contains("refused") && line.contains("[0, 0, 3, 0]")),
        "{log:?}"
    );
}
