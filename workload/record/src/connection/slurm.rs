//! How a Slurm cluster gives a host. The main type is [`Slurm`].

use std::path::{Path, PathBuf};

use serde::{Deserialize, Deserializer, Serialize, de};

use super::Connection;
use crate::quantity::TimeSpan;

/// What a cluster needs to know: which of its nodes are meant, and how it is asked. Each text is handed to `sbatch` as the value
/// of the option of that name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Slurm {
    /// The machine on which `sbatch` is called: `local`, or `{ssh: user@login}`.
    pub submit: Submit,
    /// The features that a node must have, as this site calls them.
    #[serde(deserialize_with = "word_if_any")]
    pub constraint: Option<String>,
    /// The partition; the cluster's default when left out.
    #[serde(deserialize_with = "word_if_any")]
    pub partition: Option<String>,
    /// The account that pays.
    #[serde(deserialize_with = "word_if_any")]
    pub account: Option<String>,
    /// The quality of service.
    #[serde(deserialize_with = "word_if_any")]
    pub qos: Option<String>,
    /// The reservation.
    #[serde(deserialize_with = "word_if_any")]
    pub reservation: Option<String>,
    /// The nodes that may be given.
    #[serde(deserialize_with = "word_if_any")]
    pub nodelist: Option<String>,
    /// The nodes that must not be given.
    #[serde(deserialize_with = "word_if_any")]
    pub exclude: Option<String>,
    /// A folder that the submit host and the nodes see under this name; `matrix`'s state directory on the submit host when left out.
    #[serde(deserialize_with = "absolute_if_any")]
    pub root: Option<PathBuf>,
    /// Which of the fitting nodes measure.
    pub nodes: Nodes,
    /// How many scenarios of this host are measured at the same time.
    pub at_once: u32,
    /// How long a job may wait in the queue.
    pub wait: TimeSpan,
    /// How many environments a scenario may have whose nodes fail or are taken away.
    pub attempts: u32,
    /// How often the cluster is asked at most. One question is for all jobs.
    pub poll: TimeSpan,
    /// After how long the submit host sees at the latest what a node has written to `root`.
    pub visible_within: TimeSpan,
    /// More options of `sbatch`, each as one word: `--mail-type=FAIL`.
    #[serde(deserialize_with = "options")]
    pub options: Vec<String>,
    /// The folder with Slurm's commands on the submit host, where its `PATH` does not have it.
    #[serde(deserialize_with = "absolute_if_any")]
    pub bin: Option<PathBuf>,
}

impl Default for Slurm {
    fn default() -> Self {
        Self {
            submit: Submit::default(),
            constraint: None,
            partition: None,
            account: None,
            qos: None,
            reservation: None,
            nodelist: None,
            exclude: None,
            root: None,
            nodes: Nodes::default(),
            at_once: 1,
            wait: TimeSpan::from_secs(3 * 24 * 60 * 60),
            attempts: 3,
            poll: TimeSpan::from_secs(30),
            visible_within: TimeSpan::from_secs(60),
            options: Vec::new(),
            bin: None,
        }
    }
}

impl Slurm {
    /// The options of `sbatch` that say what is wanted of a cluster, as the file has them. How a job is made, named and ended is
    /// not among them.
    #[must_use]
    pub fn wishes(&self) -> Vec<String> {
        let named = [
            ("constraint", &self.constraint),
            ("partition", &self.partition),
            ("account", &self.account),
            ("qos", &self.qos),
            ("reservation", &self.reservation),
        ];
        let named = named
            .into_iter()
            .filter_map(|(option, value)| Some(format!("--{option}={}", value.as_ref()?)));
        named.chain(self.options.iter().cloned()).collect()
    }
}

/// Which of the nodes that fit measure the scenarios of a host.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Nodes {
    /// One for all scenarios of a run, so that a difference between two of them is none between nodes.
    #[default]
    One,
    /// Whichever is free first.
    Any,
    /// Every one, as a host of its own: each scenario is measured on each node, which is a value of the axis `node`.
    Each,
}

/// The machine on which a cluster's commands are called: this one, or one over SSH.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct Submit(Box<Connection>);

impl Submit {
    /// How it is reached.
    #[must_use]
    pub fn connection(&self) -> &Connection {
        &self.0
    }

    pub(super) fn name_files_from(&mut self, folder: &Path) {
        self.0.name_files_from(folder);
    }
}

impl<'de> Deserialize<'de> for Submit {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match Connection::deserialize(deserializer)? {
            Connection::Slurm(_) => Err(de::Error::custom(
                "jobs are submitted on a machine, not on a cluster: write `local` or `{ssh: user@login}`",
            )),
            connection => Ok(Self(Box::new(connection))),
        }
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Submit {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Submit".into()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let ssh = generator.subschema_for::<super::Ssh>();
        schemars::json_schema!({
            "description": "`local` for this machine, or how to reach the submit host over SSH",
            "anyOf": [{ "const": "local" }, ssh],
        })
    }
}

/// A value of an option is one line, and not long.
const LONGEST: usize = 1000;

fn word(text: String) -> Result<String, String> {
    match text.is_empty() || text.len() > LONGEST || text.chars().any(char::is_control) {
        true => Err(format!(
            "a text of 1 to {LONGEST} bytes in one line belongs here: write what you would write behind the option of `sbatch`, or leave \
             it out"
        )),
        false => Ok(text),
    }
}

fn word_if_any<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<String>, D::Error> {
    let written = Option::<String>::deserialize(deserializer)?;
    written.map(word).transpose().map_err(de::Error::custom)
}

fn absolute_if_any<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<PathBuf>, D::Error> {
    let written = Option::<PathBuf>::deserialize(deserializer)?;
    match written {
        Some(path) if !path.is_absolute() => Err(de::Error::custom(format_args!(
            "`{}` means another folder on each machine: write the whole path, from `/` on",
            path.display()
        ))),
        written => Ok(written),
    }
}

/// Options that `matrix` decides, or that have keys of their own here.
const OURS: [&str; 31] = [
    "account",
    "array",
    "chdir",
    "comment",
    "constraint",
    "dependency",
    "error",
    "exclude",
    "exclusive",
    "export",
    "hold",
    "input",
    "job-name",
    "mem",
    "nodelist",
    "nodes",
    "no-requeue",
    "ntasks",
    "open-mode",
    "output",
    "parsable",
    "partition",
    "qos",
    "quiet",
    "requeue",
    "reservation",
    "signal",
    "test-only",
    "time",
    "wait",
    "wrap",
];

fn options<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    let written = Vec::<String>::deserialize(deserializer)?;
    for option in &written {
        let error = |why: &str| {
            Err(de::Error::custom(format_args!(
                "`{option}` cannot be an option here, {why}"
            )))
        };
        let Some(long) = option.strip_prefix("--") else {
            return error("for it is not in its long form: write it as `--mail-type=FAIL`");
        };
        let name = long.split_once('=').map_or(long, |(name, _)| name);
        let is_name = !name.is_empty()
            && name
                .chars()
                .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-');
        if !is_name || word(option.clone()).is_err() {
            return error("for it is no option of `sbatch`: write it as `--mail-type=FAIL`");
        }
        // `sbatch` takes the beginning of an option's name for the option.
        if let Some(ours) = OURS.iter().find(|ours| ours.starts_with(name)) {
            return error(&format!(
                "for `matrix` decides `--{ours}` itself: leave it out, or see which key of `slurm` it has"
            ));
        }
    }
    Ok(written)
}

#[cfg(test)]
mod tests {
    use rstest::rstest;
    use serde_json::{Value, json};

    use super::*;

    fn read(written: Value) -> Result<Connection, String> {
        serde_json::from_value(written).map_err(|error| error.to_string())
    }

    #[test]
    fn an_empty_section_is_enough_and_every_key_is_read_as_it_is_written() {
        let Ok(Connection::Slurm(slurm)) = read(json!({"slurm": {}})) else {
            panic!("it is no connection")
        };
        assert_eq!(*slurm, Slurm::default());
        let written = json!({"slurm": {
            "submit": {"ssh": "me@login", "identity": "key", "jump": null, "known_hosts": null},
            "constraint": "skylake&avx", "partition": "bench", "account": "robots", "qos": "low", "reservation": "r",
            "nodelist": "n[1-3]", "exclude": "n2", "root": "/scratch/me", "nodes": "any", "at_once": 2, "wait": "2h",
            "attempts": 5, "poll": "1min", "visible_within": "5s", "options": ["--mail-type=FAIL", "--hint=nomultithread"],
            "bin": "/opt/slurm/bin",
        }});
        let connection = read(written.clone()).unwrap();
        let Connection::Slurm(slurm) = &connection else {
            panic!("it is no cluster")
        };
        assert_eq!(
            slurm.wishes(),
            [
                "--constraint=skylake&avx",
                "--partition=bench",
                "--account=robots",
                "--qos=low",
                "--reservation=r",
                "--mail-type=FAIL",
                "--hint=nomultithread"
            ]
        );
        assert_eq!(read(serde_json::to_value(&connection).unwrap()), Ok(connection));
    }

    #[test]
    fn the_submit_hosts_key_is_named_from_the_matrix_files_folder() {
        let mut connection =
            read(json!({"slurm": {"submit": {"ssh": "me@login", "identity": "key"}}})).unwrap();
        connection.name_files_from(Path::new("/lab"));
        let Connection::Slurm(slurm) = connection else {
            panic!("it is no cluster")
        };
        let Connection::Ssh(ssh) = slurm.submit.connection() else {
            panic!("it is not reached over SSH")
        };
        assert_eq!(ssh.identity.as_deref(), Some(Path::new("/lab/key")));
    }

    #[rstest]
    #[case(json!({"slurm": {"submit": {"slurm": {}}}}), "not on a cluster")]
    #[case(json!({"slurm": {"root": "scratch"}}), "from `/` on")]
    #[case(json!({"slurm": {"partition": ""}}), "leave it out")]
    #[case(json!({"slurm": {"constraint": "a\nb"}}), "in one line")]
    #[case(json!({"slurm": {"options": ["-t1"]}}), "long form")]
    #[case(json!({"slurm": {"options": ["--time=1"]}}), "`--time`")]
    #[case(json!({"slurm": {"options": ["--tim=1"]}}), "`--time`")]
    #[case(json!({"slurm": {"options": ["--array=0-9"]}}), "`--array`")]
    #[case(json!({"slurm": {"options": ["--mail user"]}}), "no option")]
    #[case(json!({"slurm": {}, "identity": "key"}), "slurm.submit")]
    #[case(json!({"slurm": {}, "ssh": "me@login"}), "in one way")]
    #[case(json!({"identity": "key"}), "missing field `ssh`")]
    #[case(json!({"slurm": {"nodes": "all"}}), "`each`")]
    fn what_cannot_be_meant_is_refused_with_what_to_write(#[case] written: Value, #[case] says: &str) {
        let error = read(written).unwrap_err();
        assert!(error.contains(says), "{error}");
    }
}
