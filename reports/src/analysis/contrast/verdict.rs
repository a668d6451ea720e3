//! What may be said of a pair.

use statistics::effect::Interval;

/// What may be said of a pair at the level α and with the equivalence margin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// So few windows in such a family cannot reach α, whatever they are.
    CannotTell,
    /// α could have been reached, and was not. Not the same as no difference.
    NotToldApart,
    /// The simultaneous interval of the shift lies within the equivalence margin, whatever p is.
    Immaterial,
    /// Their mean levels differ; no equivalence margin was declared.
    Differ,
    /// Their levels differ, and the whole simultaneous interval of the shift lies beyond the margin.
    DifferMaterially,
    /// Their mean levels differ, and it is open whether by as much as the margin.
    DifferByUnknown,
    /// Their levels differ, and it is open whether in the mean or in how they spread.
    DifferLevelOpen,
}

/// What a verdict is made of.
#[derive(Debug, Clone, Copy)]
pub(super) struct Evidence {
    /// Of equal distributions, by Holm's method.
    pub(super) p_holm: f64,
    /// The smallest that it can be with these numbers of windows in the family.
    pub(super) smallest_p_holm: f64,
    /// Of equal means, by Holm's method; none where it cannot be tested.
    pub(super) p_shift_holm: Option<f64>,
    /// An interval of the shift that holds for all pairs at once.
    pub(super) simultaneous: Option<Interval>,
}

impl Verdict {
    /// Statements that two scenarios differ are by Holm's p, and those on the margin by the simultaneous interval: in a family with
    /// any number of pairs the chance of an untrue statement of either kind is at most α.
    pub(super) fn of(evidence: &Evidence, alpha: f64, limit: Option<f64>) -> Self {
        let interval = evidence.simultaneous;
        let within = |limit: f64| interval.is_some_and(|i| i.low > -limit && i.high < limit);
        let beyond = |limit: f64| interval.is_some_and(|i| i.low > limit || i.high < -limit);
        let differ = evidence.p_holm < alpha;
        let in_the_mean = evidence.p_shift_holm.is_some_and(|p| p < alpha);
        match limit {
            Some(limit) if within(limit) => Self::Immaterial,
            Some(limit) if differ && beyond(limit) => Self::DifferMaterially,
            _ if differ && !in_the_mean => Self::DifferLevelOpen,
            Some(_) if differ => Self::DifferByUnknown,
            None if differ => Self::Differ,
            _ if evidence.smallest_p_holm >= alpha => Self::CannotTell,
            _ => Self::NotToldApart,
        }
    }

    /// Whether the two are told apart, by whatever it is.
    #[must_use]
    pub const fn is_difference(self) -> bool {
        match self {
            Self::CannotTell | Self::NotToldApart | Self::Immaterial => false,
            Self::Differ | Self::DifferMaterially | Self::DifferByUnknown | Self::DifferLevelOpen => true,
        }
    }

    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::CannotTell => "cannot tell",
            Self::NotToldApart => "not told apart",
            Self::Immaterial => "immaterial",
            Self::Differ => "differ",
            Self::DifferMaterially => "differ, matters",
            Self::DifferByUnknown => "differ, size open",
            Self::DifferLevelOpen => "differ, level open",
        }
    }
}
