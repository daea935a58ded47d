//! The tool as its users call it: by the words of a line, in one program, so that what the tests share is
//! built and linked once.

mod accept;
mod bounds;
mod bridge;
mod check;
mod commission;
mod commission_board;
mod desk;
mod diagnose;
mod export;
mod files;
mod fit;
mod fleet;
mod hostile;
mod import;
mod install;
mod learn;
mod linuxcnc;
mod new;
mod papers;
mod pretended;
mod printed;
mod ranges;
mod records;
mod round_trips;
mod screen;
mod sign;
mod simulate;
#[cfg(unix)]
mod slots_board;
mod streams;
#[cfg(target_os = "linux")]
mod terminal;
mod tour;
mod tutorial;
mod units;
#[cfg(unix)]
mod update;
mod virtual_probe;
mod who;
mod wire;
