//! The audit on programs that it must refuse, and on one that it must not.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use schedulability::tasks::App;
use xtask::audit::{Audit, audit};

/// Folder of the programs, built once.
fn programs() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let package = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/programs");
        let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("programs");
        let workspace = xtask::Workspace::find().expect("the workspace");
        xtask::target::ensure(&workspace).expect("the target");
        let status = xtask::target::cargo(&workspace, "build")
            .current_dir(&package)
            .args(["--quiet", "--release"])
            .env("CARGO_TARGET_DIR", &target)
            .env_remove("RUSTFLAGS")
            .env_remove("CARGO_ENCODED_RUSTFLAGS")
            .status()
            .expect("cargo runs");
        assert!(status.success(), "the programs do not build");
        target.join(xtask::target::TRIPLE).join("release")
    })
}

fn audited(program: &str) -> Audit {
    let source = r#"
        #[rtic::app(device = pac)]
        mod app {
            #[task(binds = TIM2, priority = 1)]
            fn work(_: work::Context) {}
        }
    "#;
    let app = App::parse("app.rs", source).expect("an application");
    audit(&programs().join(program), &app).expect("an image")
}

fn refused(program: &str) -> String {
    let complaints = audited(program).complaints;
    assert!(!complaints.is_empty(), "{program} was accepted");
    complaints.join("; ")
}

#[test]
fn a_program_that_panics_nowhere_is_accepted() {
    let audit = audited("quiet");
    assert_eq!(audit.complaints, Vec::<String>::new());
    // One exception frame at least, and no page of the part more.
    assert!((104..1024).contains(&audit.deepest), "{}", audit.deepest);
}

#[test]
fn a_reachable_panic_is_refused_with_its_place() {
    let complaint = refused("index");
    assert!(complaint.contains("index.rs:10"), "{complaint}");
    assert!(complaint.contains("panic"), "{complaint}");
    assert!(!complaint.contains("main"), "{complaint}");
}

#[test]
fn a_panic_behind_a_pointer_is_refused() {
    let complaint = refused("pointer");
    assert!(complaint.contains("pointer.rs:13"), "{complaint}");
    assert!(complaint.contains("stack is not known"), "{complaint}");
}

#[test]
fn the_text_of_a_panic_and_its_formatting_are_refused() {
    let complaint = refused("message");
    assert!(complaint.contains("formatting of messages"), "{complaint}");
    assert!(complaint.contains("message of a panic"), "{complaint}");
}

#[test]
fn a_trap_is_refused() {
    let complaint = refused("trap");
    assert!(
        complaint.contains("trap.rs:11") && complaint.contains("may trap"),
        "{complaint}"
    );
}

#[test]
fn a_stack_without_bound_is_refused() {
    let complaint = refused("recursion");
    assert!(complaint.contains("recursion through"), "{complaint}");
}
