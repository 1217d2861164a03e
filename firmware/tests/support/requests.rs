//! The fuzz target of requests for a mission as a function of the fuzzer's bytes.

use control::mission::{End, Legs, check};
use control::position::Position;
use firmware::mission::Head;
use firmware::mission::transport::Sender;
use firmware::mission::upload::{Effect, Inbox, Job, Reason, Request, Session, Situation, WORDS};

#[path = "missions.rs"]
mod missions;
use missions::{northwards, settings};

/// Frames that the node reads in a basic cycle.
const FRAMES: usize = 10;

/// The frames of a mission of so many legs, in the blocks that the receiver grants.
fn upload(request: Request, legs: u8, curvature: f32) -> Vec<[u8; 8]> {
    let legs: Vec<_> = (0..legs.max(1))
        .map(|number| northwards(number.into(), curvature))
        .collect();
    let mission = Legs {
        origin: Position::new(1, 2),
        legs: &legs,
        fence: &[],
        obstacles: &[],
        end: End::Stop,
    };
    let head = u32::from_le_bytes([request.code(), 1, 0, 0]);
    let words = firmware::mission::words(&mission).into_iter().flatten();
    let message: Vec<u8> = std::iter::once(head)
        .chain(words)
        .flat_map(u32::to_le_bytes)
        .collect();
    let mut sender = Sender::new(&message);
    let mut frames = Vec::new();
    while !sender.is_done() {
        match sender.frame() {
            Some(frame) => frames.push(frame),
            None => sender
                .flow(&firmware::mission::transport::clear_to_send())
                .expect("it is clear to send"),
        }
    }
    frames
}

/// What a node does with requests: steps of a code, which says what the vehicle does, and eight bytes of a frame or of
/// a mission that is sent. Whatever comes, nothing is written, started or resumed in another situation than it may be,
/// and what is written can be driven.
///
/// # Panics
/// It is.
pub fn requests(data: &[u8]) {
    let Some((first, data)) = data.split_first() else {
        return;
    };
    let keyed = first & 1 != 0;
    let mut words = vec![0; WORDS];
    let mut session = Session::new(settings());
    let mut inbox = Inbox::default();
    let mut frames: std::collections::VecDeque<[u8; 8]> = std::collections::VecDeque::new();
    for step in data.chunks_exact(9) {
        let [code, bytes @ ..] = step else { continue };
        let bytes: [u8; 8] = bytes.try_into().expect("a step has nine bytes");
        let bit = |number: u8| code >> number & 1 != 0;
        let now = Situation {
            keyed,
            running: bit(0),
            idle: !bit(0) && !bit(1),
            moving: bit(2),
            paused: bit(0) && bit(3),
            there: bit(4),
            ready: bit(5),
            refused: (Reason::None, 0),
            number: bytes[7],
        };
        match code >> 6 {
            0 => frames.push_back(bytes),
            1 => {
                let request = if bytes[0] & 1 == 0 {
                    Request::Upload
                } else {
                    Request::Check
                };
                let curvature = f32::from(bytes[2]) * 0.002;
                let mut all = upload(request, bytes[1] % 16, curvature);
                let at = usize::from(bytes[3]) % all.len();
                match bytes[4] % 8 {
                    0 => drop(all.remove(at)),
                    1 => all[at][usize::from(bytes[5] % 8)] ^= bytes[6],
                    2 => all.truncate(at),
                    _ => {}
                }
                frames.extend(all);
            }
            2 => frames.push_back(firmware::mission::transport::single(&[
                bytes[0] % 9,
                bytes[1],
            ])),
            _ => frames.clear(),
        }
        // Two basic cycles.
        for _ in 0..2 {
            cycle(&mut session, &mut words, &mut inbox, &mut frames, &now);
        }
    }
}

fn cycle(
    session: &mut Session,
    words: &mut [u32],
    inbox: &mut Inbox,
    frames: &mut std::collections::VecDeque<[u8; 8]>,
    now: &Situation,
) {
    for frame in frames.drain(..frames.len().min(6)) {
        inbox.push(frame, 8);
    }
    for _ in 0..FRAMES {
        let Some((data, _)) = inbox.pop() else { break };
        match session.take(&data, words, now) {
            None => {}
            Some(Effect::Start) => assert!(!now.running && now.ready && !now.keyed),
            Some(Effect::Pause) => assert!(now.running && !now.keyed),
            Some(Effect::Resume) => assert!(now.running && now.paused && !now.keyed),
        }
    }
    let mut answers = 0;
    while session.answer().is_some() {
        answers += 1;
    }
    assert!(answers <= 4, "{answers} answers");
    for _ in 0..64 {
        session.step(words, now);
    }
    match session.tell(now) {
        None => {}
        Some(job) => {
            assert!(now.idle && !now.running && !now.moving && !now.keyed);
            if let Job::Store(length) = job {
                let record = &words[1..=length];
                let head = Head::read(record).expect("a whole record");
                assert_eq!(head.length(), length);
                assert!(check(&head.of(record), &settings()).is_ok());
            }
        }
    }
}
