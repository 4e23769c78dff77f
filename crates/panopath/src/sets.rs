//! Sets that grow together (union and find), each known by its smallest member.

/// Disjoint sets of things that are numbered from zero.
pub(crate) struct Sets(Vec<u32>);

impl Sets {
    /// Each thing by itself.
    pub fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }

    /// The set that a thing is in.
    pub fn find(&mut self, of: usize) -> usize {
        let mut at = of;
        while self.0[at] as usize != at {
            // halves the path on the way
            self.0[at] = self.0[self.0[at] as usize];
            at = self.0[at] as usize;
        }
        at
    }

    /// Makes one set of two; true where they were apart.
    pub fn join(&mut self, a: usize, b: usize) -> bool {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b)] = a.min(b) as u32;
        a != b
    }
}
