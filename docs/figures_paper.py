"""The page of the paper's experiments: ``python -m docs.figures_paper`` runs all of them, some minutes long.

Pictures and their records go to docs/img/paper, the page to docs/paper-experiments.md; raw results stay in a temporary
folder, since ``panopath paper all`` gives them to whoever wants them.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path

from panopath.paper import EXPERIMENTS, Record, Settings, run_experiment
from panopath.paper.record import summary_text

from benchmarks.run import machine, versions

HERE = Path(__file__).parent
IMAGES = HERE / "img" / "paper"
PAGE = HERE / "paper-experiments.md"
HEAD = """# The experiments of the paper

Written by `python -m docs.figures_paper`; do not edit. Every figure, table and theorem of the 2007 paper that can
be run, run: what it says, in our words, beside what came out. *Agrees*, *in part*, *corrected*: the last with what
holds instead; why is in [The paper](paper.md). All experiments took {minutes:.1f} minutes, {date}, on
{machine}.
`panopath paper all -o OUT` does the same and leaves the raw results, a row a trial; `--seed` and `--trials` make
other draws.

| experiment | section | statements | agree | in part | corrected | trials | seconds |
|---|---|---|---|---|---|---|---|
{rows}
"""


def main() -> None:
    records = []
    with tempfile.TemporaryDirectory() as folder:
        for name, experiment in EXPERIMENTS.items():
            records.append(run_experiment(experiment, folder, Settings()))
            sys.stdout.write(f"{name}: {records[-1].wall_s:.1f} s\n")
            sys.stdout.flush()
        shutil.rmtree(IMAGES, ignore_errors=True)
        IMAGES.mkdir(parents=True)
        for picture in sorted(Path(folder).glob("*.png")):
            shutil.copyfile(picture, IMAGES / picture.name)
    PAGE.write_text(page_text(records), encoding="utf-8")


def page_text(records: list[Record]) -> str:
    rows = []
    for record in records:
        verdicts = [one.verdict.value for one in record.statements]
        counts = [len(verdicts), *(verdicts.count(kind) for kind in ("agrees", "in part", "corrected"))]
        cells = (f"[`{record.name}`](#{_anchor(record.title)})", record.section, *counts, f"{record.n_trials:,}")
        rows.append(f"| {' | '.join(map(str, cells))} | {record.wall_s:.1f} |")
    head = HEAD.format(
        minutes=sum(record.wall_s for record in records) / 60.0,
        date=f"{datetime.now(UTC):%Y-%m-%d}",
        machine=_machine(),
        rows="\n".join(rows),
    )
    body = summary_text(records, "img/paper/").split("\n", 2)[2]
    return head + "\n" + body


def _machine() -> str:
    """Processor and the versions that count."""
    found, known = machine(), versions()
    packages = ", ".join(f"{name} {known[name]}" for name in ("python", "panopath", "numpy"))
    return f"{found['cpu']}, {found['cores']} cores, {found['system']}; {packages}"


def _anchor(title: str) -> str:
    """Anchor that a heading gets: small letters, hyphens for spaces, the rest dropped."""
    return "".join(c for c in title.lower().replace(" ", "-") if c.isalnum() or c in "-_")


if __name__ == "__main__":
    main()
