"""Compare a measured force over displacement with a simulated press: error, its uncertainty, validation statement.

The one nuisance is the displacement at which the indenter first touches. Where no uncertainty is known, errors are
given without intervals and verdicts.

The error of the simulated force comes from uncertain inputs of the design and from the mesh. Constants and dimensions
have the uncertainty that the design states, or a named default; the mesh's share is known from the 70 x 35 finger's
convergence, or from another mesh.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from data_schemas import (
    CompareError,
    FirstTouch,
    ForceComparison,
    ForceEstimate,
    ForceInput,
    ForcePoint,
    ForceRow,
    ForceSlope,
    ForceThird,
    Interval,
    PressMechanics,
    VariedPress,
)
from finray_calib.force._force_curves import ForceCurve, MeasuredForce, input_uncertainty, log_sensitivity

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ForceInputs:
    """Uncertain inputs of a force, log-normal and independent, each with its effect on ln F.

    Attributes
    ----------
    names, sources
        Field of the design, and in words where its uncertainty is from.
    u_rel
        Standard uncertainties over the values, (i,).
    ln_force_per_ln_input
        d ln F / d ln x at the points, (i, n).
    missing
        What has no sensitivity although it is uncertain, in words.
    """

    names: tuple[str, ...]
    sources: tuple[str, ...]
    u_rel: Floats
    ln_force_per_ln_input: Floats
    missing: tuple[str, ...]

    def draw_ratios(self, draws: int, rng: np.random.Generator) -> Floats:
        """Return draws of the force over that of the design as it is, (draws, n).

        ln F moves by the sum of sensitivities times ln x / x0; ln x is normal with variance ln(1 + u_rel^2).
        """
        u_ln = np.sqrt(np.log1p(self.u_rel**2))
        deviations = u_ln * rng.standard_normal((draws, len(self.names)))
        return np.exp(deviations @ self.ln_force_per_ln_input)


def force_inputs(press: PressMechanics, depth_mm: Floats) -> ForceInputs:
    """Return the uncertain inputs of a press at pushes (n,): those whose effect the press holds."""
    again = press.sensitivities
    varied = again.varied if again is not None else ()
    known: list[ForceSlope | VariedPress] = list(again.slopes if again is not None else ())
    known += [v for v in varied if len(v.depth_mm) > 1]
    effects = [log_sensitivity(again, v, depth_mm) for v in known] if again is not None else []
    stated = set(press.design.uncertainty_rel) - {v.field for v in known} - {v.field for v in varied}
    uncertain = [input_uncertainty(press.design, v.field) for v in known]
    return ForceInputs(
        names=tuple(v.field for v in known),
        sources=tuple(source for _, source in uncertain),
        u_rel=np.array([u for u, _ in uncertain]),
        ln_force_per_ln_input=np.array(effects).reshape(len(known), len(depth_mm)),
        missing=(
            *(f"{v.field}: its press failed ({v.failure})" for v in varied if len(v.depth_mm) < 2),
            *(
                f"{field}: the design states its uncertainty, but the press does not store its effect"
                for field in sorted(stated)
            ),
            *(f"the parameters of {part}, whose uncertainty is not known" for part in press.design.packaged_parts()),
            *(() if known or varied else ("materials and dimensions: 'finray simulate press --sensitivities'",)),
        ),
    )


@dataclass(frozen=True, slots=True)
class MeshError:
    """The error that the mesh may cause in a force.

    Attributes
    ----------
    excess_rel
        By how much the force exceeds that of an infinitely fine mesh.
    other
        Curve of another mesh, if there is one.
    source
        In words where it is known from; empty where nothing is known.
    """

    excess_rel: float
    other: ForceCurve | None
    source: str

    def at(self, depth: Floats, force: Floats) -> Floats:
        """Return the standard uncertainty, N, at pushes (n,) with the force that the press has there."""
        known = self.excess_rel / (1.0 + self.excess_rel) * force
        return known if self.other is None else np.maximum(known, np.abs(self.other.at(depth) - force))


def mesh_error(press: PressMechanics, other: PressMechanics | None) -> MeshError:
    """Return what is known of the error of a press's mesh, taken for its standard uncertainty.

    F e / (1 + e) with the force F and the excess e of the press's preset on the 70 x 35 finger; |F' - F| where the
    force F' on another mesh differs by more.

    Raises
    ------
    CompareError
        When the other press is of another design, or on the same preset.
    """
    sources = [] if press.mesh_excess_rel is None else ["excess force of the mesh, as found on the 70 x 35 finger"]
    curve = None if other is None else _curve_on_other_mesh(press, other)
    if curve is not None:
        sources.append("difference from the press on the other mesh")
    return MeshError(press.mesh_excess_rel or 0.0, curve, " or ".join(sources))


def _curve_on_other_mesh(press: PressMechanics, other: PressMechanics) -> ForceCurve:
    """Return the curve of the same finger on another mesh."""
    own = press.design.model_dump(exclude={"mesh", "provenance", "uncertainty_rel"})
    if own != other.design.model_dump(exclude={"mesh", "provenance", "uncertainty_rel"}):
        raise CompareError(
            f"{other.name}: is a press of another design; give a press of the same design on another mesh"
        )
    if other.preset == press.preset:
        raise CompareError(f"{other.name}: is also on the {other.preset} mesh; give a press on another mesh")
    return ForceCurve(other.name, other.depth_mm, other.force_n[:, 1])


Candidate = Literal["do nothing", "simulation"]

DRAWS = 2000
COVERAGE_FACTOR = 2.0
_PERCENTILES = (2.5, 97.5)
_FIT_MISSES = "first touch: its interval assumes that the measured curve has the model's shape"
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
    if press.motion is not None:
        raise CompareError(
            f"{press.name}: the indenter moved along a path, but a loading curve can be compared only with a press "
            "along the pad's normal; press again without a path of the indenter"
        )
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
            *(("the mesh: give the same press on another mesh (option 'other-mesh')",) if not mesh.source else ()),
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
        raise CompareError(f"{measured.name}: the measured force is not larger than its uncertainty")
    sizes: tuple[tuple[Candidate, Interval], ...] = (
        ("do nothing", error_size(-force, none, noise)),
        # a deviation leads to the force of the true inputs, and s = E - m back from it: F / x is never negative
        ("simulation", error_size(error, -(deviations.numerical + deviations.inputs), deviations.data)),
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
        (
            "numerics",
            "; ".join(["difference of two curves through the increments", *([mesh] if mesh else [])]),
            "numerical",
        ),
        ("measurement", "as the CSV file states", "data"),
    )
    for name, source, kind in others:
        u_rel = float(getattr(deviations, kind)[:, deepest].std()) / force_n
        lines.append(
            ForceInput(
                input=name, evaluation="B", source=source, u_rel=None, ln_force_per_ln_input=None, force_u_rel=u_rel
            )
        )
    return tuple(sorted(lines, key=lambda line: -line.force_u_rel))


# of the largest force: no finite-element press is better
_MODEL_ERROR_REL = 0.01
_TRIES = 201
# of the press's depth: far below what any bench reads
_TOLERANCE = 1e-7


def first_touch_weight(curve: ForceCurve, measured: MeasuredForce, inputs: ForceInputs) -> Floats:
    """Return the inverse covariance (n, n) of simulated minus measured force, in 1/N^2, for a fit of first touch.

    What the inputs do is shared by the points, so that a force that is off by a factor does not move first touch; what
    the measurement states is not. A model that is off by a hundredth of the largest force is allowed for everywhere.

    Parameters
    ----------
    inputs
        At the measured displacements.
    """
    effects = measured.force_n * inputs.ln_force_per_ln_input * inputs.u_rel[:, None]
    slope = curve.slope_at(np.clip(measured.displacement_mm, 0.0, curve.reach_mm))
    own = measured.variance_n2(slope) + (_MODEL_ERROR_REL * measured.force_n.max()) ** 2
    return np.asarray(np.linalg.inv(effects.T @ effects + np.diag(own)), dtype=np.float64)


def fitted_first_touch_mm(curve: ForceCurve, measured: MeasuredForce, weight: Floats) -> float:
    """Return the displacement of first touch that minimises e' W e, with e = F(d - offset) - measured.

    A grid over the offsets with which every point lies within the curve's reach and half of them beyond first touch;
    then Brent's method between the neighbours of its best.

    Raises
    ------
    CompareError
        When the best offset would need a deeper press.
    """
    tolerance_mm = _TOLERANCE * curve.reach_mm
    most = float(measured.displacement_mm.max())
    shallowest, deepest = most - curve.reach_mm, float(np.median(measured.displacement_mm))
    if deepest <= shallowest:
        raise CompareError(_deeper(measured.name, most, curve))

    def misfits(offsets_mm: Floats) -> Floats:
        errors = curve.at(measured.displacement_mm - offsets_mm[:, None]) - measured.force_n
        return np.asarray(np.einsum("ki,ij,kj->k", errors, weight, errors, optimize=True))

    offsets = np.linspace(shallowest, deepest, _TRIES)
    best = int(np.argmin(misfits(offsets)))
    low, high = offsets[max(best - 1, 0)], offsets[min(best + 1, _TRIES - 1)]
    found = minimize_scalar(
        lambda offset_mm: float(misfits(np.array([offset_mm]))[0]),
        bounds=(low, high),
        method="bounded",
        options={"xatol": tolerance_mm},
    )
    # the bounded search stays inside its ends by a few tolerances
    if found.x - shallowest < 10.0 * tolerance_mm:
        raise CompareError(_deeper(measured.name, curve.reach_mm, curve))
    return float(found.x)


def check_reach(curve: ForceCurve, measured: MeasuredForce, offset_mm: float) -> None:
    """Refuse points deeper than the press, or all of them above the pad.

    Raises
    ------
    CompareError
        When a point lies deeper, or none lies beyond first touch.
    """
    deepest = float(measured.displacement_mm.max()) - offset_mm
    if deepest <= 0.0:
        raise CompareError(
            f"{measured.name}: no point lies beyond first touch at 0 mm; leave out "
            f"--known-first-touch, so that first touch is fitted"
        )
    if deepest > curve.reach_mm:
        raise CompareError(_deeper(measured.name, deepest, curve))


def _deeper(name: str, deepest_mm: float, curve: ForceCurve) -> str:
    """Return what to do where a press is not deep enough."""
    return (
        f"{name}: reaches {deepest_mm:.4g} mm or more from first touch, but the simulated press reaches only "
        f"{curve.reach_mm:.4g} mm; simulate with a larger indenter.depth_mm, or leave the deeper points out"
    )


_SHARE = 0.95


def error_size(error: Floats, systematic: Floats, noise: Floats) -> Interval:
    """Return the root mean square of an error m of which E = m + s + e is seen, with its 95 % interval.

    Any set that holds s with 95 % gives an interval of m: here the smallest 95 % of its draws, by their mean square.
    The ends are the smallest and the largest rms(E - s) over them, so that 0 is among the sizes where s may be all of
    E; a distribution of E - s never would say so. What noise adds to a mean square, 2 m e + e^2, is taken off: its
    mean from the estimate, its 95 % range from the ends. Holds m with 95 % or more; wider than needed where many
    independent directions of s matter.

    Parameters
    ----------
    error
        Seen, (n,).
    systematic, noise
        Draws of s and e with mean 0, (k, n); s is shared by the points, e is not.
    """
    seen = float(np.mean(error**2))
    noise_squares = np.mean(noise**2, axis=1)
    added_low, added_high = np.percentile(2.0 * noise @ error / len(error) + noise_squares, _PERCENTILES)
    squares = np.mean(systematic**2, axis=1)
    likely = systematic[squares <= np.quantile(squares, _SHARE)]
    left = np.mean((error - likely) ** 2, axis=1)
    mean_squares = np.array([seen - noise_squares.mean(), left.min() - added_high, left.max() - added_low])
    estimate, low, high = np.sqrt(np.maximum(mean_squares, 0.0))
    return Interval(estimate=float(estimate), low95=float(min(low, estimate)), high95=float(max(high, estimate)))


UNKNOWN_UNCERTAINTY = (
    "intervals and verdicts: the design's inputs have no sensitivities and the CSV states no uncertainty, so u_val "
    "contains at most the numerical error. Simulate with 'press --sensitivities', and give the columns "
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
