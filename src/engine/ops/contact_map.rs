//! Where something touches the gel.

use crate::engine::ops::case::{Case, integers, random_integers};
use crate::engine::ops::op::{Entry, Op, Tolerance, expect, map_dims};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference::{self, ContactRule};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "contact_map",
    takes: "cells [3, H, W], levels from 0 to 255; optional: reference [3, H, W]",
    gives: "output u32 [N], a bit for each of ⌈H/2⌉ × ⌈W/2⌉ tiles",
    // The defaults are for trying it out; a detector sets its own (`src/detector/contact_map.rs`).
    params: &[
        Param::optional("least", "0.01", Range::Number(0.0, f32::MAX)),
        Param::optional("most", "0.04", Range::Number(0.0, f32::MAX)),
        Param::optional("clipped", "250", Range::Number(0.0, f32::MAX)),
        Param::optional("reach", "1", Range::Whole(1, 8)),
        Param::optional("factor", "4", Range::Number(0.0, f32::MAX)),
    ],
    build,
    cases,
};

/// Which tiles of a frame differ from what is round them by more than the gel does elsewhere, or than a
/// reference frame without contact does.
///
/// Inputs: `cells [3, H, W]`, the frame with a cell for each half millimetre of gel, in levels from 0 to
/// 255; `reference`, the same of a frame without contact, if `reference`. Output: `output u32
/// [⌈T/32⌉]`, a bit for each of the T tiles of 2 × 2 cells, row by row from the lowest bit on, set where
/// one of its cells is touched: see [`reference::contact_map`].
#[derive(Clone, Copy, Debug)]
pub struct ContactMap {
    /// Share of the brightness by which an untouched tile may differ at least.
    pub least: f32,
    /// And at most, however uneven the gel is.
    pub most: f32,
    /// From this level on in all channels a cell shows nothing, and may be touched.
    pub clipped: f32,
    /// Cells from one to each of the two with which it is compared.
    pub reach: u32,
    /// Touched tiles differ by more than so many times what the calmest quarter of all differs by.
    pub factor: f32,
    /// Whether there is a reference frame.
    pub reference: bool,
}

impl ContactMap {
    /// Rows and columns of tiles for so many of cells.
    pub fn tiles(cells: [usize; 2]) -> [usize; 2] {
        cells.map(|side| side.div_ceil(ContactRule::TILE))
    }

    /// What counts as contact.
    pub fn rule(&self) -> ContactRule {
        let Self { least, most, clipped, reach, factor, .. } = *self;
        ContactRule { least, most, clipped, reach, factor }
    }
}

impl Op for ContactMap {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![
            ("least", self.least.into()),
            ("most", self.most.into()),
            ("clipped", self.clipped.into()),
            ("reach", self.reach.into()),
            ("factor", self.factor.into()),
        ]
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
        let reference = inputs.get(1).map(|r| r.f32()).transpose()?;
        let words = reference::contact_map(inputs[0].f32()?, reference, self.rule());
        Ok(vec![Tensor::new(specs[0].shape.clone(), words)?.into()])
    }

    /// A bit turns where rounding takes a difference across a limit; in the cases none comes so
    /// close.
    fn tolerance(&self, _inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        Ok(vec![Tolerance::Exact])
    }
}

fn build(params: &mut Named, present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(ContactMap {
        least: params.take("least", 0.01)?,
        most: params.take("most", 0.04)?,
        clipped: params.take("clipped", 250.0)?,
        reach: params.take("reach", 1)?,
        factor: params.take("factor", 4.0)?,
        reference: present.contains(&"reference"),
    }))
}

fn cases() -> Vec<Case> {
    // Limits in steps of 3/512, so that none rounds.
    const OWN: ContactMap = ContactMap {
        least: 0.0625,
        most: 0.25,
        clipped: 250.0,
        reach: 2,
        factor: 3.0,
        reference: false,
    };
    const AGAINST: ContactMap = ContactMap { reference: true, ..OWN };
    const FIXED: ContactMap = ContactMap { most: 0.0625, ..OWN };
    let map = |dims: [usize; 3], level: &dyn Fn(usize, usize, usize) -> f32| -> Value {
        let [_, height, width] = dims;
        Tensor::from_fn(dims, |i| level(i / (height * width), i / width % height, i % width)).into()
    };
    let by_hand = |name: &str, op: ContactMap, inputs: Vec<Value>, words: &[u32]| {
        Case::new(name, op, inputs).by_hand(vec![integers([words.len()], words)]).exact()
    };
    // One row, tiles of two cells. Cell 9 is brighter in green.
    let spot = |bright: f32| {
        move |c: usize, _y: usize, x: usize| if c == 1 && x == 9 { 128.0 + bright } else { 128.0 }
    };
    let line = [3, 1, 20];
    // Two cells up, two cells down, so that each is compared with two of the other kind: (2·height) /
    // (128 − height) up, / (128 + height) down, and at the ends, where one is of its own kind, half of
    // 2·height / 128. Cell 9, which is up, has a level of its own.
    let clouds = |height: f32, own: f32| {
        move |_c: usize, _y: usize, x: usize| match x {
            9 => own,
            x if x % 4 < 2 => 128.0 + height,
            _ => 128.0 - height,
        }
    };
    let mut cases = vec![
        // 9/128 is above 1/16. The cells 7 and 11 see half of it: 4.5 of 132.5.
        by_hand("a spot of 9 by hand", OWN, vec![map(line, &spot(9.0))], &[1 << 4]),
        // Equality is no contact: 8/128.
        by_hand("a spot of 8 by hand", OWN, vec![map(line, &spot(8.0))], &[0]),
        // 12 of 116 are above 1/16: the cells 7 and 11 too.
        by_hand(
            "a dark spot of 24 by hand",
            OWN,
            vec![map(line, &spot(-24.0))],
            &[1 << 3 | 1 << 4 | 1 << 5],
        ),
        // With a reach of 1 it is the cells 8 and 10 that are 12 of 116 off.
        by_hand(
            "a dark spot of 24 and a reach of 1 by hand",
            ContactMap { reach: 1, ..OWN },
            vec![map(line, &spot(-24.0))],
            &[1 << 4 | 1 << 5],
        ),
        // Past the edge its own level counts: half of two steps, 12 of 28 at the left, 12 of 232 at the
        // right; and nothing between.
        by_hand(
            "an even slope by hand",
            ContactMap { least: 0.03125, ..OWN },
            vec![map(line, &|_, _, x| 16.0 + 12.0 * x as f32)],
            &[1 | 1 << 9],
        ),
        // A column of tiles: 20 rows of one cell, cell 9 touched, along y.
        by_hand(
            "a spot in a column by hand",
            OWN,
            vec![map([3, 20, 1], &|c, y, _| if c == 2 && y == 9 { 137.0 } else { 128.0 })],
            &[1 << 4],
        ),
        // 5 above its neighbours across and along, of 132, on one diagonal 9 of 128, on the other nothing: a
        // ridge along that one. Its ends are 5 of 132 above theirs at most. Of 3 × 3 tiles the middle one.
        by_hand(
            "a diagonal by hand",
            FIXED,
            vec![map([3, 5, 5], &|_, y, x| match (x, y) {
                (2, 2) | (4, 0) | (0, 4) => 137.0,
                (0, 2) | (4, 2) | (2, 0) | (2, 4) => 132.0,
                _ => 128.0,
            })],
            &[1 << 4],
        ),
        // Ten tiles, and the first limit that 3 times the third smallest does not pass counts. The two at
        // the ends have 2/128, those that are down 4/130: 0.0923, the limit 0.0625 + 6 · 3/512 = 0.0977.
        // Cell 9 is 13/126 = 0.1032 above its surroundings, or 12/126 = 0.0952.
        by_hand("clouds and 13 by hand", OWN, vec![map(line, &clouds(2.0, 139.0))], &[1 << 4]),
        by_hand("clouds and 12 by hand", OWN, vec![map(line, &clouds(2.0, 138.0))], &[0]),
        // 4 · 4/130 = 0.1231 puts the limit at 0.0625 + 11 · 3/512 = 0.1270.
        by_hand(
            "clouds and a factor of 4 by hand",
            ContactMap { factor: 4.0, ..OWN },
            vec![map(line, &clouds(2.0, 139.0))],
            &[0],
        ),
        // Of eight tiles two are a quarter: 3 · 2/128 is below the least limit, 8/126 above.
        by_hand(
            "a quarter is calm by hand",
            OWN,
            vec![map([3, 1, 16], &clouds(2.0, 134.0))],
            &[1 << 4],
        ),
        // 3 · 16/136 is past the most: 31/120 = 0.2583 is contact, 29/120 = 0.2417 is none.
        by_hand("high clouds and 31 by hand", OWN, vec![map(line, &clouds(8.0, 151.0))], &[1 << 4]),
        by_hand("high clouds and 29 by hand", OWN, vec![map(line, &clouds(8.0, 149.0))], &[0]),
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
        // 64 in the reference: 5 levels are 10 of 128.
        by_hand(
            "a spot against a reference by hand",
            AGAINST,
            vec![
                map(line, &|c, _, x| if c == 0 && x == 9 { 69.0 } else { 64.0 }),
                map(line, &|_, _, _| 64.0),
            ],
            &[1 << 4],
        ),
        // Dark cells of the reference count as 16, so that 1 is 8 of 128; and dark surroundings as 16,
        // so that 8 more are a half, and not all.
        by_hand(
            "a dark reference by hand",
            ContactMap { least: 0.75, most: 0.75, ..AGAINST },
            vec![
                map(line, &|c, _, x| if c == 0 && x == 9 { 2.0 } else { 1.0 }),
                map(line, &|_, _, _| 1.0),
            ],
            &[0],
        ),
        by_hand(
            "a spot in the dark by hand",
            ContactMap { least: 0.4375, most: 0.4375, ..OWN },
            vec![map(line, &|c, _, x| if c == 0 && x == 9 { 16.0 } else { 8.0 })],
            &[1 << 4],
        ),
    ];
    // Half levels, so that no comparison is near; primes, tiles of a word less one, a word and one, and more
    // words than a workgroup has invocations. A third is calm, a third has noise of 4 levels, one of 7.
    let shapes = [
        ("prime sizes", [3, 17, 19]),
        ("31 tiles", [3, 2, 62]),
        ("33 tiles", [3, 6, 21]),
        ("a gel of 40 mm", [3, 80, 80]),
        ("a gel of 60 × 45 mm", [3, 90, 120]),
        ("257 words", [3, 2, 16386]),
    ];
    for (seed, (name, dims)) in shapes.into_iter().enumerate() {
        let noise = random_integers(seed as u64, dims, 8);
        let Value::U32(noise) = noise else { continue };
        let level = |i: usize| {
            let strength = i % dims[2] / 8 % 3;
            60.0 + (noise.data()[i] as usize * strength) as f32 / 2.0
        };
        let whole: Value = Tensor::from_fn(dims, level).into();
        cases.push(Case::new(name, OWN, vec![whole]).exact());
        let whole = Tensor::from_fn(dims, |i| 60.0 + noise.data()[i] as f32).into();
        let reference =
            map(dims, &|c, y, x| if (c + y + x).is_multiple_of(4) { 128.0 } else { 64.0 });
        let name = format!("{name}, against a reference");
        let op = ContactMap { least: 1.15625, most: 1.15625, ..AGAINST };
        cases.push(Case::new(name, op, vec![whole, reference]).exact());
    }
    cases
}
