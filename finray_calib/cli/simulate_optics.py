"""``finray simulate --only optics``: beside the record of a press, its images as files that other programs open."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.options import Progress, require_new, say

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from data_schemas.fit import PaintCalibration
    from data_schemas.provenance import Provenance
    from data_schemas.simulate import SimulatedPress
    from sim.experiments.painted_finger import PaintedFinger
    from sim.optics.state_render import RenderLevel
    from sim.surface_meshes.finger_shape import FingerShape

DEFAULT_SAMPLES = 128


def optics_paths(out: Path) -> tuple[Path, Path]:
    """Return the folder of images and the record of the capture beside a press record; both must be new."""
    stem = out.name.removesuffix(".json").removesuffix(".press")
    return require_new(out.with_name(f"{stem}.optics")), require_new(out.with_name(f"{stem}.capture.json"))


def simulate_optics(
    finger: "PaintedFinger",
    level: "RenderLevel",
    seed: int,
    samples: int | None,
    paint_sha256: Mapping[str, str],
    out: Path,
    origin: "Provenance",
    progress: Progress,
    denoise: bool,
    shapes: "tuple[FingerShape, FingerShape] | None",
    calibrations: "Mapping[str, PaintCalibration]",
    with_pose_response: bool,
) -> None:
    """Render a press and write its record, its capture and the folder of its images."""
    from data_schemas.product_set import ProductSet
    from data_schemas.storage import write_record
    from finray_calib.exchange.render_files import write_optics_folder
    from finray_calib.reports.denoised import require_denoiser
    from sim.experiments.optics_products import optics_products
    from sim.experiments.pose_response import moved_designs, pose_response
    from sim.experiments.press import press_record
    from sim.optics.render import render_press

    folder, capture = optics_paths(out)
    if denoise:
        require_denoiser()
    samples = samples or DEFAULT_SAMPLES
    if with_pose_response:
        moved_designs(finger.design)  # what cannot be moved is told before anything is rendered
    render = render_press(
        finger.design, finger.paints, finger.renderer, level, seed, samples, progress, shapes, finger.calibration
    )
    pose = None
    if with_pose_response:
        pose = pose_response(finger, level, seed, samples, None, render.chains, progress=progress)
    press = press_record(finger, render, paint_sha256, calibrations, pose)
    products = optics_products(render, press, seed)
    press = press.model_copy(update={"notes": (*press.notes, str(products.colours))})
    with ProductSet(out) as stored:
        write_optics_folder(folder, products, _views(press, samples, denoise), origin, stored)
        write_record(products.capture, capture, origin, stored)
        write_record(press, out, origin, stored)
    say(f"{out}: {press.label}")
    say(f"{capture}: raw counts of {press.design.camera.bit_depth if press.design else 0} bit, for 'finray compare'")
    say(f"{folder}/: images; README.txt there says what each one is")
    say(str(products.colours))


def _views(press: "SimulatedPress", samples: int, denoise: bool) -> "dict[str, NDArray[np.uint8]]":
    """Return pictures for the eye: the camera's colours, and the bands as colours."""
    import numpy as np

    from finray_calib.reports.denoised import denoised
    from finray_calib.reports.images import display_white, to_display
    from sim.experiments.press import camera_rgb

    bands = {"contact": press.contact_bands, "no_contact": press.no_contact_bands}
    pictures: dict[str, NDArray[np.float32]] = {"contact-view": press.contact, "no_contact-view": press.no_contact}
    pictures |= {f"{state}-view-bands": image for state, image in bands.items() if image is not None}
    if denoise and press.camera_matrix is not None:
        clean = {state: denoised(image, samples) for state, image in bands.items() if image is not None}
        pictures |= {f"{state}-view-denoised": camera_rgb(image, press.camera_matrix) for state, image in clean.items()}
        pictures |= {f"{state}-view-bands-denoised": image for state, image in clean.items()}
    pad = np.isfinite(press.distance)
    return {name: to_display(image, display_white(image[pad]), linear=True) for name, image in pictures.items()}
