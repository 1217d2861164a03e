//! The vehicle and the scenario of a run: what `--set`, `--law`, `--gain-scale` and the scenario itself
//! put in place of the manifest's values.

use vehicle_model::{
    Overrides, Vehicle,
    manifest::{Law, Manifest},
};
use world::Scenario;

use super::{Error, first_scenario};
use crate::{Failure, Workspace, cli::Sim, vehicle};

/// The vehicle and the scenario that the command line names. Values of the command line count before
/// those that the scenario sets.
///
/// # Errors
///
/// There is no such vehicle or scenario, its file is wrong, a value is not accepted, or the vehicle has
/// no law to choose.
pub(super) fn choose(workspace: &Workspace, options: &Sim) -> Result<(Vehicle, Scenario), Failure> {
    let own = options.changes.overrides();
    let named = vehicle::with(workspace, &options.vehicle, &own)?;
    let name = match &options.scenario {
        Some(name) => name.clone(),
        None => first_scenario(&named)?,
    };
    let scenario = Scenario::find(&named, &name).map_err(Error::from)?;
    let set = scenario.set.clone().and(own);
    let mut vehicle = vehicle::with(workspace, &options.vehicle, &set)?;
    let law = law(&vehicle, options)?;
    if set != *named.overrides() || !law.is_empty() {
        vehicle = vehicle::with(workspace, &options.vehicle, &set.and(law))?;
    }
    let scenario = Scenario::find(&vehicle, &name).map_err(Error::from)?;
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
    let of = |set: &Overrides| vehicle::with(workspace, vehicle.name(), set);
    let law = Overrides::parse(&law_key(vehicle.manifest(), law)).map_err(Failure::Usage)?;
    let found = Scenario::find(vehicle, scenario).map_err(Error::from)?;
    let set = found.set.and(vehicle.overrides().clone()).and(law);
    let vehicle = of(&set)?;
    let scenario = Scenario::find(&vehicle, scenario).map_err(Error::from)?;
    Ok((vehicle, scenario))
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
        set.push(law_key(manifest, law));
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
