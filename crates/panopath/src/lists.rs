//! Lists of things at each of many places, one after the other in memory.

/// Compressed lists: list `k` is `item[start[k]..start[k + 1]]`.
pub(crate) struct Lists {
    start: Vec<u32>,
    item: Vec<u32>,
}

impl Lists {
    /// Lists things by the place of each, in the order in which they come.
    pub fn new(n: usize, entries: impl Iterator<Item = (u32, u32)> + Clone) -> Self {
        let mut start = vec![0u32; n + 1];
        entries.clone().for_each(|(place, _)| start[place as usize + 1] += 1);
        for k in 0..n {
            start[k + 1] += start[k];
        }
        let mut next = start.clone();
        let mut item = vec![0; start[n] as usize];
        for (place, thing) in entries {
            let slot = &mut next[place as usize];
            item[*slot as usize] = thing;
            *slot += 1;
        }
        Self { start, item }
    }

    /// One list.
    pub fn of(&self, place: usize) -> &[u32] {
        &self.item[self.range(place)]
    }

    /// Where a list stands among all things.
    pub fn range(&self, place: usize) -> std::ops::Range<usize> {
        self.start[place] as usize..self.start[place + 1] as usize
    }

    /// All lists, one after the other.
    pub fn all(&self) -> &[u32] {
        &self.item
    }
}

/// The value that stands most often, the smaller of equals; negative values do not count.
pub(crate) fn most_common(values: impl Iterator<Item = i32>) -> Option<i32> {
    let mut counts = std::collections::BTreeMap::new();
    for value in values.filter(|&v| v >= 0) {
        *counts.entry(value).or_insert(0usize) += 1;
    }
    counts.into_iter().max_by_key(|&(value, n)| (n, std::cmp::Reverse(value))).map(|(value, _)| value)
}
