//! Names and comments in the spelling of Rust.

/// `SteeringRate` and `steering_rate` as `steering_rate`.
pub(super) fn snake(name: &str) -> String {
    let mut snake = String::new();
    for (index, letter) in name.chars().enumerate() {
        if letter.is_uppercase() && index > 0 && !snake.ends_with('_') {
            snake.push('_');
        }
        snake.extend(letter.to_lowercase());
    }
    snake
}

/// `SteeringRate` as `STEERING_RATE`.
pub(super) fn screaming(name: &str) -> String {
    snake(name).to_uppercase()
}

/// `gps` as `Gps`.
pub(super) fn pascal(name: &str) -> String {
    let mut letters = name.chars();
    match letters.next() {
        Some(first) => first.to_uppercase().chain(letters).collect(),
        None => String::new(),
    }
}

/// A comment of the file as text of a doc comment.
pub(super) fn doc(comment: &str) -> String {
    comment
        .replace('[', "\\[")
        .replace('<', "\\<")
        .replace(['\n', '\r'], " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_follow_the_conventions_of_rust() {
        assert_eq!(snake("SteeringRate"), "steering_rate");
        assert_eq!(snake("X"), "x");
        assert_eq!(screaming("BasicCycle"), "BASIC_CYCLE");
        assert_eq!(pascal("gps"), "Gps");
    }
}
