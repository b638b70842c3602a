"""Many presses at once: which files belong together, and what the presses say together."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from data_schemas import ComparedPair, CompareError, Interval

_ENDINGS = (".json", ".press", ".capture")
_WORST = 5


def pair_by_name(simulated: Iterable[str], captured: Iterable[str]) -> tuple[dict[str, tuple[str, str]], list[str]]:
    """Pair file names: ``one.press.json`` belongs to ``one.capture.json`` (or both are ``one.json``).

    Parameters
    ----------
    simulated, captured
        File names of the two folders; where one holds names ending in ``.press.json`` (``.capture.json``) only these
        count in it.

    Returns
    -------
    dict
        Name -> (simulated, captured), by name.
    list of str
        Files without partner.

    Raises
    ------
    CompareError
        No name occurs in both.
    """
    press, capture = ".press.json", ".capture.json"
    first, second = _by_name(simulated, press, capture), _by_name(captured, capture, press)
    names = sorted(first.keys() & second.keys())
    if not names:
        raise CompareError(
            f"no press has a capture of its name ({len(first)} presses, {len(second)} captures): name them "
            "one.press.json and one.capture.json, or list the pairs in a CSV file with columns simulated, captured "
            "(--pairs)"
        )
    alone = [file for side, other in ((first, second), (second, first)) for n, file in side.items() if n not in other]
    return {name: (first[name], second[name]) for name in names}, sorted(alone)


def _by_name(files: Iterable[str], ending: str, other: str) -> dict[str, str]:
    """Return name without endings -> file."""
    every = [file for file in files if file.endswith(".json") and not file.endswith(other)]
    chosen = [file for file in every if file.endswith(ending)] or every
    return {pair_name(file): file for file in sorted(chosen)}


def pair_name(file: str) -> str:
    """Return a file's name without .json, .press and .capture."""
    for ending in _ENDINGS:
        file = file.removesuffix(ending)
    return file


def pairs_of_rows(rows: Sequence[Mapping[str, str | None]]) -> dict[str, tuple[str, str]]:
    """Return name -> (simulated, captured) of the rows of a table with these two columns, and ``name`` if it likes.

    Raises
    ------
    CompareError
        A column is missing, a cell is empty, a name occurs twice, or there is no row.
    """
    pairs: dict[str, tuple[str, str]] = {}
    for number, row in enumerate(rows, start=1):
        simulated, captured = ((row.get(column) or "").strip() for column in ("simulated", "captured"))
        if not simulated or not captured:
            raise CompareError(
                f"row {number}: needs a file in each of the columns simulated, captured; got {dict(row)}"
            )
        name = (row.get("name") or "").strip() or pair_name(captured.replace("\\", "/").rsplit("/", 1)[-1])
        if name in pairs:
            raise CompareError(f"row {number}: the name {name!r} occurs twice; add a column name with one of its own")
        pairs[name] = simulated, captured
    if not pairs:
        raise CompareError("no pair is listed; give one row per press under the header simulated,captured")
    return pairs


def mean_skill(skills: NDArray[np.float64]) -> Interval | None:
    """Return the mean over presses with its 95 % interval by Student's t: mean +- t(0.975, n - 1) s / sqrt(n).

    Drawing presses with replacement instead would hold the truth in half the cases of two presses and in four of five
    of four. The noise is taken out of single skills, so that means may lie above 1; an interval altogether above it
    says that model and noise disagree. None with fewer than two presses.
    """
    if skills.size < 2:
        return None
    half = float(student_t.ppf(0.975, skills.size - 1) * skills.std(ddof=1) / np.sqrt(skills.size))
    mean = float(skills.mean())
    return Interval(estimate=mean, low95=mean - half, high95=mean + half)


def worst_pairs(pairs: Iterable[ComparedPair]) -> tuple[str, ...]:
    """Return the names of the five pairs of lowest skill, the lowest first."""
    scored = sorted((pair.skill.estimate, pair.name) for pair in pairs if pair.skill is not None)
    return tuple(name for _, name in scored[:_WORST])
