# A loop over SciPy's exact test: neighbouring samples of a file with one sample a line. Prints the seconds that the loop
# took, then a p-value a line.
import sys
import time

from scipy import stats

samples = [[float(value) for value in line.split(",")] for line in open(sys.argv[1])]
stats.ks_2samp(samples[0], samples[1], method="exact")
begin = time.perf_counter()
p = [stats.ks_2samp(x, y, method="exact").pvalue for x, y in zip(samples, samples[1:])]
print(time.perf_counter() - begin)
print("\n".join(map(repr, map(float, p))))
