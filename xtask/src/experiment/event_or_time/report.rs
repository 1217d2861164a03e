//! Table, JSON and picture of the experiment.

use std::fmt::Write as _;

use serde::Serialize;
use world::report::{LatencyBar, LatencySeries, latency_svg};

use super::{Figures, NAME, Way, load::IDS};
use crate::cli::Sim;

/// Latencies above this are cut off in the picture, us: a basic cycle.
const MOST: f64 = 5000.0;

/// The latencies that are above their bounds, one phrase each.
pub(super) fn above_bounds(figures: &[Figures]) -> Vec<String> {
    let above = figures.iter().filter_map(|one| {
        let (seen, bound) = one.largest_latency_us.zip(one.latency_bound_us)?;
        (seen > bound).then(|| {
            format!(
                "{seen:.0} us from sample to pulse are above the bound of {bound:.0} us ({}, {} %)",
                one.way.name(),
                one.foreign_load_percent
            )
        })
    });
    above.collect()
}

/// For programs.
pub(super) fn json(options: &Sim, figures: &[Figures]) -> String {
    #[derive(Serialize)]
    struct Report<'a> {
        experiment: &'static str,
        first_seed: u64,
        seeds: u64,
        foreign_identifiers: [u16; 4],
        cases: &'a [Figures],
    }
    let report = Report {
        experiment: NAME,
        first_seed: options.seed,
        seeds: options.seeds,
        foreign_identifiers: IDS,
        cases: figures,
    };
    let mut text = serde_json::to_string_pretty(&report).unwrap_or_default();
    text.push('\n');
    text
}

/// For people.
pub(super) fn text(options: &Sim, figures: &[Figures]) -> String {
    let last = options.seed.wrapping_add(options.seeds - 1);
    let mut text = format!(
        "{NAME}: seeds {} to {last}, release images\n\n{:>9}{:>9}{:>6}   {:>8}{:>8}{:>8}{:>8}{:>8}   {:>8}{:>8}\n{:>9}{:>9}{:>6}   {:>40}   {:>8}{:>8}\n{:>9}{:>9}{:>6}   {:>8}{:>8}{:>8}{:>8}{:>8}   {:>8}{:>8}\n",
        options.seed,
        "foreign",
        "foreign",
        "bus",
        "",
        "",
        "",
        "",
        "",
        "command",
        "",
        "offered",
        "carried",
        "",
        "first sample to pulse, us",
        "jitter",
        "missed",
        "%",
        "%",
        "%",
        "least",
        "mean",
        "largest",
        "jitter",
        "bound",
        "us",
        "of 1000",
    );
    let cell = |value: Option<f64>| value.map_or_else(|| "-".into(), |value| format!("{value:.0}"));
    let mut way = None;
    for one in figures {
        if way.replace(one.way) != Some(one.way) {
            let _ = writeln!(text, "{}", one.way.name());
        }
        let bound = match (one.way, one.latency_bound_us) {
            (Way::ScheduleIgnored, _) => "-".into(),
            (_, None) => "none".into(),
            (_, bound) => cell(bound),
        };
        let missed = 1000.0 * one.missed_commands as f64 / one.cycles.max(1) as f64;
        let _ = writeln!(
            text,
            "{:>9}{:>9.1}{:>6.1}   {:>8}{:>8}{:>8}{:>8}{bound:>8}   {:>8}{missed:>8.1}",
            one.foreign_load_percent,
            one.carried_percent,
            one.bus_percent,
            cell(one.least_latency_us),
            cell(one.mean_latency_us),
            cell(one.largest_latency_us),
            cell(one.latency_jitter_us),
            cell(one.command_jitter_us),
        );
    }
    let ids = IDS.map(|id| id.to_string()).join(", ");
    let _ = writeln!(
        text,
        "\nForeign frames: 8 random bytes, identifiers {ids}, each up to half a period late at random. By the \
         schedule\nthey go out in free windows, and a newer one replaces one that waits. Command jitter: largest \
         difference of the\ntime between two commands from a cycle. Bound: none if the analysis has none, - where the \
         schedule that\nit assumes is ignored."
    );
    text
}

/// The picture.
pub(super) fn picture(figures: &[Figures]) -> String {
    let mut series: Vec<LatencySeries> = Vec::new();
    for one in figures {
        let name = one.way.name();
        if series.last().is_none_or(|last| last.name != name) {
            series.push(LatencySeries {
                name: name.into(),
                bars: Vec::new(),
            });
        }
        let seen = one.least_latency_us.zip(one.mean_latency_us);
        let bar = LatencyBar {
            load: one.foreign_load_percent.into(),
            seen: seen
                .zip(one.largest_latency_us)
                .map(|((least, mean), largest)| [least, mean, largest]),
            bound: one.latency_bound_us,
        };
        if let Some(last) = series.last_mut() {
            last.bars.push(bar);
        }
    }
    latency_svg("From the first sample to the pulse", &series, MOST)
}
