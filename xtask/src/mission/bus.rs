//! `mission upload`, `start`, `pause`, `resume`, `drop`, `state` on a bus, and `mission flash` by a debug probe.

use std::{fs, path::Path};

use firmware::mission::upload::{self, Request};
use parts::{Memory, Sled};
use vehicle_model::{Device, Override, Overrides, Vehicle};

use super::{
    Drivable, read_plan,
    request::{Client, Error, State, Told},
    settings,
};
use crate::{
    Failure, Workspace,
    cli::{FlashMission, OnMissionBus, UploadMission},
    probe,
    progress::Display,
    selftest::{self, Slcan},
    vehicle,
    workspace::{succeed, typed},
};

/// Bytes of a record that an upload takes: the vehicle keeps it in its RAM, behind the request, while it checks it.
pub(super) const UPLOAD: usize = (upload::WORDS - 1) * 4;

/// The vehicle on a bus, with its missions switched on.
fn of_bus(workspace: &Workspace, options: &OnMissionBus) -> Result<Vehicle, Failure> {
    let on = Override::parse("mission.enabled=true").map_err(Failure::Usage)?;
    let set: Vec<Override> = std::iter::once(on)
        .chain(options.set.iter().cloned())
        .collect();
    let name = options.vehicle.as_deref().unwrap_or(vehicle::DEFAULT);
    // Before a value is set that the vehicle does not know.
    settings(&vehicle::find(workspace, name)?).map_err(Failure::Usage)?;
    Ok(selftest::of_bus(workspace, Some(name), &options.bus, &set)?)
}

/// The record of a mission file, which the vehicle can drive.
fn record(vehicle: &Vehicle, path: &Path) -> Result<Vec<u8>, Failure> {
    let usage = |why: String| Failure::Usage(format!("{}: {why}", path.display()));
    let drivable = Drivable::of(&read_plan(path)?).map_err(usage)?;
    drivable
        .check(&settings(vehicle).map_err(Failure::Usage)?)
        .map_err(usage)?;
    drivable.record().map_err(usage)
}

/// Talks to the vehicle on a bus.
fn talk<R>(
    workspace: &Workspace,
    vehicle: &Vehicle,
    options: &OnMissionBus,
    act: impl FnOnce(&mut Client<'_>) -> Result<R, Error>,
) -> Result<R, Failure> {
    let bit_rate = vehicle.network().bit_rate;
    let mut transport = selftest::open(workspace, vehicle, &options.bus, bit_rate, Slcan::open)?;
    let mut display = Display::new();
    let mut tell = |told| match told {
        Told::Sends(sent, all) => display.show(|_| format!("sent {sent} of {all} bytes")),
        Told::Checks(piece) => {
            display.show(|_| format!("the vehicle checks piece {}", piece + 1));
        }
        Told::Writes => {
            display.end();
            eprintln!("The vehicle writes its flash and starts anew.");
        }
        Told::Again => {
            display.end();
            eprintln!("A frame was lost; once more.");
        }
    };
    let mut client = Client::new(vehicle, transport.as_mut(), &mut tell).map_err(Failure::from)?;
    let done = act(&mut client);
    display.end();
    Ok(done?)
}

/// `mission upload`.
pub(super) fn upload_file(workspace: &Workspace, options: &UploadMission) -> Result<(), Failure> {
    let vehicle = of_bus(workspace, &options.on)?;
    let record = record(&vehicle, &options.file)?;
    let file = options.file.display();
    if record.len() > UPLOAD {
        return Err(Failure::Usage(format!(
            "{file}: its record has {} bytes, and an upload takes up to {UPLOAD}: divide the mission, or write it by a debug \
             probe (mission flash)",
            record.len()
        )));
    }
    if options.check {
        talk(workspace, &vehicle, &options.on, |client| {
            client.check(&record)
        })?;
        println!("{file}: the vehicle can drive it, and has not kept it");
    } else {
        let number = talk(workspace, &vehicle, &options.on, |client| {
            client.upload(&record)
        })?;
        println!("{file}: mission {number} of the vehicle; its next run drives it");
    }
    Ok(())
}

/// The others: a request without a record.
pub(super) fn ask(
    workspace: &Workspace,
    options: &OnMissionBus,
    request: Request,
) -> Result<(), Failure> {
    let vehicle = of_bus(workspace, options)?;
    if request == Request::Drop {
        talk(workspace, &vehicle, options, |client| client.forget())?;
        println!("the vehicle has no mission any more, and drives the line of its waypoints");
        return Ok(());
    }
    let (answer, state) = talk(workspace, &vehicle, options, |client| {
        let answer = client.request(request)?;
        Ok((answer, client.state().cloned()))
    })?;
    match request {
        Request::Start => println!("the next run begins with the first leg"),
        Request::Pause => println!("the vehicle stops on its path"),
        Request::Resume => println!("the vehicle drives on"),
        _ => {
            let of = match answer.number {
                0 => "mission".to_owned(),
                number => format!("mission {number}"),
            };
            let refused = match answer.refusal.reason.map(|reason| reason.code()) {
                Some(0) => String::new(),
                _ => format!(": {}", answer.refusal.sentence()),
            };
            match state {
                Some(State {
                    state,
                    legs: (leg, legs),
                    along,
                }) => println!(
                    "{of}: {state}{refused}; piece {} of {legs}, {along:.1} m along it",
                    leg + 1
                ),
                None => println!("{of}: there is no message MissionState{refused}"),
            }
        }
    }
    Ok(())
}

/// `mission flash`.
pub(super) fn flash(workspace: &Workspace, options: &FlashMission) -> Result<(), Failure> {
    let on = Overrides::parse("mission.enabled=true").map_err(Failure::Usage)?;
    settings(&vehicle::find(workspace, &options.vehicle)?).map_err(Failure::Usage)?;
    let vehicle = vehicle::with(workspace, &options.vehicle, &on)?;
    let record = record(&vehicle, &options.file)?;
    let none = || {
        Failure::Usage(format!(
            "vehicle {:?} has no board with room for missions",
            vehicle.name()
        ))
    };
    let node = vehicle.node_of(Device::OperatorSwitches).ok_or_else(none)?;
    let sled = vehicle::board(&vehicle, node);
    let place = sled.mission.as_ref().ok_or_else(none)?;
    let found = probe::find(
        workspace,
        &vehicle.node(node).name,
        options.probe.as_deref(),
    );
    let probe = match found {
        Err(_) if options.dry_run => options.probe.clone(),
        found => found?,
    };
    if options.dry_run {
        for command in commands(
            workspace,
            sled,
            place,
            probe.as_deref(),
            Path::new("RECORD"),
        ) {
            println!("{}", typed(&command));
        }
        return Ok(());
    }
    let folder = tempfile::tempdir().map_err(|error| {
        Failure::Usage(format!("there is no folder for temporary files: {error}"))
    })?;
    let path = folder.path().join("record");
    fs::write(&path, contents(place, &record))
        .map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))?;
    for mut command in commands(workspace, sled, place, probe.as_deref(), &path) {
        succeed(&mut command, "probe-rs")?;
    }
    Ok(())
}

/// What is written: the record in the first place, and nothing in the second one, whose mission might count more.
fn contents(place: &Memory, record: &[u8]) -> Vec<u8> {
    let mut bytes = record.to_vec();
    bytes.resize(place.size as usize, 0xFF);
    bytes
}

/// The commands that write the place for missions, and start the node again.
fn commands(
    workspace: &Workspace,
    sled: &Sled,
    place: &Memory,
    probe: Option<&str>,
    file: &Path,
) -> [std::process::Command; 2] {
    let base = format!("{:#010x}", place.base);
    let options = [
        "--binary-format",
        "bin",
        "--base-address",
        &base,
        "--verify",
    ];
    let mut download = probe::command(workspace, "download", sled, probe, &options);
    download.arg(file);
    [
        download,
        probe::command(workspace, "reset", sled, probe, &[]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli;

    /// It is known before anything is sent.
    #[test]
    fn a_mission_that_is_too_long_is_not_uploaded() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("long.toml");
        let legs: String = (0..800)
            .map(|leg| {
                let (from, to) = (f64::from(leg) * 2.0, f64::from(leg) * 2.0 + 2.0);
                format!("[[leg]]\nfrom = [{from}, 0]\nto = [{to}, 0]\nspeed = \"1 m/s\"\njoin = \"continue\"\n")
            })
            .collect();
        let head = "name = \"long\"\n[origin]\nlatitude = \"40 deg\"\nlongitude = \"-96 deg\"\n";
        fs::write(&file, format!("{head}{legs}")).unwrap();
        let words = [
            "xtask",
            "mission",
            "upload",
            file.to_str().unwrap(),
            "--bus",
            "slcan:/nowhere",
        ];
        let parsed = cli::parse(words.map(std::ffi::OsString::from));
        let Ok(cli::Request::Run(cli::Command::Mission(command))) = parsed else {
            panic!("the command line is not read");
        };
        let refused = crate::mission::run(&Workspace::find().unwrap(), &command).unwrap_err();
        let said = refused.to_string();
        assert!(
            said.contains("bytes, and an upload takes up to 20476"),
            "{said}"
        );
    }

    #[test]
    fn the_record_goes_into_the_first_place_and_the_second_is_erased() {
        let workspace = Workspace::find().unwrap();
        let place = Sled::F446.mission.as_ref().unwrap();
        let [download, _] = commands(
            &workspace,
            Sled::F446,
            place,
            Some("066E"),
            Path::new("t/r"),
        );
        assert_eq!(
            typed(&download),
            "probe-rs download --chip STM32F446RETx --probe 066E --binary-format bin --base-address 0x08020000 \
             --verify t/r"
        );
        let bytes = contents(place, &[1, 2]);
        assert_eq!((bytes.len(), &bytes[..3]), (0x4_0000, &[1, 2, 0xFF][..]));
        assert!(bytes[2..].iter().all(|byte| *byte == 0xFF));
    }
}
