//! Being let in: by a key of the agent's, or by one of a file. Never by a password. The main function is [`log_in`].

use std::path::Path;

use ssh2::Session;

use super::{SshError, hop::Hop, small_file};

/// An sshd ends the connection after six keys that it does not know (`MaxAuthTries`): some are left for the files.
const AGENT_KEYS: usize = 4;

/// How an OpenSSH private key begins whose cipher is `none`: `openssh-key-v1`, a NUL, the length 4 and `no`, in base64.
const NOT_ENCRYPTED: &str = "b3BlbnNzaC1rZXktdjEAAAAABG5v";

/// Logs in on a session whose host's key was checked.
///
/// # Errors
/// When no key is taken; says which were tried.
pub fn log_in(session: &Session, hop: &Hop) -> Result<(), SshError> {
    let mut tried = Vec::new();
    let mut encrypted = Vec::new();
    if let Some(agent) = &hop.agent {
        match ask_agent(session, hop, agent) {
            Ok(None) => return Ok(()),
            Ok(Some(number)) => tried.push(format!("{number} keys of the agent")),
            Err(error) => tried.push(format!("the agent, which failed ({})", error.message())),
        }
    }
    for identity in &hop.identities {
        let what = identity.display();
        match small_file::read(identity) {
            Err(error) => {
                tried.push(format!("{what}, which cannot be read ({error})"));
                continue;
            }
            Ok(key) if is_encrypted(&String::from_utf8_lossy(&key)) => {
                tried.push(format!("{what}, which has a passphrase"));
                encrypted.push(identity.clone());
                continue;
            }
            Ok(_) => {}
        }
        match session.userauth_pubkey_file(&hop.user, None, identity, None) {
            Ok(()) => return Ok(()),
            Err(error) => tried.push(format!("{what} ({})", error.message())),
        }
    }
    Err(SshError::NotLetIn {
        place: hop.place(),
        user: hop.user.clone(),
        tried,
        encrypted,
    })
}

/// How many keys were tried; none when one was taken.
fn ask_agent(session: &Session, hop: &Hop, socket: &Path) -> Result<Option<usize>, ssh2::Error> {
    let mut agent = session.agent()?;
    agent.set_identity_path(socket)?;
    agent.connect()?;
    agent.list_identities()?;
    let keys = agent.identities()?;
    for key in keys.iter().take(AGENT_KEYS) {
        if agent.userauth(&hop.user, key).is_ok() {
            return Ok(None);
        }
    }
    Ok(Some(keys.len().min(AGENT_KEYS)))
}

/// Whether a private key can be used only with a passphrase. PEM says so in words, OpenSSH's own format in its cipher.
fn is_encrypted(key: &str) -> bool {
    let mut lines = key.lines().map(str::trim);
    if lines.any(|line| line == "-----BEGIN OPENSSH PRIVATE KEY-----") {
        return !lines.next().is_some_and(|line| line.starts_with(NOT_ENCRYPTED));
    }
    key.contains("ENCRYPTED")
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;
    use crate::workload_binary::start;

    #[rstest::rstest]
    #[case(&["-t", "ed25519"], "", false)]
    #[case(&["-t", "ed25519"], "secret", true)]
    #[case(&["-t", "ecdsa"], "secret", true)]
    #[case(&["-t", "rsa", "-m", "PEM"], "", false)]
    #[case(&["-t", "rsa", "-m", "PEM"], "secret", true)]
    #[case(&["-t", "rsa", "-m", "PKCS8"], "secret", true)]
    fn a_key_with_a_passphrase_is_recognised(
        #[case] kind: &[&str],
        #[case] passphrase: &str,
        #[case] is: bool,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("key");
        let mut keygen = Command::new("ssh-keygen");
        keygen.args(["-q", "-N", passphrase, "-f"]).arg(&file).args(kind);
        assert!(start(|| keygen.status()).unwrap().success());
        assert_eq!(is_encrypted(&std::fs::read_to_string(file).unwrap()), is);
    }
}
