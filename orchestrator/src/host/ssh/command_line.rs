//! What a host's shell is asked to do. The main functions are [`of_program`] and [`of_script`].
//!
//! sshd hands a command to the login shell of the user, so that each word is quoted for a POSIX shell, which reads none
//! of them. The shell is replaced by the program: who looks for the program finds it, and it gets the signals.

use std::{ffi::OsStr, os::unix::ffi::OsStrExt as _};

use crate::{escaping::push_quoted, host::Program};

/// Why a program cannot be started over SSH.
#[derive(Debug, thiserror::Error)]
pub enum CommandLineError {
    /// The library takes text only.
    #[error("`{0}` is not UTF-8")]
    NotText(String),
    /// `env` would take the file for a variable.
    #[error("`{0}` has a `=` in it")]
    Variable(String),
}

/// The line that starts a program in `/`, with nothing of the surroundings but `PATH` and `HOME`. On macOS what people
/// install is not in the `PATH` of a shell that is no login shell.
///
/// # Errors
/// When there is no line for it.
pub fn of_program(program: &Program) -> Result<String, CommandLineError> {
    let file = text(program.file.as_os_str())?;
    if file.contains('=') {
        return Err(CommandLineError::Variable(file.to_owned()));
    }
    let mut line =
        r#"cd / && exec env -i PATH="$PATH:/usr/local/bin:/opt/homebrew/bin" HOME="$HOME""#.to_owned();
    push_quoted(&mut line, file);
    for argument in &program.arguments {
        push_quoted(&mut line, text(argument)?);
    }
    Ok(line)
}

/// The line that has a shell read a script, with these as `$1`, `$2`, …, and all the surroundings that a login has.
#[must_use]
pub fn of_script(script: &str, arguments: &[&str]) -> String {
    let mut line = "exec sh -c".to_owned();
    push_quoted(&mut line, script);
    line.push_str(" sh");
    for argument in arguments {
        push_quoted(&mut line, argument);
    }
    line
}

fn text(word: &OsStr) -> Result<&str, CommandLineError> {
    std::str::from_utf8(word.as_bytes())
        .map_err(|_| CommandLineError::NotText(word.to_string_lossy().into_owned()))
}

#[cfg(test)]
mod tests {
    use std::{ffi::OsString, os::unix::ffi::OsStringExt as _, process::Command};

    use super::*;
    use crate::workload_binary::start;

    #[rstest::rstest]
    #[case::nothing("")]
    #[case::words("two  words ")]
    #[case::a_quote("it's '' \"it\"")]
    #[case::expansions("$HOME `id` $(id) ${x} ~ * ? [a-z] {a,b} !! #")]
    #[case::separators("a;b|c&d>e<f\\g\nh\ti\r")]
    #[case::an_option("-n")]
    #[case::not_ascii("plaça ∆ 🦀")]
    fn a_shell_hands_every_word_on_as_it_is(#[case] word: &str) {
        let program = Program::new("printf", [r"%s\0%s", word, word]);
        for shell in ["sh", "bash"] {
            let line = of_program(&program).unwrap();
            let output = start(|| Command::new(shell).args(["-c", &line]).output()).unwrap();
            assert_eq!(
                String::from_utf8_lossy(&output.stdout),
                format!("{word}\0{word}"),
                "{shell}"
            );
        }
        let line = of_script(r#"printf "%s\0%s" "$1" "$2""#, &[word, word]);
        let output = start(|| Command::new("sh").args(["-c", &line]).output()).unwrap();
        assert_eq!(String::from_utf8_lossy(&output.stdout), format!("{word}\0{word}"));
    }

    #[test]
    fn what_no_line_can_say_is_refused() {
        let not_text = Program::new("echo", [OsString::from_vec(vec![0xff])]);
        assert!(matches!(of_program(&not_text), Err(CommandLineError::NotText(_))));
        let variable = Program::new("/opt/a=b/echo", ["x"]);
        assert!(matches!(
            of_program(&variable),
            Err(CommandLineError::Variable(_))
        ));
    }
}
