//! The bridge in the loop: the same firmware, as the image for the emulator or as the one that is flashed; or none, where
//! LinuxCNC's servo thread is the bridge, and gets volts and degrees by its own `streamer`, a line a millisecond.
//!
//! | | QEMU | model of the chip |
//! |---|---|---|
//! | image | `virtual`, loaded with a calibration | `stm32f405`, with its machine file linked in |
//! | sensor | blocks of 20 codes through the front end | volts at the converter's pin, TIM3, ADC1, DMA |
//! | temperatures | the converters' words | ohms behind MAX31865 on SPI |
//! | the CNC's line | CAN through pipes, `SlcanAdapter` | the image's own SLCAN on USART1 |
//! | its second is | a second of the wall, or less | `EmulatedBridge::slowdown_factor` seconds of the wall |
//! | two hours | are lived through by the board | are the machine's: it lives faster than the board |
//!
//! The model cannot outrun the wall, so what is slow there is the time of everything: LinuxCNC's feeds are
//! divided by its factor, its accelerations by the square, its dwells are as much longer.

use std::{
    collections::BTreeMap,
    io::{Read as _, Write as _},
    net::{Shutdown, TcpListener, TcpStream},
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use trueup_core::units::AdcCode;
use trueup_machine::inputs::{TemperatureInput, TemperatureInputKind};
use trueup_pipe::Block;

use super::slcan_adapter::{COMPRESSED_PAIR_INTERVAL_CYCLES, SlcanAdapter};
use crate::{
    analogue_front_end::{ADC_REFERENCE_VOLTS, AnalogueFrontEnd, NOISE_CODES_RMS},
    board::VirtualBoard,
    lockstep_chip::LockstepChip,
    replay,
};

/// How long the model's speed is measured, in ms of the board, once it is up.
const STARTUP_MS: u64 = 1_000;
const SPEED_MEASUREMENT_MS: u64 = 2_000;
/// What LinuxCNC and its frames may take of this computer: the model is given this many times longer than it
/// took without them.
const SLOWDOWN_MARGIN: f64 = 1.5;

/// Parts of the bridge: the current machine file, and the one for the warm-up.
pub enum BridgeArtefacts {
    /// In QEMU: the image, and both calibrations.
    Qemu(PathBuf, [Vec<u8>; 2]),
    /// On the model of the chip: its program, and both images.
    Chip(PathBuf, [PathBuf; 2]),
    /// Without a board: the library of the component.
    Servo(PathBuf),
}

/// How it is wired to the machine.
pub struct BridgeWiring {
    /// The channels of the board, by the names under which the machine states its temperatures.
    pub temperatures: BTreeMap<String, TemperatureInput>,
    /// The divider before the converter.
    pub divider: f64,
    /// Seed of the front end's noise.
    pub seed: u64,
}

enum BridgeBackend {
    Qemu {
        image: PathBuf,
        later: Vec<u8>,
        board: VirtualBoard,
        adapter: SlcanAdapter,
        front_end: Box<AnalogueFrontEnd>,
    },
    Chip {
        model: PathBuf,
        later: PathBuf,
        board: LockstepChip,
        slower: u32,
    },
    Servo {
        library: PathBuf,
        listener: TcpListener,
        client: Option<TcpStream>,
        front_end: Box<AnalogueFrontEnd>,
    },
}

/// A running bridge.
pub struct EmulatedBridge {
    board: BridgeBackend,
    wiring: BridgeWiring,
}

impl EmulatedBridge {
    /// Switches it on.
    ///
    /// # Errors
    /// It does not come up.
    pub fn start(images: BridgeArtefacts, wiring: BridgeWiring) -> Result<Self> {
        let board = match images {
            BridgeArtefacts::Qemu(image, [first, later]) => BridgeBackend::Qemu {
                board: VirtualBoard::boot(&image, &first)?,
                adapter: SlcanAdapter::listen()?,
                front_end: Box::new(AnalogueFrontEnd::new(wiring.divider, wiring.seed)),
                image,
                later,
            },
            BridgeArtefacts::Chip(model, [first, later]) => {
                let mut board = add_converter_noise(LockstepChip::start(&model, &first, 0)?)?;
                let slower = measure_slowdown_factor(&mut board)?;
                BridgeBackend::Chip { model, later, board, slower }
            }
            BridgeArtefacts::Servo(library) => {
                let listener = TcpListener::bind("127.0.0.1:0")?;
                listener.set_nonblocking(true)?;
                let front_end = Box::new(AnalogueFrontEnd::new(wiring.divider, wiring.seed));
                BridgeBackend::Servo { library, listener, client: None, front_end }
            }
        };
        Ok(Self { board, wiring })
    }

    /// Where the CNC finds it; without a board, where its inputs come from.
    ///
    /// # Errors
    /// It listens nowhere.
    pub fn address(&self) -> Result<String> {
        Ok(match &self.board {
            BridgeBackend::Qemu { adapter, .. } => adapter.address(),
            BridgeBackend::Chip { board, .. } => format!("tcp:127.0.0.1:{}", board.port()),
            BridgeBackend::Servo { listener, .. } => format!("tcp:{}", listener.local_addr()?),
        })
    }

    /// Returns the library of the component, where there is no board.
    #[must_use]
    pub(crate) fn component_library(&self) -> Option<&Path> {
        match &self.board {
            BridgeBackend::Servo { library, .. } => Some(library),
            BridgeBackend::Qemu { .. } | BridgeBackend::Chip { .. } => None,
        }
    }

    /// Returns the channels of the thermometers, in the order in which [`EmulatedBridge::advance`] gives them where there is no board.
    #[must_use]
    pub fn temperature_channels(&self) -> Vec<u8> {
        self.wiring.temperatures.values().map(|input| input.channel).collect()
    }

    /// Returns a second of the board, in seconds of the wall, while the axes move.
    #[must_use]
    pub(crate) fn slowdown_factor(&self) -> u32 {
        match self.board {
            BridgeBackend::Qemu { .. } | BridgeBackend::Servo { .. } => 1,
            BridgeBackend::Chip { slower, .. } => slower,
        }
    }

    /// While machine time is compressed by `factor`: seconds of the board in one of the wall, and of the
    /// machine in one of the board.
    #[must_use]
    pub(crate) fn time_ratios(&self, factor: u32) -> [f64; 2] {
        match self.board {
            BridgeBackend::Qemu { .. } => [f64::from(factor), 1.0],
            BridgeBackend::Chip { slower, .. } => [1.0 / f64::from(slower), f64::from(factor)],
            BridgeBackend::Servo { .. } => [1.0, f64::from(factor)],
        }
    }

    /// Lets the board live for this many milliseconds, with these volts of the sensor and these temperatures
    /// by the names of their columns.
    ///
    /// # Errors
    /// It has ended.
    pub fn advance(
        &mut self,
        ms: u64,
        factor: u32,
        mut volts: impl FnMut() -> f64,
        celsius: &BTreeMap<String, f64>,
    ) -> Result<()> {
        match &mut self.board {
            BridgeBackend::Qemu { board, adapter, front_end, .. } => {
                let temperatures =
                    replay::raw_temperatures_from_celsius(&self.wiring.temperatures, celsius);
                let blocks: Vec<Block> = (0..ms)
                    .map(|_| {
                        let volts = volts();
                        Block {
                            codes: front_end.convert_block(|_| volts),
                            // The speed comes from the CNC, as everything else that it knows.
                            speed: None,
                            temperatures,
                            frames: adapter.take_frames(),
                            ..Block::default()
                        }
                    })
                    .collect();
                let sent = board.step(&blocks)?;
                adapter.set_frame_pair_interval_cycles(if factor > 1 {
                    COMPRESSED_PAIR_INTERVAL_CYCLES
                } else {
                    1
                });
                adapter.forward_frames(&sent);
                Ok(())
            }
            BridgeBackend::Chip { board, .. } => {
                for (name, input) in &self.wiring.temperatures {
                    let Some(celsius) = celsius.get(name) else { continue };
                    ensure!(input.kind == TemperatureInputKind::Pt100, "{name} is no PT100");
                    board.apply_script_line(&format!("rtd {} {celsius}", input.channel))?;
                }
                for _ in 0..ms {
                    let share = volts() * self.wiring.divider / ADC_REFERENCE_VOLTS;
                    board.apply_script_line(&format!(
                        "code {}",
                        share * f64::from(AdcCode::FULL_SCALE)
                    ))?;
                    board.advance(1)?;
                }
                Ok(())
            }
            BridgeBackend::Servo { listener, client, front_end, .. } => {
                if client.is_none() {
                    *client = listener.accept().ok().map(|connection| connection.0);
                }
                let Some(to) = client else { return Ok(()) };
                let named = self.wiring.temperatures.keys().filter_map(|name| celsius.get(name));
                let degrees: String = named.map(|celsius| format!(" {celsius:.3}")).collect();
                let mut lines = String::new();
                for _ in 0..ms {
                    let volts = volts();
                    let codes = front_end.convert_block(|_| volts);
                    let mean = codes.iter().map(|code| f64::from(code.0)).sum::<f64>()
                        / codes.len() as f64;
                    let seen = mean / f64::from(AdcCode::FULL_SCALE) * ADC_REFERENCE_VOLTS
                        / self.wiring.divider;
                    lines += &format!("{seen:.6}{degrees}\n");
                }
                // It ends before the machine does; while it runs, a sensor that stands is a fault of the figures.
                if to.write_all(lines.as_bytes()).is_err() {
                    *client = None;
                }
                Ok(())
            }
        }
    }

    /// Returns whether its time begins with that of LinuxCNC: a message before would be late for good.
    #[must_use]
    pub(crate) fn is_clocked_by_cnc(&self) -> bool {
        matches!(self.board, BridgeBackend::Servo { .. })
    }

    /// Returns whether the CNC has sent something within `time`, where that is known.
    #[must_use]
    pub(crate) fn has_received_from_cnc_within(&self, time: Duration) -> bool {
        match &self.board {
            BridgeBackend::Qemu { adapter, .. } => adapter.has_received_from_cnc_within(time),
            BridgeBackend::Chip { .. } | BridgeBackend::Servo { .. } => true,
        }
    }

    /// Takes the board's power, and gives it the machine file of the warm-up.
    ///
    /// # Errors
    /// It does not come up again, or the model of the chip objects to what was done so far.
    pub(crate) fn restart_for_warm_up(self) -> Result<Self> {
        let board = match self.board {
            BridgeBackend::Qemu { image, later, adapter, front_end, board } => {
                drop(board);
                let board = VirtualBoard::boot(&image, &later)?;
                BridgeBackend::Qemu { image, later, adapter, front_end, board }
            }
            BridgeBackend::Chip { model, later, board, slower } => {
                let port = board.port();
                board.power_off()?;
                let board = add_converter_noise(LockstepChip::start(&model, &later, port)?)?;
                BridgeBackend::Chip { model, later, board, slower }
            }
            // LinuxCNC reads its machine file once.
            it @ BridgeBackend::Servo { .. } => it,
        };
        Ok(Self { board, ..self })
    }

    /// Returns what the board has logged since it was last asked.
    #[must_use]
    pub(crate) fn take_log(&self) -> Vec<String> {
        match &self.board {
            BridgeBackend::Qemu { board, .. } => board.take_log(),
            BridgeBackend::Chip { board, .. } => board.take_log(),
            BridgeBackend::Servo { .. } => Vec::new(),
        }
    }

    /// Ends it. Pairs of offsets that the CNC got and frames that the board got, where they are counted on
    /// the way.
    ///
    /// # Errors
    /// The model of the chip objects to what was done.
    pub fn shut_down(self) -> Result<Option<(u64, u64)>> {
        match self.board {
            BridgeBackend::Qemu { adapter, .. } => Ok(Some(adapter.frame_counts())),
            BridgeBackend::Chip { board, .. } => board.power_off().map(|()| None),
            BridgeBackend::Servo { .. } => Ok(None),
        }
    }
}

/// Its converter has the front end's noise: the sum of two even draws, which is 1/√6 of its peak.
fn add_converter_noise(mut board: LockstepChip) -> Result<LockstepChip> {
    board.apply_script_line(&format!("noise {}", 6.0_f64.sqrt() * NOISE_CODES_RMS))?;
    Ok(board)
}

/// By how much the model is slower than life on this computer, with a client at its line, and with room for
/// LinuxCNC.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a cast saturates")]
fn measure_slowdown_factor(board: &mut LockstepChip) -> Result<u32> {
    board.advance(STARTUP_MS)?;
    let mut client = TcpStream::connect(("127.0.0.1", board.port()))?;
    client.write_all(b"S8\rO\r")?;
    let mut line = client.try_clone()?;
    let reader = thread::spawn(move || {
        let (mut bytes, mut received) = ([0; 4096], 0);
        while let Ok(length @ 1..) = line.read(&mut bytes) {
            received += length;
        }
        received
    });
    let began = Instant::now();
    for _ in 0..SPEED_MEASUREMENT_MS {
        board.advance(1)?;
    }
    let took_ms = began.elapsed().as_secs_f64() * 1e3;
    client.write_all(b"C\r")?;
    board.advance(100)?;
    client.shutdown(Shutdown::Both)?;
    // The model sees that its client has gone.
    board.advance(10)?;
    let received = reader.join().ok().context("the reader does not panic")?;
    ensure!(
        received as u64 > 40 * SPEED_MEASUREMENT_MS,
        "the board says too little: {received} bytes"
    );
    Ok((took_ms / SPEED_MEASUREMENT_MS as f64 * SLOWDOWN_MARGIN).ceil() as u32)
}
