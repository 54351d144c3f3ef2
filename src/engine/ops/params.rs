//! Parameters of operations: what each is called, its range, and reading it as text.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use crate::error::{Error, Result};

/// A parameter of an operation.
#[derive(Clone, Copy, Debug)]
pub struct Param {
    /// Its name.
    pub name: &'static str,
    /// Its default, or where it must be given an example; empty if the tensors decide it.
    pub value: &'static str,
    /// Whether it must be given.
    pub required: bool,
    /// Whether no command line gives it, but the tensors that are present decide it.
    pub by_tensors: bool,
    /// What [`Op::infer`](crate::engine::ops::Op::infer) lets it be.
    pub range: Range,
}

impl Param {
    pub(crate) const fn optional(name: &'static str, default: &'static str, range: Range) -> Self {
        Self { name, value: default, required: false, by_tensors: false, range }
    }

    pub(crate) const fn required(name: &'static str, example: &'static str, range: Range) -> Self {
        Self { name, value: example, required: true, by_tensors: false, range }
    }

    pub(crate) const fn by_tensors(name: &'static str, range: Range) -> Self {
        Self { name, value: "", required: false, by_tensors: true, range }
    }
}

/// The values that a parameter may have, both ends included. NaN is in no range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Range {
    /// True or false.
    Flag,
    /// Whole numbers.
    Whole(u64, u64),
    /// Numbers.
    Number(f32, f32),
    /// Lists of such numbers.
    Numbers(f32, f32),
}

impl Range {
    /// Whether `setting` is in the range.
    pub fn admits(&self, setting: &Setting) -> bool {
        match (self, setting) {
            (Self::Flag, Setting::Flag(_)) => true,
            (Self::Whole(least, most), Setting::Whole(n)) => (least..=most).contains(&n),
            (Self::Number(least, most), Setting::Number(x)) => (least..=most).contains(&x),
            (Self::Numbers(least, most), Setting::Numbers(list)) => {
                list.iter().all(|x| (least..=most).contains(&x))
            }
            _ => false,
        }
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Flag => f.write_str("true or false"),
            Self::Whole(least, most) => write!(f, "{least} to {most}"),
            Self::Number(least, most) => write!(f, "{} to {}", Short(*least), Short(*most)),
            Self::Numbers(least, most) => {
                write!(f, "numbers from {} to {}", Short(*least), Short(*most))
            }
        }
    }
}

/// A number without its many zeros.
struct Short(f32);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let plain = self.0 == 0.0 || (1e-5..1e7).contains(&self.0.abs());
        if plain { self.0.fmt(f) } else { write!(f, "{:e}", self.0) }
    }
}

/// A parameter's value in an operation.
#[derive(Clone, Debug, PartialEq)]
pub enum Setting {
    /// True or false.
    Flag(bool),
    /// A whole number.
    Whole(u64),
    /// A number.
    Number(f32),
    /// A list of numbers.
    Numbers(Vec<f32>),
}

impl From<bool> for Setting {
    fn from(value: bool) -> Self {
        Self::Flag(value)
    }
}

impl From<u32> for Setting {
    fn from(value: u32) -> Self {
        Self::Whole(value.into())
    }
}

impl From<usize> for Setting {
    fn from(value: usize) -> Self {
        Self::Whole(value as u64)
    }
}

impl From<f32> for Setting {
    fn from(value: f32) -> Self {
        Self::Number(value)
    }
}

impl From<&[f32]> for Setting {
    fn from(values: &[f32]) -> Self {
        Self::Numbers(values.to_vec())
    }
}

/// As a command line gives it.
impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Flag(value) => value.fmt(f),
            Self::Whole(n) => n.fmt(f),
            Self::Number(x) => Short(*x).fmt(f),
            Self::Numbers(list) => {
                let list: Vec<String> = list.iter().map(|x| Short(*x).to_string()).collect();
                f.write_str(&list.join(","))
            }
        }
    }
}

/// An operation's parameters by name, as [`Op::settings`](crate::engine::ops::Op::settings) tells them.
pub type Settings = Vec<(&'static str, Setting)>;

/// Parameters by name; each may be taken once, and [`Params::finish`] refuses leftovers.
#[derive(Clone, Debug)]
pub struct Params {
    op: String,
    values: BTreeMap<String, String>,
    /// Names that were asked for.
    known: Vec<&'static str>,
}

impl Params {
    /// Parameters for the operation `op`.
    pub fn new(op: &str, values: impl IntoIterator<Item = (String, String)>) -> Self {
        Self { op: op.into(), values: values.into_iter().collect(), known: Vec::new() }
    }

    /// Takes the parameter `name`, or `default` if it was not given.
    ///
    /// # Errors
    /// [`Error::Param`] if it does not parse.
    pub fn take<T: FromStr>(&mut self, name: &'static str, default: T) -> Result<T> {
        self.known.push(name);
        match self.values.remove(name) {
            None => Ok(default),
            Some(text) => self.parse(name, &text),
        }
    }

    /// Takes the parameter `name`, which must be given.
    ///
    /// # Errors
    /// [`Error::Param`] if it is missing or does not parse.
    pub fn require<T: FromStr>(&mut self, name: &'static str) -> Result<T> {
        self.known.push(name);
        match self.values.remove(name) {
            None => Err(Error::param(&self.op, name, kind::<T>(), "nothing")),
            Some(text) => self.parse(name, &text),
        }
    }

    /// Takes a comma-separated list, which must be given.
    ///
    /// # Errors
    /// [`Error::Param`] if it is missing or an element does not parse.
    pub fn require_list<T: FromStr>(&mut self, name: &'static str) -> Result<Vec<T>> {
        let text: String = self.require(name)?;
        text.split(',').map(|part| self.parse(name, part.trim())).collect()
    }

    /// Takes a comma-separated list of `N`, which must be given.
    ///
    /// # Errors
    /// As [`Params::require_list`], and [`Error::Param`] for another number of elements.
    pub fn require_array<T: FromStr, const N: usize>(
        &mut self,
        name: &'static str,
    ) -> Result<[T; N]> {
        let list: Vec<T> = self.require_list(name)?;
        let got = list.len();
        <[T; N]>::try_from(list)
            .map_err(|_| Error::param(&self.op, name, format!("{N} numbers"), got))
    }

    /// Takes a comma-separated list of `N`, or `default` if it was not given.
    ///
    /// # Errors
    /// As [`Params::require_array`].
    pub fn take_array<T: FromStr, const N: usize>(
        &mut self,
        name: &'static str,
        default: [T; N],
    ) -> Result<[T; N]> {
        self.known.push(name);
        match self.values.contains_key(name) {
            false => Ok(default),
            true => self.require_array(name),
        }
    }

    fn parse<T: FromStr>(&self, name: &str, text: &str) -> Result<T> {
        let wrong = |_| Error::param(&self.op, name, kind::<T>(), format!("`{text}`"));
        text.parse().map_err(wrong)
    }

    /// Refuses parameters that nobody took.
    ///
    /// # Errors
    /// [`Error::Param`] that names the first, and those that there are.
    pub fn finish(&self) -> Result<()> {
        let Some((name, value)) = self.values.iter().next() else { return Ok(()) };
        let expected = match self.known.is_empty() {
            true => "no parameters".into(),
            false => format!("one of {}", self.known.join(", ")),
        };
        Err(Error::param(&self.op, name, expected, format!("`{name}={value}`")))
    }
}

/// What a parameter of this type is called in messages.
fn kind<T>() -> &'static str {
    match std::any::type_name::<T>() {
        "usize" | "u32" => "a whole number from 0",
        "f32" => "a number",
        "bool" => "true or false",
        _ => "a comma-separated list",
    }
}

#[cfg(test)]
mod tests {
    use crate::engine::ops::OPS;

    use super::*;

    fn build(entry: &crate::engine::ops::Entry, given: &[(&str, &str)]) -> Result<()> {
        let given = given.iter().map(|(n, v)| ((*n).to_owned(), (*v).to_owned()));
        let mut params = Params::new(entry.name, given);
        (entry.build)(&mut params, &["map0"])?;
        params.finish()
    }

    #[test]
    fn the_listed_parameters_are_those_that_are_taken() {
        for entry in OPS {
            let given = entry.params.iter().filter(|p| !p.by_tensors);
            let required: Vec<_> =
                given.clone().filter(|p| p.required).map(|p| (p.name, p.value)).collect();
            build(entry, &required).unwrap_or_else(|e| panic!("{}: {e}", entry.name));
            for (i, (name, _)) in required.iter().enumerate() {
                let others = [&required[..i], &required[i + 1..]].concat();
                let error = build(entry, &others).expect_err("a missing parameter").to_string();
                assert!(error.contains(&format!("`{name}`")), "{error}");
            }
            // A value that no type parses: the message tells whether the name is known.
            for optional in given.clone().filter(|p| !p.required) {
                let given = [&required[..], &[(optional.name, "?")]].concat();
                let error = build(entry, &given).expect_err("no value").to_string();
                assert!(error.contains(&format!("`{}`", optional.name)), "{error}");
                assert!(error.contains("got `?`"), "{}: {error}", entry.name);
            }
            let error = build(entry, &[&required[..], &[("nope", "1")]].concat());
            let error = error.expect_err("an unknown parameter").to_string();
            assert!(given.clone().all(|p| error.contains(p.name)), "{error}");
        }
    }

    #[test]
    fn the_listed_tensors_are_those_of_the_cases() {
        for entry in OPS {
            for case in (entry.cases)() {
                // `map0`, and so on: the list names the first and the last.
                let numbered = |name: &str| ["map", "values"].iter().any(|n| name.starts_with(n));
                let named = |text: &str, name: &str| text.contains(name) || numbered(name);
                assert!(case.op.inputs().iter().all(|n| named(entry.takes, n)), "{}", entry.name);
                assert!(case.op.outputs().iter().all(|n| named(entry.gives, n)), "{}", entry.name);
            }
        }
    }
}
