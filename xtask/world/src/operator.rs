//! The operator: remote control, joystick and emergency-stop loop, as scripted in a scenario.

use crate::scenario::{Button, ButtonPress, Scenario};
use crate::signal::Input;
use crate::time::Span as _;
use crate::time::{SimTime, at};
use vehicle_model::{NodeIndex, Remote};

/// A change of a level.
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

/// The levels of one press: after each edge the contact closes and opens twice more.
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

/// The presses of a remote control whose receiver toggles an output at each press. The outputs are
/// electronic: they do not bounce, and releasing a button changes nothing.
fn toggles(scenario: &Scenario) -> Vec<LevelChange> {
    let mut presses: Vec<&ButtonPress> = scenario.press.iter().filter(|p| is_remote(p)).collect();
    presses.sort_by(|a, b| a.at.get().total_cmp(&b.at.get()));
    let mut levels = Input::ALL.map(Input::idle);
    let toggle = |press: &ButtonPress| {
        let input = press.button.input();
        let level = &mut levels[input.index()];
        *level = !*level;
        LevelChange {
            at: at(press.at.span()),
            input,
            high: *level,
        }
    };
    presses.into_iter().map(toggle).collect()
}

/// True if the button is on the remote control.
fn is_remote(press: &ButtonPress) -> bool {
    press.button != Button::J
}

/// All level changes in order of time, for this kind of remote control.
#[must_use]
pub fn level_changes(scenario: &Scenario, remote: Remote) -> Vec<LevelChange> {
    let mut changes = match remote {
        Remote::Momentary => scenario.press.iter().flat_map(press).collect(),
        Remote::Toggle => {
            let mut changes = toggles(scenario);
            let contacts = scenario.press.iter().filter(|press| !is_remote(press));
            changes.extend(contacts.flat_map(press));
            changes
        }
    };
    changes.extend(scenario.stop_loop.iter().map(|change| LevelChange {
        at: at(change.at.span()),
        input: Input::StopLoop,
        high: change.open,
    }));
    changes.sort_by_key(|change| change.at);
    changes
}

/// The joystick's deflection to the right and forward, -1 to 1, at `when`.
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

/// Position of a node's knob at `when`, from 0 at one end to 1 at the other. It is in the middle
/// until it is turned for the first time.
#[must_use]
pub fn knob(scenario: &Scenario, node: NodeIndex, when: SimTime) -> f64 {
    let now = crate::time::seconds(when);
    let turns = scenario.knob.iter();
    let so_far = turns.filter(|turn| turn.node == node && turn.at.get() <= now);
    let last = so_far.max_by(|a, b| a.at.get().total_cmp(&b.at.get()));
    last.map_or(0.5, |turn| turn.position.get())
}
