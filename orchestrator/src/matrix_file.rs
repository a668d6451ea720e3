//! The matrix file: text -> a tree with positions -> profile laid on top -> values of the types that own them. The main
//! type is [`MatrixFile`].
//!
//! Everything that can be wrong with a text alone is found here, in one go, as [`Diagnostics`]: each says file, line and
//! column, shows the line, and proposes what to write. `docs/matrix-file.md` is the user's description.

mod axes;
pub mod diagnostic;
mod experiment;
mod hosts;
mod places;
mod platforms;
mod profiles;
mod renamed;
mod report_option;
mod schema;
mod sections;
pub mod source;
mod spelling;
mod sweep;
mod text;
mod tree;
mod typing;
mod yaml;

use std::{
    collections::BTreeMap,
    path::{Path, absolute},
    sync::Arc,
};

use record::{
    axis::{NODE, SIMULATED},
    connection::Connection,
    report_settings::ReportSettings,
    settings::{Dynamics, Settings, SettingsProblem},
};

pub use axes::{Assignment, Axes, Axis, AxisValue, Condition, Exclude, Include};
pub(crate) use axes::{FEWER, SCENARIOS};
pub use diagnostic::{Code, Diagnostic, DiagnosticRecord, Diagnostics, Severity};
pub use hosts::{Host, OneNode, THIS_MACHINE};
pub(crate) use places::Places;
pub(crate) use platforms::platform;
pub use platforms::{PlatformFiles, PlatformReader};
pub use report_option::ReportOption;
pub use schema::schema;
pub(crate) use spelling::{did_you_mean, list, propose};
pub(crate) use sweep::Role;
pub use text::text_within_limits;
pub(crate) use text::{text_at, within_limits};

use profiles::{add_in_profile, choose, read_profiles};
use sections::{EXPERIMENT, HOSTS, MATRIX, PROVIDERS, REPORT, WORKLOAD, check_sections};
use source::{Source, Span};
use text::{beginning_of, decode, open};
use tree::{Content, Node};

use crate::provider::{Catalogue, ProviderSettings};

/// The setting of the workload that decides what others are when they are left out.
const DYNAMICS: &str = "dynamics";
/// Where a file names the folder of its platforms.
const PLATFORMS: &str = "providers.simulated.platforms";

/// A matrix file that makes sense, with one of its profiles applied or none.
#[derive(Debug, Clone, PartialEq)]
pub struct MatrixFile {
    /// The text.
    pub source: Arc<Source>,
    /// The profile that is applied.
    pub profile: Option<String>,
    /// The profiles that there are.
    pub profiles: Vec<String>,
    /// Axes, excludes and includes.
    pub matrix: Axes,
    /// The machines; this one if the file names none.
    pub hosts: Vec<Host>,
    /// The workload's settings, without any sweep.
    pub workload: Settings,
    /// How the tables are made.
    pub report: ReportSettings,
    /// What only one provider knows.
    pub providers: ProviderSettings,
    /// The providers that there are.
    pub catalogue: Catalogue,
    /// Whether all scenarios are computed, whatever their `virtualization`.
    pub all_simulated: bool,
    /// The platforms that simulated scenarios are on, if they have files.
    pub platforms: Option<PlatformFiles>,
    /// What is odd and yet no error.
    pub warnings: Diagnostics,
    /// The whole file with the profile applied: where things stand, and what sweeps are laid on.
    tree: Node,
}

/// The workload's settings with the sweeps of one scenario, and where each of them stands.
#[derive(Debug, Clone)]
pub struct SweptSettings {
    /// The settings.
    pub settings: Settings,
    tree: Node,
}

impl SweptSettings {
    /// A problem of these settings, at its place in the file.
    #[must_use]
    pub fn diagnose(&self, file: &MatrixFile, problem: &SettingsProblem) -> Diagnostic {
        let stands = self.tree.stands(&problem.path);
        let span = self
            .tree
            .locate(&problem.path)
            .unwrap_or_else(|| file.place_of(WORKLOAD));
        // A setting that is left out has no place of its own.
        let label = if stands {
            String::new()
        } else {
            format!("`{}` belongs here", problem.path)
        };
        Diagnostic::error(&file.source, Code::InvalidValue, span, problem.message.as_str())
            .label(label)
            .help(problem.hint.as_str())
    }
}

impl MatrixFile {
    /// Reads a file for these providers and applies a profile.
    ///
    /// # Errors
    /// All that is wrong with it.
    pub fn read(path: &Path, profile: Option<&str>, catalogue: Catalogue) -> Result<Self, Diagnostics> {
        let name = path.display().to_string();
        let beginning = beginning_of(open(path), &name)?;
        let mut file = Self::parse_for(&name, &beginning, profile, catalogue)?;
        // A run goes on from any folder with what its file named.
        if let Some(folder) = absolute(path).ok().as_deref().and_then(Path::parent) {
            for host in &mut file.hosts {
                host.connection.name_files_from(folder);
            }
            if let Some(platforms) = &file.providers.simulated.platforms {
                let span = file.place_of(PLATFORMS);
                let files = PlatformFiles::below(folder, platforms, &file.source, span)?;
                file.platforms = Some(files);
            }
        }
        Ok(file)
    }

    /// Has all scenarios computed on this machine, whatever they are to be measured on: no host is reached.
    #[must_use]
    pub fn simulated(mut self) -> Self {
        self.all_simulated = true;
        for host in &mut self.hosts {
            host.connection = Connection::Local;
        }
        self
    }

    /// Makes each of these nodes, by the name of the host that stands for them, a host of its own.
    ///
    /// # Errors
    /// When there is none, or hosts would have one name.
    pub fn split_hosts(&mut self, nodes: &BTreeMap<String, Vec<String>>) -> Result<(), Diagnostics> {
        let mut axes = self.matrix.axes.iter();
        if let Some(label) = axes
            .find(|axis| axis.name.value == NODE)
            .filter(|_| !nodes.is_empty())
        {
            let message = "the axis `node` has the nodes of a cluster (`nodes: each`)";
            let error = Diagnostic::error(&self.source, Code::InvalidValue, label.name.span, message);
            return Err(error.help("give this label another name").into());
        }
        hosts::split(&self.source, &mut self.hosts, nodes)
    }

    /// Takes the platforms of simulated scenarios from a folder that a person named on the command line.
    ///
    /// # Errors
    /// When it is no folder.
    pub fn use_platforms(&mut self, folder: &Path) -> Result<(), Diagnostics> {
        self.platforms = Some(PlatformFiles::named_by_option(folder)?);
        Ok(())
    }

    /// The name of the provider that makes a scenario's environments.
    #[must_use]
    pub const fn provider_of<'a>(&self, virtualization: &'a str) -> &'a str {
        if self.all_simulated {
            SIMULATED
        } else {
            virtualization
        }
    }

    /// Reads a text under a name for the built-in providers and applies a profile.
    ///
    /// # Errors
    /// All that is wrong with it.
    pub fn parse(name: &str, bytes: &[u8], profile: Option<&str>) -> Result<Self, Diagnostics> {
        Self::parse_for(name, bytes, profile, Catalogue::default())
    }

    /// The same for these providers.
    ///
    /// # Errors
    /// All that is wrong with it.
    pub fn parse_for(
        name: &str,
        bytes: &[u8],
        profile: Option<&str>,
        catalogue: Catalogue,
    ) -> Result<Self, Diagnostics> {
        let source = Arc::new(decode(name, bytes)?);
        let (mut tree, mut found) = yaml::parse_with_keys_twice(&source)?;
        renamed::rename(&source, &mut tree, &mut found);
        check_sections(&source, &tree, &mut found);
        if !matches!(tree.content, Content::Mapping(_)) {
            return Err(found);
        }
        let profiles = read_profiles(&source, &tree, &mut found);
        let chosen = match profile.map(|profile| choose(&profiles, profile)).transpose() {
            Ok(chosen) => chosen,
            Err(unknown) => {
                found.push(*unknown);
                None
            }
        };
        let base = Self::typed(&source, tree.clone(), catalogue, &mut found);
        let mut file = base;
        // Every profile is read, so that the one for next week is not found wrong next week.
        for candidate in &profiles {
            let mut over = tree.clone();
            over.overlay(candidate.node);
            let mut in_profile = Diagnostics::new();
            let read = Self::typed(&source, over, catalogue, &mut in_profile);
            let is_chosen = chosen.is_some_and(|chosen| std::ptr::eq(chosen, candidate));
            add_in_profile(&mut found, in_profile, candidate, is_chosen);
            if is_chosen {
                file = read;
            }
        }
        file.profile = chosen.map(|chosen| chosen.name.value.clone());
        file.profiles = profiles
            .iter()
            .map(|profile| profile.name.value.clone())
            .collect();
        let (mut file, warnings) = found.unless_errors(file)?;
        file.warnings = warnings;
        Ok(file)
    }

    /// Reads the sections of a tree. What is wrong goes to `found`, and is in the result as if it had been left out.
    fn typed(source: &Arc<Source>, tree: Node, catalogue: Catalogue, found: &mut Diagnostics) -> Self {
        let nothing = Node::empty_mapping(Span::default());
        let section = |name: &str| tree.entry(name).map_or(&nothing, |entry| &entry.value);
        let matrix = axes::read(source, section(MATRIX), catalogue, found);
        let hosts = match tree.entry(HOSTS) {
            Some(entry) => hosts::read(source, &entry.value, found),
            None => hosts::this_machine(),
        };
        // For its mistakes; what it comes to also depends on its `dynamics`.
        or_default(typing::read::<Settings>(source, section(WORKLOAD)), found);
        experiment::read(source, &tree, &matrix, found);
        let report = or_default(typing::read::<ReportSettings>(source, section(REPORT)), found);
        let providers = read_providers(source, section(PROVIDERS), catalogue, found);
        let mut file = Self {
            source: Arc::clone(source),
            profile: None,
            profiles: Vec::new(),
            matrix,
            hosts,
            workload: Settings::default(),
            report,
            providers,
            catalogue,
            all_simulated: false,
            platforms: None,
            warnings: Diagnostics::new(),
            tree,
        };
        // What is wrong was found above, or is a sweep's.
        if let Ok(swept) = file.swept([]) {
            file.workload = swept.settings;
        }
        file.check_sweeps(found);
        check_alpha(&file.places(), &file.report, found);
        file.check_platforms(found);
        file.check_vagrant(found);
        file.check_outside(found);
        file
    }

    /// What only a provider from outside this crate can know of its section.
    fn check_outside(&self, found: &mut Diagnostics) {
        for (name, options) in &self.providers.outside {
            let check = self.catalogue.kind(name).map(|kind| kind.check);
            if let Some(Err(reason)) = check.map(|check| check(options)) {
                let span = self.place_of_key(&format!("{PROVIDERS}.{name}"));
                let message = format!("`{name}` does not take these settings: {reason}");
                found.push(Diagnostic::error(&self.source, Code::InvalidValue, span, message));
            }
        }
    }

    /// A file that is somebody else's names no folder of its reader's.
    fn check_platforms(&self, found: &mut Diagnostics) {
        if let Some(folder) = &self.providers.simulated.platforms {
            let problem = platforms::problem(&self.source, self.place_of(PLATFORMS), folder);
            problem.into_iter().for_each(|problem| found.push(problem));
        }
    }

    /// What the host's Vagrant could be made to do more than make a guest.
    fn check_vagrant(&self, found: &mut Diagnostics) {
        for (provider, settings, allowed) in self.catalogue.of_vagrant(&self.providers) {
            for (place, refusal) in settings.refusals(provider, allowed) {
                let span = self.place_of(&format!("{PROVIDERS}.{provider}.{place}"));
                let error = Diagnostic::error(&self.source, Code::InvalidValue, span, refusal.reason);
                found.push(error.help(refusal.instead));
            }
        }
    }

    /// Every value of every sweep by itself, so that a wrong unit is found even in a scenario that is excluded.
    fn check_sweeps(&self, found: &mut Diagnostics) {
        let conditions = self
            .matrix
            .excludes
            .iter()
            .flat_map(|exclude| &exclude.conditions);
        let in_excludes = conditions.flat_map(|it| it.plain().map(|value| (&it.axis, value)));
        let assignments = self.matrix.includes.iter().flat_map(|include| &include.values);
        let in_includes = assignments.map(|assignment| (&assignment.axis, &assignment.value));
        let on_axes = self
            .matrix
            .axes
            .iter()
            .flat_map(|axis| axis.values.iter().map(|value| (&axis.name, value)));
        let values = on_axes.chain(in_excludes).chain(in_includes);
        for (name, value) in values.filter(|(name, _)| Role::of(&name.value) == Ok(Role::Sweep)) {
            // Each reads all settings anew.
            if found.has_all_it_keeps(Severity::Error) {
                return;
            }
            if let Err(wrong) = self.swept([(name.value.as_str(), value)]) {
                found.extend(wrong);
            }
        }
    }

    /// The workload's settings with sweeps applied: pairs of a setting's dotted path and its value.
    ///
    /// # Errors
    /// A value that its setting does not take, at the value's place.
    pub fn swept<'a>(
        &self,
        sweeps: impl IntoIterator<Item = (&'a str, &'a AxisValue)>,
    ) -> Result<SweptSettings, Diagnostics> {
        let written = self.tree.entry(WORKLOAD).filter(|entry| !entry.value.is_null());
        let sweeps: Vec<_> = sweeps.into_iter().collect();
        // On top of what is meant when it is left out, which the dynamics decides.
        let swept = sweeps.iter().find(|(path, _)| *path == DYNAMICS);
        let named = match swept {
            Some((_, value)) => Some(value.text.as_str()),
            None => written
                .and_then(|entry| entry.value.entry(DYNAMICS))
                .and_then(|entry| entry.value.text()),
        };
        // One that does not exist is found where the settings are read.
        let dynamics = named.and_then(Dynamics::named).unwrap_or_default();
        let mut tree = serde_json::to_value(Settings::of(dynamics))
            .map_or(Node::empty_mapping(Span::default()), |workload| {
                Node::of_json(&workload)
            });
        if let Some(entry) = written {
            tree.overlay(&entry.value);
        }
        if let Some(entry) = self.tree.entry(EXPERIMENT).filter(|entry| !entry.value.is_null()) {
            tree.insert(EXPERIMENT, entry.key.span, entry.value.clone());
        }
        // Of an experiment that there is not, `experiment::read` says so.
        let has_experiment = tree.entry(EXPERIMENT).is_some_and(|entry| !entry.value.is_null());
        let sweeps = sweeps.into_iter();
        for (path, value) in sweeps.filter(|(path, _)| has_experiment || !path.starts_with(sweep::PARAMETERS))
        {
            tree.insert(&sweep::path_of(path), value.node.span, value.node.clone());
        }
        let settings = typing::read(&self.source, &tree)?;
        Ok(SweptSettings { settings, tree })
    }

    /// Where things stand in the file.
    pub(crate) const fn places(&self) -> Places<'_> {
        Places {
            source: &self.source,
            tree: &self.tree,
        }
    }

    /// Where the key stands that a dotted path leads to, or the longest part of it that does; else the beginning.
    #[must_use]
    pub fn place_of_key(&self, path: &str) -> Span {
        self.places().of_key(path)
    }

    /// Where a dotted path stands in the file, or the longest part of it that does; else the beginning.
    #[must_use]
    pub fn place_of(&self, path: &str) -> Span {
        self.places().of(path)
    }
}

fn check_alpha(places: &Places<'_>, report: &ReportSettings, found: &mut Diagnostics) {
    if report.check().is_err() {
        let message = format!("α cannot be {}", report.alpha);
        found.push(
            Diagnostic::error(
                places.source,
                Code::InvalidValue,
                places.of("report.alpha"),
                message,
            )
            .help("write a number between 0 and 1, such as `0.001`"),
        );
    }
}

fn or_default<T: Default>(read: Result<T, Diagnostics>, found: &mut Diagnostics) -> T {
    read.unwrap_or_else(|wrong| {
        found.extend(wrong);
        T::default()
    })
}

/// The section `providers:`. Those from outside this crate look at their parts of it themselves, as they stand there.
fn read_providers(
    source: &Arc<Source>,
    section: &Node,
    catalogue: Catalogue,
    found: &mut Diagnostics,
) -> ProviderSettings {
    let mut built_in = section.clone();
    let mut outside = BTreeMap::new();
    if let Content::Mapping(entries) = &mut built_in.content {
        for entry in entries.extract_if(.., |entry| catalogue.is_from_outside(&entry.key.value)) {
            if !entry.value.is_null() {
                let options = typing::read::<serde_json::Value>(source, &entry.value);
                outside.insert(entry.key.value, or_default(options, found));
            }
        }
    }
    ProviderSettings {
        outside,
        ..or_default(typing::read(source, &built_in), found)
    }
}

#[cfg(test)]
mod tests;
