//! Runs -> connected components (8-connected), by union-find over runs: time all but linear in the number of runs.

use super::scan::Run;

/// Scratch memory of the grouping.
#[derive(Debug, Default)]
pub(super) struct Components {
    /// For each run: an earlier run of the same component, or itself if it is the first.
    parent: Vec<u32>,
    /// For each run: the number of its component.
    label: Vec<u32>,
    /// For each component: where its next run goes in `grouped`; finally, where it ends.
    ends: Vec<usize>,
    grouped: Vec<Run>,
}

impl Components {
    /// The components of runs given in raster order: ordered by their first runs, each in raster order.
    pub(super) fn group(&mut self, runs: &[Run]) -> impl Iterator<Item = &[Run]> {
        self.connect(runs);
        self.sort(runs);
        let Self { ends, grouped, .. } = self;
        let grouped: &[Run] = grouped;
        let mut start = 0;
        ends.iter().filter_map(move |&end| {
            let component = grouped.get(start..end);
            start = end;
            component
        })
    }

    fn connect(&mut self, runs: &[Run]) {
        self.parent.clear();
        self.parent.extend(0..runs.len() as u32);
        let mut above = 0;
        for (i, run) in runs.iter().enumerate() {
            // Skip the runs that neither this one nor a later one can touch.
            while let Some(a) = runs.get(above)
                && (a.y + 1 < run.y || (a.y + 1 == run.y && a.x1 < run.x0))
            {
                above += 1;
            }
            // Cells also touch at corners: a run reaches one cell further on the next row.
            for (k, _) in runs.iter().enumerate().skip(above).take_while(|(_, a)| a.y + 1 == run.y && a.x0 <= run.x1) {
                self.unite(k as u32, i as u32);
            }
        }
    }

    fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        // The earlier run stays the root: components are then numbered in raster order.
        if let Some(parent) = self.parent.get_mut(a.max(b) as usize) {
            *parent = a.min(b);
        }
    }

    fn root(&mut self, mut i: u32) -> u32 {
        while let Some(&parent) = self.parent.get(i as usize)
            && parent != i
        {
            // Path halving, for later searches.
            let grandparent = self.parent.get(parent as usize).copied().unwrap_or(parent);
            if let Some(p) = self.parent.get_mut(i as usize) {
                *p = grandparent;
            }
            i = grandparent;
        }
        i
    }

    /// Counting sort of the runs by component.
    fn sort(&mut self, runs: &[Run]) {
        self.label.clear();
        self.ends.clear();
        for i in 0..runs.len() as u32 {
            let root = self.root(i);
            let label = if root == i {
                self.ends.push(0);
                self.ends.len() as u32 - 1
            } else {
                self.label.get(root as usize).copied().unwrap_or_default()
            };
            self.label.push(label);
            if let Some(count) = self.ends.get_mut(label as usize) {
                *count += 1;
            }
        }
        let mut start = 0;
        for end in &mut self.ends {
            start += std::mem::replace(end, start);
        }
        self.grouped.clear();
        self.grouped.resize(runs.len(), Run { y: 0, x0: 0, x1: 0 });
        for (run, &label) in runs.iter().zip(&self.label) {
            if let Some(next) = self.ends.get_mut(label as usize)
                && let Some(place) = self.grouped.get_mut(*next)
            {
                *place = *run;
                *next += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn runs_of(rows: &[&str]) -> Vec<Run> {
        let mut runs: Vec<Run> = Vec::new();
        for (y, row) in (0_u16..).zip(rows) {
            for (x, _) in (0_u16..).zip(row.bytes()).filter(|&(_, c)| c == b'#') {
                match runs.last_mut() {
                    Some(run) if run.y == y && run.x1 == x => run.x1 += 1,
                    _ => runs.push(Run { y, x0: x, x1: x + 1 }),
                }
            }
        }
        runs
    }

    fn sizes(rows: &[&str]) -> Vec<usize> {
        Components::default().group(&runs_of(rows)).map(|c| c.iter().map(Run::cells).sum()).collect()
    }

    #[test]
    fn corners_connect_and_gaps_part() {
        assert_eq!(sizes(&["##..", "..##", "....", "#..."]), [4, 1]);
        assert_eq!(sizes(&["#.#", "#.#", "###"]), [7]);
        assert_eq!(sizes(&["#.#.#", ".....", "#.#.#"]), [1; 6]);
        // A spiral and a comb, which join late.
        assert_eq!(sizes(&["#####", "....#", "###.#", "#...#", "#####"]), [17]);
        assert_eq!(sizes(&["#.#.#.#", "#.#.#.#", "#######", "", "#"]), [15, 1]);
        assert!(sizes(&[]).is_empty());
    }

    proptest! {
        #[test]
        fn same_as_flood_fill(cells in prop::collection::vec(prop::collection::vec(0..5_u8, 12), 12)) {
            let rows: Vec<String> =
                cells.iter().map(|r| r.iter().map(|&c| if c < 2 { '#' } else { '.' }).collect()).collect();
            let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
            let mut left: Vec<Vec<bool>> = cells.iter().map(|r| r.iter().map(|&c| c < 2).collect()).collect();
            let mut expected = Vec::new();
            for y in 0..12 {
                for x in 0..12 {
                    let (mut stack, mut size) = (vec![(x, y)], 0);
                    while let Some((x, y)) = stack.pop() {
                        if std::mem::take(&mut left[y][x]) {
                            size += 1;
                            for v in y.saturating_sub(1)..(y + 2).min(12) {
                                stack.extend((x.saturating_sub(1)..(x + 2).min(12)).map(|u| (u, v)));
                            }
                        }
                    }
                    if size > 0 {
                        expected.push(size);
                    }
                }
            }
            prop_assert_eq!(sizes(&rows), expected);
        }
    }
}
