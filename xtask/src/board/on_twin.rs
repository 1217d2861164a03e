//! The tests of a board on the virtual microcontroller, under a debugger that speaks with them as
//! probe-rs does.

use std::sync::Arc;

use can_bus::SimDuration;
use twin::{
    debugger::Ended,
    image::Image,
    mcu::{Board, FlashTiming},
    network::Network,
};

use parts::Sled;

use super::{BoardTest, Error, Outcome, TestImage, Verdict};
use crate::{Failure, log::Log};

/// How often the log is read and the surroundings may change. Shorter than defmt's buffer lasts.
const SLICE: SimDuration = SimDuration::from_ticks(50_000_000);

/// How exactly the interrupts of the bus come: within two ticks of the time base.
const STEP: SimDuration = SimDuration::from_ticks(100_000);

/// What happens around the board while a test runs: called at the beginning and every 50 us.
pub type Surroundings<'a> = dyn FnMut(&mut Network) + 'a;

/// A sound board: its clock without error, its flash with wait states, and its transceiver on a bus
/// without other nodes.
#[must_use]
pub fn sound(sled: &Sled) -> Board {
    Board {
        external_clock: Some(sled.external_hz),
        flash: FlashTiming::WaitStates,
        ..Board::default()
    }
}

/// Runs one test from a cold start.
///
/// # Errors
///
/// The image is none for the part of the board.
pub fn run(
    image: &TestImage,
    test: &BoardTest,
    board: &Board,
    around: &mut Surroundings<'_>,
) -> Result<Verdict, Failure> {
    let program = Image::from_elf(image.sled.part, &image.elf).map_err(Error::Image)?;
    let mut network = Network::with_slice(STEP);
    let node = network.add(Arc::new(program), board);
    let command_line = format!("run_addr {}", test.address);
    network.node_mut(node).attach_debugger(&command_line);
    let mut log = Log::of(&image.elf);
    let mut lines = Vec::new();
    let end = SimDuration::from_ticks(u64::from(test.timeout) * 1_000_000_000_000);
    let end = network.now() + end;
    let outcome = loop {
        around(&mut network);
        let until = network.now() + SLICE;
        network.run_until(until);
        let mcu = network.node_mut(node);
        lines.extend(log.take(mcu));
        if let Some(violation) = mcu.first_violation() {
            break Outcome::Failed(format!("what the part does not allow: {violation}"));
        }
        match mcu.ended() {
            Some(Ended::Exit(0)) => break Outcome::Passed,
            Some(Ended::Exit(_)) => break Outcome::Failed(sentence(&lines)),
            Some(Ended::Restarted) => {
                let why = mcu.resets().last().map(|(_, cause)| *cause);
                break Outcome::Failed(format!("the program has started again: {why:?}"));
            }
            Some(Ended::Unknown { operation }) => {
                let why = format!("the program asked its debugger for operation {operation:#x}");
                break Outcome::Failed(why);
            }
            None if mcu.is_locked_up() => break Outcome::Failed("the core is in lockup".into()),
            None => {}
        }
        if network.now() >= end {
            break Outcome::Failed(format!("it did not end within {} s", test.timeout));
        }
    };
    Ok(Verdict {
        test: test.clone(),
        outcome,
        seconds: Some(network.now().as_ticks() as f64 / 1e12),
        log: lines,
    })
}

/// The sentence with which a test failed: the last error in its log.
fn sentence(lines: &[String]) -> String {
    let error = lines
        .iter()
        .rev()
        .find_map(|line| line.strip_prefix("ERROR "));
    error.unwrap_or("it says nothing").to_owned()
}
