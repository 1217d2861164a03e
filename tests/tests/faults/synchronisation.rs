//! How closely the nodes' times agree, with crystals drawn within 50 ppm.

use campaign::agreement::{self, Agreement};
use campaign::traffic::Traffic;
use furrow_tests::nodes;
use furrow_tests::time::{at, seconds, span};
use furrow_tests::{Journey, images, scenario};

use crate::{RUNNING, assert_never_reset, assert_steady};

/// Length of the run, s.
const END: f64 = 60.0;

#[test]
fn the_nodes_agree_on_the_time_and_start_their_frames_in_time() {
    let mut journey = Journey::new(&scenario(RUNNING), 3);
    let mut agreement = Agreement::new(images()).expect("images with debug information");
    let spread = |journey: &Journey| {
        let errors = nodes::ALL.map(|node| journey.vehicle.world().crystal_ppm(node));
        errors
            .iter()
            .fold(0.0, |most: f64, &ppm| most.max(ppm.abs()))
    };
    assert!(
        spread(&journey) > 10.0,
        "crystals that hardly differ test nothing"
    );

    while journey.vehicle.now() < at(END) {
        let next = journey.vehicle.now() + agreement::SPAN;
        journey.run_until(next);
        agreement.compare(&mut journey.vehicle);
    }
    let figures = agreement.figures().expect("the nodes know the time");
    println!(
        "global time of {} instants: largest difference {:.3} us, 99 % below {:.3} us",
        figures.instants, figures.largest_us, figures.p99_us
    );
    assert!(figures.instants > 1500, "{figures:?}");
    assert!(figures.largest_us <= 2.0, "{figures:?}");
    assert!(figures.p99_us <= 1.0, "{figures:?}");

    // Skip the first second of the schedule, in which the clocks settle.
    let begin = seconds(Traffic::so_far(&journey.vehicle).frames[0].start) + 1.0;
    let traffic = journey.traffic();
    let matrix = journey.matrix();
    let references = matrix.references(&traffic);
    let late = traffic
        .frames
        .iter()
        .filter(|frame| frame.start > at(begin) && !matrix.is_reference(frame.id) && frame.id < 500)
        .filter_map(|frame| matrix.lateness(frame, &references))
        .map(|ps| ps as f64 * 1e-6);
    let (mut first, mut last) = (f64::MAX, f64::MIN);
    for us in late {
        first = first.min(us);
        last = last.max(us);
    }
    println!("starts of frame {first:.2} to {last:.2} us after their windows begin");
    assert!(first >= -8.0 && last <= 8.0, "{first} to {last} us");

    assert_steady(&journey, &[100, 206, 300, 450, 451, 452, 453], begin, END);
    journey.assert_in_place();
    assert_never_reset(&journey);
    // The interval between references follows the master's own crystal.
    for pair in references.windows(2) {
        let period = pair[1].start - pair[0].start;
        assert!(period > span(0.099_9) && period < span(0.100_1));
    }
}
