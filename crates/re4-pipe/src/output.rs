//! Output files that the user requests: pages, videos, images. A file is written atomically: completely or not at all.

use std::io::{self, Write as _};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use anyhow::Result;
use re4_artifact::Artifact;
use re4_fault::{Fault, bail, fault};
use tempfile::NamedTempFile;

/// The path of an output file that has been checked for writing.
pub(crate) struct Output {
    /// The path as the user gave it.
    named: PathBuf,
    /// The path with symbolic links resolved.
    place: PathBuf,
    what: &'static str,
}

impl Output {
    /// Checks that a file can be written to a path. `what` names the file in errors, for instance "report".
    ///
    /// # Errors
    /// If the path is a folder or a device, its folder does not exist or is not writable, or it is inside an artifact.
    pub(crate) fn at(path: &Path, what: &'static str) -> Result<Self> {
        let refuse = |why: Fault| anyhow::Error::from(why.at(format!("cannot write the {what} {}: ", path.display())));
        let place = match std::fs::metadata(path) {
            Ok(there) if there.is_dir() => return Err(refuse(fault!("it is a folder"; "give the path of a file"))),
            Ok(there) if !there.is_file() => {
                return Err(refuse(
                    fault!("that path exists and is not a regular file"; "give the path of a file"),
                ));
            }
            // A symbolic link is kept, and the file that it points to is replaced.
            Ok(_) => std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned()),
            Err(_) => path.to_owned(),
        };
        let folder = folder_of(&place);
        if !folder.is_dir() {
            return Err(refuse(
                fault!("there is no folder {}", folder.display(); "create it, or give another path"),
            ));
        }
        let inside = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
        if let Some(artifact) = inside.ancestors().find(|ancestor| Artifact::open(ancestor).is_ok()) {
            return Err(refuse(fault!(
                "that path is inside the artifact {}, which would be damaged", artifact.display();
                "give another path"
            )));
        }
        let output = Self {
            named: path.to_owned(),
            place,
            what,
        };
        // Tests write permission now rather than after the computation of the content.
        output.temporary()?;
        Ok(output)
    }

    /// Refuses to replace a file that the command itself reads.
    pub(crate) fn refuse_inputs(&self, inputs: &[PathBuf]) -> Result<()> {
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

    /// The path as the user gave it.
    pub(crate) fn named(&self) -> &Path {
        &self.named
    }

    /// Creates a temporary file in the folder of the output, which [`Output::keep`] moves to the output's path.
    pub(crate) fn temporary(&self) -> Result<NamedTempFile> {
        tempfile::Builder::new()
            .prefix(".tmp-output-")
            // The permissions of a normal new file, subject to the umask. The default of `tempfile` allows only the owner.
            .permissions(std::fs::Permissions::from_mode(0o666))
            .tempfile_in(folder_of(&self.place))
            .map_err(|error| self.refused(&error))
    }

    /// Moves the temporary file to the path of the output.
    pub(crate) fn keep(&self, file: NamedTempFile) -> Result<()> {
        file.as_file().sync_all().map_err(|error| self.refused(&error))?;
        file.persist(&self.place).map_err(|error| self.refused(&error.error))?;
        Ok(())
    }

    /// Writes a text as the content of the file.
    pub(crate) fn write(&self, text: &str) -> Result<()> {
        let mut file = self.temporary()?;
        file.write_all(text.as_bytes()).map_err(|error| self.refused(&error))?;
        self.keep(file)
    }

    fn refused(&self, error: &io::Error) -> anyhow::Error {
        // Without the name of the temporary file, which means nothing to the user.
        let reason = error.raw_os_error().map_or_else(
            || error.to_string(),
            |code| io::Error::from_raw_os_error(code).to_string(),
        );
        fault!(
            "cannot write the {} {}: {reason}", self.what, self.named.display();
            "give the path of a file in a writable folder"
        )
        .into()
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}
