"""Gradients of probe radiances by the light's pose and the paints' conversion: automatic differentiation.

Mitsuba's own differentiable integrators silently return zero for the pose of a light behind a smooth dielectric: they
meet it by chance only. The refractive connection carries the pose smoothly from the panel to the probe, so here the
path tracer of level c is differentiated through it. Two parts of the light are no smooth function of the pose along a
path: what no connection finds (through the mirror, or the ends of the gel), and what crosses the inner face at its
rim, whose outline cuts it off. They add finite differences with common random numbers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import MissingExtraError, SimulateError
from sim.optics.differentiated_probes import (
    CONVERSIONS,
    PARAMETERS,
    POSITION_AXES,
    CountedLight,
    DifferentiatedProbes,
    Parameter,
)
from sim.optics.lit_scene import check_paints, stream_seed
from sim.optics.paint_bands import PaintOptics
from sim.optics.probes import default_probe_points_mm
from sim.optics.variants import SCALAR_VARIANT
from sim.surface_meshes.finger_shape import FingerShape, pressed_shape

Floats = NDArray[np.float64]

# half steps of the differences: wide, because only paths that begin or cease to meet the panel count; curves of the
# light's pose bend over 50 deg and 10 mm, so that the bias is below 0.3 %
_HALF_STEP_DEG, _HALF_STEP_MM = 5.0, 1.0


@dataclass(frozen=True, slots=True)
class ProbeGradient:
    """Band radiances at probe points and their derivatives; standard errors are over independent repeats.

    ``value_rel`` (probe, 3 bands: red emission, green emission, LED) is in units of the panel's radiance;
    ``gradient`` (parameter, probe, 3) is per degree, per mm, or per unit of conversion; ``by_differences`` of the
    same shape is the part of it that is a finite difference. ``rest_rel`` (probe, 3) is the part of the value that
    this part belongs to: what met a panel by chance, or crossed the rim of the inner face.
    """

    with_respect_to: tuple[Parameter, ...]
    probe_points_mm: Floats
    value_rel: Floats
    value_error_rel: Floats
    gradient: Floats
    gradient_error: Floats
    by_differences: Floats
    rest_rel: Floats
    samples: int
    seed: int


def probe_gradient(
    design: FingerDesign,
    paints: Mapping[str, PaintOptics],
    renderer: ModuleType,
    with_respect_to: Sequence[Parameter] = ("angle_deg",),
    probe_points_mm: Floats | None = None,
    repeats: int = 4,
    seed: int = 0,
    samples: int = 10_000,
    shape: FingerShape | None = None,
    automatic: bool = True,
) -> ProbeGradient:
    """Differentiate the coated face's radiance at probe points.

    The value is that of level c, towards the inner face along the pad's normal. Light through the middle of the inner
    face is differentiated automatically, exact up to noise but for shadows; what crosses its rim, 2 mm wide, or meets a
    panel by chance adds central differences over 5 deg or 1 mm to the derivatives by the pose. Equal seeds give equal
    random numbers in every design.

    Parameters
    ----------
    design
        The finger with its press.
    paints
        Optics of the paints "red" and "green".
    renderer
        From :func:`sim.optics.variants.open_renderer`, a compiled variant.
    with_respect_to
        Parameters; each costs about as much as three values.
    probe_points_mm
        Points (x, z) on the pad, shape (probe, 2); by default those of a sweep of the light angle.
    repeats
        Independent repeats, at least 2, which give the standard errors.
    seed
        Random seed, >= 0.
    samples
        Paths per probe, parameter and repeat.
    shape
        The finger, deformed in any way; by default with the analytic press of its design.
    automatic
        False takes differences of all light for the pose: noisier, but with the light that shadows cut off.

    Raises
    ------
    MissingExtraError
        In a scalar variant, which cannot differentiate.
    SimulateError
        When a parameter is not known, there is too little to measure, or a paint is missing or gains energy.
    """
    _check(renderer, with_respect_to, repeats, samples)
    finger = pressed_shape(design) if shape is None else shape
    points = default_probe_points_mm(design, finger) if probe_points_mm is None else np.asarray(probe_points_mm, float)
    probes = DifferentiatedProbes(design, finger, check_paints(design, paints), renderer, points, samples)
    seeds = [stream_seed(seed, repeat) for repeat in range(repeats)]
    rest = np.stack([probes.trace(s, "rest")[0] for s in seeds])
    values = rest + np.stack([probes.trace(s, "smooth")[0] for s in seeds])
    parts = [_parts(probes, name, seeds, automatic) for name in with_respect_to]
    differences, smooth = (np.array([p[k] for p in parts]).reshape(-1, *values.shape) for k in (0, 1))
    (value, value_error), (gradient, gradient_error) = (
        (of.mean(axis=-3), of.std(axis=-3, ddof=1) / np.sqrt(repeats)) for of in (values, differences + smooth)
    )
    return ProbeGradient(
        with_respect_to=tuple(with_respect_to),
        probe_points_mm=probes.points_mm,
        value_rel=value,
        value_error_rel=value_error,
        gradient=gradient,
        gradient_error=gradient_error,
        by_differences=differences.mean(axis=1),
        rest_rel=rest.mean(axis=0),
        samples=samples,
        seed=seed,
    )


def _check(renderer: ModuleType, with_respect_to: Sequence[Parameter], repeats: int, samples: int) -> None:
    """Refuse what cannot be differentiated."""
    unknown = [name for name in with_respect_to if name not in PARAMETERS]
    if unknown:
        raise SimulateError(f"with_respect_to: '{unknown[0]}' is none of {', '.join(PARAMETERS)}")
    if repeats < 2 or samples < 1:
        raise SimulateError(
            f"a gradient needs at least 2 repeats and 1 sample, got {repeats} repeats and {samples} samples"
        )
    if renderer.variant() == SCALAR_VARIANT:
        raise MissingExtraError(
            f"gradients need a compiled variant of the renderer, not {SCALAR_VARIANT}; install LLVM 17 or newer"
        )


def moved(design: FingerDesign, parameter: Parameter, step: float) -> FingerDesign:
    """Return the design with the pose of its first light changed by a step in degrees or mm."""
    light = design.light
    if parameter == "angle_deg":
        changed = light.model_copy(update={"angle_deg": light.angle_deg + step})
    else:
        position = np.array(light.position_mm) + step * np.array([name == parameter for name in POSITION_AXES])
        changed = light.model_copy(update={"position_mm": tuple(position.tolist())})
    return design.model_copy(update={"light": changed})


def _parts(
    probes: DifferentiatedProbes, parameter: Parameter, seeds: Sequence[int], automatic: bool
) -> tuple[Floats, Floats]:
    """Return what differences and what automatic differentiation find, (repeat, probe, 3) each."""
    none = np.zeros((len(seeds), *probes.values_shape))
    if parameter in CONVERSIONS:
        return none, _derivatives(probes, parameter, seeds, "all")
    if not automatic:
        return _differences(probes, parameter, seeds, "all"), none
    return _differences(probes, parameter, seeds, "rest"), _derivatives(probes, parameter, seeds, "smooth")


def _derivatives(
    probes: DifferentiatedProbes, parameter: Parameter, seeds: Sequence[int], light: CountedLight
) -> Floats:
    """Return automatic derivatives (repeat, probe, 3)."""
    return np.stack([probes.trace(seed, light, parameter)[1] for seed in seeds])


def _differences(
    probes: DifferentiatedProbes, parameter: Parameter, seeds: Sequence[int], light: CountedLight
) -> Floats:
    """Return central differences (repeat, probe, 3) by a parameter of the pose."""
    half = _HALF_STEP_DEG if parameter == "angle_deg" else _HALF_STEP_MM
    values = []
    for step in (half, -half):
        side = probes.of(moved(probes.design, parameter, step))
        values.append(np.stack([side.trace(seed, light)[0] for seed in seeds]))
    return np.asarray((values[0] - values[1]) / (2.0 * half))
