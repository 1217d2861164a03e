use mission::place::Geodetic;
use mission::read::agopengps::{Files, read};
use mission::read::{Drawing, Role, Shape};

use super::{at, outline, skipped};

pub(super) const FIELD: &str = "2026-May-04 10:11:12 AM\n$FieldDir\nFieldNew\n$Offsets\n0,0\nConvergence\n0\nStartFix\n40,-97\n";

/// A field of 100 m by 200 m with a tree and a waterway.
pub(super) const BOUNDARY: &str = "$Boundary
False
5
0,0,0
100,0,1.57080
100,200,3.14159
0,200,4.71239
0,0,0
False
False
3
50,50,0
52,50,0
52,52,0
True
3
10,10,0
12,10,0
12,12,0
";

const AB_LINES: &str = "North,0,10,20\nEast,90,10,20\nbroken,x\n";

const CURVES: &str = "$CurveLines
bend
0.1
4
0,0,0
0,10,0.1
x,y,z
1,20,0.1
short
0
1
5,5,0
";

const TRACKS: &str = "$TrackLines
AB 1
0
10,0
10,50
0.5
2
True
0
Cu 2
0.2
0,0
1,20
0
4
True
3
0,0,0
0,10,0.1
1,20,0.1
Pivot
0
0,0
0,0
0
64
True
0
";

/// The files of a field, as the fuzz target takes them.
pub(super) fn all() -> String {
    [FIELD, BOUNDARY, AB_LINES, CURVES, TRACKS].join("\0")
}

fn files(files: Files) -> Drawing {
    read(&Files {
        field: FIELD,
        ..files
    })
    .unwrap()
}

fn line(drawing: &Drawing, index: usize) -> (Geodetic, Geodetic) {
    match drawing.shapes[index].shape {
        Shape::Line { from, to } => (from, to),
        _ => panic!("{drawing:?}"),
    }
}

/// Metres in a degree at 40 degrees north (Snyder, Map Projections, 1987, table 10-1), within 1 m.
const DEGREE: (f64, f64) = (111_035.0, 85_394.0);

#[test]
fn a_boundary_with_its_inner_ones() {
    let drawing = files(Files {
        boundary: Some(BOUNDARY),
        ..Files::default()
    });
    assert_eq!(drawing.origin, Some(at(40.0, -97.0)));
    assert_eq!(
        outline(&drawing),
        [("boundary 1", Role::Boundary, vec![4, 3])]
    );
    assert_eq!(
        skipped(&drawing),
        ["an inner boundary that may be driven through (line 19)"]
    );
    let Shape::Polygon { outer, .. } = &drawing.shapes[0].shape else {
        panic!()
    };
    let far = outer[2];
    assert!(
        (far.latitude - 40.0 - 200.0 / DEGREE.0).abs() < 2e-8,
        "{far:?}"
    );
    assert!(
        (far.longitude + 97.0 - 100.0 / DEGREE.1).abs() < 4e-8,
        "{far:?}"
    );
}

#[test]
fn lines_have_a_heading_in_degrees() {
    let drawing = files(Files {
        ab_lines: Some(AB_LINES),
        ..Files::default()
    });
    assert_eq!(
        outline(&drawing),
        [
            ("North", Role::Guidance, vec![2]),
            ("East", Role::Guidance, vec![2])
        ]
    );
    assert_eq!(
        skipped(&drawing),
        ["a line of ABLines.txt that is none (line 3)"]
    );
    let (from, to) = line(&drawing, 0);
    assert!(
        (from.latitude - 40.0 - 20.0 / DEGREE.0).abs() < 1e-8,
        "{from:?}"
    );
    assert!(
        (from.longitude + 97.0 - 10.0 / DEGREE.1).abs() < 1e-8,
        "{from:?}"
    );
    assert!(
        (to.latitude - from.latitude - 100.0 / DEGREE.0).abs() < 2e-8,
        "{to:?}"
    );
    let (from, to) = line(&drawing, 1);
    assert!(
        (to.longitude - from.longitude - 100.0 / DEGREE.1).abs() < 2e-8,
        "{to:?}"
    );
}

#[test]
fn curves_of_the_older_files() {
    let drawing = files(Files {
        curve_lines: Some(CURVES),
        ..Files::default()
    });
    assert_eq!(outline(&drawing), [("bend", Role::Guidance, vec![3])]);
    assert_eq!(
        skipped(&drawing),
        [
            "a line of CurveLines.txt that is no point (line 7)",
            "a line of fewer than two places"
        ]
    );
}

#[test]
fn tracks_replace_the_older_files() {
    let drawing = files(Files {
        track_lines: Some(TRACKS),
        ab_lines: Some(AB_LINES),
        curve_lines: Some(CURVES),
        ..Files::default()
    });
    assert_eq!(
        outline(&drawing),
        [
            ("AB 1", Role::Guidance, vec![2]),
            ("Cu 2", Role::Guidance, vec![3])
        ]
    );
    assert_eq!(skipped(&drawing), ["a pivot, which is no line (line 28)"]);
    // Nudged half a metre to the right, which is east.
    let (from, _) = line(&drawing, 0);
    assert!(
        (from.longitude + 97.0 - 10.5 / DEGREE.1).abs() < 1e-8,
        "{from:?}"
    );
    let off = TRACKS.replacen("2\nTrue", "2\nFalse", 1);
    let drawing = files(Files {
        track_lines: Some(&off),
        ab_lines: Some(AB_LINES),
        ..Files::default()
    });
    assert_eq!(outline(&drawing), [("Cu 2", Role::Guidance, vec![3])]);
    assert_eq!(
        skipped(&drawing)[0],
        "a track that is switched off (line 9)"
    );
    let empty = files(Files {
        track_lines: Some("$TrackLines\n"),
        ab_lines: Some(AB_LINES),
        ..Files::default()
    });
    assert_eq!(empty.shapes.len(), 2);
}

#[test]
fn tracks_of_twol_have_two_more_lines() {
    let text = TRACKS.replace("$TrackLines", "$TwolTracks");
    let text = text
        .replace("True\n0\nCu 2", "True\n0\nFalse\n3.0\nCu 2")
        .replace("1,20,0.1\n", "1,20,0.1\nFalse\n3.0\n");
    let drawing = files(Files {
        track_lines: Some(&text),
        ..Files::default()
    });
    assert_eq!(drawing.shapes.len(), 2);
}

#[test]
fn a_cut_file_is_read_up_to_its_cut() {
    let (cut, _) = TRACKS.split_once("Cu 2\n0.2\n0,0\n").unwrap();
    let drawing = files(Files {
        track_lines: Some(&format!("{cut}Cu 2\n0.2\n")),
        ..Files::default()
    });
    assert_eq!(drawing.shapes.len(), 1);
    assert_eq!(
        skipped(&drawing),
        ["the rest of TrackLines.txt, which is not as AgOpenGPS writes it (line 11)"]
    );
}

/// Without one of its corners, or of its obstacles, a boundary is another field.
#[test]
fn a_boundary_is_read_whole_or_not_at_all() {
    let refused = |from: &str, to: &str| {
        let text = BOUNDARY.replacen(from, to, 1);
        let error = read(&Files {
            field: FIELD,
            boundary: Some(&text),
            ..Files::default()
        });
        error.unwrap_err().to_string()
    };
    for (from, to, line) in [
        (
            "100,200,3.14159",
            "100,",
            "line 6 of Boundary.txt is \"100,\"",
        ),
        (
            "100,200,3.14159",
            "x,y,z",
            "line 6 of Boundary.txt is \"x,y,z\"",
        ),
        (
            "100,200",
            "100,2e9",
            "line 6 of Boundary.txt is \"100,2e9,3.14159\"",
        ),
        ("52,52,0\n", "", "line 14 of Boundary.txt is \"True\""),
        (
            "True\n3\n",
            "True\nthree\n",
            "line 16 of Boundary.txt is \"three\"",
        ),
        ("12,12,0\n", "", "line 18 of Boundary.txt is \"\""),
    ] {
        let said = refused(from, to);
        assert!(said.starts_with(line), "{to:?}: {said}");
    }
}

#[test]
fn hopeless_folders_are_refused_in_a_sentence() {
    let refused = |field: &str| {
        read(&Files {
            field,
            ..Files::default()
        })
        .unwrap_err()
        .to_string()
    };
    assert_eq!(refused("$FieldDir\n"), "its Field.txt has no line StartFix");
    // Decimal commas: the first two numbers are another place.
    for fix in [
        "x,7",
        "40,83,-96,66",
        "40.83,-96.66,",
        "40.83",
        "89.5,7",
        "NaN,7",
    ] {
        assert_eq!(
            refused(&format!("StartFix\n{fix}\n")),
            format!(
                "its Field.txt has {fix:?} below StartFix, two numbers with decimal points and a comma between them are \
                 accepted: a latitude within 89 degrees of the equator and a longitude"
            )
        );
    }
    assert_eq!(
        refused(FIELD),
        "there is no line, curve or boundary in this AgOpenGPS file"
    );
}
