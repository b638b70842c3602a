"""A force comparison that knows no uncertainty: its errors without intervals and without verdicts."""

from data_schemas.force_comparison import FirstTouch, ForceComparison, ForceEstimate

UNKNOWN_UNCERTAINTY = (
    "intervals and verdicts: the design's inputs have no sensitivities and the CSV states no uncertainty, so that "
    "u_val holds the numerics at most. Simulate with --only mechanics --sensitivities, and give the columns "
    "force_uncertainty_n and displacement_uncertainty_mm"
)


def without_verdicts(comparison: ForceComparison) -> ForceComparison:
    """Return a comparison whose intervals and verdicts are withheld, with the reason."""
    touch = comparison.first_touch
    return comparison.model_copy(
        update={
            "points": tuple(
                point.model_copy(update={"simulated_n": _alone(point.simulated_n), "within": None})
                for point in comparison.points
            ),
            "rows": tuple(row.model_copy(update={"rms_rel": _alone(row.rms_rel)}) for row in comparison.rows),
            "first_touch": None if touch is None else FirstTouch(offset_mm=_alone(touch.offset_mm), u_mm=touch.u_mm),
            "thirds": tuple(third.model_copy(update={"within": None}) for third in comparison.thirds),
            "withheld": UNKNOWN_UNCERTAINTY,
        }
    )


def _alone(value: ForceEstimate) -> ForceEstimate:
    """Return an estimate without its ends."""
    return ForceEstimate(estimate=value.estimate, low95=None, high95=None)
