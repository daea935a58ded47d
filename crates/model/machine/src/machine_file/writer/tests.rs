use super::*;

const PATH: &str = "m.toml";

fn sensor() -> NewSection {
    NewSection::new("spindle.sensor")
        .with_number("k0_um", -4.0)
        .with_number("zero_counts", 5048.0)
        .with_number("um_per_count", 0.019_798_276_521_3)
        .with_preserved_keys(&["temperature"])
        .with_header_comment("15 rows, 0.84 µm RMS")
}

fn applied(source: &str, edit: &MachineFileEdit) -> String {
    edit.apply(source, Path::new(PATH)).expect("a machine file and a valid section")
}

const PLAIN: &str = "# my mill\n[machine]\nname = \"mill\" # the old one\nkind = \"3-axis\"\n";

#[test]
fn a_section_that_is_there_is_replaced_and_nothing_else_changes() {
    let source = format!(
        "{PLAIN}\n[spindle]\nsource = \"sensor\"\n\n# from the paper\n[spindle.sensor]\n\
         zero_counts = 5048.0  # after 24 h\ntemperature = \"temp_coil_c\"\nk0_um=0\n\
         um_per_count = 0.0152587890625\n\n[limits]\nhold_ms = 0x10 # as long as that\n"
    );
    let expected = source
        .replace("k0_um=0", "k0_um=-4.0")
        .replace("um_per_count = 0.0152587890625", "um_per_count = 0.0197982765213");
    assert_eq!(applied(&source, &MachineFileEdit::from_section(sensor())), expected);
}

#[test]
fn a_section_that_is_not_there_is_added_with_its_remark_and_its_source() {
    let mut edit = MachineFileEdit::from_section(sensor());
    edit.defaults.push(("spindle".into(), "source", Value::Text("sensor".into())));
    let text = applied(PLAIN, &edit);
    assert_eq!(
        text,
        format!(
            "{PLAIN}\n[spindle]\nsource = \"sensor\"\n\n# 15 rows, 0.84 µm RMS\n\
             [spindle.sensor]\nk0_um = -4.0\nzero_counts = 5048.0\n\
             um_per_count = 0.0197982765213\n"
        )
    );
    // What the user has chosen already stays.
    let chosen = format!(
        "{PLAIN}[spindle]\nsource = \"temperature\"\n[spindle.temperature]\n\
         sensor = \"temp_a_c\"\nreference_c = 20\nk_um_per_c = 2\n"
    );
    assert!(applied(&chosen, &edit).contains("source = \"temperature\""));
}

#[test]
fn it_makes_no_difference_how_the_user_wrote_the_section() {
    let numbers = "k0_um = 0, zero_counts = 1, um_per_count = 2";
    let forms = [
        format!("[spindle]\nsource = \"sensor\"\nsensor = {{ {numbers} }}\n"),
        format!("[spindle.sensor]\n{}\n", numbers.replace(", ", "\n")),
        "[spindle]\nsensor.k0_um = 0\nsensor.zero_counts = 1\nsensor.um_per_count = 2\n".into(),
        format!("[spindle]\nsensor = {{ {numbers}, temperature = \"temp_coil_c\" }}\n"),
        "[axis.x]\nfeedback = \"scale\"\n".into(),
        "[axis]\nx = { feedback = \"scale\" }\n".into(),
        "[axis]\nx.feedback = \"scale\"\n".into(),
    ];
    for form in forms {
        let mut edit = MachineFileEdit::from_section(sensor());
        let pitch = NewSection::new("axis.x.pitch").with_number("start_mm", 0.0);
        let pitch = pitch.with_number("step_mm", 0.1).with_numbers("forward_um", [0.1 + 0.2; 20]);
        edit.sections.push(pitch);
        let text = applied(&format!("{PLAIN}{form}"), &edit);
        let machine = MachineFile::parse(&text, Path::new(PATH)).expect("checked by apply");
        let sensor = machine.spindle.sensor.expect("just written");
        assert_eq!(sensor.um_per_count, 0.019_798_276_521_3, "{text}");
        assert_eq!(sensor.temperature.is_some(), form.contains("temp_coil_c"), "{text}");
        let pitch = machine.axes[0].pitch.as_ref().expect("just written");
        assert_eq!(pitch.forward_um, [0.1 + 0.2; 20], "{text}");
    }
}

#[test]
fn what_contradicts_the_new_section_is_taken_away() {
    let source =
        format!("{PLAIN}[axis.x.backlash]\nwidth_um = 4\n[axis.y.backlash]\nwidth_um = 5 # keep\n");
    let pitch =
        NewSection::new("axis.x.pitch").with_number("start_mm", 0.0).with_number("step_mm", 1.0);
    let pitch = pitch.with_numbers("forward_um", [0.0, 1.0]).with_numbers("reverse_um", [1.0, 2.0]);
    let mut edit = MachineFileEdit::from_section(pitch);
    let refused = edit.apply(&source, Path::new(PATH)).expect_err("both tables and backlash");
    assert!(refused.rule.starts_with("with what is to be written: "), "{refused}");
    edit.removed.push("axis.x.backlash".into());
    edit.removed.push("axis.z.backlash".into());
    let text = applied(&source, &edit);
    assert!(!text.contains("axis.x.backlash") && text.contains("width_um = 5 # keep"));
    assert!(edit.to_toml().contains("# A machine file must not have [axis.x.backlash] as well."));
}

#[test]
fn windows_line_ends_and_the_byte_order_mark_stay() {
    let source = format!("\u{feff}{}", PLAIN.replace('\n', "\r\n"));
    let text = applied(&source, &MachineFileEdit::from_section(sensor()));
    assert!(text.starts_with("\u{feff}# my mill\r\n"));
    assert_eq!(text.matches('\n').count(), text.matches("\r\n").count());
}

#[test]
fn the_section_alone_is_the_same_section() {
    let alone =
        MachineFileEdit::from_section(sensor().with_header_comment("a line\nbreak")).to_toml();
    assert_eq!(
        alone,
        "# 15 rows, 0.84 µm RMS\n# a line break\n[spindle.sensor]\nk0_um = -4.0\n\
         zero_counts = 5048.0\num_per_count = 0.0197982765213\n"
    );
    let text = format!("{PLAIN}{alone}");
    let machine = MachineFile::parse(&text, Path::new(PATH)).expect("a machine file");
    assert_eq!(machine.spindle.sensor.expect("written").k0_um, -4.0);
}

#[test]
fn every_number_reads_back_to_the_same_bits() {
    for number in [1e-300, 1.0 / 3.0, -0.1, 1e22, 123_456_789.123_456_79, 5e-324, 1e300] {
        let section = NewSection::new("axis.x.pitch").with_number("start_mm", number);
        let section = section.with_number("step_mm", 1.0).with_numbers("forward_um", [number]);
        let text = applied(PLAIN, &MachineFileEdit::from_section(section));
        let machine = MachineFile::parse(&text, Path::new(PATH)).expect("checked by apply");
        let pitch = machine.axes[0].pitch.as_ref().expect("just written");
        assert_eq!(pitch.start_mm.to_bits(), number.to_bits(), "{text}");
        assert_eq!(pitch.forward_um[0].to_bits(), number.to_bits(), "{text}");
    }
}

#[test]
fn rounding_takes_what_the_measurement_cannot_give() {
    assert_eq!(round_to_decimals(7.123_456_789, 4), 7.1235);
    assert_eq!(round_to_decimals(-0.000_001, 4).to_bits(), 0.0_f64.to_bits());
    assert_eq!(round_to_decimals(1e300, 4), 1e300);
    assert!(round_to_decimals(f64::NAN, 4).is_nan());
}

#[test]
fn a_file_that_is_no_file_is_refused_at_its_own_place() {
    let error =
        MachineFileEdit::from_section(sensor()).apply("[machine]\nnam = 1\n", Path::new(PATH));
    let error = error.expect_err("a misspelt key").to_string();
    assert_eq!(error, "m.toml:2:1: unknown key machine.nam; did you mean name?");
}

fn gain() -> NewSection {
    NewSection::new("term")
        .with_text("cause", "sensor-gain")
        .with_text("quantity", "elongation")
        .with_number("gain", 1.25)
}

#[test]
fn a_table_is_appended_after_the_last_of_its_array_or_at_the_end() {
    let edit = MachineFileEdit { appended: vec![gain(), gain()], ..MachineFileEdit::default() };
    let written = "\n[[term]]\ncause = \"sensor-gain\"\nquantity = \"elongation\"\ngain = 1.25\n";
    // Sections that are not next to their kin, a comment, no line end at the end.
    let source = format!(
        "{PLAIN}[axis.x.backlash]\nwidth_um = 4\n[limits]\nhold_ms = 9\n[axis.y.backlash]\nwidth_um = 5 # mm"
    );
    let text = applied(&source, &edit);
    assert_eq!(text, format!("{source}\n{written}{written}"));
    // Behind the terms that are there, of whatever form.
    let there = written.replace("1.25", "1.5");
    let source = format!("{PLAIN}{there}\n[limits] # as before\nhold_ms = 9\n");
    let text = applied(&source, &edit);
    assert_eq!(
        text,
        format!("{PLAIN}{there}{written}{written}\n[limits] # as before\nhold_ms = 9\n")
    );
    let inline = format!(
        "term = [{{ cause = \"sensor-gain\", quantity = \"elongation\", gain = 1.5 }}]\n{PLAIN}"
    );
    let machine = MachineFile::parse(&applied(&inline, &edit), Path::new(PATH)).expect("checked");
    assert_eq!(machine.terms.len(), 3);
}

#[test]
fn a_table_is_replaced_where_it_stands_and_comments_stay() {
    let edit = MachineFileEdit { replaced: vec![(1, gain())], ..MachineFileEdit::default() };
    let term = |gain: &str| {
        format!(
            "[[term]] # seen in May\ncause = \"sensor-gain\"\nquantity = \"elongation\"\n{gain}\n"
        )
    };
    let of =
        |second: &str| format!("{PLAIN}{}{}{}", term("gain = 1"), term(second), term("gain = 3"));
    // A key that the new one does not have goes.
    let text = applied(&of("gain = 1.5 # by gauge blocks\nconstant_um = 3"), &edit);
    assert_eq!(text, of("gain = 1.25 # by gauge blocks"));
    let inline = "{ cause = \"sensor-gain\", quantity = \"elongation\", gain = 1.5 }";
    let text = applied(&format!("term = [{inline}, {inline}]\n{PLAIN}"), &edit);
    let replaced = inline.replace("1.5", "1.25");
    assert_eq!(text, format!("term = [{inline}, {replaced}]\n{PLAIN}"));
}

#[test]
fn a_note_stands_next_to_a_new_key_and_an_inline_table_on_its_line() {
    let max =
        Value::Inline(vec![("x".into(), Value::Number(1e-7)), ("z".into(), Value::Number(2.0))]);
    let limits = NewSection::new("limits").with_value("max_um", max).with_integer("hold_ms", 7);
    let edit = MachineFileEdit::from_section(limits.with_key_comment("hold_ms", "of\nthe board"));
    let section = "[limits]\nmax_um = { x = 1e-7, z = 2.0 }\nhold_ms = 7";
    assert_eq!(edit.to_toml(), format!("{section} # of the board\n"));
    let source = format!("{PLAIN}\n[limits]\nhold_ms = 9 # mine\n");
    let text = applied(&source, &edit);
    assert!(text.contains("hold_ms = 7 # mine\n"), "{text}");
}

#[test]
fn a_text_of_any_characters_reads_back() {
    let description = "a \"laser\" \\ µ\n\u{1}";
    let term = NewSection::new("term")
        .with_text("cause", "reference-instrument")
        .with_text("quantity", "dx")
        .with_text("description", description);
    let text =
        applied(PLAIN, &MachineFileEdit { appended: vec![term], ..MachineFileEdit::default() });
    let machine = MachineFile::parse(&text, Path::new(PATH)).expect("checked by apply");
    assert!(format!("{:?}", machine.terms[0]).contains(&format!("{description:?}")), "{text}");
}
