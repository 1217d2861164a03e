//! A log against the schedule, as if its bus were watched in its own time.

use std::{path::Path, time::Duration};

use super::Watch;
use crate::{Failure, Workspace, analyse, cli::Monitor, vehicle};

/// The part of a time without frames in which nodes are judged: all are dead behind it.
const PAUSE: Duration = Duration::from_secs(2);

/// Prints what is known at the end of a log, or after as much of it as the command line says.
///
/// # Errors
///
/// There is no such vehicle, the log cannot be read, or it has no frame (exit code 2).
pub(super) fn run(workspace: &Workspace, options: &Monitor, log: &Path) -> Result<(), Failure> {
    if options.record.is_some() {
        return Err(Failure::Usage(
            "--record: a log has its frames already: it goes with a bus only".into(),
        ));
    }
    let name = options.vehicle.as_deref().unwrap_or(vehicle::DEFAULT);
    let vehicle = vehicle::with(workspace, name, &options.set.iter().cloned().collect())?;
    let mut watch = Watch::new(&vehicle);
    let cycle = watch.cycle();
    let mut last = Duration::ZERO;
    let mut judged = Duration::ZERO;
    analyse::replay(&vehicle, log, &mut |nanos, frame| {
        // Stamps that go back are those of a clock that was set.
        let at = Duration::from_nanos(u64::try_from(nanos).unwrap_or(0)).max(last);
        if options.seconds.is_some_and(|end| at > end) {
            return;
        }
        // Every cycle before the frame: a node that fell silent is told with its time.
        while judged + cycle < at {
            // A pause of the logger has no cycles worth their time.
            judged = (judged + cycle).max(at.saturating_sub(PAUSE));
            watch.judge(judged);
        }
        last = at;
        watch.take(at, frame);
    })?;
    let end = options.seconds.map_or(last, |seconds| seconds.min(last));
    watch.judge(end);
    let picture = watch.picture(end);
    if options.json {
        println!("{}", picture.json());
    } else {
        print!("{}", picture.text());
    }
    Ok(())
}
