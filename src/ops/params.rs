//! Named parameters as text, for building an operation from a command line.

use std::collections::BTreeMap;
use std::str::FromStr;

use crate::error::{Error, Result};

/// Parameters by name; each may be taken once, and [`Params::finish`] refuses leftovers.
#[derive(Clone, Debug)]
pub struct Params {
    op: String,
    values: BTreeMap<String, String>,
}

impl Params {
    /// Parameters for the operation `op`.
    pub fn new(op: &str, values: impl IntoIterator<Item = (String, String)>) -> Self {
        Self { op: op.into(), values: values.into_iter().collect() }
    }

    /// Takes the parameter `name`, or `default` if it was not given.
    ///
    /// # Errors
    /// [`Error::Param`] if it does not parse.
    pub fn take<T: FromStr>(&mut self, name: &str, default: T) -> Result<T> {
        match self.values.remove(name) {
            None => Ok(default),
            Some(text) => text.parse().map_err(|_| {
                Error::param(&self.op, name, std::any::type_name::<T>(), format!("`{text}`"))
            }),
        }
    }

    /// Takes the parameter `name`, which must be given.
    ///
    /// # Errors
    /// [`Error::Param`] if it is missing or does not parse.
    pub fn require<T: FromStr>(&mut self, name: &str) -> Result<T> {
        if !self.values.contains_key(name) {
            return Err(Error::param(&self.op, name, "a value", "nothing"));
        }
        match self.values.remove(name).map(|text| (text.parse(), text)) {
            Some((Ok(value), _)) => Ok(value),
            Some((Err(_), text)) => {
                Err(Error::param(&self.op, name, std::any::type_name::<T>(), format!("`{text}`")))
            }
            None => Err(Error::param(&self.op, name, "a value", "nothing")),
        }
    }

    /// Takes a comma-separated list.
    ///
    /// # Errors
    /// [`Error::Param`] if it is missing or an element does not parse.
    pub fn require_list<T: FromStr>(&mut self, name: &str) -> Result<Vec<T>> {
        let text: String = self.require(name)?;
        text.split(',')
            .map(|part| {
                part.trim().parse().map_err(|_| {
                    Error::param(&self.op, name, std::any::type_name::<T>(), format!("`{part}`"))
                })
            })
            .collect()
    }

    /// Refuses parameters that nobody took.
    ///
    /// # Errors
    /// [`Error::Param`] that names the first.
    pub fn finish(&self) -> Result<()> {
        match self.values.iter().next() {
            None => Ok(()),
            Some((name, value)) => {
                Err(Error::param(&self.op, name, "no such parameter", format!("`{value}`")))
            }
        }
    }
}
