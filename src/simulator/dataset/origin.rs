//! What a folder was made with.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::super::conditions::Distribution;
use super::super::distractors::Part;
use super::super::forced::Forced;
use super::super::relief::Relief;
use super::super::render::Request;
use super::super::scene::{Mix, Negative, NegativeShape};
use super::super::snaps::Kind;
use super::Settings;
use crate::sensor::Sensor;

/// What a folder was made with; another call must ask for the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Origin {
    seed: u64,
    kind: Mix,
    simulator: u32,
    #[serde(default)]
    conditions: Distribution,
    #[serde(default)]
    part: Option<Part>,
    #[serde(default)]
    forced: Forced,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sensor: Option<Sensor>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    press: bool,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    classes: Vec<OwnClass>,
    /// Digests of shapes that are no snaps; names of kinds that are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    negatives: Vec<String>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    negatives_alone: bool,
}

/// A class of one's own, as a folder was made with it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct OwnClass {
    name: String,
    /// Of its heights; none for A and B.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    digest: Option<String>,
}

impl Origin {
    pub fn of(settings: &Settings) -> Self {
        let Request { mix, conditions, part, forced, sensor, press, own } = &settings.request;
        let class = |kind: &Kind| OwnClass {
            name: kind.name().to_owned(),
            digest: match kind {
                Kind::Own(part) => Some(digest(&part.relief)),
                Kind::A | Kind::B => None,
            },
        };
        Self {
            seed: settings.seed,
            kind: *mix,
            simulator: simulator(*conditions),
            conditions: *conditions,
            part: *part,
            forced: forced.clone(),
            sensor: sensor.as_ref().map(|given| given.sensor().clone()),
            press: *press,
            classes: own.classes.iter().map(class).collect(),
            negatives: own
                .negatives
                .iter()
                .map(|Negative { shape, pressed, .. }| match (shape, pressed) {
                    (NegativeShape::Snap(kind), _) => kind.name().to_owned(),
                    (NegativeShape::Relief(relief), None) => digest(relief),
                    (NegativeShape::Relief(relief), Some(pressed)) => {
                        format!("{}, from {:.2} mm", digest(relief), pressed.least_mm)
                    }
                })
                .collect(),
            negatives_alone: own.negatives_alone,
        }
    }
}

fn digest(relief: &Relief) -> String {
    format!("{:016x}", relief.digest())
}

/// Raised when the same seed would give another picture.
fn simulator(conditions: Distribution) -> u32 {
    match conditions {
        Distribution::Plain => 3,
        Distribution::Wide => 5,
    }
}

/// A folder's origin in words.
pub(super) fn show(origin: &Origin) -> String {
    let kind = match origin.kind {
        Mix::A => "a",
        Mix::B => "b",
        Mix::Mixed => "mixed",
        Mix::None => "none",
        Mix::Bare => "bare",
    };
    let mut text = format!("seed {}, kind {kind}, simulator {}", origin.seed, origin.simulator);
    if origin.conditions == Distribution::Wide {
        text += ", wide conditions";
    }
    if origin.press {
        text += ", a press";
    }
    if let Some(part) = origin.part {
        text += &format!(", part {part:?}").to_lowercase();
    }
    if origin.forced != Forced::default() {
        text += &format!(", forced {}", origin.forced);
    }
    if let Some(sensor) = &origin.sensor {
        text += &format!(", sensor {}", sensor.name);
    }
    text
}

/// In what a sensor differs from one of the same name, in words; else nothing.
pub(super) fn other_sensor(found: &Origin, wanted: &Origin) -> String {
    let (Some(found), Some(wanted)) = (&found.sensor, &wanted.sensor) else {
        return String::new();
    };
    let [found, wanted] =
        [found, wanted].map(|sensor| serde_json::to_value(sensor).unwrap_or_default());
    if found["name"] != wanted["name"] || found == wanted {
        return String::new();
    }
    let keys = [&found, &wanted].into_iter().filter_map(|sensor| sensor.as_object());
    let keys: BTreeSet<&String> = keys.flat_map(|fields| fields.keys()).collect();
    let differing = keys.into_iter().filter(|key| found[key.as_str()] != wanted[key.as_str()]);
    let differing: Vec<&str> = differing.map(String::as_str).collect();
    format!(" with another {}", differing.join(" and "))
}
