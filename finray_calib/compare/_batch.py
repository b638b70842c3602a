r"""Many presses at once: which files belong together, what they say together, and a table that they teach.

The table is the yardstick that a simulator has to beat. Around a contact the picture changes by a factor that depends
on the distance from its outline (in half-widths), on the direction of the outline there, and smoothly on the place in
the picture:

.. math:: S / B - 1 = \frac{w}{w_0} \sum_{ijk} c_{ijk}\, h_i(d)\, a_j(\varphi)\, m_k(x, y)

with hat functions h of the distance d that break at the rim, a = 1, cos, sin, cos 2, sin 2 of the direction, m = 1, x,
y and the half-width w. It knows neither optics nor mechanics, but it does know the halo, which is taught too.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from data_schemas import (
    ComparedPair,
    CompareError,
    SimulatedPress,
    SimulatorScore,
    SkillDifference,
    SkillOverPresses,
    TactileCapture,
)
from finray_calib.compare._tone_curve import far_gain
from finray_calib.sensing import contact_distance, contact_sha256, full_scale_dn, rgb_image

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

TABLE_LABEL: Final = "table of other presses, not rendered"
RIDGE_REL: Final = 0.03
"""Ridge penalty on the coefficients, relative to the mean diagonal of the normal matrix. With six real presses 0.003
and 0.03 predict equally well; the larger was taken, which makes the coefficients smaller."""
REACH: Final = 2.6
"""What is farther from the contact, in half-widths, teaches nothing and is left as it is."""

_INNER = np.linspace(0.0, 1.0, 7)
_OUTER = np.array([1.0, 1.06, 1.15, 1.3, 1.5, 1.8, 2.2, 2.8])
_TERMS = 5 * 3 * (len(_INNER) + len(_OUTER))
_STRIDE_PX = 4
_PIXELS_AT_ONCE = 20_000


@dataclass(frozen=True, slots=True)
class PressTable:
    """What presses of one sensor taught.

    Attributes
    ----------
    coefficients : ndarray, shape (terms, 3)
    half_width_px : float
        Mean half-width of the contacts that taught.
    shape_px : tuple of int
        Rows and columns of the images.
    training_presses : tuple of str
        Names of the presses.
    training_sha256 : tuple of str
        SHA-256 of their contact images: a press under another name is known by it.
    """

    coefficients: Floats
    half_width_px: float
    shape_px: tuple[int, int]
    training_presses: tuple[str, ...]
    training_sha256: tuple[str, ...]


def train_table(captures: Sequence[TactileCapture]) -> PressTable:
    """Fit the table to presses of one sensor by ridge regression.

    Parameters
    ----------
    captures
        One or more, each with its contact. The gain of each against its no-contact image is taken from pixels far from
        the contact, where there are enough.

    Raises
    ------
    CompareError
        There is none, one does not tell where its contact is, images differ in size, or all pixels near the contacts
        are clipped or dark.
    """
    if not captures:
        raise CompareError("no press was given, but a table needs at least one press to train on")
    distances = [_distance(capture) for capture in captures]
    shape = distances[0].shape
    width_px = float(np.mean([_half_width_px(d) for d in distances]))
    normal, right = np.zeros((_TERMS, _TERMS)), np.zeros((_TERMS, 3))
    for capture, distance in zip(captures, distances, strict=True):
        if distance.shape != shape:
            raise CompareError(
                f"{capture.name} is {distance.shape[1]} x {distance.shape[0]} px but {captures[0].name} is {shape[1]} "
                f"x {shape[0]} px; train with captures of one camera"
            )
        contact, level = levelled_images(capture, distance)
        used = _near(distance) & np.isfinite(contact + level).all(axis=-1) & (level > 0.0).all(axis=-1)
        used[np.arange(shape[0]) % _STRIDE_PX > 0] = False
        used[:, np.arange(shape[1]) % _STRIDE_PX > 0] = False
        terms = _terms(distance, used, width_px)
        target = contact[used] / level[used] - 1.0
        normal += terms.T @ terms
        right += terms.T @ target
    if not normal.any():
        raise CompareError(
            "no pixel near the contact of any press can be used, because all are clipped, or at or below the black "
            "level without contact; check circles, exposure and black level, or give other presses to train on"
        )
    penalty = RIDGE_REL * np.trace(normal) / len(normal) * np.eye(len(normal))
    coefficients = np.linalg.solve(normal + penalty, right)
    names, digests = zip(*((capture.name, contact_sha256(capture)) for capture in captures), strict=True)
    return PressTable(coefficients, width_px, (shape[0], shape[1]), names, digests)


def levelled_images(capture: TactileCapture, distance: Floats) -> tuple[Floats, Floats]:
    """Return the contact image of a capture and its no-contact image under the same light, (H, W, 3) in DN.

    Parameters
    ----------
    capture
        Its gain against the no-contact image is taken from pixels far from the contact, where there are enough.
    distance
        From the contact, half-widths, (H, W).

    Returns
    -------
    contact, level
        NaN where clipped.
    """
    contact, no_contact = (rgb_image(counts, capture) for counts in (capture.contact, capture.no_contact))
    gain = far_gain((contact, no_contact), (no_contact, no_contact), distance, full_scale_dn(capture))
    drift = 0.0 if gain is None else np.where(gain.to_correct, gain.log_captured, 0.0)
    return contact, no_contact * np.exp(drift)


def predict_press(table: PressTable, capture: TactileCapture) -> SimulatedPress:
    """Return what the table makes of the no-contact image of a capture, with the contact where the capture has it.

    Raises
    ------
    CompareError
        The capture does not tell where its contact is, has another size, or taught the table itself.
    """
    if contact_sha256(capture) in table.training_sha256:
        raise CompareError(
            f"{capture.name}: the table was trained on this contact image (training presses: "
            f"{', '.join(table.training_presses)}), so the table's prediction of this press proves nothing; leave the "
            "press out"
        )
    distance = _distance(capture)
    if distance.shape != table.shape_px:
        height_px, width_px = table.shape_px
        raise CompareError(
            f"{capture.name} is {distance.shape[1]} x {distance.shape[0]} px, but the training presses of the table "
            f"are {width_px} x {height_px} px; compare captures of the same camera"
        )
    ratio = np.ones((*distance.shape, 3))
    near = np.flatnonzero(_near(distance))
    for part in np.array_split(near, max(1, len(near) // _PIXELS_AT_ONCE)):
        where = np.zeros(distance.size, dtype=np.bool_)
        where[part] = True
        where = where.reshape(distance.shape)
        ratio[where] += _terms(distance, where, table.half_width_px) @ table.coefficients
    taught = f"trained on {len(table.training_presses)} other presses: {', '.join(table.training_presses)}"
    return predicted_press(capture, ratio, distance, ("table", TABLE_LABEL, "table"), taught)


def predicted_press(
    capture: TactileCapture,
    ratio: Floats,
    distance: Floats,
    by: tuple[str, str, Literal["table", "rendered"]],
    taught: str,
) -> SimulatedPress:
    """Return the press that a change of the no-contact image of a capture predicts.

    Parameters
    ----------
    capture
        The capture; its contact image is not looked at.
    ratio
        (H, W, 3) contact over no contact.
    distance
        (H, W) from the contact in half-widths.
    by
        What predicts, in a word; its label; the method of the record.
    taught
        Which presses taught it, in words.
    """
    predictor, label, method = by
    full_dn = full_scale_dn(capture)
    no_contact = np.nan_to_num(rgb_image(capture.no_contact, capture), nan=full_dn)
    return SimulatedPress(
        name=f"{capture.name}, {predictor}",
        label=label,
        method=method,
        encoding=capture.encoding,
        no_contact=no_contact.astype(np.float32),
        # where nothing changes the no-contact image stands as it is, below the black level, too
        contact=np.where(ratio == 1.0, no_contact, np.clip(no_contact * ratio, 0.0, full_dn)).astype(np.float32),
        distance=distance.astype(np.float32),
        variance=None,
        light_angle_deg=None,
        design=None,
        notes=(taught, "the place of the contact and the no-contact image are taken from the capture"),
    )


def spread_over(count: int, chosen: int) -> list[int]:
    """Return which of `count` presses teach, spread evenly from the first to the last."""
    return [int(i) for i in np.unique(np.rint(np.linspace(0, count - 1, chosen)))]


def _distance(capture: TactileCapture) -> Floats:
    """Return the distance from the contact in half-widths."""
    distance = contact_distance(capture)
    if distance is None:
        raise CompareError(
            f"{capture.name}: the capture does not state where the contact is; import it again and give the contact "
            "as a circle or an outline, or let the import search for it"
        )
    return distance


def _near(distance: Floats) -> Bools:
    """Return the pixels that the table changes."""
    return np.asarray(distance < REACH)


def _half_width_px(distance: Floats) -> float:
    """Return the half-width of a contact in pixels, from how steeply the distance rises outside."""
    slopes = np.hypot(*np.gradient(distance))
    outside = (distance > 1.2) & (slopes > 0.0)
    return 1.0 / float(np.median(slopes[outside] if outside.any() else slopes[slopes > 0.0]))


def _terms(distance: Floats, used: Bools, width_px: float) -> Floats:
    """Return the terms (pixels, terms) at some pixels."""
    smooth = cv2.GaussianBlur(distance, (0, 0), 2.0)
    down, along = np.gradient(smooth)
    steep = np.hypot(down, along)[used]
    cosine, sine = (np.divide(g[used], steep, out=np.zeros_like(steep), where=steep > 0.0) for g in (along, down))
    angular = np.stack([np.ones_like(cosine), cosine, sine, cosine**2 - sine**2, 2.0 * cosine * sine], axis=-1)
    d = distance[used]
    inner = [np.interp(d, _INNER, row) * (d <= 1.0) for row in np.eye(len(_INNER))]
    outer = [np.interp(d, _OUTER, row, right=0.0) * (d > 1.0) for row in np.eye(len(_OUTER))]
    radial = np.stack([*inner, *outer], axis=-1) * (_half_width_px(distance) / width_px)
    rows, columns = np.nonzero(used)
    size = max(used.shape)
    place = np.stack([np.ones_like(d), columns / size - 0.5, rows / size - 0.5], axis=-1)
    return np.asarray(np.einsum("pi,pj,pk->pijk", radial, angular, place).reshape(len(d), _TERMS))


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
            f"no simulated press and capture have the same name ({len(first)} presses, {len(second)} captures); give "
            "the simulated presses first and the captures last, and give each pair one name, such as one.press.json "
            "and one.capture.json, or list the pairs in a CSV file with the columns simulated and captured (--pairs)"
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


@dataclass(frozen=True, slots=True)
class PairRow:
    """One line of a list of pairs: its name, files as written there, and what it tells of the press."""

    name: str
    simulated: str
    captured: str
    simulator: str = ""
    press: str = ""
    session: str | None = None
    sensor: str | None = None


def pairs_of_rows(rows: Sequence[Mapping[str, str | None]]) -> list[PairRow]:
    """Return the pairs of a table: simulated, captured; optionally name, simulator, press, session, sensor.

    Raises
    ------
    CompareError
        A column is missing, a cell is empty, a name occurs twice for one simulator, or there is no row.
    """
    pairs: dict[tuple[str, str], PairRow] = {}
    for number, row in enumerate(rows, start=1):
        told = {column: (cell or "").strip() for column, cell in row.items()}
        simulated, captured = told.get("simulated", ""), told.get("captured", "")
        if not simulated or not captured:
            words = ", ".join(f"{column} = {cell}" for column, cell in told.items()) or "no cell"
            raise CompareError(
                f"row {number}: must name a file in both columns, simulated and captured, but the row has {words}"
            )
        name = told.get("name") or pair_name(captured.replace("\\", "/").rsplit("/", 1)[-1])
        simulator, press = told.get("simulator", ""), told.get("press", "")
        if (simulator, name) in pairs:
            raise CompareError(
                f"row {number}: the name {name!r} occurs twice; give each pair a unique name in the column 'name'"
            )
        session, sensor = told.get("session") or None, told.get("sensor") or None
        pairs[simulator, name] = PairRow(name, simulated, captured, simulator, press, session, sensor)
    if not pairs:
        raise CompareError("no pair is listed; give one row per press under the header simulated,captured")
    return list(pairs.values())


LEAST_UNITS: Final = 3
"""Two units give no interval: Student's t with one degree of freedom is 13 standard errors wide."""
_COVERAGE: Final = 0.95
_NOT_SAMPLED: Final = {"press": "other presses", "session": "other sessions", "sensor": "other sensors"}
Unit = Literal["press", "session", "sensor"]


@dataclass(frozen=True, slots=True)
class _Units:
    """Sums over the units of an interval.

    Attributes
    ----------
    kind : str
        What one unit is.
    errors, signals : ndarray, shape (units,)
        Squared error, and squared change by contact.
    not_sampled : tuple of str
        What the units do not show.
    """

    kind: Unit
    errors: Floats
    signals: Floats
    not_sampled: tuple[str, ...]


def skill_over_presses(pairs: Sequence[ComparedPair]) -> SkillOverPresses | None:
    r"""Return the skill of all presses together with its 95 % interval over presses, sessions or sensors.

    .. math:: E = 1 - \sum_i e_i / \sum_i s_i, \quad
              1 - (1 - E) \exp(\pm t_{0.975, n - 1}\, u), \quad
              u^2 = \frac{n - 1}{n} \sum_i (l_i - \bar l)^2

    with squared error e and squared change by contact s of unit i, and l_i = log(1 - E) without unit i: the jackknife
    with Student's t. The interval stays below 1 and holds its estimate. The unit is the highest of sensor, session and
    press of which there are three; lower ones are summed in it. Few presses may be alike by chance: their interval is
    at least as wide as with a weak prior of how much presses differ. Where the noise that was taken out leaves a unit
    no error, the jackknife is formed on E itself, and the interval ends at 1 or at the estimate, whichever is higher.
    Of log-normal 1 - E whose logarithm has a standard deviation of 0.45 to 0.8 (0.4 to 0.7 in real sets) it holds the
    truth in 0.90 to 0.98, from three units on; of more even presses in up to 1. With a long tail of bad presses (a
    gamma of shape 4 in the logarithm) it holds it in 0.85 to 0.98.

    Parameters
    ----------
    pairs
        Compared presses of one simulator.

    Returns
    -------
    SkillOverPresses or None
        None without a pair whose contact signal is known; without ends with fewer than three units.

    References
    ----------
    W. G. Cochran, Sampling Techniques (1977), section 6.4: the ratio estimate.
    """
    scored = [pair for pair in pairs if pair.skill is not None and pair.contact_signal]
    if not scored:
        return None
    units = _units(scored, [_error(pair) for pair in scored], [pair.contact_signal or 0.0 for pair in scored])
    left = float(units.errors.sum() / units.signals.sum())
    low, high, method = _interval_of_left_over(units, left)
    return SkillOverPresses(
        estimate=1.0 - left,
        low95=low,
        high95=high,
        presses=len(scored),
        unit=units.kind,
        units=len(units.errors),
        method=method,
        not_sampled=units.not_sampled,
    )


def _interval_of_left_over(units: _Units, left: float) -> tuple[float | None, float | None, str]:
    """Return both ends of the skill's interval, and how they were formed."""
    n = len(units.errors)
    if n < LEAST_UNITS:
        are = "is" if n == 1 else "are"
        return None, None, f"no interval: it needs three independent presses, sessions or sensors, and there {are} {n}"
    t = float(stdtrit(n - 1, 0.5 + _COVERAGE / 2.0))
    without = _left_without_each(units.errors, units.signals)
    if (units.errors > 0.0).all():
        u, method = _jackknife_u(np.log(without)), "jackknife of log(1 - skill) with Student's t"
        half, least = t * u, _least_half_width(u, units.signals) if units.kind == "press" else 0.0
        if least > half:
            half, method = least, f"{method}, widened by a weak prior, because presses are more alike than usual"
        return 1.0 - left * float(np.exp(half)), 1.0 - left * float(np.exp(-half)), method
    half = t * _jackknife_u(without)
    method = "jackknife of the skill with Student's t, because noise removal leaves some presses without error"
    return 1.0 - left - half, min(1.0 - left + half, max(1.0, 1.0 - left)), method


#: Standard deviation of log(1 - skill) over presses in the most even real set (0.39 to 0.68 were measured), and the
#: weight with which it counts: as one degree of freedom, next to n - 1 of the presses themselves.
_SPREAD_OF_PRESSES, _ITS_FREEDOM = 0.4, 1.0


def _least_half_width(u: float, signals: Floats) -> float:
    """Return the half-width of the interval of log(1 - skill) that presses alike by chance do not go below.

    A scaled inverse chi-squared prior of the variance; see A. Gelman and others, Bayesian Data Analysis (2013), 2.6.
    """
    own = len(signals) - 1.0
    freedom = own + _ITS_FREEDOM
    # presses of unequal signals are worth fewer equal ones
    usual = _SPREAD_OF_PRESSES**2 * float((signals**2).sum() / signals.sum() ** 2)
    pooled = (own * u**2 + _ITS_FREEDOM * usual) / freedom
    return float(stdtrit(freedom, 0.5 + _COVERAGE / 2.0) * np.sqrt(pooled))


def _left_without_each(errors: Floats, signals: Floats) -> Floats:
    """Return the ratio of the sums without each unit (units,)."""
    return np.asarray((errors.sum() - errors) / (signals.sum() - signals))


def _jackknife_u(without: Floats) -> float:
    """Return the standard uncertainty of a statistic by its values without each unit."""
    n = len(without)
    return float(np.sqrt((n - 1.0) / n * ((without - without.mean()) ** 2).sum()))


def _units(pairs: Sequence[ComparedPair], errors: Sequence[float], signals: Sequence[float]) -> _Units:
    """Return the sums over the highest level that has three units, else over presses."""
    keys: dict[Unit, list[tuple[str, ...]]] = {
        "sensor": [(p.sensor or "",) for p in pairs],
        "session": [(p.sensor or "", p.session or "") for p in pairs],
        "press": [(p.sensor or "", p.session or "", p.press or p.name) for p in pairs],
    }
    kind: Unit = next((k for k, named in keys.items() if len(set(named)) >= LEAST_UNITS), "press")
    _, unit = np.unique([repr(key) for key in keys[kind]], return_inverse=True)
    order = list(keys)
    unseen = tuple(_NOT_SAMPLED[level] for level in order[: order.index(kind)])
    return _Units(
        kind,
        np.asarray(np.bincount(unit, weights=np.asarray(errors)), dtype=np.float64),
        np.asarray(np.bincount(unit, weights=np.asarray(signals)), dtype=np.float64),
        unseen,
    )


def _error(pair: ComparedPair) -> float:
    """Return the squared error of a pair, in the unit of its contact signal."""
    return 0.0 if pair.skill is None else (1.0 - pair.skill.estimate) * (pair.contact_signal or 0.0)


def skill_differences(pairs: Sequence[ComparedPair], ranked: Sequence[str]) -> tuple[SkillDifference, ...]:
    """Return the difference in skill of every two simulators over the presses that both have.

    Of the presses i, d = sum(f_i - e_i) / sum s_i with the squared errors e of the first and f of the second, and the
    mean s of their squared changes by contact: what makes a press hard for both cancels. Jackknife over units with
    Student's t; with m differences each interval holds with 1 - 0.05 / m, so that all of them hold together with 95 %
    (Bonferroni).

    Parameters
    ----------
    pairs
        Of all simulators.
    ranked
        Names of simulators, the best first.
    """
    scored = [pair for pair in pairs if pair.skill is not None and pair.contact_signal]
    of = {s: {p.name: p for p in scored if p.simulator == s} for s in ranked}
    both = [(a, b) for k, a in enumerate(ranked) for b in ranked[k + 1 :] if of[a].keys() & of[b].keys()]
    return tuple(_difference(a, b, of[a], of[b], len(both)) for a, b in both)


def _difference(
    first: str, second: str, one: Mapping[str, ComparedPair], other: Mapping[str, ComparedPair], differences: int
) -> SkillDifference:
    """Return the difference of two simulators."""
    names = sorted(one.keys() & other.keys())
    # the signal of a press depends a little on the simulator, whose gain is taken out of both sides
    gains = [
        (_skill(other[n]), _skill(one[n]), ((one[n].contact_signal or 0.0) + (other[n].contact_signal or 0.0)) / 2.0)
        for n in names
    ]
    units = _units([one[n] for n in names], [(a - b) * s for b, a, s in gains], [s for _, _, s in gains])
    signals = units.signals
    d, n = float(units.errors.sum() / signals.sum()), len(signals)
    low = high = None
    if n >= LEAST_UNITS:
        t = float(stdtrit(n - 1, 1.0 - (1.0 - _COVERAGE) / 2.0 / differences))
        half = t * _jackknife_u(_left_without_each(units.errors, signals))
        low, high = d - half, d + half
    return SkillDifference(
        first=first,
        second=second,
        estimate=d,
        low95=low,
        high95=high,
        presses=len(names),
        better_in=sum(a > b for b, a, _ in gains),
    )


def _skill(pair: ComparedPair) -> float:
    """Return the skill of a compared pair."""
    return pair.skill.estimate if pair.skill is not None else 0.0


def rank_simulators(pairs: Sequence[ComparedPair]) -> tuple[tuple[SimulatorScore, ...], tuple[str, ...]]:
    """Score every simulator over the presses that all of them share, the best first.

    Returns
    -------
    tuple of SimulatorScore
        A simulator of which no press could be compared stands last.
    tuple of str
        Names of presses that were left out of the ranking, as not all simulators have them.
    """
    names = list(dict.fromkeys(pair.simulator for pair in pairs))
    compared = {s: [p for p in pairs if p.simulator == s and p.skill is not None] for s in names}
    sets = [{p.name for p in of} for of in compared.values() if of]
    shared = set.intersection(*sets) if sets else set()
    everywhere = set.union(*sets) if sets else set()
    scores = [
        SimulatorScore(
            simulator=s,
            compared=len(of),
            failed=sum(p.simulator == s and p.skill is None for p in pairs),
            skill=skill_over_presses([p for p in of if not shared or p.name in shared]),
        )
        for s, of in compared.items()
    ]
    scores.sort(key=lambda score: -np.inf if score.skill is None else score.skill.estimate, reverse=True)
    return tuple(scores), tuple(sorted(everywhere - shared)) if shared else ()


#: Half an interval below which more presses add little.
_NARROW = 0.01
_MOST_ASKED = 200
_MANY: Final = {"press": "presses", "session": "sessions", "sensor": "sensors"}


def to_capture(pairs: Sequence[ComparedPair]) -> tuple[str, ...]:
    """Return what captures would make the scores surer, the most useful first.

    Of n presses with a half interval h, about n (h / 0.01)^2 bring it to 0.01.
    """
    compared = [pair for pair in pairs if pair.skill is not None]
    if not compared:
        return ()
    # each capture once, by the simulator of the first compared pair
    scored = [pair for pair in compared if pair.simulator == compared[0].simulator]
    names = {pair.press or pair.name for pair in scored}
    told = []
    if len(names) < LEAST_UNITS:
        told.append(
            f"{_more(LEAST_UNITS - len(names))}, at other places and depths: an interval needs at least {LEAST_UNITS} "
            f"presses, got {len(names)}"
        )
    best = skill_over_presses(scored)
    if best is not None and best.low95 is not None and best.high95 is not None:
        half = (best.high95 - best.low95) / 2.0
        wanted = int(np.ceil(best.units * (half / _NARROW) ** 2))
        if half > _NARROW and wanted <= _MOST_ASKED:
            told.append(
                f"{wanted - best.units} more {_MANY[best.unit]}: the interval reaches {half:.2g} to either side with "
                f"{best.units}, and would reach about {_NARROW:g} with {wanted}"
            )
        elif half > _NARROW:
            told.append(
                f"presses similar to the worst ones, to learn what makes them worse: the interval of {best.units} "
                f"{_MANY[best.unit]} reaches {half:.2g} to either side, and more presses alone would hardly narrow it"
            )
    told += [f"{what}: {why}" for is_missing, what, why in _lacking(scored) if is_missing]
    return tuple(told)


def _more(presses: int) -> str:
    """Return a number of further presses in words."""
    return f"{presses} more press{'' if presses == 1 else 'es'}"


def _lacking(scored: Sequence[ComparedPair]) -> tuple[tuple[bool, str, str], ...]:
    """Return (whether it is missing, what to capture, why)."""
    gained = sum(any("capture both images" in finding for finding in pair.findings) for pair in scored)
    clipped = sum(any("clipped" in finding for finding in pair.findings) for pair in scored)
    without_floor = sum(pair.floor_skill is None for pair in scored)
    return (
        (
            without_floor > 0,
            "a second image without contact for each press",
            f"{without_floor} of {len(scored)} pairs have none, so it is not known how much of their error is noise",
        ),
        (
            gained > len(scored) // 4,
            "an image without contact just before each press, with exposure and white balance locked",
            f"in {gained} of {len(scored)} pairs the camera's gain changed between the images",
        ),
        (
            clipped > 0,
            "the same presses with a shorter exposure",
            f"in {clipped} of {len(scored)} pairs the contact is clipped",
        ),
        (
            len({pair.session for pair in scored}) < LEAST_UNITS,
            f"the same presses in {LEAST_UNITS} sessions, after taking the sensor off",
            "the interval does not include drift and mounting",
        ),
        (
            len({pair.sensor for pair in scored}) < LEAST_UNITS,
            f"{LEAST_UNITS} sensors",
            "the interval does not include differences between sensors of one kind",
        ),
    )


def worst_pairs(pairs: Iterable[ComparedPair]) -> tuple[str, ...]:
    """Return the names of the five pairs of lowest skill, the lowest first."""
    scored = [(pair.skill.estimate, pair.name) for pair in pairs if pair.skill is not None]
    return tuple(dict.fromkeys(name for _, name in sorted(scored)))[:_WORST]
