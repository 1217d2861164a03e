//! The release images of the UAGV under a planner: a program on its bus that asks for a curvature and a speed.

use std::f64::consts::TAU;
use std::sync::OnceLock;
use std::time::Duration;

use can_bus::Frame;
use embedded_can::{Id, StandardId};
use planner::{Demand, Heard, Key, Lead, Planner};
use twin::Images;
use vehicle_model::Vehicle;
use world::Scenario;
use world::time::seconds;
use xtask::selftest::{OnTwin, Transport};

/// The vehicle with its images.
fn uagv() -> &'static (Vehicle, Images) {
    static VEHICLE: OnceLock<(Vehicle, Images)> = OnceLock::new();
    VEHICLE.get_or_init(|| furrow_tests::with("planner.enabled=true"))
}

/// A run, and what the program on the bus heard.
struct Led {
    bus: OnTwin,
    planner: Planner,
    /// Mode and reason of each change, with its time, s.
    modes: Vec<(f64, u8, u8)>,
    lead: Option<Lead>,
    refused: u8,
}

/// Numbers of the network file.
const IDLE_READY: u8 = 2;
const RUN: u8 = 3;
const NO_COMMANDS: u8 = 17;
const PATH_END: u8 = 9;

impl Led {
    /// The vehicle with C pressed at 3 s and at 4 s.
    fn new(more: &str, key: Option<Key>) -> Self {
        let (vehicle, images) = uagv();
        let text = format!(
            "{more}\n[[press]]\nat = \"3 s\"\nbutton = \"C\"\n[[press]]\nat = \"4 s\"\nbutton = \"C\"\n"
        );
        let scenario = Scenario::parse(vehicle, "test", "the test's scenario", &text).unwrap();
        Self {
            bus: OnTwin::within(vehicle, &scenario, images).unwrap(),
            planner: Planner::of(vehicle, key).unwrap(),
            modes: Vec::new(),
            lead: None,
            refused: 0,
        }
    }

    /// Asks in each basic cycle until a time, s; `None` stays silent.
    fn until(&mut self, end: f64, demand: Option<Demand<f64>>) {
        let end = Duration::from_secs_f64(end);
        while let Some(received) = self.bus.receive(end).unwrap() {
            self.note(received.at, &received.frame);
            match self.planner.heard(&received.frame, received.at) {
                Heard::Begin(slot) => {
                    let Some(frame) = demand.and_then(|it| self.planner.command::<Frame>(it))
                    else {
                        continue;
                    };
                    // Frames of the time until then belong to nobody here.
                    while let Some(other) = self.bus.receive(received.at + slot.earliest).unwrap() {
                        self.note(other.at, &other.frame);
                        if let Heard::Report(report) = self.planner.heard(&other.frame, other.at) {
                            self.told(report);
                        }
                    }
                    self.bus.send(&frame).unwrap();
                }
                Heard::Report(report) => self.told(report),
                Heard::Nothing => {}
            }
        }
    }

    fn told(&mut self, report: planner::Report) {
        (self.lead, self.refused) = (Some(report.lead), report.refused);
    }

    fn note(&mut self, at: Duration, frame: &Frame) {
        let mode_change = StandardId::new(501).map(Id::from);
        if Some(frame.id()) == mode_change {
            let data = frame.data();
            self.modes.push((at.as_secs_f64(), data[1], data[2]));
        }
    }

    /// Rear axle north and east (m), and speed (m/s), now.
    fn place(&self) -> (f64, f64, f64) {
        let state = self.bus.twin().world().states().last().unwrap();
        (state.north, state.east, state.speed)
    }

    /// The vehicle drives by itself.
    fn runs(&self) -> bool {
        self.modes.last().is_some_and(|change| change.1 == RUN)
    }
}

const fn demand(curvature: f64, speed: f64) -> Option<Demand<f64>> {
    Some(Demand { curvature, speed })
}

#[test]
fn the_vehicle_drives_a_circle_without_a_fix() {
    let mut led = Led::new("[[fix]]\nat = \"100 ms\"\nstate = \"none\"", None);
    let curvature = 0.25;
    led.until(10.0, demand(curvature, 0.8));
    assert!(led.runs(), "{:?}", led.modes);
    assert_eq!(led.lead, Some(Lead::Planner));
    let (north, east, speed) = led.place();
    assert!((speed - 0.8).abs() < 0.03, "{speed} m/s");
    // Once round it is there again, and half a round later a diameter away.
    let round = TAU / curvature / 0.8;
    led.until(10.0 + round / 2.0, demand(curvature, 0.8));
    let across = led.place();
    let diameter = (across.0 - north).hypot(across.1 - east);
    assert!((diameter - 2.0 / curvature).abs() < 0.5, "{diameter} m");
    led.until(10.0 + round, demand(curvature, 0.8));
    let again = led.place();
    assert!(
        (again.0 - north).hypot(again.1 - east) < 1.5,
        "{again:?} {north} {east}"
    );
    // Only the first frame has no predecessor.
    assert_eq!(led.refused, 1);
}

#[test]
fn the_vehicle_stops_when_the_commands_end() {
    let mut led = Led::new("", None);
    led.until(7.0, demand(0.0, 1.0));
    assert!(led.runs() && led.place().2 > 0.9, "{:?}", led.place());
    led.until(8.0, None);
    let &(at, mode, reason) = led.modes.last().unwrap();
    assert_eq!((mode, reason), (IDLE_READY, NO_COMMANDS), "{:?}", led.modes);
    assert!(at < 7.6, "{at} s");
    led.until(10.0, None);
    assert!(led.place().2.abs() < 0.01, "{:?}", led.place());
    // Commands that come back begin nothing by themselves.
    led.until(12.0, demand(0.0, 1.0));
    assert!(!led.runs() && led.place().2.abs() < 0.01);
}

#[test]
fn a_run_along_the_path_is_left_alone() {
    let mut led = Led::new("", None);
    led.until(5.0, None);
    assert!(led.runs());
    led.until(14.0, demand(0.3, 0.4));
    assert!(led.runs());
    assert_eq!(led.lead, Some(Lead::Path));
    let (_, east, speed) = led.place();
    assert!(
        east.abs() < 0.05 && (speed - 1.0).abs() < 0.05,
        "{:?}",
        led.place()
    );
    assert!(!led.modes.iter().any(|change| change.2 == PATH_END));
}

/// A frame that was made without the key, or with another one, counts for nothing.
#[test]
fn the_key_of_the_nodes_is_needed() {
    let other = Key::new(*b"another secret  ");
    for key in [None, Some(other)] {
        let mut led = Led::new(
            "key = true\n[[fix]]\nat = \"100 ms\"\nstate = \"none\"",
            key,
        );
        led.until(8.0, demand(0.0, 1.0));
        assert!(!led.runs(), "{:?}", led.modes);
        assert_eq!(led.lead, Some(Lead::Path));
        // With another key it does not even believe the time of the bus, and sends nothing.
        let refused = if key.is_none() { 51..=255 } else { 0..=0 };
        assert!(refused.contains(&led.refused), "{}", led.refused);
        let still = led.bus.twin().world().states().iter();
        let moved = still.filter(|sample| sample.speed.abs() > 0.01);
        assert_eq!(moved.map(|sample| seconds(sample.at)).next(), None);
    }
}

/// It proves the time first, half a second long, and leads then as without a key.
#[test]
fn a_planner_with_the_key_leads() {
    // What a simulation with this seed gives its nodes.
    let mut key = *b"simulated \0\0\0\0\0\0";
    key[8..].copy_from_slice(&1_u64.to_le_bytes());
    let mut led = Led::new(
        "key = true\n[[fix]]\nat = \"100 ms\"\nstate = \"none\"",
        Some(Key::new(key)),
    );
    led.until(8.0, demand(0.0, 1.0));
    assert!(led.runs(), "{:?}", led.modes);
    assert_eq!((led.lead, led.refused), (Some(Lead::Planner), 0));
    assert!((led.place().2 - 1.0).abs() < 0.05, "{:?}", led.place());
}

/// The joystick ends a run of the planner as it ends any.
#[test]
fn the_operator_counts_before_the_planner() {
    let moved = "[[joystick]]\nat = \"7 s\"\nright = \"60 %\"";
    let mut led = Led::new(moved, None);
    led.until(9.0, demand(0.0, 1.0));
    assert!(!led.runs() && led.place().2.abs() < 0.05, "{:?}", led.modes);
}
