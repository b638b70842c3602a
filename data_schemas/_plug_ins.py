"""What packages outside the tree bring: found by name through entry points, loaded when asked for, refused by name.

A plug-in is a module that an entry point names: ``[project.entry-points."finray_calib.materials"]``, ``gent =
"my_rubbers"``. A file of a user holds the name ``gent`` and never a module: files travel, and must not choose what code
runs. Nothing is imported before somebody asks for the name. There are eight kinds: camera, filter wheel and light
(``rigs``), import format (``finray_calib.exchange``), pad shape (here), indenter shape and material
(``sim.mechanics``), and metric (``finray_calib.compare``); docs/reference/extend-finray.md shows each.
"""

import difflib
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module, metadata
from types import ModuleType
from typing import Annotated, Any, Final, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from data_schemas.errors import FinrayError, SimulateError

NO_ADDRESS = ("simulated", "manual")
"""Drivers without a device of their own."""
_OF_CAMERAS = ("aravis", "folder", "gentl", "indi", "micro-manager", "mjpeg", "picamera2")
_WITH_ADDRESS = (*_OF_CAMERAS, "alpaca", "arduino", "grbl", "hx711", "thorlabs")
"""The other drivers of finray-calib; a package may bring more."""
Result = TypeVar("Result")
EXTEND: Final = "docs/reference/extend-finray.md"

Parameters = Annotated[
    dict[str, float],
    Field(
        description="parameters of a part that another package provides, under that package's names; numbers, with "
        "the unit in the name"
    ),
]
PackageName = Annotated[
    str | None,
    Field(
        description="package that provides it, with its version; finray fills it in when it reads the design, "
        "and later requires that version"
    ),
]


@dataclass(frozen=True, slots=True)
class PlugInKind:
    """One kind of thing that packages can bring.

    Attributes
    ----------
    noun
        What it is, in words: ``indenter shape``.
    group
        Of the entry points.
    members
        What its module has, each as it is called: ``read_capture(folder)``.
    error
        That refuses.
    how_to
        The page that shows how one is written.
    """

    noun: str
    group: str
    members: tuple[str, ...]
    error: type[FinrayError] = SimulateError
    how_to: str = EXTEND


@dataclass(frozen=True, slots=True)
class PlugIn:
    """A module that a package brings.

    Attributes
    ----------
    kind, name
        What it is, and its name in a file or command.
    module
        What is imported.
    package, version
        Of the distribution; empty where it names none.
    """

    kind: PlugInKind
    name: str
    module: str
    package: str = ""
    version: str = ""

    @property
    def source(self) -> str:
        """Package and version, as a record holds them."""
        return f"{self.package} {self.version}".strip() or "a package without a name"

    @property
    def label(self) -> str:
        """Kind, name and package: ``material 'gent' of package my-rubbers 0.1``."""
        of = f" of package {self.source}" if self.package else ""
        return f"{self.kind.noun} '{self.name}'{of}"

    def refusal(self, fault: str, at: str = "") -> FinrayError:
        """Return the error that says what is wrong, and what its user can do about a mistake of its author."""
        mend = f"update it (pip install --upgrade {self.package}), or tell its author" if self.package else "mend it"
        return self.kind.error(f"{at}{self.label} {fault}; {mend} ({self.kind.how_to})")

    def load(self) -> ModuleType:
        """Return the module, which has all that one of its kind must have.

        Raises
        ------
        FinrayError
            It cannot be imported, or lacks something.
        """
        try:
            module = import_module(self.module)
        except FinrayError:
            raise
        except (Exception, SystemExit) as error:  # whatever a module does when it is imported
            raise self.refusal(f"cannot be imported ({type(error).__name__}: {error})") from error
        if lacking := [member for member in self.kind.members if not hasattr(module, member.partition("(")[0])]:
            raise self.refusal(f"does not define {' and '.join(lacking)} in its module {self.module}")
        return module

    def call(self, function: Callable[[], Result], at: str = "", when: str = "") -> Result:
        """Return what a function of the plug-in gives; a mistake of its author is not its user's.

        Raises
        ------
        FinrayError
            Its own error of this kind, an error of the operating system (OSError), or the refusal of what it raises.
        """
        try:
            return function()
        except (FinrayError, OSError):
            raise
        except (Exception, SystemExit) as error:
            raise self.refusal(f"fails{when} ({type(error).__name__}: {error})", at) from error

    def check_parameters(self, function: Callable[..., Any], parameters: Mapping[str, float], positional: int) -> None:
        """Refuse parameters that a function does not take, or of which it lacks some: a mistake of the user.

        Parameters
        ----------
        function
            Takes `positional` arrays or numbers, and then the parameters by name.
        parameters
            As a design names them.
        positional
            How many come before them.
        """
        signature = inspect.signature(function)
        try:
            signature.bind(*[None] * positional, **parameters)
        except TypeError:
            taken = list(signature.parameters.values())[positional:]
            names = [p.name if p.default is p.empty else f"{p.name} (by default {p.default})" for p in taken]
            raise self.kind.error(
                f"{self.label} takes the parameters {', '.join(names) or 'none'}, but the design gives "
                f"{', '.join(parameters) or 'none'}; correct the parameters in the design"
            ) from None


@cache
def plug_ins(kind: PlugInKind) -> tuple[PlugIn, ...]:
    """Return all that installed packages bring of a kind; nothing is imported."""
    return tuple(
        PlugIn(
            kind, entry.name, entry.value, *(("", "") if entry.dist is None else (entry.dist.name, entry.dist.version))
        )
        for entry in metadata.entry_points(group=kind.group)
    )


def find_plug_in(kind: PlugInKind, name: str, ours: Iterable[str] = ()) -> PlugIn:
    """Return the only plug-in of a name.

    Parameters
    ----------
    kind, name
        What it is, and its name in a file or command.
    ours
        Names that finray-calib knows itself, for the message.

    Raises
    ------
    FinrayError
        No package brings it, or several do.
    """
    offered = plug_ins(kind)
    found = [one for one in offered if one.name == name]
    if not found:
        known = ", ".join([*ours, *sorted(one.label for one in offered)]) or "none"
        raise kind.error(
            f"no installed package provides the {kind.noun} '{name}' (available: {known}); correct the name, or "
            f"install the package that provides it ({kind.how_to})"
        )
    if len(found) > 1:
        raise kind.error(
            f"{kind.noun} '{name}' is provided by {' and by '.join(sorted(one.source for one in found))}, so finray "
            "cannot tell which one you mean; uninstall one of the packages, or ask the author of one to rename it"
        )
    return found[0]


def require_plug_in(kind: PlugInKind, name: str, source: str | None, ours: Iterable[str] = ()) -> PlugIn:
    """Return the plug-in of a name, which must be of the package and version that a design holds.

    Raises
    ------
    FinrayError
        No package or several bring it, or it is of another version: results of two versions must not mix.
    """
    found = find_plug_in(kind, name, ours)
    if source is not None and found.source != source:
        package, _, version = source.rpartition(" ")
        raise kind.error(
            f"the design uses the {kind.noun} '{name}' of {source}, but {found.source} is installed; install the "
            f"version of the design (pip install {package}=={version}), or remove 'package' from the design and "
            "compute again"
        )
    return found


PAD_SHAPES: Final = PlugInKind(
    "pad shape",
    "finray_calib.pad_shapes",
    ("drop_mm(x_mm, z_mm, ...)", "most_curvature_per_mm(half_width_mm, half_length_mm, ...)"),
)
INDENTER_SHAPES: Final = PlugInKind("indenter shape", "finray_calib.indenter_shapes", ("body(...)",))
MATERIALS: Final = PlugInKind("material", "finray_calib.materials", ("energy_mpa(stretches, ...)",))


def numbers_of(plug_in: PlugIn, what: str, given: Any, shape: tuple[int, ...], at: str = "") -> NDArray[np.float64]:
    """Return what a plug-in gave as an array of numbers.

    Raises
    ------
    FinrayError
        It is none, of another shape, or not finite.
    """
    try:
        values = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise plug_in.refusal(f"returns {what} of type {type(given).__name__}, but numbers are needed", at) from None
    if values.shape != shape:
        raise plug_in.refusal(f"returns {what} of shape {values.shape}, but shape {shape} is needed", at)
    if not np.isfinite(values).all():
        raise plug_in.refusal(f"returns {what} with {int((~np.isfinite(values)).sum())} NaN or infinite values", at)
    return values


class PadShape(Protocol):
    """What the module of a pad shape has: a coated face that lies ``drop_mm`` below its crown.

    The crown is in the middle of the pad, where the drop is 0; nowhere is it below 0, and everywhere it leaves gel. The
    face is smooth: its second derivative is bounded.
    """

    def drop_mm(self, x_mm: NDArray[np.float64], z_mm: NDArray[np.float64], **parameters: float) -> ArrayLike:
        """Return the drop in mm, shape of both arguments, at places across (x) and along (z) the pad from its middle.

        Parameters
        ----------
        x_mm, z_mm
            Of one shape, within the pad, in mm.
        **parameters
            Of the design's ``pad.parameters``.
        """
        ...

    def most_curvature_per_mm(self, half_width_mm: float, half_length_mm: float, **parameters: float) -> float:
        """Return a bound of the drop's second derivative along any direction, over the whole pad, in 1/mm."""
        ...


_CHECKED_A_SIDE = 41
_CROWN_MM = 1e-9  # what rounding may leave of the drop at the crown
_DIFFERENCE = 1e-4  # of the pad's size: leaves 1e-7 of a curvature of 0.1 per mm to rounding and truncation
_CURVATURE_SLACK = 1.001


class PackagedPad:
    """A pad shape of another package; what it returns is checked each time.

    Parameters
    ----------
    plug_in
        Who brings it.
    module
        Its functions, where they are at hand.
    """

    def __init__(self, plug_in: PlugIn, module: Any = None) -> None:
        self._plug_in = plug_in
        self._module = plug_in.load() if module is None else module

    def drop_mm(self, x_mm: NDArray[np.float64], z_mm: NDArray[np.float64], parameters: Mapping[str, float]) -> Any:
        """Return the drop, of the shape of both arguments."""
        self._plug_in.check_parameters(self._module.drop_mm, parameters, 2)
        given = self._plug_in.call(lambda: self._module.drop_mm(x_mm, z_mm, **parameters), "pad: ")
        return numbers_of(self._plug_in, "drop_mm", given, x_mm.shape, "pad: ")

    def most_curvature_per_mm(
        self, half_width_mm: float, half_length_mm: float, parameters: Mapping[str, float]
    ) -> float:
        bound = self._module.most_curvature_per_mm
        self._plug_in.check_parameters(bound, parameters, 2)
        given = self._plug_in.call(lambda: bound(half_width_mm, half_length_mm, **parameters), "pad: ")
        return float(numbers_of(self._plug_in, "most_curvature_per_mm", given, (), "pad: "))

    def check(self, length_mm: float, width_mm: float, thickness_mm: float, parameters: Mapping[str, float]) -> None:
        """Refuse a face that is no height over the pad, leaves no gel, or bends more than it says."""
        sides = [np.linspace(-size / 2.0, size / 2.0, _CHECKED_A_SIDE) for size in (width_mm, length_mm)]
        x, z = np.meshgrid(*sides, indexing="ij")
        drop = self.drop_mm(x, z, parameters)
        middle = float(drop[_CHECKED_A_SIDE // 2, _CHECKED_A_SIDE // 2])
        if abs(middle) > _CROWN_MM or drop.min() < -_CROWN_MM:
            raise self._plug_in.refusal(
                "has its crown in the wrong place; drop_mm must be 0 mm in the middle of the pad and nowhere "
                f"negative, but it is {middle:.3g} mm in the middle and {drop.min():.3g} mm at its lowest", "pad: ",
            )  # fmt: skip
        if drop.max() >= thickness_mm:
            at = np.unravel_index(int(drop.argmax()), drop.shape)
            raise self._plug_in.kind.error(
                f"thickness_mm = {thickness_mm:g} mm leaves no gel at the point {x[at]:.3g} mm across and {z[at]:.3g} "
                f"mm along from the middle, because the face of {self._plug_in.label} lies {drop.max():.3g} mm below "
                "the crown there; make the pad thicker, or change pad.parameters"
            )
        self._check_curvature(width_mm, length_mm, parameters)

    def _check_curvature(self, width_mm: float, length_mm: float, parameters: Mapping[str, float]) -> None:
        step = _DIFFERENCE * min(width_mm, length_mm)
        sides = [np.linspace(step - size / 2.0, size / 2.0 - step, _CHECKED_A_SIDE) for size in (width_mm, length_mm)]
        x, z = np.meshgrid(*sides, indexing="ij")
        most = 0.0
        for across, along in ((1.0, 0.0), (0.0, 1.0), (0.5**0.5, 0.5**0.5), (0.5**0.5, -(0.5**0.5))):
            three = [self.drop_mm(x + k * step * across, z + k * step * along, parameters) for k in (-1.0, 0.0, 1.0)]
            most = max(most, float(np.abs(three[0] - 2.0 * three[1] + three[2]).max()) / step**2)
        bound = self.most_curvature_per_mm(width_mm / 2.0, length_mm / 2.0, parameters)
        if not bound >= 0.0 or most > _CURVATURE_SLACK * bound + 1e-6:
            raise self._plug_in.refusal(
                f"has a curvature of {most:.3g} per mm, more than the bound of {bound:.3g} per mm that its "
                "most_curvature_per_mm returns", "pad: ",
            )  # fmt: skip


def check_pad_shape(
    shape: PadShape, length_mm: float, width_mm: float, thickness_mm: float, **parameters: float
) -> None:
    """Check that a pad shape keeps its contract, as a design does that names it: for the tests of its package.

    Its drop is finite, 0 at the crown in the middle and not below that, leaves gel everywhere, and bends by no more
    than it says; on 41 x 41 places of the pad.

    Parameters
    ----------
    shape
        The module, or an object with its functions.
    length_mm, width_mm, thickness_mm
        Of the pad.
    **parameters
        As ``pad.parameters`` gives them.

    Raises
    ------
    SimulateError
        It does not; the message says what is wrong, and where.
    """
    plug_in = PlugIn(PAD_SHAPES, getattr(shape, "__name__", type(shape).__name__), "")
    PackagedPad(plug_in, shape).check(length_mm, width_mm, thickness_mm, parameters)


def require_address(driver: str, address: str) -> None:
    """Refuse a driver without an address, and an address that nothing would use."""
    if driver in NO_ADDRESS and address:
        raise ValueError(f"address: driver '{driver}' does not take an address; leave the address out")
    if driver in NO_ADDRESS or address:
        return
    if driver in _WITH_ADDRESS:
        raise ValueError(f"address: driver '{driver}' needs an address; run 'finray rig detect' to find it")
    near = difflib.get_close_matches(driver, (*NO_ADDRESS, *_WITH_ADDRESS), 1, cutoff=0.6)
    hint = f"did you mean '{near[0]}'? If" if near else "if"
    raise ValueError(
        f"driver: finray has no driver '{driver}'; {hint} another package provides this driver, also give the address "
        "of the driver"
    )
