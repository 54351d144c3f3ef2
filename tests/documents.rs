//! The documents: links lead somewhere, every page is in the book, the reference says what the program does.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use pulldown_cmark::{CodeBlockKind, Event, Options, Parser, Tag, TagEnd};

#[path = "support/program.rs"]
mod program;
use program::run;

/// Folders of what is built or installed, not written.
const BUILT: [&str; 5] = ["target", ".git", ".venv", "node_modules", "out"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|e| panic!("{path}: {e}"))
}

/// The Markdown files in and below a folder.
fn pages(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let paths = entries.map(|entry| entry.expect("a readable folder").path());
    let written = paths.filter(|path| !BUILT.iter().any(|built| path.ends_with(built)));
    let each = written.flat_map(|path| if path.is_dir() { pages(&path) } else { vec![path] });
    each.filter(|path| path.extension().is_some_and(|end| end == "md")).collect()
}

/// What a page holds.
#[derive(Default)]
struct Page {
    links: Vec<String>,
    /// Names of its headings in links, as GitHub and mdBook make them.
    anchors: BTreeSet<String>,
    /// Blocks of code with what stands behind their fence.
    blocks: Vec<(String, String)>,
}

impl Page {
    fn new(text: &str) -> Self {
        let (mut page, mut heading, mut block) = (Self::default(), None, None);
        for event in Parser::new_ext(text, Options::ENABLE_TABLES) {
            match event {
                Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
                    page.links.push(dest_url.into_string());
                }
                Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
                Event::End(TagEnd::Heading(_)) => {
                    let name = heading.take().unwrap_or_default().to_lowercase();
                    let kept = name.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
                    page.anchors.insert(kept.collect::<String>().replace(' ', "-"));
                }
                Event::Start(Tag::CodeBlock(CodeBlockKind::Fenced(kind))) => {
                    block = Some((kind.into_string(), String::new()));
                }
                Event::End(TagEnd::CodeBlock) => page.blocks.extend(block.take()),
                Event::Text(text) | Event::Code(text) => {
                    if let Some(into) = heading.as_mut().or(block.as_mut().map(|(_, code)| code)) {
                        into.push_str(&text);
                    }
                }
                _ => {}
            }
        }
        page
    }

    fn open(path: &Path) -> Self {
        Self::new(
            &std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display())),
        )
    }
}

#[test]
fn links_lead_somewhere() {
    let paths = pages(root());
    assert!(paths.len() > 20, "{} pages", paths.len());
    let mut lost = Vec::new();
    for path in paths {
        let page = Page::open(&path);
        for link in &page.links {
            if link.contains("://") || link.starts_with("mailto:") {
                continue;
            }
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = path.parent().expect("a folder").join(file);
            let target = if file.is_empty() { path.clone() } else { target };
            let there = target.exists()
                && (anchor.is_empty() || Page::open(&target).anchors.contains(anchor));
            if !there {
                lost.push(format!("{}: {link}", path.display()));
            }
        }
    }
    assert!(lost.is_empty(), "{lost:#?}");
}

#[test]
fn every_page_is_in_the_book() {
    let docs = root().join("docs");
    let listed: BTreeSet<_> =
        Page::open(&docs.join("SUMMARY.md")).links.iter().map(|link| docs.join(link)).collect();
    let written: BTreeSet<_> =
        pages(&docs).into_iter().filter(|path| !path.ends_with("SUMMARY.md")).collect();
    assert_eq!(listed, written, "docs/SUMMARY.md (left) against docs/");
}

/// A reader sees in three minutes what it is.
#[test]
fn the_readme_is_short() {
    let text = read("README.md");
    assert!(text.lines().count() <= 150 && text.len() <= 9_000, "{} bytes", text.len());
}

#[test]
fn the_reference_lists_the_options() {
    let ran = run(root(), &["shell", "--markdown"]);
    assert!(
        ran.stdout == read("docs/reference/cli.md"),
        "smr-gpu shell --markdown > docs/reference/cli.md"
    );
}

/// Paths of the fields of an object, those of a list's first entry too.
fn fields(value: &serde_json::Value, at: &str, into: &mut BTreeMap<String, &'static str>) {
    use serde_json::Value::*;
    let kind = match value {
        Null => "null",
        Bool(_) => "boolean",
        Number(_) => "number",
        String(_) => "string",
        Array(entries) => {
            entries.first().into_iter().for_each(|first| fields(first, &format!("{at}[]"), into));
            "list"
        }
        Object(entries) => {
            entries.iter().for_each(|(name, value)| fields(value, &format!("{at}.{name}"), into));
            "object"
        }
    };
    into.insert(at.to_owned(), kind);
}

/// The page's line has the fields that `detect --json` prints, of the same types but where one is null.
#[test]
fn the_page_about_json_shows_a_line() {
    let page = Page::new(&read("docs/reference/json.md"));
    let (_, shown) = page.blocks.iter().find(|(kind, _)| kind == "json").expect("a block of JSON");
    let ran = run(
        root(),
        &["detect", "samples/hooks.png", "--json", "--device", "cpu", "--weights", "small"],
    );
    let [shown, printed] = [shown.as_str(), &ran.stdout].map(|text| {
        let mut found = BTreeMap::new();
        fields(&serde_json::from_str(text).expect("JSON"), "", &mut found);
        found
    });
    assert_eq!(shown.keys().collect::<Vec<_>>(), printed.keys().collect::<Vec<_>>());
    for (name, kind) in shown {
        assert!(kind == printed[&name] || [kind, printed[&name]].contains(&"null"), "{name}");
    }
}

/// Each code that the program's help names is in the table.
#[test]
fn the_exit_codes_are_those_of_the_help() {
    let help = run(root(), &["--help"]).stdout;
    let named = help.split("Exit codes: ").nth(1).expect("exit codes").split(", ");
    let named: Vec<_> =
        named.filter_map(|code| code.split(' ').next()?.parse::<u8>().ok()).collect();
    let table = read("docs/reference/exit-codes.md");
    let listed = table.lines().filter_map(|line| line.split('|').nth(1)?.trim().parse::<u8>().ok());
    assert_eq!(named, listed.collect::<Vec<_>>());
}
