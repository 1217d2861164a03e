//! `keys`: makes the key of a network, and writes it to the nodes.
//!
//! A key stands in a file of its own that only its owner can read, outside the workspace, so that it
//! gets into no image and no repository. Nothing prints a key: texts show its number.

use std::{
    env, fs,
    io::{self, Read as _, Write as _},
    path::{Path, PathBuf},
};

use campaign::quoted;
use firmware::e2e::Key;
use parts::Sled;
use serde_json::json;

use crate::{
    Failure, Workspace,
    cli::{KeyAction, KeyFile, KeyNode, Keys},
    file::{self, private},
    probe,
    vehicle::{self, DEFAULT},
    workspace::{succeed, typed},
};

/// What a file of a key begins with.
const TITLE: &str = "furrow key ";

/// Name of the key's record in the commands of a dry run, which writes none.
const RECORD: &str = "RECORD";

/// Why a command of `keys` fails.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Nobody says where keys are.
    #[error("there is no home directory for the key: --file FILE names another place")]
    NoHome,
    /// A key in the workspace would get into the repository.
    #[error(
        "{} is in the workspace, where a key would get into the repository: --file FILE with a path \
         outside is accepted",
        path.display()
    )]
    Inside {
        /// The file.
        path: PathBuf,
    },
    /// There is a key already.
    #[error("{} is there already: `cargo xtask keys rotate` replaces a key", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// There is no key.
    #[error("{} is not there: `cargo xtask keys new{options}` makes a key", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The options that name the vehicle and the file.
        options: String,
    },
    /// The file holds something else.
    #[error("{} is no key: \"{TITLE}\" and 32 hexadecimal digits are accepted", path.display())]
    NoKey {
        /// The file.
        path: PathBuf,
    },
    /// Others can read the key.
    #[error("{} can be read by others: `chmod 600` on it is needed", path.display())]
    Open {
        /// The file.
        path: PathBuf,
    },
    /// The nodes have no system time to judge a command by.
    #[error(
        "a key needs a time-triggered bus: the nodes of {vehicle} are event-triggered, and with a key \
         they would obey no command"
    )]
    EventTriggered {
        /// The vehicle.
        vehicle: String,
    },
    /// A file cannot be read or written.
    #[error("{}: {error}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why not.
        #[source]
        error: io::Error,
    },
    /// The system gives no random numbers.
    #[error("the system gives no random numbers for a key: {0}")]
    Random(String),
}

impl Error {
    /// Whether the command line or the file is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        !matches!(self, Self::Random(_))
    }

    fn of(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        |error| Self::File { path, error }
    }
}

/// Runs the command.
///
/// # Errors
///
/// The vehicle, the node or the file is wrong (exit code 2), or probe-rs fails.
pub fn run(workspace: &Workspace, options: &Keys) -> Result<(), Failure> {
    match &options.action {
        KeyAction::New(place) => {
            let path = of_vehicle(workspace, place)?;
            let key = random()?;
            create(&path, &key)?;
            say(place, &path, &Key::new(key), "is made");
            advise(place);
        }
        KeyAction::Rotate(place) => {
            let path = of_vehicle(workspace, place)?;
            read(&path, &place.options())?;
            let key = random()?;
            file::replace(&path, &text(&key))?;
            say(place, &path, &Key::new(key), "replaces the one before");
            advise(place);
        }
        KeyAction::Show(place) => {
            let path = of_vehicle(workspace, place)?;
            say(
                place,
                &path,
                &Key::new(read(&path, &place.options())?),
                "is there",
            );
        }
        KeyAction::Flash(node) => write(workspace, node, true)?,
        KeyAction::Erase(node) => write(workspace, node, false)?,
    }
    Ok(())
}

impl KeyFile {
    /// The options that name its vehicle and its file in another command, with a blank before each.
    fn options(&self) -> String {
        options(&self.vehicle, self.file.as_deref())
    }
}

/// The options that name a key's vehicle and file, with a blank before each.
fn options(vehicle: &str, file: Option<&Path>) -> String {
    let mut options = String::new();
    if vehicle != DEFAULT {
        options += &format!(" --vehicle {}", quoted(vehicle));
    }
    if let Some(file) = file {
        options += &format!(" --file {}", quoted(&file.to_string_lossy()));
    }
    options
}

/// The file of a vehicle's key.
fn of_vehicle(workspace: &Workspace, place: &KeyFile) -> Result<PathBuf, Failure> {
    let vehicle = vehicle::find(workspace, &place.vehicle)?;
    Ok(path(workspace, vehicle.name(), place.file.as_deref())?)
}

/// The file of the key of a vehicle with this name. It need not be there.
fn path(workspace: &Workspace, vehicle: &str, named: Option<&Path>) -> Result<PathBuf, Error> {
    let path = match named {
        Some(path) => env::current_dir().unwrap_or_default().join(path),
        None => {
            let home = env::home_dir().filter(|home| home.is_absolute());
            let folder = home.ok_or(Error::NoHome)?.join(".furrow");
            folder.join(format!("{vehicle}.key"))
        }
    };
    // A folder may be reached through a link.
    let parent = path.parent().unwrap_or(&path);
    let resolved = fs::canonicalize(parent).unwrap_or_else(|_| parent.into());
    let root = fs::canonicalize(workspace.root()).unwrap_or_else(|_| workspace.root().into());
    if resolved.starts_with(root) {
        return Err(Error::Inside { path });
    }
    Ok(path)
}

/// 16 bytes from the system's generator.
fn random() -> Result<[u8; 16], Error> {
    let mut key = [0; 16];
    getrandom::fill(&mut key).map_err(|error| Error::Random(error.to_string()))?;
    Ok(key)
}

fn text(key: &[u8; 16]) -> String {
    let digits: String = key.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("{TITLE}{digits}\n")
}

/// Writes a key into a new file.
fn create(path: &Path, key: &[u8; 16]) -> Result<(), Error> {
    if let Some(folder) = path.parent() {
        private_folder(folder).map_err(Error::of(folder))?;
    }
    let mut file = private(path).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => Error::Exists { path: path.into() },
        _ => Error::of(path)(error),
    })?;
    let written = file
        .write_all(text(key).as_bytes())
        .and_then(|()| file.sync_all());
    written.map_err(|error| {
        // Half a key is none.
        let _ = fs::remove_file(path);
        Error::of(path)(error)
    })
}

/// Makes a folder that only its owner can read, and those above it that are missing. One that is there stays as
/// it is.
fn private_folder(path: &Path) -> io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(path)
}

/// The key in a file. `options` names the file in the command that makes a missing one.
fn read(path: &Path, options: &str) -> Result<[u8; 16], Error> {
    let mut file = fs::File::open(path).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => Error::Missing {
            path: path.into(),
            options: options.into(),
        },
        _ => Error::of(path)(error),
    })?;
    #[cfg(unix)]
    {
        let metadata = file.metadata().map_err(Error::of(path))?;
        let mode = std::os::unix::fs::PermissionsExt::mode(&metadata.permissions());
        if metadata.is_file() && mode & 0o077 != 0 {
            return Err(Error::Open { path: path.into() });
        }
    }
    let mut bytes = Vec::new();
    // More than a key is no key, and need not be read.
    let most = TITLE.len() as u64 + 64;
    let mut limited = io::Read::by_ref(&mut file).take(most);
    limited.read_to_end(&mut bytes).map_err(Error::of(path))?;
    parse(&bytes).ok_or_else(|| Error::NoKey { path: path.into() })
}

/// The key in the text of a file.
fn parse(bytes: &[u8]) -> Option<[u8; 16]> {
    let digits = std::str::from_utf8(bytes).ok()?.trim_end();
    let digits = digits.strip_prefix(TITLE)?.as_bytes();
    let mut key = [0; 16];
    if digits.len() != 2 * key.len() {
        return None;
    }
    for (byte, pair) in key.iter_mut().zip(digits.chunks_exact(2)) {
        let digit = |digit: u8| char::from(digit).to_digit(16);
        *byte = (digit(pair[0])? << 4 | digit(pair[1])?) as u8;
    }
    Some(key)
}

/// Says which key is where.
fn say(place: &KeyFile, path: &Path, key: &Key, what: &str) {
    let number = format!("{:08X}", key.number());
    if place.json {
        println!("{}", json!({ "key": number, "file": path }));
    } else {
        println!(
            "key {number} of {} {what}: {}",
            place.vehicle,
            path.display()
        );
    }
}

/// Says what to do with a new key.
fn advise(place: &KeyFile) {
    if !place.json {
        println!(
            "Write it to every node with `cargo xtask keys flash NODE{}`. Until all have it, the vehicle \
             does not move.",
            place.options()
        );
    }
}

/// Writes the key to a board, or erases its place.
fn write(workspace: &Workspace, options: &KeyNode, key: bool) -> Result<(), Failure> {
    let changes = options.changes.overrides();
    let wanted = options.vehicle.as_deref();
    let (vehicle, node) = vehicle::with_node(workspace, &options.node, wanted, &changes)?;
    let sled = vehicle.board(node);
    let record = if key {
        if vehicle.is_event_triggered() {
            let vehicle = vehicle.name().into();
            return Err(Error::EventTriggered { vehicle }.into());
        }
        vehicle::no_guardian(&vehicle, node, "uses no key")?;
        let file = options.file.as_deref();
        let path = path(workspace, vehicle.name(), file)?;
        let named = self::options(vehicle.name(), file);
        let record = Key::new(read(&path, &named)?).record();
        record.into_iter().flat_map(u32::to_le_bytes).collect()
    } else {
        vec![0xFF; 4 * firmware::e2e::RECORD]
    };
    let found = probe::find(workspace, &options.node, options.probe.as_deref());
    let probe = match found {
        Err(_) if options.dry_run => options.probe.clone(),
        found => found?,
    };
    if options.dry_run {
        for command in commands(workspace, sled, probe.as_deref(), Path::new(RECORD)) {
            println!("{}", typed(&command));
        }
        let what = match key {
            true => "the record of the key",
            false => "the bytes of erased flash",
        };
        eprintln!(
            "{RECORD} stands for a temporary file with {what}, which a dry run does not write."
        );
        return Ok(());
    }
    // A folder that only its owner can read, and that is gone afterwards.
    let folder = tempfile::tempdir().map_err(Error::of(&env::temp_dir()))?;
    let path = folder.path().join(RECORD);
    let written = private(&path).and_then(|mut file| file.write_all(&record));
    written.map_err(Error::of(&path))?;
    for mut command in commands(workspace, sled, probe.as_deref(), &path) {
        succeed(&mut command, "probe-rs")?;
    }
    Ok(())
}

/// The commands that write a record into its place on a board, and start the node again.
fn commands(
    workspace: &Workspace,
    sled: &Sled,
    probe: Option<&str>,
    record: &Path,
) -> [std::process::Command; 2] {
    let place = format!("{:#010x}", sled.secret.base);
    let options = [
        "--binary-format",
        "bin",
        "--base-address",
        &place,
        "--verify",
    ];
    let mut download = probe::command(workspace, "download", sled, probe, &options);
    download.arg(record);
    [
        download,
        probe::command(workspace, "reset", sled, probe, &[]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_written_once_and_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("keys").join("uagv.key");
        let none = read(&path, " --vehicle two-boards --file 'a key'").unwrap_err();
        let command = "`cargo xtask keys new --vehicle two-boards --file 'a key'` makes a key";
        assert!(none.to_string().ends_with(command), "{none}");
        let (first, second) = (random().unwrap(), random().unwrap());
        assert_ne!(first, second);
        create(&path, &first).unwrap();
        assert!(matches!(create(&path, &second), Err(Error::Exists { .. })));
        assert_eq!(read(&path, "").unwrap(), first);
        file::replace(&path, &text(&second)).unwrap();
        assert_eq!(read(&path, "").unwrap(), second);
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn the_options_of_a_key_are_repeated() {
        let file = Path::new("my keys/a.key");
        assert_eq!(options(DEFAULT, None), "");
        assert_eq!(
            options("two-boards", Some(file)),
            " --vehicle two-boards --file 'my keys/a.key'"
        );
    }

    #[test]
    fn other_texts_are_no_key() {
        let digits = "00112233445566778899aabbccddeeff";
        assert!(parse(format!("{TITLE}{digits}\r\n").as_bytes()).is_some());
        for text in [
            String::new(),
            digits.into(),
            format!("{TITLE}{digits}0"),
            format!("{TITLE}{}", &digits[1..]),
            format!("{TITLE}+{}", &digits[1..]),
            format!("{TITLE}{digits} # mine"),
        ] {
            assert_eq!(parse(text.as_bytes()), None, "{text}");
        }
        assert_eq!(parse(&[0xFF; 40]), None);
    }

    #[cfg(unix)]
    #[test]
    fn a_key_that_others_can_read_is_refused() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("new").join(".furrow");
        let path = folder.join("a.key");
        create(&path, &[7; 16]).unwrap();
        for made in [folder.parent().unwrap(), &folder] {
            let mode = fs::metadata(made).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o700, "{}", made.display());
        }
        assert_eq!(
            fs::metadata(&path).unwrap().permissions().mode() & 0o777,
            0o600
        );
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
        assert!(matches!(read(&path, ""), Err(Error::Open { .. })));
    }

    #[test]
    fn no_key_gets_into_the_workspace() {
        let workspace = Workspace::find().unwrap();
        let inside = workspace.root().join("xtask/a.key");
        let refused = path(&workspace, "uagv", Some(&inside)).unwrap_err();
        assert!(refused.to_string().contains("--file"), "{refused}");
        let folder = tempfile::tempdir().unwrap();
        let outside = folder.path().join("a.key");
        assert_eq!(path(&workspace, "uagv", Some(&outside)).unwrap(), outside);
    }

    #[test]
    fn the_record_goes_behind_the_image() {
        let workspace = Workspace::find().unwrap();
        let typed_of = |sled| {
            let commands = commands(&workspace, sled, Some("066EFF57"), Path::new("t/record"));
            commands.iter().map(typed).collect::<Vec<_>>()
        };
        assert_eq!(
            typed_of(Sled::F303),
            [
                "probe-rs download --chip STM32F303K8Tx --probe 066EFF57 --binary-format bin \
                 --base-address 0x0800f800 --verify t/record",
                "probe-rs reset --chip STM32F303K8Tx --probe 066EFF57"
            ]
        );
        assert!(typed_of(Sled::F446)[0].contains("--base-address 0x08060000"));
    }
}
