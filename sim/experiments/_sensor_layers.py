"""The layers of a sensor's picture: what each light, and each chain of fluorescence, adds to it, rendered once.

A picture is their sum, each times a product of numbers that are told here: powers, yields and the camera's response.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any, Final, Literal, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError
from scipy.interpolate import RegularGridInterpolator

from data_schemas import CHANNELS, ColouredLight, FingerDesign, LightPanel, PaintCalibration, PlainSensor, SimulateError
from finray_calib.decide import LightBasis, PoweredLight
from sim.experiments import PressedCoat, pressed_coat
from sim.experiments._painted_finger import COLOURS, PaintedFinger
from sim.optics import (
    BAND_NAMES,
    FIRST_CHAINS,
    NEGLIGIBLE_CONVERSION,
    PlainRender,
    PressRender,
    Progress,
    RenderSettings,
    chain_steps,
    check_paints,
    last_band,
    light_colours,
    render_plain_sensor,
    render_press,
    seen_places_mm,
    sensor_calibration,
    stream_seed,
)

Floats = NDArray[np.float64]
Design = FingerDesign | PlainSensor
D = TypeVar("D", bound=Design)
_POWER_U_REL, _BATCH_U_REL = 0.2, 0.1
_DIM: Final = 1e-6  # power of the other lights while one is rendered
#: Cells that the middle four fifths of a pad are cut into, about; and pixels that a mean is taken of, at least.
_CELLS: Final = 40
_RIM_SHARE: Final = 0.1
_LEAST_PIXELS: Final = 12
#: Longer side of the pictures that cells are means of, px.
_PICTURE_PX: Final = 96
#: Places of presses all over a pad, as shares of its width and length.
_OVER: Final = ((0.0, 0.0), (-0.22, -0.22), (-0.22, 0.22), (0.22, -0.22), (0.22, 0.22))


@dataclass(frozen=True, slots=True)
class FreeParameter:
    """A number to be fitted: its value by the design and the standard uncertainty, of the logarithm or as it is.

    ``place`` is what it acts on: the "layer" factors, the "design" of all pictures, one "press", or the "picture".
    """

    name: str
    value: float
    u: float
    is_log: bool
    origin: str
    place: Literal["layer", "design", "press", "picture"]
    unit: str = "1"
    press: int = 0

    def at(self, theta: Any) -> Any:
        """Return the value at standardised places."""
        return self.value * np.exp(self.u * theta) if self.is_log else self.value + self.u * theta


@dataclass(frozen=True, slots=True)
class Layers:
    """Layers of each picture, without contact first, then each press; and which pixels see the pad.

    ``pictures`` (2, picture, layer, row, column) holds the mean of two independent halves of a render, and half their
    difference.
    """

    pictures: Floats
    on_pad: NDArray[np.bool_]


class SensorScene(Protocol):
    """A sensor that can be rendered in layers."""

    @property
    def design(self) -> Design:
        """The sensor as it is described."""

    @property
    def layer_numbers(self) -> tuple[FreeParameter, ...]:
        """Powers, yields and responses."""

    def mix(self, factors: Mapping[str, float]) -> Floats:
        """Return what each channel sees of each layer, (3, layer), at these factors on the layer numbers."""

    def layers(self, presses: Sequence[Design]) -> Layers:
        """Render the sensor at rest as the first of some designs says, and each of their presses."""

    @property
    def layer_names(self) -> tuple[str, ...]:
        """What the layers are of."""

    @property
    def label(self) -> str:
        """By what they are rendered."""


@dataclass(frozen=True, slots=True)
class ClassicLayers:
    """A classic sensor, one layer for each light and channel.

    Lights that share no channel are rendered together: with an ideal response each has the picture of its channel.
    """

    design: PlainSensor
    renderer: ModuleType
    folder: Path = Path()
    seed: int = 1
    samples: int = 128

    @property
    def seen(self) -> tuple[tuple[int, int], ...]:
        """Light and channel of each layer."""
        colours = light_colours(self.design, self.folder)
        return tuple((int(k), int(c)) for k, c in np.argwhere(colours > 0.0))

    @property
    def _together(self) -> list[list[int]]:
        """Lights that are rendered at once."""
        groups: list[list[int]] = []
        channels = {k: {c for light, c in self.seen if light == k} for k in range(len(self.design.lights))}
        for k, own in channels.items():
            free = [group for group in groups if not any(own & channels[other] for other in group)]
            if free:
                free[0].append(k)
            else:
                groups.append([k])
        return groups

    @property
    def layer_numbers(self) -> tuple[FreeParameter, ...]:
        """The power of each light, relative to the others."""
        return _powers(self.design, [f"lights.{k}.power_rel" for k in range(len(self.design.lights))])

    @property
    def layer_names(self) -> tuple[str, ...]:
        """Light and channel."""
        return tuple(f"light {k + 1} ({self.design.lights[k].channel}), {CHANNELS[c]} channel" for k, c in self.seen)

    @property
    def label(self) -> str:
        """By what they are rendered."""
        return f"rendered, classic sensor, {self.renderer.variant()}"

    def mix(self, factors: Mapping[str, float]) -> Floats:
        """Return what each channel sees of each layer."""
        mixed = np.zeros((len(CHANNELS), len(self.seen)))
        for layer, (k, c) in enumerate(self.seen):
            mixed[c, layer] = factors.get(f"lights.{k}.power_rel", 1.0)
        return mixed

    def layers(self, presses: Sequence[Design]) -> Layers:
        """Render the sensor at rest and each press, light by light where channels mix."""
        coats = [pressed_coat(_sensor(press), self.folder) for press in presses]
        seen = seen_places_mm(
            _sensor(presses[0]), coats[0].rest, self.renderer, sensor_calibration(self.design, self.folder)
        )
        found: list[Floats] = []
        for press, coat in zip(presses, coats, strict=True):
            of_light: dict[int, Floats] = {}
            for group in self._together:
                render = render_plain_sensor(
                    _only_lit(_sensor(press), group), self.renderer, self.seed, self.samples,
                    gels=(coat.rest, coat.pressed), folder=self.folder,
                )  # fmt: skip
                of_light |= dict.fromkeys(group, _means_and_halves(render))
            both = np.stack([of_light[k][..., c] for k, c in self.seen], axis=2)
            found += [both[:, state] for state in range(1 if found else 0, 2)]
        return Layers(np.stack(found, axis=1), np.isfinite(seen[..., 0]))


def render_each_light(
    scene: ClassicLayers, batches: int, progress: Progress | None = None
) -> tuple[LightBasis, Floats]:
    """Render each light of a classic sensor by itself, at rest and under presses all over its pad.

    Parameters
    ----------
    scene
        The sensor; its paths per pixel are those of two batches, its pictures are taken smaller. Its indenter is
        pressed in at five places, one that is no ball at three along the pad, a given [surface] where it is.
    batches
        Independent batches of paths, which tell the noise; an even number.
    progress
        Called after each two batches.

    Returns
    -------
    basis
        At rest over cells of the middle four fifths of the pad, touched over the contact of each press.
    places_mm
        Middles (x, z) of the cells, then of the contacts, (row, 2).

    Raises
    ------
    SimulateError
        When the coat cannot be made, or the camera sees too little of the pad or no contact.
    """
    scene = replace(scene, design=_smaller_picture(scene.design))
    sensor, presses = scene.design, _presses_over(scene.design)
    coats = [pressed_coat(press, scene.folder) for press in presses]
    places = [
        seen_places_mm(sensor, gel, scene.renderer, sensor_calibration(sensor, scene.folder))
        for gel in (coats[0].rest, *(coat.pressed for coat in coats))
    ]
    cells = _cells(sensor, places[0])
    contacts = [_contact(*pair) for pair in zip(coats, places[1:], strict=True)]
    kept = [k for k, contact in enumerate(contacts) if contact.sum() >= _LEAST_PIXELS]
    if not kept:
        raise SimulateError(
            "the camera sees no contact of the indenter on the pad; check indenter.depth_mm, and where the camera looks"
        )
    rest, touched = [], []
    for number in range(batches // 2):
        mean, half = replace(scene, seed=stream_seed(scene.seed, number)).layers(presses).pictures
        for pictures in (mean + half, mean - half):
            rest.append(_of_lights(scene, [pictures[0][:, cell].mean(axis=1) for cell in cells]))
            touched.append(_of_lights(scene, [pictures[1 + k][:, contacts[k]].mean(axis=1) for k in kept]))
        if progress is not None:
            progress(number + 1, batches // 2, "paths of all lights")
    middles = [places[0][cell].mean(axis=0) for cell in cells] + [places[1 + k][contacts[k]].mean(axis=0) for k in kept]
    return LightBasis.balanced(np.array(rest), np.array(touched)), np.array(middles)


def _smaller_picture(sensor: PlainSensor) -> PlainSensor:
    """Return the sensor with at most so many pixels as means of cells need; a calibrated lens keeps its own."""
    camera = sensor.camera
    factor = _PICTURE_PX / max(camera.width_px, camera.height_px)
    if factor >= 1.0 or camera.calibration is not None:
        return sensor
    size = {name: max(round(factor * getattr(camera, name)), 8) for name in ("width_px", "height_px")}
    return sensor.model_copy(update={"camera": camera.model_copy(update=size)})


def _presses_over(sensor: PlainSensor) -> list[PlainSensor]:
    """Return the sensor with its indenter all over its pad, on the middle line if no ball; as it is, with a coat."""
    if sensor.surface is not None:
        return [sensor]
    pad, is_ball = sensor.pad, sensor.indenter.shape == "ball"
    places = dict.fromkeys((across * is_ball * pad.width_mm, (0.5 + along) * pad.length_mm) for across, along in _OVER)
    return [
        with_changed_values(sensor, {"indenter.across_mm": across_mm, "indenter.position_mm": position_mm})
        for across_mm, position_mm in places
    ]


def _cells(sensor: PlainSensor, seen_mm: Floats) -> list[NDArray[np.bool_]]:
    """Return which pixels see each cell of the pad's middle, for cells that enough pixels see."""
    pad = sensor.pad
    x, z = np.nan_to_num(seen_mm[..., 0], nan=np.inf), np.nan_to_num(seen_mm[..., 1], nan=np.inf)
    inside = 1.0 - 2.0 * _RIM_SHARE
    side = inside * np.sqrt(pad.width_mm * pad.length_mm / _CELLS)
    shape = max(round(inside * pad.width_mm / side), 1), max(round(inside * pad.length_mm / side), 1)
    across, along = (x / pad.width_mm + 0.5 - _RIM_SHARE) / inside, (z / pad.length_mm - _RIM_SHARE) / inside
    found = []
    for i, j in np.ndindex(shape):
        cell = (np.floor(across * shape[0]) == i) & (np.floor(along * shape[1]) == j)
        if cell.sum() >= _LEAST_PIXELS:
            found.append(cell)
    if 2 * len(found) < np.prod(shape):
        raise SimulateError(
            f"the camera sees only {len(found)} of {np.prod(shape)} cells of the pad with at least {_LEAST_PIXELS} "
            "pixels, but half of the cells must be seen; check camera.distance_mm, camera.field_of_view_deg and the "
            "size of the picture"
        )
    return found


def _contact(coat: PressedCoat, seen_mm: Floats) -> NDArray[np.bool_]:
    """Return which pixels see the contact."""
    at = RegularGridInterpolator((coat.rest.x_mm, coat.rest.z_mm), coat.distance, bounds_error=False)
    on_coat = np.isfinite(seen_mm[..., 0])
    contact = np.zeros(on_coat.shape, dtype=np.bool_)
    contact[on_coat] = at(seen_mm[on_coat]) <= 1.0
    return contact


def _of_lights(scene: ClassicLayers, means: Sequence[Floats]) -> Floats:
    """Return means of layers (place: (layer,)) as signals of lights at their powers, (light, place, channel)."""
    signals = np.zeros((len(scene.design.lights), len(means), len(CHANNELS)))
    for layer, (light, channel) in enumerate(scene.seen):
        signals[light, :, channel] = [mean[layer] for mean in means]
    return signals


def _means_and_halves(render: PlainRender) -> Floats:
    """Return mean and half difference, each without and with contact, (2, 2, row, column, 3)."""
    halves = render.no_contact_half_difference, render.contact_half_difference
    return np.array([[render.no_contact, render.contact], halves], dtype=np.float64)


def _sensor(design: Design) -> PlainSensor:
    """Return a design that is one of a classic sensor."""
    if not isinstance(design, PlainSensor):
        raise SimulateError(f"{design.name} is a painted finger, but layers of a classic sensor were requested")
    return design


def _only_lit(sensor: PlainSensor, lit: Sequence[int]) -> PlainSensor:
    """Return the sensor with all but some lights as good as out."""
    lights = tuple(
        light if k in lit else light.model_copy(update={"power_rel": _DIM}) for k, light in enumerate(sensor.lights)
    )
    return sensor.model_copy(update={"lights": lights})


@dataclass(frozen=True, slots=True)
class FingerLayers:
    """A painted finger, one layer for each light panel and chain of fluorescence.

    The few percent of chains beyond the second order are part of the layer with the same last two conversions.
    """

    finger: PaintedFinger
    calibrations: Mapping[str, PaintCalibration] = field(default_factory=dict)
    seed: int = 1
    samples: int = 128
    shared_light: bool = False

    @property
    def chains(self) -> tuple[str, ...]:
        """Chains that have layers: all of first order, those of second order that the paints' absorption allows."""
        of_walls, led = check_paints(self.design, self.finger.paints).conversion, BAND_NAMES.index("led")
        second = (
            f"led>{first}>{wall}"
            for first in COLOURS
            for wall, row in of_walls.items()
            if row[BAND_NAMES.index(first)] > NEGLIGIBLE_CONVERSION * row[led]
        )
        return (*FIRST_CHAINS, *second)

    @property
    def design(self) -> FingerDesign:
        """The finger."""
        return self.finger.design

    @property
    def _lights(self) -> list[str]:
        """Paths of the panels in the design."""
        return light_paths(self.design)

    @property
    def layer_numbers(self) -> tuple[FreeParameter, ...]:
        """Powers where there are several panels, yields of both paints, response of the camera."""
        # the power of a single panel is told from the gain by nothing
        powers = _powers(self.design, [f"{light}.power_rel" for light in self._lights]) if len(self._lights) > 1 else ()
        return (*powers, *self._yields(), *self._responses())

    def _yields(self) -> list[FreeParameter]:
        numbers = []
        for colour in COLOURS:
            fit = self.calibrations.get(colour)
            of_fit = 0.0 if fit is None else fit.energy_yield.sd / fit.energy_yield.estimate
            origin = (
                f"calibration {100 * of_fit:.0f} %, from one batch of paint to another {100 * _BATCH_U_REL:.0f} % "
                "(assumed)"
            )
            numbers.append(_factor(f"paint.{colour}.yield_rel", float(np.hypot(of_fit, _BATCH_U_REL)), origin))
        return numbers

    def _responses(self) -> list[FreeParameter]:
        numbers = []
        at_led = self.design.camera.response_at_led_uncertainty_rel
        for channel, curve in zip(CHANNELS, self.finger.response, strict=True):
            numbers.append(_factor(f"camera.{channel}.response_rel", curve.uncertainty_rel, curve.source))
            numbers.append(
                _factor(f"camera.{channel}.response_at_led_rel", at_led, "camera.response_at_led_uncertainty_rel")
            )
        return [number for number in numbers if number.u > 0.0]

    @property
    def layer_names(self) -> tuple[str, ...]:
        """Panel and chain."""
        return tuple(f"{light}, {chain}" for light in self._lights for chain in self.chains)

    @property
    def label(self) -> str:
        """By what they are rendered."""
        return f"rendered, level b, {self.finger.renderer.variant()}"

    def mix(self, factors: Mapping[str, float]) -> Floats:
        """Return what each channel sees of each layer."""
        matrix = self.finger.camera_matrix(check_paints(self.design, self.finger.paints)).copy()
        for row, channel in enumerate(CHANNELS):
            matrix[row] *= factors.get(f"camera.{channel}.response_rel", 1.0)
            matrix[row, BAND_NAMES.index("led")] *= factors.get(f"camera.{channel}.response_at_led_rel", 1.0)
        columns = []
        for light in self._lights:
            power = factors.get(f"{light}.power_rel", 1.0)
            for chain in self.chains:
                walls = [step for _, step in chain_steps(chain)]
                gain = np.prod([factors.get(f"paint.{wall}.yield_rel", 1.0) for wall in walls])
                columns.append(matrix[:, BAND_NAMES.index(last_band(chain))] * power * gain)
        return np.array(columns).T

    def layers(self, presses: Sequence[Design]) -> Layers:
        """Render the finger at rest and each press, panel by panel."""
        settings = RenderSettings("b", self.seed, self.samples, shared_light=self.shared_light)
        at_rest, pressed = [], []
        on_pad = np.zeros(0, dtype=np.bool_)
        for number, press in enumerate(presses):
            renders = [
                render_press(
                    with_one_panel(press, light), self.finger.paints, self.finger.renderer, settings,
                    calibration=self.finger.calibration,
                )
                for light in range(len(self._lights))
            ]  # fmt: skip
            if not renders[0].chains_apart:
                raise SimulateError("fitting a finger needs a compiled variant of Mitsuba; install LLVM 17 or newer")
            if number == 0:
                on_pad = np.isfinite(renders[0].no_contact_maps.coat_mm(_finger(press))[..., 0])
                at_rest = [self._apart(render, "no_contact") for render in renders]
            pressed.append(np.concatenate([self._apart(render, "contact") for render in renders], axis=1))
        return Layers(np.stack([np.concatenate(at_rest, axis=1), *pressed], axis=1), on_pad)

    def _apart(self, render: PressRender, state: str) -> Floats:
        """Return the chains of one state and half the difference of their halves, (2, chain, row, column)."""
        layers = self.chains
        into = np.zeros((len(render.chains), len(layers)))
        for number, chain in enumerate(render.chains):
            into[number, _layer_of(chain, layers)] = 1.0
        both = (getattr(render, f"{state}_{what}").astype(np.float64) for what in ("chains", "half_difference"))
        return np.stack([np.moveaxis(image @ into, -1, 0) for image in both])


def _layer_of(chain: str, layers: Sequence[str]) -> int:
    """Return the number of the layer of a chain; without its own, that with most of its last conversions."""
    walls = [wall for _, wall in chain_steps(chain)]
    names = (">".join(["led", *walls[k:]]) for k in range(len(walls) + 1))
    return next(layers.index(name) for name in names if name in layers)


def _finger(design: Design) -> FingerDesign:
    """Return a design that is one of a finger."""
    if not isinstance(design, FingerDesign):
        raise SimulateError(f"{design.name} is a classic sensor, but layers of a painted finger were requested")
    return design


def light_paths(design: Design) -> list[str]:
    """Return the dotted path of each light in its design, in their order."""
    if isinstance(design, PlainSensor):
        return [f"lights.{k}" for k in range(len(design.lights))]
    second = ["second_light"] if design.second_light is not None else []
    return ["light", *second, *(f"further_lights.{k}" for k in range(len(design.further_lights)))]


def powered_lights(design: Design) -> tuple[list[PoweredLight], Floats]:
    r"""Return the lights of a design, and the share of each in the light of all, (light,).

    A panel of radiance L cos^(m-1) along its normal and of area A emits :math:`2 \pi L A / (m + 1)`.
    """
    lights: tuple[LightPanel | ColouredLight, ...] = design.lights
    found = []
    for number, (path, light) in enumerate(zip(light_paths(design), lights, strict=True), start=1):
        if isinstance(light, ColouredLight):
            words = f"light {number} ({light.channel})"
        else:
            x, _, z = light.position_mm
            words = f"the panel at z = {z:.0f} mm" + (f", x = {x:.0f} mm" if x else "")
        found.append(PoweredLight(f"{path}.power_rel", words, light.power_rel))
    emitted = np.array([one.power_rel * one.width_mm * one.height_mm / (one.beam_exponent + 1.0) for one in lights])
    return found, emitted / emitted.sum()


def with_one_panel(design: Design, lit: int) -> FingerDesign:
    """Return the finger with all panels but one practically off."""
    finger = _finger(design)
    if len(finger.lights) == 1:
        return finger
    lights = [
        light if k == lit else light.model_copy(update={"power_rel": _DIM}) for k, light in enumerate(finger.lights)
    ]
    second = None if finger.second_light is None else lights[1]
    further = tuple(lights[len(lights) - len(finger.further_lights) :])
    return finger.model_copy(update={"light": lights[0], "second_light": second, "further_lights": further})


def _factor(name: str, u: float, origin: str) -> FreeParameter:
    """Return a number that is 1 by the design."""
    return FreeParameter(name, 1.0, u, True, origin, "layer")


def _powers(design: Design, names: Sequence[str]) -> tuple[FreeParameter, ...]:
    """Return powers of lights, of which the uncertainty may be stated for all of them."""
    found = []
    for name in names:
        of_all = ".".join(part for part in name.split(".") if not part.isdecimal())
        stated = design.uncertainty_rel.get(of_all)
        origin = "design: uncertainty_rel" if stated is not None else "assumed: scatter from one LED to another"
        value = float(value_at(design, name))
        found.append(FreeParameter(name, value, stated or _POWER_U_REL, True, origin, "layer"))
    return tuple(found)


def value_at(design: Any, name: str) -> Any:
    """Return the value at a dotted path, entries of lists by their number; None where a part is absent."""
    for part in name.split("."):
        if isinstance(design, tuple) and part.isdecimal():
            design = design[int(part)] if int(part) < len(design) else None
        else:
            is_field = isinstance(design, BaseModel) and part in type(design).model_fields
            design = getattr(design, part) if is_field else None
    return design


def with_changed_values(design: D, values: Mapping[str, float]) -> D:
    """Return a design with values at dotted paths changed.

    Raises
    ------
    SimulateError
        The design refuses a value.
    """
    whole: Any = design.model_dump()
    for name, value in values.items():
        place = whole
        *path, last = name.split(".")
        for part in path:
            if isinstance(place, dict) and isinstance(place[part], tuple):
                place[part] = list(place[part])
            place = place[int(part)] if part.isdecimal() else place[part]
        place[int(last) if last.isdecimal() else last] = value
    try:
        return cast("D", type(design).model_validate(whole))
    except ValidationError as refused:
        fields = ", ".join(f"{name} = {value:.4g}" for name, value in values.items())
        raise SimulateError(
            f"{fields}: is not a valid design ({refused.errors()[0]['msg']}); give a smaller range, or where a fit "
            "varies the number by its uncertainty, state a smaller uncertainty_rel or leave the number out of --free"
        ) from refused
