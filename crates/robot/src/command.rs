//! A command of a program, as a value: its name, its flags, and the function that runs it. A program's help, the
//! completions of shells, man pages and the parser are all made from the list of its commands.

use clap::{ArgMatches, Args, FromArgMatches, Subcommand};
use murmurate::registry::Registry;

use super::{Ended, Logging};

/// What a command does once its arguments are read.
pub type Run = Box<dyn FnOnce(&Registry) -> anyhow::Result<Ended>>;

/// Reads the arguments that the parser has found. Returns what then runs.
type Reader = Box<dyn Fn(&ArgMatches) -> Result<Run, clap::Error>>;

/// One command.
pub struct Command {
    /// Word that selects it.
    name: &'static str,
    /// Adds its help and its flags to a definition.
    define: fn(clap::Command) -> clap::Command,
    read: Reader,
    logging: Logging,
}

impl Command {
    /// Returns a command with the flags `A`, whose doc comment is its help. It logs errors alone.
    pub fn of<A: Args + 'static>(name: &'static str, run: fn(&A, &Registry) -> anyhow::Result<Ended>) -> Command {
        Command { name, define: A::augment_args, read: reader(run), logging: Logging::Errors }
    }

    /// Returns a command with the subcommands `A`, whose doc comment is its help. It logs errors alone.
    pub fn with_subcommands<A: Subcommand + 'static>(
        name: &'static str,
        run: fn(&A, &Registry) -> anyhow::Result<Ended>,
    ) -> Command {
        let define = |command| A::augment_subcommands(command).subcommand_required(true).arg_required_else_help(true);
        Command { name, define, read: reader(run), logging: Logging::Errors }
    }

    /// Returns the command with this level and way of its log.
    pub fn logging(self, logging: Logging) -> Command {
        Command { logging, ..self }
    }

    /// Returns its name.
    pub(crate) fn name(&self) -> &'static str {
        self.name
    }

    /// Returns its definition for the parser.
    pub(crate) fn definition(&self) -> clap::Command {
        (self.define)(clap::Command::new(self.name))
    }

    /// Reads the arguments that the parser has found. Returns what then runs, and the level and the way of its log.
    pub(crate) fn read(&self, found: &ArgMatches) -> Result<(Run, Logging), clap::Error> {
        Ok(((self.read)(found)?, self.logging))
    }
}

fn reader<A: FromArgMatches + 'static>(run: fn(&A, &Registry) -> anyhow::Result<Ended>) -> Reader {
    Box::new(move |found| {
        let args = A::from_arg_matches(found)?;
        Ok(Box::new(move |registry: &Registry| run(&args, registry)) as Run)
    })
}
