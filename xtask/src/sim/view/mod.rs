//! A run on the terminal, as it happens.
//!
//! The view reads the vehicle between two steps of the simulation and changes nothing of it, so the run is the
//! same with and without it.

mod draw;
mod scene;
#[cfg(test)]
mod tests;

use std::{
    io,
    ops::RangeInclusive,
    str::FromStr,
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::{Duration, Instant},
};

use ratatui::{
    DefaultTerminal,
    crossterm::{
        cursor::Show,
        event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers},
        execute,
    },
};
use twin::Twin;
use world::{SimTime, time::seconds};

use super::{live::Pace, recording::NodeRecording};
use crate::interrupt;
use scene::Scene;
pub(crate) use scene::Subject;

/// Simulated seconds in a second that a run can be asked for.
pub const SPEEDS: RangeInclusive<f64> = 0.001..=100.0;

/// How fast a run is shown: simulated seconds in a second, `None` as fast as it can.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speed(pub Option<f64>);

/// A text that is no speed of the view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a number from {} to {}, or max, is accepted", SPEEDS.start(), SPEEDS.end())]
pub struct NoSpeed;

impl FromStr for Speed {
    type Err = NoSpeed;

    fn from_str(text: &str) -> Result<Self, NoSpeed> {
        if text == "max" {
            return Ok(Self(None));
        }
        let speed = text.parse().ok().filter(|speed| SPEEDS.contains(speed));
        speed.map(|speed| Self(Some(speed))).ok_or(NoSpeed)
    }
}

/// How often the view is drawn at most.
const DRAWN: Duration = Duration::from_millis(100);
/// How soon a key is noticed.
const NOTICED: Duration = Duration::from_millis(20);
/// The time over which the speed is measured.
const MEASURED: Duration = Duration::from_secs(1);

/// The speeds that + and - choose, simulated seconds in a second.
const STEPS: [f64; 16] = [
    0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0,
];

/// The next faster speed: behind the last one as fast as it can, unless `paced`.
fn faster(speed: Option<f64>, paced: bool) -> Option<f64> {
    let speed = speed?;
    let next = STEPS.into_iter().find(|&step| step > speed);
    next.or(paced.then_some(speed))
}

/// The next slower speed. In front of "as fast as it can" is the first step below the speed that was `measured`.
fn slower(speed: Option<f64>, measured: Option<f64>) -> Option<f64> {
    let from = speed.or(measured).unwrap_or(f64::INFINITY);
    let below = STEPS.into_iter().rev().find(|&step| step < from);
    Some(below.unwrap_or(from))
}

/// Keys that come so soon were pressed before the view was there.
const TYPED_BEFORE: Duration = Duration::from_millis(100);

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wanted {
    /// Ends the run here, with its report.
    Stop,
    /// Closes the help, or stops.
    Back,
    /// Ends the command as Ctrl-C does.
    Interrupt,
    Pause,
    Faster,
    Slower,
    Help,
}

fn wanted(key: KeyEvent) -> Option<Wanted> {
    if key.kind == KeyEventKind::Release {
        return None;
    }
    // Ctrl-Space is what a terminal makes of a zero byte, which nobody has pressed.
    if key
        .modifiers
        .intersects(KeyModifiers::CONTROL | KeyModifiers::ALT)
    {
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        let is_end = key.code == KeyCode::Char('c') && control;
        return is_end.then_some(Wanted::Interrupt);
    }
    match key.code {
        KeyCode::Char('q') => Some(Wanted::Stop),
        KeyCode::Esc => Some(Wanted::Back),
        KeyCode::Char(' ') => Some(Wanted::Pause),
        // The key of + has = without shift.
        KeyCode::Char('+' | '=') => Some(Wanted::Faster),
        KeyCode::Char('-') => Some(Wanted::Slower),
        KeyCode::Char('?') => Some(Wanted::Help),
        _ => None,
    }
}

/// The terminal, with the run on it.
pub(super) struct View {
    terminal: DefaultTerminal,
    scene: Scene,
    /// Whether other programs take part, which needs a pace.
    paced: bool,
    drawn: Option<Instant>,
    noticed: Option<Instant>,
    /// Where the measurement of the speed began.
    since: Option<(Instant, SimTime)>,
    /// Whether the user has ended the run.
    stopped: bool,
    keys: Receiver<Event>,
    opened: Instant,
}

impl View {
    /// Takes the terminal.
    ///
    /// # Errors
    /// It cannot be used.
    pub(super) fn open(subject: Subject, paced: bool) -> io::Result<Self> {
        interrupt::restore_when_interrupted(Some(restore));
        let terminal = ratatui::try_init().inspect_err(|_| restore())?;
        let (events, keys) = channel();
        // A thread of its own: a sequence that is not finished keeps its reader waiting, and nobody else.
        thread::spawn(move || {
            while let Ok(event) = event::read() {
                if events.send(event).is_err() {
                    break;
                }
            }
        });
        Ok(Self {
            terminal,
            scene: Scene::new(subject),
            paced,
            drawn: None,
            noticed: None,
            since: None,
            stopped: false,
            keys,
            opened: Instant::now(),
        })
    }

    /// Shows what has happened, does what keys ask for, and comes back when the simulated time has come.
    ///
    /// # Errors
    /// The terminal cannot be used any more.
    pub(super) fn attend(
        &mut self,
        twin: &Twin,
        nodes: &[NodeRecording],
        pace: &mut Pace,
    ) -> io::Result<()> {
        self.scene.take(twin);
        loop {
            self.measure(twin.now(), pace);
            if self.drawn.is_none_or(|drawn| drawn.elapsed() >= DRAWN) {
                self.scene.show_pace(pace.speed(), pace.is_paused());
                let scene = &self.scene;
                self.terminal
                    .draw(|frame| draw::draw(frame, scene, twin, nodes))?;
                self.drawn = Some(Instant::now());
            }
            let wait = if pace.is_paused() {
                DRAWN
            } else {
                pace.early(twin.now()).min(DRAWN)
            };
            let looked = self
                .noticed
                .is_some_and(|noticed| noticed.elapsed() < NOTICED);
            if !(wait.is_zero() && looked) {
                self.noticed = Some(Instant::now());
                if let Some(event) = self.event(wait)? {
                    self.react(&event, twin.now(), pace);
                    if self.stopped {
                        return Ok(());
                    }
                    continue;
                }
            }
            if !pace.is_paused() && pace.early(twin.now()).is_zero() {
                return Ok(());
            }
        }
    }

    /// The next event of the terminal within this time.
    fn event(&self, wait: Duration) -> io::Result<Option<Event>> {
        match self.keys.recv_timeout(wait) {
            // What was typed before was not meant for a view that nobody had seen.
            Ok(_) if self.opened.elapsed() < TYPED_BEFORE => Ok(None),
            Ok(event) => Ok(Some(event)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => {
                Err(io::Error::other("it cannot be read any more"))
            }
        }
    }

    /// Whether the user has ended the run.
    pub(super) const fn is_stopped(&self) -> bool {
        self.stopped
    }

    fn measure(&mut self, now: SimTime, pace: &Pace) {
        let (begin, from) = *self.since.get_or_insert_with(|| (Instant::now(), now));
        let passed = begin.elapsed();
        if passed >= MEASURED && !pace.is_paused() {
            let simulated = seconds(now) - seconds(from);
            self.scene.speed = Some(simulated / passed.as_secs_f64());
            self.since = None;
        }
    }

    fn react(&mut self, event: &Event, now: SimTime, pace: &mut Pace) {
        // Soon after a key something is seen of it.
        self.drawn = None;
        let Event::Key(key) = event else {
            return;
        };
        let (speed, paused) = (pace.speed(), pace.is_paused());
        match wanted(*key) {
            Some(Wanted::Interrupt) => interrupt::end(),
            Some(Wanted::Back) if self.scene.help => self.scene.help = false,
            Some(Wanted::Stop | Wanted::Back) => self.stopped = true,
            Some(Wanted::Pause) => {
                self.since = None;
                pace.change(now, speed, !paused);
            }
            Some(Wanted::Faster) => pace.change(now, faster(speed, self.paced), paused),
            Some(Wanted::Slower) => pace.change(now, slower(speed, self.scene.speed), paused),
            Some(Wanted::Help) => self.scene.help = !self.scene.help,
            None => {}
        }
    }
}

impl Drop for View {
    fn drop(&mut self) {
        restore();
        interrupt::restore_when_interrupted(None);
    }
}

/// Gives the terminal back as it was.
fn restore() {
    // A terminal that is gone needs no restoring.
    let _ = ratatui::try_restore();
    let _ = execute!(io::stdout(), Show);
}
