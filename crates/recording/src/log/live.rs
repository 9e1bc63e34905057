//! Websocket server of a running run: the topics of a log for viewers such as Foxglove.

use super::gate::{Gate, hidden_address};
use foxglove::websocket::{Capability, ChannelView, Client, ServerListener};
use foxglove::{ChannelId, Context, SinkId, WebSocketServer, WebSocketServerHandle};
use host_sim::base::error::Error;
use output::terminal::note;
use std::fmt::Display;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::Duration;
use std::{mem, thread};

/// Polling interval while waiting for a viewer.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Timeout at the end of a run for viewers to take the queued messages.
const STOP_TIMEOUT: Duration = Duration::from_secs(2);

/// Subscriptions since the last call of [`Server::joined`], and true once a viewer has subscribed.
#[derive(Default)]
struct Viewers {
    joined: Mutex<Vec<(ChannelId, SinkId)>>,
    came: AtomicBool,
}

impl ServerListener for Viewers {
    fn on_subscribe(&self, client: Client, channel: ChannelView) {
        let mut joined = self.joined.lock().unwrap_or_else(PoisonError::into_inner);
        joined.extend(client.sink_id().map(|viewer| (channel.id(), viewer)));
        self.came.store(true, Relaxed);
    }
}

/// Websocket server of all channels of a Foxglove context.
pub struct Server {
    handle: WebSocketServerHandle,
    viewers: Arc<Viewers>,
    gate: Gate,
}

impl Server {
    /// Starts the server; port 0 selects a free port. Web pages of other machines may connect only from `origins`.
    pub fn start(
        context: &Arc<Context>,
        address: SocketAddr,
        origins: Vec<String>,
    ) -> Result<Self, Error> {
        let refuse = |error: &dyn Display| {
            Error::input(format!(
                "--live {address}: {error}: must be an address of this machine with a free port"
            ))
        };
        let hidden = hidden_address();
        let viewers = Arc::new(Viewers::default());
        let handle = WebSocketServer::new()
            .name("cfmmr")
            .context(context)
            .bind(hidden.to_string(), 0)
            .capabilities([Capability::Time])
            .listener(viewers.clone())
            .start_blocking()
            .map_err(|error| refuse(&error))?;
        let inner = SocketAddr::new(hidden.into(), handle.port());
        let gate = Gate::open(address, inner, origins).map_err(|error| refuse(&error))?;
        Ok(Self {
            handle,
            viewers,
            gate,
        })
    }

    /// Reports the address and waits for a viewer; an error if `interrupt` is set meanwhile.
    pub fn await_viewer(&self, interrupt: &AtomicBool) -> Result<(), Error> {
        note(format!(
            "live: ws://{}, waiting for a viewer (Foxglove: Open connection, Foxglove WebSocket)",
            self.gate.address()
        ));
        while !self.viewers.came.load(Relaxed) {
            if interrupt.load(Relaxed) {
                return Err(Error::Interrupted(
                    "interrupted before a viewer connected".to_owned(),
                ));
            }
            thread::sleep(POLL_INTERVAL);
        }
        Ok(())
    }

    /// Sends viewers the simulated time, ns.
    pub fn time(&self, nanos: u64) {
        self.handle.broadcast_time(nanos);
    }

    /// Subscriptions since the last call: channel and viewer.
    pub fn joined(&self) -> Vec<(ChannelId, SinkId)> {
        let joined = self.viewers.joined.lock();
        mem::take(&mut *joined.unwrap_or_else(PoisonError::into_inner))
    }

    /// Sends the queued messages and ends, within [`STOP_TIMEOUT`] even if a viewer takes nothing.
    pub fn stop(self) {
        let (ended, end) = mpsc::channel();
        let handle = self.handle;
        drop(self.gate);
        thread::spawn(move || {
            handle.stop().wait_blocking();
            // The send fails if `stop` has already timed out.
            let _ = ended.send(());
        });
        let _ = end.recv_timeout(STOP_TIMEOUT);
    }
}
