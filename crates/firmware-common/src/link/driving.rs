//! Link of a board that drives: handles bytes and frames that arrive, without access to hardware.

use core_algos::bus::CanFrame;
use core_algos::link::framing::Decoder;
use core_algos::link::run_link::Station;
use core_algos::link::segment::{self, Direction};
use core_algos::link::{Demand, RunLink};
use core_algos::time::Micros;
use core_algos::topology::Role;

use super::ends::{LinkEnd, OrderResult};
use super::{Output, Route};

/// Event for which the link waits.
pub enum Event<'a> {
    /// Bytes arrived at the serial port.
    Bytes(&'a [u8]),
    /// A frame of the link arrived on the bus.
    Frame(CanFrame),
    /// The tick executed an order, with this result.
    Executed(OrderResult),
    /// The previous report was sent, or the next report is due.
    Nothing,
}

/// Link of a board that drives.
pub struct Driving {
    role: Role,
    /// Serves a host at this board's serial port.
    at_port: &'static mut RunLink,
    /// Serves a host at another board's serial port, over the bus.
    on_bus: &'static mut RunLink,
    station: Station,
    end: LinkEnd,
    /// Decoder of other boards' replies.
    relayed: Decoder,
    /// Route on which the latest order arrived.
    ordered: Route,
}

impl Driving {
    /// A link without requests or orders in progress.
    pub fn new(role: Role, [at_port, on_bus]: &'static mut [RunLink; 2], end: LinkEnd) -> Self {
        Self {
            role,
            at_port,
            on_bus,
            station: Station::default(),
            end,
            relayed: Decoder::new(),
            ordered: Route::Serial,
        }
    }

    /// The link's end of the channels to the tick.
    pub fn end(&self) -> &LinkEnd {
        &self.end
    }

    /// Handles one event at `now`. Returns the route of a request for a session: the board must then reset into a
    /// session once all bytes are sent.
    pub fn handle_event(
        &mut self,
        now: Micros,
        event: Event,
        output: &mut impl Output,
    ) -> Option<Route> {
        if self.end.is_watched() {
            self.report(output);
        }
        self.station.now = now;
        self.station.motors = self.end.motors();
        if self.station.lease.take_lapsed(now) {
            self.end.on_lease_lapsed();
        }
        match event {
            Event::Bytes(bytes) => return self.receive(Route::Serial, bytes, output),
            Event::Frame(frame) => match segment::address(frame.id) {
                Some((to, Direction::To)) if to == self.role => {
                    return self.receive(Route::Bus, frame.bytes(), output);
                }
                Some((from, Direction::From)) => self.relay(from, frame.bytes(), output),
                _ => {}
            },
            Event::Executed(result) => self.reply_to_order(result, output),
            Event::Nothing => {}
        }
        None
    }

    /// Handles bytes from a host.
    fn receive(&mut self, route: Route, bytes: &[u8], output: &mut impl Output) -> Option<Route> {
        let run_link = match route {
            Route::Serial => &mut *self.at_port,
            Route::Bus => &mut *self.on_bus,
        };
        let role = self.role;
        let mut send = |reply: &[u8]| output.reply(route, role, reply);
        match (run_link.receive(bytes, &mut self.station, &mut send), route) {
            (Some(Demand::Order(number, order)), route) => {
                self.end.order(number, order);
                self.ordered = route;
            }
            (Some(Demand::Session), route) => return Some(route),
            (Some(Demand::Watch), Route::Serial) => self.end.watch(),
            (Some(Demand::Record), _) => self.end.begin(),
            (Some(Demand::Send(frame)), _) => output.send(core::iter::once(frame)),
            (Some(Demand::Relay(to, frame)), Route::Serial) => {
                output.send(segment::frames(to, Direction::To, frame.repeated()));
            }
            // Watching and relaying are served only at a board's own port.
            (Some(Demand::Watch | Demand::Relay(..)), Route::Bus) | (None, _) => {}
        }
        None
    }

    fn reply_to_order(&mut self, result: OrderResult, output: &mut impl Output) {
        let (role, route) = (self.role, self.ordered);
        let run_link = match route {
            Route::Serial => &mut *self.at_port,
            Route::Bus => &mut *self.on_bus,
        };
        run_link.done(result, &mut |reply| output.reply(route, role, reply));
    }

    /// Handles a part of another board's reply.
    fn relay(&mut self, from: Role, bytes: &[u8], output: &mut impl Output) {
        for &byte in bytes {
            if let Some(payload) = self.relayed.take_byte(byte) {
                self.at_port
                    .relayed(from, payload, &mut |reply| output.write(reply));
            }
        }
    }

    /// Sends the host log entries of the tick and the next part of the lead node's output. While the previous report
    /// is being sent, no new report starts: entries wait, and a newer output replaces an older one.
    fn report(&mut self, output: &mut impl Output) {
        if !output.is_free() {
            return;
        }
        if self.at_port.wants_telemetry()
            && let Some(telemetry) = self.end.take_telemetry()
        {
            self.at_port.send_telemetry(&telemetry);
        }
        let entries = self.end.take_entries(self.at_port.room());
        self.at_port
            .report(self.end.lost(), &entries, &mut |report| {
                output.write(report)
            });
    }
}
