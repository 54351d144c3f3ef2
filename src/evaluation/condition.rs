//! Figures by what the labels state.

use serde::Serialize;

use super::{Figures, Seen, Snap, figures};
use crate::evaluation::coco::Attribute;

/// Figures of the pictures, or of the snaps, that share something.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stratum {
    /// What they share: a name with its unit.
    pub condition: &'static str,
    /// How much of it.
    pub value: String,
    /// Of a condition of snaps, figures are of these snaps alone: whether others are found counts
    /// neither way, and pictures without one are left out.
    pub figures: Figures,
}

/// Whose condition it is.
enum Of {
    Snap(&'static str),
    /// Of what has a direction: others are labelled too, but it means nothing there.
    Hook(&'static str),
    Picture(&'static str),
}

/// How values are put together.
enum Bins {
    /// As they are.
    Each,
    /// Names of no and yes.
    Flag([&'static str; 2]),
    /// Between these.
    Edges(&'static [f64]),
    /// Without it, where it is 0; else between these.
    Without(&'static [f64]),
    /// The picture's side that is nearest to a direction in degrees from x towards y.
    Sides,
}

/// From the direction 0 on, a quarter turn each.
const SIDES: [&str; 4] = ["right", "below", "left", "above"];

/// By what: name and unit, where it stands in the labels, how values are put together.
const CONDITIONS: [(&str, Of, Bins); 21] = [
    ("depth, mm", Of::Snap("depth_mm"), Bins::Edges(&[0.3, 0.8, 1.2])),
    ("cut by the edge", Of::Snap("whole"), Bins::Flag(["cut", "whole"])),
    ("slots", Of::Snap("slots"), Bins::Each),
    ("hole, mm", Of::Snap("hole_mm"), Bins::Edges(&[2.5, 3.5])),
    ("wall", Of::Hook("wall"), Bins::Flag(["without", "with"])),
    ("on its side", Of::Hook("on_side"), Bins::Flag(["no", "yes"])),
    ("markers' pitch, mm", Of::Picture("markers_mm"), Bins::Without(&[2.0, 3.0])),
    ("shadows' depth", Of::Picture("shadows"), Bins::Without(&[0.5])),
    ("strength of shading", Of::Picture("strength"), Bins::Edges(&[1.0, 2.0, 3.0])),
    ("light from one side", Of::Picture("light_deg"), Bins::Sides),
    ("darkness of depth", Of::Picture("darkness"), Bins::Edges(&[0.4, 0.7])),
    ("rim", Of::Picture("rim"), Bins::Edges(&[0.0, 0.4])),
    ("colour of light", Of::Picture("colour"), Bins::Edges(&[0.0, 0.12, 0.6])),
    ("exposure", Of::Picture("exposure"), Bins::Edges(&[0.7, 1.4, 2.0])),
    ("mottle", Of::Picture("mottle"), Bins::Edges(&[0.02])),
    ("JPEG's quality", Of::Picture("jpeg"), Bins::Edges(&[80.0])),
    ("housing in view", Of::Picture("housing"), Bins::Flag(["no", "yes"])),
    ("optics", Of::Picture("optics"), Bins::Each),
    ("mechanics", Of::Picture("mechanics"), Bins::Each),
    ("scale, pixels a mm", Of::Picture("pixels_per_mm"), Bins::Edges(&[10.0, 20.0])),
    ("field's longer side, mm", Of::Picture("field_mm"), Bins::Edges(&[20.0, 30.0, 45.0])),
];

/// Figures by each condition that the labels state: depth, cut, slots, markers and so on. What no
/// label states, and what is alike in all, has no rows.
pub fn by_condition(seen: &[Seen], classes: &[usize], conf: f64) -> Vec<Stratum> {
    let mut strata = Vec::new();
    for (condition, of, bins) in &CONDITIONS {
        let mut values: Vec<(usize, String)> = match of {
            Of::Picture(_) => {
                seen.iter().filter_map(|p| place(p.conditions.get(name(of))?, bins)).collect()
            }
            Of::Snap(_) | Of::Hook(_) => {
                let snaps =
                    seen.iter().flat_map(|p| &p.snaps).filter(|s| classes.contains(&s.class));
                snaps.filter_map(|s| of_snap(s, of, bins)).collect()
            }
        };
        values.sort();
        values.dedup();
        if values.len() < 2 {
            continue;
        }
        for value in values {
            let some: Vec<Seen> = match of {
                Of::Picture(name) => {
                    let is = |p: &&Seen| {
                        p.conditions.get(*name).and_then(|a| place(a, bins)).as_ref()
                            == Some(&value)
                    };
                    seen.iter().filter(is).cloned().collect()
                }
                Of::Snap(_) | Of::Hook(_) => {
                    let is = |s: &Snap| of_snap(s, of, bins).as_ref() == Some(&value);
                    seen.iter().filter_map(|p| asking(p, is)).collect()
                }
            };
            let figures = figures(&some, classes, conf);
            strata.push(Stratum { condition, value: value.1, figures });
        }
    }
    strata
}

fn name(of: &Of) -> &'static str {
    match of {
        Of::Snap(name) | Of::Hook(name) | Of::Picture(name) => name,
    }
}

fn of_snap(snap: &Snap, of: &Of, bins: &Bins) -> Option<(usize, String)> {
    if matches!(of, Of::Hook(_)) && !snap.attributes.contains_key("yaw_deg") {
        return None;
    }
    place(snap.attributes.get(name(of))?, bins)
}

/// The picture with the other snaps ignored; `None` if it has none of those asked for.
fn asking(picture: &Seen, is: impl Fn(&Snap) -> bool) -> Option<Seen> {
    if !picture.snaps.iter().any(&is) {
        return None;
    }
    let mut picture = picture.clone();
    for snap in &mut picture.snaps {
        snap.truth.ignored |= !is(snap);
    }
    Some(picture)
}

/// Where a value belongs: its place in the table, and its name. `None` for what is of another kind.
fn place(value: &Attribute, bins: &Bins) -> Option<(usize, String)> {
    let between = |number: f64, edges: &[f64]| {
        let place = edges.partition_point(|edge| *edge <= number);
        let name = match (place.checked_sub(1).map(|i| edges[i]), edges.get(place)) {
            (Some(low), Some(high)) => format!("{low} to {high}"),
            (Some(low), None) => format!("from {low}"),
            (None, Some(high)) => format!("below {high}"),
            (None, None) => "all".to_owned(),
        };
        (1 + place, name)
    };
    match (value, bins) {
        (Attribute::Flag(flag), Bins::Flag(names)) => {
            Some((usize::from(*flag), names[usize::from(*flag)].to_owned()))
        }
        (Attribute::Number(number), Bins::Each) => {
            Some((number.max(0.0) as usize, number.to_string()))
        }
        (Attribute::Text(text), Bins::Each) => Some((0, text.clone())),
        (Attribute::Number(degrees), Bins::Sides) => {
            let side = ((degrees / 90.0).round() as i64).rem_euclid(4) as usize;
            Some((side, SIDES[side].to_owned()))
        }
        (Attribute::Number(0.0), Bins::Without(_)) => Some((0, "without".to_owned())),
        (Attribute::Number(number), Bins::Edges(edges) | Bins::Without(edges)) => {
            Some(between(*number, edges))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{found, seen, snap};
    use super::*;

    fn number(name: &'static str, value: f64) -> (&'static str, Attribute) {
        (name, Attribute::Number(value))
    }

    fn get<'a>(strata: &'a [Stratum], condition: &str, value: &str) -> &'a Figures {
        let found = strata.iter().find(|s| s.condition == condition && s.value == value);
        &found.unwrap_or_else(|| panic!("no {condition} {value} in {strata:?}")).figures
    }

    #[test]
    fn snaps_of_other_depths_count_neither_way() {
        // A deep snap that is found and a faint one that is not, in one picture; and a box on nothing.
        let both = seen(
            vec![
                snap(0, 0.0, &[number("depth_mm", 1.0)]),
                snap(0, 50.0, &[number("depth_mm", 0.2)]),
            ],
            vec![found(0, 0.0, 0.9), found(0, 90.0, 0.7)],
        );
        // A faint one that is found, and none at all.
        let faint =
            seen(vec![snap(0, 50.0, &[number("depth_mm", 0.3)])], vec![found(0, 50.0, 0.8)]);
        let empty = seen(vec![], vec![found(0, 0.0, 0.9)]);
        let strata = by_condition(&[both, faint, empty], &[0], 0.5);
        let deep = get(&strata, "depth, mm", "0.8 to 1.2");
        // Of the picture with both: the faint one is no miss.
        assert_eq!((deep.pictures, deep.snaps, deep.right, deep.false_alarms), (1, 1, 1, 1));
        assert_eq!((deep.mean_best_iou, deep.ap50), (Some(1.0), Some(1.0)));
        let grazed = get(&strata, "depth, mm", "below 0.3");
        // The box on the deep one is no false box, but the one on nothing is.
        assert_eq!((grazed.snaps, grazed.right, grazed.false_alarms), (1, 0, 1));
        assert_eq!(grazed.ap50, Some(0.0));
        // An edge belongs above.
        assert_eq!(get(&strata, "depth, mm", "0.3 to 0.8").right, 1);
        let order: Vec<&str> = strata.iter().map(|s| s.value.as_str()).collect();
        assert_eq!(order, ["below 0.3", "0.3 to 0.8", "0.8 to 1.2"]);
    }

    #[test]
    fn pictures_are_parted_with_all_that_they_hold() {
        let under = |conditions: &[(&'static str, Attribute)], found| {
            let mut picture = seen(vec![], found);
            picture.conditions =
                conditions.iter().map(|(n, a)| ((*n).to_owned(), a.clone())).collect();
            picture
        };
        let text = |word: &str| ("optics", Attribute::Text(word.into()));
        let pictures = [
            under(&[number("markers_mm", 0.0), text("lamps")], vec![]),
            under(&[number("markers_mm", 2.0), text("measured")], vec![found(0, 0.0, 0.9)]),
            under(&[number("markers_mm", 3.5), text("lamps")], vec![]),
            // Another tool's: says nothing here, and is no mistake.
            under(&[("markers_mm", Attribute::Text("many".into()))], vec![]),
            under(&[], vec![]),
        ];
        let strata = by_condition(&pictures, &[0], 0.5);
        let rows: Vec<(&str, &str, usize)> = strata
            .iter()
            .map(|s| (s.condition, s.value.as_str(), s.figures.without_snap.false_alarms))
            .collect();
        let expected = [
            ("markers' pitch, mm", "without", 0),
            ("markers' pitch, mm", "2 to 3", 1),
            ("markers' pitch, mm", "from 3", 0),
            ("optics", "lamps", 0),
            ("optics", "measured", 1),
        ];
        assert_eq!(rows, expected);
        assert_eq!(get(&strata, "optics", "lamps").pictures, 2);
    }

    /// Directions from −180° to 180° in four quarters about the sides.
    #[test]
    fn light_comes_from_the_nearest_side() {
        let sides = [0.0, 44.0, 46.0, 134.0, 136.0, 180.0, -136.0, -134.0, -46.0, -44.0]
            .map(|degrees| place(&Attribute::Number(degrees), &Bins::Sides).expect("a side").1);
        let expected = ["right", "right", "below", "below", "left", "left", "left", "above"];
        assert_eq!(sides[..8], expected);
        assert_eq!(sides[8..], ["above", "right"]);
    }

    #[test]
    fn walls_are_of_hooks() {
        let wall = |flag| ("wall", Attribute::Flag(flag));
        let pictures = [
            seen(vec![snap(0, 0.0, &[wall(true), number("yaw_deg", 3.0)])], vec![]),
            seen(vec![snap(0, 0.0, &[wall(false), number("yaw_deg", 3.0)])], vec![]),
            seen(vec![snap(1, 0.0, &[wall(false), number("slots", 4.0)])], vec![]),
            seen(vec![snap(1, 0.0, &[wall(false), number("slots", 12.0)])], vec![]),
        ];
        let strata = by_condition(&pictures, &[0, 1], 0.5);
        let rows: Vec<(&str, &str, usize)> =
            strata.iter().map(|s| (s.condition, s.value.as_str(), s.figures.snaps)).collect();
        let expected =
            [("slots", "4", 1), ("slots", "12", 1), ("wall", "without", 1), ("wall", "with", 1)];
        assert_eq!(rows, expected);
    }
}
