"""The sheet of a press protocol: the pad with its places, the solids, a table to tick off, and what to type then."""

from dataclasses import asdict
from typing import Final

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.patches import Circle, Rectangle

from finray_calib.reports import (
    BLUE,
    INK,
    VERMILLION,
    Content,
    Json,
    KeyNumber,
    Part,
    Picture,
    ReportPage,
    ReportTable,
    drawing,
    figure_png,
    in_rows,
    new_figure,
    one_group,
    png_bytes,
    report_html,
    styled,
    svg_text,
)
from sim.experiments import BACK_MM, PressProtocol, PrintedSolid

START_MIN: Final = 10.0
SET_MIN: Final = 1.0
PICTURES_MIN: Final = 0.75
"""Minutes to warm up, to set an indenter and its place, and for the pictures of one press; none was measured."""
_TAUGHT: Final = 6


def protocol_page(protocol: PressProtocol, recipes: tuple[str, str]) -> str:
    """Return the sheet as self-contained HTML, to be printed.

    Parameters
    ----------
    protocol
        Presses and solids.
    recipes
        Names of the recipes that read the balls' and the solids' pictures.
    """
    presses = protocol.presses
    minutes = START_MIN + len(presses) * (SET_MIN + 2.0 * PICTURES_MIN)
    length, width, thickness = protocol.pad_mm
    return report_html(
        ReportPage(
            verb="finray export protocol",
            title=f"Press protocol: {protocol.sensor}",
            lead=f"For a pad of {length:g} x {width:g} mm, {thickness:g} mm thick. Print this sheet and the solids.",
            verdict=f"{len(presses)} presses, each taken twice, in about {minutes:.0f} minutes.",
            sentence="The pictures then compare any simulator with your sensor, on shapes that it was not fitted to.",
            picture=drawing(
                _pad_svg(protocol),
                f"The pad with {sum(press.diameter_mm is not None for press in presses)} places for balls spread over "
                "it and the place of the solids in its middle.",
                "Where to press, seen from the side that is pressed, base on the left. What to see: the numbers "
                "are those of the table, circles are as wide as the contact; all solids go to the cross.",
            ),
            key_numbers=(
                KeyNumber("presses", str(len(presses)), f"{2 * len(presses)} folders of three pictures"),
                KeyNumber("solids to print", str(len(protocol.solids)), f"shapes up to {protocol.extent_mm:g} mm"),
                KeyNumber("deepest press", f"{max(p.depth_mm for p in presses):g} mm", "from the first touch"),
            ),
            parts=(
                Part("Before you begin", Content(points=_BEFORE)),
                Part("Solids", Content(_SOLIDS, picture_rows=_solid_pictures(protocol))),
                Part("At each press", Content(points=_EACH)),
                Part("Presses", Content(_TURN, tables=(_press_table(protocol),), has_wide_tables=True)),
                Part("Then", Content(_THEN, points=_commands(recipes))),
                Part("What this does not give", Content(points=_LIMITS)),
            ),
            origin=None,
            summary=_summary(protocol, minutes),
        )
    )


_BEFORE: Final = (
    "Print the solids with layers of 0.05 mm or less (resin), lying on their flat backs. Measure one length of each "
    "with a calliper; write down what differs from the sheet by more than 0.05 mm.",
    "Take three bearing balls of the diameters in the table, glued into a cup or held by a magnet.",
    "Mount the sensor so that nothing moves for an hour. A drill stand or a stage with a dial gauge sets the depth to "
    "0.05 mm.",
    "Switch automatic exposure, white balance, denoising and sharpening off. Save pictures without loss (PNG, or raw).",
    "Switch the lights on, wait for ten minutes, and take a picture of a ruler laid on the gel: its millimetres per "
    "pixel are needed later.",
)
_SOLIDS: Final = (
    "Each carries its shape on a round back of 20 mm diameter. The files in the folder 'solids' are in mm. In a "
    "simulator they are indenters: the shape looks along -y, and its first touch is in the plane y = 0."
)
_EACH: Final = (
    "Make a folder of the press's name. Save a picture without contact as no_contact.png.",
    "Lower the indenter until the picture just changes: this is zero. Continue to the depth in the table, wait for "
    "five seconds, and save contact.png.",
    "Lift it by 5 mm, wait for a minute, and save repeat_no_contact.png. If a dent is still to be seen, wait longer.",
    "Repeat these three steps for the folder whose name ends in -again. Tick the press off.",
)
_TURN: Final = (
    "Along the pad from its base, across from its middle line (towards the green wall of a finger: positive), depth "
    "from the first touch; turned about the pad's normal, against the clock as seen from outside, where the indenter "
    "is: rotation_deg[1] of a design."
)
_THEN: Final = (
    "Put the folders, and presses.csv of this protocol, into one folder PICTURES. With S millimetres per pixel, type:"
)
_LIMITS: Final = (
    "The times on this sheet are estimates; no lab has been timed.",
    "A press by hand is accurate to about 0.1 mm in depth and 0.5 mm in place. Let the comparison fit the "
    "place, and state these uncertainties.",
    "One session does not show how much the sensor changes from day to day: repeat the protocol on another day.",
    "Pictures that went through a camera's own tone curve are compared after that curve is fitted.",
)


def _commands(recipes: tuple[str, str]) -> tuple[str, ...]:
    """Return what to type then."""
    balls, solids = recipes
    return (
        f"Captures of the balls: finray import captures PICTURES --recipe {balls} --mm-per-px S --out balls. With "
        f"--predict-from {_TAUGHT} the other presses are predicted from six of them by a table.",
        f"Captures of the solids: finray import captures PICTURES --recipe {solids} --mm-per-px S --out solids-seen.",
        "Compare with your simulator's pictures: docs/how-to/validate-your-simulator.md has all steps.",
        "One file to publish: finray export captures balls --out balls.zip.",
    )


def _press_table(protocol: PressProtocol) -> ReportTable:
    """Return the presses with boxes to tick off."""
    rows = (
        (
            str(number),
            press.name,
            press.indenter,
            f"{press.position_mm:g}",
            f"{press.across_mm:+g}" if press.across_mm else "0",
            f"{press.depth_mm:g}",
            f"{press.turn_deg:g}",
            press.purpose,
            "\u2610 \u2610",
        )
        for number, press in enumerate(protocol.presses, start=1)
    )
    columns = (
        "no.", "folder", "indenter", "along (mm)", "across (mm)", "depth (mm)", "turned (deg)", "for", "done twice"
    )  # fmt: skip
    return one_group("Presses in their order", columns, rows)


def _pad_svg(protocol: PressProtocol) -> str:
    """Draw the pad with the places."""
    length, width, _ = protocol.pad_mm
    with styled():
        figure = new_figure(7.0, min(7.0 * width / length + 0.8, 5.5))
        axes = figure.add_subplot()
        axes.add_patch(Rectangle((0.0, -width / 2.0), length, width, facecolor="none", edgecolor=INK))
        for number, press in enumerate(protocol.presses, start=1):
            if press.diameter_mm is None:
                continue
            place = (press.position_mm, press.across_mm)
            colour = BLUE if press.purpose == "teach" else VERMILLION
            contact_mm = float(np.sqrt(press.diameter_mm * press.depth_mm - press.depth_mm**2))
            axes.add_patch(Circle(place, contact_mm, facecolor="none", edgecolor=colour))
            axes.annotate(str(number), place, ha="center", va="center", color=colour)
        axes.plot(length / 2.0, 0.0, "+", color=INK, markersize=14)
        axes.set(
            xlabel="along the pad from its base (mm)",
            ylabel="across (mm)",
            xlim=(-0.05 * length, 1.05 * length),
            ylim=(-0.6 * width, 0.6 * width),
            aspect="equal",
            title="blue: balls for training; red: balls that test; cross: all solids",
        )
        return svg_text(figure)


def _solid_pictures(protocol: PressProtocol) -> tuple[tuple[Picture, ...], ...]:
    """Return a picture of each solid, three in a row."""
    return in_rows([
        figure_png(
            _solid_png(solid, protocol.extent_mm),
            f"The solid {solid.name} seen from the side that touches the gel: {solid.what}.",
            f"{solid.name}.stl: {solid.what}. Tests {solid.shows}.",
            is_small=True,
        )
        for solid in protocol.solids
    ])  # fmt: skip


def _solid_png(solid: PrintedSolid, extent_mm: float) -> bytes:
    """Draw a solid from the side that touches the gel, shaded as if lit from above on the left."""
    corners = solid.vertices_mm[solid.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    seen = normals[:, 1] < -_GRAZING
    seen &= corners[:, :, 1].max(axis=1) < BACK_MM[1]
    nearest_last = np.argsort(-corners[seen].mean(axis=1)[:, 1])
    bright = np.clip(normals[seen] @ _LIGHT, 0.0, 1.0)[nearest_last]
    with styled():
        figure = new_figure(2.6, 2.6)
        axes = figure.add_subplot()
        polygons = corners[seen][nearest_last][:, :, [2, 0]]
        shades = np.repeat(0.25 + 0.7 * bright[:, None], 3, axis=1)
        axes.add_collection(PolyCollection(list(polygons), facecolors=shades, edgecolors=shades, linewidths=0.3))
        half = 0.6 * extent_mm
        axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xlabel="mm")
        return png_bytes(figure)


_GRAZING: Final = 1e-6
_LIGHT: Final = np.array([0.4, -0.8, -0.45]) / np.linalg.norm([0.4, -0.8, -0.45])


def _summary(protocol: PressProtocol, minutes: float) -> Json:
    """Return every number of the sheet."""
    return {
        "sensor": protocol.sensor,
        "minutes": minutes,
        "extent_mm": protocol.extent_mm,
        "solids": {solid.name: solid.what for solid in protocol.solids},
        "presses": [asdict(press) for press in protocol.presses],
    }
