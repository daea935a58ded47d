//! Random machines to every control and back, by readers and the model alone: what the files make
//! the control correct is the model, within the difference that the report states.
//!
//! The report's own comparison is not trusted here: positions, directions and the sum of the parts
//! are put together again from the public readers and the model's functions, on another grid.

use std::{fmt::Write as _, path::Path};

use trueup_export::{
    ApproachDirection, ExportFormat, ExportOptions, ExportResult, ExportedTable, LengthUnit,
    export, fanuc, heidenhain, linuxcnc,
    siemens::{IniVariables, LookupTable},
};
use trueup_machine::{
    Machine, MachineFile,
    machine_file::{AxisModel, LinearAxis, PitchErrorTable},
    model::{backlash_um, pitch_error_um, spline_value_um, squareness_error_um},
};

/// Seeded numbers: splitmix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn chance(&mut self) -> bool {
        self.next() & 1 == 1
    }

    /// Returns a walk of this many values, in hundredths.
    fn walk(&mut self, count: usize, step: f64) -> Vec<f64> {
        let mut at = self.between(-5.0, 5.0);
        (0..count)
            .map(|_| {
                at += self.between(-step, step);
                (at * 100.0).round() / 100.0
            })
            .collect()
    }

    fn pitch(&mut self, most: usize, with_reverse: bool) -> String {
        let count = 2 + self.next() as usize % most;
        let step = [5.0, 10.0, 25.0, 12.5][self.next() as usize % 4];
        let start = step * -(self.next() as f64 % count as f64).floor();
        let mut text = format!("start_mm = {start:?}\nstep_mm = {step:?}\n");
        let forward = self.walk(count, 3.0);
        let _ = writeln!(text, "forward_um = {forward:?}");
        if with_reverse {
            let reverse: Vec<f64> = forward
                .iter()
                .map(|um| ((um + self.between(2.0, 6.0)) * 100.0).round() / 100.0)
                .collect();
            let _ = writeln!(text, "reverse_um = {reverse:?}");
        }
        text
    }

    fn machine(&mut self) -> Machine {
        let mut text = String::from("[machine]\nname = \"random\"\nkind = \"head-head\"\n");
        text.push_str("head_axes = [\"c\", \"a\"]\n[spindle]\nsource = \"sensor\"\n");
        text.push_str(
            "[spindle.sensor]\nk0_um = 0.0\nzero_counts = 5048.0\num_per_count = 0.015\n",
        );
        for axis in ["x", "y", "z"] {
            let has_reverse = self.chance();
            if !has_reverse || axis == "y" {
                let width = self.between(-2.0, 9.0);
                let _ = writeln!(text, "[axis.{axis}.backlash]\nwidth_um = {width:.3}");
            }
            let has_reverse = has_reverse && axis != "y";
            let _ = write!(text, "[axis.{axis}.pitch]\n{}", self.pitch(60, has_reverse));
            if axis == "y" {
                let _ = writeln!(text, "[axis.y.dual]\nacross = \"x\"\nfirst_mm = 0.0");
                let _ = write!(
                    text,
                    "second_mm = 900.0\n[axis.y.dual.pitch]\n{}",
                    self.pitch(60, false)
                );
            }
            let _ = writeln!(
                text,
                "[axis.{axis}.thermal]\nmode = \"both\"\nsensor = \"temp_{axis}_c\""
            );
            let (slope, origin) = (self.between(-12.0, 12.0), self.between(-100.0, 100.0));
            let _ = writeln!(text, "reference_c = 21.5\nconstant_um_per_c = {slope:.3}");
            let _ = writeln!(text, "slope_um_per_m_per_c = {slope:.3}\norigin_mm = {origin:.3}");
            if self.chance() {
                let row = [-3.0, 1.5, 7.0].map(|um| um * slope);
                let _ = writeln!(
                    text,
                    "table = [[10.0, {:?}, 0.0], [20.5, {:?}, 11.0], [44.0, {:?}, -200.0]]",
                    row[0], row[1], row[2]
                );
            }
        }
        for pair in ["y_of_x", "z_of_x", "z_of_y", "x_of_y", "x_of_z"] {
            let inner = 1 + self.next() as usize % 12;
            let last = self.between(300.0, 3000.0).round();
            let mut knots = vec![0.0; 4];
            let mut places: Vec<f64> = (0..inner).map(|_| self.between(1.0, last - 1.0)).collect();
            places.sort_by(f64::total_cmp);
            knots.extend(places);
            knots.extend([last; 4]);
            let control = self.walk(inner + 4, 6.0);
            let _ = writeln!(text, "[straightness.{pair}]\norder = 4\nknots_mm = {knots:?}");
            let _ = writeln!(text, "control_um = {control:?}");
        }
        text.push_str("[squareness]\nz_of_x_um_per_m = 14.0\nx_of_z_um_per_m = -9.0\n");
        MachineFile::parse(&text, Path::new("random.toml"))
            .unwrap_or_else(|e| panic!("{e}\n{text}"))
    }
}

const MACHINES: u64 = 12;

fn text<'e>(export: &'e ExportResult, name: &str) -> &'e str {
    &export.files.iter().find(|file| file.name == name).expect("the file is there").text
}

/// Positions that no table and no comparison of the crate knows.
fn positions(first: f64, last: f64) -> impl Iterator<Item = f64> {
    (0..=1777).map(move |k| first + (last - first) * f64::from(k) / 1777.0)
}

/// Returns the error of one drive, from the model's functions alone.
fn drive_um(
    axis: &AxisModel,
    pitch: Option<&PitchErrorTable>,
    mm: f64,
    approach: ApproachDirection,
) -> f64 {
    let direction = approach.sign();
    pitch.map_or(0.0, |pitch| pitch_error_um(pitch, mm, direction))
        + axis.backlash.as_ref().map_or(0.0, |backlash| backlash_um(backlash, direction))
}

fn cross_um(machine: &Machine, error: LinearAxis, along: LinearAxis, mm: f64) -> f64 {
    let curves = machine.straightness.iter();
    let curves = curves.filter(|curve| (curve.error, curve.along) == (error, along));
    let angles = machine.squareness.iter();
    let angles = angles.filter(|angle| (angle.error, angle.along) == (error, along));
    curves.map(|curve| spline_value_um(&curve.spline, mm)).sum::<f64>()
        + angles.map(|angle| squareness_error_um(angle, mm)).sum::<f64>()
}

/// Returns every drive: its name, its axis, its table.
fn drives(machine: &Machine) -> Vec<(String, &AxisModel, Option<&PitchErrorTable>)> {
    let mut all = Vec::new();
    for axis in LinearAxis::ALL {
        let of = &machine.axes[axis.index()];
        all.push((axis.name().to_string(), of, of.pitch.as_ref()));
        if let Some(dual) = &of.dual {
            all.push((format!("{}2", axis.name()), of, Some(&dual.pitch)));
        }
    }
    all
}

fn table(export: &ExportResult, what: impl Fn(&ExportedTable) -> bool) -> &ExportedTable {
    export.report.tables.iter().find(|table| what(table)).expect("the table is there")
}

/// Compares over the table's range and a little beyond; gives the largest difference.
fn assert_stated(
    table: &ExportedTable,
    error_um: impl Fn(f64, ApproachDirection) -> f64,
    correction_um: impl Fn(f64, ApproachDirection) -> f64,
) -> f64 {
    let (first, last) = table.range;
    let mut worst = 0.0_f64;
    for mm in positions(first, last) {
        for approach in ApproachDirection::BOTH {
            let left = correction_um(mm, approach) + error_um(mm, approach) - table.constant_um;
            worst = worst.max(left.abs());
        }
    }
    // Between two positions of a comparison the curve moves by less than this.
    assert!(worst <= table.largest.um + 0.02, "{worst} µm where {table:?} is stated");
    worst
}

#[test]
fn linuxcnc_corrects_every_drive_exactly() {
    let mut worst = 0.0_f64;
    for seed in 0..MACHINES {
        let machine = Random(seed).machine();
        for units in [LengthUnit::Millimetres, LengthUnit::Inches] {
            let options = ExportOptions { units, ..ExportOptions::default() };
            let export = export(&machine, ExportFormat::LinuxCnc, &options).expect("it has tables");
            for (name, axis, pitch) in drives(&machine) {
                let file = format!("{name}.comp");
                let read = linuxcnc::parse(text(&export, &file)).expect("it loads");
                let table = table(&export, |table| table.file == file);
                let correction = |mm: f64, way| {
                    read.trim_at(mm / units.mm_per_unit(), way) * units.mm_per_unit() * 1000.0
                };
                let error = |mm, way| drive_um(axis, pitch, mm, way);
                worst = worst.max(assert_stated(table, error, correction));
            }
            assert!(!export.report.is_complete(), "heat and straightness are left out");
        }
    }
    println!("linuxcnc: {MACHINES} machines, largest difference {worst:.6} µm");
    assert!(worst < 0.001, "{worst} µm");
}

#[test]
fn siemens_corrects_every_drive_and_every_pair_within_the_tolerance() {
    let (mut worst, mut heat, mut thinned) = (0.0_f64, 0.0_f64, 0);
    for seed in 0..MACHINES {
        let machine = Random(seed).machine();
        let units = if seed % 2 == 0 { LengthUnit::Millimetres } else { LengthUnit::Inches };
        let options =
            ExportOptions { units, reference_mm: [10.0, 0.0, -20.0], ..ExportOptions::default() };
        let export = export(&machine, ExportFormat::Siemens840d, &options).expect("it has tables");
        let variables = |name| IniVariables::parse(text(&export, name)).expect("it reads back");
        let (eec, cec, data) =
            (variables("AX_EEC.INI"), variables("NC_CEC.INI"), variables("ENABLE.INI"));
        let unit = units.mm_per_unit() * 1000.0;
        let tables: Vec<LookupTable> =
            (0..).map_while(|t| LookupTable::from_cec_variables(&cec, t).ok()).collect();
        let cross_tables = |input: &str, output: &str, mm: f64, way| -> f64 {
            let tables = tables.iter().filter(|t| t.input == input && t.output == output);
            -tables.map(|t| t.value(mm / units.mm_per_unit(), way)).sum::<f64>() * unit
        };
        for ((_, axis, pitch), name) in
            drives(&machine).into_iter().zip(["AX1", "AX2", "AX4", "AX3"])
        {
            let own = LookupTable::from_eec_variables(&eec, name).ok();
            let lash = data.number(&format!("$MA_BACKLASH[0,{name}]")).unwrap_or(0.0);
            let correction = |mm: f64, way| {
                let table =
                    own.as_ref().map_or(0.0, |own| own.value(mm / units.mm_per_unit(), way));
                let lash = if way == ApproachDirection::Negative { lash } else { 0.0 };
                cross_tables(name, name, mm, way) - (table + lash) * unit
            };
            let stated = table(&export, |table| {
                table.name.contains(&format!("of {name}"))
                    || (own.is_none()
                        && pitch.is_some_and(|p| p.reverse_um.is_some())
                        && table.section
                            == format!(
                                "axis.{}.pitch",
                                ["x", "y", "z"][name[2..].parse::<usize>().unwrap_or(1) - 1]
                            ))
            });
            worst = worst.max(assert_stated(
                stated,
                |mm, way| drive_um(axis, pitch, mm, way),
                correction,
            ));
        }
        for curve in &machine.straightness {
            let (error, along) = (curve.error, curve.along);
            let [output, input] = [error, along].map(|axis| format!("AX{}", axis.index() + 1));
            // Straightness and squareness are two tables that the control adds up.
            let pair = format!("from {} to {}", along.name(), error.name());
            let of_pair = export.report.tables.iter().filter(|table| table.name.ends_with(&pair));
            let of_pair: Vec<&ExportedTable> = of_pair.collect();
            let constant_um: f64 = of_pair.iter().map(|table| table.constant_um).sum();
            let stated_um: f64 = of_pair.iter().map(|table| table.largest.um).sum();
            let (first, last) =
                of_pair.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| {
                    (a.min(t.range.0), b.max(t.range.1))
                });
            for mm in positions(first, last) {
                for way in ApproachDirection::BOTH {
                    let left = cross_tables(&input, &output, mm, way)
                        + cross_um(&machine, error, along, mm)
                        - constant_um;
                    assert!(left.abs() <= stated_um + 0.02, "{left} at {mm} of {of_pair:?}");
                    if of_pair.iter().all(|table| table.loss.is_none()) {
                        worst = worst.max(left.abs());
                    }
                }
            }
        }
        let hot = export.report.tables.iter().filter(|table| table.file.ends_with(".csv"));
        heat = hot.map(|table| table.largest.um).fold(heat, f64::max);
        // Knots that nearly meet can ask for more equidistant points than there are.
        for table in export.report.tables.iter().filter(|table| table.loss.is_some()) {
            assert!(table.points == 2000 && table.name.starts_with("$AN_CEC"), "{table:?}");
            thinned += 1;
        }
    }
    println!(
        "siemens-840d: {MACHINES} machines, largest difference {worst:.4} µm, heat {heat:.4} µm; {thinned} \
         tables at the limit of points"
    );
    assert!(worst <= ExportOptions::default().tolerance_um, "{worst} µm");
    assert!(heat < 0.01, "{heat} µm");
}

#[test]
fn heidenhain_corrects_every_drive_and_every_pair_within_tolerance_and_rounding() {
    let mut worst = 0.0_f64;
    for seed in 0..MACHINES {
        let machine = Random(seed).machine();
        let export =
            export(&machine, ExportFormat::Heidenhain, &ExportOptions::default()).expect("it fits");
        let read =
            |key: &str| heidenhain::parse(text(&export, &format!("{key}.com"))).expect("it loads");
        for (name, axis, pitch) in drives(&machine) {
            let key = name.to_uppercase();
            let back = read(&key);
            let stated = table(&export, |table| table.file == format!("{key}.com"));
            let correction = |mm, way| {
                let column =
                    if way == ApproachDirection::Negative { "BACKLASH" } else { key.as_str() };
                back.correction_um(column, mm)
            };
            worst = worst.max(assert_stated(
                stated,
                |mm, way| drive_um(axis, pitch, mm, way),
                correction,
            ));
        }
        for curve in &machine.straightness {
            let (error, along) = (curve.error, curve.along);
            let key = along.name().to_uppercase();
            let back = read(&key);
            let stated = table(&export, |table| table.file == format!("{key}.com"));
            let column = error.name().to_uppercase();
            let correction = |mm, _| back.correction_um(&column, mm);
            worst = worst.max(assert_stated(
                stated,
                |mm, _| cross_um(&machine, error, along, mm),
                correction,
            ));
        }
        let thinned = export.report.tables.iter().filter(|table| table.loss.is_some()).count();
        assert_eq!(thinned, 0, "{}", export.report);
    }
    println!("heidenhain: {MACHINES} machines, largest difference {worst:.4} µm");
    // Half the tolerance for the lines, half of 0.1 µm for the rounding, and positions to 0.1 µm.
    assert!(worst < 0.11, "{worst} µm");
}

#[test]
fn fanuc_sums_stay_within_half_a_step_of_the_magnification_at_every_point() {
    let (mut worst, mut exported) = (0.0_f64, 0);
    for seed in 0..MACHINES {
        let machine = Random(seed).machine();
        let options =
            ExportOptions { unit_um: [1.0, 0.5][seed as usize % 2], ..ExportOptions::default() };
        let export = export(&machine, ExportFormat::Fanuc, &options).expect("it has tables");
        let control = fanuc::CompensationData::parse(
            text(&export, "CNC-PARA.TXT"),
            text(&export, "PITCH.TXT"),
        )
        .expect("it loads");
        for ((name, axis, pitch), number) in drives(&machine).into_iter().zip([1, 2, 4, 3]) {
            let Ok(back) = control.axis_tables(number) else {
                assert!(export.report.omitted.iter().any(|left| left.section.contains(&name[..1])));
                continue;
            };
            exported += 1;
            let stated = table(&export, |table| table.name.starts_with(&format!("axis {number},")));
            let correction =
                |mm, way| back.correction_in_detection_units(mm, way, false) * options.unit_um;
            assert_stated(stated, |mm, way| drive_um(axis, pitch, mm, way), correction);
            // At the points themselves only the rounding is left.
            let scale = control.parameter(3623, number).expect("it is there") as f64;
            let spacing = stated.spacing.expect("it is equidistant");
            for k in 0..=stated.points {
                let mm = stated.range.0 + spacing * k as f64;
                for way in ApproachDirection::BOTH {
                    let left = back.correction_in_detection_units(mm, way, true) * options.unit_um
                        + drive_um(axis, pitch, mm, way)
                        - stated.constant_um;
                    // The second table, and the backlash, begin at a rounded value of their own.
                    let rounded =
                        (scale + if way == ApproachDirection::Negative { 1.0 } else { 0.0 }) / 2.0;
                    assert!(
                        left.abs() <= rounded * options.unit_um + 1e-6,
                        "{left} at {mm} of {stated:?}"
                    );
                    worst = worst.max(left.abs() / options.unit_um);
                }
            }
        }
        for curve in &machine.straightness {
            let section = format!("straightness.{}", curve.name());
            let is_left = export.report.omitted.iter().any(|left| left.section.contains(&section));
            let is_held = export.report.tables.iter().any(|table| table.section.contains(&section));
            assert!(is_left != is_held, "{section} is either held or left out:\n{}", export.report);
        }
    }
    println!("fanuc: {exported} drives, largest difference at a point {worst:.3} units");
    assert!(exported > 3 * MACHINES, "{exported} drives");
}

#[test]
fn a_table_above_the_limit_is_thinned_to_it_with_the_loss_stated() {
    let forward = Random(7).walk(1000, 2.0);
    let source = format!(
        "[machine]\nname = \"long\"\nkind = \"3-axis\"\n[axis.x.pitch]\nstart_mm = 0.0\n\
         step_mm = 10.0\nforward_um = {forward:?}\n"
    );
    let machine = MachineFile::parse(&source, Path::new("long.toml")).expect("it is correct");
    for (format, most) in [
        (ExportFormat::LinuxCnc, 256),
        (ExportFormat::Heidenhain, 256),
        (ExportFormat::Siemens840d, 200),
        (ExportFormat::Fanuc, 128),
    ] {
        let options = ExportOptions {
            most_points: (format == ExportFormat::Siemens840d).then_some(200),
            ..ExportOptions::default()
        };
        let export = export(&machine, format, &options).expect("it can be thinned");
        let [table] = &export.report.tables[..] else { panic!("{}", export.report) };
        println!(
            "{}: {} points, {:?}, {:?}",
            format.name(),
            table.points,
            table.largest,
            table.loss
        );
        // FANUC's sections are whole multiples of the model's.
        let least = if format == ExportFormat::Fanuc { most - 5 } else { most };
        assert!((least..=most).contains(&table.points), "{table:?}");
        assert!(table.loss.is_some() && !export.report.is_complete());
        assert!(table.largest.um > 0.1, "{table:?}");
    }
}

#[test]
fn a_fanuc_axis_that_is_too_steep_is_omitted_with_the_reason() {
    let source = "[machine]\nname = \"steep\"\nkind = \"3-axis\"\n[axis.x.pitch]\nstart_mm = 0.0\n\
                  step_mm = 1.0\nforward_um = [0.0, 9000.0]\n";
    let machine = MachineFile::parse(source, Path::new("steep.toml")).expect("it is correct");
    let refused =
        export(&machine, ExportFormat::Fanuc, &ExportOptions::default()).expect_err("too steep");
    assert!(refused.to_string().contains("more than 7 times 8 units"), "{refused}");
}
