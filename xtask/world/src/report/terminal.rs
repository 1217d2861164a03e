//! The summary as text for a terminal.

use core::fmt::Write;
use std::time::Duration;

use super::crop::UNKNOWN;
use super::{
    ContactFigures, CropFigures, MissionFigures, RoverFigures, Summary,
    figures::{AutonomousRun, BusFigures, StopFigures},
};

fn figure(value: Option<f64>, digits: usize, unit: &str) -> String {
    value.map_or_else(
        || "-".to_owned(),
        |value| format!("{value:.digits$} {unit}"),
    )
}

/// The summary as text. `wall` is the real time that the simulation took. No file contains it,
/// because it differs between runs.
#[must_use]
pub fn terminal(summary: &Summary, wall: Option<Duration>) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_all(&mut text, summary, wall);
    text
}

fn write_all(t: &mut String, s: &Summary, wall: Option<Duration>) -> core::fmt::Result {
    writeln!(
        t,
        "{}, seed {}, {} s simulated",
        s.scenario, s.seed, s.simulated_seconds
    )?;
    if !s.set.is_empty() {
        writeln!(t, "  with {}", s.set.replace(';', ", "))?;
    }
    if let Some(wall) = wall {
        let wall = wall.as_secs_f64();
        let pace = s.simulated_seconds / wall.max(1e-9);
        writeln!(
            t,
            "  {wall:.1} s of wall time: {pace:.2} simulated seconds per second"
        )?;
    }

    write_guidance(t, s)?;
    write_bus(t, &s.bus)?;
    write_tasks(t, s)?;
    write_judgements(t, s)
}

/// What the scenario expects, and what makes the run questionable.
fn write_judgements(t: &mut String, s: &Summary) -> core::fmt::Result {
    if !s.expectations.is_empty() {
        writeln!(t, "\nExpectations")?;
    }
    for one in &s.expectations {
        writeln!(t, "  {:<7}{}: {}", one.judgement, one.expected, one.seen)?;
    }
    if !s.notes.is_empty() {
        writeln!(t, "\nNotes")?;
    }
    for note in &s.notes {
        writeln!(t, "  {note}")?;
    }
    Ok(())
}

fn write_guidance(t: &mut String, s: &Summary) -> core::fmt::Result {
    writeln!(t, "\nGuidance")?;
    match &s.rover {
        Some(rover) => write_rover(t, rover)?,
        None => write_machine(t, s)?,
    }
    if let Some(crop) = &s.crop {
        write_crop(t, crop)?;
    }
    for mode in &s.modes {
        writeln!(t, "  {:>10.3} s  {}", mode.at_seconds, mode.mode)?;
    }
    for stop in &s.stops {
        let after = after(stop);
        writeln!(t, "  {:>10.3} s  {}: {after}", stop.at_seconds, stop.event)?;
    }
    Ok(())
}

/// What the motors did after an event, in words.
fn after(stop: &StopFigures) -> String {
    match (stop.motors_stopped_after_ms, &stop.guided_on_by) {
        (Some(0.0), _) => "the motors stood already".into(),
        (Some(ms), _) => format!("motors stopped after {ms:.1} ms"),
        (None, Some(guide)) => format!("the vehicle drove on, guided by {guide}"),
        (None, None) => {
            "the motors did not stop before the next event or the end of the run".into()
        }
    }
}

fn write_machine(t: &mut String, s: &Summary) -> core::fmt::Result {
    let steering = s.largest_steering_angle_deg;
    let figures = s.distance_m.zip(s.largest_speed_m_s).zip(steering);
    if let Some(((way, speed), steering)) = figures {
        writeln!(
            t,
            "  {way:.1} m driven, up to {speed:.2} m/s and {steering:.1} deg of steering"
        )?;
    }
    if s.autonomous_runs.is_empty() {
        writeln!(t, "  no autonomous run")?;
    }
    for run in &s.autonomous_runs {
        match &s.mission {
            None => write_run(t, run)?,
            Some(_) => writeln!(
                t,
                "  autonomous {:.2} s to {:.2} s",
                run.from_seconds, run.until_seconds
            )?,
        }
    }
    if let Some(mission) = &s.mission {
        write_mission(t, mission, !s.autonomous_runs.is_empty())?;
    }
    Ok(())
}

/// How far a mission was driven.
fn driven_to(mission: &MissionFigures) -> String {
    let cut = match mission.cut {
        true => ", then the time of the run was over",
        false => "",
    };
    match mission.rounds {
        Some(rounds) => {
            let rounds = counted(rounds as u64, "whole round", "whole rounds");
            format!("in {rounds} of {:.1} m{cut}", mission.path_m)
        }
        None if mission.finished => "to its end".into(),
        None if mission.cut => format!("for a part of its {:.1} m{cut}", mission.path_m),
        None => "not to its end".into(),
    }
}

/// `begun` says whether there was a run.
fn write_mission(t: &mut String, mission: &MissionFigures, begun: bool) -> core::fmt::Result {
    writeln!(
        t,
        "  mission driven {}: {:.1} m in {:.1} s with {}",
        driven_to(mission),
        mission.way_m,
        mission.time_seconds,
        counted(mission.stops as u64, "stop", "stops")
    )?;
    if let Some(end) = &mission.ended {
        let reason = end.reason.as_ref();
        let reason = reason.map_or_else(String::new, |reason| format!(", reason {reason}"));
        let what = match begun {
            true => "its run ended",
            false => "no run began, refused",
        };
        writeln!(
            t,
            "    {what} at {:.1} s: mode {}{reason}",
            end.at_seconds, end.mode
        )?;
    }
    let rows = [
        ("legs, mean cross-track error", mission.mean_cm),
        ("legs, standard deviation", mission.deviation_cm),
        ("legs, largest", mission.largest_cm),
        ("turns, largest", mission.turns_largest_cm),
        ("sections switched within", mission.switched_within_cm),
    ];
    for (name, value) in rows {
        writeln!(t, "    {name:<30}{:>12}", figure(value, 2, "cm"))?;
    }
    if mission.wrong_switches > 0 {
        let wrong = counted(mission.wrong_switches as u64, "switch", "switches");
        writeln!(t, "    {wrong} of a section missing or out of place")?;
    }
    if let Some(coverage) = &mission.coverage {
        writeln!(
            t,
            "    {:.0} m2 of swaths: {:.2} % worked, {:.2} % twice; {:.1} m2 beside them",
            coverage.swaths_m2,
            coverage.worked_percent,
            coverage.twice_percent,
            coverage.outside_m2
        )?;
    }
    if !mission.legs.is_empty() {
        writeln!(
            t,
            "    {:>5} {:>9} {:>9} {:>10} {:>10} {:>10}  sections on / off behind the ends",
            "leg", "from", "speed", "mean", "deviation", "largest"
        )?;
    }
    for leg in &mission.legs {
        let sections = leg.sections.iter().map(|section| {
            let place = |place: Option<f64>| figure(place, 1, "cm");
            let (on, off) = (place(section.on_cm), place(section.off_cm));
            format!("{}: {on} / {off}", section.section)
        });
        writeln!(
            t,
            "    {:>5} {:>7.1} s {:>5.2} m/s {:>7.2} cm {:>7.2} cm {:>7.2} cm  {}",
            leg.leg,
            leg.from_seconds,
            leg.mean_speed_m_s,
            leg.mean_cm,
            leg.deviation_cm,
            leg.largest_cm,
            sections.collect::<Vec<_>>().join(", ")
        )?;
    }
    Ok(())
}

fn write_rover(t: &mut String, rover: &RoverFigures) -> core::fmt::Result {
    let Some((from, until)) = rover.from_seconds.zip(rover.until_seconds) else {
        return writeln!(t, "  the rover did not move in its row");
    };
    writeln!(
        t,
        "  {:.2} m along the row of {:.2} m, {from:.2} s to {until:.2} s; at {:.2} m at the end",
        rover.way_m, rover.row_length_m, rover.end_station_m
    )?;
    let rows = [
        ("mean speed", figure(rover.mean_speed_m_s, 2, "m/s")),
        ("largest speed", figure(rover.largest_speed_m_s, 2, "m/s")),
        (
            "mean offset from the middle",
            figure(rover.mean_offset_cm, 2, "cm"),
        ),
        ("largest offset", figure(rover.largest_offset_cm, 2, "cm")),
        (
            "mean of right - left distance",
            figure(rover.mean_difference_cm, 2, "cm"),
        ),
        (
            "mean of its magnitude",
            figure(rover.mean_absolute_difference_cm, 2, "cm"),
        ),
        (
            "from sample to pulse, least",
            figure(rover.least_latency_us, 2, "us"),
        ),
        ("mean", figure(rover.mean_latency_us, 2, "us")),
        ("largest", figure(rover.largest_latency_us, 2, "us")),
    ];
    for (name, value) in rows {
        writeln!(t, "    {name:<30}{value:>12}")?;
    }
    write_contacts(t, &rover.contacts)
}

/// What guided a machine between rows, and how well.
fn write_crop(t: &mut String, crop: &CropFigures) -> core::fmt::Result {
    writeln!(
        t,
        "  in the row of {:.2} m; at {:.2} m at the end",
        crop.row_length_m, crop.end_station_m
    )?;
    for stretch in &crop.guides {
        writeln!(
            t,
            "    {:<14} {:>7.2} m, {:.2} s to {:.2} s at {}; offset from the middle: mean {}, \
             largest {}",
            guided(&stretch.guide),
            stretch.way_m,
            stretch.from_seconds,
            stretch.until_seconds,
            figure(stretch.mean_speed_m_s, 2, "m/s"),
            figure(stretch.mean_offset_cm, 2, "cm"),
            figure(stretch.largest_offset_cm, 2, "cm"),
        )?;
    }
    write_contacts(t, &crop.contacts)
}

/// What guided the machine; without a message that tells it, only that it drove.
fn guided(guide: &str) -> String {
    match guide {
        UNKNOWN => "driven".into(),
        guide => format!("by {guide}"),
    }
}

fn write_contacts(t: &mut String, contacts: &[ContactFigures]) -> core::fmt::Result {
    if contacts.is_empty() {
        writeln!(t, "  no contact")?;
    }
    for contact in contacts {
        writeln!(
            t,
            "  {:>10.3} s  touched a {} at {:.2} m, {:.0} cm to the {} of the middle",
            contact.at_seconds,
            contact.with,
            contact.station_m,
            contact.right_cm.abs(),
            if contact.right_cm < 0.0 {
                "left"
            } else {
                "right"
            }
        )?;
    }
    Ok(())
}

fn write_run(t: &mut String, run: &AutonomousRun) -> core::fmt::Result {
    writeln!(
        t,
        "  autonomous {:.2} s to {:.2} s, from {:.1} cm off the line:",
        run.from_seconds, run.until_seconds, run.initial_cross_track_error_cm
    )?;
    let rows = [
        ("settled to 5 cm in", figure(run.settling_seconds, 2, "s")),
        (
            "mean cross-track error",
            figure(run.mean_cross_track_error_cm, 2, "cm"),
        ),
        (
            "standard deviation",
            figure(run.standard_deviation_cm, 2, "cm"),
        ),
        (
            "largest, approach over",
            figure(run.largest_cross_track_error_cm, 2, "cm"),
        ),
        ("overshoot", figure(Some(run.overshoot_cm), 2, "cm")),
        (
            "steering reversals",
            figure(run.steering_reversals_per_second, 2, "per s"),
        ),
    ];
    for (name, value) in rows {
        writeln!(t, "    {name:<24}{value:>12}")?;
    }
    Ok(())
}

fn write_bus(t: &mut String, bus: &BusFigures) -> core::fmt::Result {
    writeln!(t, "\nBus")?;
    writeln!(
        t,
        "  load {:.2} %, {} frames, {} error frames, {} basic cycles",
        bus.load_percent, bus.frames, bus.error_frames, bus.basic_cycles
    )?;
    let latest = bus
        .latest_start_id
        .map_or(String::new(), |id| format!(" (id {id})"));
    writeln!(
        t,
        "  latest start of frame {}{latest} after its window begins, earliest {}",
        figure(bus.latest_start_us, 2, "us"),
        figure(bus.earliest_start_us, 2, "us")
    )?;
    writeln!(
        t,
        "  {}, {}, {}",
        counted(bus.missed_windows, "missed window", "missed windows"),
        counted(
            bus.frames_outside_their_window,
            "frame outside its window",
            "frames outside their window"
        ),
        counted(bus.foreign_frames, "foreign frame", "foreign frames")
    )?;
    if let Some(time) = &bus.global_time {
        writeln!(
            t,
            "  global time of any two nodes within {:.3} us, 99 % of {} instants within {:.3} us",
            time.largest_difference_us, time.instants, time.p99_difference_us
        )?;
    }
    for gate in &bus.gates {
        let again = gate.open_again_seconds.map_or_else(
            || "is closed at the end".to_owned(),
            |seconds| format!("is open again since {seconds:.3} s"),
        );
        let often = match gate.closings {
            1 => "once".to_owned(),
            closings => format!("{closings} times"),
        };
        writeln!(
            t,
            "  {:>10.3} s  guardian closed the gate of {}, {often}; it {again}",
            gate.first_closed_seconds, gate.node
        )?;
    }
    for takeover in &bus.takeovers {
        let after = takeover.next_reference_after_us.map_or_else(
            || "no other master took over".to_owned(),
            |us| {
                format!(
                    "next reference {us:.1} us after its last, bound {:.1} us",
                    takeover.bound_us
                )
            },
        );
        writeln!(
            t,
            "  {:>10.3} s  time master {} dead: {after}; {} windows of others lost",
            takeover.at_seconds, takeover.master, takeover.windows_lost
        )?;
    }
    write_windows(t, bus)
}

fn write_windows(t: &mut String, bus: &BusFigures) -> core::fmt::Result {
    if !bus.windows.is_empty() {
        writeln!(
            t,
            "  {:>9}  {:>4}  {:<16} {:<11} {:>7} {:>7} {:>10} {:>10} {:>10}",
            "window", "id", "message", "sender", "frames", "missed", "earliest", "mean", "latest"
        )?;
    }
    for window in &bus.windows {
        let us = |value: Option<f64>| figure(value, 2, "us");
        writeln!(
            t,
            "  {:>6.0} us  {:>4}  {:<16} {:<11} {:>7} {:>7} {:>10} {:>10} {:>10}",
            window.window_start_us,
            window.id,
            window.message,
            window.sender,
            window.frames,
            window.missed,
            us(window.earliest_start_us),
            us(window.mean_start_us),
            us(window.latest_start_us)
        )?;
    }
    let others: Vec<String> = bus
        .frames_per_id
        .iter()
        .filter(|entry| bus.windows.iter().all(|window| window.id != entry.id))
        .map(|entry| {
            let name = if entry.message.is_empty() {
                "foreign"
            } else {
                &entry.message
            };
            format!("{} {name}: {}", entry.id, entry.frames)
        })
        .collect();
    if !others.is_empty() {
        writeln!(t, "  other frames: {}", others.join(", "))?;
    }
    Ok(())
}

fn write_tasks(t: &mut String, s: &Summary) -> core::fmt::Result {
    if !s.tasks.is_empty() {
        writeln!(t, "\nLongest observed times of tasks")?;
        writeln!(
            t,
            "  {:<11} {:<20} {:>9} {:>10} {:>12}",
            "node", "task", "runs", "cycles", "time"
        )?;
    }
    for task in &s.tasks {
        writeln!(
            t,
            "  {:<11} {:<20} {:>9} {:>10} {:>9.2} us{}",
            task.node,
            task.task,
            task.runs,
            task.longest_cycles,
            task.longest_us,
            thesis(&task.node, &task.task)
        )?;
    }
    Ok(())
}

/// The time that the thesis measured on an F446 at 180 MHz (6.2.4.1) for the same work: for the
/// control step alone, and together with formatting the display's text.
fn thesis(node: &str, task: &str) -> &'static str {
    match (node, task) {
        ("controller", "control") => "   (thesis: 8 us)",
        ("controller", "display_tick") => "   (thesis: 400 us)",
        _ => "",
    }
}

/// A number with the thing that it counts.
fn counted(count: u64, one: &str, many: &str) -> String {
    match count {
        1 => format!("1 {one}"),
        count => format!("{count} {many}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_guide_that_nothing_tells_has_no_name() {
        assert_eq!(guided("Rows"), "by Rows");
        assert_eq!(guided(UNKNOWN), "driven");
    }
}
