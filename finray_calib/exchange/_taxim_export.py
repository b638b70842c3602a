"""Make a Taxim calibration folder of rendered ball presses, so that programs built on Taxim can render our sensor.

Taxim's shading table holds the change of colour for each slope, direction and place; it is fitted to the presses.
"""

import io
import json
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import SimulateError
from finray_calib.exchange._ball_presses import DATA_PACK, PARAMETERS, Arrays
from sim.experiments import BallPresses

Floats = NDArray[np.float64]

BINS: Final = 125
"""Of slope angle (0 to pi/2) and of direction (-pi to pi), as in Taxim's own tables."""
FEWEST_PRESSES: Final = 24
"""On a plain sensor, tables of 12 and 20 rendered presses explained 0.64 and 0.69 of others; more gained little."""
SPLITS: Final = 12

# of the polynomial in the normal's two components: degrees 5 and 6 foretell unseen presses no better (by 0.01)
_DEGREE = 4
_RIDGE_REL = 1e-3
# the bulge beside a contact is taught as well, to twice the half-width
_TAUGHT_TO_REL = 2.0
_HIGHEST_SLOPE_PERCENTILE = 99.5


@dataclass(frozen=True, slots=True)
class ShadingTable:
    """The table, and how well it foretells presses that did not teach it.

    Attributes
    ----------
    red, green, blue
        (slope bin, direction bin, 6): change in DN = table . (x^2, y^2, x y, x, y, 1), x and y the column and row in
        pixels.
    explained
        Per random half: share of the contact's squared change of colour that a table of one half of the presses
        explains on the other half, inside the contact circles.
    steepest_deg
        Steepest slope that the presses showed; beyond it the table holds its value.
    presses
        How many taught it.
    """

    red: Floats
    green: Floats
    blue: Floats
    explained: Floats
    steepest_deg: float
    presses: int

    def explained_median_range(self) -> tuple[float, float, float]:
        """Return median, least and most of the random halves."""
        return float(np.median(self.explained)), float(self.explained.min()), float(self.explained.max())


def fit_shading_table(presses: BallPresses, scale_dn: float, seed: int) -> ShadingTable:
    """Fit the table by ridge regression, smooth over its bins.

    The change of colour is a polynomial of fourth degree in the normal's components along columns and rows, without
    its constant (flat gel does not change), times one of second degree in place: 84 numbers per channel. So a few dozen
    presses fill 125 x 125 bins of 6 numbers each, which bin by bin would need thousands.

    Parameters
    ----------
    presses
        At least 24.
    scale_dn
        DN of the 8-bit images per unit of the renders.
    seed
        Of the random halves.

    Raises
    ------
    SimulateError
        When there are fewer presses.
    """
    count = len(presses.contacts)
    if count < FEWEST_PRESSES:
        raise SimulateError(
            f"a shading table needs at least {FEWEST_PRESSES} presses, got {count}; with fewer, it predicts unseen "
            "presses badly. Give more with --presses"
        )
    lessons = [_lesson(presses, k, scale_dn) for k in range(count)]
    rng = np.random.default_rng(seed)
    explained = np.array([_explained(lessons, rng.permutation(count)) for _ in range(SPLITS)])
    steepest = float(np.percentile(np.concatenate([lesson.angles for lesson in lessons]), _HIGHEST_SLOPE_PERCENTILE))
    red, green, blue = _bins(_solve(lessons), steepest, presses.no_contact.shape[:2])
    return ShadingTable(red, green, blue, explained, float(np.degrees(steepest)), count)


@dataclass(frozen=True, slots=True)
class _Lesson:
    """One press: its normal equations, its steepest slopes, and terms and changes (n, 3) of its contact circle."""

    normal: Floats
    right: Floats
    angles: Floats
    terms: Floats
    change: Floats


def _lesson(presses: BallPresses, k: int, scale_dn: float) -> _Lesson:
    """Return what one press teaches."""
    taught = presses.distance[k] <= _TAUGHT_TO_REL
    rows, columns = np.nonzero(taught)
    slopes = presses.slopes[k][taught]
    angles = np.arctan(np.linalg.norm(slopes, axis=-1))
    directions = np.arctan2(slopes[:, 1], slopes[:, 0])
    change = (presses.contacts[k][taught] - presses.no_contact[taught]).astype(np.float64) * scale_dn
    places = _places(rows, columns, presses.no_contact.shape[:2])
    terms = (_shades(angles, directions)[:, :, None] * places[:, None]).reshape(len(change), -1)
    inside = presses.distance[k][taught] <= 1.0
    return _Lesson(terms.T @ terms, terms.T @ change, angles, terms[inside], change[inside])


def _shades(angles: Floats, directions: Floats) -> Floats:
    """Return monomials of the normal's components along columns and rows, degrees 1 to 4: (n, 14)."""
    u, v = np.sin(angles) * np.cos(directions), np.sin(angles) * np.sin(directions)
    powers = [(i, j) for i, j in product(range(_DEGREE + 1), repeat=2) if 1 <= i + j <= _DEGREE]
    return np.stack([u**i * v**j for i, j in powers], axis=-1)


def _places(rows: NDArray[np.intp], columns: NDArray[np.intp], shape: tuple[int, ...]) -> Floats:
    """Return x^2, y^2, x y, x, y, 1 of places as shares of the picture: (n, 6)."""
    x, y = columns / shape[1], rows / shape[0]
    return np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=-1)


def _solve(lessons: list[_Lesson]) -> Floats:
    """Return the coefficients (84, 3)."""
    normal = np.sum([lesson.normal for lesson in lessons], axis=0)
    right = np.sum([lesson.right for lesson in lessons], axis=0)
    return np.asarray(
        np.linalg.solve(normal + np.eye(len(normal)) * _RIDGE_REL * np.trace(normal) / len(normal), right)
    )


def _explained(lessons: list[_Lesson], order: NDArray[np.intp]) -> float:
    """Fit one half and return what it explains of the other, inside the contact circles."""
    half = len(lessons) // 2
    coefficients = _solve([lessons[i] for i in order[:half]])
    unseen = [lessons[i] for i in order[half:]]
    missed = sum(((u.terms @ coefficients - u.change) ** 2).sum() for u in unseen)
    return float(1.0 - missed / sum((u.change**2).sum() for u in unseen))


def _bins(coefficients: Floats, steepest: float, shape: tuple[int, ...]) -> list[Floats]:
    """Evaluate the fit at the middle of each bin; return (slope, direction, 6) per channel, for places in pixels."""
    angles = (np.arange(BINS) + 0.5) * 0.5 * np.pi / (BINS - 1)
    directions = (np.arange(BINS) + 0.5) * 2.0 * np.pi / (BINS - 1) - np.pi
    grid = np.meshgrid(np.minimum(angles, steepest), directions, indexing="ij")
    shades = _shades(grid[0].ravel(), grid[1].ravel())
    table = np.einsum("bs,spc->bpc", shades, coefficients.reshape(shades.shape[1], -1, 3))
    table[:BINS] = 0.0  # the bin of flat gel, in all directions
    height, width = shape
    table /= np.array([width**2, height**2, width * height, width, height, 1.0])[:, None]
    return [table[..., c].reshape(BINS, BINS, -1) for c in range(3)]


BRIGHTEST_DN: Final = 230.0
"""Level of the brightest pixels of the 8-bit images."""

# Taxim's own blurs, in mm on the gel (its parameters at 0.0295 mm per px); the port scales them with the picture
_PYRAMID_MM = (0.9, 0.457, 0.236, 0.103, 0.059, 0.0325)
_FINAL_MM, _SHADOW_BLUR_MM, _SHADOW_STEP_MM, _ATTACHMENT_MM = 0.059, 0.0325, 0.037, 0.148
_FRAME_MM = 1.475
_CONTACT_SCALE = 0.4
_SHADOW_BIN_RAD, _SHADOW_BIN_MM, _SHADOW_HEIGHTS = 0.1, 0.1, 20
_BRIGHTEST_PERCENTILE = 99.9


def taxim_files(presses: BallPresses, seed: int, provenance: dict[str, Any]) -> tuple[dict[str, bytes], ShadingTable]:
    """Return the files of a Taxim calibration folder by name, and the table that they hold.

    Images are BGR of 8 bits, proportional to light; the tables of red and blue are exchanged, as Taxim's programs
    expect; circle centres are (column, row). Shadows that an object casts beside its contact are not exported: the
    shadow table is there, because Taxim does not start without one, and casts none.

    Parameters
    ----------
    presses
        Rendered.
    seed
        Of the random halves that score the table.
    provenance
        Stored in params.json.

    Raises
    ------
    SimulateError
        When there are too few presses for a table.
    """
    scale_dn = BRIGHTEST_DN / float(np.percentile(presses.contacts, _BRIGHTEST_PERCENTILE))
    table = fit_shading_table(presses, scale_dn, seed)
    background = _bgr(presses.no_contact, scale_dn)
    height, width = background.shape[:2]
    gel_px = np.full((height, width), presses.thickness_mm / presses.mm_per_px, dtype=np.float32)
    data_pack: Arrays = {
        "f0": background,
        "imgs": _bgr(presses.contacts, scale_dn),
        "touch_center": np.column_stack([presses.column_px, presses.row_px]),
        "touch_radius": presses.radius_px,
        "img_size": np.array(background.shape),
    }
    # red and blue exchanged: the table's "r" is the first channel of BGR
    grades: Arrays = {"grad_r": table.blue, "grad_g": table.green, "grad_b": table.red}
    files = {
        DATA_PACK: _npz(data_pack),
        "polycalib.npz": _npz({"bins": np.array(BINS), **grades}),
        "shadowTable.npz": _npz(_no_shadows()),
        "gelmap.npy": _npy(gel_px),
        "real_bg.npy": _npy(background),
        PARAMETERS: _parameters(presses, table, scale_dn, provenance),
    }
    return files, table


def _bgr(linear: NDArray[np.float32], scale_dn: float) -> NDArray[np.uint8]:
    """Return images of 8 bits in BGR order."""
    return np.asarray(np.clip(np.rint(linear[..., ::-1] * scale_dn), 0, 255), dtype=np.uint8)


def _no_shadows() -> Arrays:
    """Return a shadow table whose every entry darkens nothing; Taxim wants lists in it, so numpy pickles them."""
    directions = np.arange(0.0, 2.0 * np.pi, _SHADOW_BIN_RAD)
    table = np.empty((3, len(directions), _SHADOW_HEIGHTS), dtype=object)
    for index in np.ndindex(table.shape):
        table[index] = [float("inf")]
    return {"shadowDirections": directions, "shadowTable": table}


def _parameters(presses: BallPresses, table: ShadingTable, scale_dn: float, provenance: dict[str, Any]) -> bytes:
    """Return params.json; blurs are relative to width and height."""
    height, width = presses.no_contact.shape[:2]
    sides_mm = [width * presses.mm_per_px, height * presses.mm_per_px]

    def relative(length_mm: float) -> list[float]:
        return [length_mm / side for side in sides_mm]

    simulator = {
        "initial_frame_sigma_rel": relative(_FRAME_MM),
        "diff_threshold": 5,
        "frame_mixing_percentage": 0.15,
        "shadow_step_rel": relative(_SHADOW_STEP_MM),
        "discretize_precision": _SHADOW_BIN_RAD,
        "height_precision": _SHADOW_BIN_MM,
        "fan_angle": 0.1,
        "fan_precision": 0.05,
        "contact_scale": _CONTACT_SCALE,
        "deform_pyramid_sigma_rel": [[length / side for length in _PYRAMID_MM] for side in sides_mm],
        "deform_final_sigma_rel": relative(_FINAL_MM),
        "shadow_blur_sigma_rel": relative(_SHADOW_BLUR_MM),
        "shadow_attachment_kernel_size_rel": relative(_ATTACHMENT_MM),
    }
    sensor = {"pixmm": presses.mm_per_px, "num_bins": BINS, "h": height, "w": width}
    made = {
        "what": presses.label,
        "presses": table.presses,
        "ball_diameter_mm": 2.0 * presses.ball_radius_mm,
        "held_out_explained": table.explained_median_range(),
        "steepest_slope_deg": table.steepest_deg,
        "dn_per_unit_radiance": scale_dn,
        "values": "8 bits, proportional to light, no camera noise",
        "shadows": "none: cast shadows beside a contact are not exported",
        "provenance": provenance,
    }
    return (json.dumps({"simulator": simulator, "sensor": sensor, "finray": made}, indent=1) + "\n").encode()


def _npz(arrays: Arrays) -> bytes:
    """Return the bytes of an npz file."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=True, **arrays)
    return buffer.getvalue()


def _npy(array: NDArray[Any]) -> bytes:
    """Return the bytes of an npy file."""
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()
