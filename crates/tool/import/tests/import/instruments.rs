//! Files of controls and instruments.

use std::path::Path;

use trueup_import::{CircleGeometry, ImportAnswers, ImportError, import};

use crate::{QuestionTopic, answers, bad, column, open, read_as, unit, values};

#[test]
fn a_compensation_file_of_linuxcnc_is_errors_there_and_back() {
    // 2 µm too far at 100 mm and a backlash of 5 µm, as `trueup export` writes it: trims are minus the error.
    let trims = "0 0 -0.005\n100 -0.002 -0.007\n";
    let actual = "0 0 0.005\n100 100.002 100.007\n";
    let given = [
        (column("nominal"), "x_mm"),
        (column("error"), "measured_dx_um"),
        (unit("nominal"), "mm"),
        (unit("error"), "mm"),
    ];
    for text in [trims, actual] {
        let imported = read_as("x.comp", text.as_bytes(), &given);
        assert_eq!(
            imported.run,
            "run,x_mm,dir_x,measured_dx_um\n1,0,1,0\n1,100,1,2\n1,100,-1,7\n1,0,-1,5\n",
            "{text}"
        );
    }
    let inches =
        [given[0].clone(), given[1].clone(), (unit("nominal"), "inch"), (unit("error"), "inch")];
    let imported = read_as("x.comp", trims.as_bytes(), &inches);
    assert_eq!(values(&imported, "measured_dx_um")[1], 50.8);
    for text in ["0 0 0\nhead\n1 0 0\n", "0 0 0\n0 1 1\n", "1 2\n"] {
        assert!(matches!(
            import(text.as_bytes(), Path::new("x.comp"), &answers(&[])),
            Err(ImportError::Bad(_))
        ));
    }
}

#[test]
fn tables_of_a_sinumerik_are_errors_by_position() {
    // As `trueup export --format siemens-840d` writes it: +2 µm at 100 mm.
    let table = "%_N_AX_EEC_INI\nCHANDATA(1)\n$AA_ENC_COMP[0,0,AX1]=0.0\n$AA_ENC_COMP[0,1,AX1]=0.002 ; at 100\n\
                 $AA_ENC_COMP[0,2,AX1]=-0.0015\n$AA_ENC_COMP_STEP[0,AX1]=100.0\n$AA_ENC_COMP_MIN[0,AX1]=-50.0\n\
                 $AA_ENC_COMP_MAX[0,AX1]=150.0\n$AA_ENC_COMP_IS_MODULO[0,AX1]=0\nM17\n";
    let given = [
        (column("position"), "x_mm"),
        (column("value"), "measured_dx_um"),
        (unit("position"), "mm"),
        (unit("value"), "mm"),
    ];
    let imported = read_as("AX_EEC.INI", table.as_bytes(), &given);
    assert_eq!(imported.run, "x_mm,dir_x,measured_dx_um\n-50,1,0\n50,1,2\n150,1,-1.5\n",);
    // Axis and unit do not stand in it, and are asked for.
    assert_eq!(open(table, &[]), [column("position"), column("value")]);
    assert_eq!(open(table, &given[..2]), [unit("position"), unit("value")]);
    for (text, phrase) in [
        (table.replace("_MIN[0", "_MINI[0"), "$AA_ENC_COMP_MIN is missing"),
        (table.replace("[0,2,AX1]", "[0,2,AX2]"), "5:1: is a table of AX2"),
        (table.replace("=0.002", "=two"), "4:1: is not $AA_ENC_COMP"),
    ] {
        assert!(bad(&text, &given).contains(phrase), "{text}: {}", bad(&text, &given));
    }
}

#[test]
fn tables_of_a_heidenhain_are_errors_there_and_back() {
    // As `trueup export --format heidenhain` writes it.
    let table = "BEGIN X.com MM\nNR AXISPOS BACKLASH X Z\n0 +0 +0.005 +0 +0\n1 +100 +0.007 +0.002 -0.004\n[END]\n";
    let imported = read_as("X.com", table.as_bytes(), &[]);
    assert_eq!(
        imported.run,
        "run,x_mm,dir_x,measured_dx_um,measured_dz_um\n1,0,1,0,0\n1,100,1,2,-4\n1,100,-1,7,-4\n1,0,-1,5,0\n"
    );
    let inches =
        read_as("Y.com", table.replace(" Z\n", " Y\n").replace(" MM", " INCH").as_bytes(), &[]);
    assert_eq!(values(&inches, "measured_dx_um"), [0.0, 50.8, 50.8, 0.0]);
    assert_eq!(values(&inches, "measured_dy_um")[2], 177.8);
    for (text, phrase) in [
        (table.replace(" MM", ""), "1:1: does not end with MM or INCH"),
        (table.replace("-0.004\n[", "["), " is not an entry of 5 numbers"),
        (table.replace(" Z\n", " C\n"), "2:1: has a column C"),
    ] {
        assert!(bad(&text, &[]).contains(phrase), "{text}: {}", bad(&text, &[]));
    }
}

#[test]
fn height_maps_are_errors_of_z_and_points_without_a_probe_are_omitted() {
    let reprap = "RepRapFirmware height map file v2 generated at 2026-04-03 08:15, mean error 0.01\n\
                  axis0,axis1,min0,max0,min1,max1,radius,spacing0,spacing1,num0,num1\n\
                  X,Y,5.00,25.00,5.00,15.00,-1.00,10.00,10.00,3,2\n\
                  \x20 0.100, -0.050,  0.000\n      0,  0.020,  0.030\n";
    let expected = "x_mm,y_mm,measured_dz_um\n5,5,-100\n15,5,50\n25,5,0\n15,15,-20\n25,15,-30\n";
    let imported = read_as("heightmap.csv", reprap.as_bytes(), &[]);
    assert_eq!(imported.run, expected);
    assert!(imported.notes.iter().any(|note| note.contains("1 points were not probed")));
    let old = reprap
        .replace(
            "axis0,axis1,min0,max0,min1,max1,radius,spacing0,spacing1,num0,num1",
            "xmin,xmax,ymin,ymax,radius,xspacing,yspacing,xnum,ynum",
        )
        .replace("X,Y,", "");
    assert_eq!(read_as("heightmap.csv", old.as_bytes(), &[]).run, expected);
    let klipper = "[printer]\nkinematics = cartesian\n\n#*# <---- SAVE_CONFIG ---->\n#*# [bed_mesh default]\n\
                   #*# version = 1\n#*# points =\n#*# \t0.100, -0.050, 0.000\n#*# \t0.010, 0.020, 0.030\n\
                   #*# x_count = 3\n#*# y_count = 2\n#*# min_x = 5\n#*# max_x = 25\n#*# min_y = 5\n#*# max_y = 15\n";
    let imported = read_as("printer.cfg", klipper.as_bytes(), &[]);
    assert_eq!(
        imported.run,
        "x_mm,y_mm,measured_dz_um\n5,5,-100\n15,5,50\n25,5,0\n5,15,-10\n15,15,-20\n25,15,-30\n"
    );
    for (text, phrase) in [
        (reprap.replace("3,2\n", "4,2\n"), "4:1: the grid has 4 points a line, this one 3"),
        (reprap.replace("3,2\n", "3,3\n"), "the grid has 3 lines of points, the file 2"),
        (reprap.replace("0.020", "x"), "5:1: \"x\" is no height"),
        (reprap.replace("X,Y,", "X,Z,"), "3:1: the map is not over X and Y"),
    ] {
        let refused = import(text.as_bytes(), Path::new("heightmap.csv"), &answers(&[]));
        let Err(ImportError::Bad(error)) = refused else { panic!("{text}: {refused:?}") };
        assert!(error.to_string().contains(phrase), "{error}");
    }
}

/// Three targets, one run there and one back.
fn target_data(back: [&str; 3]) -> String {
    format!(
        "HEADER::\r\nFile type: 41\r\nTARGET DATA::\r\nFiletype: 3\r\nTarget-count: 3\r\nTargets :\r\n  0.0000  \
         50.0000\r\n  100.0000\r\nFlags: 1 0 4\r\nUSER-TEXT::\r\nMachine: mill\r\nDate: 08:15\r\nRUNS::\r\n\
         Run-count: 2\r\nDEVIATIONS::\r\nRun Target Data:\r\n  1  1  0.1\r\n  1  2  0.5\r\n  1  3  1.5\r\n  2  {}\r\n  \
         2  {}\r\n  2  {}\r\nENVIRONMENT::\r\nEOF::\r\n",
        back[0], back[1], back[2]
    )
}

#[test]
fn target_data_of_a_laser_is_runs_with_directions_and_its_units_are_asked() {
    let given = [
        (column("target"), "x_mm"),
        (column("deviation"), "measured_dx_um"),
        (unit("target"), "mm"),
        (unit("deviation"), "µm"),
    ];
    let expected = "run,x_mm,dir_x,measured_dx_um\n1,0,1,0.1\n1,50,1,0.5\n1,100,1,1.5\n";
    let text = target_data(["3  2.5", "2  1.5", "1  1.1"]);
    let imported = read_as("x.rtl", text.as_bytes(), &given);
    assert_eq!(imported.run, format!("{expected}2,100,-1,2.5\n2,50,-1,1.5\n2,0,-1,1.1\n"));
    let Err(ImportError::Open(questions)) =
        import(text.as_bytes(), Path::new("x.rtl"), &answers(&[]))
    else {
        panic!("it has no units")
    };
    assert_eq!(questions.len(), 2, "{questions:?}");
    // Runs that are all written in one order.
    let text = target_data(["1  1.1", "2  1.5", "3  2.5"]);
    let Err(ImportError::Open(questions)) =
        import(text.as_bytes(), Path::new("x.rtl"), &answers(&given))
    else {
        panic!("the way back is not stated")
    };
    assert_eq!(questions[0].topic, QuestionTopic::Runs);
    let with = |runs| {
        let all = [&given[..], &[(QuestionTopic::Runs, runs)]].concat();
        values(&read_as("x.rtl", text.as_bytes(), &all), "dir_x")
    };
    assert_eq!(with("there-and-back"), [1.0, 1.0, 1.0, -1.0, -1.0, -1.0]);
    assert_eq!(with("one-way"), [1.0; 6]);
    for (from, to, phrase) in [
        ("Target-count: 3", "Target-count: 4", "6:1: Target-count is 4, there are 3 targets"),
        ("2  3  2.5", "2  9  2.5", "there is no target 9"),
        ("  1  2  0.5", "  1  2", "is not run, target and deviation"),
    ] {
        let text = target_data(["1  1.1", "2  1.5", "3  2.5"]).replace(from, to);
        let refused = import(text.as_bytes(), Path::new("x.rtl"), &answers(&given));
        let Err(ImportError::Bad(error)) = refused else { panic!("{from}: {refused:?}") };
        assert!(error.to_string().contains(phrase), "{error}");
    }
}

#[test]
fn a_table_of_a_laser_with_a_column_for_each_run_and_way_keeps_the_ways() {
    // As CARTO lays one out: titles, a row for each target, the ways as signs or words.
    let signs = "\"Title\",\"linear\"\n\"Axis\",\"X\"\n\nTarget (mm),Run 1 + (µm),Run 1 - (µm),Run 2 + (µm),Run 2 - (µm)\n\
                 0.0,0.0,1.2,0.1,1.3\n97.3,-1.1,0.3,-1.0,0.2\n201.9,-2.3,-0.9,-2.2,-1.0\n";
    let words = signs.replace(" + (", " Forward (").replace(" - (", " Reverse (");
    let given = |ways: &str| {
        [(column("Target (mm)"), "x_mm".to_string()), (column(ways), "measured_dx_um".to_string())]
    };
    for (text, first) in [(signs, "Run 1 + (µm)"), (&words, "Run 1 Forward (µm)")] {
        let given = given(first);
        let given: Vec<_> = given.iter().map(|(at, text)| (at.clone(), text.as_str())).collect();
        let imported = read_as("carto.csv", text.as_bytes(), &given);
        assert_eq!(values(&imported, "x_mm")[..6], [0.0, 97.3, 201.9, 201.9, 97.3, 0.0], "{text}");
        assert_eq!(values(&imported, "dir_x")[..6], [1.0, 1.0, 1.0, -1.0, -1.0, -1.0], "{text}");
        assert_eq!(values(&imported, "run")[4..8], [1.0, 1.0, 2.0, 2.0], "{text}");
        assert_eq!(values(&imported, "measured_dx_um")[3..6], [-0.9, 0.3, 1.2], "{text}");
    }
    // A column without a way next to others with one.
    let mixed = signs.replace("Run 2 - (", "Run 2 (");
    assert!(
        bad(&mixed, &[]).contains("4:52: Run 2 (µm) states no direction"),
        "{}",
        bad(&mixed, &[])
    );
}

#[test]
fn a_protocol_in_columns_of_blanks_has_headers_of_several_words() {
    // Target and actual position, as a control prints them in columns.
    let units = "Protocol\nAxis: X\nPos-No.  Target position [mm]   Actual position [mm]\n\
                 1        0.000                  0.002\n  2      100.000                100.004\n\
                 3      200.000                199.993\n";
    let given = [(column("Target position [mm]"), "x_mm")];
    let imported = read_as("log.txt", units.as_bytes(), &given);
    assert_eq!(imported.run, "x_mm,measured_dx_um\n0,2\n100,4\n200,-7\n");
}

#[test]
fn what_no_source_describes_is_refused_in_a_line_with_what_would_do() {
    for (name, content, phrase) in [
        ("a.b5r", &b"\x00\x01B5R\xff"[..], "program backlash"),
        ("A.B5R", b"<?xml version=\"1.0\"?><test/>", "ball-bar"),
        ("a.rtx", b"\x00\xff", "target data (.rtl)"),
        ("mill.xml", b"<?xml version=\"1.0\"?>\n<profile><Preferences/></profile>", "Mach3"),
        ("Machine.ini", b"[Motor0]\nCountsPerUnit=2000\n", "Mach4"),
        ("a.xml", b"<?xml version=\"1.0\"?><x/>", "csv, tsv, txt, xlsx or ods"),
        ("TCHPR421.TXT", b"Measuring log\nDiameter: 12.000\n", "FN16"),
        ("log.txt", b"MEASURING LOG PROBING CYCLE 418\nNOMINAL VALUE X : 100.0\n", "FN16"),
    ] {
        let refused = import(content, Path::new(name), &answers(&[])).expect_err(name);
        let ImportError::Bad(error) = refused else { panic!("{name} leaves a question open") };
        let line = format!("{error}. {}", error.help.as_deref().unwrap_or_default());
        assert!(line.contains(phrase) && line.lines().count() == 1, "{name}: {line}");
    }
}

#[test]
fn a_table_below_the_title_of_a_probing_cycle_is_read() {
    for title in ["Probing cycle 978", "Antastzyklus 426"] {
        let text = format!("{title}\nX [mm];Error X [µm]\n0;1\n50;3\n100;4\n");
        let imported = read_as("log.txt", text.as_bytes(), &[]);
        assert_eq!(imported.run, "x_mm,measured_dx_um\n0,1\n50,3\n100,4\n", "{title}");
    }
}

#[test]
fn a_table_of_angles_becomes_positions_on_the_circle_that_is_named() {
    let circle = |is_clockwise| CircleGeometry {
        radius_mm: 100.0,
        centre_mm: [250.0, -40.0],
        axes: ['z', 'x'],
        is_clockwise,
    };
    let import = |text: &str, is_clockwise| {
        let answers =
            ImportAnswers { circle: Some(circle(is_clockwise)), ..ImportAnswers::default() };
        import(text.as_bytes(), "bar.csv".as_ref(), &answers)
    };
    let table = "angle_deg,dr_um\n0,1.5\n90,-2\n180,0.25\n";
    let imported = import(table, None).expect("a table of angles");
    assert_eq!(imported.run, "z_mm,x_mm,measured_dr_um\n350,-40,1.5\n250,60,-2\n150,-40,0.25\n");
    let german = "Winkel [°];Abweichung [mm]\n0,0;0,0015\n90,0;-0,002\n";
    let imported = import(german, Some(true)).expect("a German one");
    assert_eq!(imported.run, "z_mm,x_mm,dir,measured_dr_um\n350,-40,-1,1.5\n250,60,-1,-2\n");
    let Err(ImportError::Bad(error)) = import("x_mm,dr_um\n1,2\n2,3\n", None) else {
        panic!("a table without angles")
    };
    assert!(error.rule.contains("--column 1=angle_deg"), "{error}");
}
