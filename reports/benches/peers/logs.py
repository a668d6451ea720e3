# pandas' and polars' plain reads of the same logs, on one thread. Prints the seconds of each.
import os
import sys
import time

os.environ["POLARS_MAX_THREADS"] = "1"
import pandas
import polars

for read in (pandas.read_csv, polars.read_csv):
    begin = time.perf_counter()
    for path in sys.argv[1:]:
        read(path)
    print(time.perf_counter() - begin)
