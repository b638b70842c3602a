"""How well one finger senses the surface normal, cheap enough to be asked some hundred times.

What 'finray decide' decides on, for one design: the error of the normal at places of the pad that have not taught the
map from colour to normal. All designs share paths, paint draws and the camera's noise (common random numbers), so that
differences between designs are surer than values. Light is kept chain by chain of fluorescence: a change of yield,
emission, camera response, exposure or contact places traces nothing again.
"""

import hashlib
import json
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from data_schemas import CameraCalibration, FingerDesign, ImpossibleFingerError, NormalErrorChange, SimulateError
from finray_calib.decide import LightBasis, error_change
from sim.experiments import light_paths, with_one_panel
from sim.experiments._light_angle import (
    POINTS_ACROSS,
    POINTS_ALONG,
    FacetTable,
    colour_separations_deg,
    exposed_table,
    facet_shares,
    facet_slopes,
    held_out_errors_deg,
    normal_sigmas_deg,
    panels_in_the_way,
    rows_along,
    uniformities,
)
from sim.experiments._optics_products import tactile_sensor
from sim.experiments._paint_choice import PaintDraws, PaintEmission, UnpaintedFinger, camera_column, camera_radiance
from sim.experiments._painted_finger import COLOURS, CameraResponse
from sim.optics import (
    BAND_NAMES,
    SCALAR_VARIANT,
    FacetChains,
    PaintBands,
    ProbePaths,
    Progress,
    SeenPoints,
    facet_chains,
    paint_bands,
    seen_points,
    tilted_facets,
)
from sim.surface_meshes import FingerShape, pressed_shape, rest_shape

Floats = NDArray[np.float64]
_Kept = TypeVar("_Kept")

_LED: Final = BAND_NAMES.index("led")
#: Parts of a design that shape the coat, its press and the mirror: equal parts are equal surfaces.
_SHAPING: Final = ("pad", "indenter", "mirror")
#: What light does not depend on: words and mechanics.
_NO_LIGHT: Final = ("provenance", "name", "materials", "origin", "uncertainty_rel", "skeleton", "mechanics", "mesh")
#: Of reflectances that count as equal: bands that differ in brightness alone differ in the last digit of their means.
_DIGITS: Final = 6
#: Results that are kept for equal questions; some 0.5 MB each.
_KEPT: Final = 64


@dataclass(frozen=True, slots=True)
class EvaluationSettings:
    """How finely fingers are evaluated; two fingers are compared at equal settings.

    Attributes
    ----------
    contact_places_mm
        Middles of the contacts along the pad; by default one at each row of the grid of points, a tenth to nine tenths
        of the pad's length.
    rays, repeats
        Paths per point and repeat, and independent repeats.
    draws
        Of both paints; draw d takes repeat d modulo the repeats.
    seed
        Of paths, paint draws and noise: the same seed gives the same numbers, and a common error to all designs.
    """

    contact_places_mm: tuple[float, ...] = ()
    rays: int = 1024
    repeats: int = 2
    draws: int = 4
    seed: int = 0


@dataclass(frozen=True)
class LightMeasure:
    """What the light of a finger is measured with.

    Attributes
    ----------
    response
        Tactile camera: red, green and blue curve.
    renderer
        A compiled variant, opened with one thread.
    paints
        "red" and "green".
    sources
        What the paints come from; part of what an evaluation is known by.
    settings
        Of the search; confirmations have other seeds and contact places.
    calibration
        Geometry of the camera; an ideal pinhole without it.
    files
        Field of the design -> SHA-256 of the file that it names; part of what an evaluation is known by.
    """

    response: CameraResponse
    renderer: ModuleType
    paints: Mapping[str, PaintDraws]
    sources: Mapping[str, str]
    settings: EvaluationSettings
    calibration: CameraCalibration | None = None
    files: Mapping[str, str] = field(default_factory=dict)

    def again(self, number: int, length_mm: float) -> EvaluationSettings:
        """Return the settings of the n-th confirmation of fingers of a pad's length: another seed, other places."""
        if number == 0:
            return self.settings
        rng = np.random.default_rng([self.settings.seed, number])
        places = np.sort(rng.uniform(0.1, 0.9, size=6)) * length_mm
        seed = int(rng.integers(2**31))
        return replace(self.settings, seed=seed, contact_places_mm=tuple(places.tolist()))


@dataclass(frozen=True, slots=True)
class FingerEvaluation:
    """The objectives of one finger.

    Attributes
    ----------
    normal_error_deg
        Expected error of the sensed normal: mean over contact places and draws.
    error_by_place_deg
        The same for each draw and place, (draw, place).
    places_mm
        Contact places along the pad.
    one_pixel_sigma_deg
        Standard deviation of the normal from one pixel (Cramer-Rao bound), median over the pad, mean over draws.
    separation_deg
        Angle between the colours of facets that tilt 20 deg to opposite sides, median over the pad, mean over draws.
    evenness_rel
        5 % over 95 % quantile over the pad of the luminance without contact, mean over draws.
    brightness_rel
        Camera signal of the coat without contact, mean over R, G, B and the pad, per radiance of the panel of
        `power_rel` = 1.
    electrons_per_radiance
        Exposure that was used, mean over draws; to be given again where fingers are compared at equal exposure.
    clipped_share
        Of the pixels of the pressed coat, with a channel at full scale.
    seen_share
        Of the grid over the middle four fifths of the pad, what the camera sees. Errors are of what it sees.
    blind_error_deg
        Error where nothing is seen and the coat is taken as not tilted: mean tilt of the facets.
    in_the_way
        First surface that a light panel passes through; empty where all panels can be mounted.
    table
        Camera signals of the facets, with draws in the place of repeats; for a calibration by another finger.
    """

    normal_error_deg: float
    error_by_place_deg: Floats
    places_mm: Floats
    one_pixel_sigma_deg: float
    separation_deg: float
    evenness_rel: float
    brightness_rel: float
    electrons_per_radiance: float
    clipped_share: float
    seen_share: float
    blind_error_deg: float
    in_the_way: str
    table: FacetTable

    @property
    def error_with_unseen_deg(self) -> float:
        """Expected error over the whole grid: what the camera does not see counts as not tilted."""
        return self.seen_share * self.normal_error_deg + (1.0 - self.seen_share) * self.blind_error_deg


@dataclass(frozen=True, slots=True)
class _SentLight:
    """What facets send to the camera chain by chain, and what the camera makes of each chain, draw by draw."""

    light: FacetChains
    points: SeenPoints
    bands: PaintBands
    drawn: Sequence[PaintEmission]
    led: Floats

    def of_draws(self) -> Floats:
        """Return signals (draw, point, facet, 3); draw d takes batch d modulo the batches of paths."""
        return camera_radiance(self.light.chains, self.light.radiance_rel, self.bands, self.drawn, self.led)

    def of_paints(self) -> Floats:
        """Return signals of each draw of the paints with the mean of the paths, (draw, point, facet, 3)."""
        mean = self.light.radiance_rel.mean(axis=0, keepdims=True)
        return camera_radiance(self.light.chains, mean, self.bands, self.drawn, self.led)

    def of_batches(self) -> Floats:
        """Return signals of each batch of paths with the mean of the paints, (batch, point, facet, 3)."""
        batches = len(self.light.radiance_rel)
        mean = [
            PaintEmission(np.tile(one.camera.mean(axis=0), (batches, 1)), np.full(batches, one.gain.mean()))
            for one in self.drawn
        ]
        return camera_radiance(self.light.chains, self.light.radiance_rel, self.bands, mean, self.led)


@dataclass(frozen=True, slots=True)
class LitFinger:
    """A finger light by light: since light adds, other powers need no new paths.

    Attributes
    ----------
    evaluator, design
        By what it was traced, and the finger with the powers that it has now.
    points_mm
        (x, z) on the undeformed pad, (point, 2).
    of_batches, of_paints, of_draws
        Camera signals in units of the panel's radiance: of each batch of paths, of each draw of the paints, and of
        draws that each take a batch, (sample, light, point, facet, 3).
    """

    evaluator: "FingerEvaluator"
    design: FingerDesign
    points_mm: Floats
    of_batches: Floats
    of_paints: Floats
    of_draws: Floats

    def basis(self) -> LightBasis:
        """Return the brightness that each light gives to each point: of the coat at rest, and of its tilted facets.

        What a touch tilts is the mean over the facets, so that their differences, which tell the normal, do not count
        as unevenness.
        """
        sent = self.of_batches, self.of_paints
        rest, drawn_rest = (signals[..., 0, :] for signals in sent)
        touched, drawn_touched = (signals[..., 1:, :].mean(axis=-2) for signals in sent)
        return LightBasis.balanced(rest, touched, drawn_rest, drawn_touched)

    def evaluated(self, powers: Floats) -> FingerEvaluation:
        """Return what the finger is worth with its lights' powers times these factors, (light,)."""
        mixed = np.einsum("k,dkpfc->dpfc", powers, self.of_draws)
        return self.evaluator.judged(self.design, mixed, self.points_mm)

    def error_change(self, powers: Floats) -> NormalErrorChange:
        """Return what these factors do to the expected error of the sensed normal, by the same draws."""
        now, then = (self.evaluated(one).error_by_place_deg.mean(axis=1) for one in (np.ones_like(powers), powers))
        return error_change(now, then)


class FingerEvaluator:
    """Evaluates designs with common random numbers, and traces nothing twice.

    Light, surfaces and presses are kept by the content of what they depend on: a changed yield, emission or camera
    response takes the light that is there, a changed light angle the presses.
    """

    def __init__(
        self,
        response: CameraResponse,
        renderer: ModuleType,
        settings: EvaluationSettings | None = None,
        calibration: CameraCalibration | None = None,
    ) -> None:
        """Open an evaluator.

        Parameters
        ----------
        response
            Tactile camera: red, green and blue curve.
        renderer
            A compiled variant, from :func:`sim.optics.open_renderer`; open it with one thread for equal digits.
        settings
            How finely; by default some 1 s of processor time a design.
        calibration
            Geometry of the camera; an ideal pinhole without it.

        Raises
        ------
        SimulateError
            With a scalar renderer, or settings that measure nothing.
        """
        if renderer.variant() == SCALAR_VARIANT:
            raise SimulateError(
                "evaluating a finger needs a compiled variant of Mitsuba, because paths are traced once for all "
                "paints; leave out --engine scalar, and make sure that LLVM is installed"
            )
        self.settings = settings or EvaluationSettings()
        if min(self.settings.rays, self.settings.repeats, self.settings.draws) < 1:
            raise SimulateError(f"an evaluation needs at least one ray, one repeat and one draw, got {self.settings}")
        self.response, self.renderer, self.calibration = response, renderer, calibration
        self.traced = 0
        self._kept: OrderedDict[str, object] = OrderedDict()

    def evaluate(
        self, design: FingerDesign, paints: Mapping[str, PaintDraws], electrons_per_radiance: float | None = None
    ) -> FingerEvaluation:
        """Return the expected error of the normal of one finger, and what else its light tells.

        Parameters
        ----------
        design
            The finger.
        paints
            The "red" and the "green" paint with their draws.
        electrons_per_radiance
            Exposure, from another evaluation; by default it is set again for each draw, as long as it clips less than
            0.1 % of the pressed coat.

        Raises
        ------
        SimulateError
            When a place lies off the pad, the panel reaches into the gel, a paint is missing or gains energy, the coat
            is black, or the camera sees less than half of the grid.
        """
        sent = self._sent(design, paints)
        return self.judged(design, sent.of_draws(), sent.points.places_mm, electrons_per_radiance)

    def judged(
        self, design: FingerDesign, rgb: Floats, points_mm: Floats, electrons_per_radiance: float | None = None
    ) -> FingerEvaluation:
        """Return what camera signals (draw, point, facet, 3) at points (x, z) of a finger are worth, (point, 2)."""
        places = self.contact_places_mm(design)
        shares = self._once("presses", self._presses(design, places), lambda: _mean_shares(design, places))
        table = self._exposed(design, rgb, points_mm, shares, electrons_per_radiance)
        rest = self._rest(design)
        blocked = self._once(
            "panels",
            [[panel.model_dump(mode="json") for panel in design.lights], _parts(design)],
            lambda: panels_in_the_way(design, rest),
        )
        seen_share = len(points_mm) / (POINTS_ACROSS * POINTS_ALONG)
        return _evaluated(design, table, rgb, places, self.settings.seed, seen_share, blocked)

    def lit_apart(
        self, design: FingerDesign, paints: Mapping[str, PaintDraws], progress: Progress | None = None
    ) -> "LitFinger":
        """Trace each light of a finger once, with the others as good as out.

        Parameters
        ----------
        design, paints
            As in :meth:`evaluate`.
        progress
            Called after each light.

        Raises
        ------
        SimulateError
            As :meth:`evaluate`.
        """
        names, found = light_paths(design), []
        for number, name in enumerate(names):
            found.append(self._sent(with_one_panel(design, number), paints))
            if progress is not None:
                progress(number + 1, len(names), name)
        of_batches, of_paints, of_draws = (
            np.stack([signals(one) for one in found], axis=1)
            for signals in (_SentLight.of_batches, _SentLight.of_paints, _SentLight.of_draws)
        )
        return LitFinger(self, design, found[0].points.places_mm, of_batches, of_paints, of_draws)

    def error_with_calibration_of(
        self, taught: FingerEvaluation, found: FingerEvaluation, design: FingerDesign
    ) -> float:
        """Return the expected error (deg) of a finger that takes the calibration of another one.

        Each finger has its own picture without contact, to which its colours are relative.

        Parameters
        ----------
        taught
            The finger that was calibrated.
        found, design
            The finger that senses.
        """
        sensor = tactile_sensor(design, self.settings.seed)
        with threadpool_limits(limits=1, user_api="blas"):
            errors_deg = held_out_errors_deg(found.table, sensor, self.settings.seed, taught.table)[0]
        return float(errors_at(found.table.places_mm, errors_deg, found.places_mm).mean())

    def _sent(self, design: FingerDesign, paints: Mapping[str, PaintDraws]) -> "_SentLight":
        """Return what facets send to the camera, and what it makes of each draw of the paints."""
        for colour in COLOURS:
            if colour not in paints:
                raise SimulateError(f"the paint of the {colour} wall is missing; give --paint {colour}=FILE")
        red, green = (paints[colour] for colour in COLOURS)
        bands = paint_bands(red.optics, green.optics, design.light)
        light, points = self._light(design, bands)
        finger = UnpaintedFinger(design, self.response, self.renderer, self.calibration)
        drawn = [
            PaintEmission.drawn(paint, finger, self.settings.draws, np.random.default_rng([self.settings.seed, k]))
            for k, paint in enumerate((red, green))
        ]
        return _SentLight(light, points, bands, drawn, camera_column(finger, bands, _LED))

    def _light(self, design: FingerDesign, bands: PaintBands) -> tuple[FacetChains, SeenPoints]:
        """Return the light of the facets, chain by chain for conversions of 1; traced once for equal content."""
        given = design.model_dump(mode="json", exclude=set(_NO_LIGHT))
        del given["camera"]["bit_depth"], given["indenter"]
        reflectance = {wall: np.round(values, _DIGITS).tolist() for wall, values in bands.reflectance.items()}

        def trace() -> tuple[FacetChains, SeenPoints]:
            self.traced += 1
            rest = self._rest(design)
            points = seen_points(design, rest, self.renderer, POINTS_ACROSS, POINTS_ALONG, self.calibration)
            facets = tilted_facets(points.normals, facet_slopes())
            paths = ProbePaths(self.settings.rays, self.settings.repeats, self.settings.seed)
            return facet_chains(design, rest, bands, self.renderer, points.probes, facets, paths), points

        # the coat reflects as at the middle of each band
        middles = [round(float(np.average(b.wavelength_nm, weights=b.density_per_nm)), 1) for b in bands.bands]
        return self._once("light", [given, reflectance, middles], trace)

    def _rest(self, design: FingerDesign) -> FingerShape:
        """Return the surfaces of the finger without contact."""
        return self._once("rest", _parts(design), lambda: rest_shape(design))

    def contact_places_mm(self, design: FingerDesign) -> Floats:
        """Return the middles of the contacts along the pad."""
        length = design.pad.length_mm
        if not self.settings.contact_places_mm:
            return length * np.linspace(0.1, 0.9, POINTS_ALONG)
        places = np.array(self.settings.contact_places_mm, dtype=np.float64)
        if not ((places >= 0.0) & (places <= length)).all():
            raise ImpossibleFingerError(
                f"contact places must lie on the pad, 0 to {length:g} mm (pad.length_mm), got {places.tolist()} mm"
            )
        return places

    def _exposed(
        self, design: FingerDesign, rgb: Floats, places_mm: Floats, shares: Floats, exposure: float | None
    ) -> FacetTable:
        """Return the camera's signals at an exposure of their own, or at a given one."""
        sensor = tactile_sensor(design, self.settings.seed)
        if exposure is None:
            return exposed_table(rgb[None], places_mm, shares, sensor)
        full_e = (sensor.full_scale_dn - sensor.black_level_dn) * sensor.gain_e_per_dn
        signal_e = exposure * rgb[None]
        clipped = (signal_e >= full_e).any(axis=-1).mean(axis=(1, 2)) @ shares
        return FacetTable(signal_e, facet_slopes(), places_mm, np.ones(1), np.asarray(clipped))

    @staticmethod
    def _presses(design: FingerDesign, places_mm: Floats) -> object:
        indenter = design.indenter.model_dump(mode="json", exclude={"position_mm"})
        return [design.pad.model_dump(mode="json"), indenter, places_mm.tolist()]

    def _once(self, what: str, content: object, make: Callable[[], _Kept]) -> _Kept:
        """Return what was made of equal content, or make it."""
        key = hashlib.sha256(json.dumps([what, content], sort_keys=True, allow_nan=False).encode()).hexdigest()
        if key not in self._kept:
            self._kept[key] = make()
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]  # type: ignore[return-value]


def _parts(design: FingerDesign) -> object:
    """Return what shapes the surfaces without contact; the layout's scale is that of the pad."""
    return [getattr(design, part).model_dump(mode="json") for part in _SHAPING if part != "indenter"]


def _mean_shares(design: FingerDesign, places_mm: Floats) -> Floats:
    """Return which share of the pressed coat each facet stands for, mean over the places."""
    rest, shares = rest_shape(design), []
    for place in places_mm:
        indenter = design.indenter.model_copy(update={"position_mm": float(place)})
        shares.append(facet_shares(rest, pressed_shape(design.model_copy(update={"indenter": indenter}))))
    return np.asarray(np.mean(shares, axis=0))


def _evaluated(
    design: FingerDesign, table: FacetTable, rgb: Floats, places_mm: Floats, seed: int, seen_share: float, blocked: str
) -> FingerEvaluation:
    """Judge a table of signals."""
    sensor = tactile_sensor(design, seed)
    with threadpool_limits(limits=1, user_api="blas"):
        errors_deg = held_out_errors_deg(table, sensor, seed)[0]
    by_place = errors_at(table.places_mm, errors_deg, places_mm)
    white = table.signal_e[0, :, :, 0]
    return FingerEvaluation(
        normal_error_deg=float(by_place.mean()),
        error_by_place_deg=by_place,
        places_mm=places_mm,
        one_pixel_sigma_deg=float(np.median(normal_sigmas_deg(table, sensor)[0], axis=-1).mean()),
        separation_deg=float(np.median(colour_separations_deg(table)[0], axis=-1).mean()),
        evenness_rel=float(uniformities(table)[0].mean()),
        brightness_rel=float(rgb[:, :, 0].mean()),
        electrons_per_radiance=float(np.mean(white.sum(axis=(1, 2)) / rgb[:, :, 0].sum(axis=(1, 2)))),
        clipped_share=float(table.clipped_share[0]),
        seen_share=seen_share,
        blind_error_deg=_blind_error_deg(),
        in_the_way=blocked,
        table=table,
    )


def errors_at(points_mm: Floats, errors_deg: Floats, places_mm: Floats) -> Floats:
    """Return errors at places along the pad, (draw, place): means of the rows of points, linear between rows.

    Parameters
    ----------
    points_mm
        (x, z) of the points, (point, 2).
    errors_deg
        (draw, point).
    places_mm
        Along the pad; beyond the first and the last row their value is held.
    """
    rows_mm, row_of_point = rows_along(points_mm[:, 1])
    of_rows = np.stack([errors_deg[:, row_of_point == row].mean(axis=1) for row in range(len(rows_mm))], axis=1)
    return np.stack([np.interp(places_mm, rows_mm, one) for one in of_rows])


def _blind_error_deg() -> float:
    """Return the mean tilt of the facets."""
    return float(np.degrees(np.arctan(np.linalg.norm(facet_slopes(), axis=1))).mean())
