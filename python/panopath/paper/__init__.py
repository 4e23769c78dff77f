"""The experiments of the 2007 paper, run again: what it states, what comes out, and whether the two agree.

Each experiment is a file here, one function from settings to an outcome: tables of raw results, pictures, and a list of
statements with the paper's words on one side and what was measured on the other. :func:`run_experiment` runs one by its
name and writes what came out; it knows nothing of what they are about.
"""

from panopath.paper.catalogue import EXPERIMENTS
from panopath.paper.experiment import Experiment, Outcome, Settings, Statement, Table, Verdict
from panopath.paper.record import Record, run_experiment, write_summary

__all__ = [
    "EXPERIMENTS",
    "Experiment",
    "Outcome",
    "Record",
    "Settings",
    "Statement",
    "Table",
    "Verdict",
    "run_experiment",
    "write_summary",
]
