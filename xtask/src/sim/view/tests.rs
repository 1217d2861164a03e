//! The view of real runs, as text.

use ratatui::{Terminal, backend::TestBackend};
use twin::Twin;
use world::time::{Span as _, from_seconds};
use world::{Scenario, time};

use super::super::{images, recording::Recorder};
use super::*;
use crate::{Workspace, vehicle};

/// A run of a vehicle's scenario up to `seconds`.
struct Stage {
    twin: Twin,
    recorder: Recorder,
    scene: Scene,
}

impl Stage {
    fn new(vehicle: &str, scenario: &str, seconds: f64) -> Self {
        let workspace = Workspace::find().unwrap();
        let vehicle = vehicle::find(&workspace, vehicle).unwrap();
        let scenario = Scenario::find(&vehicle, scenario).unwrap();
        let images = images(&workspace, &vehicle).unwrap();
        let mut twin = Twin::new(&vehicle, &scenario, 1, &images).unwrap();
        let recorder = Recorder::new(&mut twin, &images, false);
        let end = time::at(scenario.duration.span());
        let scene = Scene::new(Subject::new(&vehicle, &scenario, 1, end));
        let mut stage = Self {
            twin,
            recorder,
            scene,
        };
        stage.run(seconds);
        stage
    }

    fn run(&mut self, seconds: f64) {
        let end = self.twin.now() + from_seconds(seconds);
        self.recorder.run_until(&mut self.twin, end, None).unwrap();
        self.scene.take(&self.twin);
    }

    /// What a terminal of that size shows.
    fn shown(&self, width: u16, height: u16) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        let nodes = self.recorder.nodes();
        let drawn = |frame: &mut ratatui::Frame<'_>| {
            draw::draw(frame, &self.scene, &self.twin, nodes);
        };
        terminal.draw(drawn).unwrap();
        terminal.backend().to_string()
    }
}

#[test]
fn the_view_of_a_machine_shows_track_display_nodes_and_bus() {
    let mut stage = Stage::new("uagv", "straight-line", 8.0);
    insta::assert_snapshot!("uagv", stage.shown(120, 44));
    insta::assert_snapshot!("uagv_80x24", stage.shown(80, 24));
    insta::assert_snapshot!("too_small", stage.shown(60, 10));
    stage.scene.show_pace(None, true);
    stage.scene.speed = Some(3.456);
    stage.scene.help = true;
    insta::assert_snapshot!("help", stage.shown(80, 24));
}

#[test]
fn the_view_of_a_robot_between_rows_shows_its_offset() {
    let stage = Stage::new("row-follower", "field", 6.0);
    insta::assert_snapshot!("row_follower", stage.shown(100, 30));
}

#[test]
fn the_view_of_two_boards_has_no_track() {
    let stage = Stage::new("two-boards", "turn", 2.0);
    insta::assert_snapshot!("two_boards", stage.shown(80, 24));
}

#[test]
fn a_node_without_power_is_missed_in_its_window() {
    let mut stage = Stage::new("uagv", "master-dead", 3.0);
    let shown = stage.shown(120, 44);
    assert!(!shown.contains("missed"), "{shown}");
    let node = stage.twin.nodes().nth(2).unwrap();
    stage.twin.node_mut(node).hold_reset();
    stage.run(0.5);
    let shown = stage.shown(120, 44);
    assert!(shown.contains("missed"), "{shown}");
    assert!(shown.contains("in reset"), "{shown}");
}

#[test]
fn speeds_go_up_and_down_in_steps() {
    assert_eq!("max".parse(), Ok(Speed(None)));
    assert_eq!("2.5".parse(), Ok(Speed(Some(2.5))));
    for text in ["", "0", "-1", "101", "nan", "fast", "MAX"] {
        assert_eq!(text.parse::<Speed>(), Err(NoSpeed), "{text}");
    }
    assert_eq!(faster(Some(1.0), false), Some(2.0));
    assert_eq!(faster(Some(2.5), false), Some(5.0));
    assert_eq!(faster(Some(100.0), false), None);
    assert_eq!(faster(Some(100.0), true), Some(100.0));
    assert_eq!(faster(None, false), None);
    assert_eq!(slower(Some(1.0), None), Some(0.5));
    assert_eq!(slower(Some(0.001), None), Some(0.001));
    assert_eq!(slower(None, Some(3.2)), Some(2.0));
    assert_eq!(slower(None, None), Some(100.0));
}

#[test]
fn keys_have_a_meaning() {
    let key = |code, modifiers| wanted(KeyEvent::new(code, modifiers));
    let plain = |code| key(code, KeyModifiers::NONE);
    assert_eq!(plain(KeyCode::Char('q')), Some(Wanted::Stop));
    assert_eq!(plain(KeyCode::Esc), Some(Wanted::Back));
    assert_eq!(
        key(KeyCode::Char('c'), KeyModifiers::CONTROL),
        Some(Wanted::Interrupt)
    );
    assert_eq!(plain(KeyCode::Char('c')), None);
    assert_eq!(key(KeyCode::Char(' '), KeyModifiers::CONTROL), None);
    assert_eq!(plain(KeyCode::Char(' ')), Some(Wanted::Pause));
    assert_eq!(
        key(KeyCode::Char('+'), KeyModifiers::SHIFT),
        Some(Wanted::Faster)
    );
    assert_eq!(plain(KeyCode::Char('-')), Some(Wanted::Slower));
    let mut released = KeyEvent::new(KeyCode::Char('q'), KeyModifiers::NONE);
    released.kind = KeyEventKind::Release;
    assert_eq!(wanted(released), None);
}
