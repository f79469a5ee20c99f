//! What to know before the runs of a study are compared, or counted.

use super::{FRAME, Run, Study};
use crate::plural::plural;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

impl Study {
    /// What to say of its runs, as sentences.
    pub(crate) fn cautions(&self) -> Vec<String> {
        [self.mixed_frames(), self.mixed_programs(), self.copies(), self.without_tables()]
            .into_iter()
            .flatten()
            .collect()
    }

    /// What to say of positions in different frames of reference, if there are any.
    fn mixed_frames(&self) -> Option<String> {
        let mut runs: BTreeMap<String, usize> = BTreeMap::new();
        self.with_tables().filter_map(Run::frame).for_each(|frame| *runs.entry(frame).or_default() += 1);
        let of: Vec<String> =
            runs.iter().map(|(frame, times)| format!("{frame} frame in {}", plural(*times, "run"))).collect();
        let words = "positions and directions are in different frames of reference";
        let advice = format!("compare only those with the same value in column `{FRAME}`");
        (of.len() > 1).then(|| format!("{words} ({}): {advice}", of.join(", ")))
    }

    /// The same of runs of different versions of the program or its libraries.
    fn mixed_programs(&self) -> Option<String> {
        let summaries = self.runs.iter().map(|run| &run.summary);
        let builds: BTreeSet<_> = summaries.map(|of| (&of.version, &of.sha256.program, &of.libraries)).collect();
        (builds.len() > 1).then(|| {
            format!(
                "its runs are of {} different builds of the program or its libraries: `catoptra track --resume` tracks \
                 those of others again",
                builds.len()
            )
        })
    }

    /// The same of runs that are copies of others.
    fn copies(&self) -> Option<String> {
        let mut seen: BTreeMap<_, &Run> = BTreeMap::new();
        let mut copies = Vec::new();
        for run in self.with_tables() {
            let hashes = &run.summary.sha256;
            // A live run has no recording: what it measured is its own.
            let table = || run.table()?.sha256.as_ref();
            let Some(measured) = hashes.recording.as_ref().or_else(table) else { continue };
            match seen.entry((measured, &hashes.rig, &hashes.options)) {
                Entry::Occupied(other) => copies.push((other.get().folder.display(), run.folder.display())),
                Entry::Vacant(new) => _ = new.insert(run),
            }
        }
        let (one, other) = copies.first()?;
        let count = plural(copies.len(), "run");
        let words = "of the same recording (or live), rig and options as another, and their frames count twice";
        Some(format!("{count} {words}: {one} and {other}, for example"))
    }

    /// The same of runs whose tables are not in their folders.
    fn without_tables(&self) -> Option<String> {
        let frames = |run: &&Run| run.summary.measured.as_ref().is_some_and(|measured| measured.frames > 0);
        let without: Vec<&Run> = self.runs.iter().filter(|run| !run.has_table()).filter(frames).collect();
        let first = without.first()?.folder.display();
        let count = plural(without.len(), "run");
        Some(format!(
            "the table of {count} was written elsewhere (--csv), and its frames are not among those of the study: \
             {first}, for example"
        ))
    }
}
