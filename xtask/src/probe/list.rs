//! The debug probes that `probe-rs list` lists.

use std::fmt;

/// A connected debug probe.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Probe {
    /// Its kind, such as `STLink V2-1`.
    name: String,
    /// Its serial number; some probes have none.
    serial: String,
    /// What `probe-rs --probe` takes for it: vendor, product and serial number.
    pub(super) selector: String,
}

impl Probe {
    /// Reads a line of the list. `None` for a line that lists no probe.
    ///
    /// Since release 0.25 a line is `[0]: STLink V2-1 -- 0483:374b:066EFF57 (ST-LINK)`; before,
    /// it was `[0]: STLink V2-1 (VID: 0483, PID: 374b, Serial: 066EFF57, StLink)`.
    fn read(line: &str) -> Option<Self> {
        let (number, probe) = line.trim().strip_prefix('[')?.split_once("]: ")?;
        number.parse::<u32>().ok()?;
        match probe.split_once(" -- ") {
            Some((name, rest)) => {
                let selector = rest.split_whitespace().next()?;
                Some(Self {
                    name: name.into(),
                    serial: selector.splitn(3, ':').nth(2).unwrap_or_default().into(),
                    selector: selector.into(),
                })
            }
            None => {
                let (name, rest) = probe.split_once(" (VID: ")?;
                let (vendor, rest) = rest.split_once(", PID: ")?;
                let (product, rest) = rest.split_once(", ")?;
                let serial = rest.strip_prefix("Serial: ");
                let serial = serial.and_then(|rest| rest.split(',').next());
                let serial = serial.unwrap_or_default();
                Some(Self {
                    name: name.into(),
                    serial: serial.into(),
                    selector: format!("{vendor}:{product}:{serial}"),
                })
            }
        }
    }

    /// Whether `wanted` is its serial number, or all that probe-rs takes for it.
    pub(super) fn is(&self, wanted: &str) -> bool {
        (!self.serial.is_empty() && self.serial.eq_ignore_ascii_case(wanted))
            || self.selector.eq_ignore_ascii_case(wanted)
    }
}

/// The option that chooses it, and its kind.
impl fmt::Display for Probe {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let choice = match self.serial.as_str() {
            "" => &self.selector,
            serial => serial,
        };
        write!(f, "--probe {choice} ({})", self.name)
    }
}

/// The probes of a list.
pub(super) fn read(list: &str) -> Vec<Probe> {
    list.lines().filter_map(Probe::read).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_list_has_no_probe() {
        assert_eq!(read("No debug probes were found.\n"), []);
        assert_eq!(read(""), []);
    }

    #[test]
    fn the_lists_of_both_forms_are_read() {
        let new = "The following debug probes were found:\n\
            [0]: STLink V2-1 -- 0483:374b:066EFF575755846687183908 (ST-LINK)\n\
            [1]: STLink V2 -- 0483:3748: (ST-LINK)\n\
            [2]: ESP JTAG -- 303a:1001:84:F7:03:A0 (EspJtag)\n";
        let probes = read(new);
        assert_eq!(
            probes.iter().map(Probe::to_string).collect::<Vec<_>>(),
            [
                "--probe 066EFF575755846687183908 (STLink V2-1)",
                "--probe 0483:3748: (STLink V2)",
                "--probe 84:F7:03:A0 (ESP JTAG)",
            ]
        );
        assert_eq!(probes[0].selector, "0483:374b:066EFF575755846687183908");

        let old = "The following debug probes were found:\n\
            [0]: STLink V2-1 (VID: 0483, PID: 374b, Serial: 066EFF575755846687183908, StLink)\n\
            [1]: STLink V2 (VID: 0483, PID: 3748, StLink)\n";
        assert_eq!(read(old), probes[..2]);
    }

    #[test]
    fn a_probe_is_named_by_its_serial_number_or_in_full() {
        let [probe] = &read("[0]: STLink V2-1 -- 0483:374b:066EFF57 (ST-LINK)")[..] else {
            panic!("one probe");
        };
        assert!(probe.is("066eff57") && probe.is("0483:374b:066EFF57"));
        assert!(!probe.is("066EFF") && !probe.is("") && !probe.is("0483:374b"));
    }
}
