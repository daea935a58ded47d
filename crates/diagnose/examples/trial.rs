//! Trial.
use std::path::Path;
use trueup_machine::*;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let m = MachineFile::read(Path::new(&a[1])).unwrap();
    let mut runs = vec![];
    let mut hold = vec![];
    let mut h = false;
    for p in &a[2..] {
        if p == "--holdout" {
            h = true;
            continue;
        }
        let r = RunFile::read(Path::new(p)).unwrap();
        if h { hold.push(r) } else { runs.push(r) }
    }
    let d = trueup_diagnose::diagnose(&m, &runs, &hold, None, &mut |_, _| {}).unwrap();
    println!("{}", d.json().unwrap());
    let src = std::fs::read_to_string(&a[1]).unwrap();
    std::fs::write("/tmp/dx/extended.toml", d.extended(&src, Path::new("x.toml")).unwrap())
        .unwrap();
    std::fs::write("/tmp/dx/report.html", d.html("m")).unwrap();
}
