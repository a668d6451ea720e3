"""Expected values of the tests in src/analysis/conclusion.rs: a stratified permutation test of mean levels by enumeration, and the
shifts that it does not reject by looking at each of many. Only Python's own library."""

from itertools import combinations, product
from math import comb

FIRST = {"i7 osx": [0.120, 0.121, 0.1225, 0.124], "arm64 ubuntu": [0.110, 0.112]}
SECOND = {"i7 osx": [0.118, 0.1195, 0.121, 0.1205], "arm64 ubuntu": [0.1085, 0.1105, 0.109]}


def mean(values):
    return sum(values) / len(values)


def shift(strata):
    weights = [len(a) * len(b) / (len(a) + len(b)) for a, b in strata]
    return sum(w * (mean(b) - mean(a)) for w, (a, b) in zip(weights, strata)) / sum(weights)


def labellings(strata):
    def of_one(a, b):
        pooled = a + b
        for first in combinations(range(len(pooled)), len(a)):
            yield [pooled[i] for i in first], [pooled[i] for i in range(len(pooled)) if i not in first]

    return product(*(list(of_one(a, b)) for a, b in strata))


def p(strata):
    observed = abs(shift(strata))
    sizes = [abs(shift(labelling)) for labelling in labellings(strata)]
    return sum(size >= observed - 1e-12 for size in sizes) / len(sizes)


def moved(strata, by):
    return [(a, [value - by for value in b]) for a, b in strata]


strata = [(FIRST[name], SECOND[name]) for name in FIRST]
print("labellings", [comb(len(a) + len(b), len(a)) for a, b in strata])
print("shift (mm)", shift(strata) * 1e3, "each", [(mean(b) - mean(a)) * 1e3 for a, b in strata])
print("p", p(strata), "=", round(p(strata) * 700), "/ 700")
# The outermost shifts, in steps of 1 um beyond and then by halving, that are not rejected at 0.05.
for side in (-1, 1):
    inside, outside = shift(strata), shift(strata) + side * 0.02
    while abs(outside - inside) > 1e-9:
        middle = (inside + outside) / 2
        if p(moved(strata, middle)) > 0.05:
            inside = middle
        else:
            outside = middle
    print("limit (mm)", inside * 1e3)
