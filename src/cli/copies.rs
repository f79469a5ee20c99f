//! Records that are given twice.

use super::Failure;

/// No record may count twice, and none that is fitted can judge. `of`: a record's name, and whether it is fitted.
pub(super) fn check<T>(
    all: &[T],
    is_copy: impl Fn(&T, &T) -> bool,
    of: impl Fn(&T) -> (&str, bool),
) -> Result<(), Failure> {
    let pairs = all.iter().enumerate().flat_map(|(k, one)| all.iter().take(k).map(move |before| (before, one)));
    for (before, one) in pairs.filter(|(before, one)| is_copy(before, one)) {
        let ((other, before_fitted), (name, fitted)) = (of(before), of(one));
        match (before_fitted, fitted) {
            (true, true) => {
                return Err(Failure::usage(format!(
                    "{name}: holds the samples of {other}, which would count twice: leave one out"
                )));
            }
            (true, false) => {
                tracing::warn!(
                    "{name} is used both to fit and to validate; a model cannot be judged by the data it was fitted to"
                );
            }
            _ => {}
        }
    }
    Ok(())
}
