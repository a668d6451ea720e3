"""Expected values of the unit tests of permutation, multiplicity, effect, merged, energy, anderson_darling, dependence.

python3 -m venv venv && venv/bin/pip install scipy==1.17.1 statsmodels==0.15.0 && venv/bin/python window_tests.py
"""

import numpy as np
import scipy.stats as st
from statsmodels.stats.multitest import multipletests
from statsmodels.tsa.stattools import acf


def apart(x, y, axis=-1):
    return np.abs(np.mean(x, axis=axis) - np.mean(y, axis=axis))


for x, y in [
    ([0.236, 0.241, 0.239, 0.240], [0.238, 0.2405, 0.2425, 0.244]),
    ([1.0, 2.0], [1.5, 2.5, 4.0]),
    ([0.1, 0.2, 0.3], [0.1, 0.2, 0.3]),
]:
    print("permutation", st.permutation_test((x, y), apart, alternative="greater", n_resamples=np.inf).pvalue)

raw = [0.01, 0.04, 0.03, 0.005, 0.5, 0.04, 1.0]
print("holm", multipletests(raw, method="holm")[1])
print("benjamini-yekutieli", multipletests(raw, method="fdr_by")[1])

a, b = [0.23, 0.25, 0.24, 0.22, 0.26], [0.25, 0.27, 0.24, 0.29, 0.25, 0.21]
print("wasserstein", st.wasserstein_distance(a, b), st.wasserstein_distance([0, 1, 3], [5, 6, 8]))
print("superiority", st.mannwhitneyu(b, a).statistic, "of", len(a) * len(b))
print("energy", st.energy_distance([0, 0, 0, 8], [0, 0, 8, 8]) ** 2, st.energy_distance([1, 2], [4]) ** 2)

laboratories = [
    [38.7, 41.5, 43.8, 44.5, 45.5, 46.0, 47.7, 58.0],
    [39.2, 39.3, 39.7, 41.4, 41.8, 42.9, 43.3, 45.8],
    [34.0, 35.0, 39.0, 40.0, 43.0, 43.0, 44.0, 45.0],
    [34.0, 34.8, 34.8, 35.4, 37.2, 37.8, 41.2, 42.8],
]
print("anderson-darling", st.anderson_ksamp(laboratories).statistic)
print("autocorrelation", acf([1.0, 2.0, 4.0, 3.0, 5.0, 6.0, 5.0, 7.0], nlags=3))
