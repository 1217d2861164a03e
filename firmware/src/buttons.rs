//! Debouncing of buttons and switches, and the events that they raise.

use heapless::Deque;

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
    /// The output of a toggling remote control fell: its button was pressed, or its receiver lost
    /// its supply.
    Fallen,
    /// The output of a latching remote control rose: its button was pressed, and not the one
    /// before.
    Selected,
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
    /// Its output is high until another button is pressed.
    Latched,
}

impl Remote {
    /// What a change of an input means; `None` if it means nothing.
    ///
    /// An output that falls may have lost its supply, so that it starts nothing.
    const fn reads(self, button: Button, edge: Edge) -> Option<Edge> {
        match (self, button, edge) {
            (Self::Momentary, ..)
            | (_, Button::Joystick | Button::StopLoop, _)
            | (Self::Toggle, _, Edge::Pressed)
            | (_, Button::D, Edge::Pressed)
            | (Self::Toggle, Button::D, _) => Some(edge),
            (Self::Toggle, ..) => Some(Edge::Fallen),
            (Self::Latched, _, Edge::Pressed) => Some(Edge::Selected),
            (Self::Latched, ..) => None,
        }
    }
}

/// Samples without a high output after which the receiver of a latching remote control counts
/// as lost: 40 ms at 200 Hz. When one output takes over from another, both may bounce.
const LOST_SAMPLES: u8 = 2 * STEADY_SAMPLES;

/// All inputs, debounced.
#[derive(Clone, Copy, Debug, Default)]
pub struct Buttons {
    inputs: [Debounced; 6],
    /// Whether a sample was taken before. The outputs of a remote control that keeps them may
    /// start at either level, so the first sample is not a press.
    sampled: bool,
    /// Whether an output of a latching remote control was high.
    selected: bool,
    /// Samples since then without one.
    lost: u8,
}

impl Buttons {
    /// Takes one sample of all inputs, in the order of [`Button::ALL`], and hands each
    /// change to `sink`.
    ///
    /// | remote control | output rises | output falls |
    /// | --- | --- | --- |
    /// | momentary | [`Edge::Pressed`] | [`Edge::Released`] |
    /// | toggle | [`Edge::Pressed`] | [`Edge::Fallen`]; of D [`Edge::Released`] |
    /// | latched | [`Edge::Selected`]; of D [`Edge::Pressed`] | nothing while another is high |
    ///
    /// The receiver of a latching remote control always has one high output after its first
    /// press. When it has none any more, it has lost its supply: [`Edge::Released`] of D.
    pub fn sample(
        &mut self,
        remote: Remote,
        levels: [bool; 6],
        mut sink: impl FnMut(Button, Edge),
    ) {
        let first = !self.sampled;
        self.sampled = true;
        // loop-bound: 6 inputs
        for ((input, level), button) in self.inputs.iter_mut().zip(levels).zip(Button::ALL) {
            // A latched D is still an emergency stop.
            let settled = match remote {
                Remote::Momentary => false,
                Remote::Toggle => button.is_remote(),
                Remote::Latched => button.is_remote() && button as u8 != Button::D as u8,
            };
            if first && settled {
                input.settle(level);
            }
            let edge = input.sample(level);
            if let Some(edge) = edge.and_then(|edge| remote.reads(button, edge)) {
                sink(button, edge);
            }
        }
        if remote == Remote::Latched && self.is_receiver_lost() {
            sink(Button::D, Edge::Released);
        }
    }

    /// Whether the receiver of a latching remote control has just been lost.
    fn is_receiver_lost(&mut self) -> bool {
        let [a, b, c, d, ..] = &self.inputs;
        if a.level || b.level || c.level || d.level {
            self.selected = true;
            self.lost = 0;
            return false;
        }
        if !self.selected {
            return false;
        }
        self.lost += 1;
        if self.lost < LOST_SAMPLES {
            return false;
        }
        self.selected = false;
        true
    }

    /// The debounced level of one input.
    pub fn is_pressed(&self, button: Button) -> bool {
        self.inputs
            .get(button as usize)
            .is_some_and(Debounced::is_pressed)
    }
}

/// A change of an input, with its sequence number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// The input.
    pub button: Button,
    /// How it changed.
    pub edge: Edge,
    /// One more for each change, wraps.
    pub count: u8,
}

/// Changes that are to be told on the bus: one with each sample, so that a sample takes as long when all inputs
/// change as when one does.
#[derive(Debug, Default)]
pub struct Untold {
    changes: Deque<Change, 8>,
    count: u8,
}

impl Untold {
    /// Adds a change. If as many wait as there is room for, it is dropped, and the sequence numbers show the gap:
    /// the inputs changed faster than people press, and whatever they ask for has been heeded before.
    pub fn push(&mut self, button: Button, edge: Edge) {
        self.count = self.count.wrapping_add(1);
        let count = self.count;
        let _ = self.changes.push_back(Change {
            button,
            edge,
            count,
        });
    }

    /// The one that has waited longest.
    pub fn pop(&mut self) -> Option<Change> {
        self.changes.pop_front()
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::{Button, Buttons, Debounced, Edge, Remote, STEADY_SAMPLES, Untold};
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

    #[test]
    fn changes_are_told_one_by_one_and_a_dropped_one_leaves_a_gap() {
        let mut untold = Untold::default();
        let tell = |untold: &mut Untold| untold.pop().map(|it| (it.button, it.count));
        for button in Button::ALL {
            untold.push(button, Edge::Pressed);
        }
        assert_eq!(tell(&mut untold), Some((Button::A, 1)));
        // Six of eight places are taken after this one.
        untold.push(Button::A, Edge::Released);
        for _ in 0..3 {
            untold.push(Button::B, Edge::Released);
        }
        let rest: Vec<_> = core::iter::from_fn(|| tell(&mut untold)).collect();
        assert_eq!(rest.len(), 8);
        assert_eq!(rest.last(), Some(&(Button::B, 9)));
        untold.push(Button::C, Edge::Pressed);
        assert_eq!(tell(&mut untold), Some((Button::C, 11)));
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
    fn a_momentary_remote_control_is_pressed_while_its_output_is_high() {
        use Button::{C, Joystick};
        use Edge::{Pressed, Released};
        assert_eq!(
            presses(Remote::Momentary, &[false, true, false]),
            [
                (C, Pressed),
                (Joystick, Pressed),
                (C, Released),
                (Joystick, Released)
            ]
        );
    }

    #[test]
    fn an_output_of_a_toggling_remote_control_that_falls_may_be_a_lost_supply() {
        use Button::{C, Joystick};
        use Edge::{Fallen, Pressed, Released};
        assert_eq!(
            presses(Remote::Toggle, &[false, true, false]),
            [
                (C, Pressed),
                (Joystick, Pressed),
                (C, Fallen),
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
                (Button::C, Edge::Fallen),
                (Button::Joystick, Edge::Released)
            ]
        );
    }

    /// The events of a remote control whose outputs A to D are high in these sets, each for 20
    /// samples.
    fn outputs(remote: Remote, sets: &[&str]) -> Vec<(Button, Edge)> {
        let mut buttons = Buttons::default();
        let mut seen = Vec::new();
        for set in sets {
            let high = |name| set.contains(name);
            let levels = [high('A'), high('B'), high('C'), high('D'), false, false];
            for _ in 0..20 {
                buttons.sample(remote, levels, |button, edge| seen.push((button, edge)));
            }
        }
        seen
    }

    #[test]
    fn every_edge_of_d_is_told_of_a_momentary_and_of_a_toggling_remote_control() {
        let edges = [(Button::D, Edge::Pressed), (Button::D, Edge::Released)];
        for remote in [Remote::Momentary, Remote::Toggle] {
            assert_eq!(outputs(remote, &["", "D", ""]), edges, "{remote:?}");
        }
        // It toggled up before the controller started.
        assert_eq!(outputs(Remote::Toggle, &["D", ""]), edges[1..]);
        assert_eq!(outputs(Remote::Momentary, &["D"]), edges[..1]);
    }

    #[test]
    fn a_latching_remote_control_selects_one_button_and_its_loss_is_a_stop() {
        use Button::{A, B, C, D};
        use Edge::{Pressed, Released, Selected};
        assert_eq!(
            outputs(Remote::Latched, &["", "C", "B", "D", "A", "C"]),
            [
                (C, Selected),
                (B, Selected),
                (D, Pressed),
                (A, Selected),
                (C, Selected)
            ]
        );
        assert_eq!(
            outputs(Remote::Latched, &["B", "", "", "A"]),
            [(D, Released), (A, Selected)]
        );
        assert_eq!(
            outputs(Remote::Latched, &["D", ""]),
            [(D, Pressed), (D, Released)]
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
