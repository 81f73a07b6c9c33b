//! Files that the user asks for: pages, videos, images. They are there whole or not at all.

use std::io::{self, Write as _};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use anyhow::Result;
use re4_artifact::Artifact;
use re4_fault::{Fault, bail, fault};
use tempfile::NamedTempFile;

/// A place for a file that can be written to.
pub(crate) struct Output {
    /// As the user named it.
    named: PathBuf,
    /// Where it is, behind links.
    place: PathBuf,
    what: &'static str,
}

impl Output {
    /// Refuses a path that cannot take a file: without a folder, of a folder or a device, inside of an artifact, or in a
    /// folder that may not be written. `what` names the file in errors, as in "report".
    pub(crate) fn at(path: &Path, what: &'static str) -> Result<Self> {
        let refuse = |why: Fault| anyhow::Error::from(why.at(format!("cannot write the {what} {}: ", path.display())));
        let place = match std::fs::metadata(path) {
            Ok(there) if there.is_dir() => return Err(refuse(fault!("it is a folder"; "give the path of a file"))),
            Ok(there) if !there.is_file() => {
                return Err(refuse(
                    fault!("there is something that is no file at that path"; "give the path of a file"),
                ));
            }
            // A link stays one, and the file behind it is replaced.
            Ok(_) => std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned()),
            Err(_) => path.to_owned(),
        };
        let folder = folder_of(&place);
        if !folder.is_dir() {
            return Err(refuse(
                fault!("there is no folder {}", folder.display(); "make it, or give another path"),
            ));
        }
        let inside = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
        if let Some(artifact) = inside.ancestors().find(|ancestor| Artifact::open(ancestor).is_ok()) {
            return Err(refuse(fault!(
                "that path lies inside of the artifact {}, which would be damaged", artifact.display();
                "give another path"
            )));
        }
        let output = Self {
            named: path.to_owned(),
            place,
            what,
        };
        // Now rather than after the work that the file is made of.
        output.temporary()?;
        Ok(output)
    }

    /// Refuses to replace what the command itself reads.
    pub(crate) fn spares(&self, inputs: &[PathBuf]) -> Result<()> {
        let whole = |path: &Path| std::fs::canonicalize(path).ok();
        let place = whole(&self.place);
        if place.is_some() && inputs.iter().any(|input| whole(input) == place) {
            bail!(
                "cannot write the {} {}: this command reads that file", self.what, self.named.display();
                "give another path"
            );
        }
        Ok(())
    }

    /// The path as the user named it.
    pub(crate) fn named(&self) -> &Path {
        &self.named
    }

    /// A file beside the place, which [`Output::keep`] moves there.
    pub(crate) fn temporary(&self) -> Result<NamedTempFile> {
        tempfile::Builder::new()
            .prefix(".tmp-output-")
            // As any file that a user makes: readable as the umask says, not for the user alone.
            .permissions(std::fs::Permissions::from_mode(0o666))
            .tempfile_in(folder_of(&self.place))
            .map_err(|error| self.refused(&error))
    }

    /// Puts a file at its place.
    pub(crate) fn keep(&self, file: NamedTempFile) -> Result<()> {
        file.as_file().sync_all().map_err(|error| self.refused(&error))?;
        file.persist(&self.place).map_err(|error| self.refused(&error.error))?;
        Ok(())
    }

    /// Writes a text.
    pub(crate) fn write(&self, text: &str) -> Result<()> {
        let mut file = self.temporary()?;
        file.write_all(text.as_bytes()).map_err(|error| self.refused(&error))?;
        self.keep(file)
    }

    fn refused(&self, error: &io::Error) -> anyhow::Error {
        // Without the name of the temporary file, which says nothing to the user.
        let reason = error.raw_os_error().map_or_else(
            || error.to_string(),
            |code| io::Error::from_raw_os_error(code).to_string(),
        );
        fault!(
            "cannot write the {} {}: {reason}", self.what, self.named.display();
            "give the path of a file in a folder that may be written"
        )
        .into()
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}
