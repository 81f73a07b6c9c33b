//! Fetches from a small server on the loopback interface whose faults can be configured.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests fail by panicking"
)]

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::thread;

use re4_fault::Remedy as _;
use re4_fetch::{Dataset, FetchError, FetchReport, Form, Outcome, fetch};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

/// How the server answers.
#[derive(Debug, Clone)]
struct Behaviour {
    file: Vec<u8>,
    /// Whether `Range` is supported.
    ranges: bool,
    /// Whether the answer has a `Content-Length`.
    length: bool,
    etag: Option<&'static str>,
    /// Number of bytes of the body after which the connection is closed.
    cut_after: Option<usize>,
    /// Status of an answer without a body.
    status: Option<u16>,
    /// Whether the answer to a range starts at the start of the file.
    wrong_range: bool,
}

impl Behaviour {
    fn good(file: &[u8]) -> Self {
        let etag = Some("\"one\"");
        Self {
            file: file.to_vec(),
            ranges: true,
            length: true,
            etag,
            cut_after: None,
            status: None,
            wrong_range: false,
        }
    }
}

/// The headers `Range` and `If-Range` of a request.
type Ranges = (Option<String>, Option<String>);

struct Server {
    address: String,
    behaviour: Arc<Mutex<Behaviour>>,
    requests: Arc<Mutex<Vec<Ranges>>>,
}

impl Server {
    fn start(behaviour: Behaviour) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}/pusht.zip", listener.local_addr().unwrap());
        let behaviour = Arc::new(Mutex::new(behaviour));
        let requests = Arc::new(Mutex::new(Vec::new()));
        let (shared, record) = (Arc::clone(&behaviour), Arc::clone(&requests));
        thread::spawn(move || {
            for stream in listener.incoming() {
                let behaviour = shared.lock().unwrap().clone();
                // Some tests close the connection early, which is an error here.
                let _ = answer(stream.unwrap(), &behaviour, &record);
            }
        });
        Self {
            address,
            behaviour,
            requests,
        }
    }

    fn set(&self, change: impl FnOnce(&mut Behaviour)) {
        change(&mut self.behaviour.lock().unwrap());
    }

    fn requests(&self) -> Vec<Ranges> {
        self.requests.lock().unwrap().clone()
    }
}

fn answer(mut stream: TcpStream, behaviour: &Behaviour, requests: &Mutex<Vec<Ranges>>) -> std::io::Result<()> {
    let (mut range, mut if_range) = (None, None);
    for line in BufReader::new(stream.try_clone()?).lines() {
        let line = line?;
        let Some((name, value)) = line.split_once(':') else {
            if line.is_empty() {
                break;
            }
            continue;
        };
        match name.to_ascii_lowercase().as_str() {
            "range" => range = Some(value.trim().to_owned()),
            "if-range" => if_range = Some(value.trim().to_owned()),
            _ => {}
        }
    }
    requests.lock().unwrap().push((range.clone(), if_range.clone()));
    if let Some(status) = behaviour.status {
        return write!(
            stream,
            "HTTP/1.1 {status} No\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
        );
    }
    let size = behaviour.file.len();
    let unchanged = if_range.is_none() || if_range.as_deref() == behaviour.etag;
    let start = range.filter(|_| behaviour.ranges && unchanged).map(|range| {
        range
            .strip_prefix("bytes=")
            .unwrap()
            .strip_suffix('-')
            .unwrap()
            .parse::<usize>()
            .unwrap()
    });
    if start.is_some_and(|start| start >= size) {
        return write!(
            stream,
            "HTTP/1.1 416 Range\r\nContent-Range: bytes */{size}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
        );
    }
    let first = if behaviour.wrong_range { 0 } else { start.unwrap_or(0) };
    let body = &behaviour.file[first..];
    let mut head = match start {
        Some(_) => format!(
            "HTTP/1.1 206 Part\r\nContent-Range: bytes {first}-{}/{size}\r\n",
            size - 1
        ),
        None => "HTTP/1.1 200 OK\r\n".to_owned(),
    };
    if behaviour.length {
        head += "Content-Length: ";
        head += &body.len().to_string();
        head += "\r\n";
    }
    if let Some(etag) = behaviour.etag {
        head += &["ETag: ", etag, "\r\n"].concat();
    }
    write!(stream, "{head}Connection: close\r\n\r\n")?;
    stream.write_all(&body[..behaviour.cut_after.unwrap_or(body.len()).min(body.len())])?;
    stream.flush()?;
    // Waits until the client closes the connection, because closing it first can discard bytes that the client has not read.
    stream.shutdown(std::net::Shutdown::Write)?;
    stream.read_to_end(&mut Vec::new()).map(|_| ())
}

/// A zip file of about 400 kB of incompressible data with a dataset below `prefix`.
fn archive(prefix: &str) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default();
    writer
        .start_file(format!("{prefix}pusht.zarr/.zgroup"), options)
        .unwrap();
    writer.write_all(b"{\"zarr_format\": 2}").unwrap();
    writer
        .start_file(format!("{prefix}pusht.zarr/data/chunk"), options)
        .unwrap();
    writer.write_all(&content()).unwrap();
    writer.finish().unwrap().into_inner()
}

fn content() -> Vec<u8> {
    let mut value = 12345u32;
    (0..400_000)
        .map(|_| {
            value = value.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (value >> 24) as u8
        })
        .collect()
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect::<Vec<_>>()
        .concat()
}

fn dataset(url: &str) -> Dataset {
    Dataset {
        name: "pusht".to_owned(),
        description: "A test.".to_owned(),
        url: url.to_owned(),
        bytes: None,
        sha256: None,
        licence: "MIT".to_owned(),
        form: Form::Zip,
        provides: "pusht/pusht.zarr".to_owned(),
    }
}

fn get(dataset: &Dataset, destination: &Path) -> Result<FetchReport, FetchError> {
    fetch(dataset, destination, &mut |_, _| {})
}

/// The error message with placeholders for the port and the folder of this run.
fn sentence(result: Result<FetchReport, FetchError>, server: &str, folder: &Path) -> String {
    result
        .expect_err("the fetch should fail")
        .sentence()
        .replace(server, "[server]")
        .replace(folder.to_str().unwrap(), "[folder]")
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

fn check_unpacked(folder: &Path) {
    assert_eq!(names(folder), ["pusht"], "other files than the dataset are left");
    assert_eq!(fs::read(folder.join("pusht/pusht.zarr/data/chunk")).unwrap(), content());
    assert!(folder.join("pusht/pusht.zarr/.zgroup").is_file());
}

#[test]
fn a_dataset_is_fetched_once() {
    for prefix in ["", "pusht/"] {
        let zip = archive(prefix);
        let server = Server::start(Behaviour::good(&zip));
        let folder = TempDir::new().unwrap();
        let destination = folder.path().join("data");
        let dataset = Dataset {
            bytes: Some(zip.len() as u64),
            sha256: Some(sha256(&zip)),
            ..dataset(&server.address)
        };
        let mut calls = Vec::new();
        let report = fetch(&dataset, &destination, &mut |received, total| {
            calls.push((received, total));
        })
        .unwrap();
        assert_eq!(report.path, destination.join("pusht/pusht.zarr"));
        let bytes = zip.len() as u64;
        assert_eq!(
            report.outcome,
            Outcome::Fetched {
                bytes,
                resumed_from: 0,
                sha256: sha256(&zip),
                verified: true
            }
        );
        check_unpacked(&destination);
        assert_eq!(calls.first(), Some(&(0, Some(bytes))));
        assert_eq!(calls.last(), Some(&(bytes, Some(bytes))));
        assert!(calls.is_sorted());

        assert_eq!(get(&dataset, &destination).unwrap().outcome, Outcome::AlreadyThere);
        assert_eq!(server.requests().len(), 1);
    }
}

#[test]
fn weights_are_installed_without_unpacking() {
    // PyTorch's files have the format zip, but must not be unpacked.
    let file = archive("");
    let server = Server::start(Behaviour {
        cut_after: Some(100_000),
        ..Behaviour::good(&file)
    });
    let folder = TempDir::new().unwrap();
    let weights = |url: &str, right: &[u8]| {
        let known = re4_fetch::find("resnet18").unwrap().with_url(url);
        Dataset {
            bytes: Some(right.len() as u64),
            sha256: Some(sha256(right)),
            ..known
        }
    };
    let whole = weights(&server.address, &file);
    assert!(get(&whole, folder.path()).is_err());
    assert_eq!(
        names(folder.path()),
        ["resnet18.part", "resnet18.part.origin"],
        "an incomplete file was installed"
    );
    server.set(|behaviour| behaviour.cut_after = None);
    let report = get(&whole, folder.path()).unwrap();
    let path = folder.path().join("weights/resnet18-f37072fd.pth");
    assert_eq!(report.path, path);
    assert!(matches!(
        report.outcome,
        Outcome::Fetched {
            resumed_from: 100_000,
            verified: true,
            ..
        }
    ));
    assert_eq!(fs::read(&path).unwrap(), file);
    assert_eq!(names(folder.path()), ["weights"]);
    assert_eq!(get(&whole, folder.path()).unwrap().outcome, Outcome::AlreadyThere);

    // A file of the right size with wrong content.
    let mut other = file.clone();
    other[1000] ^= 1;
    let folder = TempDir::new().unwrap();
    let failed = sentence(
        get(&weights(&server.address, &other), folder.path()),
        &server.address,
        folder.path(),
    );
    assert!(
        failed.contains("the file has SHA-256") && failed.contains("so it was deleted"),
        "{failed}"
    );
    assert!(names(folder.path()).is_empty());
}

#[test]
fn an_interrupted_download_is_continued() {
    let zip = archive("");
    let server = Server::start(Behaviour {
        cut_after: Some(100_000),
        ..Behaviour::good(&zip)
    });
    let folder = TempDir::new().unwrap();
    let failed = sentence(
        get(&dataset(&server.address), folder.path()),
        &server.address,
        folder.path(),
    );
    insta::assert_snapshot!(failed);
    assert_eq!(fs::metadata(folder.path().join("pusht.part")).unwrap().len(), 100_000);
    assert!(!folder.path().join("pusht").exists());

    server.set(|behaviour| behaviour.cut_after = Some(50_000));
    assert!(get(&dataset(&server.address), folder.path()).is_err());
    server.set(|behaviour| behaviour.cut_after = None);
    let report = get(&dataset(&server.address), folder.path()).unwrap();
    let (bytes, sha256) = (zip.len() as u64, sha256(&zip));
    assert_eq!(
        report.outcome,
        Outcome::Fetched {
            bytes,
            resumed_from: 150_000,
            sha256,
            verified: false
        }
    );
    check_unpacked(folder.path());
    let etag = || Some("\"one\"".to_owned());
    assert_eq!(
        server.requests(),
        [
            (None, None),
            (Some("bytes=100000-".to_owned()), etag()),
            (Some("bytes=150000-".to_owned()), etag())
        ]
    );
}

/// A change of the server between two fetches.
type Change = fn(&mut Behaviour);

#[test]
fn a_download_starts_again_if_it_cannot_be_continued() {
    let changes: [(&str, Change); 3] = [
        ("no ranges", |behaviour| behaviour.ranges = false),
        ("another version", |behaviour| behaviour.etag = Some("\"two\"")),
        ("no ranges, no length", |behaviour| {
            behaviour.ranges = false;
            behaviour.length = false;
        }),
    ];
    for (name, change) in changes {
        let zip = archive("");
        // The first part belongs to an older version of the file, so continuing it would give a damaged file.
        let old = vec![7; zip.len()];
        let server = Server::start(Behaviour {
            cut_after: Some(100_000),
            ..Behaviour::good(&old)
        });
        let folder = TempDir::new().unwrap();
        assert!(get(&dataset(&server.address), folder.path()).is_err());
        server.set(|behaviour| {
            *behaviour = Behaviour::good(&zip);
            change(behaviour);
        });
        let report = get(&dataset(&server.address), folder.path()).unwrap();
        assert!(
            matches!(report.outcome, Outcome::Fetched { resumed_from: 0, .. }),
            "{name}"
        );
        check_unpacked(folder.path());
    }
}

#[test]
fn part_files_of_another_url_are_not_continued() {
    let zip = archive("");
    let first = Server::start(Behaviour {
        cut_after: Some(1000),
        ..Behaviour::good(&zip)
    });
    let second = Server::start(Behaviour::good(&zip));
    let folder = TempDir::new().unwrap();
    assert!(get(&dataset(&first.address), folder.path()).is_err());
    get(
        &dataset(&first.address).with_url(second.address.as_str()),
        folder.path(),
    )
    .unwrap();
    assert_eq!(second.requests(), [(None, None)]);
    check_unpacked(folder.path());
}

#[test]
fn a_complete_part_file_is_not_downloaded_again() {
    let zip = archive("");
    let server = Server::start(Behaviour {
        cut_after: Some(zip.len() - 1),
        ..Behaviour::good(&zip)
    });
    let folder = TempDir::new().unwrap();
    assert!(get(&dataset(&server.address), folder.path()).is_err());
    fs::write(folder.path().join("pusht.part"), &zip).unwrap();
    server.set(|behaviour| behaviour.cut_after = None);
    let report = get(&dataset(&server.address), folder.path()).unwrap();
    assert!(matches!(report.outcome, Outcome::Fetched { resumed_from, .. } if resumed_from == zip.len() as u64));
    check_unpacked(folder.path());
    // A part file with one byte too many cannot be continued, so the download starts again.
    fs::remove_dir_all(folder.path().join("pusht")).unwrap();
    fs::write(folder.path().join("pusht.part"), [zip.as_slice(), b"x"].concat()).unwrap();
    fs::write(
        folder.path().join("pusht.part.origin"),
        format!("{}\n\"one\"\n", server.address),
    )
    .unwrap();
    let report = get(&dataset(&server.address), folder.path()).unwrap();
    assert!(matches!(report.outcome, Outcome::Fetched { resumed_from: 0, .. }));
    check_unpacked(folder.path());
}

#[test]
fn servers_without_content_length_are_supported() {
    let zip = archive("");
    let server = Server::start(Behaviour {
        length: false,
        etag: None,
        ..Behaviour::good(&zip)
    });
    let folder = TempDir::new().unwrap();
    get(&dataset(&server.address), folder.path()).unwrap();
    check_unpacked(folder.path());
    // Without a length, an interrupted download looks complete. The error is detected when the zip file is read.
    server.set(|behaviour| behaviour.cut_after = Some(200_000));
    let other = TempDir::new().unwrap();
    let failed = sentence(
        get(&dataset(&server.address), other.path()),
        &server.address,
        other.path(),
    );
    insta::assert_snapshot!(failed);
    assert!(names(other.path()).is_empty());
}

#[test]
fn errors_are_reported_and_leave_no_files() {
    let zip = archive("");
    let server = Server::start(Behaviour::good(&zip));
    let folder = TempDir::new().unwrap();
    let mut sentences = Vec::new();
    let mut fails = |dataset: &Dataset| {
        sentences.push(sentence(get(dataset, folder.path()), &server.address, folder.path()));
        assert!(names(folder.path()).is_empty(), "{sentences:?}");
    };
    for status in [404, 403, 503, 302] {
        server.set(|behaviour| behaviour.status = Some(status));
        fails(&dataset(&server.address));
    }
    server.set(|behaviour| behaviour.status = None);
    fails(&Dataset {
        bytes: Some(12),
        ..dataset(&server.address)
    });
    fails(&Dataset {
        sha256: Some("0".repeat(64)),
        ..dataset(&server.address)
    });
    fails(&Dataset {
        provides: "pusht/other.zarr".to_owned(),
        ..dataset(&server.address)
    });
    server.set(|behaviour| behaviour.file = b"<html>moved</html>".to_vec());
    fails(&dataset(&server.address));
    let mut damaged = zip.clone();
    damaged[200_000] ^= 1;
    server.set(|behaviour| behaviour.file = damaged);
    fails(&dataset(&server.address));
    let mut traversal = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    traversal
        .start_file("../outside", zip::write::SimpleFileOptions::default())
        .unwrap();
    traversal.write_all(b"x").unwrap();
    server.set(|behaviour| behaviour.file = traversal.finish().unwrap().into_inner());
    fails(&dataset(&server.address));
    assert!(!folder.path().parent().unwrap().join("outside").exists());
    insta::assert_snapshot!(sentences.join("\n").replace(&sha256(&zip), "[hash]"));
}

#[test]
fn a_wrong_range_is_not_appended() {
    let zip = archive("");
    let server = Server::start(Behaviour {
        cut_after: Some(1000),
        ..Behaviour::good(&zip)
    });
    let folder = TempDir::new().unwrap();
    assert!(get(&dataset(&server.address), folder.path()).is_err());
    server.set(|behaviour| {
        behaviour.cut_after = None;
        behaviour.wrong_range = true;
    });
    let failed = sentence(
        get(&dataset(&server.address), folder.path()),
        &server.address,
        folder.path(),
    );
    insta::assert_snapshot!(failed);
    assert_eq!(fs::metadata(folder.path().join("pusht.part")).unwrap().len(), 1000);
}

#[test]
fn unreachable_servers_and_invalid_urls_are_reported() {
    let folder = TempDir::new().unwrap();
    // Port 1 is never assigned to the server of another test.
    let address = "http://127.0.0.1:1/pusht.zip".to_owned();
    let sentences = [
        sentence(get(&dataset(&address), folder.path()), &address, folder.path()),
        sentence(get(&dataset("not a url"), folder.path()), "-", folder.path()),
        sentence(get(&dataset("pusht.zip"), folder.path()), "-", folder.path()),
        sentence(
            get(&dataset("ftp://localhost/pusht.zip"), folder.path()),
            "-",
            folder.path(),
        ),
    ];
    assert!(names(folder.path()).is_empty());
    insta::assert_snapshot!(sentences.join("\n"));
}

#[test]
fn a_file_as_destination_is_refused() {
    let zip = archive("");
    let server = Server::start(Behaviour::good(&zip));
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("file"), "x").unwrap();
    let destination = folder.path().join("file");
    let failed = sentence(
        get(&dataset(&server.address), &destination),
        &server.address,
        folder.path(),
    );
    insta::assert_snapshot!(failed);
}

#[test]
fn two_fetches_do_not_write_to_the_same_part_file() {
    let zip = archive("");
    let server = Server::start(Behaviour::good(&zip));
    let folder = TempDir::new().unwrap();
    let part = fs::File::create(folder.path().join("pusht.part")).unwrap();
    part.lock().unwrap();
    let failed = sentence(
        get(&dataset(&server.address), folder.path()),
        &server.address,
        folder.path(),
    );
    insta::assert_snapshot!(failed, @"cannot fetch pusht from [server]: another fetch is writing [folder]/pusht.part; wait until it has finished");
    drop(part);
    get(&dataset(&server.address), folder.path()).unwrap();
    check_unpacked(folder.path());
}
