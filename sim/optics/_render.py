"""Render a press: the finger without and with the indenter, as band images with their noise and position maps.

A finger's scene is opened with paint on its walls, and each level in each variant has what renders it. Each state, with
contact or without, is rendered in up to 16 independent passes: what they differ by is its noise.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count as counting
from types import ModuleType
from typing import Any, Final, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import CameraCalibration, FingerDesign, SimulateError
from sim.optics._optical_layout import Window, camera_pose
from sim.optics._paint_bands import BAND_NAMES, PaintBands, PaintOptics, paint_bands
from sim.optics._painted_walls import (
    BAKE_SAMPLES,
    FIRST_CHAINS,
    LEVEL_NAMES,
    WALLS,
    Level,
    WallLight,
    bake_batches,
    last_band,
    led_irradiance,
    light_walls,
    reflected_light,
    unbaked_walls,
)
from sim.optics._path_rules import LookupTable
from sim.optics._pixel_maps import PixelMaps, pixel_maps
from sim.optics._renderer import SCALAR_VARIANT
from sim.optics._scene import LoadedScene, camera_sensor, finger_scene
from sim.surface_meshes import FingerShape, check_no_intersections, pressed_shape, rest_shape

MOST_PASSES: Final = 16
"""Passes of a picture, as many as batches of a bake: Student's t with 15 degrees of freedom is near the normal."""

_LANES: Final = {"cuda": 1 << 24, "llvm": 1 << 22}
"""Paths traced at once, by what they are compiled for; more need memory and gain nothing."""

_AROUND_PX = 5

FloatImage = NDArray[np.float32]


class PassedPicture(NamedTuple):
    """Channels of a picture, half the difference of its halves, both (..., channel); variance of the bands' means."""

    mean: FloatImage
    half_difference: FloatImage
    band_variance: FloatImage


def passes_of(*paths_per_pixel: int) -> int:
    """Return how many passes these even numbers of paths per pixel divide into: 16, 8, 4 or 2.

    Raises
    ------
    SimulateError
        One is odd.
    """
    for passes in (MOST_PASSES, 8, 4, 2):
        if all(paths % passes == 0 for paths in paths_per_pixel):
            return passes
    raise SimulateError(f"paths per pixel must be even numbers, got {', '.join(map(str, paths_per_pixel))}")


def joined_passes(passes: NDArray[np.floating], chains: Sequence[str]) -> PassedPicture:
    r"""Return mean, half difference and variance of independent passes.

    :math:`\bar x = \sum x_k / K`, half difference :math:`(\bar x_{k < K/2} - \bar x_{k \ge K/2}) / 2`, and for the
    bands, whose light is that of all their chains, :math:`s^2 / K` with K - 1 degrees of freedom.

    Parameters
    ----------
    passes
        (K, ..., channel), K even.
    chains
        What the channels hold.
    """
    values = np.asarray(passes, dtype=np.float64)
    halves = values.reshape(2, len(values) // 2, *values.shape[1:]).mean(axis=1)
    of_band = np.array([[last_band(chain) == band for band in BAND_NAMES] for chain in chains], dtype=np.float64)
    variance = (values @ of_band).var(axis=0, ddof=1) / len(values)
    return PassedPicture(
        *(image.astype(np.float32) for image in (halves.mean(axis=0), 0.5 * (halves[0] - halves[1]), variance))
    )


def traced_picture(
    scene: Any,
    integrator: Any,
    renderer: ModuleType,
    chains: Sequence[str],
    regions: Sequence[tuple[NDArray[np.int64], int]],
    seed_of: Callable[[int], int],
) -> PassedPicture:
    """Trace a picture of the scene's camera by an integrator of a compiled variant.

    Parameters
    ----------
    scene, integrator, renderer
        The integrator's channels are `chains`; where it has ``divide_lanes``, each pass sees its own batch of what
        the walls emit.
    chains
        What the channels hold.
    regions
        Pixels (n, 2: column, row) and paths per pixel of each region. One does not change the noise of another.
    seed_of
        Returns the seed of each stream of random numbers by its number.
    """
    columns, rows = scene.sensors()[0].film().size()
    passes = passes_of(*(paths for _, paths in regions))
    picture = PassedPicture(
        *(np.zeros((rows, columns, n), dtype=np.float32) for n in (len(chains), len(chains), len(BAND_NAMES)))
    )
    most_lanes = _LANES[renderer.variant().partition("_")[0]]
    for number, (pixels, paths) in enumerate(regions):
        chunks = np.array_split(pixels, -(-len(pixels) * paths // most_lanes)) if len(pixels) else []
        for part, chunk in enumerate(chunks):
            lanes = _Lanes(chunk, (rows, columns), paths, passes)
            traced = lanes.traced(scene, integrator, renderer, seed_of(1 + number + len(regions) * part))
            for image, values in zip(picture, joined_passes(traced, chains), strict=True):
                image[chunk[:, 1], chunk[:, 0]] = values
    return picture._replace(band_variance=known_variance(picture.band_variance))


def known_variance(variance: FloatImage) -> FloatImage:
    """Return a variance image (rows, columns, band) with that of their neighbourhood where no path brought light.

    There all passes are alike, dark, and their own variance of 0 would claim that the pixel is known exactly.
    """
    around = cv2.blur(variance, (_AROUND_PX, _AROUND_PX), borderType=cv2.BORDER_REPLICATE)
    # its running sums may end a last digit below zero
    return np.where(variance > 0.0, variance, np.maximum(around, 0.0)).astype(np.float32)


class _Lanes(NamedTuple):
    """Pixels (n, 2: column, row) of a picture (rows, columns) whose paths are traced at once."""

    corners: NDArray[np.int64]
    shape: tuple[int, int]
    paths: int
    passes: int

    def traced(self, scene: Any, integrator: Any, renderer: Any, seed: int) -> NDArray[np.float32]:
        """Return the radiance of each pass, (passes, n, channel)."""
        import drjit as dr

        lanes = len(self.corners) * self.paths
        per_pixel, per_pass = (dr.opaque(renderer.UInt32, n) for n in (self.paths, self.paths // self.passes))
        rows, columns = (dr.opaque(renderer.Float, n) for n in self.shape)
        lane = dr.arange(renderer.UInt32, lanes)
        number = lane // per_pixel
        corner = LookupTable(self.corners.astype(np.float64), renderer).row(number)
        sampler = renderer.load_dict({"type": "independent"})
        sampler.seed(seed, lanes)
        jitter = sampler.next_2d()
        place = renderer.Point2f((corner.x + jitter.x) / columns, (corner.y + jitter.y) / rows)
        ray, weight = scene.sensors()[0].sample_ray_differential(0.0, 0.0, place, renderer.Point2f(0.5))
        divide = getattr(integrator, "divide_lanes", None)
        if divide is not None:
            divide((lane - number * per_pixel) // per_pass)
        radiance, _, further = integrator.sample(scene, sampler, ray)
        radiance *= weight
        channels = [radiance.x, radiance.y, radiance.z, *further]
        dr.eval(channels)
        if divide is not None:
            divide(dr.opaque(renderer.UInt32, 0))
        own = self.paths // self.passes
        # summed where they were traced: to bring all paths here from a GPU takes longer than to trace them
        values = np.stack([np.array(dr.block_sum(channel, own)) for channel in channels], axis=-1) / np.float32(own)
        return np.asarray(values.reshape(len(self.corners), self.passes, len(channels)).transpose(1, 0, 2))


SURROUNDINGS_SHARE = 8
"""Pixels that see neither coat nor walls get this many times fewer paths: nothing is measured there."""

CONTACT_REACH = 2.5
"""In half-widths of the contact: a comparison reaches to twice its half-width."""

RenderLevel = Level | Literal["c"]
"""A level of :data:`sim.optics.Level`, or c: fluorescence traced along each path, the reference."""


@dataclass(frozen=True, slots=True)
class CameraWindows:
    """The finger's camera, its pixels that see the pad, and those around contact and halo if it sees any."""

    design: FingerDesign
    calibration: CameraCalibration | None
    window: Window
    contact: Window | None

    @classmethod
    def of(
        cls, design: FingerDesign, calibration: CameraCalibration | None, maps: Sequence[PixelMaps]
    ) -> "CameraWindows":
        """Return the windows of a finger by what its pixels see without contact and with it."""
        near = maps[1].contact_distance <= CONTACT_REACH
        contact = Window.around(np.where(near, 0.0, np.nan)[..., None]) if near.any() else None
        return cls(design, calibration, Window.around(*(m.coat_mm(design) for m in maps)), contact)

    def regions(self, settings: "RenderSettings") -> list[tuple[NDArray[np.int64], int]]:
        """Return (column, row) of the surroundings' pixels, the pad's and the contact's, with the paths of each."""
        pose = camera_pose(self.design)
        region = np.zeros((pose.rows_px, pose.columns_px), dtype=np.int64)
        region[self.window.rows, self.window.columns] = 1
        if self.contact is not None:
            region[self.contact.rows, self.contact.columns] = 2
        counts = (settings.surroundings, settings.on_pad, settings.around_contact)
        return [(np.argwhere(region == k)[:, ::-1], count) for k, count in enumerate(counts)]


SHARED_SHARE = 8
"""Where pixels share light, one path from the camera takes the place of so many."""

CONTACT_SHARE = 2
"""Pixels near the contact get this many times more paths by default: comparisons look there, and they are few."""


@dataclass(frozen=True, slots=True)
class RenderSettings:
    """How a press is rendered.

    Attributes
    ----------
    level
        How the walls emit. Level c needs a compiled variant.
    seed
        Random seed, >= 0.
    samples_per_pixel
        Paths per pixel that sees the pad, an even number >= 2, in as many passes as it and the next number divide
        into: 16, 8, 4 or 2. The surroundings get about an eighth, at least one path of each pass.
    contact_samples_per_pixel
        Paths per pixel of the rectangle around the contact and its halo, an even number; by default twice those
        of the pad.
    common_random_numbers
        Whether both images use the same random numbers, so that their difference away from the contact is small.
        What stands for a capture needs noise of its own in each image, as cameras have it.
    shared_light
        Whether pixels share the light that reaches the coat (:class:`sim.optics._shared_gathers.SharedGathers`). One
        path from the camera then weighs many shared ones and stands for :data:`SHARED_SHARE` of the numbers above.
        Needs a compiled variant; not for level c.

    Raises
    ------
    SimulateError
        When a number of paths cannot be halved.
    """

    level: RenderLevel = "b"
    seed: int = 0
    samples_per_pixel: int = 64
    contact_samples_per_pixel: int | None = None
    common_random_numbers: bool = True
    shared_light: bool = False

    def __post_init__(self) -> None:
        """Refuse numbers that cannot be halved."""
        for name in ("samples_per_pixel", "contact_samples_per_pixel"):
            count = getattr(self, name)
            if count is not None and (count < 2 or count % 2):
                raise SimulateError(
                    f"{name} must be an even number of at least 2 (two independent halves), got {count}"
                )
        if self.shared_light and self.level == "c":
            raise SimulateError(
                "level c cannot share light between pixels, because it follows fluorescence along each path; use level "
                "b"
            )

    @property
    def on_pad(self) -> int:
        """Paths per pixel that sees the pad."""
        return self._shared(self.samples_per_pixel)

    @property
    def around_contact(self) -> int:
        """Paths per pixel around the contact."""
        return self._shared(self.contact_samples_per_pixel or CONTACT_SHARE * self.samples_per_pixel)

    @property
    def passes(self) -> int:
        """Independent passes that the paths divide into."""
        return passes_of(self.on_pad, self.around_contact)

    @property
    def surroundings(self) -> int:
        """Paths per pixel that sees neither coat nor walls: nothing is measured there."""
        return self.passes * max(1, round(self.on_pad / (SURROUNDINGS_SHARE * self.passes)))

    def _shared(self, paths: int) -> int:
        """Return how many paths there are from the camera: few, where they share what they gather."""
        return MOST_PASSES * max(1, round(paths / (SHARED_SHARE * MOST_PASSES))) if self.shared_light else paths

    def of_contact(self) -> "RenderSettings":
        """Return the same for the image with contact, whose random numbers may be its own."""
        return self if self.common_random_numbers else replace(self, seed=stream_seed(self.seed, _CONTACT_STREAM))


@dataclass(frozen=True, slots=True)
class StateRender:
    """The finger without or with contact: its chains, their picture in passes, seconds of bake and paths."""

    chains: tuple[str, ...]
    picture: PassedPicture
    bake_s: float
    render_s: float


def render_state(
    camera: CameraWindows, shape: FingerShape, bands: PaintBands, renderer: ModuleType, settings: RenderSettings
) -> StateRender:
    """Render independent passes, each with its own batch of the walls' light; what they differ by tells the noise."""
    begun, design = time.monotonic(), camera.design
    scene = open_scene(design, shape, bands, renderer, camera_sensor(design, renderer, camera.calibration))
    scalar, light = renderer.variant() == SCALAR_VARIANT, {}
    chains: tuple[str, ...]
    if settings.level == "c":
        integrator, chains = pathwise_integrator(scene, design, shape, bands, renderer), FIRST_CHAINS
    else:
        guide, seed = open_guide(scene, design, shape, renderer), stream_seed(settings.seed, 0)
        finger = LoadedScene(scene, design, shape, bands, renderer)
        received = led_irradiance(finger, seed, BAKE_SAMPLES[scalar], guide)
        batches = bake_batches(finger, settings.level, seed, BAKE_SAMPLES[scalar], guide, received)
        light = {chain: _in_passes(of_chain, settings.passes) for chain, of_chain in batches.items()}
        if settings.shared_light:
            integrator = _shared_gathers(finger, camera, batches, received, guide, settings.seed)
            chains = integrator.chains
        else:
            integrator, chains = lit_integrator(scene, design, shape, renderer, {} if scalar else light, guide)
    bake_s = time.monotonic() - begun
    if scalar:
        picture = _scalar_picture(scene, camera, renderer, light, settings)
    else:
        seed_of = partial(stream_seed, settings.seed)
        picture = traced_picture(scene, integrator, renderer, chains, camera.regions(settings), seed_of)
    return StateRender(chains, picture, bake_s, time.monotonic() - begun - bake_s)


def _shared_gathers(
    finger: LoadedScene, camera: CameraWindows, light: WallLight, received: WallLight, guide: Any, seed: int
) -> Any:
    """Return what renders pixels that share light, each batch of it with its own batch of the walls' light."""
    from sim.optics._shared_gathers import SharedGathers  # needs the variant set

    reflected = reflected_light(finger, light, received, stream_seed(seed, REFLECTED_STREAM))
    nodes_seed = stream_seed(seed, NODES_STREAM)
    return SharedGathers(finger, light, reflected, guide, nodes_seed, camera.calibration)


def _in_passes(batches: NDArray[np.float64], passes: int) -> NDArray[np.float64]:
    """Return batches (batch, ...) joined to as many as there are passes."""
    return np.asarray(batches.reshape(passes, -1, *batches.shape[1:]).mean(axis=1))


def _scalar_picture(
    scene: Any, camera: CameraWindows, renderer: ModuleType, light: WallLight, settings: RenderSettings
) -> PassedPicture:
    """Render each pass by the scene's own integrator, the windows finely."""
    seeds, images = (stream_seed(settings.seed, stream) for stream in counting(1)), []
    windows = ((camera.window, settings.samples_per_pixel), (camera.contact, settings.around_contact))
    for number in range(settings.passes):
        light_walls(scene, {chain: batches[number] for chain, batches in light.items()}, renderer)
        image = np.array(renderer.render(scene, spp=settings.surroundings // settings.passes, seed=next(seeds)))
        for window, count in windows:
            if window is not None:
                sensor = renderer.load_dict(camera_sensor(camera.design, renderer, camera.calibration, window))
                fine = renderer.render(scene, sensor=sensor, spp=count // settings.passes, seed=next(seeds))
                image[window.rows, window.columns] = np.array(fine)
        images.append(image)
    mean, half_difference, variance = joined_passes(np.array(images), FIRST_CHAINS)
    return PassedPicture(mean, half_difference, known_variance(variance))


# beside the streams of bake and pixels, which count from zero
_CONTACT_STREAM = 100
REFLECTED_STREAM, NODES_STREAM = 1_000_000, 1_000_001

# a bent finger at rest would be shorter; meshes keep their size to rounding
_SIZE_TOLERANCE_REL = 0.02

Progress = Callable[[int, int, str], None]
"""Called with the number of finished steps, of all steps, and what was done."""


@dataclass(frozen=True, slots=True)
class PressRender:
    """Band images of a finger without and with a press.

    Images are (rows, columns, 3 bands: red emission, green emission, LED), radiance in units of the panel's;
    ``*_chains`` hold the same light apart, per chain of fluorescence in the order of ``chains``: the mean of two
    independent halves, and ``*_half_difference`` half their difference, so that mean + and - it are the halves.
    ``*_variance`` is the variance of the mean of the bands, from up to 16 passes: with K of them it has K - 1 degrees
    of freedom. Each pass sees its own batch of the baked walls, so both hold the bake's noise too; that part is common
    to all pixels and does not average out over an area. (In a scalar variant the batches of light that one paint
    excites in another share their noise, which is then not in the variance.) ``*_maps`` is what each pixel sees,
    ``contact_label`` where the pressed shape comes from.
    """

    no_contact_bands: NDArray[np.float32]
    contact_bands: NDArray[np.float32]
    chains: tuple[str, ...]
    no_contact_chains: NDArray[np.float32]
    contact_chains: NDArray[np.float32]
    no_contact_half_difference: NDArray[np.float32]
    contact_half_difference: NDArray[np.float32]
    no_contact_variance: NDArray[np.float32]
    contact_variance: NDArray[np.float32]
    no_contact_maps: PixelMaps
    contact_maps: PixelMaps
    contact_label: str
    bands: PaintBands
    samples_per_pixel: int
    seed: int
    timings_s: Mapping[str, float]
    variant: str
    level: RenderLevel
    label: str

    @property
    def chains_apart(self) -> bool:
        """Whether ``*_chains`` hold each chain; else all chains of a band stand together under its first."""
        return self.level != "c" and self.variant != SCALAR_VARIANT


def render_press(
    design: FingerDesign,
    paints: Mapping[str, PaintOptics],
    renderer: ModuleType,
    settings: RenderSettings | None = None,
    *,
    shapes: tuple[FingerShape, FingerShape] | None = None,
    calibration: CameraCalibration | None = None,
    progress: Progress | None = None,
) -> PressRender:
    """Render a finger without and with its press.

    The same seed gives the same images.

    Parameters
    ----------
    design
        The finger; without `shapes` its indenter is pressed in analytically.
    paints
        Optics of the paints "red" (x = -width/2) and "green" (x = +width/2).
    renderer
        From :func:`sim.optics.open_renderer`.
    settings
        Level, seed and numbers of paths.
    shapes
        The finger without and with contact, equal meshes.
    calibration
        Of the camera; without it the ideal pinhole of the design.
    progress
        Called after each step.

    Raises
    ------
    SimulateError
        When a paint is missing, a paint gains energy, the gel intersects itself, the camera does not see the coat, or
        level c meets a scalar variant.
    """
    settings = settings or RenderSettings()
    _check_scalar(design, renderer, settings)
    start = time.monotonic()
    bands = check_paints(design, paints)
    rest, pressed = shapes or (rest_shape(design), pressed_shape(design))
    _check_size(design, rest)
    for shape in (rest, pressed):
        check_apart(shape, is_analytic=shapes is None or shape.is_apart)
    maps = [pixel_maps(design, shape, rest, renderer, calibration) for shape in (rest, pressed)]
    timings = {"pixel maps": time.monotonic() - start}
    camera = CameraWindows.of(design, calibration, maps)
    states, both = [], (("no contact", rest, settings), ("contact", pressed, settings.of_contact()))
    for step, (name, shape, own) in enumerate(both, start=1):
        states.append(render_state(camera, shape, bands, renderer, own))
        timings |= {f"bake {name}": states[-1].bake_s, f"render {name}": states[-1].render_s}
        if progress is not None:
            progress(step, 2, f"rendered {name}")
    timings["total"] = time.monotonic() - start
    chains = tuple(dict.fromkeys(chain for state in states for chain in state.chains))
    variant = renderer.variant()
    return PressRender(
        **_images("no_contact", states[0], chains, maps[0]),
        **_images("contact", states[1], chains, maps[1]),
        chains=chains,
        contact_label=pressed.label,
        bands=bands,
        samples_per_pixel=settings.samples_per_pixel,
        seed=settings.seed,
        timings_s=timings,
        variant=variant,
        level=settings.level,
        label=f"rendered, {_level_name(settings.level)}, {variant}{_left_out(design, variant)}{_shared(settings)}",
    )


def _level_name(level: RenderLevel) -> str:
    return "level c" if level == "c" else LEVEL_NAMES[level]


def _left_out(design: FingerDesign, variant: str) -> str:
    """Say what Mitsuba's own integrators, which a scalar variant needs, cannot render."""
    return ", without the film" if variant == SCALAR_VARIANT and design.pad.film is not None else ""


def check_apart(shape: FingerShape, is_analytic: bool) -> None:
    """Refuse a gel that passes through itself.

    An analytic coat is a height over the plane of the inner face, and meets nothing while it stays above it. Other
    shapes are searched, which takes longer than a small picture.
    """
    if not is_analytic or shape.surfaces["coat"].vertices_mm[:, 1].min() <= 0.0:
        check_no_intersections(shape.gel)


def _shared(settings: RenderSettings) -> str:
    """Say that pixels share light: their noise has a part that is common to neighbours."""
    return ", pixels share light" if settings.shared_light else ""


def _check_size(design: FingerDesign, rest: FingerShape) -> None:
    """Refuse surfaces of another finger: their coordinates would be read with this one's sizes."""
    extent = np.ptp(rest.surfaces["coat"].vertices_mm, axis=0)
    for name, size, meshed in (("width", design.pad.width_mm, extent[0]), ("length", design.pad.length_mm, extent[2])):
        if abs(meshed - size) > _SIZE_TOLERANCE_REL * size:
            raise SimulateError(
                f"the surfaces belong to another finger, because their pad has a {name} of {meshed:.3g} mm and the "
                f"design's pad.{name}_mm is {size:g} mm; press this design again, and render the surfaces of that press"
            )


def _check_scalar(design: FingerDesign, renderer: ModuleType, settings: RenderSettings) -> None:
    """Refuse what a scalar variant would render wrongly."""
    if renderer.variant() == SCALAR_VARIANT and settings.shared_light:
        raise SimulateError(
            "--shared-light needs a compiled variant of Mitsuba; install LLVM 17 or newer, or leave --shared-light out"
        )
    if renderer.variant() == SCALAR_VARIANT and any(light.beam_exponent != 1.0 for light in design.lights):
        raise SimulateError(
            "light.beam_exponent: a scalar variant supports only Lambertian panels (beam_exponent = 1); set "
            "beam_exponent to 1, or install LLVM 17 or newer"
        )


def _images(name: str, state: StateRender, chains: tuple[str, ...], maps: PixelMaps) -> dict[str, Any]:
    """Return the fields of a render that belong to one state; `chains` are those of both."""
    mean, half_difference = (
        _in_order(image, state.chains, chains) for image in (state.picture.mean, state.picture.half_difference)
    )
    of_band = np.array([[last_band(chain) == band for band in BAND_NAMES] for chain in chains], dtype=np.float32)
    return {
        f"{name}_bands": np.asarray(mean @ of_band),
        f"{name}_chains": mean,
        f"{name}_half_difference": half_difference,
        f"{name}_variance": state.picture.band_variance,
        f"{name}_maps": maps,
    }


def _in_order(image: NDArray[np.float32], chains: Sequence[str], wanted: Sequence[str]) -> NDArray[np.float32]:
    """Return an image (rows, columns, chain) with other chains, dark where it has them not."""
    dark = np.zeros(image.shape[:2], dtype=np.float32)
    return np.stack([image[..., chains.index(c)] if c in chains else dark for c in wanted], axis=-1)


def check_paints(design: FingerDesign, paints: Mapping[str, PaintOptics]) -> PaintBands:
    """Return the bands of the two paints of a finger.

    Raises
    ------
    SimulateError
        When "red" or "green" is missing.
    """
    missing = {"red", "green"} - paints.keys()
    if missing:
        raise SimulateError(f"paints must contain 'red' and 'green', but {', '.join(sorted(missing))} is missing")
    return paint_bands(paints["red"], paints["green"], design.light)


def stream_seed(seed: int, stream: int) -> int:
    """Return the renderer's 32-bit seed of one of several independent random streams."""
    return int(np.random.SeedSequence((seed, stream)).generate_state(1)[0])


def open_scene(
    design: FingerDesign,
    shape: FingerShape,
    bands: PaintBands,
    renderer: ModuleType,
    sensor: Mapping[str, Any] | None = None,
) -> Any:
    """Return a scene whose walls can be lit with :func:`lit_integrator`."""
    # the band path tracer looks the walls' light up itself; Mitsuba's own integrators need emitters
    emission = unbaked_walls() if renderer.variant() == SCALAR_VARIANT else None
    return finger_scene(design, shape, bands, renderer, emission, sensor)


def open_guide(scene: Any, design: FingerDesign, shape: FingerShape, renderer: ModuleType) -> Any:
    """Return the :class:`sim.optics._mirror_guide.MirrorGuide` of a scene; None in a scalar variant, which has none."""
    if renderer.variant() == SCALAR_VARIANT:
        return None
    from sim.optics._band_paths import mirror_guide  # needs the variant set

    return mirror_guide(scene, design, shape)


def lit_integrator(
    scene: Any, design: FingerDesign, shape: FingerShape, renderer: ModuleType, light: WallLight, guide: Any = None
) -> tuple[Any, tuple[str, ...]]:
    """Return what renders a scene with lit walls, and the chains that its channels hold.

    With a guide (:func:`open_guide`) the LED's light has less noise. In a scalar variant this is the scene's own
    ``path``: its channels are the bands, all chains of a band together.
    """
    if renderer.variant() == SCALAR_VARIANT:
        light_walls(scene, light, renderer)
        return scene.integrator(), FIRST_CHAINS
    from sim.optics._band_paths import band_integrator  # needs the variant set

    integrator = band_integrator(scene, design, shape, light, guide=guide)
    return integrator, integrator.chains


def pathwise_integrator(
    scene: Any, design: FingerDesign, shape: FingerShape, bands: PaintBands, renderer: ModuleType
) -> Any:
    """Return the integrator of level c; its channels are the bands, all chains of a band together."""
    if renderer.variant() == SCALAR_VARIANT:
        raise SimulateError("level c needs a compiled variant of Mitsuba; install LLVM 17 or newer, or use --level b")
    from sim.optics._band_paths import band_paths  # these need the variant set
    from sim.optics._fluorescent_paths import fluorescent_bands

    panels = band_paths(scene, design, shape)
    return fluorescent_bands(scene, {wall: bands.matrix(wall) for wall in WALLS}, panels=panels)
