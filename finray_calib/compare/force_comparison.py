"""Compare a measured force over displacement with a simulated press: error, its uncertainty, validation statement."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.compare import Interval
from data_schemas.errors import CompareError
from data_schemas.force_comparison import (
    FirstTouch,
    ForceComparison,
    ForceEstimate,
    ForceInput,
    ForcePoint,
    ForceRow,
    ForceThird,
)
from data_schemas.press_mechanics import PressMechanics
from finray_calib.compare.error_size import error_size
from finray_calib.compare.first_touch import check_reach, first_touch_weight, fitted_first_touch_mm
from finray_calib.compare.force_curve import ForceCurve
from finray_calib.compare.force_inputs import ForceInputs, force_inputs
from finray_calib.compare.force_mesh_error import MeshError, mesh_error
from finray_calib.compare.measured_force import MeasuredForce
from finray_calib.compare.withheld_force_verdicts import without_verdicts

Floats = NDArray[np.float64]
Candidate = Literal["do nothing", "simulation"]

DRAWS = 2000
COVERAGE_FACTOR = 2.0
_PERCENTILES = (2.5, 97.5)
_FIT_MISSES = "first touch: a curve of another shape than the model's moves it by more than its interval says"
_ALWAYS_MISSING = (
    "Poisson ratios, friction, pose and radius of the indenter, dimensions of the skeleton other than thicknesses",
    "rate, creep and softening of the rubbers (the simulation is elastic)",
    "what all points of a measurement share: gain of the force sensor, compliance of the machine",
)


@dataclass(frozen=True, slots=True)
class _Deviations:
    """What the simulated (or measured) force may be off by at the points, as draws (k, n) of three kinds."""

    numerical: Floats
    inputs: Floats
    data: Floats

    @property
    def total(self) -> Floats:
        """All of them."""
        return self.numerical + self.inputs + self.data

    def refitted(self, pull: Floats, slope: Floats) -> "_Deviations":
        """Return what is left of each once the first touch, which e moves by pull'e, is fitted again."""
        return _Deviations(*(d - np.outer(d @ pull, slope) for d in (self.numerical, self.inputs, self.data)))


def compare_force(
    press: PressMechanics,
    measured: MeasuredForce,
    rng: np.random.Generator,
    fit_first_touch: bool = True,
    other_mesh: PressMechanics | None = None,
) -> ForceComparison:
    """Compare a press with a measured loading curve.

    Error E = F(d - offset) - measured, with the one offset that minimises E' W E; W is the inverse of the covariance
    that the uncertain inputs and the measurement's noise give E. Validation uncertainty u_val^2 = u_num^2 + u_input^2 +
    u_D^2, by draws in which the offset is fitted again (to first order).

    Intervals and verdicts are withheld where neither the design's inputs nor the measurement have an uncertainty.

    Parameters
    ----------
    press
        Simulated; with sensitivities its design's uncertainty is carried.
    measured
        Points of the loading curve.
    rng
        Of the draws.
    fit_first_touch
        Whether the displacement of first touch is fitted; otherwise displacements count from it.
    other_mesh
        The same press on another mesh; their difference is the standard uncertainty of the mesh where it is more than
        what the mesh is known to be off by on the 70 x 35 finger.

    Raises
    ------
    CompareError
        When the press has no curve or is not deep enough, numbers seem to be in another unit, or the other mesh is
        that of another design.

    References
    ----------
    ASME V&V 20-2009, sections 1 and 6.
    """
    curve = ForceCurve(press.name, press.depth_mm, press.force_n[:, 1])
    measured.check_units(float(curve.depth_mm[-1]), float(curve.force_n.max()))
    mesh = mesh_error(press, other_mesh)
    weight = first_touch_weight(curve, measured, force_inputs(press, measured.displacement_mm))
    offset = fitted_first_touch_mm(curve, measured, weight) if fit_first_touch else 0.0
    check_reach(curve, measured, offset)
    depth = measured.displacement_mm - offset
    inputs = force_inputs(press, depth)
    free = _deviations(curve, mesh, measured, inputs, depth, rng)
    slope = curve.slope_at(depth)
    pull = weight @ slope / (slope @ weight @ slope)
    refitted = free.refitted(pull, slope) if fit_first_touch else free
    error = curve.at(depth) - measured.force_n
    simulated = curve.at(depth) + free.inputs + free.numerical
    comparison = ForceComparison(
        simulated=press.name,
        label=press.label,
        measured=measured.name,
        points=tuple(_points(measured, depth, curve.at(depth), simulated, error, refitted)),
        rows=tuple(_rows(measured, error, refitted, free.data)),
        first_touch=_first_touch(offset, free.total @ pull) if fit_first_touch else None,
        thirds=tuple(_thirds(measured, error, refitted)),
        budget=_budget(curve, inputs, free, depth, mesh.source),
        draws=DRAWS,
        not_included=(
            *inputs.missing,
            *(("the mesh: give the same press on another mesh (--other-mesh)",) if not mesh.source else ()),
            *(("the measurement: its CSV states no uncertainty",) if not free.data.any() else ()),
            *((_FIT_MISSES,) if fit_first_touch else ()),
            *_ALWAYS_MISSING,
        ),
    )
    # numerics alone say nothing of how far finger and measurement may be off
    return comparison if inputs.names or free.data.any() else without_verdicts(comparison)


def _deviations(
    curve: ForceCurve,
    mesh: MeshError,
    measured: MeasuredForce,
    inputs: ForceInputs,
    depth: Floats,
    rng: np.random.Generator,
) -> _Deviations:
    """Draw what is uncertain at the points; numerical errors are taken as shared by all of them."""
    force, count = curve.at(depth), len(depth)
    numerical = np.outer(rng.standard_normal(DRAWS), curve.interpolation_error(depth))
    if mesh.source:
        numerical += np.outer(rng.standard_normal(DRAWS), mesh.at(depth, force))
    return _Deviations(
        numerical=numerical,
        inputs=force * (inputs.draw_ratios(DRAWS, rng) - 1.0),
        data=np.sqrt(measured.variance_n2(curve.slope_at(depth))) * rng.standard_normal((DRAWS, count)),
    )


def _points(
    measured: MeasuredForce, depth: Floats, force: Floats, simulated: Floats, error: Floats, deviations: _Deviations
) -> Iterator[ForcePoint]:
    """Yield the points in the order of the measurement."""
    low, high = np.percentile(simulated, _PERCENTILES, axis=0)
    spread = [d.std(axis=0) for d in (deviations.numerical, deviations.inputs, deviations.data)]
    for i in range(len(depth)):
        u_numerical, u_input, u_data = (float(u[i]) for u in spread)
        u_validation = float(np.sqrt(u_numerical**2 + u_input**2 + u_data**2))
        yield ForcePoint(
            displacement_mm=float(measured.displacement_mm[i]),
            depth_mm=float(depth[i]),
            force_n=float(measured.force_n[i]),
            simulated_n=ForceEstimate(estimate=float(force[i]), low95=float(low[i]), high95=float(high[i])),
            error_n=float(error[i]),
            u_numerical_n=u_numerical,
            u_input_n=u_input,
            u_data_n=u_data,
            u_validation_n=u_validation,
            within=bool(abs(error[i]) <= COVERAGE_FACTOR * u_validation),
        )


def _thirds(measured: MeasuredForce, error: Floats, deviations: _Deviations) -> Iterator[ForceThird]:
    """Yield the mean error over each third of the displacement that has points."""
    ends = np.linspace(measured.displacement_mm.min(), measured.displacement_mm.max(), 4)
    third = np.clip(np.searchsorted(ends, measured.displacement_mm, side="right") - 1, 0, 2)
    for k in range(3):
        own = third == k
        if not own.any():
            continue
        spread = (deviations.numerical, deviations.inputs, deviations.data)
        u_numerical, u_input, u_data = (float(d[:, own].mean(axis=1).std()) for d in spread)
        u_validation = float(np.sqrt(u_numerical**2 + u_input**2 + u_data**2))
        mean = float(error[own].mean())
        yield ForceThird(
            from_mm=float(ends[k]),
            to_mm=float(ends[k + 1]),
            points=int(own.sum()),
            force_n=float(measured.force_n[own].mean()),
            error_n=mean,
            u_numerical_n=u_numerical,
            u_input_n=u_input,
            u_data_n=u_data,
            u_validation_n=u_validation,
            within=abs(mean) <= COVERAGE_FACTOR * u_validation,
        )


def _rows(measured: MeasuredForce, error: Floats, deviations: _Deviations, noise: Floats) -> Iterator[ForceRow]:
    """Yield the rows of the table: sizes of errors over that of the measured force, noise taken out of both."""
    force, none = measured.force_n, np.zeros_like(noise)
    size = error_size(force, none, noise).estimate
    if size == 0.0:
        raise CompareError(f"{measured.name}: the measured force does not stand out from its uncertainty")
    sizes: tuple[tuple[Candidate, Interval], ...] = (
        ("do nothing", error_size(-force, none, noise)),
        ("simulation", error_size(error, deviations.numerical + deviations.inputs, deviations.data)),
    )
    for candidate, found in sizes:
        rms = {name: value / size for name, value in found.model_dump().items()}
        yield ForceRow(candidate=candidate, rms_rel=ForceEstimate(**rms))


def _first_touch(offset_mm: float, moved_mm: Floats) -> FirstTouch:
    """Return the fitted first touch with what the deviations move it by."""
    low, high = offset_mm + np.percentile(moved_mm, _PERCENTILES)
    return FirstTouch(
        offset_mm=ForceEstimate(estimate=offset_mm, low95=float(low), high95=float(high)), u_mm=float(moved_mm.std())
    )


def _budget(
    curve: ForceCurve, inputs: ForceInputs, deviations: _Deviations, depth: Floats, mesh: str
) -> tuple[ForceInput, ...]:
    """Return what each input does alone at the deepest point, the largest first."""
    deepest = int(np.argmax(depth))
    force_n = float(curve.at(depth[deepest]))
    effects = inputs.ln_force_per_ln_input[:, deepest]
    lines = [
        ForceInput(
            input=name,
            evaluation="B",
            source=source,
            u_rel=float(u),
            ln_force_per_ln_input=float(effect),
            force_u_rel=float(abs(effect) * u),
        )
        for name, source, u, effect in zip(inputs.names, inputs.sources, inputs.u_rel, effects, strict=True)
    ]
    others = (
        ("numerics", "; ".join(["two curves through the increments differ", *([mesh] if mesh else [])]), "numerical"),
        ("measurement", "as its CSV states", "data"),
    )
    for name, source, kind in others:
        u_rel = float(getattr(deviations, kind)[:, deepest].std()) / force_n
        lines.append(
            ForceInput(
                input=name, evaluation="B", source=source, u_rel=None, ln_force_per_ln_input=None, force_u_rel=u_rel
            )
        )
    return tuple(sorted(lines, key=lambda line: -line.force_u_rel))
