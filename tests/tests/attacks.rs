//! The campaign with an attacker: without a key it finds that forged commands move the motors.

use campaign::{Trouble, Verdict, replay};
use furrow_tests::{images, vehicle};

/// Seed of a run in which the attacker forges commands.
const FORGED: u64 = 69;

fn run(seed: u64, key: bool) -> Verdict {
    let attacks = Trouble::Attacks { key };
    replay(vehicle(), seed, images(), attacks).unwrap_or_else(|error| panic!("{error}"))
}

/// The check value of a command needs no secret.
#[test]
fn without_a_key_the_campaign_finds_that_forged_commands_move_motors() {
    let verdict = run(FORGED, false);
    assert!(verdict.tally.moved_a_motor > 0, "{verdict:?}");
    let mut rules = verdict.violations.iter().map(|one| one.rule.as_ref());
    assert!(
        rules.any(|rule| rule == "forged"),
        "{:?}",
        verdict.violations
    );
}

#[test]
fn with_a_key_the_same_attack_moves_none() {
    let verdict = run(FORGED, true);
    assert_eq!(verdict.violations, []);
    assert_eq!(verdict.tally.moved_a_motor, 0);
    assert!(verdict.tally.attempts() > 100, "{:?}", verdict.tally);
    let recovered = verdict.tally.worst_recovery_seconds;
    assert!(recovered > 0.0 && recovered < 1.0, "{recovered}");
}

/// A flood keeps the reference off the bus, and the next one begins the cycles at another time. Until the schedule
/// has followed the receiver's epochs, some windows of its messages are empty, and that is known.
#[test]
fn a_flood_that_moves_the_schedule_leaves_windows_of_the_receiver_empty() {
    let verdict = run(2231, true);
    assert_eq!(verdict.violations, []);
    assert_eq!(verdict.tally.known_examples["recovery"].seed, 2231);
    let recovered = verdict.tally.worst_recovery_seconds;
    assert!(recovered > 0.0 && recovered < 0.2, "{recovered}");
}

/// The attacker sends references of the backup master. Nodes follow some of them, and those that they
/// refuse may be on no console.
#[test]
fn what_a_reference_that_is_not_proven_yet_allows_is_counted_as_known() {
    let verdict = run(1059, true);
    assert_eq!(verdict.violations, []);
    let known = verdict.tally.known;
    assert!(
        known
            .keys()
            .all(|rule| ["notice", "place"].contains(&rule.as_ref())),
        "{known:?}"
    );
    assert_eq!(known["place"], 1);
    assert_eq!(verdict.tally.known_examples["place"].seed, 1059);
}
