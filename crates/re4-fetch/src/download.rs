//! The download of one file into a part file that an interrupted fetch leaves and the next one continues.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use sha2::{Digest, Sha256};
use ureq::http::{HeaderMap, Response, StatusCode, header};
use ureq::{Agent, Body};

use crate::catalogue::Dataset;
use crate::error::Fault;

/// Longest silence of a server before the download counts as broken.
const SILENCE: Duration = Duration::from_mins(1);
const BUFFER: usize = 256 << 10;

/// A file being downloaded.
pub(crate) struct Download<'a> {
    url: &'a str,
    /// The bytes so far.
    pub(crate) part: PathBuf,
    /// Beside them: the address and the server's mark of the version they are from.
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

    /// Downloads the file. Returns the number of bytes that were there before, and the part file: as long as it is open,
    /// no other fetch touches it.
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
        let there = if same_address {
            file.metadata().map_err(cannot_write)?.len()
        } else {
            0
        };
        let start = match self.request(there)? {
            Answer::Complete => {
                progress(there, Some(there));
                there
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
        // A weak mark does not promise equal bytes.
        let mark = header_text(headers, header::ETAG.as_str())
            .filter(|mark| !mark.starts_with("W/"))
            .or_else(|| header_text(headers, header::LAST_MODIFIED.as_str()));
        let text = format!(
            "{}\n{}",
            self.url,
            mark.map_or(String::new(), |mark| format!("{mark}\n"))
        );
        fs::write(&self.origin, text).map_err(|error| Fault::io("write", &self.origin, error))
    }

    /// Asks for the file from byte `there` on.
    fn request(&self, there: u64) -> Result<Answer, Fault> {
        let agent = agent(self.url);
        let mut request = agent.get(self.url);
        if there > 0 {
            request = request.header(header::RANGE, format!("bytes={there}-"));
            if let Some((_, Some(mark))) = self.read_origin() {
                request = request.header(header::IF_RANGE, mark);
            }
        }
        let response = request.call().map_err(|error| no_answer(&error))?;
        match response.status() {
            StatusCode::OK => Ok(Answer::From(0, response)),
            StatusCode::PARTIAL_CONTENT if there > 0 => Ok(Answer::From(there, response)),
            StatusCode::RANGE_NOT_SATISFIABLE if there > 0 => {
                let range = header_text(response.headers(), header::CONTENT_RANGE.as_str());
                let total = range.and_then(|range| range.strip_prefix("bytes */")?.parse().ok());
                if total == Some(there) {
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
        let broken = loop {
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
        // Whatever arrived is kept for the next fetch.
        writer.flush().map_err(cannot_write)?;
        match broken {
            Some(why) => Err(Fault::Interrupted { received, total, why }),
            None if total.is_some_and(|total| received < total) => Err(Fault::Interrupted {
                received,
                total,
                why: "the server closed it".to_owned(),
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

    /// Removes what a fetch leaves that got nothing.
    pub(crate) fn discard_if_empty(&self) -> Result<(), Fault> {
        if fs::metadata(&self.part).is_ok_and(|metadata| metadata.len() == 0) {
            self.discard()
        } else {
            Ok(())
        }
    }

    /// Removes the part file and what lies beside it.
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

/// Why there is no answer.
fn no_answer(error: &ureq::Error) -> Fault {
    let why = error.to_string();
    match error {
        ureq::Error::BadUri(_) | ureq::Error::Http(_) => Fault::BadAddress { why },
        ureq::Error::Protocol(_) | ureq::Error::TooManyRedirects | ureq::Error::LargeResponseHeader(..) => {
            Fault::BadAnswer { why }
        }
        _ => Fault::Unreachable { why },
    }
}

/// What a server gives.
enum Answer {
    /// The file from this byte on.
    From(u64, Response<Body>),
    /// Nothing: the part file is the whole file.
    Complete,
}

/// Checks that a partial answer continues at `start`; the size of the whole file if the answer says it.
fn total_of_range(response: &Response<Body>, start: u64) -> Result<Option<u64>, Fault> {
    if start == 0 {
        return Ok(None);
    }
    let range = header_text(response.headers(), header::CONTENT_RANGE.as_str());
    let misfit = || Fault::BadAnswer {
        why: format!(
            "asked for bytes from {start}, got the range {}",
            range.as_deref().unwrap_or("of no bytes")
        ),
    };
    let (span, total) = range
        .as_deref()
        .and_then(|range| range.strip_prefix("bytes "))
        .and_then(|range| range.split_once('/'))
        .ok_or_else(misfit)?;
    if span.split_once('-').and_then(|(first, _)| first.parse().ok()) != Some(start) {
        return Err(misfit());
    }
    Ok(total.parse().ok())
}

fn header_text(headers: &HeaderMap, name: &str) -> Option<String> {
    headers.get(name)?.to_str().ok().map(ToOwned::to_owned)
}

fn agent(url: &str) -> Agent {
    let mut config = Agent::config_builder()
        .http_status_as_error(false)
        .user_agent(concat!("re4-pipe/", env!("CARGO_PKG_VERSION")))
        .timeout_connect(Some(SILENCE))
        .timeout_recv_response(Some(SILENCE))
        .timeout_per_read(Some(SILENCE));
    // A proxy of the environment cannot reach this machine's own servers.
    if ["http://127.0.0.1", "http://localhost", "http://[::1]"]
        .iter()
        .any(|local| url.starts_with(local))
    {
        config = config.proxy(None);
    }
    config.build().into()
}
