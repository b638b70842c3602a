"""What each input adds to an uncertainty, as bars."""

from collections.abc import Callable

from data_schemas.compare import InputUncertainty
from finray_calib.reports.style import BLUE, INK, ORANGE, new_figure, styled, svg_text

_LOOK = {"A": ("from repeated observations (A)", BLUE, ""), "B": ("from other knowledge (B)", ORANGE, "///")}
_LINE_LENGTH = 24


@styled()
def budget_figure(bars: list[tuple[InputUncertainty, float]], text: Callable[[float], str], label: str) -> str:
    """Draw one bar for each input, the longest on top, with its value written at its end.

    Parameters
    ----------
    bars
        Inputs and the standard uncertainty that each makes alone.
    text
        How a value is written.
    label
        What the values are, with their unit.
    """
    ranked = sorted(bars, key=lambda bar: bar[1])
    top = max((value for _, value in ranked), default=0.0) or 1.0
    figure = new_figure(5.6, 0.46 * len(ranked) + 1.2)
    axes = figure.subplots()
    seen: set[str] = set()
    for place, (line, value) in enumerate(ranked):
        name, colour, hatch = _LOOK[line.evaluation]
        named = None if line.evaluation in seen else name
        seen.add(line.evaluation)
        axes.barh(place, value, height=0.6, color=colour, edgecolor=INK, hatch=hatch, linewidth=0.6, label=named)
        axes.text(value + 0.015 * top, place, text(value), va="center", fontsize=9)
    axes.set_yticks(range(len(ranked)), [_wrapped(line.input) for line, _ in ranked])
    axes.set(xlim=(0.0, 1.25 * top), xlabel=label)
    axes.locator_params(axis="x", nbins=5)
    axes.grid(visible=False, axis="y")
    figure.legend(loc="outside upper left", ncols=2, columnspacing=1.2)
    return svg_text(figure)


def _wrapped(name: str) -> str:
    """Return a name in at most two lines that leave room for the bars; a dollar sign is no mathematics here."""
    lines = [""]
    for word in name.split():
        longer = f"{lines[-1]} {word}".strip()
        if len(longer) <= _LINE_LENGTH or not lines[-1]:
            lines[-1] = longer
        else:
            lines.append(word)
    if len(lines) > 2:
        lines = [lines[0], f"{lines[1]}\N{HORIZONTAL ELLIPSIS}"]
    return "\n".join(line[: _LINE_LENGTH + 1] for line in lines).replace("$", r"\$")
