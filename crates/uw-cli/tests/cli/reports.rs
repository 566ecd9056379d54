//! `report`, and the page of `calibrate --report`.

use std::{fs, path::Path, sync::LazyLock};

use assert_cmd::cargo::cargo_bin_cmd;
use scraper::{Html, Selector};
use serde_json::Value;
use tempfile::TempDir;

use crate::{
    job::{calibration, calibration_report, reconstruct},
    samples::{fixture, names, part_of, uwscan},
};

/// What a cut-down calibration and every second image leave of the ball's radius, mm.
const RADIUS_TOLERANCE_MM: f64 = 0.3;
const NOMINAL: &str = "kind,a,b,value_mm\nradius,ball,,20.0175\n";
/// Sunday 13 September 2020, 12:26:40.
const MADE: (&str, &str) = ("1600000000", "2020-09-13T12:26:40Z");

/// A folder with a part of the ball's capture, its cloud, nominal values, and a report on both scans.
static REPORTED: LazyLock<(TempDir, String)> = LazyLock::new(|| {
    let dir = TempDir::new().unwrap();
    let scan = part_of("ball", |row, _| row.is_multiple_of(2));
    fs::rename(scan.path(), dir.path().join("ball")).unwrap();
    reconstruct(&dir.path().join("ball"), &dir.path().join("cloud.ply"), &[]).text();
    fs::write(dir.path().join("nominal.csv"), NOMINAL).unwrap();
    let printed = report(dir.path(), "report.html", &["--json"]);
    (dir, printed)
});

/// Reports on capture and cloud of a folder into one of its files; what is printed.
fn report(dir: &Path, page: &str, more: &[&str]) -> String {
    let calibration = calibration();
    let args = ["report", "ball", "cloud.ply", "-c", &calibration, "--nominal", "nominal.csv", "-o", page];
    let mut command = cargo_bin_cmd!("uwscan");
    let output =
        command.current_dir(dir).env("SOURCE_DATE_EPOCH", MADE.0).args(args).args(more).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn read(dir: &Path, name: &str) -> String {
    fs::read_to_string(dir.join(name)).unwrap()
}

/// Whether two numbers are one that was written: the JSON's reader is good to its last bits only.
fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 4.0 * f64::EPSILON * b.abs()
}

/// A page as a browser's parser reads it: sound, asking for nothing, its figures those of the JSON; how many these are.
#[track_caller]
fn sound(page: &str, json: &Value) -> usize {
    let html = Html::parse_document(page);
    assert!(html.errors.is_empty(), "{:?}", html.errors);
    for foreign in ["http:", "https:", "url(", "@import"] {
        assert!(!page.contains(foreign), "{foreign} is in the page");
    }
    for element in html.select(&Selector::parse("[src],[href]").unwrap()) {
        let target = element.value().attr("href").or(element.value().attr("src")).unwrap();
        assert!(target.starts_with('#') || target == "data:,", "{target}");
    }
    let mut figures = 0;
    for figure in html.select(&Selector::parse("data[data-at]").unwrap()) {
        let at = figure.value().attr("data-at").unwrap();
        let value: f64 = figure.value().attr("value").unwrap().parse().unwrap();
        let kept = json.pointer(at).and_then(Value::as_f64);
        assert!(kept.is_some_and(|kept| same(kept, value)), "{at}: {value} and {kept:?}");
        // What people read is that number, rounded.
        let text: String = figure.text().collect();
        let shown = text.split(" ±").next().unwrap();
        let decimals = shown.split('.').nth(1).map_or(0, str::len) as i32;
        let read: f64 = shown.parse().unwrap();
        assert!((read - value).abs() <= 0.501 * 10_f64.powi(-decimals), "{at}: {text} for {value}");
        figures += 1;
    }
    figures
}

#[test]
fn a_report_is_a_page_with_the_figures_of_its_json_beside_it() {
    let (dir, printed) = &*REPORTED;
    let kept: Value = serde_json::from_str(&read(dir.path(), "report.json")).unwrap();
    let told: Value = serde_json::from_str(printed).unwrap();
    assert_eq!(kept, told);
    let page = read(dir.path(), "report.html");
    let figures = sound(&page, &kept);
    assert!(figures > 60, "{figures} figures");
    assert_eq!((&kept["format"], &kept["made"]), (&"uwscan-report".into(), &MADE.1.into()));
    assert!(page.contains(MADE.1));

    let [capture, cloud] = [&kept["scans"][0], &kept["scans"][1]];
    assert_eq!((&capture["kind"], &cloud["kind"]), (&"capture".into(), &"cloud".into()));
    assert_eq!((&capture["name"], &cloud["name"]), (&"ball".into(), &"cloud".into()));
    assert_eq!((&capture["medium"], &cloud["medium"]), (&"water".into(), &Value::Null));
    for scan in [capture, cloud] {
        let ball = &scan["shapes"][0];
        assert_eq!((&ball["label"], &ball["kind"]), (&"ball".into(), &"sphere".into()));
        let radius = &ball["figures"][0];
        let number = |key: &str| radius[key].as_f64().unwrap();
        assert!((number("value") - 20.0175).abs() < RADIUS_TOLERANCE_MM, "{radius}");
        assert!((number("error") - (number("value") - 20.0175)).abs() < 1e-12, "{radius}");
        assert!(number("sigma_total") > number("sigma"), "{radius}");
    }
    // The cloud is that capture's: what was measured from either is the same.
    assert_eq!(capture["shapes"], cloud["shapes"]);
    // Every row of every image is a point or has a reason.
    let images = capture["images"].as_array().unwrap();
    assert_eq!(images.len(), 22);
    let sum = |of: &Value| of.as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum::<u64>();
    let rejected: u64 = images.iter().map(|image| sum(&image["rejected"])).sum();
    assert_eq!(rejected, sum(&capture["rejected"]));
    let points: u64 = images.iter().map(|image| image["points"].as_u64().unwrap()).sum();
    assert_eq!(Some(points), capture["points"].as_u64());

    // The table has the same figures, a line each.
    let table = read(dir.path(), "report.csv");
    let mut rows = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    assert_eq!(rows.next().unwrap()[..4], ["scan", "of", "with", "quantity"]);
    let radius = rows.find(|row| row[..4] == ["cloud", "ball", "", "radius_mm"]).unwrap();
    let value = cloud["shapes"][0]["figures"][0]["value"].as_f64().unwrap();
    assert!(same(radius[4].parse().unwrap(), value), "{} and {value}", radius[4]);
}

#[test]
fn a_report_shows_and_explains_what_a_customer_asks_for() {
    let (dir, _) = &*REPORTED;
    let html = Html::parse_document(&read(dir.path(), "report.html"));
    let texts = |selector: &str| -> Vec<String> {
        let selector = Selector::parse(selector).unwrap();
        html.select(&selector).map(|e| e.text().collect::<String>()).collect()
    };
    let headings = texts("h2");
    for heading in
        ["Summary", "Balls", "ball", "Probing and sphere-spacing errors", "Instrument and calibration"]
    {
        assert!(headings.iter().any(|h| h == heading), "{heading} in {headings:?}");
    }
    let plots = texts(".plot svg > title");
    for plot in [
        "Error of the radius by distance",
        "Farthest points outside and inside, by distance",
        "Deviations from the fitted shapes",
        "Stripes found and rejected, image by image",
    ] {
        assert!(plots.iter().any(|p| p.starts_with(plot)), "{plot} in {plots:?}");
    }
    assert_eq!(texts(".view3d canvas").len(), 2, "a view a scan");
    let terms = texts("dt");
    assert!(["(PF)", "(PS)", "(SD)"].iter().all(|t| terms.iter().any(|term| term.contains(t))), "{terms:?}");
    assert!(!texts("data").iter().any(|text| text.contains("NaN") || text.contains("inf")));
}

#[test]
fn the_same_input_gives_the_same_report_on_one_thread_and_existing_ones_stay() {
    let (dir, _) = &*REPORTED;
    report(dir.path(), "again.html", &["--threads", "1"]);
    for ending in ["html", "json", "csv"] {
        let [one, other] = ["report", "again"].map(|name| read(dir.path(), &format!("{name}.{ending}")));
        assert!(one == other, "{ending} differs");
    }
    let page = dir.path().join("report.html");
    let cloud = dir.path().join("cloud.ply");
    let args = ["report".as_ref(), cloud.as_os_str(), "-o".as_ref(), page.as_os_str()];
    uwscan(args).fails(&["report.html", "--force"]);
}

#[test]
fn a_cloud_alone_is_reported_and_what_is_not_known_is_not_told() {
    let (dir, _) = &*REPORTED;
    let out = TempDir::new().unwrap();
    let [cloud, page] = [dir.path().join("cloud.ply"), out.path().join("p.html")].map(|path| text(&path));
    let run = uwscan(["report", &cloud, "-o", &page, "--title", "A <ball>"]);
    assert!(run.text().contains("1 scan, "), "{}", run.stdout);
    assert_eq!(names(out.path()), ["p.csv", "p.html", "p.json"]);
    let json: Value = serde_json::from_str(&read(out.path(), "p.json")).unwrap();
    let html = read(out.path(), "p.html");
    sound(&html, &json);
    assert!(html.contains("<h1>A &lt;ball&gt;</h1>"));
    assert!(json["calibration"].is_null() && json["scans"][0]["index"].is_null());
    assert!(json["scans"][0]["shapes"][0]["figures"][0]["sigma_total"].is_null());
    assert!(json["probing"][0]["size_mm"].is_null(), "a size error needs a nominal size");
    assert!(!html.contains("Stripes found"));
}

fn text(path: &Path) -> String {
    path.to_str().unwrap().to_owned()
}

#[test]
fn a_reference_is_what_scans_are_held_against() {
    let (dir, _) = &*REPORTED;
    let out = TempDir::new().unwrap();
    let [cloud, mesh, page] =
        [dir.path().join("cloud.ply"), out.path().join("m.ply"), out.path().join("p.html")]
            .map(|path| text(&path));
    uwscan(["mesh", &cloud, "-o", &mesh]).text();
    let run = uwscan(["report", &cloud, "--reference", &mesh, "-o", &page, "--json"]);
    let json = run.json(0);
    let deviations = &json["scans"][0]["deviations"];
    // A cloud's own surface passes through its points; those on its outline may lie beside it.
    assert!(deviations["rms_mm"].as_f64().unwrap() < 0.05, "{deviations}");
    assert!(deviations["overlap"].as_f64().unwrap() > 0.7, "{deviations}");
    sound(&read(out.path(), "p.html"), &json);
    uwscan(["report", &mesh, "-o", &page, "--force"]).fails(&["m.ply", "mesh", "--reference"]);
}

#[test]
fn what_can_not_be_reported_is_refused_and_nothing_is_left() {
    let (dir, _) = &*REPORTED;
    let out = TempDir::new().unwrap();
    let [cloud, page, bad] =
        [dir.path().join("cloud.ply"), out.path().join("p.html"), out.path().join("bad.csv")]
            .map(|path| text(&path));
    let capture = text(&fixture("ball"));
    let boards = text(&fixture("cal-water"));
    let calibration = calibration();
    uwscan(["report", &capture, "-o", &page]).fails(&["ball", "-c calibration.toml"]);
    uwscan(["report", &boards, "-c", &calibration, "-o", &page]).fails(&["cal-water", "scan is needed"]);
    uwscan(["report", "nowhere", "-o", &page]).fails(&["nowhere"]);
    uwscan(["report", "nowhere.ply", "-o", &page]).fails(&["nowhere.ply"]);
    let mesh = text(&out.path().join("m.stl"));
    fs::write(&mesh, "solid").unwrap();
    uwscan(["report", &mesh, "-o", &page]).fails(&["m.stl", "this is a mesh", "--reference"]);
    fs::remove_file(&mesh).unwrap();
    let elsewhere = text(&out.path().join("p.json"));
    uwscan(["report", &cloud, "-o", &elsewhere]).fails(&["p.json", ".html"]);
    uwscan(["report", &cloud, "--reference", "none.stl", "-o", &page]).fails(&["none.stl"]);
    fs::write(&bad, "kind,a,b,value_mm\nradius,A,,-1\n").unwrap();
    uwscan(["report", &cloud, "--nominal", &bad, "-o", &page]).fails(&["bad.csv", "-1 mm"]);
    let beside = text(&out.path().join("bad.html"));
    let own = ["report", &cloud, "--nominal", &bad, "-o", &beside, "--force"];
    uwscan(own).fails(&["bad.csv", "is an input", "another name"]);
    uwscan(["report", "-o", &page]).is_misused(&["<SCAN>"]);
    assert_eq!(names(out.path()), ["bad.csv"]);
}

#[test]
fn a_calibration_has_a_page_of_its_own() {
    let folder = calibration_report();
    let json: Value = serde_json::from_str(&read(&folder, "calibration-report.json")).unwrap();
    let page = read(&folder, "calibration-report.html");
    assert!(sound(&page, &json) > 100);
    assert_eq!(json["format"], "uwscan-calibration-report");
    let poses = json["poses"].as_array().unwrap();
    assert!(poses.len() >= 10, "{} poses", poses.len());
    // The residuals of the placements are those of the whole.
    let (mut squares, mut corners) = (0.0, 0.0);
    for pose in poses {
        let count = pose["corners"].as_f64().unwrap();
        squares += count * pose["rms_px"].as_f64().unwrap().powi(2);
        corners += count;
    }
    let rms = json["reprojection_rms_px"].as_f64().unwrap();
    assert!(((squares / corners).sqrt() / rms - 1.0).abs() < 1e-9);
    assert_eq!(json["corners"][0].as_f64(), Some(corners));
    let html = Html::parse_document(&page);
    let plots = html.select(&Selector::parse(".plot svg").unwrap()).count();
    assert_eq!(plots, 9, "residuals, coverage, placements, correlations");
    let table = read(&folder, "calibration-report.csv");
    assert_eq!(table.lines().count(), 1 + json["figures"].as_array().unwrap().len());
}
