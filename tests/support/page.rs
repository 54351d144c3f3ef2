//! A page of Markdown: its links, headings and blocks of code.
#![allow(dead_code, reason = "not every test crate uses all of it")]

use std::collections::BTreeSet;
use std::path::Path;

use pulldown_cmark::{CodeBlockKind, Event, Options, Parser, Tag, TagEnd};

/// What a page holds.
#[derive(Default)]
pub struct Page {
    pub links: Vec<String>,
    /// Names of its headings in links, as GitHub and mdBook make them.
    pub anchors: BTreeSet<String>,
    /// Blocks of code with what stands behind their fence.
    pub blocks: Vec<(String, String)>,
}

impl Page {
    pub fn new(text: &str) -> Self {
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

    pub fn open(path: &Path) -> Self {
        Self::new(
            &std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display())),
        )
    }
}
