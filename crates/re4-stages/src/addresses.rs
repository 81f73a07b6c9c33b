//! Addresses of object stores in place of folders of artifacts.
//!
//! The artifacts of an object store are kept in a folder on this machine, its cache, which is an ordinary store. All stages and commands
//! work with that folder; `re4_artifact` downloads what it lacks and uploads what is published in it.

use std::env;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use anyhow::Result;
use re4_artifact::{MANIFEST_NAME, Stage, attached, fetch_all, fetch_folder};
use re4_fault::{OrFault as _, ensure, fault};

/// Environment variable that names the folder of the caches.
const CACHE: &str = "RE4_CACHE";

/// Whether a path is an address of an object store, such as `s3://bucket/folder`.
pub fn is_address(path: &Path) -> bool {
    path.to_str().is_some_and(|text| text.contains("://"))
}

/// The folder in which the artifacts at an address are kept on this machine. Stores that are opened there use the object store. A path
/// that is not an address is returned as it is.
///
/// # Errors
/// If this build has no object stores, or the address or the settings in the environment cannot be used.
pub fn local_store(artifacts: &Path) -> Result<PathBuf> {
    if !is_address(artifacts) {
        return Ok(artifacts.to_path_buf());
    }
    let address = artifacts.to_string_lossy();
    let address = address.trim_end_matches('/');
    let cache = cache_of(address)?;
    if attached(&cache).is_none() {
        connect(address, &cache)?;
    }
    Ok(cache)
}

/// The folder of the artifact at an address, after downloading what this machine lacks of it. A path that is not an address is returned as
/// it is.
///
/// # Errors
/// As [`local_store`], and if there is no such artifact, or it is damaged.
pub fn local_artifact(path: &Path) -> Result<PathBuf> {
    if !is_address(path) {
        return Ok(path.to_path_buf());
    }
    let named = || {
        let (kind, key) = (path.parent()?.file_name()?, path.file_name()?);
        let is_kind = Stage::ALL.iter().any(|stage| OsStr::new(stage.artifact()) == kind);
        is_kind.then_some((path.ancestors().nth(2)?, Path::new(kind).join(key)))
    };
    let (root, inside) = named().or_fault(|| {
        fault!(
            "{} is not the address of an artifact", path.display();
            "give the address of one artifact, such as s3://BUCKET/FOLDER/rollouts/0123456789abcdef"
        )
    })?;
    let store = local_store(root)?;
    let folder = store.join(inside);
    ensure!(
        fetch_folder(&store, &folder)?,
        "cannot read artifact {}: there is no object {MANIFEST_NAME} below it", path.display();
        "check the address, or run the stage that produces the artifact"
    );
    Ok(folder)
}

/// Downloads all artifacts at an address; nothing if the path is not an address. Returns the folder of the artifacts.
///
/// # Errors
/// As [`local_artifact`].
pub fn local_artifacts(artifacts: &Path) -> Result<PathBuf> {
    let store = local_store(artifacts)?;
    if is_address(artifacts) {
        fetch_all(&store)?;
    }
    Ok(store)
}

/// A folder in this machine's copies of an object store as an address, for commands on other machines. Other paths are returned as they
/// are.
pub fn address_of(path: &Path) -> PathBuf {
    let of = |root: &Path| {
        let remote = attached(root)?;
        let inside = path.strip_prefix(root).ok()?;
        Some(Path::new(remote.address()).join(inside))
    };
    // `join` of an empty path would add a slash.
    let address = attached(path).map(|remote| PathBuf::from(remote.address()));
    address
        .or_else(|| path.ancestors().skip(1).find_map(of))
        .unwrap_or_else(|| path.to_path_buf())
}

/// The cache of an address: a folder whose name begins with the address, for users, and ends with its hash.
fn cache_of(address: &str) -> Result<PathBuf> {
    let folder = |variable: &str, inside: &str| {
        let value = env::var_os(variable).filter(|value| !value.is_empty())?;
        Some(Path::new(&value).join(inside))
    };
    let caches = folder(CACHE, "")
        .or_else(|| folder("XDG_CACHE_HOME", "re4-pipe"))
        .or_else(|| folder("HOME", ".cache/re4-pipe"))
        .or_fault(|| fault!("no folder for copies of {address}: HOME is not set"; "set {CACHE} to a folder"))?;
    let readable: String = address
        .chars()
        .map(|letter| {
            if letter.is_ascii_alphanumeric() || letter == '.' {
                letter
            } else {
                '-'
            }
        })
        .take(80)
        .collect();
    let hash = blake3::hash(address.as_bytes()).to_hex();
    let cache = caches.join(format!("{}-{}", readable.replace("---", "-"), &hash[..16]));
    std::path::absolute(&cache).or_fault(|| fault!("cannot use {}", cache.display(); "set {CACHE} to a folder"))
}

#[cfg(feature = "object-store")]
fn connect(address: &str, cache: &Path) -> Result<()> {
    let objects = re4_object::Objects::open(address)?;
    Ok(re4_artifact::attach(cache, std::sync::Arc::new(objects))?)
}

#[cfg(not(feature = "object-store"))]
fn connect(address: &str, _: &Path) -> Result<()> {
    re4_fault::bail!(
        "cannot use {address}: this re4-pipe was built without object stores";
        "build it with the cargo feature object-store (cargo build --release -p re4-pipe --features object-store), or name a folder"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_returned_as_they_are() {
        for path in ["artifacts", "/a/b", "s3:/bucket"] {
            let path = Path::new(path);
            assert_eq!(local_store(path).unwrap(), path);
            assert_eq!(local_artifact(path).unwrap(), path);
            assert_eq!(local_artifacts(path).unwrap(), path);
            assert_eq!(address_of(path), path);
        }
    }

    #[test]
    fn caches_of_addresses_differ() {
        let name = |address: &str| {
            let cache = cache_of(address).unwrap();
            assert!(cache.is_absolute());
            cache.file_name().unwrap().to_str().unwrap().to_owned()
        };
        let plain = name("s3://bucket/a/b");
        assert!(plain.starts_with("s3-bucket-a-b-"), "{plain}");
        assert_eq!(plain.len(), "s3-bucket-a-b-".len() + 16);
        assert_ne!(plain, name("s3://bucket/a-b"));
        assert!(name(&format!("s3://bucket/{}", "a/".repeat(200))).len() < 128);
    }

    #[test]
    fn other_addresses_are_not_artifacts() {
        for address in ["s3://bucket", "s3://bucket/a/0123456789abcdef", "s3://bucket/rollouts"] {
            let error = local_artifact(Path::new(address)).unwrap_err().to_string();
            assert!(error.contains("is not the address of an artifact"), "{error}");
        }
    }

    #[cfg(not(feature = "object-store"))]
    #[test]
    fn a_build_without_object_stores_names_the_feature() {
        use re4_fault::Remedy as _;
        let error = local_store(Path::new("s3://bucket/a/")).unwrap_err();
        let sentence = crate::notes::fault_of(&error).sentence();
        assert!(sentence.starts_with("cannot use s3://bucket/a: this re4-pipe was built without object stores; "));
        assert!(sentence.contains("--features object-store"), "{sentence}");
    }
}
