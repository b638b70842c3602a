r"""Moduli with which finite elements give the force over push that a bench measured, with their posterior.

.. math:: F_i = e^{s} F(d_i - d_0; \theta) + b_0 + b_1 t_i + \epsilon_i, \qquad \epsilon_i \sim N(0, \sigma^2 + u_i^2)

u_i holds the stated uncertainties of force and, by the slope of the measured curve, displacement.
theta are logarithms of moduli. Nuisances of each curve: the first touch d_0, the zero of the load cell b_0, its drift
b_1 over the curve (t from 0 to 1) and the noise sigma; of each specimen: a factor e^s by which its computed force may
be wrong (mesh, dimensions). b_0 and b_1 are integrated in closed form; the rest by importance sampling, whose
diagnostics show whether to trust it. F is tabulated by the elements with its derivatives; between the tabulated moduli
cubics meet both.

The prior of the gel's C10 is even in its logarithm over all gels, and so is that of K/mu: how much narrower the
posterior is shows how much the curve has measured. The law is neo-Hooke's; a gel of another law has a C10 that depends
on how far it is pressed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.optimize import minimize

from data_schemas import (
    CompareError,
    FingerDesign,
    FittedForceCurve,
    FittedModulus,
    MaterialFit,
    MaterialVerdict,
    PressSensitivities,
)
from finray_calib.fit import Maxima, MixtureProposal, Prior, estimate, importance_sample
from finray_calib.force._force_curves import MeasuredForce, input_uncertainty

Floats = NDArray[np.float64]
GEL: Final = "mechanics.gel.c10_mpa"
BULK: Final = "mechanics.gel.bulk_over_shear"
GEL_RANGE_MPA: Final = (0.01, 10.0)
BULK_RANGE: Final = (10.0, 10_000.0)
"""K/mu from a soft foamless rubber (Poisson's ratio 0.452) to what designs allow (0.49995)."""

MEASURED_BELOW: Final = 0.25
MEASURED_LN: Final = 0.15
"""Half the width of the middle 68 % of the logarithm: a modulus known to 15 % or better."""
PRIOR_ABOVE: Final = 0.8
_ZERO_REL, _DRIFT_REL = 0.005, 0.01  # of the largest force
_NOISE_REL, _NOISE_LN_SD, _NOISE_RANGE_REL = 0.01, 1.5, (1e-4, 0.3)
_TOUCH_SD_REL, _TOUCH_RANGE_REL = 0.15, 0.5  # of the range of displacements
_STARTS_BULK = 3
_DRAWS, _KEPT = 5000, 2000
_UNEXPLAINED_REL = 0.15  # of the largest force, rms
_STEP_SD = 1e-3  # of numerical derivatives, in standard deviations of the prior


@dataclass(frozen=True, slots=True)
class ForceModel:
    """The force of one specimen at pushes (k,), by the logarithms of its moduli.

    ln F = h(ln C10) + [g(ln K/mu) - g(reference)] + sum_i S_i(ln C10) (ln x_i - reference); h and g are cubics through
    values and derivatives, straight beyond them, the S_i lie on straight lines. Between pushes a cubic of ln F over
    ln d, below the first one a power law.

    Attributes
    ----------
    name
        Of the specimen.
    push_mm
        Rising, (k,).
    gel_mpa, ln_force_gel, slope_gel
        Tabulated C10 (g,), and there ln F and d ln F / d ln C10 (g, k); with one C10 alone, a power law.
    bulk, ln_force_bulk, slope_bulk
        The same of K/mu, (b,) and (b, k), at the reference of the rest.
    bulk_over_shear
        K/mu at which the gel's table is.
    others, others_reference, slope_others
        Further moduli: fields (p,), their values (p,) and d ln F / d ln x (g, p, k).
    others_u_rel
        Standard uncertainty of these before the curve, (p,).
    scale_u_rel
        By how much the computed force may be wrong all over: mesh and dimensions.
    """

    name: str
    push_mm: Floats
    gel_mpa: Floats
    ln_force_gel: Floats
    slope_gel: Floats
    bulk: Floats
    ln_force_bulk: Floats
    slope_bulk: Floats
    bulk_over_shear: float
    others: tuple[str, ...] = ()
    others_reference: tuple[float, ...] = ()
    slope_others: Floats | None = None
    others_u_rel: tuple[float, ...] = ()
    scale_u_rel: float = 0.02

    @classmethod
    def of_finger(
        cls,
        name: str,
        design: FingerDesign,
        gel: Sequence[tuple[float, PressSensitivities]],
        bulk: Sequence[tuple[float, PressSensitivities]],
        mesh_excess_rel: float,
    ) -> "ForceModel":
        """Return the model of a press of a finger.

        Parameters
        ----------
        name, design
            Of the finger.
        gel, bulk
            Presses to one depth with other C10 and K/mu, rising, each with its derivatives; the design's own C10 is
            one of them, and only its press needs derivatives by dimensions.
        mesh_excess_rel
            By how much the mesh makes the force too high; it is taken off, and half of it stays uncertain.
        """
        middle = min(gel, key=lambda pair: abs(math.log(pair[0] / design.mechanics.gel.c10_mpa)))[1]
        slopes = {slope.field: slope.ln_force_per_ln_number for slope in middle.slopes}
        others = tuple(f for f in slopes if f.endswith("_mpa") and f != GEL)
        rest = [f for f in slopes if f not in {GEL, BULK, *others}]
        variance = sum((float(slopes[f][-1]) * input_uncertainty(design, f)[0]) ** 2 for f in rest)
        variance += (0.5 * mesh_excess_rel) ** 2
        excess = math.log1p(mesh_excess_rel)
        return cls(
            name,
            middle.depth_mm,
            np.array([value for value, _ in gel]),
            np.array([np.log(p.force_n) - excess for _, p in gel]),
            np.array([_slope(p, GEL) for _, p in gel]),
            np.array([value for value, _ in bulk]),
            np.array([np.log(p.force_n) for _, p in bulk]),
            np.array([_slope(p, BULK) for _, p in bulk]),
            design.mechanics.gel.bulk_over_shear,
            others,
            # of a list of constants their common factor
            tuple(float(np.sum(attrgetter(f)(design))) for f in others),
            np.array([[_slope(p, f) for f in others] for _, p in gel]),
            tuple(input_uncertainty(design, f)[0] for f in others),
            math.sqrt(variance),
        )

    def ln_force(self, ln_moduli: Floats) -> Floats:
        """Return ln F (m, k) of logarithms of C10, K/mu and the others (m, 2 + p)."""
        gel, bulk = np.log(self.gel_mpa), np.log(self.bulk)
        out = _cubic(gel, self.ln_force_gel, self.slope_gel, ln_moduli[:, 0])
        reference = np.array([math.log(self.bulk_over_shear)])
        out = out + _cubic(bulk, self.ln_force_bulk, self.slope_bulk, ln_moduli[:, 1])
        out = out - _cubic(bulk, self.ln_force_bulk, self.slope_bulk, reference)
        if self.slope_others is None or not self.others:
            return out
        apart = ln_moduli[:, 2:] - np.log(self.others_reference)
        at = np.clip(np.interp(ln_moduli[:, 0], gel, np.arange(len(gel))), 0.0, len(gel) - 1.0)
        low = np.minimum(at.astype(int), max(len(gel) - 2, 0))
        share = (at - low)[:, None, None]
        high = np.minimum(low + 1, len(gel) - 1)
        slopes = (1.0 - share) * self.slope_others[low] + share * self.slope_others[high]
        return np.asarray(out + np.einsum("mp,mpk->mk", apart, slopes))

    def force_n(self, ln_moduli: Floats, push_mm: Floats) -> Floats:
        """Return forces (m, n) at pushes (m, n); 0 before first touch."""
        known, x = self.ln_force(ln_moduli), np.log(self.push_mm)
        inside = push_mm > 0.0
        at = np.log(np.where(inside, push_mm, self.push_mm[0]))
        basis = CubicSpline(x, np.eye(len(x)), bc_type="natural")
        near = np.clip(at, x[0], x[-1])
        weights = basis(near) + basis(near, 1) * (at - near)[..., None]
        return np.where(inside, np.exp(np.einsum("mnk,mk->mn", weights, known)), 0.0)


def _slope(press: PressSensitivities, field: str) -> Floats:
    """Return d ln F / d ln x of a press.

    Raises
    ------
    CompareError
        When the press has no derivative by this number.
    """
    for slope in press.slopes:
        if slope.field == field:
            return slope.ln_force_per_ln_number
    raise CompareError(
        f"the derivative of the force by {field} is not available for this press, because the finger is about to "
        "snap, or was pressed with barrier contact (for example because ribs touch); give force curves that end at a "
        "smaller displacement"
    )


def _cubic(nodes: Floats, values: Floats, slopes: Floats, at: Floats) -> Floats:
    """Return a cubic through values and slopes (g, k) at places (m,), straight beyond the nodes; (m, k)."""
    near = np.clip(at, nodes[0], nodes[-1])
    beyond = (at - near)[:, None]
    if len(nodes) == 1:
        return np.asarray(values[0] + beyond * slopes[0])
    curve = CubicHermiteSpline(nodes, values, slopes)
    return np.asarray(curve(near) + curve(near, 1) * beyond)


@dataclass(frozen=True, slots=True)
class _Problem:
    """Curves, their models and the prior.

    Parameters: moduli, then of each curve first touch and ln noise, then of each specimen the scale.
    """

    curves: tuple[MeasuredForce, ...]
    models: tuple[ForceModel, ...]
    prior: Prior
    fields: tuple[str, ...]
    specimens: tuple[str, ...]

    def moduli_of(self, model: ForceModel, theta: Floats) -> Floats:
        """Return the columns of the moduli that a specimen has."""
        return theta[:, [0, 1, *(self.fields.index(field) for field in model.others)]]

    def nuisances(self, curve: int, theta: Floats) -> Floats:
        """Return first touch, ln noise and scale of a curve, (m, 3)."""
        first = len(self.fields) + 2 * curve
        # the scale is an error of the specimen, which its repeated presses share
        scale = len(self.fields) + 2 * len(self.curves) + self.specimens.index(self.models[curve].name)
        return theta[:, [first, first + 1, scale]]

    def forces_n(self, curve: int, theta: Floats) -> Floats:
        """Return the forces that the model says at a curve's points, (m, n)."""
        touch, _, scale = self.nuisances(curve, theta).T
        push = self.curves[curve].displacement_mm - touch[:, None]
        model = self.models[curve]
        return np.asarray(np.exp(scale)[:, None] * model.force_n(self.moduli_of(model, theta), push))

    def log_posterior(self, theta: Floats) -> Floats:
        """Return the log density (m,) of parameters (m, D), b_0 and b_1 integrated."""
        inside = self.prior.contains(theta)
        out = np.full(len(theta), -np.inf)
        if inside.any():
            kept = theta[inside]
            total = self.prior.log_density(kept)
            for k in range(len(self.curves)):
                total = total + self._log_likelihood(k, kept)
            out[inside] = total
        return out

    def _log_likelihood(self, curve: int, theta: Floats) -> Floats:
        measured = self.curves[curve]
        residual = measured.force_n - self.forces_n(curve, theta)
        weight = 1.0 / self.variance_n2(curve, theta)
        design, precision = _drift(measured)
        # Woodbury: the covariance is diagonal plus zero and drift
        inner = np.einsum("na,mn,nb->mab", design, weight, design) + np.diag(precision)
        right = np.einsum("na,mn->ma", design, weight * residual)
        explained = np.einsum("ma,ma->m", right, np.linalg.solve(inner, right[..., None])[..., 0])
        quadratic = (weight * residual**2).sum(axis=1) - explained
        ln_det = -np.log(weight).sum(axis=1) + np.linalg.slogdet(inner)[1] - np.log(precision).sum()
        return np.asarray(-0.5 * (quadratic + ln_det + residual.shape[1] * math.log(2.0 * math.pi)))

    def variance_n2(self, curve: int, theta: Floats) -> Floats:
        """Return the variance of each point, of the noise and of its stated uncertainties, (m, n)."""
        measured = self.curves[curve]
        slope = np.polyval(
            np.polyder(np.polyfit(measured.displacement_mm, measured.force_n, 2)), measured.displacement_mm
        )
        return np.asarray(np.exp(2.0 * self.nuisances(curve, theta)[:, 1])[:, None] + measured.variance_n2(slope))

    def with_drift_n(self, curve: int, theta: Floats) -> Floats:
        """Return the forces (m, n) with the zero and drift that fit best."""
        measured, model = self.curves[curve], self.forces_n(curve, theta)
        residual = measured.force_n - model
        weight = 1.0 / self.variance_n2(curve, theta)
        design, precision = _drift(measured)
        inner = np.einsum("na,mn,nb->mab", design, weight, design) + np.diag(precision)
        right = np.einsum("na,mn->ma", design, weight * residual)
        return np.asarray(model + np.linalg.solve(inner, right[..., None])[..., 0] @ design.T)


def _drift(measured: MeasuredForce) -> tuple[Floats, Floats]:
    """Return what zero and drift do to the points (n, 2), and their prior precisions (2,)."""
    largest = float(measured.force_n.max())
    over = np.linspace(0.0, 1.0, len(measured.force_n))
    return np.column_stack([np.ones_like(over), over]), 1.0 / np.array([_ZERO_REL, _DRIFT_REL]) ** 2 / largest**2


def _problem(curves: Sequence[MeasuredForce], models: Sequence[ForceModel]) -> _Problem:
    """Return the problem with its prior."""
    others: dict[str, tuple[float, float]] = {}
    for model in models:
        for field, value, u_rel in zip(model.others, model.others_reference, model.others_u_rel, strict=True):
            others.setdefault(field, (value, u_rel))
    rows = [_even("ln " + GEL, *GEL_RANGE_MPA), _even("ln " + BULK, *BULK_RANGE)]
    for field, (value, u_rel) in others.items():
        rows.append((f"ln {field}", math.log(value), math.sqrt(math.log1p(u_rel**2)), -np.inf, np.inf))
    for curve in curves:
        size, largest = float(np.ptp(curve.displacement_mm)), float(curve.force_n.max())
        reach = _TOUCH_RANGE_REL * size
        rows.append(("first touch", 0.0, _TOUCH_SD_REL * size, -reach, reach))
        low, high = (math.log(limit * largest) for limit in _NOISE_RANGE_REL)
        rows.append(("ln noise", math.log(_NOISE_REL * largest), _NOISE_LN_SD, low, high))
    specimens = tuple(dict.fromkeys(model.name for model in models))
    for name in specimens:
        scale_u_rel = max(model.scale_u_rel for model in models if model.name == name)
        rows.append(("scale", 0.0, scale_u_rel, -np.inf, np.inf))
    names, mean, sd, low_, high_ = zip(*rows, strict=True)
    prior = Prior(names, np.array(mean), np.array(sd), np.array(low_), np.array(high_), names)
    return _Problem(tuple(curves), tuple(models), prior, (GEL, BULK, *others), specimens)


def _even(name: str, low: float, high: float) -> tuple[str, float, float, float, float]:
    """Return a prior that is all but even in the logarithm between two limits."""
    low_ln, high_ln = math.log(low), math.log(high)
    return name, 0.5 * (low_ln + high_ln), 10.0 * (high_ln - low_ln), low_ln, high_ln


def fit_material(
    curves: Sequence[MeasuredForce], models: Sequence[ForceModel], rng: np.random.Generator, name: str = "gel"
) -> MaterialFit:
    """Return the posterior of the moduli of a gel, and of what else its specimens are made of, by measured forces.

    Parameters
    ----------
    curves
        Loading curves.
    models
        The specimen of each; models of one name are of one specimen.
    rng
        Source of all randomness.
    name
        Of the material.

    Raises
    ------
    CompareError
        When curves and models are not as many, displacements do not count from near first touch, or no modulus
        explains the curves.
    """
    if len(curves) != len(models) or not curves:
        raise CompareError(
            f"got {len(curves)} curves and {len(models)} specimens; give at least one curve, and one "
            "specimen for each curve"
        )
    for curve in curves:
        begin, size = float(curve.displacement_mm.min()), float(np.ptp(curve.displacement_mm))
        if abs(begin) > _TOUCH_RANGE_REL * size:
            raise CompareError(
                f"{curve.name}: the displacements begin at {begin:g} mm and cover {size:g} mm, but must begin near "
                "first touch; count displacements from near first touch (0 mm), which the fit then finds"
            )
    problem = _problem(curves, models)
    maxima = _maxima(problem)
    proposal = MixtureProposal.around(maxima, problem.prior).adapted(problem.log_posterior, rng)
    sample = importance_sample(problem.log_posterior, proposal, _DRAWS, rng)
    draws = sample.resampled(_KEPT, rng)
    moduli = tuple(_modulus(problem, k, draws[:, k], rng) for k in range(len(problem.fields)))
    return MaterialFit(
        name=name,
        moduli=moduli,
        draws=np.exp(draws[:, : len(problem.fields)]),
        # K = (K/mu) mu with mu = 2 C10
        bulk_modulus_mpa=estimate(2.0 * np.exp(draws[:, 0] + draws[:, 1])),
        curves=tuple(_curve(problem, k, draws, rng) for k in range(len(curves))),
        effective_samples=float(sample.effective),
        pareto_k=float(sample.pareto_k),
        trusted=bool(sample.trusted),
        design_toml=_toml(moduli),
        notes=_notes(problem, moduli, bool(sample.trusted)),
    )


def _maxima(problem: _Problem) -> Maxima:
    """Return the greatest densities at some K/mu each, with the curvature of all parameters there."""
    prior = problem.prior
    unit = np.where(np.isfinite(prior.high - prior.low), np.minimum(prior.sd, 0.1 * (prior.high - prior.low)), prior.sd)
    low, high = (float(np.log(end)) for end in BULK_RANGE)
    bulks = np.linspace(low, high, _STARTS_BULK + 2)[1:-1]
    free = np.array([k for k in range(prior.size) if k != 1])
    found = []
    for bulk in bulks:
        start = np.clip(prior.mean, prior.low + 1e-6, prior.high - 1e-6)
        start[1], start[0] = bulk, _first_gel(problem, bulk)
        theta = _climbed(problem, start, unit, free)
        found.append((theta, *_curvature(problem, theta, unit)))
    theta, height, information = (np.array(column) for column in zip(*found, strict=True))
    kept = np.isfinite(height)
    best = theta[[int(np.argmax(np.where(kept, height, -np.inf)))]]
    for k, curve in enumerate(problem.curves):
        off = float(np.sqrt(((problem.with_drift_n(k, best)[0] - curve.force_n) ** 2).mean()) / curve.force_n.max())
        if not (kept.any() and off < _UNEXPLAINED_REL):
            raise CompareError(
                f"{curve.name}: no modulus explains this curve; the nearest fit differs by {100 * off:.0f} % of the "
                f"largest force (rms; at most {100 * _UNEXPLAINED_REL:.0f} % is allowed). Check that displacements "
                "are in mm and forces in N, and that this specimen was pressed"
            )
    # the components share what K/mu leaves open between them
    apart = float(bulks[1] - bulks[0])
    information[:, 1, 1] = np.maximum(information[:, 1, 1], 1.0 / apart**2)
    return Maxima(theta[kept], height[kept], information[kept])


def _first_gel(problem: _Problem, bulk_ln: float) -> float:
    """Return the ln C10 at which the computed work of the first curve is the measured one."""
    curve, model = problem.curves[0], problem.models[0]
    low, high = (float(np.log(end)) for end in GEL_RANGE_MPA)
    ln_gel = np.linspace(low, high, 60)
    rows = np.column_stack([ln_gel, np.full(60, bulk_ln), np.tile(np.log(model.others_reference), (60, 1))])
    push = np.maximum(curve.displacement_mm, 0.0)
    whole = model.force_n(rows, np.tile(push, (60, 1))).sum(axis=1)
    return float(ln_gel[np.argmin(np.abs(np.log(whole / curve.force_n.sum())))])


def _climbed(problem: _Problem, start: Floats, unit: Floats, free: NDArray[np.int64]) -> Floats:
    """Return the greatest density over the free parameters, from a start; all in units of the prior."""

    def rows(z: Floats) -> Floats:
        theta = np.tile(start, (len(z), 1))
        theta[:, free] += z * unit[free]
        return theta

    def value_and_slope(z: Floats) -> tuple[float, Floats]:
        steps = _STEP_SD * np.eye(len(free))
        values = -problem.log_posterior(rows(np.concatenate([z[None], z + steps, z - steps])))
        values = np.where(np.isfinite(values), values, 1e12)
        count = len(free)
        return float(values[0]), (values[1 : count + 1] - values[count + 1 :]) / (2.0 * _STEP_SD)

    low = (problem.prior.low[free] - start[free]) / unit[free] + 2.0 * _STEP_SD
    high = (problem.prior.high[free] - start[free]) / unit[free] - 2.0 * _STEP_SD
    found = minimize(
        value_and_slope, np.zeros(len(free)), jac=True, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)),
        options={"maxiter": 300},
    )  # fmt: skip
    return np.asarray(rows(found.x[None])[0])


def _curvature(problem: _Problem, theta: Floats, unit: Floats) -> tuple[float, Floats]:
    """Return the log density and minus its second derivative, made positive definite, by central differences."""
    size = len(theta)
    steps = 0.02 * np.diag(unit)
    inner = np.clip(theta, problem.prior.low + 0.05 * unit, problem.prior.high - 0.05 * unit)
    pairs = [(a, b) for a in range(size) for b in range(a, size)]
    rows = [inner + s * steps[a] + t * steps[b] for a, b in pairs for s in (1, -1) for t in (1, -1)]
    values = problem.log_posterior(np.array([inner, *rows]))
    corners = values[1:].reshape(len(pairs), 2, 2)
    second = np.zeros((size, size))
    for (a, b), v in zip(pairs, corners, strict=True):
        second[a, b] = second[b, a] = -(v[0, 0] - v[0, 1] - v[1, 0] + v[1, 1]) / 4.0
    scale = 0.02 * unit
    second = np.nan_to_num(second / np.outer(scale, scale))
    # never wider than the prior
    least = 1.0 / unit**2
    scaled = second / np.sqrt(np.outer(least, least))
    w, v = np.linalg.eigh(scaled)
    scaled = (v * np.maximum(w, 0.1)) @ v.T
    return float(values[0]), scaled * np.sqrt(np.outer(least, least))


def _modulus(problem: _Problem, number: int, ln_draws: Floats, rng: np.random.Generator) -> FittedModulus:
    """Return what is known of one modulus before and after."""
    before = problem.prior.draw(_KEPT * 5, rng)[:, number]
    width = float(np.ptp(np.quantile(ln_draws, (0.16, 0.84))))
    left = width / float(np.ptp(np.quantile(before, (0.16, 0.84))))
    verdict: MaterialVerdict = "constrained in part"
    if left < MEASURED_BELOW and width < 2.0 * MEASURED_LN:
        verdict = "measured"
    elif left > PRIOR_ABOVE:
        verdict = "not measured (prior)"
    field = problem.fields[number]
    return FittedModulus(
        field=field,
        unit="1" if field == BULK else "MPa",
        prior=estimate(np.exp(before)),
        posterior=estimate(np.exp(ln_draws)),
        left_of_prior_rel=left,
        verdict=verdict,
    )


def _curve(problem: _Problem, number: int, draws: Floats, rng: np.random.Generator) -> FittedForceCurve:
    """Return a curve with what the fitted moduli say of it."""
    measured = problem.curves[number]
    touch, ln_noise, scale = problem.nuisances(number, draws).T
    forces = problem.with_drift_n(number, draws)
    again = forces + np.sqrt(problem.variance_n2(number, draws)) * rng.standard_normal(forces.shape)
    middle = np.median(forces, axis=0)
    low, high = np.quantile(again, (0.025, 0.975), axis=0)
    return FittedForceCurve(
        measured=measured.name,
        specimen=problem.models[number].name,
        displacement_mm=measured.displacement_mm,
        force_n=measured.force_n,
        fitted_n=middle,
        low95_n=low,
        high95_n=high,
        first_touch_mm=estimate(touch),
        noise_n=estimate(np.exp(ln_noise)),
        scale_ln=estimate(scale),
        residual_rms_n=float(np.sqrt(((measured.force_n - middle) ** 2).mean())),
    )


def _toml(moduli: Sequence[FittedModulus]) -> str:
    """Return the lines of a design that hold what was measured of the gel, with its uncertainty."""
    own = [m for m in moduli if m.field in (GEL, BULK) and m.verdict == "measured"]
    if not own:
        return ""
    lines = ["[mechanics.gel]"]
    lines += [f"{m.field.rpartition('.')[2]} = {m.posterior.estimate:.4g}" for m in own]
    lines += ["", "[origin]", *(f'"{m.field}" = "measured"' for m in own)]
    lines += ["", "[uncertainty_rel]"]
    lines += [f'"{m.field}" = {min(1.0, m.posterior.sd / m.posterior.estimate):.2g}' for m in own]
    return "\n".join(lines) + "\n"


def _notes(problem: _Problem, moduli: Sequence[FittedModulus], trusted: bool) -> tuple[str, ...]:
    """Return what the fit does not know, in words."""
    notes = [
        "the material law is neo-Hookean: C10 holds for the strains that the curve reaches",
        "rate, creep and temperature are those of the bench; friction of an indenter is not computed",
    ]
    bulk = moduli[1]
    if bulk.verdict != "measured":
        notes.append(
            f"K/mu is {bulk.verdict}, because the force is nearly the same for every K/mu from "
            f"{bulk.posterior.low95:.3g} to {bulk.posterior.high95:.3g}; a confined block of the gel would measure it"
        )
    for curve, model in zip(problem.curves, problem.models, strict=True):
        notes.append(
            f"{curve.name}: the computed force may be wrong by {100 * model.scale_u_rel:.1f} % (mesh, dimensions)"
        )
    if not trusted:
        notes.append("the draws are NOT trusted: the intervals may be too narrow; give more points or a longer curve")
    return tuple(notes)
