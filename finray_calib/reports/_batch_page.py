"""The page over many presses and simulators: who explains most, by how much, where it goes wrong, what to capture next.

Simulators are ranked over the presses that all of them have; the worst presses stand with picture and causes.
"""

from collections.abc import Iterator, Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    ComparedPair,
    ComparisonBatch,
    ErrorAttribution,
    Model,
    PhotometricErrorReport,
    SimulatedPress,
    SimulatorScore,
    SkillDifference,
    SkillOverPresses,
    TactileCapture,
    package_version,
)
from finray_calib.compare import OWN_NOISE
from finray_calib.reports._comparison_statements import judged_skill
from finray_calib.reports._images import ByteImage, png_data_uri, touch_changes, touch_pictures
from finray_calib.reports._page import (
    Content,
    KeyNumber,
    Light,
    Link,
    Part,
    Picture,
    ReportPage,
    ReportTable,
    drawing,
    files_table,
    findings_section,
    in_rows,
    light_of,
    limits_section,
    one_group,
    report_html,
)
from finray_calib.reports._plain_text import NO_VALUE, fixed, plain, relative_sentence, skill_text
from finray_calib.reports._style import BLUE, INK, MUTED, new_figure, styled, svg_text

_TILE_PX = 150
_MOST_DOTS = 2000
#: Change of the picture, relative to the untouched level, that is shown as full colour.
_SHOWN_PERCENTILE = 99.0


class PressPictures(Model):
    """What the page shows of one press; plain text, so that another process can make it.

    Attributes
    ----------
    simulator, name
        Whose press, and which.
    page
        File of its own page, relative to this one.
    skill
        Of the simulation.
    tiles
        Captured, simulated and what is left over, side by side, as a PNG data URI.
    attribution
        Causes of its error without their maps; None where they cannot be told.
    """

    simulator: str
    name: str
    page: str
    skill: float
    tiles: str
    attribution: ErrorAttribution | None


def press_pictures(
    simulator: str,
    name: str,
    page: str,
    report: PhotometricErrorReport,
    press: SimulatedPress,
    capture: TactileCapture,
) -> PressPictures:
    """Return the small pictures of a press: captured, simulated, simulated change minus captured change."""
    factors = tuple(region.factor for region in report.regions)
    shown, changes = touch_pictures(press, capture, factors), touch_changes(press, capture, factors)
    left = changes.simulated - changes.captured
    scale = float(np.nanpercentile(np.abs(changes.captured), _SHOWN_PERCENTILE)) if changes.captured.size else 1.0
    tiles = _tiles([shown.captured, shown.simulated, _signed(left, max(scale, 1e-9))])
    causes = None if report.attribution is None else report.attribution.model_copy(update={"maps": None})
    return PressPictures(
        simulator=simulator, name=name, page=page, skill=report.headline_skill.estimate, tiles=png_data_uri(tiles),
        attribution=causes,
    )  # fmt: skip


def _tiles(pictures: Sequence[ByteImage]) -> ByteImage:
    """Return pictures side by side in the size of a tile, with a margin; a high one is narrower than its tile."""
    heights = [max(1, round(_TILE_PX * picture.shape[0] / picture.shape[1])) for picture in pictures]
    lying = min(heights) <= _TILE_PX * 3 // 4
    whole = np.full((_TILE_PX * 3 // 4 if lying else _TILE_PX * 4 // 3, (_TILE_PX + 6) * len(pictures), 3), 255)
    for number, (picture, height) in enumerate(zip(pictures, heights, strict=True)):
        rows, left = min(height, len(whole)), number * (_TILE_PX + 6) + 3
        columns = max(1, round(_TILE_PX * rows / height))
        small = cv2.resize(np.ascontiguousarray(picture), (columns, rows), interpolation=cv2.INTER_AREA)
        whole[:rows, left : left + columns] = small
    return whole.astype(np.uint8)


def _signed(values: NDArray[np.float64], top: float) -> ByteImage:
    """Return values as blue (too dark) over white to orange (too bright)."""
    share = np.clip(np.nan_to_num(values) / top, -1.0, 1.0)[..., None]
    white, dark, bright = np.array([255.0, 255.0, 255.0]), np.array([0.0, 84.0, 147.0]), np.array([213.0, 94.0, 0.0])
    ends = np.where(share < 0.0, dark, bright)
    return np.asarray(np.rint(white + np.abs(share) * (ends - white)), dtype=np.uint8)


def batch_page(batch: ComparisonBatch, worst: Sequence[PressPictures], command: str, digests: Mapping[str, str]) -> str:
    """Return the page over all presses as self-contained HTML; equal input gives equal text.

    Parameters
    ----------
    batch
        The comparison.
    worst
        The presses of lowest skill, the lowest first.
    command
        The command that reproduces it.
    digests
        Name of each input file -> SHA-256.
    """
    failed = sum(pair.skill is None for pair in batch.pairs)
    names = {pair.name for pair in batch.pairs}
    return report_html(
        ReportPage(
            verb="finray compare",
            title=f"{len(names)} presses, {_count(len(batch.simulators), 'simulator')}",
            lead=(
                "How far simulated touches are from real ones. A skill of 0 means that the simulation predicts a "
                "touch no better than the image without contact does; 1 is perfect." + relative_sentence(batch)
            ),
            verdict=_verdict(batch),
            light=_light(batch),
            sentence=" ".join(list(_sentences(batch))[:1]),
            picture=_ranking_picture(batch) if _ranked(batch) else None,
            key_numbers=tuple(_key_numbers(batch)),
            parts=(
                *findings_section((*list(_sentences(batch))[1:], *_own_sentence(batch), *_failures(batch))),
                limits_section(_limits(batch), batch.notes),
                *_sections(batch, worst),
            ),
            command=command,
            origin=files_table(digests, package_version()),
            summary=plain({"comparison": batch.model_dump(mode="json", exclude={"provenance"}), "failed": failed}),
        )
    )


def _light(batch: ComparisonBatch) -> Light:
    """Return the light of the best simulator."""
    ranked = _ranked(batch)
    return _judged(batch, *ranked[0])[0] if ranked else "bad"


def _judged(batch: ComparisonBatch, score: SimulatorScore, skill: SkillOverPresses) -> tuple[Light, str]:
    """Return the light of a simulator's skill, and why."""
    if any(OWN_NOISE in pair.findings for pair in _scored(batch, score)):
        return "care", "captures were made from its renders"
    return judged_skill(skill.low95, skill.high95)


def _scored(batch: ComparisonBatch, score: SimulatorScore) -> list[ComparedPair]:
    """Return the compared pairs of a simulator."""
    return [pair for pair in batch.pairs if pair.simulator == score.simulator and pair.skill is not None]


def _own_sentence(batch: ComparisonBatch) -> Iterator[str]:
    """Yield how many captures prove nothing, where there are any."""
    own = sum(OWN_NOISE in pair.findings for pair in batch.pairs)
    if own:
        yield (
            f"In {own} of {_count(len(batch.pairs), 'pair')} the capture was made from the render that it is compared "
            "with: agreement shows only that the comparison works."
        )


def batch_lines(batch: ComparisonBatch) -> Iterator[str]:
    """Yield what the terminal prints of a batch: skills over presses, differences, the worst, what to capture."""
    if batch.relative:
        yield relative_sentence(batch).strip()
    for score in batch.simulators:
        if score.skill is not None:
            yield f"{_simulator(score)}: skill {skill_over_text(score.skill)}, {_over(score.skill)}"
            yield f"  {_method(score.skill)}"
        else:
            yield f"{_simulator(score)}: no press could be compared"
    if len(batch.differences) > 1:
        yield "differences in skill; all their 95 % intervals hold together (Bonferroni):"
    for difference in batch.differences:
        yield f"{_difference_sentence(difference)}"
    yield from _own_sentence(batch)
    if batch.worst:
        of = f" of {_simulator(batch.simulators[0])}" if len(batch.simulators) > 1 else ""
        yield f"lowest{of}: {', '.join(batch.worst)}"
    for wish in batch.to_capture_next:
        yield f"capture next: {wish}"


def skill_over_text(skill: SkillOverPresses) -> str:
    """Return the skill of all presses with its interval, where there is one."""
    if skill.low95 is None or skill.high95 is None:
        return fixed(skill.estimate, 3)
    return skill_text(skill.estimate, skill.low95, skill.high95)


def _simulator(score: SimulatorScore) -> str:
    """Return how a simulator is called."""
    return score.simulator or "simulation"


_PLURAL = {"press": "presses"}


def _count(number: int, what: str) -> str:
    """Return a number of things."""
    return f"{number} {what}" if number == 1 else f"{number} {_PLURAL.get(what, what + 's')}"


def _over(skill: SkillOverPresses) -> str:
    """Say what the skill is taken over."""
    units = "" if skill.unit == "press" else f" of {_count(skill.units, skill.unit)}"
    return f"over {_count(skill.presses, 'press')}{units}"


def _method(skill: SkillOverPresses) -> str:
    """Say how the interval was formed and what it does not know."""
    unknown = f"; not included: {', '.join(skill.not_sampled)}" if skill.not_sampled else ""
    if skill.low95 is None:
        return f"{skill.method}{unknown}"
    return f"95 % over {_count(skill.units, skill.unit)}: {skill.method}{unknown}"


def _named(batch: ComparisonBatch, pair: ComparedPair) -> str:
    """Return the name of a press, with its simulator where there are several."""
    return f"{pair.simulator}, {pair.name}" if len(batch.simulators) > 1 else pair.name


def _ranked(batch: ComparisonBatch) -> list[tuple[SimulatorScore, SkillOverPresses]]:
    """Return the simulators that have a skill, the best first."""
    return [(score, score.skill) for score in batch.simulators if score.skill is not None]


def _verdict(batch: ComparisonBatch) -> str:
    """Say which simulator is best, or how good the only one is."""
    ranked = _ranked(batch)
    if not ranked:
        return "Nothing could be compared"
    score, skill = ranked[0]
    scored = _scored(batch, score)
    if scored and all(OWN_NOISE in pair.findings for pair in scored):
        return "This comparison proves nothing about the simulation"
    if len(ranked) == 1:
        if skill.low95 is None or skill.high95 is None:
            return f"Skill {fixed(skill.estimate, 2)}; {_count(skill.units, skill.unit)} give no interval"
        if skill.low95 > 0.0:
            return "Better than no simulation"
        return "Worse than no simulation" if skill.high95 < 0.0 else "Not distinguishable from no simulation"
    next_one = next((d for d in batch.differences if {d.first, d.second} == {s.simulator for s, _ in ranked[:2]}), None)
    if next_one is None or next_one.low95 is None:
        return f"{_simulator(score)} scores highest; too few presses to distinguish it from the next"
    return f"{_simulator(score)} is best" if next_one.low95 > 0.0 else "The best two cannot be distinguished"


def _sentences(batch: ComparisonBatch) -> Iterator[str]:
    """Yield the scores in words."""
    for score, skill in _ranked(batch):
        yield f"{_capital(_simulator(score))} scores {skill_over_text(skill)} {_over(skill)}."


def _capital(text: str) -> str:
    """Return the name of a simulator as the beginning of a sentence."""
    return "The simulation" if text == "simulation" else f"\u201c{text}\u201d"


def _failures(batch: ComparisonBatch) -> Iterator[str]:
    """Yield the first pairs that could not be compared and why; what all simulators share is said once."""
    of: dict[tuple[str, str], list[str]] = {}
    for pair in batch.pairs:
        if pair.error:
            of.setdefault((pair.name, pair.error), []).append(pair.simulator)
    for (name, error), simulators in list(of.items())[:_MOST_FAILURES]:
        whose = f" ({', '.join(simulators)})" if len(batch.simulators) > len(simulators) else ""
        yield f"Not compared: {name}{whose}: {error}"
    if len(of) > _MOST_FAILURES:
        yield f"{len(of) - _MOST_FAILURES} more were not compared; summary.csv says why."


_MOST_FAILURES = 5


def _key_numbers(batch: ComparisonBatch) -> Iterator[KeyNumber]:
    """Yield the skill of the best two, and how much was compared."""
    for score, skill in _ranked(batch)[:2]:
        between = "no interval: it needs three presses"
        if skill.low95 is not None and skill.high95 is not None:
            places = 3 if skill.high95 - skill.low95 < 0.02 else 2
            ends = fixed(skill.low95, places), fixed(skill.high95, places)
            between = f"95 %: {' to '.join(ends)}" if ends[0] != ends[1] else "its interval is narrower than 0.001"
        judged = _judged(batch, score, skill)
        name = "Relative skill" if batch.relative else "Skill"
        yield KeyNumber(f"{name}, {_simulator(score)}", fixed(skill.estimate, 3), between, *judged)
    if len(_ranked(batch)) < 2:
        yield KeyNumber("Doing nothing", "0", "an image of the untouched pad in place of the simulation")
    compared, total = sum(pair.skill is not None for pair in batch.pairs), len(batch.pairs)
    light = light_of(compared == total, is_bad=compared == 0)
    yield KeyNumber(
        "Compared",
        f"{compared} of {total}",
        "pairs" if compared == total else "pairs; the others are named below",
        light,
        "all" if compared == total else "not all",
    )


def _limits(batch: ComparisonBatch) -> Iterator[str]:
    """Yield what the numbers do not know."""
    ranked = _ranked(batch)
    if ranked:
        _, skill = ranked[0]
        yield (
            "Skill over presses is 1 - the sum of squared errors of all presses / the sum of their squared changes by "
            "contact, so a press that changes the picture more counts more."
        )
        yield f"Its interval: {_method(skill)}."
        if skill.unit == "press":
            yield (
                "Presses are assumed to be independent samples of the presses that matter to you. The same place and "
                "depth again is a repeat; mark it by the column press in --pairs."
            )
    if batch.differences:
        yield (
            "Differences are taken press by press, so that difficulties of a press that both simulators "
            "share cancel. Their 95 % intervals are simultaneous (Bonferroni over "
            f"{_count(len(batch.differences), 'difference')})."
        )
    yield "The pages of single presses show intervals of one press; these do not apply to other presses."


def _sections(batch: ComparisonBatch, worst: Sequence[PressPictures]) -> Iterator[Part]:
    """Yield ranking, worst presses, causes, and all presses."""
    if _ranked(batch):
        yield _ranking_part(batch)
    if worst:
        yield _worst_part(batch, worst)
    if any(press.attribution is not None for press in worst):
        yield _causes_part(batch, worst)
    if batch.to_capture_next:
        rows = [(str(k), wish) for k, wish in enumerate(batch.to_capture_next, start=1)]
        table = one_group("Most useful first", ("", "capture"), rows, is_words=True)
        yield Part("What to capture next", Content("What would make these scores more certain.", tables=(table,)))
    table = _all_table(batch, {(press.simulator, press.name): press.page for press in worst})
    yield Part("All presses", Content("Skill of each press, with a link to its page where it is one of the worst.",
                                      tables=(table,), has_wide_tables=True))  # fmt: skip


def _ranking_picture(batch: ComparisonBatch) -> Picture:
    """Show the skill of all simulators."""
    return drawing(
        ranking_figure(batch),
        " ".join(_sentences(batch)),
        "Large mark with bar: skill of all presses together with its 95 % interval; small marks: single presses. "
        "What to see: simulators whose intervals do not overlap differ; where intervals overlap, look at the "
        "differences, which are taken press by press.",
    )


def _ranking_part(batch: ComparisonBatch) -> Part:
    """List the skills and their differences."""
    tables = [_score_table(batch), *([_difference_table(batch)] if batch.differences else [])]
    return Part("Ranking", Content(tables=tuple(tables)))


@styled()
def ranking_figure(batch: ComparisonBatch) -> str:
    """Draw the skill of each simulator with its interval, and those of its presses."""
    ranked = _ranked(batch)
    figure = new_figure(7.2, 0.75 * len(ranked) + 1.1)
    axes = figure.subplots()
    lowest = 0.0
    for place, (score, skill) in enumerate(ranked):
        of = [p.skill.estimate for p in batch.pairs if p.simulator == score.simulator and p.skill is not None]
        shown = np.array(of[:_MOST_DOTS])
        spread = 0.28 * np.sin(2.4 * np.arange(len(shown)))  # apart, and the same each time
        axes.plot(shown, place + spread, ".", color=MUTED, markersize=4.0, alpha=0.6)
        low, high = skill.low95, skill.high95
        bar = None if low is None or high is None else [[skill.estimate - low], [high - skill.estimate]]
        axes.errorbar([skill.estimate], [place], xerr=bar, fmt="o", color=BLUE, markersize=8.0, linewidth=2.2)
        lowest = min(lowest, float(np.quantile(shown, 0.02)), skill.estimate if low is None else low)
    axes.axvline(0.0, color=MUTED, linewidth=1.0)
    axes.axvline(1.0, color=MUTED, linewidth=1.0, linestyle=":")
    left = max(lowest - 0.05, -2.0)
    axes.set(ylim=(len(ranked) - 0.5, -0.5), xlim=(left, 1.05), xlabel="skill (1): 0 is doing nothing, 1 is perfect")
    labels = [_simulator(score)[-32:].replace("$", r"\$") for score, _ in ranked]
    axes.set_yticks(range(len(ranked)), labels, color=INK)
    axes.grid(visible=False, axis="y")
    return svg_text(figure)


def _score_table(batch: ComparisonBatch) -> ReportTable:
    """List the simulators."""
    rows = [
        (
            _simulator(score),
            NO_VALUE if score.skill is None else skill_over_text(score.skill),
            NO_VALUE if score.skill is None else str(score.skill.presses),
            str(score.compared),
            str(score.failed),
        )
        for score in batch.simulators
    ]
    columns = ("simulator", "skill [95 %]", "presses in it", "compared", "failed")
    return one_group("Simulators, the best first", columns, rows)


def _difference_table(batch: ComparisonBatch) -> ReportTable:
    """List the differences of every two simulators."""
    rows = [
        (
            f"{d.first} less {d.second}",
            fixed(d.estimate, 3) if d.low95 is None or d.high95 is None else skill_text(d.estimate, d.low95, d.high95),
            f"{d.better_in} of {d.presses}",
            _told_apart(d),
        )
        for d in batch.differences
    ]
    columns = (
        "pair", "difference in skill [95 %, all together]", "presses in which the first is better", "distinguishable",
    )  # fmt: skip
    return one_group("Differences, press by press", columns, rows)


def _told_apart(difference: SkillDifference) -> str:
    """Say whether two simulators are told apart."""
    if difference.low95 is None or difference.high95 is None:
        return "too few presses"
    return "yes" if difference.low95 > 0.0 or difference.high95 < 0.0 else "no"


def _difference_sentence(d: SkillDifference) -> str:
    """Return a difference in one line."""
    ends = "no interval" if d.low95 is None or d.high95 is None else skill_text(d.estimate, d.low95, d.high95)
    shown = f"{fixed(d.estimate, 3)}, {ends}" if d.low95 is None else ends
    return f"{d.first} minus {d.second}: {shown}; better in {d.better_in} of {d.presses} presses"


def _worst_part(batch: ComparisonBatch, worst: Sequence[PressPictures]) -> Part:
    """Show the presses of lowest skill."""
    pictures = [_worst_picture(batch, press) for press in worst]
    rows = in_rows(pictures)
    lead = (
        "From left to right: captured, simulated, and simulated minus captured change (orange: the simulation is too "
        "bright, blue: too dark, full colour at the largest captured change)."
    )
    return Part(f"The {_count(len(worst), 'press')} of lowest skill", Content(lead, rows))


def _worst_picture(batch: ComparisonBatch, press: PressPictures) -> Picture:
    """Return the pictures of one press with its largest cause."""
    name = f"{press.simulator}, {press.name}" if len(batch.simulators) > 1 else press.name
    cause = ""
    if press.attribution is not None and press.attribution.causes:
        first = press.attribution.causes[0]
        cause = f"; largest cause: {first.cause}, {fixed(first.skill_lost, 3)}"
    text = f"{name}: skill {fixed(press.skill, 3)}{cause}"
    what = f"Captured change, simulated change and the remaining difference, {text}."
    return Picture(press.tiles, what, text, is_raster=True, is_small=True)


def _causes_part(batch: ComparisonBatch, worst: Sequence[PressPictures]) -> Part:
    """List what each of the worst presses loses by what."""
    told = [(press, press.attribution) for press in worst if press.attribution is not None]
    names = list(dict.fromkeys(cause.cause for _, found in told for cause in found.causes))
    totals: dict[str, float] = {
        n: sum(c.skill_lost for _, found in told for c in found.causes if c.cause == n) for n in names
    }
    names.sort(key=lambda n: -totals[n])
    rows = []
    for press, found in told:
        of = {cause.cause: fixed(cause.skill_lost, 3) for cause in found.causes}
        name = f"{press.simulator}, {press.name}" if len(batch.simulators) > 1 else press.name
        rest = (found.saturation_skill, found.noise_skill, found.remainder_skill, found.skill_lost)
        last = (fixed(value, 3) for value in rest)
        rows.append((name, *(of.get(n, NO_VALUE) for n in names), *last))
    columns = ("press", *names, "saturation", "noise", "remainder", "1 - skill")
    lead = "No small change of the simulation explains the remaining difference."
    if names:
        lead = _causes_sentence(totals, [found for _, found in told])
    remark = (
        "The parts of a row add up to 1 - skill. The page of each press shows how large each cause of lost skill is, "
        "with pictures."
    )
    return Part(
        "Why the worst differ",
        Content(lead, remarks=(remark,), tables=(one_group("Skill lost", columns, rows),)),
    )


def _causes_sentence(totals: Mapping[str, float], told: Sequence[ErrorAttribution]) -> str:
    """Say what costs most skill: a cause, or what no cause explains."""
    parts = {
        **totals,
        "saturation": sum(found.saturation_skill for found in told),
        "noise": sum(found.noise_skill for found in told),
        "what none of the causes explains (remainder)": sum(found.remainder_skill for found in told),
    }
    cause, most = (max(of, key=lambda name: of[name]) for of in (totals, parts))
    told_cause = f" Of the causes, {cause} costs most: {fixed(totals[cause] / len(told), 3)}." if cause != most else ""
    return (
        f"Most skill is lost by {most}: {fixed(parts[most] / len(told), 3)} for each press, averaged over these "
        f"presses.{told_cause}"
    )


def _all_table(batch: ComparisonBatch, pages: Mapping[tuple[str, str], str]) -> ReportTable:
    """List all pairs."""
    rows = []
    for pair in batch.pairs:
        name: str | Link = _named(batch, pair)
        page = pages.get((pair.simulator, pair.name))
        if page is not None:
            name = Link(_named(batch, pair), page)
        floor = NO_VALUE if pair.floor_skill is None else fixed(pair.floor_skill.estimate, 3)
        skill = "not compared" if pair.skill is None else fixed(pair.skill.estimate, 3)
        rows.append((name, skill, floor, str(len(pair.findings))))
    return one_group("Skill of every press", ("press", "skill", "floor", "findings"), rows)
