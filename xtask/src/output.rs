//! What commands print. A reader such as `head` may stop reading, and a disk may be full: neither ends a command in
//! the middle of its work, as the standard macros do with a panic.

use std::fmt::Arguments;
use std::io::{self, Write as _};
use std::sync::OnceLock;

use crate::Failure;

/// The first error of the standard output. Nothing is printed after it.
static ERROR: OnceLock<io::Error> = OnceLock::new();

/// As in the standard library, without a panic.
macro_rules! print {
    ($($text:tt)*) => { $crate::output::put(::std::format_args!($($text)*)) };
}

/// As in the standard library, without a panic.
macro_rules! println {
    ($($text:tt)*) => {
        $crate::output::put(::std::format_args!("{}\n", ::std::format_args!($($text)*)))
    };
}

/// As in the standard library, but where nobody reads it the text is lost.
macro_rules! eprint {
    ($($text:tt)*) => {{
        use ::std::io::Write as _;
        _ = ::std::io::stderr().write_fmt(::std::format_args!($($text)*));
    }};
}

/// As in the standard library, but where nobody reads it the text is lost.
macro_rules! eprintln {
    () => { eprintln!("") };
    ($($text:tt)*) => {{
        use ::std::io::Write as _;
        let mut errors = ::std::io::stderr().lock();
        _ = errors.write_fmt(::std::format_args!($($text)*));
        _ = errors.write_all(b"\n");
    }};
}

/// A text without the characters that would make a terminal do something: of files, and of names that
/// others have chosen.
pub(crate) fn plain(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    for one in text.chars() {
        if one.is_control() && one != '\n' && one != '\t' {
            plain.extend(one.escape_default());
        } else {
            plain.push(one);
        }
    }
    plain
}

/// Prints text.
pub(crate) fn put(text: Arguments<'_>) {
    if ERROR.get().is_none() {
        note(io::stdout().lock().write_fmt(text));
    }
}

/// Prints what is still held back, at the end of a command. A text that was not written makes one fail that has
/// `done` its work; that nobody reads it does not.
pub(crate) fn end(done: Result<(), Failure>) -> Result<(), Failure> {
    if ERROR.get().is_none() {
        note(io::stdout().lock().flush());
    }
    done?;
    match ERROR.get() {
        Some(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(Failure::Usage(format!(
            "the report cannot be printed: {error}"
        ))),
        _ => Ok(()),
    }
}

fn note(written: io::Result<()>) {
    if let Err(error) = written {
        // Another thread's error may have come first.
        _ = ERROR.set(error);
    }
}
