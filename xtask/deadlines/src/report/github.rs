//! Annotations of a pull request: workflow commands of GitHub Actions.

use std::fmt::Write as _;

use super::findings::Finding;

/// One line `::error file=F,line=N,title=T::MESSAGE` for each.
#[must_use]
pub fn github(findings: &[Finding]) -> String {
    let mut text = String::new();
    for finding in findings {
        let _ = writeln!(
            text,
            "::error file={},line={},title=cargo deadlines: {}::{}",
            property(&finding.file),
            finding.line,
            finding.rule,
            data(&finding.message)
        );
    }
    text
}

/// The message, with what would end the command escaped.
fn data(text: &str) -> String {
    text.replace('%', "%25")
        .replace('\r', "%0D")
        .replace('\n', "%0A")
}

/// A property, in which colons and commas are escaped, too.
fn property(text: &str) -> String {
    data(text).replace(':', "%3A").replace(',', "%2C")
}

#[cfg(test)]
mod tests {
    use super::{Finding, github};

    #[test]
    fn what_would_end_the_command_is_escaped() {
        let finding = Finding {
            rule: "deadline",
            message: "blink misses its deadline by 100 %\nof it".to_owned(),
            file: "src/a,b.rs".to_owned(),
            line: 7,
        };
        assert_eq!(
            github(&[finding]),
            "::error file=src/a%2Cb.rs,line=7,title=cargo deadlines: deadline::blink misses its deadline by \
             100 %25%0Aof it\n"
        );
    }
}
