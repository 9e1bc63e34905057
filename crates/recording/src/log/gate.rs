//! Gate of the live server: rejects web pages of other sites by their Origin header.
//!
//! A browser lets any page connect to any websocket and sends the page's site in `Origin`. Programs other than
//! browsers send no `Origin`.

use output::terminal::note;
use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

/// Limit of the length of a request's HTTP head, bytes.
const LONGEST_HEAD: usize = 16 * 1024;
/// Timeout for receiving the HTTP head of a request.
const HEAD_WITHIN: Duration = Duration::from_secs(5);

/// Listener that passes accepted connections to the server behind it.
pub struct Gate {
    address: SocketAddr,
    closed: Arc<AtomicBool>,
}

impl Gate {
    /// Listens at `address` for the server at `inner`. Pages of this machine and of the `allowed` origins may
    /// connect.
    pub fn open(address: SocketAddr, inner: SocketAddr, allowed: Vec<String>) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        let gate = Self {
            address: listener.local_addr()?,
            closed: Arc::default(),
        };
        let (closed, allowed) = (gate.closed.clone(), Arc::new(allowed));
        thread::spawn(move || {
            for outside in listener.incoming() {
                if closed.load(Relaxed) {
                    return;
                }
                let allowed = allowed.clone();
                if let Ok(outside) = outside {
                    // An error ends only this connection.
                    thread::spawn(move || drop(admit(outside, inner, &allowed)));
                }
            }
        });
        Ok(gate)
    }

    /// Address with the chosen port.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Gate {
    fn drop(&mut self) {
        self.closed.store(true, Relaxed);
        // A connection wakes the listener, which then ends.
        let here = match self.address.ip() {
            ip if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
            ip => ip,
        };
        let _ = TcpStream::connect_timeout(&(here, self.address.port()).into(), HEAD_WITHIN);
    }
}

/// Random loopback address, hard to guess, because the server behind the gate checks nothing.
pub fn hidden_address() -> Ipv4Addr {
    use std::hash::{BuildHasher, RandomState};
    let [a, b, c, ..] = RandomState::new().hash_one(()).to_le_bytes();
    Ipv4Addr::new(127, a.max(1), b, c.clamp(1, 254))
}

/// Passes a connection on to the server, or rejects the connection because of its origin.
fn admit(mut outside: TcpStream, inner: SocketAddr, allowed: &[String]) -> io::Result<()> {
    outside.set_nodelay(true)?;
    outside.set_read_timeout(Some(HEAD_WITHIN))?;
    let head = head(&mut outside)?;
    if let Some(origin) = origin(&head).filter(|origin| !is_allowed(origin, allowed)) {
        let text = format!("origin {origin} is refused; to allow it: --live-origin {origin}");
        note(format!("live: {text}"));
        let length = text.len() + 1;
        return write!(
            outside,
            "HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain\r\nContent-Length: {length}\r\n\
             Connection: close\r\n\r\n{text}\n"
        );
    }
    outside.set_read_timeout(None)?;
    let mut inside = TcpStream::connect(inner)?;
    inside.set_nodelay(true)?;
    inside.write_all(&head)?;
    let (mut from, mut to) = (outside.try_clone()?, inside.try_clone()?);
    thread::spawn(move || {
        let _ = io::copy(&mut from, &mut to);
        let _ = to.shutdown(Shutdown::Write);
    });
    let copied = io::copy(&mut inside, &mut outside);
    outside.shutdown(Shutdown::Both)?;
    copied.map(drop)
}

/// Received bytes up to at least the end of the HTTP head.
fn head(from: &mut TcpStream) -> io::Result<Vec<u8>> {
    let (mut head, mut buffer) = (Vec::new(), [0; 2048]);
    while !head.windows(4).any(|end| end == b"\r\n\r\n") {
        let count = from.read(&mut buffer)?;
        if count == 0 || head.len() + count > LONGEST_HEAD {
            return Err(io::ErrorKind::InvalidData.into());
        }
        head.extend_from_slice(&buffer[..count]);
    }
    Ok(head)
}

/// Content of the `Origin` header of a request; `None` without this header.
fn origin(head: &[u8]) -> Option<String> {
    let head = String::from_utf8_lossy(head);
    let mut fields = head.lines().skip(1).map_while(|line| line.split_once(':'));
    let found = fields.find(|(name, _)| name.trim().eq_ignore_ascii_case("origin"));
    found.map(|(_, value)| value.trim().to_owned())
}

/// True for origins of this machine and for the allowed origins. Desktop programs built on a browser send `file://`,
/// which no web page can send.
fn is_allowed(origin: &str, allowed: &[String]) -> bool {
    let Some((scheme, place)) = origin.split_once("://") else {
        return false;
    };
    let host = match place.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => place.split(':').next().unwrap_or_default(),
    };
    let is_here = host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback());
    scheme == "file" && place.is_empty()
        || host.eq_ignore_ascii_case("localhost")
        || is_here
        || allowed
            .iter()
            .any(|other| other.trim_end_matches('/').eq_ignore_ascii_case(origin))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_of_this_machine_and_named_ones_are_allowed() {
        let named = ["https://app.example.org/".to_owned()];
        for (origin, allowed) in [
            ("http://localhost:8080", true),
            ("https://LOCALHOST", true),
            ("http://127.0.0.1:3000", true),
            ("http://[::1]:3000", true),
            ("file://", true),
            ("https://app.example.org", true),
            ("https://app.example.org:444", false),
            ("https://evil.example", false),
            ("http://localhost.evil.example", false),
            ("http://127.0.0.1.evil.example", false),
            ("file://evil.example", false),
            ("null", false),
            ("", false),
        ] {
            assert_eq!(is_allowed(origin, &named), allowed, "{origin}");
        }
    }

    /// Server that echoes its input.
    fn echo() -> SocketAddr {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let address = listener.local_addr().unwrap();
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let (mut from, mut to) = (stream.try_clone().unwrap(), stream);
                let _ = io::copy(&mut from, &mut to);
            }
        });
        address
    }

    fn answer(gate: &Gate, request: &str) -> String {
        let mut stream = TcpStream::connect(gate.address()).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        stream.shutdown(Shutdown::Write).unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        text
    }

    #[test]
    fn page_of_another_site_is_refused_and_others_reach_the_server() {
        let gate = Gate::open((Ipv4Addr::LOCALHOST, 0).into(), echo(), Vec::new()).unwrap();
        for origin in ["", "Origin: http://localhost:8080\r\n"] {
            let request = format!("GET / HTTP/1.1\r\nHost: x\r\n{origin}\r\nand more");
            assert_eq!(answer(&gate, &request), request);
        }
        let refused = answer(
            &gate,
            "GET / HTTP/1.1\r\noRiGiN:https://evil.example\r\n\r\n",
        );
        assert!(refused.starts_with("HTTP/1.1 403 "), "{refused}");
        assert!(
            refused.contains("--live-origin https://evil.example"),
            "{refused}"
        );
        let [a, b] = [hidden_address(), hidden_address()];
        assert!(a.is_loopback() && a != b);
    }
}
