//! Object stores for artifacts: S3 and stores with its interface, Google Cloud Storage, Azure, and folders with the same rules.
//!
//! [`Objects`] is the [`Remote`] of an address. Credentials and settings come from environment variables (`AWS_...`, `GOOGLE_...`,
//! `AZURE_...`). The clients are those of the crate `object_store`, which is asynchronous; [`Objects`] has a small runtime of its own, so
//! that callers need none.

use std::fmt;
use std::future::Future;
use std::ops::Range;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures_util::TryStreamExt as _;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey, S3ConditionalPut};
use object_store::azure::{AzureConfigKey, MicrosoftAzureBuilder};
use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey};
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{
    ClientConfigKey, Error, ObjectStore, ObjectStoreExt as _, PutMode, PutOptions, PutPayload, RetryConfig,
};
use re4_artifact::{Put, Remote, RemoteError};
use re4_fault::Remedy;
use tokio::runtime::{Builder, Runtime};

/// Maximum duration of a request. A file is one request, whatever its size.
const LONGEST_REQUEST: &str = "30 minutes";

/// An address that cannot be used.
#[derive(Debug, thiserror::Error, Remedy)]
pub enum AddressError {
    /// The address is not one of an object store.
    #[error("cannot keep artifacts in {address}: it is not the address of an object store")]
    #[remedy("use s3://BUCKET/FOLDER, gs://BUCKET/FOLDER, az://CONTAINER/FOLDER or file:///FOLDER")]
    Unknown {
        /// The address.
        address: String,
    },
    /// The settings in the environment are incomplete or contradict each other.
    #[error("cannot keep artifacts in {address}: {reason}")]
    #[remedy("check the address and the environment variables for it, such as {example}")]
    Settings {
        /// The address.
        address: String,
        /// The reason.
        reason: String,
        /// An environment variable.
        example: &'static str,
    },
}

/// The objects below an address.
pub struct Objects {
    address: String,
    folder: String,
    store: Arc<dyn ObjectStore>,
    runtime: Runtime,
}

impl fmt::Debug for Objects {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Objects")
            .field("address", &self.address)
            .finish_non_exhaustive()
    }
}

impl Objects {
    /// The objects below `address`: `s3://BUCKET/FOLDER`, `gs://BUCKET/FOLDER`, `az://CONTAINER/FOLDER` or `file:///FOLDER`. No request
    /// is made. The folder of a `file` address is created if necessary.
    ///
    /// # Errors
    /// If the address is not one of an object store, or the settings in the environment cannot be used.
    pub fn open(address: &str) -> Result<Self, AddressError> {
        Self::open_with(address, &[])
    }

    /// As [`Objects::open`], with settings in place of environment variables of the same names, such as `AWS_ENDPOINT`.
    ///
    /// # Errors
    /// As [`Objects::open`].
    pub fn open_with(address: &str, settings: &[(&str, &str)]) -> Result<Self, AddressError> {
        let address = address.trim_end_matches('/');
        let unknown = || AddressError::Unknown {
            address: address.to_owned(),
        };
        let (scheme, place) = address.split_once("://").ok_or_else(unknown)?;
        let (container, folder) = place.split_once('/').unwrap_or((place, ""));
        let example = match scheme {
            "s3" => "AWS_ACCESS_KEY_ID",
            "gs" => "GOOGLE_SERVICE_ACCOUNT",
            "az" => "AZURE_STORAGE_ACCOUNT_NAME",
            _ => "HOME",
        };
        let refuse = |reason: String| AddressError::Settings {
            address: address.to_owned(),
            reason,
            example,
        };
        let opened: Result<Arc<dyn ObjectStore>, Error> = match scheme {
            "file" if container.is_empty() && !folder.is_empty() => {
                let root = std::path::Path::new("/").join(folder);
                std::fs::create_dir_all(&root).map_err(|error| refuse(error.to_string()))?;
                LocalFileSystem::new_with_prefix(root).map(|store| Arc::new(store) as _)
            }
            _ if container.is_empty() => return Err(unknown()),
            "s3" => s3(address, settings).map(|store| Arc::new(store) as _),
            "gs" => gs(address, settings).map(|store| Arc::new(store) as _),
            "az" => az(address, settings).map(|store| Arc::new(store) as _),
            _ => return Err(unknown()),
        };
        let folder = if scheme == "file" { "" } else { folder };
        let checked = Path::parse(folder).map_err(|error| refuse(one_line(&error.to_string())))?;
        let runtime = Builder::new_multi_thread()
            .worker_threads(2)
            .thread_name("objects")
            .enable_all()
            .build()
            .map_err(|error| refuse(error.to_string()))?;
        Ok(Self {
            address: address.to_owned(),
            folder: checked.to_string(),
            store: opened.map_err(|error| refuse(one_line(&error.to_string())))?,
            runtime,
        })
    }

    fn path(&self, name: &str) -> Result<Path, RemoteError> {
        let whole = [self.folder.as_str(), name].join("/");
        Path::parse(whole.trim_matches('/')).map_err(|error| refused(&error.into()))
    }

    /// Waits for an answer; `None` if there is no such object.
    fn wait<T>(&self, answer: impl Future<Output = Result<T, Error>>) -> Result<Option<T>, RemoteError> {
        match self.runtime.block_on(answer) {
            Ok(answer) => Ok(Some(answer)),
            Err(Error::NotFound { source, .. }) if !is_about_the_bucket(&source.to_string()) => Ok(None),
            Err(error) => Err(refused(&error)),
        }
    }
}

fn retries() -> RetryConfig {
    RetryConfig {
        max_retries: 6,
        retry_timeout: Duration::from_mins(2),
        ..RetryConfig::default()
    }
}

/// The settings whose names the client of an object store knows.
fn known<'a, K: FromStr>(settings: &'a [(&str, &str)]) -> impl Iterator<Item = (K, String)> + 'a {
    settings
        .iter()
        .filter_map(|(name, value)| Some((name.to_ascii_lowercase().parse().ok()?, (*value).to_owned())))
}

fn s3(address: &str, settings: &[(&str, &str)]) -> Result<impl ObjectStore, Error> {
    let builder = AmazonS3Builder::from_env()
        .with_url(address)
        .with_config(AmazonS3ConfigKey::Client(ClientConfigKey::Timeout), LONGEST_REQUEST)
        .with_conditional_put(S3ConditionalPut::ETagMatch)
        .with_retry(retries());
    known(settings)
        .fold(builder, |builder, (key, value)| builder.with_config(key, value))
        .build()
}

fn gs(address: &str, settings: &[(&str, &str)]) -> Result<impl ObjectStore, Error> {
    let builder = GoogleCloudStorageBuilder::from_env()
        .with_url(address)
        .with_config(GoogleConfigKey::Client(ClientConfigKey::Timeout), LONGEST_REQUEST)
        .with_retry(retries());
    known(settings)
        .fold(builder, |builder, (key, value)| builder.with_config(key, value))
        .build()
}

fn az(address: &str, settings: &[(&str, &str)]) -> Result<impl ObjectStore, Error> {
    let builder = MicrosoftAzureBuilder::from_env()
        .with_url(address)
        .with_config(AzureConfigKey::Client(ClientConfigKey::Timeout), LONGEST_REQUEST)
        .with_retry(retries());
    known(settings)
        .fold(builder, |builder, (key, value)| builder.with_config(key, value))
        .build()
}

/// Whether the answer "not found" is about the bucket or container and not about the object.
fn is_about_the_bucket(answer: &str) -> bool {
    [
        "NoSuchBucket",
        "ContainerNotFound",
        "The specified bucket does not exist",
    ]
    .iter()
    .any(|code| answer.contains(code))
}

/// Bytes that several attempts to send them share.
struct Shared(Arc<Vec<u8>>);

impl AsRef<[u8]> for Shared {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl Remote for Objects {
    fn address(&self) -> &str {
        &self.address
    }

    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, RemoteError> {
        let path = self.path(name)?;
        let read = async { self.store.get(&path).await?.bytes().await };
        Ok(self.wait(read)?.map(Vec::from))
    }

    fn get_range(&self, name: &str, range: Range<u64>) -> Result<Option<Vec<u8>>, RemoteError> {
        let path = self.path(name)?;
        if range.is_empty() {
            return Ok(self.wait(self.store.head(&path))?.map(|_| Vec::new()));
        }
        match self.wait(self.store.get_range(&path, range.clone())) {
            Ok(found) => Ok(found.map(Vec::from)),
            // A range after the end of an object is an error for object stores.
            Err(error) => match self.wait(self.store.head(&path)) {
                Ok(Some(object)) if object.size <= range.start => Ok(Some(Vec::new())),
                _ => Err(error),
            },
        }
    }

    fn put_new(&self, name: &str, content: Arc<Vec<u8>>) -> Result<Put, RemoteError> {
        let path = self.path(name)?;
        let payload = PutPayload::from_bytes(Bytes::from_owner(Shared(content)));
        let options = PutOptions::from(PutMode::Create);
        match self.runtime.block_on(self.store.put_opts(&path, payload, options)) {
            Ok(_) => Ok(Put::Created),
            Err(Error::AlreadyExists { .. } | Error::Precondition { .. }) => Ok(Put::Taken),
            Err(error) => Err(refused(&error)),
        }
    }

    fn list(&self, folder: &str) -> Result<Vec<(String, u64)>, RemoteError> {
        let path = self.path(folder)?;
        let objects = self.store.list(Some(&path)).try_collect::<Vec<_>>();
        let objects = self.wait(objects)?.unwrap_or_default();
        let inside = |path: &Path| path.as_ref().strip_prefix(self.folder.as_str()).map(str::to_owned);
        let mut names: Vec<(String, u64)> = objects
            .iter()
            .filter_map(|object| {
                Some((
                    inside(&object.location)?.trim_start_matches('/').to_owned(),
                    object.size,
                ))
            })
            .collect();
        names.sort();
        Ok(names)
    }
}

/// Converts an error of the client to one line and a remedy.
fn refused(error: &Error) -> RemoteError {
    let text = one_line(&error.to_string());
    let remedy = match error {
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => {
            "check the credentials in the environment and what they permit"
        }
        Error::NotFound { .. } => "create the bucket, or check the address",
        Error::NotImplemented { .. } | Error::NotSupported { .. } => {
            "use an object store that creates objects only if they do not exist (If-None-Match)"
        }
        _ => "check the network, the address and the credentials in the environment, and run again",
    };
    RemoteError {
        reason: text,
        remedy: Some(remedy),
    }
}

/// The first 300 characters of a text in one line. The errors of object stores contain documents of several lines.
fn one_line(text: &str) -> String {
    let words: Vec<&str> = text.split_whitespace().collect();
    words.join(" ").chars().take(300).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(address: &str) -> String {
        Objects::open(address).unwrap_err().sentence()
    }

    #[test]
    fn other_addresses_are_refused() {
        for address in [
            "ftp://a/b",
            "s3://",
            "s3:///a",
            "file://a/b",
            "artifacts",
            "https://a/b",
        ] {
            assert!(
                refusal(address).contains("it is not the address of an object store; use s3://"),
                "{address}"
            );
        }
        assert!(refusal("s3://bucket/a//b").contains("cannot keep artifacts in s3://bucket/a//b: "));
        assert!(refusal("s3://bucket/../b").contains("AWS_ACCESS_KEY_ID"));
    }

    #[test]
    fn a_folder_follows_the_rules_of_an_object_store() {
        let folder = tempfile::tempdir().unwrap();
        let address = format!("file://{}/objects/", folder.path().display());
        let objects = Objects::open(&address).unwrap();
        assert_eq!(objects.address(), address.trim_end_matches('/'));
        assert_eq!(objects.get("a/b").unwrap(), None);
        assert_eq!(objects.get_range("a/b", 0..1).unwrap(), None);
        let content = Arc::new(b"content".to_vec());
        assert_eq!(objects.put_new("a/b", Arc::clone(&content)).unwrap(), Put::Created);
        assert_eq!(objects.put_new("a/b", Arc::new(Vec::new())).unwrap(), Put::Taken);
        assert_eq!(objects.put_new("c", Arc::clone(&content)).unwrap(), Put::Created);
        assert_eq!(objects.get("a/b").unwrap().unwrap(), *content);
        for (range, expected) in [(0..3, "con"), (3..100, "tent"), (7..9, ""), (8..9, ""), (2..2, "")] {
            let found = objects.get_range("a/b", range.clone()).unwrap().unwrap();
            assert_eq!(found, expected.as_bytes(), "{range:?}");
        }
        let all = vec![("a/b".to_owned(), 7), ("c".to_owned(), 7)];
        assert_eq!(objects.list("").unwrap(), all);
        assert_eq!(objects.list("a").unwrap(), all[..1]);
        assert!(objects.list("nothing").unwrap().is_empty());
    }
}
