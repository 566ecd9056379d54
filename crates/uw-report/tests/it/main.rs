//! A page as a browser's parser reads it.
#![allow(clippy::unwrap_used)]

mod sample;

use sample::{EVIL, page};
use scraper::{Html, Selector};

fn all<'a>(html: &'a Html, selector: &str) -> Vec<scraper::ElementRef<'a>> {
    html.select(&Selector::parse(selector).unwrap()).collect()
}

fn text(element: &scraper::ElementRef<'_>) -> String {
    element.text().collect::<String>().trim().to_owned()
}

#[test]
fn a_page_is_well_formed_and_the_same_every_time() {
    let written = page().html().unwrap();
    assert_eq!(written, page().html().unwrap());
    let html = Html::parse_document(&written);
    assert!(html.errors.is_empty(), "{:?}", html.errors);
    assert_eq!(text(&all(&html, "h1")[0]), format!("A page {EVIL}"));
    assert_eq!(all(&html, "script").len(), 1, "only the page's own script is one");
}

#[test]
fn a_page_asks_for_nothing() {
    let written = page().html().unwrap();
    let html = Html::parse_document(&written);
    for element in html.root_element().descendent_elements() {
        for (name, value) in element.value().attrs() {
            let refers = ["href", "src", "srcset", "action", "poster", "data", "xlink:href"].contains(&name);
            assert!(!refers || value.starts_with('#') || value == "data:,", "{name}={value}");
        }
    }
    for foreign in ["http:", "https:", "url(", "@import", "fetch(", "XMLHttpRequest", "WebSocket"] {
        assert!(!written.contains(foreign), "{foreign} is in the page");
    }
}

#[test]
fn who_does_not_see_the_page_is_told_what_is_there() {
    let written = page().html().unwrap();
    let html = Html::parse_document(&written);
    let ids: Vec<&str> = all(&html, "[id]").iter().filter_map(|e| e.value().attr("id")).collect();
    let mut different = ids.clone();
    different.sort_unstable();
    different.dedup();
    assert_eq!(ids.len(), different.len(), "an id stands twice");
    for name in ["aria-labelledby", "aria-describedby"] {
        for element in all(&html, &format!("[{name}]")) {
            for id in element.value().attr(name).unwrap().split_whitespace() {
                assert!(ids.contains(&id), "{name} names {id}, which is not there");
            }
        }
    }
    let plots = all(&html, ".plot svg");
    assert_eq!(plots.len(), 2);
    for plot in &plots {
        assert_eq!(plot.value().attr("role"), Some("img"));
        let parts: Vec<&str> = plot.child_elements().map(|e| e.value().name()).collect();
        assert_eq!(parts[..2], ["title", "desc"]);
    }
    for canvas in all(&html, "canvas") {
        assert_eq!(canvas.value().attr("tabindex"), Some("0"));
        assert_eq!(canvas.value().attr("aria-label"), Some(format!("A wavy sheet {EVIL}").as_str()));
    }
    assert!(
        all(&html, "table").iter().all(|t| t.child_elements().next().unwrap().value().name() == "caption")
    );
    // A heading's rank is one more than that of the part around it.
    let ranks: Vec<&str> = all(&html, "h1,h2,h3,h4").iter().map(|h| h.value().name()).collect();
    assert_eq!(ranks, ["h1", "h2", "h3", "h2"]);
}

#[test]
fn a_figure_has_its_whole_value_and_its_place() {
    let written = page().html().unwrap();
    let html = Html::parse_document(&written);
    let figures = all(&html, "data");
    assert_eq!(text(&figures[0]), "20.017 ± 0.012");
    assert_eq!(figures[0].value().attr("data-at"), Some("/figures/0/value"));
    let value: f64 = figures[0].value().attr("value").unwrap().parse().unwrap();
    assert_eq!(value.to_bits(), 20.017_025_562_703_7_f64.to_bits());
}
