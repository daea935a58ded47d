//! Parts that all programs of a touch probe share: the stylus, the search distance before a surface, and the limits of its moves.
//!
//! ```text
//!   retracted │ approach alone may be unguarded: nothing is above the tool
//!             ▼
//!   guarded   ├──► over the place ──► down ──► next to the surface    contact ends the program
//!             ▼
//!   touch     └─ search ─┤ surface ├─ search: not found ends the program
//! ```
//!
//! A touch probe is read by its control. Only LinuxCNC's words for it are written: see [`crate::control`].

use trueup_machine::{
    Machine,
    machine_file::{LinearAxis, MachineKind},
};

use crate::{
    options::MeasurementOptions,
    plan::Step,
    probe::Touch,
    program_error::ProgramError,
    travel::{AxisTravel, resolve_travels, round_to_micrometres},
};

/// The feed of a touch in mm/min: within 1 ms a control that sees it late goes 1 µm.
const DEFAULT_PROBING_FEED_MM_PER_MIN: f64 = 60.0;
/// How far before a surface a touch begins and how far behind it ends, in mm.
const DEFAULT_SEARCH_DISTANCE_MM: f64 = 3.0;
/// The shortest such way in mm: a hand puts an artefact down that well, and no better.
const MIN_SEARCH_DISTANCE_MM: f64 = 0.5;
/// A tool that points along an axis has at least this share of its direction there.
const MIN_ALIGNMENT_COSINE: f64 = 0.9999;

/// A touch probe in the spindle, and the room that it has.
pub(super) struct ProbeSetup {
    /// X, Y and Z.
    pub travels: [AxisTravel; 3],
    /// The axis along which the tool points.
    pub tool: usize,
    /// Which way retracts it: +1, −1.
    pub retract: f64,
    /// The other axes.
    pub sides: [usize; 2],
    pub stylus_mm: f64,
    pub search_mm: f64,
    feed_mm_per_min: f64,
    /// The lengths of the styli; at least one.
    pub tool_lengths_mm: Vec<Option<f64>>,
    /// Where the artefact is, for the first stylus.
    pub at_mm: [f64; 3],
}

impl ProbeSetup {
    /// Returns it, and notes. `what` is what is probed.
    pub fn new(
        machine: &Machine,
        options: &MeasurementOptions,
        what: &str,
    ) -> Result<(Self, Vec<String>), ProgramError> {
        if machine.kind == MachineKind::Lathe {
            return Err(ProgramError(format!(
                "{what} is probed with three axes, and a lathe has no Y"
            )));
        }
        let (travels, notes) = resolve_travels(machine, options)?;
        let travels = <[AxisTravel; 3]>::try_from(travels).map_err(|travels| {
            let names: Vec<&str> = travels.iter().map(|travel| travel.axis.name()).collect();
            let why = format!(
                "{what} is probed with three axes, and only {} may move or is asked for",
                names.join(", ")
            );
            ProgramError([vec![why], notes.clone()].concat().join("; "))
        })?;
        let direction = machine.tool_direction;
        let tool =
            (0..3).find(|n| direction[*n].abs() > MIN_ALIGNMENT_COSINE).ok_or_else(|| {
                ProgramError(format!(
                    "{what} is probed along an axis, and tool_direction is along none"
                ))
            })?;
        let stylus_mm =
            require_option(options.stylus_mm, "--stylus", "the diameter of the stylus ball")?;
        let search_mm = options.search_mm.unwrap_or(DEFAULT_SEARCH_DISTANCE_MM);
        if search_mm < MIN_SEARCH_DISTANCE_MM {
            return Err(ProgramError(format!(
                "--search {search_mm}: at least {MIN_SEARCH_DISTANCE_MM} mm"
            )));
        }
        let mut at_mm = [0.0; 3];
        for (mm, axis) in at_mm.iter_mut().zip(LinearAxis::ALL) {
            let name = format!("--at {}=MM", axis.name());
            *mm = round_to_micrometres(require_option(
                options.at_mm[axis.index()],
                &name,
                "where it is",
            )?);
        }
        let lengths = options.tool_lengths_mm.iter().copied().map(Some);
        let mut tool_lengths_mm: Vec<Option<f64>> = lengths.collect();
        if tool_lengths_mm.is_empty() {
            tool_lengths_mm.push(None);
        }
        let own = Self {
            travels,
            tool,
            retract: -direction[tool].signum(),
            sides: [(tool + 1) % 3, (tool + 2) % 3],
            stylus_mm,
            search_mm,
            feed_mm_per_min: options
                .feeds_mm_per_min
                .first()
                .copied()
                .unwrap_or(DEFAULT_PROBING_FEED_MM_PER_MIN),
            tool_lengths_mm,
            at_mm,
        };
        Ok((own, notes))
    }

    /// Returns a place for another stylus: a longer one stands back by what it is longer.
    pub(crate) fn adjust_position_for_stylus(
        &self,
        mut at_mm: [f64; 3],
        length_mm: Option<f64>,
    ) -> [f64; 3] {
        let first = self.tool_lengths_mm[0];
        let longer = length_mm.zip(first).map_or(0.0, |(length, first)| length - first);
        at_mm[self.tool] = round_to_micrometres(at_mm[self.tool] + self.retract * longer);
        at_mm
    }

    /// Returns the place at which the tool is retracted.
    pub(crate) fn retracted_position_mm(&self) -> f64 {
        self.travels[self.tool].ends_in_approach_order_mm()[0]
    }

    /// Returns the steps from anywhere to the retracted end of the tool, and of what else is vertical.
    pub(crate) fn retract_steps(&self) -> Vec<Step> {
        let mut order = vec![self.tool];
        order.extend(self.sides.into_iter().filter(|n| self.travels[*n].retract.is_some()));
        let to = |n: usize| {
            self.travels[n].approach_step(self.travels[n].ends_in_approach_order_mm()[0])
        };
        order.into_iter().map(to).collect()
    }

    /// Returns a move that no contact may end.
    pub(crate) fn guarded_move(&self, axis: usize, mm: f64) -> Step {
        Step::Guarded { axis, to_mm: round_to_micrometres(mm) }
    }

    /// Returns a touch that looks for a surface from as far before it as behind it.
    pub(crate) fn touch_step(
        &self,
        axis: usize,
        surface_mm: f64,
        towards: f64,
        number: usize,
    ) -> Step {
        Step::Touch(Touch {
            axis,
            to_mm: round_to_micrometres(surface_mm + towards * self.search_mm),
            feed_mm_per_min: self.feed_mm_per_min,
            number,
        })
    }

    /// Checks that an axis may go to these places.
    pub(crate) fn check_travel(&self, axis: usize, places_mm: &[f64]) -> Result<(), ProgramError> {
        let AxisTravel { low_mm, high_mm, axis, .. } = self.travels[axis];
        let beyond = places_mm.iter().find(|mm| **mm < low_mm - 5e-4 || **mm > high_mm + 5e-4);
        beyond.map_or(Ok(()), |mm| {
            let (name, mm) = (axis.name(), round_to_micrometres(*mm));
            Err(ProgramError(format!(
                "{name} would go to {mm} mm, and it may move from {low_mm} to {high_mm} mm: give another place by --at, or a \
                 longer --range {name}=LOW:HIGH"
            )))
        })
    }

    /// Returns what the operator does to change the stylus.
    pub(crate) fn stylus_change_step(&self, length_mm: f64) -> Step {
        Step::Stop(vec![
            format!(
                "Put in the stylus of {length_mm} mm, nothing else. All as before must be clear."
            ),
            "See that the probe opens and closes.".into(),
        ])
    }
}

/// Returns a value that has no default, because the tool would hit something by it.
pub(super) fn require_option(
    value: Option<f64>,
    option: &str,
    what: &str,
) -> Result<f64, ProgramError> {
    value.ok_or_else(|| ProgramError(format!("{what} is not known: give {option}")))
}

/// Returns the command that fits the readings of `steps`; none where they are too few to be fitted alone.
pub(super) fn build_fit_command(name: &str, steps: &[Step]) -> Vec<String> {
    /// As many as `fit volume` needs.
    const MIN_VOLUME_READINGS: usize = 24;
    let of_step = |step: &Step| match step {
        Step::Found(found) => found.by.iter().flatten().count(),
        _ => 0,
    };
    let readings: usize = steps.iter().map(of_step).sum();
    let line = format!("trueup fit volume --run {name}.csv");
    (readings >= MIN_VOLUME_READINGS).then_some(line).into_iter().collect()
}

/// Precaution of every program of a touch probe.
pub(super) const PROBE_PRECAUTION: &str =
    "The probe is in the spindle, its signal was tried by hand, and it is open now.";
/// What is read where.
pub(super) const LINUXCNC_LOG_NOTE: &str = "LinuxCNC writes the readings into the run file of \
    this name, in the folder that it runs in. Put it in the place of the empty one.";
