"""Speed of daest beside its peers, in one process run: the table of docs/speed.md and its picture.

    python benchmarks/speed.py [--rows N] [--repeat N] [--only PART] [--project FOLDER] [--table FILE]

Figures are medians of processor time; each pair is measured in turn, so that both share the load of the
machine. Processes are measured from outside, with all that they load. The peer of a command is the
interpreter that loads numpy, scipy.linalg, scipy.sparse and casadi and does nothing. A diagnosis runs in a
process of its own, once with an empty cache of compiled code and once more with what the first run compiled;
the stages of the second are told with their shares, those of refits by their effect. `--project` adds the
diagnosis of a project folder of one's own, where a daest.toml stands.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

from command_speed import process_rows, table_rows
from diagnosis_speed import diagnosis_rows, screen_rows
from filter_speed import kalman_rows, nonlinear_rows
from growth_speed import Growth, drawn, growths
from timed import Row, in_turn

from daest.machine import described

SIZES = (("Chain", 118), ("Chain", 588), ("Rigid", 286), ("long chain", 5882))  # models of `size.py`
PARTS = ("kalman", "nonlinear", "table", "process", "size", "screen", "diagnosis", "growth")
PICTURE = "speed_growth.svg"


def size_rows() -> Iterator[Row]:
    import size

    for name, n in SIZES:
        dae = size.model(name, n)
        (seconds,) = in_turn([lambda dae=dae: size.by_sparse_form(dae)], 1)
        yield Row(f"noise verdict, {name}, {dae.n} equations", "s", seconds)


def markdown(rows: list[Row], growth: list[Growth]) -> str:
    names = ("numpy", "scipy", "casadi", "statsmodels", "pyarrow", "pandas")
    lines = [
        "# Speed",
        "",
        "`python benchmarks/speed.py --table docs/speed.md` measures this page in one process run. Figures",
        "are medians of processor time on one core where nothing else is said; the last column says how many",
        "times faster daest is. `--project FOLDER` adds the diagnosis of a project of one's own.",
        "",
        f"{described(names)}. A load above 1 makes figures larger than on a quiet machine; ratios stay.",
        "",
        "| step | daest | peer | its figure | times faster |",
        "|---|---|---|---|---|",
        *(f"| {' | '.join(row.cells())} |" for row in rows),
    ]
    if growth:
        lines += [
            "",
            "## How time grows",
            "",
            "Processor time goes with a power of the size, fitted over the larger half of the sizes.",
            "",
            f"![Times over sizes, in decades, with the fitted powers]({PICTURE})",
            "",
            "| step | of | from | to | longest | exponent |",
            "|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {g.step} | {g.what} | {g.sizes[0]:g} | {g.sizes[-1]:g} | {g.seconds[-1]:.3g} s "
            f"| {g.exponent:.2f} |"
            for g in growth
        ]
    return "\n".join([*lines, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rows", type=int, default=5_000_000, help="of the long CSV file")
    parser.add_argument("--repeat", type=int, default=3, help="of files and processes")
    parser.add_argument(
        "--table", type=Path, help="write the table there as Markdown, and its picture beside it"
    )
    parser.add_argument("--project", type=Path, action="append", default=[], help="diagnose this one, too")
    parser.add_argument("--only", choices=PARTS)
    options = parser.parse_args()
    print(described(), flush=True)
    rows: list[Row] = []
    growth: list[Growth] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parts = (
            kalman_rows(),
            nonlinear_rows(),
            table_rows(folder, options.rows, options.repeat),
            process_rows(folder, options.repeat),
            size_rows(),
            screen_rows(),
            diagnosis_rows(folder, options.project),
        )
        for part, found in zip(PARTS, parts, strict=False):
            for row in found if options.only in (None, part) else ():
                print("  ".join(row.cells()), flush=True)
                rows.append(row)
        for one in growths() if options.only in (None, "growth") else ():
            print(
                f"{one.step}: {one.what}^{one.exponent:.2f}",
                *zip(one.sizes, one.seconds, strict=True),
                flush=True,
            )
            growth.append(one)
    if options.table is not None:
        options.table.write_text(markdown(rows, growth), encoding="utf-8")
        if growth:
            drawn(growth, options.table.with_name(PICTURE))


if __name__ == "__main__":
    main()
