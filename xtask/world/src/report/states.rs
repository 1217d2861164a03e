//! The vehicle's states as a table.

use core::fmt::Write;

use super::Run;
use crate::time::seconds;
use crate::vehicle::wrap;

/// `states.csv`: one line for each recorded state, every 10 ms; `None` without a machine. Positions
/// are the true ones of the point on the centre line beside the antenna, not the receiver's
/// measurements.
#[must_use]
pub fn states_csv(run: &Run) -> Option<String> {
    let line = run.scenario.line.as_ref()?;
    let mut text = String::from(
        "time_s,north_m,east_m,heading_deg,steering_angle_deg,speed_m_s,along_m,\
         cross_track_error_m,heading_error_deg,steering_effort,drive_effort,fix\n",
    );
    let direction = line.direction();
    for state in run.states {
        let (along, error) = line.locate(state.north, state.east);
        let heading = state.heading.to_degrees().rem_euclid(360.0);
        let columns = [
            (seconds(state.at), 2),
            (state.north, 4),
            (state.east, 4),
            (heading, 3),
            (state.steering.to_degrees(), 3),
            (state.speed, 4),
            (along, 4),
            (error, 4),
            (wrap(state.heading - direction).to_degrees(), 3),
            (state.steering_effort, 4),
            (state.drive_effort, 4),
        ];
        for (value, digits) in columns {
            let value = super::figures::rounded(value, digits as i32);
            // Writing to a string cannot fail.
            let _ = write!(text, "{value:.digits$},");
        }
        text.push_str(state.fix.name());
        text.push('\n');
    }
    Some(text)
}
