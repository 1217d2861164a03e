//! What happens when the user or the system ends a command.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

/// Files that an end removes.
static FILES: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
/// What gives the terminal back to the shell.
static RESTORE: Mutex<Option<fn()>> = Mutex::new(None);
/// Whether the command ends by itself when it is asked to.
static ENDS: AtomicBool = AtomicBool::new(false);
/// Whether it has been asked to.
static ASKED: AtomicBool = AtomicBool::new(false);

fn files() -> MutexGuard<'static, Vec<PathBuf>> {
    FILES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes a file if the command is interrupted.
pub(crate) fn remove_when_interrupted(file: &Path) {
    files().push(file.to_owned());
}

/// Takes [`remove_when_interrupted`] back.
pub(crate) fn keep(file: &Path) {
    files().retain(|one| one != file);
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
    for file in files().drain(..) {
        // If this fails, the next run removes it.
        let _ = fs::remove_file(file);
    }
    eprintln!("interrupted");
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
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::iterator::Signals;

    // Without a handler the command still ends, and the next one removes what it has left.
    let Ok(mut signals) = Signals::new([SIGHUP, SIGINT, SIGTERM]) else {
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
