//! The command line of the example.

#[path = "../examples/circle.rs"]
#[expect(dead_code, reason = "a program of its own")]
mod circle;

#[test]
fn a_command_line_that_makes_no_sense_is_refused_in_a_sentence() {
    let words = |line: &str| line.split(' ').map(str::to_owned).collect::<Vec<_>>();
    let refused = |line: &str| circle::wanted(&words(line)).unwrap_err();
    assert_eq!(
        refused("target/bus 0.2 nan"),
        "SPEED is \"nan\", 0 to 10 m/s is accepted"
    );
    assert_eq!(
        refused("target/bus 0.2 -1"),
        "SPEED is \"-1\", 0 to 10 m/s is accepted"
    );
    assert_eq!(
        refused("target/bus inf 1"),
        "CURVATURE is \"inf\", -2 to 2 1/m is accepted"
    );
    assert_eq!(
        refused("target/bus 0.2"),
        "there are 2 words, three are accepted: circle PORT CURVATURE SPEED"
    );
    let line = words("target/bus -0.2 0.5");
    let (port, demand) = circle::wanted(&line).unwrap();
    assert_eq!(
        (port, demand.curvature, demand.speed),
        ("target/bus", -0.2, 0.5)
    );
}

#[test]
fn a_port_that_is_not_there_is_named() {
    let why = circle::open("/nowhere/bus").unwrap_err();
    assert!(
        why.starts_with("PORT \"/nowhere/bus\" cannot be opened: "),
        "{why}"
    );
}
