//! Replies: a pattern of literal text and fields.

/// What a reply says. A field that its pattern doesn't have is `None`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reply {
    /// `{v}`: a number.
    pub number: Option<f64>,
    /// `{code}`: a whole number, such as that of an error.
    pub code: Option<i64>,
    /// `{on}`: 1, ON, 0 or OFF.
    pub on: Option<bool>,
    /// `{text}`: anything.
    pub text: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Field {
    Number,
    Code,
    On,
    Text,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Part {
    Literal(String),
    Field(Field),
}

/// Literal text and fields: `{v}`, `{code},{text}`, `VOLT {v} V`, `OK`. Case and spaces at the ends don't matter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pattern {
    parts: Vec<Part>,
    text: String,
}

impl Pattern {
    /// A pattern of its text.
    ///
    /// # Errors
    /// What is wrong with the text.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut parts: Vec<Part> = Vec::new();
        let mut rest = text.trim();
        while !rest.is_empty() {
            let Some(open) = rest.find('{') else {
                parts.push(Part::Literal(rest.to_owned()));
                break;
            };
            if open > 0 {
                parts.push(Part::Literal(rest[..open].to_owned()));
            }
            let Some(close) = rest[open..].find('}').map(|at| open + at) else {
                return Err(format!("{text:?}: a {{ without its }}"));
            };
            let field = match &rest[open + 1..close] {
                "v" => Field::Number,
                "code" => Field::Code,
                "on" => Field::On,
                "text" => Field::Text,
                other => {
                    return Err(format!(
                        "{text:?}: {{{other}}} is no field of a reply; {{v}}, {{code}}, {{on}} and {{text}} are"
                    ));
                }
            };
            if matches!(parts.last(), Some(Part::Field(_))) {
                return Err(format!(
                    "{text:?}: two fields without anything between them can't be told apart"
                ));
            }
            parts.push(Part::Field(field));
            rest = &rest[close + 1..];
        }
        if parts.is_empty() {
            return Err("an empty reply can't be told from none; leave `reply` out".into());
        }
        Ok(Self { parts, text: text.trim().to_owned() })
    }

    /// The pattern's text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// What a line says; `None` where it is no such reply.
    pub fn matches(&self, line: &str) -> Option<Reply> {
        let mut reply = Reply::default();
        let mut rest = line.trim();
        let mut parts = self.parts.iter().peekable();
        while let Some(part) = parts.next() {
            match part {
                Part::Literal(literal) => rest = after_literal(rest, literal)?,
                Part::Field(field) => {
                    let end = match parts.peek() {
                        Some(Part::Literal(literal)) => find(rest, literal)?,
                        _ => rest.len(),
                    };
                    let value = rest[..end].trim();
                    match field {
                        Field::Number => reply.number = Some(number(value)?),
                        Field::Code => {
                            reply.code = Some(value.strip_prefix('+').unwrap_or(value).parse().ok()?);
                        }
                        Field::On => reply.on = Some(on(value)?),
                        Field::Text => reply.text = Some(value.to_owned()),
                    }
                    rest = &rest[end..];
                }
            }
        }
        rest.trim().is_empty().then_some(reply)
    }
}

fn after_literal<'a>(text: &'a str, literal: &str) -> Option<&'a str> {
    let head = text.get(..literal.len())?;
    head.eq_ignore_ascii_case(literal).then(|| &text[literal.len()..])
}

fn find(text: &str, literal: &str) -> Option<usize> {
    (0..text.len()).find(|&at| text.get(at..).is_some_and(|rest| after_literal(rest, literal).is_some()))
}

/// From here on SCPI means infinity (9.9E37) and "not a number" (9.91E37): SCPI-99, volume 1, 7.2.1.4 and 7.2.1.5.
const NO_NUMBER: f64 = 9.9e37;

/// A decimal number: NR1, NR2 or NR3 of IEEE 488.2.
fn number(text: &str) -> Option<f64> {
    let decimal = text.bytes().all(|b| b.is_ascii_digit() || b"+-.eE".contains(&b));
    let value: f64 = decimal.then(|| text.parse().ok())??;
    (value.abs() < NO_NUMBER).then_some(value)
}

fn on(text: &str) -> Option<bool> {
    match text {
        "1" | "+1" => Some(true),
        "0" | "+0" => Some(false),
        _ if text.eq_ignore_ascii_case("on") => Some(true),
        _ if text.eq_ignore_ascii_case("off") => Some(false),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volts(pattern: &str, line: &str) -> Option<f64> {
        Pattern::parse(pattern).unwrap().matches(line)?.number
    }

    #[test]
    fn numbers_come_in_all_forms_of_the_standard_and_nothing_else_is_one() {
        for line in ["1.25", "+1.25", "1.250000E+00", " 12.5e-1 ", "125E-2", "+1.25E0"] {
            assert_eq!(volts("{v}", line), Some(1.25), "{line:?}");
        }
        assert_eq!(
            (volts("{v}", "-3"), volts("{v}", ".5"), volts("{v}", "-0.0")),
            (Some(-3.0), Some(0.5), Some(-0.0))
        );
        for line in [
            "", "nan", "inf", "-inf", "1.25V", "1,25", "9.91E37", "9.9E+37", "1.2.5", "0x10", "1e999", "ü",
            "1.25;0",
        ] {
            assert_eq!(volts("{v}", line), None, "{line:?}");
        }
    }

    #[test]
    fn fields_stand_between_literals_whatever_their_case() {
        assert_eq!(volts("VOLT {v} V", "volt -0.75 v"), Some(-0.75));
        assert_eq!(volts("VOLT {v} V", "VOLT -0.75"), None);
        let error =
            Pattern::parse("{code},{text}").unwrap().matches("-113,\"Undefined header, or so\"").unwrap();
        assert_eq!((error.code, error.text.as_deref()), (Some(-113), Some("\"Undefined header, or so\"")));
        assert_eq!(Pattern::parse("+{code},{text}").unwrap().matches("0,\"No error\""), None);
        assert_eq!(Pattern::parse("OK").unwrap().matches("ok "), Some(Reply::default()));
        assert_eq!(Pattern::parse("OK").unwrap().matches("OK!"), None);
        let on = |line| Pattern::parse("{on}").unwrap().matches(line).and_then(|reply| reply.on);
        assert_eq!(
            ["1", "ON", "0", "off", "2", ""].map(on),
            [Some(true), Some(true), Some(false), Some(false), None, None]
        );
    }

    #[test]
    fn patterns_that_can_not_be_meant_are_refused() {
        for text in ["", "  ", "{v", "{volts}", "{v}{text}", "{}"] {
            assert!(Pattern::parse(text).is_err(), "{text:?}");
        }
    }
}
