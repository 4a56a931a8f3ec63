//! As many points as can be told apart, and no more: a page of a million dots helps nobody.

use std::collections::HashSet;

/// Dots of a series.
const MAX_DOTS: usize = 4000;

/// Points of a line.
const MAX_POINTS: usize = 8000;

/// Points of a line that are closer than this, in pixels, are one.
const SAME_PX: f64 = 0.25;

/// Dots, in pixels: of those in the same square only the first is kept; the squares grow until the rest is few enough. So
/// lonely dots, which matter most, stay.
pub(super) fn dots(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut side_px = 0.5;
    loop {
        let mut taken = HashSet::new();
        let square = |at: f64| (at / side_px).floor() as i64;
        let kept = points
            .iter()
            .filter(|[x, y]| taken.insert((square(*x), square(*y))))
            .copied();
        let kept: Vec<_> = kept.collect();
        if kept.len() <= MAX_DOTS {
            return kept;
        }
        side_px *= 1.5;
    }
}

/// A line, in pixels. Where x grows, every column of pixels keeps its first, least, greatest and last point, which looks the
/// same (Jugel et al. 2014, "M4: a visualization-oriented time series data aggregation"); elsewhere points go that hardly
/// differ from the one before, and then as many as are too many.
pub(super) fn line(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    if points.is_sorted_by(|a, b| a[0] <= b[0]) {
        return columns(points);
    }
    let mut kept: Vec<[f64; 2]> = Vec::new();
    for (index, point) in points.iter().enumerate() {
        let is_new = kept
            .last()
            .is_none_or(|last| (last[0] - point[0]).hypot(last[1] - point[1]) >= SAME_PX);
        if is_new || index + 1 == points.len() {
            kept.push(*point);
        }
    }
    let every = kept.len().div_ceil(MAX_POINTS).max(1);
    kept.into_iter().step_by(every).collect()
}

fn columns(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut kept = Vec::new();
    for column in points.chunk_by(|a, b| a[0].floor() == b[0].floor()) {
        if column.len() <= 4 {
            kept.extend_from_slice(column);
            continue;
        }
        let by_height = |a: &usize, b: &usize| column[*a][1].total_cmp(&column[*b][1]);
        let least = (0..column.len()).min_by(by_height).unwrap_or(0);
        let greatest = (0..column.len()).max_by(by_height).unwrap_or(0);
        let mut chosen = vec![0, least, greatest, column.len() - 1];
        chosen.sort_unstable();
        chosen.dedup();
        kept.extend(chosen.into_iter().map(|index| column[index]));
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_keeps_its_extremes_in_every_column() {
        let points: Vec<[f64; 2]> = (0..100_000)
            .map(|i| {
                let x = f64::from(i) * 0.006;
                [x, if i == 51_234 { 1000.0 } else { (x * 40.0).sin() }]
            })
            .collect();
        let thin = line(&points);
        assert!(thin.len() <= 4 * 601, "{}", thin.len());
        assert_eq!((thin[0], thin[thin.len() - 1]), (points[0], points[99_999]));
        assert!(thin.contains(&points[51_234]));
        assert!(thin.is_sorted_by(|a, b| a[0] <= b[0]));
    }

    #[test]
    fn a_curve_that_turns_back_keeps_its_order() {
        let circle: Vec<[f64; 2]> = (0..100_000)
            .map(|i| {
                let angle = f64::from(i) * 1e-3;
                [300.0 + 200.0 * angle.cos(), 200.0 * angle.sin()]
            })
            .collect();
        let thin = line(&circle);
        assert!(thin.len() <= MAX_POINTS && thin.len() > 2000, "{}", thin.len());
        assert_eq!(thin[0], circle[0]);
    }

    #[test]
    fn few_dots_stay_and_of_many_the_lonely_ones_do() {
        let few = vec![[1.0, 2.0], [3.0, 4.0], [1.0, 200.0]];
        assert_eq!(dots(&few), few);
        let mut many: Vec<[f64; 2]> = (0..300_000)
            .map(|i| [f64::from(i % 500), f64::from(i / 1500)])
            .collect();
        many.push([650.0, 390.0]);
        let thin = dots(&many);
        assert!(thin.len() <= MAX_DOTS && thin.len() > 1000, "{}", thin.len());
        assert!(thin.contains(&[650.0, 390.0]));
    }
}
