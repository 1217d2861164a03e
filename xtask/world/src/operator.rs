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
            Self::Run => Input::PinRun,
            Self::Stop => Input::PinStop,
        }
    }
}

/// The levels of an input that changes to `level` at `begin`, s, and bounces for `bounce`, s: it
/// goes back and forth twice more.
fn edge(input: Input, level: bool, begin: f64, bounce: f64) -> impl Iterator<Item = LevelChange> {
    let bounces = if bounce > 0.0 { 4 } else { 0 };
    (0..=bounces).map(move |i| LevelChange {
        at: at(crate::time::from_seconds(
            begin + bounce * f64::from(i) / 4.0,
        )),
        input,
        high: if i % 2 == 0 { level } else { !level },
    })
}

/// The levels of one press of a contact.
fn press(press: &ButtonPress) -> impl Iterator<Item = LevelChange> + use<> {
    let input = press.button.input();
    let pressed = !input.idle();
    let (down, bounce) = (press.at.get(), press.bounce.get());
    let up = down + press.hold.get();
    edge(input, pressed, down, bounce).chain(edge(input, !pressed, up, bounce))
}

/// What happens to the receiver of the remote control.
#[derive(Clone, Copy)]
enum Happening<'a> {
    Down(&'a ButtonPress),
    Up(&'a ButtonPress),
    Supply(bool),
}

/// The outputs of the remote control's receiver. Without supply they are low, as their inputs pull
/// them down, and presses do nothing. A receiver that keeps its outputs starts with all of them low.
fn outputs(scenario: &Scenario, remote: Remote) -> Vec<LevelChange> {
    let mut happenings: Vec<(f64, Happening<'_>)> = Vec::new();
    for press in scenario.press.iter().filter(|press| is_remote(press)) {
        happenings.push((press.at.get(), Happening::Down(press)));
        let up = press.at.get() + press.hold.get();
        happenings.push((up, Happening::Up(press)));
    }
    for change in &scenario.supply {
        happenings.push((change.at.get(), Happening::Supply(change.on)));
    }
    happenings.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut changes: Vec<LevelChange> = Vec::new();
    let (mut levels, mut powered) = (Input::ALL.map(|_| false), true);
    for (when, what) in happenings {
        let before = levels;
        let bounce = match what {
            Happening::Supply(on) => {
                powered = on;
                if !on {
                    levels = Input::ALL.map(|_| false);
                    // Bounces end with the supply.
                    let now = at(crate::time::from_seconds(when));
                    changes.retain(|change| change.at < now);
                }
                0.0
            }
            Happening::Down(press) | Happening::Up(press) => {
                let down = matches!(what, Happening::Down(_));
                let input = press.button.input();
                let level = &mut levels[input.index()];
                match remote {
                    _ if !powered => {}
                    Remote::Momentary => *level = down,
                    Remote::Toggle => *level ^= down,
                    Remote::Latched if down => levels = Input::ALL.map(|other| other == input),
                    Remote::Latched => {}
                }
                match remote {
                    Remote::Momentary => press.bounce.get(),
                    Remote::Toggle | Remote::Latched => scenario.remote.bounce.get(),
                }
            }
        };
        for input in Input::ALL {
            let level = levels[input.index()];
            if level != before[input.index()] {
                changes.extend(edge(input, level, when, bounce));
            }
        }
    }
    changes
}

/// True if the button is on the remote control.
fn is_remote(press: &ButtonPress) -> bool {
    press.button != Button::J
}

/// All level changes in order of time. `remote` is the remote control of the manifest; the
/// scenario may have another.
#[must_use]
pub fn level_changes(scenario: &Scenario, remote: Remote) -> Vec<LevelChange> {
    let mut changes = outputs(scenario, scenario.remote.kind.unwrap_or(remote));
    let contacts = scenario.press.iter().filter(|press| !is_remote(press));
    changes.extend(contacts.flat_map(press));
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
