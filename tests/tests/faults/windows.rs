//! Where in its window a frame starts, with and without flash wait states.

use campaign::traffic::Matrix;
use furrow_tests::time::{at, seconds};
use furrow_tests::{images, scenario};
use twin::mcu::FlashTiming;
use twin::{Options, run};

use crate::RUNNING;

/// Two bits. The nodes' times agree to a microsecond. A request that comes just after the start of
/// a bit delays the frame to the next bit.
const LATEST: f64 = 8e-6;
const EARLIEST: f64 = -1e-6;

/// Messages with exclusive windows (thesis Figure 6.13), except the reference.
const EXCLUSIVE: [u16; 11] = [401, 402, 200, 201, 202, 206, 300, 450, 451, 452, 453];

#[test]
fn frames_start_with_their_windows_with_and_without_wait_states_of_the_flash() {
    let scenario = scenario(RUNNING);
    for flash in [FlashTiming::Immediate, FlashTiming::WaitStates] {
        let options = Options {
            duration: Some(furrow_tests::time::span(3.0)),
            flash,
            ..Options::default()
        };
        let outcome = run(
            furrow_tests::vehicle(),
            &scenario,
            images(),
            &options,
            |_| {},
        )
        .expect("images of the nodes");
        let traffic = campaign::traffic::Traffic::of(&outcome);
        let matrix = Matrix::new(furrow_tests::vehicle());
        let mut judged = 0;
        let references: Vec<f64> = traffic.genuine(100).map(|f| seconds(f.start)).collect();
        for message in matrix
            .messages()
            .iter()
            .filter(|m| EXCLUSIVE.contains(&m.id))
        {
            // From the second cycle on, when the clocks are synchronised.
            for frame in traffic.between(message.id, at(1.2), at(3.0)) {
                let start = seconds(frame.start);
                let begun = references
                    .iter()
                    .rfind(|&&reference| reference <= start + 1e-5);
                let mark = begun.expect("a reference") + f64::from(message.window.start_us) * 1e-6;
                let late = start - mark;
                assert!(
                    (EARLIEST..LATEST).contains(&late),
                    "{flash:?}: {} starts {:.2} us after its window",
                    message.id,
                    late * 1e6
                );
                judged += 1;
            }
        }
        assert!(judged > 150, "{judged}");
    }
}
