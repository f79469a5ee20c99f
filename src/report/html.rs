//! Markup of a page.

use std::fmt;

/// Markup. Conversion from text escapes it; only [`Html::raw`] takes its argument unchanged.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Html(String);

impl Html {
    /// From existing markup.
    pub(super) fn raw(markup: impl Into<String>) -> Self {
        Self(markup.into())
    }

    /// From text, with code between backticks.
    pub(super) fn with_code(text: &str) -> Self {
        let parts = text.split('`').enumerate();
        Self(
            parts
                .map(|(i, part)| if i % 2 == 1 { format!("<code>{}</code>", escape(part)) } else { escape(part) })
                .collect(),
        )
    }

    /// From text that may wrap in a cell.
    pub(super) fn wrapped(text: &str) -> Self {
        Self(format!("<span class=\"why\">{}</span>", escape(text)))
    }
}

impl<T: AsRef<str> + ?Sized> From<&T> for Html {
    fn from(text: &T) -> Self {
        Self(escape(text.as_ref()))
    }
}

impl From<String> for Html {
    fn from(text: String) -> Self {
        Self(escape(&text))
    }
}

impl From<&Html> for Html {
    fn from(markup: &Html) -> Self {
        markup.clone()
    }
}

impl fmt::Display for Html {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Text as HTML. Names in plots also need it: the plotting library interprets some tags in them.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            _ => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_in_text_stays_text() {
        assert_eq!(Html::from("<b>\"a\" & b</b>").to_string(), "&lt;b&gt;&quot;a&quot; &amp; b&lt;/b&gt;");
        assert_eq!(Html::from(&"a<b".to_owned()), Html::from("a<b".to_owned()));
        assert_eq!(Html::with_code("run `a<b` & go").to_string(), "run <code>a&lt;b</code> &amp; go");
        assert_eq!(Html::wrapped("<i>").to_string(), "<span class=\"why\">&lt;i&gt;</span>");
    }

    #[test]
    fn markup_stays_markup() {
        assert_eq!(Html::from(&Html::raw("10<sup>3</sup>")).to_string(), "10<sup>3</sup>");
    }
}
