//! Whether the mean brightness of a picture's blocks steps in the middle of a row, and stays there.
//!
//! The mean of a block is stored as the difference from the block before. Where one such difference is damaged, all
//! later blocks are off by the same amount: compared with the row above, the rest of this row and the beginning of the
//! next, up to the same column. No edge of an object looks like that, because it continues in the row below instead of
//! starting again at its beginning.
//!
//! Cannot detect: steps smaller than the structure of the picture, in the first and last rows, and near the sides.

/// Smallest step, in units of stored means (eight are one level of brightness).
const MIN_STEP: i32 = 24;
/// One in so many blocks may be an exception, on either side.
const BLOCKS_PER_EXCEPTION: usize = 20;
/// How many times larger than the picture's structure a step must be.
const MIN_STEP_RATIO: i32 = 2;
/// Rows with fewer blocks are too short to judge.
const MIN_BLOCKS_PER_ROW: usize = 10;

/// Whether there is such a step in blocks in rows of `width`.
pub(super) fn has_step(means: &[i32], width: usize) -> bool {
    if width < MIN_BLOCKS_PER_ROW {
        return false;
    }
    let above: Vec<i32> =
        means.iter().skip(width).zip(means).map(|(here, above)| here.saturating_sub(*above)).collect();
    let margin = width / 10 + 1;
    let mut sorted = Vec::with_capacity(width);
    // The value that only a small part of a row's length of blocks is below, or above.
    let mut beyond = |from: usize, sign: i32, above_it: bool| {
        sorted.clear();
        sorted.extend(above.get(from..from + width)?.iter().map(|difference| sign * difference));
        let index = if above_it { width - 1 - width / BLOCKS_PER_EXCEPTION } else { width / BLOCKS_PER_EXCEPTION };
        Some(*sorted.select_nth_unstable(index).1)
    };
    // `above[at]` belongs to block `at + width`.
    (width + margin..means.len().saturating_sub(2 * width)).any(|at| {
        let column = at % width;
        let (Some(here), Some(before)) = (means.get(at + width), means.get(at + width - 1)) else { return false };
        let aside = here.saturating_sub(*before);
        if column < margin || column + margin > width || aside.saturating_abs() < MIN_STEP {
            return false;
        }
        let sign = aside.signum();
        // Hardly any place has a row of steps after it, and the first few differences tell.
        let mut smaller = above.iter().skip(at).take(width).filter(|difference| sign * **difference < MIN_STEP);
        if smaller.nth(width / BLOCKS_PER_EXCEPTION).is_some() {
            return false;
        }
        let Some(step) = beyond(at, sign, false) else { return false };
        let usual = [at - width, at + width].map(|from| beyond(from, sign, true).unwrap_or(0));
        usual.iter().all(|usual| step > MIN_STEP_RATIO * usual) && aside.saturating_abs() > step / 2
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [40, 30];

    fn picture(value: impl Fn(usize, usize) -> i32) -> Vec<i32> {
        (0..SIZE[0] * SIZE[1]).map(|i| value(i % SIZE[0], i / SIZE[0])).collect()
    }

    #[test]
    fn a_step_that_stays_is_noticed_and_edges_of_things_are_not() {
        let gradient = |x: usize, y: usize| (5 * x + 3 * y) as i32 + (x * 7 + y * 13) as i32 % 5;
        assert!(!has_step(&picture(gradient), SIZE[0]));
        for edge in [
            // A horizontal edge; one that begins in the middle; a tilted one; a bright object.
            &(|_: usize, y: usize| if y > 12 { 400 } else { 0 }) as &dyn Fn(usize, usize) -> i32,
            &|x, y| if y > 12 && x > 17 { 400 } else { 0 },
            &|x, y| if 40 * y + x > 500 { 400 } else { 0 }.min((40 * y + x).abs_diff(500) as i32 * 10),
            &|x, y| if (5..30).contains(&x) && (6..9).contains(&y) { 400 } else { 0 },
        ] {
            assert!(!has_step(&picture(|x, y| gradient(x, y) + edge(x, y)), SIZE[0]));
        }
        for step in [60, -60, 500] {
            let mut means = picture(gradient);
            means.iter_mut().skip(12 * SIZE[0] + 17).for_each(|mean| *mean += step);
            assert!(has_step(&means, SIZE[0]), "{step}");
        }
    }
}
