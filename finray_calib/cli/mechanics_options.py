"""Options of ``finray simulate`` that only the mechanics reads, and what does not go together with them."""

import argparse
import math
from pathlib import Path

from finray_calib.cli.options import DEFAULT_INCREMENTS, increment_count

LARGEST_FORCE_N = 1000.0


def add_mechanics_options(parser: argparse.ArgumentParser) -> None:
    """Add what only the mechanics reads."""
    parser.add_argument(
        "--increments", type=increment_count, metavar="N",
        help=f"with --only mechanics: steps of the push (default {DEFAULT_INCREMENTS})",
    )  # fmt: skip
    parser.add_argument(
        "--force", type=_force, metavar="NEWTON",
        help="with --only mechanics: press until the indenter pushes with this force, frictionless, in place of the "
        "design's depth_mm",
    )  # fmt: skip
    parser.add_argument(
        "--resume", type=Path, metavar="INCREMENT",
        help="with --only mechanics: go on from a stored increment, or the last one in a folder NAME.increments",
    )  # fmt: skip
    parser.add_argument(
        "--contact", choices=["auto", "penalty", "barrier"], default="auto",
        help="with --only mechanics: penalty (fast, no friction), barrier (friction, any indenter, contact of ribs) or "
        "auto (default: penalty where it can)",
    )  # fmt: skip
    parser.add_argument(
        "--sensitivities", action="store_true",
        help="with --only mechanics: also press with each uncertain modulus and thickness changed (some 15 presses), "
        "so that 'finray compare --force' can carry their uncertainty",
    )  # fmt: skip


def _force(text: str) -> float:
    """Parse a force."""
    try:
        force_n = float(text)
    except ValueError:
        force_n = math.nan
    if not 0.0 < force_n <= LARGEST_FORCE_N:
        raise argparse.ArgumentTypeError(f"{text!r} must be a force in N above 0 and at most {LARGEST_FORCE_N:g}")
    return force_n


def require_mechanics_only(arguments: argparse.Namespace) -> None:
    """Refuse what only the optics reads, and what does not go together."""
    from data_schemas.errors import SimulateError

    optical: dict[str, object] = {
        "paint": [],
        "angles": None,
        "objectives": "intensity",
        "surfaces": None,
        "level": "b",
        "samples": None,
        "denoise": False,
        "pose_response": False,
    }
    for name, default in optical.items():
        if getattr(arguments, name) != default:
            option = name.replace("_", "-")
            raise SimulateError(f"--{option} belongs to the optics; leave it out with --only mechanics")
    if arguments.seed is not None:
        raise SimulateError("--seed: a press knows no chance; leave it out with --only mechanics")
    if arguments.engine not in {"auto", "calculix"}:
        raise SimulateError(f"--engine {arguments.engine} renders; give calculix with --only mechanics, or none")
    calculix, forced, resumes = (
        arguments.engine == "calculix",
        arguments.force is not None,
        arguments.resume is not None,
    )
    if calculix and arguments.contact != "auto":
        raise SimulateError("--contact: CalculiX has a contact of its own; leave out --contact, or --engine calculix")
    if forced and (calculix or resumes or arguments.sensitivities or arguments.contact == "barrier"):
        raise SimulateError(
            "--force presses from first touch by the penalty of the elements here; leave out --force, or --resume, "
            "--sensitivities, --contact barrier and --engine"
        )
    if arguments.sensitivities and (calculix or resumes):
        raise SimulateError("--sensitivities need a whole press by the elements here; leave out --resume and --engine")
    if calculix and resumes:
        raise SimulateError("--resume: CalculiX presses from first touch; leave out --resume, or --engine calculix")


def require_optics_only(arguments: argparse.Namespace) -> None:
    """Refuse what only the mechanics reads."""
    from data_schemas.errors import SimulateError

    mechanical: dict[str, tuple[object, str]] = {
        "contact": ("auto", "is that of the finite elements"),
        "force": (None, "is that of a press by finite elements"),
        "sensitivities": (False, "are those of a force"),
        "resume": (None, "goes on with a press of finite elements"),
        "increments": (None, "are steps of finite elements"),
    }
    if arguments.engine == "calculix":
        raise SimulateError("--engine calculix presses, it does not render; add --only mechanics, or leave it out")
    for name, (default, what) in mechanical.items():
        if getattr(arguments, name) != default:
            raise SimulateError(f"--{name} {what}; add --only mechanics or leave it out")
