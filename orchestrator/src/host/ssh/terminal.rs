//! A terminal on a host over SSH, which is `ssh`'s business: it knows terminals, and their sizes. The main function is
//! [`terminal`].

use std::{ffi::OsString, path::Path, process::Command};

use record::connection::{Ssh, SshAddress};

use crate::{escaping::quoted, host::Program};

/// `ssh`, on its way to start a program with our standard input and output, by the way that the matrix file names.
#[must_use]
pub fn terminal(ssh: &Ssh, program: &Program) -> Command {
    let mut command = Command::new("ssh");
    command.args(options(ssh));
    if let Some(jump) = &ssh.jump {
        // `-J` would not hand these options on to the host on the way.
        let through = ["ssh".into()]
            .into_iter()
            .chain(options(ssh))
            .chain(["-W".into(), "%h:%p".into()])
            .chain(place(jump));
        command.arg("-o").arg(format!("ProxyCommand={}", quoted(through)));
    }
    let words = [program.file.clone().into_os_string()]
        .into_iter()
        .chain(program.arguments.iter().cloned());
    command
        // A terminal there if there is one here.
        .arg("-t")
        .args(place(&ssh.address))
        .arg(format!("exec {}", quoted(words)));
    command
}

fn options(ssh: &Ssh) -> Vec<OsString> {
    let mut options = Vec::new();
    if let Some(identity) = &ssh.identity {
        options.extend(["-i".into(), identity.clone().into_os_string()]);
    }
    if let Some(known_hosts) = &ssh.known_hosts {
        options.extend(["-o".into(), option("UserKnownHostsFile", known_hosts)]);
    }
    options
}

fn option(name: &str, value: &Path) -> OsString {
    let mut option = OsString::from(format!("{name}=\""));
    option.push(value);
    option.push("\"");
    option
}

fn place(address: &SshAddress) -> Vec<OsString> {
    let mut words = Vec::new();
    if let Some(port) = address.port {
        words.extend(["-p".into(), port.to_string().into()]);
    }
    let user = address.user.as_ref().map(|user| format!("{user}@"));
    words.push(format!("{}{}", user.unwrap_or_default(), address.host).into());
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(ssh: &Ssh) -> Vec<String> {
        let program = Program::new("sh", ["-c", "cd '/a b'; exec sh"]);
        terminal(ssh, &program)
            .get_args()
            .map(|word| word.to_string_lossy().into_owned())
            .collect()
    }

    fn ssh(address: &str) -> Ssh {
        Ssh {
            address: address.parse().unwrap(),
            identity: None,
            jump: None,
            known_hosts: None,
        }
    }

    #[test]
    fn a_name_of_the_configuration_is_left_to_ssh() {
        let words = words(&ssh("pi"));
        assert_eq!(words, ["-t", "pi", r"exec 'sh' '-c' 'cd '\''/a b'\''; exec sh'"]);
    }

    #[test]
    fn what_the_matrix_file_names_goes_for_the_host_on_the_way_too() {
        let ssh = Ssh {
            identity: Some("/k".into()),
            known_hosts: Some("/known hosts".into()),
            jump: Some("gate:2222".parse().unwrap()),
            ..ssh("me@pi:22")
        };
        let words = words(&ssh);
        assert_eq!(
            words.get(..10).unwrap(),
            [
                "-i",
                "/k",
                "-o",
                "UserKnownHostsFile=\"/known hosts\"",
                "-o",
                "ProxyCommand='ssh' '-i' '/k' '-o' 'UserKnownHostsFile=\"/known hosts\"' '-W' '%h:%p' '-p' '2222' 'gate'",
                "-t",
                "-p",
                "22",
                "me@pi",
            ]
        );
    }
}
