//! Download of one file to a part file. An interrupted fetch leaves the part file, and the next fetch continues it.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use sha2::{Digest, Sha256};
use ureq::http::{HeaderMap, Response, StatusCode, header};
use ureq::{Agent, Body};

use crate::catalogue::Dataset;
use crate::error::Fault;

/// Timeout for a connection, an answer, and each read.
const TIMEOUT: Duration = Duration::from_mins(1);
const BUFFER: usize = 256 << 10;

/// The download of a file.
pub(crate) struct Download<'a> {
    url: &'a str,
    /// File with the bytes downloaded so far.
    pub(crate) part: PathBuf,
    /// File with the URL of these bytes and the server's validator (`ETag` or `Last-Modified`) of the version they belong to.
    origin: PathBuf,
}

impl<'a> Download<'a> {
    pub(crate) fn new(dataset: &'a Dataset, destination: &Path) -> Self {
        let beside = |extension: &str| destination.join(format!("{}.{extension}", dataset.name));
        Self {
            url: &dataset.url,
            part: beside("part"),
            origin: beside("part.origin"),
        }
    }

    /// Downloads the file. Returns the number of bytes that were on disk before, and the locked part file: other fetches do not
    /// write to it as long as it is open.
    pub(crate) fn run(&self, progress: &mut dyn FnMut(u64, Option<u64>)) -> Result<(u64, File), Fault> {
        let cannot_write = |error| Fault::io("write", &self.part, error);
        let mut file = OpenOptions::new()
            .create(true)
            .write(true)
            .truncate(false)
            .open(&self.part)
            .map_err(cannot_write)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(Fault::Busy {
                    part: self.part.clone(),
                });
            }
            Err(TryLockError::Error(error)) => return Err(Fault::io("lock", &self.part, error)),
        }
        let same_address = self.read_origin().is_some_and(|(url, _)| url == self.url);
        let present = if same_address {
            file.metadata().map_err(cannot_write)?.len()
        } else {
            0
        };
        let start = match self.request(present)? {
            Answer::Complete => {
                progress(present, Some(present));
                present
            }
            Answer::From(start, response) => {
                let length = header_text(response.headers(), header::CONTENT_LENGTH.as_str())
                    .and_then(|text| text.parse::<u64>().ok());
                let total = match (total_of_range(&response, start)?, length) {
                    (Some(total), _) => Some(total),
                    (None, length) => length.and_then(|length| start.checked_add(length)),
                };
                file.set_len(start).map_err(cannot_write)?;
                file.seek(SeekFrom::Start(start)).map_err(cannot_write)?;
                if start == 0 {
                    self.remember_origin(response.headers())?;
                }
                self.copy(response, &mut file, start, total, progress)?;
                start
            }
        };
        Ok((start, file))
    }

    fn read_origin(&self) -> Option<(String, Option<String>)> {
        let text = fs::read_to_string(&self.origin).ok()?;
        let mut lines = text.lines();
        Some((lines.next()?.to_owned(), lines.next().map(ToOwned::to_owned)))
    }

    fn remember_origin(&self, headers: &HeaderMap) -> Result<(), Fault> {
        // A weak ETag does not guarantee equal bytes, so it must not be used for `If-Range`.
        let validator = header_text(headers, header::ETAG.as_str())
            .filter(|etag| !etag.starts_with("W/"))
            .or_else(|| header_text(headers, header::LAST_MODIFIED.as_str()));
        let text = format!(
            "{}\n{}",
            self.url,
            validator.map_or(String::new(), |validator| format!("{validator}\n"))
        );
        fs::write(&self.origin, text).map_err(|error| Fault::io("write", &self.origin, error))
    }

    /// Requests the file from byte `present` on.
    fn request(&self, present: u64) -> Result<Answer, Fault> {
        let agent = agent(self.url);
        let mut request = agent.get(self.url);
        if present > 0 {
            request = request.header(header::RANGE, format!("bytes={present}-"));
            // The server sends the whole file if its version differs from that of the part file.
            if let Some((_, Some(validator))) = self.read_origin() {
                request = request.header(header::IF_RANGE, validator);
            }
        }
        let response = request.call().map_err(|error| no_answer(&error))?;
        match response.status() {
            StatusCode::OK => Ok(Answer::From(0, response)),
            StatusCode::PARTIAL_CONTENT if present > 0 => Ok(Answer::From(present, response)),
            // There are no bytes after the present ones. The part file is complete if it has the size of the server's file.
            StatusCode::RANGE_NOT_SATISFIABLE if present > 0 => {
                let range = header_text(response.headers(), header::CONTENT_RANGE.as_str());
                let total = range.and_then(|range| range.strip_prefix("bytes */")?.parse().ok());
                if total == Some(present) {
                    Ok(Answer::Complete)
                } else {
                    self.request(0)
                }
            }
            status => Err(Fault::Status {
                status: status.as_u16(),
            }),
        }
    }

    fn copy(
        &self,
        response: Response<Body>,
        file: &mut File,
        start: u64,
        total: Option<u64>,
        progress: &mut dyn FnMut(u64, Option<u64>),
    ) -> Result<(), Fault> {
        let cannot_write = |error| Fault::io("write", &self.part, error);
        let mut reader = response.into_body().into_reader();
        let mut writer = BufWriter::with_capacity(BUFFER, file);
        let mut buffer = vec![0; BUFFER];
        let mut received = start;
        progress(received, total);
        let error = loop {
            match reader.read(&mut buffer) {
                Ok(0) => break None,
                Ok(count) => {
                    writer.write_all(&buffer[..count]).map_err(cannot_write)?;
                    received += count as u64;
                    progress(received, total);
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => break Some(error.to_string()),
            }
        };
        // Also after an error, so that the next fetch can continue from the received bytes.
        writer.flush().map_err(cannot_write)?;
        match error {
            Some(why) => Err(Fault::Interrupted { received, total, why }),
            None if total.is_some_and(|total| received < total) => Err(Fault::Interrupted {
                received,
                total,
                why: "the server closed the connection".to_owned(),
            }),
            None => Ok(()),
        }
    }

    /// Compares the finished file with the catalogue; returns its size and SHA-256.
    pub(crate) fn check(&self, dataset: &Dataset) -> Result<(u64, String), Fault> {
        let cannot_read = |error| Fault::io("read", &self.part, error);
        let found = fs::metadata(&self.part).map_err(cannot_read)?.len();
        if let Some(expected) = dataset.bytes.filter(|&expected| expected != found) {
            return Err(Fault::WrongSize { found, expected });
        }
        let mut file = File::open(&self.part).map_err(cannot_read)?;
        let mut hasher = Sha256::new();
        let mut buffer = vec![0; BUFFER];
        loop {
            match file.read(&mut buffer).map_err(cannot_read)? {
                0 => break,
                count => hasher.update(&buffer[..count]),
            }
        }
        let sha256 = hasher.finalize().iter().fold(String::new(), |mut text, byte| {
            for digit in [byte >> 4, byte & 15] {
                text.extend(char::from_digit(digit.into(), 16));
            }
            text
        });
        match &dataset.sha256 {
            Some(expected) if !expected.eq_ignore_ascii_case(&sha256) => Err(Fault::WrongHash {
                found: sha256,
                expected: expected.clone(),
            }),
            _ => Ok((found, sha256)),
        }
    }

    /// Removes the part file and its origin file if no bytes were received.
    pub(crate) fn discard_if_empty(&self) -> Result<(), Fault> {
        if fs::metadata(&self.part).is_ok_and(|metadata| metadata.len() == 0) {
            self.discard()
        } else {
            Ok(())
        }
    }

    /// Removes the part file and its origin file.
    pub(crate) fn discard(&self) -> Result<(), Fault> {
        for path in [&self.part, &self.origin] {
            match fs::remove_file(path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(Fault::io("remove", path, error)),
                _ => {}
            }
        }
        Ok(())
    }
}

/// Converts the error of a request without an answer.
fn no_answer(error: &ureq::Error) -> Fault {
    let why = error.to_string();
    match error {
        ureq::Error::BadUri(_) | ureq::Error::Http(_) => Fault::InvalidUrl { why },
        ureq::Error::Protocol(_) | ureq::Error::TooManyRedirects | ureq::Error::LargeResponseHeader(..) => {
            Fault::BadAnswer { why }
        }
        _ => Fault::Unreachable { why },
    }
}

/// The answer of a server.
enum Answer {
    /// The bytes of the file from this position on.
    From(u64, Response<Body>),
    /// No bytes: the part file is already complete.
    Complete,
}

/// Checks that a partial answer starts at `start`. Returns the size of the whole file if the answer contains it.
fn total_of_range(response: &Response<Body>, start: u64) -> Result<Option<u64>, Fault> {
    if start == 0 {
        return Ok(None);
    }
    let range = header_text(response.headers(), header::CONTENT_RANGE.as_str());
    let mismatch = || Fault::BadAnswer {
        why: format!(
            "requested bytes from {start} on, received {}",
            range.as_deref().unwrap_or("no Content-Range header")
        ),
    };
    let (span, total) = range
        .as_deref()
        .and_then(|range| range.strip_prefix("bytes "))
        .and_then(|range| range.split_once('/'))
        .ok_or_else(mismatch)?;
    if span.split_once('-').and_then(|(first, _)| first.parse().ok()) != Some(start) {
        return Err(mismatch());
    }
    Ok(total.parse().ok())
}

fn header_text(headers: &HeaderMap, name: &str) -> Option<String> {
    headers.get(name)?.to_str().ok().map(ToOwned::to_owned)
}

fn agent(url: &str) -> Agent {
    let mut config = Agent::config_builder()
        // `Download::request` handles the statuses.
        .http_status_as_error(false)
        .user_agent(concat!("re4-pipe/", env!("CARGO_PKG_VERSION")))
        .timeout_connect(Some(TIMEOUT))
        .timeout_recv_response(Some(TIMEOUT))
        .timeout_per_read(Some(TIMEOUT));
    // A proxy that is configured in the environment cannot reach servers on the loopback interface.
    if ["http://127.0.0.1", "http://localhost", "http://[::1]"]
        .iter()
        .any(|local| url.starts_with(local))
    {
        config = config.proxy(None);
    }
    config.build().into()
}
