//! The scenarios that come with the program.

/// A built-in scenario.
#[derive(Copy, Clone, Debug)]
pub struct Builtin {
    /// Its name.
    pub name: &'static str,
    /// What it shows, in one line: the file's `summary`.
    pub summary: &'static str,
    /// Its TOML text.
    pub text: &'static str,
}

macro_rules! builtins {
    ($($name:literal: $summary:literal;)+) => {
        pub(super) const ALL: &[Builtin] = &[$(Builtin {
            name: $name,
            summary: $summary,
            text: include_str!(concat!("builtin/", $name, ".toml")),
        }),+];
    };
}

builtins! {
    "straight-line": "1 m beside a 243 m line, 1 m/s, RTK-fixed receiver with 1 cm noise";
    "five-metres-off": "5 m off the line and facing away from it";
    "calibration": "by hand: circles and movements of the steering for `cargo xtask calibrate`";
    "gps-lost": "the fix is lost at 20 s and back at 40 s";
    "master-dead": "the gps node, time master of the bus, is held in reset at 20 s";
}

#[cfg(test)]
mod tests {
    use crate::scenario::Scenario;

    #[test]
    fn every_builtin_reads_and_says_what_the_list_says() {
        for builtin in super::ALL {
            let scenario = Scenario::find(builtin.name).unwrap();
            assert_eq!(scenario.summary, builtin.summary);
            assert_eq!(scenario.name, builtin.name);
        }
    }
}
