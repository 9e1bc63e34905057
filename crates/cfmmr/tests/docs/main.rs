//! Compares the pages of the documentation with the program and the repository: links, files, names and commands.

mod commands;
mod pages;
mod references;
