//! Every report in a real browser, headless Chromium: nothing is cut at 1280 and at 390 px, light and dark,
//! no error is reported, and the figures of a page are those of its JSON. Without a Chromium it is skipped.

use std::{fmt::Write as _, fs, path::Path, process::Command};

use trueup_accept::{AcceptanceCriteria, evaluate_acceptance};
use trueup_campaigns::{faulty_machine::SeparableFaultMachine, run_file::parse_run};
use trueup_demo::{
    hidden_fault_demo::run_hidden_fault_demo,
    html_report,
    measured_run_demo::{MeasuredRunInput, run_measured_run_demo},
    stepped_board::BoardSource,
    summary::DemoSummary,
};
use trueup_diagnose::diagnose;
use trueup_emulator::{
    linuxcnc::{
        self,
        loop_results::{AcceptanceCheck, ErrorCurve, ErrorCurves, LoopFigures, StaircaseStep},
    },
    process, setup,
};
use trueup_fleet::{
    findings::{EstimatedConstant, NamedFinding},
    random_effects::Estimate,
    record::MachineRecord,
};
use trueup_machine::{MachineFile, RunFile};
use trueup_page::format_micrometres;

/// Asks the page itself, once it is laid out: how wide the window is, what reaches beyond it or out of its
/// own box, which words and numbers a line's end cuts, and what was reported as an error.
const PROBE: &str = r#"<script>
const errors = []; addEventListener('error', event => errors.push(event.message));
addEventListener('load', () => {
  const wide = innerWidth, cut = [];
  for (const it of document.querySelectorAll('body *'))
    if (it.getBoundingClientRect().right > wide + 1) cut.push(it.tagName + ':' + it.textContent.slice(0, 40));
  for (const it of document.querySelectorAll('.table'))
    if (it.scrollWidth > it.clientWidth + 1) cut.push('table:' + it.textContent.slice(0, 40));
  const broken = [], texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let text; text = texts.nextNode();) {
    if (text.parentElement.closest('script,style,svg,pre')) continue;
    for (const word of text.textContent.matchAll(/[^\s-]+/g)) {
      const range = document.createRange();
      range.setStart(text, word.index);
      range.setEnd(text, word.index + word[0].length);
      const lines = [...range.getClientRects()].filter(it => it.width > 0.5).map(it => Math.round(it.top));
      if (new Set(lines).size > 1) broken.push(word[0]);
    }
  }
  const dark = matchMedia('(prefers-color-scheme: dark)').matches;
  const paper = getComputedStyle(document.body).backgroundColor;
  parent.postMessage(JSON.stringify(
    {wide, scroll: document.documentElement.scrollWidth, cut, broken, errors, dark, paper}), '*');
});
</script></head>"#;
/// A browser's window has a least width, a frame in it has not.
const FRAME: &str = "<!doctype html><script>addEventListener('message', event => {\
    document.body.textContent = 'PROBE ' + event.data})</script><body style=\"margin:0\">\
    <iframe src=\"page.html\" style=\"border:0;height:800px;width:WIDTHpx\"></iframe></body>";

fn chromium() -> Option<std::path::PathBuf> {
    ["chromium", "chromium-browser", "google-chrome"].into_iter().find_map(process::find_on_path)
}

/// Returns what the browser says of a page at this width.
fn probed(browser: &Path, folder: &Path, html: &str, width: u32, dark: bool) -> serde_json::Value {
    let file = folder.join("page.html");
    fs::write(&file, html.replacen("</head>", PROBE, 1)).expect("written");
    let frame = folder.join("frame.html");
    fs::write(&frame, FRAME.replace("WIDTH", &width.to_string())).expect("written");
    let mut command = Command::new(browser);
    command.args(["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]);
    command.arg(format!("--user-data-dir={}", folder.join("profile").display()));
    // In the browser's own time: as long as the page takes to say something.
    command.args(["--window-size=1300,900", "--virtual-time-budget=10000"]);
    if dark {
        command.arg("--force-dark-mode");
    }
    let output = command.arg("--dump-dom").arg(format!("file://{}", frame.display())).output();
    let text = String::from_utf8_lossy(&output.expect("it starts").stdout).into_owned();
    let answer = text.rsplit("PROBE ").next().and_then(|rest| rest.split("</body>").next());
    let answer = answer.unwrap_or_else(|| panic!("the page did not come up: {text}"));
    serde_json::from_str(&answer.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))
        .expect("JSON")
}

fn demonstration() -> String {
    let path = setup::project_root().join("data/paper_spindle.toml");
    let source = MachineFile::read_text(&path).expect("the project's own");
    let run = RunFile::read(&setup::project_root().join("data/spindle_paper_table1.csv"))
        .expect("the same");
    let asked = MeasuredRunInput { source: &source, path: &path, run: &run, quantity: None };
    let one =
        run_measured_run_demo(&BoardSource::InProcess, &asked, &mut |_, _| {}).expect("it runs");
    let hidden = SeparableFaultMachine::draw(7).expect("a machine that can be diagnosed");
    let two =
        run_hidden_fault_demo(&BoardSource::InProcess, &hidden, &mut |_, _| {}).expect("it runs");
    let html = html_report::render_page(&one, Some(&two));
    // What the page says is what the JSON says.
    let summary = DemoSummary::new(&one, Some(&two.outcome), "host", 0.0);
    let json = serde_json::to_value(&summary).expect("JSON");
    for um in [
        &json["paper"]["rms_um"],
        &json["calibrated"]["loo_rms_um"],
        &json["calibrated"]["loo_max_um"],
        &json["hidden"]["tool_rms_before_um"],
        &json["hidden"]["tool_rms_after_um"],
    ] {
        let figure = format_micrometres(um.as_f64().expect("a number"));
        assert!(html.contains(&figure), "{figure} is not on the page");
    }
    for finding in json["findings"].as_array().expect("a list") {
        assert!(html.contains(finding["sentence"].as_str().expect("a sentence")));
    }
    html
}

fn diagnosis() -> String {
    let hidden = SeparableFaultMachine::draw(0).expect("a machine that can be diagnosed");
    let run = hidden.record_day(0, false).expect("a record");
    let machine = MachineFile::parse(&hidden.plant.machine, Path::new("m.toml")).expect("a file");
    let diagnosis = diagnose(&machine, &[run], &[], None, &mut |_, _| {}).expect("comparable");
    diagnosis.render_html(
        "an axis",
        &trueup_page::Provenance::default(),
        &["trueup compile m.toml -o m.bin".into()],
    )
}

fn acceptance() -> String {
    let run = |left: f64| {
        let mut csv = String::from("time_s,measured_elongation_um\n");
        for minute in 0..120 {
            let um = 60.0 * left * (1.0 - (-f64::from(minute) / 30.0).exp());
            writeln!(csv, "{},{um:.2}", 60 * minute).expect("a string grows");
        }
        parse_run(&csv, "run.csv").expect("a run file")
    };
    let file = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"warmup\"\n\
                [spindle.warmup]\nlag_s = 0.0\nwarm_s = 7200.0\nmax_um = 36.0\nexponent = 4.0\n";
    let machine = MachineFile::parse(file, Path::new("m.toml")).expect("a file");
    let it = evaluate_acceptance(
        &run(1.0),
        &run(0.4),
        None,
        Some((file, &machine)),
        AcceptanceCriteria::default(),
    );
    it.expect("comparable").render_html("a spindle", &trueup_page::Provenance::default(), &[])
}

fn circle() -> String {
    let folder = setup::project_root().join("data/mill");
    let machine = MachineFile::read(&folder.join("mill.toml")).expect("the project's own");
    let run = |way| RunFile::read(&folder.join(format!("circle-{way}.csv"))).expect("the same");
    let report = trueup_fit::circle::analyse_circles(&["ccw", "cw"].map(run), Some(&machine));
    trueup_fit::circle::build_circle_page(
        &report.expect("a circle"),
        &trueup_page::Provenance::default(),
    )
    .to_html()
}

fn fleet() -> String {
    let record = |number: u8| {
        let value = if number == 7 { 19.0 } else { 7.0 + 0.5 * f64::from(number % 3) };
        let estimate = Estimate { value, se: 0.4 };
        let constant = EstimatedConstant { parameter: "offset_um".into(), estimate };
        let found = NamedFinding {
            name: "elongation sensor-offset".into(),
            identity: None,
            claimed: true,
            explains_um: 9.0,
            constants: vec![constant],
            alternatives: Vec::new(),
        };
        MachineRecord {
            machine: format!("M-{number:04}"),
            day: None,
            verdict: "explained".into(),
            quantity: "elongation".into(),
            belief: "the same".into(),
            found: vec![found],
            fitted: Vec::new(),
        }
    };
    let records: Vec<MachineRecord> = (1..=12).map(record).collect();
    let series = trueup_fleet::series::evaluate_series(&records, vec!["a note".into()]);
    trueup_fleet::html_report::render_html(&series, "shop", &trueup_page::Provenance::default())
}

/// Returns how many sheets of paper a page takes.
fn sheets(browser: &Path, folder: &Path, html: &str) -> usize {
    let (file, print) = (folder.join("page.html"), folder.join("page.pdf"));
    fs::write(&file, html).expect("written");
    let output = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer"])
        .arg(format!("--user-data-dir={}", folder.join("profile").display()))
        .arg(format!("--print-to-pdf={}", print.display()))
        .arg(format!("file://{}", file.display()))
        .output();
    assert!(output.expect("it starts").status.success(), "it prints");
    let pdf = fs::read(&print).expect("a print");
    let text = String::from_utf8_lossy(&pdf);
    let count = text.split("/Type /Pages").nth(1).and_then(|part| part.split("/Count ").nth(1));
    let count = count.and_then(|text| text.split_whitespace().next()?.parse().ok());
    count.expect("a PDF states its number of pages")
}

#[test]
#[ignore = "long: a browser that prints"]
fn an_acceptance_is_signed_on_one_sheet() {
    let Some(browser) = chromium() else {
        println!("skipped: there is no Chromium here (apt-get install chromium)");
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    assert_eq!(sheets(&browser, folder.path(), &acceptance()), 1);
    // What is longer takes more: the count is that of the print.
    assert!(sheets(&browser, folder.path(), &demonstration()) > 1);
}

/// Returns the page of the loop with LinuxCNC, of figures that were not measured.
fn loop_with_linuxcnc() -> String {
    let curve = |size_um: f64| {
        let at: Vec<f64> = (0..500).map(f64::from).collect();
        let before_um: Vec<f64> = at.iter().map(|mm| size_um * (mm / 60.0).sin()).collect();
        let after_um = before_um.iter().map(|um| 0.02 * um).collect();
        ErrorCurve { at, before_um, after_um }
    };
    let check = AcceptanceCheck {
        name: "straightness along the diagonal, X, Y and Z together",
        before_um: Some(195.19),
        after_um: Some(3.49),
        value: 98.21,
        unit: "%",
        limit: 95.0,
        at_least: true,
    };
    let missed = AcceptanceCheck { name: "a figure that is missed", value: 12.0, ..check.clone() };
    linuxcnc::html_report::render_page(&LoopFigures {
        checks: vec![check, missed],
        stairs: vec![StaircaseStep {
            z_mm: -1250.0,
            before_um: [-12.5, 3.0],
            after_um: [0.1, -0.2],
        }],
        curves: ErrorCurves {
            diagonal_y: curve(40.0),
            diagonal_z: curve(90.0),
            arc_z: curve(20.0),
            warm_up: curve(80.0),
            five_axes: curve(85.0),
        },
        machine_file: "[machine]\nname = \"a gantry with a very long line in its file\"\n"
            .repeat(30),
        ..LoopFigures::default()
    })
}

#[test]
#[ignore = "long: a browser for each page, width and colour"]
fn no_page_is_cut_or_wrong_in_a_browser() {
    let Some(browser) = chromium() else {
        println!("skipped: there is no Chromium here (apt-get install chromium)");
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let pages = [
        ("demonstration", demonstration()),
        ("diagnosis", diagnosis()),
        ("acceptance", acceptance()),
        ("circle", circle()),
        ("fleet", fleet()),
        ("loop with LinuxCNC", loop_with_linuxcnc()),
    ];
    for (name, html) in &pages {
        for outside in ["<script", "<link", "src=", "href=", "url("] {
            assert!(!html.contains(outside), "{name} stands alone: {outside}");
        }
        let mut papers = Vec::new();
        for (width, dark) in [(1280, false), (390, false), (390, true)] {
            let layout = probed(&browser, folder.path(), html, width, dark);
            println!("{name} at {width} px: {layout}");
            assert_eq!(layout["wide"], width, "the window is as wide as asked");
            assert!(
                layout["scroll"].as_u64().is_some_and(|value| value <= u64::from(width)),
                "{name}: {layout}"
            );
            assert_eq!(layout["cut"], serde_json::json!([]), "{name} at {width} px");
            assert_eq!(layout["broken"], serde_json::json!([]), "{name} at {width} px");
            assert_eq!(layout["errors"], serde_json::json!([]), "{name}");
            papers.push(layout["paper"].clone());
        }
        assert_ne!(papers[1], papers[2], "{name}: in the dark it is dark");
    }
}
