//! Imports between modules of `src`: only those that ARCHITECTURE.md allows, and never circular. Test-only code is
//! exempt.
//!
//! Reads the tokens of every file. A path counts if it begins with `crate`, `super`, `self` or a module of the same
//! file; a re-exported item counts for the file that defines it. Paths built by macros are not seen.

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// Names from the crate's root down.
type Name = Vec<String>;

/// A path in the code, from the crate's root down, and its line.
struct Import {
    path: Name,
    line: usize,
    /// A `pub use`: it names where an item is found, and takes nothing from it.
    public: bool,
}

struct Module {
    /// Relative to the repository.
    file: String,
    imports: Vec<Import>,
    /// What `pub use` gives another place, by its name here.
    exports: BTreeMap<String, Name>,
}

struct Tree {
    modules: BTreeMap<Name, Module>,
}

static TREE: LazyLock<Tree> = LazyLock::new(Tree::read);

impl Tree {
    fn read() -> Self {
        let mut tree = Self { modules: BTreeMap::new() };
        tree.file(&root().join("src/lib.rs"), &[], &root().join("src"));
        tree
    }

    /// Reads a file as the module `name`, whose modules are in `folder`.
    fn file(&mut self, path: &Path, name: &[String], folder: &Path) {
        let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let tokens: TokenStream = text.parse().unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let file = path.strip_prefix(root()).unwrap().to_string_lossy().into_owned();
        self.scan(tokens, name, &file, folder);
    }

    fn scan(&mut self, tokens: TokenStream, name: &[String], file: &str, folder: &Path) {
        let module = Module { file: file.to_owned(), imports: Vec::new(), exports: BTreeMap::new() };
        self.modules.insert(name.to_vec(), module);
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        self.items(&tokens, name, folder);
    }

    fn items(&mut self, tokens: &[TokenTree], name: &[String], folder: &Path) {
        let mut rest = tokens;
        let (mut for_tests, mut public) = (false, false);
        while let Some(token) = rest.first() {
            match token {
                TokenTree::Punct(punct) if punct.as_char() == '#' && is_group(rest.get(1), Delimiter::Bracket) => {
                    for_tests |= rest[1].to_string().replace(' ', "") == "[cfg(test)]";
                    rest = &rest[2..];
                    continue;
                }
                _ if for_tests => {
                    rest = after_item(rest);
                    for_tests = false;
                    continue;
                }
                TokenTree::Ident(ident) if ident == "pub" => {
                    public = true;
                    rest = &rest[1..];
                    if is_group(rest.first(), Delimiter::Parenthesis) {
                        rest = &rest[1..];
                    }
                    continue;
                }
                TokenTree::Ident(ident) if ident == "mod" => {
                    let child = [name, &[rest[1].to_string()]].concat();
                    let own = folder.join(rest[1].to_string());
                    match &rest[2] {
                        TokenTree::Group(group) => {
                            let file = self.modules[name].file.clone();
                            self.scan(group.stream(), &child, &file, &own);
                        }
                        _ if own.join("mod.rs").exists() => self.file(&own.join("mod.rs"), &child, &own),
                        _ => self.file(&own.with_extension("rs"), &child, &own),
                    }
                    rest = &rest[3..];
                }
                TokenTree::Ident(ident) if ident == "use" && !is_punct(rest.get(1), '<') => {
                    let end = after_item(rest);
                    let tree = &rest[1..rest.len() - end.len() - 1];
                    let mut leaves = Vec::new();
                    use_tree(tree, &[], &mut leaves);
                    for (path, alias, line) in leaves {
                        self.import(name, path, Some(alias), line, public);
                    }
                    rest = end;
                }
                TokenTree::Group(group) => {
                    let inner: Vec<TokenTree> = group.stream().into_iter().collect();
                    self.items(&inner, name, folder);
                    rest = &rest[1..];
                }
                TokenTree::Ident(_) => {
                    let (path, after) = path_at(rest);
                    if path.len() > 1 {
                        self.import(name, path, None, token.span().start().line, false);
                    }
                    rest = after;
                }
                // Of `a::b` inside of a path that began before, or of a method: no beginning of a path.
                TokenTree::Punct(punct) if punct.as_char() == '$' => rest = rest.get(2..).unwrap_or_default(),
                _ => rest = &rest[1..],
            }
            public = false;
        }
    }

    /// Notes a path of module `name` if it leads into the crate.
    fn import(&mut self, name: &[String], path: Name, alias: Option<String>, line: usize, public: bool) {
        let mut from = name.to_vec();
        let mut path = path.as_slice();
        match path[0].as_str() {
            "crate" => {
                from.clear();
                path = &path[1..];
            }
            "self" => path = &path[1..],
            "super" => {
                while path.first().is_some_and(|part| part == "super") {
                    from.pop();
                    path = &path[1..];
                }
            }
            // Later, when all modules are known, it is one of this crate or not.
            _ => {}
        }
        let path = [&from, path].concat();
        let module = self.modules.get_mut(name).unwrap();
        if let (true, Some(alias)) = (public, alias) {
            module.exports.insert(alias, path.clone());
        }
        module.imports.push(Import { path, line, public });
    }

    /// The module that defines what a path names; `None` for what is not of this crate.
    fn target(&self, path: &[String]) -> Option<&Name> {
        let depth = (1..=path.len()).rev().find(|depth| self.modules.contains_key(&path[..*depth]))?;
        let (name, module) = self.modules.get_key_value(&path[..depth])?;
        match path.get(depth).and_then(|item| module.exports.get(item)) {
            Some(export) if export.as_slice() != path => self.target(&[export, &path[depth + 1..]].concat()),
            _ => Some(name),
        }
    }

    /// Every import that takes something from another file: from module, to module, line.
    fn arrows(&self) -> impl Iterator<Item = (&Name, &Name, usize)> {
        self.modules.iter().flat_map(move |(name, module)| {
            module.imports.iter().filter(|import| !import.public).filter_map(move |import| {
                let target = self.target(&import.path)?;
                // An item of the module itself, or of an inline one, is no import.
                (self.modules[target].file != module.file).then_some((name, target, import.line))
            })
        })
    }
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn is_group(token: Option<&TokenTree>, delimiter: Delimiter) -> bool {
    matches!(token, Some(TokenTree::Group(group)) if group.delimiter() == delimiter)
}

fn is_punct(token: Option<&TokenTree>, char: char) -> bool {
    matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == char)
}

/// What follows an item: a `use` or a constant ends with a semicolon, others with their braces if they have any.
fn after_item(tokens: &[TokenTree]) -> &[TokenTree] {
    let ends_with_semicolon =
        tokens.iter().take(3).any(|t| ["use", "const", "static", "type"].contains(&t.to_string().as_str()));
    let ends = |t: &TokenTree| is_punct(Some(t), ';') || !ends_with_semicolon && is_group(Some(t), Delimiter::Brace);
    tokens.iter().position(ends).map_or(&[], |end| &tokens[end + 1..])
}

/// The path that begins here, as far as it is made of names, and what follows it.
fn path_at(tokens: &[TokenTree]) -> (Name, &[TokenTree]) {
    let mut path = Vec::new();
    let mut rest = tokens;
    while let Some(TokenTree::Ident(ident)) = rest.first() {
        path.push(ident.to_string());
        rest = &rest[1..];
        if !(is_punct(rest.first(), ':') && is_punct(rest.get(1), ':')) {
            break;
        }
        rest = &rest[2..];
    }
    (path, rest)
}

/// The leaves of a `use`: path, name here, line.
fn use_tree(tokens: &[TokenTree], before: &[String], leaves: &mut Vec<(Name, String, usize)>) {
    for branch in tokens.split(|t| is_punct(Some(t), ',')).filter(|branch| !branch.is_empty()) {
        let (path, rest) = path_at(branch);
        let mut path = [before, &path].concat();
        match rest.first() {
            Some(TokenTree::Group(group)) => {
                use_tree(&group.stream().into_iter().collect::<Vec<_>>(), &path, leaves);
                continue;
            }
            // `self` in braces is what stands before them.
            _ if path.len() > 1 && path.last().is_some_and(|last| last == "self") => drop(path.pop()),
            _ => {}
        }
        let alias = match rest {
            [TokenTree::Ident(word), alias, ..] if word == "as" => alias.to_string(),
            _ => path.last().cloned().unwrap_or_default(),
        };
        leaves.push((path, alias, branch[0].span().start().line));
    }
}

fn architecture_md() -> String {
    std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap()
}

/// From ARCHITECTURE.md: a row a module, low ones first, and what it may import.
fn allowed() -> Vec<(String, BTreeSet<String>)> {
    let text = architecture_md();
    let (_, table) = text.split_once("| module | may import |\n").expect("ARCHITECTURE.md has the table");
    let names = |cell: &str| {
        let names = cell.split('`').skip(1).step_by(2).map(str::to_owned);
        names.collect::<Vec<_>>()
    };
    let rows = table.lines().skip(1).take_while(|line| line.starts_with('|'));
    rows.map(|row| {
        let cells: Vec<&str> = row.split('|').collect();
        (names(cells[1]).remove(0), names(cells[2]).into_iter().collect())
    })
    .collect()
}

#[test]
fn modules_import_only_what_architecture_md_allows() {
    let (tree, allowed) = (&*TREE, allowed());
    let mut wrong = Vec::new();
    let mut unused: BTreeSet<(&str, &str)> = BTreeSet::new();
    for (i, (module, imports)) in allowed.iter().enumerate() {
        for import in imports {
            unused.insert((module, import));
            if !allowed[..i].iter().any(|(lower, _)| lower == import) {
                wrong.push(format!(
                    "ARCHITECTURE.md: `{module}` may import `{import}`, which is not above it in the table"
                ));
            }
        }
    }
    let top: BTreeSet<&str> = tree.modules.keys().filter_map(|name| name.first()).map(String::as_str).collect();
    let rows: BTreeSet<&str> = allowed.iter().map(|(module, _)| module.as_str()).collect();
    assert_eq!(rows, top, "the table of ARCHITECTURE.md has not the modules of src");
    for (from, to, line) in tree.arrows() {
        let (Some(own), Some(other)) = (from.first(), to.first()) else { continue };
        if own == other {
            continue;
        }
        unused.remove(&(own.as_str(), other.as_str()));
        if !allowed.iter().any(|(module, imports)| module == own && imports.contains(other)) {
            wrong.push(format!(
                "{}:{line}: `{own}` may not import `{other}` ({})",
                tree.modules[from].file,
                to.join("::")
            ));
        }
    }
    wrong.extend(unused.iter().map(|(own, other)| format!("ARCHITECTURE.md: `{own}` no longer imports `{other}`")));
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn files_do_not_import_each_other_in_a_circle() {
    let tree = &*TREE;
    let mut graph: BTreeMap<&str, BTreeMap<&str, usize>> = BTreeMap::new();
    // A file may use what the module that it is a part of defines.
    for (from, to, line) in tree.arrows().filter(|(from, to, _)| !from.starts_with(to)) {
        let [from, to] = [from, to].map(|name| tree.modules[name].file.as_str());
        graph.entry(from).or_default().entry(to).or_insert(line);
    }
    let reached = |start: &str| {
        let mut reached = BTreeSet::new();
        let mut next: Vec<&str> = graph.get(start).into_iter().flat_map(|to| to.keys().copied()).collect();
        while let Some(file) = next.pop() {
            if reached.insert(file) {
                next.extend(graph.get(file).into_iter().flat_map(|to| to.keys().copied()));
            }
        }
        reached
    };
    let reached: BTreeMap<&str, BTreeSet<&str>> = graph.keys().map(|file| (*file, reached(file))).collect();
    let circles = graph.iter().flat_map(|(from, to)| to.iter().map(move |(to, line)| (from, to, line)));
    let circles = circles.filter(|(from, to, _)| reached.get(*to).is_some_and(|reached| reached.contains(*from)));
    let wrong: Vec<String> =
        circles.map(|(from, to, line)| format!("{from}:{line}: imports {to}, which leads back here")).collect();
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn the_front_page_of_the_documentation_shows_the_same_picture() {
    let picture = |text: &str| {
        let (_, after) = text.split_once("```text\n").unwrap();
        after.split("```").next().unwrap().lines().map(str::trim_end).collect::<Vec<_>>().join("\n")
    };
    let front = std::fs::read_to_string(root().join("src/lib.rs")).unwrap();
    let front: Vec<&str> = front
        .lines()
        .map_while(|line| line.strip_prefix("//!"))
        .map(|line| line.strip_prefix(' ').unwrap_or(line))
        .collect();
    assert_eq!(picture(&architecture_md()), picture(&front.join("\n")));
}
