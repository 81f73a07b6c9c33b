//! Ranks and their correlation.

/// Ranks of values, 1 for the best. Equal values share the mean of their ranks; missing values have none.
pub fn ranks(values: &[Option<f64>], higher_is_better: bool) -> Vec<Option<f64>> {
    let sign = if higher_is_better { -1.0 } else { 1.0 };
    let mut order: Vec<(f64, usize)> = values
        .iter()
        .enumerate()
        .filter_map(|(place, value)| Some((sign * (*value)?, place)))
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut ranks = vec![None; values.len()];
    let mut start = 0;
    while start < order.len() {
        let value = order[start].0;
        let end = start
            + order[start..]
                .iter()
                .take_while(|(other, _)| *other == value)
                .count()
                .max(1);
        let shared = (start + 1 + end) as f64 / 2.0;
        for (_, place) in &order[start..end] {
            ranks[*place] = Some(shared);
        }
        start = end;
    }
    ranks
}

/// Spearman's correlation of two columns of ranks, over the demonstrations that have both: the correlation of the ranks among them.
/// `None` if one of them does not vary.
pub fn correlation(a: &[Option<f64>], b: &[Option<f64>]) -> Option<f64> {
    let both: Vec<(f64, f64)> = a.iter().zip(b).filter_map(|(a, b)| Some(((*a)?, (*b)?))).collect();
    let again = |values: Vec<Option<f64>>| ranks(&values, false);
    let (a, b) = (
        again(both.iter().map(|pair| Some(pair.0)).collect()),
        again(both.iter().map(|pair| Some(pair.1)).collect()),
    );
    let mean = (both.len() + 1) as f64 / 2.0;
    let (mut product, mut square_a, mut square_b) = (0.0, 0.0, 0.0);
    for (a, b) in a.into_iter().flatten().zip(b.into_iter().flatten()) {
        product += (a - mean) * (b - mean);
        square_a += (a - mean) * (a - mean);
        square_b += (b - mean) * (b - mean);
    }
    (square_a > 0.0 && square_b > 0.0).then(|| (product / (square_a * square_b).sqrt()).clamp(-1.0, 1.0))
}
