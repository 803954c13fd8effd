//! A command of a program, as a value: its name, its flags, and the function that runs it. A program's help, the
//! completions of shells, man pages and the parser are all made from the list of its commands.

use clap::{ArgMatches, Args, FromArgMatches, Subcommand};
use murmurate::registry::Registry;

use super::{Ended, Logging};

/// Function that runs a command with arguments that were parsed before.
pub type Run = Box<dyn FnOnce(&Registry) -> anyhow::Result<Ended>>;

/// Function that reads the arguments that the parser has found, and returns the one that runs the command with them.
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
        Command::new(name, A::augment_args, run)
    }

    /// Returns a command with the subcommands `A`, whose doc comment is its help. It logs errors alone.
    pub fn with_subcommands<A: Subcommand + 'static>(
        name: &'static str,
        run: fn(&A, &Registry) -> anyhow::Result<Ended>,
    ) -> Command {
        let define = |command| A::augment_subcommands(command).subcommand_required(true).arg_required_else_help(true);
        Command::new(name, define, run)
    }

    fn new<A: FromArgMatches + 'static>(
        name: &'static str,
        define: fn(clap::Command) -> clap::Command,
        run: fn(&A, &Registry) -> anyhow::Result<Ended>,
    ) -> Command {
        let read: Reader = Box::new(move |found| {
            let args = A::from_arg_matches(found)?;
            Ok(Box::new(move |registry| run(&args, registry)))
        });
        Command { name, define, read, logging: Logging::Errors }
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

    /// Reads the arguments that the parser has found. Returns the function that runs the command with them, and the
    /// level and the way of the command's log.
    pub(crate) fn read(&self, found: &ArgMatches) -> Result<(Run, Logging), clap::Error> {
        Ok(((self.read)(found)?, self.logging))
    }
}
