"""Gradients of probe radiances by the light's pose and the paints' conversion: automatic differentiation.

Mitsuba's own differentiable integrators silently return zero for the pose of a light behind a smooth dielectric: they
meet it by chance only. The refractive connection carries the pose smoothly from the panel to the probe, so here the
path tracer of level c is differentiated through it. Two parts of the light are no smooth function of the pose along a
path: what no connection finds (through the mirror, or the ends of the gel), and what crosses the inner face at its
rim, whose outline cuts it off. They add finite differences with common random numbers.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, LightPanel, MissingExtraError, SimulateError
from sim.optics._paint_bands import BAND_NAMES, PaintBands, PaintOptics
from sim.optics._painted_walls import WALLS
from sim.optics._probes import ProbePaths, default_probe_points_mm, probes_on
from sim.optics._render import check_paints, open_scene, stream_seed
from sim.optics._renderer import SCALAR_VARIANT
from sim.surface_meshes import FingerShape, pressed_shape

Floats = NDArray[np.float64]

Parameter = Literal[
    "angle_deg", "position_x_mm", "position_y_mm", "position_z_mm", "red_conversion", "green_conversion"
]
"""Of the first light: its angle and the position of its centre; of a paint: the share of the LED's energy that it
emits, its conversion of other bands growing in proportion."""

PARAMETERS: tuple[Parameter, ...] = get_args(Parameter)
CONVERSIONS = ("red_conversion", "green_conversion")
POSITION_AXES = ("position_x_mm", "position_y_mm", "position_z_mm")

# probes are spots of this half size: a ray exactly along an edge between two triangles can slip through the mesh
_SPOT_MM = 0.01

CountedLight = Literal["all", "smooth", "rest"]
"""All light; what is a smooth function of the pose along each path; what is not."""

# which light each path meets by connection (crossing which part of the inner face), and whether by chance too
_PARTS: dict[CountedLight, tuple[Literal["all", "middle", "rim"], bool]] = {
    "all": ("all", True),
    "smooth": ("middle", False),
    "rest": ("rim", True),
}


class DifferentiatedProbes:
    """The scene of one design, and rays that meet its probe points along the pad's normal.

    Parameters
    ----------
    design, shape, bands
        Finger, its surfaces and its paints.
    renderer
        A compiled variant.
    points_xz_mm
        Probe points (x, z) on the pad, shape (probe, 2).
    samples
        Paths per probe.
    """

    def __init__(
        self,
        design: FingerDesign,
        shape: FingerShape,
        bands: PaintBands,
        renderer: ModuleType,
        points_xz_mm: Floats,
        samples: int,
    ) -> None:
        self.design, self.renderer = design, renderer
        self._shape, self._bands, self._samples, self._points_xz_mm = shape, bands, samples, points_xz_mm
        self._scene = open_scene(design, shape, bands, renderer)
        self._probes = probes_on(design, shape, points_xz_mm)
        self.points_mm = self._probes.points_mm
        self.values_shape = (len(self.points_mm), len(BAND_NAMES))

    def of(self, design: FingerDesign) -> "DifferentiatedProbes":
        """Return the same probes on the same surfaces in another design."""
        return DifferentiatedProbes(design, self._shape, self._bands, self.renderer, self._points_xz_mm, self._samples)

    def trace(
        self, seed: int, light: CountedLight = "all", parameter: Parameter | None = None
    ) -> tuple[Floats, Floats]:
        """Return values and derivatives by one parameter (zero without), both (probe, 3 bands)."""
        import drjit as dr

        mi = self.renderer
        change = mi.Float(0.0)
        dr.make_opaque(change)
        if parameter is not None:
            dr.enable_grad(change)
            dr.set_grad(change, 1.0)
        # an integrator serves one differentiation only: a loop compiled before cannot be traversed again
        integrator = self._integrator(change, parameter, light)
        count = len(self.points_mm) * self._samples
        middle, direction = (
            np.repeat(v, self._samples, axis=0) for v in (self._probes.origins_mm, self._probes.directions)
        )
        middle += np.random.default_rng(seed).uniform(-_SPOT_MM, _SPOT_MM, middle.shape)
        o, d = (np.ascontiguousarray(v.T, dtype=np.float32) for v in (middle, direction))
        rays = mi.Ray3f(mi.Point3f(o), mi.Vector3f(d))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, count)
        radiance = integrator.sample(self._scene, sampler, rays, None, mi.Bool(True))[0]
        if parameter is None:
            return self._means(radiance), np.zeros(self.values_shape)
        dr.forward_to(radiance)
        return self._means(dr.detach(radiance)), self._means(dr.grad(radiance))

    def _means(self, of_rays: Any) -> Floats:
        """Return the mean over the rays of each probe, (probe, 3)."""
        values = of_rays.numpy().astype(np.float64).reshape(len(BAND_NAMES), len(self.points_mm), self._samples)
        return np.asarray(values.mean(axis=2).T)

    def _integrator(self, change: Any, parameter: Parameter | None, light: CountedLight) -> Any:
        """Return a fresh path tracer of level c in which one parameter has moved by `change`."""
        from sim.optics._band_paths import band_paths  # these need the variant set
        from sim.optics._fluorescent_paths import fluorescent_integrator, painted_bsdfs

        panels = band_paths(self._scene, self.design, self._shape)
        part, by_chance = _PARTS[light]
        panels.face = replace(panels.face, part=part)
        if parameter in ("angle_deg", *POSITION_AXES):
            move_panel(panels.panels[0], self.design.light, change, parameter, self.renderer)
        carrier = _carrier(self._bands, self.renderer, change, parameter)
        connection = _Connection(panels, by_chance)
        return fluorescent_integrator(carrier, painted_bsdfs(self._scene, list(WALLS)), panels=connection)


def move_panel(panel: Any, light: LightPanel, change: Any, parameter: Parameter, renderer: ModuleType) -> None:
    """Turn or shift a panel of an integrator, which stands as `light` says, by degrees or mm."""
    import drjit as dr

    if parameter == "angle_deg":
        sine, cosine = dr.sincos(math.radians(1.0) * (light.angle_deg + change))
        x, z = math.sin(math.radians(light.azimuth_deg)), math.cos(math.radians(light.azimuth_deg))
        panel.normal = renderer.Vector3f(x * cosine, sine, z * cosine)
        panel.along = renderer.Vector3f(-x * sine, cosine, -z * sine) * (light.height_mm / 2.0)
    else:
        axis = renderer.Vector3f(*[1.0 if name == parameter else 0.0 for name in POSITION_AXES])
        panel.centre = panel.centre + change * axis


class _Connection:
    """What the fluorescent paths ask of the panels; no object of the renderer, whose arrays a loop would carry along.

    An object of the renderer becomes part of the loop's state, which can then not be differentiated.
    """

    def __init__(self, panels: Any, by_chance: bool) -> None:
        self.face, self.inner, self.coat = panels.face, panels.inner, panels.coat
        self.film_factor, self.connect, self.panel_met = panels.film_factor, panels.connect, panels.panel_met
        if not by_chance:
            self.panel_met = lambda *_: 0.0


def _carrier(bands: PaintBands, renderer: ModuleType, change: Any, parameter: Parameter | None) -> Any:
    """Return the carrier of three bands, one paint's conversion of LED light grown by `change`."""
    import drjit as dr

    from sim.optics._fluorescent_paths import BandCarrier  # needs the variant set

    class Carrier(BandCarrier):
        """Roulette decides by numbers only: a path's chance of surviving is no function of the parameter."""

        def largest(self, carried: list[Any]) -> Any:
            return dr.detach(super().largest(carried))

    carrier = Carrier([bands.matrix(wall) for wall in WALLS])
    for number, wall in enumerate(WALLS):
        if parameter == f"{wall}_conversion":
            row = bands.conversion[wall] / bands.conversion[wall][BAND_NAMES.index("led")]
            for k in range(len(BAND_NAMES)):
                direction = np.zeros(len(WALLS) * len(BAND_NAMES), dtype=np.float32)
                direction[len(BAND_NAMES) * number + BAND_NAMES.index(wall)] = row[k]
                carrier.columns[k].add(change * renderer.Float(direction))
    return carrier


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
    paths: ProbePaths | None = None,
    probe_points_mm: Floats | None = None,
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
        From :func:`sim.optics.open_renderer`, a compiled variant.
    with_respect_to
        Parameters; each costs about as much as three values.
    paths
        Paths per probe, parameter and repeat; the repeats, at least 2, give the standard errors. By default 10 000
        paths in each of 4 repeats.
    probe_points_mm
        Points (x, z) on the pad, shape (probe, 2); by default those of a sweep of the light angle.
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
    paths = paths or ProbePaths(samples=10_000, repeats=4)
    _check(renderer, with_respect_to, paths)
    finger = pressed_shape(design) if shape is None else shape
    points = default_probe_points_mm(design, finger) if probe_points_mm is None else np.asarray(probe_points_mm, float)
    probes = DifferentiatedProbes(design, finger, check_paints(design, paints), renderer, points, paths.samples)
    seeds = [stream_seed(paths.seed, repeat) for repeat in range(paths.repeats)]
    rest = np.stack([probes.trace(s, "rest")[0] for s in seeds])
    values = rest + np.stack([probes.trace(s, "smooth")[0] for s in seeds])
    parts = [_parts(probes, name, seeds, automatic) for name in with_respect_to]
    differences, smooth = (np.array([p[k] for p in parts]).reshape(-1, *values.shape) for k in (0, 1))
    (value, value_error), (gradient, gradient_error) = (
        (of.mean(axis=-3), of.std(axis=-3, ddof=1) / np.sqrt(paths.repeats)) for of in (values, differences + smooth)
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
        samples=paths.samples,
        seed=paths.seed,
    )


def _check(renderer: ModuleType, with_respect_to: Sequence[Parameter], paths: ProbePaths) -> None:
    """Refuse what cannot be differentiated."""
    unknown = [name for name in with_respect_to if name not in PARAMETERS]
    if unknown:
        raise SimulateError(f"with_respect_to: must be among {', '.join(PARAMETERS)}, got '{unknown[0]}'")
    if paths.repeats < 2 or paths.samples < 1:
        raise SimulateError(
            f"a gradient needs at least 2 repeats and 1 sample, got {paths.repeats} repeats and {paths.samples} samples"
        )
    if renderer.variant() == SCALAR_VARIANT:
        raise MissingExtraError(
            f"gradients need a compiled variant of Mitsuba, but {SCALAR_VARIANT} is set; install LLVM 17 or newer"
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
