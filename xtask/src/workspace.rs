//! Finds the workspace, and runs cargo and other programs in it.

use std::{
    env,
    ffi::OsStr,
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    process::{Command, ExitStatus, Stdio},
};

use vehicle_model::build::{OVERRIDES, VARIANT};

use crate::target::TRIPLE;

/// What goes wrong with the workspace or a program that runs in it.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// It is not where it should be.
    #[error("the workspace is not found: run this as `cargo xtask`")]
    NotFound,
    /// A program did not succeed.
    #[error("{what} failed ({status})")]
    Unsuccessful {
        /// What it was to do.
        what: String,
        /// How it ended.
        status: ExitStatus,
    },
    /// A program cannot be run.
    #[error("{what} failed: {program} cannot be run: {error}")]
    Program {
        /// What it was to do.
        what: String,
        /// Its name.
        program: String,
        /// Why it cannot be run.
        #[source]
        error: io::Error,
    },
}

/// The workspace that the commands work on.
#[derive(Debug, Clone)]
pub struct Workspace {
    root: PathBuf,
    /// Cargo's target folder, where it is not the usual one.
    target: Option<PathBuf>,
}

impl Workspace {
    /// The workspace that this program belongs to.
    ///
    /// # Errors
    ///
    /// It is not where it was when the program was built, and cargo does not
    /// say where it is.
    pub fn find() -> Result<Self, Error> {
        let package = env::var_os("CARGO_MANIFEST_DIR")
            .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")), PathBuf::from);
        package
            .parent()
            .filter(|root| root.join("Cargo.toml").is_file())
            .map(Self::at)
            .ok_or(Error::NotFound)
    }

    /// The workspace with this root folder.
    pub fn at(root: &Path) -> Self {
        Self {
            root: root.into(),
            target: None,
        }
    }

    /// The same workspace, built in another target folder.
    #[must_use]
    pub fn with_target_folder(self, target: &Path) -> Self {
        Self {
            target: Some(target.into()),
            ..self
        }
    }

    /// The folder of its vehicles.
    pub fn vehicles(&self) -> PathBuf {
        self.root.join("firmware/vehicles")
    }

    /// Its root folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Keeps other threads and programs from building images until it is dropped. Cargo has one place
    /// for images of one name, so that theirs could replace one before it is copied from there. On a
    /// file system without locks it keeps nobody.
    pub(crate) fn builds_alone(&self) -> Option<File> {
        let target = self.target();
        fs::create_dir_all(&target).ok()?;
        let file = File::create(target.join(".images-lock")).ok()?;
        file.lock().ok()?;
        Some(file)
    }

    /// Removes what was built for boards in another folder, if the target folder was moved with its workspace. Cargo
    /// takes it for fresh, but its debug information names sources that are no longer there. A target folder of a place of
    /// its own may be that of several workspaces, so nothing is removed there.
    pub(crate) fn forget_moved(&self) {
        let target = self.target();
        if target != self.root.join("target") {
            return;
        }
        let noted = target.join(".images-of");
        let here = self.root.as_os_str().as_encoded_bytes();
        let is_here = || fs::read(&noted).map(|there| there == here);
        if is_here().is_ok_and(|is_here| is_here) {
            return;
        }
        let _alone = self.builds_alone();
        // Another program may have done it meanwhile.
        if is_here().is_ok_and(|is_here| !is_here) {
            // What stays is built over, or named by the analysis.
            let _ = fs::remove_dir_all(target.join(TRIPLE));
            let _ = fs::remove_dir_all(target.join("bench"));
        }
        let _ = fs::write(&noted, here);
    }

    /// Where cargo builds, unless its own settings say another place.
    pub(crate) fn target(&self) -> PathBuf {
        let target = self.target.clone();
        let target = target.or_else(|| env::var_os("CARGO_TARGET_DIR").map(PathBuf::from));
        self.root.join(target.unwrap_or_else(|| "target".into()))
    }

    /// Cargo, to be run in the workspace.
    pub fn cargo(&self) -> Command {
        let mut command = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        command.current_dir(&self.root);
        if let Some(target) = &self.target {
            command.env("CARGO_TARGET_DIR", target);
        }
        command
    }

    /// Another program, to be run in the workspace, where the pinned toolchain is
    /// in force.
    pub fn program(&self, name: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new(name);
        command.current_dir(&self.root);
        command
    }
}

/// What a program printed on its standard output, if it could be run and succeeded.
pub(crate) fn output(command: &mut Command) -> Option<String> {
    let output = command.stderr(Stdio::null()).output().ok()?;
    output
        .status
        .success()
        .then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Runs a program to its end. It inherits standard output and standard error.
///
/// # Errors
///
/// It cannot be run or does not succeed. The error names `what` it was to do.
pub(crate) fn succeed(command: &mut Command, what: &str) -> Result<(), Error> {
    let what = what.to_owned();
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(Error::Unsuccessful { what, status }),
        Err(error) => Err(Error::Program {
            what,
            program: command.get_program().to_string_lossy().into_owned(),
            error,
        }),
    }
}

/// A command as one would type it, with the variant and the values in place of a manifest's.
pub(crate) fn typed(command: &Command) -> String {
    let set = [VARIANT, OVERRIDES].into_iter().filter_map(|wanted| {
        let mut values = command.get_envs().filter(|(name, _)| *name == wanted);
        let value = values.find_map(|(_, value)| value)?;
        Some(format!("{wanted}={}", quoted(value)))
    });
    // A program is typed by its name, wherever it was found.
    let program = Path::new(command.get_program());
    let program = program.file_name().unwrap_or(program.as_os_str());
    let mut words: Vec<String> = set.collect();
    words.push(program.to_string_lossy().into_owned());
    words.extend(command.get_args().map(quoted));
    words.join(" ")
}

/// A word as a shell reads it back.
fn quoted(word: &OsStr) -> String {
    campaign::quoted(&word.to_string_lossy())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_built_for_boards_is_forgotten_when_its_folder_was_moved() {
        let folder = tempfile::tempdir().unwrap();
        let built = |root: &Path| root.join("target").join(TRIPLE).join("release/gps");
        let (before, after) = (folder.path().join("before"), folder.path().join("after"));
        fs::create_dir_all(built(&before).parent().unwrap()).unwrap();
        fs::write(built(&before), "image").unwrap();
        for _ in 0..2 {
            Workspace::at(&before).forget_moved();
            assert!(built(&before).is_file());
        }
        fs::rename(&before, &after).unwrap();
        let shared = after.join("target");
        let other = Workspace::at(folder.path()).with_target_folder(&shared);
        other.forget_moved();
        assert!(built(&after).is_file());
        Workspace::at(&after).forget_moved();
        assert!(!built(&after).exists());
    }

    #[test]
    fn a_command_is_shown_so_that_a_shell_reads_it_back() {
        let mut command = Command::new("/usr/bin/probe-rs");
        command.args(["download", "a file", "it's"]);
        assert_eq!(typed(&command), r"probe-rs download 'a file' 'it'\''s'");
    }

    #[test]
    fn a_program_that_fails_is_named() {
        let failure = succeed(&mut Command::new("no-such-program"), "the attempt");
        let text = failure.unwrap_err().to_string();
        assert!(
            text.starts_with("the attempt failed: no-such-program"),
            "{text}"
        );
        assert_eq!(output(&mut Command::new("no-such-program")), None);
    }
}
