//! Writer thread of a recording: the run waits only if the queue is full.

use super::log::Mcap;
use super::tables::Tables;
use super::{Line, failed};
use host_sim::base::error::Error;
use host_sim::run::end::RunEnd;
use host_sim::run::robot::Record;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{Builder, JoinHandle};

/// Number of items of a recording per batch; each batch wakes the writer thread.
const BATCH: usize = 256;
/// Number of batches that the queue holds.
const WAITING: usize = 32;

/// Item of a recording.
pub(super) enum Note {
    /// Event of the recording.
    Line(Line),
    /// True state at the end of an epoch.
    Epoch(Box<Record>),
    /// Goal and path of the run.
    Plan([f64; 3], Vec<[f64; 3]>),
}

/// Files of a recording.
pub(super) struct Files {
    pub mcap: Option<Mcap>,
    pub tables: Option<Tables>,
}

impl Files {
    fn take(&mut self, note: &Note) {
        if let Some(mcap) = &mut self.mcap {
            match note {
                Note::Line(line) => mcap.note(line),
                Note::Epoch(record) => mcap.write_epoch(record),
                Note::Plan(goal, path) => mcap.plan(*goal, path),
            }
        }
        if let Some(tables) = &mut self.tables {
            match note {
                Note::Line(line) => tables.note(line),
                Note::Epoch(record) => tables.epoch(record),
                Note::Plan(..) => {}
            }
        }
    }

    /// Completes the files; returns their paths.
    pub fn close(self, end: &RunEnd) -> Result<Vec<PathBuf>, Error> {
        let mut paths = Vec::new();
        if let Some(mut mcap) = self.mcap {
            mcap.close(end)?;
            paths.extend(mcap.path());
        }
        if let Some(tables) = self.tables {
            paths.extend(tables.write(end)?);
        }
        Ok(paths)
    }
}

struct Thread {
    to: SyncSender<Vec<Note>>,
    handle: JoinHandle<Option<Box<Files>>>,
}

impl Thread {
    /// Starts the thread with the files; returns the files if no thread can be started.
    fn start(files: Box<Files>) -> Result<Self, Box<Files>> {
        let (to, notes) = sync_channel::<Vec<Note>>(WAITING);
        let (give, given): (_, Receiver<Box<Files>>) = sync_channel(1);
        let write = move || {
            let mut files = given.recv().ok()?;
            while let Ok(batch) = notes.recv() {
                batch.iter().for_each(|note| files.take(note));
            }
            Some(files)
        };
        match Builder::new().name("log".to_owned()).spawn(write) {
            Ok(handle) => match give.send(files) {
                Ok(()) => Ok(Self { to, handle }),
                Err(back) => Err(back.0),
            },
            Err(_) => Err(files),
        }
    }
}

enum WriterState {
    /// The caller writes: no note was taken yet, or no thread could be started.
    Inline(Box<Files>),
    Threaded(Thread),
    Closed,
}

/// Writes the items of a recording in order. A writer that is dropped before it is closed completes the files as they
/// are.
pub(super) struct Writer {
    state: WriterState,
    /// True once the start of a thread was tried.
    tried: bool,
    batch: Vec<Note>,
    /// True if every epoch is passed on at once, for viewers.
    prompt: bool,
}

impl Writer {
    /// A writer to these files; `prompt` passes every epoch on at once.
    pub fn new(files: Files, prompt: bool) -> Self {
        Self {
            state: WriterState::Inline(Box::new(files)),
            tried: false,
            batch: Vec::new(),
            prompt,
        }
    }

    /// The files; `None` once the writer thread has them.
    pub fn files(&mut self) -> Option<&mut Files> {
        match &mut self.state {
            WriterState::Inline(files) => Some(files),
            WriterState::Threaded(_) | WriterState::Closed => None,
        }
    }

    /// Queues a note for the thread, or writes the note if there is no thread.
    pub fn take(&mut self, note: Note) {
        if !self.tried {
            self.tried = true;
            if let WriterState::Inline(files) =
                std::mem::replace(&mut self.state, WriterState::Closed)
            {
                self.state =
                    Thread::start(files).map_or_else(WriterState::Inline, WriterState::Threaded);
            }
        }
        if let WriterState::Inline(files) = &mut self.state {
            files.take(&note);
            return;
        }
        let now = self.prompt && matches!(note, Note::Epoch(_));
        self.batch.push(note);
        if now || self.batch.len() >= BATCH {
            self.hand_over();
        }
    }

    fn hand_over(&mut self) {
        let batch = std::mem::replace(&mut self.batch, Vec::with_capacity(BATCH));
        if let WriterState::Threaded(thread) = &self.state {
            // A failed thread is reported by `finish`.
            let _ = thread.to.send(batch);
        }
    }

    /// Waits for the writer thread and returns the complete files; `None` if they were already returned.
    pub fn finish(&mut self) -> Result<Option<Box<Files>>, Error> {
        self.hand_over();
        match std::mem::replace(&mut self.state, WriterState::Closed) {
            WriterState::Inline(files) => Ok(Some(files)),
            WriterState::Threaded(Thread { to, handle }) => {
                drop(to);
                let files = handle.join().ok().flatten();
                files
                    .map(Some)
                    .ok_or_else(|| failed("the thread that writes it has failed"))
            }
            WriterState::Closed => Ok(None),
        }
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        // This completes the files; `drop` cannot return an error.
        let _ = self.finish();
    }
}
