//! `analyse`: reads the log of a CAN bus and reports traffic, timing, guidance and events.

mod drawings;
mod events;
mod figures;
pub(crate) mod guidance;
pub(crate) mod page;
mod parquet;
mod series;
mod source;
mod steering;
mod table;
mod text;
mod timing;
mod traffic;

use std::path::{Path, PathBuf};

use can_bus::{Frame, wire::INTERMISSION_BITS};
use embedded_can::Id;
use vehicle_model::{Overrides, Vehicle};
use world::report::OutputFolder;

use crate::{
    Failure, Workspace,
    cli::Analyse,
    network::{decode::Decoder, length::frame_bits},
    page::chart,
    progress::Display,
    vehicle,
};
use events::Events;
use figures::rounded;
pub use figures::{
    Event, EventKind, FileFigures, ForeignFigures, GuidanceFigures, HistogramFigures, LogFigures,
    MessageFigures, ModeFigures, RemoteFigures, RunFigures, ScheduleFigures, SteeringFigures,
    Summary, UnknownFigures, WindowFigures,
};
use guidance::Guidance;
use source::Survey;
use steering::Steering;
use table::Messages;
pub use text::text;
use timing::Timing;
use traffic::Traffic;

/// Runs the command.
///
/// # Errors
///
/// [`Failure::Usage`] when a log cannot be read or has no known format; [`Failure::Folder`] when the files cannot be written.
pub fn run(workspace: &Workspace, options: &Analyse) -> Result<(), Failure> {
    let vehicle = vehicle::with(workspace, &options.vehicle, &options.changes.overrides())?;
    let interface = options.interface.as_deref();
    let mut display = Display::new();
    let input = Input::survey(&vehicle, &options.logs, interface, &mut display)?;
    if let Some(out) = &options.out {
        keep_logs(out, &options.logs)?;
    }
    let mut folder = match &options.out {
        Some(path) => Some(OutputFolder::create(path)?),
        None => None,
    };
    let mut messages = match &mut folder {
        Some(folder) => Some(Messages::create(
            folder.file("messages.csv")?,
            folder.file("messages.parquet")?,
            &input.decoder,
        )?),
        None => None,
    };
    let found = input.analyse(&vehicle, messages.as_mut(), &mut display)?;
    display.end();
    let summary = &found.summary;
    if let Some(mut folder) = folder {
        if let Some(messages) = messages {
            messages.finish()?;
        }
        let page = page::page(&found);
        folder.replace_older(|name| name.starts_with(PICTURE) && name.ends_with(".svg"));
        for (name, picture) in chart::pictures(&page) {
            folder.write(&format!("{PICTURE}{name}.svg"), picture.as_bytes())?;
        }
        folder.write("analysis.html", page.as_bytes())?;
        folder.write("events.csv", table::events(&summary.events).as_bytes())?;
        table::write_events(folder.file("events.parquet")?, &summary.events)?;
        folder.write("analysis.json", json(summary).as_bytes())?;
        let path = folder.finish()?;
        let files = FILES.join(", ");
        eprintln!(
            "Wrote {files} and a picture of each chart to {}.",
            path.display()
        );
    }
    if options.json {
        print!("{}", json(summary));
    } else {
        print!("{}", text(summary));
    }
    if let Some(hint) = hint(workspace, options, summary) {
        eprintln!("{hint}");
    }
    let ids = summary.unknown.iter().filter(|one| !one.extended);
    let ids: Vec<u32> = ids.map(|one| one.id).collect();
    if let Some(hint) = switched_off(workspace, &vehicle, &ids) {
        eprintln!("{hint}");
    }
    Ok(())
}

/// What can be off in a manifest and has messages of its own.
const PARTS: [&str; 3] = [
    "mission.enabled=true",
    "planner.enabled=true",
    "row_guidance.enabled=true",
];

/// What is said of unknown identifiers that are messages of something that is off in the vehicle.
fn switched_off(workspace: &Workspace, vehicle: &Vehicle, unknown: &[u32]) -> Option<String> {
    let knows = |part: &&str| {
        let on = Overrides::parse(part).ok()?;
        let set = vehicle.overrides().clone().and(on);
        let on = vehicle::with(workspace, vehicle.name(), &set).ok()?;
        let mut ids = unknown.iter().filter_map(|id| u16::try_from(*id).ok());
        ids.find(|id| on.network().message(*id).is_some())
    };
    let found = PARTS.iter().filter(|part| knows(part).is_some());
    let found: Vec<String> = found.map(|part| format!("--set {part}")).collect();
    (!found.is_empty()).then(|| {
        format!(
            "note: some of the unknown identifiers are messages of what is off in {}: {} knows them",
            vehicle.name(),
            found.join(" or ")
        )
    })
}

/// Share of the frames from which on it is asked whether the vehicle is the right one.
const MOST_FRAMES: f64 = 0.5;

/// Frames that are unknown, have a wrong length or are outside of their windows, as a share of all, and the same
/// with those that have no reference, as under another basic cycle.
fn misfits(summary: &Summary) -> (f64, f64) {
    let unknown: u64 = summary.unknown.iter().map(|one| one.frames).sum();
    let foreign = summary.schedule.iter().flat_map(|all| &all.foreign);
    let outside: u64 = foreign
        .filter(|one| one.message.is_some())
        .map(|one| one.frames)
        .sum();
    let all = summary.log.frames - summary.log.remote_frames;
    let schedule = summary.schedule.as_ref();
    let alone = schedule.map_or(0, |all| all.frames_without_reference);
    let share = |frames: u64| (frames as f64 / all.max(1) as f64).min(1.0);
    let strange = unknown + outside + summary.log.wrong_length;
    (share(strange), share(strange + alone))
}

/// What is said when most frames do not fit: which vehicle of the workspace they fit better.
fn hint(workspace: &Workspace, options: &Analyse, summary: &Summary) -> Option<String> {
    let (strange, own) = misfits(summary);
    if own <= MOST_FRAMES {
        return None;
    }
    let mut names = Vehicle::names(&workspace.vehicles()).unwrap_or_default();
    names.retain(|name| *name != summary.vehicle);
    let fits = names.into_iter().filter_map(|name| {
        let vehicle = vehicle::find(workspace, &name).ok()?;
        // Its messages are those of the other vehicle.
        if vehicle.variant_of().is_some() {
            return None;
        }
        let found = analyse(&vehicle, &options.logs, options.interface.as_deref()).ok()?;
        Some((misfits(&found).1, name))
    });
    let best = fits.min_by(|one, other| one.0.total_cmp(&other.0));
    let better = best.filter(|(misfits, _)| *misfits < MOST_FRAMES * own);
    let advice = match better {
        Some((_, name)) => format!("{name} fits better"),
        None if strange > MOST_FRAMES => "chooses another vehicle".to_owned(),
        // As on a bus without a master.
        None => return None,
    };
    Some(format!(
        "note: most frames are unknown to {} or in none of its windows: --vehicle {advice}",
        summary.vehicle
    ))
}

/// How the names of pictures begin.
const PICTURE: &str = "analysis-";

/// The files of an analysis.
const FILES: [&str; 6] = [
    "analysis.html",
    "messages.csv",
    "messages.parquet",
    "events.csv",
    "events.parquet",
    "analysis.json",
];

/// Refuses a folder in which a file of the analysis would take the place of a log.
fn keep_logs(out: &Path, logs: &[PathBuf]) -> Result<(), Failure> {
    for name in FILES {
        let Ok(file) = out.join(name).canonicalize() else {
            continue;
        };
        let same = |log: &&PathBuf| log.canonicalize().is_ok_and(|log| log == file);
        if let Some(log) = logs.iter().find(same) {
            return Err(Failure::Usage(format!(
                "--out {}: {name} would take the place of the log {}: name another folder",
                out.display(),
                log.display()
            )));
        }
    }
    Ok(())
}

/// Analyses the logs of a vehicle's bus, without output.
///
/// # Errors
///
/// [`Failure::Usage`]: a log cannot be read or has no known format, or there is no frame.
pub fn analyse(
    vehicle: &Vehicle,
    logs: &[PathBuf],
    interface: Option<&str>,
) -> Result<Summary, Failure> {
    let mut display = Display::new();
    let input = Input::survey(vehicle, logs, interface, &mut display)?;
    let found = input.analyse(vehicle, None, &mut display)?;
    display.end();
    Ok(found.summary)
}

/// Hands over the frames of the vehicle's bus in a log, with their times in nanoseconds from the first frame.
///
/// # Errors
///
/// [`Failure::Usage`]: the log cannot be read or has no known format, or there is no frame.
pub(crate) fn replay(
    vehicle: &Vehicle,
    log: &Path,
    each: &mut dyn FnMut(i64, &Frame),
) -> Result<(), Failure> {
    let mut display = Display::new();
    let input = Input::survey(vehicle, &[log.to_owned()], None, &mut display)?;
    input.survey.replay(&mut display, each)?;
    display.end();
    Ok(())
}

fn json(summary: &Summary) -> String {
    let text = serde_json::to_string_pretty(summary).unwrap_or_default();
    format!("{text}\n")
}

/// The logs with the network that they are read with.
struct Input {
    decoder: Decoder,
    survey: Survey,
}

/// Everything that an analysis found.
struct Found {
    summary: Summary,
    guidance: Guidance,
    steering: Option<Steering>,
}

impl Input {
    fn survey(
        vehicle: &Vehicle,
        logs: &[PathBuf],
        interface: Option<&str>,
        display: &mut Display,
    ) -> Result<Self, Failure> {
        let decoder = Decoder::new(vehicle.network());
        let known = |frame: &Frame| match frame.id() {
            Id::Standard(id) => !frame.is_remote() && decoder.message(id.as_raw()).is_some(),
            Id::Extended(_) => false,
        };
        let survey = source::survey(logs, &known, interface, display)?;
        Ok(Self { decoder, survey })
    }

    fn analyse(
        &self,
        vehicle: &Vehicle,
        mut messages: Option<&mut Messages>,
        display: &mut Display,
    ) -> Result<Found, Failure> {
        let mut analysis = Analysis::new(vehicle, &self.decoder, self.survey.tolerance);
        self.survey.replay(display, &mut |at, frame| {
            if let Some((at, id, data)) = analysis.take(at, frame)
                && let Some(messages) = &mut messages
            {
                messages.add(at, id, &data);
            }
        })?;
        analysis.check_time()?;
        Ok(analysis.finish(vehicle, &self.survey))
    }
}

/// Basic cycles without a frame that make a gap.
const GAP_CYCLES: i64 = 2;
/// A longer gap is a pause of the logger: nothing that is missing in it counts, ns.
const PAUSE: i64 = 10_000_000_000;
/// If the time goes back more often than this, and than once in so many frames, the stamps are no times since one
/// instant.
const OFTEN: u64 = 20;
const SELDOM: u64 = 50;

/// The analysis so far.
struct Analysis<'d> {
    decoder: &'d Decoder,
    traffic: Traffic,
    timing: Option<Timing>,
    guidance: Guidance,
    steering: Option<Steering>,
    events: Events,
    /// A longer time without a frame is a gap, ns.
    gap: i64,
    bit_rate: i64,
    /// Bits of all frames with their intermissions.
    bits: u64,
    /// Time of the log without its gaps, ns.
    watched: i64,
    last: Option<i64>,
    end: i64,
    time_goes_back: u64,
    /// What is added to the time stamps, so that time goes on where they go back, ns.
    shift: i64,
}

impl<'d> Analysis<'d> {
    fn new(vehicle: &Vehicle, decoder: &'d Decoder, tolerance: i64) -> Self {
        let mode = vehicle.manifest().mode.as_ref().and_then(|mode| {
            let message = decoder.named(&mode.message)?;
            message.field(&mode.signal)?.table.clone()
        });
        Self {
            decoder,
            traffic: Traffic::new(),
            timing: Timing::new(vehicle, tolerance),
            guidance: Guidance::new(vehicle, decoder),
            steering: Steering::new(vehicle, decoder),
            events: Events::new(mode),
            gap: GAP_CYCLES * i64::from(vehicle.network().basic_cycle_us) * 1000,
            bit_rate: i64::from(vehicle.network().bit_rate.max(1)),
            bits: 0,
            watched: 0,
            last: None,
            end: 0,
            time_goes_back: 0,
            shift: 0,
        }
    }

    /// Takes the next frame; returns time, identifier and data of one that can be decoded.
    fn take(&mut self, stamp: i64, frame: &Frame) -> Option<(i64, u16, [u8; 8])> {
        let bits = frame_bits(frame);
        let length = i64::from(bits) * 1_000_000_000 / self.bit_rate;
        let at = match self.last {
            Some(last) => self.between(last, stamp),
            None => {
                self.watched = length;
                stamp
            }
        };
        let seconds = at as f64 * 1e-9;
        self.last = Some(at);
        self.end = at;
        let start = at - length;
        self.bits += u64::from(bits + INTERMISSION_BITS);
        if let Some(timing) = &mut self.timing
            && !frame.is_remote()
        {
            timing.take(start, frame);
        }
        if !self.traffic.count(self.decoder, at, frame) {
            return None;
        }
        let Id::Standard(id) = frame.id() else {
            return None;
        };
        let id = id.as_raw();
        // Missing bytes read as zero.
        let mut data = [0; 8];
        for (place, byte) in data.iter_mut().zip(frame.data()) {
            *place = *byte;
        }
        self.guidance.take(seconds, id, &data);
        if let Some(steering) = &mut self.steering {
            steering.take(seconds, id, &data);
        }
        if let Some(message) = self.decoder.message(id).filter(|known| known.is_event) {
            self.events.take(seconds, message, &data);
        }
        Some((at, id, data))
    }

    /// Looks at the time between two frames, and returns that of the later one. Where the stamps go back, time
    /// goes on; what happened between the two is not known.
    fn between(&mut self, last: i64, stamp: i64) -> i64 {
        let at = stamp.saturating_add(self.shift);
        let since = at.saturating_sub(last);
        let (from, seconds) = (last as f64 * 1e-9, since as f64 * 1e-9);
        if since < 0 {
            self.time_goes_back += 1;
            self.shift = self.shift.saturating_sub(since);
            self.events.add(from, EventKind::Time, || {
                format!("the next time stamp is {:.6} s earlier", -seconds)
            });
            self.interrupt(last);
            return last;
        }
        if since <= self.gap {
            self.watched += since;
            return at;
        }
        self.events.add(from, EventKind::Gap, || {
            format!("no frame for {seconds:.3} s")
        });
        if since > PAUSE {
            self.interrupt(last);
        } else {
            self.guidance.interrupt(from);
        }
        at
    }

    /// Nothing is known of the bus behind `last`, until the next frame.
    fn interrupt(&mut self, last: i64) {
        self.guidance.interrupt(last as f64 * 1e-9);
        if let Some(timing) = &mut self.timing {
            timing.finish(last);
        }
    }

    /// Refuses stamps that are no times since one instant.
    fn check_time(&self) -> Result<(), Failure> {
        let frames = self.traffic.frames();
        if self.time_goes_back > OFTEN.max(frames / SELDOM) {
            return Err(Failure::Usage(format!(
                "the time goes back {} times in {frames} frames: are the stamps relative, as of candump -t d? Times \
                 since one instant are accepted, as of candump -L",
                self.time_goes_back
            )));
        }
        Ok(())
    }

    /// Share of the time that the frames take, in percent.
    fn load(&self) -> f64 {
        let all = self.watched as f64 * 1e-9;
        let busy = self.bits as f64 / self.bit_rate as f64;
        if all > 0.0 {
            // The intermission of the last frame is not in the time.
            rounded((busy / all * 100.0).min(100.0), 3)
        } else {
            0.0
        }
    }

    /// The figures of the logs.
    fn log(&self, survey: &Survey, messages: &[MessageFigures]) -> LogFigures {
        let frames = self.traffic.frames();
        let all: u64 = survey.interfaces.values().map(|one| one.frames).sum();
        let files = survey.logs.iter().map(|log| FileFigures {
            file: log.path.display().to_string(),
            format: log.format,
            frames: log.frames,
        });
        let interfaces = survey.interfaces.iter();
        let skipped = survey.skipped.iter();
        LogFigures {
            files: files.collect(),
            interface: survey.interface.clone(),
            interfaces: interfaces
                .map(|(name, one)| (name.clone(), one.frames))
                .collect(),
            start_seconds: survey.start.as_ticks() as f64 * 1e-9,
            span_seconds: rounded(self.end as f64 * 1e-9, 6),
            frames,
            load_percent: self.load(),
            frames_of_other_interfaces: all - frames,
            remote_frames: self.traffic.remote(),
            wrong_length: messages.iter().map(|one| one.wrong_length).sum(),
            time_goes_back: self.time_goes_back,
            skipped: skipped.map(|(skip, count)| (skip.name(), *count)).collect(),
        }
    }

    fn finish(mut self, vehicle: &Vehicle, survey: &Survey) -> Found {
        if let Some(timing) = &mut self.timing {
            timing.finish(self.end);
            self.events.irregular(self.decoder, timing.irregularities());
        }
        let modes = self.guidance.modes(self.end as f64 * 1e-9);
        let messages = self.traffic.messages(self.decoder);
        let log = self.log(survey, &messages);
        let (events, events_left_out) = self.events.finish(&modes);
        let summary = Summary {
            vehicle: vehicle.name().to_owned(),
            log,
            messages,
            unknown: self.traffic.unknown(self.decoder),
            remote: self.traffic.asked(self.decoder),
            schedule: self.timing.map(|timing| timing.figures(self.decoder)),
            guidance: self.guidance.figures(&modes),
            steering: self.steering.as_ref().and_then(Steering::figures),
            modes,
            events,
            events_left_out,
        };
        Found {
            summary,
            guidance: self.guidance,
            steering: self.steering,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_of_what_is_off_are_named() {
        let workspace = Workspace::find().unwrap();
        let vehicle = vehicle::find(&workspace, "uagv").unwrap();
        let hint = |ids: &[u32]| switched_off(&workspace, &vehicle, ids);
        assert_eq!(hint(&[1, 0x1234_5678]), None);
        let mission = hint(&[456]).unwrap();
        assert!(
            mission.contains("--set mission.enabled=true knows"),
            "{mission}"
        );
        let planner = hint(&[1, 310]).unwrap();
        assert!(
            planner.contains("--set planner.enabled=true knows"),
            "{planner}"
        );
    }
}
