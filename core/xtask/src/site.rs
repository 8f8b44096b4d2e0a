//! The documentation as a web site: one page per Markdown file of the repository, with the files that pages link to.

mod links;

use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use pulldown_cmark::{CowStr, Event, Options, Parser, Tag, TagEnd, html};

use crate::package::tree::{copy, write};
use crate::process::capture;
use crate::workspace::Workspace;
use links::{Anchors, Link};

/// Folders whose pages are written for other places: templates of plugins, and files of packages.
const ELSEWHERE: [&str; 2] = ["core/cli/templates/", "core/xtask/package/"];
/// The page's sections in the order of the navigation: folder, title.
const SECTIONS: [(&str, &str); 5] =
    [("graphs/", "Graphs"), ("plugins/", "Plugins"), ("editor/", "Windows"), ("core/", "Core"), ("tests/", "Tests")];
const STYLE: &str = include_str!("../site/style.css");

/// A Markdown file.
struct Page {
    /// Path in the repository.
    file: PathBuf,
    title: String,
    text: String,
}

/// Writes the site into `dir`; returns the number of pages.
///
/// # Errors
/// A link of a page leads nowhere (all such links are named), git cannot list the files, or a file cannot be written.
pub fn site(workspace: &Workspace, dir: &Path) -> Result<usize> {
    let pages = pages(&workspace.root)?;
    let anchors: Anchors = pages.iter().map(|page| (page.file.clone(), headings(&page.text))).collect();
    let mut broken = String::new();
    let mut copied = BTreeSet::new();
    for page in &pages {
        let (mut events, mut is_plain) = (Vec::new(), false);
        let mut anchor = headings(&page.text).into_iter();
        for event in Parser::new_ext(&page.text, options()) {
            events.push(match event {
                Event::Start(Tag::Heading { level, classes, attrs, .. }) => {
                    Event::Start(Tag::Heading { level, id: anchor.next().map(CowStr::from), classes, attrs })
                }
                Event::Start(Tag::Link { link_type, dest_url, title, id }) => {
                    let dest_url = follow(&workspace.root, page, &dest_url, &anchors, &mut broken, &mut copied)?;
                    let Some(dest_url) = dest_url.map(CowStr::from) else {
                        is_plain = true;
                        continue;
                    };
                    Event::Start(Tag::Link { link_type, dest_url, title, id })
                }
                Event::End(TagEnd::Link) if std::mem::take(&mut is_plain) => continue,
                Event::Start(Tag::Image { link_type, dest_url, title, id }) => {
                    let dest_url = follow(&workspace.root, page, &dest_url, &anchors, &mut broken, &mut copied)?;
                    Event::Start(Tag::Image { link_type, dest_url: dest_url.unwrap_or_default().into(), title, id })
                }
                other => other,
            });
        }
        let mut body = String::new();
        html::push_html(&mut body, events.into_iter());
        write(&dir.join(links::target(&page.file)), framed(page, &pages, &body))?;
    }
    if !broken.is_empty() {
        bail!("links that lead nowhere:\n{broken}");
    }
    for file in &copied {
        copy(&workspace.root.join(file), &dir.join(file))?;
    }
    Ok(pages.len())
}

fn options() -> Options {
    Options::ENABLE_TABLES | Options::ENABLE_STRIKETHROUGH
}

/// The Markdown files under version control.
fn pages(root: &Path) -> Result<Vec<Page>> {
    let list = capture(Command::new("git").current_dir(root).args(["ls-files", "*.md"]))?;
    let files = list.lines().filter(|file| !ELSEWHERE.iter().any(|folder| file.starts_with(folder)));
    files
        .map(|file| {
            let text = fs::read_to_string(root.join(file)).with_context(|| format!("cannot read {file}"))?;
            let title = text.lines().find_map(|line| line.strip_prefix("# ")).unwrap_or(file).replace('`', "");
            Ok(Page { file: file.into(), title, text })
        })
        .collect()
}

/// Anchors of the headings of a page, in order, as code hosts make them.
fn headings(text: &str) -> Vec<String> {
    let (mut found, mut heading) = (Vec::new(), None);
    for event in Parser::new_ext(text, options()) {
        match event {
            Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
            Event::Text(words) | Event::Code(words) => {
                if let Some(heading) = &mut heading {
                    heading.push_str(&words);
                }
            }
            Event::End(TagEnd::Heading(_)) => found.extend(heading.take().map(|words| links::anchor(&words))),
            _ => {}
        }
    }
    found
}

/// The address of a link on the site; `None` for a folder without a page. Files that are no pages are copied.
fn follow(
    root: &Path,
    page: &Page,
    address: &str,
    anchors: &Anchors,
    broken: &mut String,
    copied: &mut BTreeSet<PathBuf>,
) -> Result<Option<String>> {
    Ok(match links::resolve(root, &page.file, address, anchors) {
        Link::Outside => Some(address.to_owned()),
        Link::Page { address } => Some(address),
        Link::File { file, address } => {
            copied.insert(file);
            Some(address)
        }
        Link::Folder => None,
        Link::Nowhere { why } => {
            writeln!(broken, "  {}: {address}: {why}", page.file.display())?;
            None
        }
    })
}

/// A whole page, with navigation.
fn framed(page: &Page, pages: &[Page], body: &str) -> String {
    let up = "../".repeat(page.file.components().count() - 1);
    let mut navigation = String::new();
    let entry = |other: &Page| {
        let here = if other.file == page.file { " class=\"here\"" } else { "" };
        format!("<a{here} href=\"{up}{}\">{}</a>\n", links::target(&other.file).display(), escaped(&other.title))
    };
    navigation.extend(pages.iter().filter(|other| other.file == Path::new("README.md")).map(entry));
    for (folder, title) in SECTIONS {
        let _ = writeln!(navigation, "<b>{title}</b>");
        navigation.extend(pages.iter().filter(|other| other.file.starts_with(folder)).map(entry));
    }
    let title = escaped(&page.title);
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width\">\n\
         <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<nav>\n{navigation}</nav>\n<main>\n{body}</main>\n</body>\n</html>\n"
    )
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_page_of_the_repository_is_on_the_site_and_every_link_leads_somewhere() {
        let dir = std::env::temp_dir().join(format!("xtask_site_{}", std::process::id()));
        let _ = fs::remove_dir_all(&dir);
        let workspace = Workspace::locate().unwrap();
        let count = site(&workspace, &dir).unwrap();
        assert!(count > 15, "{count} pages");
        let first = fs::read_to_string(dir.join("index.html")).unwrap();
        assert!(first.contains("<main>") && first.contains("href=\"graphs/index.html\"") && !first.contains(".md\""));
        for picture in first.split("<img src=\"").skip(1).filter_map(|rest| rest.split('"').next()) {
            assert!(dir.join(picture).is_file(), "{picture}");
        }
        fs::remove_dir_all(&dir).unwrap();
    }

    #[test]
    fn headings_get_the_anchors_of_code_hosts() {
        assert_eq!(headings("# A `b` c\n\n## What's new?\n"), ["a-b-c", "whats-new"]);
    }
}
