//! `matrix ci-generate FILE`: a pipeline of GitLab or GitHub with a job for each scenario, and one that makes a report of them all.

use std::{collections::BTreeMap, path::PathBuf};

use clap::{Args, ValueEnum};
use record::{
    exit::matrix::Exit,
    run_directory::{PlanRecord, PlannedScenario},
};
use serde::{Serialize, Serializer};

use crate::{
    cli::{
        command::options::SelectionArguments,
        terminal::{self, CommandError},
    },
    escaping, preparation,
    provider::Catalogue,
};

/// GitHub ends a job on one of its own machines after so many minutes.
const HOSTED_MINUTES: u64 = 360;
/// What goes before the windows and after them, in minutes.
const AROUND_MINUTES: u64 = 30;
/// Where the jobs leave their runs.
const RUNS: &str = "runs";

/// What it takes.
#[derive(Debug, Args)]
pub struct CiGenerateArguments {
    /// The matrix file, by its path in the repository.
    file: PathBuf,
    /// Whose pipeline.
    #[arg(long = "for", value_enum, value_name = "SYSTEM")]
    system: System,
    #[command(flatten)]
    selection: SelectionArguments,
}

/// Who runs pipelines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum System {
    /// GitLab CI: `.gitlab-ci.yml`.
    Gitlab,
    /// GitHub Actions: a file in `.github/workflows`.
    Github,
}

/// Prints it. Reaches no host.
///
/// # Errors
/// All that is wrong with the file.
pub fn execute(arguments: &CiGenerateArguments, catalogue: Catalogue) -> Result<Exit, CommandError> {
    let plan = preparation::prepare_offline(&arguments.selection.request(&arguments.file), catalogue)?;
    if let Some(host) = plan.unknown_nodes.first() {
        return Err(CommandError {
            what: format!(
                "the scenarios of host `{host}` are not known before its cluster is asked for its nodes"
            )
            .into(),
            hint: Some("write `nodes: one`, or a host with a `nodelist` for each node".to_owned()),
            exit: Exit::Wrong,
        });
    }
    let mut call = format!("matrix run {}", escaping::pasted(&arguments.file));
    if let Some(profile) = &arguments.selection.profile {
        call.push_str(&format!(" --profile {}", escaping::pasted(profile.as_ref())));
    }
    terminal::result(&pipeline(arguments.system, &call, &plan.record));
    Ok(Exit::Done)
}

/// A scenario as a job.
struct Job<'a> {
    planned: &'a PlannedScenario,
    /// What measures it.
    script: String,
    /// How long it may take.
    minutes: u64,
}

impl Job<'_> {
    fn host(&self) -> &str {
        self.planned.host.as_deref().unwrap_or_default()
    }
}

/// The pipeline of a plan, whose scenarios are measured by that call of `matrix`.
fn pipeline(system: System, call: &str, plan: &PlanRecord) -> String {
    let jobs: Vec<Job<'_>> = plan
        .scenarios
        .iter()
        .filter(|planned| planned.runs())
        .map(|planned| {
            let settings = &planned.settings;
            let windows = settings.longest_window().duration() * settings.all_windows();
            Job {
                planned,
                script: format!("{call} --only {} --out {RUNS} --quiet", planned.slug),
                minutes: windows
                    .mul_f64(1.05)
                    .as_secs()
                    .div_ceil(60)
                    .saturating_add(AROUND_MINUTES),
            }
        })
        .collect();
    let mut text = "# Made by `matrix ci-generate`. A job for each scenario runs on a runner that has the name of the scenario's host as its\n\
                    # tag, and has `matrix` in its PATH. The runner is to do one job at a time: others would disturb what is measured.\n"
        .to_owned();
    let long = jobs.iter().filter(|job| job.minutes > HOSTED_MINUTES).count();
    if long > 0 && system == System::Github {
        text.push_str(&format!(
            "# {long} of the jobs take more than {HOSTED_MINUTES} minutes, after which GitHub ends a job on its own machines.\n"
        ));
    }
    // Plain data can always be written.
    text.push_str(&match system {
        System::Gitlab => serde_yaml::to_string(&gitlab(&jobs)).unwrap_or_default(),
        System::Github => serde_yaml::to_string(&github(&jobs)).unwrap_or_default(),
    });
    text
}

/// What makes one report of all runs.
fn report() -> String {
    format!("matrix report {RUNS}/* --output report")
}

/// What a job of GitLab's leaves, in its words.
#[derive(Serialize)]
struct Artifacts {
    when: &'static str,
    paths: [&'static str; 1],
}

#[derive(Serialize)]
#[serde(untagged)]
enum GitlabEntry {
    Stages([&'static str; 2]),
    Job {
        stage: &'static str,
        #[serde(skip_serializing_if = "Vec::is_empty")]
        tags: Vec<String>,
        #[serde(skip_serializing_if = "Option::is_none")]
        resource_group: Option<String>,
        #[serde(skip_serializing_if = "Option::is_none")]
        timeout: Option<String>,
        #[serde(skip_serializing_if = "Option::is_none")]
        when: Option<&'static str>,
        script: [String; 1],
        artifacts: Artifacts,
    },
}

/// In this order.
struct GitlabPipeline(Vec<(String, GitlabEntry)>);

impl Serialize for GitlabPipeline {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(name, entry)| (name, entry)))
    }
}

fn gitlab(jobs: &[Job<'_>]) -> GitlabPipeline {
    let mut entries = vec![("stages".to_owned(), GitlabEntry::Stages(["measure", "report"]))];
    for job in jobs {
        let entry = GitlabEntry::Job {
            stage: "measure",
            tags: vec![job.host().to_owned()],
            resource_group: Some(format!("matrix-{}", job.host())),
            timeout: Some(format!("{} minutes", job.minutes)),
            when: None,
            script: [job.script.clone()],
            artifacts: Artifacts {
                when: "always",
                paths: [RUNS],
            },
        };
        entries.push((job.planned.slug.clone(), entry));
    }
    let entry = GitlabEntry::Job {
        stage: "report",
        tags: Vec::new(),
        resource_group: None,
        timeout: None,
        when: Some("always"),
        script: [report()],
        artifacts: Artifacts {
            when: "always",
            paths: ["report"],
        },
    };
    entries.push(("report".to_owned(), entry));
    GitlabPipeline(entries)
}

#[derive(Serialize)]
struct Workflow {
    name: &'static str,
    on: [&'static str; 1],
    jobs: BTreeMap<String, GithubJob>,
}

#[derive(Serialize)]
#[serde(rename_all = "kebab-case")]
struct GithubJob {
    name: String,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    needs: Vec<String>,
    #[serde(rename = "if", skip_serializing_if = "Option::is_none")]
    condition: Option<&'static str>,
    runs_on: Vec<String>,
    timeout_minutes: u64,
    steps: Vec<Step>,
}

#[derive(Default, Serialize)]
struct Step {
    #[serde(rename = "if", skip_serializing_if = "Option::is_none")]
    condition: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    uses: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    run: Option<String>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    with: BTreeMap<&'static str, String>,
}

fn github(jobs: &[Job<'_>]) -> Workflow {
    const ALWAYS: &str = "always()";
    let step = |uses: &'static str| Step {
        uses: Some(uses),
        ..Step::default()
    };
    let upload = |name: String, path: &str| Step {
        condition: Some(ALWAYS),
        with: BTreeMap::from([("name", name), ("path", path.to_owned())]),
        ..step("actions/upload-artifact@v4")
    };
    let run = |script: String| Step {
        run: Some(script),
        ..Step::default()
    };
    let mut entries: BTreeMap<String, GithubJob> = jobs
        .iter()
        .map(|job| {
            let entry = GithubJob {
                name: job.planned.slug.clone(),
                needs: Vec::new(),
                condition: None,
                runs_on: vec!["self-hosted".to_owned(), job.host().to_owned()],
                timeout_minutes: job.minutes,
                steps: vec![
                    step("actions/checkout@v4"),
                    run(job.script.clone()),
                    upload(format!("run-{}", job.planned.id), RUNS),
                ],
            };
            (job.planned.id.clone(), entry)
        })
        .collect();
    let needs = entries.keys().cloned().collect();
    let download = Step {
        with: BTreeMap::from([
            ("path", RUNS.to_owned()),
            ("pattern", "run-*".to_owned()),
            ("merge-multiple", "true".to_owned()),
        ]),
        ..step("actions/download-artifact@v4")
    };
    let report = GithubJob {
        name: "report".to_owned(),
        needs,
        condition: Some(ALWAYS),
        runs_on: vec!["self-hosted".to_owned()],
        timeout_minutes: AROUND_MINUTES,
        steps: vec![download, run(report()), upload("report".to_owned(), "report")],
    };
    entries.insert("report".to_owned(), report);
    Workflow {
        name: "matrix",
        on: ["workflow_dispatch"],
        jobs: entries,
    }
}

#[cfg(test)]
mod tests {
    use serde_yaml::Value;

    use super::*;
    use crate::cli::arguments::{Arguments, Command};

    /// The pipeline of the paper's scenarios, as it is printed and as a reader of YAML has it.
    fn of_the_paper(system: System) -> (String, Value) {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/paper.yaml");
        let system = system.to_possible_value().map(|it| it.get_name().to_owned());
        let words = ["matrix", "ci-generate", file, "--for", &system.unwrap()];
        let parsed = <Arguments as clap::Parser>::try_parse_from(words).unwrap();
        let Command::CiGenerate(arguments) = parsed.command else {
            panic!("it is another command")
        };
        let request = arguments.selection.request(&arguments.file);
        let plan = preparation::prepare_offline(&request, Catalogue::default()).unwrap();
        let text = pipeline(arguments.system, "matrix run paper.yaml", &plan.record);
        let read = serde_yaml::from_str(&text).unwrap();
        (text, read)
    }

    #[test]
    fn gitlab_has_a_job_for_each_scenario_and_one_for_the_report() {
        let (text, read) = of_the_paper(System::Gitlab);
        let jobs = read.as_mapping().unwrap();
        let measuring: Vec<&Value> = jobs
            .values()
            .filter(|job| job.get("stage") == Some(&"measure".into()))
            .collect();
        assert!(measuring.len() > 1, "{text}");
        for job in measuring {
            let script = job["script"][0].as_str().unwrap();
            assert!(script.starts_with("matrix run paper.yaml --only "), "{script}");
            assert_eq!(job["timeout"], Value::from("450 minutes"));
            assert!(
                job["tags"][0].as_str().is_some_and(|tag| !tag.is_empty()),
                "{text}"
            );
        }
        assert_eq!(
            read["report"]["script"][0],
            Value::from("matrix report runs/* --output report")
        );
    }

    #[test]
    fn github_is_told_that_its_own_machines_end_a_long_job() {
        let (text, read) = of_the_paper(System::Github);
        assert!(text.contains("take more than 360 minutes"), "{text}");
        let jobs = read["jobs"].as_mapping().unwrap();
        let needs = read["jobs"]["report"]["needs"].as_sequence().unwrap();
        assert_eq!(needs.len() + 1, jobs.len());
        for id in needs {
            let job = &jobs[id];
            assert_eq!(job["timeout-minutes"], Value::from(450));
            assert_eq!(job["runs-on"][0], Value::from("self-hosted"));
            assert!(
                job["steps"][1]["run"].as_str().unwrap().contains(" --only "),
                "{text}"
            );
        }
    }
}
