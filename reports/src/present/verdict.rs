//! What a report found, in one sentence that says no more than was measured: [`Report::verdict`].

use crate::analysis::{contrast::Verdict, report::Report, scenario::Standing};

/// Pairs up to which each is named.
const MOST_NAMED: usize = 6;

impl Report {
    /// The verdict on the declared family, with the window as the unit. What could not be measured is never no difference.
    #[must_use]
    pub fn verdict(&self) -> String {
        let simulated = match self.is_simulated() {
            true => "Simulated, not measured: ",
            false => "",
        };
        format!("{simulated}{}", self.finding())
    }

    fn finding(&self) -> String {
        let pairs = &self.contrasts.pairs;
        if pairs.is_empty() {
            let completed = self
                .scenarios
                .iter()
                .filter(|it| it.standing == Standing::Completed);
            return format!(
                "No two scenarios of the family have windows that count: nothing can be said of a difference ({} of {} scenarios \
                 completed).",
                completed.count(),
                self.scenarios.len()
            );
        }
        let of = |wanted: &[Verdict]| -> Vec<String> {
            let found = pairs.iter().filter(|pair| wanted.contains(&pair.verdict));
            found.map(|pair| format!("{}–{}", pair.a, pair.b)).collect()
        };
        let differ = of(&[
            Verdict::Differ,
            Verdict::DifferMaterially,
            Verdict::DifferByUnknown,
        ]);
        let level_open = of(&[Verdict::DifferLevelOpen]);
        let immaterial = of(&[Verdict::Immaterial]);
        let open = of(&[Verdict::NotToldApart]);
        let hopeless = of(&[Verdict::CannotTell]);
        let all = pairs.len();
        let missing = match self.contrasts.without_data.len() {
            0 => String::new(),
            without => format!(
                "; {without} further {} no data",
                if without == 1 { "has" } else { "have" }
            ),
        };
        let mut parts = Vec::new();
        for (found, what) in [
            (&differ, "differ"),
            (
                &level_open,
                "differ, and it is open whether in the mean or in the spread of their windows alone",
            ),
            (
                &immaterial,
                "differ by no more than what is declared not to matter",
            ),
            (
                &open,
                "are not told apart, which is not the same as no difference",
            ),
            (
                &hopeless,
                "cannot be told apart by so few windows, however large the difference",
            ),
        ] {
            if !found.is_empty() {
                parts.push(format!("{} {what}{}", found.len(), named(found)));
            }
        }
        let noun = if all == 1 { "pair" } else { "pairs" };
        format!(
            "{all} {noun} of scenarios compared: {}{missing} (Holm's p at {}).",
            parts.join("; "),
            self.settings.alpha
        )
    }
}

fn named(pairs: &[String]) -> String {
    match pairs.len() {
        0 => String::new(),
        few if few <= MOST_NAMED => format!(" ({})", pairs.join(", ")),
        _ => String::new(),
    }
}
