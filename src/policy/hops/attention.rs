//! Arithmetic of aggregation: sum, mean and maximum of rows of messages, softmax of scores, dot products.
//!
//! Every sum runs over the rows in their order, from zero, with multiplications and additions only.

use super::manifest::Aggregation;

/// Adds the first `count` rows of `messages` to `sum`, whose length is that of a row.
#[inline(always)]
pub fn add(count: usize, messages: &[f32], sum: &mut [f32]) {
    for message in messages.chunks_exact(sum.len()).take(count) {
        sum.iter_mut().zip(message).for_each(|(sum, term)| *sum += *term);
    }
}

/// Writes the sum, the mean or the maximum of the first `count` rows of `messages` into `sum`, whose length is that of
/// a row; zero without any row. Any other aggregation is computed as the sum.
#[inline(always)]
pub fn plain(aggregation: Aggregation, count: usize, messages: &[f32], sum: &mut [f32]) {
    sum.fill(0.0);
    match aggregation {
        Aggregation::Max if count > 0 => {
            sum.fill(f32::NEG_INFINITY);
            for message in messages.chunks_exact(sum.len()).take(count) {
                sum.iter_mut().zip(message).for_each(|(sum, term)| *sum = sum.max(*term));
            }
        }
        _ => add(count, messages, sum),
    }
    if aggregation == Aggregation::Mean && count > 0 {
        sum.iter_mut().for_each(|sum| *sum /= count as f32);
    }
}

/// Replaces the first `count` rows of `scores`, with one score for each of `heads` heads, by their softmax over the
/// rows, for each head. The largest score is subtracted first, so that no exponential overflows.
#[inline(always)]
pub fn softmax(count: usize, heads: usize, scores: &mut [f32]) {
    let scores = &mut scores[..count * heads];
    for head in 0..heads {
        let of_head = || (head..count * heads).step_by(heads);
        let largest = of_head().map(|at| scores[at]).fold(f32::NEG_INFINITY, f32::max);
        let mut total = 0.0;
        for at in of_head() {
            scores[at] = libm::expf(scores[at] - largest);
            total += scores[at];
        }
        of_head().for_each(|at| scores[at] /= total);
    }
}

/// Writes the scores of scaled dot-product attention into `scores`: one row for each of the first `count` rows of
/// `keys`, with one score for each head. Query and keys consist of `heads` equal parts; a score is the dot product of a
/// part of the query and of a key, divided by the square root of the part's width.
#[inline(always)]
pub fn dot_products(count: usize, heads: usize, query: &[f32], keys: &[f32], scores: &mut [f32]) {
    let width = query.len() / heads;
    let scale = (width as f32).sqrt();
    for (key, scores) in keys.chunks_exact(query.len()).zip(scores.chunks_exact_mut(heads)).take(count) {
        for ((query, key), score) in query.chunks_exact(width).zip(key.chunks_exact(width)).zip(scores) {
            *score = query.iter().zip(key).map(|(q, k)| q * k).sum::<f32>() / scale;
        }
    }
}

/// Writes the sum of the first `count` rows of `messages` into `sum`, each head's part of a row multiplied by its
/// weight. `weights` has a row of `heads` weights for each row of messages.
#[inline(always)]
pub fn weighted_sum(count: usize, heads: usize, weights: &[f32], messages: &[f32], sum: &mut [f32]) {
    sum.fill(0.0);
    let width = sum.len() / heads;
    for (message, weights) in messages.chunks_exact(sum.len()).zip(weights.chunks_exact(heads)).take(count) {
        for ((sum, part), weight) in sum.chunks_exact_mut(width).zip(message.chunks_exact(width)).zip(weights) {
            sum.iter_mut().zip(part).for_each(|(sum, term)| *sum += weight * term);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sum_mean_and_max_of_rows_are_zero_without_rows() {
        let messages = [1.0, -2.0, 3.0, -4.0, 99.0, 99.0];
        let of = |aggregation, count| {
            let mut sum = [7.0; 2];
            plain(aggregation, count, &messages, &mut sum);
            sum
        };
        assert_eq!(of(Aggregation::Sum, 2), [4.0, -6.0]);
        assert_eq!(of(Aggregation::Mean, 2), [2.0, -3.0]);
        assert_eq!(of(Aggregation::Max, 2), [3.0, -2.0]);
        for aggregation in [Aggregation::Sum, Aggregation::Mean, Aggregation::Max] {
            assert_eq!(of(aggregation, 0), [0.0, 0.0]);
        }
    }

    #[test]
    fn softmax_weighs_each_head_by_itself_and_does_not_overflow() {
        // Head 0: scores 1000 + ln 3 and 1000, so weights 3/4 and 1/4. Head 1: equal scores.
        let mut scores = [1000.0 + 3.0f32.ln(), 5.0, 1000.0, 5.0, 7.0, 7.0];
        softmax(2, 2, &mut scores);
        let expected = [0.75, 0.5, 0.25, 0.5, 7.0, 7.0];
        scores.iter().zip(expected).for_each(|(found, expected)| assert!((found - expected).abs() < 1e-4, "{found}"));
        let mut sum = [9.0; 4];
        weighted_sum(2, 2, &[0.75, 0.5, 0.25, 0.5], &[4.0, 8.0, 2.0, 0.0, 0.0, 4.0, 4.0, 6.0], &mut sum);
        assert_eq!(sum, [3.0, 7.0, 3.0, 3.0]);
        weighted_sum(0, 2, &[], &[], &mut sum);
        assert_eq!(sum, [0.0; 4]);
    }

    #[test]
    fn dot_products_are_scaled_by_the_root_of_a_head_s_width() {
        let mut scores = [0.0; 2];
        dot_products(1, 2, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0], &[1.0; 8], &mut scores);
        assert_eq!(scores, [5.0, 13.0]);
    }
}
