"""What others tell of series, night by night: reads lines of JSON {"values": [...], "from": 60}, and writes for each a line of
JSON with the changes of each peer, [[the night in which it was told, the first night with it], ...].

In each night a peer sees the newest 150 nights. What it finds within five nights of a change that it told of is that change.
"""

import json
import math
import multiprocessing
import sys

import numpy
import ruptures
from otava.analysis import compute_change_points

SEES = 150
SAME = 5


def otava(values):
    """Apache Otava with its defaults: windows of 50, p < 0.001."""
    changes, _ = compute_change_points(values, window_len=50, max_pvalue=0.001, min_magnitude=0.0)
    return [change.index for change in changes]


def pelt(values):
    """Killick, Fearnhead and Eckley 2012, for changes of the mean, with a penalty of 3 ln n (Zhang and Siegmund 2007). The scale is
    that of the differences of successive nights, which a change of level hardly moves."""
    if len(values) < 10:
        return []
    differences = numpy.abs(numpy.diff(values))
    scale = numpy.median(differences) / 0.6745 / math.sqrt(2.0)
    if scale == 0.0:
        scale = numpy.std(values) or 1.0
    series = (numpy.asarray(values) / scale).reshape(-1, 1)
    found = ruptures.KernelCPD(kernel="linear", min_size=2).fit(series).predict(pen=3.0 * math.log(len(values)))
    return found[:-1]


def perfherder(values):
    """Mozilla's rule: |t| above 7 between the 12 to 24 nights before and the 12 from a night on, by means whose weights fall linearly
    with the distance, where neither neighbour has a larger one. Written anew after its description."""

    def t(at):
        before, after = values[max(0, at - 24) : at][::-1], values[at : at + 12]
        if len(before) < 2 or len(after) < 2:
            return 0.0
        means, of_means = [], 0.0
        for side in (before, after):
            weights = 1.0 - numpy.arange(len(side)) / len(side)
            means.append(numpy.average(side, weights=weights))
            of_means += numpy.square(side - means[-1]).sum() / (len(side) - 1) / len(side)
        shift = abs(means[1] - means[0])
        return shift / math.sqrt(of_means) if of_means > 0.0 else (math.inf if shift > 0.0 else 0.0)

    values = numpy.asarray(values)
    last = len(values) - 12
    # An earlier place was looked at in an earlier night.
    places = range(max(12, last - 1), last + 1)
    return [at for at in places if t(at) > 7.0 and t(at - 1) <= t(at) >= t(at + 1)]


PEERS = {"otava": otava, "perfherder": perfherder, "pelt": pelt}


def nightly(detect, values, first):
    """The changes that are told from the night `first` on."""
    told = []
    for night in range(first, len(values)):
        begins = max(0, night + 1 - SEES)
        for place in detect(values[begins : night + 1]):
            at = int(begins + place)
            if all(abs(at - known) > SAME for _, known in told):
                told.append([night, at])
    return told


def answer(line):
    question = json.loads(line)
    return json.dumps({name: nightly(detect, question["values"], question["from"]) for name, detect in PEERS.items()})


if __name__ == "__main__":
    with multiprocessing.Pool() as pool:
        for row in pool.imap(answer, sys.stdin, chunksize=4):
            print(row, flush=True)
