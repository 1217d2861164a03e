//! The vehicle and the scenario of a run: what `--set`, `--law`, `--gain-scale` and the scenario itself
//! put in place of the manifest's values.

use vehicle_model::{
    Overrides, Vehicle,
    manifest::{Law, Manifest},
};
use world::Scenario;

use super::{Error, first_scenario};
use crate::{Failure, Workspace, cli::Sim, vehicle};

/// The scenario of a mission.
const MISSION: &str = "mission";

/// The vehicle and the scenario that the command line names. Values of the command line count before
/// those that the scenario sets.
///
/// # Errors
///
/// There is no such vehicle or scenario, its file is wrong, a value is not accepted, or the vehicle has
/// no law to choose.
pub(super) fn choose(workspace: &Workspace, options: &Sim) -> Result<(Vehicle, Scenario), Failure> {
    let mut own = options.changes.overrides();
    if options.mission.is_some() {
        // Before a value is set that the vehicle does not know.
        let vehicle = vehicle::find(workspace, &options.vehicle)?;
        crate::mission::settings(&vehicle).map_err(Failure::Usage)?;
        let on = Overrides::parse("mission.enabled=true").map_err(Failure::Usage)?;
        own = on.and(own);
    }
    let name = match &options.scenario {
        Some(name) => name.clone(),
        None if options.mission.is_some() => MISSION.to_owned(),
        None => first_scenario(&vehicle::with(workspace, &options.vehicle, &own)?)?,
    };
    let (vehicle, scenario) = with(workspace, &options.vehicle, &name, &own)?;
    if options.mission.is_some() && vehicle.manifest().missions().is_none() {
        return Err(Failure::Usage(
            "--mission with mission.enabled=false: the vehicle would not drive the mission, so leave one of the two out"
                .into(),
        ));
    }
    let law = law(&vehicle, options)?;
    if law.is_empty() {
        return Ok((vehicle, scenario));
    }
    with(workspace, vehicle.name(), &name, &own.and(law))
}

/// A vehicle with these values in place of its manifest's, and its scenario, whose own values count less.
///
/// # Errors
///
/// There is no such vehicle or scenario, its file is wrong, or a value is not accepted.
pub(crate) fn with(
    workspace: &Workspace,
    vehicle: &str,
    scenario: &str,
    own: &Overrides,
) -> Result<(Vehicle, Scenario), Failure> {
    let named = vehicle::with(workspace, vehicle, own)?;
    let found = Scenario::find(&named, scenario).map_err(Error::from)?;
    if found.set.is_empty() {
        return Ok((named, found));
    }
    let set = found.set.and(own.clone());
    let vehicle = vehicle::with(workspace, vehicle, &set)?;
    let mut scenario = Scenario::find(&vehicle, scenario).map_err(Error::from)?;
    // The vehicle has them now.
    scenario.set = Overrides::default();
    Ok((vehicle, scenario))
}

/// A vehicle's scenario, and the vehicle as it wants it, under a law.
///
/// # Errors
///
/// There is no such scenario, its file is wrong, or a value is not accepted.
pub(crate) fn under(
    workspace: &Workspace,
    vehicle: &Vehicle,
    law: Law,
    scenario: &str,
) -> Result<(Vehicle, Scenario), Failure> {
    let law = Overrides::parse(&law_key(vehicle.manifest(), law)).map_err(Failure::Usage)?;
    let own = vehicle.overrides().clone().and(law);
    with(workspace, vehicle.name(), scenario, &own)
}

/// The value that chooses a law.
fn law_key(manifest: &Manifest, law: Law) -> String {
    let table = if manifest.rover.is_some() {
        "rover"
    } else {
        "machine"
    };
    format!("{table}.law={}", law.name())
}

/// What `--law` and `--gain-scale` put in place of the manifest's values.
fn law(vehicle: &Vehicle, options: &Sim) -> Result<Overrides, Failure> {
    let refuse = |why: &str| Err(Failure::Usage(why.to_owned()));
    if options.law.is_none() && options.gain_scale.is_none() {
        return Ok(Overrides::default());
    }
    let manifest = vehicle.manifest();
    let usual = match (&manifest.machine, &manifest.rover) {
        (Some(machine), _) => machine.law,
        (None, Some(rover)) => rover.law,
        (None, None) => {
            return refuse(&format!(
                "--law and --gain-scale: vehicle {:?} has no law that steers, as it has neither [machine] nor [rover]",
                vehicle.name()
            ));
        }
    };
    let mut set = Vec::new();
    if let Some(law) = options.law {
        let key = law_key(manifest, law);
        let own = Overrides::parse(&key).map_err(Failure::Usage)?;
        if let Some(key) = own.shared_key(&options.changes.overrides()) {
            return refuse(&format!(
                "--law and --set {key} both choose the law: one of them is accepted"
            ));
        }
        set.push(key);
    }
    if let Some(scale) = options.gain_scale {
        if options.law.unwrap_or(usual) != Law::Thesis {
            return refuse(
                "--gain-scale scales the gains of the thesis's law, and this run is under Furrow's: --law thesis \
                 chooses the other one",
            );
        }
        let gains = gains(manifest).into_iter();
        set.extend(gains.map(|(key, gain)| format!("{key}={:?}", gain * scale)));
    }
    Overrides::parse(&set.join(";")).map_err(Failure::Usage)
}

/// The gains of the thesis's law, with their keys.
fn gains(manifest: &Manifest) -> Vec<(&'static str, f64)> {
    if let Some(machine) = &manifest.machine {
        let gains = machine.thesis;
        return vec![
            ("machine.thesis.cross_track", gains.cross_track),
            ("machine.thesis.heading", gains.heading),
            ("machine.thesis.steering_angle", gains.steering_angle),
        ];
    }
    manifest.rover.map_or(Vec::new(), |rover| {
        vec![
            ("rover.thesis.proportional", rover.thesis.proportional),
            ("rover.thesis.integral", rover.thesis.integral),
        ]
    })
}

#[cfg(test)]
mod tests {
    use std::ffi::OsString;

    use super::*;
    use crate::cli;

    /// The overrides of the vehicle that a command line chooses, or what it is told.
    fn chosen(line: &str) -> Result<String, String> {
        let words = ["xtask", "sim"].into_iter().chain(line.split(' '));
        let Ok(cli::Request::Run(cli::Command::Sim(options))) =
            cli::parse(words.map(OsString::from))
        else {
            panic!("not read: {line}");
        };
        let workspace = Workspace::find().unwrap();
        let (vehicle, scenario) = choose(&workspace, &options).map_err(|why| why.to_string())?;
        assert!(scenario.set.is_empty(), "{line}");
        Ok(vehicle.overrides().environment())
    }

    #[test]
    fn the_command_line_counts_before_the_scenario() {
        let gains = "machine.thesis.cross_track=0.273;machine.thesis.heading=1.552;machine.thesis.steering_angle=2.257";
        let scenario = "thesis-machine/one-metre-off";
        assert_eq!(chosen(scenario), Ok(format!("machine.law=thesis;{gains}")));
        assert_eq!(
            chosen(&format!("{scenario} --law furrow")),
            Ok(format!("machine.law=furrow;{gains}"))
        );
        let other = chosen(&format!("{scenario} --set machine.thesis.heading=2")).unwrap();
        assert_eq!(
            other,
            format!("machine.law=thesis;{}", gains.replace("1.552", "2"))
        );
        assert_eq!(chosen("straight-line"), Ok(String::new()));
    }

    #[test]
    fn a_mission_needs_missions() {
        let refused = chosen("--mission field.toml --set mission.enabled=false").unwrap_err();
        assert!(refused.contains("--mission with"), "{refused}");
        let on = chosen("--mission field.toml");
        assert_eq!(on, Ok("mission.enabled=true".into()));
    }

    #[test]
    fn the_law_is_chosen_once() {
        let refused = chosen("straight-line --law furrow --set machine.law=thesis").unwrap_err();
        assert!(refused.contains("--law and --set machine.law"), "{refused}");
    }

    /// What is left may be what the manifest has anyway.
    #[test]
    fn the_command_line_may_take_back_all_that_a_scenario_sets() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("thesis.toml");
        std::fs::write(&file, "set = [\"machine.law=thesis\"]\n").unwrap();
        let file = file.display();
        assert_eq!(chosen(&format!("{file}")), Ok("machine.law=thesis".into()));
        for line in ["--law furrow", "--set machine.law=furrow"] {
            assert!(chosen(&format!("{file} {line}")).is_ok(), "{line}");
        }
    }

    #[test]
    fn gains_are_scaled_whoever_chose_them() {
        assert_eq!(
            chosen("thesis-machine/one-metre-off --gain-scale 0.5"),
            Ok(
                "machine.law=thesis;machine.thesis.cross_track=0.1365;machine.thesis.heading=0.776;\
                machine.thesis.steering_angle=1.1285"
                    .into()
            )
        );
        let rover = chosen("field --vehicle row-follower --law thesis --gain-scale 2").unwrap();
        assert_eq!(
            rover,
            "rover.law=thesis;rover.thesis.integral=0.0;rover.thesis.proportional=0.0036"
        );
        let refused = chosen("straight-line --gain-scale 2").unwrap_err();
        assert!(refused.contains("--law thesis"), "{refused}");
    }
}
