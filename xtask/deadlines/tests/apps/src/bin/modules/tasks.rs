//! The bodies of the tasks.

use rtic::Mutex as _;

use crate::firmware;

/// Looks at the level for ever.
pub(crate) fn idle(mut cx: firmware::idle::Context<'_>) -> ! {
    loop {
        let level = cx.shared.level.lock(|level| *level);
        apps::output(level);
    }
}

/// Reads the converter.
pub(crate) fn convert(mut cx: firmware::convert::Context<'_>) {
    let reading = apps::input();
    cx.shared.level.lock(|level| *level = reading);
    let _ = firmware::handle::spawn(reading);
}

/// Thinks about a reading.
pub(crate) async fn handle(mut cx: firmware::handle::Context<'_>, reading: u32) {
    let samples = [reading; 8];
    let smooth = apps::smoothed(&samples, 2);
    cx.shared.level.lock(|level| *level = smooth);
}
