//! Parameters of a board behind a link; see [`core_algos::link::stored_parameters`].

use crate::board::Remote;
use crate::board::refused;
use core_algos::link::protocol::{Refusal, Reply, Request};
use core_algos::params::{COUNT, Parameter, Source, TABLE, fingerprint};
use host_sim::base::error::Error;
use host_sim::scenario::board_parameters::Values;
use host_sim::targets::Fault;
use host_sim::targets::boards::fatal;
use output::terminal::note;

/// One parameter of a board, with its value and the source of the value.
#[derive(Clone, Copy, Debug)]
pub struct BoardParameter {
    /// Name, unit and range of the parameter, from the parameter table.
    pub parameter: &'static Parameter,
    /// Present value of the parameter on the board.
    pub value: f32,
    /// Source of the value at the start of the board or at its latest save.
    pub source: Source,
    /// True if the board still has this value after a reset.
    pub saved: bool,
}

impl BoardParameter {
    /// True if the value is the board's own: read from the store, or set but not saved.
    pub fn is_own(&self) -> bool {
        self.source == Source::Stored || !self.saved
    }
}

impl Remote {
    /// Starts a session with the board, in which its parameters can be read and set.
    pub fn start_session(&mut self) -> Result<(), Error> {
        let name = self.name;
        self.open_session().map_err(|fault| fatal(name, fault))
    }

    /// All parameters of the board, in the order of the table.
    pub fn parameters(&mut self) -> Result<Vec<BoardParameter>, Error> {
        let name = self.name;
        self.request_parameters()
            .map_err(|fault| fatal(name, fault))
    }

    /// Parameters with a value of their own on the board ([`BoardParameter::is_own`]).
    pub fn own_parameters(&mut self) -> Result<Values, Error> {
        let parameters = self.parameters()?;
        let own = parameters.iter().filter(|parameter| parameter.is_own());
        Ok(own.map(|own| (own.parameter, own.value)).collect())
    }

    /// Sets a parameter until the board is reset or its parameters are saved.
    pub fn set_parameter(&mut self, parameter: &Parameter, value: f32) -> Result<(), Error> {
        let name = self.name;
        let place = TABLE.iter().position(|other| other.id == parameter.id);
        let index = place.unwrap_or(COUNT) as u8;
        let set = self.execute("the value", &Request::SetParameter { index, value });
        set.map_err(|fault| fatal(name, fault))
    }

    /// Saves the parameters; returns the number of values written.
    pub fn save_parameters(&mut self) -> Result<u8, Error> {
        let name = self.name;
        self.request_save().map_err(|fault| fatal(name, fault))
    }

    fn request_save(&mut self) -> Result<u8, Fault> {
        let name = self.name;
        self.channel.send_request(&Request::SaveParameters)?;
        match self.channel.receive_reply()? {
            Reply::Saved { values } => Ok(values),
            // Each value is in range, but together they make no valid node: an error of the user's input.
            Reply::Refused(Refusal::Parameter { text }) => Err(Fault::Fatal(Error::input(
                format!("{name} board: not saved: {text}"),
            ))),
            other => Err(refused(name, "to save", other)),
        }
    }

    fn request_parameters(&mut self) -> Result<Vec<BoardParameter>, Fault> {
        let name = self.name;
        self.channel.send_request(&Request::Parameters)?;
        let (table, count, unusable) = match self.channel.receive_reply()? {
            Reply::Parameters {
                table,
                count,
                unusable,
            } => (table, count, unusable),
            other => return Err(refused(name, "its parameters", other)),
        };
        if (table, usize::from(count)) != (fingerprint(), COUNT) {
            return Err(Fault::Fatal(Error::Failure(format!(
                "{name} board: its table of parameters ({count}, hash {table:08x}) differs from this program \
                 ({COUNT}, hash {:08x}): flash the image of this version",
                fingerprint()
            ))));
        }
        if unusable {
            note(format!(
                "{name} board: the stored parameters form no valid configuration; the board uses the defaults"
            ));
        }
        let mut all = Vec::with_capacity(COUNT);
        for (index, parameter) in (0..).zip(&TABLE) {
            self.channel.send_request(&Request::Parameter { index })?;
            match self.channel.receive_reply()? {
                Reply::Parameter {
                    value,
                    source,
                    saved,
                } => all.push(BoardParameter {
                    parameter,
                    value,
                    source,
                    saved,
                }),
                other => return Err(refused(name, "a parameter", other)),
            }
        }
        Ok(all)
    }
}
