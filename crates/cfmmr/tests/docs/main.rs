//! The pages of the documentation against the program and the repository: links, files, names and
//! commands.

mod commands;
mod pages;
mod references;
