//! A server that simulates S3.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// A running server with the bucket `bucket`.
pub(crate) struct Moto {
    server: Child,
    endpoint: String,
}

impl Moto {
    /// Starts a server; `None`, with a message, if `RE4_MOTO` does not name the program.
    pub(crate) fn start() -> Option<Self> {
        let Some(program) = std::env::var_os("RE4_MOTO") else {
            println!("skipped: RE4_MOTO is not set; scripts/setup-moto.sh installs moto_server");
            return None;
        };
        // The interpreter beside the program.
        let python = PathBuf::from(program).with_file_name("python");
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/support/atomic_moto.py");
        let mut server = Command::new(python)
            .arg(script)
            .args(["-H", "127.0.0.1", "-p", "0"])
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(server.stderr.take().unwrap()).lines();
        let endpoint = lines
            .find_map(|line| Some(line.unwrap().split("Running on ").nth(1)?.trim().to_owned()))
            .unwrap();
        // The server waits if nobody reads what it prints.
        std::thread::spawn(move || lines.for_each(drop));
        let moto = Self { server, endpoint };
        moto.create_bucket();
        Some(moto)
    }

    fn create_bucket(&self) {
        let address = self.endpoint.trim_start_matches("http://");
        let mut stream = TcpStream::connect(address).unwrap();
        write!(
            stream,
            "PUT /bucket HTTP/1.1\r\nHost: {address}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
        )
        .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    }

    /// Address of the server.
    #[allow(dead_code, reason = "only one of the two test programs with this module uses it")]
    pub(crate) fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Lets a command use this server for S3.
    pub(crate) fn settings<'a>(&self, command: &'a mut Command) -> &'a mut Command {
        command
            .env("AWS_ENDPOINT", &self.endpoint)
            .env("AWS_ALLOW_HTTP", "true")
            .env("AWS_ACCESS_KEY_ID", "key")
            .env("AWS_SECRET_ACCESS_KEY", "secret")
            .env("AWS_REGION", "us-east-1")
    }
}

impl Drop for Moto {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}
