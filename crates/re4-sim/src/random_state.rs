//! The part of numpy's legacy generator `RandomState`, which `np.random.seed` and the functions of `np.random` use, that
//! scenes need: Matsumoto and Nishimura 1998 (MT19937), Marsaglia's polar method for normal numbers.

use rand_mt::Mt;

/// numpy's `RandomState(seed)`; also its global generator after `np.random.seed(seed)`.
pub(crate) struct RandomState {
    words: Mt,
    /// The second number of the last pair of normal numbers.
    kept_normal: Option<f64>,
}

impl RandomState {
    pub(crate) fn new(seed: u32) -> Self {
        Self {
            words: Mt::new(seed),
            kept_normal: None,
        }
    }

    /// `randint(low, high)`: masks 32 bits to the next power of two and samples again while the result is too large.
    pub(crate) fn integer(&mut self, low: u32, high: u32) -> u32 {
        let maximum = high - 1 - low;
        let mask = u32::MAX >> maximum.leading_zeros();
        loop {
            let value = self.words.next_u32() & mask;
            if value <= maximum {
                return low + value;
            }
        }
    }

    /// `random()`: a number in `[0, 1)` with 53 random bits, from two words.
    pub(crate) fn unit(&mut self) -> f64 {
        let high = f64::from(self.words.next_u32() >> 5);
        let low = f64::from(self.words.next_u32() >> 6);
        (high * 67_108_864.0 + low) / 9_007_199_254_740_992.0
    }

    /// `uniform(low, high)`.
    pub(crate) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// `randn()`: the polar method gives two numbers. As in numpy, the second one is returned and the first one is kept for
    /// the next call, even if other numbers are sampled in between.
    pub(crate) fn standard_normal(&mut self) -> f64 {
        if let Some(kept) = self.kept_normal.take() {
            return kept;
        }
        loop {
            let x = 2.0 * self.unit() - 1.0;
            let y = 2.0 * self.unit() - 1.0;
            let squared = x * x + y * y;
            if squared < 1.0 && squared != 0.0 {
                let factor = (-2.0 * squared.ln() / squared).sqrt();
                self.kept_normal = Some(factor * x);
                return factor * y;
            }
        }
    }
}
