"""Who notices that a scene is ambiguous: the certificate, a dense null space, or the solver's own status.

``python -m benchmarks.rigidity`` runs the suite of configurations with exact truth (``tests/rigidity_suite.py``),
without noise and with it. It prints for each method how often an ambiguous scene passes for determined (a miss), how
often a determined one is called undetermined (a false alarm) or weak, and the median time of one verdict; then the
certificate's verdicts by family.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import panopath as pp
from panopath.certificate import Verdict

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from rigidity_suite import (
    Configuration,
    configurations,
    exact_case,
    faults,
    is_whole,
    noisy_case,
    rigidity_matrix,
)

NOISE_DEG = (0.0, 0.02, 0.05, 0.1)
#: The certificate is told this where there is no noise.
EXACT_SIGMA_RAD = 1e-9
#: Singular values below this share of the largest are zero to the dense method.
DENSE_TOLERANCE = 1e-9

Method = Callable[[Configuration, pp.Tracks, pp.Scene, float], Verdict]


@dataclass(frozen=True)
class Answer:
    """One verdict on one configuration."""

    configuration: Configuration
    noise_deg: float
    #: Whether the solver claims to have solved all of it.
    whole: bool
    verdict: Verdict
    seconds: float


def main() -> None:
    methods: dict[str, Method] = {"certify": certificate, "dense null space": dense, "status of the solver": status}
    answers: dict[str, list[Answer]] = {name: [] for name in methods}
    for noise_deg in NOISE_DEG:
        for c in configurations():
            tracks, scene = noisy_case(c, np.radians(noise_deg)) if noise_deg else exact_case(c)
            sigma_rad = float(np.radians(noise_deg)) or EXACT_SIGMA_RAD
            for name, method in methods.items():
                clock = time.perf_counter()
                verdict = method(c, tracks, scene, sigma_rad)
                seconds = time.perf_counter() - clock
                answers[name].append(Answer(c, noise_deg, is_whole(scene), verdict, seconds))
    print_methods(answers)
    print_families(answers["certify"])
    print_faults()


def certificate(c: Configuration, tracks: pp.Tracks, scene: pp.Scene, sigma_rad: float) -> Verdict:
    options = pp.CertifyOptions(orientation=c.orientation, sigma_rad=sigma_rad)
    return Verdict(pp.certify(tracks, scene, options).verdict)


def dense(c: Configuration, tracks: pp.Tracks, scene: pp.Scene, sigma_rad: float) -> Verdict:
    """Null space of the dense matrix at the scene, by a fixed tolerance; what textbooks do."""
    lengths = np.linalg.norm(scene.points[tracks.track] - scene.centers[tracks.view], axis=1)
    if not (np.isfinite(lengths).all() and lengths.min() > DENSE_TOLERANCE * lengths.max()):
        return Verdict.UNDETERMINED
    matrix = rigidity_matrix(replace(c, centers=scene.centers, points=scene.points))
    values = np.linalg.svd(matrix, compute_uv=False)
    nullity = matrix.shape[1] - int((values > DENSE_TOLERANCE * values[0]).sum())
    return Verdict.DETERMINED if nullity == c.gauge_freedoms else Verdict.UNDETERMINED


def status(c: Configuration, tracks: pp.Tracks, scene: pp.Scene, sigma_rad: float) -> Verdict:
    """Believe the solver; it is not asked where the truth is given."""
    return Verdict.DETERMINED if is_whole(scene) else Verdict.UNDETERMINED


def print_methods(answers: dict[str, list[Answer]]) -> None:
    print("| noise (deg) | method | misses | false alarms | determined, called weak | ms a verdict |")
    print("|---|---|---|---|---|---|")
    for noise_deg in NOISE_DEG:
        for name, every in answers.items():
            if not noise_deg and name == "status of the solver":
                continue
            found = [a for a in every if a.noise_deg == noise_deg]
            loose = [a for a in found if a.configuration.ambiguous]
            firm = [a for a in found if not a.configuration.ambiguous]
            misses = sum(a.verdict == Verdict.DETERMINED for a in loose)
            alarms = sum(a.verdict == Verdict.UNDETERMINED for a in firm)
            excused = sum(a.verdict == Verdict.UNDETERMINED and not a.whole for a in firm)
            weak = sum(a.verdict == Verdict.WEAK for a in firm)
            milliseconds = "" if name.startswith("status") else f"{1e3 * np.median([a.seconds for a in found]):.2f}"
            print(
                f"| {noise_deg:g} | {name} | {misses} of {len(loose)} "
                f"| {alarms} of {len(firm)} ({excused} where the solver gave up) | {weak} | {milliseconds} |"
            )


def print_families(answers: list[Answer]) -> None:
    print("\nVerdicts of certify: determined / weak / undetermined\n")
    print("| family | configurations | ambiguous |" + "".join(f" {noise:g} deg |" for noise in NOISE_DEG))
    print("|---|---|---|" + "---|" * len(NOISE_DEG))
    for family in dict.fromkeys(c.family for c in configurations()):
        for ambiguous in (False, True):
            own = [a for a in answers if (a.configuration.family, a.configuration.ambiguous) == (family, ambiguous)]
            cells = []
            for noise_deg in NOISE_DEG:
                count = Counter(a.verdict for a in own if a.noise_deg == noise_deg)
                cells.append(f" {' / '.join(str(count[verdict]) for verdict in Verdict)} |")
            if own:
                print(f"| {family} | {len(own) // len(NOISE_DEG)} | {'yes' if ambiguous else 'no'} |" + "".join(cells))


def print_faults() -> None:
    """Nullity, components and causes without noise, where they are not the exact ones."""
    wrong = []
    for c in configurations():
        options = pp.CertifyOptions(orientation=c.orientation, sigma_rad=EXACT_SIGMA_RAD)
        wrong += faults(c, pp.certify(*exact_case(c), options))
    print(f"\n{len(wrong)} faults without noise in {len(configurations())} configurations")
    for line in wrong:
        print(line)


if __name__ == "__main__":
    main()
