"""Radiance at probe points of one design and its derivative by one parameter, through the paths of level c."""

import math
from dataclasses import replace
from types import ModuleType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from sim.optics.lit_scene import open_scene
from sim.optics.paint_bands import BAND_NAMES, PaintBands
from sim.optics.probes import probes_on
from sim.optics.wall_emission import WALLS
from sim.surface_meshes.finger_shape import FingerShape

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
        from sim.optics.band_integrator import band_paths  # these need the variant set
        from sim.optics.fluorescent_paths import fluorescent_integrator, painted_bsdfs

        panels = band_paths(self._scene, self.design, self._shape)
        part, by_chance = _PARTS[light]
        panels.face = replace(panels.face, part=part)
        if parameter in ("angle_deg", *POSITION_AXES):
            self._move(panels.panels[0], change, parameter)
        carrier = _carrier(self._bands, self.renderer, change, parameter)
        connection = _Connection(panels, by_chance)
        return fluorescent_integrator(carrier, painted_bsdfs(self._scene, list(WALLS)), panels=connection)

    def _move(self, panel: Any, change: Any, parameter: Parameter | None) -> None:
        """Turn or shift a panel of the integrator."""
        import drjit as dr

        mi, light = self.renderer, self.design.light
        if parameter == "angle_deg":
            sine, cosine = dr.sincos(math.radians(1.0) * (light.angle_deg + change))
            panel.normal = mi.Vector3f(0.0, sine, cosine)
            panel.along = mi.Vector3f(0.0, cosine, -sine) * (light.height_mm / 2.0)
        else:
            axis = mi.Vector3f(*[1.0 if name == parameter else 0.0 for name in POSITION_AXES])
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

    from sim.optics.fluorescent_bands import BandCarrier  # needs the variant set

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
