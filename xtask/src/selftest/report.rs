//! The results as a table, as JSON, and as what to look at first. What was not done is named, too.

use std::{
    fmt::{self, Write},
    time::Duration,
};

use serde_json::{Value as Json, json};
use vehicle_model::Vehicle;

use super::{
    Error,
    ask::{Answers, Unsent, other_cycle},
    messages::{Report, Value},
};

/// The results of a self-test.
pub struct Results<'a> {
    /// The vehicle that was asked.
    pub vehicle: &'a Vehicle,
    /// The bus, as the command line names it.
    pub bus: String,
    /// Indices of the nodes that are shown.
    pub nodes: &'a [usize],
    /// What came from the bus.
    pub answers: &'a Answers,
}

/// What is wrong.
struct Finding {
    /// Node and check, or node and silence.
    what: String,
    /// What is so when the check passes.
    meaning: Option<String>,
    /// What to look at first.
    look: String,
}

/// A check that a node did not do.
struct Gap {
    /// Node and check.
    what: String,
    /// Why it was not done.
    why: String,
}

impl Results<'_> {
    fn name(&self, node: usize) -> &str {
        &self.vehicle.manifest().nodes[node].name
    }

    fn report(&self, node: usize) -> Option<&Report> {
        let (_, report) = self.answers.reports.get(node)?.as_ref()?;
        Some(report)
    }

    /// Whether all nodes have reported and no check has failed.
    ///
    /// # Errors
    /// Names each silent node and each failed check.
    pub fn outcome(&self) -> Result<(), Error> {
        let findings = self.findings().into_iter();
        let failed: Vec<String> = findings.map(|finding| finding.what).collect();
        if failed.is_empty() {
            Ok(())
        } else {
            Err(Error::Failed(failed))
        }
    }

    /// All that is wrong.
    fn findings(&self) -> Vec<Finding> {
        let of_node = |&node: &usize| match self.report(node) {
            None => vec![self.silence(node)],
            Some(report) => {
                let failed = report.failed();
                failed
                    .map(|check| Finding {
                        what: format!("{}: {} failed", self.name(node), check.name),
                        meaning: Some(check.meaning.clone()),
                        look: self.look_for_check(node, &check.name),
                    })
                    .collect()
            }
        };
        self.nodes.iter().flat_map(of_node).collect()
    }

    /// All checks that were not done.
    fn gaps(&self) -> Vec<Gap> {
        let of_node = |&node: &usize| {
            let checks = self.report(node).into_iter().flat_map(Report::not_done);
            checks.map(move |check| Gap {
                what: format!("{}: {} not done", self.name(node), check.name),
                why: self.why_not_done(node, &check.name),
            })
        };
        self.nodes.iter().flat_map(of_node).collect()
    }

    /// Why a node does not do a check.
    fn why_not_done(&self, node: usize, check: &str) -> String {
        match check {
            "Program" => self.flash(node, "the image in flash carries no check value"),
            "Oscillators" => {
                "the node runs on the external clock, but no edge of it came to the timer that \
                 measures it"
                    .into()
            }
            "LoopBack" => {
                "the receive pin of the controller was dominant at the start: transceiver, its \
                 supply and wires, and any node that holds the bus dominant"
                    .into()
            }
            "Bus" => "the node was not in the schedule".into(),
            "Relay" => "the node has no motor, or its motor may have turned".into(),
            _ => "the node could not do it".into(),
        }
    }

    /// Why a node may be silent.
    fn silence(&self, node: usize) -> Finding {
        let name = self.name(node);
        let network = self.vehicle.network();
        let its_own = |id: &u16| {
            let message = network.message(*id);
            message.is_some_and(|message| message.sender == *name)
        };
        let heard = &self.answers.heard;
        let look = if heard.is_empty() {
            "no frame at all is on the bus: power of the boards, CANH and CANL, termination, \
             bit rate of the adapter"
                .into()
        } else if let Some(Unsent::OtherCycle { seen }) = self.answers.unsent {
            let cycle = Duration::from_micros(u64::from(network.basic_cycle_us));
            other_cycle(self.vehicle.name(), cycle, seen)
        } else if heard.keys().any(its_own) {
            format!(
                "the node sends other messages: {}",
                self.flash(node, "its image may be of another tree")
            )
        } else if self.answers.unsent == Some(Unsent::NoReference) {
            "without a time master no node reports: LED and console of the time masters".into()
        } else {
            "the node sends nothing: its power, LED and console, then its transceiver and its \
             wires to the bus"
                .into()
        };
        Finding {
            what: format!("{name}: no report"),
            meaning: None,
            look,
        }
    }

    /// The advice to write a node's image.
    fn flash(&self, node: usize, why: &str) -> String {
        format!(
            "{why}; `cargo xtask flash {} --vehicle {}` writes it",
            self.name(node),
            self.vehicle.name()
        )
    }

    /// What to look at first when a check has failed.
    fn look_for_check(&self, node: usize, check: &str) -> String {
        let log = format!(
            "`cargo xtask attach {} --vehicle {}`",
            self.name(node),
            self.vehicle.name()
        );
        match check {
            "Reset" => format!("the log, {log}, tells the cause of the reset and the fault before"),
            "Memory" => "the part: if it fails again after a start, replace the board".into(),
            "Program" => self.flash(node, "the image in flash has changed"),
            "Oscillators" => {
                "solder bridges and oscillator of the board, boards/GETTING_STARTED.md, \"Power, \
                 jumpers and solder bridges\""
                    .into()
            }
            "LoopBack" => {
                "the part: the frame goes through no wire outside of it; try another board".into()
            }
            "Bus" => "termination, CANH and CANL, ground between the boards, and any other \
                device on the bus with another bit rate"
                .into(),
            "Reference" => "the supply of the converter, pin VDDA (on a Nucleo AVDD)".into(),
            "Supply" => "the 3.3 V of the board, at its pin, and what else they supply".into(),
            "Relay" => {
                "the relay, its transistor and the wire of its read back, boards/sleds".into()
            }
            "Stack" => format!("the log, {log}; `cargo xtask build` shows the stack's budget"),
            _ => format!("the log, {log}"),
        }
    }

    /// The results as JSON.
    #[must_use]
    pub fn json(&self) -> Json {
        let nodes: Vec<Json> = self
            .nodes
            .iter()
            .map(|&node| self.json_node(node))
            .collect();
        let findings = self.findings();
        let gaps = self.gaps();
        let requests = self.answers.requests.iter();
        json!({
            "vehicle": self.vehicle.name(),
            "bus": self.bus,
            "passed": findings.is_empty(),
            "reference": self.answers.unsent != Some(Unsent::NoReference),
            "requests": requests
                .map(|(_, after)| json!({ "microseconds_in_cycle": after.as_micros() }))
                .collect::<Vec<_>>(),
            "nodes": nodes,
            "findings": findings
                .iter()
                .map(|finding| json!({
                    "what": finding.what,
                    "passes_when": finding.meaning,
                    "look_first_at": finding.look,
                }))
                .collect::<Vec<_>>(),
            "not_done": gaps
                .iter()
                .map(|gap| json!({ "what": gap.what, "why": gap.why }))
                .collect::<Vec<_>>(),
        })
    }

    fn json_node(&self, node: usize) -> Json {
        let name = self.name(node);
        let Some(report) = self.report(node) else {
            return json!({ "node": name, "reported": false });
        };
        let checks = report.checks.iter();
        let checks: serde_json::Map<String, Json> = checks
            .map(|check| (check.name.clone(), json!(check.result.word())))
            .collect();
        let values = report.values.iter();
        let values: serde_json::Map<String, Json> = values
            .map(|value| {
                let shown: f64 = number(value).parse().unwrap_or(value.value);
                let with_unit = json!({ "value": shown, "unit": value.unit });
                (value.name.clone(), with_unit)
            })
            .collect();
        json!({
            "node": name,
            "reported": true,
            "after_start": report.round == 0,
            "round": report.round,
            "checks": checks,
            "values": values,
        })
    }

    /// The results as text.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, t: &mut String) -> fmt::Result {
        writeln!(t, "Self-test of {} on {}\n", self.vehicle.name(), self.bus)?;
        let rows = self.rows();
        let columns = rows.first().map_or(0, Vec::len);
        let width = |column: usize| {
            let cells = rows.iter().filter_map(|row| row.get(column));
            cells.map(String::len).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..columns).map(width).collect();
        for row in &rows {
            let cells = row.iter().zip(&widths);
            let line: Vec<String> = cells
                .map(|(cell, &width)| format!("{cell:<width$}"))
                .collect();
            writeln!(t, "{}", line.join("  ").trim_end())?;
        }
        writeln!(t)?;
        let findings = self.findings();
        for finding in &findings {
            writeln!(t, "{}", finding.what)?;
            if let Some(meaning) = &finding.meaning {
                writeln!(t, "    passes when  {meaning}")?;
            }
            writeln!(t, "    look first   {}", finding.look)?;
        }
        let gaps = self.gaps();
        for Gap { what, why } in &gaps {
            writeln!(t, "{what}: {why}")?;
        }
        if findings.is_empty() {
            let count = self.nodes.len();
            let nodes = if count == 1 { "node" } else { "nodes" };
            match gaps.len() {
                0 => writeln!(t, "{count} {nodes} reported, and every check passed.")?,
                not_done => writeln!(
                    t,
                    "{count} {nodes} reported. No check failed, {not_done} not done."
                )?,
            }
        }
        Ok(())
    }

    /// The cells of the table: a column for each node.
    fn rows(&self) -> Vec<Vec<String>> {
        let row = |name: &str, cell: &dyn Fn(&Report) -> String| {
            let cells = self.nodes.iter().map(|&node| match self.report(node) {
                Some(report) => cell(report),
                None => "-".into(),
            });
            std::iter::once(name.to_owned()).chain(cells).collect()
        };
        let names = self.nodes.iter().map(|&node| self.name(node).to_owned());
        let mut rows: Vec<Vec<String>> = vec![
            std::iter::once(String::new()).chain(names).collect(),
            row("reported", &|report| match report.round {
                0 => "after a start".into(),
                _ => "while running".into(),
            }),
        ];
        // All reports have the same signals.
        let mut reports = self.nodes.iter().filter_map(|&node| self.report(node));
        let Some(first) = reports.next() else {
            return rows;
        };
        for (index, check) in first.checks.iter().enumerate() {
            rows.push(row(&check.name, &|report| {
                let check = report.checks.get(index);
                check.map_or(String::new(), |check| check.result.word().into())
            }));
        }
        for (index, value) in first.values.iter().enumerate() {
            rows.push(row(&value.name, &|report| {
                let value = report.values.get(index);
                value.map_or(String::new(), |value| {
                    format!("{} {}", number(value), value.unit)
                })
            }));
        }
        rows
    }
}

/// A value with the digits of its resolution.
fn number(value: &Value) -> String {
    format!("{:.*}", value.digits, value.value)
}
