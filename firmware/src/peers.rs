//! What a node sees of the other nodes (thesis 4.3.7): the first of them that is dead, lost or
//! babbles, for an operator.

use ttcan::Health;

use crate::text::Text;

/// A node that does not do its part on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub struct Trouble {
    /// Its number in the network.
    pub node: u8,
    /// Its failure class.
    pub health: Health,
    /// How many more there are.
    pub others: u8,
}

impl Trouble {
    /// The trouble among the nodes of a network, by the health of each; `None` if there is none.
    pub fn among<const N: usize>(health: &[Health; N]) -> Option<Self> {
        const { assert!(N <= 8, "the loop is bounded for eight nodes") };
        let mut found: Option<Self> = None;
        // loop-bound: 8. One turn for each node.
        for (node, health) in health.iter().enumerate() {
            if matches!(health, Health::Unknown | Health::Healthy) {
                continue;
            }
            match &mut found {
                Some(trouble) => trouble.others = trouble.others.saturating_add(1),
                None => {
                    found = Some(Self {
                        node: node as u8,
                        health: *health,
                        others: 0,
                    });
                }
            }
        }
        found
    }

    /// With the name of the node, of these by their numbers.
    pub fn named(self, names: &[&'static str]) -> Named {
        let name = names.get(usize::from(self.node)).copied();
        Named {
            trouble: self,
            name: name.unwrap_or("?"),
        }
    }
}

/// A trouble as people read it.
#[derive(Clone, Copy, Debug)]
pub struct Named {
    /// What it is.
    pub trouble: Trouble,
    /// Name of the node.
    pub name: &'static str,
}

impl Named {
    /// Writes it: `drive dead +1`.
    pub fn write<const N: usize>(&self, text: &mut Text<N>) {
        text.str(self.name);
        text.str(match self.trouble.health {
            Health::Unknown => " unknown",
            Health::Healthy => " healthy",
            Health::Dead => " dead",
            Health::Lost => " lost",
            Health::Babbling => " babbling",
            Health::Masquerade => " masquerade",
        });
        if self.trouble.others > 0 {
            text.str(" +").unsigned(u32::from(self.trouble.others));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_in_trouble_is_named_and_the_others_are_counted() {
        let healthy = [Health::Unknown, Health::Healthy, Health::Healthy];
        assert_eq!(Trouble::among(&healthy), None);
        let trouble = Trouble {
            node: 1,
            health: Health::Lost,
            others: 1,
        };
        let found = Trouble::among(&[Health::Healthy, Health::Lost, Health::Dead]);
        assert_eq!(found, Some(trouble));
        let mut text = Text::<20>::new();
        trouble.named(&["gps", "controller"]).write(&mut text);
        assert_eq!(text.as_bytes(), b"controller lost +1");
    }
}
