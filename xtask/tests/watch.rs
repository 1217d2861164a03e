//! `cargo xtask sim --watch` on a pseudo-terminal.

#![cfg(target_os = "linux")]

use std::{
    fs::{self, File, OpenOptions},
    io::{Read, Write},
    path::Path,
    process::{Child, Command, ExitStatus},
    sync::{Arc, Mutex},
    thread,
    time::{Duration, Instant},
};

use rustix::{
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    termios::{LocalModes, Winsize, tcgetattr, tcsetwinsize},
};
use xtask::Workspace;

const ENTER: &str = "\x1b[?1049h";
const LEAVE: &str = "\x1b[?1049l";

/// A run on a terminal of its own.
struct Watched {
    run: Child,
    keyboard: File,
    /// The program's end of the terminal.
    end: File,
    screen: Arc<Mutex<String>>,
}

impl Watched {
    fn start(options: &[&str]) -> Self {
        Self::on("xterm", options)
    }

    fn on(term: &str, options: &[&str]) -> Self {
        // A run that had this end, too, would not notice that the test is gone.
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let keyboard = openpt(flags).unwrap();
        grantpt(&keyboard).unwrap();
        unlockpt(&keyboard).unwrap();
        let path = ptsname(&keyboard, Vec::new())
            .unwrap()
            .into_string()
            .unwrap();
        let end = OpenOptions::new()
            .read(true)
            .write(true)
            .open(path)
            .unwrap();
        let size = Winsize {
            ws_row: 30,
            ws_col: 100,
            ws_xpixel: 0,
            ws_ypixel: 0,
        };
        tcsetwinsize(&end, size).unwrap();
        let keyboard = File::from(keyboard);
        // In a session of its own, or /dev/tty would be the terminal of whoever runs the test.
        let run = Command::new("setsid")
            .args(["--ctty", "--wait", env!("CARGO_BIN_EXE_xtask"), "sim"])
            .args(["--vehicle", "two-boards"])
            .args(options)
            .env("TERM", term)
            .current_dir(Workspace::find().unwrap().root())
            .stdin(end.try_clone().unwrap())
            .stdout(end.try_clone().unwrap())
            .stderr(end.try_clone().unwrap())
            .spawn()
            .unwrap();
        let screen = Arc::new(Mutex::new(String::new()));
        let (to, mut from) = (Arc::clone(&screen), keyboard.try_clone().unwrap());
        thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(count) = from.read(&mut bytes) {
                let text = String::from_utf8_lossy(&bytes[..count]).into_owned();
                to.lock().unwrap().push_str(&text);
            }
        });
        Self {
            run,
            keyboard,
            end,
            screen,
        }
    }

    fn screen(&self) -> String {
        self.screen.lock().unwrap().clone()
    }

    fn press(&mut self, keys: &str) {
        self.keyboard.write_all(keys.as_bytes()).unwrap();
    }

    /// Waits until that text comes behind what was seen of the screen before.
    fn wait_for(&mut self, text: &str, seen: usize) -> usize {
        let begin = Instant::now();
        loop {
            let screen = self.screen();
            let new = screen.get(seen..).unwrap_or_default();
            if let Some(place) = new.find(text) {
                return seen + place;
            }
            let ended = self.run.try_wait().unwrap();
            assert_eq!(ended, None, "{screen}");
            let shown: Vec<_> = screen.chars().rev().take(4000).collect();
            let shown: String = shown.into_iter().rev().collect();
            assert!(
                begin.elapsed() < Duration::from_secs(60),
                "no {text}: {shown:?}"
            );
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// Whether the terminal hands over lines, with what is typed shown.
    fn is_in_order(&self) -> bool {
        let modes = tcgetattr(&self.end).unwrap().local_modes;
        modes.contains(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG)
    }

    /// Waits for the end. Returns the status and what came behind the view.
    fn ended(&mut self) -> (ExitStatus, String) {
        let status = self.run.wait().unwrap();
        // What the terminal still has.
        thread::sleep(Duration::from_millis(300));
        assert!(self.is_in_order());
        let screen = self.screen();
        let (_, view) = screen.split_once(ENTER).unwrap();
        let (_, after) = view.split_once(LEAVE).unwrap();
        assert!(after.contains("\x1b[?25h"), "the cursor is back: {after}");
        (status, after.to_owned())
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        // A run that has ended cannot be killed.
        let _ = self.run.kill();
        let _ = self.run.wait();
    }
}

fn no_folder_in(folder: &Path) {
    let left: Vec<_> = fs::read_dir(folder).unwrap().collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn a_watched_run_is_the_run_without_a_view() {
    let folder = tempfile::tempdir().unwrap();
    let (watched, plain) = (folder.path().join("watched"), folder.path().join("plain"));
    let out = watched.display().to_string();
    let mut run = Watched::start(&["--seconds", "3", "--watch=max", "--out", &out]);
    let (status, after) = run.ended();
    assert!(status.success(), "{after}");
    assert!(
        after.contains("turn, seed 1, 3 s simulated"),
        "the report follows: {after}"
    );
    let done = Command::new(env!("CARGO_BIN_EXE_xtask"))
        .args(["sim", "--vehicle", "two-boards", "--seconds", "3", "--out"])
        .arg(&plain)
        .current_dir(Workspace::find().unwrap().root())
        .output()
        .unwrap();
    assert!(done.status.success(), "{done:?}");
    for name in ["bus.log", "summary.json", "run.mcap", "run.html"] {
        let read = |of: &Path| fs::read(of.join(name)).unwrap();
        assert!(read(&watched) == read(&plain), "{name}");
    }
}

#[test]
fn keys_pause_and_end_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run").display().to_string();
    let mut run = Watched::start(&["--seconds", "600", "--watch=50", "--out", &out]);
    let seen = run.wait_for("basic cycle", 0);
    assert!(!run.is_in_order());
    run.press(" ");
    let seen = run.wait_for("paused", seen);
    run.press("+");
    // Of "50 times" only what differs is drawn.
    let seen = run.wait_for("0 times real time", seen);
    run.press("?");
    let seen = run.wait_for("┌help", seen);
    // Escape closes the help; the run goes on.
    run.press("\x1b");
    thread::sleep(Duration::from_millis(300));
    run.press("-");
    run.wait_for("times real time", seen);
    run.press("q");
    let (status, after) = run.ended();
    assert_eq!(status.code(), Some(0), "{after}");
    assert!(after.contains("ended by hand at"), "{after}");
    assert!(after.contains("Bus"), "{after}");
    let kept = fs::read_to_string(folder.path().join("run/summary.json")).unwrap();
    let kept: serde_json::Value = serde_json::from_str(&kept).unwrap();
    let simulated = kept["simulated_seconds"].as_f64().unwrap();
    assert!(simulated < 600.0, "{simulated}");
}

/// Such as Escape and a bracket: whatever the terminal may still wait for, the run goes on.
#[test]
fn an_unfinished_key_sequence_does_not_stop_a_run() {
    for keys in ["\x1b[", "\x1bO", "\x1b[200"] {
        let mut run = Watched::start(&["--seconds", "4", "--watch=2"]);
        run.wait_for("basic cycle", 0);
        thread::sleep(Duration::from_millis(200));
        run.press(keys);
        let (status, after) = run.ended();
        assert_eq!(status.code(), Some(0), "{after}");
        assert!(after.contains("4 s simulated"), "{after}");
    }
}

/// Ctrl-C is a key there, and a request of the system comes as ever.
#[test]
fn an_interrupted_view_gives_the_terminal_back() {
    for (signal, code) in [
        (None, 130),
        (Some("TERM"), 143),
        (Some("HUP"), 129),
        (Some("QUIT"), 131),
        (Some("USR1"), 138),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("run").display().to_string();
        let mut run = Watched::start(&["--seconds", "600", "--watch", "--out", &out]);
        run.wait_for("basic cycle", 0);
        match signal {
            None => run.press("\x03"),
            Some(signal) => {
                let pid = run.run.id().to_string();
                let kill = Command::new("kill").args(["-s", signal, &pid]).status();
                assert!(kill.unwrap().success());
            }
        }
        let (status, after) = run.ended();
        assert_eq!(status.code(), Some(code), "{after}");
        assert!(after.contains("interrupted"), "{after}");
        no_folder_in(folder.path());
    }
}

#[test]
fn a_terminal_that_cannot_be_drawn_on_is_refused() {
    let mut run = Watched::on("dumb", &["--seconds", "1", "--watch"]);
    let status = run.run.wait().unwrap();
    // What the terminal still has.
    thread::sleep(Duration::from_millis(300));
    let said = run.screen();
    assert_eq!(status.code(), Some(2), "{said}");
    assert!(said.contains("TERM says that it is a dumb one"), "{said}");
    assert!(!said.contains(ENTER), "{said}");
}
