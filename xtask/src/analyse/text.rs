//! The analysis as text for a terminal.

use std::fmt::{self, Write};

use super::figures::{
    EventKind, GuidanceFigures, LogFigures, ScheduleFigures, SteeringFigures, Summary, identifier,
};

/// Most events, modes, runs, and other things of one kind that are printed.
const MOST: usize = 40;

/// Says that a list goes on.
fn more(t: &mut String, count: usize) -> fmt::Result {
    match count.saturating_sub(MOST) {
        0 => Ok(()),
        rest => writeln!(t, "  and {rest} more: --json has them all"),
    }
}

/// The summary as text.
#[must_use]
pub fn text(summary: &Summary) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = all(&mut text, summary);
    text
}

fn figure(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

fn all(t: &mut String, s: &Summary) -> fmt::Result {
    log(t, &s.log)?;
    messages(t, s)?;
    match &s.schedule {
        Some(schedule) => timing(t, schedule)?,
        None => writeln!(
            t,
            "\nSchedule\n  the nodes of {} send at once: there are no windows",
            s.vehicle
        )?,
    }
    if !s.modes.is_empty() {
        writeln!(t, "\nModes")?;
    }
    for mode in s.modes.iter().take(MOST) {
        writeln!(
            t,
            "  {:>12.3} s to {:>12.3} s  {}",
            mode.from_seconds, mode.until_seconds, mode.mode
        )?;
    }
    more(t, s.modes.len())?;
    if let Some(figures) = &s.guidance {
        guidance(t, figures)?;
    }
    if let Some(figures) = &s.steering {
        steering(t, figures)?;
    }
    events(t, s)
}

/// A number with the thing that it counts.
pub(super) fn counted(count: u64, one: &str, many: &str) -> String {
    match count {
        1 => format!("1 {one}"),
        count => format!("{count} {many}"),
    }
}

/// Everything that was skipped, in words.
pub(super) fn left_out(log: &LogFigures) -> Vec<String> {
    let mut all = Vec::new();
    if log.frames_of_other_interfaces > 0 {
        let others = log.interfaces.iter();
        let others: Vec<String> = others
            .filter(|(name, _)| **name != log.interface)
            .map(|(name, frames)| format!("{name}: {frames}"))
            .collect();
        all.push(format!(
            "frames of other interfaces ({})",
            others.join(", ")
        ));
    }
    for (kind, count) in &log.skipped {
        all.push(format!("{kind}: {count}"));
    }
    if log.wrong_length > 0 {
        all.push(format!(
            "frames with a wrong length, not decoded: {}",
            log.wrong_length
        ));
    }
    if log.remote_frames > 0 {
        all.push(format!(
            "remote frames, without data: {}",
            log.remote_frames
        ));
    }
    all
}

fn log(t: &mut String, log: &LogFigures) -> fmt::Result {
    writeln!(t, "Log")?;
    for file in &log.files {
        let frames = counted(file.frames, "frame", "frames");
        writeln!(t, "  {} ({}): {frames}", file.file, file.format)?;
    }
    writeln!(
        t,
        "  {} in {:.3} s on interface {}, bus load {:.2} %; the first is stamped {:.6} s, and times count \
         from there",
        counted(log.frames, "frame", "frames"),
        log.span_seconds,
        log.interface,
        log.load_percent,
        log.start_seconds
    )?;
    let left_out = left_out(log);
    if left_out.is_empty() {
        writeln!(t, "  nothing was skipped")?;
    } else {
        writeln!(t, "  skipped: {}", left_out.join("; "))?;
    }
    if log.time_goes_back > 0 {
        let times = counted(log.time_goes_back, "time", "times");
        writeln!(t, "  the time stamps go back {times}")?;
        if log.time_goes_back > log.frames / 10 {
            writeln!(
                t,
                "  are they times between frames, as candump -t d writes them? Then nothing below is right"
            )?;
        }
    }
    Ok(())
}

fn messages(t: &mut String, s: &Summary) -> fmt::Result {
    writeln!(
        t,
        "\nMessages of {}\n  {:>4}  {:<18} {:<11} {:>8} {:>13} {:>10} {:>10}",
        s.vehicle, "id", "message", "sender", "frames", "period: mean", "least", "greatest"
    )?;
    for one in &s.messages {
        writeln!(
            t,
            "  {:>4}  {:<18} {:<11} {:>8} {:>10} ms {:>7} ms {:>7} ms",
            one.id,
            one.message,
            one.sender,
            one.frames,
            figure(one.mean_period_ms, 3),
            figure(one.least_period_ms, 2),
            figure(one.greatest_period_ms, 2)
        )?;
    }
    if s.messages.is_empty() {
        writeln!(t, "  none")?;
    }
    let unknown: Vec<String> = s
        .unknown
        .iter()
        .take(MOST)
        .map(|one| format!("{}: {}", identifier(one.id, one.extended), one.frames))
        .collect();
    if !unknown.is_empty() {
        writeln!(t, "  unknown identifiers: {}", unknown.join(", "))?;
        more(t, s.unknown.len())?;
    }
    for one in s.remote.iter().take(MOST) {
        let name = one.message.as_deref().unwrap_or("unknown");
        let id = identifier(one.id, one.extended);
        let frames = counted(one.frames, "remote frame", "remote frames");
        writeln!(
            t,
            "  {frames} for {id} {name}; the log does not tell who asked"
        )?;
    }
    more(t, s.remote.len())
}

fn timing(t: &mut String, s: &ScheduleFigures) -> fmt::Result {
    writeln!(t, "\nSchedule")?;
    writeln!(
        t,
        "  {}, {} us to {} us, mean {} us; {} missing",
        counted(s.basic_cycles, "basic cycle", "basic cycles"),
        figure(s.shortest_cycle_us, 1),
        figure(s.longest_cycle_us, 1),
        figure(s.mean_cycle_us, 2),
        counted(s.missing_references, "reference is", "references are")
    )?;
    if s.tolerance_us > 0.0 {
        writeln!(
            t,
            "  the stamps are whole milliseconds apart, so a frame may be {:.0} us beside its window",
            s.tolerance_us
        )?;
    }
    writeln!(
        t,
        "  {} missed, {}, {} without a reference",
        counted(s.missed_windows, "window", "windows"),
        counted(
            s.frames_outside_their_window,
            "frame outside its window",
            "frames outside their window"
        ),
        counted(s.frames_without_reference, "frame", "frames")
    )?;
    writeln!(
        t,
        "  {:>9}  {:>4}  {:<18} {:<11} {:>7} {:>7} {:>9} {:>9} {:>9} {:>9}",
        "window",
        "id",
        "message",
        "sender",
        "frames",
        "missed",
        "earliest",
        "mean",
        "latest",
        "jitter"
    )?;
    for window in &s.windows {
        writeln!(
            t,
            "  {:>6.0} us  {:>4}  {:<18} {:<11} {:>7} {:>7} {:>9} {:>9} {:>9} {:>6} us",
            window.window_start_us,
            window.id,
            window.message,
            window.sender,
            window.frames,
            window.missed,
            figure(window.earliest_start_us, 1),
            figure(window.mean_start_us, 2),
            figure(window.latest_start_us, 1),
            figure(window.jitter_us, 1)
        )?;
    }
    if let Some(never) = s.never_came() {
        writeln!(t, "  never came, and is not counted as missed: {never}")?;
    }
    for one in s.foreign.iter().take(MOST) {
        let name = one.message.as_deref().unwrap_or("unknown");
        let place = match one.window_start_us {
            Some(start) => format!(
                "in the window at {start:.0} us of {}",
                one.window_of.join(", ")
            ),
            None => "in time that belongs to nobody".to_owned(),
        };
        let frames = counted(one.frames, "frame", "frames");
        let id = identifier(one.id, one.extended);
        writeln!(t, "  foreign: {id} {name}, {frames} {place}")?;
    }
    more(t, s.foreign.len())
}

fn guidance(t: &mut String, g: &GuidanceFigures) -> fmt::Result {
    writeln!(
        t,
        "\nGuidance\n  {} from {:.2} m north, {:.2} m east to {:.2} m north, {:.2} m east",
        counted(g.positions, "position", "positions"),
        g.first_m[0],
        g.first_m[1],
        g.last_m[0],
        g.last_m[1]
    )?;
    for run in g.runs.iter().take(MOST) {
        let settled = match run.settling_seconds {
            Some(seconds) => format!("settled to 5 cm in {seconds:.2} s, then"),
            None => "not settled to 5 cm,".to_owned(),
        };
        writeln!(
            t,
            "  autonomous {:.2} s to {:.2} s, from {:.1} cm off the line: {settled} mean {:.2} cm, \
             standard deviation {:.2} cm, largest {:.2} cm",
            run.from_seconds,
            run.until_seconds,
            run.initial_cross_track_error_cm,
            run.mean_cross_track_error_cm,
            run.standard_deviation_cm,
            run.largest_cross_track_error_cm
        )?;
        if let Some((mean, deviation)) = run.estimated_mean_cm.zip(run.estimated_deviation_cm) {
            writeln!(
                t,
                "    by the vehicle's own estimate: mean {mean:.2} cm, standard deviation {deviation:.2} cm"
            )?;
        }
    }
    more(t, g.runs.len())?;
    if g.runs.is_empty() {
        writeln!(t, "  no autonomous run")?;
    }
    let Some(bars) = &g.histogram else {
        return Ok(());
    };
    writeln!(t, "  cross-track error, positive right of the line")?;
    let most = bars.positions.iter().copied().max().unwrap_or(1).max(1);
    for (index, count) in bars.positions.iter().enumerate() {
        let from = bars.from_cm + index as f64 * bars.width_cm;
        let length = (count * 40).div_ceil(most) as usize;
        let until = from + bars.width_cm;
        let bar = "#".repeat(length);
        let line = format!("  {from:>7.1} to {until:>5.1} cm {count:>7} {bar}");
        writeln!(t, "{}", line.trim_end())?;
    }
    Ok(())
}

fn steering(t: &mut String, s: &SteeringFigures) -> fmt::Result {
    writeln!(
        t,
        "\nSteering\n  {}, {} of them let the steering move, {} to stand still",
        counted(s.commands, "command", "commands"),
        s.enabled,
        s.zero
    )?;
    if s.enabled == 0 {
        return Ok(());
    }
    writeln!(
        t,
        "  rate: mean {} deg/s, standard deviation {} deg/s, largest {} deg/s; {} reversals per second",
        figure(s.mean_rate_deg_s, 3),
        figure(s.deviation_deg_s, 3),
        figure(s.largest_rate_deg_s, 2),
        figure(s.reversals_per_second, 2)
    )?;
    writeln!(
        t,
        "  dead band: the wheels move from {} deg/s to the right and {} deg/s to the left; {} to move \
         left them where they were",
        figure(s.moves_right_from_deg_s, 2),
        figure(s.moves_left_from_deg_s, 2),
        counted(s.within_dead_band, "command", "commands")
    )
}

fn events(t: &mut String, s: &Summary) -> fmt::Result {
    writeln!(t, "\nEvents")?;
    // A fault is not to be lost among many changes of a status.
    let told: Vec<_> = match s.events.len() {
        0..=MOST => s.events.iter().collect(),
        _ => s
            .events
            .iter()
            .filter(|event| event.kind != EventKind::Status)
            .take(MOST)
            .collect(),
    };
    for event in &told {
        let kind = event.kind.name();
        writeln!(
            t,
            "  {:>12.3} s  {kind:<17} {}",
            event.at_seconds, event.what
        )?;
    }
    let rest = s.events.len() as u64 + s.events_left_out - told.len() as u64;
    match (s.events.len(), rest) {
        (0, _) => writeln!(t, "  none"),
        (_, 0) => Ok(()),
        (_, rest) => writeln!(t, "  and {rest} more: --out writes events.csv"),
    }
}
