//! Frames of nodes with one mailbox: the published answers, and a bus that is simulated bit by bit.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use schedulability::can::{ErrorRate, frame_time};
use schedulability::queued::{self, Bounds, Meeting, Stream};

/// A stream of a node of its own that loads its mailbox at once.
fn alone(node: usize, length: u64, period: u64) -> Stream {
    Stream {
        node,
        length,
        period,
        jitter: 0,
        load: 0,
        reload: 0,
        repeat: 0,
        follows: Vec::new(),
        rest: None,
    }
}

/// Bounds of streams that meet in any way, on a bus without errors.
fn bounds(streams: &[Stream], bit: u64) -> Vec<Option<Bounds>> {
    queued::bounds(streams, bit, ErrorRate::NONE, |_, _| Meeting::Any)
}

fn responses(streams: &[Stream], bit: u64) -> Vec<u64> {
    let bounds = bounds(streams, bit);
    bounds
        .into_iter()
        .map(|one| one.unwrap().response)
        .collect()
}

#[test]
fn nodes_that_load_at_once_have_the_published_answers() {
    // Davis et al. (2007), table 2: three messages of 135 bits, 1 ms each.
    let set = [
        alone(0, 999_945, 2_500_000),
        alone(1, 999_945, 3_500_000),
        alone(2, 999_945, 3_500_000),
    ];
    let rounded = responses(&set, 7407);
    let rounded: Vec<u64> = rounded.iter().map(|ns| (ns + 50_000) / 100_000).collect();
    assert_eq!(rounded, [20, 30, 35]);

    let bit = 4_000;
    let bytes = [1, 2, 1, 2, 1, 2, 6, 1, 2, 3, 1, 4, 1, 1, 3, 1, 1];
    let periods = [
        50, 5, 5, 5, 5, 5, 10, 10, 10, 10, 50, 100, 100, 100, 1000, 1000, 1000,
    ];
    let set: Vec<Stream> = (0..)
        .zip(bytes.into_iter().zip(periods))
        .map(|(node, (bytes, period))| alone(node, frame_time(bytes, bit), period * 1_000_000))
        .collect();
    let expected = [
        720, 1020, 1280, 1580, 1840, 2140, 2520, 2780, 3080, 3420, 3680, 4020, 4280, 4540, 4800,
        5060, 5060,
    ];
    assert_eq!(responses(&set, bit), expected.map(|us| us * 1000));
}

#[test]
fn a_slow_mailbox_lets_one_less_urgent_frame_in_behind_each_own_one() {
    let load = 10;
    let set = [
        Stream {
            load,
            ..alone(0, 100, 5_000)
        },
        Stream {
            load,
            ..alone(0, 100, 5_000)
        },
        alone(1, 130, 5_000),
    ];
    let found = bounds(&set, 1);
    let delays: Vec<u64> = found.iter().map(|one| one.unwrap().delay).collect();
    // The first waits for the less urgent message of its node and for a foreign one; the second for
    // a foreign one, then the first, and another foreign one at its put and at its end; the last
    // waits for both.
    assert_eq!(
        delays,
        [
            100 + 10 + 130 + 100,
            130 + (10 + 130) + 100 + (10 + 130) + 100,
            330
        ]
    );
}

#[test]
fn messages_that_follow_from_one_sample_delay_each_other_once_or_never() {
    let set = [
        Stream {
            jitter: 4_000,
            ..alone(0, 100, 5_000)
        },
        alone(0, 110, 5_000),
        alone(1, 130, 5_000),
    ];
    let delays = |meeting: fn(usize, usize) -> Meeting| -> Vec<u64> {
        let found = queued::bounds(&set, 1, ErrorRate::NONE, meeting);
        found.iter().map(|one| one.unwrap().delay).collect()
    };
    // The first may come twice, as it may be late.
    assert_eq!(
        delays(|_, _| Meeting::Any)[1..],
        [130 + 110 + 100, 100 + 110 + 130]
    );
    let once = |_, _| Meeting::Once;
    assert_eq!(delays(once), [130 + 100, 130 + 100 + 110, 100 + 110 + 130]);
    let never = |_, _| Meeting::Never;
    assert_eq!(delays(never), [100, 110, 130]);
    let mixed = |of, other| {
        if (of, other) == (1, 0) {
            Meeting::Once
        } else {
            Meeting::Never
        }
    };
    assert_eq!(delays(mixed), [100, 100 + 110, 130]);
}

#[test]
fn a_slow_reload_lets_a_less_urgent_frame_in_behind_each_winner() {
    let late = Stream {
        reload: 40,
        ..alone(1, 110, 5_000)
    };
    let set = [alone(0, 100, 5_000), late, alone(2, 130, 5_000)];
    let found = bounds(&set, 1);
    let delays: Vec<u64> = found.iter().map(|one| one.unwrap().delay).collect();
    assert_eq!(
        delays,
        [130 + 100, 130 + 100 + (40 + 130) + 110, 100 + 110 + 130]
    );
}

#[test]
fn jitter_counts_for_the_response_and_not_for_the_delay_of_the_first_frame() {
    let late = Stream {
        jitter: 70,
        ..alone(0, 100, 5_000)
    };
    let expected = Bounds {
        response: 170,
        delay: 100,
    };
    assert_eq!(bounds(&[late], 1), [Some(expected)]);
}

#[test]
fn what_an_overloaded_bus_does_not_carry_has_no_bound() {
    let set = [
        alone(0, 600, 1_000),
        alone(1, 600, 1_000),
        alone(2, 10, 1_000),
    ];
    let found = bounds(&set, 1);
    assert!(found[0].is_some() && found[1].is_none() && found[2].is_none());
}

#[test]
fn an_error_in_the_last_bit_repeats_what_follows_too() {
    let one = ErrorRate {
        burst: 1,
        interval: 0,
    };
    let of = |set: &[Stream], index: usize, errors| {
        let found = queued::bounds(set, 1, errors, |_, _| Meeting::Any);
        found[index].unwrap().response
    };
    let mut set = [
        alone(0, 100, 10_000),
        alone(1, 60, 10_000),
        alone(2, 80, 10_000),
    ];
    let clean = of(&set, 2, ErrorRate::NONE);
    assert_eq!(clean, 100 + 60 + 80);
    // The longest frame again, and 31 bits.
    assert_eq!(of(&set, 2, one), clean + 31 + 100);
    // The receivers have taken it, and answer with the second message twice.
    set[1].follows = vec![0];
    assert_eq!(of(&set, 2, one), clean + 31 + 100 + 60);
    // Its node rests after two attempts that failed.
    set[2].rest = Some((2, 5000));
    assert_eq!(of(&set, 2, one), clean + 31 + 100 + 60);
    let two = ErrorRate { burst: 2, ..one };
    assert_eq!(of(&set, 2, two), clean + 2 * (31 + 100 + 60) + 5000);
}

/// A number below `end`.
fn below(random: &mut ChaCha8Rng, end: u64) -> u64 {
    random.next_u64() % end
}

/// A node of the simulated bus.
#[derive(Default)]
struct Node {
    /// Frames that wait: stream and instant of the put.
    waiting: Vec<(usize, u64)>,
    mailbox: Option<(usize, u64)>,
    /// When the transmit interrupt has loaded the next frame, if it is due.
    loaded_at: Option<u64>,
}

impl Node {
    /// The attempt or the withdrawal has ended: the interrupt loads the next frame at `at`.
    fn ended(&mut self, at: u64) {
        self.loaded_at = Some(at);
    }

    /// Loads the most urgent frame that waits, if the interrupt has come.
    fn load(&mut self, now: u64) {
        if self.loaded_at.is_some_and(|at| at > now) || self.mailbox.is_some() {
            return;
        }
        self.loaded_at = None;
        self.waiting.sort_unstable();
        if !self.waiting.is_empty() {
            self.mailbox = Some(self.waiting.remove(0));
        }
    }
}

/// A time up to `most`, and often that.
fn late(random: &mut ChaCha8Rng, most: u64) -> u64 {
    match below(random, 3) {
        0 => below(random, most + 1),
        _ => most,
    }
}

/// The stream that wins the bus, with the instants of its put and its end.
fn arbitrate(
    streams: &[Stream],
    nodes: &mut [Node],
    now: u64,
    random: &mut ChaCha8Rng,
) -> Option<(usize, u64, u64)> {
    let mut competing: Vec<(usize, u64)> = nodes.iter().filter_map(|node| node.mailbox).collect();
    competing.sort_unstable();
    let mut competing = competing.into_iter();
    let (winner, put) = competing.next()?;
    // The others have lost, and load again while the winner is on the bus.
    for (loser, put) in competing {
        let node = &mut nodes[streams[loser].node];
        node.mailbox = None;
        node.waiting.push((loser, put));
        node.ended(now + late(random, streams[loser].load));
    }
    Some((winner, put, now + streams[winner].length))
}

/// Bits between two frames, which the lengths include.
const INTERFRAME: u64 = 3;

/// The longest time from nominal instant and from put to the end of a frame of each stream, on a bus
/// that runs for `end` bits. `None` if a frame was still waiting when the next one was put.
fn simulated(streams: &[Stream], end: u64, random: &mut ChaCha8Rng) -> Option<Vec<Bounds>> {
    let nodes = streams.iter().map(|stream| stream.node).max().unwrap_or(0) + 1;
    let mut nodes: Vec<Node> = (0..nodes).map(|_| Node::default()).collect();
    let mut seen = vec![
        Bounds {
            response: 0,
            delay: 0
        };
        streams.len()
    ];
    // Nominal instant of the next put, and how late it is. All begin close to each other.
    let mut due: Vec<(u64, u64)> = streams
        .iter()
        .map(|_| (20 + below(random, 12), 0))
        .collect();
    let mut nominal: Vec<u64> = vec![0; streams.len()];
    // Stream, put and end of the frame on the bus.
    let mut on_bus: Option<(usize, u64, u64)> = None;
    for now in 0..end {
        if let Some((stream, put, ends)) = on_bus {
            if now + INTERFRAME == ends {
                let node = &mut nodes[streams[stream].node];
                let load = late(random, streams[stream].load);
                node.mailbox = None;
                node.ended(now + load);
            }
            if now == ends {
                let of = &mut seen[stream];
                of.delay = of.delay.max(now - put);
                of.response = of.response.max(now - nominal[stream]);
                on_bus = None;
            }
        }
        for (stream, (instant, jitter)) in due.iter_mut().enumerate() {
            if now != *instant + *jitter {
                continue;
            }
            let of = &streams[stream];
            let node = &mut nodes[of.node];
            let pending = node.waiting.iter().chain(&node.mailbox);
            let mut pending = pending.map(|(other, _)| *other);
            if pending.any(|other| other == stream)
                || on_bus.is_some_and(|(other, ..)| other == stream)
            {
                return None;
            }
            nominal[stream] = *instant;
            node.waiting.push((stream, now));
            let begun = on_bus.is_some_and(|(other, ..)| Some(other) == node.mailbox.map(|m| m.0));
            if let Some(less) = node.mailbox.filter(|(other, _)| !begun && stream < *other) {
                node.waiting.push(less);
                node.mailbox = None;
                let load = late(random, of.load);
                node.ended(now + load);
            }
            // Mostly as often as it may, sometimes not.
            let pause = if below(random, 8) == 0 {
                below(random, 40)
            } else {
                0
            };
            *instant += of.period + pause;
            *jitter = late(random, of.jitter);
        }
        for node in &mut nodes {
            node.load(now);
        }
        if on_bus.is_none() {
            on_bus = arbitrate(streams, &mut nodes, now, random);
        }
    }
    Some(seen)
}

#[test]
fn no_simulated_frame_takes_longer_than_its_bound() {
    let mut random = ChaCha8Rng::seed_from_u64(2017);
    let (mut tight, mut judged) = (0, 0);
    for _ in 0..3000 {
        let count = 2 + below(&mut random, 5) as usize;
        let loads: Vec<u64> = (0..3).map(|_| below(&mut random, 8)).collect();
        let streams: Vec<Stream> = (0..count)
            .map(|_| {
                let node = below(&mut random, 3) as usize;
                Stream {
                    node,
                    length: 12 + below(&mut random, 14),
                    period: 90 + below(&mut random, 250),
                    jitter: below(&mut random, 3) * below(&mut random, 25),
                    load: loads[node],
                    reload: 0,
                    repeat: 0,
                    follows: Vec::new(),
                    rest: None,
                }
            })
            .collect();
        let found = bounds(&streams, 1);
        let found: Option<Vec<Bounds>> = found.into_iter().collect();
        // A frame must be out before the next one of its message is put.
        let Some(found) = found.filter(|all| {
            let mut each = all.iter().zip(&streams);
            each.all(|(bounds, stream)| bounds.response <= stream.period)
        }) else {
            continue;
        };
        let seen = simulated(&streams, 4_000, &mut random).expect("each frame is out in time");
        judged += 1;
        for (at, (bound, seen)) in found.iter().zip(&seen).enumerate() {
            assert!(
                seen.response <= bound.response && seen.delay <= bound.delay,
                "{at}: {seen:?} {bound:?} {streams:#?}"
            );
            tight += u32::from(seen.delay + 3 >= bound.delay);
        }
    }
    // The bounds are met often enough to see that the simulation comes close to the worst case.
    assert!(judged > 500 && tight > judged / 4, "{tight} of {judged}");
}
