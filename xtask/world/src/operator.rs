//! The operator: remote control, joystick and emergency-stop loop, as scripted in a scenario.

use crate::node::Input;
use crate::scenario::{Button, ButtonPress, Scenario};
use crate::time::Span as _;
use crate::time::{SimTime, at};

/// A level that changes.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub struct LevelChange {
    /// When.
    pub at: SimTime,
    /// Which input.
    pub input: Input,
    /// Its level from then on.
    pub high: bool,
}

impl Button {
    /// The input that the button is wired to.
    #[must_use]
    pub const fn input(self) -> Input {
        match self {
            Self::A => Input::RemoteA,
            Self::B => Input::RemoteB,
            Self::C => Input::RemoteC,
            Self::D => Input::RemoteD,
            Self::J => Input::JoystickSwitch,
        }
    }
}

/// Edges of one press: each contact closes and opens twice more before it rests.
fn press(press: &ButtonPress) -> Vec<LevelChange> {
    let input = press.button.input();
    let pressed = !input.idle();
    let mut changes = Vec::new();
    for (begin, level) in [
        (press.at.get(), pressed),
        (press.at.get() + press.hold.get(), !pressed),
    ] {
        let bounces = if press.bounce.get() > 0.0 { 4 } else { 0 };
        for i in 0..=bounces {
            let moment = begin + press.bounce.get() * f64::from(i) / 4.0;
            changes.push(LevelChange {
                at: at(crate::time::from_seconds(moment)),
                input,
                high: if i % 2 == 0 { level } else { !level },
            });
        }
    }
    changes
}

/// All changes of all levels, in order of time.
#[must_use]
pub fn level_changes(scenario: &Scenario) -> Vec<LevelChange> {
    let mut changes: Vec<LevelChange> = scenario.press.iter().flat_map(press).collect();
    changes.extend(scenario.stop_loop.iter().map(|change| LevelChange {
        at: at(change.at.span()),
        input: Input::StopLoop,
        high: change.open,
    }));
    changes.sort_by_key(|change| change.at);
    changes
}

/// The joystick's way to the right and forward, -1 to 1, at `when`.
#[must_use]
pub fn joystick(scenario: &Scenario, when: SimTime) -> (f64, f64) {
    let now = crate::time::seconds(when);
    scenario
        .joystick
        .iter()
        .filter(|movement| movement.at.get() <= now)
        .reduce(|last, next| {
            if next.at.get() >= last.at.get() {
                next
            } else {
                last
            }
        })
        .map_or((0.0, 0.0), |movement| {
            (movement.right.get(), movement.forward.get())
        })
}
