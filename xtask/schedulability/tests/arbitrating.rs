//! Known answers for frames in an arbitrating window, and a simulation of it that disturbs frames. Times in
//! bits.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};
use schedulability::arbitrating::{Competition, Frame, Reaction};
use schedulability::can::{self, ErrorRate};

/// Bits between two frames, which the lengths include.
const INTERFRAME: u64 = 3;
/// An error in a burst that does not come again.
fn burst(errors: u64) -> ErrorRate {
    ErrorRate {
        burst: errors,
        interval: 0,
    }
}

fn frame(node: usize, length: u64) -> Frame {
    Frame {
        node,
        length,
        shortest: length,
        count: 1,
    }
}

#[test]
fn nodes_that_request_at_once_have_the_published_answers() {
    // Each node has one message. In a window, none comes twice.
    let lengths = [135, 75, 95, 135, 65, 115];
    let frames = (0..).zip(lengths).map(|(node, length)| frame(node, length));
    let window = Competition {
        frames: frames.collect(),
        reactions: vec![Reaction::default(); lengths.len()],
        bit_time: 1,
    };
    let streams: Vec<can::Message> = lengths
        .iter()
        .map(|length| can::Message {
            name: String::new(),
            length: *length,
            period: 1_000_000,
            deadline: 0,
            jitter: 0,
        })
        .collect();
    for errors in 0..4 {
        for index in 0..lengths.len() {
            // A less urgent frame that is destroyed is not sent again before this one.
            let published = can::response(&streams, index, 1, burst(errors)).unwrap();
            assert_eq!(
                window.response(index, burst(errors)),
                Some(published),
                "{index} with {errors}"
            );
        }
    }
}

#[test]
fn each_reaction_lets_a_less_urgent_frame_in() {
    // Worked out by hand. The second node's reaction of 60 bits is over when a winner of 100 bits ends, the
    // first one's of 200 bits is not: 87 of its bits pass behind the arbitration.
    let window = Competition {
        frames: vec![
            frame(0, 100),
            frame(1, 100),
            frame(0, 100),
            frame(2, 120),
            frame(2, 80),
        ],
        reactions: [(10, 200), (20, 60), (0, 0)]
            .map(|(first, next)| Reaction { first, next })
            .into(),
        bit_time: 1,
    };
    let of = |index, errors| window.response(index, burst(errors)).unwrap();
    // The first request and the longest less urgent frame of another node.
    assert_eq!(of(0, 0), 10 + 120 + 100);
    assert_eq!(of(1, 0), 20 + 120 + 100 + 100);
    // It waits for the frame of its own node and its reaction, and for the other node's and the rest of the
    // reaction. Before the first request and in each absence a less urgent frame may begin; there are two.
    assert_eq!(of(2, 0), 10 + (100 + 200) + (100 + 113) + (120 + 80) + 100);
    assert_eq!(of(4, 0), 3 * 100 + 120 + 80);
    // An error: 31 bits, the reaction, and the frame once more. The longest less urgent one may be that which was
    // destroyed, so it gets in again.
    assert_eq!(of(0, 1), of(0, 0) + 31 + 200 + 100 + 120);
    assert_eq!(of(4, 1), of(4, 0) + 31 + 120);
}

#[test]
fn errors_faster_than_they_pass_have_no_bound() {
    let window = Competition {
        frames: vec![frame(0, 100)],
        reactions: vec![Reaction::default()],
        bit_time: 1,
    };
    let every = |interval| ErrorRate { burst: 1, interval };
    assert_eq!(window.response(0, every(100)), None);
    // 100 bits; with one error 231, with two 362: no third comes in 400.
    assert_eq!(window.response(0, every(200)), Some(362));
}

/// A number below `end`.
fn below(random: &mut ChaCha8Rng, end: u64) -> u64 {
    random.next_u64() % end
}

/// A time from `least` to `most`, and often the longest.
fn up_to(random: &mut ChaCha8Rng, least: u64, most: u64) -> u64 {
    match below(random, 3) {
        0 => least + below(random, most - least + 1),
        _ => most,
    }
}

/// A node of the simulated window: its frames that wait, and the one in its controller.
#[derive(Default, Clone)]
struct Node {
    waiting: Vec<usize>,
    mailbox: Option<usize>,
    /// When it requests the next frame.
    ready: u64,
}

/// A frame on the bus: what it is, when the bus is free again, and when its node's attempt ends.
struct OnBus {
    frame: usize,
    free: u64,
    destroyed: bool,
}

/// The end of each message's last frame of those that wait when the window opens; 0 for a message without
/// one.
fn simulated(window: &Competition, mut errors: u64, random: &mut ChaCha8Rng) -> Vec<u64> {
    let mut nodes: Vec<Node> = window
        .reactions
        .iter()
        .map(|reaction| Node {
            ready: up_to(random, 0, reaction.first),
            ..Node::default()
        })
        .collect();
    let mut ends = vec![0; window.frames.len()];
    let mut measured = vec![0; window.frames.len()];
    // Frames that are put later: when and which.
    let mut later: Vec<(u64, usize)> = Vec::new();
    for (at, frame) in window.frames.iter().enumerate() {
        for _ in 0..frame.count {
            if below(random, 4) == 0 {
                later.push((below(random, 1000), at));
            } else {
                nodes[frame.node].waiting.push(at);
                measured[at] += 1;
            }
        }
    }
    let mut on_bus: Option<OnBus> = None;
    let mut left = window.frames.iter().map(|frame| frame.count).sum::<u64>();
    let mut now = 0;
    while left > 0 {
        if on_bus.as_ref().is_some_and(|on_bus| on_bus.free == now) {
            let OnBus {
                frame, destroyed, ..
            } = on_bus.take().unwrap();
            if !destroyed {
                left -= 1;
                if measured[frame] > 0 {
                    measured[frame] -= 1;
                    ends[frame] = now;
                }
            }
        }
        later.retain(|(put, frame)| {
            let due = *put == now;
            if due {
                nodes[window.frames[*frame].node].waiting.push(*frame);
            }
            !due
        });
        for node in &mut nodes {
            if node.ready <= now && node.mailbox.is_none() && !node.waiting.is_empty() {
                node.waiting.sort_unstable();
                node.mailbox = Some(node.waiting.remove(0));
            }
        }
        if on_bus.is_none() {
            on_bus = arbitrate(window, &mut nodes, now, &mut errors, random);
        }
        now += 1;
    }
    ends
}

/// The most urgent frame begins, and an error may destroy it. The attempts of the others end.
fn arbitrate(
    window: &Competition,
    nodes: &mut [Node],
    now: u64,
    errors: &mut u64,
    random: &mut ChaCha8Rng,
) -> Option<OnBus> {
    let winner = nodes.iter().filter_map(|node| node.mailbox).min()?;
    let of = window.frames[winner];
    let length = up_to(random, of.shortest, of.length);
    // Mostly in the last bit, so that it takes longest.
    let error =
        (*errors > 0 && below(random, 3) == 0).then(|| up_to(random, 1, length - INTERFRAME));
    *errors -= u64::from(error.is_some());
    let free = match error {
        Some(error) => error + up_to(random, 17, 31),
        None => length,
    };
    for (number, node) in nodes.iter_mut().enumerate() {
        let Some(frame) = node.mailbox.take() else {
            continue;
        };
        let next = up_to(random, 0, window.reactions[number].next);
        if frame != winner {
            node.waiting.push(frame);
            let lost = up_to(random, 1, 13.min(error.unwrap_or(13)));
            node.ready = now + lost + next;
        } else if let Some(error) = error {
            node.waiting.push(frame);
            // Its controller reports the error at once, or behind the error frame.
            node.ready = now + up_to(random, error, free - INTERFRAME) + next;
        } else {
            node.ready = now + length - INTERFRAME + next;
        }
    }
    Some(OnBus {
        frame: winner,
        free: now + free,
        destroyed: error.is_some(),
    })
}

#[test]
fn no_simulated_frame_of_a_window_ends_behind_its_bound() {
    let mut random = ChaCha8Rng::seed_from_u64(1994);
    let (mut close, mut judged, mut disturbed) = (0_u32, 0_u32, 0_u32);
    for _ in 0..2000 {
        let nodes = 1 + below(&mut random, 4) as usize;
        let count = 1 + below(&mut random, 7) as usize;
        let fast = below(&mut random, 3) == 0;
        let window = Competition {
            frames: (0..count)
                .map(|_| {
                    let shortest = 47 + 8 * below(&mut random, 9);
                    Frame {
                        node: below(&mut random, nodes as u64) as usize,
                        length: shortest + below(&mut random, 25),
                        shortest,
                        count: if below(&mut random, 5) == 0 { 2 } else { 1 },
                    }
                })
                .collect(),
            reactions: (0..nodes)
                .map(|_| Reaction {
                    first: below(&mut random, 60),
                    next: if fast { 0 } else { below(&mut random, 150) },
                })
                .collect(),
            bit_time: 1,
        };
        let errors = below(&mut random, 4);
        let bounds: Vec<u64> = (0..count)
            .map(|at| window.response(at, burst(errors)).unwrap())
            .collect();
        let mut longest = vec![0; count];
        for _ in 0..60 {
            let ends = simulated(&window, errors, &mut random);
            for (at, end) in ends.into_iter().enumerate() {
                assert!(
                    end <= bounds[at],
                    "{at}: {end} of {bounds:?}, {errors} errors: {window:#?}"
                );
                longest[at] = longest[at].max(end);
            }
        }
        for (bound, seen) in bounds.iter().zip(&longest) {
            judged += 1;
            close += u32::from(10 * seen >= 8 * bound);
            disturbed += u32::from(errors > 0 && 10 * seen >= 8 * bound);
        }
    }
    // The simulation comes close enough to the bounds to find one that is too small.
    assert!(
        close > judged / 4 && disturbed > judged / 10,
        "{close} and {disturbed} of {judged}"
    );
}
