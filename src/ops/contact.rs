//! Where something touches the gel.

use crate::cpu::{self, ContactRule};
use crate::error::{Error, Result};
use crate::ops::case::{Case, integers, random_integers};
use crate::ops::op::{Entry, Op, Tolerance, expect, map_dims};
use crate::ops::params::{Param, Params as Named, Range, Settings};
use crate::shape::TensorSpec;
use crate::tensor::{Tensor, Value};

/// This operation in [`crate::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "contact",
    takes: "cells [3, H, W], levels from 0 to 255; optional: reference [3, H, W]",
    gives: "output u32 [N], a bit for each of ⌈H/2⌉ × ⌈W/2⌉ tiles",
    params: &[
        Param::optional("threshold", "5.5", Range::Number(0.0, f32::MAX)),
        Param::optional("clipped", "250", Range::Number(0.0, f32::MAX)),
    ],
    build,
    cases,
};

/// Which tiles of a frame differ from the frame's own smooth background, or from a reference frame
/// without contact.
///
/// Inputs: `cells [3, H, W]`, the frame with a cell for each half millimetre of gel, in levels from 0 to
/// 255; `reference`, the same of a frame without contact, if `reference`. Output: `output u32
/// [⌈T/32⌉]`, a bit for each of the T tiles of 2 × 2 cells, row by row from the lowest bit on, set where
/// one of its cells is touched: see [`cpu::contact`].
#[derive(Clone, Copy, Debug)]
pub struct Contact {
    /// Levels by which an untouched cell may differ from the middle of two others.
    pub threshold: f32,
    /// From this level on in all channels a cell shows nothing, and may be touched.
    pub clipped: f32,
    /// Whether there is a reference frame.
    pub reference: bool,
}

impl Contact {
    /// Rows and columns of tiles for so many of cells.
    pub fn tiles(cells: [usize; 2]) -> [usize; 2] {
        cells.map(|side| side.div_ceil(ContactRule::TILE))
    }
}

impl Op for Contact {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![("threshold", self.threshold.into()), ("clipped", self.clipped.into())]
    }

    fn inputs(&self) -> Vec<&'static str> {
        let mut names = vec!["cells"];
        names.extend(self.reference.then_some("reference"));
        names
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let [channels, height, width] = map_dims(self.name(), "cells", &inputs[0])?;
        if channels != 3 {
            return Err(Error::tensor(self.name(), "cells", "three channels", &inputs[0]));
        }
        if self.reference {
            expect(self.name(), "reference", &inputs[0], &inputs[1])?;
        }
        let [rows, columns] = Self::tiles([height, width]);
        Ok(vec![TensorSpec::u32([(rows * columns).div_ceil(32)])])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let rule = ContactRule { threshold: self.threshold, clipped: self.clipped };
        let reference = inputs.get(1).map(|r| r.f32()).transpose()?;
        let words = cpu::contact(inputs[0].f32()?, reference, rule);
        Ok(vec![Tensor::new(specs[0].shape.clone(), words)?.into()])
    }

    /// A bit turns where rounding takes a difference across the threshold; in the cases none comes so
    /// close.
    fn tolerance(&self, _inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        Ok(vec![Tolerance::Exact])
    }
}

fn build(params: &mut Named, present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(Contact {
        threshold: params.take("threshold", 5.5)?,
        clipped: params.take("clipped", 250.0)?,
        reference: present.contains(&"reference"),
    }))
}

fn cases() -> Vec<Case> {
    const OWN: Contact = Contact { threshold: 5.5, clipped: 250.0, reference: false };
    const AGAINST: Contact = Contact { reference: true, ..OWN };
    let map = |dims: [usize; 3], level: &dyn Fn(usize, usize, usize) -> f32| -> Value {
        let [_, height, width] = dims;
        Tensor::from_fn(dims, |i| level(i / (height * width), i / width % height, i % width)).into()
    };
    let by_hand = |name: &str, op: Contact, inputs: Vec<Value>, words: &[u32]| {
        Case::new(name, op, inputs).by_hand(vec![integers([words.len()], words)]).exact()
    };
    // One row, tiles of two cells. Cell 9 is 6 brighter in green: itself, and with half of it, 3, the
    // cells 5 and 13, which is below 5.5.
    let spot = |bright: f32| {
        move |c: usize, _y: usize, x: usize| if c == 1 && x == 9 { 100.0 + bright } else { 100.0 }
    };
    let line = [3, 1, 20];
    let mut cases = vec![
        by_hand("a spot of 6 by hand", OWN, vec![map(line, &spot(6.0))], &[1 << 4]),
        // Equality is no contact.
        by_hand("a spot of 5.5 by hand", OWN, vec![map(line, &spot(5.5))], &[0]),
        // Half of 12 is above 5.5: the cells 5 and 13 too.
        by_hand(
            "a dark spot of 12 by hand",
            OWN,
            vec![map(line, &spot(-12.0))],
            &[1 << 2 | 1 << 4 | 1 << 6],
        ),
        // Past the edge its own level counts: x − (x₊ + x₋)/2 is (4 − i) · 3/2 at column i from the
        // left, 6 at the first alone, and the same at the right; nothing between.
        by_hand(
            "an even slope by hand",
            OWN,
            vec![map([3, 1, 40], &|_, _, x| 3.0 * x as f32)],
            &[1 | 1 << 19],
        ),
        // A column of tiles: 20 rows of one cell, cell 9 touched, along y.
        by_hand(
            "a spot in a column by hand",
            OWN,
            vec![map([3, 20, 1], &|c, y, _| if c == 2 && y == 9 { 106.0 } else { 100.0 })],
            &[1 << 4],
        ),
        // 6 brighter than its neighbours across and along by 3, on one diagonal by 6, on the other by
        // nothing: a ridge along that one. In tiles of 5 × 5 it is the middle, 2·5 + 2 = 12.
        by_hand(
            "a diagonal by hand",
            OWN,
            vec![map([3, 9, 9], &|_, y, x| match (x, y) {
                (4, 4) | (8, 0) | (0, 8) => 106.0,
                (0, 4) | (8, 4) | (4, 0) | (4, 8) => 103.0,
                _ => 100.0,
            })],
            // The diagonal's own corners differ from the edge's by 3 at most.
            &[1 << 12],
        ),
        // All channels must be clipped.
        by_hand(
            "overexposed by hand",
            OWN,
            vec![map([3, 3, 3], &|c, _, x| if c == 0 && x == 0 { 249.0 } else { 250.0 })],
            &[0b1111],
        ),
        by_hand(
            "one channel overexposed by hand",
            OWN,
            vec![map([3, 3, 3], &|c, _, _| if c == 0 { 249.0 } else { 250.0 })],
            &[0],
        ),
        by_hand("one cell by hand", OWN, vec![map([3, 1, 1], &|_, _, _| 0.0)], &[0]),
        // Printed dots, at a quarter of the light that the reference had: no contact.
        by_hand(
            "dots and less light by hand",
            AGAINST,
            vec![
                map(line, &|_, _, x| if x.is_multiple_of(3) { 8.0 } else { 32.0 }),
                map(line, &|_, _, x| if x.is_multiple_of(3) { 32.0 } else { 128.0 }),
            ],
            &[0],
        ),
        // 64 in the reference: 3 levels are 6 of 128.
        by_hand(
            "a spot against a reference by hand",
            AGAINST,
            vec![
                map(line, &|c, _, x| if c == 0 && x == 9 { 67.0 } else { 64.0 }),
                map(line, &|_, _, _| 64.0),
            ],
            &[1 << 4],
        ),
        // Dark cells of the reference count as 16: a level is 8 of 128, and not 128.
        by_hand(
            "a dark reference by hand",
            Contact { threshold: 9.0, ..AGAINST },
            vec![
                map(line, &|c, _, x| if c == 0 && x == 9 { 2.0 } else { 1.0 }),
                map(line, &|_, _, _| 1.0),
            ],
            &[0],
        ),
    ];
    // Whole levels, so that nothing rounds; primes, and tiles of a word less one, a word and one.
    let shapes = [
        ("prime sizes", [3, 17, 19]),
        ("31 tiles", [3, 2, 62]),
        ("33 tiles", [3, 6, 21]),
        ("a gel of 40 mm", [3, 80, 80]),
        ("a gel of 60 × 45 mm", [3, 90, 120]),
    ];
    for (seed, (name, dims)) in shapes.into_iter().enumerate() {
        let noise = random_integers(seed as u64, dims, 8);
        let Value::U32(noise) = noise else { continue };
        let level = |i: usize| 60.0 + noise.data()[i] as f32;
        let whole: Value = Tensor::from_fn(dims, level).into();
        cases.push(Case::new(name, OWN, vec![whole.clone()]).exact());
        let reference =
            map(dims, &|c, y, x| if (c + y + x).is_multiple_of(4) { 128.0 } else { 64.0 });
        let name = format!("{name}, against a reference");
        let op = Contact { threshold: 40.0, ..AGAINST };
        cases.push(Case::new(name, op, vec![whole, reference]).exact());
    }
    cases
}
