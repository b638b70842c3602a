"""``finray export capture-request``: which captures a lab should take of a finger, as a page and tactile plans."""

import argparse
from pathlib import Path

from finray_calib.cli.design_file import read_design
from finray_calib.cli.options import file_name, naming, open_engine, require_new, say


def run(arguments: argparse.Namespace) -> None:
    """Write page and plans, and report."""
    from data_schemas.errors import RecordError, SimulateError
    from data_schemas.product_set import ProductSet
    from finray_calib.cli.export_deck import refuse_options as refuse_deck
    from finray_calib.cli.export_taxim import refuse_options as refuse_taxim
    from finray_calib.exchange.capture_request import capture_request
    from finray_calib.exchange.requested_presses import PlannedView
    from finray_calib.reports.finger_outline import finger_outline
    from sim.experiments.camera_view import camera_view

    refuse_deck(arguments)
    refuse_taxim(arguments)
    for name in ("format", "led", "camera_response"):
        if getattr(arguments, name) is not None:
            raise RecordError(f"--{name.replace('_', '-')} belongs to a paint; leave it out for a capture request")
    if len(arguments.paint) != 2:  # the word and the file
        raise RecordError("a capture request needs one design: finray export capture-request DESIGN.toml")
    path: Path = arguments.paint[1]
    design = read_design(path)
    out = require_new(arguments.out or Path(f"{file_name(design.name)}.request.md"))
    with naming(SimulateError, path):
        finger_outline(design, path.parent)  # nobody can print, and then capture, parts that do not fit
        seen = camera_view(design, path.parent, open_engine("auto"))
    scale, u_rel = seen.mm_per_px
    view = PlannedView(*seen.seen_mm, mm_per_px=scale, mm_per_px_u_rel=u_rel)
    request = capture_request(design, path.name, out.name.removesuffix(".md"), view)
    plans = {require_new(out.with_name(name)): text for name, text in request.plans.items()}
    with ProductSet(out) as products:
        for plan, text in plans.items():
            products.add(plan, text.encode())
        products.add(out, request.page.encode())
    say(f"{out}: what to capture of {design.name}")
    for plan in plans:
        say(f"{plan}: plan for 'finray capture'")
