# %% [markdown]
# # A report in Python
#
# Reads what `matrix report` leaves in `RUN/report`, makes the paper's tables again from the single comparisons, and draws the
# two distribution functions of a pair anew. docs/report-columns.md names every column and its unit.
#
# A notebook with `# %%` cells (VS Code, Spyder, Jupytext), or a program: `python examples/report.py RUN [FIGURE.png]`, with
# polars and matplotlib (`pip install polars matplotlib`).

# %%
import json
import sys
from pathlib import Path

import polars as pl
import polars.selectors as cs

run = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/my-run")
folder = run / "report"
report = json.loads((folder / "report.json").read_text())
comparisons = pl.read_parquet(folder / "comparisons.parquet")
scenarios = pl.read_parquet(folder / "scenarios.parquet")
samples = pl.read_parquet(folder / "samples.parquet")
contrasts = pl.read_csv(folder / "contrasts.csv")  # the same as contrasts.parquet
print(f"{report['run']}: {len(report['scenarios'])} scenarios, {comparisons.height} comparisons of two windows")
if report["simulated"]:
    print("SIMULATED, NOT MEASURED")

# %% [markdown]
# ## Tables III to V: how many window pairs were rejected
#
# Each is a filter, a join or a pivot of the counts, and these are a group-by of the comparisons.

# %%
counts = comparisons.group_by(
    cs.by_name("a", "b", "same_scenario") | cs.matches("^[ab]_(platform|os|virtualization|is_control)$"),
    maintain_order=True,
).agg(pairs=pl.len(), rejected=pl.col("rejected").sum())

# III: each scenario that can run against itself. Without data there is no count, and never a zero.
table_3 = (
    scenarios.filter("can_run")
    .join(counts.filter("same_scenario"), left_on="id", right_on="a", how="left", maintain_order="left")
    .select("id", "hardware", "os", "virtualization", "windows_counted", "pairs", "rejected")
)
print(table_3)

# IV: the baseline scenarios, which the paper calls controls, against each other, and two virtualizations on each platform.
controls = counts.filter("a_is_control", "b_is_control", ~pl.col("same_scenario"))
virtualizations = counts.filter(
    ~pl.col("a_is_control"),
    ~pl.col("b_is_control"),
    pl.col("a_platform") == pl.col("b_platform"),
    pl.col("a_virtualization") != pl.col("b_virtualization"),
)
table_4 = pl.concat([controls, virtualizations]).select("a", "a_os", "b", "b_os", "pairs", "rejected")
print(table_4)

# V: each baseline scenario against the others, which may stand on either side.
turned = {"a": "b", "b": "a"}
other_side = counts.rename(
    {name: turned[name[0]] + name[1:] for name in counts.columns if name[:2] in ("a", "b", "a_", "b_")}
).select(counts.columns)
against_control = pl.concat([counts, other_side]).filter("a_is_control", ~pl.col("b_is_control"))
table_5 = against_control.pivot("b_platform", index=["a", "b_virtualization"], values="rejected")
print(table_5)

# The report's own counts. Without data there is no row, and never a zero.
for row in counts.iter_rows(named=True):
    if row["a"] == row["b"]:
        [own] = [one for one in report["within"] if one["id"] == row["a"]]
    else:
        [own] = [one for one in report["between"] if {one["a"], one["b"]} == {row["a"], row["b"]}]
    assert (own["pairs"], own["rejected"]) == (row["pairs"], row["rejected"]), (own, row)

# %% [markdown]
# ## The window as the unit
#
# The counts share their windows: these p-values do not.

# %%
print(contrasts.select("a", "b", "p", "p_holm", pl.col("shift") * 1e3, "verdict").rename({"shift": "shift (mm)"}))

# %% [markdown]
# ## One figure again: the pair of windows that are furthest apart
#
# The distance is computed anew from the periods' errors and must be the report's.

# %%
pair = comparisons.sort("d", descending=True).row(0, named=True)


def errors_m(scenario, window):
    own = samples.filter((pl.col("scenario") == scenario) & (pl.col("window") == window))
    return own["value"].sort().to_list()


x, y = errors_m(pair["a"], pair["a_window"]), errors_m(pair["b"], pair["b_window"])
assert (len(x), len(y)) == (pair["n"], pair["m"])


def share(values, at):
    """Of the values, those that are at most so large."""
    return sum(value <= at for value in values) / len(values)


d, at = max((abs(share(x, at) - share(y, at)), at) for at in x + y)
assert abs(d - pair["d"]) < 1e-12, (d, pair)
assert abs(pair["d"] - pair["h"] / pair["lcm"]) < 1e-12
names = [f"{pair[side]} {pair[side + '_slug']}, window {pair[side + '_window']}" for side in "ab"]
print(f"{names[0]} against {names[1]}: D = {pair['h']}/{pair['lcm']} = {d:.3f}, log10 p = {pair['log10_p']:.2f}")

# %%
import matplotlib

if not hasattr(sys, "ps1"):
    matplotlib.use("Agg")  # without a screen
import matplotlib.pyplot as plt

figure, axes = plt.subplots(figsize=(6, 4))
for values, name, line in zip([x, y], names, ["-", "--"]):
    axes.ecdf(values, label=name, linestyle=line)
place = pair["at"]
axes.vlines(place, share(x, place), share(y, place), colors="black", label=f"D = {d:.3f}")
axes.set(xlabel=f"error of a period, {report['metric']} (m)", ylabel="share of periods with at most this error")
axes.legend()
figure.tight_layout()
if len(sys.argv) > 2:
    figure.savefig(sys.argv[2], dpi=150)
