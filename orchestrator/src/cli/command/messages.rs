//! `matrix messages RUN`: a row for every message of the experiment, from the captures and logs of a run directory.

use std::path::PathBuf;

use clap::Args;
use record::{exit::matrix::Exit, run_directory::RunDirectory};
use reports::messages::{self, MessagesError, ScenarioMessages, TopicMessages};

use crate::cli::{
    command::options::OutputArguments,
    completion,
    run_argument::run_argument,
    terminal::{self, CommandError},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct MessagesArguments {
    /// The run directory.
    #[arg(value_parser = run_argument(), add = completion::runs())]
    run: PathBuf,
    /// Only this scenario: its letter or slug. May be repeated.
    #[arg(long, value_name = "SCENARIO", add = completion::scenarios_of_run())]
    only: Vec<String>,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Reads the captures, writes the tables and prints what they come to.
///
/// # Errors
/// When the run directory, a log or a capture cannot be read, or a table not written.
pub fn execute(arguments: &MessagesArguments) -> Result<Exit, CommandError> {
    let directory = RunDirectory::new(&arguments.run);
    let messages = messages::write_messages(&directory, &arguments.only).map_err(|error| {
        let exit = match error {
            MessagesError::Write(_) => Exit::Infrastructure,
            _ => Exit::Wrong,
        };
        CommandError::new(exit, &error, Some(error.hint()))
    })?;
    if arguments.output.json {
        terminal::json(&messages);
        return Ok(Exit::Done);
    }
    let mut text = format!("messages of {}\n", messages.run);
    messages
        .scenarios
        .iter()
        .for_each(|scenario| print(&mut text, scenario));
    terminal::result(&text);
    Ok(Exit::Done)
}

fn print(text: &mut String, scenario: &ScenarioMessages) {
    let windows: Vec<String> = scenario.windows.iter().map(ToString::to_string).collect();
    text.push_str(&format!(
        "{} {}, windows {}\n",
        scenario.id,
        scenario.slug,
        windows.join(", ")
    ));
    for topic in &scenario.topics {
        text.push_str(&format!("  {}\n", line(topic)));
    }
    for file in &scenario.files {
        text.push_str(&format!("  {}\n", file.display()));
    }
}

fn line(topic: &TopicMessages) -> String {
    let delay = topic.one_way.map_or_else(String::new, |delay| {
        let ms = |ns: f64| ns / 1e6;
        format!(
            ", one way {:.3} ms ({:.3} to {:.3})",
            ms(delay.mean_ns),
            ms(delay.min_ns as f64),
            ms(delay.max_ns as f64)
        )
    });
    let missing = match topic.missing.is_empty() {
        true => String::new(),
        false => format!(
            ", NOT FOUND: {}{}",
            topic
                .missing
                .iter()
                .map(ToString::to_string)
                .collect::<Vec<_>>()
                .join(", "),
            if topic.logged - topic.found > topic.missing.len() as u64 {
                ", …"
            } else {
                ""
            }
        ),
    };
    format!(
        "{:<8} {} of {} in the log found, {} sent, {} arrived{delay}; retransmitted {}, duplicated {}, reordered {}{missing}",
        topic.topic,
        topic.found,
        topic.logged,
        topic.sent,
        topic.arrived,
        topic.retransmitted,
        topic.duplicated,
        topic.reordered,
    )
}
