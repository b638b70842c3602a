"""The pages of a search over designs, and of the powers and places of its lights.

The recommended finger, what it gains, the front, and what each parameter does; lights with their powers over the pad
that they light, and a map over two numbers of a finger.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from matplotlib.axes import Axes

from data_schemas import (
    DesignGain,
    DesignObjective,
    DesignOptimum,
    LightPlaceMap,
    LightPowers,
    OptimisedDesign,
    package_version,
)
from finray_calib.reports import (
    CHANNELS,
    MUTED,
    Content,
    KeyNumber,
    Light,
    Part,
    Picture,
    ReportPage,
    ReportTable,
    drawing,
    files_table,
    findings_section,
    interval_text,
    legend_above,
    light_map_figure,
    light_map_sentence,
    lights_from_the_side,
    limits_section,
    lit_pad_figure,
    methods_part,
    new_figure,
    one_group,
    percent,
    probability,
    report_html,
    signed_percent,
    styled,
    svg_text,
)

#: Designs shown as the front: as likely on it as not.
ON_FRONT: Final = 0.5
#: A parameter nearer to its limit than this share of its range is called at it.
_AT_LIMIT: Final = 0.02
_PANELS_IN_A_ROW: Final = 4
#: A search that may have missed this much is to be read with care.
_SMALL_REGRET_REL: Final = 0.05
_LOOKS: Final = {
    "screen": ("o", MUTED, "screen"),
    "search": ("^", CHANNELS[2][2], "proposed by the emulator"),
    "start": ("D", "#1c2128", "start"),
    "chosen": ("*", CHANNELS[0][2], "chosen"),
}
"""Role -> marker, colour and words."""


def optimum_page(optimum: DesignOptimum, command: str, digests: Mapping[str, str], version: str) -> str:
    """Return the page of a search over designs (HTML).

    Parameters
    ----------
    optimum
        The search.
    command
        That made it.
    digests
        Input file -> SHA-256.
    version
        Of the package.
    """
    first, *others = (_gain(optimum, objective, "start") for objective in optimum.objectives)
    light, reason = _judged(first)
    lost = [gain for gain in others if _judged(gain)[0] == "bad"]
    return report_html(
        ReportPage(
            verb="finray design optimise",
            title=optimum.name,
            lead=f"{len(optimum.designs)} designs within limits of {', '.join(p.field for p in optimum.parameters)}, "
            f"for {' and '.join(o.name for o in optimum.objectives)}.",
            verdict=_sentence_case("; ".join(_verdict(gain) for gain in (first, *lost))),
            light="care" if lost and light == "good" else light,
            sentence=optimum.sentence,
            picture=_front_picture(optimum),
            key_numbers=(
                KeyNumber(
                    f"Gain in {first.objective} against the start", _best_known(first), _how(first), light, reason
                ),
                _screen_number(optimum),
                KeyNumber(
                    "Lost at most",
                    percent(optimum.regret_95_rel),
                    f"against the best design within the limits (95 %, emulator); {percent(optimum.regret_rel)} "
                    "expected",
                    "good" if optimum.regret_95_rel < _SMALL_REGRET_REL else "care",
                    "little is left" if optimum.regret_95_rel < _SMALL_REGRET_REL else "more evaluations may find it",
                ),
            ),
            parts=(
                *findings_section(_found(optimum)),
                Part("The recommended finger", _finger(optimum)),
                Part("What was gained, and how much of it was chance", _gains(optimum)),
                Part("The front", _front(optimum)),
                Part("What each parameter does", _effects(optimum)),
                limits_section(_limits(optimum), optimum.notes),
                Part("All designs", _all_designs(optimum), is_detail=True),
                methods_part(_methods(optimum), optimum.provenance),
            ),
            command=command,
            origin=files_table(digests, version),
            summary=optimum.model_dump(mode="json", exclude={"provenance", "start", "design"}),
        )
    )


def front_rows(optimum: DesignOptimum) -> list[OptimisedDesign]:
    """Return the designs of the front and the chosen one, the best of the first objective first."""
    one = optimum.objectives[0]
    rows = [
        d for d in optimum.designs if d.number == optimum.chosen or (d.p_front is not None and d.p_front >= ON_FRONT)
    ]
    return sorted(rows, key=lambda row: row.values[one.name], reverse=one.larger_is_better)


def _gain(optimum: DesignOptimum, objective: DesignObjective, against: str) -> DesignGain:
    return next(gain for gain in optimum.gains if (gain.objective, gain.against) == (objective.name, against))


def _interval(gain: DesignGain) -> tuple[float, float, float]:
    """Return the gain that counts with its limits: the confirmed one, where there is one."""
    if gain.confirmed_rel is not None and gain.confirmed_95_rel is not None:
        return gain.confirmed_rel, *gain.confirmed_95_rel
    return gain.expected_rel, *gain.expected_95_rel


def _best_known(gain: DesignGain) -> str:
    return signed_percent(_interval(gain)[0])


def _how(gain: DesignGain) -> str:
    _, low, high = _interval(gain)
    how = "by the emulator" if gain.confirmed_rel is None else "with other seeds and contact places"
    return f"{signed_percent(low)} to {signed_percent(high)} (95 %), {how}; + is better"


def _judged(gain: DesignGain) -> tuple[Light, str]:
    """Return the light of a gain, and why."""
    _, low, high = _interval(gain)
    if gain.confirmed_rel is None:
        return "care", "not confirmed with other seeds"
    if low > 0.0:
        return "good", "the 95 % interval lies above zero"
    return ("bad", "really worse") if high < 0.0 else ("care", "no difference is shown")


def _sentence_case(text: str) -> str:
    """Return a text with its first letter large."""
    return text[:1].upper() + text[1:]


def _verdict(gain: DesignGain) -> str:
    """Say in few words what the search found."""
    value, low, high = _interval(gain)
    if low <= 0.0 <= high:
        return f"no real gain in {gain.objective}"
    return f"{gain.objective} {percent(abs(value))} {'better' if value > 0.0 else 'worse'} than the start"


def _screen_number(optimum: DesignOptimum) -> KeyNumber:
    """Return the number that tells what the emulator is worth: the gain against the best of the screening."""
    gain = _gain(optimum, optimum.objectives[0], "best of the screen")
    count = sum(row.role == "screen" for row in optimum.designs)
    light, reason = _judged(gain)
    return KeyNumber(
        f"Gain in {gain.objective} against the best of the screening", _best_known(gain),
        f"{_how(gain)}; a screen of {count} Sobol' points",
        "care" if light == "bad" else light, reason,
    )  # fmt: skip


def _found(optimum: DesignOptimum) -> Iterator[str]:
    """Yield what is to be noticed."""
    chosen = optimum.designs[optimum.chosen - 1].changes
    for one in optimum.parameters:
        share = (chosen[one.field] - one.low) / (one.high - one.low)
        if min(share, 1.0 - share) < _AT_LIMIT:
            yield (
                f"{one.field} ends at its limit ({chosen[one.field]:.4g}): the finger may be still better "
                "beyond it; widen the limit if it can be built."
            )
    failed = [row for row in optimum.designs if row.failure]
    if failed:
        first = "design could not be evaluated" if len(failed) == 1 else "designs could not be evaluated; the first"
        yield f"{len(failed)} {first}: {failed[0].failure}"
    for name, error in optimum.unexplained_rel.items():
        if error > _POOR:
            yield f"The emulator of {name} explains little (error at left-out designs {error:.2f} of their spread)."
    yield from _trades(optimum)


#: Left-out error over spread beyond which an emulator is said to explain little.
_POOR: Final = 0.7


def _trades(optimum: DesignOptimum) -> Iterator[str]:
    """Yield for each objective what the best design of the front in it has of the others, beside the chosen one."""
    if len(optimum.objectives) < 2:
        return
    chosen = optimum.designs[optimum.chosen - 1]
    for one in optimum.objectives:
        best = sorted(front_rows(optimum), key=lambda row: row.values[one.name], reverse=one.larger_is_better)[0]
        if best.number == chosen.number:
            yield f"The chosen finger is the best of the front in {one.name}."
            continue
        told = ", ".join(
            f"{o.name} {best.values[o.name]:.4g} instead of {chosen.values[o.name]:.4g}"
            + ("" if o.name in (*best.better_than_chosen, *best.worse_than_chosen) else " (no significant difference)")
            for o in optimum.objectives
        )
        yield f"Best in {one.name}: design {best.number}, with {told}."


def _finger(optimum: DesignOptimum) -> Content:
    """Show the numbers of the recommended finger beside those of the start."""
    chosen = optimum.designs[optimum.chosen - 1]
    rows = [
        (p.field, f"{p.start:.4g}", f"{chosen.changes[p.field]:.4g}", f"{p.low:.4g} to {p.high:.4g}")
        for p in optimum.parameters
    ]
    values = [
        (f"{o.name} ({o.unit})", f"{optimum.designs[0].values[o.name]:.4g}", f"{chosen.values[o.name]:.4g}",
         "larger is better" if o.larger_is_better else "smaller is better")
        for o in optimum.objectives
    ]  # fmt: skip
    return Content(
        "The design file beside this page is this finger; 'finray design export' writes its printed parts.",
        tables=(
            one_group("Numbers of the finger", ("parameter", "start", "recommended", "limits"), rows),
            one_group("As computed in the search", ("objective", "start", "recommended", ""), values),
        ),
    )


def _gains(optimum: DesignOptimum) -> Content:
    """Show each gain as seen, expected and confirmed."""
    rows = [
        (
            gain.objective,
            gain.against,
            signed_percent(gain.seen_rel),
            _percent_interval(gain.expected_rel, gain.expected_95_rel),
            "not done" if gain.confirmed_rel is None else _percent_interval(gain.confirmed_rel, gain.confirmed_95_rel),
            "" if gain.shrinkage_rel is None else signed_percent(gain.shrinkage_rel),
        )
        for gain in optimum.gains
    ]
    return Content(
        "Positive is better. All designs of the search share their random numbers; a gain that is due to them alone "
        "disappears with other seeds and contact places (shrinkage). The confirmed gain is the one to quote.",
        tables=(
            one_group(
                "Gains of the recommended finger (95 % intervals)",
                ("objective", "against", "seen", "by the emulator", "confirmed", "shrinkage"),
                rows,
            ),
        ),
        has_wide_tables=True,
    )


def _percent_interval(value: float, limits: tuple[float, float] | None) -> str:
    low, high = limits or (value, value)
    return interval_text(100.0 * value, 100.0 * low, 100.0 * high, "%")


def _front(optimum: DesignOptimum) -> Content:
    """Show the designs of the front in a table."""
    lead = (
        "Designs for which, with a probability of at least 1/2, no other within the limits is as good in every "
        f"objective and better by {percent(optimum.tolerance_rel)} in one. The last column names the objectives in "
        "which they differ from the recommended one (97.5 %, one-sided); everything else is within the noise."
    )
    return Content(lead, tables=(_designs_table(optimum, front_rows(optimum), "The front"),), has_wide_tables=True)


def _designs_table(optimum: DesignOptimum, rows: Sequence[OptimisedDesign], caption: str) -> ReportTable:
    fields, names = [p.field for p in optimum.parameters], [o.name for o in optimum.objectives]
    units = [f"{o.name} ({o.unit})" for o in optimum.objectives]
    cells = [
        (
            str(row.number),
            row.role,
            *(f"{row.changes[name]:.4g}" for name in fields),
            *(_value(row, name) for name in names),
            "" if row.p_front is None else probability(row.p_front),
            _difference(row, optimum.chosen),
        )
        for row in rows
    ]
    return one_group(caption, ("design", "role", *fields, *units, "p(front)", "against the recommended"), cells)


def _value(row: OptimisedDesign, name: str) -> str:
    if name not in row.values:
        return "failed"
    low, high = row.expected_95[name]
    return f"{row.values[name]:.4g} [{low:.4g}, {high:.4g}]"


def _difference(row: OptimisedDesign, chosen: int) -> str:
    """Say in what a design really differs from the chosen one."""
    if row.number == chosen:
        return "recommended"
    told = [f"{word} {', '.join(names)}" for word, names in
            (("better", row.better_than_chosen), ("worse", row.worse_than_chosen)) if names]  # fmt: skip
    return "; ".join(told) or row.failure or "no significant difference"


def _all_designs(optimum: DesignOptimum) -> Content:
    return Content(
        "In the order in which they were computed; in brackets the 95 % interval by the emulator.",
        tables=(_designs_table(optimum, optimum.designs, "All designs"),),
        has_wide_tables=True,
    )


def _front_picture(optimum: DesignOptimum) -> Picture:
    """Draw the designs in their first two objectives, or one objective in the order of the search."""
    names = [o.name for o in optimum.objectives]
    with styled():
        figure = new_figure(5.2, 4.2)
        axes = figure.add_subplot()
        x_name = names[0] if len(names) > 1 else None
        y = optimum.objectives[1] if len(names) > 1 else optimum.objectives[0]
        for role, (marker, colour, words) in _LOOKS.items():
            _points(axes, [d for d in optimum.designs if d.role == role and d.values], x_name, y.name,
                    (marker, colour, words))  # fmt: skip
        on_front = [d for d in optimum.designs if d.p_front is not None and d.p_front >= ON_FRONT]
        axes.plot([d.number if x_name is None else d.values[x_name] for d in on_front],
                  [d.values[y.name] for d in on_front], "o", ms=13, mfc="none", mec=CHANNELS[1][2], label="front",
                  zorder=1)  # fmt: skip
        axes.set_xlabel("design, in order" if x_name is None else _axis(optimum.objectives[0]))
        axes.set_ylabel(_axis(y))
        legend_above(figure, axes, 3)
        text = svg_text(figure)
    more = f" Of {len(names)} objectives the first two are drawn." if len(names) > 2 else ""
    return drawing(
        text,
        f"The designs of the search in {' and '.join(names[:2])}. {optimum.sentence}",
        "Each point is a design, with the 95 % interval of the emulator. What to see: whether the chosen one differs "
        f"from those of the screening by more than the intervals.{more}",
    )


def _axis(objective: DesignObjective) -> str:
    unit = "" if objective.unit == "1" else f" ({objective.unit})"
    return f"{objective.name}{unit}, {'larger' if objective.larger_is_better else 'smaller'} is better"


def _points(
    axes: Axes, rows: Sequence[OptimisedDesign], x_name: str | None, y_name: str, look: tuple[str, str, str]
) -> None:
    """Draw designs of one role with their intervals."""
    marker, colour, words = look
    size = 12 if marker == "*" else 5
    x = [float(row.number) if x_name is None else row.values[x_name] for row in rows]
    y = [row.values[y_name] for row in rows]
    errors = [
        None if name is None else [
            [max(row.values[name] - row.expected_95[name][0], 0.0) for row in rows],
            [max(row.expected_95[name][1] - row.values[name], 0.0) for row in rows],
        ]
        for name in (x_name, y_name)
    ]  # fmt: skip
    axes.errorbar(x, y, yerr=errors[1], xerr=errors[0], fmt=marker, ms=size, color=colour, elinewidth=0.7,
                  capsize=0, label=words)  # fmt: skip


def _effects(optimum: DesignOptimum) -> Content:
    """Draw how each objective goes with each parameter."""
    count = len(optimum.parameters)
    columns = min(count, _PANELS_IN_A_ROW)
    rows = -(-count // columns)
    pictures = []
    for objective in optimum.objectives:
        effects = [e for e in optimum.effects if e.objective == objective.name]
        if not effects:
            continue
        with styled():
            figure = new_figure(max(2.3 * columns, 4.6), 2.2 * rows)
            bottom, top = min(min(e.low95) for e in effects), max(max(e.high95) for e in effects)
            for k, effect in enumerate(effects):
                axes = figure.add_subplot(rows, columns, k + 1)
                axes.fill_between(effect.at, effect.low95, effect.high95, color=CHANNELS[2][2], alpha=0.25, linewidth=0)
                axes.plot(effect.at, effect.mean, color=CHANNELS[2][2])
                at = optimum.designs[optimum.chosen - 1].changes[effect.parameter]
                axes.axvline(at, color=CHANNELS[0][2], linestyle="--", linewidth=1)
                axes.set_ylim(bottom, top)
                axes.set_xlabel(effect.parameter, fontsize=8)
                if k % columns == 0:
                    axes.set_ylabel(_unit_axis(objective), fontsize=8)
            text = svg_text(figure)
        told = _widest(optimum, objective)
        pictures.append(drawing(text, f"{objective.name} over each parameter. {told}",
                                f"{objective.name}: {told} Dashed: the recommended finger."))  # fmt: skip
    lead = (
        "Mean over all other parameters within their limits, by the emulator, with its 95 % band. A parameter whose "
        "curve is flat may still matter in combination with another one."
    )
    return Content(lead, tuple((picture,) for picture in pictures))


def _unit_axis(objective: DesignObjective) -> str:
    return objective.name if objective.unit == "1" else f"{objective.name} ({objective.unit})"


def _widest(optimum: DesignOptimum, objective: DesignObjective) -> str:
    """Say which parameter moves an objective most on its own."""
    effects = [e for e in optimum.effects if e.objective == objective.name]
    spans = {e.parameter: (max(e.mean) - min(e.mean)) / max(min(e.mean), 1e-12) for e in effects}
    name = max(spans, key=lambda one: spans[one])
    return f"{name} changes it most on its own, by {percent(spans[name])} from least to greatest."


def _limits(optimum: DesignOptimum) -> tuple[str, ...]:
    """Say what the numbers do not know."""
    return (
        "All numbers are simulated. How far the simulation is from a real finger is shared by all designs and not in "
        "the intervals; a gain holds on the bench only as far as the simulation ranks designs correctly.",
        "The bound on the gain that is still possible comes from the emulator, which assumes smooth numbers within "
        "the limits. A narrow optimum between the computed designs would not be seen.",
        "A panel is modelled as a sheet without thickness: its housing and wires may need more room than the model "
        "shows. The camera's exposure is set again for each design.",
        "When the finger was chosen, 1 % of one objective counted as much as 1 % of another; the front shows the "
        "alternatives.",
    )[: 4 if len(optimum.objectives) > 1 else 3]


def _methods(optimum: DesignOptimum) -> tuple[str, ...]:
    screen = sum(row.role == "screen" for row in optimum.designs)
    search = sum(row.role == "search" for row in optimum.designs)
    meanings = "; ".join(f"{o.name}: {o.meaning}" for o in optimum.objectives)
    return (
        f"{screen} designs of a scrambled Sobol' sequence were computed, then {search} one by one where the knowledge "
        "gradient of Gaussian processes (Frazier et al., 2009; Rasmussen and Williams, 2006) was largest. Each "
        "objective's logarithm had a process of its own with one length for each parameter and a fitted noise; "
        "intervals include the uncertainty of these. The recommended design has the best expected value, which is "
        "not the "
        f"best value seen. Objectives are: {meanings}.",
    )


def light_powers_page(record: LightPowers, command: str, digests: Mapping[str, str]) -> str:
    """Return the page of the most even powers of a sensor's lights (HTML); equal input gives equal text.

    Parameters
    ----------
    record
        The powers.
    command
        That made it.
    digests
        Input file -> SHA-256.
    """
    gain, error = record.gain_rel, record.normal_error
    is_worse = error is not None and error.low95_rel > 0.0
    light: Light = "care" if is_worse or gain.low95 <= 0.0 else "good"
    reason = (
        "the error of the normal grows" if is_worse else "95 % interval above zero" if light == "good" else "no gain"
    )
    parts = [Part("The powers", _powers_content(record))]
    if record.design is not None:
        parts.append(Part("The finger and its lights", _side_content(record)))
    if record.map is not None:
        parts.append(Part("Over two numbers of the finger", _map_content(record.map)))
    return report_html(
        ReportPage(
            verb="finray design lights",
            title=record.name,
            lead=(
                    "The light of all sources adds up. So each is traced only once, and the powers that light the coat "
                    "most evenly are computed from that."
                ),
            verdict=f"{percent(max(gain.estimate, 0.0))} less uneven" if light == "good" else "No gain is certain"
            if gain.low95 <= 0.0 else "More even, but the sensed normal is worse",
            light=light,
            sentence=record.sentence,
            picture=drawing(
                lit_pad_figure(record), "the pad with its lights, now and with the recommended powers",
                "The pad from its inner side, with the lights and their powers. Dots are the brightness of the coat "
                "relative to its mean at rest, triangles that of touches; a good picture has one colour.",
            ),
            key_numbers=(
                KeyNumber("Variation over the pad", percent(record.variation_rel.estimate),
                          f"now {percent(record.variation_now_rel.estimate)}; {_less(record)}", light, reason),
                KeyNumber("Brightness", f"{record.brightness_rel:.2f}", "times that of now"),
                *_error_number(record),
            ),
            parts=(*parts, limits_section([_sentence_case(f"{note}.") for note in record.notes])),
            command=command,
            origin=files_table(digests, package_version()),
            summary=record.model_dump(
                mode="json",
                exclude={"provenance", "design", "sensor", "basis", "basis_u", "power_draws", "places_mm", "map"},
            ),
        )
    )  # fmt: skip


def _less(record: LightPowers) -> str:
    """Say by how much the variation falls."""
    gain = record.gain_rel
    return f"{percent(gain.low95)} to {percent(gain.high95)} less (95 %)"


def _error_number(record: LightPowers) -> Iterator[KeyNumber]:
    """Yield what happens to the error of the normal, where it is evaluated."""
    error = record.normal_error
    if error is not None:
        yield KeyNumber(
            "Expected error of the sensed normal", f"{error.recommended_deg:.2f} deg",
            f"now {error.now_deg:.2f} deg; change {signed_percent(error.low95_rel)} to "
            f"{signed_percent(error.high95_rel)} (95 %, from the same draws)",
            "good" if error.high95_rel < 0.0 else "bad" if error.low95_rel > 0.0 else "care",
            "falls" if error.high95_rel < 0.0 else "grows" if error.low95_rel > 0.0 else "no difference is shown",
        )  # fmt: skip


def _powers_content(record: LightPowers) -> Content:
    """List the powers, and say how it is known that there are none better."""
    rows = [
        (row.light, row.field, f"{row.now_rel:.3g}", f"{row.power_rel:.3g}",
         f"{row.optimum_rel.low95:.3g} to {row.optimum_rel.high95:.3g}", f"{row.least_rel:.3g} to {row.most_rel:.3g}",
         percent(row.share_now))
        for row in record.rows
    ]  # fmt: skip
    columns = (
        "light",
        "field of the design",
        "now",
        "recommended",
        "optimum, 95 %",
        "allowed",
        "share of the light now",
    )
    return Content(
        f"The design file beside this page has these powers. By this computation no powers within the limits light the "
        f"coat more evenly by a share larger than {max(record.gap_rel, 1e-12):.0e} (bound by the gradient). All lights "
        f"together emit at most {record.total_rel:.3g} times what they do now.",
        tables=(one_group("Powers (radiance along the normal, relative)", columns, rows),),
        has_wide_tables=True,
    )


def _side_content(record: LightPowers) -> Content:
    """Show the finger from its side."""
    return Content(
        "The finger cut along its middle; a panel's angle is that of its normal (arrow) from the plane of the pad.",
        picture_rows=((drawing(lights_from_the_side(record), "the finger from its side with its lights",
                               "Panels with their normals and recommended powers."),),),
    )  # fmt: skip


def _map_content(found: LightPlaceMap) -> Content:
    """Show a map."""
    return Content(
        light_map_sentence(found),
        picture_rows=((drawing(light_map_figure(found), "error of the normal, evenness and brightness, for two numbers",
                               "Star: least error of the sensed normal. Dots: not distinguishable (two "
                               "standard uncertainties). White: cannot be built. Everything else is as in "
                               "the design, with the present powers."),),),
    )  # fmt: skip
