//! A run of the image on the emulated part: what it takes and how often it comes, held against the analysis.
//!
//! The emulated part has core, flash, clocks and the peripherals of the Furrow boards, and nothing is connected to
//! it but a clock. So most interrupts of an application never come by themselves: a task that was not
//! released in the first half of the run is pended in the second, as often as its row allows.

use std::sync::Arc;

use can_bus::{SimDuration, SimTime};
use observer::follower::{Findings, lock};
use schedulability::arrivals::Sporadic;
use schedulability::execution::Execution;
use schedulability::node::{Entered, Observed};
use schedulability::table::{ONCE, TaskTable};
use schedulability::units::{MICROSECOND, time};
use twin::mcu::{Board, FlashTiming, Mcu};
use twin::part::Part;
use wcet::cycles::Model as Timing;
use wcet::graph::is_panic;
use wcet::image::{FIRST_INTERRUPT, HARD_FAULT, Image};

use crate::error::Error;
use crate::model::Model;
use crate::parts::Emulated;

impl Emulated {
    const fn part(self) -> &'static Part {
        match self {
            Self::Stm32f446 => Part::F446,
            Self::Stm32f303 => Part::F303,
        }
    }
}

/// The longest run.
pub const LONGEST_S: u64 = 3600;

/// Which run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Run {
    /// The part.
    pub on: Emulated,
    /// Its length, in seconds.
    pub seconds: u64,
    /// The clock at the part's input, in Hz, if there is one.
    pub external_hz: Option<u32>,
    /// Clock of the core that the task table says, in Hz.
    pub core_hz: u32,
}

/// What a run showed.
#[derive(Debug, Clone, PartialEq)]
pub struct Shown {
    /// Of each handler.
    pub observed: Observed,
    /// What the run was, for the report.
    pub sentence: String,
}

/// Picoseconds in a second.
const SECOND: u64 = 1_000_000_000_000;

/// Runs the image in `elf`, which is `image`, and holds the run against the analysis. `progress` is told the
/// second that has been reached.
///
/// # Errors
/// The image does not fit the emulated part, sets another clock than the task table says, ends in a fault or a
/// panic, or does what the analysis takes for impossible.
pub fn run(
    run: &Run,
    elf: &[u8],
    image: &Image,
    model: &Model,
    execution: &Execution,
    progress: &dyn Fn(u64),
) -> Result<Shown, Error> {
    let mut mcu = powered(run, elf)?;
    let watches = execution.handlers.values();
    let watches = watches.filter_map(|handler| handler.watch.as_ref());
    observer::slow_down(
        &mut mcu,
        wcet::timing::Timing::flashed(&model.table.board.part),
    );
    let findings = observer::follow(&mut mcu, watches, execution.known.clone(), 0);
    mcu.let_unmodelled_change();
    let end = run.seconds * SECOND;
    go_on(&mut mcu, end / 2, &mut [], progress);
    fails_to_run(&mcu, image)?;
    let mut waiting = waiting(&mcu, model);
    go_on(&mut mcu, end, &mut waiting, progress);
    fails_to_run(&mcu, image)?;
    let findings = lock(&findings);
    if findings.handlers.is_empty() {
        return Err(Error::input(format!(
            "in {} s on the emulated {} no task ran: at the end the program is at {}",
            run.seconds,
            mcu.part().title,
            image.describe(mcu.pc())
        )));
    }
    if mcu.core_hz() != u64::from(run.core_hz) {
        return Err(Error::input(format!(
            "the program sets the core to {} Hz, and the task table says `core_hz` = {}: correct the table, or say \
             by --external-hz which clock is at the part's input",
            mcu.core_hz(),
            run.core_hz
        )));
    }
    if let Some(stray) = findings.stray.first() {
        return Err(Error::Missed(format!(
            "the run is not as analysed: {}",
            stray.sentence(image)
        )));
    }
    if let Some(sentence) = unfinished(&findings, &mcu, model, end) {
        return Err(Error::Missed(format!(
            "the run is not as analysed: {sentence}"
        )));
    }
    let mut observed = Observed::default();
    for task in &mcu.load().tasks {
        let found = findings.handlers.get(&task.exception);
        let is_refuted = found.is_some_and(|found| !found.refuted.is_empty());
        let image = is_refuted.then_some(image);
        let entered = |runs: &[Vec<u64>]| -> Vec<Entered> {
            let runs = runs.iter().filter(|run| !run.is_empty());
            runs.map(|at| Entered {
                scenario: "the emulated run".to_owned(),
                at: at.clone(),
            })
            .collect()
        };
        observer::note(&mut observed, task, found, Timing::Flashed, image, &entered);
    }
    Ok(Shown {
        observed,
        sentence: sentence(run, &mcu, &waiting),
    })
}

/// What to say of a job that began longer than its deadline before the `end` of the run, and has not ended: no time
/// is known of it.
fn unfinished(findings: &Findings, mcu: &Mcu, model: &Model, end: u64) -> Option<String> {
    findings.handlers.iter().find_map(|(exception, found)| {
        let entered: usize = found.entered.iter().map(Vec::len).sum();
        let began = *found.entered.last()?.last()?;
        let (_, interrupt) = mcu.image().handler(*exception)?;
        let tasks = model.node.tasks.iter();
        let task = tasks
            .filter(|task| task.interrupt == interrupt)
            .max_by_key(|task| task.deadline)?;
        let lasts = entered as u64 > found.activations && end - began > task.deadline;
        lasts.then(|| {
            format!(
                "a job of {} that began {} after power-on did not end within its deadline of {}, nor in the run",
                task.name,
                time(began),
                time(task.deadline)
            )
        })
    })
}

/// The part with the image, before its first instruction.
fn powered(run: &Run, elf: &[u8]) -> Result<Mcu, Error> {
    let part = run.on.part();
    let image = twin::image::Image::from_elf(part, elf).map_err(|error| {
        Error::input(format!(
            "the image does not run on the emulated part: {error}"
        ))
    })?;
    let word: Option<[u8; 4]> = image.flash().get(..4).and_then(|word| word.try_into().ok());
    let stack = word.map_or(0, u32::from_le_bytes);
    let has = |base: u32, size: u32| base < stack && stack - base <= size;
    if !part.ram.iter().any(|ram| has(ram.base, ram.size)) {
        return Err(Error::input(format!(
            "the image does not run on the emulated {}: its stack begins at {stack:#010x}, where that has no RAM",
            part.title
        )));
    }
    let board = Board {
        external_clock: run.external_hz,
        flash: FlashTiming::EmptyCaches,
        ..Board::default()
    };
    Ok(Mcu::new(Arc::new(image), &board, None))
}

/// A task that the run pends.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Waiting {
    task: String,
    exception: u16,
    period: u64,
    next: u64,
}

/// The tasks that have not run so far, and that their rows release by something else than another task.
fn waiting(mcu: &Mcu, model: &Model) -> Vec<Waiting> {
    let load = mcu.load();
    let exception = |interrupt: &str| {
        let mut all = FIRST_INTERRUPT..u16::from(u8::MAX);
        all.find(|number| {
            let handler = mcu.image().handler(*number);
            handler.is_some_and(|(_, name)| name == interrupt)
        })
    };
    let tasks = model.node.tasks.iter().filter(|task| !task.dispatched);
    let quiet = tasks.filter(|task| {
        let mut ran = load.tasks.iter();
        !ran.any(|ran| ran.name == task.interrupt && ran.activations > 0)
    });
    let now = mcu.now().as_ticks();
    let pended = quiet.filter_map(|task| {
        let period = period(model.table.task.get(&task.name)?)?;
        Some(Waiting {
            task: task.name.clone(),
            exception: exception(&task.interrupt)?,
            period,
            next: now + period,
        })
    });
    pended.collect()
}

/// The shortest period in which a row allows releases for ever, in picoseconds.
fn period(row: &TaskTable) -> Option<u64> {
    let every = row.every_us.as_slice().iter();
    let every = every.map(|us| us * MICROSECOND);
    let derived = row.derived.iter().map(sustained);
    let shortest = every.chain(derived).filter(|period| *period < ONCE).min()?;
    let apart = row.apart_us.map_or(0, |us| us * MICROSECOND);
    Some(shortest.max(apart).max(1))
}

/// The period in which a cause may release a task for ever.
fn sustained(cause: &Sporadic) -> u64 {
    let limited = cause.limit.map(|(jobs, every)| every.div_ceil(jobs.max(1)));
    cause.period.max(limited.unwrap_or(0))
}

/// Runs until `end`, and pends the tasks meanwhile.
fn go_on(mcu: &mut Mcu, end: u64, waiting: &mut [Waiting], progress: &dyn Fn(u64)) {
    loop {
        let now = mcu.now().as_ticks();
        if now >= end || mcu.is_locked_up() {
            return;
        }
        progress(now / SECOND);
        let next = waiting.iter().map(|one| one.next).min();
        let stop = (now + SECOND / 10)
            .min(next.unwrap_or(u64::MAX))
            .min(end)
            .max(now + 1);
        let stop = SimTime::from_ticks(stop);
        mcu.run_for(
            stop.checked_duration_since(mcu.now())
                .unwrap_or(SimDuration::from_ticks(1)),
        );
        let now = mcu.now().as_ticks();
        for one in waiting.iter_mut().filter(|one| one.next <= now) {
            mcu.pend(one.exception);
            // Counted from what was late, so that two are never closer than the row allows.
            one.next = now + one.period;
        }
    }
}

/// Why what runs is the program's own tasks no more, if it is so.
fn fails_to_run(mcu: &Mcu, image: &Image) -> Result<(), Error> {
    let place = image.describe(mcu.pc());
    let what = if mcu.is_locked_up() {
        "the core has locked up"
    } else if mcu.exception() == HARD_FAULT {
        "the program has ended in a hard fault"
    } else if is_panic(&image.name(mcu.pc())) {
        "the program has ended in a panic"
    } else {
        return Ok(());
    };
    let faults = match mcu.bus_faults() {
        (0, _) => String::new(),
        (_, at) => format!(", after an access to {at:#010x}, where the emulated part has nothing"),
    };
    let lacks = match mcu.unmodelled().as_slice() {
        [] => String::new(),
        all => {
            let all: Vec<String> = all.iter().take(4).map(|at| format!("{at:#010x}")).collect();
            format!(
                "; it has used registers without a model, as {}",
                all.join(", ")
            )
        }
    };
    Err(Error::input(format!(
        "the run shows nothing: {what} at {place}{faults}{lacks}"
    )))
}

/// What the run was.
fn sentence(run: &Run, mcu: &Mcu, pended: &[Waiting]) -> String {
    let mut said = format!(
        "The image was run for {} s on an emulated {}, with its flash as the program sets it and nothing connected",
        run.seconds,
        mcu.part().title
    );
    if let Some(hertz) = run.external_hz {
        said += &format!(" but a clock of {hertz} Hz");
    }
    said.push('.');
    let unmodelled = mcu.unmodelled().len();
    if unmodelled > 0 {
        said += &format!(
            " It used {unmodelled} registers without a model, which read as zeros and as ones in turn."
        );
    }
    if !pended.is_empty() {
        let names: Vec<&str> = pended.iter().map(|one| one.task.as_str()).collect();
        said += &format!(
            " These tasks were not released in its first half, and pended in the second as often as their rows \
             allow for ever: {}.",
            names.join(", ")
        );
    }
    said + " It holds times, releases and paths against the analysis, and shows no worst case."
}
