//! The node's SBP parser against the `sbp` crate, on libsbp's own packets.

use firmware::navigation::{Navigation, STEP, Station, Step, Update};
use firmware::sbp::{self, Fix, Message, Parser, Progress};
use proptest::prelude::*;
use serde::Deserialize;

#[derive(Deserialize)]
struct Packet {
    hex: String,
    r#type: String,
    len: usize,
}

impl Packet {
    fn bytes(&self) -> Vec<u8> {
        (0..self.hex.len())
            .step_by(2)
            .map(|at| u8::from_str_radix(&self.hex[at..at + 2], 16).expect("hex digits"))
            .collect()
    }
}

fn packets() -> Vec<Packet> {
    serde_json::from_str(include_str!("data/sbp_packets.json")).expect("the data file parses")
}

/// Result of the parser for a stream: type and message of each frame.
fn parse(parser: &mut Parser, bytes: &[u8]) -> Vec<(u16, Option<Message>)> {
    let mut found = Vec::new();
    for bytes in bytes.chunks(sbp::LOT) {
        parser.take(bytes.iter().copied());
        found.extend(frames(parser));
    }
    found
}

/// The frames among the bytes that the parser has taken.
fn frames(parser: &mut Parser) -> Vec<(u16, Option<Message>)> {
    let mut found = Vec::new();
    loop {
        match parser.next(1) {
            Progress::Frame(frame) => found.push((frame.kind(), sbp::decode(&frame))),
            Progress::More => {}
            Progress::Drained => return found,
        }
    }
}

/// A frame of this type.
fn frame_of(kind: u16, payload: &[u8]) -> Vec<u8> {
    let mut frame = vec![0x55];
    frame.extend(kind.to_le_bytes());
    frame.extend([1, 0, payload.len() as u8]);
    frame.extend(payload);
    let checksum = sbp::crc16(0, &frame[1..]);
    frame.extend(checksum.to_le_bytes());
    frame
}

/// The same frame, built by the `sbp` crate.
fn oracle(bytes: &[u8]) -> ::sbp::Sbp {
    ::sbp::iter_messages(bytes)
        .next()
        .expect("one message")
        .expect("that decodes")
}

/// Fix of a position, as libsbp's enumerations name it.
fn fix_of(name: &str) -> Fix {
    match name {
        "SinglePointPosition" | "SinglePointPositioning" => Fix::Single,
        "DifferentialGnss" | "Dgnss" => Fix::Differential,
        "FloatRtk" => Fix::Float,
        "FixedRtk" => Fix::Fixed,
        "DeadReckoning" => Fix::DeadReckoning,
        "SbasPosition" => Fix::Augmented,
        "Invalid" => Fix::None,
        other => panic!("the oracle knows a fix {other} that the test does not"),
    }
}

#[test]
#[expect(clippy::too_many_lines, reason = "one arm for each kind of message")]
fn every_packet_decodes_as_the_sbp_crate_says() {
    use ::sbp::Sbp;
    let packets = packets();
    assert_eq!(packets.len(), 68);
    for packet in &packets {
        let bytes = packet.bytes();
        let found = parse(&mut Parser::new(), &bytes);
        let [(kind, Some(message))] = found[..] else {
            panic!("{}: {found:?}", packet.hex);
        };
        let kind_said = u16::from_str_radix(packet.r#type.trim_start_matches("0x"), 16).unwrap();
        assert_eq!(kind, kind_said);
        assert_eq!(bytes.len(), packet.len + 8);
        match (message, oracle(&bytes)) {
            (Message::Time(ours), Sbp::MsgGpsTime(theirs)) => {
                assert_eq!(
                    (ours.week, ours.tow, ours.nanoseconds, ours.valid),
                    (
                        theirs.wn,
                        theirs.tow,
                        theirs.ns_residual,
                        theirs.flags & 7 != 0
                    )
                );
            }
            (Message::Time(ours), Sbp::MsgGpsTimeDepA(theirs)) => {
                assert_eq!(
                    (ours.week, ours.tow, ours.nanoseconds),
                    (theirs.wn, theirs.tow, theirs.ns_residual)
                );
            }
            (Message::PositionLlh(ours), Sbp::MsgPosLlh(theirs)) => {
                assert_eq!(
                    (ours.tow, ours.latitude, ours.longitude, ours.satellites),
                    (theirs.tow, theirs.lat, theirs.lon, theirs.n_sats)
                );
                let mode = theirs.fix_mode().expect("a known mode");
                assert_eq!(ours.fix, fix_of(&format!("{mode:?}")));
            }
            (Message::PositionLlh(ours), Sbp::MsgPosLlhDepA(theirs)) => {
                assert_eq!(
                    (ours.tow, ours.latitude, ours.longitude, ours.satellites),
                    (theirs.tow, theirs.lat, theirs.lon, theirs.n_sats)
                );
                let mode = theirs.fix_mode().expect("a known mode");
                assert_eq!(ours.fix, fix_of(&format!("{mode:?}")));
            }
            (Message::PositionNed(ours), Sbp::MsgBaselineNed(theirs)) => {
                assert_eq!(
                    (ours.tow, ours.north, ours.east, ours.down, ours.satellites),
                    (theirs.tow, theirs.n, theirs.e, theirs.d, theirs.n_sats)
                );
                let mode = theirs.fix_mode().expect("a known mode");
                assert_eq!(ours.fix, fix_of(&format!("{mode:?}")));
            }
            (Message::PositionNed(ours), Sbp::MsgBaselineNedDepA(theirs)) => {
                assert_eq!(
                    (ours.tow, ours.north, ours.east, ours.down, ours.satellites),
                    (theirs.tow, theirs.n, theirs.e, theirs.d, theirs.n_sats)
                );
                let mode = theirs.fix_mode().expect("a known mode");
                assert_eq!(ours.fix, fix_of(&format!("{mode:?}")));
            }
            (Message::VelocityNed(ours), Sbp::MsgVelNed(theirs)) => {
                assert_eq!(
                    (ours.tow, ours.north, ours.east, ours.down, ours.valid),
                    (
                        theirs.tow,
                        theirs.n,
                        theirs.e,
                        theirs.d,
                        theirs.flags & 7 != 0
                    )
                );
            }
            (Message::VelocityNed(ours), Sbp::MsgVelNedDepA(theirs)) => {
                assert_eq!(
                    (ours.tow, ours.north, ours.east, ours.down, ours.satellites),
                    (theirs.tow, theirs.n, theirs.e, theirs.d, theirs.n_sats)
                );
            }
            (Message::Heading(ours), Sbp::MsgBaselineHeading(theirs)) => {
                assert_eq!((ours.tow, ours.millidegrees), (theirs.tow, theirs.heading));
                let mode = theirs.fix_mode().expect("a known mode");
                assert_eq!(ours.fix, fix_of(&format!("{mode:?}")));
            }
            (Message::Heading(ours), Sbp::MsgBaselineHeadingDepA(theirs)) => {
                assert_eq!((ours.tow, ours.millidegrees), (theirs.tow, theirs.heading));
            }
            (Message::Heartbeat(ours), Sbp::MsgHeartbeat(theirs)) => assert_eq!(ours, theirs.flags),
            (ours, theirs) => panic!("{ours:?} is not {theirs:?}"),
        }
    }
}

/// A frame 0x0221 by the `sbp` crate, with roll and pitch in microdegrees.
fn orientation(roll: i32, pitch: i32, flags: u8) -> Vec<u8> {
    let message = ::sbp::messages::orientation::MsgOrientEuler {
        sender_id: Some(1),
        tow: 123_456,
        roll,
        pitch,
        yaw: -90_000_000,
        roll_accuracy: 0.1,
        pitch_accuracy: 0.2,
        yaw_accuracy: 0.5,
        flags,
    };
    ::sbp::to_vec(&message).expect("a frame")
}

/// What a station shows of roll and pitch.
fn orientations(bytes: &[u8]) -> Vec<sbp::Orientation> {
    let mut station = Station::new();
    let mut found = Vec::new();
    for bytes in bytes.chunks(sbp::LOT) {
        station.take(bytes.iter().copied());
        let mut step = Step::More;
        while step == Step::More {
            step = station.step_showing(0, |_| {}, |frame| found.extend(sbp::orientation(&frame)));
        }
    }
    found
}

#[test]
fn roll_and_pitch_are_those_of_the_sbp_crate() {
    for (roll, pitch) in [(0, 0), (5_250_000, -3_125_000), (i32::MIN, i32::MAX)] {
        for flags in 0..=u8::MAX {
            let bytes = orientation(roll, pitch, flags);
            let ::sbp::Sbp::MsgOrientEuler(theirs) = oracle(&bytes) else {
                panic!("another message");
            };
            let valid = theirs.ins_navigation_mode()
                == Ok(::sbp::messages::orientation::msg_orient_euler::InsNavigationMode::Valid);
            let expected = sbp::Orientation {
                tow: theirs.tow,
                roll: theirs.roll,
                pitch: theirs.pitch,
                valid,
            };
            assert_eq!(orientations(&bytes), [expected]);
        }
    }
    // Another length, and another message.
    assert_eq!(orientations(&frame_of(0x0221, &[0; 28])), []);
    assert_eq!(orientations(&frame_of(0x0222, &[0; 29])), []);
}

/// Places of the frames with a right checksum, found by a search that sees all bytes at once.
fn frames_of_the_whole(stream: &[u8]) -> Vec<std::ops::Range<usize>> {
    let padded = [stream, &[0; 263]].concat();
    frames_until_one_is_incomplete(&padded)
}

/// The same if nothing follows the stream: the search ends at a candidate whose end is missing.
fn frames_until_one_is_incomplete(stream: &[u8]) -> Vec<std::ops::Range<usize>> {
    let mut frames = Vec::new();
    let mut at = 0;
    while let Some(&first) = stream.get(at) {
        if first != 0x55 {
            at += 1;
            continue;
        }
        let rest = &stream[at..];
        let whole = rest.get(5).map(|&length| usize::from(length) + 8);
        let Some(frame) = whole.and_then(|whole| rest.get(..whole)) else {
            break;
        };
        let (covered, received) = frame.split_at(frame.len() - 2);
        if sbp::crc16(0, &covered[1..]).to_le_bytes() == received {
            frames.push(at..at + frame.len());
            at += frame.len();
        } else {
            at += 1;
        }
    }
    frames
}

/// Streams that a receiver's line may carry when something is wrong, by their names.
fn corpus() -> Vec<(String, Vec<u8>)> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/corpus");
    let files = std::fs::read_dir(folder).expect("the corpus is there");
    let files = files.map(|file| file.expect("an entry").path());
    let mut corpus: Vec<_> = files
        .filter(|path| path.extension().is_some_and(|end| end == "bin"))
        .map(|path| {
            let bytes = std::fs::read(&path).expect("it can be read");
            (path.display().to_string(), bytes)
        })
        .collect();
    corpus.sort();
    corpus
}

#[test]
fn every_stream_of_the_corpus_yields_what_a_look_at_the_whole_finds() {
    let corpus = corpus();
    assert_eq!(corpus.len(), 12);
    for (name, mut stream) in corpus {
        stream.extend([0; 263]);
        let expected: Vec<_> = frames_of_the_whole(&stream)
            .into_iter()
            .flat_map(|range| parse(&mut Parser::new(), &stream[range]))
            .collect();
        let mut parser = Parser::new();
        assert_eq!(
            format!("{:?}", parse(&mut parser, &stream)),
            format!("{expected:?}"),
            "{name}"
        );
        let counters = parser.counters();
        assert_eq!(counters.frames as usize, expected.len(), "{name}");
        assert!(counters.skipped as usize <= stream.len(), "{name}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// Taking bytes one by one finds the same frames as a search of the whole stream. After
    /// noise a frame is lost only if a candidate that begins in the noise and overlaps the
    /// frame happens to have a right checksum.
    #[test]
    fn a_frame_behind_any_bytes_is_found(
        noise in proptest::collection::vec(prop_oneof![Just(0x55u8), any::<u8>()], 0..400),
        which in 0usize..68,
    ) {
        let frame = packets()[which].bytes();
        let begin = noise.len();
        let mut stream = noise;
        stream.extend(&frame);
        stream.extend([0; 263]);
        let frames = frames_of_the_whole(&stream);
        let hidden = frames.iter().any(|found| found.start < begin && found.end > begin);
        prop_assert!(hidden || frames.contains(&(begin..begin + frame.len())));
        let expected: Vec<_> = frames
            .into_iter()
            .flat_map(|range| parse(&mut Parser::new(), &stream[range]))
            .collect();
        prop_assert_eq!(parse(&mut Parser::new(), &stream), expected);
    }

    /// A frame with a flipped bit is never accepted, costs no other frame, and is counted.
    #[test]
    fn a_flipped_bit_costs_one_frame(which in 0usize..68, at in any::<prop::sample::Index>(), bit in 0..8) {
        let packets = packets();
        let good = packets[which].bytes();
        let mut bad = good.clone();
        let at = at.index(bad.len());
        bad[at] ^= 1u8 << bit;
        let mut parser = Parser::new();
        let mut stream = good.clone();
        stream.extend(&bad);
        stream.extend(&good);
        stream.extend(&good);
        stream.extend([0; 263]);
        let found = parse(&mut parser, &stream);
        prop_assert_eq!(found.len(), 3);
        let counters = parser.counters();
        prop_assert_eq!(counters.frames, 3);
        prop_assert!(counters.skipped as usize >= bad.len());
    }

    /// Arbitrary payloads of the right type and any length decode or are refused, but do not
    /// panic.
    #[test]
    fn any_payload_is_survived(kind in any::<u16>(), payload in proptest::collection::vec(any::<u8>(), 0..=255)) {
        for kind in [kind, 0x0100, 0x0102, 0x0201, 0x0203, 0x0205, 0x0207, 0x020A, 0x020C, 0x020E, 0x020F, 0x0221, 0xFFFF] {
            let found = parse(&mut Parser::new(), &frame_of(kind, &payload));
            prop_assert!(matches!(found[..], [(of, _)] if of == kind));
            let wanted = usize::from(kind == 0x0221 && payload.len() == 29);
            prop_assert_eq!(orientations(&frame_of(kind, &payload)).len(), wanted);
        }
    }

    /// For any division of the bytes into lots, and any number of steps between two lots: the
    /// station's updates are those of the messages of the whole stream, in the same order.
    /// Every step except the last consumes its share of bytes. A pause of the line is reported
    /// when all bytes before it have been read.
    #[test]
    fn short_steps_do_what_a_look_at_the_whole_does(
        pieces in proptest::collection::vec(piece(), 1..24),
        lots in proptest::collection::vec((0usize..=128, 0usize..8, any::<bool>()), 1..40),
    ) {
        let stream = pieces.concat();
        let mut station = Station::new();
        let (mut puts, mut steps) = (Vec::new(), 0);
        let mut taken = 0;
        // The drawn lots may take nothing, or leave no room: the rest comes in large ones.
        let mut lots = lots.into_iter().chain(std::iter::repeat((128, 8, false)));
        while taken < stream.len() {
            let (lot, most, pause) = lots.next().expect("there is always one");
            let arrived = (taken + lot).min(stream.len());
            if pause {
                station.pause(arrived as u32);
            }
            // Bytes for which there is no room are offered again later.
            loop {
                let mut count = 0;
                let rest = stream[taken..arrived].iter().copied();
                let more = station.take(rest.inspect(|_| count += 1));
                taken += count;
                if !more {
                    break;
                }
                prop_assert_eq!(count, sbp::LOT);
            }
            for _ in 0..if pause { usize::MAX } else { most } {
                let step = station.step(0, |put| puts.push(put));
                steps += usize::from(step == Step::More);
                if step != Step::More {
                    prop_assert_eq!(matches!(step, Step::Paused(_)), pause);
                    break;
                }
            }
        }
        let mut last = station.step(0, |put| puts.push(put));
        while last == Step::More {
            steps += 1;
            last = station.step(0, |put| puts.push(put));
        }
        prop_assert!(steps <= stream.len() / STEP, "{steps} steps for {taken} bytes");
        prop_assert_eq!(puts, puts_of_the_whole(&stream));
    }
}

/// The updates that a stream's messages cause, found by a search that sees all bytes at once.
fn puts_of_the_whole(stream: &[u8]) -> Vec<Update> {
    let mut navigation = Navigation::new();
    let mut puts = Vec::new();
    // Nothing follows: a candidate whose end is missing holds back all bytes after it.
    for range in frames_until_one_is_incomplete(stream) {
        for (_, message) in parse(&mut Parser::new(), &stream[range]) {
            if let Some(message) = message {
                navigation.message(&message, 0, |put| puts.push(put));
            }
        }
    }
    puts
}

/// Part of a stream: a packet, whole, damaged or cut, or noise with many preambles.
fn piece() -> impl Strategy<Value = Vec<u8>> {
    let packet = || (0usize..68).prop_map(|which| packets()[which].bytes());
    let noise = prop_oneof![Just(0x55u8), any::<u8>()];
    prop_oneof![
        4 => packet(),
        1 => (packet(), any::<prop::sample::Index>(), 0..8).prop_map(|(mut packet, at, bit)| {
            let at = at.index(packet.len());
            packet[at] ^= 1u8 << bit;
            packet
        }),
        1 => (packet(), any::<prop::sample::Index>()).prop_map(|(mut packet, at)| {
            packet.truncate(at.index(packet.len()));
            packet
        }),
        1 => proptest::collection::vec(noise, 0..300),
    ]
}
