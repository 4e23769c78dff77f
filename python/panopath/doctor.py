"""What is installed and what it can do: for a person whose program does not run, and for reports of errors."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import platform
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from panopath import _core

#: Extras for those who work on panopath itself.
_DEVELOPERS = {"all", "dev", "peers", "docs"}
_REQUIREMENT = re.compile(r"(?P<name>[A-Za-z0-9._-]+)(?:\[[^]]*\])?\s*(?P<range>[^;]*)")
_EXTRA = re.compile(r"""extra\s*==\s*['"](?P<extra>[^'"]+)['"]""")


@dataclass(frozen=True)
class Library:
    """A library that panopath needs, or that one of its extras does."""

    name: str
    #: As the package asks for it: ">=14".
    required: str
    #: None where it is absent.
    version: str | None
    #: Why it cannot be used, though it is there: too old, or what its import said.
    trouble: str = ""

    @property
    def is_ready(self) -> bool:
        """Whether it can be used."""
        return self.version is not None and not self.trouble


@dataclass(frozen=True)
class Diagnosis:
    """What :func:`diagnose` found."""

    version: str
    python: str
    system: str
    #: Platform that the compiled module was made for.
    built_for: str
    #: Vector instructions in use: avx512, avx2, neon or none.
    vector_instructions: str
    n_cores: int
    #: Threads that a step takes by itself; RAYON_NUM_THREADS changes it.
    n_threads: int
    #: Libraries of the base install.
    base: tuple[Library, ...]
    #: Libraries by extra.
    extras: Mapping[str, tuple[Library, ...]]

    @property
    def is_healthy(self) -> bool:
        """Whether the base install is whole, and nothing that is installed fails."""
        optional = [library for libraries in self.extras.values() for library in libraries]
        return all(library.is_ready for library in self.base) and not any(library.trouble for library in optional)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self) | {
            "extras": {name: [asdict(library) for library in libraries] for name, libraries in self.extras.items()},
            "is_healthy": self.is_healthy,
        }


def diagnose() -> Diagnosis:
    """Look at the installation: every library is imported once, so that one that cannot be is found."""
    info = _core.build_info()
    base: list[Library] = []
    extras: dict[str, list[Library]] = {}
    modules = _modules()
    for extra, name, wanted in _requirements():
        library = _look_at(name, wanted, modules)
        if extra is None:
            base.append(library)
        elif extra not in _DEVELOPERS:
            extras.setdefault(extra, []).append(library)
    return Diagnosis(
        version=_core.__version__,
        python=f"{platform.python_implementation()} {platform.python_version()}",
        system=platform.platform(),
        built_for=str(info["platform"]),
        vector_instructions=str(info["vector_instructions"]),
        n_cores=os.cpu_count() or 1,
        n_threads=int(info["threads"]),
        base=tuple(base),
        extras={name: tuple(libraries) for name, libraries in extras.items()},
    )


def _requirements() -> Iterator[tuple[str | None, str, str]]:
    """Yield extra, library and versions, as the metadata of the package has them."""
    try:
        lines = importlib.metadata.requires("panopath") or []
    except importlib.metadata.PackageNotFoundError:
        lines = []  # run from its sources, never installed
    for line in lines:
        found = _REQUIREMENT.match(line)
        extra = _EXTRA.search(line)
        if found is not None and found["name"] != "panopath":
            yield (extra["extra"] if extra else None), found["name"], found["range"].strip()


def _modules() -> dict[str, str]:
    """Find the module to import, by name of its distribution."""
    named: dict[str, str] = {}
    for module, distributions in importlib.metadata.packages_distributions().items():
        for distribution in distributions:
            known = named.get(distribution.lower())
            if not module.startswith("_") and (known is None or module.lower() == distribution.lower()):
                named[distribution.lower()] = module
    return named


def _look_at(name: str, wanted: str, modules: Mapping[str, str]) -> Library:
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return Library(name, wanted, None)
    if _is_older(version, wanted):
        return Library(name, wanted, version, "too old")
    try:
        importlib.import_module(modules.get(name.lower(), name.replace("-", "_")))
    except Exception as error:
        return Library(name, wanted, version, " ".join(str(error).split()) or type(error).__name__)
    return Library(name, wanted, version)


def _is_older(version: str, wanted: str) -> bool:
    """Whether a version lies below the lower bound."""
    least = re.search(r">=\s*([\d.]+)", wanted)
    return least is not None and _release(version) < _release(least[1])


def _release(version: str) -> tuple[int, ...]:
    """Take the numbers at the front, without zeros at their end."""
    found = re.match(r"\d+(?:\.\d+)*", version)
    numbers = [int(part) for part in found[0].split(".")] if found else []
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return tuple(numbers)
