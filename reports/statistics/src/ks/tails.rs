//! Which computation gives a p-value, and those that are known already: without ties a p-value depends on n, m and the
//! distance alone, so that half a million tests of samples of 60 need at most 60 of them. The main types are [`Tail`]
//! and [`KnownTails`].

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, OnceLock, PoisonError},
};

use super::{Method, Procedure, limit, paths::Band};

/// Cells of the recursion up to which the exact p-value is computed: a few seconds. n = m = 30 000 is within it at
/// any distance, larger samples when they are as close as those are that the test does not tell apart at once.
const EXACT_CELLS: u64 = 2_000_000_000;

/// How many p-values are remembered: some ten megabytes.
const REMEMBERED: usize = 1 << 17;

/// A p-value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Tail {
    pub(super) p: f64,
    pub(super) log10_p: f64,
    pub(super) method: Method,
}

impl Tail {
    /// The p-value of a distance of h / lcm that exists after each of `ends` of the pooled values.
    pub(super) fn given_ties(procedure: Procedure, n: usize, m: usize, h: u64, ends: &[usize]) -> Self {
        let band = Band::of(n, m, h, procedure.alternative);
        let method = match procedure.method {
            Method::Exact if band.cells() > EXACT_CELLS => Method::Asymptotic,
            asked => asked,
        };
        let (p, log10_p) = match method {
            Method::Exact => band.share_leaving(ends),
            Method::Asymptotic => limit::asymptotic(n, m, band.d(), procedure.alternative),
            Method::Paper => limit::paper(n, m, band.d(), procedure.alternative),
        };
        Self { p, log10_p, method }
    }

    /// The same without ties.
    pub(super) fn without_ties(procedure: Procedure, n: usize, m: usize, h: u64) -> Self {
        let ends: Vec<usize> = (1..=n + m).collect();
        Self::given_ties(procedure, n, m, h, &ends)
    }
}

/// What the p-value without ties depends on, in one operation on all pairs.
type Question = (usize, usize, u64);

/// The p-values that some thread has computed or is computing.
#[derive(Debug, Default)]
pub struct SharedTails(Mutex<HashMap<Question, Arc<OnceLock<Tail>>>>);

/// Those that this thread has seen, so that it need not ask the others.
#[derive(Debug, Default)]
pub(super) struct KnownTails {
    shared: Arc<SharedTails>,
    known: HashMap<Question, Tail>,
}

impl KnownTails {
    pub(super) fn beside(shared: Arc<SharedTails>) -> Self {
        Self {
            shared,
            known: HashMap::new(),
        }
    }

    /// As [`Tail::without_ties`]; always asked for the same procedure.
    pub(super) fn without_ties(&mut self, procedure: Procedure, n: usize, m: usize, h: u64) -> Tail {
        let question = (n, m, h);
        if let Some(tail) = self.known.get(&question) {
            return *tail;
        }
        let compute = || Tail::without_ties(procedure, n, m, h);
        let tail = match self.shared.place_of(question) {
            Some(place) => *place.get_or_init(compute),
            None => compute(),
        };
        if self.known.len() < REMEMBERED {
            self.known.insert(question, tail);
        }
        tail
    }
}

impl SharedTails {
    /// Where the answer is or will be; none if so many are remembered that this one will not be.
    fn place_of(&self, question: Question) -> Option<Arc<OnceLock<Tail>>> {
        let mut places = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let has_room = places.len() < REMEMBERED;
        match places.get(&question) {
            Some(place) => Some(place.clone()),
            None => has_room.then(|| places.entry(question).or_default().clone()),
        }
    }
}
