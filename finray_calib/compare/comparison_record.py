"""From one simulated press and one tactile capture to the photometric error report."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.compare import ErrorRow, Interval, PhotometricErrorReport
from data_schemas.compare import RegionError as RegionRecord
from data_schemas.simulate import SimulatedPress
from finray_calib.compare import photometric_error as table
from finray_calib.compare.blocks import LARGEST_BLOCK_PX, LARGEST_NOISE_REL
from finray_calib.compare.brightness import brightness_error
from finray_calib.compare.interval import Interval as BootstrapInterval
from finray_calib.compare.prepared_images import prepare_images
from finray_calib.compare.regions import Region, strip_from_distance

Floats = NDArray[np.float64]
PATCH, DILATED = "contact patch", "contact patch dilated 2x"
FACTORS = {PATCH: 1.0, DILATED: 2.0}
SSIM_SETTINGS = (
    "Wang 2004 on the compared values: sigma 1.5, 11 x 11, K1 0.01, K2 0.03, population covariance, no border"
)


def compare_press(press: SimulatedPress, capture: TactileCapture, seed: int) -> PhotometricErrorReport:
    """Compare a render (or table prediction) with a capture over the contact patch and its halo.

    Parameters
    ----------
    press
        Simulated contact and no-contact images with the distance map that defines the regions.
    capture
        Contact, no-contact and repeat images of the same press.
    seed
        Seed of the block bootstrap.

    Raises
    ------
    CompareError
        The images differ in size, or linear light would be compared with encoded values.
    """
    images = prepare_images(press, capture)
    linear = capture.encoding == "linear"
    regions = [Region(name, strip_from_distance(images.distance, factor), factor) for name, factor in FACTORS.items()]
    result = table.photometric_error(
        images.simulated, images.contact, images.no_contact, images.repeat, regions,
        2.0**capture.bit_depth - 1 - capture.black_level_dn, linear, np.random.default_rng(seed), fit_exposure=linear,
        simulated_no_contact=images.simulated_no_contact, weights=None if linear else np.ones(3),
    )  # fmt: skip
    factor = result.exposure.k if result.exposure else 1.0
    factor_sd = result.exposure.u if result.exposure else 0.0
    simulated = factor * images.simulated
    brightness = None
    if linear:
        brightness = brightness_error(
            simulated, images.contact, images.no_contact, images.repeat, images.distance, factor_sd / factor
        )
    rows = {r.region.name: r for r in result.regions}
    return PhotometricErrorReport(
        simulated=press.name,
        captured=capture.name,
        label=press.label,
        values="linear light" if linear else "encoded values, encoding unknown",
        headline_region=DILATED,
        headline_skill=_interval(rows[DILATED].simulation.skill),
        regions=tuple(_region(r, images.clipped) for r in result.regions),
        ssim_full_frame=_full_frame_ssim(rows[DILATED]),
        ssim_settings=SSIM_SETTINGS,
        exposure_factor=factor * images.scale if linear else None,
        exposure_factor_sd=factor_sd * images.scale if linear and np.isfinite(factor_sd) else None,
        channel_weights=_three(rows[DILATED].channel_weights),
        objective_error_rel=brightness.error_rel if brightness else None,
        objective_error_sd_rel=brightness.sd_rel if brightness else None,
        light_angle_deg=capture.light_angle_deg,
        block_px=images.block_px,
        error_map=_error_map(simulated, images.contact, images.no_contact),
        withheld=() if linear else _withheld(capture),
        notes=_notes(press, capture, images.block_px),
    )


def _interval(value: BootstrapInterval) -> Interval:
    """Return the record of an interval."""
    return Interval(estimate=value.estimate, low95=value.low, high95=value.high)


def _three(values: Sequence[float] | Floats) -> tuple[float, float, float]:
    """Return three channel values."""
    red, green, blue = (float(v) for v in values)
    return red, green, blue


def _region(result: table.RegionError, clipped: NDArray[np.bool_]) -> RegionRecord:
    """Return the record of one region."""
    rows = [_row("do nothing", result.do_nothing), _row("simulation", result.simulation)]
    if result.floor is not None:
        rows.append(_row("floor", result.floor))
    return RegionRecord(
        region=result.region.name,
        factor=result.region.factor,
        pixels=result.pixels_used,
        clipped_fraction=float(clipped[result.region.mask].mean()),
        rows=tuple(rows),
    )


def _row(candidate: str, row: table.PhotometricRow) -> ErrorRow:
    """Return the record of one row; what has no value is None."""
    channels = [float(v) if np.isfinite(v) else None for v in row.per_channel_skill]
    return ErrorRow.model_validate(
        {
            "candidate": candidate,
            "skill": _interval(row.skill),
            "skill_per_channel": tuple(channels),
            "relative_rms": None if row.relative_rms is None else tuple(r.estimate for r in row.relative_rms),
            "psnr_db": row.psnr_db if np.isfinite(row.psnr_db) else None,
            "ssim": row.ssim_in_region if np.isfinite(row.ssim_in_region) else None,
        }
    )


def _full_frame_ssim(result: table.RegionError) -> dict[str, float | None]:
    """Return the full-frame SSIM of each candidate, for comparison with papers."""
    rows = {"do nothing": result.do_nothing, "simulation": result.simulation}
    if result.floor is not None:
        rows["floor"] = result.floor
    return {name: r.ssim_full_frame if np.isfinite(r.ssim_full_frame) else None for name, r in rows.items()}


def _error_map(simulated: Floats, captured: Floats, no_contact: Floats) -> NDArray[np.float32]:
    """Return the error per pixel: rms over channels of (simulated - captured) / mean no-contact level."""
    level = np.nanmean(no_contact, axis=(0, 1))
    error: Floats = np.sqrt((((simulated - captured) / level) ** 2).mean(axis=-1))
    return error.astype(np.float32)


def _withheld(capture: TactileCapture) -> tuple[str, ...]:
    """Say which figures an unknown encoding does not allow."""
    return (
        f"relative RMS, exposure factor and brightness error are not given: the encoding of {capture.name} is unknown, "
        "so its values are not proportional to light",
    )


def _notes(press: SimulatedPress, capture: TactileCapture, block_px: int) -> tuple[str, ...]:
    """Collect what a reader must know."""
    notes = list(press.notes)
    if block_px > 1:
        notes.append(
            f"compared over blocks of {block_px} x {block_px} px, so that render noise stays below "
            f"{LARGEST_NOISE_REL:.0%} of the level (or as near as blocks of {LARGEST_BLOCK_PX} px come)"
        )
    if capture.repeat_no_contact is None:
        notes.append("no repeat of the no-contact image: the floor is not known")
    return tuple(notes)
