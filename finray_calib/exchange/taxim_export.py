"""Make a Taxim calibration folder of rendered ball presses, so that programs built on Taxim can render our sensor."""

import io
import json
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.exchange.plain_arrays import Arrays
from finray_calib.exchange.taxim_folder import DATA_PACK, PARAMETERS
from finray_calib.exchange.taxim_table import BINS, ShadingTable, fit_shading_table
from sim.experiments.taxim_calibration import BallPresses

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
