//! What Vagrant prints with `--machine-readable`: lines of a time, a machine, a kind and data, with commas and line ends
//! written otherwise (Vagrant's documentation, "Machine Readable Output"). The main type is [`Line`].

/// One line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Line {
    /// What it is: `state`, `ui`, `error-exit`, …
    pub kind: String,
    /// What it says.
    pub data: Vec<String>,
}

/// Why Vagrant gave up.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{words}")]
pub struct VagrantFailure {
    /// The class of its error, such as `Vagrant::Errors::VMBootBadState`; empty where it does not say.
    pub class: String,
    /// Its own words, in one line.
    pub words: String,
}

/// The lines of what was printed. What is none, such as a warning of Ruby's, is left out.
#[must_use]
pub fn read(printed: &str) -> Vec<Line> {
    printed.lines().filter_map(line).collect()
}

fn line(text: &str) -> Option<Line> {
    let mut fields = text.split(',');
    let time = fields.next()?;
    if time.is_empty() || !time.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let _machine = fields.next()?;
    Some(Line {
        kind: fields.next()?.to_owned(),
        data: fields.map(plain).collect(),
    })
}

/// As it was before it was written for machines.
fn plain(field: &str) -> String {
    field
        .replace("%!(VAGRANT_COMMA)", ",")
        .replace("\\n", "\n")
        .replace("\\r", "")
}

/// The first data of the first line of a kind.
#[must_use]
pub fn value<'a>(lines: &'a [Line], kind: &str) -> Option<&'a str> {
    lines
        .iter()
        .find(|line| line.kind == kind)
        .and_then(|line| line.data.first())
        .map(String::as_str)
}

/// Why a call failed, from what it printed and from its standard error.
#[must_use]
pub fn failure(printed: &str, errors: &str) -> VagrantFailure {
    let lines = read(printed);
    let of = |line: &Line, words: usize, class: &str| VagrantFailure {
        class: class.to_owned(),
        words: one_line(line.data.get(words).map_or("", String::as_str)),
    };
    if let Some(line) = lines.iter().find(|line| line.kind == "error-exit") {
        return of(line, 1, line.data.first().map_or("", String::as_str));
    }
    let said = |line: &&Line| line.kind == "ui" && line.data.first().is_some_and(|level| level == "error");
    if let Some(line) = lines.iter().find(said) {
        return of(line, 1, "");
    }
    // A crash of Ruby's: its last lines are where it was, its first what it was.
    let first = errors.lines().find(|line| !line.trim().is_empty());
    VagrantFailure {
        class: String::new(),
        words: one_line(first.unwrap_or("it does not say why")),
    }
}

fn one_line(words: &str) -> String {
    words.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As Vagrant 2.3.4 printed them.
    const STATUS: &str = "\
1795272478,machine,metadata,provider,libvirt
1795272479,machine,provider-name,libvirt
1795272479,machine,state,running
1795272479,machine,state-human-long,The Libvirt domain is running. To stop this machine%!(VAGRANT_COMMA) you can run\\n`vagrant halt`.
";
    const FAILED: &str = "\
1795272478,machine,ui,info,Bringing machine up
1795272478,,error-exit,Vagrant::Errors::MachineLocked,An action 'up' was attempted on the machine 'machine'%!(VAGRANT_COMMA)\\nbut another process is already executing an action on the machine.
";

    #[test]
    fn lines_are_read_with_their_commas_and_line_ends() {
        let lines = read(STATUS);
        assert_eq!(lines.len(), 4);
        assert_eq!(value(&lines, "state"), Some("running"));
        let long = value(&lines, "state-human-long").unwrap();
        assert!(
            long.contains("this machine, you can run\n`vagrant halt`"),
            "{long}"
        );
        assert_eq!(value(&lines, "box-name"), None);
    }

    #[test]
    fn what_ruby_says_in_between_is_no_line() {
        assert_eq!(read("/usr/lib/ruby: warning, this, that\n\n,,,\n"), []);
    }

    #[test]
    fn a_failure_has_its_class_and_its_words() {
        assert_eq!(
            failure(FAILED, ""),
            VagrantFailure {
                class: "Vagrant::Errors::MachineLocked".to_owned(),
                words:
                    "An action 'up' was attempted on the machine 'machine', but another process is already \
                        executing an action on the machine."
                        .to_owned(),
            }
        );
        let told = "1795272478,,ui,error,There are errors in the\\nconfiguration\n";
        assert_eq!(failure(told, "").words, "There are errors in the configuration");
        assert_eq!(
            failure("", "\nuninitialized constant X\n at y\n").words,
            "uninitialized constant X"
        );
        assert_eq!(failure("", "").words, "it does not say why");
    }
}
