//! How many millimetres of gel a pixel shows, which part of a frame is gel, and how each is known.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::sensor::rect::Rect;

/// Side of the paper's gel in millimetres: what a picture shows of which nothing else is known.
pub(crate) const PAPER_MM: f32 = 40.0;
/// Millimetres a pixel: from 60 mm on 65 535 pixels to 10 mm on 16.
pub(crate) const MM_PER_PIXEL: [f32; 2] = [5e-4, 1.0];

/// How many millimetres of gel a pixel of a frame shows, and how that is known.
///
/// Scale and gel are found in one way for every frame. The first that says it counts:
///
/// | | who says it | it is then |
/// |---|---|---|
/// | scale | [`Frame::scale`](crate::Frame::scale), else [`Config::mm_per_pixel`](crate::Config::mm_per_pixel) | [`Origin::Stated`], or [`Origin::Label`] |
/// | | [`Config::sensor`](crate::Config::sensor), by the frame's size | [`Origin::Sensor`] |
/// | | nobody: 40 mm along the gel's shorter side, as the paper's sensor has | [`Origin::Assumed`] |
/// | gel | [`Frame::gel`](crate::Frame::gel), else [`Config::gel`](crate::Config::gel) | stated |
/// | | [`Config::sensor`](crate::Config::sensor), by the frame's size | the sensor's |
/// | | nobody: the middle square of a frame of the paper's 16 : 10, unless its stated scale is another; else all of the frame | assumed |
///
/// A crop ([`Frame::crop`](crate::Frame::crop)) cuts what the network sees. It changes neither the scale nor where
/// millimetres begin, which is the middle of the gel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scale {
    /// Millimetres on the undeformed gel for a pixel of the frame, 0.0005 to 1.
    pub mm_per_pixel: f32,
    /// How that is known; serialised as `scale_from`.
    #[serde(rename = "scale_from")]
    pub from: Origin,
}

/// How the scale of a frame is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Origin {
    /// Somebody said it for these frames.
    Stated,
    /// The sensor's, by the frame's size.
    Sensor,
    /// The picture's label says it.
    Label,
    /// Nobody said it: 40 mm along the gel's shorter side. Snaps are missed, and others seen, where that
    /// is wrong.
    Assumed,
}

impl Scale {
    /// A scale that somebody says of these frames.
    pub fn stated(mm_per_pixel: f32) -> Self {
        Self { mm_per_pixel, from: Origin::Stated }
    }

    /// A scale from a picture's label.
    pub fn label(mm_per_pixel: f32) -> Self {
        Self { mm_per_pixel, from: Origin::Label }
    }

    /// Checks that a sensor can have this scale; NaN is none.
    ///
    /// # Errors
    /// [`Error::Param`] outside 0.0005 to 1 mm.
    pub fn check(&self) -> Result<()> {
        let ([least, most], got) = (MM_PER_PIXEL, self.mm_per_pixel);
        match (least..=most).contains(&got) {
            true => Ok(()),
            false => {
                let expected = format!("{least} to {most} mm a pixel");
                Err(Error::param("frame", "scale", expected, got))
            }
        }
    }
}

/// Which part of a frame shows the gel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gel {
    /// All of it.
    All,
    /// This part.
    Part(Rect),
}

impl FromStr for Gel {
    type Err = Error;

    /// `all`, or `X,Y,WIDTH,HEIGHT` in pixels.
    ///
    /// # Errors
    /// [`Error::Param`] for anything else, and for an empty part.
    fn from_str(text: &str) -> Result<Self> {
        if text.eq_ignore_ascii_case("all") {
            return Ok(Self::All);
        }
        let sides = text.split(',').map(|side| side.trim().parse().ok());
        match sides.collect::<Option<Vec<u32>>>().as_deref() {
            Some(&[x, y, width, height]) if width > 0 && height > 0 => {
                Ok(Self::Part(Rect { x, y, width, height }))
            }
            _ => Err(Error::param("frame", "gel", "`all` or X,Y,WIDTH,HEIGHT in pixels", text)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gel_is_all_or_a_part() {
        assert_eq!("all".parse::<Gel>().expect("a gel"), Gel::All);
        let part = Rect { x: 460, y: 100, width: 1000, height: 90 };
        assert_eq!("460, 100,1000,90".parse::<Gel>().expect("a gel"), Gel::Part(part));
        for text in
            ["", "1,2,3", "1,2,3,4,5", "1,2,0,4", "1,2,3,0", "-1,2,3,4", "a,b,c,d", "1;2;3;4"]
        {
            let message = text.parse::<Gel>().expect_err("an error").to_string();
            assert!(message.contains("`all` or X,Y,WIDTH,HEIGHT"), "{text}: {message}");
        }
    }
}
