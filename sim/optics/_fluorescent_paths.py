"""Path tracing through paint that changes the colour of light, and level c: the same in three bands.

Any scene of the renderer will do: paint is recognised by the pointer of a surface's BSDF and treated as Lambertian on
the side of its normal; everything else scatters and shines as in the renderer's own ``path``, with multiple importance
sampling of emitters. What a path carries, and what happens to it at paint, is a :class:`Carrier`: of three bands here,
of a classic sensor's channels in :mod:`sim.optics._band_paths`, of full spectra in the tests.
Import this module after a variant of the renderer has been set (see :func:`sim.optics.open_renderer`).
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from data_schemas import SimulateError
from sim.optics._panel_light import FROM_EYE, state_after
from sim.optics._path_rules import LARGEST_SURVIVAL, MAX_DEPTH, ROULETTE_DEPTH, LookupTable
from sim.optics._renderer import check_variant

# a matrix from measured tables may exceed energy balance by rounding only
_ENERGY_TOLERANCE = 1e-9


class Carrier(Protocol):
    """What a path carries from the eye, and how paint changes it; all values are renderer arrays."""

    def start(self) -> Any:
        """Return what a fresh path carries."""

    def received(self, carried: Any, light: Any) -> Any:
        """Return the contribution to the result of light met by the path."""

    def scattered(self, carried: Any, weight: Any) -> Any:
        """Return what is carried on after a surface (or roulette) of this weight."""

    def reradiated(self, carried: Any, si: Any, sampler: Any, paint: Any, painted: Any) -> Any:
        """Return what is carried on after paint number `paint` where `painted`; may change si.wavelengths."""

    def largest(self, carried: Any) -> Any:
        """Return the largest share of light that is still carried, for roulette."""

    def panel_light(self, si: Any, radiance: Any) -> Any:
        """Return light of the LED panels, whose radiance is one number, as this carrier sees it."""


class PanelLight(Protocol):
    """LED panels behind a refracting face, as :class:`sim.optics._band_paths.BandPaths` connects them with the gel."""

    face: Any
    inner: Any
    coat: Any

    def connect(self, scene: Any, si: Any, sample: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return (visible, direction, radiance x solid angle) of a point on a panel."""

    def panel_met(self, si: Any, state: Any) -> Any:
        """Return the radiance of a panel met by chance, none if a connection has counted it."""

    def film_factor(self, si: Any, transmitted: Any) -> Any:
        """Return what the film on the face changes beyond the scene's BSDF."""


class BandCarrier:
    """What a path carries from the eye: T (bands out, bands in), the light of each band that reaches each of the image.

    At ordinary surfaces T <- T diag(w), at paint T <- T M with M = diag(reflectance) + K, and light L adds T L. Nothing
    is chosen by chance at paint, so one path serves every conversion of bands, of every order.

    Parameters
    ----------
    matrices
        M of each paint, in the order in which :func:`fluorescent_integrator` gets the paints.
    """

    def __init__(self, matrices: Sequence[NDArray[np.float64]]) -> None:
        rows = np.array(matrices, dtype=np.float64).reshape(-1, 3)
        self.columns = [LookupTable(rows[:, k : k + 1], mi) for k in range(3)]

    def start(self) -> list[Any]:
        """Return the unit matrix."""
        return [mi.Color3f(1, 0, 0), mi.Color3f(0, 1, 0), mi.Color3f(0, 0, 1)]

    def received(self, carried: list[Any], light: Any) -> Any:
        """Return T L."""
        return mi.Color3f(*[dr.dot(row, light) for row in carried])

    def scattered(self, carried: list[Any], weight: Any) -> list[Any]:
        """Return T diag(weight)."""
        return [row * weight for row in carried]

    def reradiated(self, carried: list[Any], si: Any, sampler: Any, paint: Any, painted: Any) -> list[Any]:
        """Return T M of paint number `paint` where `painted`."""
        matrix = [mi.Color3f(*[column.row(3 * paint + k, painted) for column in self.columns]) for k in range(3)]
        changed = [row.x * matrix[0] + row.y * matrix[1] + row.z * matrix[2] for row in carried]
        return [dr.select(painted, new, old) for new, old in zip(changed, carried, strict=True)]

    def largest(self, carried: list[Any]) -> Any:
        """Return the largest entry of T, by which paths end by chance."""
        return dr.maximum(dr.maximum(dr.max(carried[0]), dr.max(carried[1])), dr.max(carried[2]))

    def panel_light(self, si: Any, radiance: Any) -> Any:
        """Return the light of LED panels, whose radiance is one number: it is in the third band."""
        return mi.Color3f(0, 0, radiance)


def fluorescent_integrator(
    carrier: Carrier,
    paints: Sequence[Any],
    max_depth: int = MAX_DEPTH,
    roulette_depth: int = ROULETTE_DEPTH,
    panels: PanelLight | None = None,
) -> Any:
    """Return an integrator for the variant that is set.

    Parameters
    ----------
    carrier
        What the paths carry.
    paints
        BSDFs of the painted surfaces, in the carrier's order.
    max_depth
        Longest path in surfaces.
    roulette_depth
        Paths longer than this end by chance.
    panels
        LED panels of a finger: the only light then, connected through the gel's face. Without, the scene's emitters
        shine, sampled as in the renderer's ``path``.
    """

    class FluorescentPaths(mi.SamplingIntegrator):
        """The renderer's handle on the loop below; a class of the variant that is set."""

        def sample(  # type: ignore[no-untyped-def]
            self, scene, sampler, ray, medium=None, active=True
        ):
            """Return radiance along rays (called by the renderer)."""
            return _trace(  # type: ignore[no-untyped-call]
                carrier, paints, panels, (max_depth, roulette_depth), scene, sampler, ray, active
            )

    return FluorescentPaths(mi.Properties())


def fluorescent_bands(
    scene: Any,
    matrices: Mapping[str, NDArray[np.float64]],
    max_depth: int = MAX_DEPTH,
    roulette_depth: int = ROULETTE_DEPTH,
    panels: PanelLight | None = None,
) -> Any:
    """Return the integrator of level c: path-wise fluorescence in three bands.

    Parameters
    ----------
    scene
        Scene of an rgb variant whose three channels are the bands.
    matrices
        By id of the painted surfaces or of their BSDF: M[band out, band in], shape (3, 3), reflectance and
        reradiation together; it replaces the reflectance of that BSDF. Empty for a scene without paint.
    max_depth, roulette_depth
        Longest path, and from where on paths end by chance.
    panels
        LED panels of a finger, connected through its inner face, see :func:`fluorescent_integrator`.

    Raises
    ------
    SimulateError
        When a matrix is no 3 x 3 matrix, is negative or gains energy (a column that sums to more than 1), when the
        variant is not an rgb variant, or when no surface has one of the ids.
    """
    check_variant("rgb", "three bands")
    for name, matrix in matrices.items():
        if np.shape(matrix) != (3, 3) or not np.isfinite(matrix).all() or (matrix < 0.0).any():
            raise SimulateError(
                f"paint {name}: the band matrix must be 3 x 3 finite numbers of 0 or more, got {matrix}"
            )
        gain = float(matrix.sum(axis=0).max())
        if gain > 1.0 + _ENERGY_TOLERANCE:
            raise SimulateError(
                f"paint {name} returns {gain:.3f} times the energy of one band, but a column of its matrix may sum to "
                "at most 1"
            )
    paints = painted_bsdfs(scene, list(matrices))
    carrier = BandCarrier(list(matrices.values()) or [np.eye(3)])
    return fluorescent_integrator(carrier, paints, max_depth, roulette_depth, panels)


def painted_bsdfs(scene: Any, names: Sequence[str]) -> list[Any]:
    """Return the BSDFs with these ids, or of the shapes with these ids, in this order.

    The renderer makes equal BSDFs one when it loads a scene: two paints must differ in something.

    Raises
    ------
    SimulateError
        When no surface of the scene has that id or a BSDF of that id.
    """
    known = {shape.id(): shape.bsdf() for shape in scene.shapes()}
    known |= {shape.bsdf().id(): shape.bsdf() for shape in scene.shapes()}
    missing = [name for name in names if name not in known]
    if missing:
        raise SimulateError(
            f"no surface or BSDF of the scene has the id {', '.join(missing)}; valid ids are "
            f"{', '.join(sorted(known))} (equal BSDFs become one, so give the paints different reflectances)"
        )
    return [known[name] for name in names]


@dr.syntax
def _trace(  # type: ignore[no-untyped-def]
    carrier, paints, panels, depths, scene, sampler, ray, active
):
    """Follow paths from the eye; return (radiance, valid, no further outputs)."""
    max_depth, roulette_depth = depths
    context = mi.BSDFContext()
    ray = mi.Ray3f(ray)
    carried = carrier.start()
    radiance: Any = mi.Spectrum(0)
    depth, eta = mi.UInt32(0), mi.Float(1)
    active, valid = mi.Bool(active), mi.Bool(False)
    before, before_pdf, before_smooth = dr.zeros(mi.Interaction3f), mi.Float(1), mi.Bool(True)
    state = mi.UInt32(FROM_EYE)
    while dr.hint(active, max_iterations=max_depth):
        si = scene.ray_intersect(ray, active)
        valid |= active & si.is_valid() & (depth == 0)
        front = mi.Frame3f.cos_theta(si.wi) > 0
        light = _light_met(carrier, panels, scene, si, (before, before_pdf, before_smooth), state, active)
        radiance += dr.select(active, carrier.received(carried, light), 0)
        active &= si.is_valid() & (depth + 1 < max_depth)

        bsdf = si.bsdf(ray)
        number, painted = _paint_number(bsdf, paints)
        painted &= active
        carried = carrier.reradiated(carried, si, sampler, number, painted)
        aimed, light = _light_aimed_at(carrier, panels, scene, si, sampler, bsdf, painted, active)
        radiance += dr.select(aimed, carrier.received(carried, light), 0)

        spot = sampler.next_2d(active)
        drawn, weight = bsdf.sample(context, si, sampler.next_1d(active), spot, active)
        cosine = mi.warp.square_to_cosine_hemisphere(spot)
        direction = dr.select(painted, cosine, drawn.wo)
        # a direction exactly in the surface has density 0: followed on, its weight against emitter sampling is 0 / 0
        weight = dr.select(painted, mi.Spectrum(dr.select(front & (cosine.z > 0), 1.0, 0.0)), weight)
        before_smooth = ~painted & mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        before, before_pdf = mi.Interaction3f(si), dr.select(painted, cosine.z * dr.inv_pi, drawn.pdf)
        if dr.hint(panels is not None, mode="scalar"):
            state, film = _way_on(panels, si, drawn, before_smooth, state)
            weight *= film
        carried = carrier.scattered(carried, weight)
        eta *= dr.select(painted, 1.0, drawn.eta)
        ray = si.spawn_ray(si.to_world(direction))
        depth += 1

        left = carrier.largest(carried)
        active &= left > 0
        survival = dr.select(depth >= roulette_depth, dr.minimum(left * eta * eta, LARGEST_SURVIVAL), 1.0)
        active &= sampler.next_1d(active) < survival
        carried = carrier.scattered(carried, dr.rcp(survival))
    return radiance, valid, []


def _light_met(
    carrier: Carrier,
    panels: PanelLight | None,
    scene: Any,
    si: Any,
    before: tuple[Any, Any, Any],
    state: Any,
    active: Any,
) -> Any:
    """Return the light of a source that a path has met."""
    if panels is None:
        return _light_by_chance(scene, si, before, active)
    front = (mi.Frame3f.cos_theta(si.wi) > 0) & si.is_valid()
    return carrier.panel_light(si, dr.select(front, panels.panel_met(si, state), 0))


def _light_aimed_at(
    carrier: Carrier,
    panels: PanelLight | None,
    scene: Any,
    si: Any,
    sampler: Any,
    bsdf: Any,
    painted: Any,
    active: Any,
) -> tuple[Any, Any]:
    """Return (aimed at all, light scattered towards the eye) of a point on a source drawn from a surface point."""
    if panels is None:
        aimed = active & (painted | mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth))
        sample, light = scene.sample_emitter_direction(si, sampler.next_2d(aimed), True, aimed)
        aimed &= sample.pdf > 0
        value, pdf = _scattering(bsdf, si, si.to_local(sample.d), painted, aimed)
        return aimed, value * (light * dr.select(sample.delta, 1.0, sample.pdf / (sample.pdf + pdf)))
    front = mi.Frame3f.cos_theta(si.wi) > 0
    aimed = (painted & front) | (active & ~front & (si.shape == panels.coat))
    aimed, direction, power = panels.connect(scene, si, sampler.next_2d(aimed), aimed)
    value, _ = _scattering(bsdf, si, si.to_local(direction), painted, aimed)
    return aimed, value * carrier.panel_light(si, power)


def _way_on(panels: PanelLight, si: Any, drawn: Any, smooth: Any, state: Any) -> tuple[Any, Any]:
    """Return how a path leaves its last rough surface from here on, and what a film on the face changes."""
    front = mi.Frame3f.cos_theta(si.wi) > 0
    through = smooth & mi.has_flag(drawn.sampled_type, mi.BSDFFlags.DeltaTransmission)
    on_face = si.shape == panels.inner
    film: Any = mi.Float(1)
    if panels.face.film is not None:
        film = dr.select(on_face & smooth, panels.film_factor(si, through), 1)
    return state_after(state, smooth, through & on_face & ~front), film


def _light_by_chance(scene: Any, si: Any, before: tuple[Any, Any, Any], active: Any) -> Any:
    """Return what an emitter that a path met sends, weighted against its having been aimed at."""
    vertex, pdf, smooth = before
    aimed_pdf = scene.pdf_emitter_direction(vertex, mi.DirectionSample3f(scene, si, vertex), active & ~smooth)
    return si.emitter(scene).eval(si, active) * dr.select(smooth, 1.0, pdf / (pdf + aimed_pdf))


def _scattering(bsdf: Any, si: Any, direction: Any, painted: Any, active: Any) -> tuple[Any, Any]:
    """Return BSDF times cosine, and the density of drawing this direction; paint is Lambertian with albedo one."""
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, direction, active)
    lambert = dr.maximum(mi.Frame3f.cos_theta(direction), 0) * dr.inv_pi
    front = mi.Frame3f.cos_theta(si.wi) > 0
    return (
        dr.select(painted, mi.Spectrum(dr.select(front, lambert, 0)), value),
        dr.select(painted, lambert, pdf),
    )


def _paint_number(bsdf: Any, paints: Sequence[Any]) -> tuple[Any, Any]:
    """Return which paint a BSDF is (0 where none) and where it is one."""
    number, painted = mi.UInt32(0), mi.Bool(False)
    for k, paint in enumerate(paints):
        same = bsdf == mi.BSDFPtr(paint)
        number = dr.select(same, mi.UInt32(k), number)
        painted |= same
    return number, painted
