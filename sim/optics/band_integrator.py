"""The band path tracer of a finger's scene, and the renderer's handle on it.

Import this module only after a compiled variant has been set (see :mod:`sim.optics.variants`): integrators written in
Python do not run in scalar variants, which use Mitsuba's own ``path`` instead.
"""

from collections.abc import Mapping
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from sim.optics.gel_face import inner_face
from sim.optics.mirror_guide import MirrorGuide, learn_guide
from sim.optics.panel_light import panels_of
from sim.optics.path_rules import MAX_DEPTH
from sim.optics.paths import BandPaths
from sim.optics.wall_emission import FIRST_CHAINS
from sim.surface_meshes.finger_shape import FingerShape


def band_paths(
    scene: Any,
    design: FingerDesign,
    shape: FingerShape,
    emission: Mapping[str, NDArray[np.float64]] | None = None,
    refractive: bool = True,
    max_depth: int = MAX_DEPTH,
    from_wall: bool = False,
    with_led: bool = True,
    guide: MirrorGuide | None = None,
) -> BandPaths:
    """Return the path tracer of a scene, whose channels are its ``chains``.

    Parameters
    ----------
    scene
        From :func:`sim.optics.scene.finger_scene`; emitters of its walls are not looked at.
    design, shape
        Panels, pad and the shape of the inner face.
    emission
        What the walls emit per chain, see :data:`sim.optics.wall_emission.WallLight`; dark by default.
    refractive
        False leaves the panel to chance: the same mean, much more noise; it serves as a check.
    max_depth
        Longest path in surfaces; below 30 the painted bands lose light.
    from_wall
        Rays start on a wall in the gel: the panel's direct light through the inner face is left out.
    with_led
        False leaves the panels dark.
    guide
        From :func:`mirror_guide` for this scene: the same mean, less noise of the LED's light.
    """
    face = inner_face(design, shape)
    paths = BandPaths(scene, panels_of(design, face), face, max_depth, from_wall)
    paths.refractive, paths.with_led = refractive, with_led
    paths.emit(emission or {})
    paths.guide = guide if with_led else None
    return paths


def band_integrator(
    scene: Any,
    design: FingerDesign,
    shape: FingerShape,
    emission: Mapping[str, NDArray[np.float64]] | None = None,
    **options: Any,
) -> Any:
    """Return the same as an integrator of the renderer, which has the ``chains`` too; options are those of the paths.

    Its first three channels are the chains led>red, led>green and led, the others ``aov_names()``.
    """
    paths = band_paths(scene, design, shape, emission, **options)

    class BandIntegrator(mi.SamplingIntegrator):
        """The renderer's handle on the paths; a class of the variant that is set, for others refuse it."""

        chains = paths.chains

        def sample(  # type: ignore[no-untyped-def]
            self, scene, sampler, ray, medium=None, active=True
        ):
            """Return the radiance of the chains along rays (called by the renderer)."""
            return paths.sample(scene, sampler, ray, medium, active)  # type: ignore[no-untyped-call]

        def aov_names(self) -> list[str]:
            """Return the names of the channels beyond the first three chains."""
            return list(paths.chains[len(FIRST_CHAINS) :])

    return BandIntegrator(mi.Properties())


def mirror_guide(scene: Any, design: FingerDesign, shape: FingerShape) -> MirrorGuide:
    """Return where the coating of a finger sees its panels by the mirror; for all integrators of this scene."""
    return learn_guide(scene, band_paths(scene, design, shape))
