"""Render one press of a painted finger as a record, with what its colours and its pose are worth; and recolour it.

How sure the colours are: draws of both paints and of the camera, as factors on the layers of the render. How the
contact image changes with the indenter's depth and place: central differences of renders. Other paints, another
camera or white balance are put on a stored render by arithmetic: no path is traced again.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from data_schemas import (
    FingerDesign,
    KnownInputs,
    PaintCalibration,
    PoseResponse,
    RenderedLight,
    SimulatedPress,
    SimulateError,
    SpectralCurve,
)
from finray_calib.compare import srgb_to_lab
from sim.experiments._painted_finger import (
    COLOURS,
    CameraResponse,
    FingerScene,
    PaintedFinger,
    coverage_notes,
    response_matrix,
)
from sim.optics import (
    BAND_NAMES,
    FIRST_CHAINS,
    PaintBands,
    PaintOptics,
    PressRender,
    Progress,
    RenderLevel,
    RenderSettings,
    SpectralBand,
    chain_matrix,
    chain_steps,
    conversion_gains,
    mix_chains,
    paint_bands,
    render_press,
    require_near_bands,
    require_same_reflectance,
    require_small_reemission,
)
from sim.surface_meshes import FingerShape, pressed_shape

Floats = NDArray[np.float64]
SHAPE_NOTE = "shape of the finger: "
CAMERA_NOTE = "camera response: "


@dataclass(frozen=True, slots=True)
class Rendering:
    """How a press is rendered.

    Attributes
    ----------
    level
        "b": walls re-emit the blue light that reaches them; "a" and "a_inverse_square": the paper's distance-textured
        emitter; "c": the reference, fluorescence traced along each path.
    seed
        Of the random numbers.
    samples_per_pixel
        Paths per pixel, an even number: a press is rendered as two halves.
    contact_samples_per_pixel
        Paths per pixel around the contact, see :func:`sim.optics.render_press`.
    with_pose_response
        Also render how the contact image changes with the indenter's depth and position (analytic press only).
    shared_light
        Whether pixels share the light that reaches the coat, see :class:`sim.optics.RenderSettings`.
    """

    level: RenderLevel = "b"
    seed: int = 1
    samples_per_pixel: int = 128
    contact_samples_per_pixel: int | None = None
    with_pose_response: bool = False
    shared_light: bool = False

    @property
    def settings(self) -> RenderSettings:
        """What the renderer takes of it."""
        counts = self.samples_per_pixel, self.contact_samples_per_pixel
        return RenderSettings(self.level, self.seed, *counts, shared_light=self.shared_light)


def simulate_press(
    scene: FingerScene, how: Rendering, paint_sha256: Mapping[str, str], progress: Progress | None = None
) -> SimulatedPress:
    """Render the contact and no-contact image of a finger in its camera's linear RGB.

    Parameters
    ----------
    scene
        The painted finger; with the fits of its paints, the press holds draws of what its colours rest on.
    how
        Level, seed and number of paths.
    paint_sha256
        Colour -> SHA-256 of the paint calibration the optics came from.
    progress
        Called with parts done, parts in all and what is done.

    Raises
    ------
    SimulateError
        A response to the pose is asked for of given shapes.
    """
    return press_with_render(scene, how, paint_sha256, progress)[0]


def press_with_render(
    scene: FingerScene, how: Rendering, paint_sha256: Mapping[str, str], progress: Progress | None = None
) -> tuple[SimulatedPress, PressRender]:
    """Return the record of :func:`simulate_press` with the render that it was made from."""
    finger = scene.finger
    if how.with_pose_response and scene.shapes is not None:
        raise SimulateError(
            "the response to the pose can be rendered only for the analytic press; leave out --pose-response or "
            "--surfaces"
        )
    if how.with_pose_response:
        moved_designs(finger.design)  # what cannot be moved is told before anything is rendered
    render = render_press(
        finger.design,
        finger.paints,
        finger.renderer,
        how.settings,
        shapes=scene.shapes,
        calibration=finger.calibration,
        progress=progress,
    )
    pose = None
    if how.with_pose_response:
        pose = pose_response(finger, how.settings, render.chains, progress=progress)
    return press_record(finger, render, paint_sha256, scene.calibrations, pose), render


def press_record(
    finger: PaintedFinger,
    render: PressRender,
    paint_sha256: Mapping[str, str],
    calibrations: Mapping[str, PaintCalibration],
    pose: PoseResponse | None = None,
) -> SimulatedPress:
    """Return the record of a render of `finger`; its paints and their fits as in :func:`simulate_press`."""
    matrix = finger.camera_matrix(render.bands)
    return SimulatedPress(
        name=f"{finger.design.name}, press of {finger.design.indenter.depth_mm:g} mm",
        label=render.label,
        method="rendered",
        encoding="linear",
        no_contact=camera_rgb(render.no_contact_bands, matrix),
        contact=camera_rgb(render.contact_bands, matrix),
        distance=render.contact_maps.contact_distance.astype(np.float32),
        variance=camera_rgb(render.contact_variance, matrix**2),
        no_contact_bands=render.no_contact_bands,
        contact_bands=render.contact_bands,
        contact_bands_variance=render.contact_variance,
        bands=BAND_NAMES,
        no_contact_chains=render.no_contact_chains if render.chains_apart else None,
        contact_chains=render.contact_chains if render.chains_apart else None,
        chains=render.chains if render.chains_apart else (),
        no_contact_half_difference=render.no_contact_half_difference,
        contact_half_difference=render.contact_half_difference,
        layer_matrix=matrix @ chain_matrix(render.chains),
        known_inputs=known_inputs(finger, calibrations, paint_sha256, render.chains),
        pose_response=pose,
        rendered_light=light_record(render.bands, finger.response),
        camera_matrix=matrix,
        light_angle_deg=finger.design.light.angle_deg,
        design=finger.design,
        paints=dict(paint_sha256),
        notes=(*colour_notes(finger.response, render.bands), f"{SHAPE_NOTE}{render.contact_label}"),
    )


def camera_rgb(bands: NDArray[np.float32], matrix: Floats) -> NDArray[np.float32]:
    """Return camera RGB (rows, columns, 3) = C @ bands."""
    rgb: Floats = np.einsum("cb,ijb->ijc", matrix, bands.astype(np.float64))
    return rgb.astype(np.float32)


_MIDDLE_GREY = 0.18


def vividness(rgb: Floats) -> float:
    r"""Return the mean CIELAB chroma of linear camera RGB, balanced to grey and exposed to middle grey.

    .. math:: C^* = \sqrt{a^{*2} + b^{*2}}, \quad \mathrm{RGB}_i' = 0.18\, \mathrm{RGB}_i / \overline{\mathrm{RGB}}_i

    The camera's channels stand for those of sRGB, as its own colour matrix is not known.

    Parameters
    ----------
    rgb
        Linear values, (n, 3), each channel with a positive mean.
    """
    balanced = np.clip(_MIDDLE_GREY * rgb / rgb.mean(axis=0), 0.0, 1.0)
    encoded = np.where(balanced <= 0.0031308, 12.92 * balanced, 1.055 * balanced ** (1.0 / 2.4) - 0.055)
    lab = srgb_to_lab(encoded[None])[0]
    return float(np.hypot(lab[:, 1], lab[:, 2]).mean())


def light_record(
    bands: PaintBands, response: CameraResponse, white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> RenderedLight:
    """Return what the colours of a render rest on, as it is stored."""
    red, green, led = (
        SpectralCurve(name=f"{name} band", wavelength_nm=b.wavelength_nm, values=b.density_per_nm, source="rendered")
        for name, b in zip(BAND_NAMES, bands.bands, strict=True)
    )
    return RenderedLight(
        walls=COLOURS,
        bands=(red, green, led),
        reflectance=np.array([bands.reflectance[wall] for wall in COLOURS]),
        conversion=np.array([bands.conversion[wall] for wall in COLOURS]),
        response=response,
        white_balance=white_balance,
    )


def colour_notes(response: CameraResponse, bands: PaintBands) -> tuple[str, ...]:
    """Say what the colours of a press rest on."""
    cut = [
        f"{colour} paint: {100 * share:.1f} % of the fitted emission lay below the LED's upper edge and was cut"
        for colour, share in bands.cut_share.items()
        if share > 0.001
    ]
    return (f"{CAMERA_NOTE}{response[0].source}", *coverage_notes(response, bands), *cut)


DRAWS = 1000
"""Of each input; a standard deviation is then known to 2 %."""

# a calibration whose draws mostly break the conservation of energy says nothing about a real paint
_LARGEST_UNPHYSICAL_SHARE = 0.5


def known_inputs(
    finger: PaintedFinger,
    calibrations: Mapping[str, PaintCalibration],
    paint_sha256: Mapping[str, str],
    chains: Sequence[str],
    draws: int = DRAWS,
) -> KnownInputs:
    """Return draws of what decides the colours: paints with a calibration, and the camera's response.

    A chain's light is proportional to each conversion on its way, and channel c sees its last band with the response
    R[c, band]; so the matrix from chains to RGB of draw d is that of the best values times
    (R_d / R_0)[c, band] * product over steps of (K_d / K_0). Paints are drawn from their posterior without the draws
    that break the conservation of energy. The camera's factors are log-normal with mean 1: the scale of each channel's
    curve, and on top of it each channel's response in the LED's band.

    Parameters
    ----------
    finger
        Paints at their posterior means.
    calibrations, paint_sha256
        "red" and "green", where calibrated: the fits and the checksums of their files.
    chains
        Chains of the render, in its order.
    draws
        Draws of each input.

    Raises
    ------
    SimulateError
        More than half the draws of a paint return more light than they get.
    """
    mean = paint_bands(finger.paints["red"], finger.paints["green"], finger.design.light)
    names, keys, evaluations, sources, factors = [], [], [], [], []
    for colour in COLOURS:
        if colour in calibrations:
            key = paint_sha256.get(colour, calibrations[colour].paint_name)
            names.append(f"{colour} paint")
            keys.append(key)
            evaluations.append("A")
            sources.append(f"posterior of {calibrations[colour].paint_name}")
            factors.append(_paint_factors(finger, colour, calibrations[colour], mean, chains, draws, _rng(key)))
    camera_key = "; ".join(f"{c.source} +- {c.uncertainty_rel:g}" for c in finger.response)
    at_led = finger.design.camera.response_at_led_uncertainty_rel
    camera_key += f"; at the LED +- {at_led:g}"
    return KnownInputs(
        names=(*names, "camera response"),
        keys=(*keys, camera_key),
        evaluations=(*_evaluations(evaluations), "B"),
        sources=(
            *sources,
            f"{finger.response[0].source}; its uncertainty at the LED's wavelengths is stated as {100 * at_led:.0f} %",
        ),
        factors=np.array([*factors, _camera_factors(finger, chains, draws, _rng(camera_key))], dtype=np.float32),
    )


def _evaluations(names: Sequence[str]) -> tuple[Literal["A"], ...]:
    """Return one "A" per paint."""
    return tuple("A" for _ in names)


def _rng(key: str) -> np.random.Generator:
    """Return the generator of an input: the same key gives the same draws in every render."""
    return np.random.default_rng(int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], "little"))


def _paint_factors(
    finger: PaintedFinger,
    colour: str,
    calibration: PaintCalibration,
    mean: PaintBands,
    chains: Sequence[str],
    draws: int,
    rng: np.random.Generator,
) -> Floats:
    """Return factors (draw, 3, chain) of one paint."""
    best = response_matrix(finger.response, mean)
    found: list[Floats] = []
    tried, emission = 0, calibration.emission_draws_per_nm
    while len(found) < draws:
        tried += 1
        if tried - len(found) > max(20, _LARGEST_UNPHYSICAL_SHARE * tried):
            raise SimulateError(
                f"more than half of the posterior draws of {calibration.paint_name} return more light than falls on "
                "the paint; check the white reference of the capture session of this paint"
            )
        paint = replace(finger.paints[colour], emission_per_nm=np.maximum(emission[rng.integers(len(emission))], 0.0))
        try:
            bands = paint_bands(**{**finger.paints, colour: paint}, light=finger.design.light)
        except SimulateError:
            continue
        gains = conversion_gains(mean.conversion, bands.conversion)
        response = response_matrix(finger.response, bands)
        # a channel that is blind to a band stays so
        change = np.divide(response, best, out=np.ones_like(best), where=best > 0.0)
        found.append(_of_chains(change, chains, gains))
    return np.array(found)


def _of_chains(response: Floats, chains: Sequence[str], gains: Mapping[tuple[str, str], float]) -> Floats:
    """Return factors (3, chain): of the last band's response, times the gains on the chain's way."""
    last = [BAND_NAMES.index(chain.rsplit(">", 1)[-1]) for chain in chains]
    gain = np.array([np.prod([gains[step] for step in chain_steps(chain)]) for chain in chains])
    return np.asarray(response[:, last] * gain)


def _camera_factors(finger: PaintedFinger, chains: Sequence[str], draws: int, rng: np.random.Generator) -> Floats:
    """Return factors (draw, 3, chain) of the camera."""
    scale = _log_normal(np.array([curve.uncertainty_rel for curve in finger.response]), draws, rng)
    at_led = _log_normal(np.full(3, finger.design.camera.response_at_led_uncertainty_rel), draws, rng)
    is_led = np.array([chain.rsplit(">", 1)[-1] == "led" for chain in chains])
    return scale[..., None] * np.where(is_led, at_led[..., None], 1.0)


def _log_normal(sd_rel: Floats, draws: int, rng: np.random.Generator) -> Floats:
    """Return factors (draw, n) of mean 1 and these standard deviations."""
    sigma = np.sqrt(np.log1p(sd_rel**2))
    return np.asarray(np.exp(sigma * rng.standard_normal((draws, len(sd_rel))) - 0.5 * sigma**2))


POSE_STEPS_MM = {"depth_mm": 0.1, "position_mm": 0.3}
"""Steps to either side: near the uncertainty of a pose set by hand, so that a curved response is averaged over it."""

ShapeAt = Callable[[FingerDesign], FingerShape]


def pose_response(
    finger: PaintedFinger,
    settings: RenderSettings,
    chains: tuple[str, ...],
    shape_at: ShapeAt = pressed_shape,
    progress: Progress | None = None,
) -> PoseResponse:
    """Render the press a little deeper and flatter, nearer and farther, with the random numbers of the press itself.

    Parameters
    ----------
    finger, settings
        As of the press.
    chains
        Layers of the press, in its order.
    shape_at
        Returns the pressed finger of a design whose indenter has another pose; by default the analytic press.
    progress
        Called after each render.
    """
    derivatives, differences = [], []
    for (_, step_mm), designs in zip(POSE_STEPS_MM.items(), moved_designs(finger.design), strict=True):
        shapes = (shape_at(designs[0]), shape_at(designs[1]))
        render = render_press(
            finger.design,
            finger.paints,
            finger.renderer,
            settings,
            shapes=shapes,
            calibration=finger.calibration,
            progress=progress,
        )
        span_mm = np.float32(2.0 * step_mm)
        both = (
            (render.contact_chains, render.no_contact_chains),
            (render.contact_half_difference, render.no_contact_half_difference),
        )
        derivative, difference = (_ordered((more - less) / span_mm, render.chains, chains) for more, less in both)
        derivatives.append(derivative)
        differences.append(difference)
    return PoseResponse(
        names=("depth_mm", "position_mm"),
        steps_mm=tuple(POSE_STEPS_MM.values()),
        derivative=np.array(derivatives),
        half_difference=np.array(differences),
    )


def moved_designs(design: FingerDesign) -> tuple[tuple[FingerDesign, FingerDesign], ...]:
    """Return the design with its indenter a step before and after its place, for each part of the pose.

    Raises
    ------
    SimulateError
        A step leads out of the pad: the press is too shallow, or too near an end.
    """
    found = []
    for field, step_mm in POSE_STEPS_MM.items():
        pair = []
        for sign in (-1.0, 1.0):
            values = design.model_dump()
            values["indenter"][field] += sign * step_mm
            try:
                pair.append(FingerDesign.model_validate(values))
            except ValidationError:
                raise SimulateError(
                    f"the response to the pose moves indenter.{field} by {step_mm:g} mm to either side, but "
                    f"{values['indenter'][field]:g} mm is not possible; press deeper, or farther from the end of the "
                    "pad, or leave out --pose-response"
                ) from None
        found.append((pair[0], pair[1]))
    return tuple(found)


def _ordered(images: NDArray[np.float32], own: tuple[str, ...], chains: tuple[str, ...]) -> NDArray[np.float32]:
    """Return images (row, column, chain) in the order of the press; a chain that is too weak here is dark."""
    dark = np.zeros(images.shape[:2], dtype=np.float32)
    return np.stack([images[..., own.index(c)] if c in own else dark for c in chains], axis=-1)


Image = NDArray[np.float32]
Gains = tuple[float, float, float]
WhiteBalance = Gains | Literal["pad"]
"""Gains of red, green and blue; or "pad": those that make the mean of the untouched pad grey, green kept."""

_RECOLOURED = ", recoloured"
WHITE_BALANCE_NOTE = "white balance (red:green:blue): "


def recoloured(
    press: SimulatedPress,
    paints: Mapping[str, PaintOptics] | None = None,
    response: CameraResponse | None = None,
    white_balance: WhiteBalance | None = None,
    paint_sha256: Mapping[str, str] | None = None,
) -> SimulatedPress:
    """Return a press as other paints, another camera or another white balance would show it.

    RGB = diag(white balance) C W chains: the light of a chain is proportional to every conversion on its way, W holds
    their changes, C the camera's response over the bands. Equal to a new render with the same seed as far as the
    reflectances of the walls, and of the coating at the bands' centroids, are equal. The noise of a band is scaled
    with the light of its first chain; ``contact_bands_variance`` stays that of the render, like the chains.

    Parameters
    ----------
    press
        A press rendered by level a or b in a compiled variant; of any render, camera and white balance can be changed.
    paints
        New optics of "red" and "green"; those that the press shows without it.
    response
        New camera; that which the press shows without it.
    white_balance
        New gains; those that the press shows without it.
    paint_sha256
        Checksums of the new paints' files, for the record.

    Raises
    ------
    SimulateError
        When the press is no render or holds no chains, when a reflectance, a band's place or a conversion changes too
        much to do without a new render, or when a gain is not positive.
    CurveError
        When the response misses more than 20 % of a band.
    """
    rendered, shown, design = _lights(press)
    if paints is None:
        bands = stored_bands(shown)
    else:
        bands = paint_bands(paints["red"], paints["green"], design.light)
        _require_chains(press, stored_bands(rendered), bands)
    growth = _growth(press, stored_bands(rendered), bands)
    camera = shown.response if response is None else response
    to_rgb = response_matrix(camera, bands)
    gains = _gains(shown.white_balance if white_balance is None else white_balance, press, to_rgb @ growth)
    notes = press.notes if paints is None else tuple(n for n in press.notes if n.startswith(SHAPE_NOTE))
    kept = [note for note in notes if not note.startswith((CAMERA_NOTE, WHITE_BALANCE_NOTE))]
    balance = [] if gains == (1.0, 1.0, 1.0) else [WHITE_BALANCE_NOTE + ":".join(f"{g:.4g}" for g in gains)]
    return press.model_copy(
        update={
            **_images(press, growth, np.array(gains)[:, None] * to_rgb),
            "label": press.label.removesuffix(_RECOLOURED) + _RECOLOURED,
            "layer_matrix": np.array(gains)[:, None] * to_rgb @ growth,
            "known_inputs": _still_known(press.known_inputs, paints is not None, response is not None),
            "shown_light": light_record(bands, camera, gains),
            "paints": press.paints if paint_sha256 is None else dict(paint_sha256),
            "notes": (*dict.fromkeys([*colour_notes(camera, bands), *kept]), *balance),
        }
    )


def _still_known(known: KnownInputs | None, other_paints: bool, other_camera: bool) -> KnownInputs | None:
    """Return the inputs whose draws still hold: another camera sees a draw of a paint otherwise too."""
    if known is None or other_camera:
        return None
    kept = [i for i, name in enumerate(known.names) if not (other_paints and name.endswith("paint"))]
    if not kept:
        return None
    fields = {
        field: tuple(getattr(known, field)[i] for i in kept) for field in ("names", "keys", "evaluations", "sources")
    }
    return known.model_copy(update={**fields, "factors": known.factors[kept]})


def stored_bands(rendered: RenderedLight) -> PaintBands:
    """Return the bands that a stored render was made with; what was cut of the emission is not known any more."""
    red, green, led = (SpectralBand(curve.wavelength_nm, curve.values) for curve in rendered.bands)
    reflectance, conversion = (
        dict(zip(rendered.walls, table, strict=True)) for table in (rendered.reflectance, rendered.conversion)
    )
    return PaintBands((red, green, led), reflectance, conversion, {})


def _lights(press: SimulatedPress) -> tuple[RenderedLight, RenderedLight, FingerDesign]:
    """Return the light that a press was rendered with and the one that it shows."""
    if press.sensor is not None:
        raise SimulateError(
            f"{press.name} ({press.label}) is of a classic sensor, which has no paints, so it cannot be recoloured; "
            "change its design and render it again"
        )
    if press.rendered_light is None or press.design is None or _layers(press)[0] is None:
        raise SimulateError(
            f"{press.name} ({press.label}) does not contain the light that it was rendered with, so it cannot be "
            "recoloured; render the press again with 'finray simulate render' of this version"
        )
    return press.rendered_light, press.shown_light or press.rendered_light, press.design


def _layers(press: SimulatedPress) -> tuple[Image | None, Image | None]:
    """Return what all images are sums of: chains, or bands where chains do not stand apart."""
    if press.chains:
        return press.no_contact_chains, press.contact_chains
    return press.no_contact_bands, press.contact_bands


def _require_chains(press: SimulatedPress, before: PaintBands, after: PaintBands) -> None:
    """Refuse other paints where they need a new render."""
    if not press.chains:
        raise SimulateError(
            f"{press.name} ({press.label}) does not contain each chain of fluorescence separately, but other paints "
            "need this; render with --level b in a compiled variant of Mitsuba (--engine llvm), or change only camera "
            "and white balance"
        )
    require_same_reflectance(before.reflectance, after.reflectance)
    require_near_bands(before.bands, after.bands)
    require_small_reemission(press.chains, conversion_gains(before.conversion, after.conversion))


def _growth(press: SimulatedPress, before: PaintBands, after: PaintBands) -> Floats:
    """Return W (3 bands, layer) with bands = W @ layers."""
    if not press.chains:
        return np.eye(len(BAND_NAMES))
    return chain_matrix(press.chains, conversion_gains(before.conversion, after.conversion))


def _gains(white_balance: WhiteBalance, press: SimulatedPress, layers_to_rgb: Floats) -> Gains:
    """Return the gains of red, green and blue."""
    if isinstance(white_balance, str) and white_balance == "pad":
        pad, layers, means = pixels_of_coat(press), _layers(press)[0], np.zeros(3)
        if layers is not None:
            # row by row: one product of all pixels is spread over threads, see sim.optics._paint_bands
            of_rows = np.matmul(pad[:, None, :].astype(np.float32), layers)[:, 0]
            means = layers_to_rgb @ of_rows.sum(axis=0, dtype=np.float64)
        if not (means > 0.0).all():
            raise SimulateError(
                f"{press.name}: the gains of the white balance cannot be found, because the pad without contact is "
                "black in a channel; give three gains"
            )
        gains = means[BAND_NAMES.index("green")] / means
    else:
        try:
            gains = np.array(white_balance, dtype=np.float64)
        except (TypeError, ValueError):
            gains = np.empty(0)
    if gains.shape != (3,) or not np.isfinite(gains).all() or (gains <= 0.0).any():
        raise SimulateError(
            f'white_balance={white_balance!r}: must be three positive gains (red, green, blue) or "pad", which makes '
            "the untouched pad grey on average"
        )
    red, green, blue = gains.tolist()
    return red, green, blue


def pixels_of_coat(press: SimulatedPress) -> NDArray[np.bool_]:
    """Return which pixels see the coat, (row, column): those with a distance from the contact.

    Raises
    ------
    SimulateError
        The press has no contact.
    """
    coat = np.isfinite(press.distance)
    if not coat.any():
        raise SimulateError(
            f"{press.name} has no contact, so its record does not state which pixels see the pad, but its mean colour "
            "is needed; render a press with contact (indenter.depth_mm above 0), or give three gains"
        )
    return np.asarray(coat)


def _images(press: SimulatedPress, growth: Floats, matrix: Floats) -> dict[str, Image | Floats]:
    """Return bands and pictures of both states and the noise; each in one pass over its pixels."""
    images: dict[str, Image | Floats] = {"camera_matrix": matrix}
    for state, layers in zip(("no_contact", "contact"), _layers(press), strict=True):
        if layers is not None:
            both = mix_chains(layers, np.concatenate([growth, matrix @ growth]))
            images[f"{state}_bands"], images[state] = both[..., :3], both[..., 3:]
    if press.contact_bands_variance is not None:
        # the variance of the render, scaled with the square of each band's first chain
        first = [press.chains.index(chain) if press.chains else k for k, chain in enumerate(FIRST_CHAINS)]
        images["variance"] = mix_chains(press.contact_bands_variance, (matrix * np.diag(growth[:, first])) ** 2)
    return images
