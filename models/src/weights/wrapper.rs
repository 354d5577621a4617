//! The prefix of names that a program of one's own put before those of the network.

use super::Shapes;
use std::collections::BTreeMap;

/// Prefixes of names, up to a dot, the ones with most names behind them first.
fn prefixes(names: &Shapes) -> Vec<&str> {
    let mut counts = BTreeMap::<&str, usize>::new();
    for name in names.keys() {
        for (dot, _) in name.match_indices('.') {
            *counts.entry(&name[..=dot]).or_default() += 1;
        }
    }
    let mut prefixes: Vec<(&str, usize)> = counts.into_iter().collect();
    prefixes.sort_by_key(|&(prefix, count)| (std::cmp::Reverse(count), prefix.len()));
    prefixes.into_iter().map(|(prefix, _)| prefix).collect()
}

/// The prefixes behind which there is a network: `behind` gives the names with their shapes that are left of those behind
/// a prefix, `is_network` whether they are one. None if there is one without a prefix.
pub(super) fn wrappers(
    names: &Shapes,
    behind: impl Fn(&str) -> Shapes,
    is_network: impl Fn(&Shapes) -> bool,
) -> Vec<&str> {
    if is_network(names) {
        return Vec::new();
    }
    let mut found = Vec::<&str>::new();
    for prefix in prefixes(names) {
        // What a known wrapper adds (`net.module.`) is the same network.
        let is_within = found.iter().any(|outer| prefix.starts_with(outer));
        if !is_within && is_network(&behind(prefix)) {
            found.push(prefix);
        }
    }
    found
}
