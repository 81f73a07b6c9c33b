//! Statistics of features: minimum, maximum, mean, standard deviation and quantiles, by episode and over the dataset.
//!
//! Within an episode all figures are exact; quantiles are interpolated linearly, as numpy does by default. Over the dataset, quantiles
//! of numbers are those of a histogram with [`BINS`] bins between minimum and maximum, because the values are not held in memory.
//! Images have whole numbers from 0 to 255 in each channel, so their quantiles are those of a complete histogram.

use serde_json::{Map, Value, json};

use super::Data;
use crate::images;

/// The quantiles and their names in files.
pub(super) const QUANTILES: [(&str, f64); 5] = [("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)];

/// Bins of a histogram. The error of a quantile is at most the 65,536th part of the range.
const BINS: usize = 1 << 16;

/// Maximum number of images of an episode that enter the statistics, evenly spaced.
const SAMPLED: usize = 32;

/// Statistics of one feature.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Stats {
    /// Whether they are those of an image: one number per channel, written as `[3][1][1]`.
    pub(super) image: bool,
    pub(super) count: u64,
    pub(super) min: Vec<f64>,
    pub(super) max: Vec<f64>,
    pub(super) mean: Vec<f64>,
    pub(super) std: Vec<f64>,
    /// By quantile; empty if there are none.
    pub(super) quantiles: Vec<Vec<f64>>,
}

impl Stats {
    /// Names and values of all figures except the count.
    pub(super) fn figures(&self) -> impl Iterator<Item = (&'static str, &Vec<f64>)> {
        let names = QUANTILES.map(|(name, _)| name);
        [
            ("min", &self.min),
            ("max", &self.max),
            ("mean", &self.mean),
            ("std", &self.std),
        ]
        .into_iter()
        .chain(names.into_iter().zip(&self.quantiles))
    }

    pub(super) fn to_json(&self) -> Value {
        let mut object = Map::new();
        for (name, values) in self.figures() {
            let value = if self.image {
                values.iter().map(|value| json!([[value]])).collect()
            } else {
                json!(values)
            };
            object.insert(name.to_owned(), value);
        }
        object.insert("count".to_owned(), json!([self.count]));
        Value::Object(object)
    }
}

/// Statistics of the values of one feature in one episode. `width` is the number of values of a frame.
pub(super) fn of_numbers(values: &[f64], width: usize) -> Stats {
    let rows = values.len() / width.max(1);
    let mut stats = Stats {
        image: false,
        count: rows as u64,
        min: Vec::with_capacity(width),
        max: Vec::with_capacity(width),
        mean: Vec::with_capacity(width),
        std: Vec::with_capacity(width),
        quantiles: vec![Vec::with_capacity(width); QUANTILES.len()],
    };
    for column in 0..width {
        let mut sorted: Vec<f64> = values.iter().skip(column).step_by(width).copied().collect();
        let mean = sorted.iter().sum::<f64>() / rows as f64;
        let variance = sorted.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / rows as f64;
        sorted.sort_by(f64::total_cmp);
        stats.min.push(sorted.first().copied().unwrap_or(0.0));
        stats.max.push(sorted.last().copied().unwrap_or(0.0));
        stats.mean.push(mean);
        stats.std.push(variance.sqrt());
        for (quantile, (_, fraction)) in stats.quantiles.iter_mut().zip(QUANTILES) {
            quantile.push(linear(&sorted, fraction));
        }
    }
    stats
}

/// The quantile of sorted values, interpolated linearly between order statistics.
fn linear(sorted: &[f64], fraction: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else {
        return 0.0;
    };
    let place = fraction * last as f64;
    let below = place.floor() as usize;
    let (low, high) = (sorted[below], sorted[(below + 1).min(last)]);
    low + (high - low) * (place - below as f64)
}

/// Counts of the 256 values in each of the three channels.
#[derive(Debug, Clone)]
pub(super) struct Levels {
    counts: Box<[[u64; 256]; 3]>,
    images: u64,
}

impl Default for Levels {
    fn default() -> Self {
        Self {
            counts: Box::new([[0; 256]; 3]),
            images: 0,
        }
    }
}

impl Levels {
    /// Counts the pixels of a sample of an episode's images. The error is the number of an image and what is wrong with it.
    pub(super) fn of(images: &[Vec<u8>]) -> Result<Self, (usize, String)> {
        let mut levels = Self::default();
        let count = images.len().min(SAMPLED);
        for sample in 0..count {
            // Evenly spaced, with the first and the last image.
            let at = if count > 1 {
                sample * (images.len() - 1) / (count - 1)
            } else {
                0
            };
            let (_, _, rgb) = images::decode(&images[at]).map_err(|(_, why)| (at, why))?;
            levels.add(&rgb);
        }
        Ok(levels)
    }

    fn add(&mut self, rgb: &[u8]) {
        for pixel in rgb.chunks_exact(3) {
            for (counts, level) in self.counts.iter_mut().zip(pixel) {
                counts[usize::from(*level)] += 1;
            }
        }
        self.images += 1;
    }

    pub(super) fn merge(&mut self, other: &Self) {
        for (own, others) in self
            .counts
            .as_flattened_mut()
            .iter_mut()
            .zip(other.counts.as_flattened())
        {
            *own += others;
        }
        self.images += other.images;
    }

    /// Statistics of the values divided by 255. The count is the number of images.
    pub(super) fn stats(&self) -> Stats {
        let mut stats = Stats {
            image: true,
            count: self.images,
            min: Vec::new(),
            max: Vec::new(),
            mean: Vec::new(),
            std: Vec::new(),
            quantiles: vec![Vec::new(); QUANTILES.len()],
        };
        for counts in self.counts.iter() {
            let pixels: u64 = counts.iter().sum();
            let of = |power: i32| -> f64 {
                let sum: f64 = (0..256).map(|i| counts[i] as f64 * (i as f64).powi(power)).sum();
                sum / pixels.max(1) as f64
            };
            let mean = of(1);
            let used = |&level: &usize| counts[level] > 0;
            stats.min.push((0..256).find(used).unwrap_or(0) as f64 / 255.0);
            stats.max.push((0..256).rev().find(used).unwrap_or(0) as f64 / 255.0);
            stats.mean.push(mean / 255.0);
            stats.std.push((of(2) - mean * mean).max(0.0).sqrt() / 255.0);
            for (quantile, (_, fraction)) in stats.quantiles.iter_mut().zip(QUANTILES) {
                let rank = (fraction * pixels.saturating_sub(1) as f64).floor() as u64;
                let mut below = 0;
                let level = counts.iter().position(|count| {
                    below += count;
                    below > rank
                });
                quantile.push(level.unwrap_or(0) as f64 / 255.0);
            }
        }
        stats
    }
}

/// What is known of a feature over all episodes so far.
#[derive(Debug, Clone)]
pub(super) enum Total {
    Images(Levels),
    Numbers(Moments),
}

/// Count, mean and sum of squared deviations of each value of a feature, and its extremes.
#[derive(Debug, Clone, Default)]
pub(super) struct Moments {
    count: u64,
    mean: Vec<f64>,
    squares: Vec<f64>,
    min: Vec<f64>,
    max: Vec<f64>,
}

impl Moments {
    /// Adds the statistics of an episode: the pairwise formula of Chan, Golub and `LeVeque`.
    pub(super) fn add(&mut self, stats: &Stats) {
        if self.count == 0 {
            self.mean = vec![0.0; stats.mean.len()];
            self.squares = self.mean.clone();
            self.min.clone_from(&stats.min);
            self.max.clone_from(&stats.max);
        }
        let (before, new) = (self.count as f64, stats.count as f64);
        let all = before + new;
        for i in 0..self.mean.len() {
            let difference = stats.mean[i] - self.mean[i];
            self.mean[i] += difference * new / all;
            self.squares[i] += stats.std[i].powi(2) * new + difference.powi(2) * before * new / all;
            self.min[i] = self.min[i].min(stats.min[i]);
            self.max[i] = self.max[i].max(stats.max[i]);
        }
        self.count += stats.count;
    }

    /// The statistics, with the quantiles of the histograms.
    pub(super) fn stats(&self, histograms: &[Histogram]) -> Stats {
        let quantile = |fraction| histograms.iter().map(|of| of.quantile(fraction)).collect();
        Stats {
            image: false,
            count: self.count,
            min: self.min.clone(),
            max: self.max.clone(),
            mean: self.mean.clone(),
            std: self
                .squares
                .iter()
                .map(|squares| (squares / self.count.max(1) as f64).sqrt())
                .collect(),
            quantiles: QUANTILES.map(|(_, fraction)| quantile(fraction)).to_vec(),
        }
    }

    /// Empty histograms between the extremes.
    pub(super) fn histograms(&self) -> Vec<Histogram> {
        let ranges = self.min.iter().zip(&self.max);
        ranges.map(|(min, max)| Histogram::new(*min, *max)).collect()
    }
}

/// Counts of values in equal parts of a range.
pub(super) struct Histogram {
    min: f64,
    max: f64,
    counts: Vec<u64>,
}

impl Histogram {
    fn new(min: f64, max: f64) -> Self {
        let bins = if max > min { BINS } else { 0 };
        Self {
            min,
            max,
            counts: vec![0; bins],
        }
    }

    pub(super) fn add(&mut self, value: f64) {
        let share = (value - self.min) / (self.max - self.min);
        let bin = (share * self.counts.len() as f64) as usize;
        let last = self.counts.len().saturating_sub(1);
        if let Some(count) = self.counts.get_mut(bin.min(last)) {
            *count += 1;
        }
    }

    fn quantile(&self, fraction: f64) -> f64 {
        let all: u64 = self.counts.iter().sum();
        if all == 0 {
            return self.min;
        }
        let rank = fraction * (all - 1) as f64;
        let width = (self.max - self.min) / self.counts.len() as f64;
        let mut below = 0;
        for (bin, &count) in self.counts.iter().enumerate() {
            if count > 0 && (below + count) as f64 > rank {
                let inside = (rank - below as f64 + 0.5) / count as f64;
                return (self.min + width * (bin as f64 + inside)).clamp(self.min, self.max);
            }
            below += count;
        }
        self.max
    }
}

/// The values of a feature as doubles; `None` for images.
pub(super) fn numbers(data: &Data) -> Option<Vec<f64>> {
    Some(match data {
        Data::Single(values) => values.iter().map(|&value| f64::from(value)).collect(),
        Data::Double(values) => values.clone(),
        Data::Integer(values) => values.iter().map(|&value| value as f64).collect(),
        Data::Truth(values) => values.iter().map(|&value| f64::from(u8::from(value))).collect(),
        Data::Images(_) => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_an_episode_are_those_of_numpy() {
        // numpy.quantile([3, 1, 4, 1, 5], [0.01, 0.1, 0.5, 0.9, 0.99]) and numpy.std of the same, and of ten times it.
        let values: Vec<f64> = [3.0, 1.0, 4.0, 1.0, 5.0].iter().flat_map(|x| [*x, 10.0 * x]).collect();
        let stats = of_numbers(&values, 2);
        assert_eq!(
            (stats.count, &stats.min, &stats.max),
            (5, &vec![1.0, 10.0], &vec![5.0, 50.0])
        );
        assert_eq!(stats.mean, [2.8, 28.0]);
        assert!((stats.std[0] - 1.6).abs() < 1e-15 && (stats.std[1] - 16.0).abs() < 1e-14);
        let first: Vec<f64> = stats.quantiles.iter().map(|quantile| quantile[0]).collect();
        for (found, expected) in first.iter().zip([1.0, 1.0, 3.0, 4.6, 4.96]) {
            assert!((found - expected).abs() < 1e-12, "{first:?}");
        }
    }

    #[test]
    fn episodes_add_up_to_the_dataset() {
        let all: Vec<f64> = (0..1000).map(|i| f64::from(i * 7919 % 1013) * 0.25 - 40.0).collect();
        let mut moments = Moments::default();
        for part in [&all[..1], &all[1..17], &all[17..600], &all[600..]] {
            moments.add(&of_numbers(part, 1));
        }
        let mut histograms = moments.histograms();
        for value in &all {
            histograms[0].add(*value);
        }
        let (whole, exact) = (moments.stats(&histograms), of_numbers(&all, 1));
        assert_eq!((whole.count, &whole.min, &whole.max), (1000, &exact.min, &exact.max));
        let near = |a: f64, b: f64, tolerance: f64| (a - b).abs() < tolerance;
        assert!(near(whole.mean[0], exact.mean[0], 1e-9) && near(whole.std[0], exact.std[0], 1e-9));
        for (found, expected) in whole.quantiles.iter().zip(&exact.quantiles) {
            // A histogram does not interpolate between order statistics, which are 0.25 apart here.
            assert!(near(found[0], expected[0], 0.26), "{found:?} {expected:?}");
        }
    }

    #[test]
    fn constant_values_have_constant_quantiles() {
        let mut moments = Moments::default();
        moments.add(&of_numbers(&[2.5; 9], 1));
        let mut histograms = moments.histograms();
        histograms[0].add(2.5);
        let stats = moments.stats(&histograms);
        assert!(stats.quantiles.iter().all(|quantile| quantile == &[2.5]));
        assert_eq!(stats.std, [0.0]);
    }

    #[test]
    fn levels_of_images_are_scaled_to_one() {
        let mut levels = Levels::default();
        levels.add(&[0, 51, 255, 0, 102, 255]);
        let stats = levels.stats();
        assert_eq!(
            (stats.count, stats.min, stats.max),
            (1, vec![0.0, 0.2, 1.0], vec![0.0, 0.4, 1.0])
        );
        assert!((stats.mean[1] - 0.3).abs() < 1e-15 && (stats.std[1] - 0.1).abs() < 1e-12);
        assert_eq!(levels.stats().to_json()["mean"][2], json!([[1.0]]));
    }
}
