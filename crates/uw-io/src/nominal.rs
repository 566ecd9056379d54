//! Nominal values of an artefact, such as its certificate states them: radii of balls and distances between their centres.

use std::path::Path;

use csv::{ReaderBuilder, Trim};
use serde::Deserialize;

use crate::{
    error::{Error, Place},
    text,
    toml_file::TomlFile,
};

/// The `format` of a file of nominal values.
pub const FORMAT: &str = "uwscan-nominal";
/// The newest version of it that is read.
pub const VERSION: u32 = 1;
/// The most balls that one artefact may have: which is which is found out by trying.
pub const MOST_SPHERES: usize = 8;

const HEADER: &str = "kind,a,b,value_mm";
const LIMIT: u64 = 1 << 20;

/// What an artefact should measure.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Nominal {
    /// Its balls.
    #[serde(default, rename = "sphere")]
    pub spheres: Vec<NominalSphere>,
    /// Distances between centres; those that are not given are not judged.
    #[serde(default, rename = "distance")]
    pub distances: Vec<NominalDistance>,
}

/// A ball.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NominalSphere {
    /// Its name.
    pub name: String,
    /// Its radius.
    pub radius_mm: f64,
}

/// A distance between the centres of two balls.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NominalDistance {
    /// The one.
    pub a: String,
    /// The other.
    pub b: String,
    /// How far.
    pub distance_mm: f64,
}

impl Nominal {
    /// The nominal values of a file: TOML (tables `[[sphere]]` and `[[distance]]`), or CSV where its name ends in `.csv`
    /// (columns `kind,a,b,value_mm`; kind `radius` or `distance`, `b` empty of a radius).
    ///
    /// # Errors
    /// [`Error`] where it can't be read, or names, radii or distances are such as no artefact has.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let nominal = match path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv")) {
            true => table(path)?,
            false => TomlFile::read(path, FORMAT, VERSION)?.parse()?,
        };
        nominal.check(path)?;
        Ok(nominal)
    }

    fn check(&self, path: &Path) -> Result<(), Error> {
        let fail = |what: String, mend: &str| Err(Error::content(Place::file(path), what, mend));
        if self.spheres.is_empty() {
            return fail("names no ball".to_owned(), "give at least one with its radius");
        }
        if self.spheres.len() > MOST_SPHERES {
            let what = format!("names {} balls", self.spheres.len());
            return fail(what, "give at most eight, such as those that a scan shows");
        }
        for (at, sphere) in self.spheres.iter().enumerate() {
            if sphere.name.trim().is_empty() {
                return fail("has a ball without a name".to_owned(), "name it, such as A");
            }
            if self.spheres[..at].iter().any(|other| other.name == sphere.name) {
                return fail(format!("names ball \"{}\" twice", sphere.name), "give each a name of its own");
            }
            if !(sphere.radius_mm > 0.0 && sphere.radius_mm.is_finite()) {
                let what = format!("gives ball \"{}\" a radius of {} mm", sphere.name, sphere.radius_mm);
                return fail(what, "give a number above zero");
            }
        }
        for (at, distance) in self.distances.iter().enumerate() {
            let NominalDistance { a, b, distance_mm } = distance;
            if let Some(unknown) = [a, b].into_iter().find(|n| self.spheres.iter().all(|s| s.name != **n)) {
                return fail(
                    format!("has a distance to \"{unknown}\", which is no ball of it"),
                    "name balls",
                );
            }
            if a == b || !(*distance_mm > 0.0 && distance_mm.is_finite()) {
                let what = format!("gives {distance_mm} mm from \"{a}\" to \"{b}\"");
                return fail(what, "give a number above zero between two balls");
            }
            let same = |d: &NominalDistance| (&d.a, &d.b) == (a, b) || (&d.a, &d.b) == (b, a);
            if self.distances[..at].iter().any(same) {
                return fail(format!("has the distance from \"{a}\" to \"{b}\" twice"), "give it once");
            }
        }
        Ok(())
    }
}

/// The values of a table.
fn table(path: &Path) -> Result<Nominal, Error> {
    let text = text::read(path, LIMIT)?;
    let mut reader =
        ReaderBuilder::new().trim(Trim::All).comment(Some(b'#')).flexible(true).from_reader(text.as_bytes());
    let unreadable = |e: csv::Error| {
        let mend = format!("separate its columns by commas: {HEADER}");
        Error::content(Place::file(path), format!("is no table: {e}"), mend)
    };
    let header: Vec<String> = reader.headers().map_err(unreadable)?.iter().map(str::to_owned).collect();
    if header.join(",") != HEADER {
        let what = format!("begins with \"{}\"", header.join(","));
        return Err(Error::content(Place::line(path, 1), what, format!("the first line must be: {HEADER}")));
    }
    let mut nominal = Nominal::default();
    for record in reader.records() {
        let record = record.map_err(unreadable)?;
        let line = record.position().map_or(0, |p| p.line() as u32);
        let fail = |what: String| {
            let mend = "a row is radius,NAME,,MM or distance,NAME,NAME,MM";
            Err(Error::content(Place::line(path, line), what, mend))
        };
        let fields: Vec<&str> = record.iter().collect();
        let &[kind, a, b, value] = &fields[..] else {
            return fail(format!("has {} fields", fields.len()));
        };
        let Ok(value) = value.parse::<f64>() else { return fail(format!("\"{value}\" is no number")) };
        match (kind, b) {
            ("radius", "") => nominal.spheres.push(NominalSphere { name: a.to_owned(), radius_mm: value }),
            ("distance", b) if !b.is_empty() => nominal.distances.push(NominalDistance {
                a: a.to_owned(),
                b: b.to_owned(),
                distance_mm: value,
            }),
            _ => {
                return fail(format!(
                    "\"{kind}\" with \"{a}\" and \"{b}\" is neither a radius nor a distance"
                ));
            }
        }
    }
    Ok(nominal)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, text: &str) -> Result<Nominal, String> {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        Nominal::read(&path).map_err(|e| e.to_string())
    }

    const HEAD: &str = "format = \"uwscan-nominal\"\nversion = 1\n";

    #[test]
    fn both_formats_say_the_same() {
        let toml = format!(
            "{HEAD}[[sphere]]\nname = \"A\"\nradius_mm = 30.2\n[[sphere]]\nname = \"B\"\nradius_mm = 30.193\n\
             [[distance]]\na = \"A\"\nb = \"B\"\ndistance_mm = 151.713\n"
        );
        let csv = "kind,a,b,value_mm\n# by its certificate\nradius,A,,30.2\nradius, B ,,30.193\ndistance,A,B,151.713\n";
        let (one, other) = (read("n.toml", &toml).unwrap(), read("n.CSV", csv).unwrap());
        assert_eq!(one, other);
        assert_eq!(one.spheres[1], NominalSphere { name: "B".to_owned(), radius_mm: 30.193 });
        assert!((one.distances[0].distance_mm - 151.713).abs() < 1e-12);
    }

    #[test]
    fn what_no_artefact_has_is_refused() {
        let ball =
            |name: &str, radius: &str| format!("[[sphere]]\nname = \"{name}\"\nradius_mm = {radius}\n");
        let many: String = (0..9).map(|i| ball(&format!("b{i}"), "10.0")).collect();
        let far = |a: &str, b: &str, mm: &str| {
            format!(
                "{}{}[[distance]]\na = \"{a}\"\nb = \"{b}\"\ndistance_mm = {mm}\n",
                ball("A", "1.0"),
                ball("B", "1.0")
            )
        };
        for (text, said) in [
            (String::new(), "no ball"),
            (many, "9 balls"),
            (ball(" ", "1.0"), "without a name"),
            (ball("A", "1.0") + &ball("A", "2.0"), "twice"),
            (ball("A", "-1.0"), "radius of -1"),
            (ball("A", "nan"), "radius of NaN"),
            (far("A", "C", "5.0"), "\"C\""),
            (far("A", "A", "5.0"), "5 mm from \"A\" to \"A\""),
            (far("A", "B", "0.0"), "0 mm"),
            (far("A", "B", "5.0") + "[[distance]]\na = \"B\"\nb = \"A\"\ndistance_mm = 5.0\n", "twice"),
        ] {
            let error = read("n.toml", &format!("{HEAD}{text}")).unwrap_err();
            assert!(error.contains(said) && error.contains("n.toml"), "{error}, not {said}");
        }
        for (text, said) in [
            ("", "begins with"),
            ("kind,a,value\n", "begins with"),
            ("kind,a,b,value_mm\nradius,A,,x\n", "n.csv:2: \"x\" is no number"),
            ("kind,a,b,value_mm\nradius,A,1\n", "3 fields"),
            ("kind,a,b,value_mm\ndiameter,A,,1\n", "neither"),
            ("kind,a,b,value_mm\nradius,A,B,1\n", "neither"),
        ] {
            let error = read("n.csv", text).unwrap_err();
            assert!(error.contains(said), "{error}, not {said}");
        }
    }
}
