//! `cfmmr world`: the true robot and its surroundings, each figure with its unit and reason.

use clap::Args;
use host_sim::base::error::Error;
use host_sim::world;
use host_sim::world::{Figure, NAMES};
use output::table::Table;
use output::terminal;
use serde::Serialize;

/// Arguments of `world`.
#[derive(Clone, Debug, Args)]
pub struct WorldArgs {
    /// World: a name or a TOML file [default: list the names]
    pub name: Option<String>,
    /// Print the world as JSON
    #[arg(long, requires = "name")]
    pub json: bool,
    /// Print the file of the world, as a template for a new world
    #[arg(long, requires = "name", conflicts_with = "json")]
    pub toml: bool,
}

/// Content of the JSON file.
#[derive(Serialize)]
struct Printed<'a> {
    world: &'a str,
    figures: Vec<Figure>,
}

/// Prints a world, or the names of the built-in worlds.
pub fn run(args: &WorldArgs) -> Result<(), Error> {
    let Some(name) = &args.name else {
        return terminal::print(&(NAMES.join("\n") + "\n"));
    };
    if args.toml {
        world::World::load(name)?;
        return terminal::print(&world::text(name)?);
    }
    let figures = world::figures(name)?;
    if args.json {
        let printed = Printed {
            world: name,
            figures,
        };
        let json = serde_json::to_string_pretty(&printed);
        return terminal::print(&(json.map_err(|error| Error::Failure(error.to_string()))? + "\n"));
    }
    let mut table = Table::new(["figure", "value", "unit", "reason"]).left_aligned();
    for (k, figure) in figures.iter().enumerate() {
        if k > 0 && figure.base != figures[k - 1].base {
            table.rule();
        }
        table.row([
            figure.key.clone(),
            figure.value.to_string(),
            figure.unit.to_owned(),
            figure.reason.clone(),
        ]);
    }
    terminal::print(&format!(
        "World {name}. Keys of spread and keys with sigma: standard deviation of a value drawn in each trial. Below \
         the line: base values.\n\n{table}"
    ))
}
