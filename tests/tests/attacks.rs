//! The campaign with an attacker: without a key it finds that forged commands move the motors.

use campaign::attack::{self, Attack, Kind, Role};
use campaign::{Sequence, Trouble, Verdict, play, replay};
use furrow_tests::{images, vehicle};

fn run(seed: u64, key: bool) -> Verdict {
    let attacks = Trouble::Attacks { key };
    replay(vehicle(), seed, images(), attacks).unwrap_or_else(|error| panic!("{error}"))
}

/// A run of the vehicle. For two seconds the attacker destroys the true commands and sends forged ones instead.
fn forged_commands(seed: u64, key: bool) -> Verdict {
    let id = attack::command(vehicle()).expect("a command").id;
    let (from, until) = (2.0, 4.0);
    let forgery = Kind::Forge {
        role: Role::Command,
        id,
        rate: 500.0,
    };
    let suppression = Kind::Suppress {
        id: Some(id),
        bit: 40,
    };
    let kinds = [forgery, suppression].into_iter();
    let attacks = kinds.map(|kind| Attack { kind, from, until }).collect();
    let sequence = Sequence {
        attacks,
        ..Sequence::attacked(vehicle(), seed, key)
    };
    play(vehicle(), sequence, images()).unwrap_or_else(|error| panic!("{error}"))
}

/// The check value of a command needs no secret. Whether a forged one has the counter that is expected next is a
/// matter of luck, so not each attack moves a motor.
#[test]
fn without_a_key_the_campaign_finds_that_forged_commands_move_motors() {
    let mut verdicts = (1..=8).map(|seed| forged_commands(seed, false));
    let moved = verdicts.find(|verdict| verdict.tally.moved_a_motor > 0);
    let moved = moved.expect("a forged command that is obeyed");
    let mut rules = moved.violations.iter().map(|one| one.rule.as_ref());
    assert!(rules.any(|rule| rule == "forged"), "{:?}", moved.violations);
}

#[test]
fn with_a_key_the_same_attacks_move_none() {
    for seed in 1..=2 {
        let verdict = forged_commands(seed, true);
        assert_eq!(verdict.violations, []);
        assert_eq!(verdict.tally.moved_a_motor, 0);
        assert!(verdict.tally.attempts() > 100, "{:?}", verdict.tally);
        let recovered = verdict.tally.worst_recovery_seconds;
        assert!(recovered > 0.0 && recovered < 1.0, "{recovered}");
    }
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

/// The attacker's references tell a time that runs 200 ppm too fast. Nodes that have followed them begin their last
/// windows 21 us early, until they have measured the rate of their own master again.
#[test]
fn the_rate_of_foreign_references_is_soon_forgotten() {
    for seed in [2917, 3055] {
        assert_eq!(run(seed, true).violations, [], "{seed}");
    }
}
