//! `schedule`: shows and checks the system matrix of a network file, or finds a new one and
//! writes it to the file.

mod plan;
mod table;

use std::path::Path;

use network_model::{Assignment, Network};
use schedulability::{bus::Reactions, results::MessageReport, table::BusTable};
use std::collections::BTreeSet;
use vehicle_model::NetworkText;

use crate::{Failure, Workspace, cli::Schedule, file, vehicle};

/// A schedule to be shown, and perhaps written.
struct Scheduled {
    network: Network,
    /// The file's text with this schedule.
    text: String,
    /// Changes of periods by a new schedule; empty for the schedule of the file.
    notes: Vec<plan::Note>,
}

/// Runs the command.
///
/// # Errors
///
/// [`Failure::Usage`]: there is no such vehicle; the file cannot be read or written, something
/// in it is wrong, or its messages have no schedule.
pub fn run(workspace: &Workspace, options: &Schedule) -> Result<(), Failure> {
    let NetworkText {
        file,
        supplements,
        text,
    } = input(workspace, options)?;
    let path = file.as_path();
    let with: Vec<String> = supplements
        .iter()
        .map(|one| one.display().to_string())
        .collect();
    let with = with.join(" and ");
    let scheduled = schedule(&text, options).map_err(|what| match with.as_str() {
        "" => wrong(path, &what),
        with => wrong(path, &format!("with {with}: {what}")),
    })?;
    if options.write && !with.is_empty() {
        return Err(Failure::Usage(format!(
            "--write writes into one file, and these windows are those of {} and of {}: they must be \
             copied by hand, into each",
            path.display(),
            with
        )));
    }
    let changed = options.write && scheduled.text != text;
    // Written before anything is printed: whoever reads the output may stop reading.
    if changed {
        file::replace(path, &scheduled.text)?;
    }
    if options.json {
        println!("{}", table::json(&scheduled.network, &scheduled.notes));
    } else {
        print!("{}", table::text(&scheduled.network, &scheduled.notes));
    }
    if changed {
        eprintln!(
            "The schedule was written to {}. {}",
            path.display(),
            verdict(&scheduled.network)
        );
    } else if options.write {
        eprintln!("{} has this schedule; it was not written.", path.display());
    }
    Ok(())
}

/// The network file that is meant.
fn input(workspace: &Workspace, options: &Schedule) -> Result<NetworkText, Failure> {
    if let Some(path) = &options.file {
        return Ok(NetworkText {
            file: path.clone(),
            supplements: Vec::new(),
            text: file::read(path)?,
        });
    }
    let set = options.set.iter().cloned().collect();
    // Its messages may have no windows yet, and then the folder cannot be read.
    if options.method.is_none() {
        vehicle::with(workspace, &options.vehicle, &set)?;
    }
    Ok(vehicle::network_text(workspace, &options.vehicle, &set)?)
}

/// What to do next with a new schedule: the search gives each frame room, but only the analysis
/// knows how long messages in a common arbitrating window and the tasks take.
fn verdict(network: &Network) -> String {
    match first_miss(network) {
        None => "`cargo xtask schedulability` shows whether every deadline holds with it.".into(),
        Some(miss) => format!(
            "`cargo xtask schedulability` will refuse it: {miss}. A longer arbitrating window \
             (--arbitrating) helps."
        ),
    }
}

/// The first message that needs more time than it has, disturbed frames at the usual rate included.
fn first_miss(network: &Network) -> Option<String> {
    let errors = BusTable::default().errors();
    let (supervised, at_once) = (BTreeSet::new(), Reactions::new());
    let messages = schedulability::bus::messages(network, errors, &supervised, &at_once);
    messages.iter().find_map(MessageReport::miss)
}

/// The largest share of time for arbitrating windows that is tried unasked, in thousandths.
const LARGEST_SHARE: u16 = 512;

fn wrong(path: &Path, what: &str) -> Failure {
    Failure::Usage(format!("{}: {}", path.display(), what.replace('\n', "; ")))
}

/// The schedule that the options request, and the file's text with it.
fn schedule(text: &str, options: &Schedule) -> Result<Scheduled, String> {
    let scheduled = match options.method {
        None => Scheduled {
            network: own(text)?,
            text: text.to_owned(),
            notes: Vec::new(),
        },
        Some(method) => {
            let network = Network::parse_unscheduled(text).map_err(|error| error.to_string())?;
            let share = Network::parse(text).map_or(0, |network| plan::arbitrating_share(&network));
            let find = |share| -> Result<Scheduled, String> {
                let planned = plan::find(&network, method, options, share)?;
                let text = planned.assignment.write(text);
                let network = reread(&text, &planned.assignment)?;
                Ok(Scheduled {
                    network,
                    text,
                    notes: planned.notes,
                })
            };
            with_room(share, options.arbitrating.is_some(), find)?
        }
    };
    // The images are built with `ttcan`, so its own check must accept the schedule.
    plan::check(&scheduled.network)?;
    Ok(scheduled)
}

/// The schedule with the first share of time for arbitrating windows, from `share` thousandths on, in which each
/// event message has the time that it needs. If the share is `given` or none is large enough, the first schedule.
fn with_room(
    share: u16,
    given: bool,
    find: impl Fn(u16) -> Result<Scheduled, String>,
) -> Result<Scheduled, String> {
    let first = find(share)?;
    if given || first_miss(&first.network).is_none() {
        return Ok(first);
    }
    let shares = (0..).map(|doubled| share.max(1) << doubled);
    let larger = shares.skip(1).take_while(|share| *share <= LARGEST_SHARE);
    let mut found = larger.map_while(|share| find(share).ok());
    let enough = found.find(|scheduled| first_miss(&scheduled.network).is_none());
    Ok(enough.unwrap_or(first))
}

/// The network with the schedule that the file already has.
fn own(text: &str) -> Result<Network, String> {
    Network::parse(text).map_err(|problems| {
        let unscheduled = Network::parse_unscheduled(text).is_ok();
        let hint = if unscheduled {
            "; --method power-of-two or --method least-jitter finds other windows"
        } else {
            ""
        };
        format!("{problems}{hint}")
    })
}

/// Reads back a text before it is written: it must hold the planned schedule.
fn reread(text: &str, planned: &Assignment) -> Result<Network, String> {
    let network = Network::parse(text)
        .map_err(|problems| format!("the schedule cannot be written: {problems}"))?;
    let sorted = |assignment: &Assignment| {
        let mut assignment = assignment.clone();
        assignment.messages.sort_by_key(|message| message.id);
        for message in &mut assignment.messages {
            message.windows.sort();
        }
        assignment
    };
    if sorted(&Assignment::of(&network)) == sorted(planned) {
        Ok(network)
    } else {
        Err("the schedule cannot be written: the file would not read back as planned".into())
    }
}

#[cfg(test)]
mod tests;
