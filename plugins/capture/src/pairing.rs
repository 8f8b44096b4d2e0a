//! Decides which frames of several live views belong together.

/// What to do with the waiting frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Pairing {
    /// Take one frame of each view, by its index in the view's list: the newest ones that belong together.
    Take {
        /// Index in the list of each view.
        indices: Vec<usize>,
        /// Time between the first and the last of them, ns.
        skew_ns: i64,
    },
    /// Drop what arrived before these times, one for each view, ns: no partner can follow any more.
    Skip {
        /// Time for each view.
        before_ns: Vec<i64>,
    },
    /// Wait: a partner may still arrive.
    Wait,
}

/// Result of grabbing one frame of every view.
#[derive(Debug, PartialEq, Eq)]
pub enum Grabbed {
    /// No view is lost. A silent live view may have no frame.
    Ready,
    /// A view has no more frames.
    End,
    /// A view ended before the promised number of frames.
    Failed(String),
    /// Devices or streams are gone, or the frames of the views do not belong together; the text says what happened. Views with `is_there` still have
    /// a frame.
    Lost(String),
}

/// Pairs frames by their arrival. `arrivals`: times of each view's waiting frames, oldest first, ns. Frames further apart than `tolerance_ns` do not
/// belong together.
pub fn pair(arrivals: &[Vec<i64>], tolerance_ns: i64) -> Pairing {
    // The view whose newest picture is oldest decides: the others are at least as far.
    let newest = arrivals.iter().enumerate().filter_map(|(view, times)| Some((view, *times.last()?)));
    let Some((slowest, last_ns)) = newest.clone().min_by_key(|(_, time)| *time) else { return Pairing::Wait };
    if newest.count() < arrivals.len() {
        return Pairing::Wait;
    }
    for (anchor, time) in arrivals[slowest].iter().enumerate().rev() {
        let nearest = |times: &Vec<i64>| {
            times.iter().enumerate().min_by_key(|(_, other)| other.abs_diff(*time)).map_or(0, |(index, _)| index)
        };
        let mut indices: Vec<usize> = arrivals.iter().map(nearest).collect();
        indices[slowest] = anchor;
        let chosen = || arrivals.iter().zip(&indices).map(|(times, index)| times[*index]);
        let skew_ns = chosen().max().unwrap_or(0) - chosen().min().unwrap_or(0);
        if skew_ns <= tolerance_ns {
            return Pairing::Take { indices, skew_ns };
        }
    }
    // Later pictures of the slowest view are later than its last one.
    let mut before_ns = vec![last_ns.saturating_sub(tolerance_ns); arrivals.len()];
    // Its own may still get a partner only where no other view is past them.
    let past_ns = arrivals.iter().filter_map(|times| times.last()).max().copied().unwrap_or(0);
    before_ns[slowest] =
        if past_ns > last_ns { last_ns.saturating_add(1) } else { last_ns.saturating_sub(tolerance_ns) };
    let is_any =
        arrivals.iter().zip(&before_ns).any(|(times, before)| times.first().is_some_and(|first| first < before));
    if is_any { Pairing::Skip { before_ns } } else { Pairing::Wait }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(indices: &[usize], skew_ns: i64) -> Pairing {
        Pairing::Take { indices: indices.to_vec(), skew_ns }
    }

    #[test]
    fn the_newest_pair_within_the_tolerance_is_taken() {
        assert_eq!(pair(&[vec![0, 33, 66], vec![2, 35]], 16), take(&[1, 1], 2));
        assert_eq!(pair(&[vec![100], vec![90]], 16), take(&[0, 0], 10));
        assert_eq!(pair(&[vec![10, 20]], 16), take(&[1], 0));
        // The newest of one has no partner, the one before has.
        assert_eq!(pair(&[vec![100, 133], vec![102, 160]], 16), take(&[0, 0], 2));
        // Three views: all within the tolerance of each other.
        assert_eq!(pair(&[vec![100], vec![112], vec![88]], 16), Pairing::Skip { before_ns: vec![72, 72, 89] });
        assert_eq!(pair(&[vec![100], vec![108], vec![92]], 16), take(&[0, 0, 0], 16));
    }

    #[test]
    fn a_picture_waits_only_while_a_partner_may_come() {
        assert_eq!(pair(&[vec![], vec![5]], 16), Pairing::Wait);
        assert_eq!(pair(&[vec![0], vec![]], 16), Pairing::Wait);
        // The right view is past 0 + 16: the left picture is lost, the right one waits.
        assert_eq!(pair(&[vec![0], vec![33]], 16), Pairing::Skip { before_ns: vec![1, -16] });
        assert_eq!(pair(&[vec![], vec![33]], 16), Pairing::Wait);
        // A view that comes back late pairs with what is new only.
        assert_eq!(pair(&[vec![1000, 1033, 1066], vec![1069]], 16), take(&[2, 0], 3));
    }

    /// Two cameras with drift, jitter and drops: all pairs are the nearest ones, and no frame is used twice or out of order.
    #[test]
    fn drifting_views_with_drops_are_paired_nearest() {
        let mut chance = panoscope_node::random::SplitMix64(5);
        let (mut waiting, mut skews) = ([Vec::new(), Vec::new()], Vec::new());
        let (mut last, mut pairs) = ([i64::MIN; 2], 0);
        for index in 0..3000_i64 {
            for (view, period) in [(0, 33_333), (1, 33_400)] {
                if chance.below(20) > 0 {
                    waiting[view].push(index * period + chance.below(2000) as i64);
                }
            }
            loop {
                match pair(&waiting, 16_666) {
                    Pairing::Wait => break,
                    Pairing::Take { indices, skew_ns } => {
                        for view in 0..2 {
                            let time = waiting[view][indices[view]];
                            assert!(time > last[view]);
                            last[view] = time;
                            waiting[view].drain(..=indices[view]);
                        }
                        assert!((last[0] - last[1]).abs() == skew_ns && skew_ns <= 16_666);
                        skews.push(skew_ns);
                        pairs += 1;
                    }
                    Pairing::Skip { before_ns } => {
                        for view in 0..2 {
                            waiting[view].retain(|time| *time >= before_ns[view]);
                        }
                    }
                }
            }
        }
        assert!(pairs > 2500, "{pairs}");
        // The second view ends six periods ahead of the first, and its pictures wait.
        assert!(waiting.iter().all(|times| times.len() < 10), "{waiting:?}");
    }
}
