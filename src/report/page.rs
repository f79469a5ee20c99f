//! A self-contained HTML file with style, script and data.

use super::html::{Html, escape};
use base64::prelude::{BASE64_STANDARD, Engine as _};
use plotly::Plot;
use std::fmt::Display;
use std::io::{self, Write};
use std::sync::OnceLock;

/// Style of all pages.
const STYLE: &str = include_str!("page.css");
/// Links the time axes of plots: zooming one zooms all.
const LINK: &str = include_str!("link.js");
/// Fits 3D plots into their width.
const SCENE: &str = include_str!("scene.js");
/// Fits plots on paper.
const PRINT: &str = include_str!("print.js");
/// Saves plots as vector graphics, named after the page and the plot.
const SAVE: &str = include_str!("save.js");

/// The browser loads nothing from anywhere: the page is self-contained. (3D plots compile their drawing code.)
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; \
                      img-src data: blob:";

/// A table of cells, text or markup. The first `words` columns are text, the others numbers.
pub(super) fn table<'a, H, C>(words: usize, heads: &'a [H], rows: &'a [Vec<C>]) -> String
where
    Html: From<&'a H> + From<&'a C>,
{
    fn cells(tag: &str, words: usize, cells: impl Iterator<Item = Html>) -> String {
        let class = |k: usize| if k < words { " class=\"text\"" } else { "" };
        cells.enumerate().map(|(k, c)| format!("<{tag}{}>{c}</{tag}>", class(k))).collect()
    }
    let row = |row: &'a Vec<C>| format!("<tr>{}</tr>\n", cells("td", words, row.iter().map(Html::from)));
    let body: String = rows.iter().map(row).collect();
    let head = cells("th", words, heads.iter().map(Html::from));
    format!("<div class=\"scroll\"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody></table></div>\n")
}

/// A plot, `height` pixels high. Linked ones share their time axis with all others on the page.
pub(super) fn figure(id: &str, plot: &Plot, height: u32, linked: bool) -> String {
    let class = if linked { "plot linked" } else { "plot" };
    format!("<div class=\"{class}\" style=\"height:{height}px\">{}</div>\n", plot.to_inline_html(Some(id)))
}

/// A key figure at the top of a page. `warn` colours it.
pub(super) fn card(name: impl Into<Html>, value: impl Into<Html>, unit: impl Into<Html>, warn: bool) -> String {
    let (name, value, unit) = (name.into(), value.into(), unit.into());
    let class = if warn { " class=\"warn\"" } else { "" };
    format!("<div{class}><dt>{name}</dt><dd>{value} <small>{unit}</small></dd></div>\n")
}

/// What to know before the results are used; nothing when there are no doubts.
pub(super) fn doubts(doubts: &[impl Display]) -> String {
    if doubts.is_empty() {
        return String::new();
    }
    let items: String = doubts.iter().map(|doubt| format!("<li>{}</li>\n", escape(&doubt.to_string()))).collect();
    format!(
        "<div class=\"doubts\"><p><strong>Read this before using the numbers:</strong></p>\n<ul>\n{items}</ul></div>\n"
    )
}

/// Names and values.
pub(super) fn facts_table<'a, N, V>(rows: &'a [(N, V)]) -> String
where
    Html: From<&'a N> + From<&'a V>,
{
    let row =
        |(name, value): &'a (N, V)| format!("<tr><td>{}</td><td>{}</td></tr>\n", Html::from(name), Html::from(value));
    let rows: String = rows.iter().map(row).collect();
    format!("<div class=\"scroll\"><table class=\"facts\"><tbody>\n{rows}</tbody></table></div>\n")
}

/// What would indicate trouble in the plot or table above; not a verdict on this one.
pub(super) fn trouble(signs: &str) -> String {
    format!("<p class=\"signs\"><strong>Signs of trouble:</strong> {signs}</p>\n")
}

/// A picture (a JPEG) with a caption.
pub(super) fn picture(jpeg: &[u8], caption: impl Into<Html>) -> String {
    let (caption, data) = (caption.into(), BASE64_STANDARD.encode(jpeg));
    format!(
        "<figure><img alt=\"{caption}\" \
         src=\"data:image/jpeg;base64,{data}\"><figcaption>{caption}</figcaption></figure>\n"
    )
}

/// Numbers in a text that has no hyphens, with a typographic minus.
pub(super) fn minus(numbers: impl AsRef<str>) -> String {
    numbers.as_ref().replace('-', "−")
}

/// With a sign, and a typographic minus.
pub(super) fn signed(value: f64, digits: usize) -> String {
    let text = format!("{value:+.digits$}");
    // A value that rounds to zero has no sign.
    let zero = text.chars().all(|c| !c.is_ascii_digit() || c == '0');
    if zero { text.trim_start_matches(['+', '-']).to_owned() } else { minus(text) }
}

/// The foot of a page: who made it, and what the numbers are.
pub(super) fn footer(numbers: &str) -> String {
    let space = if numbers.is_empty() { "" } else { " " };
    format!("<footer>Catoptra {}.{space}{numbers} This file needs no network.</footer>\n", env!("CARGO_PKG_VERSION"))
}

/// A page around `body`. `title` is text, `body` HTML.
pub(super) fn page(title: &str, body: &str) -> String {
    parts(&escape(title), body).concat()
}

/// Makes what all pages have in common, once, so that writing one takes less time.
pub(super) fn prepare() {
    plotly_script();
}

/// Writes the same page. The script is most of it, and is not copied.
///
/// # Errors
/// Those of `out`.
pub(super) fn write_page(out: &mut impl Write, title: &str, body: &str) -> io::Result<()> {
    parts(&escape(title), body).iter().try_for_each(|part| out.write_all(part.as_bytes()))
}

fn parts<'a>(title: &'a str, body: &'a str) -> [&'a str; 17] {
    [
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"",
        POLICY,
        "\">\n<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>",
        title,
        "</title>\n<style>\n",
        STYLE,
        "</style>\n",
        plotly_script(),
        "\n<script>\n",
        SAVE,
        "</script>\n</head>\n<body>\n<main>\n",
        body,
        "<noscript><p class=\"note\">The plots of this page are drawn by its own script; scripts are switched off \
         here.</p></noscript>\n</main>\n<script>\n",
        LINK,
        SCENE,
        PRINT,
        "</script>\n</body>\n</html>\n",
    ]
}

/// The plotting library as a script element, made once. The crate returns it together with MathJax, which is not used
/// here and would load more from elsewhere, so only the first element is taken.
fn plotly_script() -> &'static str {
    const END: &str = "</script>";
    static SCRIPT: OnceLock<String> = OnceLock::new();
    SCRIPT.get_or_init(|| {
        let mut both = Plot::offline_js_sources();
        if let Some(end) = both.find(END) {
            both.truncate(end + END.len());
            both.shrink_to_fit();
        }
        both
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_script_is_plotly_alone() {
        let script = plotly_script();
        assert!(script.contains("plotly.js v"));
        assert_eq!((script.matches("<script").count(), script.matches("</script>").count()), (1, 1));
        assert!(!script.contains("MathJax.loader"));
    }

    #[test]
    fn cells_and_cards_are_text_until_said_otherwise() {
        let cells = table(1, &["a<b"], &[vec![Html::from("x & y"), Html::raw("<em>z</em>")]]);
        assert!(cells.contains("<th class=\"text\">a&lt;b</th>"), "{cells}");
        assert!(cells.contains("<td class=\"text\">x &amp; y</td><td><em>z</em></td>"), "{cells}");
        assert!(card("a<b", "1".to_owned(), "<c>", false).contains("<dt>a&lt;b</dt><dd>1 <small>&lt;c&gt;</small>"));
        assert!(facts_table(&[("<a>", "b<")]).contains("<td>&lt;a&gt;</td><td>b&lt;</td>"));
    }
}
