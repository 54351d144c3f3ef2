//! Named parameters as text, for building an operation from a command line.

use std::collections::BTreeMap;
use std::str::FromStr;

use crate::error::{Error, Result};

/// A parameter that an operation takes on a command line.
#[derive(Clone, Copy, Debug)]
pub struct Param {
    /// Its name.
    pub name: &'static str,
    /// Its default, or where it must be given an example.
    pub value: &'static str,
    /// Whether it must be given.
    pub required: bool,
}

impl Param {
    pub(crate) const fn optional(name: &'static str, default: &'static str) -> Self {
        Self { name, value: default, required: false }
    }

    pub(crate) const fn required(name: &'static str, example: &'static str) -> Self {
        Self { name, value: example, required: true }
    }
}

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
    use crate::ops::OPS;

    use super::*;

    fn build(entry: &crate::ops::Entry, given: &[(&str, &str)]) -> Result<()> {
        let given = given.iter().map(|(n, v)| ((*n).to_owned(), (*v).to_owned()));
        let mut params = Params::new(entry.name, given);
        (entry.build)(&mut params, &["map0"])?;
        params.finish()
    }

    #[test]
    fn the_listed_parameters_are_those_that_are_taken() {
        for entry in OPS {
            let required: Vec<_> =
                entry.params.iter().filter(|p| p.required).map(|p| (p.name, p.value)).collect();
            build(entry, &required).unwrap_or_else(|e| panic!("{}: {e}", entry.name));
            for (i, (name, _)) in required.iter().enumerate() {
                let others = [&required[..i], &required[i + 1..]].concat();
                let error = build(entry, &others).expect_err("a missing parameter").to_string();
                assert!(error.contains(&format!("`{name}`")), "{error}");
            }
            // A value that no type parses: the message tells whether the name is known.
            for optional in entry.params.iter().filter(|p| !p.required) {
                let given = [&required[..], &[(optional.name, "?")]].concat();
                let error = build(entry, &given).expect_err("no value").to_string();
                assert!(error.contains(&format!("`{}`", optional.name)), "{error}");
                assert!(error.contains("got `?`"), "{}: {error}", entry.name);
            }
            let error = build(entry, &[&required[..], &[("nope", "1")]].concat());
            let error = error.expect_err("an unknown parameter").to_string();
            assert!(entry.params.iter().all(|p| error.contains(p.name)), "{error}");
        }
    }

    #[test]
    fn the_listed_tensors_are_those_of_the_cases() {
        for entry in OPS {
            for case in (entry.cases)() {
                // `map0`, and so on: the list names the first and the last.
                let named = |text: &str, name: &str| text.contains(name) || name.starts_with("map");
                assert!(case.op.inputs().iter().all(|n| named(entry.takes, n)), "{}", entry.name);
                assert!(case.op.outputs().iter().all(|n| named(entry.gives, n)), "{}", entry.name);
            }
        }
    }
}
