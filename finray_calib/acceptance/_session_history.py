r"""What a rig and a sample were in every session, charted over sessions, and the light that each sample has received.

From the frames of a paint session: level and colour of the lamp, each filter apart from both, the laser, the dark
level and how it grows, the sharpness of the white frames; and of the sample its emission, the centroid of that, and
its fading. With W, L and F the summed channels of white tile under the lamp, white tile and sample under the laser,

.. math:: \ln W_f = a + b \lambda_f + r_f, \quad \text{emission} = \ln \sum_f F_f / W_f - \ln L / W_{450}

with level a at the mean wavelength, colour b over the range of the filters and r the filter by itself.

Is a quantity still what it was? Two charts watch its series :math:`x_i`, standardised by mean and standard deviation
of the m sessions of the reference. Shewhart's alarms where one session stands out, :math:`|x_i| > k`. The
exponentially weighted mean

.. math:: z_i = \lambda x_i + (1 - \lambda) z_{i-1}, \quad |z_i| > L \sqrt{\lambda / (2 - \lambda)}

alarms where several lean the same way. After an alarm both begin anew. The false alarms of a session are one over the
mean number of sessions to an alarm of either, which the Markov chain of the weighted mean gives (Brook and Evans
1972). Mean and standard deviation of few sessions are poorly known: with limits that ignore it, ten sessions of
reference give up to 25 times the false alarms that were asked for. Here the rate is averaged over what the reference
may have been: k is the prediction limit of Student's t for half of the rate, L follows so that both charts together
keep all of it.

Valid for sessions that are independent and normally distributed while nothing is wrong.

References
----------
Roberts, Technometrics 1 (1959) 239-250. Lucas and Saccucci, Technometrics 32 (1990) 1-12. Brook and Evans, Biometrika
59 (1972) 539-549.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr
from scipy.stats import chi2, norm
from scipy.stats import t as student

from data_schemas import CaptureSession, FinrayError
from finray_calib.radiometry import ReadFrame, SessionSteps, bleaching_trend, session_steps

Floats = NDArray[np.float64]
ChartName = Literal["Shewhart", "EWMA"]

SMOOTHING_FACTOR: Final = 0.2
FEWEST_REFERENCE: Final = 6
"""Sessions of a reference: with fewer, limits are so wide that little is seen."""
OUTLIER_P: Final = 0.01
"""Below it, a session of the reference stands out from the others (Grubbs' test)."""
_STATES, _NODES = 81, 16


@dataclass(frozen=True, slots=True)
class ChartRules:
    """Limits of both charts.

    Attributes
    ----------
    false_alarm_share
        Rate for one session of one quantity, for which the limits were computed.
    reference
        Sessions of the reference; None where mean and standard deviation are known.
    shewhart_factor
        k, in standard deviations of the reference.
    smoothing_factor, ewma_factor
        The weight of the newest session, and L, in standard deviations of the weighted mean.
    """

    false_alarm_share: float
    reference: int | None
    shewhart_factor: float
    smoothing_factor: float
    ewma_factor: float

    @property
    def ewma_limit_factor(self) -> float:
        """Largest weighted mean that is allowed, in standard deviations of the reference."""
        return self.ewma_factor * math.sqrt(self.smoothing_factor / (2.0 - self.smoothing_factor))


@lru_cache
def chart_rules(
    false_alarm_share: float, reference: int | None = None, smoothing_factor: float = SMOOTHING_FACTOR
) -> ChartRules:
    """Return limits that keep a rate of false alarms.

    Parameters
    ----------
    false_alarm_share
        Share of the sessions of one quantity with nothing wrong that give an alarm.
    reference
        Number of sessions that mean and standard deviation were estimated from; None where they are known.
    smoothing_factor
        Weight of the newest session in the weighted mean.

    Raises
    ------
    FinrayError
        The rate or the weight is out of range, or the reference has too few sessions.
    """
    if not 1e-6 <= false_alarm_share <= 0.2:
        raise FinrayError(
            f"false alarms: a share of {false_alarm_share:g} of the sessions is out of range; give 0.000001 to 0.2"
        )
    if not 0.01 <= smoothing_factor <= 1.0:
        raise FinrayError(f"weight of the newest session: {smoothing_factor:g} is out of range; give 0.01 to 1")
    if reference is not None and reference < FEWEST_REFERENCE:
        raise FinrayError(f"reference: {reference} sessions are too few; give {FEWEST_REFERENCE} or more")
    if reference is None:
        shewhart_factor = float(norm.isf(false_alarm_share / 4))
    else:
        shewhart_factor = float(student.isf(false_alarm_share / 4, reference - 1)) * math.sqrt(1.0 + 1.0 / reference)

    def excess(ewma_factor: float) -> float:
        rules = ChartRules(false_alarm_share, reference, shewhart_factor, smoothing_factor, ewma_factor)
        return math.log(false_alarm_rate(rules) / false_alarm_share)

    highest = shewhart_factor / math.sqrt(
        smoothing_factor / (2.0 - smoothing_factor)
    )  # beyond it the other chart alarms first
    ewma_factor = float(brentq(excess, 0.2, highest, xtol=1e-4))
    return ChartRules(false_alarm_share, reference, shewhart_factor, smoothing_factor, ewma_factor)


def false_alarm_rate(rules: ChartRules) -> float:
    """Return the false alarms for each session, averaged over what the reference may have been."""
    if rules.reference is None:
        return 1.0 / run_length(rules)
    freedom = rules.reference - 1
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    scales = np.sqrt(chi2.ppf(0.5 + 0.5 * nodes, freedom) / freedom)
    shifts, shares = np.polynomial.hermite_e.hermegauss(_NODES)
    shifts, shares = shifts / math.sqrt(rules.reference), shares / shares.sum()
    upper = shifts > 0  # both signs are alike
    rate = 0.0
    for scale, weight in zip(scales, 0.5 * weights, strict=True):
        for shift, share in zip(shifts[upper], 2.0 * shares[upper], strict=True):
            rate += weight * share / run_length(rules, float(shift), float(scale))
    return rate


def run_length(rules: ChartRules, shift_sd: float = 0.0, scale: float = 1.0) -> float:
    """Return the mean number of sessions to an alarm of either chart.

    Parameters
    ----------
    rules
        The limits.
    shift_sd
        True mean minus that of the reference, in true standard deviations.
    scale
        Standard deviation of the reference over the true one.
    """
    limit, weight = scale * rules.ewma_limit_factor, rules.smoothing_factor
    width = 2.0 * limit / _STATES
    places = -limit + width * (np.arange(_STATES) + 0.5)
    most = scale * rules.shewhart_factor
    upper = (places[None] + width / 2 - (1.0 - weight) * places[:, None]) / weight
    lower = upper - width / weight
    inside = ndtr(np.clip(upper, -most, most) - shift_sd) - ndtr(np.clip(lower, -most, most) - shift_sd)
    lengths = np.linalg.solve(np.eye(_STATES) - inside, np.ones(_STATES))
    return float(lengths[_STATES // 2])


@dataclass(frozen=True, slots=True)
class Alarm:
    """A session at which a chart alarmed: its place in the series, counted from 0."""

    place: int
    chart: ChartName


@dataclass(frozen=True, slots=True)
class Chart:
    """One quantity over sessions.

    Attributes
    ----------
    values
        (n,) in the unit of the quantity.
    mean, sd
        Of the reference.
    weighted
        (n,) exponentially weighted mean, in the unit of the quantity; the mean over the reference.
    rules
        Limits.
    alarms
        Alarms behind the reference, oldest first.
    outlier
        Place of the session that stands out of the reference; None where none does.
    """

    values: Floats
    mean: float
    sd: float
    weighted: Floats
    rules: ChartRules
    alarms: tuple[Alarm, ...]
    outlier: int | None


def watch(values: Sequence[float], rules: ChartRules, cleared: int = 0) -> Chart:
    """Chart a series whose first sessions are the reference.

    Parameters
    ----------
    values
        One for each session, oldest first.
    rules
        Limits, for the number of sessions of the reference.
    cleared
        Alarms before this place were looked into: the charts begin anew there.

    Raises
    ------
    FinrayError
        The series is shorter than its reference, holds a value that is not finite, or does not scatter in it.
    """
    series, count = np.asarray(values, dtype=np.float64), rules.reference or 0
    if count < 2 or series.size < count or not np.isfinite(series).all():
        raise FinrayError(
            f"series of {series.size} values: must have at least {count} values, as the reference has, and only "
            "finite numbers"
        )
    mean, sd = float(series[:count].mean()), float(series[:count].std(ddof=1))
    if not sd > 0.0:
        raise FinrayError(
            "all sessions of the reference have exactly the same value, so they do not show how much "
            "sessions may differ; give sessions that were captured independently"
        )
    weighted, alarms, z = np.full(series.size, mean), [], 0.0
    for place in range(max(count, cleared), series.size):
        x = (series[place] - mean) / sd
        z = rules.smoothing_factor * x + (1.0 - rules.smoothing_factor) * z
        weighted[place] = mean + sd * z
        found: list[ChartName] = []
        if abs(x) > rules.shewhart_factor:
            found.append("Shewhart")
        if abs(z) > rules.ewma_limit_factor:
            found.append("EWMA")
        alarms += [Alarm(place, chart) for chart in found]
        z = 0.0 if found else z
    return Chart(series, mean, sd, weighted, rules, tuple(alarms), _outlier(series[:count]))


def _outlier(reference: Floats) -> int | None:
    """Return the place of a session that stands out of the others (Grubbs' test, two sides), or None."""
    n = reference.size
    departures = np.abs(reference - reference.mean()) / reference.std(ddof=1)
    critical = float(student.isf(OUTLIER_P / (2 * n), n - 2))
    limit = (n - 1) / math.sqrt(n) * math.sqrt(critical**2 / (n - 2 + critical**2))
    return int(departures.argmax()) if departures.max() > limit else None


Verdict = Literal["IN CONTROL", "OUT OF CONTROL", "UNDECIDED"]
PERCENT: Final = 100.0
SHARPNESS: Final = "sharpness of the white frames"
MOST_FALSE_ALARMS: Final = 0.2


@dataclass(frozen=True, slots=True)
class SessionFacts:
    """What one session shows.

    Attributes
    ----------
    name, captured_utc
        Its folder, and when its first frame was taken.
    rig_name, paint_name
        Names in rig file and plan: sessions with the same names are compared.
    dose_j
        Laser light that fell on the sample.
    rig, sample
        Quantity, with its unit in brackets -> value.
    fading_per_j, fading_sd_per_j
        Relative loss of emission per joule; None where no filter was captured twice.
    fault
        Why the frames could not be reduced; the quantities are then empty.
    """

    name: str
    captured_utc: str
    rig_name: str
    paint_name: str
    dose_j: float
    rig: dict[str, float]
    sample: dict[str, float]
    fading_per_j: float | None = None
    fading_sd_per_j: float | None = None
    fault: str = ""


def session_facts(name: str, session: CaptureSession, read: ReadFrame) -> SessionFacts:
    """Reduce a session to what is charted.

    Parameters
    ----------
    name
        How the session is called.
    session
        Its record.
    read
        Returns the counts of a frame.
    """
    dose_j = max((frame.laser_dose_j for frame in session.frames), default=0.0)
    taken, rig, paint = session.frames[0].captured_utc, session.rig.name, session.plan.paint_name
    try:
        steps = session_steps(session, read)
        trend = bleaching_trend(steps)
        of_rig = {
            **_lights(session, steps),
            **_darks(steps),
            f"{SHARPNESS} (%)": _sharpness(session, read),
        }
        of_sample = _emission(session, steps)
    except FinrayError as error:
        return SessionFacts(name, taken, rig, paint, dose_j, {}, {}, fault=str(error))
    if trend is None:
        return SessionFacts(name, taken, rig, paint, dose_j, of_rig, of_sample)
    return SessionFacts(
        name, taken, rig, paint, dose_j, of_rig, of_sample, trend.record.loss_per_j, trend.record.sd_per_j
    )


def _summed(signal_dn_per_s: Floats) -> float:
    """Return the signal summed over the channels; a lost channel counts as nothing."""
    return float(np.nansum(signal_dn_per_s))


def _level(signal_dn_per_s: Floats, light: str, filter_name: str) -> float:
    """Return 100 times the logarithm of the white tile's signal, which has none where the light was off."""
    level_dn_per_s = _summed(signal_dn_per_s)
    if level_dn_per_s <= 0.0:
        raise FinrayError(
            f"{light} behind filter {filter_name}: the signal of the white tile is {level_dn_per_s:.3g} DN/s above the "
            f"dark level, but must be above 0; check that the {light} was on, and capture again"
        )
    return PERCENT * float(np.log(level_dn_per_s))


def _lights(session: CaptureSession, steps: SessionSteps) -> dict[str, float]:
    """Return the lamp's level and colour, each filter by itself, and the laser's level."""
    centres = {band.name: band.center_nm for band in session.rig.filter_wheel.filters}
    place = np.array([centres[name] for name in steps.names])
    white = np.array([
        _level(step.signal_dn_per_s, "lamp", name) for step, name in zip(steps.white, steps.names, strict=True)
    ])  # fmt: skip
    span = float(np.ptp(place)) or 1.0
    design = np.column_stack([np.ones(place.size), (place - place.mean()) / span])
    line = np.linalg.lstsq(design, white, rcond=None)[0]
    apart = white - design @ line
    return {
        "lamp level (%)": float(line[0]),
        "lamp colour, long / short wavelengths (%)": float(line[1]),
        **{f"filter {name} (%)": float(value) for name, value in zip(steps.names, apart, strict=True)},
        "laser level (%)": _level(steps.laser_white.signal_dn_per_s, "laser", steps.names[steps.excitation]),
    }


def _darks(steps: SessionSteps) -> dict[str, float]:
    """Return the dark level at the shortest exposure, and its growth, which is dark current and stray light."""
    shortest_s, longest_s = min(steps.darks), max(steps.darks)
    low, high = (float(steps.darks[time].level_dn.mean()) for time in (shortest_s, longest_s))
    growth = {} if longest_s == shortest_s else {"dark rate (DN/s)": (high - low) / (longest_s - shortest_s)}
    return {"dark level (DN)": low, **growth}


def _emission(session: CaptureSession, steps: SessionSteps) -> dict[str, float]:
    """Return level and centroid of the emission of the sample."""
    centres = {band.name: band.center_nm for band in session.rig.filter_wheel.filters}
    shown = [i for i in range(len(steps.names)) if i != steps.excitation]
    place = np.array([centres[steps.names[i]] for i in shown])
    white = np.array([_summed(steps.white[i].signal_dn_per_s) for i in shown])
    emitted = np.array([_summed(steps.fluorescence[i].signal_dn_per_s) for i in shown]) / white
    laser = _summed(steps.laser_white.signal_dn_per_s) / _summed(steps.white[steps.excitation].signal_dn_per_s)
    total = float(emitted.sum())
    if total <= 0.0:
        return {}
    return {
        "emission (%)": PERCENT * float(np.log(total / laser)),
        "centroid of the emission (nm)": float((place * emitted).sum() / total),
    }


def _sharpness(session: CaptureSession, read: ReadFrame) -> float:
    r"""Return the sharpness of the white frames, which the edges of the white tile decide.

    .. math:: 100 \sqrt{\sum_{i \ne j} \langle g_i g_j \rangle \Big/ \sum_{i \ne j} \bar D_i \bar D_j}

    with g the differences of neighbouring greens over a white frame and D the mean of its region, over all pairs of
    frames: their noise is independent, so that it does not count as sharpness. The camera's own pattern does; where the
    tile fills the frame it is most of it, and a change of focus is not seen. Negative where chance outweighs all.
    """
    black = session.rig.camera.black_level_dn
    region = session.plan.region
    means, squares = [], 0.0
    sums: list[Floats | float] = [0.0, 0.0]
    for frame in session.frames:
        if frame.frame_type == "white":
            green = read(frame)[0::2, 1::2] - black
            rows = slice(region.row_px // 2, (region.row_px + region.height_px) // 2)
            columns = slice(region.column_px // 2, (region.column_px + region.width_px) // 2)
            means.append(float(green[rows, columns].mean()))
            steps = [np.diff(green, axis=axis) for axis in (0, 1)]
            sums = [total + step for total, step in zip(sums, steps, strict=True)]
            squares += sum(float((step**2).mean()) for step in steps)
    together = sum(float((np.asarray(total) ** 2).mean()) for total in sums)
    level = sum(means) ** 2 - sum(mean**2 for mean in means)
    energy = (together - squares) / max(level, 1e-300)
    return PERCENT * float(np.sign(energy) * np.sqrt(abs(energy)))


@dataclass(frozen=True, slots=True)
class ChartedQuantity:
    """One quantity of a rig or a sample over its sessions."""

    of: str
    quantity: str
    sessions: tuple[str, ...]
    captured_utc: tuple[str, ...]
    chart: Chart

    @property
    def is_logarithm(self) -> bool:
        """Whether the values are 100 times a natural logarithm: only their differences mean something."""
        return self.quantity.endswith("(%)") and not self.quantity.startswith(SHARPNESS)

    def told(self, value: float) -> str:
        """Return a value in words: of a logarithm its difference from the reference."""
        return f"{value - self.chart.mean:.2g} %" if self.is_logarithm else f"{value:.5g}"

    def told_mean(self) -> str:
        """Return the mean of the reference in words; a dash for a logarithm."""
        return "\N{EN DASH}" if self.is_logarithm else f"{self.chart.mean:.5g}"


@dataclass(frozen=True, slots=True)
class LedgerRow:
    """Laser light that a sample has received.

    Attributes
    ----------
    paint_name, sessions, dose_j
        The sample, its sessions, and the dose summed over them.
    fading_per_j, fading_sd_per_j
        Mean relative loss per joule, weighted by its uncertainty in each session; None where none measured it.
    """

    paint_name: str
    sessions: int
    dose_j: float
    fading_per_j: float | None
    fading_sd_per_j: float | None

    @property
    def lost(self) -> float | None:
        """Share of the emission that the dose took; None where no loss is resolved (two standard deviations)."""
        if self.fading_per_j is None or self.fading_sd_per_j is None or self.fading_per_j < 2.0 * self.fading_sd_per_j:
            return None
        return float(-np.expm1(-self.fading_per_j * self.dose_j))


@dataclass(frozen=True, slots=True)
class History:
    """Sessions over time.

    Attributes
    ----------
    verdict
        OUT OF CONTROL: a chart alarmed after the reference, or a session could not be reduced, since alarms were last
        cleared. UNDECIDED: no chart has more sessions than its reference.
    reasons
        What stands behind it, the newest last.
    watched, ledger
        The charts, and the dose of each sample.
    waiting
        What is not judged, and why: no session after the reference, or a reference without scatter.
    false_alarm_share, false_alarm_share_each
        Share of the sessions with nothing wrong that raise any alarm, and of one quantity.
    newest_utc
        When the newest session was captured, ISO 8601; empty without sessions.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    watched: tuple[ChartedQuantity, ...]
    ledger: tuple[LedgerRow, ...]
    waiting: tuple[str, ...]
    false_alarm_share: float
    false_alarm_share_each: float
    newest_utc: str

    @property
    def outliers(self) -> dict[str, list[str]]:
        """Sessions of a reference that differ from the rest of it, and the quantities that show it."""
        found: dict[str, list[str]] = {}
        for one in self.watched:
            if one.chart.outlier is not None:
                found.setdefault(one.sessions[one.chart.outlier], []).append(one.quantity)
        return found


def session_history(
    facts: Sequence[SessionFacts], reference: int = 10, false_alarm_share: float = 0.01, cleared: str | None = None
) -> History:
    """Chart all quantities over the sessions.

    Parameters
    ----------
    facts
        One for each session, in any order.
    reference
        Number of first sessions, of each rig and sample, that say what is normal.
    false_alarm_share
        Share of the sessions with nothing wrong that raise an alarm in any quantity, which are taken as independent.
    cleared
        Name of the session up to which alarms were looked into.

    Raises
    ------
    FinrayError
        The reference is too short, the rate out of range, or no session has the name that was cleared.
    """
    ordered = sorted(facts, key=lambda one: one.captured_utc)
    if reference < FEWEST_REFERENCE:
        raise FinrayError(f"reference: {reference} sessions are too few; give {FEWEST_REFERENCE} or more")
    if not 0.0 < false_alarm_share <= MOST_FALSE_ALARMS:
        raise FinrayError(
            f"false alarms: {false_alarm_share:g} is out of range; give a share above 0 and up to {MOST_FALSE_ALARMS:g}"
        )
    since = ""
    if cleared is not None:
        since = next((one.captured_utc for one in ordered if one.name == cleared), "")
        if not since:
            raise FinrayError(f"no session is called {cleared!r}; give one of {', '.join(one.name for one in ordered)}")
    series, waiting = _series(ordered, reference)
    false_alarm_share_each = 1.0 - (1.0 - false_alarm_share) ** (1.0 / max(len(series), 1))
    rules = chart_rules(false_alarm_share_each, reference, SMOOTHING_FACTOR)
    watched = []
    for of, quantity, sessions in series:
        values = [{**one.rig, **one.sample}[quantity] for one in sessions]
        first = sum(one.captured_utc <= since for one in sessions)
        chart = watch(values, rules, first)
        watched.append(
            ChartedQuantity(
                of, quantity, tuple(s.name for s in sessions), tuple(s.captured_utc for s in sessions), chart
            )
        )
    reasons = _reasons(watched, ordered, since)
    judged = any(len(one.sessions) > reference for one in watched)
    verdict: Verdict = "OUT OF CONTROL" if reasons else "IN CONTROL" if judged else "UNDECIDED"
    newest_utc, ledger = ordered[-1].captured_utc if ordered else "", _ledger(ordered)
    return History(
        verdict, reasons, tuple(watched), ledger, waiting, false_alarm_share, false_alarm_share_each, newest_utc
    )


def _series(
    ordered: Sequence[SessionFacts], reference: int
) -> tuple[list[tuple[str, str, list[SessionFacts]]], tuple[str, ...]]:
    """Return (of what, quantity, sessions) for all that has a whole reference, and what has none."""
    found: dict[tuple[str, str], list[SessionFacts]] = {}
    for one in ordered:
        for quantity in one.rig:
            found.setdefault((one.rig_name, quantity), []).append(one)
        for quantity in one.sample:
            found.setdefault((f"{one.paint_name} on {one.rig_name}", quantity), []).append(one)
    series, counts, alike = [], dict[str, int](), dict[str, list[str]]()
    for (of, quantity), sessions in found.items():
        if len(sessions) < reference:
            counts[of] = max(counts.get(of, 0), len(sessions))
        elif np.ptp([{**s.rig, **s.sample}[quantity] for s in sessions[:reference]]) > 0:
            series.append((of, quantity, sessions))
        else:
            alike.setdefault(of, []).append(quantity)
    fewer = f", or give a smaller reference ({FEWEST_REFERENCE} or more)" if reference > FEWEST_REFERENCE else ""
    waiting = [
        f"{of}: has {n} of the {reference} sessions that its reference needs; session {reference + 1} is the first "
        f"that is judged: capture {reference + 1 - n} more{fewer}"
        for of, n in counts.items()
    ]
    charted = dict.fromkeys(of for of, _, _ in series)
    waiting += [
        f"{of}: all {reference} sessions belong to the reference; capture another, which is the first that is judged"
        for of in charted
        if all(len(sessions) == reference for charted_of, _, sessions in series if charted_of == of)
    ]
    copies = "; the sessions are copies of one, or of a rig without devices with one [simulated] seed"
    same = (
        f"{of}: {', '.join(names)}: exactly the same in all sessions of the reference{'' if of in charted else copies}"
        for of, names in alike.items()
    )
    return series, (*waiting, *same)


def _reasons(watched: Sequence[ChartedQuantity], ordered: Sequence[SessionFacts], since: str) -> tuple[str, ...]:
    """Return the sessions that could not be reduced and, of each chart, its alarms; in the order of their beginning."""
    told = [(s.captured_utc, f"{s.name}: cannot be reduced: {s.fault}") for s in ordered if s.fault]
    for one in watched:
        alarms = [alarm for alarm in one.chart.alarms if one.captured_utc[alarm.place] > since]
        if not alarms:
            continue
        first = alarms[0].place
        charts = " and ".join(dict.fromkeys(alarm.chart for alarm in alarms if alarm.place == first))
        apart = (one.chart.values[first] - one.chart.mean) / one.chart.sd
        sessions = len({alarm.place for alarm in alarms})
        again = "" if sessions == 1 else f"; {sessions} sessions in all"
        text = f"{one.sessions[first]}: {one.quantity} is {apart:+.1f} sd from the reference ({charts}){again}"
        told.append((one.captured_utc[first], text))
    return tuple(text for taken, text in sorted(told) if taken > since)


def _ledger(ordered: Sequence[SessionFacts]) -> tuple[LedgerRow, ...]:
    """Sum the dose of each sample."""
    rows = []
    for name in dict.fromkeys(one.paint_name for one in ordered):
        sessions = [one for one in ordered if one.paint_name == name]
        measured = [
            (one.fading_per_j, one.fading_sd_per_j)
            for one in sessions
            if one.fading_per_j is not None and one.fading_sd_per_j
        ]
        fading = sd = None
        if measured:
            values, weights = np.array([v for v, _ in measured]), np.array([s**-2 for _, s in measured])
            fading, sd = float((values * weights).sum() / weights.sum()), float(weights.sum() ** -0.5)
        rows.append(LedgerRow(name, len(sessions), sum(one.dose_j for one in sessions), fading, sd))
    return tuple(rows)
