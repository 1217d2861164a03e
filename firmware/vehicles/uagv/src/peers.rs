//! What the controller sees of the other nodes.

#[cfg(feature = "f446")]
use firmware::link::{Link, Port, WindowTimer};
use ttcan::{Health, NodeId};

use crate::NODES;
use crate::messages::NodeHealth;

/// The failure class of each node, by its number.
pub type Peers = [Health; NODES];

/// The failure classes now. A node does not judge itself.
#[cfg(feature = "f446")]
pub fn of<P: Port, T: WindowTimer, const WINDOWS: usize>(
    link: &Link<P, T, WINDOWS, NODES>,
) -> Peers {
    let mut peers = [Health::Unknown; NODES];
    for (number, health) in (0..).zip(&mut peers) {
        *health = link.health(NodeId(number));
    }
    peers
}

/// The failure class of a node as the network names it.
pub fn health(peers: &Peers, node: NodeId) -> NodeHealth {
    match peers.get(usize::from(node.0)) {
        None | Some(Health::Unknown) => NodeHealth::Unknown,
        Some(Health::Healthy) => NodeHealth::Healthy,
        Some(Health::Dead) => NodeHealth::Dead,
        Some(Health::Lost) => NodeHealth::Lost,
        Some(Health::Babbling) => NodeHealth::Babbling,
        Some(Health::Masquerade) => NodeHealth::Masquerade,
    }
}
