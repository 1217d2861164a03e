//! How well the nodes agree on the time, with crystals drawn within 50 ppm.

use campaign::traffic::Traffic;
use furrow_tests::clock::NodeClock;
use furrow_tests::time::{at, seconds, span};
use furrow_tests::{Journey, images, scenario};
use world::Node;

use crate::{RUNNING, assert_never_reset, assert_steady};

/// Length of the run, s.
const END: f64 = 60.0;

#[test]
fn the_nodes_agree_on_the_time_and_start_their_frames_in_time() {
    let mut journey = Journey::new(&scenario(RUNNING), 3);
    let images = images();
    let clocks = [
        (Node::Gps, NodeClock::find(&images.gps)),
        (Node::Controller, NodeClock::find(&images.controller)),
        (Node::Steering, NodeClock::find(&images.steering)),
        (Node::Drive, NodeClock::find(&images.drive)),
    ];
    let spread = |journey: &Journey| {
        let errors = Node::ALL.map(|node| journey.vehicle.world().crystal_ppm(node));
        errors
            .iter()
            .fold(0.0, |most: f64, &ppm| most.max(ppm.abs()))
    };
    assert!(
        spread(&journey) > 10.0,
        "crystals that hardly differ test nothing"
    );

    // The first second of the schedule is for settling.
    journey.to(2.0);
    let begin = seconds(Traffic::so_far(&journey.vehicle).frames[0].start) + 1.0;
    let mut errors = Vec::new();
    let mut next = begin;
    // No multiple of the basic cycle: every age of the reference comes up.
    while next < END {
        journey.to(next);
        next += 0.037;
        let times = clocks.iter().map(|(node, clock)| {
            let time = clock.read(journey.vehicle.node_mut(*node));
            let (global, when) = time.unwrap_or_else(|| panic!("{node} knows no time"));
            global - seconds(when) * 1e6
        });
        let times: Vec<f64> = times.collect();
        let most = times.iter().copied().fold(f64::MIN, f64::max);
        let least = times.iter().copied().fold(f64::MAX, f64::min);
        errors.push(most - least);
    }
    errors.sort_by(f64::total_cmp);
    let largest = errors[errors.len() - 1];
    let p99 = errors[errors.len() * 99 / 100];
    println!(
        "global time of {} instants: largest difference {largest:.3} us, 99 % below {p99:.3} us",
        errors.len()
    );
    assert!(largest <= 2.0, "{largest} us");
    assert!(p99 <= 1.0, "{p99} us");

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
    // References keep their distance by the master's own crystal.
    for pair in references.windows(2) {
        let period = pair[1] - pair[0];
        assert!(period > span(0.099_9) && period < span(0.100_1));
    }
}
