//! Short calls: a program that reads something, answers and ends. The function is [`output`]; [`answer`] is for what is
//! started in another way.

use std::{future::Future, io, time::Duration};

use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::{
        UnixStream,
        unix::{OwnedReadHalf, OwnedWriteHalf},
    },
};

use super::{Exit, Host, HostError, Program, RunningProgram};

/// An answer is kilobytes; a list of thousands of environments a megabyte.
const LONGEST_ANSWER: u64 = 16 << 20;

/// Starts a program, gives it `input` and waits until it has ended: how, and what it wrote to its standard output.
///
/// # Errors
/// When the host cannot be reached or refuses, and when the program has not ended after `timeout` or says far too much.
pub async fn output(
    host: &dyn Host,
    program: &Program,
    input: &[u8],
    timeout: Duration,
) -> Result<(Exit, Vec<u8>), HostError> {
    let action = format!("running {}", program.file.display());
    answer(host.name(), &action, host.start(program), input, timeout).await
}

/// Gives a program `input` once it is started, and waits until it has ended.
///
/// # Errors
/// As [`output`].
pub(super) async fn answer(
    host: &str,
    action: &str,
    starting: impl Future<Output = Result<RunningProgram, HostError>>,
    input: &[u8],
    timeout: Duration,
) -> Result<(Exit, Vec<u8>), HostError> {
    let running = async {
        let running = starting.await?;
        let answer = talk(running.stream, input)
            .await
            .map_err(|source| HostError::Refused {
                host: host.to_owned(),
                action: action.to_owned(),
                hint: None,
                source: source.into(),
            })?;
        Ok((running.end.wait().await?, answer))
    };
    tokio::time::timeout(timeout, running)
        .await
        .map_err(|_| HostError::TimedOut {
            host: host.to_owned(),
            action: action.to_owned(),
            after: timeout,
        })?
}

/// Both at once: a program may answer before it has read everything.
async fn talk(stream: UnixStream, input: &[u8]) -> io::Result<Vec<u8>> {
    let (reading, writing) = stream.into_split();
    tokio::try_join!(listen(reading), say(writing, input)).map(|(answer, ())| answer)
}

async fn say(mut writing: OwnedWriteHalf, input: &[u8]) -> io::Result<()> {
    let said = async {
        writing.write_all(input).await?;
        writing.shutdown().await
    };
    or_gone(said.await)
}

async fn listen(reading: OwnedReadHalf) -> io::Result<Vec<u8>> {
    let mut answer = Vec::new();
    or_gone(
        reading
            .take(LONGEST_ANSWER + 1)
            .read_to_end(&mut answer)
            .await
            .map(drop),
    )?;
    match answer.len() as u64 > LONGEST_ANSWER {
        true => Err(io::Error::other(format!(
            "it says more than {LONGEST_ANSWER} bytes"
        ))),
        false => Ok(answer),
    }
}

/// A program need not read what it is told: that it is gone is for its exit code to explain.
fn or_gone(talked: io::Result<()>) -> io::Result<()> {
    match talked {
        Err(error)
            if matches!(
                error.kind(),
                io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionReset | io::ErrorKind::NotConnected
            ) =>
        {
            Ok(())
        }
        talked => talked,
    }
}
