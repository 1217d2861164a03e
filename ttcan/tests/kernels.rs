//! The kernels of the benchmark run the events that they are named for.

#[path = "../benches/kernels.rs"]
#[expect(unreachable_pub, reason = "the benchmark's programs share the file")]
mod kernels;

use kernels::{Event, Guarded, few, many, watch};

#[test]
fn every_event_comes_about() {
    for event in [
        Event::ReceiveMessage,
        Event::ReceiveReference,
        Event::TransmitWindow,
    ] {
        assert!(few(event).unwrap().run(), "8 windows, {event:?}");
        assert!(many(event).unwrap().run(), "512 windows, {event:?}");
    }
}

#[test]
fn every_event_of_a_guardian_comes_about() {
    for event in [
        Guarded::Rest,
        Guarded::Begin,
        Guarded::Follow,
        Guarded::BeginAll,
        Guarded::FollowAll,
        Guarded::Ahead,
        Guarded::Message,
        Guarded::Reference,
    ] {
        assert!(watch(event).unwrap().run(), "{event:?}");
    }
}
