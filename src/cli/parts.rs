//! Parts of one's own, for `simulate` and `teach`: what the options name, read from files.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use smr_gpu::simulator::Error;
use smr_gpu::simulator::mesh::{Mesh, Unit};
use smr_gpu::simulator::own_part::{Derived, OwnPart, PressedLike};
use smr_gpu::simulator::relief::{self, Direction, Relief, Symmetry, View};
use smr_gpu::simulator::scene::{Negative, NegativeShape, Own};
use smr_gpu::simulator::snaps::Kind;
use smr_gpu::smr::MAX_CLASSES;

use super::exit::{Exit, Failure};
use super::message::remark;
use super::names::shown;

/// Longest file of a part's settings, in bytes.
const MOST_SETTINGS: u64 = 1 << 16;

/// How the files' parts lie before the gel, where a part's own file of settings does not say it.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(super) struct CadArgs {
    /// Which direction of the files points to the gel.
    #[arg(help_heading = "Parts of your own", long, default_value = "z", value_name = "x|y|z|-x|-y|-z", value_parser = direction)]
    #[arg(allow_hyphen_values = true, requires = "part")]
    axis: Direction,

    /// Which direction of the files points up in a picture of a part that is not turned [default: y, or z where
    /// --axis is another].
    #[arg(help_heading = "Parts of your own", long, value_name = "x|y|z|-x|-y|-z", value_parser = direction)]
    #[arg(allow_hyphen_values = true, requires = "part")]
    up: Option<Direction>,

    /// What lengths in the files are in.
    #[arg(help_heading = "Parts of your own", long, default_value = "mm", value_name = "mm|inch|m", value_parser = unit)]
    #[arg(requires = "part")]
    unit: Unit,

    /// Side of a pixel of a height map, in millimetres.
    #[arg(help_heading = "Parts of your own", long, value_name = "MM", requires = "part")]
    map_pixel: Option<f64>,

    /// Height of white over black in a height map, in millimetres.
    #[arg(help_heading = "Parts of your own", long, value_name = "MM", requires = "part")]
    map_height: Option<f64>,
}

/// A class, as `--part` names it.
#[derive(Clone, Debug)]
pub(super) enum PartArg {
    A,
    B,
    Own { name: String, file: PathBuf },
}

impl PartArg {
    fn name(&self) -> &str {
        match self {
            Self::A => "A",
            Self::B => "B",
            Self::Own { name, .. } => name,
        }
    }
}

impl fmt::Display for PartArg {
    /// As it is typed.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::A | Self::B => f.write_str(self.name()),
            Self::Own { name, file } => write!(f, "{name}={}", shown(file.as_os_str())),
        }
    }
}

fn direction(text: &str) -> Result<Direction, String> {
    Direction::named(text).ok_or_else(|| "expected x, y, z, -x, -y or -z".to_owned())
}

fn unit(text: &str) -> Result<Unit, String> {
    Unit::named(text).ok_or_else(|| "expected mm, inch or m".to_owned())
}

/// Parses `NAME=FILE`, `A` or `B`.
///
/// # Errors
/// In words.
pub(super) fn part(text: &str) -> Result<PartArg, String> {
    match text.split_once('=') {
        None if text == "A" => Ok(PartArg::A),
        None if text == "B" => Ok(PartArg::B),
        None => Err("expected NAME=FILE, A or B".to_owned()),
        Some((name, _)) if name.trim().is_empty() => Err("expected a name before `=`".to_owned()),
        Some((_, "")) => Err("expected a file behind `=`".to_owned()),
        Some((name, file)) => Ok(PartArg::Own { name: name.trim().into(), file: file.into() }),
    }
}

/// Parses what [`part`] does, or a file alone: then the part is called as that is.
///
/// # Errors
/// In words.
pub(super) fn part_or_file(text: &str) -> Result<PartArg, String> {
    let file = Path::new(text);
    match file.file_stem().map(|stem| stem.to_string_lossy().trim().to_owned()) {
        _ if matches!(text, "A" | "B") || text.contains('=') => part(text),
        Some(name) if !name.is_empty() => Ok(PartArg::Own { name, file: file.into() }),
        _ => Err("expected NAME=FILE, FILE, A or B".to_owned()),
    }
}

/// The files that the parts are read from.
pub(super) fn files(parts: &[PartArg]) -> Vec<PathBuf> {
    let named = parts.iter().filter_map(|part| match part {
        PartArg::A | PartArg::B => None,
        PartArg::Own { file, .. } => Some(file.clone()),
    });
    let files: Vec<_> = named.collect();
    let told = files.iter().filter(|file| is_settings(file)).filter_map(|file| settings(file).ok());
    let told: Vec<_> = told.map(|settings| settings.file).collect();
    [files, told].concat()
}

/// A part's settings: what differs from part to part.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PartSettings {
    /// The CAD file or height map.
    file: PathBuf,
    axis: Option<Direction>,
    up: Option<Direction>,
    unit: Option<Unit>,
    map_pixel: Option<f64>,
    map_height: Option<f64>,
}

fn has_ending(file: &Path, ending: &str) -> bool {
    file.extension().is_some_and(|own| own.eq_ignore_ascii_case(ending))
}

fn is_settings(file: &Path) -> bool {
    has_ending(file, "json")
}

/// Reads a part's settings; its file is named from their folder.
///
/// # Errors
/// In words that name the key.
fn settings(path: &Path) -> Result<PartSettings, String> {
    let bytes = smr_gpu::files::read(path, MOST_SETTINGS).map_err(|e| e.to_string())?;
    let text = smr_gpu::files::text(&bytes).map_err(|e| e.to_string())?;
    let mut json = serde_json::Deserializer::from_str(text);
    let read = serde_path_to_error::deserialize::<_, PartSettings>(&mut json);
    let mut settings = read.map_err(|e| match e.path().iter().next() {
        None => e.inner().to_string(),
        Some(_) => e.to_string(),
    })?;
    json.end().map_err(|e| e.to_string())?;
    settings.file = path.parent().unwrap_or(Path::new("")).join(settings.file);
    if is_settings(&settings.file) || !settings.file.exists() {
        let got = if is_settings(&settings.file) { "settings" } else { "none there" };
        let file = shown(settings.file.as_os_str());
        return Err(format!("file: expected a CAD file or a height map, got {got}: {file}"));
    }
    Ok(settings)
}

/// Reads the parts and what is taken for them, and tells what is odd about each.
///
/// # Errors
/// [`Exit::Usage`] for two classes of one name or too many; [`Exit::Inputs`] for a file that holds no part.
pub(super) fn own(parts: &[PartArg], negatives: &[PathBuf], cad: &CadArgs) -> Result<Own, Failure> {
    if parts.len() > MAX_CLASSES {
        let got = parts.len();
        return Err(Failure::usage(format!("--part: expected at most {MAX_CLASSES}, got {got}")));
    }
    let mut own = Own::default();
    for (at, part) in parts.iter().enumerate() {
        let name = part.name();
        if parts[..at].iter().any(|other| other.name().eq_ignore_ascii_case(name)) {
            let message =
                format!("--part: expected a name of its own for each, got `{name}` twice");
            return Err(Failure::usage(message));
        }
        own.classes.push(match part {
            PartArg::A => Kind::A,
            PartArg::B => Kind::B,
            PartArg::Own { name, file } => {
                let part = OwnPart::new(name.clone(), read(file, cad)?);
                remark(described(&part));
                for Derived { what, weight, shape } in part.negatives() {
                    let name = format!("{name}-{what}");
                    match shape {
                        Some((relief, least_mm)) => {
                            let pressed = Some(PressedLike { part: part.clone(), least_mm });
                            let negative = Negative::of(name, relief);
                            own.negatives.push(Negative { weight, pressed, ..negative });
                        }
                        None => remark(format!("{name} looks like the part, and is left out")),
                    }
                }
                Kind::Own(part)
            }
        });
    }
    for file in negatives {
        let name = file.file_stem().unwrap_or(file.as_os_str()).to_string_lossy().into_owned();
        own.negatives.push(Negative::of(name, read(file, cad)?));
    }
    for kind in [Kind::A, Kind::B] {
        if !own.classes.is_empty() && !own.classes.contains(&kind) {
            let (name, shape) = (kind.name().to_owned(), NegativeShape::Snap(kind));
            own.negatives.push(Negative { name, shape, weight: 1, pressed: None });
        }
    }
    Ok(own)
}

/// A part's size and its symmetry, in words.
pub(super) fn described(part: &OwnPart) -> String {
    let [x, y] = part.relief.half_size().map(|half| 2.0 * half);
    let turns = match part.symmetry {
        Symmetry::None => "it has a direction".to_owned(),
        Symmetry::Half => "it looks the same after half a turn".to_owned(),
        Symmetry::Quarter => "it looks the same after a quarter of a turn".to_owned(),
        Symmetry::Other(turns) => format!("it looks the same after 1/{turns} of a turn"),
        Symmetry::Round => "it looks the same from everywhere".to_owned(),
    };
    format!("{}: {x:.2} x {y:.2} mm; {turns}", part.name)
}

/// Reads a part from a CAD file or a height map, or from what settings name.
fn read(file: &Path, cad: &CadArgs) -> Result<Relief, Failure> {
    if !is_settings(file) {
        return read_shape(file, cad);
    }
    let about = |message: String| format!("{}: {message}", shown(file.as_os_str()));
    let own = settings(file).map_err(|e| Failure::new(Exit::Inputs, about(e)))?;
    let cad = CadArgs {
        axis: own.axis.unwrap_or(cad.axis),
        up: own.up.or(cad.up),
        unit: own.unit.unwrap_or(cad.unit),
        map_pixel: own.map_pixel.or(cad.map_pixel),
        map_height: own.map_height.or(cad.map_height),
    };
    read_shape(&own.file, &cad).map_err(|e| Failure { message: e.message.map(about), ..e })
}

fn read_shape(file: &Path, cad: &CadArgs) -> Result<Relief, Failure> {
    let part = |source: relief::Error| {
        Failure::new(Exit::Inputs, Error::Part { path: file.to_owned(), source })
    };
    if has_ending(file, "png") {
        let (Some(pixel), Some(height)) = (cad.map_pixel, cad.map_height) else {
            let message = format!(
                "{}: expected --map-pixel and --map-height for a height map, got none",
                shown(file.as_os_str())
            );
            return Err(Failure::usage(message));
        };
        return Relief::read_map(file, pixel, height).map_err(part);
    }
    let mesh = Mesh::read(file, cad.unit).map_err(|e| part(e.into()))?;
    let view = View { towards: cad.axis, up: cad.up };
    let (relief, remarks) = Relief::of_mesh(&mesh, view).map_err(part)?;
    for what in remarks {
        remark(format!("{}: {what}", shown(file.as_os_str())));
    }
    Ok(relief)
}
