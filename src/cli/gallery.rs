//! Folders of outputs: a file for each frame, or for each snap of it.

use std::path::{Path, PathBuf};

use image::RgbImage;
use smr_gpu::files::{self, Outputs};

use super::draw::png;
use super::exit::{Exit, Failure};

/// A folder of outputs that have their sources' names.
pub(super) struct Gallery {
    folder: PathBuf,
}

impl Gallery {
    /// Creates the folder.
    ///
    /// # Errors
    /// [`Exit::Output`].
    pub fn create(folder: &Path) -> Result<Self, Failure> {
        std::fs::create_dir_all(folder).map_err(|e| {
            let e = match folder.exists() {
                true => "expected a folder, got a file".to_owned(),
                false => format!("cannot write: {e}"),
            };
            Failure::new(Exit::Output, format!("{}: {e}", folder.display()))
        })?;
        Ok(Self { folder: folder.into() })
    }

    /// Writes a picture under this name as PNG, with a number where that name is taken.
    ///
    /// # Errors
    /// [`Exit::Output`].
    pub fn save(
        &self,
        outputs: &mut Outputs,
        stem: &str,
        picture: &RgbImage,
    ) -> Result<(), Failure> {
        let path = self.free_name(outputs, stem, "png")?;
        Ok(outputs.write(&path, &png(&path, picture)?)?)
    }

    /// Writes a text under this name, as [`save`](Self::save) does.
    ///
    /// # Errors
    /// [`Exit::Output`].
    pub fn write(&self, outputs: &mut Outputs, stem: &str, text: &str) -> Result<(), Failure> {
        let path = self.free_name(outputs, stem, "txt")?;
        Ok(outputs.write(&path, text.as_bytes())?)
    }

    /// A name for a file that may be written: an earlier run's is replaced.
    fn free_name(
        &self,
        outputs: &Outputs,
        stem: &str,
        ending: &str,
    ) -> Result<PathBuf, files::Error> {
        let mut number = 0;
        loop {
            number += 1;
            let name = match number {
                1 => format!("{stem}.{ending}"),
                n => format!("{stem}-{n}.{ending}"),
            };
            let path = self.folder.join(name);
            match outputs.check(&path) {
                Err(files::Error::Spared { .. } | files::Error::NotReplaceable { .. }) => {}
                other => return other.map(|()| path),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_spare_the_pictures() {
        let folder = tempfile::tempdir().expect("a folder");
        let original = folder.path().join("x.png");
        std::fs::write(&original, "mine").expect("written");
        let mut outputs = Outputs::sparing([&original]);
        let gallery = Gallery::create(folder.path()).expect("created");
        for _ in 0..2 {
            gallery.save(&mut outputs, "x", &RgbImage::new(1, 1)).expect("saved");
        }
        assert_eq!(std::fs::read(&original).expect("kept"), b"mine");
        assert!(folder.path().join("x-2.png").exists() && folder.path().join("x-3.png").exists());
    }
}
