//! Debouncing of buttons and switches, and the events that they raise.

/// Samples that an input must hold a new level before it counts: 20 ms at 200 Hz. A remote
/// control's relay and a tactile switch bounce for less than 10 ms.
pub const STEADY_SAMPLES: u8 = 4;

/// One debounced input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Debounced {
    level: bool,
    differing: u8,
}

/// A change of a debounced input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// It was pressed, or opened.
    Pressed,
    /// It was released, or closed.
    Released,
}

impl Debounced {
    /// Takes one sample and says when the input changed.
    pub fn sample(&mut self, level: bool) -> Option<Edge> {
        if level == self.level {
            self.differing = 0;
            return None;
        }
        self.differing += 1;
        if self.differing < STEADY_SAMPLES {
            return None;
        }
        self.differing = 0;
        self.level = level;
        Some(if level { Edge::Pressed } else { Edge::Released })
    }

    /// Takes a level as the debounced one without reporting a change.
    const fn settle(&mut self, level: bool) {
        self.level = level;
        self.differing = 0;
    }

    /// The debounced level.
    pub const fn is_pressed(&self) -> bool {
        self.level
    }
}

/// The operator's inputs (thesis 5.2.5), in the order of their numbers on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Button {
    /// Remote control A: idle, release.
    A,
    /// Remote control B: manual.
    B,
    /// Remote control C: autonomous.
    C,
    /// Remote control D: emergency stop.
    D,
    /// The joystick's switch, same as D.
    Joystick,
    /// The emergency stop loop; pressed means open.
    StopLoop,
}

impl Button {
    /// All of them, in order.
    pub const ALL: [Self; 6] = [
        Self::A,
        Self::B,
        Self::C,
        Self::D,
        Self::Joystick,
        Self::StopLoop,
    ];

    /// Whether the button is on the remote control.
    pub const fn is_remote(self) -> bool {
        matches!(self, Self::A | Self::B | Self::C | Self::D)
    }
}

/// How the remote control's receiver shows a press.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Remote {
    /// Its output is high while the button is pressed.
    Momentary,
    /// Each press changes its output.
    Toggle,
}

/// All inputs, debounced.
#[derive(Clone, Copy, Debug, Default)]
pub struct Buttons {
    inputs: [Debounced; 6],
    /// Whether a sample was taken before. The outputs of a toggling remote control may start at
    /// either level, so the first sample is not a press.
    sampled: bool,
}

impl Buttons {
    /// Takes one sample of all inputs, in the order of [`Button::ALL`], and hands each
    /// change to `sink`. Each change of a toggling remote control's output is a press.
    pub fn sample(
        &mut self,
        remote: Remote,
        levels: [bool; 6],
        mut sink: impl FnMut(Button, Edge),
    ) {
        let toggles = remote == Remote::Toggle;
        let first = toggles && !self.sampled;
        self.sampled = true;
        // loop-bound: 6 inputs
        for ((input, level), button) in self.inputs.iter_mut().zip(levels).zip(Button::ALL) {
            let toggled = toggles && button.is_remote();
            if first && toggled {
                input.settle(level);
            }
            if let Some(edge) = input.sample(level) {
                sink(button, if toggled { Edge::Pressed } else { edge });
            }
        }
    }

    /// The debounced level of one input.
    pub fn is_pressed(&self, button: Button) -> bool {
        self.inputs
            .get(button as usize)
            .is_some_and(Debounced::is_pressed)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::{Button, Buttons, Debounced, Edge, Remote, STEADY_SAMPLES};
    use proptest::prelude::*;
    use std::vec::Vec;

    #[test]
    fn a_held_button_counts_once_and_the_loop_is_the_last() {
        let mut buttons = Buttons::default();
        let mut seen = Vec::new();
        for _ in 0..20 {
            let levels = [false, false, false, false, false, true];
            buttons.sample(Remote::Momentary, levels, |button, edge| {
                seen.push((button, edge));
            });
        }
        assert_eq!(seen, [(Button::StopLoop, Edge::Pressed)]);
        assert!(buttons.is_pressed(Button::StopLoop));
    }

    /// The events of a remote control whose output C has these levels, each for 20 samples. The
    /// joystick's switch has the same levels.
    fn presses(remote: Remote, levels: &[bool]) -> Vec<(Button, Edge)> {
        let mut buttons = Buttons::default();
        let mut seen = Vec::new();
        for &level in levels {
            for _ in 0..20 {
                let levels = [false, false, level, false, level, false];
                buttons.sample(remote, levels, |button, edge| seen.push((button, edge)));
            }
        }
        seen
    }

    #[test]
    fn a_toggling_remote_control_is_pressed_with_each_change() {
        use Button::{C, Joystick};
        use Edge::{Pressed, Released};
        let levels = [false, true, false];
        assert_eq!(
            presses(Remote::Momentary, &levels),
            [
                (C, Pressed),
                (Joystick, Pressed),
                (C, Released),
                (Joystick, Released)
            ]
        );
        assert_eq!(
            presses(Remote::Toggle, &levels),
            [
                (C, Pressed),
                (Joystick, Pressed),
                (C, Pressed),
                (Joystick, Released)
            ]
        );
    }

    #[test]
    fn the_level_at_which_a_toggling_remote_control_starts_is_no_press() {
        assert_eq!(
            presses(Remote::Toggle, &[true, false]),
            [
                (Button::Joystick, Edge::Pressed),
                (Button::C, Edge::Pressed),
                (Button::Joystick, Edge::Released)
            ]
        );
    }

    proptest! {
        /// Bounces shorter than the steady time never count, whatever their pattern.
        #[test]
        fn bounces_never_count(runs in proptest::collection::vec(1u8..STEADY_SAMPLES, 0..40)) {
            let mut input = Debounced::default();
            let mut level = true;
            for run in runs {
                for _ in 0..run {
                    prop_assert_eq!(input.sample(level), None);
                }
                // Back to the steady level for one sample at least.
                prop_assert_eq!(input.sample(false), None);
                level = true;
            }
        }

        /// Edges alternate: pressed, released, pressed.
        #[test]
        fn edges_alternate(levels in proptest::collection::vec(any::<bool>(), 0..300)) {
            let mut input = Debounced::default();
            let mut expected = Edge::Pressed;
            for level in levels {
                if let Some(edge) = input.sample(level) {
                    prop_assert_eq!(edge, expected);
                    expected = if edge == Edge::Pressed { Edge::Released } else { Edge::Pressed };
                }
            }
        }
    }
}
