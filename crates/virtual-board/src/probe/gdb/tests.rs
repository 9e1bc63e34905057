//! A scripted client that speaks the remote protocol after gdb's manual, and nothing of the server's.

use super::*;
use crate::chip::Bare;
use crate::image::tests::Builder;
use crate::time::Time;
use std::io::Write;

/// Counts in r0 and stores it at 0x20000100, for ever:
/// `movs r0, #0; ldr r1, =0x20000100; 1: adds r0, #1; str r0, [r1]; b 1b`.
const PROGRAM: [u8; 16] = [
    0x00, 0x20, 0x02, 0x49, 0x40, 0x1c, 0x08, 0x60, 0xfc, 0xe7, 0x00, 0xbf, 0x00, 0x01, 0x00, 0x20,
];
const STORE: u32 = 0x0800_0106;

struct Client {
    stream: TcpStream,
    session: Option<Session>,
    board: Board,
    received: Vec<u8>,
}

impl Client {
    fn new() -> Self {
        let mut board = Board::new(Box::new(Bare), 0);
        board.flash(&Builder::new(&PROGRAM).image());
        board.power(true);
        let server = Server::listen(0).unwrap();
        let stream = TcpStream::connect(("127.0.0.1", server.port().unwrap())).unwrap();
        let mut calls = std::iter::repeat_with(|| server.poll(&mut board).unwrap());
        let session = calls.find_map(|session| session);
        stream.set_nonblocking(true).unwrap();
        stream.set_nodelay(true).unwrap();
        Self {
            stream,
            session,
            board,
            received: Vec::new(),
        }
    }

    fn send(&mut self, packet: &str) {
        let sum = packet.bytes().fold(0u8, u8::wrapping_add);
        let framed = format!("${packet}#{sum:02x}");
        self.stream.write_all(framed.as_bytes()).unwrap();
    }

    /// Lets the board run and the server work for a while.
    fn work(&mut self) -> Next {
        let session = self.session.as_mut().unwrap();
        let next = session.serve(&mut self.board).unwrap();
        if next == Next::Run {
            let to = self.board.now() + Time::from_micros(100);
            self.board.run_until(to);
        }
        let mut bytes = [0; 4096];
        if let Ok(count) = self.stream.read(&mut bytes) {
            self.received.extend_from_slice(&bytes[..count]);
        }
        next
    }

    /// The next packet, acknowledged, with its repetitions written out.
    fn answer(&mut self) -> String {
        for _ in 0..100_000 {
            let start = self.received.iter().position(|&b| b == b'$');
            let end = self.received.iter().position(|&b| b == b'#');
            if let (Some(start), Some(end)) = (start, end)
                && self.received.len() >= end + 3
            {
                let body: Vec<u8> = self.received[start + 1..end].to_vec();
                self.received.drain(..end + 3);
                self.stream.write_all(b"+").unwrap();
                return unpacked(&body);
            }
            self.work();
        }
        panic!("no answer");
    }

    /// Continues and lets the board run for 2 ms.
    fn run(&mut self) {
        self.send("c");
        while self.work() != Next::Run {}
        for _ in 0..20 {
            self.work();
        }
    }

    fn ask(&mut self, packet: &str) -> String {
        self.send(packet);
        self.answer()
    }

    /// Words of the answer to `g`.
    fn registers(&mut self) -> Vec<u32> {
        let hex = self.ask("g");
        let bytes: Vec<u8> = (0..hex.len() / 2)
            .map(|k| u8::from_str_radix(&hex[2 * k..2 * k + 2], 16).unwrap())
            .collect();
        let words = bytes.chunks_exact(4);
        words
            .map(|w| u32::from_le_bytes(w.try_into().unwrap()))
            .collect()
    }

    /// What a monitor command prints.
    fn monitor(&mut self, command: &str) -> String {
        let hex: String = command.bytes().map(|b| format!("{b:02x}")).collect();
        self.send(&format!("qRcmd,{hex}"));
        let mut text = String::new();
        loop {
            let answer = self.answer();
            let Some(hex) = answer.strip_prefix('O').filter(|_| answer != "OK") else {
                assert_eq!(answer, "OK");
                return text;
            };
            for k in 0..hex.len() / 2 {
                text.push(
                    u8::from_str_radix(&hex[2 * k..2 * k + 2], 16)
                        .unwrap()
                        .into(),
                );
            }
        }
    }
}

/// `x*n`: x, then as often again as the code of n is above 29.
fn unpacked(body: &[u8]) -> String {
    let mut text = String::new();
    let mut bytes = body.iter();
    while let Some(&byte) = bytes.next() {
        if byte == b'*' {
            let last = text.chars().last().unwrap();
            let times = bytes.next().unwrap() - 29;
            text.extend(std::iter::repeat_n(last, times.into()));
        } else {
            text.push(byte.into());
        }
    }
    text
}

const PC: usize = 15;

#[test]
fn the_description_names_what_the_registers_packet_holds() {
    let mut client = Client::new();
    let offers = client.ask("qSupported:swbreak+;hwbreak+;xmlRegisters=arm");
    assert!(offers.contains("qXfer:features:read+"), "{offers}");
    let text = client.ask("qXfer:features:read:target.xml:0,2000");
    let bits = |part: &str| part.split('"').next().unwrap().parse::<usize>().unwrap();
    let widths = text.split("bitsize=\"").skip(1).map(bits);
    assert_eq!(client.ask("g").len() * 4, widths.sum::<usize>());
    let last = text.matches("name=\"").count();
    // 17 of the core, 16 and the status of floating point, 6 of the system, three features.
    assert_eq!(last, 17 + 17 + 6 + 3);
    // After a reset: the vectors of the image.
    let registers = client.registers();
    assert_eq!((registers[13], registers[PC]), (0x2002_0000, 0x0800_0100));
    assert_eq!(registers[16], 0x0100_0000);
}

#[test]
fn breakpoints_steps_and_interrupting() {
    let mut client = Client::new();
    assert_eq!(client.ask(&format!("Z0,{STORE:x},2")), "OK");
    for round in 1..4 {
        assert_eq!(&client.ask("c")[1..3], "05");
        let registers = client.registers();
        assert_eq!((registers[PC], registers[0]), (STORE, round));
    }
    // The third store is still to come.
    assert_eq!(client.ask("m20000100,4"), "02000000");
    assert_eq!(&client.ask("s")[1..3], "05");
    assert_eq!(client.registers()[PC], STORE + 2);
    assert_eq!(client.ask("m20000100,4"), "03000000");
    assert_eq!(client.ask(&format!("z0,{STORE:x},2")), "OK");
    client.run();
    client.stream.write_all(&[3]).unwrap();
    assert_eq!(&client.answer()[1..3], "02");
    // Stopped, time stands still.
    let (now, count) = (client.board.now(), client.registers()[0]);
    for _ in 0..20 {
        assert_eq!(client.work(), Next::Wait);
        client.board.run_until(now + Time::from_micros(1_000_000));
    }
    assert_eq!((client.board.now(), client.registers()[0]), (now, count));
    assert!(count > 1000, "{count}");
}

#[test]
fn stops_and_steps_take_the_board_no_time() {
    let mut client = Client::new();
    client.ask(&format!("Z1,{STORE:x},2"));
    for _ in 0..50 {
        client.ask("c");
        client.ask("s");
    }
    client.ask(&format!("z1,{STORE:x},2"));
    client.run();
    let mut free = Client::new();
    free.run();
    let later = client.board.now().max(free.board.now());
    for board in [&mut client.board, &mut free.board] {
        board.run_until(later);
    }
    let seen = |board: &Board| (board.core().cycles(), board.core().register(0));
    assert_eq!(seen(&client.board), seen(&free.board));
}

#[test]
fn watchpoints_stop_after_the_access() {
    let mut client = Client::new();
    assert_eq!(client.ask("Z2,20000100,4"), "OK");
    let stop = client.ask("c");
    assert!(stop.contains("watch:20000100"), "{stop}");
    assert_eq!(client.registers()[PC], STORE + 2);
    assert_eq!(client.ask("z2,20000100,4"), "OK");
    assert_eq!(client.ask("Z3,20000100,4"), "OK");
    client.run();
    // Nobody reads it.
    assert_eq!(client.board.stopped(), None);
}

#[test]
fn memory_and_registers_are_written() {
    let mut client = Client::new();
    assert_eq!(client.ask("M20000201,5:0102030405"), "OK");
    assert_eq!(client.ask("m20000200,8").get(2..12), Some("0102030405"));
    // The flash is read at both its places, and not written.
    assert_eq!(client.ask("m8000100,4"), "00200249");
    assert_eq!(client.ask("m100,4"), "00200249");
    assert_eq!(&client.ask("M8000100,1:00")[..1], "E");
    // r0 becomes 0x50 and s5 1.5, by writing all registers.
    let mut hex = client.ask("g");
    hex.replace_range(..8, "50000000");
    let s5 = (17 + 5) * 8;
    hex.replace_range(s5..s5 + 8, "0000c03f");
    assert_eq!(client.ask(&format!("G{hex}")), "OK");
    assert_eq!(client.ask("g"), hex);
    assert_eq!(client.board.core().register(0), 0x50);
    assert_eq!(client.board.core().single(5), 1.5f32.to_bits());
}

#[test]
fn peripherals_are_read_only_when_asked_for() {
    let mut client = Client::new();
    assert_eq!(&client.ask("m40023800,4")[..1], "E");
    client.monitor("peripherals on");
    // RCC_CR after a reset: HSI on, ready and trimmed in the middle; its calibration is the chip's.
    let value = client.ask("m40023800,4");
    assert_eq!(&value[..2], "83", "{value}");
    assert_eq!(&client.ask("me000ed00,4")[..1], "E");
}

#[test]
fn monitor_commands() {
    let mut client = Client::new();
    client.ask(&format!("Z0,{STORE:x},2"));
    client.ask("c");
    assert!(client.monitor("time").contains("cycle"));
    assert_eq!(client.monitor("findings"), "0 findings\n");
    assert_eq!(client.monitor("reset"), "reset; stopped at 0x08000100\n");
    assert_eq!(client.registers()[PC], 0x0800_0100);
    assert!(client.monitor("help").starts_with("reset, time"));
}

#[test]
fn when_gdb_goes_the_board_runs_on_without_breakpoints() {
    for packet in ["D", "k", ""] {
        let mut client = Client::new();
        client.ask(&format!("Z0,{STORE:x},2"));
        client.ask("Z2,20000100,4");
        if packet.is_empty() {
            client.stream.shutdown(std::net::Shutdown::Both).unwrap();
        } else {
            client.send(packet);
        }
        while client.work() != Next::Gone {}
        assert!(!client.board.core().debugger_attached());
        let now = client.board.now();
        client.board.run_until(now + Time::from_micros(3000));
        assert_eq!(client.board.stopped(), None);
        assert!(client.board.core().register(0) > 100);
    }
}

#[test]
fn a_port_in_use_is_an_error_that_says_which() {
    let server = Server::listen(0).unwrap();
    let port = server.port().unwrap();
    let error = Server::listen(port).unwrap_err().to_string();
    assert!(error.starts_with(&format!("port {port} cannot be opened")));
}

#[test]
fn a_client_that_is_no_gdb_ends_its_session_and_the_board_runs_on() {
    // An answer to nothing, and a packet with a wrong checksum.
    for bytes in [b"-".as_slice(), b"$g#00"] {
        let mut client = Client::new();
        client.stream.write_all(bytes).unwrap();
        let mut session = client.session.take().unwrap();
        let mut calls = (0..100_000).map(|_| session.serve(&mut client.board));
        let error = calls.find_map(Result::err).unwrap();
        assert!(matches!(error, GdbError::Protocol(_)), "{error}");
        let before = client.board.core().instructions();
        let to = client.board.now() + Time::from_micros(10_000);
        client.board.run_until(to);
        assert!(client.board.core().instructions() > before);
    }
}
