//! One value for each band in each view.

use crate::rig::Rig;

/// By marker and view, in the rig's order.
#[derive(Debug)]
pub(in crate::track) struct ByBand<T>(Vec<Vec<T>>);

impl<T> ByBand<T> {
    /// Of a marker and a view each.
    pub(in crate::track) fn new(rig: &Rig, value: impl Fn(usize, usize) -> T) -> Self {
        let of_marker = |m: usize| (0..rig.views.len()).map(|v| value(m, v)).collect();
        Self((0..rig.markers.len()).map(of_marker).collect())
    }

    pub(in crate::track) fn get(&self, marker: usize, view: usize) -> Option<&T> {
        self.0.get(marker)?.get(view)
    }

    pub(in crate::track) fn get_mut(&mut self, marker: usize, view: usize) -> Option<&mut T> {
        self.0.get_mut(marker)?.get_mut(view)
    }

    /// Those of a marker in all views.
    pub(super) fn of_marker(&self, marker: usize) -> Option<&[T]> {
        self.0.get(marker).map(Vec::as_slice)
    }

    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.0.iter_mut().flatten()
    }

    pub(in crate::track) fn iter(&self) -> impl Iterator<Item = &T> {
        self.0.iter().flatten()
    }
}
