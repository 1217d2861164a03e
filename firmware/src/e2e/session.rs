//! The key of a session, which makes the tags of a run differ from those of every other run.
//!
//! The system time of a run says nothing of other runs: it begins anew whenever the network does. Who has
//! recorded references and commands of one run could play them to a network that has just begun, whose
//! time they have not reached yet. So each node that obeys commands has a number of its own for each of
//! its starts ([`sled_common::starts`]), which no other start of it has, and tells it on the bus. All who seal or
//! judge commands make the session's key from the network's key and these numbers. A command from
//! before the last start of an actuator was sealed by another key, so the actuator refuses it.
//!
//! The numbers need no tag. Who forges one makes those who hear it disagree with the node that has it: its commands are
//! refused, the actuators stop, and the next true number ends that. Nobody gets old commands obeyed by it, as
//! each node that obeys makes its key from its own number, whatever is on the bus.
//!
//! The chain of keys is that of a key derivation by a pseudorandom function (NIST SP 800-108r1, 4): the next key is
//! SipHash-2-4 under the last one of place and number, once for each half, under identifiers that no message has.

use super::secret::Secret;

/// Sender and receivers of one kind of commands, of which `N` nodes obey them. Places are those of the nodes in
/// an order that all of them have.
#[derive(Clone, Copy, Debug)]
pub struct Session<const N: usize> {
    network: Secret,
    starts: [Option<u32>; N],
}

impl<const N: usize> Session<N> {
    /// Nothing is known but the secret of the network.
    pub const fn new(network: Secret) -> Self {
        Self {
            network,
            starts: [None; N],
        }
    }

    /// A node at `place` has begun its start number `start`, as it says itself; 0 is none. Returns whether that
    /// changes the session. A node calls this with its own number once, and never with what others say it were.
    pub fn hear(&mut self, place: usize, start: u32) -> bool {
        let start = (start != 0).then_some(start);
        match self.starts.get_mut(place) {
            Some(known) if *known != start => {
                *known = start;
                true
            }
            _ => false,
        }
    }

    /// The secret by which frames are sealed and judged; `None` as long as a number is not known. Without a key
    /// there are no sessions.
    pub fn secret(&self) -> Option<Secret> {
        let Secret::Key(network) = self.network else {
            return Some(self.network);
        };
        let mut key = network;
        // loop-bound: 2
        for (place, start) in self.starts.iter().enumerate() {
            key = key.of_start(place as u32, (*start)?);
        }
        Some(Secret::Key(key))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::e2e::Key;
    use proptest::prelude::*;

    const SECRET: Secret = Secret::Key(Key::new(*b"a secret of 16 b"));

    fn session(starts: [u32; 2]) -> Session<2> {
        let mut session = Session::new(SECRET);
        for (place, start) in starts.into_iter().enumerate() {
            session.hear(place, start);
        }
        session
    }

    #[test]
    fn all_numbers_have_to_be_known() {
        let mut session = Session::<2>::new(SECRET);
        assert_eq!(session.secret(), None);
        assert!(session.hear(1, 7));
        assert!(!session.hear(1, 7));
        assert_eq!(session.secret(), None);
        assert!(session.hear(0, 3));
        assert!(matches!(session.secret(), Some(Secret::Key(_))));
        // Nobody starts for the zeroth time.
        assert!(session.hear(0, 0));
        assert_eq!(session.secret(), None);
        // A place that is none.
        assert!(!session.hear(2, 1));
    }

    #[test]
    fn without_a_good_key_there_is_no_session() {
        for secret in [Secret::None, Secret::Damaged] {
            let mut session = Session::<2>::new(secret);
            assert_eq!(session.secret(), Some(secret));
            session.hear(0, 1);
            assert_eq!(session.secret(), Some(secret));
        }
    }

    proptest! {
        #[test]
        fn other_numbers_make_another_key(one: [u32; 2], other: [u32; 2]) {
            prop_assume!(one != other && !one.contains(&0) && !other.contains(&0));
            prop_assert_ne!(session(one).secret(), session(other).secret());
            prop_assert_ne!(session(one).secret(), Some(SECRET));
        }
    }
}
