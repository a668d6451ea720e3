//! What is in a run directory against what its journal says, before a run goes on: a disk that lost power, a copy that was
//! restored and a person can make the two differ. The main function is [`inspect`].
//!
//! A window that is whole and belongs there counts, whether or not the journal knows of it. One that the journal knows and that
//! is not whole any more is kept aside and measured again, or collected again where its environment still is. Nothing is
//! mended and nothing is thrown away.

use std::ops::RangeInclusive;

use record::run_directory::{Event, RunDirectory, ScenarioState, ensure_window_is_whole, read_window};

use super::collection::{CollectionError, failed, keep, put_aside, record_sha256};

/// What the journal has to be told of some of a scenario's windows, done already where something had to be put aside.
///
/// # Errors
/// When a window cannot be read, so that nobody knows, or a broken one not be put aside.
pub fn inspect(
    directory: &RunDirectory,
    run: &str,
    slug: &str,
    windows: RangeInclusive<u32>,
    state: &ScenarioState,
) -> Result<Vec<Event>, CollectionError> {
    let mut events = Vec::new();
    for window in windows {
        let place = directory.window(slug, window);
        let known = state.collected.get(&window);
        let is_there = place.kind().map_err(failed("cannot look for", &place))?;
        if is_there.is_none() {
            events.extend(known.map(|known| Event::WindowBroken {
                scenario: slug.to_owned(),
                environment: known.environment.clone(),
                window,
                reason: "it is not in the run directory any more".to_owned(),
            }));
            continue;
        }
        let known_environment = known.map(|known| &known.environment);
        let known_sha256 = known.and_then(|known| known.sha256.as_deref());
        let environment = read_window(&place, None).ok().map(|record| record.environment);
        // What the journal knows is believed, whatever its environment is called.
        let foreign = environment
            .as_ref()
            .filter(|environment| known_environment != Some(*environment) && !is_of(run, slug, environment));
        let verified = match (foreign, ensure_window_is_whole(&place, window, known_sha256)) {
            (Some(environment), _) => Err(format!(
                "it is of the environment {environment}, which this scenario never had"
            )),
            (None, Ok(record)) => Ok(record.verdict),
            (None, Err(not_whole)) => Err(not_whole.known_reason().map_err(failed("cannot read", &place))?),
        };
        match (verified, known) {
            (Ok(_), Some(_)) => {}
            (Ok(verdict), None) => {
                keep(&place)?;
                events.push(Event::WindowCollected {
                    scenario: slug.to_owned(),
                    environment: environment.unwrap_or_default(),
                    window,
                    verdict,
                    sha256: Some(record_sha256(&place)?),
                });
            }
            (Err(reason), _) => {
                let environment = known_environment
                    .cloned()
                    .or(environment)
                    .unwrap_or_else(|| "unknown".to_owned());
                put_aside(directory, slug, &environment, window, &place)?;
                events.push(Event::WindowBroken {
                    scenario: slug.to_owned(),
                    environment,
                    window,
                    reason: format!("it was in its place, and {reason}"),
                });
            }
        }
    }
    Ok(events)
}

/// Whether an environment has the name that this scenario's have.
fn is_of(run: &str, slug: &str, environment: &str) -> bool {
    let number = environment.strip_prefix(&format!("matrix-{run}-{slug}-"));
    number.is_some_and(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
}
