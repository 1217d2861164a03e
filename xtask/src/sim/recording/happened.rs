//! What happened in a run, so far or to its end.

use twin::{GateChange, ResetCause};
use world::report::{ModeChange, Summary};
use world::time::{Span as _, seconds};
use world::{NodeIndex, Scenario, SimTime};

use super::{super::Finished, LogLine};

/// An event of a run.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Event {
    /// When, s.
    pub at: f64,
    /// What.
    pub text: String,
    /// Whether something went wrong.
    pub bad: bool,
}

/// What is known of a node.
pub(crate) struct NodeHistory<'r> {
    /// Its name.
    pub name: &'r str,
    /// Its resets, power-on first.
    pub resets: &'r [(SimTime, ResetCause)],
    /// Its log.
    pub log: &'r [LogLine],
}

/// Where the events are found.
pub(crate) struct Happened<'r> {
    /// What is simulated.
    pub scenario: &'r Scenario,
    /// How far.
    pub until: SimTime,
    /// Changes of the vehicle's mode.
    pub modes: &'r [ModeChange],
    /// What the bus guardian did.
    pub gates: &'r [GateChange],
    /// All nodes, in the order of the manifest.
    pub nodes: Vec<NodeHistory<'r>>,
}

impl Happened<'_> {
    /// The events in order of time: modes, what the scenario lets happen, resets, gates, and warnings and
    /// errors of the nodes' logs.
    pub(crate) fn events(&self) -> Vec<Event> {
        let event = |at: SimTime, text: String, bad| Event {
            at: seconds(at),
            text,
            bad,
        };
        let mut all = Vec::new();
        for mode in self.modes {
            all.push(event(mode.at, format!("mode {}", mode.mode), false));
        }
        let name = |index: NodeIndex| {
            let node = self.nodes.get(index.0);
            node.map_or_else(String::new, |node| node.name.to_owned())
        };
        for happening in self.scenario.happenings(&name) {
            let at = world::time::at(happening.at.span());
            if at <= self.until {
                let text = format!("scenario: {}", happening.words);
                all.push(event(at, text, false));
            }
        }
        for node in &self.nodes {
            for (at, cause) in node.resets.iter().skip(1) {
                let text = format!("{} starts again: {cause:?}", node.name);
                all.push(event(*at, text, true));
            }
        }
        for change in self.gates {
            let gate = if change.closed { "closes" } else { "opens" };
            let node = self.nodes.get(change.node.0);
            let node = node.map_or("", |node| node.name);
            let text = format!("the guardian {gate} the gate of {node}");
            all.push(event(change.at, text, change.closed));
        }
        for node in &self.nodes {
            let lines = node.log.iter();
            let bad = lines.filter(|line| matches!(line.parts().0, "WARN" | "ERROR"));
            all.extend(bad.map(|line| {
                let text = format!("{}: {}", node.name, line.text);
                event(line.at, text, true)
            }));
        }
        all.sort_by(|one, other| one.at.total_cmp(&other.at));
        all
    }
}

/// What happened in a finished run.
pub(crate) fn of_run(finished: &Finished<'_>, summary: &Summary) -> Vec<Event> {
    let nodes = finished.nodes.iter().zip(&finished.outcome.nodes);
    let happened = Happened {
        scenario: finished.scenario,
        until: finished.outcome.duration,
        modes: &finished.modes,
        gates: &finished.outcome.gates,
        nodes: nodes
            .zip(&finished.recordings)
            .map(|((name, outcome), recording)| NodeHistory {
                name,
                resets: &outcome.resets,
                log: &recording.log,
            })
            .collect(),
    };
    let mut all = happened.events();
    if let Some(settled) = summary
        .autonomous_runs
        .first()
        .and_then(|run| run.settling_seconds.map(|after| run.from_seconds + after))
    {
        let place = all.partition_point(|one| one.at <= settled);
        let text = "settled on the line".to_owned();
        let bad = false;
        all.insert(
            place,
            Event {
                at: settled,
                text,
                bad,
            },
        );
    }
    all
}
