"""A force comparison as a plain text table for the terminal."""

from collections.abc import Iterator
from textwrap import wrap

from data_schemas.force_comparison import ForceComparison, ForceEstimate, ForceThird

_LARGEST_INPUTS = 6
_WIDTH_COLUMNS = 120


def force_lines(comparison: ForceComparison) -> str:
    """Return the rows, the validation statement by thirds, and the budget, at most 120 columns wide."""
    return "\n".join(_lines(comparison)) + "\n"


def _lines(comparison: ForceComparison) -> Iterator[str]:
    """Yield the lines."""
    yield f"{comparison.simulated} against {comparison.measured}, {len(comparison.points)} points"
    yield comparison.label
    yield ""
    yield f"{'':<12}relative RMS" + ("" if comparison.withheld else " [95 % of the model's own error]")
    for row in comparison.rows:
        rms = row.rms_rel
        yield f"{row.candidate:<12}{rms.estimate:8.1%}" + _interval(rms, ".1%", "  ")
    if comparison.first_touch is None:
        yield "first touch: displacements count from it, nothing fitted"
    else:
        offset = comparison.first_touch.offset_mm
        known = "" if comparison.withheld else f", u = {comparison.first_touch.u_mm:.3f} mm"
        yield f"first touch: fitted at {offset.estimate:.3f} mm{_interval(offset, '.3f', ' ')}{known}"
    yield ""
    yield f"{'displacement mm':<18}{'force N':>9}{'error N':>9}{'u_num':>8}{'u_input':>8}{'u_D':>8}{'u_val':>8}"
    yield from map(_third, comparison.thirds)
    yield ""
    yield "largest contributions to the simulated force at the deepest point:"
    for line in comparison.budget[:_LARGEST_INPUTS]:
        effect = (
            ""
            if line.u_rel is None
            else f"; input {line.u_rel:.1%}, d ln F / d ln x = {line.ln_force_per_ln_input:+.2f}"
        )
        yield f"  {line.force_u_rel:6.1%}  {line.input} ({line.source}{effect})"
    yield ""
    if comparison.withheld:
        yield from wrap(f"withheld: {comparison.withheld}", _WIDTH_COLUMNS, subsequent_indent="  ")
    for missing in comparison.not_included:
        yield f"not included: {missing}"


def _interval(value: ForceEstimate, form: str, before: str) -> str:
    """Return the ends of an interval in brackets; nothing where they are withheld."""
    if value.low95 is None or value.high95 is None:
        return ""
    return f"{before}[{value.low95:{form}}, {value.high95:{form}}]"


def _third(third: ForceThird) -> str:
    """Return the line of a third."""
    place = f"{third.from_mm:.3g} to {third.to_mm:.3g}"
    uncertainties = (third.u_numerical_n, third.u_input_n, third.u_data_n, third.u_validation_n)
    said = "verdict withheld"
    if third.within is not None:
        said = "within 2 u_val" if third.within else "the model is off by more than 2 u_val"
    return (
        f"{place:<18}{third.force_n:9.3f}{third.error_n:+9.3f}"
        + "".join(f"{u:8.3f}" for u in uncertainties)
        + f"  {said}"
    )
