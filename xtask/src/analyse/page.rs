//! The analysis as one page that loads nothing else.

use maud::{DOCTYPE, Markup, html};

use super::{
    Found, drawings,
    figures::{EventKind, ScheduleFigures, Summary, identifier},
    text::{counted, left_out},
};
use crate::page::head;

/// Most events, modes and other rows of one kind on the page.
pub(super) const MOST: usize = 2000;

/// The page.
pub(super) fn page(found: &Found) -> String {
    let summary = &found.summary;
    let title = format!("Bus log of {}", summary.vehicle);
    let sections = sections(found);
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (head(&title, ""))
            body {
                a.skip href="#main" { "Skip to the figures" }
                header {
                    h1 { (title) }
                    p { (about(summary)) }
                    nav aria-label="Sections" {
                        ul {
                            @for (id, heading, _) in &sections { li { a href=(format!("#{id}")) { (heading) } } }
                        }
                    }
                }
                main id="main" {
                    (tiles(summary))
                    @for (id, heading, body) in &sections {
                        section id=(id) aria-labelledby=(format!("{id}-heading")) {
                            h2 id=(format!("{id}-heading")) { (heading) }
                            (body)
                        }
                    }
                }
            }
        }
    };
    page.into_string()
}

/// Address, heading and content of each section that has a content.
fn sections(found: &Found) -> Vec<(&'static str, &'static str, Markup)> {
    let summary = &found.summary;
    let mut all = Vec::new();
    if summary.guidance.is_some() {
        all.push(("guidance", "Track and cross-track error", guidance(found)));
    }
    if !summary.modes.is_empty() {
        all.push(("modes", "Modes", modes(found)));
    }
    if summary.steering.is_some() {
        all.push(("steering", "Steering", steering(found)));
    }
    if let Some(schedule) = &summary.schedule {
        all.push(("timing", "Bus timing", timing(schedule)));
    }
    all.push(("messages", "Messages", messages(summary)));
    all.push(("events", "Events", events(summary)));
    all.push(("log", "The log", log(summary)));
    all
}

fn about(s: &Summary) -> String {
    let files: Vec<&str> = s.log.files.iter().map(|file| file.file.as_str()).collect();
    format!(
        "{}: {} in {:.3} s on interface {}. Times count from the first frame, which is stamped {:.6} s.",
        files.join(", "),
        counted(s.log.frames, "frame", "frames"),
        s.log.span_seconds,
        s.log.interface,
        s.log.start_seconds
    )
}

/// Most autonomous runs among the figures on top.
const TILES: usize = 6;

/// The figures that matter most: name, value, whether it is bad.
fn tiles(s: &Summary) -> Markup {
    let mut all: Vec<(&str, String, bool)> = Vec::new();
    if let Some(schedule) = &s.schedule {
        all.push(("basic cycles", schedule.basic_cycles.to_string(), false));
        for (name, count) in [
            ("missing references", schedule.missing_references),
            ("missed windows", schedule.missed_windows),
            (
                "frames outside their window",
                schedule.frames_outside_their_window,
            ),
        ] {
            all.push((name, count.to_string(), count > 0));
        }
    }
    all.push(("bus load", format!("{:.2} %", s.log.load_percent), false));
    let unknown: u64 = s.unknown.iter().map(|one| one.frames).sum();
    all.push((
        "frames with unknown identifiers",
        unknown.to_string(),
        unknown > 0,
    ));
    let faults = s
        .events
        .iter()
        .filter(|event| event.kind == EventKind::Fault);
    let faults = faults.count();
    all.push(("statuses with a fault", faults.to_string(), faults > 0));
    let runs = s.guidance.iter().flat_map(|guidance| &guidance.runs);
    for run in runs.take(TILES) {
        let value = format!(
            "{:.2} cm, SD {:.2} cm",
            run.mean_cross_track_error_cm, run.standard_deviation_cm
        );
        let name = if run.settling_seconds.is_some() {
            "mean cross-track error, settled"
        } else {
            "mean cross-track error, not settled"
        };
        all.push((name, value, false));
    }
    html! {
        dl.tiles {
            @for (name, value, bad) in &all {
                div class=[bad.then_some("bad")] { dt { (name) } dd { (value) } }
            }
        }
    }
}

/// A column: its heading, and whether it has words.
type Column = (&'static str, bool);

/// A table that can be scrolled by keyboard; rows whose first part is true are marked.
fn table(caption: &str, columns: &[Column], rows: &[(bool, Vec<String>)]) -> Markup {
    let class = |word: bool| word.then_some("word");
    html! {
        div.scroll tabindex="0" role="region" aria-label=(caption) {
            table {
                caption { (caption) }
                thead {
                    tr { @for (name, word) in columns { th scope="col" class=[class(*word)] { (name) } } }
                }
                tbody {
                    @for (bad, cells) in rows.iter().take(MOST) {
                        tr class=[bad.then_some("bad")] {
                            @for (cell, (_, word)) in cells.iter().zip(columns) { td class=[class(*word)] { (cell) } }
                        }
                    }
                }
            }
        }
        @if rows.len() > MOST { p { (rows.len() - MOST) " more rows are in analysis.json." } }
    }
}

fn figure(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(
        || "\u{2013}".to_owned(),
        |value| format!("{value:.digits$}"),
    )
}

fn guidance(found: &Found) -> Markup {
    let Some(figures) = &found.summary.guidance else {
        return Markup::default();
    };
    let columns = [
        ("from (s)", false),
        ("until (s)", false),
        ("positions", false),
        ("at the start (cm)", false),
        ("settled after (s)", false),
        ("mean (cm)", false),
        ("SD (cm)", false),
        ("largest (cm)", false),
        ("estimated mean (cm)", false),
        ("estimated SD (cm)", false),
    ];
    let rows: Vec<_> = figures
        .runs
        .iter()
        .map(|run| {
            let cells = vec![
                format!("{:.2}", run.from_seconds),
                format!("{:.2}", run.until_seconds),
                run.positions.to_string(),
                format!("{:.1}", run.initial_cross_track_error_cm),
                figure(run.settling_seconds, 2),
                format!("{:.2}", run.mean_cross_track_error_cm),
                format!("{:.2}", run.standard_deviation_cm),
                format!("{:.2}", run.largest_cross_track_error_cm),
                figure(run.estimated_mean_cm, 2),
                figure(run.estimated_deviation_cm, 2),
            ];
            (false, cells)
        })
        .collect();
    html! {
        p {
            (counted(figures.positions, "position", "positions"))
            (format!(
                " of the antenna, from {:.2} m north, {:.2} m east to {:.2} m north, {:.2} m east of the base \
                 station.",
                figures.first_m[0], figures.first_m[1], figures.last_m[0], figures.last_m[1]
            ))
        }
        (drawings::track(found))
        (drawings::cross_track(found))
        @if let Some(bars) = &figures.histogram { (drawings::histogram(bars)) }
        @if rows.is_empty() {
            p { "There is no autonomous run in the log." }
        } @else {
            (table(
                "Autonomous runs: cross-track error of the measured positions, positive right of the line; mean, \
                 and SD from settling on, largest from the first pass of the mean on; of the whole run if it did not settle",
                &columns,
                &rows,
            ))
        }
    }
}

fn modes(found: &Found) -> Markup {
    let rows: Vec<_> = found
        .summary
        .modes
        .iter()
        .map(|mode| {
            let cells = vec![
                mode.mode.clone(),
                format!("{:.3}", mode.from_seconds),
                format!("{:.3}", mode.until_seconds),
            ];
            (false, cells)
        })
        .collect();
    html! {
        (drawings::modes(found))
        details {
            summary { "The modes as a table" }
            (table("Modes", &[("mode", true), ("from (s)", false), ("until (s)", false)], &rows))
        }
    }
}

fn steering(found: &Found) -> Markup {
    let Some(s) = &found.summary.steering else {
        return Markup::default();
    };
    html! {
        p {
            (format!(
                "{}, {} of them let the steering move, {} to stand still. Commanded rate: mean {} deg/s, SD {} \
                 deg/s, largest {} deg/s, {} reversals per second. The wheels move from {} deg/s to the right \
                 and {} deg/s to the left; {} to move left them where they were.",
                counted(s.commands, "command", "commands"),
                s.enabled,
                s.zero,
                figure(s.mean_rate_deg_s, 3),
                figure(s.deviation_deg_s, 3),
                figure(s.largest_rate_deg_s, 2),
                figure(s.reversals_per_second, 2),
                figure(s.moves_right_from_deg_s, 2),
                figure(s.moves_left_from_deg_s, 2),
                counted(s.within_dead_band, "command", "commands")
            ))
        }
        (drawings::steering(found))
    }
}

fn timing(s: &ScheduleFigures) -> Markup {
    let columns = [
        ("message", true),
        ("id", false),
        ("sender", true),
        ("window at (us)", false),
        ("frames", false),
        ("missed", false),
        ("earliest (us)", false),
        ("mean (us)", false),
        ("latest (us)", false),
        ("jitter (us)", false),
        ("SD (us)", false),
    ];
    let windows = s.windows.iter().map(|one| {
        let cells = vec![
            one.message.clone(),
            one.id.to_string(),
            one.sender.clone(),
            format!("{:.0}", one.window_start_us),
            one.frames.to_string(),
            one.missed.to_string(),
            figure(one.earliest_start_us, 1),
            figure(one.mean_start_us, 2),
            figure(one.latest_start_us, 1),
            figure(one.jitter_us, 1),
            figure(one.deviation_us, 2),
        ];
        (one.missed > 0, cells)
    });
    let foreign = s.foreign.iter().map(|one| {
        let window = match one.window_start_us {
            Some(start) => format!("{start:.0} us, of {}", one.window_of.join(", ")),
            None => "none: free time".to_owned(),
        };
        let name = one.message.clone().unwrap_or_else(|| "unknown".to_owned());
        (
            true,
            vec![
                name,
                identifier(one.id, one.extended),
                window,
                one.frames.to_string(),
            ],
        )
    });
    html! {
        @if s.tolerance_us > 0.0 {
            p { "The stamps are whole milliseconds apart, so a frame may be a millisecond beside its window." }
        }
        p {
            (format!(
                "{}: {} us to {} us, mean {} us. {}. {} could not be placed, for want of a reference.",
                counted(s.basic_cycles, "basic cycle", "basic cycles"),
                figure(s.shortest_cycle_us, 1),
                figure(s.longest_cycle_us, 1),
                figure(s.mean_cycle_us, 2),
                counted(s.missing_references, "reference is missing", "references are missing"),
                counted(s.frames_without_reference, "frame", "frames")
            ))
        }
        (drawings::windows(s))
        (table(
            "Starts of frame after the begin of the window; a window is missed if its message was due and had come \
             before",
            &columns,
            &windows.collect::<Vec<_>>(),
        ))
        @if let Some(never) = s.never_came() {
            p { "Never came, and is not counted as missed: " (never) "." }
        }
        @if s.foreign.is_empty() {
            p { "No frame was outside its window." }
        } @else {
            (table(
                "Frames outside their window",
                &[("message", true), ("id", false), ("was in the window at", true), ("frames", false)],
                &foreign.collect::<Vec<_>>(),
            ))
        }
    }
}

fn messages(s: &Summary) -> Markup {
    let columns = [
        ("message", true),
        ("id", false),
        ("sender", true),
        ("frames", false),
        ("mean period (ms)", false),
        ("least (ms)", false),
        ("greatest (ms)", false),
    ];
    let rows = s.messages.iter().map(|one| {
        let cells = vec![
            one.message.clone(),
            one.id.to_string(),
            one.sender.clone(),
            one.frames.to_string(),
            figure(one.mean_period_ms, 3),
            figure(one.least_period_ms, 3),
            figure(one.greatest_period_ms, 3),
        ];
        (one.wrong_length > 0, cells)
    });
    let unknown = s.unknown.iter().map(|one| {
        let id = identifier(one.id, one.extended);
        (true, vec![id, one.frames.to_string()])
    });
    let remote = s.remote.iter().map(|one| {
        let id = identifier(one.id, one.extended);
        let message = one.message.clone().unwrap_or_else(|| "unknown".to_owned());
        (false, vec![id, message, one.frames.to_string()])
    });
    html! {
        (table("Messages of the network file", &columns, &rows.collect::<Vec<_>>()))
        @if !s.unknown.is_empty() {
            (table(
                "Identifiers that the network file does not have",
                &[("identifier", true), ("frames", false)],
                &unknown.collect::<Vec<_>>(),
            ))
        }
        @if !s.remote.is_empty() {
            (table(
                "Remote frames: the log does not tell who sent them",
                &[("identifier", true), ("message asked for", true), ("frames", false)],
                &remote.collect::<Vec<_>>(),
            ))
        }
    }
}

fn events(s: &Summary) -> Markup {
    let shown = s.events.iter().take(MOST);
    let rest = s.events.len().saturating_sub(MOST) as u64 + s.events_left_out;
    let bad = |kind: EventKind| {
        !matches!(
            kind,
            EventKind::Mode | EventKind::Button | EventKind::Status | EventKind::Message
        )
    };
    html! {
        @if s.events.is_empty() {
            p { "There are none in the log." }
        } @else {
            div.scroll tabindex="0" role="region" aria-label="Events" {
                table {
                    caption { "Events in order of time" }
                    thead {
                        tr { th scope="col" { "time (s)" } th.word scope="col" { "kind" } th.word scope="col" { "event" } }
                    }
                    tbody {
                        @for event in shown {
                            tr class=[bad(event.kind).then_some("bad")] {
                                td { (format!("{:.3}", event.at_seconds)) }
                                td.word { (event.kind.name()) }
                                td.what { (event.what) }
                            }
                        }
                    }
                }
            }
        }
        @if rest > 0 { p { (counted(rest, "event is", "events are")) " not shown; events.csv has those that were kept." } }
    }
}

fn log(s: &Summary) -> Markup {
    let left_out = left_out(&s.log);
    html! {
        ul {
            @for file in &s.log.files {
                li { (file.file) " (" (file.format) "): " (counted(file.frames, "frame", "frames")) }
            }
        }
        @if left_out.is_empty() {
            p { "Nothing was skipped." }
        } @else {
            p { "Skipped:" }
            ul { @for one in &left_out { li { (one) } } }
        }
        @if s.log.time_goes_back > 0 {
            p { "The time stamps go back " (counted(s.log.time_goes_back, "time", "times")) "." }
        }
        p {
            "Loggers stamp the end of a frame. Its start is taken to be its length in bits earlier, stuff bits \
             included, so the starts are as exact as the stamps."
        }
    }
}
