//! The order in which swaths are driven.

use super::swaths::{Piece, place};
use super::{Options, Order, Swath};
use crate::place::Local;

/// The numbers 0 to `count` in an order in which two neighbours differ by at least `apart`, if there are at least 2 `apart` + 1; with
/// fewer, by as much as they can.
pub(super) fn skipping(count: usize, apart: usize) -> Vec<usize> {
    if apart <= 1 {
        return (0..count).collect();
    }
    let group = 2 * apart + 1;
    let mut order = Vec::with_capacity(count);
    let mut first = 0;
    while first < count {
        let rest = count - first;
        // The last group takes what would make no group of its own.
        let size = if rest >= 2 * group { group } else { rest };
        let half = size.div_ceil(2);
        for index in 0..half {
            order.push(first + index);
            order.extend((index + half < size).then_some(first + index + half));
        }
        first += size;
    }
    order
}

/// Pieces that lie beside each other as a whole, as lists of their numbers by track.
fn blocks(pieces: &[Piece]) -> Vec<Vec<usize>> {
    let beside = |one: &Piece, other: &Piece| {
        one.track + 1 == other.track && one.from < other.to && other.from < one.to
    };
    // Pieces are sorted by track: those of the next one are near.
    let after = |one: usize| {
        let near = pieces.iter().enumerate().skip(one + 1);
        let near = near.take_while(move |(_, other)| other.track <= pieces[one].track + 1);
        near.filter(move |(_, other)| beside(&pieces[one], other))
            .map(|(index, _)| index)
    };
    let mut count_before = vec![0; pieces.len()];
    for one in 0..pieces.len() {
        for other in after(one) {
            count_before[other] += 1;
        }
    }
    let only = |one: usize| {
        let mut others = after(one);
        let other = others.next()?;
        (others.next().is_none() && count_before[other] == 1).then_some(other)
    };
    let next: Vec<Option<usize>> = (0..pieces.len()).map(only).collect();
    let mut is_next = vec![false; pieces.len()];
    for other in next.iter().flatten() {
        is_next[*other] = true;
    }
    let firsts = (0..pieces.len()).filter(|index| !is_next[*index]);
    firsts
        .map(|first| std::iter::successors(Some(first), |index| next[*index]).collect())
        .collect()
}

/// A way through a block: from, to and track of its pieces.
type Way = Vec<(Local, Local, usize)>;

/// The way that takes pieces in an order, counted from the last one or not, the first of them backwards or not.
fn way(pieces: &[&Piece], bearing: f64, order: &[usize], from_last: bool, back: bool) -> Way {
    let mut way = Vec::with_capacity(order.len());
    for (turn, index) in order.iter().enumerate() {
        let index = if from_last {
            pieces.len() - 1 - index
        } else {
            *index
        };
        let piece = pieces[index];
        let ends = (
            place(piece.from, piece.right, bearing),
            place(piece.to, piece.right, bearing),
        );
        let (from, to) = match back == (turn % 2 == 1) {
            true => ends,
            false => (ends.1, ends.0),
        };
        way.push((from, to, piece.track));
    }
    way
}

/// All pieces in driving order.
pub(super) fn ordered(pieces: &[Piece], bearing: f64, options: &Options) -> Vec<Swath> {
    let apart = match options.order {
        Order::Neighbouring => 1,
        Order::Skip => (2.0 * options.radius / options.width - 1e-9)
            .ceil()
            .max(1.0) as usize,
    };
    let mut blocks: Vec<Vec<&Piece>> = blocks(pieces)
        .into_iter()
        .map(|block| block.into_iter().map(|index| &pieces[index]).collect())
        .collect();
    let mut here = options.start;
    let mut swaths = Vec::with_capacity(pieces.len());
    let mut number = 0;
    while !blocks.is_empty() {
        let mut best: Option<(f64, usize, Way)> = None;
        for (index, block) in blocks.iter().enumerate() {
            let order = skipping(block.len(), apart);
            for (from_last, back) in [(false, false), (false, true), (true, false), (true, true)] {
                let first = if from_last {
                    block.len() - 1 - order[0]
                } else {
                    order[0]
                };
                let along = if back {
                    block[first].to
                } else {
                    block[first].from
                };
                let begin = place(along, block[first].right, bearing);
                let far = here.map_or(0.0, |here| here.distance(begin));
                if best.as_ref().is_none_or(|(least, ..)| far < *least) {
                    best = Some((far, index, way(block, bearing, &order, from_last, back)));
                }
            }
        }
        let Some((_, index, way)) = best else { break };
        blocks.swap_remove(index);
        here = way.last().map(|(_, to, _)| *to);
        swaths.extend(way.into_iter().map(|(from, to, track)| Swath {
            from,
            to,
            track,
            block: number,
        }));
        number += 1;
    }
    swaths
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skipped_swaths_are_far_enough_apart() {
        assert_eq!(skipping(5, 2), [0, 3, 1, 4, 2]);
        assert_eq!(skipping(4, 1), [0, 1, 2, 3]);
        for apart in 1..8 {
            for count in 0..120 {
                let order = skipping(count, apart);
                let mut sorted = order.clone();
                sorted.sort_unstable();
                assert!(sorted.into_iter().eq(0..count), "{order:?}");
                if count > 2 * apart {
                    let near = order.windows(2).map(|pair| pair[0].abs_diff(pair[1])).min();
                    assert!(near >= Some(apart), "{count} {apart}: {order:?}");
                }
            }
        }
    }

    #[test]
    fn a_hole_makes_four_blocks() {
        let piece = |track: usize, from, to| Piece {
            track,
            right: track as f64,
            from,
            to,
        };
        let pieces = [
            piece(0, 0.0, 9.0),
            piece(1, 0.0, 9.0),
            piece(2, 0.0, 3.0),
            piece(2, 6.0, 9.0),
            piece(3, 0.0, 3.0),
            piece(3, 6.0, 9.0),
            piece(4, 0.0, 9.0),
        ];
        assert_eq!(
            blocks(&pieces),
            [vec![0, 1], vec![2, 4], vec![3, 5], vec![6]]
        );
    }
}
