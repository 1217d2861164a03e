//! What happens when the user or the system ends a command.

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
        if let Some(signal) = signals.forever().next() {
            world::report::remove_unfinished();
            eprintln!("interrupted");
            std::process::exit(128 + signal);
        }
    });
}

/// Nothing: other systems end the program at once.
#[cfg(not(unix))]
pub fn clean_up_on_signals() {}
