//! Axes, excludes and includes -> combinations, with the semantics of GitHub Actions. The main function is [`expand`].
//!
//! As documented under `jobs.<job_id>.strategy.matrix` of GitHub's workflow syntax: an exclude takes out what has all of
//! its values; then each include adds its values to every combination of the axes that it contradicts in none, or, if
//! there is none, is a combination of its own. Values of the axes are never overwritten, added ones are. Two things are
//! ours: what is excluded stays in the list, with its reason and its letter, and an include that is the very same brings
//! it back; and the hosts give hardware and OS where no axis does.

use std::collections::{HashMap, HashSet};

use record::axis::{HARDWARE, NATIVE, NODE, OS, VIRTUALIZATION};

use super::placement::HostCapabilities;
use crate::matrix_file::{
    Assignment, Axis, AxisValue, Code, Condition, Diagnostic, Diagnostics, Exclude, FEWER, Host, Include,
    MatrixFile, OneNode, Role, SCENARIOS, did_you_mean, list, propose, source::Span,
};

/// The reason of an exclude that gives none.
const NO_REASON: &str = "excluded by the matrix file";

/// All excludes of a file are compared with no more letters of its scenarios than these, in the worst case; it takes a second. 1000 scenarios
/// with values of 20 letters take 500 patterns of 30.
const LETTERS: usize = 300_000_000;
/// To look for a misspelling takes as long as to compare so many letters for each pair of letters.
const LETTERS_OF_A_MISSPELLING: usize = 10;

/// Values of axes, in the order they are shown.
pub type Values = Vec<(String, AxisValue)>;

/// One scenario to be.
#[derive(Debug, Clone, PartialEq)]
pub struct Combination {
    /// Its values, hardware and OS where known, and virtualization always among them.
    pub axes: Values,
    /// Why it is excluded, if it is.
    pub excluded: Option<String>,
}

impl Combination {
    /// The value of an axis.
    #[must_use]
    pub fn value(&self, axis: &str) -> Option<&str> {
        value_of(&self.axes, axis).map(|value| value.text.as_str())
    }

    /// What makes its environment.
    #[must_use]
    pub fn virtualization(&self) -> &str {
        self.value(VIRTUALIZATION).unwrap_or(NATIVE)
    }

    /// The values that sweep a setting of the workload.
    pub fn sweeps(&self) -> impl Iterator<Item = (&str, &AxisValue)> {
        let values = self.axes.iter().map(|(axis, value)| (axis.as_str(), value));
        values.filter(|(axis, _)| Role::of(axis) == Ok(Role::Sweep))
    }
}

/// All combinations, the first axis slowest, included ones last. What is wrong goes to `found`.
pub fn expand(file: &MatrixFile, offers: &[HostCapabilities], found: &mut Diagnostics) -> Vec<Combination> {
    let mut expansion = Expansion {
        file,
        offers,
        found,
        axes: Vec::new(),
        drafts: Vec::new(),
        letters_left: LETTERS,
    };
    expansion.multiply();
    expansion.exclude();
    for include in &file.matrix.includes {
        expansion.include(include);
        if expansion.drafts.len() > SCENARIOS {
            expansion.too_many(Some(expansion.drafts.len()));
            break;
        }
    }
    expansion.finish()
}

/// How many letters take as long as to look for what the values of an idle exclude were meant to be.
fn letters_of_misspellings(exclude: &Exclude, known: &HashMap<String, Vec<String>>) -> usize {
    let of = |condition: &Condition| {
        let wanted = condition.plain().map(|value| value.text.len());
        let known = known
            .get(&condition.axis.value)
            .map_or(&[] as &[String], Vec::as_slice);
        let known = known
            .iter()
            .map(|value| value.len().saturating_mul(LETTERS_OF_A_MISSPELLING));
        wanted.sum::<usize>().saturating_mul(known.sum())
    };
    exclude.conditions.iter().map(of).fold(0, usize::saturating_add)
}

/// A combination in the making.
struct Draft {
    /// From the axes: never overwritten. Of one that an include made, all its values.
    original: Values,
    /// From includes.
    added: Values,
    excluded: Option<String>,
    /// The include that made it, if it does not come from the axes.
    made_by: Option<Span>,
}

struct Expansion<'a> {
    file: &'a MatrixFile,
    offers: &'a [HostCapabilities],
    found: &'a mut Diagnostics,
    /// Axis names in order, those among them that the hosts give.
    axes: Vec<String>,
    drafts: Vec<Draft>,
    /// So many letters more are compared.
    letters_left: usize,
}

impl<'a> Expansion<'a> {
    /// The product of the axes. Hardware and OS from the hosts are one axis of pairs: not every host has every OS.
    fn multiply(&mut self) {
        let axes = &self.file.matrix.axes;
        // A matrix of includes alone has no combination to begin with, as in GitHub Actions.
        if axes.is_empty() && !self.file.matrix.includes.is_empty() {
            return;
        }
        let listed = |name: &str| axes.iter().any(|axis| axis.name.value == name);
        let mut choices: Vec<Vec<Values>> = Vec::new();
        if !listed(HARDWARE) && !listed(OS) {
            self.axes.extend([HARDWARE.to_owned(), OS.to_owned()]);
            choices.push(self.pairs(|_| true));
        }
        for axis in axes {
            match axis.name.value.as_str() {
                HARDWARE | OS if !listed(HARDWARE) || !listed(OS) => {
                    self.axes.extend([HARDWARE.to_owned(), OS.to_owned()]);
                }
                name => self.axes.push(name.to_owned()),
            }
            choices.push(match axis.name.value.as_str() {
                HARDWARE if !listed(OS) => self.completed(axis),
                OS if !listed(HARDWARE) => self.completed(axis),
                name => axis
                    .values
                    .iter()
                    .map(|value| vec![(name.to_owned(), value.clone())])
                    .collect(),
            });
        }
        let count = choices
            .iter()
            .try_fold(1_usize, |count, choices| count.checked_mul(choices.len()));
        if count.is_none_or(|count| count > SCENARIOS) {
            self.too_many(count);
            return;
        }
        let mut combinations: Vec<Values> = vec![Vec::new()];
        for choices in &choices {
            let extended = combinations.iter().flat_map(|before| {
                choices
                    .iter()
                    .map(|choice| before.iter().chain(choice).cloned().collect())
            });
            combinations = extended.collect();
        }
        let combinations: Vec<Values> = combinations
            .into_iter()
            .flat_map(|values| self.on_nodes(values))
            .collect();
        if combinations.len() > SCENARIOS {
            self.too_many(Some(combinations.len()));
            return;
        }
        self.drafts = combinations
            .into_iter()
            .map(|original| Draft {
                original,
                added: Vec::new(),
                excluded: None,
                made_by: None,
            })
            .collect();
    }

    fn too_many(&mut self, count: Option<usize>) {
        let count = count.map_or_else(
            || "more than can be counted".to_owned(),
            |count| count.to_string(),
        );
        let message = format!("these are {count} scenarios, more than {SCENARIOS}");
        let span = self
            .file
            .matrix
            .axes
            .first()
            .map_or(self.file.matrix.span, |axis| axis.name.span);
        self.found
            .push(Diagnostic::error(&self.file.source, Code::TooManyScenarios, span, message).help(FEWER));
    }

    /// What the hosts offer, each pair once.
    fn pairs(&self, wanted: impl Fn(&HostCapabilities) -> bool) -> Vec<Values> {
        let mut seen = HashSet::new();
        self.offers
            .iter()
            .filter(|offer| wanted(offer) && seen.insert((&offer.hardware, &offer.os)))
            .map(|offer| {
                vec![
                    (HARDWARE.to_owned(), AxisValue::word(&offer.hardware)),
                    (OS.to_owned(), AxisValue::word(&offer.os)),
                ]
            })
            .collect()
    }

    /// The values on each node of the cluster, where the first host that offers them is one of its nodes.
    fn on_nodes(&self, values: Values) -> Vec<Values> {
        let offers = |offer: &&HostCapabilities| {
            [HARDWARE, OS]
                .iter()
                .all(|axis| value_of(&values, axis).map(|value| value.text.as_str()) == offer.get(axis))
        };
        let nodes = self.offers.iter().filter(offers).map(|offer| offer.node.as_ref());
        let first = nodes.clone().next().flatten();
        let Some(first) = first.filter(|_| value_of(&values, NODE).is_none()) else {
            return vec![values];
        };
        let on_node = |node: &OneNode| {
            let mut values = values.clone();
            values.push((NODE.to_owned(), AxisValue::word(&node.name)));
            values
        };
        nodes
            .flatten()
            .filter(|node| node.of == first.of)
            .map(on_node)
            .collect()
    }

    /// The values of one of hardware and OS, with each that the hosts offer of the other.
    fn completed(&self, axis: &Axis) -> Vec<Values> {
        let name = &axis.name.value;
        let mut choices = Vec::new();
        for value in &axis.values {
            let pairs = self.pairs(|offer| offer.get(name) == Some(value.text.as_str()));
            let with_place = |mut pair: Values| {
                // The value as it stands in the file, so that it is known where.
                pair.iter_mut()
                    .filter(|(axis, _)| axis == name)
                    .for_each(|(_, v)| *v = value.clone());
                pair
            };
            if pairs.is_empty() {
                choices.push(vec![(name.clone(), value.clone())]);
            }
            choices.extend(pairs.into_iter().map(with_place));
        }
        choices
    }

    fn exclude(&mut self) {
        let known = self.known_values();
        for exclude in &self.file.matrix.excludes {
            let reason = exclude.reason.as_deref().unwrap_or(NO_REASON);
            if !self.may_compare(exclude, self.letters_of_patterns(exclude)) {
                return;
            }
            let mut matched = false;
            for draft in &mut self.drafts {
                let fits = |condition: &Condition| {
                    let value = value_of(&draft.original, &condition.axis.value);
                    value.is_some_and(|value| condition.fits(&value.text))
                };
                if exclude.conditions.iter().all(fits) {
                    matched = true;
                    draft.excluded.get_or_insert_with(|| reason.to_owned());
                }
            }
            if !matched && !self.drafts.is_empty() {
                if !self.may_compare(exclude, letters_of_misspellings(exclude, &known)) {
                    return;
                }
                self.matches_nothing(exclude, &known);
            }
        }
    }

    /// How many letters are compared at most to see which scenarios fit an exclude.
    fn letters_of_patterns(&self, exclude: &Exclude) -> usize {
        let of = |draft: &Draft, condition: &Condition| {
            value_of(&draft.original, &condition.axis.value)
                .map_or(0, |value| condition.letters_compared(&value.text))
        };
        let conditions = exclude.conditions.iter();
        conditions
            .flat_map(|condition| self.drafts.iter().map(move |draft| of(draft, condition)))
            .fold(0, usize::saturating_add)
    }

    /// Whether so many letters more may be compared for an exclude. A file that is made to be slow is an error.
    fn may_compare(&mut self, exclude: &Exclude, letters: usize) -> bool {
        let left = self.letters_left.checked_sub(letters);
        self.letters_left = left.unwrap_or_default();
        if left.is_none() {
            let message =
                "the excludes have more values and patterns than can be compared with the scenarios";
            let error = Diagnostic::error(&self.file.source, Code::TooLarge, exclude.span, message);
            self.found.push(error.label("up to here").help(
                "write one pattern in place of many, such as `debian-*`, or leave values off the axes",
            ));
        }
        left.is_some()
    }

    /// Of each axis the values that the combinations have, each once: ten thousand excludes ask for them.
    fn known_values(&self) -> HashMap<String, Vec<String>> {
        let mut seen = HashSet::new();
        let mut known: HashMap<String, Vec<String>> = HashMap::new();
        for (axis, value) in self.drafts.iter().flat_map(|draft| &draft.original) {
            if seen.insert((axis, &value.text)) {
                known.entry(axis.clone()).or_default().push(value.text.clone());
            }
        }
        known
    }

    /// A near miss is a misspelling, and would measure what was not to be measured: an error. Anything else may be left
    /// from a longer list of values, or stand for a profile: a warning.
    fn matches_nothing(&mut self, exclude: &Exclude, known: &HashMap<String, Vec<String>>) {
        let source = &self.file.source;
        let usual = [HARDWARE, OS, NODE, VIRTUALIZATION];
        let values_of = |axis: &str| known.get(axis).map_or(&[] as &[String], Vec::as_slice);
        // Which nodes there are is not known yet.
        if self.file.hosts.iter().any(Host::is_each_node)
            && exclude.conditions.iter().any(|it| it.axis.value == NODE)
        {
            return;
        }
        for wanted in &exclude.conditions {
            let axis = wanted.axis.value.as_str();
            let name = wanted.axis.span;
            if !self.axes.iter().any(|known| known == axis) && !usual.contains(&axis) {
                self.found.push(
                    Diagnostic::error(
                        source,
                        Code::UnknownKey,
                        name,
                        format!("there is no axis `{axis}` to exclude from"),
                    )
                    .label("unknown axis")
                    .help(propose(axis, self.axes.iter().map(String::as_str))),
                );
                return;
            }
            let values = values_of(axis);
            let absent = wanted.plain().filter(|value| !values.contains(&value.text));
            let misspelt = absent
                .filter_map(|value| {
                    let meant = did_you_mean(&value.text, values.iter().map(String::as_str))?;
                    Some((value, meant))
                })
                .next();
            if let Some((value, meant)) = misspelt {
                self.found.push(
                    Diagnostic::error(
                        source,
                        Code::UnknownValue,
                        value.node.span,
                        format!("no `{axis}` is `{}`", value.text),
                    )
                    .label("unknown value")
                    .help(format!("did you mean `{meant}`?")),
                );
                return;
            }
        }
        let is_absent = |wanted: &&Condition| {
            let mut values = values_of(&wanted.axis.value).iter();
            !values.any(|value| wanted.fits(value))
        };
        let absent = exclude.conditions.iter().find(is_absent);
        let help = absent.map_or_else(
            || "no scenario has all of these values together: take one out, or the exclude".to_owned(),
            |wanted| {
                let texts = wanted.values.iter().map(|value| value.text.as_str());
                let has_none = match wanted.values.len() {
                    1 => format!(
                        "no scenario has `{}: {}`",
                        wanted.axis.value,
                        texts.collect::<String>()
                    ),
                    _ => format!(
                        "no scenario has one of {} as `{}`",
                        list(texts),
                        wanted.axis.value
                    ),
                };
                format!("{has_none}: take the exclude out, or correct the value")
            },
        );
        self.found.push(
            Diagnostic::warning(
                source,
                Code::IdleExclude,
                exclude.span,
                "this exclude matches no scenario",
            )
            .help(help),
        );
    }

    fn include(&mut self, include: &'a Include) {
        let fits = |draft: &&mut Draft| {
            let free = |wanted: &Assignment| {
                let original = value_of(&draft.original, &wanted.axis.value);
                original.is_none() || same(original, wanted)
            };
            draft.excluded.is_none() && draft.made_by.is_none() && include.values.iter().all(free)
        };
        let mut fitting = 0;
        let mut changed = false;
        for draft in self.drafts.iter_mut().filter(fits) {
            fitting += 1;
            for wanted in &include.values {
                if value_of(&draft.original, &wanted.axis.value).is_none() {
                    changed |= set(&mut draft.added, wanted);
                }
            }
        }
        match fitting {
            0 => self.add(include),
            _ if changed => {}
            1 if include
                .values
                .iter()
                .all(|wanted| self.axes.contains(&wanted.axis.value)) =>
            {
                self.repeats(include.span, None);
            }
            _ => self.found.push(
                Diagnostic::warning(
                    &self.file.source,
                    Code::IdleInclude,
                    include.span,
                    "this include changes nothing",
                )
                .label(format!("fits {fitting} scenarios, which have all of it"))
                .help("take it out, or add what is to be different"),
            ),
        }
    }

    /// An include that fits no combination of the axes: one that was excluded, or a new one.
    fn add(&mut self, include: &Include) {
        let mut values: Values = Vec::new();
        for wanted in &include.values {
            set(&mut values, wanted);
        }
        self.complete(&mut values);
        let is_excluded = |draft: &&mut Draft| {
            draft.excluded.is_some()
                && draft.original.iter().all(|(axis, value)| {
                    value_of(&values, axis).is_some_and(|wanted| wanted.text == value.text)
                })
        };
        if let Some(draft) = self.drafts.iter_mut().find(is_excluded) {
            draft.excluded = None;
            values.retain(|(axis, _)| value_of(&draft.original, axis).is_none());
            draft.added = values;
            return;
        }
        let place = |name: &str| {
            self.axes
                .iter()
                .position(|axis| axis == name)
                .unwrap_or(usize::MAX)
        };
        values.sort_by_key(|(axis, _)| place(axis));
        let included = self.on_nodes(values).into_iter().map(|original| Draft {
            original,
            added: Vec::new(),
            excluded: None,
            made_by: Some(include.span),
        });
        let included: Vec<Draft> = included.collect();
        self.drafts.extend(included);
    }

    /// Hardware and OS that are not named are those of the first host that offers the rest.
    fn complete(&self, values: &mut Values) {
        let wanted = |offer: &HostCapabilities| {
            [HARDWARE, OS].iter().all(|axis| {
                value_of(values, axis).is_none_or(|value| offer.get(axis) == Some(value.text.as_str()))
            })
        };
        let first = self.pairs(wanted).into_iter().next();
        for (at, (axis, value)) in first.into_iter().flatten().enumerate() {
            if value_of(values, &axis).is_none() {
                values.insert(at.min(values.len()), (axis, value));
            }
        }
    }

    fn repeats(&mut self, span: Span, first: Option<Span>) {
        let message = "this include repeats a scenario that is there already";
        let error =
            Diagnostic::error(&self.file.source, Code::DuplicateScenario, span, message).label("again");
        let error = match first {
            Some(first) => error.also(first, "first"),
            None => error.also(
                self.file.matrix.axes.first().map_or(span, |axis| axis.name.span),
                "from the axes",
            ),
        };
        self.found
            .push(error.help("take it out, or give it a value that the other has not"));
    }

    fn finish(mut self) -> Vec<Combination> {
        let drafts = std::mem::take(&mut self.drafts);
        let mut seen: HashMap<Vec<(String, String)>, Option<Span>> = HashMap::new();
        let mut combinations = Vec::new();
        for draft in drafts {
            let mut axes: Values = draft.original.into_iter().chain(draft.added).collect();
            if value_of(&axes, VIRTUALIZATION).is_none() {
                axes.push((VIRTUALIZATION.to_owned(), AxisValue::word(NATIVE)));
            }
            if self.offers.iter().any(|offer| offer.node.is_some()) {
                // Last, wherever an include names it: a cluster's nodes are the fastest axis.
                axes.sort_by_key(|(axis, _)| axis == NODE);
            }
            let mut identity: Vec<_> = axes
                .iter()
                .map(|(axis, value)| (axis.clone(), value.text.clone()))
                .collect();
            identity.sort();
            match (seen.get(&identity), draft.made_by) {
                (Some(first), Some(span)) => {
                    let first = *first;
                    self.repeats(span, first);
                }
                _ => {
                    seen.insert(identity, draft.made_by);
                }
            }
            combinations.push(Combination {
                axes,
                excluded: draft.excluded,
            });
        }
        if combinations.is_empty() && !self.found.has_errors() {
            let hosts = list(self.offers.iter().map(|offer| offer.host.as_str()));
            self.found.push(
                Diagnostic::error(
                    &self.file.source,
                    Code::EmptyAxis,
                    self.file.matrix.span,
                    "this makes no scenario",
                )
                .help(format!(
                    "add an axis, as in `virtualization: [native, docker]`, for the hosts {hosts}"
                )),
            );
        }
        combinations
    }
}

fn value_of<'v>(values: &'v Values, axis: &str) -> Option<&'v AxisValue> {
    values
        .iter()
        .find(|(name, _)| name == axis)
        .map(|(_, value)| value)
}

fn same(value: Option<&AxisValue>, wanted: &Assignment) -> bool {
    value.is_some_and(|value| value.text == wanted.value.text)
}

/// Whether that changed anything.
fn set(values: &mut Values, wanted: &Assignment) -> bool {
    match values.iter_mut().find(|(name, _)| *name == wanted.axis.value) {
        Some((_, value)) if value.text == wanted.value.text => false,
        Some((_, value)) => {
            *value = wanted.value.clone();
            true
        }
        None => {
            values.push((wanted.axis.value.clone(), wanted.value.clone()));
            true
        }
    }
}
