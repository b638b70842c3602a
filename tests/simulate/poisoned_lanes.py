"""Child process of test_poisoned_lanes.py: look-ups of lanes that hold NaN, infinities and numbers without an integer.

python -m tests.simulate.poisoned_lanes rgb|spectral|paths [PROCESSOR]
"""

import ctypes
import sys
from pathlib import Path
from types import SimpleNamespace

import drjit as dr
import numpy as np

from data_schemas import CameraCalibration, FingerDesign
from data_schemas._design_parts import TactileCamera
from sim.optics import (
    FIRST_CHAINS,
    TEXELS_ALONG,
    LoadedScene,
    PaintOptics,
    choose_variant,
    open_renderer,
    open_scene,
    paint_bands,
)
from sim.optics._calibrated_camera import opencv_sensor
from sim.optics._mirror_guide import CELLS_ACROSS, CELLS_ALONG, NUMBERS, ROUTES
from sim.optics._painted_walls import TEXELS_UP
from sim.optics._path_rules import EventLog, LookupTable, Tally, cell_at
from sim.optics._position_map import PositionMap
from sim.optics._render import pathwise_integrator
from sim.surface_meshes import bent, rest_shape
from tests.simulate.spectral_paths import FluorescentPaint

LANES = 20_000
POISON = np.array([np.nan, np.inf, -np.inf, 1e30, -1e30, 4.3e9, -1.0, 0.5], dtype=np.float32)
NUMBERS_OUTSIDE = np.array([0, 1, 2**31 - 1, 2**31, 2**32 - 39, 2**32 - 1], dtype=np.uint32)
DESIGN = FingerDesign(camera=TactileCamera(width_px=64, height_px=48))
SHAPE = bent(rest_shape(DESIGN), 80.0)
DARK = np.zeros(351)
PAINTS = [PaintOptics(name, np.arange(400.0, 751.0), DARK + 1e-3, DARK + 0.3) for name in ("red", "green")]


def compile_for(processor):
    """Compile for another processor than this one: what a cast of NaN gives depends on it."""
    library = ctypes.CDLL(str(Path(dr.__file__).with_name("libdrjit-core.so")))
    set_target = library["_Z19jit_llvm_set_targetPKcS0_j"]
    set_target.argtypes, set_target.restype = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_uint32], None
    set_target(processor.encode(), b"", 8)


class Poisoned:
    """Lanes of poison in place of what the renderer gives; also a sampler."""

    def __init__(self, renderer):
        self.renderer, self.rng = renderer, np.random.default_rng(5)

    def next_1d(self, active=True):
        return self.renderer.Float(self.rng.choice(POISON, LANES))

    def next_2d(self, active=True):
        return self.renderer.Point2f(self.next_1d(), self.next_1d())

    def next_3d(self):
        return self.renderer.Point3f(self.next_1d(), self.next_1d(), self.next_1d())

    def number(self):
        return self.renderer.UInt32(self.rng.choice(NUMBERS_OUTSIDE, LANES))

    def either(self):
        return self.renderer.Bool(self.rng.random(LANES) < 0.5)

    def rays(self):
        return self.renderer.Ray3f(self.next_3d(), self.renderer.Vector3f(self.next_3d()))

    def interaction(self, scene):
        """All that an interaction of a ray which met nothing may hold."""
        mi = self.renderer
        si = scene.ray_intersect(mi.Ray3f(mi.Point3f(0.0, 0.5, self.next_1d()), mi.Vector3f(0.0, 1.0, 0.0)))
        si.uv, si.p, si.wi = self.next_2d(), self.next_3d(), mi.Vector3f(self.next_3d())
        return si


def tables(lanes, _scene):
    """The door itself: places, and numbers that lie outside."""
    mi = lanes.renderer
    table, tally, log = LookupTable(np.ones((5, 4)), mi), Tally(5, mi), EventLog(5, 1, 1, mi)
    log.add([lanes.number(), lanes.next_1d()], lanes.either())
    tally.add(mi.Float(1.0), lanes.number())
    tally.add(mi.Float(1.0), cell_at(lanes.next_1d(), 5), lanes.either())
    return [table.row(lanes.number()), table.row(cell_at(lanes.next_1d(), 5), lanes.either()), tally.sums, *log.columns]


def position_map(lanes, _scene):
    """Points of a bent face."""
    face = PositionMap.of(SHAPE.surfaces["inner"])
    assert not face.is_plane
    return list(face.in_renderer(lanes.renderer)(lanes.next_1d(), lanes.next_1d()))


def walls(lanes, scene):
    """What known walls send, and what is noted of paths that met them."""
    from sim.optics._band_paths import WallGlow, WallTexels, band_paths

    mi, texels = lanes.renderer, (2, TEXELS_ALONG, TEXELS_UP)
    paths = band_paths(scene, DESIGN, SHAPE, {chain: np.ones(texels[1:]) for chain in FIRST_CHAINS[:2]})
    si, green, throughput = SimpleNamespace(uv=lanes.next_2d()), lanes.either(), mi.Color3f(lanes.next_3d())
    found = paths.wall_radiance(si, green, mi.Bool(True))
    glow = WallGlow(np.ones((3, *texels)), LANES)
    log = EventLog(LANES, 3, 3, mi)
    noted = WallTexels(Tally(4 * int(np.prod(texels)), mi), log, dr.arange(mi.UInt32, LANES), lanes.number())
    for tally in (glow, noted):
        tally.met(si, green, throughput, lanes.number(), mi.Bool(True))
    return [*found, glow.radiance.sums, noted.by_wall.sums, *log.columns]


def mirror_guide(lanes, _scene):
    """Directions in which the coating sees the panels."""
    from sim.optics._mirror_guide import MirrorGuide

    guide = MirrorGuide(np.ones((CELLS_ACROSS * CELLS_ALONG, ROUTES, NUMBERS)))
    lobes = guide.lobes(SimpleNamespace(uv=lanes.next_2d()), lanes.renderer.Bool(True))
    drawn = guide.direction(lobes, lanes.next_1d(), lanes.next_2d())
    return [drawn, guide.density(lobes, drawn), guide.known(lobes)]


def shared_light(lanes, scene):
    """Radiance and points of lit walls, and the nodes that stand for places of the coat."""
    from sim.optics._shared_gathers import LitWalls, Nodes

    mi, everywhere = lanes.renderer, lanes.renderer.Bool(True)
    lit = LitWalls(np.ones((3, 2, TEXELS_ALONG, TEXELS_UP, 5)), SHAPE, 6.0, 70.0)
    seen = lit.at(SimpleNamespace(uv=lanes.next_2d()), lanes.either(), lanes.number(), everywhere)
    point, du, dv = lit.place(1, lanes.next_1d(), lanes.next_1d(), everywhere)
    aimed = list(lit.aim(scene, lanes.interaction(scene), 0, [lanes.next_1d() for _ in range(3)], everywhere))[:3]
    nodes = Nodes(LoadedScene(scene, DESIGN, SHAPE, BANDS, mi), np.full((1, 2), 0.5), np.eye(3)[1:2])
    near = nodes.near(lanes.next_2d(), [lanes.next_1d() for _ in range(2)])
    around = nodes.around(lanes.next_2d())
    return [
        *seen,
        point,
        du,
        dv,
        *aimed,
        LookupTable(np.ones((9, 4)), mi).row(near),
        sum(weight * LookupTable(np.ones((9, 4)), mi).row(number) for weight, number in around),
        nodes.seen(scene, lanes.number()).p,
    ]


def connections(lanes, scene):
    """Points joined to a panel through the inner face, and emitters and materials asked at unwritten places."""
    from sim.optics._band_paths import band_paths

    mi = lanes.renderer
    paths, si = band_paths(scene, DESIGN, SHAPE), lanes.interaction(scene)
    everywhere = mi.Bool(True)
    seen = list(paths.connect(scene, si, lanes.next_2d(), everywhere))
    value, pdf = si.bsdf().eval_pdf(mi.BSDFContext(), si, mi.Vector3f(lanes.next_3d()), everywhere)
    return [*seen, value, pdf, si.emitter(scene).eval(si, everywhere)]


def painted_bands(lanes, _scene):
    """Matrices of paints."""
    from sim.optics._fluorescent_paths import BandCarrier

    carrier = BandCarrier([np.eye(3)] * 2)
    return carrier.reradiated(carrier.start(), None, lanes, lanes.number(), lanes.renderer.Bool(True))


def camera(lanes, _scene):
    """Rays of a calibrated camera."""
    mi = lanes.renderer
    lens = CameraCalibration(
        model="pinhole", width_px=64, height_px=48, focal_px=(31.0, 31.0), centre_px=(31.5, 23.5),
        distortion=(-0.28, 0.11, 0.001, -0.002, -0.01), source="lens.yaml",
    )  # fmt: skip
    film = {"type": "hdrfilm", "width": 64, "height": 48, "rfilter": {"type": "box"}}
    sensor = mi.load_dict(opencv_sensor(lens, mi.ScalarTransform4f(), film, mi))
    ray, weight = sensor.sample_ray(lanes.next_1d(), lanes.next_1d(), lanes.next_2d(), lanes.next_2d(), True)
    return [ray.o, ray.d, weight]


def whole_paths(lanes, scene):
    """Paths of each tracer that start at poisoned points in poisoned directions."""
    from sim.optics._angle_paths import AnglePaths
    from sim.optics._band_paths import band_integrator
    from sim.optics._band_paths import mirror_guide as learned

    mi, found = lanes.renderer, []
    guide = learned(scene, DESIGN, SHAPE)
    for tracer in (
        band_integrator(scene, DESIGN, SHAPE, guide=guide),
        pathwise_integrator(scene, DESIGN, SHAPE, BANDS, mi),
    ):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1, LANES)
        radiance, valid, further = tracer.sample(scene, sampler, lanes.rays(), None, mi.Bool(True))
        found += [radiance, valid, *further]
    other = open_scene(DESIGN, SHAPE, BANDS, mi)  # its panels are moved away
    angles = AnglePaths(other, DESIGN, SHAPE, [DESIGN.light.model_copy(update={"angle_deg": a}) for a in (0.0, 50.0)])
    origins, ways = (lanes.rng.choice(POISON, (LANES, 3)) for _ in range(2))
    angles.arriving(origins, ways, np.ones((2, 2, TEXELS_ALONG, TEXELS_UP)), 1)
    angles.straight(origins, ways, 100, 1)
    angles.trace(origins, ways, 100, 1, from_wall=True)
    return found


def painted_spectra(lanes, _scene):
    """Tables of paints and lights at poisoned wavelengths and places."""
    from sim.optics._scene import RENDERED_NM
    from tests.simulate.spectral_paths import SpectralCarrier

    mi = lanes.renderer
    grid = np.linspace(*RENDERED_NM, 471)
    paint = FluorescentPaint("paint", grid, *np.full((3, grid.size), 1e-3))
    carrier = SpectralCarrier([paint] * 2, np.ones(grid.size))
    wavelengths = mi.Spectrum(*[lanes.next_1d() for _ in range(4)])
    si = SimpleNamespace(wavelengths=mi.Spectrum(wavelengths))
    light = carrier.panel_light(si, lanes.next_1d())
    carried = carrier.reradiated(carrier.start(), si, lanes, lanes.number(), mi.Bool(True))
    return [light, carried, si.wavelengths]


BANDS = paint_bands(*PAINTS, DESIGN.light)
# how often: compiling the last two takes most of the time
TIMES = {
    "rgb": {
        tables: 10,
        position_map: 10,
        walls: 10,
        mirror_guide: 10,
        painted_bands: 10,
        camera: 10,
        shared_light: 2,
        connections: 2,
    },
    "spectral": {painted_spectra: 10},
    "paths": {whole_paths: 1},
}


def main(lookups, processor=None):
    renderer = open_renderer(choose_variant("llvm", spectral=lookups == "spectral"))
    if processor is not None:
        compile_for(processor)
    # the renderer's own check of every gather and scatter: it writes "out-of-bounds"
    dr.set_flag(dr.JitFlag.Debug, True)
    lanes = Poisoned(renderer)
    scene = None if lookups == "spectral" else open_scene(DESIGN, SHAPE, BANDS, renderer)
    for lookup, times in TIMES[lookups].items():
        sys.stderr.write(f"{lookup.__name__}\n")
        for _ in range(times):
            # a plain list: the renderer evaluates no tuple with names, and says nothing
            found = lookup(lanes, scene)
            assert type(found) is list
            dr.eval(found)
            dr.sync_thread()
    sys.stdout.write("ended well\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
