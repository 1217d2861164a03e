//! What happens when the user or the system ends a command.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

/// Links that an end removes, each with what it leads to.
static LINKS: Mutex<Vec<(PathBuf, PathBuf)>> = Mutex::new(Vec::new());
/// Programs that this one waits for, and ends with it. Otherwise they would complain that nobody reads what they
/// say.
static PROGRAMS: Mutex<Vec<u32>> = Mutex::new(Vec::new());
/// What is said of work that is kept.
static KEPT: Mutex<Option<String>> = Mutex::new(None);
/// What gives the terminal back to the shell.
static RESTORE: Mutex<Option<fn()>> = Mutex::new(None);
/// Whether the command ends by itself when it is asked to.
static ENDS: AtomicBool = AtomicBool::new(false);
/// Whether it has been asked to.
static ASKED: AtomicBool = AtomicBool::new(false);

fn links() -> MutexGuard<'static, Vec<(PathBuf, PathBuf)>> {
    LINKS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes a link to `target` if the command is interrupted.
pub(crate) fn remove_when_interrupted(link: &Path, target: &Path) {
    links().push((link.to_owned(), target.to_owned()));
}

/// Removes such a link now.
pub(crate) fn remove_link(link: &Path) {
    let mut links = links();
    for (link, target) in links.extract_if(.., |(one, _)| one == link) {
        remove_own(&link, &target);
    }
}

/// Removes a link, unless somebody has put something else in its place.
fn remove_own(link: &Path, target: &Path) {
    if fs::read_link(link).is_ok_and(|leads| leads == target) {
        // A link that stays leads nowhere, and the next run replaces it.
        let _ = fs::remove_file(link);
    }
}

/// Ends a program, by its number, if the command is interrupted.
pub(crate) fn end_together(program: u32) {
    PROGRAMS
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .push(program);
}

/// Takes [`end_together`] back.
pub(crate) fn end_alone(program: u32) {
    PROGRAMS
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .retain(|one| *one != program);
}

#[cfg(unix)]
fn end_program(program: u32) {
    use rustix::process::{Pid, Signal, kill_process};
    let pid = i32::try_from(program).ok().and_then(Pid::from_raw);
    if let Some(pid) = pid {
        // It may have ended by itself.
        let _ = kill_process(pid, Signal::TERM);
    }
}

#[cfg(not(unix))]
fn end_program(_: u32) {}

/// Sets what an interrupted command says of the work that is kept; `None` if there is none.
pub(crate) fn say_when_interrupted(kept: Option<String>) {
    *KEPT.lock().unwrap_or_else(PoisonError::into_inner) = kept;
}

/// Sets the function that gives the terminal back before an interrupted command ends; `None` removes it.
pub(crate) fn restore_when_interrupted(restore: Option<fn()>) {
    *RESTORE.lock().unwrap_or_else(PoisonError::into_inner) = restore;
}

/// Ends the command as Ctrl-C does, where the terminal hands that over as a key.
pub(crate) fn end() -> ! {
    // SIGINT has this number on every system.
    end_by(2)
}

/// Leaves no unfinished folder behind and ends, with the exit code that a shell gives for the signal.
fn end_by(signal: i32) -> ! {
    let restore = RESTORE
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .take();
    if let Some(restore) = restore {
        restore();
    }
    world::report::remove_unfinished();
    for (link, target) in links().drain(..) {
        remove_own(&link, &target);
    }
    let mut programs = PROGRAMS.lock().unwrap_or_else(PoisonError::into_inner);
    for program in programs.drain(..) {
        end_program(program);
    }
    match KEPT.lock().unwrap_or_else(PoisonError::into_inner).take() {
        Some(kept) => eprintln!("interrupted; {kept}"),
        None => eprintln!("interrupted"),
    }
    std::process::exit(128 + signal)
}

/// From now on the first Ctrl-C, or request of the system to end, makes [`asked`] true, and the command
/// ends by itself.
pub(crate) fn end_by_itself() {
    ENDS.store(true, Ordering::Relaxed);
}

/// Whether the command has been asked to end.
pub(crate) fn asked() -> bool {
    ASKED.load(Ordering::Relaxed)
}

/// From now on an end by Ctrl-C, or by a request of the system, leaves no unfinished folder behind. The
/// exit code is that of a shell: 128 and the number of the signal.
#[cfg(unix)]
pub fn clean_up_on_signals() {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGUSR1, SIGUSR2};
    use signal_hook::iterator::Signals;

    // Without a handler the command still ends, and the next one removes what it has left.
    let all = [SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGUSR1, SIGUSR2];
    let Ok(mut signals) = Signals::new(all) else {
        return;
    };
    std::thread::spawn(move || {
        for signal in signals.forever() {
            if ENDS.load(Ordering::Relaxed) && !ASKED.swap(true, Ordering::Relaxed) {
                continue;
            }
            end_by(signal);
        }
    });
}

/// Nothing: other systems end the program at once.
#[cfg(not(unix))]
pub fn clean_up_on_signals() {}
