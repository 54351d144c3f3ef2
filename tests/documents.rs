//! The documents: links lead somewhere, every page is in the book, the reference says what the program does.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde_json::Value;
use sha2::{Digest, Sha256};

#[path = "support/page.rs"]
mod page;
#[path = "support/program.rs"]
mod program;
use page::Page;
use program::{ramp, run};

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

/// What tools/report.py writes is there, and was measured with the weights of this checkout.
#[test]
fn tables_are_of_these_weights() {
    let digest = |(name, file): (&str, &str)| {
        let bytes = std::fs::read(root().join("weights").join(file)).expect("weights");
        let hex: String = Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect();
        format!("{name} `{}`", &hex[..12])
    };
    let networks = [("large", "smrnet.safetensors"), ("small", "smrnet-s.safetensors")];
    let today = format!("Weights: {}.", networks.map(digest).join(", "));
    let mut tables = 0;
    for path in pages(root()) {
        let text = std::fs::read_to_string(&path).expect("a page");
        for table in text.split("<!-- report: ").skip(1) {
            let (name, rest) = table.split_once(" -->\n").expect("a name");
            let (table, _) = rest.split_once("<!-- end -->").expect("an end");
            let is_printed = name == "samples" && table.contains("$ smr-gpu");
            assert!(is_printed || table.contains(&today), "{}: {name}: {today}", path.display());
            tables += 1;
        }
    }
    let listed = read("tools/report.py");
    let listed = listed.split("TABLES = {").nth(1).expect("a list").split('}').next();
    assert_eq!(listed.map(|list| list.matches("\": (").count()), Some(tables));
}

/// Makes every object of a schema refuse fields that it does not name, which users' copies let pass.
fn name_all_fields(schema: &mut Value) {
    match schema {
        Value::Array(entries) => entries.iter_mut().for_each(name_all_fields),
        Value::Object(entries) => {
            entries.values_mut().for_each(name_all_fields);
            if entries.get("type").is_some_and(|kind| kind == "object") {
                entries.insert("additionalProperties".to_owned(), Value::Bool(false));
            }
        }
        _ => {}
    }
}

/// What `detect --json` prints, and what the page shows, is what the schema says.
#[test]
fn the_schema_describes_the_lines_of_json() {
    let mut schema =
        serde_json::from_str(&read("docs/reference/detect.schema.json")).expect("JSON");
    jsonschema::meta::validate(&schema).expect("a schema");
    name_all_fields(&mut schema);
    let schema = jsonschema::validator_for(&schema).expect("a schema");
    let page = Page::new(&read("docs/reference/json.md"));
    let (_, shown) = page.blocks.iter().find(|(kind, _)| kind == "json").expect("a block of JSON");
    let mut lines = vec![serde_json::from_str(shown).expect("JSON")];
    let bare = tempfile::tempdir().expect("a folder");
    ramp(96, 64).save(bare.path().join("bare.png")).expect("saved");
    let bare = bare.path().join("bare.png").to_str().expect("a name").to_owned();
    for options in [
        "samples/hooks.png --mm-per-pixel 0.04",
        "samples/hooks.png --sensor paper --exact",
        &format!("{bare} samples/stud.png"),
    ] {
        let mut line = vec!["detect", "--json", "--device", "cpu", "--weights", "small"];
        line.extend(options.split(' '));
        lines.extend(run(root(), &line).expect(0).json());
    }
    assert_eq!(lines.len(), 5);
    for line in &lines {
        let wrong: Vec<_> = schema.iter_errors(line).map(|e| e.to_string()).collect();
        assert!(wrong.is_empty(), "{wrong:#?} of {line}");
    }
    // It refuses what is not so.
    let mut other = lines[1].clone();
    other["detections"][0]["box"] = serde_json::json!([1, 2, 3]);
    assert!(!schema.is_valid(&other));
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
