//! Which pairs of scenarios are asked about: the family that p-values are adjusted for, declared in the matrix file
//! (`report.family`) before anything is measured. Pairs that were chosen for their results would need no adjustment to
//! look significant. The main type is [`Family`].

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use serde_json::{Map, Value};

use crate::axis::{VIRTUALIZATION, axis_text};

/// A declared family.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum Family {
    /// Every two scenarios.
    #[default]
    All,
    /// Each other scenario against each baseline scenario, as Table V.
    AgainstBaseline,
    /// Those that differ in virtualization alone.
    SamePlatform,
    /// These, by letter or slug.
    Pairs(Vec<(String, String)>),
}

const ALL: &str = "all";
const AGAINST_BASELINE: &str = "against-baseline";
/// Its name in files of earlier versions.
const AGAINST_CONTROLS: &str = "against-controls";
const SAME_PLATFORM: &str = "same-platform";
const NAMES: &[&str] = &[ALL, AGAINST_BASELINE, SAME_PLATFORM];

/// What a scenario is to a family.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Member<'a> {
    /// Its letter.
    pub id: &'a str,
    /// Its slug.
    pub slug: &'a str,
    /// Whether it belongs to the baseline.
    pub is_baseline: bool,
    /// Its axis values but for virtualization.
    pub platform: Vec<(&'a str, String)>,
}

impl Family {
    /// Whether it is what is meant when none is declared.
    #[must_use]
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// The pairs of places in `members` that belong to it, each once, the earlier scenario first.
    #[must_use]
    pub fn pairs(&self, members: &[Member<'_>]) -> Vec<(usize, usize)> {
        let every_two = (0..members.len()).flat_map(|a| (a + 1..members.len()).map(move |b| (a, b)));
        every_two
            .filter(|(a, b)| match (members.get(*a), members.get(*b)) {
                (Some(a), Some(b)) => self.has(a, b),
                _ => false,
            })
            .collect()
    }

    /// Those of them that are asked about: scenarios that are not to run the same experiment, as `is_unlike` says of two places,
    /// only if they are named.
    #[must_use]
    pub fn asked(
        &self,
        members: &[Member<'_>],
        is_unlike: impl Fn(usize, usize) -> bool,
    ) -> Vec<(usize, usize)> {
        let is_named = matches!(self, Self::Pairs(_));
        let mut pairs = self.pairs(members);
        pairs.retain(|(a, b)| is_named || !is_unlike(*a, *b));
        pairs
    }

    fn has(&self, a: &Member<'_>, b: &Member<'_>) -> bool {
        match self {
            Self::All => true,
            Self::AgainstBaseline => a.is_baseline != b.is_baseline,
            Self::SamePlatform => a.platform == b.platform,
            Self::Pairs(pairs) => pairs
                .iter()
                .any(|(x, y)| (a.is(x) && b.is(y)) || (a.is(y) && b.is(x))),
        }
    }

    /// The names in it, if it is a list; they may be no scenario's.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        let pairs = match self {
            Self::Pairs(pairs) => pairs.as_slice(),
            _ => &[],
        };
        pairs.iter().flat_map(|(a, b)| [a.as_str(), b.as_str()])
    }

    /// What it is, for people.
    #[must_use]
    pub fn description(&self) -> String {
        match self {
            Self::All => "every two scenarios".to_owned(),
            Self::AgainstBaseline => "each scenario against each baseline scenario".to_owned(),
            Self::SamePlatform => "scenarios that differ in virtualization alone".to_owned(),
            Self::Pairs(pairs) => {
                let pairs: Vec<String> = pairs.iter().map(|(a, b)| format!("{a} / {b}")).collect();
                pairs.join(", ")
            }
        }
    }
}

impl<'a> Member<'a> {
    /// A scenario with these axes, by its letter and slug.
    #[must_use]
    pub fn new(id: &'a str, slug: &'a str, is_baseline: bool, axes: &'a Map<String, Value>) -> Self {
        let platform = axes.iter().filter(|(axis, _)| *axis != VIRTUALIZATION);
        Self {
            id,
            slug,
            is_baseline,
            platform: platform
                .map(|(axis, value)| (axis.as_str(), axis_text(value)))
                .collect(),
        }
    }

    fn is(&self, name: &str) -> bool {
        self.id == name || self.slug == name
    }
}

impl Serialize for Family {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::All => serializer.serialize_str(ALL),
            Self::AgainstBaseline => serializer.serialize_str(AGAINST_BASELINE),
            Self::SamePlatform => serializer.serialize_str(SAME_PLATFORM),
            Self::Pairs(pairs) => pairs.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Family {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl<'de> de::Visitor<'de> for Visitor {
            type Value = Family;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(
                    "`all`, `against-baseline`, `same-platform` or a list of pairs such as `[[a, b]]`",
                )
            }

            fn visit_str<E: de::Error>(self, name: &str) -> Result<Family, E> {
                match name {
                    ALL => Ok(Family::All),
                    AGAINST_BASELINE | AGAINST_CONTROLS => Ok(Family::AgainstBaseline),
                    SAME_PLATFORM => Ok(Family::SamePlatform),
                    other => Err(E::unknown_variant(other, NAMES)),
                }
            }

            fn visit_seq<A: de::SeqAccess<'de>>(self, mut items: A) -> Result<Family, A::Error> {
                let mut pairs = Vec::new();
                while let Some(pair) = items.next_element()? {
                    pairs.push(pair);
                }
                Ok(Family::Pairs(pairs))
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Family {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Family".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "description": "Which pairs of scenarios are asked about.",
            "anyOf": [
                { "enum": NAMES },
                {
                    "type": "array",
                    "items": { "type": "array", "items": { "type": "string" }, "minItems": 2, "maxItems": 2 },
                },
            ],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn members() -> Vec<Member<'static>> {
        let member = |id, slug, is_baseline, os: &str| Member {
            id,
            slug,
            is_baseline,
            platform: vec![("os", os.to_owned())],
        };
        vec![
            member("a", "ubuntu-native", true, "ubuntu"),
            member("b", "ubuntu-docker", false, "ubuntu"),
            member("c", "osx-native", true, "osx"),
        ]
    }

    #[test]
    fn each_family_has_the_pairs_that_its_name_says() {
        let pairs = |family: Family| family.pairs(&members());
        assert_eq!(pairs(Family::All), [(0, 1), (0, 2), (1, 2)]);
        assert_eq!(pairs(Family::AgainstBaseline), [(0, 1), (1, 2)]);
        assert_eq!(pairs(Family::SamePlatform), [(0, 1)]);
    }

    #[test]
    fn a_list_names_scenarios_by_letter_or_slug_in_any_order_and_each_pair_once() {
        let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
        let family = Family::Pairs(vec![
            pair("c", "a"),
            pair("ubuntu-native", "osx-native"),
            pair("b", "x"),
        ]);
        assert_eq!(family.pairs(&members()), [(0, 2)]);
        assert!(family.names().any(|name| name == "x"));
    }

    #[test]
    fn it_reads_back_as_it_is_written() {
        for text in [
            r#""all""#,
            r#""against-baseline""#,
            r#""same-platform""#,
            r#"[["a","b"]]"#,
        ] {
            let family: Family = serde_json::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&family).unwrap(), text);
        }
        let error = serde_json::from_str::<Family>(r#""everything""#).unwrap_err();
        assert!(error.to_string().contains("against-baseline"), "{error}");
    }
}
