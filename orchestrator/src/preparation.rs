//! From a matrix file to its plan, without a terminal: what `matrix plan`, `matrix run` and `matrix check` have in common. The
//! main function is [`prepare`].
//!
//! ```text
//! file -> which nodes clusters have -> what the hosts are -> the matrix expanded, once -> what the hosts can do for its scenarios -> plan
//! ```

use std::{collections::BTreeMap, path::Path};

use record::causes::with_causes;

use crate::{
    experiment_files::ExperimentFiles,
    matrix_file::{
        Diagnostics, MatrixFile, PlatformFiles,
        diagnostic::{Code, Diagnostic},
    },
    plan::{self, ExpandedMatrix, HostFacts, Plan, Selection, order::Order},
    provider::{Catalogue, Providers},
    survey,
};

/// Which plan is wanted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlanRequest<'a> {
    /// The matrix file.
    pub file: &'a Path,
    /// The profile of the file that is applied, if any.
    pub profile: Option<&'a str>,
    /// The scenarios that run.
    pub selection: Selection,
    /// How they are put in order.
    pub order: Order,
    /// The seed of the order.
    pub seed: u64,
    /// Whether all scenarios are computed and none is measured.
    pub simulated: bool,
    /// The folder with the platforms of simulated scenarios, if it is another than the file says.
    pub platforms: Option<&'a Path>,
}

impl<'a> PlanRequest<'a> {
    /// All scenarios of a file without a profile, in the default order.
    #[must_use]
    pub fn new(file: &'a Path) -> Self {
        Self {
            file,
            profile: None,
            selection: Selection::default(),
            order: Order::default(),
            seed: 0,
            simulated: false,
            platforms: None,
        }
    }
}

/// A matrix file and its plan for the hosts as they are now.
pub struct Prepared {
    /// The file.
    pub file: MatrixFile,
    /// The plan, with what is odd in the file.
    pub plan: Plan,
    /// The hosts and providers that were asked.
    pub providers: Providers,
    /// What is known of the hosts, by their names.
    pub facts: BTreeMap<String, HostFacts>,
    /// The files of a user's experiment, if it has any.
    pub files: Option<ExperimentFiles>,
}

/// Why there is no plan.
#[derive(Debug, thiserror::Error)]
pub enum PreparationError {
    /// The file cannot be read, or its text is wrong whatever the hosts are.
    #[error(transparent)]
    File(Diagnostics),
    /// The scenarios are wrong: together, for the hosts, or for the selection.
    #[error(transparent)]
    Plan(Diagnostics),
}

impl PreparationError {
    /// All that is wrong.
    #[must_use]
    pub fn into_mistakes(self) -> Diagnostics {
        match self {
            Self::File(mistakes) | Self::Plan(mistakes) => mistakes,
        }
    }
}

/// Reads a matrix file, asks its hosts what they are and what its scenarios need, and plans.
///
/// # Errors
/// All that is wrong with the file, or with its scenarios. That a host does not answer is none.
pub async fn prepare(request: &PlanRequest<'_>, catalogue: Catalogue) -> Result<Prepared, PreparationError> {
    let mut file = read(request, catalogue).map_err(PreparationError::File)?;
    survey::split_clusters(&mut file)
        .await
        .map_err(PreparationError::Plan)?;
    let providers = survey::providers(&file);
    let mut facts = survey::identities(&providers).await;
    let matrix = ExpandedMatrix::of(&file, &facts).map_err(PreparationError::Plan)?;
    survey::ask_hosts(&mut facts, matrix.questions(), &providers).await;
    let plan = matrix
        .plan(&facts, &request.selection, request.order, request.seed)
        .map_err(PreparationError::Plan)?;
    check_platforms(request, &plan)?;
    Ok(Prepared {
        files: files(request, &file)?,
        file,
        plan,
        providers,
        facts,
    })
}

fn read(request: &PlanRequest<'_>, catalogue: Catalogue) -> Result<MatrixFile, Diagnostics> {
    let mut file = MatrixFile::read(request.file, request.profile, catalogue)?;
    if let Some(folder) = request.platforms {
        file.use_platforms(folder)?;
    }
    Ok(match request.simulated {
        true => file.simulated(),
        false => file,
    })
}

/// Reads a matrix file and plans with what is known without asking: no host is reached, and nothing is started.
///
/// # Errors
/// All that is wrong with the file, or with its scenarios.
pub fn prepare_offline(request: &PlanRequest<'_>, catalogue: Catalogue) -> Result<Plan, PreparationError> {
    let file = read(request, catalogue).map_err(PreparationError::File)?;
    let facts = survey::unasked(&file);
    files(request, &file)?;
    let plan = plan::plan(&file, &facts, &request.selection, request.order, request.seed)
        .map_err(PreparationError::Plan)?;
    check_platforms(request, &plan)?;
    Ok(plan)
}

/// Who names platforms wants scenarios to be computed, and would wait for hours if they were measured.
fn check_platforms(request: &PlanRequest<'_>, plan: &Plan) -> Result<(), PreparationError> {
    let mut scenarios = plan.record.scenarios.iter();
    match request.platforms {
        Some(folder) if !scenarios.any(|it| it.settings.simulation.is_some()) => {
            Err(PreparationError::Plan(PlatformFiles::in_vain(folder)))
        }
        _ => Ok(()),
    }
}

/// The files of a user's experiment, which lie beside the matrix file.
fn files(request: &PlanRequest<'_>, file: &MatrixFile) -> Result<Option<ExperimentFiles>, PreparationError> {
    let experiment = file.workload.experiment.as_ref();
    let Some(experiment) = experiment.filter(|experiment| !experiment.files.is_empty()) else {
        return Ok(None);
    };
    let folder = request.file.parent().unwrap_or(Path::new(""));
    ExperimentFiles::pack(folder, &experiment.files)
        .map(Some)
        .map_err(|error| {
            let place = experiment.files.iter().position(|named| error.names(named));
            let path = place.map_or_else(String::new, |at| format!(".{at}"));
            let span = file.place_of(&format!("experiment.files{path}"));
            let message = with_causes(&error);
            let mut diagnostic = Diagnostic::error(&file.source, Code::InvalidValue, span, message);
            if let Some(hint) = error.hint() {
                diagnostic = diagnostic.help(hint);
            }
            let mut found = Diagnostics::default();
            found.push(diagnostic);
            PreparationError::File(found)
        })
}

#[cfg(test)]
mod tests {
    use std::{fs, path::PathBuf};

    use tempfile::TempDir;

    use super::*;
    use crate::provider::{Making, Provider, ProviderError, ProviderKind};

    /// A provider that must not be made.
    static UNTOUCHED: [ProviderKind; 1] = [ProviderKind::new("untouched", never)];

    fn never(_: &Making<'_>) -> Result<Box<dyn Provider>, ProviderError> {
        panic!("a provider is made only to be asked")
    }

    fn written(text: &str) -> (PathBuf, TempDir) {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("matrix.yaml");
        fs::write(&file, text).unwrap();
        (file, folder)
    }

    #[test]
    fn files_that_are_not_there_are_told_before_anything_is_run() {
        let (file, _folder) = written(
            "matrix: {}\nexperiment:\n  name: reach\n  files: [matrix.yaml, sin/]\n  run: [\"true\"]\n  metrics:\n  - {name: error, \
             from: errors.csv}\n",
        );
        let wrong = prepare_offline(&PlanRequest::new(&file), Catalogue::default()).unwrap_err();
        let told = wrong.into_mistakes().to_string();
        assert!(
            told.contains("there is no `sin/` beside the matrix file"),
            "{told}"
        );
        assert!(told.contains("matrix.yaml:4:24"), "{told}");
    }

    #[test]
    fn a_mistake_in_a_platform_is_told_at_its_place_in_that_file() {
        let (file, folder) = written(
            "matrix: {hardware: [x], os: [y], virtualization: [simulated]}\nhosts: {here: {hardware: x, os: y}}\n\
             providers: {simulated: {platforms: p}}\n",
        );
        fs::create_dir(folder.path().join("p")).unwrap();
        let told = || {
            prepare_offline(&PlanRequest::new(&file), Catalogue::default())
                .map_err(|it| it.into_mistakes().to_string())
        };
        let wrong = told().unwrap_err();
        assert!(
            wrong.contains("there is no platform for `x-y-simulated`") && wrong.contains("matrix.yaml:3:"),
            "{wrong}"
        );
        fs::write(
            folder.path().join("p/x-y-simulated.yaml"),
            "stack: 1us\nlatness: 3us\n",
        )
        .unwrap();
        let wrong = told().unwrap_err();
        assert!(
            wrong.contains("p/x-y-simulated.yaml:2:1") && wrong.contains("no key `latness`"),
            "{wrong}"
        );
        fs::write(folder.path().join("p/x-y-simulated.yaml"), "stack: 1us\n").unwrap();
        let plan = told().unwrap();
        let simulation = plan.record.scenarios[0].settings.simulation.as_ref().unwrap();
        assert_eq!(simulation.platform.stack.to_string(), "1us");
    }

    #[test]
    fn platforms_for_scenarios_that_are_all_measured_are_an_error() {
        let (file, folder) = written("matrix: {virtualization: [native]}\n");
        let request = PlanRequest {
            platforms: Some(folder.path()),
            ..PlanRequest::new(&file)
        };
        let wrong = prepare_offline(&request, Catalogue::default()).unwrap_err();
        let told = wrong.into_mistakes().to_string();
        assert!(
            told.contains("no scenario is computed") && told.contains("add `--simulated`"),
            "{told}"
        );
    }

    #[tokio::test]
    async fn a_program_plans_for_the_fake_platform_without_a_terminal() {
        let (file, _folder) = written(
            "matrix: {virtualization: [fake], network.seed: [1, 2]}\n\
             profiles: {quick: {workload: {window: 800s}}}\n",
        );
        let request = PlanRequest {
            profile: Some("quick"),
            selection: Selection {
                skip: vec!["b".to_owned()],
                ..Selection::default()
            },
            ..PlanRequest::new(&file)
        };
        let prepared = prepare(&request, Catalogue::default()).await.unwrap();
        let record = &prepared.plan.record;
        assert_eq!(record.order, ["a"]);
        assert!(
            record.scenarios.iter().all(|it| it.feasible && it.simulated),
            "{record:?}"
        );
        assert_eq!(prepared.file.profile.as_deref(), Some("quick"));
        // What a run begins with: the host, what it answered, and the provider that was asked.
        let asked: Vec<_> = prepared.facts["local"].providers.keys().collect();
        assert_eq!(asked, ["fake"]);
        assert!(prepared.providers.of("fake", "local").is_ok());
    }

    #[test]
    fn offline_a_plan_reaches_no_host_and_makes_no_provider() {
        let (file, _folder) = written(
            "hosts: {far: {hardware: x, os: y, connect: {ssh: nobody@far.invalid}}}\n\
             matrix: {virtualization: [untouched]}\n",
        );
        let catalogue = Catalogue::with(&UNTOUCHED).unwrap();
        let plan = prepare_offline(&PlanRequest::new(&file), catalogue).unwrap();
        assert_eq!(plan.record.scenarios[0].host.as_deref(), Some("far"));
        assert!(plan.record.scenarios[0].feasible && plan.silent.is_empty());
    }

    #[tokio::test]
    async fn an_error_is_of_the_file_or_of_its_scenarios() {
        let (file, _folder) = written("matirx: {}\n");
        let wrong = prepare(&PlanRequest::new(&file), Catalogue::default()).await;
        assert!(matches!(wrong, Err(PreparationError::File(_))));
        let (file, _folder) = written("matrix: {virtualization: [fake]}\n");
        let request = PlanRequest {
            selection: Selection {
                only: vec!["nothing".to_owned()],
                ..Selection::default()
            },
            ..PlanRequest::new(&file)
        };
        let wrong = prepare(&request, Catalogue::default()).await;
        assert!(matches!(wrong, Err(PreparationError::Plan(_))));
    }
}
