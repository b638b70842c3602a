"""Results on stage and load cell of a rig that presses.

No device is its own witness. What a controller reports of its press axis counts where the load cell felt the pad, what
it reports of its pad axis where the camera saw the dent move, and what the cell says where it felt the stage press. A
known mass is the witness of the cell's factor.
Without the witness a result may fail or be undecided, and never passes.
"""

import math
from typing import Final, Literal

import numpy as np
from scipy.stats import chi2

from data_schemas import (
    AcceptanceReport,
    CellAtRest,
    CheckedTouch,
    CheckResult,
    LoadCellCalibration,
    LoadCellSettings,
    MovingStop,
    PressFacts,
    Section,
    StageMoves,
    StageSettings,
    StageStop,
    TactileCheckPlan,
    TactileRig,
)
from finray_calib.acceptance._conformity import ToleranceInterval, limit_text, measured, not_proven, unmeasured
from finray_calib.acceptance._device_checks import (
    CLOCK_SD_S,
    judge_frames,
    judge_handshakes,
    judge_reconnect,
    report_of,
    results_of,
)

PRESS_SECTIONS: Final[dict[Section, str]] = {
    "opening": "rig opens",
    "handshake": "devices answer",
    "load cell": "load cell",
    "stage": "stage moves",
    "touch": "touches",
    "force limit": "force limit holds",
    "stops": "stops",
    "closing": "rig closes",
    "reconnect": "devices come back",
}
REPORT_SD_MM: Final = 0.001 / math.sqrt(12.0)
"""Rounding of a reported position to 0.001 mm."""
AGE_SD_DAYS: Final = 0.5
"""Of a day's date."""
FELT_SD: Final = 5.0
FELT_SHARE: Final = 0.25
"""Of the force of a press: a zero that moved by more could have been the force."""
NO_SCALE: Final = "that is the controller's own count; it is not confirmed that {axis} travels as far as commanded"
NO_BLOCK: Final = (
    "only the controller reports its travel, because no block of known thickness was laid on the pad; name a block "
    "in the plan ([gauge_block])"
)
NO_PICTURE_SCALE: Final = "the pixel size in mm is not known; give mm_per_px and mm_per_px_u_rel in the plan"
NO_DENT: Final = (
    "the camera did not see the contact move with {axis}; light the pad, check exposure_s, or raise beside_mm"
)
FEWEST_DENTS: Final = 6
DENT_LIGHT_PX: Final = 0.25
"""Standard uncertainty of the centre of a contact by light that falls unevenly: stated, an eighth of a Bayer cell."""
ONLY_COUNTED: Final = (
    "only the controller reports that the stage stopped: the cell could not detect whether it moved on; press "
    "harder, or watch it with a dial gauge"
)
NO_MASS: Final = (
    "no known mass was laid on the cell in this check, so a wrong factor would not show, and the true force can "
    "exceed the plan's limit; name a mass in the plan ([known_mass])"
)
UNCERTIFIED: Final = "no certificate of the mass recorded"
LAID_SHARE: Final = 0.05
"""Of its weight: a mass that gives less was not laid, or the cell is dead."""
LEAST_WEIGHT_SHARE: Final = 0.2
"""Of the rig's force limit: a factor that a lighter mass shows need not hold for the forces of presses."""
ONE_OF_THEM: Final = (
    "this mass may be one of the masses that calibrated the cell, and then an error of its value would not show; "
    "place another mass, or give the certificate of this one"
)
ONE_STEP: Final = (
    "in some or all tries the move was too short, or the force grew too little, for a stop before its end to show: "
    "those tries show only that no further step was begun, not that a force stops a move; raise force_limit_n of the "
    "plan, or shorten step_mm of the rig file"
)
TO_ITS_END: Final = "a move was not seen to be stopped before its end"
NO_FORCE_PASSED: Final = "a move ended without a reading beyond its limit, so no force stopped it"
COUNTED_TO_ITS_END: Final = "by the controller's count a move that a force stopped went to its end"
UNKNOWN_AFTER_A_STOP: Final = "after a stop within a move the position of the stage was unknown"
LEAST_LEFT_SHARE: Final = 0.05
"""Of a move with its limit halfway: one that a force stops ends well before."""
NO_FACTOR: Final = (
    "the force was measured by a cell that the check 'calibration holds' did not confirm, so the true force is not "
    "known"
)
DENT_MOVED_PX: Final = 5.0
LOST_BITS: Final = (
    "{jumps} of {readings} readings were far beyond the noise, as where a bit is lost between amplifier and board, and "
    "are left out; shorten these wires, and keep them away from those of the motors"
)
MINUTE_S: Final = 60.0
FEWEST_STOPS: Final = 3
"""Below it a stage that stops now and then passes by chance."""
FEWEST_TOUCHES: Final = 4
FEWEST_RETURNS: Final = 10
"""Below it the standard deviation of the returns is known too badly."""
TURNED_WIDTHS: Final = 1.5
"""Of the limit of the backlash: a turn that is shorter cannot show a backlash at the limit."""
READINGS_OF_A_BLOCK: Final = 4.0
"""Readings of an HX711 that share conversions: its filter has four."""


def judge_pressing(facts: PressFacts, plan: TactileCheckPlan, rig: TactileRig) -> AcceptanceReport:
    """Return the report of an acceptance check of a rig whose stage presses; see :func:`judge` for what it takes."""
    limits, judged = plan.limits, _of_stage_and_cell(facts, plan, rig)
    judged["handshake"] = (
        *judge_handshakes(facts.handshakes, limits.handshake_s),
        *judge_frames("handshake", facts.frame_overheads_s, limits.frame_overhead_s),
    )
    judged["reconnect"] = judge_reconnect(facts, limits.reconnect_s)
    return report_of(facts, plan, rig, results_of(PRESS_SECTIONS, judged, facts.errors))


def _of_stage_and_cell(
    facts: PressFacts, plan: TactileCheckPlan, rig: TactileRig
) -> dict[Section, tuple[CheckResult, ...]]:
    """Return the results of each part that stage and cell witness for each other."""
    stage, cell = rig.stage, rig.load_cell
    if stage is None or cell is None:
        return {}
    found: dict[Section, tuple[CheckResult, ...]] = {
        "load cell": _at_rest(facts, plan, cell),
        "stage": _moves(facts, plan, stage),
        "touch": _touches(facts, plan, cell),
        "force limit": _force_limit(facts, plan, cell),
        "stops": _stops(facts, plan, cell),
    }
    if (lacking := unfelt(facts)) is not None:
        found = {section: tuple(not_proven(one, lacking) for one in results) for section, results in found.items()}
    found["load cell"] = (*_calibration(facts, plan, cell), *found["load cell"])
    return found


def unfelt(facts: PressFacts) -> str | None:
    """Return why the cell is no witness of the stage, nor the stage one of the cell; None where they are.

    At every touch the force must grow by five standard deviations where the stage goes deeper, be positive, and be gone
    afterwards: a drift grows too, but it stays.
    """
    touches = (*facts.touches, *facts.after_stops)
    if not touches:
        return "no touch was detected, so it is not confirmed that the stage moves or that the cell responds"
    for one in touches:
        grew = one.deeper_n - one.from_above_n > FELT_SD * math.sqrt(2.0) * one.noise_n
        gone = abs(one.zero_shift_n) < FELT_SHARE * one.from_above_n
        if not (grew and gone and one.from_above_n > FELT_SD * one.noise_n):
            return (
                f"a touch gave {one.from_above_n:.3g} N, then {one.deeper_n:.3g} N deeper in the pad and "
                f"{one.zero_shift_n:.3g} N after the stage had left; no pad responds like this, so stage and cell do "
                "not confirm each other"
            )
    return None


def _calibration(facts: PressFacts, plan: TactileCheckPlan, cell: LoadCellSettings) -> tuple[CheckResult, ...]:
    """Judge age and straightness of the calibration."""
    if (calibration := facts.calibration) is None:
        return ()
    age, straight = "calibration is recent", "load cell is straight"
    what_age = "age of the load cell's calibration"
    limits = plan.limits
    if facts.calibration_age_days is None:
        reason = f"its date '{calibration.calibrated_utc}' cannot be read or lies ahead; calibrate the cell again"
        first = unmeasured(
            "load cell", age, what_age, "UNDECIDED", reason, limit_text(None, limits.calibration_age_days, "d")
        )
    else:
        first = measured(
            "load cell", age, what_age, max(facts.calibration_age_days, 0.0), AGE_SD_DAYS, "d",
            f"calibrated {calibration.calibrated_utc}; {calibration.traceability}",
            limits=ToleranceInterval(None, limits.calibration_age_days),
        )  # fmt: skip
    heaviest_n = max(calibration.masses_kg) * calibration.gravity_m_per_s2
    sd_n = max(calibration.counts_uncertainties) * abs(calibration.slope_n_per_count)
    worst_n = math.hypot(calibration.linearity_n, 0.5 * calibration.hysteresis_n)
    second = measured(
        "load cell", straight,
        "largest distance of the calibration from its straight line, with half the "
    "hysteresis, relative to the heaviest mass",
        100 * worst_n / heaviest_n, 100 * sd_n / heaviest_n, "%",
        f"{1e3 * calibration.linearity_n:.2g} mN from the line, {1e3 * calibration.hysteresis_n:.2g} mN between "
        f"loading and unloading, up to {heaviest_n:.3g} N",
        limits=ToleranceInterval(None, 100 * limits.linearity_rel),
    )  # fmt: skip
    factor = _factor(facts, plan, cell, calibration)
    _, _, address = calibration.cell.rpartition(", ")[2].partition(" ")
    if address != cell.address:
        other = f"the cell was calibrated at '{address}' and is at '{cell.address}'; calibrate it if it is another cell"
        return not_proven(first, other), not_proven(second, other), factor
    if cell.force_limit_n > heaviest_n:
        beyond = (
            f"force_limit_n = {cell.force_limit_n:g} N of the rig file exceeds the heaviest mass, {heaviest_n:.3g} N; "
            "calibrate with heavier masses, or lower force_limit_n"
        )
        return first, not_proven(second, beyond), factor
    return first, second, factor


def _factor(
    facts: PressFacts, plan: TactileCheckPlan, cell: LoadCellSettings, calibration: LoadCellCalibration
) -> CheckResult:
    """Judge the force of a known mass by the calibration.

    Its uncertainty holds that of the mass and of gravity, noise, the scatter of the layings, how far the zero moved
    (evenly likely), and the calibration's form. The slope's own does not count: the slope is what is judged.
    """
    name, what = "calibration holds", "calibrated force of a known mass minus its weight, relative to its weight"
    known, laid, most = plan.known_mass, facts.laid, 100 * plan.limits.factor_rel
    limits = ToleranceInterval(-most, most)
    if known is None or laid is None:
        return unmeasured("load cell", name, what, "UNDECIDED", NO_MASS, limit_text(-most, most, "%"))
    gravity = calibration.gravity_m_per_s2
    weight_n, force_n = known.mass_kg * gravity, float(np.mean(laid.forces_n))
    sd_n = math.hypot(
        known.uncertainty_kg * gravity,
        known.mass_kg * calibration.gravity_uncertainty_m_per_s2,
        math.sqrt(1.5 / len(laid.forces_n)) * laid.noise_n,
        float(np.ptp(laid.forces_n)) / 2.0,
        float(np.ptp(laid.zeros_n)) / math.sqrt(12.0),
        calibration.form_uncertainty_n,
    )
    evidence = (
        f"{known.mass_kg:g} kg +- {known.uncertainty_kg:.2g} kg laid {len(laid.forces_n)} times: {force_n:.4g} N "
    )
    evidence += f"by the calibration, {weight_n:.4g} N by its mass; {known.certificate or UNCERTIFIED}"
    if abs(force_n) < LAID_SHARE * weight_n:
        why = f"{evidence}, but hardly any force was felt; place the mass on the cell, and check again"
        return unmeasured("load cell", name, what, "UNDECIDED", why, limit_text(-most, most, "%"))
    found = measured(
        "load cell", name, what, 100 * (force_n / weight_n - 1.0), 100 * sd_n / weight_n, "%", evidence, limits=limits
    )
    if weight_n < LEAST_WEIGHT_SHARE * cell.force_limit_n:
        light = f"the mass weighs less than {100 * LEAST_WEIGHT_SHARE:g} % of force_limit_n; lay a heavier one"
        found = not_proven(found, light)
    same = any(math.isclose(known.mass_kg, one_kg, rel_tol=1e-3) for one_kg in calibration.masses_kg if one_kg)
    if same and not known.certificate:
        found = not_proven(found, ONE_OF_THEM)
    return found


def _at_rest(facts: PressFacts, plan: TactileCheckPlan, cell: LoadCellSettings) -> tuple[CheckResult, ...]:
    """Judge noise, drift, rate and gaps of the cell while nothing moved."""
    if (rest := facts.at_rest) is None:
        return ()
    limits, full_n = plan.limits, cell.force_limit_n
    free = max(rest.readings / READINGS_OF_A_BLOCK - len(rest.means_n), 1.0)
    spent = f"{rest.readings} readings within {rest.span_s:.3g} s"
    drift_n, drift_sd_n = rest_drift_n(rest)
    most = 100 * limits.cell_drift_rel
    per_minute = MINUTE_S / max(rest.span_s, 1e-9)
    zero = measured(
        "load cell", "load cell keeps its zero",
        "change of the zero in a minute without contact, relative to force_limit_n of the rig file",
        100 * drift_n * per_minute / full_n, 100 * drift_sd_n * per_minute / full_n, "%",
        f"{1e3 * drift_n:+.2g} mN within {rest.span_s:.3g} s", limits=ToleranceInterval(-most, most),
    )  # fmt: skip
    if plan.rest_s < MINUTE_S:
        zero = not_proven(
            zero, f"{plan.rest_s:g} s are too short for the drift in a minute; set rest_s = {MINUTE_S:g} or more"
        )
    quiet = measured(
        "load cell", "load cell is quiet", "noise of one reading, relative to force_limit_n of the rig file",
        100 * rest.noise_n / full_n, 100 * rest.noise_n / full_n / math.sqrt(2.0 * free), "%",
        f"{1e3 * rest.noise_n:.3g} mN in {spent}", limits=ToleranceInterval(None, 100 * limits.cell_noise_rel),
    )  # fmt: skip
    if rest.jumps:
        quiet = not_proven(quiet, LOST_BITS.format(jumps=rest.jumps, readings=rest.readings))
    rate_hz = (rest.readings - 1) / max(rest.span_s, 1e-9)
    low_hz, high_hz = (cell.rate_hz * (1.0 + sign * limits.cell_rate_rel) for sign in (-1.0, 1.0))
    return (
        quiet,
        zero,
        measured(
            "load cell", "readings a second", "mean number of readings a second", rate_hz,
            rate_hz * CLOCK_SD_S / max(rest.span_s, CLOCK_SD_S), "1/s",
            f"{spent}; the rig file states {cell.rate_hz}", limits=ToleranceInterval(low_hz, high_hz),
        ),
        measured(
            "load cell", "readings in time", "longest time between two readings", rest.longest_gap_s, CLOCK_SD_S, "s",
            spent, limits=ToleranceInterval(None, limits.cell_gap_s),
        ),
    )  # fmt: skip


def rest_drift_n(rest: CellAtRest) -> tuple[float, float]:
    """Return by how much the zero changed from the first to the last reading (N), with its standard uncertainty.

    A line through the means of equal parts of the time; its uncertainty is that of the scatter about it, enlarged for
    few parts (GUM Supplement 1, 6.4.9), so that a wandering zero counts as much as noise.
    """
    means = np.array(rest.means_n)
    place = (np.arange(means.size) + 0.5) / means.size - 0.5
    spread = float(place @ place)
    slope = float(place @ means) / spread
    left, free = means - means.mean() - slope * place, means.size - 2
    return slope, math.sqrt(float(left @ left) / free / spread * free / (free - 2))


def _moves(facts: PressFacts, plan: TactileCheckPlan, stage: StageSettings) -> tuple[CheckResult, ...]:
    """Judge the moves of each axis by what the controller reports."""
    return tuple(row for moves in facts.moves for row in _moves_of(moves, facts, plan, stage))


def _moves_of(
    moves: StageMoves, facts: PressFacts, plan: TactileCheckPlan, stage: StageSettings
) -> tuple[CheckResult, ...]:
    """Judge one axis."""
    axis, told = moves.axis, f"{moves.moves} moves, by what the controller counts"
    most_s = plan.limits.stage_overhead_s
    rows = (
        measured(
            "stage", f"{axis} moves in time", f"longest time that a move of {axis} takes beyond distance / speed",
            moves.longest_overhead_s, CLOCK_SD_S, "s", told, limits=ToleranceInterval(None, most_s),
        ),
        measured(
            "stage", f"{axis} reports its position", f"largest distance of the reported {axis} from where it was sent",
            moves.furthest_off_mm, REPORT_SD_MM, "mm", told,
            limits=ToleranceInterval(None, plan.limits.stage_report_mm),
        ),
    )  # fmt: skip
    scale = _by_camera(axis, facts, plan) if axis == stage.pad_axis else _by_block(stage, facts, plan)
    if scale.verdict != "PASS":
        whys = (f"it is not confirmed that {axis} travels as far as commanded", NO_SCALE.format(axis=axis))
        rows = not_proven(rows[0], whys[0]), not_proven(rows[1], whys[1])
    return *rows, scale


def _by_camera(axis: str, facts: PressFacts, plan: TactileCheckPlan) -> CheckResult:
    """Judge the way of the pad axis by the contact in the camera's picture.

    The standard uncertainty holds the scatter of the contacts on either side, what uneven light may shift each, and the
    scale's. Light and scale are stated, not measured.
    """
    name, what, most, way_mm = *_names(axis, "the contact in the camera's picture"), _most(plan), 2.0 * plan.beside_mm
    dents = np.array(facts.dents_px)
    base_px, tip_px = dents[0::2], dents[1::2]
    words = limit_text(-most, most, "%")
    if dents.size < 2 or abs(moved_px := float(tip_px.mean() - base_px.mean())) <= DENT_MOVED_PX:
        return unmeasured("stage", name, what, "UNDECIDED", NO_DENT.format(axis=axis), words)
    seen = f"the camera saw the contact move by {abs(moved_px):.4g} px while {axis} was sent {way_mm:g} mm"
    if plan.mm_per_px is None or plan.mm_per_px_u_rel is None:
        return unmeasured("stage", name, what, "UNDECIDED", f"{seen}; {NO_PICTURE_SCALE}", words)
    if dents.size < FEWEST_DENTS:
        return unmeasured("stage", name, what, "UNDECIDED", f"{seen}, too few times to give its scatter", words)
    number = base_px.size
    scatter_px = math.sqrt(0.5 * (base_px.var(ddof=1) + tip_px.var(ddof=1)))
    free = 2 * (number - 1)
    scatter_px *= math.sqrt(free / (free - 2)) * math.sqrt(2.0 / number)
    sd_px = math.hypot(scatter_px, math.sqrt(2.0) * DENT_LIGHT_PX)
    ratio = abs(moved_px) * plan.mm_per_px / way_mm
    sd = ratio * math.hypot(sd_px / moved_px, plan.mm_per_px_u_rel)
    evidence = f"{seen}, {number} times on either side of the position; the direction was not checked"
    return measured(
        "stage", name, what, 100 * (ratio - 1.0), 100 * sd, "%", evidence, limits=ToleranceInterval(-most, most)
    )


def _by_block(stage: StageSettings, facts: PressFacts, plan: TactileCheckPlan) -> CheckResult:
    """Judge the way of the press axis by a block of known thickness, which is touched before the pad."""
    axis = stage.press_axis
    name, what, most = *_names(axis, "a gauge block between two touches"), _most(plan)
    known, block, words = plan.gauge_block, facts.block, limit_text(-most, most, "%")
    if known is None or block is None:
        return unmeasured("stage", name, what, "UNDECIDED", NO_BLOCK, words)
    pad, on_block = np.array(block.pad_mm), np.array(block.block_mm)
    way_mm = stage.into_pad * float(pad.mean() - on_block.mean())
    evidence = (
        f"a block of {known.thickness_mm:g} +- {known.uncertainty_mm:.2g} mm was touched {way_mm:.4g} mm before the "
        f"pad, by {axis}, {pad.size} times each"
    )
    if abs(way_mm) < LAID_SHARE * known.thickness_mm + 2.0 * block.touch_uncertainty_mm:
        why = f"{evidence}; place the block on the pad, and check again"
        return unmeasured("stage", name, what, "UNDECIDED", why, words)
    scatter_mm = math.sqrt((pad.var(ddof=1) + on_block.var(ddof=1)) / pad.size)
    sd_mm = math.hypot(math.sqrt(2.0) * max(block.touch_uncertainty_mm, scatter_mm), known.uncertainty_mm)
    thick_mm = known.thickness_mm
    return measured(
        "stage", name, what, 100 * (way_mm / thick_mm - 1.0), 100 * sd_mm / thick_mm, "%", evidence,
        limits=ToleranceInterval(-most, most),
    )  # fmt: skip


def _names(axis: str, witness: str) -> tuple[str, str]:
    """Return name and meaning of the row on how far an axis goes."""
    return f"{axis} goes as far as sent", f"travel of {axis} by {witness} minus the commanded travel, relative to it"


def _most(plan: TactileCheckPlan) -> float:
    """Return the limit of an axis' scale (%)."""
    return 100 * plan.limits.scale_rel


def _touches(facts: PressFacts, plan: TactileCheckPlan, cell: LoadCellSettings) -> tuple[CheckResult, ...]:
    """Judge how well the touch repeats, what is lost on turning, and whether the cell returns to its zero."""
    if len(touches := facts.touches) < FEWEST_TOUCHES:  # an error ended them, and has a row of its own
        return ()
    limits, number = plan.limits, len(touches)
    spread_mm, spread_sd_mm = _spread_mm(touches)
    sides = {side: [one.touch_mm for one in touches if one.side == side] for side in ("base", "tip")}
    between = abs(float(np.mean(sides["base"]) - np.mean(sides["tip"]))) if all(sides.values()) else math.nan
    repeats = measured(
        "touch", "touch repeats", "standard deviation of the position at which the cell feels the pad", spread_mm,
        spread_sd_mm, "mm", f"{number} returns from either side in turn; the sides differ by {between:.2g} mm",
        limits=ToleranceInterval(None, limits.touch_repeat_mm),
    )  # fmt: skip
    repeats = _by_chi_square(repeats, number, limits.touch_repeat_mm)
    lost_mm, lost_sd_mm, relaxed_mm = backlash_mm(touches) or (math.nan, math.nan, math.nan)
    turn = measured(
        "touch", "press axis turns without play",
        "how much deeper the stage is on its way out of the pad, from the force there and the stiffness",
        lost_mm, lost_sd_mm, "mm",
        f"{number} turns of {touches[0].deeper_mm:.3g} mm; the pad gave way by {relaxed_mm:.2g} mm meanwhile, which is "
        "in the uncertainty",
        limits=ToleranceInterval(-limits.backlash_mm, limits.backlash_mm),
    )  # fmt: skip
    turn = not_proven(
        turn, "a pad that gives less force on the way out hides play, and its hysteresis was not measured"
    )
    if min(one.deeper_mm for one in touches) < TURNED_WIDTHS * limits.backlash_mm:
        turn = not_proven(
            turn, "the turns were too short to show a play at the limit; raise force_limit_n or deepest_mm of the plan"
        )
    shifts = [one.zero_shift_n for one in touches]
    worst_n, most = max(shifts, key=abs), 100 * limits.zero_return_rel
    zero_sd_n = float(np.std(shifts, ddof=1))
    zero = measured(
        "touch", "load cell returns to zero",
        "largest change of the zero by a press, relative to force_limit_n of the rig file",
        100 * worst_n / cell.force_limit_n, 100 * zero_sd_n / cell.force_limit_n, "%",
        f"{1e3 * worst_n:+.2g} mN after presses of {max(one.deeper_n for one in touches):.3g} N",
        limits=ToleranceInterval(-most, most),
    )  # fmt: skip
    if number < FEWEST_RETURNS:
        few = f"{number} returns are too few to pass; set returns = {FEWEST_RETURNS} or more"
        return not_proven(repeats, few), not_proven(turn, few), not_proven(zero, few)
    return repeats, turn, zero


def _by_chi_square(found: CheckResult, number: int, most: float) -> CheckResult:
    r"""Let a standard deviation pass only where its 95 % upper confidence limit is inside.

    :math:`s \sqrt{(n-1) / \chi^2_{0.05}}` for n normal values: at the limit it passes in 5 % of all checks.
    """
    if found.value is None or found.verdict != "PASS":
        return found
    upper = found.value * math.sqrt((number - 1) / float(chi2.ppf(0.05, number - 1)))
    p_conform = float(chi2.sf((number - 1) * (found.value / most) ** 2, number - 1))
    found = found.model_copy(update={"p_conform": p_conform})
    why = f"its 95 % upper confidence limit, {upper:.2g} {found.unit}, is beyond {most:g} {found.unit}"
    return found if upper <= most else not_proven(found, why)


def _spread_mm(touches: tuple[CheckedTouch, ...]) -> tuple[float, float]:
    """Return the standard deviation of the touches (mm), and its standard uncertainty: few touches, and their steps."""
    spread_mm = float(np.std([one.touch_mm for one in touches], ddof=1))
    one_mm = max(one.touch_uncertainty_mm for one in touches)
    return spread_mm, math.hypot(spread_mm / math.sqrt(2.0 * (len(touches) - 1)), one_mm)


def backlash_mm(touches: tuple[CheckedTouch, ...]) -> tuple[float, float, float] | None:
    r"""Return the play of the press axis (mm), its standard uncertainty, and by how much the pad gave way (mm).

    The force at one commanded position is larger when the position is reached out of the pad, because a stage with play
    stands deeper then. With the stiffness of the turn

    .. math:: b = (F_\text{below} - F_\text{above}) / k, \quad k = (F_\text{deeper} - F_\text{above}) / d.

    A pad that relaxes presses less after the turn, which hides play: what it lost while the stage stood, and once more
    for the step that was deeper, counts in full as a standard uncertainty. None where the force did not grow.
    """
    play, relaxed, noise = [], [], []
    for one in touches:
        stiffness = (one.deeper_n - one.from_above_n) / one.deeper_mm
        if stiffness <= 0.0:
            return None
        play.append((one.from_below_n - one.from_above_n) / stiffness)
        relaxed.append(2.0 * abs(one.relaxed_n) / stiffness)
        noise.append(math.sqrt(2.0) * one.noise_n / stiffness)
    number = len(play)
    scatter = float(np.std(play, ddof=1)) / math.sqrt(number) * math.sqrt((number - 1) / (number - 3))
    gave_mm = float(np.mean(relaxed))
    return float(np.mean(play)), math.hypot(scatter, gave_mm, float(np.mean(noise)) / math.sqrt(number)), gave_mm


def _force_limit(facts: PressFacts, plan: TactileCheckPlan, cell: LoadCellSettings) -> tuple[CheckResult, ...]:
    """Judge the force beyond a limit at which the stage stopped: one more step of the pad's stiffness is allowed.

    Between steps, no further one was begun. Within a move through depths that steps had measured before, the stage was
    stopped where the force stayed below that of the move's end: the cell is the witness, and a known mass that of the
    cell.
    """
    if not (stops := facts.force_stops):
        return ()
    moving = [one.moving for one in stops if one.moving is not None]
    tries = [(one.peak_n, one.limit_n, one) for one in stops]
    tries += [(one.moving.peak_n, one.moving.limit_n, one) for one in stops if one.moving is not None]
    peak_n, limit_n, worst = max(tries, key=lambda one: one[0] - one[1] - one[2].stiffness_n_per_mm * one[2].step_mm)
    evidence = (
        f"worst of {len(tries)} stops, at {limit_n:.3g} N; allowed is one step of {worst.step_mm:g} mm at "
        f"{worst.stiffness_n_per_mm:.3g} N/mm"
    )
    if moving:
        evidence += f"; {_in_words(moving)}"
    found = measured(
        "force limit", "force stops the stage", "largest force beyond a limit at which the stage was stopped",
        peak_n - limit_n, 2.0 * worst.noise_n, "N", evidence,
        limits=ToleranceInterval(None, worst.stiffness_n_per_mm * worst.step_mm),
    )  # fmt: skip
    why = [] if len(moving) == len(stops) else [ONE_STEP]
    if any(one.moving and one.moving.peak_n + FELT_SD * one.noise_n > one.moving.unstopped_n for one in stops):
        why.append(TO_ITS_END)
    why += _unstopped(moving)
    if facts.calibration is None or _factor(facts, plan, cell, facts.calibration).verdict != "PASS":
        why.append(NO_FACTOR)
    if len(stops) < FEWEST_STOPS:
        why.append(_few(len(stops)))
    return (not_proven(found, "; ".join(why)) if why else found,)


def _in_words(moving: list[MovingStop]) -> str:
    """Say where the longest of some moves was stopped: by which force, and how long before its end."""
    longest = max(moving, key=lambda one: one.way_mm)
    said = f"{len(moving)} moves of up to {longest.way_mm:.2g} mm had a limit halfway; in the longest "
    if longest.stopped_at_n is None:
        said += f"no reading passed {longest.limit_n:.3g} N"
    else:
        said += f"a reading of {longest.stopped_at_n:.3g} N passed {longest.limit_n:.3g} N"
    if longest.stood_mm is None or longest.end_mm is None:
        return f"{said}, and the stage's position was unknown afterwards"
    return (
        f"{said}, the stage stood {abs(longest.end_mm - longest.stood_mm):.2g} mm before the end of the move, and the "
        f"cell felt up to {longest.peak_n:.3g} N; a press in steps had given {longest.unstopped_n:.3g} N"
    )


def _unstopped(moving: list[MovingStop]) -> list[str]:
    """Say which moves ended without a force beyond the limit, or at their end by the controller's count."""
    if any(one.stopped_at_n is None or one.peak_n <= one.limit_n for one in moving):
        return [NO_FORCE_PASSED]
    at_end = any(one.stood_mm is not None and one.end_mm is not None
                 and abs(one.end_mm - one.stood_mm) < LEAST_LEFT_SHARE * one.way_mm for one in moving)  # fmt: skip
    unknown = any(one.stood_mm is None for one in moving)
    return [COUNTED_TO_ITS_END] * at_end + [UNKNOWN_AFTER_A_STOP] * unknown


def _few(stops: int) -> str:
    """Say that a stage that stops now and then could pass by chance."""
    return f"{stops} stops are too few; set stops = {FEWEST_STOPS} or more"


_REASONS: Final[dict[Literal["request", "silent cell"], tuple[str, str]]] = {
    "request": ("stage stops on request", "longest time from a request until the stage was seen to be at rest"),
    "silent cell": (
        "stage stops at a silent cell",
        "longest time from the cell's last reading until the stage was seen to be at rest",
    ),
}


def _stops(facts: PressFacts, plan: TactileCheckPlan, cell: LoadCellSettings) -> tuple[CheckResult, ...]:
    """Judge stops on the way out of the pad, and whether the touch is where it was afterwards."""
    if not facts.stops:
        return ()
    rows = []
    for reason in _REASONS:
        stops = [one for one in facts.stops if one.reason == reason]
        silent_s = cell.silent_s if reason == "silent cell" else 0.0
        if stops:
            rows.append(_stop(stops, silent_s + plan.limits.halt_s))
    return (*rows, *_after_stops(facts, plan))


def _stop(stops: list[StageStop], most_s: float) -> CheckResult:
    """Judge the stops for one reason."""
    name, what = _REASONS[stops[0].reason]
    words = limit_text(None, most_s, "s")
    driven = [one for one in stops if one.stood_mm is not None and abs(one.stood_mm - one.end_mm) < 1e-2]
    if driven:
        reason = f"the stage did not stop before the end of its move in {len(driven)} of {len(stops)} tries"
        return unmeasured("stops", name, what, "FAIL", reason, words)
    is_felt = all(one.still_after_s is not None for one in stops)
    who = "and the cell felt no more motion" if is_felt else "as the controller reports"
    evidence = f"slowest of {len(stops)} stops on the way out of the pad, {who}"
    creeps = [one.unseen_creep_rel for one in stops if one.unseen_creep_rel is not None]
    if creeps:
        evidence += f"; a creep below {100 * max(creeps):.2g} % of its speed would not be felt"
    if stops[0].reason == "silent cell":
        evidence += "; readings were withheld from the stage, the cell's cable was not pulled"
    slowest_s = max(max(one.stood_after_s, one.still_after_s or 0.0) for one in stops)
    sd_s = max(CLOCK_SD_S, *(one.still_sd_s or 0.0 for one in stops))
    found = measured("stops", name, what, slowest_s, sd_s, "s", evidence, limits=ToleranceInterval(None, most_s))
    lost = sum(one.stood_mm is None for one in stops)
    why = [] if is_felt else [ONLY_COUNTED]
    if lost:
        why.append(f"after {lost} of the stops the stage's position was unknown")
    if len(stops) < FEWEST_STOPS:
        why.append(_few(len(stops)))
    return not_proven(found, "; ".join(why)) if why else found


def _after_stops(facts: PressFacts, plan: TactileCheckPlan) -> tuple[CheckResult, ...]:
    r"""Judge whether the touch after all stops is where it was before.

    The standard uncertainty of the difference of the means of m touches before and n after holds that of a touch, which
    steps and noise bound, and their scatter s about the means with :math:`\nu = m + n - 2` degrees of freedom:

    .. math:: s \sqrt{\nu / (\nu - 2)} \sqrt{1 / m + 1 / n},

    or half of the distance between the touches after the stops where that is more.
    """
    name, what = "position survives stops", "position of the touch after all stops less the mean of those before"
    most_mm = plan.limits.touch_repeat_mm
    if len(facts.after_stops) < 2 or len(facts.touches) < FEWEST_TOUCHES:
        few = [f"{len(facts.after_stops)} after the stops (2 are needed)"] if len(facts.after_stops) < 2 else []
        if len(facts.touches) < FEWEST_TOUCHES:
            few.append(f"{len(facts.touches)} before the stops ({FEWEST_TOUCHES} are needed)")
        reason = f"too few touches were made: {' and '.join(few)}"
        return (unmeasured("stops", name, what, "UNDECIDED", reason, limit_text(-most_mm, most_mm, "mm")),)
    before, after = (np.array([one.touch_mm for one in some]) for some in (facts.touches, facts.after_stops))
    free = before.size + after.size - 2
    squares = float(((before - before.mean()) ** 2).sum() + ((after - after.mean()) ** 2).sum())
    scatter_mm = math.sqrt(squares / free * free / (free - 2) * (1.0 / before.size + 1.0 / after.size))
    scatter_mm = max(scatter_mm, float(np.ptp(after)) / 2.0)
    touch_mm = max(one.touch_uncertainty_mm for one in (*facts.touches, *facts.after_stops)) * math.sqrt(2.0)
    evidence = f"{after.size} touches after {len(facts.stops)} stops, {1e3 * float(np.ptp(after)):.2g} um apart"
    evidence += "; steps that a stop loses would show here"
    return (
        measured(
            "stops", name, what, float(after.mean() - before.mean()), math.hypot(touch_mm, scatter_mm), "mm", evidence,
            limits=ToleranceInterval(-most_mm, most_mm),
        ),
    )  # fmt: skip
