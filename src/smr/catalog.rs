//! Finding weights, by the name of a network or as a file. No weights are read on the way.
//!
//! 1. A file that is there is that file, and so is whatever is no plain word (letters, digits, `-` and `_`).
//! 2. A word is the name of a network. `large` is the file `smrnet.safetensors`, `small` is
//!    `smrnet-s.safetensors`, and any other `NAME` is `NAME.safetensors`, in the first of these folders that
//!    has one:
//!    - `$SMR_GPU_WEIGHTS`, if it is a folder;
//!    - the user's data: `$XDG_DATA_HOME/smr-gpu/weights`, by default `~/.local/share/smr-gpu/weights`; on macOS
//!      `~/Library/Application Support/smr-gpu/weights`, on Windows `%LOCALAPPDATA%\smr-gpu\weights`;
//!    - `weights` beside the program, and up to two folders above it;
//!    - `share/smr-gpu/weights` beside the program's folder, where packages put it: of `/usr/bin/smr-gpu` that is
//!      `/usr/share/smr-gpu/weights`;
//!    - `weights` in the current folder.
//! 3. `small` is also in the program, with the feature `embedded-weights`.
//!
//! Where nothing is asked for, what `$SMR_GPU_WEIGHTS` says counts, if it is no folder; else `large`; where there
//! is none, `small`.

use std::collections::BTreeMap;
use std::env;
use std::path::{Path, PathBuf};

use etcetera::BaseStrategy;

use crate::error::{Error, Result};
use crate::smr::weights::WeightSource;

/// Names a folder of weights, or the weights that count where none are asked for.
pub const VARIABLE: &str = "SMR_GPU_WEIGHTS";

/// The networks that this program was made with.
pub const PUBLISHED: [Published; 2] = [
    Published {
        name: "large",
        file: "smrnet.safetensors",
        sha256: "61ba90a3c20a91cd45bd154edf624fa2fa98c70d875dd62904ec46454771b3cd",
    },
    Published {
        name: "small",
        file: "smrnet-s.safetensors",
        sha256: "f62eb741d1e410bc073e341e7e035940bbcef69553c31e38d3080a5f6aee9d48",
    },
];

/// Weights that the program knows.
#[derive(Clone, Copy, Debug)]
pub struct Published {
    /// The network's name.
    pub name: &'static str,
    /// The name of its file.
    pub file: &'static str,
    /// The file's SHA-256, in small hexadecimal digits.
    pub sha256: &'static str,
}

/// Where weights are looked for.
#[derive(Clone, Debug)]
pub struct Catalog {
    /// Folders, the nearest first.
    folders: Vec<PathBuf>,
    /// What counts where nothing is asked for.
    usual: Option<PathBuf>,
}

impl Catalog {
    /// The places of this process's environment.
    pub fn from_env() -> Self {
        let variable = env::var_os(VARIABLE).filter(|v| !v.is_empty()).map(PathBuf::from);
        let program = env::current_exe().unwrap_or_default();
        // The third folder up from target/release/smr-gpu is the checkout.
        let beside = program.ancestors().skip(1).take(3).map(|folder| folder.join("weights"));
        let share = program.ancestors().nth(2).map(|folder| folder.join("share/smr-gpu/weights"));
        let folders = data_folder().into_iter().chain(beside).chain(share);
        let folders = folders.chain(["weights".into()]);
        Self::new(variable, folders)
    }

    /// With what [`VARIABLE`] says, and the other folders, the nearest first.
    fn new(variable: Option<PathBuf>, folders: impl IntoIterator<Item = PathBuf>) -> Self {
        let is_folder = variable.as_deref().is_some_and(Path::is_dir);
        let (folder, usual) = if is_folder { (variable, None) } else { (None, variable) };
        Self { folders: folder.into_iter().chain(folders).collect(), usual }
    }

    /// The weights of that name, or that file. A file need not be there: reading it says so.
    ///
    /// # Errors
    /// [`Error::NoWeights`] for a name that nothing has.
    pub fn find(&self, weights: &Path) -> Result<WeightSource> {
        match weights.to_str() {
            Some(name) if is_name(name) && !weights.is_file() => self.named(name),
            _ => Ok(WeightSource::File(weights.into())),
        }
    }

    /// What runs where nothing is asked for; with a remark for people where that is the small network for want
    /// of the large one.
    ///
    /// # Errors
    /// [`Error::NoWeights`] where there is neither, and as [`find`](Self::find).
    pub fn usual(&self) -> Result<(WeightSource, Option<String>)> {
        if let Some(usual) = &self.usual {
            return Ok((self.find(usual)?, None));
        }
        let [large, small] = PUBLISHED.map(|network| network.name);
        let missing = match self.named(large) {
            Ok(found) => return Ok((found, None)),
            Err(missing) => missing,
        };
        let Ok(found) = self.named(small) else { return Err(missing) };
        let remark = format!(
            "no weights of the {large} network were found: {} runs; `smr-gpu weights add FILE` adds the \
             {large} one",
            found.name().display()
        );
        Ok((found, Some(remark)))
    }

    /// The weights of that name, whatever files are called so.
    ///
    /// # Errors
    /// [`Error::NoWeights`].
    pub fn named(&self, name: &str) -> Result<WeightSource> {
        let file = file_name(name);
        let searched: Vec<_> = self.folders.iter().map(|folder| folder.join(&file)).collect();
        let file = searched.iter().find(|path| path.is_file()).cloned().map(WeightSource::File);
        file.or_else(|| embedded(name)).ok_or(Error::NoWeights { name: name.into(), searched })
    }

    /// Each name that [`named`](Self::named) finds something for, with that.
    pub fn all(&self) -> BTreeMap<String, WeightSource> {
        let entries =
            self.folders.iter().flat_map(|folder| folder.read_dir().into_iter().flatten());
        let paths = entries.flatten().map(|entry| entry.path());
        let names = paths.filter_map(|path| name_of(path.file_name()?.to_str()?));
        let names = names.chain(PUBLISHED.map(|network| network.name.to_owned()));
        names.filter_map(|name| self.named(&name).ok().map(|found| (name, found))).collect()
    }
}

/// What is in the program under this name.
fn embedded(name: &str) -> Option<WeightSource> {
    #[cfg(feature = "embedded-weights")]
    if name == "small" {
        let bytes = include_bytes!("../../weights/smrnet-s.safetensors");
        return Some(WeightSource::Static("small (in the program)", bytes));
    }
    let _ = name;
    None
}

/// Where the user's weights are kept; `None` where the system names no such place.
pub fn data_folder() -> Option<PathBuf> {
    let user = etcetera::base_strategy::choose_native_strategy().ok()?;
    // What Windows calls data travels with the user from machine to machine.
    let folder = if cfg!(windows) { user.cache_dir() } else { user.data_dir() };
    Some(folder.join("smr-gpu").join("weights"))
}

/// Whether weights may have this name: a plain word.
pub fn is_name(name: &str) -> bool {
    !name.is_empty()
        && !name.starts_with('-')
        && name.chars().all(|c| c.is_alphanumeric() || matches!(c, '-' | '_'))
}

/// The name of the file of the weights of this name.
pub fn file_name(name: &str) -> String {
    match PUBLISHED.iter().find(|network| network.name == name) {
        Some(network) => network.file.into(),
        None => format!("{name}.safetensors"),
    }
}

/// The name that finds a file of this name; `None` if none does.
pub fn name_of(file: &str) -> Option<String> {
    if let Some(network) = PUBLISHED.iter().find(|network| network.file == file) {
        return Some(network.name.into());
    }
    let name = file.strip_suffix(".safetensors").filter(|name| is_name(name))?;
    (file_name(name) == file).then(|| name.into())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn file(found: Result<WeightSource>) -> PathBuf {
        found.expect("weights").file().expect("a file").into()
    }

    /// Folders are looked into in their order, and what they hold is read by nobody.
    #[test]
    fn the_nearest_counts() {
        let root = tempfile::tempdir().expect("a folder");
        let at = |path: &str| root.path().join(path);
        let put = |path: &str| fs::write(at(path), "no weights").expect("written");
        for folder in ["set", "data", "here"] {
            fs::create_dir(at(folder)).expect("created");
        }
        let catalog = Catalog::new(Some(at("set")), ["data", "here"].map(at));
        for name in ["large", "mine"] {
            let error = catalog.find(Path::new(name)).expect_err("none");
            let Error::NoWeights { name: missing, searched } = &error else { panic!("{error}") };
            assert_eq!(missing, name);
            assert_eq!(*searched, ["set", "data", "here"].map(|f| at(f).join(file_name(name))));
            let message = error.to_string();
            assert!(searched.iter().all(|path| message.contains(path.to_str().expect("UTF-8"))));
            assert!(message.contains("`smr-gpu weights add FILE"), "{message}");
        }
        // A folder of a weight file's name is none.
        fs::create_dir(at("set/mine.safetensors")).expect("created");
        for folder in ["here", "data"] {
            put(&format!("{folder}/smrnet.safetensors"));
            put(&format!("{folder}/smrnet-s.safetensors"));
            put(&format!("{folder}/mine.safetensors"));
            for (name, path) in [
                ("large", "smrnet.safetensors"),
                ("small", "smrnet-s.safetensors"),
                ("mine", "mine.safetensors"),
            ] {
                assert_eq!(file(catalog.find(Path::new(name))), at(folder).join(path));
            }
            assert_eq!(
                file(catalog.usual().map(|(found, _)| found)),
                at(folder).join(PUBLISHED[0].file)
            );
        }
        put("set/smrnet.safetensors");
        assert_eq!(file(catalog.find(Path::new("large"))), at("set/smrnet.safetensors"));
        // What is a path is one, there or not.
        for path in
            [at("set/smrnet.safetensors"), at("gone"), "mine.safetensors".into(), "a b".into()]
        {
            assert_eq!(file(catalog.find(&path)), path);
        }
        // What no name finds is not in the list.
        put("here/large.safetensors");
        put("here/a b.safetensors");
        put("here/notes.txt");
        let all = catalog.all();
        assert_eq!(all.keys().collect::<Vec<_>>(), ["large", "mine", "small"]);
        assert_eq!(all["large"].file(), Some(&*at("set/smrnet.safetensors")));
        assert_eq!(all["mine"].file(), Some(&*at("data/mine.safetensors")));
    }

    /// A variable that is no folder is what counts where nothing is asked for, be it there or not.
    #[test]
    fn the_variable_names_the_usual_weights() {
        let root = tempfile::tempdir().expect("a folder");
        let gone = root.path().join("gone.safetensors");
        let catalog = Catalog::new(Some(gone.clone()), [root.path().into()]);
        let (found, remark) = catalog.usual().expect("a path");
        assert_eq!((found.file(), remark), (Some(&*gone), None));
        let named = Catalog::new(Some("mine".into()), [root.path().into()]);
        assert!(matches!(named.usual(), Err(Error::NoWeights { name, .. }) if name == "mine"));
        fs::write(root.path().join("mine.safetensors"), "").expect("written");
        assert_eq!(
            file(named.usual().map(|(found, _)| found)),
            root.path().join("mine.safetensors")
        );
    }

    /// Without any file the small network of the program runs, if it is there, and people are told.
    #[test]
    fn nothing_at_all_leaves_what_is_in_the_program() {
        let catalog = Catalog::new(None, ["gone".into()]);
        assert!(matches!(catalog.find(Path::new("large")), Err(Error::NoWeights { .. })));
        if !cfg!(feature = "embedded-weights") {
            assert!(
                matches!(catalog.usual(), Err(Error::NoWeights { name, .. }) if name == "large")
            );
            assert!(catalog.all().is_empty());
            return;
        }
        let (found, remark) = catalog.usual().expect("the small network");
        assert!(matches!(found, WeightSource::Static(..)), "{found:?}");
        let remark = remark.expect("a remark");
        assert!(remark.contains("small (in the program) runs") && remark.contains("weights add"));
        assert_eq!(catalog.all().keys().collect::<Vec<_>>(), ["small"]);
    }

    #[test]
    fn names_are_plain_words() {
        for name in ["a", "small", "my-gel_2", "größer"] {
            assert!(is_name(name) && name_of(&file_name(name)).as_deref() == Some(name), "{name}");
        }
        for name in ["", "-a", ".", "..", "a.b", "a/b", "a\\b", "a b", "a\0", "C:a", "~"] {
            assert!(!is_name(name), "{name}");
        }
        assert_eq!(name_of("smrnet.safetensors").as_deref(), Some("large"));
        for file in ["large.safetensors", ".safetensors", "a.b.safetensors", "a.txt", "a"] {
            assert_eq!(name_of(file), None);
        }
    }
}
