"""Ready-made fingers: the paper's family of sizes and shapes of gel pads.

The paper gives length and width of the pads (but for the original finger), the thickness of film and mirror, the
camera's field of view, the indenter and the constants of the materials. Radii, semi-axes, other thicknesses and all
dimensions of the skeletons it does not give; they are assumed, and so not listed in ``origin``.
"""

from collections.abc import Callable
from functools import partial
from typing import Final

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.gel_pad import Film, GelPad
from data_schemas.indenter import Indenter
from data_schemas.mechanical_design import Backing, Skeleton
from data_schemas.optical_design import LightPanel

# the panel at the tip, a mirror image of the one at the base
_LIGHT_AT_THE_TIP: Final = LightPanel(angle_deg=150.0, position_mm=(0.0, -4.0, 71.0))


_STIFF: Final = Skeleton(backing=Backing())
# the paper: thinner ribs
_SOFT: Final = Skeleton(rib_thickness_mm=0.8, backing=Backing())
_SMALL: Final = Skeleton(
    tip_length_mm=4.0,
    base_thickness_mm=4.0,
    front_fin_thickness_mm=1.2,
    back_fin_thickness_mm=1.2,
    rib_thickness_mm=0.9,
    rib_width_mm=2.0,
    backing=Backing(to_z_mm=40.0),
)
_ORIGINAL: Final = Skeleton(backing=None)
# like a box: the mirror ends with the pad, where the fins are still far apart
_WIDE: Final = Skeleton(
    tip_starts_mm=54.0,
    front_fin_thickness_mm=2.0,
    back_fin_thickness_mm=2.0,
    rib_count=4,
    rib_thickness_mm=1.6,
    rib_width_mm=4.0,
    backing=Backing(to_z_mm=45.0),
)
_NOMINAL_LENGTH_MM: Final = 70.0
_PAD_SIZE: Final = ("pad.length_mm", "pad.width_mm")


def _design(
    name: str,
    pad: GelPad,
    second_light: LightPanel | None = None,
    skeleton: Skeleton = _STIFF,
    assumed: tuple[str, ...] = (),
) -> FingerDesign:
    """Return a finger with the indenter on the middle of its pad and a light that grows with the finger."""
    indenter = Indenter(position_mm=pad.length_mm / 2.0)
    size = min(1.0, pad.length_mm / _NOMINAL_LENGTH_MM)
    light = LightPanel(position_mm=(0.0, -10.0 * size, -1.0 * size), width_mm=20.0 * size, height_mm=4.0 * size)
    design = FingerDesign(
        name=name, pad=pad, light=light, indenter=indenter, second_light=second_light, skeleton=skeleton
    )
    without = {*assumed, *(() if pad.film is not None else ("pad.film.thickness_mm",))}
    origin = {field: where for field, where in design.origin.items() if field not in without}
    return design.model_copy(update={"origin": origin})


def _ellipsoidal(semi_axes_mm: tuple[float, float, float]) -> GelPad:
    """Return a pad cast in a printed mould, which takes no film."""
    return GelPad(shape="ellipsoidal", semi_axes_mm=semi_axes_mm)


PRESETS: Final[dict[str, tuple[str, Callable[[str], FingerDesign]]]] = {
    "flat-70x35": ("the paper's finger for grasping, flat pad, stiff", lambda n: _design(n, GelPad(film=Film()))),
    "flat-70x35-soft": (
        "the same with thinner ribs",
        lambda n: _design(n, GelPad(film=Film()), skeleton=_SOFT),
    ),
    "flat-70x35-two-lights": (
        "the same with a second panel at the tip",
        lambda n: _design(n, GelPad(film=Film()), _LIGHT_AT_THE_TIP),
    ),
    "original-60x22": (
        "the original GelSight Fin Ray, without backing; the paper does not give its pad's size (assumed)",
        lambda n: _design(
            n,
            GelPad(length_mm=60.0, width_mm=22.0, thickness_mm=4.0, film=Film()),
            skeleton=_ORIGINAL,
            assumed=_PAD_SIZE,
        ),
    ),
    "baby-48x18": (
        "GelSight Baby Fin Ray",
        lambda n: _design(n, GelPad(length_mm=48.0, width_mm=18.0, thickness_mm=4.0, film=Film()), skeleton=_SMALL),
    ),
    "wide-50x60": (
        "box-like finger; the paper says 60 mm of width here and 50 mm later",
        lambda n: _design(n, GelPad(length_mm=50.0, width_mm=60.0, film=Film()), skeleton=_WIDE),
    ),
    "wide-50x50": (
        "box-like finger, the paper's later width",
        lambda n: _design(n, GelPad(length_mm=50.0, width_mm=50.0, film=Film()), skeleton=_WIDE),
    ),
    **{
        f"cylindrical-r{radius:g}": (
            f"70 x 35 mm, cylindrical pad of {radius:g} mm radius (assumed)",
            partial(_design, pad=GelPad(shape="cylindrical", radius_mm=radius, film=Film())),
        )
        for radius in (40.0, 60.0, 90.0)
    },
    **{
        f"ellipsoidal-{a:g}-{b:g}-{c:g}": (
            f"70 x 35 mm, pad cut from an ellipsoid of {a:g}, {b:g}, {c:g} mm (assumed)",
            partial(_design, pad=_ellipsoidal((a, b, c))),
        )
        for a, b, c in ((30.0, 8.0, 90.0), (30.0, 12.0, 90.0), (45.0, 20.0, 70.0))
    },
}
"""Name -> (what it is, its builder)."""


def preset_design(name: str) -> FingerDesign:
    """Return a ready-made finger.

    Raises
    ------
    SimulateError
        When there is none of this name; the message lists them.
    """
    if name not in PRESETS:
        raise SimulateError(f"there is no preset design '{name}'; there are {', '.join(PRESETS)}")
    return PRESETS[name][1](name)
